"""Delamination of beams against corrected beam theory: DCB (mode I) and ENF (mode II)."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from parts.delamination.laminate import ALFANO_CRISFIELD, IM7_8552, Laminate
from parts.topology import global_sum
from parts.verification.checks import Check, compare, describe
from scipy.optimize import brentq

import vmdg
from vmdg.meshes import TaggedMesh, beams
from vmdg.meshes.beams import CONTACT, INTERFACE, LOWER_LEFT, RIGHT, TOP, UPPER_LEFT


@dataclass(frozen=True)
class Run:
    """A delamination test."""

    # Of the run; its history has opening, load and crack length, computed and of the theory
    result: vmdg.Result
    checks: list[Check]  # Lines of the table
    more: int = 0  # Factorizations of other parts of the run
    # Motion and force of those parts, to be drawn with the published ones
    points: Sequence[tuple[float, float]] = ()

    @property
    def factorizations(self) -> int:
        return self.result.counts.factorizations + self.more

    @property
    def history(self) -> vmdg.History:
        return self.result.history


def compared(
    case: str,
    result: vmdg.Result,
    pairs: Sequence[tuple[str, float, float]],
    problem: vmdg.Problem,
    degree: int,
) -> Run:
    """A run with its checks: quantity, computed and exact value of each."""
    mesh = describe(problem, degree)
    return Run(result, [compare(case, *pair, mesh) for pair in pairs])


def arms(
    stations: Sequence[float],
    sizes: Sequence[float],
    height: float,
    rows: int,
    precrack: float,
    contact: float | None = None,
) -> TaggedMesh:
    """Quadrilaterals of at most ``sizes`` between stations, see `vmdg.meshes.beams`."""
    counts = np.ceil(np.diff(stations) / sizes - 1e-9).astype(int).tolist()
    return beams(MPI.COMM_WORLD, "quadrilateral", stations, counts, height, rows, precrack, contact)


def build(
    m: Laminate,
    tagged: TaggedMesh,
    degree: int,
    kinematics: str = "small",
    friction: float | None = None,
) -> vmdg.Problem:
    """Both arms, bonded from the crack on.

    With ``friction`` the crack faces touch where the crack is an interface.
    """
    material, facets = m.material, tagged.facet_tags
    laws = {INTERFACE: m.bond(friction or 0.0)}
    if friction is not None:
        laws[CONTACT] = vmdg.Contact(friction)
    interfaces = [vmdg.Interface(facets.find(tag), law=law) for tag, law in laws.items()]
    return vmdg.Problem(
        tagged.mesh,
        tagged.cell_tags,
        {1: material, 2: material},
        interfaces,
        degree,
        kinematics=kinematics,
        thickness=m.b,
    )


def at(x: float, y: float) -> Callable[[NDArray], NDArray]:
    return lambda points: np.isclose(points[0], x) & np.isclose(points[1], y)


def rest(problem: vmdg.Problem, tagged: TaggedMesh, height: float, span: float) -> None:
    """Support the lower arm at its left end and at ``span``, where nothing moves along."""
    problem.dirichlet(tagged.facet_tags.find(LOWER_LEFT), 0.0, "y")
    problem.dirichlet_points(at(span, -height), 0.0, "y")
    problem.dirichlet_points(at(span, 0.0), 0.0, "x")


def node(problem: vmdg.Problem, x: float, y: float) -> NDArray:
    """The owned node of a point, none on other ranks."""
    nodes = fem.locate_dofs_geometrical(problem.space, at(x, y))
    return nodes[nodes < problem.space.dofmap.index_map.size_local]


def lift(problem: vmdg.Problem, nodes: NDArray) -> float:
    """Displacement along y of what :func:`node` gives; collective [mm]."""
    u = problem.u.x.array.reshape(-1, 2)[:, 1]
    return float(global_sum(problem.comm, u[nodes].sum()))


def open_beam(
    element_size: float,
    rows: int,
    degree: int,
    m: Laminate,
    length: float,
    a_0: float,
    fine: float,
    kinematics: str = "small",
) -> tuple[vmdg.Problem, vmdg.NamedTags]:
    """A double cantilever beam whose load factor is its opening [mm], and the tags of its facets.

    Facets are of ``element_size`` from the crack to x = ``fine``.
    """
    stations = (0.0, a_0 - 2, a_0, fine, length)
    sizes = element_size * np.array([4, 1, 1, 8])
    tagged = arms(stations, sizes, m.h, rows, a_0)
    problem, facets = build(m, tagged, degree, kinematics), tagged.facet_tags
    # At the corners: an edge that may not change its height cannot turn, at finite strain.
    problem.dirichlet_points(at(0.0, -m.h), lambda t: -t / 2, "y")
    problem.dirichlet_points(at(0.0, m.h), lambda t: t / 2, "y")
    problem.dirichlet(facets.find(RIGHT), 0.0)
    return problem, facets


def dcb(
    element_size: float = 0.0625,
    steps: int = 40,
    end: float = 6.0,
    rows: int = 3,
    degree: int = 1,
    verbose: bool = False,
    m: Laminate = ALFANO_CRISFIELD,
    length: float = 100.0,
    kinematics: str = "small",
    a_0: float = 30.0,
    zone: float = 4.0,
    finer: float = 0.0,
) -> Run:
    """Double cantilever beam opened to ``end`` [mm]; a_0, L and data of Alfano-Crisfield.

    Corrected beam theory with a_e = a + chi h: opening C P, C = 8 a_e^3/(b E h^3), and
    G = 12 P^2 a_e^2/(b^2 E h^3) = G_c while the crack runs. So P = K/a_e with
    K = b sqrt(G_c E h^3/12), opening 8 K a_e^2/(b E h^3), and a follows from the opening alone. The
    crack length of the computation is that of the energy spent, a = a_0 + D/(G_c b). Facets are
    fine until ``zone`` [mm] beyond the crack of the theory. Up to the opening ``finer`` [mm] steps
    are a fifth of the others, so that a row is near the peak.
    """
    K = math.sqrt(m.b * m.G_I * m.rigidity / 12)

    def arm(opening: float) -> float:
        return max(math.sqrt(opening * m.rigidity / (8 * K)), a_0 + m.chi * m.h)

    def load(opening: float) -> float:
        return opening * m.rigidity / (8 * arm(opening) ** 3)

    # Fine where the crack runs, and a bit around.
    fine = min(math.ceil(arm(end) - m.chi * m.h + zone), length - 4)
    problem, facets = open_beam(element_size, rows, degree, m, length, a_0, fine, kinematics)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {
            "force [N]": problem.reaction(facets.find(UPPER_LEFT))[1],
            "force_exact [N]": load(problem.t),
            "crack [mm]": a_0 + problem.energy().damage / (m.G_I * m.b),
            "crack_exact [mm]": arm(problem.t) - m.chi * m.h,
        }

    options = vmdg.SolveOptions(progress=True, verbose=verbose)
    openings = np.linspace(end / steps, end, steps)
    first = np.linspace(0.2 * end / steps, end, 5 * steps)
    openings = np.append(first[first < finer], openings[openings >= finer])
    result = vmdg.solve(problem, openings, options, monitor)
    history = result.history
    first, last = history.rows[0], history.rows[-1]
    pairs = [
        ("stiffness [N/mm]", first["force"] / first["load"], first["force_exact"] / first["load"]),
        ("peak load [N]", history["force"].max(), K / (a_0 + m.chi * m.h)),
        (f"load at {end:g} mm [N]", last["force"], last["force_exact"]),
        (f"crack at {end:g} mm [mm]", last["crack"], last["crack_exact"]),
    ]
    return compared("DCB", result, pairs, problem, degree)


def enf(
    friction: float = 0.0,
    element_size: float = 0.25,
    steps: int = 12,
    end: float = 1.49,
    rows: int = 2,
    degree: int = 2,
    verbose: bool = False,
    m: Laminate = ALFANO_CRISFIELD,
    L: float = 50.0,
    a_0: float = 40.0,
) -> Run:
    """End-notched flexure: 2 L = 100, a_0 = 40 mm, stable since a_0 > 0.7 L.

    Only the lower arm is supported at the left end; it carries the upper one by contact there.
    Equal arms bend alike and each carries P/4, so the contact force is P/4 and, since the crack
    faces slide, its friction is f = mu P/4. We assume no other contact: the crack faces are an
    interface over the first 6 mm and a slit beyond. (In the computation they touch over 1 mm with
    P/4 to 0.7 %, and the slit is open everywhere.) Each arm then has the moment P x/4 - f h/2 and
    the axial force f.
    From the section forces behind and ahead of the tip the energy release rate is a full square,

        G = 9 P^2 (a_e - 2 mu h/3)^2/(16 b^2 E h^3),  so that  P (a_e - 2 mu h/3) = K

    with K = 4/3 b sqrt(G_c E h^3) while the crack runs (an analysis of the kind of Carlsson,
    Gillespie and Pipes 1986). The work of P on the deflection C P, less the energy stored, is the
    work W of f on the slip of the crack faces before growth:

        C = (2 L^3 + 3 a_e^3 - 3 mu h a_e^2)/(8 b E h^3) + 3 L/(10 G_12 b h),
        W = 3 mu P^2 h a_e (a_e - 4 mu h/3)/(16 b E h^3).

    a_e = a + 0.42 chi h corrects for the tip, the last term of C for shear. The load at the end is
    compared at the crack length a = a_0 + D/(G_c b) of the energy spent on the bond. The history
    has load and crack length of the theory at the same deflection.
    """
    stations = (0.0, 6.0, a_0 - 4, a_0, L, 1.2 * L, 2 * L)
    sizes = element_size * np.array([1, 4, 1, 1, 1, 4])
    tagged = arms(stations, sizes, m.h, rows, a_0, contact=stations[1])
    problem, facets = build(m, tagged, degree, friction=friction), tagged.facet_tags

    G_c = m.G_I if math.isnan(m.G_II) else m.G_II
    tip, rubbed = 0.42 * m.chi * m.h, friction * m.h
    K = 4 / 3 * math.sqrt(m.b * G_c * m.rigidity)

    def compliance(a: float) -> float:
        bending = (2 * L**3 + 3 * a**3 - 3 * rubbed * a**2) / (8 * m.rigidity)
        return bending + 0.3 * L / (m.G12 * m.b * m.h)

    def driving(a: float) -> float:
        return K / (a - 2 * rubbed / 3)

    def arm(deflection: float) -> float:
        a = a_0 + tip
        if deflection <= compliance(a) * driving(a):
            return a
        return brentq(lambda a: compliance(a) * driving(a) - deflection, a, 2 * L)

    rest(problem, tagged, m.h, 2 * L)
    problem.dirichlet_points(at(L, m.h), lambda t: -t, "y")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        energy, exact = problem.energy(), arm(problem.t)
        return {
            "force [N]": -problem.reaction(facets.find(TOP))[1],
            "force_exact [N]": problem.t / compliance(exact),
            "crack [mm]": a_0 + energy.damage / (G_c * m.b),
            "crack_exact [mm]": exact - tip,
            "friction": energy.friction,
        }

    # The first step finds where the crack faces touch, whatever its size.
    options = vmdg.SolveOptions(progress=True, verbose=verbose)
    result = vmdg.solve(problem, np.linspace(end / steps, end, steps), options, monitor)
    history = result.history
    first, last = history.rows[0], history.rows[-1]
    a = a_0 + tip
    work = 3 * rubbed * first["force"] ** 2 * a * (a - 4 * rubbed / 3) / (16 * m.rigidity)
    crack = last["crack"]
    pairs = [
        ("stiffness [N/mm]", first["force"] / first["load"], 1 / compliance(a)),
        (f"load at a = {crack:.2f} mm [N]", last["force"], driving(crack + tip)),
    ]
    if friction > 0:
        pairs.insert(1, ("friction work before growth [N mm]", first["friction"], work))
    return compared(f"ENF, mu = {friction:g}", result, pairs, problem, degree)


def four_point(
    element_size: float = 0.5,
    run: float = 40.0,
    rows: int = 2,
    degree: int = 2,
    verbose: bool = False,
    m: Laminate = IM7_8552,
    outer: float = 203.2,
    inner: float = 101.6,
    a_0: float = 76.2,
) -> Run:
    """Four-point bend end-notched flexure (4ENF): the moment between the rollers is constant.

    Supports at the ends of the span ``outer``; on each of two rollers ``inner`` apart P/2 as dead
    load, which a loading nose that turns shares equally; the crack starts on the left and ends
    between them. With c = (outer - inner)/2 the moment there is M = P c/2, of which each arm
    carries one half until the crack has passed, so that

        G = M^2/(2 b) (1/(2 E I) - 1/(8 E I)) = 9 P^2 c^2/(16 b^2 E h^3),  I = b h^3/12,

    whatever the crack length: P = K/c with K = 4/3 b sqrt(G_c E h^3) while it runs (Martin and
    Davidson 1999). The mean deflection of the rollers is C P, by virtual work

        C = (c^3 + 3 c^2 (a_e - c))/(2 b E h^3) + (c^3 + 3 c^2 (outer - c - a_e))/(8 b E h^3)
            + 3 c/(10 G_12 b h),  a_e = a + 0.42 chi h.

    The crack faces touch at the support and under the roller, where they are an interface without
    friction, and are a slit beyond.
    """
    c = (outer - inner) / 2
    stations = (0.0, 6.0, c - 6, c + 6, a_0 - 4, a_0, a_0 + run + 10, outer - c, outer)
    sizes = element_size * np.array([1, 4, 1, 4, 1, 1, 4, 4])
    tagged = arms(stations, sizes, m.h, rows, a_0, contact=stations[3])
    problem = build(m, tagged, degree, friction=0.0)
    K, tip = 4 / 3 * math.sqrt(m.b * m.G_II * m.rigidity), 0.42 * m.chi * m.h

    def compliance(a: float) -> float:
        parted, whole = (c**3 + 3 * c**2 * (x - c) for x in (a + tip, outer - a - tip))
        return (parted + whole / 4) / (2 * m.rigidity) + 0.3 * c / (m.G12 * m.b * m.h)

    rest(problem, tagged, m.h, outer)
    rollers = c, outer - c
    for x in rollers:
        problem.point_load(at(x, m.h), lambda t: -t / 2, "y")
    heights = [node(problem, x, m.h) for x in rollers]

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        w = -sum(lift(problem, height) for height in heights) / 2
        a = a_0 + problem.energy().damage / (m.G_II * m.b)
        exact = min(w / compliance(a_0), K / c)
        return {"deflection [mm]": w, "crack [mm]": a, "force_exact [N]": exact}

    shown = {"progress": True, "verbose": verbose, "show": ("deflection",)}
    result = vmdg.solve(
        problem,
        np.array([0.3, 0.6, 20.0]) * K / c,
        vmdg.SolveOptions(unstable="trace", max_share=0.03, **shown),
        monitor,
        until=lambda problem: problem.energy().damage > run * m.G_II * m.b,
    )
    history = result.history
    w, P, a = (history[name] for name in ("deflection", "load", "crack"))
    running = a > a_0 + 10
    pairs = [
        ("stiffness [N/mm]", P[0] / w[0], 1 / compliance(a_0)),
        ("peak load [N]", P.max(), K / c),
        ("mean load while the crack runs [N]", P[running].mean(), K / c),
        (f"deflection at a = {a[-1]:.2f} mm [mm]", w[-1], compliance(a[-1]) * K / c),
    ]
    return compared("4ENF", result, pairs, problem, degree)
