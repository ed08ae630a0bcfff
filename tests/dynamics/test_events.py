"""Long runs and events against closed forms: energy, thrown blocks, a bar on a wall."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import of_two

import vmdg
from vmdg.meshes import blocks


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
