"""Push-out of a fibre, section 7.4: cure shrinkage, debonding, the snap at the peak, and friction.

The matrix shrinks around the fibre, then a punch pushes the fibre's top down by .174 mm while the
bottom of the matrix rests on a plate with a hole. Friction holds the fibre after the bond is gone.
The report does not print its friction coefficient: .475 gives its final force, 105.5 N, in the
shear-lag estimate. Drawn and computed in 3D (a quarter) or as an axisymmetric section.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import numpy as np
from _pushout import E_MATRIX, Levels, build, curves
from _restart import add_options, files, resumed

import vmdg

FIBRE_MODULUS, FRICTION, END = 2500.0, 0.475, 0.174  # MPa, -, mm
STUDIES = {"modulus": (0.625, 2.5, 6.0), "friction": (0.3, 0.475, 0.6)}


def main(
    solid: bool = False,
    layers: int = 25,
    refine: float = 1,
    steps: int = 100,
    end: float = END,
    friction: float = FRICTION,
    fibre_modulus: float = FIBRE_MODULUS,
    checkpoint_every: int = 25,
    resume: bool = False,
    picture: bool = True,
    out: str = "results/pushout",
) -> vmdg.History:
    """Push the fibre by ``end`` [mm]; pictures, history and checkpoints go to ``out``."""
    model, folder = build(solid, layers, refine, friction, fibre_modulus), Path(out)
    problem, rank = model.problem, MPI.COMM_WORLD.rank
    checkpoint, cure = folder / "checkpoint", folder / "checkpoint_cure"
    if resumed(problem, resume, cure, checkpoint) is None:
        vmdg.solve(problem, np.linspace(0.25, 1, 4), vmdg.SolveOptions(relative_tolerance=1e-8))
        if checkpoint_every:
            vmdg.write_checkpoint(problem, cure)
    levels = Levels(model) if picture else None
    problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    history = vmdg.read_checkpoint(problem, checkpoint)
    if picture and history:
        levels.skip(history)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        measured = model.measures(problem)
        if picture:
            levels.update(measured["force"], measured["damaged"])
        return measured

    loads = 1 + np.linspace(0, end, steps + 1)[1:]
    options = vmdg.SolveOptions(1e-7, progress=True, **files(checkpoint, checkpoint_every))
    loads = loads[loads > problem.t + 1e-12]
    history = vmdg.solve(problem, loads, options, monitor, history).history
    figure = levels.draw() if picture else None
    if rank == 0:
        report(history)
        history.to_csv(folder / "history.csv")
        if picture:
            figure.savefig(folder / "pushout_levels.png", dpi=110)
            name = "3D" if solid else "axisymmetric"
            drawn = curves({name: history}, friction, fibre_modulus)
            drawn.savefig(folder / "pushout.png", dpi=130)
            print(f"pictures and history are in {folder}")
    return history


def report(history: vmdg.History) -> None:
    """Print the numbers of section 7.4."""
    punch, force = history["punch"], history["force"]
    peak, start = np.argmax(force), np.argmax(history["damaged"] > 0)
    print(f"slope {force[0] / punch[0]:.0f} N/mm, first damage {force[start]:.1f} N")
    print(f"peak {force[peak]:.1f} N at {punch[peak]:.4f} mm, end {force[-1]:.1f} N")
    iterations, jumps = history["iterations"], history["jump_steps"]
    print(
        f"{len(history)} steps, {iterations.mean():.2f} iterations a step, {jumps.sum()} in jumps"
    )


def study(name: str, out: str, **options: float | bool) -> dict[str, vmdg.History]:
    """Figure 30 (E_f / E_m) or 31 (friction): one run a value, one picture."""
    runs = {}
    for value in STUDIES[name]:
        given = {"friction": value} if name == "friction" else {"fibre_modulus": value * E_MATRIX}
        label = f"mu = {value}" if name == "friction" else f"E_f / E_m = {value}"
        print(label)
        folder = f"{out}/{name}_{value}"
        runs[label] = main(**{**options, **given, "out": folder, "picture": False})
    if MPI.COMM_WORLD.rank == 0:
        figure = curves(runs, FRICTION, FIBRE_MODULUS)
        figure.savefig(Path(out) / f"pushout_{name}.png", dpi=130)
    return runs


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--solid", action="store_true", help="a quarter in 3D, not the section")
    parser.add_argument("--layers", type=int, default=25, help="cells along the fibre (25)")
    parser.add_argument(
        "--refine", type=float, default=1, help="multiplies all counts of cells (1)"
    )
    parser.add_argument("--steps", type=int, default=100, help="load steps of the punch (100)")
    parser.add_argument("--end", type=float, default=END, help="travel of the punch [mm] (.174)")
    parser.add_argument("--friction", type=float, default=FRICTION, help="coefficient (.475)")
    parser.add_argument("--fibre-modulus", type=float, default=FIBRE_MODULUS, help="[MPa] (2500)")
    parser.add_argument("--study", choices=STUDIES, help="several runs: Figures 30 and 31")
    add_options(parser, every=25)
    parser.add_argument("--out", default="results/pushout", help="folder for the results")
    arguments = vars(parser.parse_args())
    chosen = arguments.pop("study")
    study(chosen, **arguments) if chosen else main(**arguments)
