"""Closed forms of linear and nonlinear elasticity with an interface: bar, ring, inclusion."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from time import perf_counter

from mpi4py import MPI

import numpy as np
from parts.tables import markdown
from parts.topology import global_max, global_sum
from scipy.optimize import brentq

import vmdg
from vmdg.meshes import TaggedMesh, blocks, distribute, model


@dataclass(frozen=True)
class Check:
    """One line of the table."""

    case: str  # Name of the scene
    quantity: str  # What is compared, with its unit
    computed: float  # By vmdg
    exact: float  # By the closed form
    # Relative. Of a field (its largest value is shown) the largest deviation, relative to its
    # largest value
    error: float
    mesh: str  # Cells and degree
    seconds: float = 0.0  # Of the whole scene


@contextmanager
def timed(checks: list[Check]) -> Iterator[None]:
    """Give the checks that are added inside the time of the whole."""
    start, first = perf_counter(), len(checks)
    yield
    seconds = perf_counter() - start
    checks[first:] = [Check(**{**vars(c), "seconds": seconds}) for c in checks[first:]]


def table(checks: Sequence[Check]) -> str:
    return markdown(
        "case quantity computed exact error mesh s".split(),
        [
            (
                *(c.case, c.quantity, f"{c.computed:.6g}", f"{c.exact:.6g}", f"{c.error:.1e}"),
                *(c.mesh, f"{c.seconds:.1f}"),
            )
            for c in checks
        ],
    )


def compare(case: str, quantity: str, computed: float, exact: float, mesh: str) -> Check:
    """A number against its closed form."""
    error = abs(computed - exact) / abs(exact)
    return Check(case, quantity, float(computed), float(exact), float(error), mesh)


def describe(problem: vmdg.Problem, degree: int) -> str:
    mesh = problem.mesh
    count = mesh.topology.index_map(mesh.topology.dim).size_global
    return f"{count} {mesh.topology.cell_name()}s, k = {degree}"


def bimaterial_bar(n: int = 1, contrast: float = 100.0, verbose: bool = False) -> list[Check]:
    """Two bars of 1 mm in uniaxial strain pulled until their bond has softened to nothing.

    With F = diag(s, 1, 1), (86) gives P(s) = mu (s - 1/s) + lambda (s - 1). The state at the end
    displacement delta solves P_1(s_1) = P_2(s_2) = P_c (1 - zeta/zeta_c) and
    s_1 + s_2 - 2 + zeta = delta. Hexahedra at finite strain.
    """
    materials = [vmdg.NeoHookean(E=E, nu=0.3) for E in (1000.0 * contrast, 1000.0)]
    law = vmdg.Debonding(strength=200.0, critical_gap=0.5)

    def piola(s: float, material: vmdg.NeoHookean) -> float:
        p = material.parameters
        return p["mu"] * (s - 1 / s) + p["lmbda"] * (s - 1)

    def stretch(stress: float, material: vmdg.NeoHookean) -> float:
        return brentq(lambda s: piola(s, material) - stress, 0.5, 3.0, xtol=1e-15)

    def end(stress: float) -> float:
        gap = law.critical_gap * (1 - stress / law.strength)
        return sum(stretch(stress, m) - 1 for m in materials) + gap

    delta = 0.3
    exact = brentq(lambda stress: end(stress) - delta, 1.0, law.strength, xtol=1e-13)
    mesh, cells, facets = blocks(MPI.COMM_WORLD, "hexahedron", (n, n, n))
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, dict(enumerate(materials, start=1)), [interface])
    for tag, axis in ((1, "x"), (4, "y"), (5, "y"), (6, "z"), (7, "z")):
        problem.dirichlet(facets.find(tag), 0.0, axis)
    problem.dirichlet(facets.find(2), lambda t: t, "x")
    options = vmdg.SolveOptions(relative_tolerance=1e-12, verbose=verbose)
    vmdg.solve(problem, np.linspace(0.02, delta, 15), options)
    mean, size = problem.mean(0), describe(problem, 1)
    gap = law.critical_gap * (1 - exact / law.strength)
    return [
        compare("bimaterial bar", "traction [MPa]", mean.traction[0], exact, size),
        compare("bimaterial bar", "residual gap [mm]", mean.gap[0], gap, size),
    ]


def _polar(points: np.ndarray, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angle, radial and circumferential component at points (n, 3) of vectors (n, 2)."""
    angle = np.arctan2(points[:, 1], points[:, 0])
    c, s = np.cos(angle), np.sin(angle)
    return angle, vectors[:, 0] * c + vectors[:, 1] * s, vectors[:, 1] * c - vectors[:, 0] * s


def core_and_ring(comm: MPI.Comm, outer: float, element_size: float, order: int = 1) -> TaggedMesh:
    """The quadrant x, y > 0 of a disc of radius 1 in a ring, triangles that grow with the radius.

    Cell tags 1 (core) and 2 (ring); facet tags 1 y = 0, 2 x = 0, 3 interface, 4 outer side.
    """
    with model("core and ring") as scene:
        if comm.rank == 0:
            geo, radii = scene.geo, (1.0, outer)
            centre = geo.addPoint(0, 0, 0, element_size)
            right = [geo.addPoint(r, 0, 0, element_size * r) for r in radii]
            up = [geo.addPoint(0, r, 0, element_size * r) for r in radii]
            arcs = [geo.addCircleArc(a, centre, b) for a, b in zip(right, up, strict=True)]
            bottom, left = ([geo.addLine(centre, x[0]), geo.addLine(*x)] for x in (right, up))
            loops = [bottom[0], arcs[0], -left[0]], [bottom[1], arcs[1], -left[1], -arcs[0]]
            faces = [geo.addPlaneSurface([geo.addCurveLoop(loop)]) for loop in loops]
            geo.synchronize()
            for tag, face in enumerate(faces, start=1):
                scene.addPhysicalGroup(2, [face], tag)
            for tag, side in enumerate((bottom, left, arcs[:1], arcs[1:]), start=1):
                scene.addPhysicalGroup(1, side, tag)
            scene.mesh.generate(2)
            scene.mesh.setOrder(order)
        return distribute(scene, comm, 2)


