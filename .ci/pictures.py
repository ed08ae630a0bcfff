"""Makes the pictures and tables of the pages again with the present code.

    demos/run .ci/pictures.py             all of them, an hour or more on one core
    demos/run .ci/pictures.py NAME...     those of some commands, "list" names them

Every command runs in a process of its own in results/pictures/NAME, next to its log; what it makes
for the pages is copied to demos/gallery. A table becomes a page of its own, which says what was
computed, by which command and version, on which machine and when.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
from datetime import date
from pathlib import Path
from time import perf_counter

import dolfinx

import vmdg

ROOT = Path(__file__).resolve().parent.parent
GALLERY, OUT = ROOT / "demos" / "gallery", ROOT / "results" / "pictures"

_FINE = "fibre_matrix --element-size 0.05 --critical-gap 0.01"
_MANY = f"{_FINE} --fibres 5 --cell triangle --activate on-demand"
_ENVELOPE = (
    "fibre_cell_strengths --fibres 12 --cells 2 --directions 7 --seeds 2 --end 0.018 --steps 6"
)

#: By name a command and what it makes, each with its name in the gallery where that is another.
COMMANDS = {
    "laws": (".ci/laws.py OUT", "law_*.png"),
    "unloading": (".ci/unloading.py OUT/unloading.png", "unloading.png"),
    "weak_links": ("weak_links", "weak_links.png"),
    "measured_images": ("measured_images", "measured_images.png"),
    "adhesive": ("adhesive", "adhesive.png"),
    "bridged_dcb": ("bridged_dcb", "bridged_dcb.png bridged_dcb.md"),
    "lap_joint": ("lap_joint", "lap_joint.png"),
    "push_through": ("push_through", "push_through.png"),
    "ironing": ("ironing", "ironing.png"),
    "shrink_fit": ("shrink_fit", "shrink_fit.png"),
    "patch_tension": ("patch_tension", "patch_tension.png"),
    "patch_shear": ("patch_shear", "patch_shear.png"),
    "load_cycle": ("load_cycle", "load_cycle.png"),
    "two_inclusions": ("two_inclusions", "two_inclusions.png"),
    "tutorial": ("tutorial", "tutorial.png"),
    "tutorial_law": ("tutorial_law", "tutorial_law.png"),
    "tutorial_material": ("tutorial_material", "tutorial_material.png"),
    "tutorial_laminate": ("tutorial_laminate", "tutorial_laminate.png"),
    "tutorial_dcb": ("tutorial_dcb", "tutorial_dcb.png"),
    "tutorial_film": ("tutorial_film", "tutorial_film.png"),
    "tutorial_friction": ("tutorial_friction", "tutorial_friction.png"),
    "buckling": ("buckling", "buckling.png"),
    "fibre_matrix": (f"{_FINE} --animate", "fibre_matrix.png fibre_matrix.gif"),
    "ductile_matrix": ("ductile_matrix", "ductile_matrix.png"),
    "spall": ("spall", "spall.png"),
    "crack_speed": ("crack_speed", "crack_speed.png crack_speed.gif"),
    "fault": ("fault", "fault.png fault.gif"),
    "impact": ("impact", "impact.png impact.gif"),
    "in_time": ("in_time", "in_time.png in_time.md"),
    "creep_joint": ("creep_joint", "creep_joint.png"),
    "ductile_grains": ("ductile_grains", "ductile_grains.png"),
    "plastic_peel": ("plastic_peel", "plastic_peel.png"),
    "plasticity": ("plasticity", "plasticity.png plasticity.md"),
    "fibres_many": (_MANY, "fibre_matrix.png=fibres_many.png"),
    "fibre_cell": ("fibre_cell --cells 4", "fibre_cell.png"),
    "envelope": (_ENVELOPE, "envelope.png=fibre_cell_envelope.png"),
    "polycrystal": ("polycrystal", "polycrystal.png"),
    "polycrystal_solid": (
        "polycrystal --solid --grains 6 --seed 1 --cells 4 --end 0.006",
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
    "pushout_solid": ("pushout --solid --refine 0.7", "pushout.png=pushout_solid.png"),
    "tearing": ("tearing", "tearing_neo-hookean.png"),
    "tearing_ogden": ("tearing --material ogden", "tearing_ogden.png"),
    "tearing_sheet": ("tearing_sheet", "tearing_sheet.png"),
    "adaptive": ("adaptive dcb", "adaptive.png"),
    "indicator": ("indicator DCB", "indicator.png"),
    "verification": ("verification", "verification.png verification.md"),
    "delamination": (
        "delamination",
        "mmb-80.png=delamination.png d30.png=delamination_d30.png "
        "fatigue.png=delamination_fatigue.png overview.png=delamination_all.png delamination.md",
    ),
    "stability": ("stability", "stability.md stability.csv"),
    "precision": (
        "benchmark precision",
        "precision.png=benchmark_precision.png precision.csv=benchmark_precision.csv "
        "precision.md=benchmark_precision.md",
    ),
    "ratio": ("benchmark ratio", "ratio.md=benchmark_ratio.md"),
    "others": ("others", "others.md=benchmark_others.md"),
    "convergence": ("convergence", "convergence.png convergence.md convergence.csv"),
}

#: Title of every table that becomes a page, and what is computed.
TABLES = {
    "bridged_dcb.md": (
        "A published curve of a double cantilever beam",
        "Load over opening of de Gracia, Boyano, Arrese and Mujika (2015), fitted by linear "
        "softening and by a law with fibre bridges. The residual is the standard deviation of "
        "load that the fit leaves.",
    ),
    "convergence.md": (
        "Rates of convergence",
        "Two bodies tied along an interface, at finite strain, with exact solutions: least rate of "
        "all studies of a cell type and degree, then every study. u and GRAD u in L2 of the "
        "bodies, T in L2 of the interface.",
    ),
    "verification.md": (
        "Closed forms",
        "Scenes with closed-form solutions, with default options. Of a field the largest deviation "
        "is shown, relative to the largest value.",
    ),
    "plasticity.md": (
        "Plastic bodies",
        "Bodies of J2 plasticity with interfaces, with default options, against one body on the "
        "same mesh, closed forms and published values.",
    ),
    "in_time.md": (
        "Motion in time",
        "A bar that parts in its middle and beats for 50 periods: energy relative to that at the "
        "start, and change of T in a step while the bond begins to fail, relative to its strength.",
    ),
    "delamination.md": (
        "Delamination tests",
        "Tests of the literature against published values and corrected beam theory, with default "
        "options.",
    ),
    "stability.md": (
        "Random stress runs",
        "Runs far from ordinary problems, drawn at random, by family: how they ended, and the "
        "steps, cut attempts and residuals that they took.",
    ),
    "pushout_mesh.md": ("Push-out: mesh", "Section 7.4 of the report on four meshes."),
    "pushout_steps.md": ("Push-out: steps", "Section 7.4 of the report with four step sizes."),
    "pushout_friction.md": (
        "Push-out: friction",
        "Section 7.4 of the report with three coefficients of friction.",
    ),
    "pushout_modulus.md": (
        "Push-out: moduli",
        "Section 7.4 of the report with three ratios of the moduli of fibre and matrix.",
    ),
    "benchmark_precision.md": (
        "Errors and seconds of ties",
        "A kinked solution in two bodies, moduli 10 : 1, that are continuous, tied by vmdg or by "
        "intrinsic springs: unknowns, errors in L2 of u and GRAD u, and processor time of a "
        "solution from rest and from the interpolated exact one.",
    ),
    "benchmark_ratio.md": (
        "Cost of a Newton iteration",
        "One Newton iteration of plain finite elements / of vmdg on the same mesh, neo-Hookean, "
        "the interface through the middle: tied, or with every point damaged or sliding with "
        "friction, which makes the tangent unsymmetric: direct solvers take LU, for plain elements "
        "LDL^T. Processor time on one core, the least of several runs that take turns. To rebuilt: "
        "against plain elements whose multigrid interpolation is rebuilt in every iteration, as "
        "PETSc does by default. Active: the share of points that are damaged or slide. A step "
        "more: what a step costs in addition, however many iterations it takes.",
    ),
    "benchmark_others.md": (
        "vmdg, fedoo and Akantu",
        "P1, a plate cracked over a quarter of its width (4,900 unknowns, 40 steps), and P2, two "
        "cubes (7,986 unknowns, 20 steps), on the same meshes in the same equal load steps by "
        "fedoo 1.1.0 and Akantu 5.0.7, one after the other: processor time of the steps on one "
        "core in a warm process, linear systems, largest force, and errors of the slope (of a "
        "step so small that nothing fails, against bonded plain elements), of the largest "
        "force (against ten times as many steps) and of the work. Intrinsic elements reach the "
        "strength at 1e-4 mm, half a percent of the critical gap.",
    ),
}


def page(table: str, command: str, text: str, busy: float) -> str:
    """A table as a page that says how it was made.

    Args:
        table: Key of ``TABLES``.
        command: Of ``COMMANDS``.
        text: What the command has written.
        busy: Processes that ran on the machine before it began, on average.
    """
    title, what = TABLES[table]
    versions = f"vmdg {vmdg.__version__}, DOLFINx {dolfinx.__version__}"
    said = {
        "Command": f"`demos/run {command}`",
        "Version": f"{versions}, Python {platform.python_version()}",
        "Machine": f"{_processor()}, {os.cpu_count()} cores, {busy:.1f} other processes running",
        "Date": date.today().isoformat(),
    }
    lines = "\n".join(f"- {name}: {value}" for name, value in said.items())
    return f"# {title}\n\n{what}\n\n{lines}\n\n{text}"


def _processor() -> str:
    """What Linux calls the processor."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((x.partition(": ")[2] for x in lines if x.startswith("model name")), "unknown")


