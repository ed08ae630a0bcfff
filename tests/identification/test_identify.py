"""Parameters found again from synthetic curves, and how far their intervals can be trusted."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import nullcontext

from mpi4py import MPI

import numpy as np
import pytest
from scipy.optimize import brentq, minimize_scalar
from scipy.stats import norm
from support.arms import bent_apart
from support.bar import with_law

import vmdg
from vmdg.meshes import blocks

LOADS = np.linspace(0, 0.14, 9)[1:]
BAR = {"interface_0.strength": 100.0, "interface_0.fracture_energy": 4.0}
BEAM = {"bond.strength": 20.0, "bond.fracture_energy": 0.3}
OPENINGS = np.linspace(0, 1.2, 9)[1:]


def bar(values: dict[str, float], comm: MPI.Comm = MPI.COMM_SELF) -> tuple[vmdg.Problem, Callable]:
    """The bar of two squares with a bond that softens slowly, and its force."""
    strength, energy = (values.get(name, given) for name, given in BAR.items())
    problem = with_law(comm, vmdg.ExponentialDebonding(strength, energy), "small")
    return problem, lambda problem: {"force [N]": problem.reaction(_end)[0]}


def _end(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[0], 2.0)


def beam(values: dict[str, float], comm: MPI.Comm = MPI.COMM_WORLD) -> tuple:
    law = vmdg.ExponentialDebonding(values["bond.strength"], values["bond.fracture_energy"])
    problem, sides = bent_apart(comm, 22.0, (20, 4), law)
    top = sides.find("upper left")
    return problem, lambda problem: {"force [N]": problem.reaction(top)[1]}


def measured(make: Callable, values: dict[str, float], x: np.ndarray) -> vmdg.Curve:
    """The curve of a run, without noise."""
    problem, monitor = make(values)
    history = vmdg.solve(problem, x, monitor=monitor).history
    y = [history["force"][np.isclose(history["load"], t)][0] for t in x]
    return vmdg.Curve(x, y)


@pytest.mark.filterwarnings("ignore:.*process zone:vmdg.ModelWarning")  # coarse
@pytest.mark.parametrize("factors", [(1.3, 0.7), pytest.param((0.7, 1.3), marks=pytest.mark.long)])
def test_beam(factors):
    """Strength and energy of a bond from 30 % off, within 1 % in at most 8 iterations."""
    curve = measured(beam, BEAM, OPENINGS)
    start = {name: f * value for (name, value), f in zip(BEAM.items(), factors, strict=True)}
    found = vmdg.identify(beam, curve, start, sigma=0.01 * curve.y.max())
    assert found.converged
    assert found.iterations <= 8
    assert list(found.estimate.values()) == pytest.approx(list(BEAM.values()), rel=1e-4)
    # A long crack says more about energy than about strength.
    errors = found.relative_errors
    assert errors["bond.fracture_energy"] < 0.3 * errors["bond.strength"] < 0.1


def test_not_determined():
    """A bar that stays intact says nothing about its bond."""
    curve = measured(bar, BAR, LOADS[:1] / 10)
    curve = vmdg.Curve(np.append(curve.x, 2 * curve.x), np.append(curve.y, 2 * curve.y))
    with pytest.warns(vmdg.ModelWarning, match="do not determine interface_0"):
        found = vmdg.identify(bar, curve, BAR, sigma=1.0, comm=MPI.COMM_SELF)
    assert len(found.warnings) == 2


def test_prior_and_two_experiments(tmp_path):
    """A prior holds what the data leave open; two experiments give the smaller errors; stored runs
    are not repeated."""
    curve, made = measured(bar, BAR, LOADS), []

    def counted(values):
        made.append(values)
        return bar(values)

    name = "interface_0.strength"
    arguments = {"sigma": 1.0, "comm": MPI.COMM_SELF}
    alone = vmdg.identify(bar, curve, BAR, **arguments)
    prior = {name: (100.0, alone.relative_errors[name] / 2)}
    held = vmdg.identify(bar, curve, BAR, priors=prior, **arguments)
    assert held.relative_errors[name] < alone.relative_errors[name] / 2
    start = {name: 1.1 * value for name, value in BAR.items()}
    file = tmp_path / "runs.json"
    both = {"first": counted, "second": counted}, {"first": curve, "second": curve}
    found = vmdg.identify(*both, start, file=file, **arguments)
    assert found.relative_errors[name] == pytest.approx(
        alone.relative_errors[name] / np.sqrt(2), rel=1e-3
    )
    assert found.estimate == pytest.approx(BAR, rel=1e-4)
    count = len(made)
    again = vmdg.identify(*both, start, file=file, **arguments)
    # One problem for each experiment, to compare it with that of the file.
    assert len(made) - count == 2 < count
    assert again.estimate == found.estimate
    with pytest.raises(ValueError, match="has runs for other parameters"):
        vmdg.identify(*both, {name: 100.0}, file=file, **arguments)
    with pytest.raises(ValueError, match="loads= by name of the experiments"):
        vmdg.identify(*both, start, loads={"first": LOADS}, **arguments)


@pytest.mark.long
def test_spread():
    """Experiments on different ranks give what they give together."""
    curve = measured(bar, BAR, LOADS)
    makes, curves = {"a": bar, "b": bar}, {"a": curve, "b": vmdg.Curve(curve.x, 1.1 * curve.y)}
    found = [
        vmdg.identify(makes, curves, BAR, sigma=10.0, spread=spread).estimate
        for spread in (False, True)
    ]
    assert found[0] == found[1]


def test_spread_errors():
    """An experiment that fails on one rank fails on all."""
    curve = measured(bar, BAR, LOADS)

    def broken(values):
        raise OSError("no mesh")

    makes, curves = {"a": bar, "b": broken}, {"a": curve, "b": curve}
    kind = OSError if MPI.COMM_WORLD.size == 1 else RuntimeError
    with pytest.raises(kind, match="no mesh"):
        vmdg.identify(makes, curves, BAR, sigma=1.0, spread=True)


def test_profile_and_plot():
    """Close to the estimate the cost is a parabola; the residuals can be drawn."""
    import matplotlib.pyplot as plt

    found = vmdg.identify(bar, measured(bar, BAR, LOADS), BAR, sigma=0.1, comm=MPI.COMM_SELF)
    steps, rises, parabola = found.profile()
    assert np.abs(rises - parabola).max() < 0.05 * parabola.max()
    direction, error = found.least_certain
    assert np.hypot(*direction.values()) == pytest.approx(1.0)
    assert error >= max(found.relative_errors.values())
    assert steps[2] == 0.0
    figure = found.plot()
    above, below = figure.axes
    assert above.lines[0].get_ydata() == pytest.approx(found.measured["measured"][0].y)
    assert above.lines[-1].get_ydata() == pytest.approx(found.fitted["measured"][0])
    assert below.lines[-1].get_ydata() == pytest.approx(found.residuals["measured"][0])
    plt.close(figure)
    assert "95 %" in str(found)
    assert "correlation" in str(found)


STIFF, PRIOR = {"1.E": 1000.0, "2.E": 2000.0}, 0.3
STRAINS = np.array([0.01, 0.02, 0.03])


def tied(values: dict[str, float]) -> tuple[vmdg.Problem, Callable]:
    """Two squares in series without lateral contraction: force = u E_1 E_2 / (E_1 + E_2)."""
    mesh, cells, facets = blocks(MPI.COMM_SELF, "quadrilateral", (1, 1))
    bodies = {tag: vmdg.NeoHookean(E=values[f"{tag}.E"], nu=0.0) for tag in (1, 2)}
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(mesh, cells, bodies, [tie], kinematics="small")
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda t: t, "x")
    return problem, lambda problem: {"force [N]": problem.reaction(_end)[0]}


@pytest.mark.long
@pytest.mark.parametrize("prior", [True, False])
def test_profile_interval(prior):
    """The interval from the cost, against that of the closed form, which is not symmetric; without
    a prior nothing limits a stiffness from above."""
    k, sigma = 2000.0 / 3, 4.0
    curve = vmdg.Curve(STRAINS, k * STRAINS, sigma=sigma)
    priors = {"2.E": (STIFF["2.E"], PRIOR)} if prior else None
    with pytest.warns(vmdg.ModelWarning) if not prior else nullcontext():
        found = vmdg.identify(tied, curve, STIFF, priors=priors, comm=MPI.COMM_SELF)
    low, high = found.profile_interval("1.E")
    if not prior:
        assert high == np.inf
        return

    def rise(E: float) -> float:
        def square(log: float) -> float:
            other = STIFF["2.E"] * np.exp(log)
            off = (E * other / (E + other) - k) * STRAINS / sigma
            return off @ off + (log / PRIOR) ** 2

        return minimize_scalar(square, (-1.0, 1.0)).fun - norm.ppf(0.975) ** 2

    exact = brentq(rise, 400.0, 1000.0), brentq(rise, 1000.0, 5000.0)
    assert low == pytest.approx(exact[0], rel=0.02)
    assert high == pytest.approx(exact[1], rel=0.02)
    assert found.interval("1.E")[1] < 0.9 * exact[1]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"start": {"interface_0.strength": -1.0}}, "must be positive"),
        ({"bounds": {"interface_0.strength": (200.0, 300.0)}}, "inside of its bounds"),
        ({"bounds": {"strength": (1.0, 2.0)}}, "bounds of 'strength'"),
        ({"priors": {"strength": (1.0, 2.0)}}, "prior of 'strength'"),
        ({"measured": vmdg.Curve([1.0], [1.0])}, "do not determine 2 parameters"),
        ({"measured": {"a": vmdg.Curve([1.0], [1.0])}}, "several experiments"),
        ({"measured": vmdg.Curve([1.0, 0.5, 1.0], [1.0] * 3)}, "give loads="),
        ({"sigma": -1.0}, "sigma = -1.0 must be positive"),
    ],
)
def test_refusals(changes, message):
    """Mistakes are named before the first run."""
    given = {"start": BAR, "measured": vmdg.Curve(LOADS, LOADS)} | changes
    with pytest.raises(ValueError, match=message):
        vmdg.identify(bar, given.pop("measured"), given.pop("start"), **given)
