"""What isotropic plastic materials share: both kinds of strain from one return, batch by batch.

At small strain a return is given the trial strain as a vector of six components, at finite strain
its three principal values: F = F_e F_p with Hencky's energy of ln U_e and an exponential map for
F_p, for which the return in the principal axes of the trial b_e is that of small strain (Simo 1992;
de Souza Neto, Peric and Owen 2008, section 14.5). Products of two such vectors are those of the
tensors, so that a return need not know which it has.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from numbers import Real
from typing import NamedTuple

import numpy as np

from ..forms.materials import NeoHookean
from .point import Array, PointMaterial, Response

_ONE = np.eye(3)

#: Components of a symmetric tensor in the history.
_ROWS, _COLUMNS = [0, 1, 2, 0, 1, 2], [0, 1, 2, 1, 2, 0]
_FLAT = 3 * np.array(_ROWS) + _COLUMNS
#: What makes vectors of them, whose products are those of the tensors.
_SCALE = np.array([1.0, 1.0, 1.0, *[math.sqrt(2)] * 3])
#: Component of every entry of a tensor, and of every pair of entries.
_ENTRY = np.array([0, 3, 5, 3, 1, 4, 5, 4, 2])
_PAIR = (6 * _ENTRY[:, None] + _ENTRY).ravel()
_ONES = np.outer([1, 1, 1, 0, 0, 0], [1.0, 1, 1, 0, 0, 0])
_DEVIATOR = np.eye(6) - _ONES / 3
_PER_SCALES = (1 / np.outer(_SCALE, _SCALE)).ravel()
#: Pairs of principal axes: twice the same, three pairs, and those the other way round.
_FIRST, _SECOND = [0, 1, 2, 0, 1, 2, 1, 2, 0], [0, 1, 2, 1, 2, 0, 0, 1, 2]


def pack(tensor: Array) -> Array:
    """The six components 11, 22, 33, 12, 23, 13 of symmetric tensors, (n, 6)."""
    return tensor.reshape(-1, 9)[:, _FLAT]


def unpack(components: Array) -> Array:
    """Symmetric tensors (n, 3, 3) from their six components."""
    return components[:, _ENTRY].reshape(-1, 3, 3)


def vector(components: Array) -> Array:
    """Vectors (n, 6) whose products are those of the tensors with these six components."""
    return components * _SCALE


def components(vectors: Array) -> Array:
    return vectors / _SCALE


def dot(a: Array, b: Array) -> Array:
    """Products of vectors (n, k)."""
    return np.einsum("pi,pi->p", a, b)


def deviatoric(strain: Array) -> tuple[Array, Array]:
    """Trace (n,) and deviator (n, k) of vectors."""
    trace = strain[:, 0] + strain[:, 1] + strain[:, 2]
    deviator = strain.copy()
    deviator[:, :3] -= trace[:, None] / 3
    return trace, deviator


def with_mean(deviator: Array, mean: Array) -> Array:
    """Vectors (n, k) of a deviator and a mean value (n,)."""
    whole = deviator.copy()
    whole[:, :3] += mean[:, None]
    return whole


def isotropic(bulk: Array | float, shear: Array, k: int) -> Array:
    """bulk 1 (x) 1 + shear (I - 1 (x) 1/3), (n, k, k)."""
    moduli = shear[:, None, None] * _DEVIATOR[:k, :k]
    moduli += np.asarray(bulk)[..., None, None] * _ONES[:k, :k]
    return moduli


class Returned(NamedTuple):
    """A return from an elastic trial strain, a vector of k = 6 or 3.

    Attributes:
        stress: sigma, at finite strain tau (n, k) [MPa].
        tangent: Its derivative by the trial strain (n, k, k) [MPa].
        turning: Difference of two principal stresses by that of their trial strains (n,) [MPa].
        change: Plastic strain of the step (n, k).
        history: Other quantities of the history, with alpha first (n, m - 6).
        stored: Recoverable energy per volume (n,) [MPa].
        dissipated: Dissipated energy per volume in the step (n,) [MPa].
    """

    stress: Array
    tangent: Array
    turning: Array
    change: Array
    history: Array
    stored: Array
    dissipated: Array


class Plastic(PointMaterial):
    """An isotropic elastoplastic material, given by its return.

    Its history is alpha, the plastic strain (eps_p at small, C_p^-1 - I at finite strain), and what
    else a subclass adds behind them.

    Args:
        E: Young's modulus [MPa].
        nu: Poisson's ratio, -1 < nu < 0.5.
    """

    fields: Mapping[str, int] = {"alpha": 1, "plastic strain": 6}

    def __init__(self, E: float, nu: float):
        elastic = NeoHookean(E=E, nu=nu)
        super().__init__(elastic)
        self._G = elastic.parameters["mu"]
        self._K = elastic.parameters["lmbda"] + 2 * self._G / 3

    def _return(self, trial: Array, state: Array, dt: float) -> Returned:
        """The return from a trial strain (n, 6) or (n, 3).

        Args:
            state: History at the start of the step (n, m); at finite strain only what is no tensor
                has a meaning for the return.
            dt: Time step [s].
        """
        raise NotImplementedError

    def __call__(
        self, deformation: Array, state: Array, dt: float = math.inf, small: bool = False
    ) -> Response:
        return (self._small if small else self._finite)(deformation, state, dt)

    def _small(self, strain: Array, state: Array, dt: float) -> Response:
        n, plastic = len(strain), vector(state[:, 1:7])
        found = self._return(vector(pack(strain)) - plastic, state, dt)
        moduli = (found.tangent.reshape(n, 36) * _PER_SCALES)[:, _PAIR]
        return Response(
            unpack(found.stress / _SCALE),
            moduli.reshape(n, 3, 3, 3, 3),
            _history(found, (plastic + found.change) / _SCALE),
            found.stored,
            found.dissipated,
        )

    def _finite(self, F: Array, state: Array, dt: float) -> Response:
        """At finite strain.

        With b = F C_p^-1 F^T of the trial, its principal axes v_a and values b_a, L = dF F^-1 and
        w_a = F^-1 v_a is P = sum tau_a v_a w_a and, in the principal axes,

            dP F^T = dtau - tau L^T,  dtau_aa = sum_b dtau_a/deps_b L_bb,
            dtau_ab = (tau_a - tau_b)/(b_a - b_b) (L_ab b_b + b_a L_ba),  a unequal b.
        """
        n = len(F)
        b = F @ (_ONE + unpack(state[:, 1:7])) @ F.transpose(0, 2, 1)
        squares, axes = np.linalg.eigh(b)
        found = self._return(np.log(squares) / 2, state, dt)
        tau = found.stress
        inner = inverse(F) @ axes
        # C_p^-1 = F^-1 b_e F^-T with b_e = b exp(-2 d eps_p), coaxial with b.
        elastic = squares * np.exp(-2 * found.change)
        metric = (inner * elastic[:, None]) @ inner.transpose(0, 2, 1) - _ONE
        pairs = (
            axes.transpose(0, 2, 1)[:, _FIRST, :, None]
            * inner.transpose(0, 2, 1)[:, _SECOND, None, :]
        )
        pairs = pairs.reshape(n, 9, 9)
        first, second = _FIRST[3:], _SECOND[3:]
        shear = found.turning[:, None] * _log_slopes(squares)
        shear = np.concatenate([shear, shear], axis=1)
        turned = np.empty_like(pairs)
        np.matmul(found.tangent - tau[:, :, None] * _ONE, pairs[:, :3], out=turned[:, :3])
        turned[:, 3:] = (shear * squares[:, second])[:, :, None] * pairs[:, 3:]
        back = (shear * squares[:, first] - tau[:, first])[:, :, None]
        turned[:, 3:6] += back[:, :3] * pairs[:, 6:]
        turned[:, 6:] += back[:, 3:] * pairs[:, 3:6]
        return Response(
            (axes * tau[:, None]) @ inner.transpose(0, 2, 1),
            (pairs.transpose(0, 2, 1) @ turned).reshape(n, 3, 3, 3, 3),
            _history(found, pack(metric)),
            found.stored,
            found.dissipated,
        )


def _history(found: Returned, plastic: Array) -> Array:
    return np.concatenate([found.history[:, :1], plastic, found.history[:, 1:]], axis=1)


def inverse(F: Array) -> Array:
    """Inverses of (n, 3, 3), entry by entry: several times as fast as a library for any size."""
    a, b, c, d, e, f, g, h, i = F.reshape(-1, 9).T
    A, B, C = e * i - f * h, f * g - d * i, d * h - e * g
    rows = [A, c * h - b * i, b * f - c * e, B, a * i - c * g, c * d - a * f]
    rows += [C, b * g - a * h, a * e - b * d]
    return (np.array(rows) / (a * A + b * B + c * C)).T.reshape(-1, 3, 3)


def _log_slopes(x: Array) -> Array:
    """(ln x_a - ln x_b)/(2 (x_a - x_b)) of three pairs (n, 3); for equal values 1/(2 x_a)."""
    other = x[:, _SECOND[3:6]]
    r = (x[:, _FIRST[3:6]] - other) / other
    equal = r == 0
    return np.where(equal, 1.0, np.log1p(r) / np.where(equal, 1.0, r)) / (2 * other)


def check_numbers(owner: str, numbers: Mapping[str, object], positive: tuple[str, ...]) -> None:
    for name, value in numbers.items():
        if not isinstance(value, Real):
            raise TypeError(f"{owner}: {name} = {value!r} must be a number")
        least = 1e-300 if name in positive else 0.0
        if not least <= float(value) < math.inf:
            word = "positive" if least else "not negative"
            raise ValueError(f"{owner}: {name} = {value!r} must be {word} and finite")
