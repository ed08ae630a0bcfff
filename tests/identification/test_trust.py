"""A fit says what is wrong with it: units, files of other models, refused values, bad models."""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import pytest

import vmdg
from vmdg.meshes import blocks

COMM = MPI.COMM_SELF
OPENINGS = np.linspace(0.01, 0.2, 12)
BOND = {"bond.strength": 20.0, "bond.critical_gap": 0.12}
NEAR = {"bond.strength": 14.0, "bond.critical_gap": 0.14}
SIGMA = 0.2


def pulled(
    values: dict[str, float],
    law: Callable = vmdg.Debonding,
    E: float = 1000.0,
    F: float = 1.0,
    L: float = 1.0,
) -> tuple[vmdg.Problem, Callable]:
    """Two squares of 1 mm pulled apart, in units of which a newton and a millimetre have F and L;
    with a compliance of the machine in series where there is one."""
    mesh, cells, facets = blocks(COMM, "quadrilateral", (1, 1))
    mesh.geometry.x[:] *= L
    given = {name.partition(".")[2]: v for name, v in values.items() if name.startswith("bond")}
    bond = vmdg.Interface(between=(1, 2), law=law(**given), name="bond")
    body = vmdg.NeoHookean(E=E * F / L**2, nu=0.3)
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond], kinematics="small", thickness=L)
    problem.dirichlet(facets.find(1), 0.0, "x")
    problem.dirichlet(facets.find(5), 0.0, "y")
    problem.dirichlet(facets.find(2), lambda t: t, "x")
    compliance = values.get("machine.compliance", 0.0)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = problem.reaction(facets.find(2))[0]
        return {"force [N]": force, "opening [mm]": problem.t + compliance * force}

    return problem, monitor


def forces(values: dict[str, float] = BOND, **options) -> np.ndarray:
    problem, monitor = pulled(values, **options)
    history = vmdg.solve(problem, OPENINGS, monitor=monitor).history
    return history["force"][[np.abs(history["load"] - t).argmin() for t in OPENINGS]]


def noise(seed: int = 0) -> np.ndarray:
    """Of all forces [N]."""
    return SIGMA * np.random.default_rng(seed).standard_normal(len(OPENINGS))


