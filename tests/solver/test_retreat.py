"""A machine never goes back: bars beside one that snaps are not worked a second time by the way the
snap is traced."""

from __future__ import annotations

from mpi4py import MPI

import basix.ufl
import numpy as np
import pytest
from dolfinx import mesh as dmesh

import vmdg

E, MU, PRESS = 1000.0, 0.5, 0.002

#: Where the brittle bar snaps [mm], by the motion of the grip, and its strength [MPa].
SNAP = 0.02


def two_bars(comm: MPI.Comm, brittle: float, laws: list[vmdg.Law], bodies: list, shears: bool):
    """Two bars of two halves a mm long between rigid grips, pulled by the load factor, or sheared
    by it after they were pressed; all nodes are guided across."""
    points = np.array([(x, y) for y in (0.0, 1.0, 2.0, 3.0) for x in (0.0, 1.0, 2.0)])
    cells = np.array([[b + i, b + i + 1, b + i + 3, b + i + 4] for b in (0, 6) for i in (0, 1)])
    some = slice(None) if comm.rank == 0 else slice(0)
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    split = dmesh.create_cell_partitioner(dmesh.GhostMode.shared_facet)
    mesh = dmesh.create_mesh(comm, cells[some], points[some], element, partitioner=split)
    count = mesh.topology.index_map(2).size_local
    own = np.arange(count, dtype=np.int32)
    x = dmesh.compute_midpoints(mesh, 2, own)
    tags = (2 * (x[:, 1] > 1.5) + (x[:, 0] > 1)).astype(np.int32)
    bonds = [
        vmdg.Interface(between=(2 * n, 2 * n + 1), law=law, frame="reference")
        for n, law in enumerate(laws)
    ]
    materials = {2 * n + i: body for n, body in enumerate(bodies) for i in (0, 1)}
    marks = dmesh.meshtags(mesh, 2, own, tags)
    problem = vmdg.Problem(mesh, marks, materials, bonds, degree=2, kinematics="small")
    axis = int(shears)
    end = lambda x: np.isclose(x[0], 2.0)  # noqa: E731
    problem.dirichlet(lambda x: np.isclose(x[0], 0.0), 0.0, axis)
    problem.dirichlet(end, lambda t: t, axis)
    across = -PRESS / 2 if shears else 0.0
    problem.dirichlet_points(lambda x: x[0] > -1, lambda x, t: across * x[0], 1 - axis)
    return problem, lambda p: {"force [N]": p.reaction(end)[axis]}


@pytest.mark.parametrize("steps", [2, 5, 40])
def test_friction_beside_a_snap(comm, steps):
    """The other bar slides; friction takes mu N per length of slip, and only once."""
    strength, k = E / 4 * SNAP, E / 4
    brittle = vmdg.Debonding(strength, 0.3 * SNAP)
    rubs = E * PRESS / 2 * MU
    body = vmdg.NeoHookean(E=E, nu=0.0)
    problem, look = two_bars(comm, SNAP, [vmdg.Contact(MU), brittle], [body, body], True)
    vmdg.solve(problem, [0.0])  # presses them
    history = vmdg.solve(problem, np.linspace(0, 0.08, steps + 1)[1:], monitor=look).history
    assert history["force"][-1] == pytest.approx(rubs, rel=1e-6)
    assert problem.energy().friction == pytest.approx(rubs * (0.08 - rubs / k), rel=1e-4)


@pytest.mark.parametrize("steps", [2, 5, 40])
def test_flow_beside_a_snap(comm, steps):
    """The other bar flows, with kinematics of one strain: it hardens once."""
    brittle = vmdg.Debonding(E / 2 * SNAP, 0.3 * SNAP)
    flows = vmdg.J2(E=E, nu=0.0, yield_stress=0.5, hardening=200.0)
    body = vmdg.NeoHookean(E=E, nu=0.0)
    once, _ = two_bars(comm, SNAP, [vmdg.Bonded(), vmdg.Bonded()], [flows, flows], False)
    vmdg.solve(once, [0.01, 0.04, 0.08])
    problem, look = two_bars(comm, SNAP, [vmdg.Bonded(), brittle], [flows, body], False)
    vmdg.solve(problem, np.linspace(0, 0.08, steps + 1)[1:], monitor=look)
    assert problem.energy().plastic == pytest.approx(once.energy().plastic / 2, rel=0.03)