def make(name: str) -> bool:
    """Run a command and copy what it has made; whether it has done so."""
    command, made = COMMANDS[name]
    folder, start, (busy, _, _) = OUT / name, perf_counter(), os.getloadavg()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    script, *options = command.replace("OUT", str(folder)).split()
    if not script.startswith("."):
        example = ROOT / "demos" / f"{script}.py"
        script = example if example.is_file() else example.parent / "studies" / example.name
        options += ["--out", str(folder)]
    style = {"MATPLOTLIBRC": str(ROOT / "vmdg" / "plot" / "paper.mplstyle")}
    with open(folder / "log", "w") as log:
        run = [sys.executable, str(ROOT / script), *options]
        kept = {"stdout": log, "stderr": log, "env": os.environ | style}
        done = subprocess.run(run, check=False, **kept).returncode == 0
    for each in made.split() if done else ():
        source, _, target = each.partition("=")
        for file in folder.glob(source):
            place = GALLERY / (target or file.name)
            if place.name in TABLES:
                place.write_text(page(place.name, command, file.read_text(), busy))
            else:
                shutil.copy(file, place)
    said = "made" if done else f"FAILED, see {folder}/log"
    print(f"{name}: {said}, {perf_counter() - start:.0f} s", flush=True)
    return done


def in_gallery(made: str) -> list[str]:
    """Names or patterns in the gallery of what a command makes."""
    return [each.partition("=")[2] or each for each in made.split()]


def main(names: list[str]) -> None:
    """The command line."""
    if names == ["list"]:
        print("\n".join(f"{name}: {command}" for name, (command, _) in COMMANDS.items()))
        return
    asked = names or list(COMMANDS)
    if unknown := set(asked) - set(COMMANDS):
        raise SystemExit(f"no command is called {', '.join(unknown)}; list names them")
    failed = [name for name in asked if not make(name)]
    if failed:
        raise SystemExit(f"not made: {', '.join(failed)}")


if __name__ == "__main__":
    main(sys.argv[1:])
