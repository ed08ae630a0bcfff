"""A strip that a moment peels off rigid ground, in plane stress.

By the elementary theory of bending of a strip of thickness t whose stress grows with the slope
alpha E beyond the yield stress Y, as Kinloch, Lau and Williams (1994) and, with alpha = 0, Kim and
Aravas (1988) use it for peel tests, the moment at k times the curvature K_e = 2 Y/(E t) is

    M/M_e = k,                                         k <= 1,  M_e = Y t^2/6,
    M/M_e = (1 - alpha)(3/2 - 1/(2 k^2)) + alpha k,    k >= 1.

While the crack runs, far behind it all of the strip is bent by M. The work M K per new area is the
toughness G_c of the bond and int M dK, so that G_c = int K dM. In the parameter of Kim and Aravas

    eta = 6 E G_c/(Y^2 t) = k^2,                                                     k <= 1,
    eta = 1 + 2 (1 - alpha)(1 - 1/k) + alpha (k^2 - 1),                              k >= 1:

the strip stays elastic up to eta = 1; without hardening no moment peels it off from eta = 3 on.
"""

from __future__ import annotations

from typing import NamedTuple

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import CellType, GhostMode, create_rectangle
from numpy.typing import NDArray
from scipy.optimize import brentq

import vmdg
from parts.plasticity.rows import Row
from parts.verification.checks import describe

E, NU, Y, ALPHA = 70e3, 0.3, 100.0, 0.05  # MPa, -, MPa, -
METAL = vmdg.J2(E, NU, Y, hardening=ALPHA / (1 - ALPHA) * E)
G_C, STRENGTH = 0.02, 10.0  # N/mm, MPa
#: Parameters of the strips, and the growth of the crack in lengths of its process zone.
ETAS, GROWTH = (0.8, 1.5, 2.5), 3.0


class Peeled(NamedTuple):
    """A steady state.

    Attributes:
        moment: Of a strip of unit width [N].
        work: Per new area, relative to the toughness.
        flow: Plastic part of it.
    """

    moment: float
    work: float
    flow: float


def thickness_of(eta: float) -> float:
    """Thickness of a strip [mm]."""
    return 6 * E * G_C / (Y**2 * eta)


def theory(eta: float) -> Peeled:
    """The steady state by elementary bending."""
    t = thickness_of(eta)

    def excess(k: float) -> float:
        return 1 + 2 * (1 - ALPHA) * (1 - 1 / k) + ALPHA * (k**2 - 1) - eta

    if eta <= 1:
        return Peeled(float(np.sqrt(eta)) * Y * t**2 / 6, 2.0, 0.0)
    k = brentq(excess, 1.0, 100.0)
    moment = (1 - ALPHA) * (1.5 - 0.5 / k**2) + ALPHA * k
    # Over M_e K_e = Y^2 t/(3 E); that of fibres stress^2/(2 E), from the axis to the surface.
    fibres = np.linspace(0.0, k, 20001)
    stresses = np.minimum(fibres, 1 - ALPHA + ALPHA * fibres)
    stored = 1.5 * float(np.trapezoid(stresses**2, fibres)) / k
    work = 2 * moment * k / eta
    return Peeled(moment * Y * t**2 / 6, work, work - 1 - 2 * stored / eta)


def strip(eta: float, facet: float, rows: int) -> tuple[vmdg.Problem, float]:
    """A strip on its ground, bent by the load factor [N], and the length of its process zone [mm].

    Args:
        eta: Its parameter.
        facet: Length of facets, relative to the process zone.
        rows: Cells across the strip.
    """
    t = thickness_of(eta)
    zone = (E * t**3 * G_C / STRENGTH**2) ** 0.25
    count = round((GROWTH + 6) / facet)
    length = count * facet * zone
    corners = (0.0, -t / rows), (length, t)
    kind, ghosts = CellType.quadrilateral, GhostMode.shared_facet
    mesh = create_rectangle(MPI.COMM_WORLD, corners, (count, rows + 1), kind, ghost_mode=ghosts)
    cells = vmdg.split_cells(mesh, lambda x: -x[1], "strip")
    bond = vmdg.Interface(
        between=("outside", "strip"),
        law=vmdg.Debonding(STRENGTH, 2 * G_C / STRENGTH),
        initial_damage=lambda x: np.where(x[0] < zone, 1.0, 0.0),
    )
    bodies = {"outside": vmdg.Rigid(), "strip": METAL}
    given = {"degree": 2, "kinematics": "small", "plane": "stress"}
    problem = vmdg.Problem(mesh, cells, bodies, [bond], **given)

    def moment(x: NDArray, factor: float) -> NDArray:
        """Tractions of a bending moment."""
        along = 12 * factor / t**3 * (x[1] - t / 2)
        return np.stack([along, 0 * along])

    problem.traction(lambda x: np.isclose(x[0], 0.0) & (x[1] > -1e-9), moment)
    problem.dirichlet(lambda x: np.isclose(x[0], length) & (x[1] > -1e-9), 0.0)
    return problem, zone


def peel(eta: float, facet: float, rows: int) -> tuple[Peeled, str]:
    """The second half of the crack's growth, and the mesh; arguments as for :func:`strip`."""
    problem, zone = strip(eta, facet, rows)
    crack, scale = vmdg.CrackGrowth(problem, 0), theory(eta).moment
    history = vmdg.solve(
        problem,
        scale * np.array([0.5, 0.8, 2.0]),
        vmdg.SolveOptions(unstable="trace", energy=True),
        lambda problem: {"moment [N]": problem.t} | crack(),
        until=lambda problem: crack.length > (1 + GROWTH) * zone,
    ).history
    # Work on the bond, not the length of the crack, which is known to a part of a facet.
    half = int(np.searchsorted(history["crack"], (1 + GROWTH / 2) * zone))
    bond, work, flow = (
        history[name][-1] - history[name][half] for name in ("damage", "external", "plastic")
    )
    moment = float(history["moment"][half:].mean())
    return Peeled(moment, work / bond, flow / bond), describe(problem, 2)


def peels(coarse: bool = False) -> list[Row]:
    """Strips of several thicknesses against elementary bending."""
    facet, rows = (0.34, 3) if coarse else (0.25, 8)
    quantities = "moment [N]", "work / toughness [-]", "plastic work / toughness [-]"
    lines = []
    for eta in (1.5,) if coarse else ETAS:
        found, mesh = peel(eta, facet, rows)
        case, source = f"peeled strip, eta = {eta:g}", "elementary bending"
        lines += [
            Row(case, quantity, ours, exact, source, mesh)
            for quantity, ours, exact in zip(quantities, found, theory(eta), strict=True)
            if exact > 0
        ]
    return lines
