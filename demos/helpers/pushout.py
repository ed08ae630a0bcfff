"""Models, measures and pictures of the fibre push-out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import vmdg
from helpers.tables import markdown
from vmdg.meshes import pushout, pushout_section
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
from vmdg.plot import cell_means, deformed_corners, draw_cells, mode_map

RADIUS, OUTER_RADIUS, HEIGHT = 0.95, 4.3, 5.36  # mm
E_MATRIX, NU_MATRIX, NU_FIBRE = 4000.0, 0.33, 0.35  # MPa
FIBRE_MODULUS, FRICTION = 2500.0, 0.525  # MPa, -
STRENGTH, CRITICAL_GAP, SHRINKAGE = 22.0, 0.011, 0.0022  # MPa, mm
MAGNIFY = 5  # of the displacement in pictures
# Figures 30 and 31, and what the numbers owe to the mesh and to the steps: argument, label, values.
STUDIES = {
    "modulus": ("fibre_modulus", "E_f / E_m = {:g}", (0.625, 2.5, 6.0)),
    "friction": ("friction", "mu = {:g}", (0.3, 0.525, 0.6)),
    "mesh": ("refine", "cells x {:g}", (0.5, 1.0, 2.0, 4.0)),
    "steps": ("steps", "{:d} steps", (50, 100, 200, 400)),
}


@dataclass
class Model:
    """A push-out set up for the cure, in 3D or as a section.

    Attributes:
        problem: The problem; its load factor is 0 to 1 in the cure, 1 + punch [mm] afterwards.
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
        return {
            "punch [mm]": problem.t - 1,
            "force [N]": force,
            "debonded [mm]": lengths[0],
            "damaged [mm]": lengths[1],
        }


def build(
    solid: bool,
    layers: int,
    refine: float,
    friction: float,
    fibre_modulus: float,
    kinematics: str = "finite",
) -> Model:
    """The model at the start of the cure; ``refine`` multiplies all counts of cells."""

    def count(cells: int) -> int:
        return max(round(refine * cells), 1)

    if solid:
        mesh, cells, facets = pushout(
            layers=count(layers),
            around=2 * count(6),
            fibre_rings=count(4),
            hole_rings=count(2),
            matrix_rings=count(31),
        )
    else:
        mesh, cells, facets = pushout_section(
            layers=count(layers), fibre_cells=count(8), hole_cells=count(1), matrix_cells=count(14)
        )
    bond = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP, friction=friction)
    problem = vmdg.Problem(
        mesh,
        cells,
        {
            FIBRE: vmdg.NeoHookean(E=fibre_modulus, nu=NU_FIBRE),
            MATRIX: vmdg.NeoHookean(E=E_MATRIX, nu=NU_MATRIX),
        },
        [vmdg.Interface(between=(FIBRE, MATRIX), law=bond)],
        eigenstrain={MATRIX: lambda t: -SHRINKAGE * min(t, 1.0)},
        kinematics=kinematics,
        symmetry=None if solid else "axisymmetric",
    )
    axis = "z" if solid else "y"
    problem.dirichlet(facets.find(SUPPORT), 0.0, axis)
    seen = None
    if solid:
        problem.dirichlet(facets.find(SYMMETRY_X), 0.0, "x")
        problem.dirichlet(facets.find(SYMMETRY_Y), 0.0, "y")
        tags = (SYMMETRY_X, SYMMETRY_Y, FIBRE_TOP, MATRIX_TOP, OUTER)
        seen = np.concatenate([facets.find(tag) for tag in tags])
    return Model(problem, axis, 4 if solid else 1, facets.find(FIBRE_TOP), seen)


def ring_pressure(fibre_modulus: float) -> tuple[float, float]:
    """p0 [MPa] and k [-]: p = p0 + k sigma on a fibre with stress sigma (Lame, plane stress)."""
    a2, b2 = RADIUS**2, OUTER_RADIUS**2
    compliance = ((b2 + a2) / (b2 - a2) + NU_MATRIX) / E_MATRIX + (1 - NU_FIBRE) / fibre_modulus
    return SHRINKAGE / compliance, NU_FIBRE / fibre_modulus / compliance


