"""A Newton iteration of plastic bodies against that of elastic ones, and points a second.

Mesh, interface and quadrature are the same; the bodies of the one flow at every point. With a tie
the tangent of plastic bodies is unsymmetric; one body alone has a symmetric one.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import process_time

from petsc4py import PETSc

import numpy as np

import vmdg
from parts.benchmark.common import BOTTOM, LOWER, TOP, UPPER, layers, least_times
from parts.benchmark.ratio import STEPS, Direct, Multigrid
from vmdg.linear.ksp import LDLT, LU, automatic_options, set_rigid_modes

E, NU, YIELD = 1000.0, 0.3, 8.0  # MPa
ELASTIC = vmdg.NeoHookean(E=E, nu=NU)
METALS = {
    "J2, linear": vmdg.J2(E, NU, YIELD, hardening=50.0),
    "J2, Voce": vmdg.J2(E, NU, YIELD, hardening=50.0, saturation=12.0, exponent=20.0),
    "DruckerPrager": vmdg.DruckerPrager(E, NU, 4.0, 30.0, hardening=50.0),
}
HEAD_POINTS = ("material", "small strain", "finite strain")
HEAD = (
    "Newton iteration",
    "unknowns",
    *(f"{step} [ms]" for step in STEPS),
    "iterations or Gflop",
    "return maps [ms]",
    "all [ms]",
    "ratio",
)


def points_a_second(material: vmdg.PointMaterial, small: bool, repeats: int) -> float:
    """How many points a material answers, all of which flow, in batches as in a run."""
    rng, n = np.random.default_rng(0), 2048
    H = 0.02 * rng.normal(size=(n, 3, 3))
    H -= np.trace(H, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)

    def F(size: float) -> np.ndarray:
        G = size * H
        return (G + G.transpose(0, 2, 1)) / 2 if small else np.eye(3) + G

    state = material(F(1.0), material.start(n), np.inf, small).state
    further = F(1.1)
    least = np.inf
    for _ in range(5 * repeats):
        start = process_time()
        found = material(further, state, np.inf, small)
        least = min(least, process_time() - start)
    assert (found.state[:, 0] > state[:, 0]).mean() > 0.9
    return n / least


@dataclass(frozen=True)
class Cost:
    """Processor times of the parts of an iteration [s]."""

    name: str  # Kinematics, bodies and solver
    times: dict[str, dict[str, float]]  # Of "elastic" and "plastic", by part
    # Krylov iterations of the linear solves, or operations of direct ones [1e9]
    efforts: tuple[float, float]
    points: float  # Of the return maps, within "residual" of "plastic"
    size: int  # Number of unknowns
    flowing: float  # Share of the points that flow

    @property
    def totals(self) -> tuple[float, float]:
        """Of an iteration [s]."""
        return tuple(sum(self.times[name].values()) for name in ("elastic", "plastic"))

    @property
    def ratio(self) -> float:
        """Plastic to elastic."""
        elastic, plastic = self.totals
        return plastic / elastic

    def row(self) -> Iterator[str | float]:
        """Of the table below ``HEAD``, elastic bodies first."""
        elastic, plastic = self.times["elastic"], self.times["plastic"]
        yield self.name
        yield self.size
        for step in STEPS:
            yield f"{1e3 * elastic[step]:.4g} / {1e3 * plastic[step]:.4g}"
        yield " / ".join(f"{effort:.4g}" for effort in self.efforts)
        yield 1e3 * self.points
        yield " / ".join(f"{1e3 * total:.4g}" for total in self.totals)
        yield f"{self.ratio:.2f}"


def measure(small: bool, direct: bool, n: int, repeats: int, tied: bool = True) -> Cost:
    """One row of the table: hexahedra of degree 2.

    Args:
        direct: MUMPS instead of a Krylov solver with GAMG.
        repeats: The least of so many iterations.
    """
    named: dict[str, dict[str, Callable]] = {}
    problems: dict[str, vmdg.Problem] = {}
    for name, body in {"elastic": ELASTIC, "plastic": METALS["J2, Voce"]}.items():
        problem = problems[name] = _problem(body, small, n, tied)
        named[name] = dict(zip(STEPS, iteration(problem, direct), strict=True))
    bodies = problems["plastic"].discretization.bodies.points
    deformation = bodies.deformation(problems["plastic"].u)
    alone = {"plastic": {"points": lambda: bodies.update(deformation, np.inf)}}
    times = least_times(named, repeats)
    state = bodies.state
    pairs = zip(state.next, state.history, strict=True)
    grown = [after[:, 0] > before[:, 0] for after, before in pairs]
    words = "small" if small else "finite", "tied" if tied else "one body"
    return Cost(
        f"{', '.join(words)}, {'direct' if direct else 'multigrid'}",
        times,
        tuple(actions["solve"].effort for actions in named.values()),
        least_times(alone, repeats)["plastic"]["points"],
        problems["plastic"].space.dofmap.index_map.size_global * 3,
        float(np.concatenate(grown).mean()),
    )


def _problem(body: vmdg.Material, small: bool, n: int, tied: bool) -> vmdg.Problem:
    tagged = layers("hexahedron", (n, n, n), np.ones(3), n // 2)
    interfaces = [vmdg.Interface(between=(LOWER, UPPER), law=vmdg.Bonded())] if tied else []
    problem = vmdg.Problem(
        tagged.mesh,
        tagged.cell_tags,
        {LOWER: body, UPPER: body},
        interfaces,
        degree=2,
        kinematics="small" if small else "finite",
    )
    problem.dirichlet(np.concatenate([tagged.facet_tags.find(tag) for tag in (BOTTOM, TOP)]), 0.0)

    def u(x: np.ndarray) -> np.ndarray:
        return np.array([0.01 * x[0], 0 * x[0], (0.003 * x[0] - 0.03) * x[2]])

    problem.u.interpolate(u)
    return problem


def iteration(problem: vmdg.Problem, direct: bool) -> tuple[Callable, ...]:
    """Residual, tangent, boundary conditions and solve of one iteration, at the displacement."""
    parts, held = problem.discretization, problem.loading.prescribed
    matrix = parts.create_matrix(PETSc.Mat.Type.AIJ if direct else PETSc.Mat.Type.BAIJ)
    matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
    right = problem.step.assemble_residual().copy()
    right[problem.loading.owned_prescribed] = 0
    parts.assemble_tangent(matrix)
    matrix.zeroRowsColumnsLocal(held, 1.0)
    if direct:
        solver = Direct(matrix, LDLT if parts.symmetric else LU, right)
    else:
        set_rigid_modes(problem.space, parts.geometry, matrix)
        solver = Multigrid(matrix, automatic_options(problem, 0, 0)[0], right)
    return (
        problem.step.assemble_residual,
        lambda: parts.assemble_tangent(matrix),
        lambda: matrix.zeroRowsColumnsLocal(held, 1.0),
        solver,
    )
