"""Makes the pictures and tables of the pages anew by the present code.

    demos/run .ci/pictures.py             all of them, an hour or more on one core
    demos/run .ci/pictures.py NAME...     those of some commands, "list" names them
    demos/run .ci/pictures.py pages       only put the tables of demos/gallery into the pages

Every command runs in a process of its own in results/pictures/NAME, its log beside; what it makes
for the pages is copied to demos/gallery. A table of demos/gallery stands in the pages wherever one
with the same first line does, so that no number is written twice by hand.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from time import perf_counter

ROOT = Path(__file__).resolve().parent.parent
GALLERY, OUT = ROOT / "demos" / "gallery", ROOT / "results" / "pictures"
PAGES = [ROOT / "README.md", ROOT / "demos" / "ACCURACY.md"]

_FINE = "fibre_matrix --element-size .05 --critical-gap .01"
_MANY = f"{_FINE} --fibres 5 --cell triangle --activate on-demand"
_ENVELOPE = (
    "fibre_cell_strengths --fibres 12 --cells 2 --directions 7 --seeds 2 --end .018 --steps 6"
)

#: By name a command and what it makes, each with its name in the gallery where that is another.
COMMANDS = {
    "laws": (".ci/laws.py OUT", "law_*.png"),
    "unloading": (".ci/unloading.py OUT/unloading.png", "unloading.png"),
    "weak_links": ("weak_links", "weak_links.png"),
    "patch_tension": ("patch_tension", "patch_tension.png"),
    "patch_shear": ("patch_shear", "patch_shear.png"),
    "load_cycle": ("load_cycle", "load_cycle.png"),
    "two_inclusions": ("two_inclusions", "two_inclusions.png"),
    "tutorial": ("tutorial", "tutorial.png"),
    "tutorial_law": ("tutorial_law", "tutorial_law.png"),
    "tutorial_material": ("tutorial_material", "tutorial_material.png"),
    "tutorial_laminate": ("tutorial_laminate", "tutorial_laminate.png"),
    "buckling": ("buckling", "buckling.png"),
    "fibre_matrix": ("fibre_matrix", "fibre_matrix.png"),
    "film": (f"{_FINE} --growth 1.04 --animate", "fibre_matrix.gif"),
    "fibres_many": (_MANY, "fibre_matrix.png=fibres_many.png"),
    "fibre_cell": ("fibre_cell", "fibre_cell.png"),
    "envelope": (_ENVELOPE, "envelope.png=fibre_cell_envelope.png"),
    "polycrystal": ("polycrystal", "polycrystal.png"),
    "polycrystal_solid": (
        "polycrystal --solid --grains 6 --seed 1 --cells 2 --end .01",
        "polycrystal.png=polycrystal_solid.png",
    ),
    "pushout": ("pushout", "pushout.png"),
    "pushout_report": ("pushout_parameters", "pushout_report.png"),
    "pushout_friction": (
        "pushout_parameters --study friction",
        "pushout_friction.png pushout_friction.md",
    ),
    "pushout_modulus": ("pushout_parameters --study modulus", "pushout_modulus.md"),
    "pushout_mesh": ("pushout_parameters --study mesh", "pushout_mesh.png pushout_mesh.md"),
    "pushout_steps": ("pushout_parameters --study steps", "pushout_steps.md"),
    "pushout_solid": ("pushout --solid", "pushout.png=pushout_solid.png"),
    "tearing": ("tearing", "tearing_neo-hookean.png"),
    "tearing_ogden": ("tearing --material ogden", "tearing_ogden.png"),
    "verification": ("verification", "verification.png verification.md"),
    "delamination": (
        "delamination",
        "mmb-80.png=delamination.png d30.png=delamination_d30.png "
        "fatigue.png=delamination_fatigue.png overview.png=delamination_all.png delamination.md",
    ),
    "stability": ("stability", "stability.png stability.md stability.csv"),
    "precision": (
        "benchmark precision",
        "precision.png=benchmark_precision.png precision.csv=benchmark_precision.csv",
    ),
    "tearing_meshes": ("tearing_meshes", "tearing_meshes_neo-hookean.png=tearing_meshes.png"),
    "convergence": ("convergence", "convergence.png convergence.md convergence.csv"),
}


def make(name: str) -> bool:
    """Run a command and copy what it has made; whether it has done so."""
    command, made = COMMANDS[name]
    folder, start = OUT / name, perf_counter()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    script, *options = command.replace("OUT", str(folder)).split()
    if not script.startswith("."):
        example = ROOT / "demos" / f"{script}.py"
        script = example if example.is_file() else example.parent / "studies" / example.name
        options += ["--out", str(folder)]
    with open(folder / "log", "w") as log:
        run = [sys.executable, str(ROOT / script), *options]
        done = subprocess.run(run, stdout=log, stderr=log, check=False).returncode == 0
    for each in made.split() if done else ():
        source, _, target = each.partition("=")
        for file in folder.glob(source):
            shutil.copy(file, GALLERY / (target or file.name))
    said = "made" if done else f"FAILED, see {folder}/log"
    print(f"{name}: {said}, {perf_counter() - start:.0f} s", flush=True)
    return done


def in_gallery(made: str) -> list[str]:
    """Names or patterns in the gallery of what a command makes."""
    return [each.partition("=")[2] or each for each in made.split()]


_TABLE = re.compile(r"^\|.*\n(?:\|.*\n?)+", re.MULTILINE)


def tables() -> dict[str, str]:
    """Tables of the gallery by their first lines."""
    texts = (file.read_text() for file in sorted(GALLERY.glob("*.md")))
    found = [table.strip() for text in texts for table in _TABLE.findall(text)]
    return {table.partition("\n")[0]: table for table in found}


def renewed(page: str) -> str:
    """The text of a page with the tables of the gallery as they are now."""
    known = tables()

    def current(match: re.Match[str]) -> str:
        table = match[0].strip()
        return match[0].replace(table, known.get(table.partition("\n")[0], table))

    return _TABLE.sub(current, page)


def main(names: list[str]) -> None:
    """The command line."""
    if names == ["list"]:
        print("\n".join(f"{name}: {command}" for name, (command, _) in COMMANDS.items()))
        return
    asked = [] if names == ["pages"] else names or list(COMMANDS)
    if unknown := set(asked) - set(COMMANDS):
        raise SystemExit(f"no command is called {', '.join(unknown)}; list names them")
    failed = [name for name in asked if not make(name)]
    for page in PAGES:
        page.write_text(renewed(page.read_text()))
    if failed:
        raise SystemExit(f"not made: {', '.join(failed)}")


if __name__ == "__main__":
    main(sys.argv[1:])
