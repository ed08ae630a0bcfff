"""Docstrings of vmdg as reStructuredText: plain text with formulas in it, sections as Google's."""

from __future__ import annotations

import re

#: What is marked up and stays as it is: roles, literals, links.
MARKED = re.compile(r"(:[a-z:]+:`[^`]+`|``.+?``|`[^`]+`)")

BULLET = re.compile(r"( *)([*+-]|\d+\.|#\.) +")
SECTION = re.compile(r"(Args|Attributes|Examples?|Notes?|Raises|Returns|Yields|Warns|See Also):$")


def readable(lines: list[str]) -> list[str]:
    """The lines of a docstring, in which formulas stand as they were typed.

    * A block that is set in after a blank line is a formula: it becomes a literal block.
    * Elsewhere ``|``, ``*`` and ``_`` belong to formulas and are escaped: |T*_N| is no
      substitution, but the size of a traction.

    Args:
        lines: Without the indentation that all have in common.
    """
    made: list[str] = []
    base = 0  # indentation of the paragraph before
    literal = False
    for i, line in enumerate(lines):
        indent = len(line) - len(line.lstrip())
        if not line.strip():
            made.append("")
            continue
        if literal and indent > base:
            made.append(line)
            continue
        after_blank = i > 0 and not lines[i - 1].strip()
        literal = after_blank and any(made) and indent >= base + 4
        if literal:
            last = next(text for text in reversed(made) if text)
            if not last.endswith("::"):
                made += [" " * base + "::", ""]
            made.append(line)
            continue
        bullet = BULLET.match(line)
        if after_blank or i == 0 or bullet or indent < base or SECTION.match(line):
            base = bullet.end() if bullet else indent
        made.append(escaped(line, bullet.end() if bullet else 0))
    return made


def escaped(line: str, start: int = 0) -> str:
    """A line whose characters of formulas are not taken for markup.

    Args:
        line: Of a docstring.
        start: First character that is looked at, behind a bullet.
    """
    parts = MARKED.split(line[start:])
    for i in range(0, len(parts), 2):
        text = re.sub(r"(?<!\\)([|*])", r"\\\1", parts[i])
        parts[i] = re.sub(r"(?<=\w)_(?=\W|$)", r"\\_", text)
    return line[:start] + "".join(parts)
