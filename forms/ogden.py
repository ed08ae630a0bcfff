"""The Ogden material (87)-(88), in invariants that are smooth where principal stretches coincide.

Principal stretches are not differentiable where two of them coincide, but sums over them are. With
l_i = ln of the deviatoric principal stretches (sum 0) and x, y the first two invariants of the
unimodular C_bar = J^(-2/3) C, every sum of powers is analytic in (x, y):

* Near C_bar = I, the only triple point, tr(C_bar^p) = sum_k binom(p, k) tr(D^k), D = C_bar - I,
  and the traces follow from the three invariants of D by the Cayley-Hamilton recursion.
* Elsewhere one eigenvalue is separated from the other two. It is the trigonometric root of the
  characteristic polynomial; the pair (exp(r + t), exp(r - t)) enters by cosh(m t) only, which is
  analytic in sinh(t)^2 (:func:`hyperbolic_pair`).

In plane strain the third stretch is known, and only the pair remains.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import ufl
from numpy.typing import ArrayLike
from ufl.core.expr import Expr

from .invariants import Invariants
from .materials import Material, one_number

# Thresholds between truncated series and closed forms with cancellation: relative errors are 1e-11
# in third derivatives, 1e-13 in first and second ones.
_PAIR_SWITCH, _PAIR_TERMS = 0.06, 15
_TRIPLE_SWITCH, _TRIPLE_TERMS = 0.01, 22
_ROOT_DEGREE = 15


class Ogden(Material):
    """Ogden material with a volumetric energy, eqs. (87) and (88).

    W = sum_a c_a / m_a^2 (sum_i lt_i^m_a - 3) + kappa/2 ((J^2 - 1)/2 - ln J), with deviatoric
    principal stretches lt_i = J^(-1/3) lambda_i. At small strain it is isotropic elasticity with
    shear modulus mu = sum_a c_a / 2 and bulk modulus kappa; from Young's modulus and Poisson's
    ratio kappa = E / (3 (1 - 2 nu)).

    Materials with the same number of terms share a kernel.

    Args:
        c: Moduli c_a [MPa]; individual ones may be negative.
        m: Exponents m_a, as many as ``c``; one c = (2 mu,), m = (2,) is neo-Hookean.
        kappa: Bulk modulus [MPa].

    Raises:
        TypeError: one of them is not a number.
        ValueError: ``c`` and ``m`` differ in length, or a modulus is outside its range.
    """

    free_at_rest = True

    def __init__(self, *, c: ArrayLike, m: ArrayLike, kappa: float):
        if {np.asarray(c).dtype.kind, np.asarray(m).dtype.kind} & set("US"):
            raise TypeError(f"Ogden: c = {c!r} and m = {m!r} must be numbers, not text")
        c, m = np.atleast_1d(np.asarray(c, float)), np.atleast_1d(np.asarray(m, float))
        if c.ndim != 1 or c.shape != m.shape or not c.size:
            raise ValueError(
                f"Ogden: c and m need the same number of entries, at least one, but have {c.size} "
                f"and {m.size}"
            )
        if not (np.isfinite(c).all() and np.isfinite(m).all()):
            raise ValueError(f"Ogden: c = {c.tolist()} and m = {m.tolist()} must be finite")
        if not m.all():
            raise ValueError(f"Ogden: the exponents m = {m.tolist()} must not be zero")
        if not c.sum() > 0:
            raise ValueError(f"Ogden: the shear modulus sum(c)/2 = {c.sum() / 2} must be positive")
        if not (math.isfinite(one_number("Ogden: kappa", kappa)) and kappa > 0):
            raise ValueError(f"Ogden: kappa = {kappa} must be positive and finite")
        self.terms = len(c)
        parameters = {"kappa": float(kappa)}
        for a in range(self.terms):
            parameters |= {f"c{a + 1}": float(c[a]), f"m{a + 1}": float(m[a])}
        self.parameters = parameters

    @property
    def kernel_key(self) -> Hashable:
        """One kernel for every number of terms."""
        return type(self), self.terms

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """Eqs. (87) and (88)."""
        return self.invariant_energy(F, None, parameters).energy

    def invariant_energy(
        self,
        F: Expr,
        out_of_plane: Expr | None,
        parameters: Mapping[str, Expr],
        dilatation: Expr | None = None,
    ) -> Invariants:
        """Eqs. (87) and (88) as functions of (x, y, J) in 3D and of the in-plane (Y, J) in plane
        strain.

        x, y and Y do not change with the volume, so ``dilatation`` replaces J where J is a separate
        argument.
        """
        moduli = [(parameters[f"c{a + 1}"], parameters[f"m{a + 1}"]) for a in range(self.terms)]
        # J is a separate argument of the energy, distinct from the J in the other arguments.
        if out_of_plane is None:
            cofactor = _cofactor(F)
            first = ufl.variable(_square(F[i, k] for i in range(3) for k in range(3)))
            second = ufl.variable(_square(cofactor))
            J = ufl.variable(sum(F[0, k] * cofactor[k] for k in range(3)))
            scale = ufl.exp(-2 / 3 * ufl.ln(J))
            x, y = ufl.variable(scale * first), ufl.variable(scale**2 * second)
            volume, variables = _volume(J, dilatation)
            energy = _isochoric(x, y, moduli) + _volumetric(volume, parameters["kappa"])
            return Invariants(energy, (x, y, volume), (first, second, *variables))
        # Square of the difference of the two stretches, without cancellation.
        square = ufl.variable(_square((F[0, 0] - F[1, 1], F[0, 1] + F[1, 0])))
        J = ufl.variable(F[0, 0] * F[1, 1] - F[0, 1] * F[1, 0])
        Y = ufl.variable(square / (4 * J))
        volume, variables = _volume(J, dilatation)
        third = ufl.ln(out_of_plane) * 2 / 3 - ufl.ln(volume) / 3
        energy = _apart(third, Y, moduli) + _volumetric(volume * out_of_plane, parameters["kappa"])
        return Invariants(energy, (Y, volume), (square, *variables))

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """mu dev(eps):dev(eps) + kappa/2 tr(eps)^2 with mu = sum_a c_a / 2."""
        mu = sum(parameters[f"c{a + 1}"] for a in range(self.terms)) / 2
        return mu * ufl.inner(ufl.dev(strain), ufl.dev(strain)) + (
            parameters["kappa"] / 2 * ufl.tr(strain) ** 2
        )


def _volume(J: Expr, dilatation: Expr | None) -> tuple[Expr, tuple[Expr, ...]]:
    """The volume ratio as an argument of W, and the invariants J and, if given, the dilatation."""
    if dilatation is None:
        return ufl.variable(J), (J,)
    theta = ufl.variable(dilatation)
    return ufl.variable(theta), (J, theta)


def _square(entries: Iterable[Expr]) -> Expr:
    return sum(entry**2 for entry in entries)


def _cofactor(F: Expr) -> list[Expr]:
    """Entries of cof F, row by row."""
    return [
        F[i, k] * F[m, n] - F[i, n] * F[m, k]
        for i, m in ((1, 2), (2, 0), (0, 1))
        for k, n in ((1, 2), (2, 0), (0, 1))
    ]


def _volumetric(J: Expr, kappa: Expr) -> Expr:
    """kappa U(J) with (88)."""
    return kappa / 2 * ((J**2 - 1) / 2 - ufl.ln(J))


def hyperbolic_pair(Y: Expr, m: Expr) -> Expr:
    """cosh(m t) of Y = sinh(t)^2, analytic for Y > -1, hence also where the pair coincides.

    It is the hypergeometric function F(-m/2, m/2; 1/2; -Y), whose series is used near Y = 0.
    """
    coefficients = [1]
    for k in range(_PAIR_TERMS - 1):
        factor = (m**2 / 4 - k**2) / ((k + 0.5) * (k + 1))
        coefficients.append(coefficients[-1] * factor)
    far = ufl.gt(Y, _PAIR_SWITCH)
    # The branch not taken must not evaluate the root of a rounded zero.
    safe = ufl.conditional(far, Y, _PAIR_SWITCH)
    t = ufl.ln(ufl.sqrt(safe) + ufl.sqrt(1 + safe))
    return ufl.conditional(far, ufl.cosh(m * t), _horner(Y, coefficients))


def _apart(third: Expr, Y: Expr, moduli: Sequence[tuple[Expr, Expr]]) -> Expr:
    """Isochoric part of (87) from the separate log stretch l_3 = ``third`` and Y of the other two.

    l_1,2 = -l_3/2 +- t give sum_i lt_i^m = exp(m l_3) + 2 exp(-m l_3/2) cosh(m t).
    """
    energy = 0
    for c, m in moduli:
        pair = ufl.exp(-m / 2 * third)
        energy += c / m**2 * (1 / pair**2 + 2 * pair * hyperbolic_pair(Y, m) - 3)
    return energy


def _isochoric(x: Expr, y: Expr, moduli: Sequence[tuple[Expr, Expr]]) -> Expr:
    """Isochoric part of (87) from the invariants x and y of C_bar, det(C_bar) = 1."""
    # The depressed characteristic polynomial is z^3 - 3 Q z - 2 R.
    R = x**3 / 27 - x * y / 6 + 0.5
    Q = x**2 / 9 - y / 3
    far = ufl.gt(Q, _TRIPLE_SWITCH)
    # Largest eigenvalue Z of C_bar or of its inverse, whichever is separated from the other two:
    # its angle is at most pi/6, and no digits are lost to a small eigenvalue.
    swap = ufl.lt(R, 0)
    X, Y = ufl.conditional(swap, y, x), ufl.conditional(swap, x, y)
    sign = ufl.conditional(swap, -0.5, 0.5)
    Q = ufl.conditional(far, X**2 / 9 - Y / 3, 1.0)
    cosine = (X**3 / 27 - X * Y / 6 + 0.5) / (Q * ufl.sqrt(Q))
    cosine = ufl.conditional(far, cosine, 1.0)
    root = X / 3 + 2 * ufl.sqrt(Q) * _cosine_of_third(cosine)
    product = ufl.sqrt(1 / root)
    difference = ((Y - 1 / root) / root - 2 * product) / (4 * product)
    return ufl.conditional(
        far, _apart(sign * ufl.ln(root), difference, moduli), _triple(x, y, moduli)
    )


def _triple(x: Expr, y: Expr, moduli: Sequence[tuple[Expr, Expr]]) -> Expr:
    """Series of the isochoric part of (87) about C_bar = I."""
    e1, e2, e3 = x - 3, y - 2 * x + 3, x - y
    traces = [e1, e1**2 - 2 * e2]
    traces.append(e1 * traces[1] - e2 * traces[0] + 3 * e3)
    while len(traces) < _TRIPLE_TERMS:
        traces.append(e1 * traces[-1] - e2 * traces[-2] + e3 * traces[-3])
    binomials = [c / m**2 for c, m in moduli]
    energy = 0
    for k, trace in enumerate(traces):
        binomials = [b * (m / 2 - k) / (k + 1) for b, (_, m) in zip(binomials, moduli, strict=True)]
        energy += sum(binomials) * trace
    return energy


def _horner(x: Expr, coefficients: Sequence[Expr | float]) -> Expr:
    """Polynomial with ``coefficients`` in ascending order."""
    result = coefficients[-1]
    for coefficient in reversed(coefficients[:-1]):
        result = result * x + coefficient
    return result


def _cosine_of_third(cosine: Expr) -> Expr:
    """cos(phi/3) of cos(phi) in [0, 1]: analytic also at 1, where arccos is not.

    With h = cos(phi/2) in [sqrt(1/2), 1] it is cos(2/3 arccos(h)), whose nearest singularity h = -1
    is so far away that its Chebyshev series gains 1.4 digits per term.
    """
    centre, radius = (1 + math.sqrt(0.5)) / 2, (1 - math.sqrt(0.5)) / 2
    series: Any = np.polynomial.chebyshev.chebinterpolate(
        lambda s: np.cos(2 / 3 * np.arccos(np.clip(centre + radius * s, -1, 1))), _ROOT_DEGREE
    )
    half = ufl.sqrt((1 + cosine) / 2)
    return _horner((half - centre) / radius, np.polynomial.chebyshev.cheb2poly(series).tolist())
