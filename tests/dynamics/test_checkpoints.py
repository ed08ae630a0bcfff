"""Runs in time that are killed and resumed, and steps that adapt to their error."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import of_two
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg
from vmdg.meshes import blocks

BODY = vmdg.NeoHookean(E=1.0, nu=0.2)


class Killed(Exception):
    """What a monitor raises in place of a power cut."""


def scene_of(comm, law, damping):
    """Blocks that are pulled apart by one end, with some damping."""
    scene = two_blocks(comm, "quadrilateral", 3)
    problem = of_two(
        scene, law, (BODY,) * 2, {"name": "bond"}, density={1: 1.0, 2: 1.0}, damping=damping
    )
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(scene.facet_tags.find(RIGHT), lambda t: 0.02 * np.sin(3 * t), "x")
    problem.spring(scene.facet_tags.find(RIGHT), viscosity=(0.0, 0.1))
    return problem


def velocity(x):
    return np.array([0.05 * x[0], 0.02 * np.sin(x[0])])


BOND = vmdg.Debonding(strength=0.02, critical_gap=0.1, friction=0.3, viscosity=0.01)
CONTACT = vmdg.Contact(0.5, dynamic_friction=0.2, slip_distance=0.01)


@pytest.mark.parametrize(
    ("scheme", "law"),
    [
        (vmdg.GeneralizedAlpha(), BOND),
        pytest.param(vmdg.GeneralizedAlpha(tolerance=1e-3), BOND, marks=pytest.mark.long),
        (vmdg.CentralDifferences(renewal=7), BOND),
        (vmdg.CentralDifferences(renewal=7), CONTACT),
    ],
    ids=["implicit", "adaptive", "explicit", "contact"],
)
def test_resumed(comm, out, scheme, law):
    """A run that is killed and resumed equals one that is not, to the last bit on one rank."""
    times, damping = np.linspace(0, 2.4, 25)[1:], vmdg.Rayleigh(0.1, 0.01)
    rows = []

    def monitor(problem):
        mean = problem.mean("bond")
        rows.append(0)
        if len(rows) == killed:
            raise Killed
        return {"T": mean.traction[0], "gap": mean.gap[0]}

    def run(problem, folder, history=None):
        options = vmdg.SolveOptions(energy=True, checkpoint=out / folder, checkpoint_every=10)
        return vmdg.solve_dynamics(problem, times, scheme, velocity, monitor, options, history)

    killed, whole = 0, scene_of(comm, law, damping)
    expected = run(whole, "whole").history
    killed = len(rows) + 15
    with pytest.raises(Killed):
        run(scene_of(comm, law, damping), "killed")
    problem = scene_of(comm, law, damping)
    history = vmdg.read_checkpoint(problem, out / "killed")
    assert len(history) == 10
    found = run(problem, "killed", history).history
    assert len(found) == len(expected) == 24
    assert expected["gap"].max() > 1e-3
    if comm.size == 1:
        assert np.array_equal(problem.u.x.array, whole.u.x.array)
        assert np.array_equal(problem.velocity.x.array, whole.velocity.x.array)
        for name in expected.columns:
            assert np.array_equal(found[name], expected[name]), name
    else:
        assert problem.u.x.array == pytest.approx(whole.u.x.array, abs=1e-9)
        assert problem.velocity.x.array == pytest.approx(whole.velocity.x.array, abs=1e-8)


@pytest.mark.filterwarnings("ignore:solve_dynamics. up to")  # long steps
def test_nothing_left(comm, out):
    """A run that was complete is read, and not continued."""
    times, options = [0.1, 0.2], vmdg.SolveOptions(checkpoint=out / "run")
    vmdg.solve_dynamics(scene_of(comm, BOND, None), times, options=options)
    problem = scene_of(comm, BOND, None)
    history = vmdg.read_checkpoint(problem, out / "run")
    assert len(vmdg.solve_dynamics(problem, times, options=options, history=history).history) == 2
    assert problem.t == 0.2


def decaying(comm, scheme):
    """End of a bar that is hit and comes to rest, at a time, and the steps of every row."""
    scene = blocks(comm, "quadrilateral", divisions=(8, 1, 1))
    body = vmdg.NeoHookean(E=1.0, nu=0.0)
    problem = vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        {1: body, 2: body},
        [],
        kinematics="small",
        density={1: 1.0, 2: 1.0},
        damping=vmdg.Rayleigh(alpha=1.5, beta=0.2),
    )
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    x = problem.space.tabulate_dof_coordinates()[:, 0]

    def end(problem):
        u = problem.u.x.array.reshape(-1, 2)[x > 2 - 1e-9, 0]
        return {"u": comm.allreduce(u.max(initial=-np.inf), MPI.MAX)}

    start = lambda x: np.array([np.sin(np.pi * x[0] / 4) ** 3, 0 * x[0]])  # noqa: E731
    times = np.linspace(0.0, 24.0, 13)[1:]
    return vmdg.solve_dynamics(problem, times, scheme, start, end).history


def test_steps_adapt(comm):
    """The error falls with the tolerance, and steps grow where the motion fades."""
    exact = decaying(comm, vmdg.GeneralizedAlpha(tolerance=1e-6))
    errors, counts = [], []
    for tolerance in (1e-3, 3e-5):
        history = decaying(comm, vmdg.GeneralizedAlpha(tolerance=tolerance))
        errors.append(np.abs(history["u"] - exact["u"]).max() / exact["u"].max())
        counts.append(history["steps"])
    assert errors[0] < 1e-2
    assert errors[1] < errors[0] / 5
    assert counts[1][0] > 5 * counts[1][-1]
    assert (history["cuts"] == 0).all()


@pytest.mark.parametrize("tolerance", [0.0, 2.0, "small"])
def test_tolerance(tolerance):
    """A number in (0, 1]."""
    with pytest.raises(ValueError, match="tolerance"):
        vmdg.GeneralizedAlpha(tolerance=tolerance)
