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
    ratios = [float(row[6]) for row in rows(found["benchmark_ratio"])]
    said = f"takes {min(ratios):.2f} to {max(ratios):.2f} times as long"
    assert said in readme and said in speed
    studies = sum(int(row[2]) for row in rows(found["convergence"]))
    missed = sum(int(row[-1]) for row in rows(found["convergence"]))
    assert missed == 0
    assert f"{studies} studies of [convergence]" in readme
    assert f"All {studies} studies meet the targets" in accuracy


def test_other_codes_in_the_text():
    """Linear systems, errors of slope and peak at small strain, where there are any."""
    cells: dict[str, list[str]] = {}
    for scene, code, _, solves, _, _, *errors, _ in rows(named_tables()["benchmark_others"]):
        if scene.endswith(", small"):
            shown = [f"{float(error.removesuffix(' %')):+.1f} %" for error in errors if error]
            said = ", ".join([solves, *shown]) if shown else "does not converge"
            cells.setdefault(code, []).append(said)
    assert len(cells) == 5
    for code, found in cells.items():
        assert f"| {code} | {' | '.join(found)} |" in text("demos/SPEED.md")


def test_precision_in_the_text():
    """Errors beside those of plain elements, on all meshes; those of springs at their worst."""
    with open(GALLERY / "benchmark_precision.csv") as file:
        runs = list(csv.DictReader(file))
    meshes: dict[tuple[str, ...], dict[str, dict[str, str]]] = {}
    for run in runs:
        meshes.setdefault((run["cell"], run["degree"], run["n"]), {})[run["method"]] = run
    pairs = [(methods["vmdg"], methods["plain"]) for methods in meshes.values()]
    assert len(pairs) == 28
    worst = {
        norm: max(abs(float(ours[norm]) / float(plain[norm]) - 1) for ours, plain in pairs)
        for norm in ("l2", "h1")
    }
    readme = text("README.md")
    said = f"{worst['l2']:.1%} (displacement) and {worst['h1']:.1%} (its gradient)"
    assert said.replace("%", " %") in readme
    springs = [
        float(methods["springs"]["l2"]) / float(methods["plain"]["l2"])
        for methods in meshes.values()
        if "springs" in methods
    ]
    accuracy = text("demos/ACCURACY.md")
    assert f"up to {max(springs):.0f} times that of the mesh" in accuracy


def test_push_out_in_the_text():
    """The run with the defaults of the demo is in every study."""
    found, accuracy = named_tables(), text("demos/ACCURACY.md")
    defaults = {
        "mesh": "cells x 1",
        "steps": "100 steps",
        "friction": "mu = 0.525",
        "modulus": "E_f / E_m = 0.625",
    }
    for study, label in defaults.items():
        (ran,) = (row for row in rows(found[f"pushout_{study}"]) if row[0] == label)
        largest, end = float(ran[4]), float(ran[6])
        assert f"| 412.2 | {largest:.1f} (+0.3 %) |" in accuracy
        assert f"| 105.5 | {end:.1f} (-0.3 %) |" in accuracy
        assert abs(largest / 412.2 - 1) < 0.0035
        assert abs(end / 105.5 - 1) < 0.0035


def test_delamination_in_the_text():
    """Largest deviations of the tests of each kind, from published values or beam theory."""
    table, accuracy = rows(named_tables()["delamination"]), text("demos/ACCURACY.md")

    def worst(cases: str, quantities: str, column: int) -> str:
        found = [
            abs(float(re.search(r"\(([-+\d.]+) %\)", row[column])[1]))
            for row in table
            if row[0] in cases.split() and re.match(quantities, row[1])
        ]
        assert found
        return f"{max(found):.1f} %"

    published, theory = 3, 4
    mixed = " ".join({row[0] for row in table if row[0].startswith("mmb")})
    beams = "dcb dcb-t300 turon turon-60 turon-26"
    assert f"stiffness within {worst(mixed, 'stiffness', theory)} of beam theory" in accuracy
    peak, rest = worst(beams, "peak", theory), worst(beams, "load at|crack at", theory)
    assert f"peak within {peak}, load and crack while it grows within {rest}" in accuracy
    assert f"loads within {worst('t300 d30', '.*: load', published)} of published" in accuracy
    ends = worst("4enf-nasa", ".*", theory)
    assert f"| 4ENF | within {ends} of beam theory |" in accuracy
    assert f"force within {worst('peel-90 peel-180', 'force', theory)} of the closed" in accuracy
    slope, growth = worst("fatigue", "slope", theory), worst("fatigue", "da/dN", theory)
    assert f"Paris line within {slope}, growth rate {growth} above" in accuracy


def test_plastic_bodies_in_the_text():
    """Largest deviations of every case, by what it is compared with."""
    table, accuracy = rows(named_tables()["plasticity"]), text("demos/ACCURACY.md")

    def worst(case: str, quantity: str, source: str) -> str:
        found = [
            abs(float(row[4].removesuffix(" %")))
            for row in table
            if re.match(case, row[0]) and re.match(quantity, row[1]) and re.match(source, row[5])
        ]
        assert found
        return f"{float(f'{max(found):.2g}'):g} %"

    assert f"within {worst('necking', '.*force', 'one body, same')} of one body" in accuracy
    assert f"within {worst('necking', '.*', 'one body, refined')} of a mesh" in accuracy
    assert f"within {worst('necking in 3D', '.*', 'axisymmetric')} of the section" in accuracy
    aster = worst("Cook's membrane$", ".*", "code_aster")
    reference = worst("Cook's membrane$", ".*", "its reference")
    assert f"{aster} of code_aster" in accuracy and f"{reference} of the values" in accuracy
    solid = worst(".* in 3D", ".*", "code_aster")
    assert f"16 x 16 hexahedra between smooth walls are {solid} below" in accuracy
    assert f"sphere {worst('sphere', 'error', 'one body')} above" in accuracy
    assert f"tube {worst('tube', 'error', 'one body')} below" in accuracy
    assert f"limit pressure within {worst('tube', 'limit', '.*')}" in accuracy
    traction, gap = worst("inclusion", "traction", ".*"), worst("inclusion", "opening", ".*")
    assert f"traction within {traction} and gap within {gap} of the closed form" in accuracy
    assert f"moment within {worst('plastic arms', '.*', '.*')} of the J integral" in accuracy
