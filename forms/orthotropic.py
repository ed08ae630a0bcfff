"""Orthotropic bodies: plies, wood, aligned fibres, with axes that may turn from cell to cell."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping, Sequence
from numbers import Real
from typing import Any

import numpy as np
import ufl
from numpy.typing import NDArray
from ufl.core.expr import Expr

from .materials import Material, one_number

#: Pairs of axes, in the order of nu and G.
_PAIRS = ((0, 1), (0, 2), (1, 2))


class Orthotropic(Material):
    """Orthotropic St. Venant-Kirchhoff material, linear elastic at small strain.

    W = E:C:E/2 of the Green strain E = (F^T F - I)/2 in the axes of the material, which are turned
    about z by ``angle`` from x, y, z. C is the inverse of the compliance: 1/E_i and -nu_ij/E_i
    for axial strains, 1/G_ij for shear (Jones 1999, Mechanics of Composite Materials, 2.4). In
    plane strain axis 3 is out of the plane; in axisymmetry x, y, z are r, z and hoop. W is meant
    for moderate strains: compressed to about half, it softens as every St. Venant-Kirchhoff
    material does.

    Args:
        E: Young's moduli E_1, E_2, E_3 [MPa].
        nu: Poisson's ratios nu_12, nu_13, nu_23; nu_ij = -strain j / strain i under stress i.
        G: Shear moduli G_12, G_13, G_23 [MPa].
        angle: From x to axis 1, towards y [degrees]: a number, f(x) at midpoints x (3, n) of
            cells, a Function of degree 0, or an array with a value for each local cell of the mesh,
            ghosts included.

    Raises:
        TypeError: a constant is no number, or three of them are not given.
        ValueError: a modulus is not positive, or the ratios make no positive energy.
    """

    free_at_rest = True

    def __init__(
        self,
        E: Sequence[float],
        nu: Sequence[float],
        G: Sequence[float],
        angle: Any = 0.0,
    ):
        E, nu, G = (_three(name, v) for name, v in (("E", E), ("nu", nu), ("G", G)))
        for name, moduli in (("E", E), ("G", G)):
            if not (np.isfinite(moduli).all() and (moduli > 0).all()):
                raise ValueError(
                    f"Orthotropic: {name} = {moduli.tolist()} must be positive and finite"
                )
        C = _axial_stiffness(E, nu)
        number = isinstance(angle, Real)
        if number and not math.isfinite(angle):
            raise ValueError(f"Orthotropic: angle = {angle} must be finite [degrees]")
        parameters: dict[str, Any] = {f"C{i}{j}": C[i, j] for i in range(3) for j in range(i, 3)}
        parameters |= {f"G{i}{j}": G[n] for n, (i, j) in enumerate(_PAIRS)}
        self._turned = not (number and angle == 0)
        self.parameters = parameters | ({"angle": angle} if self._turned else {})

    @property
    def kernel_key(self) -> Hashable:
        """One kernel for axes along x, y, z, and one for axes that are turned."""
        return type(self), self._turned

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """E:C:E/2 of the Green strain."""
        return self.linear_energy((F.T * F - ufl.Identity(3)) / 2, parameters)

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """E:C:E/2 in the axes of the material."""
        p = parameters
        if self._turned:
            angle = p["angle"] * (math.pi / 180)
            c, s = ufl.cos(angle), ufl.sin(angle)
            # Columns are the axes of the material.
            axes = ufl.as_matrix([[c, -s, 0], [s, c, 0], [0, 0, 1]])
            strain = axes.T * strain * axes
        axial = sum(
            p[f"C{min(i, j)}{max(i, j)}"] * strain[i, i] * strain[j, j]
            for i in range(3)
            for j in range(3)
        )
        shear = sum(p[f"G{i}{j}"] * (strain[i, j] + strain[j, i]) ** 2 for i, j in _PAIRS)
        return (axial + shear) / 2


def _three(name: str, values: Sequence[float]) -> NDArray[np.float64]:
    """Three constants of a material.

    Raises:
        TypeError: they are something else.
    """
    if np.shape(values) != (3,):
        raise TypeError(
            f"Orthotropic: {name} = {values!r} must be three numbers, for example E=(E1, E2, E3), "
            "nu=(nu12, nu13, nu23), G=(G12, G13, G23)"
        )
    return np.array([one_number(f"Orthotropic: {name}", v) for v in values])


def _axial_stiffness(E: NDArray[np.float64], nu: NDArray[np.float64]) -> NDArray[np.float64]:
    """C of the axial strains (3, 3) [MPa].

    Raises:
        ValueError: the compliance is not positive definite.
    """
    S = np.diag(1 / E)
    for value, (i, j) in zip(nu, _PAIRS, strict=True):
        S[i, j] = S[j, i] = -value / E[i]
    scaled = S * np.sqrt(np.outer(E, E))
    if not np.isfinite(scaled).all() or np.linalg.eigvalsh(scaled).min() <= 0:
        raise ValueError(
            f"Orthotropic: nu = {nu.tolist()} gives an energy that is not positive; nu_ij must "
            "stay below sqrt(E_i/E_j), and 1 - nu12 nu21 - nu13 nu31 - nu23 nu32 - 2 nu21 nu32 "
            "nu13 above 0 with nu_ji = nu_ij E_j/E_i; perhaps nu_ji was given for nu_ij"
        )
    return np.linalg.inv(S)