def fitted(make: Callable, y: np.ndarray, start: dict[str, float], **options) -> vmdg.Identified:
    """A fit, without its warnings on the screen."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vmdg.ModelWarning)
        return vmdg.identify(make, vmdg.Curve(OPENINGS, y), start, comm=COMM, **options)


@pytest.mark.long
def test_units():
    """The same digits in units 2^20 times as large and small, and up to the tolerance of the runs
    in those 1e6 times as large and small."""
    data, found = forces() + noise(), []
    for F, L in ((1.0, 1.0), (2.0**-20, 2.0**20), (1e6, 1e-6), (1e-6, 1e6)):
        start = {"bond.strength": 14.0 * F / L**2, "bond.critical_gap": 0.14 * L}
        curve = vmdg.Curve(L * OPENINGS, F * data)
        one = vmdg.identify(lambda v, F=F, L=L: pulled(v, F=F, L=L), curve, start, comm=COMM)
        strength, gap = one.estimate.values()
        values = [strength * L**2 / F, gap / L, one.noise / F, *one.relative_errors.values()]
        found.append([*values, len(one.runs)])
    first, binary, *decimal = found
    assert binary == pytest.approx(first, rel=1e-13)
    for values in decimal:
        assert values == pytest.approx(first, rel=1e-6)
    assert first[0] == pytest.approx(20.0, rel=0.03)


def test_file(tmp_path):
    """Runs of one model are not those of another body, load or option; a damaged file, and one that
    another process writes, are refused."""
    y, file = forces(), tmp_path / "runs.json"
    options = {"sigma": SIGMA, "file": file}
    found = fitted(pulled, y, NEAR, **options)
    again = fitted(pulled, y, NEAR, **options)
    assert again.estimate == found.estimate
    with pytest.raises(ValueError, match=r"another model.*material 1, mu: 384.6.* there, 192.3"):
        fitted(lambda v: pulled(v, E=500.0), y, NEAR, **options)
    with pytest.raises(ValueError, match=r"another model.*options, max_cuts: 6 there, 3 here"):
        fitted(pulled, y, NEAR, **options, options=vmdg.SolveOptions(max_cuts=3))

    def pushed(values):
        problem, monitor = pulled(values)
        problem.dirichlet(lambda x: np.isclose(x[0], 2.0), lambda t: 2 * t, "x")
        return problem, monitor

    with pytest.raises(ValueError, match=r"another model.*a prescribed displacement"):
        fitted(pushed, y, NEAR, **options)
    whole = file.read_text()
    file.write_text(whole.replace("384.6", "384.7"))
    with pytest.raises(ValueError, match="was changed after it was written"):
        fitted(pulled, y, NEAR, **options)
    file.write_text(whole[:-100])
    with pytest.raises(ValueError, match="was truncated"):
        fitted(pulled, y, NEAR, **options)
    file.write_text(json.dumps({"runs": {}}))
    with pytest.raises(ValueError, match="no file of runs of this version"):
        fitted(pulled, y, NEAR, **options)
    assert [path.name for path in tmp_path.iterdir()] == ["runs.json"]


def test_refused_values():
    """Trials that a law refuses are rejected, wherever a fit begins; a start that it refuses is an
    error."""
    true = {"bond.strength": 15.0, "bond.plateau_gap": 0.05, "bond.critical_gap": 0.15}

    def make(values):
        return pulled(values, vmdg.TrapezoidalDebonding)

    y = forces(true, law=vmdg.TrapezoidalDebonding)
    found = fitted(make, y, dict(zip(true, (13.0, 0.09, 0.1), strict=True)), sigma=SIGMA)
    assert found.estimate == pytest.approx(true, rel=1e-3)
    assert not found.warnings
    refused = [run for run in found.runs if run.refused]
    assert refused
    assert all("must be less than critical_gap" in run.refused for run in refused)
    assert f"{len(refused)} of them refused" in str(found)
    total = true["bond.strength"] * (true["bond.plateau_gap"] + true["bond.critical_gap"]) / 2
    assert found.energies["bond"][0] == pytest.approx(total, rel=1e-3)
    assert found.energies["bond"][1] < found.relative_errors["bond.plateau_gap"]
    with pytest.raises(ValueError, match="must be less than critical_gap"):
        fitted(make, y, dict(zip(true, (15.0, 0.2, 0.15), strict=True)), sigma=SIGMA)


def softer(values: dict[str, float]) -> tuple[vmdg.Problem, Callable]:
    return pulled(values, E=700.0)


@pytest.mark.parametrize(
    ("make", "change", "start", "message"),
    [
        (softer, lambda y: y, NEAR, "misses the data by"),
        (pulled, lambda y: y + (np.arange(12) == 5) * 5, NEAR, "the force at load 0.0963636"),
        (pulled, lambda y: -y, NEAR | {"max_runs": 2}, "has the opposite sign"),
        (pulled, lambda y: y / 1e3, NEAR | {"max_runs": 2}, "are they in the same unit"),
        (pulled, lambda y: y + (np.arange(12) == 5) * 5, NEAR | {"sigma": None}, "an outlier"),
        (pulled, lambda y: y, NEAR | {"max_runs": 2}, "ended by max_runs = 2"),
        (
            pulled,
            lambda y: y,
            NEAR | {"bounds": {"bond.strength": (10.0, 15.0)}},
            "bond.strength ended at a bound",
        ),
    ],
)
def test_doubts(make, change, start, message):
    """Wrong models, outliers, signs and units, fits that end early: said, with errors or not."""
    options = {"sigma": SIGMA} | {k: v for k, v in start.items() if k not in BOND}
    start = {name: start[name] for name in BOND}
    found = fitted(make, change(forces() + noise()), start, **options)
    assert any(message in one for one in found.warnings), found.warnings
    assert all(one in str(found) for one in found.warnings)


@pytest.mark.parametrize("sigma", [pytest.param(SIGMA, marks=pytest.mark.long), None])
def test_far_start(sigma):
    """A bond that holds in the first run is found; one that no factor on a parameter makes fail is
    said to change nothing, without numbers in a corner of the runs."""
    y = forces() + noise()
    strong = BOND | {"bond.strength": 200.0}
    found = fitted(pulled, y, strong, sigma=sigma)
    assert found.estimate == pytest.approx(BOND, rel=0.03)
    assert found.converged
    assert not found.warnings
    stronger = BOND | {"bond.strength": 1e5}
    found = fitted(pulled, y, stronger, sigma=sigma, max_runs=4)
    assert not found.converged
    assert found.estimate == pytest.approx(stronger, rel=1e-12)
    assert len(found.warnings) == 1
    assert "do not change with bond.strength = 100000, bond.critical_gap" in found.warnings[0]


def test_given_parameters():
    """What a wrong number in the model does to estimates that fit: the force of a bar in plane
    strain tells E / (1 - nu^2). What a function sets from a parameter of its own is not given."""

    def make(values):
        E = values.get("NeoHookean.E", values.get("stiffness"))
        return pulled({"bond.strength": 1e3, "bond.critical_gap": 0.1}, E=E)

    y = 1000 / (1 - 0.3**2) / 2 * OPENINGS + noise()
    found = fitted(make, y, {"NeoHookean.E": 800.0}, sigma=SIGMA)
    effects, error = found.given["NeoHookean.nu"]
    assert effects["NeoHookean.E"] == pytest.approx(-2 * 0.3**2 / (1 - 0.3**2), rel=1e-4)
    assert error > 1e3
    assert "NeoHookean.nu  NeoHookean.E by -0.2 %; the data do not tell it" in str(found)
    assert "bond.strength  nothing; the data do not tell it" in str(found)
    own = fitted(make, y, {"stiffness": 800.0}, sigma=SIGMA)
    assert list(own.given) == [name for name in found.given]


def test_residuals_that_follow_each_other():
    """A body that stiffens less than its model, where the noise is not known."""

    def make(values):
        return pulled({"bond.strength": 1e3, "bond.critical_gap": 0.1}, E=values["NeoHookean.E"])

    stiffness = 1000 / (1 - 0.3**2) / 2
    y = stiffness * OPENINGS * (1 - 1.5 * OPENINGS) + noise()
    found = fitted(make, y, {"NeoHookean.E": 800.0})
    assert len(found.warnings) == 1
    assert "follow each other" in found.warnings[0]


@pytest.mark.parametrize("sigma", [SIGMA, pytest.param(None, marks=pytest.mark.long)])
def test_no_doubt(sigma):
    """A fit of noise is not warned of, with its noise in the printout."""
    found = fitted(pulled, forces() + noise(), NEAR, sigma=sigma)
    assert not found.warnings
    assert found.noise == pytest.approx(1.0 if sigma else SIGMA, rel=0.4)
    assert "noise" in str(found)


@pytest.mark.long
def test_own_parameters():
    """The compliance of a machine, by differences of whole runs, next to a strength with direct
    derivatives; a name that changes nothing is one that was mistyped."""
    true = BOND | {"machine.compliance": 1e-3}
    problem, monitor = pulled(true)
    history = vmdg.solve(problem, OPENINGS, monitor=monitor).history
    curve = vmdg.Curve(history["opening"], history["force"], along="opening", sigma=SIGMA)
    start = BOND | {"machine.compliance": 1.5e-3}
    found = vmdg.identify(pulled, curve, start, loads=OPENINGS, comm=COMM)
    assert found.estimate == pytest.approx(true, rel=0.02)
    assert found.differenced == ["machine.compliance"]
    assert "by differences of whole runs: machine.compliance" in str(found)

    def make(values):
        return pulled({name: values[name] for name in BOND})

    with pytest.raises(ValueError, match=r"no run changes with bond.frictions. Did you mean"):
        fitted(make, forces(), NEAR | {"bond.frictions": 0.1}, sigma=SIGMA)
