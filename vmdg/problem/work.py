"""Work of the loads along the equilibrium path.

With Pi(u, zeta) the energy of the bodies and (30), (27) is F = dPi/du and tractions are
T = -dPi/dzeta. The loads do the work

    int F.du = int (F.du - T.dzeta) + int T.dzeta.

The second integral is evaluated at the points, with return maps at intermediate states that show
when they yield, separate or close, :mod:`vmdg.interface.gap_work`. The first one is that of the
derivative of an energy and path independent, so it can be taken along the straight line from z_0 to
z_1, z = (u, zeta), and the load factor if eigenstrains change:

    int_0^1 phi ds,  phi(s) = dPi/dz(z_0 + s dz).dz.

At the ends phi follows from the loads, which are in equilibrium with F there: the trapezoidal rule
is the work of the mean loads on du. It is exact for linear bodies, for any path of zeta. At finite
strain the integral is less by phi''/12 = D3Pi[dz, dz, dz]/12, third order in the step. Two steps a
and b, one after the other, with changes f of dPi/dz and lengths l = |dz|, in which the load factor
is not included, predict it:

    X = f_a.dz_b - f_b.dz_a = -D3Pi[dz_a, dz_b, dz_a + dz_b]/2,
    D3Pi[dz_b, dz_b, dz_b] = -2 l_b^2/(l_a (l_a + l_b)) X if the path is straight.

If this is large, and in a first step, Simpson's rule also uses phi at the midpoint, where forces
are not in equilibrium, with error phi''''/2880; if it differs much from the trapezoidal rule,
Boole's rule also uses the quarter points, with error phi^(6)/1935360. This costs residuals and is
done if the energies are evaluated at the end of the step.

None of this uses the energy stored at the ends or the dissipation returned by the laws, so the
energy balance is an independent check. A snap does not pass equilibria: the work of a jump, at
constant load, is that of its ends only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_sum

Array = NDArray[np.float64]

#: Cosine between two steps above which the path counts as straight.
STRAIGHT = 0.95

#: Largest error of the trapezoidal rule predicted by two steps, and difference from Simpson's rule
#: above which quarter points are used, relative to the work of the run.
CURVED, FINE = 1e-6, 1e-4


class Increment(NamedTuple):
    """A step along the path."""

    forces: Array  # Change of dPi/dz, owned dofs and points [N]
    z: Array  # Change of displacement and gap, owned dofs and points [mm], and of the load factor
    length: float  # Norm of that of displacement and gap [mm]
    work: float  # Size of the work of the run so far [N mm]


def next_increment(
    comm: MPI.Comm,
    last: Increment | None,
    forces: Array,
    z: Array,
    work: float,
    lengths: int | None = None,
) -> tuple[Increment, float, bool]:
    """The record of a step, the correction of the trapezoidal rule [N mm] predicted by two steps,
    and whether it is accurate enough; collective.

    It is not if the path is not STRAIGHT, where 0 is predicted, or if it exceeds CURVED.

    Args:
        last: The previous step; None if the path does not continue it.
        forces: Change of dPi/dz, owned dofs and points [N].
        z: Change of displacement and gap, owned dofs and points [mm], and of the load factor.
        work: Work of the run so far, this rank's [N mm].
        lengths: Number of leading entries of z that are lengths; None for all.
    """
    before = 0.0 if last is None else last.forces @ z - forces @ last.z
    # A load factor may have any unit and is not added to lengths.
    moved, rest = z[:lengths], z[len(z) if lengths is None else lengths :]
    along = 0.0 if last is None else last.z[:lengths] @ moved
    sums = [before, along, moved @ moved, work, np.abs(rest).sum()]
    crossed, along, square, work, led = global_sum(comm, sums)
    increment = Increment(forces, z, float(np.sqrt(square)), abs(work))
    if increment.length == 0:
        return increment, 0.0, bool(led == 0)
    if last is None or last.length == 0:
        return increment, 0.0, False
    length = increment.length
    more = crossed * length * length / (6 * last.length * (last.length + length))
    if along < STRAIGHT * last.length * increment.length:
        return increment, 0.0, False
    return increment, float(more), abs(more) <= CURVED * increment.work


def chord_integral(first: float, last: float, phi: Callable[[float], float], size: float) -> float:
    """int_0^1 phi ds by Simpson's or Boole's rule."""
    middle = phi(0.5)
    simpson = (first + 4 * middle + last) / 6
    if abs(simpson - (first + last) / 2) <= FINE * size:
        return simpson
    return (7 * (first + last) + 32 * (phi(0.25) + phi(0.75)) + 12 * middle) / 90
