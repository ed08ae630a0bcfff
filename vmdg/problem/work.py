"""Work of the loads along the equilibrium path.

With Pi(u, zeta) the energy of the bodies and (30), (27) is F = dPi/du and tractions are
T = -dPi/dzeta. The loads do the work

    int F.du = int (F.du - T.dzeta) + int T.dzeta.

The second integral is a matter of the points: it is added up where return maps on the way say when
they yield, part or close, :mod:`vmdg.interface.gap_work`. The first one is that of the derivative
of an energy. It does not depend on the way from one end of a step to the other, so that it may go
straight from z_0 to z_1, z = (u, zeta), and the load factor where eigenstrains change:

    int_0^1 phi ds,  phi(s) = dPi/dz(z_0 + s dz).dz.

At the ends phi is a matter of the loads, which are in equilibrium with F there: the trapezoidal
rule is the work of the mean of the loads on du. It is exact for linear bodies, however zeta goes
from one end to the other. At finite strain the integral is less by phi''/12 = D3Pi[dz, dz, dz]/12,
third order in the step. Two steps a and b, one after the other, with changes f of dPi/dz and
lengths l = |dz|, in which the load factor has no part, foretell that:

    X = f_a.dz_b - f_b.dz_a = -D3Pi[dz_a, dz_b, dz_a + dz_b]/2,
    D3Pi[dz_b, dz_b, dz_b] = -2 l_b^2/(l_a (l_a + l_b)) X  if the path goes straight on.

Where that is much, and in a first step, Simpson's rule takes phi in the middle besides, where
forces are not in equilibrium, and misses phi''''/2880; where it differs much from the trapezoidal
rule, Boole's rule takes quarters besides and misses phi^(6)/1935360. That costs residuals, and is
done where someone asks for the energies at the end of the step.

What is stored at the ends is in none of this, nor is what the laws say that they have spent, so
that the balance of the energies holds them to it. A snap goes through no equilibrium: a jump, whose
load is held, has the work of its ends only.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_sum

Array = NDArray[np.float64]

#: Cosine between two steps from which on the path goes straight on.
STRAIGHT = 0.95

#: What the trapezoidal rule may miss in a step for two steps to foretell it, and difference of
#: Simpson's rule from it above which quarters are taken besides, relative to the work of the run.
CURVED, FINE = 1e-6, 1e-4


class Arc(NamedTuple):
    """A step along the path.

    Attributes:
        forces: Change of dPi/dz, owned dofs and points [N].
        z: Change of displacement and gap, owned dofs and points [mm], and of the load factor.
        length: Norm of that of displacement and gap [mm].
        work: Size of the work of the run so far [N mm].
    """

    forces: Array
    z: Array
    length: float
    work: float


def next_arc(
    comm: MPI.Comm,
    last: Arc | None,
    forces: Array,
    z: Array,
    work: float,
    lengths: int | None = None,
) -> tuple[Arc, float, bool]:
    """The arc of a step, what the integral is more than the trapezoidal rule has [N mm], as two
    steps foretell it, and whether that will do; collective.

    It will not where the path is not STRAIGHT, so that 0 is foretold, or where it is above CURVED.

    Args:
        comm: Of the problem.
        last: The step before it; None where the path does not go on from there.
        forces: Change of dPi/dz, owned dofs and points [N].
        z: Change of displacement and gap, owned dofs and points [mm], and of the load factor.
        work: Of the run so far, this rank's [N mm].
        lengths: How many of z are lengths, the first ones; None for all.
    """
    before = 0.0 if last is None else last.forces @ z - forces @ last.z
    # A load factor may have any unit and is not added to lengths.
    moved, rest = z[:lengths], z[len(z) if lengths is None else lengths :]
    along = 0.0 if last is None else last.z[:lengths] @ moved
    sums = [before, along, moved @ moved, work, np.abs(rest).sum()]
    crossed, along, square, work, led = global_sum(comm, sums)
    arc = Arc(forces, z, float(np.sqrt(square)), abs(work))
    if arc.length == 0:
        return arc, 0.0, bool(led == 0)
    if last is None or last.length == 0:
        return arc, 0.0, False
    more = crossed * arc.length**2 / (6 * last.length * (last.length + arc.length))
    if along < STRAIGHT * last.length * arc.length:
        return arc, 0.0, False
    return arc, float(more), abs(more) <= CURVED * arc.work


def chord_integral(first: float, last: float, phi: Callable[[float], float], size: float) -> float:
    """int_0^1 phi ds by Simpson's or Boole's rule.

    Args:
        first, last: phi(0) and phi(1).
        phi: Of s.
        size: What FINE is relative to.
    """
    middle = phi(0.5)
    simpson = (first + 4 * middle + last) / 6
    if abs(simpson - (first + last) / 2) <= FINE * size:
        return simpson
    return (7 * (first + last) + 32 * (phi(0.25) + phi(0.75)) + 12 * middle) / 90
