"""Laminates: plies stacked along z, several per layer of cells."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np
import ufl
from numpy.typing import NDArray
from ufl.core.expr import Expr

from .materials import Material, one_number
from .orthotropic import Orthotropic

#: Components of a strain or stress: 11, 22, 33, 23, 13, 12.
_COMPONENTS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))

#: Nonzero entries of C of a ply rotated about z, upper triangle.
_ENTRIES = tuple(
    (a, b) for a, b in itertools.combinations_with_replacement(range(6), 2)
    if (a in (3, 4)) == (b in (3, 4))
)  # fmt: skip

#: Quadrature points of cells of degree 2 across a layer, zeta in (-1, 1) from below.
_POINTS = np.array([-math.sqrt(0.6), 0.0, math.sqrt(0.6)])

#: |zeta| above this value is on a face of a layer, the upper one for zeta > 0.
_FACE = 1 - 1e-9


class Laminate(Material):
    """Plies stacked along z; a layer of hexahedra of degree 2 contains several plies.

    Over a layer of cells, with zeta in (-1, 1) from its lower to its upper face, the moduli C of
    the plies are replaced by their projection on quadratic polynomials,

        C~ = sum_k C_k P_k(zeta),    C_k = (2 k + 1)/2 int C P_k dzeta,    k = 0, 1, 2,

    P_k the Legendre polynomials. The energy of every strain linear in zeta is then that of the
    plies, and the stiffnesses A, B and D of classical lamination theory are exact in every layer,
    with the three points that cells of degree 2 have across it. On the faces, where interfaces
    evaluate tractions, C~ is the C of the adjacent ply.

    Args:
        plies: The plies from below, each with its angle to x.
        thickness: One for all plies, or one for each [mm].
        bottom: z of the lower face of the first ply [mm].
        rows: Number of layers of cells, of equal height, in the laminate.

    Raises:
        TypeError: a ply is not :class:`Orthotropic`, or its angle is not a number.
        ValueError: a thickness is not positive, their number does not match the plies, there are no
            rows, or the plies of a layer differ so much that C~ is not positive definite at a
            point.
    """

    free_at_rest = True

    def __init__(
        self,
        plies: Sequence[Orthotropic],
        thickness: float | Sequence[float],
        bottom: float = 0.0,
        rows: int = 1,
    ):
        self._plies = [_moduli(ply) for ply in plies]
        heights = _heights(thickness, len(self._plies))
        if rows < 1:
            raise ValueError(f"Laminate: rows = {rows} must be at least 1")
        one_number("Laminate: bottom", bottom)
        self._levels = bottom + np.concatenate([[0.0], np.cumsum(heights)])
        self._faces = np.linspace(self._levels[0], self._levels[-1], rows + 1)
        layers = np.array([self._projection(*ends) for ends in itertools.pairwise(self._faces)])
        _check_positive(layers)
        # On the faces, lower and upper.
        outer = np.array([[self._plies[i] for i in self._at(z)] for z in self._ends()])
        values = np.concatenate([layers, outer.swapaxes(0, 1)], axis=1)
        self.parameters = {
            "half": (self._levels[-1] - self._levels[0]) / (2 * rows),
            "middle": self._by_layer(self._middles),
        } | {
            f"C{a}{b}_{name}": self._by_layer(values[:, k, a, b])
            for a, b in _ENTRIES
            for k, name in enumerate((0, 1, 2, "low", "high"))
        }

    @property
    def _middles(self) -> NDArray[np.float64]:
        """z of the midplanes of the layers [mm]."""
        return (self._faces[1:] + self._faces[:-1]) / 2

    def _ends(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """z just inside of the lower faces of the layers, and of the upper ones [mm]."""
        inside = 1e-9 * (self._levels[-1] - self._levels[0])
        return self._faces[:-1] + inside, self._faces[1:] - inside

    def _at(self, z: NDArray[np.float64]) -> NDArray[np.intp]:
        return np.searchsorted(self._levels, z) - 1

    def _projection(self, low: float, high: float) -> NDArray[np.float64]:
        """C_k of a layer (3, 6, 6) [MPa]."""
        zeta = np.clip((2 * self._levels - low - high) / (high - low), -1, 1)
        # Antiderivatives of (2 k + 1)/2 P_k.
        integrals = np.array([zeta / 2, 3 / 4 * zeta**2, 5 / 4 * (zeta**3 - zeta)])
        return np.einsum("kp,pab->kab", np.diff(integrals, axis=1), np.array(self._plies))

    def _by_layer(self, values: NDArray[np.float64]) -> Callable[[NDArray], NDArray]:
        def at(x: NDArray) -> NDArray:
            layer = np.abs(x[2][:, None] - self._middles).argmin(axis=1)
            off = np.abs(x[2] - self._middles[layer]).max(initial=0)
            if off > 1e-6 * (self._faces[1] - self._faces[0]):
                faces = ", ".join(f"{z:.6g}" for z in self._faces)
                raise ValueError(
                    f"the midplane of a cell is {off:.3g} mm from that of a layer: Laminate needs "
                    f"layers of cells between z = {faces}, see rows="
                )
            return values[layer]

        return at

    def plate_stiffness(self) -> tuple[NDArray, NDArray, NDArray]:
        """A [N/mm], B [N] and D [N mm] of classical lamination theory, (3, 3) each.

        About the midplane of the laminate, in the order 11, 22, 12: forces N = A.e + B.k and
        moments M = B.e + D.k per length, from the midplane strains e and the curvatures k, both
        with engineering shear; plane stress in every ply (Jones 1999, Mechanics of Composite
        Materials, 4).
        """
        plane, rest = [0, 1, 5], [2, 3, 4]
        Q = np.array(
            [
                C[np.ix_(plane, plane)]
                - C[np.ix_(plane, rest)]
                @ np.linalg.solve(C[np.ix_(rest, rest)], C[np.ix_(rest, plane)])
                for C in self._plies
            ]
        )
        z = self._levels - (self._levels[0] + self._levels[-1]) / 2
        moments = [np.einsum("p,pab->ab", np.diff(z**k) / k, Q) for k in (1, 2, 3)]
        return moments[0], moments[1], moments[2]

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """E:C~:E/2 of the Green strain."""
        return self.linear_energy((F.T * F - ufl.Identity(3)) / 2, parameters)

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """E:C~:E/2.

        Raises:
            ValueError: the mesh is not 3D.
        """
        p = parameters
        x = ufl.SpatialCoordinate(ufl.domain.extract_unique_domain(p["half"]))
        if len(x) != 3:
            raise ValueError("Laminate: plies are stacked along z, the mesh must be 3D")
        zeta = (x[2] - p["middle"]) / p["half"]
        low = ufl.conditional(ufl.lt(zeta, -_FACE), 1.0, 0.0)
        high = ufl.conditional(ufl.gt(zeta, _FACE), 1.0, 0.0)
        inside = 1 - low - high
        weights = {
            "0": inside,
            "1": inside * zeta,
            "2": inside * (3 * zeta**2 - 1) / 2,
            "low": low,
            "high": high,
        }
        e = [strain[i, j] if i == j else strain[i, j] + strain[j, i] for i, j in _COMPONENTS]
        return sum(
            (0.5 if a == b else 1) * e[a] * e[b]
            * sum(p[f"C{a}{b}_{name}"] * weight for name, weight in weights.items())
            for a, b in _ENTRIES
        )  # fmt: skip


def _heights(thickness: float | Sequence[float], plies: int) -> NDArray[np.float64]:
    """Thickness of every ply [mm]."""
    heights = np.asarray(thickness)
    if heights.shape not in ((), (plies,)) or plies == 0:
        raise ValueError(
            f"Laminate: {plies} plies, and a thickness of shape {heights.shape}; give one number, "
            "or one for each ply"
        )
    number = heights.dtype.kind in "iuf"
    if not (number and np.isfinite(heights).all() and (heights > 0).all()):
        raise ValueError(f"Laminate: thickness = {thickness!r} must be positive and finite")
    return np.broadcast_to(heights, plies)


def _moduli(ply: Orthotropic) -> NDArray[np.float64]:
    """C of a ply in x, y, z (6, 6), for strains 11, 22, 33, 23, 13, 12 with engineering shear
    [MPa]."""
    if not isinstance(ply, Orthotropic):
        raise TypeError(f"Laminate: a ply must be Orthotropic(E=, nu=, G=, angle=), got {ply!r}")
    p = ply.parameters
    angle = math.radians(one_number("Laminate: angle of a ply", p.get("angle", 0.0)))
    C = np.zeros((3, 3, 3, 3))
    for i, j in itertools.product(range(3), repeat=2):
        low, high = min(i, j), max(i, j)
        C[i, i, j, j] = p[f"C{low}{high}"]
        if i != j:
            C[i, j, i, j] = C[i, j, j, i] = p[f"G{low}{high}"]
    c, s = math.cos(angle), math.sin(angle)
    axes = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    if "R00" in p:
        axes = np.array([[p[f"R{i}{j}"] for j in range(3)] for i in range(3)])
    C = np.einsum("ia,jb,kc,ld,abcd->ijkl", axes, axes, axes, axes, C)
    return np.array([[C[i, j, k, m] for k, m in _COMPONENTS] for i, j in _COMPONENTS])


def _check_positive(layers: NDArray[np.float64]) -> None:
    """Refuse layers (n, 3, 6, 6) whose C~ is not positive definite at a point."""
    legendre = np.array([np.ones(3), _POINTS, (3 * _POINTS**2 - 1) / 2])
    for number, layer in enumerate(layers):
        least = np.linalg.eigvalsh(np.einsum("kz,kab->zab", legendre, layer)).min()
        if least <= 0:
            raise ValueError(
                f"Laminate: the plies of layer {number} of cells differ so much that their "
                f"quadratic projection is not positive definite (least modulus {least:.3g} MPa); "
                "use one row per ply, or fewer rows"
            )
