"""Random stress runs end well, and the checks that say so can fail."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
import stability
from parts.stability import checks, runner
from parts.stability.cases import bar, block_pair, pulled, two_materials
from parts.stability.checks import Run
from parts.stability.runner import BAD, FAMILIES, examine, execute, numbers, stress
from parts.stability.scenes import Bond, Case

import vmdg

# The scenes are meant to be out of all proportion.
pytestmark = pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")

#: A run of every family.
RUNS = numbers(1)

LAW = vmdg.Debonding(strength=10.0, critical_gap=0.2, friction=0.3)


@pytest.mark.long
def test_no_run_fails(comm, out):
    """No wrong state, no NaN, no hang, no crash; every family occurs, most runs get to the end."""
    runs = stability.main(each=1, out=str(out))
    comm.barrier()
    failed = [f"{o.number}: {o.verdict}, {o.detail}" for o in runs if o.verdict in BAD]
    assert not failed
    assert [o.number for o in runs] == RUNS
    assert len(runner.families(runs)) == sum(map(len, FAMILIES.values()))
    number = runner.counts(runs)
    assert number["correct"] > 0.7 * len(RUNS)
    assert number["refused"] >= 1
    assert (out / "stability.md").read_text() == runner.table(runs) + "\n"


@pytest.mark.long
@pytest.mark.parametrize("number", [249, 301])
def test_crushed_cells_and_new_facets(number):
    """Crushed cells whose interface held less than the body; facets that open in the first stage.

    With less tau_s, or with C of another one in the first tangent of a step, they stop.
    """
    outcome = stress(number)
    assert (outcome.verdict, outcome.detail) == ("correct", "")


# The checks


def cracked(**options) -> Case:
    """Two squares pulled apart in part, sheared, with an exact end state if ``options`` say so."""
    rng = np.random.default_rng(1)
    mesh, tags = block_pair("quadrilateral", rng, np.ones(2))
    inputs = pulled(rng, mesh, tags, two_materials(rng), (Bond(LAW, (1, 2)),), 0.1)
    return Case("test", "cracked", **(inputs | options))


@pytest.fixture
def run() -> Run:
    """A sound run that ended with partial damage."""
    result = execute(cracked(unchanged_from=0.0, loads=np.array([0.2, 0.4, 0.6])))
    softening = result.problem.state[0].softening
    assert not result.stopped
    assert 0 < softening.max() < LAW.strength
    return result


def test_sound_run(run):
    """Every check but that of rigid motion, which this run is not, passes."""
    for check in checks.CHECKS:
        assert bool(check(run)) == (check is checks.objective), check


@pytest.mark.parametrize("what", ["u", "softening"])
def test_state_intact(run, what):
    """One bit more or less in any array."""
    active = run.problem.discretization.active[0]
    array = {
        "u": run.problem.u.x.array,
        "softening": active.history.softening,
    }[what]
    array[-1] = np.nextafter(array[-1], 1.0)
    assert checks.at_last_record(run)


def test_equilibrium(run):
    """A millionth of the opening more at a free node; a lost reaction; a force that turns."""
    u = run.problem.u.x.array
    free = np.setdiff1d(np.arange(len(u)), run.problem.loading.prescribed)[0]
    u[free] += 1e-6 * LAW.critical_gap
    found = checks.equilibrium(run)
    assert "residual" in found[0]
    u[free] -= 1e-6 * LAW.critical_gap
    del run.new
    largest = np.abs(run.problem.discretization.forces.x.array).argmax()
    run.problem.discretization.forces.x.array[largest] *= 1 + 1e-5
    assert "reported" in checks.equilibrium(run)[0]
    run.new.discretization.forces.x.array[largest] *= 1 + 1e-5
    found = checks.equilibrium(run)
    assert any("add up" in text for text in found)
    assert any("moments" in text for text in found)


def test_admissible(run):
    """A history that the displacement does not belong to."""
    assert not checks.admissible(run)
    active = run.problem.discretization.active[0]
    active.history = replace(active.history, softening=active.history.softening + 0.5)
    del run.new
    assert checks.admissible(run)


@pytest.mark.parametrize("t", [0.005, 0.15, 0.4])
def test_exact(t):
    """The bar before the peak, beyond it and apart: a ten-thousandth too far is found."""
    rng = np.random.default_rng(2)
    mesh, tags = block_pair("quadrilateral", rng, np.ones(2))
    case = Case("test", "bar", **bar(mesh, tags, (1e3, 3e3), 0.3, LAW, np.array([t])))
    run = execute(case)
    assert not checks.exact(run)
    run.problem.u.x.array[:] *= 1 + 1e-4
    run.problem.step.assemble_residual()
    assert checks.exact(run)


# Verdicts


def stopped_case() -> Case:
    """One step far beyond separation, with nothing allowed that would carry it."""
    options = vmdg.SolveOptions(max_cuts=0, max_iterations=1, control="load")
    return cracked(loads=np.array([0.05, 2.0]), options=options)


def test_stopped():
    """A step that fails leaves the last converged state; left as it failed, it is found."""
    run = execute(stopped_case())
    assert len(run.records) == 2
    assert examine(run)[0] == "stopped"
    assert "0.05" in examine(run)[1]
    run.problem.u.x.array[:] *= 1 + 1e-12
    assert examine(run)[0] == "wrong"


def test_hang():
    """An endless run ends by itself."""
    start = time.perf_counter()
    assert stress(0, 0.2, lambda case: time.sleep(60)).verdict == "hang"
    assert time.perf_counter() - start < 10


def test_crash():
    """An error is a crash."""

    def fails(case: Case) -> Run:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    outcome = stress(0, 600.0, fails)
    assert outcome.verdict == "crash"
    assert "Eigenvalues" in outcome.detail


def test_a_flaw_must_be_refused():
    """A run through inverted cells would be wrong, whatever it gave."""
    case = cracked(must_refuse=True)
    assert examine(execute(case)) == ("wrong", "went through; ")
