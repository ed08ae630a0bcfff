"""The work of the derivative of an energy along a chord: Simpson's and Boole's rule."""

from __future__ import annotations

import numpy as np
import pytest

from vmdg.problem.work import CURVED, chord_integral, next_increment


@pytest.mark.parametrize(("power", "size", "inside"), [(3, np.inf, 1), (5, 0.0, 3)])
def test_powers(power, size, inside):
    """Cubics are exact with the middle alone, quintics with the quarters."""
    asked = []

    def phi(s):
        asked.append(s)
        return s**power

    assert chord_integral(0.0, 1.0, phi, size) == pytest.approx(1 / (power + 1), rel=1e-14)
    assert len(asked) == inside


def test_quarters_are_taken_where_forces_bend():
    """exp(s): Simpson's rule misses 6e-4, enough where that is little of the work of the run."""
    exact = np.e - 1
    plain, fine = (abs(chord_integral(1.0, np.e, np.exp, size) - exact) for size in (1e4, 1.0))
    assert 100 * fine < plain < 1e-3


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_two_steps_foretell_a_little(comm, factor):
    """Of z^3 a step from 1 to 3 misses 4 by the trapezoidal rule; of a first step nobody knows."""
    z = np.array([0.0, 1.0, 3.0])
    a, b = (np.array([d]) * (comm.rank == 0) for d in np.diff(z))
    f_a, f_b = (np.array([f]) * (comm.rank == 0) for f in np.diff(3 * z**2))
    work = factor * 4 / CURVED * (comm.rank == 0)
    first, *foretold = next_increment(comm, None, f_a, a, work)
    assert foretold == [0.0, False]
    _, more, told = next_increment(comm, first, f_b, b, work)
    assert more == pytest.approx(-4, rel=1e-14)
    assert told == (factor > 1)


@pytest.mark.parametrize("unit", [1e-6, 1e6])
def test_a_load_factor_is_no_length(comm, unit):
    """Pi = u^2 t^2 of a displacement u and a load factor t, in seconds or pascals for example."""

    def foretold(unit):
        u, t = np.array([0.0, 1.0, 1.7]), np.array([0.0, 1.0, 1.8])
        z, f = np.array([u, t * unit]), np.array([2 * u * t**2, 2 * u**2 * t / unit])
        z, f = (np.diff(a) * (comm.rank == 0) for a in (z, f))
        first, *_ = next_increment(comm, None, f[:, 0], z[:, 0], 1.0, 1)
        return next_increment(comm, first, f[:, 1], z[:, 1], 1.0, 1)[1]

    assert foretold(unit) == pytest.approx(foretold(1.0), rel=1e-12)
    assert foretold(1.0) != 0


def test_a_body_at_rest_whose_load_factor_changes(comm):
    """Nothing is foretold of it: eigenstrains may do work on stress alone."""
    z = np.array([0.0, 1.0 * (comm.rank == 0)])
    assert next_increment(comm, None, z, z, 1.0, 1)[1:] == (0.0, False)
    assert next_increment(comm, None, 0 * z, 0 * z, 1.0, 1)[1:] == (0.0, True)


@pytest.mark.parametrize("known", [True, False])
def test_a_path_that_turns_foretells_nothing(comm, known):
    """A step at .3 or .4 rad to the one before; the forces are those of a spring."""
    angle = 0.3 if known else 0.4
    a, b = (np.array([np.cos(x), np.sin(x)]) * (comm.rank == 0) for x in (0.0, angle))
    first, *_ = next_increment(comm, None, a, a, 1.0)
    assert next_increment(comm, first, b, b, 1.0)[2] == known
