"""Forces of the bodies and tau_s are evaluated once a state."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem

import vmdg
from vmdg.assembly import discretization
from vmdg.interface.active import ActiveInterface
from vmdg.meshes import blocks

STRENGTH = 10.0


def pulled(comm, material: vmdg.Material, kinematics: str = "small") -> vmdg.Problem:
    """Two bonded squares, pulled and sheared apart by the load factor."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (4, 4))
    law = vmdg.Debonding(strength=STRENGTH, critical_gap=0.5)
    problem = vmdg.Problem(
        mesh,
        cells,
        {1: material, 2: material},
        [vmdg.Interface(between=(1, 2), law=law)],
        kinematics=kinematics,
    )
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda x, t: t * np.stack([0.01 + 0 * x[0], 0.002 * x[1]]))
    return problem


@pytest.mark.parametrize("condensed", [False, None])
def test_bodies_are_assembled_once_a_displacement(comm, monkeypatch, condensed):
    """As often as the displacement changes between two residuals, not once a residual."""
    problem = pulled(comm, vmdg.NeoHookean(E=1000.0, nu=0.3))
    problem.compile()
    bulk = problem.discretization._residual_forms.bulk
    counts = {"bodies": 0, "residuals": 0, "changes": 0}
    assemble, last = fem.assemble_vector, [np.full_like(problem.u.x.array, np.nan)]

    def counted(vector, form, *others):
        counts["bodies"] += form is bulk
        return assemble(vector, form, *others)

    evaluate = problem.discretization.assemble_residual

    def watched(dt, hold, loads):
        counts["residuals"] += 1
        counts["changes"] += not np.array_equal(last[0], problem.u.x.array)
        last[0] = problem.u.x.array.copy()
        return evaluate(dt, hold, loads)

    monkeypatch.setattr(discretization.fem, "assemble_vector", counted)
    monkeypatch.setattr(problem.discretization, "assemble_residual", watched)
    vmdg.solve(problem, np.linspace(0.25, 2, 8), vmdg.SolveOptions(condensed=condensed))
    local = problem.mesh.topology.index_map(problem.mesh.topology.dim).size_local > 0
    assert counts["bodies"] == counts["changes"] or not local
    assert counts["changes"] < counts["residuals"]


def test_constants_of_a_material_may_change(comm):
    """Twice the stiffness at the same displacement gives twice the forces of the bodies."""
    mesh, cells, _ = blocks(comm, "quadrilateral", (4, 4))
    stiffness = fem.Constant(mesh, 3.0)

    def energy(F, parameters):
        C = F.T * F
        return stiffness * (ufl.inner(C, C) + parameters["b"] * ufl.tr(C))

    material = vmdg.Hyperelastic(energy, {"b": -1.0})
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(mesh, cells, {1: material, 2: material}, [tie])
    problem.u.interpolate(lambda x: np.stack([0.1 * x[0] * x[1], 0.05 * x[0] ** 2]))
    problem.assemble_residual()
    first = problem.bulk_forces().copy()
    stiffness.value *= 2
    problem.assemble_residual()
    assert problem.bulk_forces() == pytest.approx(2 * first, rel=1e-13, abs=1e-13)


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_stabilization_is_derived_once_at_small_strain(comm, monkeypatch, kinematics):
    """tau_s is constant there; at finite strain it follows every step."""
    problem = pulled(comm, vmdg.NeoHookean(E=1000.0, nu=0.3), kinematics)
    derive, calls = ActiveInterface.derive_stabilization, []

    def counted(self, *kept):
        calls.append(not kept)
        return derive(self, *kept)

    monkeypatch.setattr(ActiveInterface, "derive_stabilization", counted)
    vmdg.solve(problem, np.linspace(0.25, 1, 4))
    assert sum(calls) == 0 if kinematics == "small" else sum(calls) >= 4
