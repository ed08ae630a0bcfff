"""Formulas of pages and docstrings, plain text in the sources, as MathML on the site.

The notation is that of a terminal: ``K.du_0 = -R``, ``tau_s = inv(tau_1 + tau_2)``, ``F_s^-T``,
``N (x) N``, ``{P.N}``, ``int_K p dV``. Nothing is computed and nothing rearranged: a formula has
the same signs in the same order. Text that could be anything else, a program or a sentence, is
``Unclear`` and stays as it is.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from html import escape
from typing import NamedTuple

NAMES = (
    "alpha beta gamma delta epsilon zeta eta theta iota kappa lambda mu nu xi omicron pi rho "
    "varsigma sigma tau upsilon phi chi psi omega"
).split()
GREEK = dict(zip(NAMES, "αβγδεζηθικλμνξοπρςστυφχψω", strict=True)) | {"eps": "ε"}
GREEK |= {name.capitalize(): sign.upper() for name, sign in GREEK.items() if len(sign) == 1}
GREEK = {name: sign for name, sign in GREEK.items() if name not in ("Eps", "omicron", "Omicron")}

FUNCTIONS = set(
    "sin cos tan arcsin arccos arctan sinh cosh tanh exp log log10 ln sqrt max min tr inv det div "
    "grad GRAD Grad meas argmin argmax sign dev sym".split()
)
BIG = {"int": "∫", "sum": "∑"}
RELATIONS = {"<=": "≤", ">=": "≥", "<<": "≪", ">>": "≫", "->": "→", "=": "=", "<": "<", ">": ">"}
BRACKETS = {"(": ")", "[": "]", "{": "}"}
#: Words that begin a remark next to a formula.
REMARK = set("where for in if with at and or otherwise next the along of is all".split())
#: Of two or three letters of which each could be a symbol, yet words, names or units.
WORDS = {"do", "e.g", "i.e", "I/O", "N/m", "J/m", "m/s", "W/m", "K/s", "1/s"}
UNITS = set("N m s J K W g")
#: Letters that are words of English, or names, more often than symbols.
ARTICLES = set("a A I C x")

LETTER = "|".join(sorted(GREEK, key=len, reverse=True)) + "|[A-Za-z]"
DIFFERENTIAL = re.compile(rf"(?:(?:d[23]?|D[23])(?:{LETTER})[23]?)+$")
FACTOR = re.compile(rf"([dD])([23]?)({LETTER})([23]?)")
NUMBER = re.compile(r"\d+(?:\.\d+)?(?![\w])")
WORD = re.compile(r"[^\W\d_²³][^\W_²³]*")
BELOW = re.compile(r"_(?:\{([^{}]+)\}|([A-Za-z0-9]+|\+)(?![A-Za-z0-9]))((?:,[A-Za-z]+(?!\w))?)")
#: x^-T, x^-1_JK; not x^1/2, which is two things.
POWER = re.compile(rf"(-?)(?:(\d+(?:\.\d+)?)|({LETTER}))(?!(?<=1)/\d)(?![^\W_]|\.\d)")
PRIMES = {"'": "′", "*": "∗"}
POWERS = {"²": "2", "³": "3"}


class Unclear(ValueError):
    """Text that is no formula, or not without doubt."""


class Item(NamedTuple):
    """A piece of a formula: what it is, and its MathML."""

    kind: str  # number symbol differential function group word text; operator slash; space ...
    xml: str
    inside: str = ""  # of a group in parentheses, without them


OPERANDS = {"number", "symbol", "differential", "group", "word"}


def mathml(text: str, display: bool = True) -> str:
    """A formula as an element of MathML, its text with it.

    Args:
        text: One line.
        display: A line of its own, which may have names of parameters and remarks in it; otherwise
            a formula within a sentence.

    Raises:
        Unclear: it may be no formula.
    """
    text = text.strip().replace("\n", " ").replace("’", "'").replace("−", "-")
    reader = Reader(text, display)
    row = joined(reader.row(""), display)
    style = ' displaystyle="true"' if display else ""
    return (
        f"<math{style}><semantics><mrow>{row}</mrow>"
        f'<annotation encoding="text/plain">{escape(text)}</annotation></semantics></math>'
    )


def block(text: str) -> str:
    """A block of formulas, one a line, as HTML.

    Raises:
        Unclear: of a line, or no line relates anything.
    """
    lines = [line for line in text.expandtabs().splitlines() if line.strip()]
    if not any(re.search(r" (=|<=|>=|<|>|[-+/]) |\S/\S", line) for line in lines):
        raise Unclear("nothing is related")
    least = min(len(line) - len(line.lstrip()) for line in lines)
    made = []
    for line in lines:
        inset = len(line) - len(line.lstrip()) - least
        style = f' style="margin-left: {inset / 2:g}em"' * bool(inset)
        made.append(f"<div{style}>{mathml(line)}</div>")
    return '<div class="formula">' + "".join(made) + "</div>"


class Reader:
    """Reads one formula from left to right."""

    def __init__(self, text: str, display: bool) -> None:
        """Of a text, see `mathml`."""
        self.text, self.display = text, display
        self.at = self.depth = 0

    def here(self, shift: int = 0) -> str:
        """A character of the text, a space beyond its ends."""
        i = self.at + shift
        return self.text[i] if 0 <= i < len(self.text) else " "

    def row(self, end: str) -> list[Item]:
        """Pieces up to a closing bracket, or up to the end of the text."""
        items: list[Item] = []
        while self.at < len(self.text):
            opens = end == "|" and self.here(-1) == " "
            if end and not opens and self.text.startswith(end, self.at):
                return items
            items.append(self.piece(items))
        if end:
            raise Unclear(f"no {end}")
        return items

    def piece(self, before: list[Item]) -> Item:
        """The next piece."""
        rest = self.text[self.at :]
        operand = bool(before) and before[-1].kind in OPERANDS
        if spaces := re.match(" +", rest):
            self.at += spaces.end()
            return Item("space", f'<mspace width="{0.2 if spaces.end() == 1 else 2}em"/>')
        if rest.startswith("(x) ") and self.here(-1) == " ":
            return self.sign(3, "⊗")
        if label := re.match(r"\(\*+\)$", rest):
            self.at += label.end()
            return Item("text", f"<mtext>{label[0]}</mtext>")
        if found := NUMBER.match(rest):
            self.at += found.end()
            return self.scripts(Item("number", f"<mn>{found[0]}</mn>"))
        if found := WORD.match(rest):
            return self.name(found[0], before)
        if rest[0] in "([{":
            return self.group(rest[0], BRACKETS[rest[0]])
        if rest[0] == "|" and not operand:
            return self.group("|", "|")
        for sign, shown in RELATIONS.items():
            if rest.startswith(sign):
                return self.spaced(sign, shown)
        if rest[0] in "+-":
            return self.sum_or_sign(rest[0], operand)
        if rest[0] in ".:,;":
            return self.point(rest[0], operand)
        if rest[0] == "/":
            if not before or (self.here(-1) == " ") != (self.here(1) == " "):
                raise Unclear("a slash between nothing")
            self.at += 1
            return Item("slash", "<mo>/</mo>")
        raise Unclear(f"{rest[0]} in {self.text}")

    def sign(self, length: int, shown: str, attributes: str = "") -> Item:
        """An operator of a length in the text."""
        self.at += length
        return Item("operator", f"<mo{attributes}>{escape(shown)}</mo>")

    def spaced(self, sign: str, shown: str) -> Item:
        """A relation, which has spaces around it."""
        after = self.text[self.at + len(sign) :]
        if self.here(-1) != " " or not after.startswith(" ") or not after.strip(" .,;"):
            if not (self.display and self.at == 0):
                raise Unclear(f"{sign} without spaces or a side")
        return self.sign(len(sign), shown)

    def sum_or_sign(self, sign: str, operand: bool) -> Item:
        """A sum or difference, spaced; or the sign of what comes next."""
        shown = "−" if sign == "-" else "+"
        left, right = self.here(-1) == " ", self.here(1) == " "
        if left and right and self.text[self.at + 1 :].strip():
            return self.sign(1, shown)
        if right or operand or not re.match(r"[\w|({\[]", self.here(1)):
            raise Unclear(f"{sign} without spaces")
        return self.sign(1, shown, ' form="prefix"')

    def point(self, sign: str, operand: bool) -> Item:
        """A product between two letters, or the end of a clause."""
        after = self.here(1)
        if sign == ":" and self.here(-1) == " " == after:
            return self.sign(1, ":", ' lspace="0.2em" rspace="0.2em"')
        if sign in ".:" and operand and re.match(r"[^\W\d]|[(\[{|]", after):
            return self.sign(1, {".": "⋅"}.get(sign, ":"), ' lspace="0.1em" rspace="0.1em"')
        if after == " " and before_sign(self.here(-1)):
            self.at += 1
            return Item("punctuation", f'<mo separator="true" lspace="0">{sign}</mo>')
        raise Unclear(f"{sign} within a word")

    def group(self, left: str, right: str) -> Item:
        """What stands between brackets or bars, which may have scripts."""
        self.at += 1
        if left == "|" and self.here() == " ":
            raise Unclear("a bar without its other one")
        self.depth += 1
        inside = joined(self.row(right), self.display)
        self.depth -= 1
        if not inside:
            raise Unclear("empty brackets")
        self.at += 1
        high = str("<mfrac>" in inside).lower()
        xml = (
            f'<mrow><mo form="prefix" stretchy="{high}">{left}</mo>{inside}'
            f'<mo form="postfix" stretchy="{high}">{right}</mo></mrow>'
        )
        made = self.scripts(Item("group", xml))
        plain = made.xml == xml and left == "("
        return Item("group", made.xml, f"<mrow>{inside}</mrow>" if plain else "")

    def name(self, word: str, before: list[Item]) -> Item:
        """A symbol, a function, a differential, a parameter by its name, or a remark."""
        start = self.at
        self.at += len(word)
        if word in BIG:
            return self.big(word)
        if word in GREEK or len(word) == 1:
            operand = bool(before) and before[-1].kind == "space" and self.here() == " "
            if word == "x" and operand and re.match(r" [\w({\[]", self.rest()):
                # (a x b) is a product of vectors, a x b may be one of numbers.
                if not (self.depth and len(before) == 2 and before[0].kind in OPERANDS):
                    raise Unclear("x may be a product")
                return Item("operator", "<mo>×</mo>")
            return self.scripts(Item("symbol", f"<mi>{GREEK.get(word, word)}</mi>"))
        if word in FUNCTIONS:
            return self.scripts(Item("function", f"<mi>{word}</mi>"))
        if DIFFERENTIAL.match(word) and word not in WORDS:
            return self.scripts(Item("differential", differentials(word)))
        if not self.display:
            raise Unclear(f"{word} is a word")
        if word in REMARK:
            return self.remark(word)
        return self.parameter(start, before)

    def big(self, word: str) -> Item:
        """A sum or an integral with its range."""
        sign = f'<mo movablelimits="false">{BIG[word]}</mo>'
        low = high = ""
        if found := BELOW.match(self.text, self.at):
            self.at = found.end()
            low = subscript(found)
        if self.here() == "^":
            self.at += 1
            high = self.power()
        if not (low or high):
            return Item("function", sign)
        under = ("munder", "mover", "munderover")
        tags = under if word == "sum" and self.display else ("msub", "msup", "msubsup")
        tag = tags[2] if low and high else tags[0] if low else tags[1]
        return Item("function", f"<{tag}>{sign}{low}{high}</{tag}>")

    def scripts(self, base: Item) -> Item:
        """A piece with what stands at it: index, prime, tilde, star, power."""
        xml, low, high = base.xml, "", ""

        def with_scripts() -> str:
            tag = "msubsup" if low and high else "msub" if low else "msup"
            return f"<{tag}>{xml}{low}{high}</{tag}>" if low or high else xml

        while True:
            here = self.here()
            found = BELOW.match(self.text, self.at)
            above = ""
            if found:
                self.at = found.end()
                if found[2] == "bar" and base.kind != "group" and not (low or high):
                    xml = f'<mover accent="true">{xml}<mo stretchy="false">¯</mo></mover>'
                    continue
                if low:
                    xml, low, high = with_scripts(), "", ""
                low = subscript(found)
                continue
            if here == "_":
                raise Unclear(f"an index in {self.text}")
            star = base.kind == "symbol" and re.match("[_| ,)]", self.here(1))
            if here == "~" and not (low or high):
                self.at += 1
                xml = f'<mover accent="true">{xml}<mo stretchy="false">~</mo></mover>'
                continue
            if here == "'" or (here == "*" and star):
                self.at += 1
                above = f"<mo>{PRIMES[here]}</mo>"
            elif here in POWERS:
                self.at += 1
                above = f"<mn>{POWERS[here]}</mn>"
            elif here == "^":
                self.at += 1
                above = self.power()
            else:
                return Item(base.kind, with_scripts())
            if high:
                xml, low, high = with_scripts(), "", ""
            high = above

    def power(self) -> str:
        """What stands behind ``^``: one sign, number or letter, or a bracket."""
        found = POWER.match(self.text, self.at)
        if found:
            self.at = found.end()
            minus = "<mo>−</mo>" * bool(found[1])
            value = f"<mn>{found[2]}</mn>" if found[2] else f"<mi>{letter(found[3])}</mi>"
            return f"<mrow>{minus}{value}</mrow>"
        if self.here() == "(":
            self.at += 1
            inside = joined(self.row(")"), False)
            self.at += 1
            return f"<mrow>{inside}</mrow>"
        raise Unclear(f"a power in {self.text}")

    def remark(self, word: str) -> Item:
        """Words up to the next symbol or sign."""
        said = [word]
        while found := re.match(r" ([^\W\d_]+)(?![\w'(=])", self.text[self.at :]):
            known = found[1] in GREEK or found[1] in FUNCTIONS or DIFFERENTIAL.match(found[1])
            article = found[1] == "a" and re.match(r" a [a-z]{2}", self.text[self.at :])
            if (known or len(found[1]) == 1) and not article and found[1] not in WORDS:
                break
            said.append(found[1])
            self.at += found.end()
        return Item("text", f"<mtext>{' '.join(said)}</mtext>")

    def parameter(self, start: int, before: list[Item]) -> Item:
        """A quantity by its name, which stands alone between signs."""
        found = re.compile(r"[^\W\d]\w*").match(self.text, start)
        self.at = found.end()
        kinds = [item.kind for item in before if item.kind != "space"]
        tight = self.here() in "([.:/" and not re.match(r"\.( |$)|/[^\W\d]*\d|/\(", self.rest())
        if tight or (kinds and kinds[-1] == "word") or self.here(start - self.at - 1) in "./:":
            raise Unclear(f"{found[0]} is a word")
        return Item("word", f"<mi>{found[0]}</mi>")

    def rest(self) -> str:
        """The text that is not read yet."""
        return self.text[self.at :]


def before_sign(character: str) -> bool:
    """Whether a comma, point or colon may follow this character."""
    return character.isalnum() or character in ")]}|'~+*²³"


def letter(name: str) -> str:
    """A letter by its name."""
    return GREEK.get(name, name)


def subscript(found: re.Match[str]) -> str:
    """An index, words and letters of Greek names."""
    if found[1]:
        return f"<mrow>{joined(Reader(found[1], False).row(''), False)}</mrow>"
    parts = [found[2], *filter(None, [found[3][1:]])]
    shown = [f"<mn>{p}</mn>" if p.isdigit() else f"<mi>{letter(p)}</mi>" for p in parts]
    return "<mrow>" + "<mo>,</mo>".join(shown).replace("<mi>+</mi>", "<mo>+</mo>") + "</mrow>"


def differentials(word: str) -> str:
    """The factors of dV, dzeta, d2Pi, dFdF."""
    made = []
    for d, order, name, power in FACTOR.findall(word):
        sign = f'<mi mathvariant="normal">{d}</mi>'
        made.append(f"<msup>{sign}<mn>{order}</mn></msup>" if order else sign)
        value = f"<mi>{letter(name)}</mi>"
        made.append(f"<msup>{value}<mn>{power}</mn></msup>" if power else value)
    return "<mrow>" + "".join(made) + "</mrow>"


def joined(items: list[Item], display: bool) -> str:
    """Pieces in a row; in a formula of its own a fraction whose ends are plain is stacked."""
    made: list[str] = []
    i = 0
    while i < len(items):
        if display and stacked(items, i):
            top, bottom = items[i], items[i + 2]
            made.append(f"<mfrac>{top.inside or top.xml}{bottom.inside or bottom.xml}</mfrac>")
            i += 3
        else:
            made.append(items[i].xml)
            i += 1
    return "".join(made)


def stacked(items: list[Item], i: int) -> bool:
    """Whether the pieces from i on are a fraction, that cannot be read as another one."""
    ends = items[i : i + 3]
    if len(ends) < 3 or ends[1].kind != "slash":
        return False
    top, _, bottom = ends
    plain = {"number", "symbol", "differential", "group"}
    if top.kind not in plain or bottom.kind not in plain:
        return False
    if "<mi>d</mi>" in (top.xml, bottom.xml):
        return False
    before = [item for item in items[:i] if item.kind != "space"][-1:]
    if i and items[i - 1].kind not in ("space", "operator", "punctuation"):
        return False
    if i and items[i - 1].kind == "operator" and "lspace" in items[i - 1].xml:
        return False  # a product
    if before and (before[0].kind == "function" or before[0].xml == "<mi>d</mi>"):
        return False
    after = items[i + 3 : i + 5]
    if after and after[0].kind not in ("space", "punctuation"):
        return False
    factor = len(after) == 2 and after[1].kind in {*OPERANDS, "function", "differential"}
    sure = bottom.kind == "number" or top.kind == bottom.kind == "differential"
    return not factor or sure


# ---- formulas within sentences ------------------------------------------------------------------

UNIT_AFTER = re.compile(r",?\s(and\s)?(mm|MPa|kN|GPa)\b")
UNIT_BEFORE = re.compile(r"\b(mm|MPa|kN|GPa|per),?\s(and\s)?$")
SIGNS = {"=", "+", "-", "<", ">", "<=", ">=", "<<", ">>", "/", ":", "(x)"}


def spans(text: str) -> Iterator[tuple[int, int]]:
    """Where formulas stand in a sentence: first character, and the one behind the last.

    A letter that is a word of English is a symbol only next to a sign.
    """
    words = [(found.start(), found.end()) for found in re.finditer(r"\S+", text)]
    i = 0
    while i < len(words):
        for j in range(min(len(words), i + 24), i, -1):
            start, end = words[i][0], words[j - 1][1]
            end -= len(text[start:end]) - len(text[start:end].rstrip(".,;:"))
            if formula(text, start, end):
                yield start, end
                i = j
                break
        else:
            i += 1


def formula(text: str, start: int, end: int) -> bool:
    """Whether this part of a sentence is a formula without doubt."""
    part = text[start:end].replace("\n", " ")
    words = part.split()
    if not words or words[0] in SIGNS or words[-1] in SIGNS:
        return False
    if part in FUNCTIONS or part in BIG or not re.search(r"[^\W\d_]", part):
        return False
    if re.search(r"[.,;:] ", re.sub(r"[(\[{|][^()]*[)\]}|]", "", part)):
        return False  # two clauses
    if re.search(r"(^| )(\(\d+\)|\[[A-Za-z]\])( |$)", part):
        return False  # the number of an equation, a unit
    if set(words) & WORDS or numbers_apart(words):
        return False
    if re.fullmatch(r"[^\W\d]", part):
        # Neither an article, nor an initial of a name, nor a unit.
        if part in UNITS and (UNIT_AFTER.match(text[end:]) or UNIT_BEFORE.search(text[:start])):
            return False
        follows = text[end : end + 1]
        return part not in ARTICLES and follows != "." and not re.search(r"\d\s$", text[:start])
    for k, word in enumerate(words):
        if word in ARTICLES and not {*words[max(0, k - 1) : k], *words[k + 1 : k + 2]} & SIGNS:
            return False
    if len(words) > 2 and not set(words) & SIGNS and words[0] not in {"GRAD", "tr", "d"}:
        return False  # a list
    try:
        mathml(part, display=False)
    except Unclear:
        return False
    return True


def numbers_apart(words: list[str]) -> bool:
    """Whether a number counts what follows (2 H), has a unit, or follows without a sign."""
    words = [word.strip("()") for word in words]
    number = [bool(NUMBER.fullmatch(word)) for word in words]
    if number[0] and (len(words) == 1 or words[1] not in SIGNS):
        return True
    if len(words) == 1:
        return False
    return (number[-2] and words[-1] in UNITS) or (number[-1] and words[-2] not in SIGNS)
