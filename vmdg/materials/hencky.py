"""Hencky's strain ln U, and P and dP/dF of a stress that is conjugate to it.

With F = sum lambda_a n_a (x) N_a and c_a = lambda_a^2, divided differences f of the logarithm,

    f_ab = f[c_a, c_b] = (ln c_a - ln c_b)/(c_a - c_b),
    f_acb = f[c_a, c_c, c_b] = (f_ac - f_cb)/(c_a - c_b),

and all tensors in the axes N_a, those of F and P in n_a and N_b, are (Daleckii and Krein; Miehe and
Lambrecht 2001)

    dH_ab = f_ab dC_ab/2,   S_ab = f_ab T_ab,   P_ab = lambda_a S_ab,
    CC = f_ab EE_abcd f_cd + 4 sym(T_ad f_abd 1_bc),
    A_abcd = 1_ac S_bd + lambda_a CC_abcd lambda_c.
"""

from __future__ import annotations

import itertools

import numpy as np

from .point import Array

_ONE = np.eye(3)
#: Sets of three principal axes, the outer ones first and last, and that of every (a, b, d).
_SETS = list(itertools.combinations_with_replacement(range(3), 3))
_LOW, _MIDDLE, _HIGH = np.array(_SETS).T
_SET_OF = [_SETS.index(tuple(sorted(three))) for three in itertools.product(range(3), repeat=3)]
#: Spread of three squares, relative to their mean, below which a series is more accurate.
_NEAR = 1e-3


def _symmetrized() -> Array:
    """4 sym(T_ad f_abd 1_bc), abcd, from the products of T and f, abd (27, 81)."""
    unit = np.eye(27).reshape(27, 3, 3, 3)
    whole = np.einsum("kabd,bc->kabcd", unit, _ONE)
    whole = whole + whole.transpose(0, 2, 1, 3, 4)
    return (whole + whole.transpose(0, 1, 2, 4, 3)).reshape(27, 81)


_GEOMETRIC = _symmetrized()


class Hencky:
    """ln U of some deformation gradients.

    Args:
        F: Deformation gradients (n, 3, 3), with positive determinant.

    Attributes:
        strain: ln U (n, 3, 3).
    """

    def __init__(self, F: Array):
        self._c, self._axes = np.linalg.eigh(F.transpose(0, 2, 1) @ F)
        self._stretch = np.sqrt(self._c)
        self._turned = (F @ self._axes) / self._stretch[:, None]
        self.strain = self._back(self._axes * (np.log(self._c) / 2)[:, None])

    def pushed(self, T: Array, moduli: Array) -> tuple[Array, Array]:
        """P (n, 3, 3) and its derivative by F (n, 3, 3, 3, 3) [MPa].

        Args:
            T: Conjugate to ln U (n, 3, 3) [MPa].
            moduli: Its isotropic derivative by ln U (n, 3, 3, 3, 3) [MPa].
        """
        n, stretch = len(T), self._stretch
        slopes = _slopes(self._c[:, :, None], self._c[:, None])
        T = self._axes.transpose(0, 2, 1) @ T @ self._axes
        S = slopes * T
        flat = slopes.reshape(n, 9)
        inner = flat[:, :, None] * moduli.reshape(n, 9, 9) * flat[:, None]
        products = T[:, :, None] * self._curvatures(slopes)[:, _SET_OF].reshape(n, 3, 3, 3)
        inner += (products.reshape(n, 27) @ _GEOMETRIC).reshape(n, 9, 9)
        first = np.repeat(stretch, 3, axis=1)
        inner *= first[:, :, None] * first[:, None]
        inner.reshape(n, 3, 3, 3, 3)[:] += np.einsum("ac,pbd->pabcd", _ONE, S)
        pairs = np.einsum("pia,pjb->pijab", self._turned, self._axes).reshape(n, 9, 9)
        moduli = (pairs @ inner @ pairs.transpose(0, 2, 1)).reshape(n, 3, 3, 3, 3)
        return self._turned @ self._back(stretch[:, :, None] * S), moduli

    def _back(self, tensor: Array) -> Array:
        """The second index out of the principal axes."""
        return tensor @ self._axes.transpose(0, 2, 1)

    def _curvatures(self, slopes: Array) -> Array:
        """f of three squares, for every set of three (n, 10); of near ones by the series around
        their mean m, sum_k (-1)^(k+1) h_k/((k + 2) m^(k+2)) with the complete symmetric polynomials
        h_k of their distances from it."""
        c = self._c
        width = c[:, _HIGH] - c[:, _LOW]
        three = np.stack([c[:, _LOW], c[:, _MIDDLE], c[:, _HIGH]])
        m = three.mean(axis=0)
        d = three / m - 1
        two, cubes = (d**2).sum(axis=0) / 2, d.prod(axis=0)
        series = -(1 / 2 + two / 4 - cubes / 5 + two**2 / 6) / m**2
        near = width < _NEAR * m
        steep = slopes[:, _HIGH, _MIDDLE] - slopes[:, _LOW, _MIDDLE]
        return np.where(near, series, steep / np.where(near, 1.0, width))


def _slopes(a: Array, b: Array) -> Array:
    """(ln a - ln b)/(a - b), for equal values 1/a."""
    r = (a - b) / b
    equal = r == 0
    return np.where(equal, 1.0, np.log1p(r) / np.where(equal, 1.0, r)) / b
