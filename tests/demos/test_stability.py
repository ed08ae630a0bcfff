"""Random stress runs end well, and the checks that say so can fail."""

from __future__ import annotations

import pytest
import stability
from parts.stability import runner
from parts.stability.runner import BAD, FAMILIES, numbers, stress

# The scenes are meant to be out of all proportion.
pytestmark = pytest.mark.filterwarnings("ignore::vmdg.ModelWarning")

#: A run of every family.
RUNS = numbers(1)


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


# Verdicts
