"""The peer of the delamination demo: its law, and its curve beside beam theory."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from parts.delamination.beams import open_beam
from parts.delamination.intrinsic import Bilinear, peer, side_by_side, table
from parts.delamination.laminate import ALFANO_CRISFIELD

LAW = Bilinear(strength=50.0, energy=0.3, K=1e5)
one_rank = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="the peer runs on one rank")


def test_energy():
    """The area under the curve, and what of it is spent."""
    g = np.column_stack([np.zeros(4001), np.linspace(0, 1.01 * LAW.gaps[1], 4001)])
    T = LAW(g, np.zeros(len(g)))[0][:, 1]
    assert T.max() == pytest.approx(LAW.strength, rel=1e-2)
    assert np.trapezoid(T, g[:, 1]) == pytest.approx(LAW.energy, rel=1e-4)
    assert LAW.spent(np.array([LAW.gaps[0], LAW.gaps[1]])) == pytest.approx([0, LAW.energy])


def test_tangent():
    """By differences: before damage, softening in any direction, unloading, gone, and closed."""
    first = LAW.gaps[0]
    g = np.array([[0.3, 0.6], [3.0, 4.0], [-20.0, 5.0], [0.5, 0.9], [300.0, 1.0], [2.0, -1.0]])
    g, kappa = g * first, np.array([0.0, 0.0, 0.0, 10 * first, 0.0, 0.0])
    _, C, _, rate = LAW(g, kappa)
    step = 1e-6 * first
    for axis in (0, 1):
        forth, back = (g + sign * step * np.eye(2)[axis] for sign in (1, -1))
        difference = (LAW(forth, kappa)[0] - LAW(back, kappa)[0]) / (2 * step)
        assert difference == pytest.approx(C[:, :, axis], abs=1e-5 * LAW.K)
        spent = [LAW.spent(LAW(moved, kappa)[2]) for moved in (forth, back)]
        assert (spent[0] - spent[1]) / (2 * step) == pytest.approx(rate[:, axis], abs=1e-5 * 50)


@one_rank
def test_curve():
    """Load at the end within 2% of corrected beam theory, and stiffness that grows with K."""
    bonded, lines = side_by_side(element_size=0.25, stiffnesses=(1e4, 1e6), share=0.1)
    ours, soft, stiff = lines
    assert soft.stiffness < stiff.stiffness
    assert ours.stiffness == pytest.approx(bonded, rel=0.03)
    assert stiff.load == pytest.approx(ours.load, rel=0.03)
    assert soft.load == pytest.approx(ours.load, rel=0.03)
    assert all(one.factorizations > one.rows > 10 for one in (soft, stiff))
    assert table(bonded, lines).count("\n") == 4


@one_rank
def test_elastic():
    """A stiff bond before damage: the stiffness of vmdg's tie on a fine mesh."""
    m = ALFANO_CRISFIELD
    problem, _ = open_beam(0.5, 4, 2, m, 60.0, 30.0, 40.0)
    (opening, force), *_ = peer(problem, m, 30.0, 2, 1e8).run([1e-3]).curve
    K = 32.72  # corrected beam theory
    assert force / opening == pytest.approx(K, rel=0.01)
