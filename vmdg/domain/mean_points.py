"""Mean dilatation of materials that are evaluated at points.

The material is evaluated at F_bar of :mod:`forms.dilatation`, with P_bar and A_bar there. Virtual
work P_bar : dF_bar defines what is conjugate to F and theta. With J = det F, M = F^-T,
a = (theta/J)^(1/n) and c = P_bar : F of the n axes,

    S_F = a P_bar - a c/n M,    S_theta = a c/(n theta),

as dw/dF and dw/dtheta of an elastic body, with the derivatives

    S_F,F = G^T A_bar G - a/n (P_bar (x) M + M (x) P_bar) + a c/n^2 M (x) M - a c/n M',
    S_F,theta = G^T A_bar g + S_F/(n theta),
    S_theta,theta = g A_bar g + (1/n - 1) a c/(n theta^2),

G = dF_bar/dF = a (1 - F (x) M/n), g = dF_bar/dtheta = a F/(n theta), M'_iJkL = -F^-1_Jk F^-1_Li.
The stress at a point, for tractions, is P = S_F + S_theta J M. At small strain F and M become I,
a, J and theta 1, and A_bar alone has a derivative.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..forms.geometry import Entries
from .shapes import determinants

Array = NDArray[np.float64]


class MeanPoints:
    """F_bar at points, and stress and moduli conjugate to F and theta there.

    Deformations are diag(F, theta), at small strain diag(strain, theta - 1), (n, 4, 4); rows and
    columns of moduli are the entries of F, then theta.
    """

    def __init__(self, entries: Entries, axes: int, small: bool):
        self._rows, self._columns = np.array(entries).T
        self._axes, self._small = axes, small
        self._unit = (self._rows == self._columns).astype(float)

    def _parts(self, deformation: Array) -> tuple[Array, Array, Array, Array]:
        """F and M by entries (n, k), J and theta (n,)."""
        if self._small:
            unit = np.tile(self._unit, (len(deformation), 1))
            return unit, unit, np.ones(len(unit)), np.ones(len(unit))
        F = deformation[:, :3, :3]
        M = np.array(np.linalg.inv(F)[:, self._columns, self._rows], dtype=float)
        return F[:, self._rows, self._columns], M, determinants(F), deformation[:, 3, 3]

    def effective(self, deformation: Array) -> Array:
        """F_bar, at small strain the strain, (n, 3, 3)."""
        result = deformation[:, :3, :3].copy()
        if self._small:
            missing = deformation[:, 3, 3] - result[:, self._rows, self._columns] @ self._unit
            result[:, self._rows, self._columns] += missing[:, None] * self._unit / self._axes
            return result
        F, _, J, theta = self._parts(deformation)
        a = (theta / J) ** (1 / self._axes)
        result[:, self._rows, self._columns] = a[:, None] * F
        return result

    def conjugate(self, deformation: Array, stress: Array, moduli: Array) -> tuple[Array, Array]:
        """diag(S_F, S_theta) (n, 4, 4) and its derivative (n, k + 1, k + 1).

        Args:
            stress: P_bar (n, 3, 3).
            moduli: A_bar by entries (n, k, k).
        """
        F, M, J, theta = self._parts(deformation)
        n, k = self._axes, len(self._rows)
        a = ((theta / J) ** (1 / n))[:, None]
        P = stress[:, self._rows, self._columns]
        c = a * (P * F).sum(axis=1, keepdims=True)
        S = np.zeros_like(deformation)
        S[:, :3, :3] = stress
        S[:, self._rows, self._columns] = by_F = a * P - c / n * M
        S[:, 3, 3] = (c / n)[:, 0] / theta
        g = a * F / (n * theta[:, None])
        G = np.concatenate(
            [a[..., None] * np.eye(k) - a[..., None] / n * _outer(F, M), g[..., None]], axis=2
        )
        result = G.transpose(0, 2, 1) @ moduli @ G
        if not self._small:
            mixed = a[..., None] / n * _outer(P, M)
            result[:, :k, :k] -= mixed + mixed.transpose(0, 2, 1)
            result[:, :k, :k] += (c / n)[..., None] * (_outer(M, M) / n - self._turn(deformation))
            by_both = by_F / (n * theta[:, None])
            result[:, :k, k] += by_both
            result[:, k, :k] += by_both
            result[:, k, k] += (1 / n - 1) * c[:, 0] / (n * theta**2)
        return S, result

    def stress(self, deformation: Array, S: Array) -> Array:
        """P = S_F + S_theta J M (n, 3, 3)."""
        _, M, J, _ = self._parts(deformation)
        P = S[:, :3, :3].copy()
        P[:, self._rows, self._columns] += (S[:, 3, 3] * J)[:, None] * M
        return P

    def stress_moduli(self, deformation: Array, S: Array, moduli: Array) -> Array:
        """Derivative of :meth:`stress` (n, k + 1, k + 1), its last row zero."""
        _, M, J, _ = self._parts(deformation)
        k = M.shape[1]
        result = np.zeros_like(moduli)
        result[:, :k] = moduli[:, :k] + _outer(J[:, None] * M, moduli[:, k])
        result[:, :k, :k] += S[:, 3, 3, None, None] * self.volume_moduli(deformation)
        return result

    def volume_moduli(self, deformation: Array) -> Array:
        """d2J/dF2 by entries (n, k, k), zero at small strain."""
        _, M, J, _ = self._parts(deformation)
        return J[:, None, None] * (_outer(M, M) + self._turn(deformation)) * (not self._small)

    def _turn(self, deformation: Array) -> Array:
        """M' by entries (n, k, k)."""
        if self._small:
            return np.zeros((len(deformation), len(self._rows), len(self._rows)))
        inverse = np.linalg.inv(deformation[:, :3, :3])
        i, J = self._rows[:, None], self._columns[:, None]
        return -inverse[:, J, self._rows] * inverse[:, self._columns, i]


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None]
