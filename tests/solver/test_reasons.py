"""Why steps fail: in words, with what helps, in the error and in the guide."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from support import bar
from support.problems import pulled

import vmdg
from vmdg.solver.reasons import REASONS, explained

ROOT = Path(__file__).resolve().parents[2]


def test_error_says_what_happened_and_what_helps(comm):
    """In words; the name of PETSc, how often, and the residuals follow in brackets."""
    options = vmdg.SolveOptions(max_iterations=0, max_cuts=1, control="load")
    with pytest.raises(vmdg.StepFailure) as failure:
        vmdg.solve(pulled(comm), [0.3], options)
    assert re.fullmatch(
        r"the step from load factor 0 to 0\.15 failed although it was cut 1 times; the problem is "
        r"in its state at 0\. In the last attempt Newton's method did not converge within "
        r"the maximum number of corrections \(DIVERGED_MAX_IT, 2 times\)\. What helps: "
        r"SolveOptions\(max_iterations=40\).* smaller steps"
        r".* \(Its last residuals: [-+.e0-9, ]+ N\.\)",
        str(failure.value),
    )


@pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")
@pytest.mark.parametrize("loads", [[50.0, 99.0, 101.0], [101.0]], ids=["steps", "at once"])
def test_jump_that_led_nowhere(comm, loads):
    """A dead load beyond the strength has no equilibrium: the error says so, and what helps."""
    problem = bar.build(comm, 0.005, "small", dead=True)
    with pytest.raises(vmdg.StepFailure) as failure:
        vmdg.solve(problem, loads, vmdg.SolveOptions(max_cuts=2))
    (t, reason) = [f for f in failure.value.result.failures if "JUMP_FAILED" in f[1]][-1]
    last = failure.value.result.history.rows[-1:]
    assert problem.t == (last[0]["load"] if last else 0.0)
    assert problem.mean(0).traction[0] == pytest.approx(problem.t, rel=1e-6, abs=1e-6)
    told = str(failure.value).partition(f" At load factor {t:.8g} ")[2]
    assert told.startswith("there is no equilibrium nearby")
    assert f"({reason}). What helps: prescribed displacements instead of forces" in told


def test_attempts_for_different_reasons():
    """The last one first, with its advice; the others follow."""
    text = explained(["DIVERGED_LOCAL_MIN", "JUMPED", "CELLS_INVERTED", "JUMPED"])
    order = ["passed a snap", "(JUMPED, 2 times)", "before,", "(CELLS_INVERTED)", "(DIVERGED_LOCAL"]
    places = [text.index(part) for part in [*order, "What helps", "control='dissipation'"]]
    assert places == sorted(places)
    assert "Interface 0: r = 3" in explained(["Interface 0: r = 3 MPa/mm, refine the facet"])
    assert "What helps: the PETSc options" in explained(["DIVERGED_TR_DELTA"])
    assert explained(["JUMP_FAILED after 3 steps"]).endswith(REASONS["JUMP_FAILED"].helps)


def test_every_reason_is_explained():
    """What the solver gives as a reason has its words, and its row in the how-to."""
    files = [*(ROOT / "vmdg" / "solver").glob("*.py"), ROOT / "vmdg" / "problem" / "step.py"]
    code = "".join(path.read_text() for path in files)
    own = re.findall(r'(?:failed\(|return )f?"([A-Z_]{4,})', code)
    given = {*own, *re.findall(r"reasons\.(DIV\w+)", code)}
    assert {"CELLS_INVERTED", "BODIES_OVERLAP", "JUMP_FAILED", "DIVERGED_MAX_IT"} <= given
    assert given <= set(REASONS)
    pages = (ROOT / "vmdg" / "HOWTO.md").read_text()
    section = pages.split("## When a step fails")[1].split("\n## ")[0]
    assert set(re.findall(r"^\| `([A-Z_]+)`", section, re.MULTILINE)) == set(REASONS)


def test_steps_that_vanish_have_a_cause():
    """What helps is what cures the failures that made them short."""
    words = explained(["ENERGY_GAINED", "ENERGY_GAINED", "STEP_VANISHES"], in_time=True)
    assert words.startswith("steps are shorter")
    assert "What helps: shorter steps" in words
    assert "What helps: larger or better shaped" in explained(["STEP_VANISHES"], in_time=True)
