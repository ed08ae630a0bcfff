"""Bodies with unsymmetric moduli: flow that is not associated, a back stress that fades."""

from __future__ import annotations

import numpy as np
import pytest
from support.checks import tangent_error, tangent_matrix
from support.problems import joined, partly_damaged
from support.scenes import EVERY_CELL, EVERY_DEGREE, two_blocks

import vmdg

E, NU = 4000.0, 0.3
FADING = vmdg.J2(E, NU, 60.0, kinematic=8000.0, recovery=400.0)
SOIL = vmdg.DruckerPrager(E, NU, 80.0, 20.0, dilatancy=5.0, hardening=400.0)
pytestmark = pytest.mark.filterwarnings("ignore:plastic flow keeps the volume")
CASES = pytest.mark.parametrize(
    ("material", "kinematics"), [(FADING, "small"), (SOIL, "small"), (SOIL, "finite")]
)


@CASES
@EVERY_DEGREE
@EVERY_CELL
def test_tangent(comm, cell, degree, material, kinematics):
    """The derivative of the residual, and not symmetric in the bodies that flow."""
    problem = partly_damaged(
        comm, cell, degree, materials=(material, material), kinematics=kinematics
    )
    assert tangent_error(problem, tangent_matrix(problem)) < 1e-7
    moduli = problem.discretization.bodies.points.state.moduli
    off = np.abs(moduli - moduli.transpose(0, 1, 3, 2)).max(initial=0.0)
    assert comm.allreduce(float(off)) > 3e-4 * E


@CASES
def test_restart(comm, out, material, kinematics):
    """A run continued from a checkpoint has the history of the uninterrupted one, all of it."""

    def problem():
        scene = two_blocks(comm, "quadrilateral", n=2, distortion=0.03)
        materials = (material, material)
        given = joined(scene, vmdg.Bonded(), materials, kinematics=kinematics, degree=2)
        given.dirichlet(scene.facet_tags.find(1), 0.0)
        given.dirichlet(scene.facet_tags.find(2), lambda t: (t, 0.3 * t))
        return given

    loads = np.linspace(0.0, 0.06, 7)[1:]
    whole, again = problem(), problem()
    vmdg.solve(whole, loads[:3], vmdg.SolveOptions(checkpoint=out / "run"))
    vmdg.solve(whole, loads[3:])
    assert vmdg.read_checkpoint(again, out / "run") is not None
    vmdg.solve(again, loads[3:])
    energy = whole.energy()
    assert energy.plastic > 0.02 * energy.external
    assert again.energy().plastic == pytest.approx(energy.plastic, rel=1e-9)
    ours, theirs = (p.body_state(1).history for p in (whole, again))
    assert list(ours) == list(material.fields)
    for name, values in ours.items():
        assert theirs[name] == pytest.approx(values, abs=1e-10)
