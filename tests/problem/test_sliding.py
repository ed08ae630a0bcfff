"""Contact that slides beyond its facets is warned of, once, with facet, slip and size.

The table has the slip of every row.
"""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
from support.problems import couple
from support.scenes import two_blocks

import vmdg
from vmdg.interface.sliding import sliding

CONTACT = vmdg.Contact(friction=0.3)
SIZE = 0.25  # mm


def slid(comm, law, opening: float, loads) -> tuple[vmdg.Problem, vmdg.History, list[str]]:
    """Two blocks with facets of .25 mm, opened or pressed, slid by t mm; table and warnings."""
    scene = two_blocks(comm, "quadrilateral", 4)
    problem = couple(scene, law)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: (opening, t))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", vmdg.ModelWarning)
        history = vmdg.solve(problem, loads).history
    return problem, history, [str(warning.message) for warning in caught]


def test_warned_once(comm):
    """Half a facet: one warning on rank 0, with numbers that fit the state."""
    problem, history, messages = slid(comm, CONTACT, -0.01, np.linspace(0.05, 0.3, 6))
    assert len(messages) == (comm.rank == 0)
    for message in messages:
        assert "Interface(between" in message
        words = message.split()
        slip, share = (float(words[words.index(w) + 1].rstrip("%")) for w in ("slip", "is"))
        assert share / 100 == pytest.approx(slip / SIZE, rel=0.02)
        assert 0.5 < share / 100 < 0.8
    assert 1.0 < problem.step.sliding < 0.3 / SIZE
    assert (np.diff(history["sliding"]) > 0).all()
    assert history["sliding"][-1] == problem.step.sliding


@pytest.mark.parametrize(
    ("law", "opening", "loads"),
    [(CONTACT, -0.01, [0.05, 0.1]), (CONTACT, 0.01, [0.1, 0.3]), (vmdg.Bonded(), -0.01, [0.3])],
    ids=["short", "open", "tied"],
)
def test_not_warned(comm, law, opening, loads):
    """Slips below half a facet, open cracks and ties have partners that fit, or need none."""
    problem, history, messages = slid(comm, law, opening, loads)
    assert not messages
    assert problem.step.sliding <= 0.5
    assert ("sliding" in history.columns) == law.inelastic
    if law.inelastic:
        assert (history["sliding"][-1] > 0) == (opening < 0)


def test_rounding_is_no_contact(comm):
    """T of an open point is the rounding of r zeta, of either sign."""
    law = vmdg.Debonding(strength=10.0, critical_gap=0.02)
    problem, _, _ = slid(comm, law, 0.05, [0.1])
    active = problem.discretization.active[0]
    for size, touches in ((1e-14, False), (1.0, True)):
        traction = -size * active.quadrature.normal
        active.history = replace(active.history, traction=traction)
        assert (sliding(active).ratio > 0) == (touches and len(traction) > 0)
