"""Orthotropic and cubic materials with their own axes: plies, wood, aligned fibres, crystals."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from numbers import Real
from typing import Any, cast

import numpy as np
import ufl
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from .geometry import with_entry
from .materials import Material, one_number

#: Pairs of axes, in the order of nu and G.
_PAIRS = ((0, 1), (0, 2), (1, 2))

#: Deviation from 1 of the cosine between an axis and z that counts as rounding.
_ALONG = 1e-12


class Orthotropic(Material):
    """Orthotropic St. Venant-Kirchhoff material, linear elastic at small strain.

    W = E:C:E/2 of the Green strain E = (F^T F - I)/2 in the material axes, which are rotated about
    z by ``angle`` from x, y, z. C is the inverse of the compliance: 1/E_i and -nu_ij/E_i for axial
    strains, 1/G_ij for shear (Jones 1999, Mechanics of Composite Materials, 2.4). In plane strain
    axis 3 is out of the plane; in axisymmetry x, y, z are r, z and hoop. W is intended for moderate
    strains: compressed to about half its length it softens, like every St. Venant-Kirchhoff
    material.

    Args:
        E: Young's moduli E_1, E_2, E_3 [MPa].
        nu: Poisson's ratios nu_12, nu_13, nu_23; nu_ij = -strain j / strain i under stress i.
        G: Shear moduli G_12, G_13, G_23 [MPa].
        angle: From x to axis 1, towards y [degrees]: a number, f(x) at midpoints x (3, n) of
            cells, a Function of degree 0, or an array with a value for each local cell of the mesh,
            ghosts included.
        rotation: Instead of ``angle``, general axes: a matrix (3, 3) whose columns are axes 1, 2, 3
            in x, y, z, for example ``scipy.spatial.transform.Rotation.as_matrix``.

    Raises:
        TypeError: a constant is not a number, or their number is not three.
        ValueError: a modulus is not positive, the energy is not positive definite, or the rotation
            is invalid.
    """

    free_at_rest = True

    def __init__(
        self,
        E: ArrayLike,
        nu: ArrayLike,
        G: ArrayLike,
        angle: Any = 0.0,
        rotation: ArrayLike | None = None,
    ):
        E, nu, G = (_three(name, v) for name, v in (("E", E), ("nu", nu), ("G", G)))
        for name, moduli in (("E", E), ("G", G)):
            if not (np.isfinite(moduli).all() and (moduli > 0).all()):
                raise ValueError(
                    f"Orthotropic: {name} = {moduli.tolist()} must be positive and finite"
                )
        self._set(_axial_stiffness(E, nu), G, angle, rotation)

    def _set(
        self, C: NDArray[np.float64], G: NDArray[np.float64], angle: Any, rotation: ArrayLike | None
    ) -> None:
        """Parameters, from the stiffness of axial strains (3, 3) and the shear moduli [MPa]."""
        name = type(self).__name__
        number = isinstance(angle, Real)
        if number and not math.isfinite(angle):
            raise ValueError(f"{name}: angle = {angle} must be finite [degrees]")
        parameters: dict[str, Any] = {f"C{i}{j}": C[i, j] for i in range(3) for j in range(i, 3)}
        parameters |= {f"G{i}{j}": G[n] for n, (i, j) in enumerate(_PAIRS)}
        self._turned = not (number and angle == 0)
        if rotation is not None:
            if self._turned:
                raise ValueError(f"{name}: give an angle or a rotation, not both")
            axes = _checked_rotation(name, rotation)
            parameters |= {f"R{i}{j}": axes[i, j] for i in range(3) for j in range(3)}
        elif self._turned:
            parameters["angle"] = angle
        self._rotated = rotation is not None
        self.parameters = parameters

    @property
    def kernel_key(self) -> Hashable:
        """One kernel for axes along x, y, z, one for axes rotated about z, one for all others."""
        return Orthotropic, self._turned, self._rotated

    @property
    def mirrored(self) -> bool:  # type: ignore[override] # a property here, an attribute elsewhere
        """Whether axis 3 is along z."""
        return not self._rotated or abs(abs(self.parameters["R22"]) - 1) < _ALONG

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """E:C:E/2 of the Green strain."""
        return self.linear_energy((F.T * F - ufl.Identity(3)) / 2, parameters)

    def free_stretch(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """sqrt(1 + 2 E_33) with E_33 = -(C_13 E_11 + C_23 E_22)/C_33 at zero stress."""
        p, strain = parameters, self._in_own_axes((F.T * F - ufl.Identity(2)) / 2, parameters)
        return ufl.sqrt(1 - 2 * (p["C02"] * strain[0, 0] + p["C12"] * strain[1, 1]) / p["C22"])

    def plane_stress_energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """E:Q:E/2, Q_ab = C_ab - C_a3 C_b3/C_33."""
        p, strain = parameters, self._in_own_axes((F.T * F - ufl.Identity(2)) / 2, parameters)
        axial = sum(
            (p[f"C{min(i, j)}{max(i, j)}"] - p[f"C{i}2"] * p[f"C{j}2"] / p["C22"])
            * strain[i, i]
            * strain[j, j]
            for i in range(2)
            for j in range(2)
        )
        return (axial + p["G01"] * (strain[0, 1] + strain[1, 0]) ** 2) / 2

    def _in_own_axes(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """Components in the material axes of a strain (3, 3), or in the plane (2, 2)."""
        n = range(strain.ufl_shape[0])
        if self._rotated:
            axes = ufl.as_matrix([[parameters[f"R{i}{j}"] for j in n] for i in n])
            return axes.T * strain * axes
        if not self._turned:
            return strain
        angle = parameters["angle"] * (math.pi / 180)
        c, s = ufl.cos(angle), ufl.sin(angle)
        # Columns are the material axes.
        axes = ufl.as_matrix([[c, -s], [s, c]])
        axes = axes if len(n) == 2 else with_entry(axes, 1)
        return axes.T * strain * axes

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """E:C:E/2 in the material axes."""
        p, strain = parameters, self._in_own_axes(strain, parameters)
        axial = sum(
            p[f"C{min(i, j)}{max(i, j)}"] * strain[i, i] * strain[j, j]
            for i in range(3)
            for j in range(3)
        )
        shear = sum(p[f"G{i}{j}"] * (strain[i, j] + strain[j, i]) ** 2 for i, j in _PAIRS)
        return (axial + shear) / 2


class Cubic(Orthotropic):
    """A cubic crystal: St. Venant-Kirchhoff as :class:`Orthotropic`, linear at small strain.

    Stress_11 = C11 strain_11 + C12 (strain_22 + strain_33), stress_12 = 2 C44 strain_12 along the
    edges of the crystal, etc. (Nye 1985, Physical Properties of Crystals, VIII). The ratio 2
    C44/(C11 - C12) is 1 for an isotropic body, 3.2 for copper, 2.5 for nickel.

    Args:
        C11: Axial stiffness [MPa].
        C12: Coupling of axial strains [MPa].
        C44: Shear modulus on the faces of the crystal [MPa].
        angle: Angle of its edges in the plane, as for :class:`Orthotropic` [degrees].
        rotation: Instead of ``angle``, general axes, as for :class:`Orthotropic`.

    Raises:
        TypeError: a constant is not a number.
        ValueError: the energy is not positive definite, or the rotation is invalid.
    """

    def __init__(
        self,
        C11: float,
        C12: float,
        C44: float,
        angle: Any = 0.0,
        rotation: ArrayLike | None = None,
    ):
        C11, C12, C44 = (
            one_number(f"Cubic: {name}", value)
            for name, value in (("C11", C11), ("C12", C12), ("C44", C44))
        )
        if not (C44 > 0 and C11 > abs(C12) and C11 + 2 * C12 > 0 and math.isfinite(C11 + C44)):
            raise ValueError(
                f"Cubic: C11 = {C11}, C12 = {C12}, C44 = {C44} give an energy that is not positive "
                "definite; it must satisfy C44 > 0, C11 > |C12| and C11 + 2 C12 > 0"
            )
        self._set(C12 + (C11 - C12) * np.eye(3), np.full(3, C44), angle, rotation)


def _checked_rotation(name: str, rotation: ArrayLike) -> NDArray[np.float64]:
    axes = np.asarray(rotation)
    if (
        axes.shape != (3, 3)
        or axes.dtype.kind not in "iuf"
        or not np.abs(axes.T @ axes - np.eye(3)).max() < 1e-10
        or np.linalg.det(axes) < 0
    ):
        raise ValueError(
            f"{name}: rotation = {axes.tolist()} must be a matrix (3, 3) with orthonormal columns, "
            "the material axes, and determinant 1"
        )
    return axes.astype(float)


def _three(name: str, values: ArrayLike) -> NDArray[np.float64]:
    if np.shape(values) != (3,):
        raise TypeError(
            f"Orthotropic: {name} = {values!r} must be three numbers, for example E=(E1, E2, E3), "
            "nu=(nu12, nu13, nu23), G=(G12, G13, G23)"
        )
    return np.array([one_number(f"Orthotropic: {name}", v) for v in cast(Sequence[Any], values)])


def _axial_stiffness(E: NDArray[np.float64], nu: NDArray[np.float64]) -> NDArray[np.float64]:
    """C of the axial strains (3, 3) [MPa]."""
    S = np.diag(1 / E)
    for value, (i, j) in zip(nu, _PAIRS, strict=True):
        S[i, j] = S[j, i] = -value / E[i]
    scaled = S * np.sqrt(np.outer(E, E))
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled).min() <= 0:
        raise ValueError(
            f"Orthotropic: nu = {nu.tolist()} gives an energy that is not positive definite; nu_ij "
            "must stay below sqrt(E_i/E_j), and 1 - nu12 nu21 - nu13 nu31 - nu23 nu32 - 2 nu21 "
            "nu32 nu13 above 0 with nu_ji = nu_ij E_j/E_i; was nu_ji given for nu_ij?"
        )
    return np.asarray(np.linalg.inv(S), dtype=float)
