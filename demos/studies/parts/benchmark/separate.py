"""A Newton iteration of bodies that are meshed separately against one of a mesh that matches.

Both have the same cells and unknowns. In the separate meshes the nodes of the upper body are moved
along the interface by up to two fifths of a cell, so that its facets meet two of the others in the
plane and four in space. Surfaces that slide are paired again in every residual: in each it finds a
displacement that it has not seen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import count

import numpy as np

import vmdg
from parts.benchmark.common import DIMENSION, LOWER, UPPER, layers, least_times
from parts.benchmark.plastic import iteration
from parts.benchmark.ratio import STEPS
from vmdg.meshes import TaggedMesh, apart

#: Cells in every direction, by cell; of the last one half is below the interface. In space small
#: blocks, of which the interface is a large part, and blocks three times as fine.
SIZES = {
    "triangle": (64,),
    "quadrilateral": (64,),
    "tetrahedron": (10, 30),
    "hexahedron": (14, 42),
}
BODY = vmdg.NeoHookean(E=1000.0, nu=0.3)  # MPa
#: Interface, and what it is called with separate meshes.
LAWS = {"tied": vmdg.Bonded(), "sliding": vmdg.Contact(friction=0.3)}
HEAD = (
    "Newton iteration",
    "unknowns",
    *(f"{step} [ms]" for step in STEPS),
    "all [ms]",
    "ratio",
    "of it cut",
)


@dataclass(frozen=True)
class Cost:
    """Processor times of the parts of an iteration [s]."""

    name: str  # Cell and interface
    times: dict[str, dict[str, float]]  # Of "matching" and "separate", by part
    sizes: tuple[int, int]  # Numbers of unknowns
    pairs: float  # Pairs of facets, for each facet of the interface
    # Of the search for pairs and the cutting, within "residual" of "separate"; zero for surfaces
    # that are paired once
    cut: float

    @property
    def ratio(self) -> float:
        """Separate to matching."""
        one, other = (sum(self.times[name].values()) for name in ("matching", "separate"))
        return other / one

    def row(self) -> Iterator[str | int]:
        """Of the table below ``HEAD``, the mesh that matches first."""
        one, other = self.times["matching"], self.times["separate"]
        yield self.name
        yield self.sizes[0]
        for step in STEPS:
            yield f"{1e3 * one[step]:.3g} / {1e3 * other[step]:.3g}"
        yield f"{1e3 * sum(one.values()):.4g} / {1e3 * sum(other.values()):.4g}"
        yield f"{self.ratio:.2f}"
        yield f"{100 * self.cut / sum(other.values()):.0f} %"


def measure(cell: str, law: str, n: int, repeats: int) -> Cost:
    """One row of the table.

    Args:
        cell: Of both meshes, of degree 1.
        n: Cells along an edge, an even number.
        repeats: The least of so many iterations.
    """
    problems = {
        name: _problem(cell, law, n, name == "separate") for name in ("matching", "separate")
    }
    named = {}
    for name, problem in problems.items():
        residual, *others = iteration(problem, direct=DIMENSION[cell] == 2)
        named[name] = dict(zip(STEPS, (_moved(problem, residual), *others), strict=True))
    sizes = tuple(p.space.dofmap.index_map.size_global * DIMENSION[cell] for p in problems.values())
    pairs = [p.discretization.active[0].facets for p in problems.values()]
    given = sizes, len(pairs[1].facets) / len(pairs[0].facets)
    times, cut, u = least_times(named, repeats), 0.0, problems["separate"].u
    if law == "sliding":
        alone = {"separate": {"cut": lambda: pairs[1].surfaces.pairs(u)}}
        cut = least_times(alone, repeats)["separate"]["cut"]
    return Cost(f"{cell}, {law}", times, *given, cut)


def _moved(problem: vmdg.Problem, residual: Callable[[], np.ndarray]) -> Callable[[], None]:
    """The residual at displacements that differ each time, for which surfaces are paired again."""
    u, steps = problem.u.x.array, count(1)
    start = u.copy()

    def call() -> None:
        u[:] = (1 + 1e-9 * next(steps)) * start
        residual()

    return call


def _problem(cell: str, law: str, n: int, separate: bool) -> vmdg.Problem:
    """Two layers that press each other, their ends held."""
    d = DIMENSION[cell]
    tagged = _apart(cell, n) if separate else layers(cell, (n,) * d, np.ones(d), n // 2)
    given = {"sliding": True} if separate and law == "sliding" else {}
    interface = vmdg.Interface(between=(LOWER, UPPER), law=LAWS[law], **given)
    bodies = {LOWER: BODY, UPPER: BODY}
    problem = vmdg.Problem(tagged.mesh, tagged.cell_tags, bodies, [interface])
    problem.dirichlet(lambda x: np.isclose(x[d - 1], 0) | np.isclose(x[d - 1], 1), 0.0)

    def u(x: np.ndarray) -> np.ndarray:
        return np.concatenate([0.01 * x[: d - 1], (0.003 * x[:1] - 0.03) * x[d - 1 : d]])

    problem.u.interpolate(u)
    return problem


def _apart(cell: str, n: int) -> TaggedMesh:
    """The two layers with meshes of their own."""
    d, parts = DIMENSION[cell], []
    for below in (n // 2, 0):
        part = layers(cell, (*(n,) * (d - 1), n // 2), (*(1.0,) * (d - 1), 0.5), below)
        parts.append((part.mesh, part.cell_tags, part.facet_tags))
    x = parts[1][0].geometry.x
    x[:, d - 1] += 0.5
    x[:, : d - 1] += 0.4 / n * np.sin(np.pi * x[:, : d - 1])
    return apart(parts)
