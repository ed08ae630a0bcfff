"""The benchmark at a coarse size: what it counts and the physics it compares, no timings."""

from __future__ import annotations

from mpi4py import MPI

import benchmark
import numpy as np
import pytest
import two_inclusions
import two_inclusions as inclusions
from parts.benchmark import peers
from parts.benchmark.common import layers
from support.budgets import over_budget

import vmdg
from vmdg.base import kernels

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="measured on one rank")


@pytest.mark.long
def test_errors_are_those_of_plain_elements(out):
    """vmdg has the error of plain finite elements within 5%; springs are never much better."""
    points = benchmark.main(["precision"], coarse=True, repeats=1, out=str(out))["precision"]
    by_case = {(p.cell, p.degree, p.n, p.method): p for p in points}
    for (*case, method), point in by_case.items():
        plain = by_case[(*case, "plain")]
        assert point.solves >= 1
        assert not over_budget("block of known solution", solves=point.solves)
        if method == "vmdg":
            assert point.h1 == pytest.approx(plain.h1, rel=0.05), point
            assert point.l2 == pytest.approx(plain.l2, rel=0.05), point
        if method == "springs":
            assert point.h1 > 0.95 * plain.h1, point
    assert (out / "precision.png").stat().st_size > 10_000


def test_cracked_plate():
    """P1 in 40 steps: peak within 1%, work within .5%, few corrections."""
    run, _ = peers.run(peers.P1)
    assert run.history["force"].max() == pytest.approx(peers.P1.peak, rel=0.01)
    assert run.history["external"][-1] == pytest.approx(peers.P1.work, rel=5e-3)
    assert run.history["damage"][-1] == pytest.approx(peers.P1.work)
    assert np.abs(run.history["imbalance"]).max() < 5e-3 * peers.P1.work
    assert not over_budget("cracked plate", run)
    assert run.counts.solves >= len(run.history)


def test_two_inclusions(out):
    """Slope of a bond within .1%, largest and last force within 1% of h -> 0, no penetration.

    Behind the snap, where less and less breaks in a step, load control leads again.
    """
    run, bonded = two_inclusions.main(element_size=0.08, out=str(out))
    force = run.history["force"]
    assert bonded == pytest.approx(inclusions.SLOPE, rel=1e-3)
    assert force.max() == pytest.approx(inclusions.PEAK, rel=5e-3)
    assert force[-1] == pytest.approx(inclusions.LAST, rel=1e-2)
    assert run.penetration < 1e-12
    assert not over_budget("two inclusions, to the end", run.history)
    assert (out / "two_inclusions.png").stat().st_size > 10_000


@pytest.mark.long
def test_attempt_that_backtracks_in_vain_ends():
    """Next to the snap the tangent is as good as singular, and no length of a correction helps."""
    problem, _ = inclusions.build(inclusions.LAWS["intrinsic"], 2, 0.05)
    loads = np.linspace(0, inclusions.END, 41)[1:]
    result = vmdg.solve(problem, loads, vmdg.SolveOptions(relative_tolerance=1e-6))
    assert result.failures
    assert not over_budget("two inclusions", result)


def test_kernels_are_shared():
    """A law of another class needs no kernel beyond those of the first; a tie none of damage."""
    mesh, cells, facets = layers("quadrilateral", (2, 4), (1.0, 2.0), 2)

    def asked(law: vmdg.Law) -> list[tuple[str, int]]:
        first, body = len(kernels.requested), vmdg.NeoHookean(E=1000.0, nu=0.3)
        interface = vmdg.Interface(between=(1, 2), law=law)
        problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [interface])
        problem.dirichlet(facets.find(1), 0.0)
        problem.dirichlet(facets.find(2), 1e-3)
        vmdg.solve(problem, [1.0])
        return [(kernel.name, kernel.lines) for kernel in kernels.requested[first:]]

    one = asked(vmdg.Debonding(strength=10.0, critical_gap=0.1, friction=0.3))
    other = asked(vmdg.ExponentialDebonding(strength=10.0, fracture_energy=1.0))
    assert other == [(name, 0) for name, _ in one]
    names = [name for name, _ in asked(vmdg.Bonded())]
    assert names.count("bodies' tangent") == 1
    assert names.count("H") == names.count("K") == 1
    assert "energy" not in names
