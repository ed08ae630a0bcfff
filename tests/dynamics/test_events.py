"""Long runs and events against closed forms: energy, thrown blocks, a bar on a wall."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import of_two
from support.scenes import LEFT, RIGHT, box, two_blocks

import vmdg
from vmdg.meshes import blocks

QUIET = vmdg.SolveOptions(energy=True)


@pytest.mark.long
def test_energy_of_a_long_run(comm):
    """Bonds that open, close and slide over 1e4 explicit steps, a fortieth of the critical one:
    the energies add up to 1e-4, an error that arises while bonds fail and does not grow later."""
    scene = two_blocks(comm, "quadrilateral", 2)
    body = vmdg.NeoHookean(E=1.0, nu=0.3)
    law = vmdg.Debonding(strength=0.02, critical_gap=0.4, friction=0.3)
    problem = of_two(scene, law, (body,) * 2, kinematics="small", density={1: 1.0, 2: 1.0})
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.spring(scene.facet_tags.find(RIGHT), (0.02, 0.02))
    modes = set()

    def seen(problem):
        modes.update(np.concatenate(comm.allgather(problem.state[0].mode)).tolist())
        return {}

    start = lambda x: np.array([0.1 * (x[0] > 1), 0.05 * x[0] * (x[1] - 0.2)])  # noqa: E731
    scheme = vmdg.CentralDifferences(safety=0.025)
    times = np.linspace(0.0, 100.0, 101)[1:]
    result = vmdg.solve_dynamics(problem, times, scheme, start, seen, QUIET)
    history = result.history
    assert result.counts.residuals > 1e4
    assert {vmdg.Mode.TENSION, vmdg.Mode.OPEN, vmdg.Mode.FRICTION} <= modes
    assert history["damage"][-1] > 1e-4
    assert history["friction"][-1] > 1e-5
    assert np.abs(history["imbalance"]).max() < 1e-4 * history["external"][0]
    drift = history["imbalance"][20:] - history["imbalance"][20]
    assert np.abs(drift).max() < 5e-5 * history["external"][0]


@pytest.mark.long
@pytest.mark.parametrize(("speed", "friction"), [(0.02, 0.3), (0.001, 0.9)], ids=["slip", "stick"])
def test_block_thrown_onto_a_rough_floor(comm, speed, friction):
    """A wide block falls, touches for 2 H/c and leaves as fast; sliding friction takes mu of its
    momentum across, and where it sticks a wave of shear 2 c_s/c of that along."""
    H, W, n, fall = 1.0, 16.0, 32, 0.01
    ends = [[0.0, -H / n], [W, H]]
    mesh, tags = box(comm, ends, [4 * n, n + 1], lambda x: 1 + (x[1] > 0))
    problem = vmdg.Problem(
        mesh,
        tags,
        {1: vmdg.Rigid(), 2: vmdg.NeoHookean(E=1.0, nu=0.0)},
        [vmdg.Interface(between=(1, 2), law=vmdg.Contact(friction))],
        kinematics="small",
        density={2: 1.0},
    )
    owned = problem.discretization.owned

    def mean(problem):
        P = (problem.step.motion.lumped * problem.velocity.x.array[:owned]).reshape(-1, 2)
        x, y = comm.allreduce(P.sum(axis=0)) / (W * H)
        return {"x": x, "y": y, "force": -problem.mean(0).traction[1]}

    throw = lambda x: np.array([[speed], [-fall]]) * np.ones(x.shape[1])  # noqa: E731
    times = np.linspace(0.0, 2.6, 261)[1:]
    scheme = vmdg.CentralDifferences()
    history = vmdg.solve_dynamics(problem, times, scheme, throw, mean, QUIET).history
    touching = times[np.abs(history["force"]) > 1e-2 * fall]
    assert touching[-1] == pytest.approx(2.0, rel=0.03)
    assert history["y"][-1] == pytest.approx(fall, rel=0.03)
    if friction == 0.3:
        after = speed - friction * (fall + history["y"][-1])
        assert history["x"][-1] == pytest.approx(after, rel=1e-6)
        work = history["friction"][-1]
        # The lower face is slowed down by the wave of shear, c/c_s mu times its fall.
        slid = 2 * fall * friction * (speed - friction * fall * np.sqrt(2.0)) * W * H
        assert work == pytest.approx(slid, rel=0.03)
    else:
        assert history["x"][-1] == pytest.approx(speed * (1 - np.sqrt(2.0)), abs=0.06 * speed)
        # It slides at the ends of the block only.
        assert history["friction"][-1] < 0.1 * speed**2 * W * H / 2


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
