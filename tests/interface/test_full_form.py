"""The full form (26) with its traction jump, the fine scales (24) and the error indicator."""

from __future__ import annotations

import numpy as np
import pytest
from support.checks import assert_residual_is_energy_derivative, gather, tangent_error
from support.problems import MATERIALS, couple, put, set_displacement, through
from support.scenes import DIMENSION, two_blocks

import vmdg
from vmdg.meshes import blocks
from vmdg.output.values import facet_scalar

BOTH_FORMS = pytest.mark.parametrize("jump", [False, True], ids=["(27)", "(26)"])
LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2)


# Patch tests


# Consistency


def moved(comm, cell, law, jump, frame="corotating"):
    """Two different blocks after two motions: damaged where the law can be."""
    scene = two_blocks(comm, cell, 2 if cell == "quadrilateral" else 1)
    problem = couple(scene, law, MATERIALS, traction_jump=jump, frame=frame)
    motions = ((0.03, 0.01, 0.02), 0.4), ((0.06, 0.04, 0.01), 0.5)
    return through(problem, *(lambda m=m: put(problem, scene, *m) for m in motions))


@BOTH_FORMS
@pytest.mark.parametrize("law", [vmdg.Bonded(), LAW], ids=["tie", "debonding"])
def test_residual_is_the_derivative_of_the_energy(comm, law, jump):
    """Residual (27) and (26) = d/du of the energy with zeta held, entry by entry to rounding.

    With the frame that turns it has the frame's couple besides: see the energies in test_motion.
    """
    problem = moved(comm, "quadrilateral", law, jump, frame="reference")
    assert_residual_is_energy_derivative(problem)


@pytest.mark.parametrize("law", [vmdg.Bonded(), LAW], ids=["tie", "debonding"])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_tangent_of_full_form(comm, cell, law):
    """K.v = central differences of the residual of (26), tied and debonding, turned."""
    problem = moved(comm, cell, law, True)
    assert tangent_error(problem) < 1e-7


# Fine scales


def first_piola(F, material):
    """P of (86) at one F (d, d), plane strain for d = 2: mu (F - F^-T) + lambda J (J-1) F^-T."""
    mu, lmbda = material.parameters["mu"], material.parameters["lmbda"]
    J, G = np.linalg.det(F), np.linalg.inv(F).T
    return mu * (F - G) + lmbda * J * (J - 1) * G


@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
def test_fine_scales(comm, cell):
    """Fine scales = (24) with P of both sides, g and zeta computed beside the engine.

    u_1 = -delta_s.[[P.N]] + delta_1^T.s and u_2 = -delta_s.[[P.N]] - delta_2^T.s, s = g - zeta,
    so that their difference is s. The indicator is their root mean square over a facet.
    """
    d = DIMENSION[cell]
    scene = blocks(comm, cell, (2, 2, 1), interface=(0.9, 1.2))
    problem = couple(scene, LAW, MATERIALS, frame="reference")
    gradient = {
        1: np.array([[0.02, 0.01, 0.0], [-0.02, 0.01, 0.01], [0.0, 0.02, -0.01]])[:d, :d],
        2: np.array([[0.03, -0.01, 0.01], [0.01, -0.02, 0.0], [0.02, 0.0, 0.01]])[:d, :d],
    }
    move = np.array([0.05, 0.02, -0.01])[:d, None]
    set_displacement(
        problem.u, scene.cell_tags, lambda x, tag: gradient[tag] @ x[:d] + (tag == 2) * move
    )
    problem.discretization.update_stabilization()
    problem.step.assemble_residual()
    state, stabilization = problem.state[0], problem.stabilization[0]
    facet = problem.discretization.active[0].quadrature.facet

    N = state.normal
    jump = sum(
        sign * N @ first_piola(np.eye(d) + gradient[tag], MATERIALS[tag - 1]).T
        for tag, sign in ((1, 1), (2, -1))
    )
    g = state.points[:, :d] @ (gradient[2] - gradient[1]).T + move.T
    s = g - state.gap
    tau = np.linalg.inv(stabilization.tau / stabilization.safety[:, None, None])  # tau_1 + tau_2
    delta = stabilization.delta
    tau_1, tau_2 = tau @ delta[:, 0], tau @ delta[:, 1]
    delta_s = np.linalg.inv(np.linalg.inv(tau_1) + np.linalg.inv(tau_2))[facet]
    expected = np.stack(
        [
            -np.einsum("pij,pj->pi", delta_s, jump)
            + sign * np.einsum("pji,pj->pi", delta[facet, a], s)
            for a, sign in enumerate((1, -1))
        ],
        axis=1,
    )
    found = problem.fine_scale(0)
    assert np.abs(gather(comm, state.gap)).max() > 0.01
    # Tensors of size 1e-5 to 1e5 multiply: 1e-10 of the move of .05 mm.
    assert found == pytest.approx(expected, abs=5e-12)
    assert found[:, 0] - found[:, 1] == pytest.approx(s, abs=1e-14)
    for f, value in enumerate(facet_scalar(problem, 0, "fine_scale")):
        mine = facet == f
        square = state.weights[mine] @ (expected[mine] ** 2).sum(axis=(1, 2))
        assert value == pytest.approx(np.sqrt(square / state.weights[mine].sum()), rel=1e-8)


# Error indicator
