"""Plain words: coined and ambiguous ones, with those that stand for them, and numbers as printed.

The terms of the code and their one meaning are listed in vmdg/GLOSSARY.md.
"""

from __future__ import annotations

import ast
import io
import re
import tokenize
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

#: Where plain words are expected: docstrings, comments and messages of modules, text of pages.
ROOMS = ("vmdg", "forms", "meshes", "demos", ".ci", ".github")
INSIDE = (path for room in ROOMS for path in (ROOT / room).rglob("*.*"))
FILES = sorted({*ROOT.glob("*.md"), *(path for path in INSIDE if path.suffix in (".py", ".md"))})

#: Words that are not used, as whole words, and what is written instead.
BANNED = {
    r"lips?": "crack faces",
    r"(?-i:tours?)": "the name of the source, cited",
    r"foresee[ns]?|foretells?|foretold": "predict, estimate",
    r"held by": "constrained by",
    r"(goes|go|went) on": "continue",
    r"kept back": "buffered",
    r"what leads": "control parameter, load on",
    r"rests": "is supported, is constant",
    r"(come|comes|came|comes) free": "is detached",
    r"inside out": "inverted",
    r"to and fro": "alternate, oscillate",
    r"for ever": "indefinitely",
    r"anew": "again",
    r"besides?": "next to, in addition to",
    r"bears?|bore|borne": "carry",
    r"(?-i:[Ww](ears?|ore|orn))": "degrade, damage",
    r"whole numbers?": "integer",
    r"in words": "as text, description",
    r"nobody|somebody|anybody": "no process, a rank, any rank",
    r"sets? out": "start",
    r"at the door": "on input",
    r"(?<!there )(is|are) no (?!longer|more)": "is not a",
    r"(?<!there )(is|are) (?-i:none)(?! of)": "is not a",
    r"one (\w+ )?a (point|cell|facet|row|rank|group|pair|step)": "one per",
    r"first guess(es)?": "predictor",
    r"slip s": "elastic opening s",
    r"drag on the gap": "overstress",
    r"work on bonds": "damage work",
}

#: Names of groups of facets, which are public.
NAMES = {"lower lip", "upper lip"}

#: Numbers without the leading zero, and percent signs without a space before them.
NUMBERS = {r"(?<![\w.\])}])\.\d": "a leading zero", r"\d%(?![\w.(|])": "a space before %"}


#: Code in a text, fields of formats, and names of arguments before what is said of them.
CODE = re.compile(
    r"```.*?```|``.*?``|`[^`\n]*`|\{[^{}]*\}|^ *\*{0,2}\w+(?:, \*{0,2}\w+)*: ",
    re.DOTALL | re.MULTILINE,
)


def literals(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Strings with their lines, without the format specifications of f-strings."""
    specifications = {
        id(part)
        for node in ast.walk(tree)
        if isinstance(node, ast.FormattedValue) and node.format_spec is not None
        for part in ast.walk(node.format_spec)
    }
    for node in ast.walk(tree):
        is_text = isinstance(node, ast.Constant) and isinstance(node.value, str)
        if is_text and id(node) not in specifications:
            yield node.lineno, node.value


def comments(source: str) -> Iterator[tuple[int, str]]:
    """Comments with their lines; those that continue each other are one."""
    block, last = [], None
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        line, column = token.start
        if block and last != (line - 1, column):
            yield block[0][0], " ".join(text for _, text in block)
            block = []
        block.append((line, token.string.lstrip("#: ")))
        last = line, column
    if block:
        yield block[0][0], " ".join(text for _, text in block)


def prose(path: Path) -> Iterator[tuple[int, str]]:
    """Text for readers in a file, with the lines where it starts; code in it is left out."""
    source = path.read_text()
    texts = [(1, source)]
    if path.suffix == ".py":
        texts = [*literals(ast.parse(source)), *comments(source)]
    for line, text in texts:
        plain = re.sub(CODE, " ", "" if text in NAMES else text)
        yield line, re.sub(r"\s+", " ", plain)


def found(text: str) -> list[str]:
    """What is not written so in a text, and what is written instead."""
    patterns = {rf"\b(?:{word})(?!\w)": instead for word, instead in BANNED.items()} | NUMBERS
    return [
        f"{match[0].strip()!r} (write: {instead})"
        for pattern, instead in patterns.items()
        for match in re.finditer(pattern, text, re.IGNORECASE)
    ]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_words_are_plain(path):
    """No coined word in docstrings, comments and messages; numbers as journals print them."""
    bad = [f"{path.name}:{line}: {word}" for line, text in prose(path) for word in found(text)]
    assert not bad, "\n".join(bad)


def test_glossary_has_each_term_once():
    """One row per term, with a meaning, and equations that the report has."""
    lines = (ROOT / "vmdg" / "GLOSSARY.md").read_text().splitlines()
    rows = [[cell.strip() for cell in line[1:-1].split(" | ")] for line in lines if line[:1] == "|"]
    rows = [row for row in rows if row[0] != "term" and set(row[0]) != {"-", "|"}]
    assert len(rows) > 50
    terms = [term for row in rows for term in row[0].split(", ")]
    assert len(terms) == len(set(terms))
    for row in rows:
        assert len(row[2]) > 10, row[0]
        numbers = [int(number) for number in re.findall(r"\((\d+)\)", row[3])]
        assert all(0 < number < 92 for number in numbers), row[0]
