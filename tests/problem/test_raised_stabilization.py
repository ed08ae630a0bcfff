"""r of "auto" in a run: raised within a step that asks for it, kept, carried on by a checkpoint."""

from __future__ import annotations

from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest

import vmdg
from vmdg.base.timers import timings, timings_since
from vmdg.checkpoint.checkpoint import read_checkpoint, write_checkpoint
from vmdg.meshes import blocks

E = 1000.0


def crushed(comm, law: vmdg.Law) -> vmdg.Problem:
    """Two squares shortened by the share t, between sides that do not give way."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (2, 2))
    material = vmdg.NeoHookean(E=E, nu=0.3)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, {1: material, 2: material}, [interface])
    for tag in (1, 2):
        problem.dirichlet(facets.find(tag), lambda x, t: np.stack([-t * x[0], 0 * x[0]]))
    for tag in (4, 5):
        problem.dirichlet(facets.find(tag), 0.0, "y")
    return problem


def squeezed(
    comm,
    law: vmdg.Law,
    amount,
    n: int = 2,
    degree: int = 1,
    cell: str = "quadrilateral",
    ratio: float = 1.0,
) -> vmdg.Problem:
    """Two blocks side by side, shortened by ``amount(t)`` between rigid ends, nu = .45."""
    mesh, cells, facets = blocks(comm, cell, (n // 2, n), 1.0, interface=(0.5, 0.5))
    bodies = {tag: vmdg.NeoHookean(E=E * ratio ** (tag - 1), nu=0.45) for tag in (1, 2)}
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, bodies, [interface], degree=degree)
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda t: np.array([-amount(t), 0.0]))
    return problem


def test_coercivity_is_asked_once_a_step(comm):
    """A step begins where the last one was checked; elsewhere tau_s is found anew."""
    problem = squeezed(comm, vmdg.Bonded(), lambda t: 0.02 * t)
    before = timings()
    result = vmdg.solve(problem, [0.5, 1.0])
    assert len(result.history) == 2 and not result.failures
    (runs,) = (timing.runs for timing in timings_since(before) if timing.name == "coercivity")
    assert runs == 2
    there = problem.stabilization[0].norm.copy()
    problem.u.x.array[:] *= 5.0
    problem.step.begin(1.0, 1.0)
    assert comm.allreduce(bool((problem.stabilization[0].norm > there).any()), op=MPI.LOR)


@pytest.mark.filterwarnings("ignore:equilibria beyond:vmdg.ModelWarning")
@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Contact()], ids=["tie", "contact"])
def test_r_is_raised_within_the_step_and_never_lowered(comm, out, law):
    """Crushed to a fifth, r of the start does not serve: the step is done again, not cut.

    Back at .7 of the length less would do; r stays, in a run that is resumed there, too.
    """
    problem = crushed(comm, law)
    norms = [problem.stabilization[0].norm]
    for t in (0.4, 0.8):
        # Blocks that touch without friction are short columns beyond their critical load.
        assert {reason for _, reason in vmdg.solve(problem, [t]).failures} <= {"UNSTABLE"}
        assert problem.step.stabilization_suffices()
        norms.append(problem.stabilization[0].norm)
    whole, part, fifth = norms
    assert comm.allreduce(bool((part >= whole).all()), op=MPI.LAND)
    assert comm.allreduce(bool((fifth > 1.9 * whole).all()), op=MPI.LAND)
    write_checkpoint(problem, out)
    resumed = crushed(comm, law)
    read_checkpoint(resumed, out)
    for one in (problem, resumed):
        vmdg.solve(one, [0.3])
        # What a state asks for is known to the tolerance of the residual, 1e-9.
        kept = np.allclose(one.stabilization[0].norm, fifth, rtol=1e-8, atol=0)
        assert comm.allreduce(kept, op=MPI.LAND)
    # On several ranks MUMPS adds in the order of its messages.
    rounding = 0.0 if comm.size == 1 else 1e-12
    same = np.allclose(problem.u.x.array, resumed.u.x.array, rtol=0, atol=rounding)
    assert comm.allreduce(same, op=MPI.LAND)


def test_raise_ends_and_leaves_no_trace(comm):
    """A state off the path asks for more at every attempt; the step given up, r is as it was."""
    problem = crushed(comm, vmdg.Contact())
    step, norm = problem.step, problem.stabilization[0].norm
    raised = [norm]
    for stretch in (1.0, 2.0, 3.0, 4.0):
        step.begin(0.1, 1.0)
        raised.append(problem.stabilization[0].norm)
        problem.u.interpolate(lambda x, s=stretch: np.stack([0 * x[0], s * x[1] ** 2]))
        assert not step.stabilization_suffices()
        assert step.raise_stabilization() == (stretch < 4)
    assert all((after >= before).all() for before, after in pairwise(raised))
    assert comm.allreduce(float((raised[-1] - norm).sum())) > 0
    step.cancel()
    step.begin(0.1, 1.0)
    assert np.array_equal(problem.stabilization[0].norm, norm)
