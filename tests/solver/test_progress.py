"""What a run says: its bar, residuals, timers, and that other ranks are quiet."""

from __future__ import annotations

import re
from time import sleep

import numpy as np
import pytest
from support.problems import MATERIALS, joined
from support.scenes import two_blocks

import vmdg
from vmdg.base.timers import timer, timings, timings_since

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.3)
#: Seconds between two states of the bar.
ALWAYS = 1e-9
ITERATIVE = {"ksp_type": "gmres", "pc_type": "jacobi", "ksp_max_it": 200}


def pulled(comm, n: int = 2, law: vmdg.Law = LAW, **options) -> vmdg.Problem:
    """Two squares, the right one pulled and turned by t [mm]."""
    scene = two_blocks(comm, "quadrilateral", n)
    problem = joined(scene, law, **options)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(
        scene.facet_tags.find(2), lambda x, t: t * np.array([1 + x[1], 0.2 + 0 * x[0]])
    )
    return problem


def solve(problem, loads, **options) -> vmdg.Result:
    monitor = lambda problem: {"force [N]": problem.reaction(lambda x: np.isclose(x[0], 0))[0]}  # noqa: E731
    return vmdg.solve(problem, loads, vmdg.SolveOptions(**options), monitor)


def test_quiet_by_default(comm, capfd):
    """Not a word, on any rank."""
    solve(pulled(comm), [0.01, 0.02])
    said = capfd.readouterr()
    assert said.out == said.err == ""


@pytest.fixture(autouse=True)
def wide(monkeypatch):
    monkeypatch.setenv("COLUMNS", "400")
    monkeypatch.setenv("LINES", "50")


def test_bar(comm, capsys):
    """Load, force with its unit, debonded area, step, iterations and imbalance, on rank 0 only."""
    problem = pulled(comm)
    result = solve(problem, [0.01, 0.2, 0.3], progress=ALWAYS, energy=True)
    said = capsys.readouterr()
    if comm.rank > 0:
        assert said.out == said.err == ""
        return
    history, states = result.history, said.err.split("\r")
    last = states[-1].strip()
    assert last.startswith("100%")
    assert "3/3" in last
    assert f"load 0.3, force {history['force'][-1]:.4g} N, debonded 100.0%, step 0.1, " in last
    assert f"{history['iterations'][-1]} it, imbalance " in last
    assert any("load 0.01, " in state and "debonded 0.0%" in state for state in states)
    assert "Krylov" not in said.err


def test_bar_shows_what_is_asked_for(comm, capsys):
    """Columns of the user's choice, with or without their unit; others are an error at once."""
    solve(pulled(comm), [0.01], progress=ALWAYS, show=["cuts", "residual [N]"])
    said = capsys.readouterr().err
    if comm.rank == 0:
        assert re.search(r"load 0\.01, cuts 0, residual \S+ N, ", said)
        assert "force" not in said
    with pytest.raises(ValueError, match="show = 'torque': the history has no column 'torque'"):
        solve(pulled(comm), [0.01], progress=ALWAYS, show="torque")


def test_verbose(comm, capsys):
    """The residuals of every step and its Krylov iterations, on rank 0 only."""
    chosen = {"control": "load", "petsc": ITERATIVE}
    result = solve(pulled(comm), [0.01, 0.15], verbose=True, **chosen)
    said = capsys.readouterr()
    if comm.rank > 0:
        assert said.out == ""
        return
    steps = said.out.split("step to load ")[1:]
    assert [step.split(",")[0] for step in steps] == ["0.01", "0.15"]
    for step, norms in zip(steps, result.residuals, strict=True):
        printed = re.search("residuals (.*) N, .* asked for", step).group(1)
        assert [float(norm) for norm in printed.split()] == pytest.approx(norms, rel=1e-3)
    krylov = [int(number) for number in re.findall(r"asked for, (\d+) Krylov", said.out)]
    assert krylov == result.history["krylov"].tolist()
    assert "timer" in said.out


def test_failures_as_they_happen(comm, capsys):
    """Every attempt with its reason, and where the problem is then."""
    options = {"verbose": True, "max_iterations": 0, "max_cuts": 1, "control": "load"}
    with pytest.raises(vmdg.StepFailure) as error:
        solve(pulled(comm), [0.3], **options)
    said = capsys.readouterr().out
    if comm.rank == 0:
        failures = re.findall(r"failed: (\S+); the problem is at load 0,", said)
        assert failures == [reason for _, reason in error.value.result.failures]
        assert len(failures) == 2


def test_krylov_iterations(comm):
    """None of direct solvers; of an iterative one those that PETSc counts."""
    direct = solve(pulled(comm), [0.01, 0.1], control="load")
    assert not direct.history["krylov"].any()
    assert direct.counts.krylov == 0
    iterative = solve(pulled(comm), [0.01, 0.1], petsc=ITERATIVE, control="load")
    assert not iterative.failures
    assert (iterative.history["krylov"] > iterative.history["iterations"]).all()
    assert iterative.counts.krylov == iterative.history["krylov"].sum()


def test_debonded(comm):
    """The share of the area: of bonds that can fail only, facets that are closed included."""
    assert pulled(comm, law=vmdg.Bonded()).debonded() == 0.0
    problem = pulled(comm, n=4)
    assert problem.debonded() == 0.0
    # Half of the facets, on whatever rank they are.
    active = problem.discretization.active[0]
    lower = active.quadrature.points[:, 1] < 0.5
    active.history.softening[lower] = LAW.strength
    assert problem.debonded() == pytest.approx(0.5)
    scene = two_blocks(comm, "quadrilateral", 4)
    interfaces = [
        vmdg.Interface(between=(1, 2), law=LAW),
        vmdg.Interface(within=1, law=LAW, activate="on-demand"),
    ]
    bodies = dict(enumerate(MATERIALS, start=1))
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, interfaces)
    problem.discretization.active[0].history.softening[:] = LAW.strength
    # 3 lines of length 1 mm in both directions inside the left block.
    assert problem.debonded() == pytest.approx(1 / (1 + 6))


def test_timers(comm):
    """Runs and seconds of what was timed, without what was before, longest first."""
    with timer("test, before"):
        pass
    before = timings()
    for _ in range(3):
        with timer("test, long"):
            sleep(0.02)
    with timer("test, short"):
        pass
    found = timings_since(before)
    assert [t.name for t in found] == ["test, long", "test, short"]
    assert [t.runs for t in found] == [3, 1]
    assert 0.05 < found[0].seconds < 1
