"""Contact in explicit steps: massless nodes, the force of an impact, and friction."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from support.problems import of_two
from support.scenes import EVERY_CELL, two_blocks

import vmdg
from vmdg.dynamics.contact_nodes import ContactNodes
from vmdg.meshes import blocks

ENERGY = vmdg.SolveOptions(energy=True)
BODY = vmdg.NeoHookean(E=1.0, nu=0.0)


def bars(comm, n, cell="quadrilateral", kinematics="small", friction=0.0):
    """Two bars of unit length, modulus and density that touch, the first one with a speed."""
    scene = blocks(comm, cell, divisions=(n, 1, 1))
    problem = of_two(
        scene,
        vmdg.Contact(friction=friction),
        (BODY,) * 2,
        kinematics=kinematics,
        density={1: 1.0, 2: 1.0},
    )
    d, velocity = scene.mesh.geometry.dim, fem.Function(problem.space)
    first = np.unique(problem.space.dofmap.list[problem.discretization.bodies.cells_of[1]])
    velocity.x.array.reshape(-1, d)[first, 0] = 0.01
    return problem, velocity, first


def hit(problem, velocity, first, times):
    """History: force per speed/2, least opening, and the first bar's share of the momentum."""
    d, comm = problem.mesh.geometry.dim, problem.comm
    mine = first[first < problem.discretization.owned // d]

    def monitor(problem):
        v = problem.velocity.x.array[: problem.discretization.owned]
        P = (problem.step.motion.lumped * v)[::d]
        parts = comm.allreduce(np.array([P[mine].sum(), P.sum()]))
        overlap = vmdg.extremes(problem, 0, lambda state: state.opening[:, 0])[0]
        force = -problem.mean(0).traction[0] / 0.005
        return {"force": force, "overlap": overlap, "share": parts[0] / parts[1]}

    scheme = vmdg.CentralDifferences()
    return vmdg.solve_dynamics(problem, times, scheme, velocity, monitor, ENERGY).history


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_impact(comm, kinematics):
    """Force, duration and speeds of an impact within 1 %, no overlap, and no noise."""
    times = np.linspace(0.0, 2.4, 481)[1:]
    history = hit(*bars(comm, 80, kinematics=kinematics), times)
    steady, touching = (times > 0.2) & (times < 1.8), history["force"] > 1e-6
    assert np.abs(history["force"][steady] - 1).max() < 0.01
    assert times[touching][0] < 0.01
    assert times[touching][-1] == pytest.approx(2.0, rel=0.01)
    assert abs(history["share"][-1]) < 0.01
    assert history["overlap"].min() > -1e-12
    assert np.abs(history["imbalance"]).max() < 1e-3 * history["kinetic"][0]


@EVERY_CELL
def test_mass_is_kept(comm, cell):
    """Massless nodes give all of their mass to their neighbours."""
    problem, *_ = bars(comm, 3, cell)
    sums = problem.step.motion.row_sums
    nodes, d = ContactNodes(problem, sums), problem.mesh.geometry.dim
    on = np.isclose(problem.space.tabulate_dof_coordinates()[: len(sums) // d, 0], 1.0)
    assert np.array_equal(nodes.masses == 0, np.repeat(on, d))
    assert comm.allreduce(nodes.masses.sum()) == pytest.approx(comm.allreduce(sums.sum()))
    assert comm.allreduce(len(nodes.dofs)) == 2 * d * (2 if d == 2 else 4)
    nodes.free()


@pytest.mark.parametrize(
    "law", [vmdg.Bonded(), vmdg.Debonding(strength=1.0, critical_gap=0.1, friction=0.5)], ids=str
)
def test_nodes_of_bonds_keep_their_mass(comm, law):
    """Where a bond softens, lumped masses are more accurate."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = of_two(scene, law, (BODY,) * 2, density={1: 1.0, 2: 1.0})
    nodes = ContactNodes(problem, problem.step.motion.row_sums)
    assert not nodes.exist
    assert np.array_equal(nodes.masses, problem.step.motion.row_sums)


def test_bar_hits_a_wall(comm):
    """SDNV100 of code_aster (V5.03.100), in one dimension: 200 mm of steel at 100 m/s press with
    rho c V = 4 GPa for 80 us and leave as fast."""
    n, L, E, rho, V = 80, 200.0, 2e5, 8e-9, 1e5
    scene = blocks(comm, "quadrilateral", (n, 1, 1), 2 * L, 20.0, interface=(L, L))
    problem = of_two(
        scene,
        vmdg.Contact(),
        (vmdg.NeoHookean(E=E, nu=0.0), vmdg.Rigid()),
        kinematics="small",
        density={1: rho},
    )
    x = problem.space.tabulate_dof_coordinates()[:, 0]

    def watched(problem):
        v = problem.velocity.x.array.reshape(-1, 2)[x < 1e-9, 0]
        rear = comm.allreduce(v.sum(), MPI.SUM) / comm.allreduce(len(v), MPI.SUM)
        return {"stress [MPa]": -problem.mean(0).traction[0], "rear [mm/s]": rear}

    start = lambda x: np.array([V * np.ones(x.shape[1]), 0 * x[0]])  # noqa: E731
    times = np.linspace(0.0, 1.2e-4, 241)[1:]
    scheme = vmdg.CentralDifferences()
    history = vmdg.solve_dynamics(problem, times, scheme, start, watched).history
    steady = (times > 5e-6) & (times < 7.5e-5)
    assert history["stress"][steady] == pytest.approx(np.full(steady.sum(), 4000.0), rel=0.01)
    assert times[history["stress"] > 40][-1] == pytest.approx(8e-5, rel=0.02)
    assert history["rear"][(times > 5e-5) & (times < 1.1e-4)].mean() == pytest.approx(-V, rel=0.01)
