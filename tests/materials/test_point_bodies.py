"""Bodies whose stress is computed at points, in the forms: residual, tangent, states."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from scipy.optimize import brentq
from support.checks import modes, tangent_error, tangent_matrix
from support.problems import joined, partly_damaged
from support.scenes import EVERY_CELL, EVERY_DEGREE, two_blocks

import vmdg
from vmdg import Mode

E, NU = 4000.0, 0.3
METAL = vmdg.J2(E, NU, 60.0, hardening=400.0, saturation=90.0, exponent=20.0)
ELASTIC = vmdg.NeoHookean(E=2 * E, nu=NU)
BODIES = {"both": (METAL, METAL), "one": (METAL, ELASTIC)}
KINEMATICS = pytest.mark.parametrize("kinematics", ["small", "finite"])


@EVERY_CELL
@EVERY_DEGREE
@KINEMATICS
@pytest.mark.parametrize("frame", ["reference", "corotating"])
def test_tangent(comm, cell, degree, kinematics, frame):
    """The derivative of the residual through return maps of bodies and bond; also on one side."""
    if kinematics == "small" and frame == "corotating":
        pytest.skip("the frame is fixed at small strain")
    materials = BODIES["both" if frame == "reference" else "one"]
    options = {"materials": materials, "kinematics": kinematics, "frame": frame}
    problem = partly_damaged(comm, cell, degree, **options)
    matrix = tangent_matrix(problem)
    assert tangent_error(problem, matrix) < 1e-7
    alpha = problem.discretization.bodies.points.state.next[0][:, 0]
    assert comm.allreduce(float(alpha.max(initial=0.0)), MPI.MAX) > 1e-3
    assert Mode.TENSION in modes(problem)


# Bar of two parts with a bond, in uniaxial stress: hardens, then debonds and unloads.
SIGMA, H = 60.0, 200.0
BAR = vmdg.J2(E, NU, SIGMA, hardening=H)
BOND = vmdg.Debonding(strength=70.0, critical_gap=0.5)
LENGTH = 2.0
LOADS = [0.01, 0.02, 0.05, 0.1, 0.11, 0.2, 0.4, 0.55, 0.549, 0.57]


def series(loads, small):
    """Nominal stress P of the bar in series with its bond at these elongations.

    The bar: P l = E (ln l - eps_p) with Hencky's energy, E (l - 1 - eps_p) at small strain; it
    flows at SIGMA + H eps_p. The bond: P = T_c (1 - zeta/zeta_c) once it fails.
    """

    def elastic(elongation, plastic):
        """P of the bar without further flow."""
        if small:
            return E * (elongation / LENGTH - plastic)
        x = np.log1p(elongation / LENGTH)
        return E * (x - plastic) * np.exp(-x)

    def flowing(plastic):
        """P and elongation of the bar that flows."""
        stress = SIGMA + H * plastic
        x = plastic + stress / E
        return (stress, LENGTH * x) if small else (stress * np.exp(-x), LENGTH * np.expm1(x))

    def root(function, low, high):
        return brentq(function, low, high, xtol=1e-15)

    T, slope = BOND.strength, BOND.strength / BOND.critical_gap
    onset = root(lambda p: flowing(p)[0] - T, 0.0, 0.1)
    plastic = gap = 0.0
    for u in loads:
        P = elastic(u - gap, plastic)
        if P > flowing(plastic)[0] and gap == 0.0:
            further = u < flowing(onset)[1]
            plastic = root(lambda p, u=u: flowing(p)[1] - u, 0.0, onset) if further else onset
            P = elastic(u, plastic)
        if P > T - slope * gap:
            known = u, plastic
            gap = root(
                lambda g, k=known: T - slope * g - elastic(k[0] - g, k[1]), gap, BOND.critical_gap
            )
            P = T - slope * gap
        yield P


@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
@KINEMATICS
def test_bar_in_series_with_a_bond(comm, cell, kinematics):
    """Loading, flow, debonding with elastic unloading, unloading and reloading: closed form."""
    scene = two_blocks(comm, cell, n=1)
    problem = joined(scene, BOND, (BAR, BAR), kinematics=kinematics, degree=2)
    facets = scene.facet_tags
    problem.dirichlet(facets.find(1), 0.0, "x")
    problem.dirichlet(facets.find(2), lambda t: t, "x")
    for k, name in ((1, "y"), (2, "z")):
        problem.dirichlet(lambda x, k=k: np.isclose(x[k], 0.0), 0.0, name)
    found = []
    for load in LOADS:
        vmdg.solve(problem, [load], vmdg.SolveOptions(relative_tolerance=1e-12))
        found.append(-problem.reaction(facets.find(1))[0])
    expected = list(series(LOADS, kinematics == "small"))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * SIGMA)
