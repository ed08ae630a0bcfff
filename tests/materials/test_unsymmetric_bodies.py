"""Bodies with unsymmetric moduli: flow that is not associated, a back stress that fades."""

from __future__ import annotations

import numpy as np
import pytest
from support.checks import tangent_error, tangent_matrix
from support.problems import partly_damaged

import vmdg

E, NU = 4000.0, 0.3
FADING = vmdg.J2(E, NU, 60.0, kinematic=8000.0, recovery=400.0)
SOIL = vmdg.DruckerPrager(E, NU, 80.0, 20.0, dilatancy=5.0, hardening=400.0)
pytestmark = pytest.mark.filterwarnings("ignore:plastic flow keeps the volume")


@pytest.mark.parametrize(
    ("cell", "degree", "material", "kinematics"),
    [
        ("triangle", 2, SOIL, "finite"),
        ("quadrilateral", 1, FADING, "small"),
        ("quadrilateral", 2, SOIL, "small"),
        ("tetrahedron", 2, FADING, "small"),
        ("hexahedron", 1, SOIL, "finite"),
    ],
)
def test_tangent(comm, cell, degree, material, kinematics):
    """The derivative of the residual, and not symmetric in the bodies that flow."""
    problem = partly_damaged(
        comm, cell, degree, materials=(material, material), kinematics=kinematics
    )
    assert tangent_error(problem, tangent_matrix(problem)) < 1e-7
    moduli = problem.discretization.bodies.points.state.moduli
    off = np.abs(moduli - moduli.transpose(0, 1, 3, 2)).max(initial=0.0)
    assert comm.allreduce(float(off)) > 3e-4 * E
