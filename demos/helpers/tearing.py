"""What the tearing demo records and draws: contours, and curves along the interface."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import vmdg
from vmdg.meshes import TaggedMesh
from vmdg.plot import cell_means, deformed_polygons, draw_cells

STYLES = {"coarse": "o", "medium": "x", "fine": "-"}


def gathered(problem: vmdg.Problem, *columns: NDArray) -> NDArray:
    """Rows of all ranks in ascending order of the first column."""
    rows = np.concatenate(problem.comm.allgather(np.column_stack(columns)))
    return rows[np.argsort(rows[:, 0])]


def gap_profile(problem: vmdg.Problem, tagged: TaggedMesh, y: float) -> NDArray:
    """Rows (x, opening along y) at the nodes of the line ``y`` of both plates, slit included."""
    X = problem.space.tabulate_dof_coordinates()
    lips = []
    for tag in (1, 2):
        nodes = np.unique(problem.space.dofmap.list[tagged.cell_tags.find(tag)])
        nodes = nodes[np.isclose(X[nodes, 1], y)]
        rows = gathered(problem, X[nodes, 0].round(9), problem.u.x.array.reshape(-1, 2)[nodes, 1])
        lips.append(rows[np.unique(rows[:, 0], return_index=True)[1]])
    return np.column_stack([lips[0][:, 0], lips[1][:, 1] - lips[0][:, 1]])


def error_profile(problem: vmdg.Problem) -> NDArray:
    """Rows (x, size of the fine scales) of the facets of the interface."""
    q = problem.discretization.active[0].quadrature
    x = np.bincount(q.facet, q.weights * problem.state[0].points[:, 0], len(q.area)) / q.area
    return gathered(problem, x, problem.error_indicator(0))


@dataclass
class Run:
    """What one mesh gave.

    Attributes:
        history: Table of the run.
        failures: Load factor and reason of every step that was cut.
        gap: Profile of the opening by strain.
        error: Profile of the fine scales by strain.
    """

    history: vmdg.History = field(default_factory=vmdg.History)
    failures: list[tuple[float, str]] = field(default_factory=list)
    gap: dict[float, NDArray] = field(default_factory=dict)
    error: dict[float, NDArray] = field(default_factory=dict)

    @property
    def peak(self) -> float:
        """Strain of the largest force: damage has crossed the bond and the tearing begins."""
        return self.history["load"][np.argmax(self.history["force"])]

    @property
    def separation(self) -> float:
        """First strain without force after the peak; NaN where the plates hold."""
        strain, force = self.history["load"], self.history["force"]
        parted = strain[force < 1e-6 * force.max()]
        return parted[0] if len(parted) else np.nan

    def summary(self) -> str:
        """What to print of it."""
        h = self.history
        return (
            f"peak {h['force'].max():.5g} N/mm at {100 * self.peak:.3g} %, parted at "
            f"{100 * self.separation:.4g} %, broken {100 * h['broken'][-1]:.3g} %;"
            f"\n  {len(h)} steps, iterations median {np.median(h['iterations']):g}, maximum "
            f"{h['iterations'].max()}, {len(self.failures)} steps cut, {h['jump_steps'].sum()} "
            f"viscous; energy missing {h['imbalance'][-1] / h['external'][-1]:.1e}"
        )

    def gap_difference(self, reference: Run, strain: float) -> float:
        """Largest difference of the openings at ``strain``, relative to the largest opening."""
        x, gap = reference.gap[strain].T
        return np.abs(np.interp(x, *self.gap[strain].T) - gap).max() / gap.max()


class Contours:
    """A row of pictures of sigma_yy on the deformed plates, one for each chosen strain.

    Args:
        strains: When to draw.
        limits: Of the colours [MPa].
    """

    def __init__(self, strains: Sequence[float], limits: tuple[float, float]):
        self.figure, axes = plt.subplots(
            1, len(strains), figsize=(9.5, 3.4), sharey=True, layout="constrained"
        )
        self._axes = dict(zip(strains, axes, strict=True))
        self._limits = limits

    def take(self, problem: vmdg.Problem) -> None:
        """Draw the current state if its strain is one of the chosen; collective."""
        for strain, ax in self._axes.items():
            if not np.isclose(problem.t, strain):
                continue
            polygons, cells = deformed_polygons(problem)
            values = cell_means(problem.stress(), (1, 1))[cells]
            drawn = draw_cells(ax, problem, polygons, values, self._limits)
            drawn.set(linewidth=0, antialiased=False)
            ax.set(title=f"strain {100 * strain:.3g} %", xlabel="x [mm]")
            first, *_, last = self._axes.values()
            if ax is first:
                ax.set_ylabel("y [mm]")
            if ax is last:
                bar = self.figure.colorbar(drawn, ax=list(self._axes.values()), extend="both")
                bar.set_label(r"$\sigma_{yy}$ [MPa]")


def curves(runs: Mapping[str, Run], law: vmdg.Law, tip: float) -> Figure:
    """Force, opening along the interface, traction at the tip, and fine scales."""
    figure, ((force, gap), (bond, error)) = plt.subplots(
        2, 2, figsize=(9.5, 7), layout="constrained"
    )
    finest = list(runs)[-1]
    for name, run in runs.items():
        h, style = run.history, STYLES[name]
        for ax, x, y in (
            (force, 100 * h["load"], h["force"]),
            (bond, h["tip_opening"], h["tip_traction"]),
        ):
            ax.plot(x, y, style, ms=4, mfc="none", label=name)
        for i, (strain, profile) in enumerate(run.gap.items()):
            label = f"{100 * strain:.3g} %" if name == finest else None
            every = slice(None, None, {"coarse": 1, "medium": 2}.get(name, 1))
            gap.plot(*profile[every].T, style, ms=4, mfc="none", color=f"C{i}", label=label)
        for i, (strain, profile) in enumerate(run.error.items()):
            label = f"{100 * strain:.3g} %, {name}" if name in (finest, next(iter(runs))) else None
            error.semilogy(*profile.T, style, ms=3, mfc="none", lw=1, color=f"C{i}", label=label)
    largest = max(run.history["tip_opening"].max() for run in runs.values())
    opening = np.append(np.linspace(0, min(law.critical_gap, 1.5 * largest)), 1.5 * largest)
    line = law.strength * np.clip(1 - opening / law.critical_gap, 0, None)
    bond.plot(opening, line, "k--", lw=1, label="law")
    for ax in (gap, error):
        ax.axvline(tip, color="0.7", lw=1, zorder=0)
        ax.set_xlabel("x [mm]")
    gap.annotate("crack tip", (tip, 0.5), xycoords=("data", "axes fraction"), rotation=90)
    force.set(xlabel="strain [%]", ylabel="force [N/mm]")
    gap.set(ylabel="opening of the interface [mm]")
    bond.set(xlabel="opening at the tip, |g| [mm]", ylabel="traction at the tip, |T| [MPa]")
    error.set(ylabel="fine-scale error [mm]")
    for ax in (force, gap, bond):
        ax.legend(fontsize=8)
    error.set_ylim(top=20 * error.get_ylim()[1])
    error.legend(fontsize=8, ncols=2, loc="upper center")
    return figure
