"""What materials at points answer for the deformation of a body.

An eigenstrain, F = F_e F_s: the material is evaluated at F_e = F F_s^-1, and of its W_e, P_e and
A_e the body has, per volume before F_s with J_s = det F_s,

    W = J_s W_e,   P = J_s P_e F_s^-T,   A_iJkL = J_s A_e,iKkM F_s^-1_JK F_s^-1_LM;

at small strain the strain is reduced by F_s - I, and nothing else changes.

Plane stress: F_33 is such that P_33 = 0, by Newton's method at every point. With dP_33 = 0 the
moduli in the plane are A_ab - A_a3 A_3b / A_33, 3 being the pair 33. Moduli between zero and the
elastic ones remain so, as Schur complements do.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..materials.point import PointMaterial, Response
from .shapes import determinants

Array = NDArray[np.float64]

#: P_33 in plane stress that counts as zero, relative to the stress and to the moduli.
_STRESS, _MODULI = 1e-12, 1e-16

#: Evaluations for that: bisection alone needs 60.
_MOST = 100


class PointEvaluator:
    """A material and how it is asked."""

    def __init__(self, material: PointMaterial, dt: float, small: bool, plane_stress: bool):
        self._material, self._dt, self._small = material, dt, small
        self._plane_stress = plane_stress

    def __call__(
        self, deformation: Array, state: Array, strain: Array | None
    ) -> tuple[Response, Array]:
        """The answer at some points, not a number where an iteration that diverges asks for it, and
        the deformation with F_33.

        Args:
            deformation: F, at small strain the strain, (n, 3, 3); in plane stress 33 is a guess.
            strain: Eigenstrain F_s - I (n, 3, 3); None for none.
        """
        if not np.isfinite(deformation).all():
            n = len(deformation)
            shapes = (n, 3, 3), (n, 3, 3, 3, 3), state.shape, (n,), (n,)
            return Response(*(np.full(shape, np.nan) for shape in shapes)), deformation
        if self._plane_stress:
            return self._thin(deformation, state, strain)
        return self._strained(deformation, state, strain), deformation

    def _thin(
        self, deformation: Array, state: Array, strain: Array | None
    ) -> tuple[Response, Array]:
        """Without P_33."""
        F, x = deformation.copy(), deformation[:, 2, 2].copy()
        low, high = np.full(len(F), -np.inf if self._small else 0.0), np.full(len(F), np.inf)
        found = Response(*map(np.array, self._strained(F, state, strain)))
        rows = np.arange(len(F))
        for _ in range(_MOST):
            P, A = found.stress[:, 2, 2], found.moduli[:, 2, 2, 2, 2]
            zero = _STRESS * np.abs(found.stress).max(axis=(1, 2)) + _MODULI * np.abs(A)
            rows = np.flatnonzero(~(np.abs(P) <= zero))
            if not len(rows):
                break
            high = np.where(P > 0, x, high)
            low = np.where(P < 0, x, low)
            x[rows] -= P[rows] / np.where(A[rows] > 0, A[rows], np.inf)
            astray = rows[~((x[rows] > low[rows]) & (x[rows] < high[rows]))]
            with np.errstate(invalid="ignore"):
                x[astray] = (low[astray] + high[astray]) / 2
            if not np.isfinite(x).all():
                break  # as where the material has softened so far that nothing bounds F_33
            F[rows, 2, 2] = x[rows]
            own = None if strain is None else strain[rows]
            for known, new in zip(found, self._strained(F[rows], state[rows], own), strict=True):
                known[rows] = new
        found.stress[rows] = np.nan
        F[rows] = deformation[rows]
        moduli = found.moduli
        to_33 = moduli[..., 2, 2, None, None] * moduli[:, None, None, 2, 2]
        with np.errstate(divide="ignore", invalid="ignore"):  # points without an answer
            moduli -= to_33 / moduli[:, 2, 2, 2, 2, None, None, None, None]
        return found, F

    def _strained(self, deformation: Array, state: Array, strain: Array | None) -> Response:
        if strain is None:
            return self._checked(deformation, state)
        if self._small:
            return self._checked(deformation - strain, state)
        F_s = np.eye(3) + strain
        inverse, J = np.linalg.inv(F_s), determinants(F_s)
        found = self._checked(deformation @ inverse, state)
        turned = inverse.transpose(0, 2, 1)
        moduli = np.einsum("piKkM,pJK,pLM->piJkL", found.moduli, inverse, inverse, optimize=True)
        return Response(
            J[:, None, None] * (found.stress @ turned),
            J[:, None, None, None, None] * moduli,
            found.state,
            J * found.stored,
            J * found.dissipated,
        )

    def _checked(self, deformation: Array, state: Array) -> Response:
        n, material = len(deformation), self._material
        shapes = (n, 3, 3), (n, 3, 3, 3, 3), state.shape, (n,), (n,)
        # A material that writes into what it is given writes into copies.
        found = material(deformation.copy(), state.copy(), self._dt, self._small)
        for name, value, shape in zip(Response._fields, found, shapes, strict=True):
            if np.shape(value) != shape:
                raise ValueError(
                    f"{type(material).__name__}: {name} of {n} points has shape "
                    f"{np.shape(value)}, expected {shape}, see vmdg.Response"
                )
        return found
