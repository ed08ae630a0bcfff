"""Pictures and tables of the pages come from commands, and stand the same everywhere."""

from __future__ import annotations

import re
import runpy
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
GALLERY = ROOT / "demos" / "gallery"
SCRIPT = runpy.run_path(str(ROOT / ".ci" / "pictures.py"))
PAGES = [ROOT / "README.md", *sorted(ROOT.glob("[!.]*/**/*.md"))]


def linked() -> set[str]:
    """Files of the gallery that a page shows or links."""
    found = [re.findall(r"gallery/([\w.-]+\.\w+)", page.read_text()) for page in PAGES]
    return {name for names in found for name in names}


def made() -> list[str]:
    """Names and patterns of what commands make."""
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


@pytest.mark.parametrize("page", SCRIPT["PAGES"], ids=lambda page: page.name)
def test_tables_are_those_of_the_gallery(page):
    """The numbers of a table stand in one file, pages repeat it word for word."""
    text = page.read_text()
    assert SCRIPT["renewed"](text) == text


def test_which_tables_are_repeated():
    """The check above finds them: by their first lines."""
    heads = {name: table.partition("\n")[0] for name, table in named_tables().items()}
    readme, accuracy = (page.read_text() for page in SCRIPT["PAGES"])
    assert heads["convergence"] in readme
    assert all(head in accuracy for head in heads.values())
    changed = accuracy.replace("| triangle | 1 | 30 | ", "| triangle | 1 | 31 | ")
    assert changed != accuracy
    assert SCRIPT["renewed"](changed) == accuracy


def named_tables() -> dict[str, str]:
    """First table of every page of the gallery."""
    return {
        file.stem: re.search(r"(?:^\|.*\n)+", file.read_text(), re.MULTILINE)[0].strip()
        for file in sorted(GALLERY.glob("*.md"))
    }


def rows(table: str) -> list[list[str]]:
    """Cells of the lines below the head of a table."""
    return [[c.strip() for c in line.strip("|").split("|")] for line in table.splitlines()[2:]]


def test_numbers_in_the_text():
    """Sentences count what the tables count."""
    found, text = named_tables(), (ROOT / "README.md").read_text()
    _, runs, correct, refused, stopped, *bad = rows(found["stability"])[-1][:9]
    assert set(bad) == {"0"}
    said = (
        f"Of {runs} random stress runs {correct} ended right, {refused} were refused with the "
        f"reason, {stopped} stopped in a clear error with their last state intact, none was wrong."
    )
    assert said in " ".join(text.split())
    accuracy = (ROOT / "demos" / "ACCURACY.md").read_text()
    # The run with the defaults of the demo is in every study.
    defaults = {
        "mesh": "cells x 1",
        "steps": "100 steps",
        "friction": "mu = 0.525",
        "modulus": "E_f / E_m = 0.625",
    }
    for study, label in defaults.items():
        (ran,) = (row for row in rows(found[f"pushout_{study}"]) if row[0] == label)
        largest, end = float(ran[4]), float(ran[6])
        assert f"| 412.2 | {largest:.1f} (+.3%) |" in accuracy
        assert f"| 105.5 | {end:.1f} (-.3%) |" in accuracy
        assert abs(largest / 412.2 - 1) < 0.0035
        assert abs(end / 105.5 - 1) < 0.0035
    studies = sum(int(row[2]) for row in rows(found["convergence"]))
    missed = sum(int(row[-1]) for row in rows(found["convergence"]))
    assert f"All {studies} studies meet the targets" in accuracy
    assert missed == 0
