"""A periodic cell of crystals whose boundaries can fail, and a picture of their damage."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

import vmdg
from vmdg.meshes import polycrystal
from vmdg.output.values import scalar

SIZE, LOW_ANGLE = 0.1, 15.0  # mm, degrees
NICKEL = {"C11": 246.5e3, "C12": 147.3e3, "C44": 124.7e3}  # MPa
STRENGTH, CRITICAL_GAP = 500.0, 2e-4  # MPa, mm


def build(grains: int, seed: int, spread: float, cells: float) -> vmdg.Problem:
    """A cell stretched along x by the load factor, with two classes of grain boundaries.

    Args:
        grains: Number of grains.
        seed: Of their places and angles.
        spread: Of their sizes.
        cells: Along the mean size of a grain.
    """
    fine = SIZE / np.sqrt(grains) / cells
    mesh, tags, _ = polycrystal(grains, seed, spread=spread, size=SIZE, element_size=fine)
    angle = np.radians(np.random.default_rng(seed).uniform(0, 90, grains + 1))
    c, s, zero = np.cos(angle), np.sin(angle), np.zeros(grains + 1)
    turns = np.array([[c, -s, zero], [s, c, zero], [zero, zero, zero + 1]]).transpose(2, 0, 1)
    crystals = {n: vmdg.Cubic(**NICKEL, rotation=turns[n]) for n in range(1, grains + 1)}

    def alike(a: NDArray, b: NDArray) -> NDArray:
        return vmdg.misorientation(turns[a], turns[b]) < LOW_ANGLE

    strong, weak = (vmdg.Debonding(f * STRENGTH, CRITICAL_GAP) for f in (2, 1))
    interfaces = [
        vmdg.Interface(between=alike, law=strong, name="low-angle"),
        vmdg.Interface(between=lambda a, b: ~alike(a, b), law=weak, name="high-angle"),
    ]
    stretch = vmdg.Periodic(strain={"xx": lambda strain: strain})
    return vmdg.Problem(mesh, tags, crystals, interfaces, kinematics="small", periodic=stretch)


def damage(problem: vmdg.Problem) -> NDArray[np.float64]:
    """x, y and Q/strength of all points of all interfaces (n, 3), on rank 0; collective."""
    rows = [
        np.column_stack([state.points[:, :2], scalar(problem, interface, "damage")])
        for state, interface in zip(problem.state, problem.interfaces, strict=True)
    ]
    parts = problem.comm.gather(np.concatenate(rows))
    return np.concatenate(parts) if parts else np.zeros((0, 3))


class CellMonitor:
    """Monitor of a run: what a cell has for every row, and states for pictures; collective.

    Args:
        problem: A periodic cell.
        film: Whether to keep what a film needs.

    Attributes:
        states: :func:`damage` of every row.
        snapshots: Of every row, for a film; else none.
    """

    def __init__(self, problem: vmdg.Problem, film: bool):
        self._cell, self._film = vmdg.PeriodicCell(problem), film
        self.states, self.snapshots = [], []

    def __call__(self, problem: vmdg.Problem) -> dict[str, float]:
        """Columns of the row."""
        if self._film:
            self.snapshots.append(problem.step.snapshot())
        self.states.append(damage(problem))
        return self._cell.row()


def draw_damage(ax: Axes, problem: vmdg.Problem, points: NDArray, strain: str) -> None:
    """Points of the interfaces, coloured by their damage.

    Args:
        ax: Where to draw.
        problem: The problem.
        points: Of :func:`damage`.
        strain: For the title.
    """
    drawn = ax.scatter(*points[:, :2].T, s=4, c=points[:, 2], cmap="inferno_r", vmin=0, vmax=1)
    ax.set(aspect="equal", xlabel="x [mm]", ylabel="y [mm]", title=f"damage at the peak, {strain}")
    ax.figure.colorbar(drawn, ax=ax, shrink=0.8)
