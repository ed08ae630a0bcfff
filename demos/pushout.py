"""Push-out of a fibre, section 7.4: cure shrinkage, debonding, the snap at the peak, and friction.

The matrix shrinks around the fibre, then a punch pushes the fibre's top down by 0.174 mm while a
plate with a hole supports the bottom of the matrix. After debonding, friction resists. The report
does not print its friction coefficient: 0.525 gives its largest and its final force, 412.2 and
105.5 N, within 0.3 %. The model is an axisymmetric section or, with ``--solid``, a quarter in 3D.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg import meshes

RADIUS, HEIGHT = 0.95, 5.36  # of the fibre, mm
E_MATRIX, NU_MATRIX, NU_FIBRE = 4000.0, 0.33, 0.35  # MPa
FIBRE_MODULUS, FRICTION = 2500.0, 0.525  # MPa, -
STRENGTH, CRITICAL_GAP, SHRINKAGE = 22.0, 0.011, 0.0022  # MPa, mm, -
LAW = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP, friction=FRICTION)


class Model(NamedTuple):
    """A push-out at the start of the cure, in 3D or as a section.

    Attributes:
        problem: The problem; its load factor is 0 to 1 in the cure, 1 + punch [mm] afterwards.
        axis: Component of the displacement along the fibre.
        share: How often the model is contained in the whole body.
        top: Facets under the punch.
    """

    problem: vmdg.Problem
    axis: str
    share: int
    top: np.ndarray

    def measures(self, problem: vmdg.Problem) -> dict[str, float]:
        """Punch, force, debonded and damaged length, by names with units; collective."""
        state, strength = problem.state[0], problem.interfaces[0].law.strength
        areas = [state.weights[state.softening > q].sum() for q in (strength * (1 - 1e-9), 0.0)]
        lengths = self.share * problem.comm.allreduce(np.array(areas)) / (2 * np.pi * RADIUS)
        force = -self.share * problem.reaction(self.top)["xyz".index(self.axis)]
        names = "punch [mm]", "force [N]", "debonded [mm]", "damaged [mm]"
        return dict(zip(names, (problem.t - 1, force, *lengths), strict=True))


def build(
    solid: bool, layers: int, refine: float, law: vmdg.Law, modulus: float, small: bool = False
) -> Model:
    """The model at the start of the cure.

    Args:
        solid: Whether it is a quarter in 3D.
        layers: Number of cells along the fibre.
        refine: Factor on all counts of cells [-].
        law: Of the bond.
        modulus: Young's modulus of the fibre [MPa].
        small: Whether to assume small strains.
    """
    counts = {"fibre_cells": 8, "hole_cells": 1, "matrix_cells": 14}
    if solid:
        counts = {"fibre_rings": 4, "hole_rings": 2, "matrix_rings": 31, "around": 6}
    counts = {name: max(round(refine * n), 1) for name, n in {"layers": layers, **counts}.items()}
    if solid:
        counts["around"] *= 2
    mesh, cells, sides = (meshes.pushout if solid else meshes.pushout_section)(**counts)
    bond = vmdg.Interface(between=("fibre", "matrix"), law=law, name="bond")
    fibre = vmdg.NeoHookean(E=modulus, nu=NU_FIBRE)
    bodies = {"fibre": fibre, "matrix": vmdg.NeoHookean(E=E_MATRIX, nu=NU_MATRIX)}
    cure = {"matrix": lambda t: -SHRINKAGE * min(t, 1.0)}
    axis, symmetry = ("z", None) if solid else ("y", "axisymmetric")
    kinds = {"kinematics": "small" if small else "finite", "symmetry": symmetry}
    problem = vmdg.Problem(mesh, cells, bodies, [bond], eigenstrain=cure, **kinds)
    problem.dirichlet(sides.find("support"), 0.0, axis)
    for direction in "xy" if solid else "":
        problem.dirichlet(sides.find(f"symmetry {direction}"), 0.0, direction)
    return Model(problem, axis, 4 if solid else 1, sides.find("fibre top"))


def push(
    model: Model, folder: Path, steps: int, end: float, resume: bool, monitor: Callable
) -> vmdg.History:
    """Cure the matrix and push the fibre, or continue from checkpoints; the history of the push."""
    problem, checkpoint, cure = model.problem, folder / "checkpoint", folder / "checkpoint_cure"
    for old in () if resume else (checkpoint, cure):
        vmdg.discard_checkpoint(problem.comm, old)
    if vmdg.read_checkpoint(problem, cure) is None:
        vmdg.solve(problem, np.linspace(0.25, 1, 4))
        vmdg.write_checkpoint(problem, cure)
    # The punch displaces the top of the fibre as it is after the cure.
    problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    history = vmdg.read_checkpoint(problem, checkpoint)
    loads = 1 + np.linspace(0, end, steps + 1)[1:]
    saved = {"checkpoint": checkpoint, "checkpoint_every": 25, "csv": folder / "history.csv"}
    options = vmdg.SolveOptions(progress=True, **saved)
    return vmdg.solve(problem, loads[loads > problem.t + 1e-12], options, monitor, history).history


def main(
    solid: bool = False,
    refine: float = 1.0,
    steps: int = 100,
    end: float = 0.174,
    resume: bool = False,
    out: str = "results/pushout",
) -> vmdg.History:
    """Cure the matrix and push the fibre; the history of the push."""
    model = build(solid, 25, refine, LAW, FIBRE_MODULUS)
    figure, axes = plt.subplots(2, 2, figsize=(9, 7.4), layout="constrained")
    force, length, stress, modes = axes.ravel()

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        row = model.measures(problem)
        if row["debonded [mm]"] > HEIGHT / 2 and not stress.get_title():
            vmdg.plot.stress(problem, "principal", 5, stress, (-5, 25))
            vmdg.plot.mode_map(problem, 0, axis=model.axis, ax=modes)
            stress.set_title(f"punch {row['punch [mm]']:.4f} mm")
        return row

    history = push(model, Path(out), steps, end, resume, monitor)
    vmdg.plot.curve(history, "punch", "force", force, origin=True)
    vmdg.plot.curve(history, "punch", "debonded", length, origin=True)
    if model.problem.comm.rank == 0:
        figure.savefig(Path(out) / "pushout.png")
        print(f"largest force {history['force'].max():.5g} N, last {history['force'][-1]:.5g} N")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--solid", action="store_true", help="a quarter in 3D, not the section")
    command.add_argument("--refine", type=float, default=1.0, help="factor on counts of cells [-]")
    command.add_argument("--steps", type=int, default=100, help="load steps of the punch")
    command.add_argument("--end", type=float, default=0.174, help="travel of the punch [mm]")
    command.add_argument("--resume", action="store_true", help="continue from the last checkpoint")
    command.add_argument("--out", default="results/pushout", help="folder for the results")
    main(**vars(command.parse_args()))
