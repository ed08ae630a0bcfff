"""Perfectly plastic tube and spherical shell, and an inclusion that debonds, in closed form.

Small strain, yield stress Y, inner radius a, outer radius b, plastic up to the radius c. For the
sphere (Hill 1950, chapter 5) the tangential stresses are equal, so that the criteria of Tresca and
von Mises agree and the solution is exact for every Poisson's ratio:

    p = 2 Y ln(c/a) + 2/3 Y (1 - c^3/b^3),
    u/r = Y/E [(1 - nu) c^3/r^3 - 2/3 (1 - 2 nu) (1 - c^3/b^3 + 3 ln(c/r))]        r < c,
    u/r = 2/3 Y/E c^3/b^3 [1 - 2 nu + (1 + nu) b^3/(2 r^3)]                        r > c.

For the tube in plane strain with von Mises' criterion (the same with Y -> 2 Y/sqrt(3) for that of
Tresca)

    p = Y/sqrt(3) [2 ln(c/a) + 1 - c^2/b^2],   u = sqrt(3)/2 Y c^2/(E r),

exact for nu = 1/2, where the axial stress is the mean of the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import log, pi, sqrt

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from parts.topology import global_max, global_sum
from parts.verification.checks import describe
from scipy.optimize import brentq

import vmdg
from vmdg.meshes import blocks
from vmdg.meshes.two_blocks import BOTTOM, LEFT, RIGHT, TOP

A, M, B = 1.0, 1.25, 2.0  # inner radius, interface, outer radius [mm]
E, Y = 70e3, 200.0  # MPa


@dataclass(frozen=True)
class Shell:
    """The closed form of one shape."""

    sphere: bool  # Whether it is a sphere, else a tube
    nu: float  # Poisson's ratio
    # outer, inner: Radii [mm]
    outer: float = B
    inner: float = A

    def pressure(self, c: float) -> float:
        """Pressure inside [MPa]."""
        if self.sphere:
            return 2 * Y * log(c / self.inner) + 2 / 3 * Y * (1 - (c / self.outer) ** 3)
        return Y / sqrt(3) * (2 * log(c / self.inner) + 1 - (c / self.outer) ** 2)

    def displacement(self, r: NDArray, c: float) -> NDArray:
        """Radial displacement at radii r [mm]."""
        if not self.sphere:
            return sqrt(3) / 2 * Y / E * c**2 / r
        nu, far = self.nu, (c / self.outer) ** 3
        flown = (1 - nu) * (c / r) ** 3 - 2 / 3 * (1 - 2 * nu) * (1 - far + 3 * np.log(c / r))
        elastic = 2 / 3 * ((1 - 2 * nu) * far + (1 + nu) / 2 * (c / r) ** 3)
        return Y / E * r * np.where(r < c, flown, elastic)


def quarter(
    radii: tuple[float, float, float], rings: int, sectors: int
) -> tuple[vmdg.meshes.TaggedMesh, Callable[[NDArray], NDArray]]:
    """A quarter of two rings of curved cells, and radii of points."""
    inner, middle, outer = radii
    place = (middle - inner,) * 2
    tagged = blocks(
        MPI.COMM_WORLD, "quadrilateral", (rings, sectors), outer - inner, 1.0, 1.0, place, 2
    )
    x = tagged.mesh.geometry.x
    r, angle = inner + x[:, 0], pi / 2 * x[:, 1]
    x[:, 0], x[:, 1] = r * np.cos(angle), r * np.sin(angle)
    return tagged, lambda x: np.hypot(x[0], x[1])


@dataclass(frozen=True)
class Found:
    """What one run of a shell gives."""

    widening: float  # Mean radial displacement of the inner surface [mm]
    front: float  # Radius of the volume that has flown [mm]
    # Of the radial displacement, root mean square of the nodes, relative to that of the inner
    # surface
    error: float
    mesh: str  # Cells and degree


def build(
    shape: Shell, n: int, tied: bool, pressure: float
) -> tuple[vmdg.Problem, Callable[[NDArray], NDArray]]:
    """A quarter of the shell, and radii of points; the load factor is a share of a pressure.

    Args:
        n: Cells across each of two rings, between which an interface may lie.
        tied: Whether they are two bodies, else one.
        pressure: Inside, at the load factor 1 [MPa].
    """
    tagged, radius = quarter((shape.inner, M, shape.outer), n, 2 * n)
    mesh, cells, facets = tagged
    metal = vmdg.J2(E, shape.nu, Y)
    problem = vmdg.Problem(
        mesh,
        cells,
        {1: metal, 2: metal},
        [vmdg.Interface(between=(1, 2), law=vmdg.Bonded())] if tied else [],
        degree=2,
        kinematics="small",
        symmetry="axisymmetric" if shape.sphere else None,
    )
    problem.pressure(facets.find(LEFT), lambda t: t * pressure)
    problem.dirichlet(facets.find(BOTTOM), 0.0, "y")
    problem.dirichlet(facets.find(TOP), 0.0, "x")
    return problem, radius


def limit(shape: Shell, n: int) -> tuple[float, str]:
    """Largest pressure of a tied shell that is widened by a tenth of its radius [MPa]; mesh.

    The load factor is the pressure over Y: that of the closed form is no multiple of a step.
    """
    problem, _ = build(shape, n, True, Y)

    def wide(problem: vmdg.Problem) -> bool:
        widening = global_max(problem.comm, np.abs(problem.u.x.array).max(initial=0.0))
        return widening > 0.1 * shape.inner

    options = vmdg.SolveOptions(unstable="trace")
    history = vmdg.solve(problem, [0.6, 0.7, 0.78, 1.0], options, until=wide).history
    return Y * float(history["load"].max()), describe(problem, 2)


def press(shape: Shell, n: int, tied: bool, front: float, steps: int = 8) -> Found:
    """Put a shell under the inner pressure at which the closed form flows up to ``front``."""
    problem, radius = build(shape, n, tied, shape.pressure(front))
    vmdg.solve(problem, steps, vmdg.SolveOptions(relative_tolerance=1e-10))
    flown = sum(
        state.weights[state.history["alpha"] > 0].sum() for state in map(problem.body_state, (1, 2))
    )
    flown = float(global_sum(problem.comm, flown))
    power, unit = (3, 2 / 3 * pi) if shape.sphere else (2, pi / 4)
    own = slice(problem.space.dofmap.index_map.size_local)
    x = problem.space.tabulate_dof_coordinates()[own].T
    r = radius(x)
    radial = np.sum(problem.u.x.array.reshape(-1, 2)[own].T * x[:2], axis=0) / r
    squares = np.sum((radial - shape.displacement(r, front)) ** 2)
    inside = np.isclose(r, shape.inner)
    sums = [squares, len(r), radial[inside].sum(), np.count_nonzero(inside)]
    total, count, widening, nodes = global_sum(problem.comm, sums)
    end = float(shape.displacement(np.array(shape.inner), front))
    return Found(
        widening=widening / nodes,
        front=(shape.inner**power + flown / unit) ** (1 / power),
        error=sqrt(total / count) / end,
        mesh=describe(problem, 2),
    )


#: Bond of a rigid inclusion of radius A in a matrix up to OUTSIDE: weaker than 1.7 Y, so that the
#: matrix is elastic until it fails, and tough enough to open steadily as the outside moves.
BOND, OUTSIDE, NU = vmdg.Debonding(strength=1.5 * Y, critical_gap=0.04), 3.0, 0.3


def debonding(gap: float) -> tuple[float, float, float]:
    """Motion of the outer surface [mm], traction of the bond [MPa] and plastic radius at a gap.

    The matrix under tractions T inside and S outside is in a hydrostatic state S and in that of a
    shell under the pressure S - T, whose inner surface moves by the gap g:

        u(r) = (1 - 2 nu) S r/E + u_shell(r, c),   S = T(g) + p(c),   u(a) = g.

    While the shell is elastic its state is a share of that of c = a, negative at first.
    """
    shell = Shell(sphere=True, nu=NU, outer=OUTSIDE)
    T = BOND.strength * (1 - gap / BOND.critical_gap)

    def motion(r: float, c: float, share: float = 1.0) -> float:
        uniform = (1 - 2 * NU) / E * (T + share * shell.pressure(c)) * r
        return uniform + share * float(shell.displacement(np.array(r), c))

    rest, whole = (motion(A, A, share) for share in (0.0, 1.0))
    share = (gap - rest) / (whole - rest)
    if share <= 1:
        return motion(OUTSIDE, A, share), T, A
    c = brentq(lambda c: motion(A, c) - gap, A, OUTSIDE)
    return motion(OUTSIDE, c), T, c


def pull_off(n: int, gaps: NDArray) -> tuple[NDArray, NDArray, str]:
    """Pull the matrix off its rigid inclusion: tractions [MPa] and gaps [mm], and the mesh.

    Args:
        n: Cells over the radius of the matrix, and along the inclusion.
        gaps: Those of the closed form at the motions that are prescribed [mm].
    """
    tagged, radius = quarter((0.9 * A, A, OUTSIDE), n, n)
    mesh, cells, facets = tagged
    problem = vmdg.Problem(
        mesh,
        cells,
        {1: vmdg.Rigid(), 2: vmdg.J2(E, NU, Y)},
        [vmdg.Interface(between=(1, 2), law=BOND)],
        degree=2,
        kinematics="small",
        symmetry="axisymmetric",
    )
    # Rounded: supports that meet in a corner agree to the last bit.
    problem.dirichlet(facets.find(RIGHT), lambda x, t: t * np.round(x[:2] / radius(x), 12))
    problem.dirichlet(facets.find(BOTTOM), 0.0, "y")
    problem.dirichlet(facets.find(TOP), 0.0, "x")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        means = {name: vmdg.average(problem, 0, name) for name in ("traction", "opening")}
        return means

    loads = [debonding(gap)[0] for gap in gaps]
    history = vmdg.solve(problem, loads, monitor=monitor).history
    found = [np.interp(loads, history["load"], history[k]) for k in ("traction", "opening")]
    return found[0], found[1], describe(problem, 2)
