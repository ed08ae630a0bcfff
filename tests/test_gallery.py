"""Pictures and tables of the pages come from commands, and sentences repeat their numbers."""

from __future__ import annotations

import csv
import re
import runpy
from fnmatch import fnmatch
from pathlib import Path

import vmdg

ROOT = Path(__file__).resolve().parent.parent
GALLERY = ROOT / "demos" / "gallery"
SCRIPT = runpy.run_path(str(ROOT / ".ci" / "pictures.py"))
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("[!.]*/**/*.md"))]


def linked() -> set[str]:
    found = [re.findall(r"gallery/([\w.-]+\.\w+)", page.read_text()) for page in PAGES]
    return {name for names in found for name in names}


def made() -> list[str]:
    return [
        name for _, files in SCRIPT["COMMANDS"].values() for name in SCRIPT["in_gallery"](files)
    ]


def test_every_file_is_made_by_a_command():
    """None is left from a command that nobody knows any more, none is missing."""
    files = {file.name for file in GALLERY.iterdir()}
    strange = {name for name in files if not any(fnmatch(name, each) for each in made())}
    assert not strange
    assert not [each for each in made() if not any(fnmatch(name, each) for name in files)]


def test_every_picture_is_shown():
    """A picture that no page shows would be made for nobody."""
    pictures = {file.name for file in GALLERY.iterdir() if file.suffix in (".png", ".gif")}
    assert len(pictures) > 30
    assert not pictures - linked()


def test_every_table_says_how_it_was_made():
    """What is computed, command, version, machine and date, and the title that the site lists."""
    tables = {file.name: file.read_text() for file in sorted(GALLERY.glob("*.md"))}
    assert set(tables) == set(SCRIPT["TABLES"])
    commands = {
        name: command
        for command, files in SCRIPT["COMMANDS"].values()
        for name in SCRIPT["in_gallery"](files)
    }
    for name, text in tables.items():
        title, what = SCRIPT["TABLES"][name]
        assert text.startswith(f"# {title}\n\n{what}\n\n- Command: `demos/run {commands[name]}`\n")
        assert re.search(r"\n- Version: vmdg .+\n- Machine: .+\n- Date: \d{4}-\d\d-\d\d", text)


def test_page_of_a_table():
    """The table as the command wrote it, below what a reader asks first."""
    text = SCRIPT["page"]("stability.md", "stability", "| a |\n|---|\n| 1 |\n", 0.25)
    title, what = SCRIPT["TABLES"]["stability.md"]
    assert text.startswith(f"# {title}\n\n{what}\n\n- Command: `demos/run stability`\n")
    assert f"vmdg {vmdg.__version__}, DOLFINx" in text
    assert "cores, 0.2 other processes running\n" in text
    assert text.endswith("\n\n| a |\n|---|\n| 1 |\n")


def named_tables() -> dict[str, str]:
    return {
        file.stem: re.search(r"(?:^\|.*\n)+", file.read_text(), re.MULTILINE)[0].strip()
        for file in sorted(GALLERY.glob("*.md"))
    }


def rows(table: str) -> list[list[str]]:
    return [[c.strip() for c in line.strip("|").split("|")] for line in table.splitlines()[2:]]


STUDIES = ("demos/ACCURACY", "demos/SPEED")


def table_with(page: str, row: str) -> str:
    """The table of a page that has a row."""
    tables = re.findall(r"(?:^\|.*\n)+", page, re.MULTILINE)
    return next(table for table in tables if row in table)


def text(page: str) -> str:
    """Words of a page, in one line."""
    return " ".join((ROOT / page).read_text().split())


def test_numbers_in_the_text():
    """Sentences count what the tables count."""
    found = named_tables()
    readme, accuracy, speed = (text(f"{name}.md") for name in ("README", *STUDIES))
    _, runs, correct, refused, stopped, *bad = rows(found["stability"])[-1][:9]
    assert set(bad) == {"0"}
    said = (
        f"Of {runs} random stress runs {correct} ended right, {refused} were refused with the "
        f"reason, {stopped} stopped in a clear error with their last state intact, none was wrong"
    )
    assert said in readme
    ratios = [float(row[8]) for row in rows(found["benchmark_ratio"])]
    said = f"takes {min(ratios):.2f} to {max(ratios):.2f} times as long"
    assert said in readme and said in speed
    with open(GALLERY / "benchmark_precision.csv") as file:
        points = {(r["cell"], r["degree"], r["n"], r["method"]): r for r in csv.DictReader(file)}
    for norm, name in (("l2", "(displacement)"), ("h1", "(its gradient")):
        off = [
            float(point[norm]) / float(points[(*key[:3], "plain")][norm]) - 1
            for key, point in points.items()
            if key[3] == "vmdg"
        ]
        said = f"{100 * max(map(abs, off)):.1f} % {name}"
        assert said in readme and len(off) > 20 and max(off) < 0.003
        assert said.partition(" (")[0] in accuracy
    tables = {
        row[0]: row[1:]
        for row in rows(
            table_with((ROOT / "demos" / "ACCURACY.md").read_text(), "| ties, degree 1 |")
        )
    }
    for kind, words in {
        "ties, degree 1": "{} and {} (ties)",
        "bonds, degrees 2 and 3": "{} and {} (bonds of degrees 2 and 3)",
        "bonds, degree 1": "{} and {} (bonds of degree 1",
    }.items():
        assert words.format(*tables[kind]) in readme
    head, *errors = [
        line.strip("|").split("|")
        for line in table_with(
            (ROOT / "demos" / "ACCURACY.md").read_text(), "| of degree 2 |"
        ).splitlines()
        if "---" not in line
    ]
    first = [
        next(n for n, e in zip(head[1:], row[1:], strict=True) if float(e.strip(" %")) < 1)
        for row in errors
    ]
    said = "{1} unknowns of degree 2 and with {0} of degree 1".format(*map(str.strip, first))
    assert said in text("vmdg/HOWTO.md")
    studies = sum(int(row[2]) for row in rows(found["convergence"]))
    missed = sum(int(row[-1]) for row in rows(found["convergence"]))
    assert missed == 0
    assert f"{studies} studies of [convergence]" in readme
    assert f"All {studies} studies meet the targets" in accuracy
