"""Work of the loads along the equilibrium path.

With Pi(u, zeta) the energy of the bodies and (30), (27) is F = dPi/du and tractions are
T = -dPi/dzeta. The loads do the work

    int F.du = int (F.du - T.dzeta) + int T.dzeta.

The first integral is that of the derivative of an energy: for linear bodies the trapezoidal rule is
exact, however zeta goes from one end of a step to the other. The second one is a matter of the
points: it is added up where return maps on the way say when they yield, part or close,
:mod:`vmdg.interface.gap_work`. What the laws say that they have spent is in neither, so that the
balance of the energies holds them to it. A snap goes through no equilibrium: a jump, whose load
is held, has the work of its ends only.

With forces f on displacements u, here both of the first integral, W = int f.du. The trapezoidal
rule misses the curvature of f(u). Where f and u are parabolas in the arc length of u over two steps
a and b of lengths l_a and l_b,

    int_b f.du = (f_0 + f_1)/2.D_b u + l_b^2/(6 l_a (l_a + l_b)) X,
    X = D_a f.D_b u - D_b f.D_a u,

and with a and b exchanged in the factor for step a. Where points begin or end to break u turns. Of
both parabolas through a step, with the step before and after it, the smaller correction counts, and
none where they differ in sign: the choice of essentially non-oscillatory schemes (Harten and others
1987), by which a turn between steps, such as the onset of damage, does not spoil the smooth step
beside it.
"""

from __future__ import annotations

from typing import NamedTuple

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import global_sum

Array = NDArray[np.float64]


class Arc(NamedTuple):
    """A step along the path.

    Attributes:
        forces: Change of the forces, owned dofs [N].
        u: Change of the displacement, owned dofs [mm].
        length: Its norm [mm].
        correction: Of the work of the step, by the parabola with the step before it [N mm].
    """

    forces: Array
    u: Array
    length: float
    correction: float


def next_arc(comm: MPI.Comm, last: Arc | None, forces: Array, u: Array) -> tuple[Arc, float]:
    """The arc of a step, and the correction of the work of the last one; collective.

    Args:
        comm: Of the problem.
        last: The step before it; None where the path does not go on from there.
        forces: Change of the forces, owned dofs [N].
        u: Change of the displacement, owned dofs [mm].
    """
    before = 0.0 if last is None else last.forces @ u - forces @ last.u
    crossed, square = global_sum(comm, [before, u @ u])
    length = float(np.sqrt(square))
    if last is None or length == 0 or last.length == 0:
        return Arc(forces, u, length, 0.0), 0.0
    share = crossed / (6 * (last.length + length))
    here, there = share * length**2 / last.length, share * last.length**2 / length
    return Arc(forces, u, length, here), _smaller(last.correction, there)


def _smaller(one: float, other: float) -> float:
    """The smaller of two numbers of the same sign, 0 where the signs differ."""
    return 0.0 if one * other <= 0 else min(one, other, key=abs)
