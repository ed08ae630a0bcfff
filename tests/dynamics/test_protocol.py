"""How a run in time ends: rows, exceptions anywhere, failures, and runs that continue."""

from __future__ import annotations

import sys

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import of_two
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg

TIMES = np.linspace(0.0, 0.8, 17)[1:]
QUIET = vmdg.SolveOptions(energy=True)
SCHEMES = [vmdg.GeneralizedAlpha(), vmdg.CentralDifferences(renewal=7)]
EVERY_SCHEME = pytest.mark.parametrize("scheme", SCHEMES, ids=["implicit", "explicit"])


def pulled(comm, kinematics="small"):
    """Two bonded blocks, one held, the other moved by a support that accelerates."""
    scene = two_blocks(comm, "quadrilateral", 3)
    body = vmdg.NeoHookean(E=1.0, nu=0.3)
    bond = vmdg.Debonding(strength=0.05, critical_gap=0.3)
    problem = of_two(scene, bond, (body,) * 2, kinematics=kinematics, density={1: 1.0, 2: 1.0})
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(scene.facet_tags.find(RIGHT), lambda t: 0.1 * (1 - np.cos(3 * t)), "x")
    return problem


def state(problem):
    motion = problem.step.motion
    found = [problem.u.x.array, problem.velocity.x.array, motion.acceleration, motion.carried]
    return np.concatenate([[problem.t], *found])


def fail_in(problem, call, error, name="assemble_residual"):
    plain, count = getattr(problem.step, name), [0]

    def failing(*given, **named):
        count[0] += 1
        if count[0] == call:
            raise error
        return plain(*given, **named)

    setattr(problem.step, name, failing)


class Interruption:
    """Raises an error where the engine calls a function for the nth time."""

    def __init__(self, call, error=None):
        self.call, self.error, self.count = call, error, 0

    def __call__(self, frame, event, _):
        if event == "call" and "vmdg" in frame.f_globals.get("__name__", "").split("."):
            self.count += 1
            if self.count == self.call:
                sys.setprofile(None)
                raise self.error

    def __enter__(self):
        sys.setprofile(self)

    def __exit__(self, *_):
        sys.setprofile(None)


ERRORS = [KeyboardInterrupt, ValueError, IndexError, MemoryError, RuntimeError, FloatingPointError]


@pytest.mark.parametrize("count", [3, pytest.param(30, marks=pytest.mark.long)])
@EVERY_SCHEME
def test_exceptions_anywhere(scheme, count):
    """Ctrl-C twice, or any error at any call of the engine, on one rank: it is the one that is
    raised, the state is that of the last row, and the run goes on from there as if nothing had
    happened."""
    comm = MPI.COMM_SELF
    whole, rows, calls = pulled(comm), {0: state(pulled(comm))}, Interruption(0)
    keep = lambda p: rows.update({len(rows): state(p)}) or {}  # noqa: E731
    with calls:
        vmdg.solve_dynamics(whole, TIMES, scheme, None, keep, QUIET)
    rng = np.random.default_rng(3)
    for number, call in enumerate(rng.integers(20, int(0.9 * calls.count), count)):
        problem, history = pulled(comm), vmdg.History()
        error = ERRORS[number % len(ERRORS)]
        with pytest.raises(error, match="anywhere"), Interruption(call, error("anywhere")):
            vmdg.solve_dynamics(problem, TIMES, scheme, options=QUIET, history=history)
        assert np.array_equal(state(problem), rows[len(history)])
        vmdg.solve_dynamics(problem, TIMES, scheme, options=QUIET, history=history)
        assert history["time"] == pytest.approx(TIMES)
        last = rows[len(TIMES)]
        assert np.abs(state(problem) - last).max() < 1e-9 * np.abs(last).max()


@pytest.mark.parametrize(("scheme", "name"), zip(SCHEMES, ("begin", "renew"), strict=True))
def test_error_where_a_step_begins(comm, scheme, name):
    """It is no step that fails."""
    problem = pulled(comm, "finite")
    fail_in(problem, 2, ValueError("of a user"), name)
    with pytest.raises(ValueError, match="of a user"):
        vmdg.solve_dynamics(problem, TIMES, scheme)


def test_exception_at_a_row(comm):
    """While the state of a new row is copied: that row is not there."""
    rows = {0: state(pulled(comm))}
    keep = lambda p: rows.update({len(rows): state(p)}) or {}  # noqa: E731
    vmdg.solve_dynamics(pulled(comm), TIMES[:3], monitor=keep)
    problem, history = pulled(comm), vmdg.History()
    fail_in(problem, 5, MemoryError, "snapshot")  # one at the start, then two a row
    with pytest.raises(MemoryError):
        vmdg.solve_dynamics(problem, TIMES[:3], history=history)
    assert np.array_equal(state(problem), rows[len(history)])
    vmdg.solve_dynamics(problem, TIMES[:3], history=history)
    assert history["time"] == pytest.approx(TIMES[:3])


@EVERY_SCHEME
def test_extended(comm, scheme):
    """A run that is extended is one run, whose supports know their acceleration at its end."""
    found = []
    for parts in ([TIMES], [TIMES[:7], TIMES]):
        problem, history = pulled(comm), None
        for times in parts:
            found_here = vmdg.solve_dynamics(problem, times, scheme, options=QUIET, history=history)
            history = found_here.history
        found.append((state(problem), history["kinetic"], history["external"]))
    for one, other in zip(*found, strict=True):
        assert one == pytest.approx(other, rel=1e-12, abs=1e-12)


@pytest.mark.filterwarnings("ignore:solve_dynamics. up to")  # long steps
def test_explicit_run_that_fails(comm):
    """A load that throws the body away: the state is that of the last row."""
    problem, far = pulled(comm, "finite"), lambda x: np.isclose(x[1], 1.0)
    problem.traction(far, lambda t: (0.0, -1e9 * max(t - 0.1, 0.0) ** 2))
    seen = []
    with pytest.raises(vmdg.StepFailure, match="in the state of its last row") as error:
        vmdg.solve_dynamics(
            problem, TIMES, SCHEMES[1], None, lambda p: seen.append(state(p)), QUIET
        )
    assert problem.t == error.value.result.history["time"][-1]
    assert np.array_equal(state(problem), seen[-1])
    assert "cells are inverted" in str(error.value)


@EVERY_SCHEME
def test_monitor_that_does_more_than_look(comm, scheme):
    """It must not run the problem; its errors leave the last row."""
    problem = pulled(comm)

    def monitor(problem):
        if problem.t > TIMES[1]:
            vmdg.solve_dynamics(problem, [1.0])

    history = vmdg.History()
    with pytest.raises(RuntimeError, match="its monitor must not solve it"):
        vmdg.solve_dynamics(problem, TIMES, scheme, monitor=monitor, history=history)
    assert problem.t == history["time"][-1] == TIMES[1]
    assert {"step", "time", "iterations", "cuts", "steps", "krylov"} <= set(history.rows[-1])
