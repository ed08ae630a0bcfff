"""Length, zone, resistance and modes of a crack, in a short cantilever of mode I."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import couple
from support.scenes import two_blocks

import vmdg
from vmdg.meshes import beams
from vmdg.meshes.beams import INTERFACE, RIGHT

STRENGTH, G_C, WIDTH, A_0, H = 20.0, 0.3, 5.0, 10.0, 1.0
LAW = vmdg.Debonding(strength=STRENGTH, critical_gap=2 * G_C / STRENGTH)


def cantilever(rows: int = 14, **options) -> vmdg.History:
    """A cantilever of degree 2 opened until the crack has run 3 mm, about; its history."""
    tagged = beams(
        MPI.COMM_WORLD, "quadrilateral", (0.0, 8.0, A_0, 18.0, 24.0), (8, 8, 32, 6), H, 2, A_0
    )
    body = vmdg.NeoHookean(E=50e3, nu=0.3)
    facets = tagged.facet_tags.find(INTERFACE)
    bond = vmdg.Interface(facets, law=LAW, name="bond", **options)
    problem = vmdg.Problem(
        tagged.mesh,
        tagged.cell_tags,
        {1: body, 2: body},
        [bond],
        degree=2,
        kinematics="small",
        thickness=WIDTH,
    )
    for y, sign in ((-H, -0.5), (H, 0.5)):
        at = lambda x, y=y: np.isclose(x[0], 0) & np.isclose(x[1], y)  # noqa: E731
        problem.dirichlet_points(at, lambda t, sign=sign: sign * t, "y")
    problem.dirichlet(tagged.facet_tags.find(RIGHT), 0.0)
    crack = vmdg.CrackGrowth(problem, "bond", start=A_0)
    result = vmdg.solve(
        problem, 0.1 * np.arange(1, rows + 1), vmdg.SolveOptions(energy=True), crack
    )
    assert crack.length == result.history["crack"][-1]
    return result.history


@pytest.fixture(scope="module")
def opened():
    return cantilever()


def test_initial_damage(opened):
    """A crack that is there by damage counts from the start, without another word; of a bond that
    is half gone the crack needs (1 - d)^2 of the energy, and what was gone counts no crack."""
    ahead = 2.0
    given = cantilever(1, initial_damage=lambda x: np.where(x[0] < A_0 + ahead, 1.0, 0.0))
    assert given["crack"][0] == pytest.approx(A_0 + ahead, abs=0.3)
    weak = cantilever(initial_damage=0.5)
    assert weak["crack"][0] == pytest.approx(opened["crack"][0], abs=0.3)
    assert 0 < weak["zone"][-1] < 4 * opened["zone"][-1]
    running = (weak["crack"] > A_0 + 1) & (weak["crack"] < A_0 + 6)
    assert running.sum() > 2
    assert weak["resistance"][running] == pytest.approx(0.25 * G_C, rel=0.05)


def test_length(opened):
    """It only grows, and what is spent on it, D/(G_c b), is as long within half a zone."""
    assert (np.diff(opened["crack"]) >= 0).all()
    assert opened["crack"][0] >= A_0
    spent = A_0 + opened["damage"] / (G_C * WIDTH)
    assert opened["crack"][-1] > A_0 + 2
    assert (np.abs(opened["crack"] - spent) <= opened["zone"] / 2 + 1e-12).all()


def test_resistance_and_modes(opened):
    """G_c while the crack runs, all of it opening: J by the rule to 2%, D over da to 3%."""
    running = opened["crack"] > A_0 + 1
    assert running.sum() > 3
    assert opened["resistance"][running] == pytest.approx(G_C, rel=0.03)
    assert opened["mode_1"][running] == pytest.approx(G_C, rel=0.02)
    assert opened["mode_2"].max() < 1e-3 * G_C


def test_zone(opened):
    """It stays as long as it is while the crack runs, to the nearest facet."""
    zone = opened["zone"][opened["crack"] > A_0 + 1]
    assert zone == pytest.approx(zone.mean(), rel=0.25)


def test_refused(comm):
    """Interfaces without a crack to follow, and a width that is missing."""
    plane, solid = (two_blocks(comm, cell, 1) for cell in ("triangle", "tetrahedron"))
    with pytest.raises(ValueError, match="has no bond that can fail"):
        vmdg.CrackGrowth(couple(plane, vmdg.Bonded()), 0)
    with pytest.raises(ValueError, match="opens on demand"):
        vmdg.CrackGrowth(couple(plane, LAW, activate="on-demand"), 0)
    with pytest.raises(ValueError, match="give the width"):
        vmdg.CrackGrowth(couple(solid, LAW), 0)
