"""Model, loads, stages and pictures of the fibre-matrix cell."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import vmdg
from vmdg.meshes import TaggedMesh
from vmdg.plot import cell_means, deformed_polygons, draw_cells, profile

SIZE, RADIUS = 1.0, 0.25  # mm
REPORT = {"fibre": vmdg.NeoHookean(E=40e3, nu=0.4), "matrix": vmdg.NeoHookean(E=10e3, nu=0.33)}
DECK = {"fibre": vmdg.NeoHookean(E=40e3, nu=0.33), "matrix": vmdg.NeoHookean(E=4e3, nu=0.4)}

STAGES = ("debonding starts", "cracks kink into the matrix", "cracks reach an edge", "separation")
MAGNIFY = (20, 20, 20, 1)
SEPARATED = 1e-3  # of the peak force


def build(
    tagged: TaggedMesh,
    materials: dict[str, vmdg.Material],
    critical_gap: float,
    cracks: str | None = None,
    kinematics: str = "finite",
) -> vmdg.Problem:
    """A cell whose sides are pulled apart, each by the load factor [mm].

    Args:
        tagged: Of :func:`vmdg.meshes.fibre_matrix`.
        materials: Of "fibre" and "matrix".
        critical_gap: Of the bonds [mm].
        cracks: How facets of the matrix are activated; None without cracks in the matrix.
        kinematics: "finite" or "small".
    """
    mesh, cells, sides = tagged
    bond = vmdg.Debonding(strength=10.0, critical_gap=critical_gap)
    interfaces = [vmdg.Interface(between=("fibre", "matrix"), law=bond)]
    if cracks:
        crack = vmdg.Debonding(strength=30.0, critical_gap=critical_gap)
        interfaces.append(vmdg.Interface(within="matrix", law=crack, activate=cracks))
    problem = vmdg.Problem(mesh, cells, materials, interfaces, kinematics=kinematics)
    problem.dirichlet(sides.find("left"), lambda pull: -pull, "x")
    problem.dirichlet(sides.find("right"), lambda pull: pull, "x")
    middle = np.array([[0.0, SIZE / 2], [SIZE, SIZE / 2]])

    def held(x: NDArray) -> NDArray:
        return np.any([np.isclose(x[:2].T, point).all(axis=1) for point in middle], axis=0)

    problem.dirichlet_points(held, 0.0, "y")
    return problem


def pulls(step: float, end: float, growth: float, constant: float = 0.003) -> NDArray[np.float64]:
    """Displacements of a side [mm]: equal steps to ``constant``, then growing ones to ``end``."""
    values, size = [step], step
    while values[-1] < end * (1 - 1e-9):
        if values[-1] > constant:
            size = min(size * growth, end / 12)
        values.append(min(values[-1] + size, end))
    return np.array(values)


class Cell:
    """The stage a cell is in, with a picture and the gap of one fibre as each one starts.

    1 an interface point is damaged, 2 a matrix point is, 3 a damaged matrix point lies within
    ``near`` of the top or bottom, 4 the force is below .1% of its peak.

    Args:
        problem: The cell; interface 0 is around the fibres, 1 (if any) in the matrix.
        size: Side of the cell [mm].
        near: [mm].
        draws: Whether there are pictures.
    """

    def __init__(self, problem: vmdg.Problem, size: float, near: float, draws: bool = True):
        self._problem, self._size, self._near = problem, size, near
        self._peak = 0.0
        self.stage = 0
        self.gaps: dict[int, tuple[NDArray, NDArray]] = {}
        self._draws = draws
        if draws:
            self.figure, self._axes = plt.subplots(2, 2, figsize=(7, 6.6), layout="constrained")

    def skip(self, history: vmdg.History) -> None:
        """Leave out the stages that a run which is resumed has passed already."""
        self._peak = np.abs(history["stress"]).max() * self._size
        self.stage = int(history["stage"][-1])

    def update(self, force: float) -> int:
        """The stage of the current state; collective."""
        self._peak = max(self._peak, abs(force))
        comm, state = self._problem.comm, self._problem.state
        damaged = [values.points[values.softening > 0] for values in state]
        matrix = damaged[1] if len(damaged) > 1 else np.zeros((0, 3))
        y = np.abs(matrix[:, 1] - self._size / 2)
        reached = comm.allreduce(np.array([len(damaged[0]), len(matrix), 0]))
        reached[2] = comm.allreduce(int((y > self._size / 2 - self._near).sum()))
        events = [*(reached > 0), abs(force) < SEPARATED * self._peak]
        while self.stage < 4 and events[self.stage]:
            self.stage += 1
            if self._draws:
                self._keep()
        return self.stage

    def _keep(self) -> None:
        number, problem = self.stage, self._problem
        ax, magnify = self._axes.flat[number - 1], MAGNIFY[number - 1]
        polygons, cells = deformed_polygons(problem, magnify=magnify)
        values = cell_means(problem.stress(), (0, 0))[cells]
        self._drawn = draw_cells(ax, problem, polygons, values, (0, 30))
        self._drawn.set(linewidth=0.3, cmap="viridis")
        scale = f"displacement x {magnify}" if magnify > 1 else "true scale"
        ax.set_title(f"{number} {STAGES[number - 1]}\n{problem.t * 1e3:.3g} µm, {scale}", size=9)
        ax.set(xlabel="x [mm]", ylabel="y [mm]")
        self.gaps[number] = tuple(profile(problem, 0, "opening", "angle")[0].T)

    def finish(self) -> plt.Figure:
        """Hide the panels of stages that did not come; the contours."""
        for number, ax in enumerate(self._axes.flat, start=1):
            ax.set_visible(number in self.gaps)
        if self.gaps:
            label = r"$\sigma_{xx}$ [MPa]"
            self.figure.colorbar(self._drawn, ax=self._axes, label=label, shrink=0.7)
        return self.figure


def curves(history: vmdg.History, cell: Cell) -> plt.Figure:
    """Stress over strain with the stages, and the normal gap around the fibre."""
    figure, axes = plt.subplots(1, 3, figsize=(10.5, 3.4), layout="constrained")
    strain, stress, stage = 100 * history["strain"], history["stress"], history["stage"]
    onset = strain <= max(0.7, 2 * strain[np.argmax(stress)])
    for ax, show in zip(axes, (onset, slice(None)), strict=False):
        ax.plot(np.r_[0, strain[show]], np.r_[0, stress[show]], color="black")
        for number in cell.gaps:
            first = int(np.argmax(stage >= number))
            if strain[first] <= strain[show][-1]:
                dot = {"color": f"C{number - 1}", "clip_on": False, "zorder": 3}
                ax.plot(strain[first], stress[first], "o", label=number, **dot)
        ax.set(xlabel="strain [%]", ylabel="stress [MPa]", xlim=0, ylim=(0, 1.1 * stress.max()))
    axes[1].legend(title="stage", loc="upper right")
    axes[0].set_title("start", size=10)
    axes[1].set_title("to separation" if cell.stage == 4 else "whole run", size=10)
    for number, (theta, gap) in cell.gaps.items():
        label = f"stage {number}, max {gap.max() * 1e3:.3g} µm"
        axes[2].plot(theta, gap / gap.max(), color=f"C{number - 1}", label=label)
    axes[2].set(xlabel=r"angle $\theta$ [°]", ylabel="normal gap / largest", xlim=(0, 360))
    axes[2].set(xticks=range(0, 361, 90), ylim=(min(axes[2].get_ylim()[0], -0.05), 1.75))
    axes[2].legend(loc="upper center", fontsize=8)
    return figure


def report(history: vmdg.History) -> None:
    """Print what the run took and what came out."""
    iterations, viscous = history["iterations"], history["jump_steps"].sum()
    print(
        f"{len(history)} steps, iterations: median {np.median(iterations):g}, most "
        f"{iterations.max()}; steps cut: {(history['cuts'] > 0).sum()}, viscous: {viscous}"
    )
    print(
        f"peak {history['stress'].max():.4g} MPa, stage {history['stage'][-1]}, energy imbalance "
        f"{history['imbalance'][-1] / history['external'][-1]:.2e} of the work"
    )
    print(f"{history['nodes'][0]} nodes at first, {history['nodes'][-1]} at the end")
