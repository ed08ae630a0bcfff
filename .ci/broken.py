"""Does the suite find broken lines? Breaks lines of the engine at random, one after the other.

    python3 .ci/broken.py [--count 20] [--seed 1] [--rooms] [--checkout FOLDER] [-- pytest ...]

In a copy of the checkout one operator of a line is changed, + to -, * to /, < to >=, and the tests
named after its file run, those of its room, those of the rooms that build on it, then all, until
one fails. A line that no test finds has no witness, or does nothing. With --rooms the last is left
out, which takes a quarter of the time.
"""

from __future__ import annotations

import argparse
import ast
import random
import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[1]
ROOMS = (
    *("assembly", "domain", "dynamics", "interface", "laws", "linear", "materials", "points"),
    *("problem", "sensitivity", "solver", "checks"),
)
#: Rooms whose tests show most of what a room does wrong, in addition to its own.
NEXT = {
    "laws": ("interface", "problem"),
    "materials": ("problem", "assembly"),
    "points": ("interface",),
    "checks": ("problem", "interface"),
    "domain": ("assembly", "problem"),
    "linear": ("solver", "problem"),
    "solver": ("problem",),
    "problem": ("solver", "assembly"),
    "interface": ("problem", "dynamics"),
    "assembly": ("problem", "interface"),
    "sensitivity": ("identification",),
    "dynamics": ("solver",),
}
#: Seconds after which a broken line counts as found.
PATIENCE = 1200
OTHERS = {"+": "-", "-": "+", "*": "/", "/": "*", "<": ">=", ">": "<=", "<=": ">", ">=": "<"}


class Line(NamedTuple):
    """An operator that can be changed: file within the checkout, its place, and its text."""

    file: Path
    line: int
    column: int
    operator: str


def operators(root: Path) -> list[Line]:
    """All operators between two numbers in the rooms of the engine."""
    found = []
    for room in ROOMS:
        for file in sorted((root / "vmdg" / room).glob("*.py")):
            text = file.read_text("utf-8")
            lines = text.splitlines()
            for node in ast.walk(ast.parse(text)):
                if isinstance(node, ast.BinOp):
                    left, right = node.left, node.right
                elif isinstance(node, ast.Compare) and len(node.ops) == 1:
                    left, right = node.left, node.comparators[0]
                else:
                    continue
                if left.end_lineno != right.lineno:
                    continue
                start = left.end_col_offset
                between = lines[left.end_lineno - 1].encode()[start : right.col_offset].decode()
                sign = re.fullmatch(r"\)*\s*(<=|>=|[-+*/<>])\s*\(*", between)
                if sign:
                    place = start + sign.start(1)
                    found.append(Line(file.relative_to(root), right.lineno, place, sign[1]))
    return found


def broken(copy: Path, one: Line) -> str:
    """Change an operator; the line as it is then."""
    lines = (copy / one.file).read_text("utf-8").splitlines(keepends=True)
    text = lines[one.line - 1].encode()
    end = one.column + len(one.operator)
    changed = text[: one.column] + OTHERS[one.operator].encode() + text[end:]
    lines[one.line - 1] = changed.decode()
    (copy / one.file).write_text("".join(lines), "utf-8")
    return changed.decode().strip()


def places_of(copy: Path, file: Path, rooms: bool) -> list[list[str]]:
    """What runs one after the other: those most likely to fail first."""
    tests, room = copy / "tests", file.parts[1]
    own = tests / room
    named = sorted(map(str, tests.rglob(f"test_{file.stem}*.py")))
    dear = [path for other in NEXT.get(room, ()) if (path := tests / other).is_dir()]
    chosen = [named, [str(own)] if own.is_dir() else [], [*map(str, dear)]]
    return [places for places in chosen if places] + ([] if rooms else [[]])


def first_failure(copy: Path, file: Path, arguments: list[str], rooms: bool) -> str:
    """Name of a test that fails; empty if all pass."""
    for places in places_of(copy, file, rooms):
        command = [str(copy / "tests/run"), "-q", "-x", *arguments, *places]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, check=False, timeout=PATIENCE
            )
        except subprocess.TimeoutExpired:
            return f"no end within {PATIENCE} s"
        if done.returncode not in (0, 5):
            said = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
            return said[1] if said else f"exit code {done.returncode}"
    return ""


def main(count: int, seed: int, checkout: Path, arguments: list[str], rooms: bool) -> None:
    """Break lines, and print a table of what finds them."""
    chosen = random.Random(seed).sample(operators(checkout), count)
    print("| line | broken | found by |\n|---|---|---|", flush=True)
    missed = 0
    for one in chosen:
        with TemporaryDirectory() as folder:
            copy = Path(folder) / "copy"
            shutil.copytree(checkout, copy, symlinks=True, ignore=shutil.ignore_patterns(".git"))
            text = broken(copy, one).replace("|", "\\|")
            by = first_failure(copy, one.file, arguments, rooms)
        missed += not by
        print(f"| {one.file}:{one.line} | `{text}` | {by or '**nothing**'} |", flush=True)
    print(f"{count - missed} of {count} found")


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    command.add_argument("--count", type=int, default=20)
    command.add_argument("--seed", type=int, default=1)
    command.add_argument("--checkout", type=Path, default=ROOT)
    command.add_argument("--rooms", action="store_true", help="leave out what runs all tests")
    mine, rest = sys.argv[1:], []
    if "--" in mine:
        mine, rest = mine[: mine.index("--")], mine[mine.index("--") + 1 :]
    options = command.parse_args(mine)
    main(options.count, options.seed, options.checkout.resolve(), rest, options.rooms)