def _quadrant(
    materials: Sequence[vmdg.Material], element_size: float, outer: float, degree: int, **options
) -> tuple[vmdg.Problem, object]:
    """Core of radius 1 tied in a ring, small strains, symmetric about both axes."""
    mesh, cells, facets = core_and_ring(MPI.COMM_WORLD, outer, element_size, degree)
    interface = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    bodies = dict(enumerate(materials, start=1))
    problem = vmdg.Problem(mesh, cells, bodies, [interface], degree, kinematics="small", **options)
    problem.dirichlet(facets.find(1), 0.0, "y")
    problem.dirichlet(facets.find(2), 0.0, "x")
    return problem, facets


def compare_field(
    case: str, quantity: str, computed: np.ndarray, exact: np.ndarray, mesh: str
) -> Check:
    """Largest deviation of a field, relative to its largest value."""
    comm = MPI.COMM_WORLD
    error = global_max(comm, np.abs(computed - exact).max(initial=0.0))
    size = global_max(comm, np.abs(exact).max(initial=0.0))
    peak = global_max(comm, np.abs(computed).max(initial=0.0))
    return Check(case, quantity, float(peak), float(size), float(error / size), mesh)


def shrink_fit(
    element_size: float = 0.1, degree: int = 2, theta: float = 1e-3, verbose: bool = False
) -> list[Check]:
    """Lame: a core of radius a = 1 that swells by theta in a ring of outer radius b, plane strain.

    Free swelling in the plane is (1 + nu_f) theta, hence the pressure between them

        p = (1 + nu_f) theta / [(1 + nu_f)(1 - 2 nu_f)/E_f
                                + (1 + nu_m)/E_m ((1 - 2 nu_m) a2 + b2)/(b2 - a2)].
    """
    E, nu, b = (40e3, 10e3), (0.2, 0.33), 2.0
    core = (1 + nu[0]) * (1 - 2 * nu[0]) / E[0]
    ring = (1 + nu[1]) / E[1] * ((1 - 2 * nu[1]) + b**2) / (b**2 - 1)
    pressure = (1 + nu[0]) * theta / (core + ring)
    materials = [vmdg.NeoHookean(E=e, nu=n) for e, n in zip(E, nu, strict=True)]
    problem, _ = _quadrant(materials, element_size, b, degree, eigenstrain={1: lambda t: t * theta})
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(verbose=verbose))
    state, size = problem.state[0], describe(problem, degree)
    _, radial, shear = _polar(state.points, state.traction)
    total, area = global_sum(problem.comm, [state.weights @ radial, state.weights.sum()])
    return [
        compare("Lame shrink fit", "mean pressure [MPa]", -total / area, pressure, size),
        compare_field(
            "Lame shrink fit", "radial traction [MPa]", radial, -pressure + 0 * shear, size
        ),
    ]


def goodier(
    element_size: float = 0.1, degree: int = 2, S: float = 1.0, verbose: bool = False
) -> list[Check]:
    """Goodier: a round core in an infinite matrix under remote tension S along x, plane strain.

    With k = 3 - 4 nu of the matrix, beta = -2 (G - 1)/(1 + G k), gamma = 1 - A, delta = -beta/2,
    q = a2/r2 and A, B of the interface,

        s_rr = S/2 (1 - gamma q + (1 - 2 beta q - 3 delta q2) cos 2 th),
        s_rt = -S/2 (1 + beta q + 3 delta q2) sin 2 th,

    prescribed at r = 3 a as tractions; on the interface s_rr = S/2 (A + B cos 2 th) and
    s_rt = -S/2 B sin 2 th.
    """
    core, matrix = vmdg.NeoHookean(E=40e3, nu=0.2), vmdg.NeoHookean(E=10e3, nu=0.33)
    G = core.parameters["mu"] / matrix.parameters["mu"]
    k_f, k = 3 - 4 * 0.2, 3 - 4 * 0.33
    A, B = G * (k + 1) / (2 * G + k_f - 1), G * (k + 1) / (1 + k * G)
    beta = -2 * (G - 1) / (1 + G * k)

    def stress(x: np.ndarray, t: float) -> np.ndarray:
        q, angle = 1 / (x[0] ** 2 + x[1] ** 2), np.arctan2(x[1], x[0])
        bracket = 1 - 2 * beta * q + 1.5 * beta * q**2
        rr = t * S / 2 * (1 - (1 - A) * q + bracket * np.cos(2 * angle))
        rt = -t * S / 2 * (1 + beta * q - 1.5 * beta * q**2) * np.sin(2 * angle)
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([c * rr - s * rt, s * rr + c * rt])

    problem, facets = _quadrant([core, matrix], element_size, 3.0, degree)
    problem.traction(facets.find(4), stress)
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(verbose=verbose))
    state, size = problem.state[0], describe(problem, degree)
    angle, radial, shear = _polar(state.points, state.traction)
    exact = S / 2 * (A + B * np.cos(2 * angle)), -S / 2 * B * np.sin(2 * angle)
    return [
        compare_field("Goodier inclusion", "radial traction [MPa]", radial, exact[0], size),
        compare_field("Goodier inclusion", "shear traction [MPa]", shear, exact[1], size),
    ]
