"""Push-out of a fibre, section 7.4: cure shrinkage, debonding, the snap at the peak, and friction.

The matrix shrinks around the fibre, then a punch pushes the fibre's top down by 0.174 mm while a
plate with a hole supports the bottom of the matrix. After debonding, friction resists. The report
does not print its friction coefficient: 0.525 gives its largest and its final force, 412.2 and
105.5 N, within 0.3 %. The model is an axisymmetric section or, with ``--solid``, a quarter in 3D.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

import vmdg
from vmdg import meshes
from vmdg.meshes.pushout import (
    FIBRE,
    FIBRE_TOP,
    MATRIX,
    MATRIX_TOP,
    OUTER,
    SUPPORT,
    SYMMETRY_X,
    SYMMETRY_Y,
)

RADIUS = 0.95  # of the fibre, mm
E_MATRIX, NU_MATRIX, NU_FIBRE = 4000.0, 0.33, 0.35  # MPa
FIBRE_MODULUS, FRICTION = 2500.0, 0.525  # MPa, -
STRENGTH, CRITICAL_GAP, SHRINKAGE = 22.0, 0.011, 0.0022  # MPa, mm, -


@dataclass
class Model:
    """A push-out set up for the cure, in 3D or as a section.

    Attributes:
        problem: Its load factor is 0 to 1 in the cure, 1 + punch [mm] afterwards.
        axis: Component of the displacement along the fibre.
        share: How often the model is contained in the whole body.
        top: Facets under the punch.
        seen: Facets that pictures show, in 3D.
    """

    problem: vmdg.Problem
    axis: str
    share: int
    top: NDArray[np.int32]
    seen: NDArray[np.int32] | None

    def measures(self, problem: vmdg.Problem) -> dict[str, float]:
        """Punch, force, debonded and damaged length, by names with units; collective."""
        state = problem.state[0]
        gone = state.softening >= STRENGTH * (1 - 1e-9)
        areas = [state.weights[gone].sum(), state.weights[state.softening > 0].sum()]
        lengths = self.share * problem.comm.allreduce(np.array(areas)) / (2 * np.pi * RADIUS)
        force = -self.share * problem.reaction(self.top)["xyz".index(self.axis)]
        row = {"punch [mm]": problem.t - 1, "force [N]": force}
        return row | {"debonded [mm]": lengths[0], "damaged [mm]": lengths[1]}

    def show(self, axes: Sequence[Axes], title: str) -> None:
        """Draw the largest principal stress, and below it the mode of the law; collective."""
        for ax in axes:
            ax.clear()
        last = title == "end"
        style = {"magnify": 5, "limits": (-5, 25), "facets": self.seen, "edges": 0}
        vmdg.plot.stress(self.problem, "principal", ax=axes[0], colorbar=last, **style)
        vmdg.plot.mode_map(self.problem, 0, axis=self.axis, ax=axes[1])
        axes[0].set_title(f"{title}\n{self.problem.t - 1:.4f} mm\ndisplacement x 5", size=9)
        if self.seen is not None:
            axes[0].view_init(elev=25, azim=225)
            axes[0].set_axis_off()


def build(
    solid: bool,
    layers: int,
    refine: float,
    friction: float,
    fibre_modulus: float,
    kinematics: str = "finite",
) -> Model:
    """The model at the start of the cure; ``refine`` multiplies all counts of cells."""
    names = ("layers", "around", "fibre_rings", "hole_rings", "matrix_rings")
    numbers, make = (layers, 6, 4, 2, 31), meshes.pushout
    if not solid:
        names = ("layers", "fibre_cells", "hole_cells", "matrix_cells")
        numbers, make = (layers, 8, 1, 14), meshes.pushout_section
    counts = {name: max(round(refine * n), 1) for name, n in zip(names, numbers, strict=True)}
    if solid:
        counts["around"] *= 2
    mesh, cells, facets = make(**counts)
    bond = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP, friction=friction)
    fibre = vmdg.NeoHookean(E=fibre_modulus, nu=NU_FIBRE)
    matrix = vmdg.NeoHookean(E=E_MATRIX, nu=NU_MATRIX)
    problem = vmdg.Problem(
        mesh,
        cells,
        {FIBRE: fibre, MATRIX: matrix},
        [vmdg.Interface(between=(FIBRE, MATRIX), law=bond)],
        eigenstrain={MATRIX: lambda t: -SHRINKAGE * min(t, 1.0)},
        kinematics=kinematics,
        symmetry=None if solid else "axisymmetric",
    )
    axis, seen = "z" if solid else "y", None
    problem.dirichlet(facets.find(SUPPORT), 0.0, axis)
    if solid:
        problem.dirichlet(facets.find(SYMMETRY_X), 0.0, "x")
        problem.dirichlet(facets.find(SYMMETRY_Y), 0.0, "y")
        tags = (SYMMETRY_X, SYMMETRY_Y, FIBRE_TOP, MATRIX_TOP, OUTER)
        seen = np.concatenate([facets.find(tag) for tag in tags])
    return Model(problem, axis, 4 if solid else 1, facets.find(FIBRE_TOP), seen)


def draw(history: vmdg.History, axes: Sequence[Axes]) -> None:
    """Force and debonded length over the punch, and the force over the lengths."""
    punch, force, gone = (history[name] for name in ("punch", "force", "debonded"))
    axes[0].plot(np.r_[0, punch], np.r_[0, force])
    axes[1].plot(np.r_[0, punch], np.r_[0, gone])
    axes[2].plot(gone, force, label="bond gone")
    axes[2].plot(history["damaged"], force, "--", label="bond damaged")
    axes[0].set(xlabel="punch [mm]", ylabel="force [N]", xlim=0, ylim=0)
    axes[1].set(xlabel="punch [mm]", ylabel="debonded length [mm]", xlim=0)
    axes[2].set(xlabel="length [mm]", ylabel="force [N]", xlim=0, ylim=0)
    axes[2].legend()


def main(
    solid: bool = False,
    layers: int = 25,
    refine: float = 1.0,
    steps: int = 100,
    end: float = 0.174,
    friction: float = FRICTION,
    fibre_modulus: float = FIBRE_MODULUS,
    checkpoint_every: int = 25,
    resume: bool = False,
    plot: bool = True,
    out: str = "results/pushout",
) -> vmdg.History:
    """Cure the matrix and push the fibre; the history of the push."""
    model, folder = build(solid, layers, refine, friction, fibre_modulus), Path(out)
    problem = model.problem
    if plot:
        figure = plt.figure(figsize=(12, 10), layout="constrained")
        curves, states = figure.subfigures(2, 1, height_ratios=(1, 2))
        shape = {"projection": "3d"} if solid else {}
        panels = [
            (states.add_subplot(2, 4, i, **shape), states.add_subplot(2, 4, i + 4))
            for i in range(1, 5)
        ]

    # The cure. A run that is resumed has it from its checkpoint.
    checkpoint, cure = folder / "checkpoint", folder / "checkpoint_cure"
    if not resume:
        vmdg.discard_checkpoint(problem.comm, checkpoint)
        vmdg.discard_checkpoint(problem.comm, cure)
    if vmdg.read_checkpoint(problem, cure) is None:
        vmdg.solve(problem, np.linspace(0.25, 1, 4), vmdg.SolveOptions(relative_tolerance=1e-8))
        if checkpoint_every:
            vmdg.write_checkpoint(problem, cure)
    if plot:
        model.show(panels[0], "after the cure")

    # The punch grips the fibre as it is then.
    problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    history = vmdg.read_checkpoint(problem, checkpoint)
    most = {"force": 0.0, "damaged": 0.0}
    if history:
        most = {name: history[name].max() for name in most}

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        row = model.measures(problem)
        force, damaged = row["force [N]"], row["damaged [mm]"]
        if plot and damaged > 0 and most["damaged"] == 0:
            model.show(panels[1], "debonding starts")
        if plot and force > most["force"]:
            model.show(panels[2], "largest force")
        most.update(force=max(force, most["force"]), damaged=max(damaged, most["damaged"]))
        return row

    # A looser tolerance spares a sixth of the section's residuals, and nothing in 3D.
    shown = {"progress": True, "csv": folder / "history.csv"}
    saved = {"checkpoint": checkpoint, "checkpoint_every": checkpoint_every}
    saved = saved if checkpoint_every else {}
    options = vmdg.SolveOptions(relative_tolerance=1e-9 if solid else 1e-7, **shown, **saved)
    loads = 1 + np.linspace(0, end, steps + 1)[1:]
    loads = loads[loads > problem.t + 1e-12]
    history = vmdg.solve(problem, loads, options, monitor, history).history
    if plot:
        model.show(panels[3], "end")
        draw(history, curves.subplots(1, 3))
    if problem.comm.rank == 0:
        if plot:
            figure.savefig(folder / "pushout.png", dpi=110)
        print(f"largest force {history['force'].max():.5g} N, last {history['force'][-1]:.5g} N")
        print(f"results are in {folder}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--solid", action="store_true", help="a quarter in 3D, not the section")
    command.add_argument("--layers", type=int, default=25, help="cells along the fibre")
    command.add_argument("--refine", type=float, default=1.0, help="all numbers of cells [-]")
    command.add_argument("--steps", type=int, default=100, help="load steps of the punch")
    command.add_argument("--end", type=float, default=0.174, help="travel of the punch [mm]")
    command.add_argument("--friction", type=float, default=FRICTION, help="its coefficient [-]")
    command.add_argument("--fibre-modulus", type=float, default=FIBRE_MODULUS, help="E [MPa]")
    command.add_argument("--checkpoint-every", type=int, default=25, help="steps; 0 for none")
    command.add_argument("--resume", action="store_true", help="continue from the last checkpoint")
    command.add_argument("--no-plot", dest="plot", action="store_false", help="draw no picture")
    command.add_argument("--out", default="results/pushout", help="folder for the results")
    main(**vars(command.parse_args()))
