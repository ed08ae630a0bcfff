"""A tangent that cannot have changed is neither assembled nor factorized again."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import joined
from support.scenes import two_blocks

import vmdg
from vmdg.solver import linear as linear_solver
from vmdg.solver.newton import Newton
from vmdg.solver.stepping import Stepper
from vmdg.solver.tangent import Tangent

STRENGTH = 20.0
LOADS = np.linspace(0.002, 0.02, 10)


def pulled(comm, law: vmdg.Law, **options) -> vmdg.Problem:
    """Two blocks, one end held, the other moved by the load factor along x, half of it along y."""
    scene = two_blocks(comm, "quadrilateral", 4)
    problem = joined(scene, law, **options)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: (t, t / 2))
    return problem


def run(problem: vmdg.Problem, loads=LOADS) -> tuple[Newton, np.ndarray]:
    """The general solver after these steps, and the reactions of all of them."""
    stepper = Stepper(problem, vmdg.SolveOptions(condensed=False))
    forces = []
    for t in loads:
        assert stepper.step(t).converged
        forces.append(np.linalg.norm(problem.forces.x.array))
    return stepper._newton, np.array(forces)


@pytest.mark.parametrize("limit", [0, 10_000])
@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Debonding(1e4, critical_gap=0.1)])
def test_steps_without_damage(comm, monkeypatch, law, limit):
    """Ten steps at small strain: one tangent, one factorization; the forces are proportional."""
    monkeypatch.setattr(linear_solver, "MEDIUM", limit)
    newton, forces = run(pulled(comm, law, kinematics="small"))
    counts = newton.linear.counts
    assert newton._tangent.assemblies == 1
    assert counts.factorizations + counts.setups == 1
    assert counts.solves >= 1
    # Linear: the tolerance of the steps is 1e-9 of the largest force.
    assert forces == pytest.approx(forces[-1] * LOADS / LOADS[-1], rel=1e-7)
    newton.destroy()


def test_finite_strain_assembles_every_time(comm):
    """There the tangent changes with the displacement."""
    newton, _ = run(pulled(comm, vmdg.Bonded()))
    assert newton._tangent.assemblies >= len(LOADS)
    newton.destroy()


def test_damage_and_back(comm):
    """Damage asks for other tangents, unloading for that of the bond; the path stays the same."""
    law = vmdg.Debonding(STRENGTH, critical_gap=0.05)
    loads = [0.004, 0.03, 0.06, 0.05, 0.04, 0.03]
    problem = pulled(comm, law, kinematics="small")
    newton, forces = run(problem, loads)
    assert problem.energy().dissipated > 0
    again = pulled(comm, law, kinematics="small")
    stepper = Stepper(again, vmdg.SolveOptions(condensed=False))
    # Nothing is held: every tangent is assembled.
    stepper._newton._tangent._constant = False
    others = []
    for t in loads:
        stepper.step(t)
        others.append(np.linalg.norm(again.forces.x.array))
    assert forces == pytest.approx(others, rel=1e-7)
    assert newton._tangent.assemblies < stepper._newton._tangent.assemblies
    newton.destroy()
    stepper.close()


def test_lift_of_a_held_tangent(comm):
    """K.u of prescribed dofs from the columns that the matrix has lost, to rounding."""
    problem = pulled(comm, vmdg.Bonded(), kinematics="small")
    problem.begin_step(0.01, 1.0)
    problem.assemble_residual()
    tangent = Tangent(problem, keeps_bulk=False)
    u, expected = tangent.matrix.createVecs()
    owned = problem.discretization.owned
    u.array[problem.owned_prescribed] = problem.prescribed_values(0.01)[problem.prescribed < owned]
    tangent.assemble()
    tangent.matrix.mult(u, expected)
    for _ in range(2):
        found = expected.duplicate()
        tangent.assemble()
        tangent.lift(u, found)
        tangent.constrain()
        found.axpy(-1.0, expected)
        assert found.norm() < 1e-13 * expected.norm()
    assert tangent.assemblies == 1
    tangent.destroy()
