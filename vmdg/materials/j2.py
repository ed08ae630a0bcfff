"""Plasticity of metals: von Mises yield stress with isotropic and kinematic hardening.

Small strain: radial return (Simo and Hughes 1998, Box 3.2). Finite strain: F = F_e F_p with
Hencky's energy of ln U_e and an exponential map for F_p, for which the return in the principal axes
of the trial b_e is that of small strain (Simo 1992; de Souza Neto, Peric and Owen 2008, section
14.5). Both share :meth:`J2._return`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from ..forms.materials import NeoHookean
from ..laws.roots import increasing_root
from .point import Array, PointMaterial, Response

_ONE = np.eye(3)
_SPHERE = np.einsum("ij,kl->ijkl", _ONE, _ONE)
_SYMMETRIC = (np.einsum("ik,jl->ijkl", _ONE, _ONE) + np.einsum("il,jk->ijkl", _ONE, _ONE)) / 2
_DEVIATOR = _SYMMETRIC - _SPHERE / 3

#: Components of a symmetric tensor in the history.
_ROWS, _COLUMNS = [0, 1, 2, 0, 1, 2], [0, 1, 2, 1, 2, 0]


def pack(tensor: Array) -> Array:
    """The six components 11, 22, 33, 12, 23, 13 of symmetric tensors, (n, 6)."""
    return tensor[:, _ROWS, _COLUMNS]


def unpack(components: Array) -> Array:
    """Symmetric tensors (n, 3, 3) from their six components."""
    tensor = np.empty((len(components), 3, 3))
    tensor[:, _ROWS, _COLUMNS] = components
    tensor[:, _COLUMNS, _ROWS] = components
    return tensor


class _Return(NamedTuple):
    """A return of the deviator: dgamma and the flow direction with its derivative.

    Attributes:
        increment: dgamma (n,).
        flow: sqrt(3/2) n with d eps_p = dgamma flow (n, 3, 3).
        slope: d eps_p/d eps (n, 3, 3, 3, 3).
    """

    increment: Array
    flow: Array
    slope: Array


class J2(PointMaterial):
    """An elastoplastic metal with the yield stress of von Mises.

    sqrt(3/2) |dev sigma - beta| = sigma_y(alpha) + rate dalpha/dt, with the equivalent plastic
    strain alpha, and beta = 2/3 kinematic eps_p (Prager). The yield stress is

        sigma_y = yield_stress + hardening alpha
                  + (saturation - yield_stress) (1 - exp(-exponent alpha)),

    linear and Voce hardening together, or a table.

    Args:
        E: Young's modulus [MPa].
        nu: Poisson's ratio, -1 < nu < 0.5.
        yield_stress: Initial yield stress [MPa].
        hardening: Linear hardening modulus [MPa], or a table of pairs (alpha, sigma_y) from
            alpha = 0 on, linear in between and constant beyond; it replaces ``yield_stress``.
        saturation: Stress towards which the exponential part tends; None for none [MPa].
        exponent: Its rate.
        kinematic: Modulus of linear kinematic hardening, at small strain [MPa].
        rate: Perzyna viscosity [MPa s].

    Raises:
        TypeError: a parameter is not a number.
        ValueError: a parameter out of range, a yield stress that vanishes, or a table that does not
            start at 0 or does not increase.
    """

    fields: Mapping[str, int] = {"alpha": 1, "plastic strain": 6}

    def __init__(
        self,
        E: float,
        nu: float,
        yield_stress: float | None = None,
        *,
        hardening: float | Sequence[tuple[float, float]] = 0.0,
        saturation: float | None = None,
        exponent: float = 0.0,
        kinematic: float = 0.0,
        rate: float = 0.0,
    ):
        elastic = NeoHookean(E=E, nu=nu)
        super().__init__(elastic)
        self._G = elastic.parameters["mu"]
        self._K = elastic.parameters["lmbda"] + 2 * self._G / 3
        table = None if isinstance(hardening, Real) else np.array(hardening, dtype=float)
        if table is not None:
            _check_table(table, yield_stress, saturation)
            yield_stress = float(table[0, 1])
        numbers: dict[str, Any] = {
            "yield_stress": yield_stress,
            "exponent": exponent,
            "kinematic": kinematic,
            "rate": rate,
        }
        if table is None:
            numbers["hardening"] = hardening
        if saturation is not None:
            numbers |= {"saturation": saturation}
        for name, value in numbers.items():
            if not isinstance(value, Real):
                raise TypeError(f"J2: {name} = {value!r} must be a number")
            least = 1e-300 if name in ("yield_stress", "saturation") else 0.0
            if not least <= float(value) < math.inf:
                word = "positive" if least else "not negative"
                raise ValueError(f"J2: {name} = {value!r} must be {word} and finite")
        if saturation is not None and exponent == 0:
            raise ValueError("J2: saturation needs its rate, exponent > 0")
        self._yield = float(numbers["yield_stress"])
        if saturation is not None and saturation < self._yield:
            raise ValueError(
                f"J2: saturation = {saturation} is below yield_stress = {self._yield}: a body "
                "that softens localises in one row of cells, whatever their size; let an interface "
                "soften instead"
            )
        self._table = table
        self._hardening = float(numbers.get("hardening", 0.0))
        self._rise = 0.0 if saturation is None else float(saturation) - self._yield
        self._exponent, self._kinematic = float(exponent), float(kinematic)
        self._rate = float(rate)
        given = numbers if table is None else numbers | {"hardening": table.tolist()}
        self.numbers = dict(elastic.parameters) | given
        self.viscous = rate > 0
        if kinematic > 0:
            self.kinematics = ("small",)

    def yield_stress(self, alpha: Array) -> tuple[Array, Array, Array]:
        """sigma_y, its slope and its integral over alpha, (n,) each [MPa]."""
        if self._table is not None:
            return _of_table(self._table[:, 0], self._table[:, 1], alpha)
        decay = np.exp(-self._exponent * alpha)
        stress = self._yield + self._hardening * alpha + self._rise * (1 - decay)
        slope = self._hardening + self._rise * self._exponent * decay
        work = (self._yield + self._hardening * alpha / 2) * alpha
        if self._rise > 0:
            work += self._rise * (alpha + np.expm1(-self._exponent * alpha) / self._exponent)
        return stress, slope, work

    def __call__(self, deformation: Array, state: Array, dt: float, small: bool) -> Response:
        """The return map of the step, see :class:`.PointMaterial`."""
        given = deformation, state[:, 0], unpack(state[:, 1:]), dt
        return self._small(*given) if small else self._finite(*given)

    def _small(self, strain: Array, alpha: Array, plastic: Array, dt: float) -> Response:
        """At small strain; ``plastic`` is eps_p."""
        trial = strain - plastic
        back = 2 / 3 * self._kinematic * plastic
        found = self._return(trial, alpha, back, dt)
        change = found.increment[:, None, None] * found.flow
        plastic, alpha_new = plastic + change, alpha + found.increment
        stress, stored = self._elastic(trial - change)
        stored += self._kinematic / 3 * np.einsum("pij,pij->p", plastic, plastic)
        return Response(
            stress,
            self._moduli(found),
            np.column_stack([alpha_new, pack(plastic)]),
            stored,
            self._dissipated(alpha, found.increment, dt),
        )

    def _finite(self, F: Array, alpha: Array, metric: Array, dt: float) -> Response:
        """At finite strain; ``metric`` is C_p^-1 - I.

        With tau = tau(eps), eps = ln(b)/2, b = F C_p^-1 F^T of the trial, P = tau F^-T and

            dP = (dtau - tau F^-T dF^T) F^-T,  dtau = dtau/deps : deps/db : db.
        """
        C = _ONE + metric
        FC = F @ C
        b = FC @ F.transpose(0, 2, 1)
        values, axes = np.linalg.eigh(b)
        trial = _spectral(np.log(values) / 2, axes)
        found = self._return(trial, alpha, np.zeros_like(trial), dt)
        change = found.increment[:, None, None] * found.flow
        tau, stored = self._elastic(trial - change)
        inverse = np.linalg.inv(F)
        # C_p^-1 = F^-1 b_e F^-T with b_e = exp(2 (eps - d eps_p)), coaxial with b.
        strains = np.einsum("pki,pkl,pli->pi", axes, trial - change, axes)
        elastic = _spectral(np.exp(2 * strains), axes)
        metric = inverse @ elastic @ inverse.transpose(0, 2, 1) - _ONE
        # Products of matrices, einsum is several times as slow.
        n = len(F)
        by_b = self._moduli(found).reshape(n, 9, 9) @ _by_b(values, axes)
        # db_mn = dF_mK (FC)_nK + (FC)_mK dF_nK; by_b is symmetric in mn.
        by_F = 2 * (by_b.reshape(n, 27, 3) @ FC)
        P = tau @ inverse.transpose(0, 2, 1)
        moduli = (inverse[:, None] @ by_F.reshape(n, 3, 3, 9)).reshape(n, 3, 3, 3, 3)
        moduli -= np.einsum("piL,pJk->piJkL", P, inverse)
        return Response(
            P,
            moduli,
            np.column_stack([alpha + found.increment, pack(metric)]),
            stored,
            self._dissipated(alpha, found.increment, dt),
        )

    def _return(self, trial: Array, alpha: Array, back: Array, dt: float) -> _Return:
        """Radial return from an elastic trial strain."""
        xi = 2 * self._G * _deviator(trial) - back
        size = np.sqrt(np.einsum("pij,pij->p", xi, xi))
        q, G3 = math.sqrt(1.5) * size, 3 * self._G
        viscosity = self._rate / dt if self._rate > 0 else 0.0
        start, slope, _ = self.yield_stress(alpha)
        flows = q > start
        increment, rate = np.zeros_like(q), np.zeros_like(q)
        if flows.any():
            of, load = alpha[flows], q[flows]
            straight = G3 + self._kinematic + viscosity

            def excess(gamma: Array) -> tuple[Array, Array]:
                stress, slope, _ = self.yield_stress(of + gamma)
                return straight * gamma + stress - load, straight + slope

            first = (load - start[flows]) / (straight + slope[flows])
            most = (load - start[flows]) / straight
            increment[flows] = increasing_root(excess, np.zeros_like(most), most, first)
            rate[flows] = 1 / (straight + self.yield_stress(of + increment[flows])[1])
        n = xi / np.where(flows, size, 1.0)[:, None, None]
        turn = G3 * increment / np.where(flows, q, 1.0)
        along = (G3 * rate - turn)[:, None, None, None, None]
        slope4 = turn[:, None, None, None, None] * _DEVIATOR
        slope4 = slope4 + along * np.einsum("pij,pkl->pijkl", n, n)
        return _Return(increment, math.sqrt(1.5) * n, slope4)

    def _elastic(self, strain: Array) -> tuple[Array, Array]:
        """Stress and stored energy of an elastic strain."""
        volume, deviator = np.trace(strain, axis1=1, axis2=2), _deviator(strain)
        stress = self._K * volume[:, None, None] * _ONE + 2 * self._G * deviator
        energy = self._K * volume**2 / 2
        return stress, energy + self._G * np.einsum("pij,pij->p", deviator, deviator)

    def _moduli(self, found: _Return) -> Array:
        """d stress/d strain of a return."""
        return self._K * _SPHERE + 2 * self._G * (_DEVIATOR - found.slope)

    def _dissipated(self, alpha: Array, increment: Array, dt: float) -> Array:
        """Plastic and viscous work of the step: the integral of sigma_y, exact for any size."""
        work = self.yield_stress(alpha + increment)[2] - self.yield_stress(alpha)[2]
        return work + self._rate * increment**2 / dt if self._rate > 0 else work


def _check_table(table: Array, yield_stress: float | None, saturation: float | None) -> None:
    if yield_stress is not None or saturation is not None:
        raise ValueError(
            "J2: a table of hardening begins with the yield stress: give neither yield_stress nor "
            "saturation with it"
        )
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        raise ValueError("J2: hardening must be a number or a table of pairs (alpha, sigma_y)")
    if table[0, 0] != 0 or (np.diff(table[:, 0]) <= 0).any() or (np.diff(table[:, 1]) < 0).any():
        raise ValueError(
            "J2: the table of hardening must start at alpha = 0, with increasing alpha and a "
            "yield stress that does not decrease"
        )


def _of_table(x: Array, y: Array, alpha: Array) -> tuple[Array, Array, Array]:
    """sigma_y, its slope and its integral of a table with the abscissae ``x``."""
    slopes = np.append(np.diff(y) / np.diff(x), 0.0)
    works = np.append(0.0, np.cumsum(np.diff(x) * (y[1:] + y[:-1]) / 2))
    row = np.clip(np.searchsorted(x, alpha, side="right") - 1, 0, None)
    ahead = alpha - x[row]
    stress = y[row] + slopes[row] * ahead
    return stress, slopes[row], works[row] + ahead * (y[row] + stress) / 2


def _deviator(tensor: Array) -> Array:
    return tensor - np.trace(tensor, axis1=1, axis2=2)[:, None, None] / 3 * _ONE


def _spectral(values: Array, axes: Array) -> Array:
    """Symmetric tensors with these eigenvalues (n, 3) and eigenvectors in columns (n, 3, 3)."""
    return (axes * values[:, None]) @ axes.transpose(0, 2, 1)


def _by_b(values: Array, axes: Array) -> Array:
    """d(ln b / 2)/db (n, 9, 9) from eigenvalues and eigenvectors of b.

    In the axes of b component ij is multiplied by (ln b_i - ln b_j)/(2 (b_i - b_j)), with its limit
    1/(2 b_i) for equal values.
    """
    x = (values[:, :, None] - values[:, None]) / values[:, None]
    near = np.abs(x) < 1e-8
    ratio = np.where(near, 1 - x / 2, np.log1p(x) / np.where(near, 1.0, x))
    theta = ratio / (2 * values[:, None])
    theta = (theta + theta.transpose(0, 2, 1)) / 2
    n = len(values)
    pairs = axes[:, :, None, :, None] * axes[:, None, :, None, :]
    turned = pairs.transpose(0, 2, 1, 3, 4).reshape(n, 9, 9)
    pairs = pairs.reshape(n, 9, 9)
    return (pairs * theta.reshape(n, 1, 9)) @ ((pairs + turned) / 2).transpose(0, 2, 1)
