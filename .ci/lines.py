"""Lines of code, docstrings, comments and blanks of the Python files of a checkout, by folder.

python3 .ci/lines.py [CHECKOUT] [DEPTH]     one row per folder at this depth, 1 by default
"""

from __future__ import annotations

import ast
import io
import sys
import tokenize
from collections import Counter
from pathlib import Path

#: What users install, what protects it, and what shows it.
PARTS = {"engine": ("vmdg", "forms", "meshes"), "tests": ("tests",), "demos": ("demos",)}
KINDS = ("code", "docstring", "comment", "blank")
_LAYOUT = (
    *(tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT),
    *(tokenize.COMMENT, tokenize.ENDMARKER),
)


def count(source: str) -> Counter:
    """Number of lines of every kind."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(
            node
        ):
            text = node.body[0]
            docstrings.update(range(text.lineno, text.end_lineno + 1))
    code: set[int] = set()
    comments: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        rows = range(token.start[0], token.end[0] + 1)
        if token.type == tokenize.COMMENT:
            comments.update(rows)
        elif token.type not in _LAYOUT:
            code.update(rows)
    code -= docstrings
    comments -= code
    total = source.count("\n")
    blank = total - len(code) - len(docstrings) - len(comments)
    return Counter(code=len(code), docstring=len(docstrings), comment=len(comments), blank=blank)


def files(root: Path, folder: str) -> list[Path]:
    """Python files of a folder; links are counted where they lead."""
    found = sorted((root / folder).rglob("*.py"))
    return [path for path in found if not any(p.is_symlink() for p in path.parents)]


def main() -> None:
    """Print the table."""
    root = Path(sys.argv[1]) if sys.argv[1:] else Path(__file__).resolve().parent.parent
    depth = int(sys.argv[2]) if sys.argv[2:] else 1
    print(f"| folder | files | {' | '.join(KINDS)} | all |")
    print("|---" * (len(KINDS) + 3) + "|")
    for part, folders in PARTS.items():
        rows: dict[str, Counter] = {}
        for folder in folders:
            for path in files(root, folder):
                name = "/".join(path.relative_to(root).parts[:-1][:depth])
                row = rows.setdefault(name, Counter())
                row.update(count(path.read_text("utf-8")))
                row["files"] += 1
        rows[f"**{part}**"] = sum(rows.values(), Counter())
        for name, row in rows.items():
            numbers = [row["files"], *(row[kind] for kind in KINDS), sum(row[k] for k in KINDS)]
            print(f"| {name} | {' | '.join(map(str, numbers))} |")


if __name__ == "__main__":
    main()