def shear_lag(
    length: NDArray | float,
    friction: float,
    fibre_modulus: float,
    energy: float = STRENGTH * CRITICAL_GAP / 2,
) -> NDArray | float:
    """Force [N] at which the bond is gone over ``length`` [mm] from the loaded end.

    F = pi a^2 [sigma_d e^(lambda l) + p0/k (e^(lambda l) - 1)], the one-dimensional estimate of
    Alfano and Sacco and of Lin, Geubelle and Sottos: p0 the pressure after the cure, k the rise of
    the pressure with the stress in the fibre, sigma_d = 2 sqrt(E_f G / a) with G the work of the
    bond [N/mm], 0 for friction alone. Near its ends the fibre is no bar: lengths differ by up to
    1.5 a.
    """
    p0, k = ring_pressure(fibre_modulus)
    sigma = 2 * np.sqrt(fibre_modulus * energy / RADIUS)
    grown = np.exp(2 * friction * k / RADIUS * length)
    return np.pi * RADIUS**2 * (sigma * grown + p0 / k * (grown - 1))


class Levels:
    """Keeps the states of Figures 25 to 27: after the cure, at initiation, peak and end.

    Args:
        model: The model after the cure.
    """

    NAMES = ("after the cure", "debonding starts", "largest force", "end")
    ROWS = (
        (r"$\sigma_{rz}$ [MPa]", "coolwarm", (-22, 22)),
        (r"$\sigma_1$ [MPa]", "viridis", (-5, 25)),
    )

    def __init__(self, model: Model):
        self._model = model
        self._kept = {self.NAMES[0]: (model.problem.step.snapshot(), 0.0)}
        self._peak, self._damaged = -np.inf, False

    def skip(self, history: vmdg.History) -> None:
        """Leave out what a run that is resumed has passed already."""
        self._peak = history["force"].max()
        self._damaged = history["damaged"].max() > 0

    def update(self, force: float, damaged: float) -> None:
        """Keep the current state where it is one of the four."""
        state = self._model.problem.step.snapshot(), force
        if damaged > 0 and not self._damaged:
            self._damaged = True
            self._kept[self.NAMES[1]] = state
        if force > self._peak:
            self._peak = force
            self._kept[self.NAMES[2]] = state
        self._kept[self.NAMES[3]] = state

    def draw(self) -> Figure:
        """Shear stress, largest principal stress and mode of the interface at the four levels."""
        problem, solid = self._model.problem, self._model.seen is not None
        figure = plt.figure(figsize=(12, 9), layout="constrained")
        kept = [(name, self._kept[name]) for name in self.NAMES if name in self._kept]
        axes = [[], []]
        for column, (name, (snapshot, force)) in enumerate(kept, start=1):
            problem.step.return_to(snapshot)
            corners, cells = deformed_corners(problem, self._model.seen, magnify=MAGNIFY)
            for row, values in enumerate(self._stresses()):
                place = (3, len(kept), column + len(kept) * row)
                ax = figure.add_subplot(*place, projection="3d" if solid else None)
                shown = corners if solid else corners[..., :2]
                _, colours, limits = self.ROWS[row]
                drawn = draw_cells(ax, problem, shown, values[cells], limits)
                # Lines of the colour of the faces: without any there would be white seams in space.
                drawn.set(cmap=colours, linewidth=0.3 if solid else 0, edgecolor="face")
                if solid:
                    ax.set(xlim=(0, OUTER_RADIUS), ylim=(0, OUTER_RADIUS), zlim=(-1, HEIGHT))
                    ax.set_aspect("equal")
                    ax.view_init(elev=25, azim=225)
                    ax.set_axis_off()
                else:
                    ax.set(xlabel="r [mm]", ylabel="z [mm]")
                axes[row].append((ax, drawn))
            title = f"{name}\n{problem.t - 1:.4f} mm, {force:.1f} N"
            axes[0][-1][0].set_title(f"{title}\ndisplacement x {MAGNIFY}", size=9)
            # Figure 27: the active branch on the unrolled interface.
            ax = figure.add_subplot(3, len(kept), 2 * len(kept) + column)
            mode_map(problem, 0, axis=self._model.axis, ax=ax)
        for drawn, (label, *_) in zip(axes, self.ROWS, strict=True):
            figure.colorbar(drawn[0][1], ax=[ax for ax, _ in drawn], label=label, shrink=0.8)
        return figure

    def _stresses(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """sigma_rz and the largest principal stress, cell means [MPa]."""
        function = self._model.problem.stress()
        sigma = cell_means(function)
        shear = sigma[:, 0, 1]
        if self._model.seen is not None:
            space = function.function_space
            x = space.tabulate_dof_coordinates()[space.dofmap.list].mean(axis=1)
            radial = x[:, :2] / np.linalg.norm(x[:, :2], axis=1, keepdims=True)
            shear = np.einsum("ci,ci->c", radial, sigma[:, :2, 2])
        return shear, np.linalg.eigvalsh(sigma)[:, -1]


def curves(runs: dict[str, vmdg.History], friction: float, fibre_modulus: float) -> Figure:
    """Force and debonded length over the punch, and the force over the debonded length."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    for label, history in runs.items():
        punch, force, length = (history[name] for name in ("punch", "force", "debonded"))
        axes[0].plot(np.r_[0, punch], np.r_[0, force], label=label)
        axes[1].plot(np.r_[0, punch], np.r_[0, length], label=label)
        axes[2].plot(length, force, label="bond gone" if len(runs) == 1 else label)
    axes[0].set(xlabel="punch [mm]", ylabel="force [N]", xlim=0, ylim=0)
    axes[1].set(xlabel="punch [mm]", ylabel="debonded length [mm]", xlim=0)
    axes[1].set_ylim(0, 1.05 * HEIGHT)
    axes[2].set(xlabel="debonded length [mm]", ylabel="force [N]", xlim=(0, HEIGHT), ylim=0)
    if len(runs) == 1:
        history = next(iter(runs.values()))
        axes[2].plot(history["damaged"], history["force"], "--", label="bond damaged")
        length = np.linspace(0, HEIGHT, 100)
        force = shear_lag(length, friction, fibre_modulus)
        shift = 1.5 * RADIUS
        band = {"color": "black", "alpha": 0.15, "label": r"shear lag $\pm$ 1.5 a"}
        axes[2].fill_betweenx(force, length - shift, length + shift, **band)
        axes[2].legend()
    else:
        axes[0].legend()
    return figure


def _force_at_first(history: vmdg.History, name: str) -> float:
    """Force [N] in the first step at which a column is above zero, NaN if in none."""
    reached = history[name] > 0
    return history["force"][np.argmax(reached)] if reached.any() else np.nan


def describe(runs: dict[str, vmdg.History], name: str = "run") -> str:
    """Table of the numbers of section 7.4, a row a run.

    Args:
        runs: Histories by label.
        name: Of what runs differ in.
    """
    head = [
        *(name, "slope [N/mm]", "first damage [N]", "bond first gone [N]", "largest [N]"),
        *("debonded at the largest [mm]", "end [N]"),
    ]
    rows = []
    for label, history in runs.items():
        punch, force, gone = (history[name] for name in ("punch", "force", "debonded"))
        starts = [_force_at_first(history, name) for name in ("damaged", "debonded")]
        peak = np.argmax(force)
        numbers = [force[0] / punch[0], *starts, force[peak], gone[peak], force[-1]]
        rows.append([label, *(f"{number:.5g}" for number in numbers)])
    return markdown(head, rows)


def studied(
    main: Callable[..., vmdg.History],
    name: str,
    values: Sequence[float],
    out: Path,
    plot: bool = True,
    **options: float | bool,
) -> dict[str, vmdg.History]:
    """One run of the demo a value, a table and a picture of all; the histories by label.

    Args:
        main: Of the demo.
        name: Of the study.
        values: Of its argument.
        out: Folder for table and picture; every run has a folder in it.
        plot: Draw the picture.
        options: Other arguments of the demo.
    """
    argument, label, _ = STUDIES[name]
    first, runs = MPI.COMM_WORLD.rank == 0, {}
    for value in values:
        if first:
            print(label.format(value))
        given = {argument: value * E_MATRIX if name == "modulus" else value}
        given["out"] = str(out / f"{name}_{value}")
        runs[label.format(value)] = main(**options | given, plot=False)
    if first:
        (out / f"pushout_{name}.md").write_text(describe(runs, name) + "\n")
        print(describe(runs, name))
    if first and plot:
        curves(runs, FRICTION, FIBRE_MODULUS).savefig(out / f"pushout_{name}.png", dpi=130)
    return runs
