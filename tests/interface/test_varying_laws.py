"""Strengths, energies and friction that vary along an interface, by places and at random."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import compute_midpoints, locate_entities
from scipy import stats
from support.checks import by_position
from support.scenes import SEVERAL_RANKS, two_blocks

import vmdg
from vmdg.laws import Debonding, MixedModeDebonding

WEAK, STRONG = 20.0, 35.0
STEEL = vmdg.NeoHookean(E=5000.0, nu=0.25)
LOADS = np.linspace(0.3, 2.4, 8)


def low(x):
    """Facets of the lower half of the interface x = 1."""
    return np.isclose(x[0], 1) & (x[1] <= 0.5 + 1e-9)


def high(x):
    return np.isclose(x[0], 1) & (x[1] >= 0.5 - 1e-9)


def step(x):
    return np.where(x[1] < 0.5, WEAK, STRONG)


def bond(strength, **more):
    return Debonding(strength, 0.1, friction=0.3, **more)


def mixed(strength):
    """All of its strengths and energies vary where one does."""
    if callable(strength):
        return MixedModeDebonding(
            strength,
            lambda x: 1.5 * strength(x),
            lambda x: 0.05 * strength(x),
            lambda x: 0.1 * strength(x),
            criterion="BK",
            exponent=1.5,
            unloading="secant",
        )
    return MixedModeDebonding(
        strength,
        1.5 * strength,
        0.05 * strength,
        0.1 * strength,
        criterion="BK",
        exponent=1.5,
        unloading="secant",
    )


def pulled(scene, interfaces, **options) -> vmdg.Problem:
    """Blocks that part, more so at the top, and slide."""
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, {1: STEEL, 2: STEEL}, interfaces, **options)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(
        scene.facet_tags.find(2), lambda x, t: t * np.vstack([0.03 + 0.05 * x[1], 0 * x[0] - 0.03])
    )
    return problem


def run(problem, loads=LOADS, history=None, **more) -> vmdg.History:
    options = vmdg.SolveOptions(relative_tolerance=1e-12, energy=True, control="load", **more)
    return vmdg.solve(problem, loads, options, history=history).history


def both(problem) -> np.ndarray:
    """g, zeta, T and Q at the points of all interfaces, by place (n, 7)."""
    parts = [[s.points, s.opening, s.gap, s.traction, s.softening[:, None]] for s in problem.state]
    points, *values = (np.concatenate(kind) for kind in zip(*parts, strict=True))
    return np.hstack(by_position(problem.comm, points, *values)[1:])


@pytest.mark.parametrize("law", [bond, mixed])
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_equals_groups(comm, law, kinematics):
    """One interface with f(x), an array or a Function, and one interface for each value."""
    scene = two_blocks(comm, "quadrilateral", 4)
    parts = [vmdg.Interface(low, law=law(WEAK)), vmdg.Interface(high, law=law(STRONG))]
    groups = pulled(scene, parts, kinematics=kinematics)
    history, expected = run(groups), both(groups)
    given = [vmdg.Interface(between=(1, 2), law=law(step))]
    if law is bond and kinematics == "small":
        facets = locate_entities(scene.mesh, 1, lambda x: np.isclose(x[0], 1))
        values = step(compute_midpoints(scene.mesh, 1, facets).T)
        given.append(vmdg.Interface(facets, law=law(values)))
        field = fem.Function(fem.functionspace(scene.mesh, ("DG", 0)))
        field.interpolate(step)
        given.append(vmdg.Interface(between=(1, 2), law=law(field)))
    for interface in given:
        problem = pulled(scene, [interface], kinematics=kinematics)
        fields = run(problem)
        difference = np.abs(both(problem) - expected).max(axis=0)
        assert (difference <= 1e-12 * np.abs(expected).max(axis=0)).all()
        for name in ("damage", "friction", "bulk", "interface"):
            bound = 1e-12 * np.abs(history["bulk"]).max()
            np.testing.assert_allclose(fields[name], history[name], rtol=0, atol=bound)
        assert problem.debonded() == pytest.approx(groups.debonded(), abs=1e-14)
    lost = groups.state[0].softening.max(initial=0.0) / WEAK
    assert comm.allreduce(lost, MPI.MAX) > 0.99


def scattered(seed: int = 3) -> vmdg.Law:
    return Debonding(vmdg.Weibull(30.0, 5.0, seed), vmdg.Weibull(0.1, 8.0, seed + 1), 0.3)


@SEVERAL_RANKS
def test_random_strengths_on_any_ranks(comm):
    """The same strengths and the same curve on these ranks and on one."""
    bonded = vmdg.Interface(between=(1, 2), law=scattered())
    here, alone = (
        pulled(two_blocks(ranks, "triangle", 4), [bonded]) for ranks in (comm, MPI.COMM_SELF)
    )
    strengths = []
    for problem in (here, alone):
        active = problem.discretization.active[0]
        strengths.append(
            by_position(problem.comm, active.quadrature.points, active.law.strength)[1]
        )
    np.testing.assert_array_equal(*strengths)
    assert len(np.unique(strengths[0])) == 4
    one, two = run(here), run(alone)
    for name in ("damage", "bulk", "external"):
        scale = np.abs(two[name]).max()
        np.testing.assert_allclose(one[name], two[name], rtol=0, atol=1e-10 * scale)


def test_weibull():
    """Mean, deviation and distribution of 20,000 places; other seeds are other samples."""
    places = np.stack(np.meshgrid(np.arange(200) / 64, np.arange(100) / 1000, [0.0])).reshape(3, -1)
    sample = vmdg.Weibull(scale=40.0, modulus=7.0, seed=1, resolution=1e-6)
    values = sample(places)
    count = values.size
    assert values.mean() == pytest.approx(sample.mean, abs=4 * sample.deviation / np.sqrt(count))
    assert values.std() == pytest.approx(sample.deviation, rel=4 / np.sqrt(2 * count) * 1.2)
    assert stats.kstest(values, stats.weibull_min(7.0, scale=40.0).cdf).pvalue > 0.05
    # neighbours and samples know nothing of each other
    other = vmdg.Weibull(40.0, 7.0, seed=2, resolution=1e-6)(places)
    for a, b in ((values, other), (values[1:], values[:-1]), (values[200:], values[:-200])):
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(count)
    # the order of the places and their last digits do not matter
    order = np.random.default_rng(0).permutation(count)
    np.testing.assert_array_equal(sample(places[:, order] * (1 + 1e-15)), values[order])
    scaled = vmdg.Weibull(2.0, 7.0, seed=1, resolution=1e-6)(places)
    np.testing.assert_allclose(scaled, values / 20, rtol=1e-14)
    with pytest.raises(ValueError, match="give resolution="):
        vmdg.Weibull(40.0, 7.0)(places)


@pytest.mark.parametrize("refined", [1, 2])
def test_weibull_by_section(comm, refined):
    """Facets of a section share a strength, the same on every mesh; sections are independent."""
    sample = vmdg.Weibull(30.0, 5.0, seed=3, section=lambda x: x[1] // 0.5)
    low, high = sample(np.array([[1.0, 1.0], [0.2, 0.7], [0.0, 0.0]]))
    assert low != high
    problem = pulled(
        two_blocks(comm, "quadrilateral", 4 * refined),
        [vmdg.Interface(between=(1, 2), law=bond(sample))],
    )
    active = problem.discretization.active[0]
    expected = np.where(active.quadrature.points[:, 1] < 0.5, low, high)
    np.testing.assert_array_equal(active.law.strength, expected)
    numbers = vmdg.Weibull(30.0, 5.0, seed=3, section=lambda x: x[0])(np.arange(20000.0)[None])
    assert stats.kstest(numbers, stats.weibull_min(5.0, scale=30.0).cdf).pvalue > 0.05
    with pytest.raises(TypeError, match=r"Weibull: section = 0.5 must be a function of points"):
        vmdg.Weibull(30.0, 5.0, section=0.5)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (bond(lambda x: x[1] - 0.3), r"facet \d+ with its midpoint at \(1, 0.125, 0\): strength ="),
        (bond(lambda x: np.ones(99)), r"strength of the law must be one finite number for each"),
        (bond(lambda x: x[7]), r"strength of the law must be .*: index 7"),
        (bond(lambda x: np.nan * x[0]), r"or are not finite"),
        (bond(vmdg.Weibull(1.0, 5.0, resolution=9.0)), "closer together than resolution = 9 "),
        (bond(vmdg.Weibull(1.0, 5.0, resolution=1e-14)), "close to the rounding of coordinates"),
        (bond(vmdg.Weibull(1.0, 5.0, section=lambda x: 4 * x[1])), "must return one integer"),
        (bond(vmdg.Weibull(1.0, 5.0, section=lambda x: x[:2] // 1)), "must return one integer"),
    ],
)
def test_mistakes_are_told(comm, law, words):
    """On every rank, with the facet and the remedy."""
    scene = two_blocks(comm, "quadrilateral", 4)
    with pytest.raises(ValueError, match=words):
        pulled(scene, [vmdg.Interface(between=(1, 2), law=law)])


def test_array_without_facets():
    with pytest.raises(ValueError, match=r"strength of the law has shape .* facet of facets="):
        vmdg.Interface(between=(1, 2), law=bond(np.ones(3)))
    for wrong in ({"scale": -1.0}, {"modulus": 0.0}, {"seed": 0.5}, {"resolution": np.nan}):
        with pytest.raises(ValueError, match=f"Weibull: {next(iter(wrong))} ="):
            vmdg.Weibull(**({"scale": 1.0, "modulus": 5.0} | wrong))
