"""Discs of few facets that roll down a slope in long steps."""

from __future__ import annotations

import numpy as np
import pytest
from support.apart import block, moved
from support.problems import of_two

import vmdg
from vmdg.meshes import apart

pytestmark = pytest.mark.filterwarnings("ignore:solve_dynamics. up to")  # long steps


def polygon(x, sides):
    """A square grid with 4 n sides, -1 to 1, as a polygon whose corners are on a circle."""
    size = np.maximum(np.abs(x).max(axis=0), 1e-12)
    along = np.where(np.abs(x[0]) >= np.abs(x[1]), x[1], x[0]) / size
    axis = np.abs(x[0]) >= np.abs(x[1])
    angle = np.pi / 4 * along
    cos, sin = np.sign(np.where(axis, x[0], x[1])) * np.cos(angle), np.sin(angle)
    turned = size * np.where(axis, [cos, sin], [sin, cos])
    c, s = np.cos(np.pi / sides), np.sin(np.pi / sides)  # a side below
    return np.array([[c, -s], [s, c]]) @ turned


@pytest.mark.parametrize(
    ("sides", "stiff"),
    [(48, 1e3), pytest.param(64, 1e4, marks=pytest.mark.long)],
)
def test_disc_rolls_down(comm, sides, stiff):
    """A disc that rolls has 2/3 of the work of its weight in its translation and 1/3 in its spin,
    here within 5 % with two sides a step."""
    slope, weight, way = np.deg2rad(20.0), 1.0, np.pi / 2
    grid = sides // 4
    parts = [
        block("quadrilateral", (12, 1), [-1.5, -0.5], [way + 2.5, 0.0], 1, comm),
        moved(
            block("quadrilateral", (grid, grid), [-1, -1], [1, 1], 2, comm),
            lambda x: polygon(x, sides),
        ),
    ]
    x = parts[1][0].geometry.x
    x[:, 1] -= x[:, 1].min()
    bodies = (vmdg.Rigid(), vmdg.NeoHookean(E=stiff, nu=0.3))
    problem = of_two(
        apart(parts), vmdg.Contact(friction=0.8), bodies, {"sliding": True}, density={2: 1.0}
    )
    force = weight * np.array([np.sin(slope), -np.cos(slope)])
    problem.body_force(force)
    span = np.sqrt(2 * way / (2 / 3 * force[0]))
    steps = int(np.ceil(way / (2 * np.pi / sides)))  # twice that speed at the end

    def watched(problem):
        motion, owned = problem.step.motion, problem.discretization.owned
        u, v = (one.x.array[:owned] for one in (problem.u, problem.velocity))
        P, moment = (comm.allreduce(motion.of(one).reshape(-1, 2).sum(axis=0)) for one in (v, u))
        mass = comm.allreduce(motion.row_sums[::2].sum())
        return {"share": P @ P / (2 * mass) / (force @ moment), "way": moment[0] / mass}

    times = np.linspace(0.0, span, steps + 1)[1:]
    history = vmdg.solve_dynamics(problem, times, monitor=watched).history
    assert history["way"][-1] == pytest.approx(way, rel=0.05)
    assert history["share"][-1] == pytest.approx(2 / 3, rel=0.05)
