"""Growth of a crack under cycles without vmdg: one arm of a DCB, and CF20 at its nodes in numpy.

What growth over the energy release rate owes to the law and to the arms, not to its computation.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse.linalg import splu

from parts.delamination.laminate import Laminate
from parts.delamination.vcct import Array, assembled, dofs_of, moduli, stiffness

#: dd/dN over lambda.
Rate = Callable[[Array], Array]


class Arm(NamedTuple):
    """Flexibility of the upper arm, of unit width, whose lower face is bonded from the crack on.

    Attributes:
        weights: Length of a bonded node (n,) [mm].
        load: Deflection of its corner by a force there [mm2/N].
        both: Deflection of the bonded nodes by that force (n,), and of the corner by theirs.
        bonded: Deflection of the bonded nodes by forces at them (n, n).
    """

    weights: Array
    load: float
    both: Array
    bonded: Array


class Growth(NamedTuple):
    """A row for every step of the cycles: (k,) each.

    Attributes:
        cycles: N.
        crack: a_0 + integral of d [mm].
        release: J_I = integral of T dg [N/mm].
    """

    cycles: Array
    crack: Array
    release: Array


def cf20(endurance: float, ratio: float, life: float, brittleness: float) -> Rate:
    """dd/dN over lambda in opening (Davila, NASA/TP-2020-220584).

    Args:
        endurance: Fraction of the strength that lasts for `life` cycles at R = -1.
        ratio: R, least over largest load.
        life: Cycles at the limit of endurance.
        brittleness: eta.
    """
    E = 2 * endurance / (endurance + 1 + ratio * (endurance - 1))
    beta = -7 * brittleness / math.log10(E)

    def rate(share: Array) -> Array:
        return np.where(share >= E, (share / E) ** beta / (life * (beta + 1)), 0.0)

    return rate


def arm(m: Laminate, a_0: float, far: float, size: float, rows: int = 12) -> Arm:
    """Rectangles with incompatible modes, of `size` along x where the crack runs, flat below.

    Args:
        m: The laminate.
        a_0: Crack length at the start [mm].
        far: Length of the part that can fail [mm]; what lies beyond does not open.
        size: Of its cells along x [mm].
        rows: Of cells.
    """
    free = np.linspace(0.0, a_0 - 4, math.ceil(a_0 - 4) + 1)[:-1]
    fine = np.linspace(a_0 - 4, a_0 + far, round((far + 4) / size) + 1)
    x = np.concatenate([free, fine, np.arange(a_0 + far + 1, a_0 + far + 20)])
    y = m.h * np.linspace(0.0, 1.0, rows + 1) ** 2
    nodes = np.arange(len(x) * len(y)).reshape(len(x), -1)
    D = moduli(m)
    lengths, column = np.unique(np.diff(x).round(9), return_inverse=True)
    cells = np.array([[stiffness(dx, dy, D) for dy in np.diff(y)] for dx in lengths])
    of_cell = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], -1)
    n = 2 * nodes.size
    K = assembled(dofs_of(of_cell), cells[column], n)

    lower, end = nodes[:, 0], a_0 + far
    held = np.concatenate([2 * nodes[-1], 2 * nodes[-1] + 1, 2 * lower[x > end + 1e-9] + 1])
    some = np.setdiff1d(np.arange(n), held)
    bonded = (x > a_0 - 1e-9) & (x < end + 1e-9)
    loaded = np.append(2 * nodes[0, -1] + 1, 2 * lower[bonded] + 1)
    forces = np.zeros((n, len(loaded)))
    forces[loaded, np.arange(len(loaded))] = 1.0
    u = np.zeros_like(forces)
    u[some] = splu(K[some][:, some]).solve(forces[some])
    C = u[loaded]
    weights = np.full(bonded.sum(), size)
    weights[0] /= 2
    return Arm(weights, C[0, 0], C[1:, 0], C[1:, 1:])


def grow(
    m: Laminate,
    opening: float,
    rate: Rate,
    a_0: float,
    far: float,
    size: float = 0.05,
    most: float = 0.02,
) -> Growth:
    """Keep the opening while cycles damage the bond, until the crack has run `far` less 1.5 mm.

    With the damage d of all nodes known the arms are linear: g = 2 (C_P P - C w T) and
    g (1 - d) P_n = d zeta_c T, zeta_c = 2 G_c/P_n. Where lambda = T/((1 - d) P_n) is above 1 the
    monotonic law adds to d, as in the first opening; else cycles do, in explicit steps.

    Args:
        m: The laminate.
        opening: Between the ends of the arms [mm].
        rate: dd/dN over lambda.
        a_0: Crack length at the start [mm].
        far: Length of the part that can fail [mm].
        size: Of cells along x [mm].
        most: Growth of d in a step.
    """
    body = arm(m, a_0, far, size)
    final = 2 * m.G_I / m.strength
    d, N, rows = np.zeros(len(body.weights)), 0.0, []
    while (crack := a_0 + body.weights @ d) < a_0 + far - 1.5:
        A = (2 * m.strength * (1 - d))[:, None] * body.bonded * body.weights
        A[np.diag_indices_from(A)] += d * final
        T = np.linalg.solve(A, 2 * m.strength * (1 - d) * body.both)
        P = opening / (2 * (body.load - body.both @ (body.weights * T)))
        T *= P
        g = 2 * (body.both * P - body.bonded @ (body.weights * T))
        # T/(1 - d) = P_n g/(d zeta_c): the one where d is small, the other where it is near 1
        some = d > 0.5
        ratio = np.where(some, g / final, T / m.strength) / np.where(some, d, 1 - d)
        ratio = np.where(d < 1, np.maximum(ratio, 0.0), 0.0)
        if ratio.max() > 1.0:
            d = np.minimum(d + most * (ratio > 1.0), 1.0)
            continue
        speed = rate(ratio)
        release = -np.trapezoid(T, g)
        rows.append((N, crack, release))
        cycles = most / speed.max()
        d, N = np.minimum(d + cycles * speed, 1.0), N + cycles
    return Growth(*np.array(rows).T)
