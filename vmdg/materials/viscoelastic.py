"""Linear viscoelasticity in the strain: a generalized Maxwell model with Prony series.

At finite strain the strain is Hencky's, ln U, and the stress conjugate to it (:mod:`.hencky`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from numbers import Real
from typing import NamedTuple

import numpy as np

from ..forms.materials import NeoHookean
from .hencky import Hencky
from .plasticity import components, deviatoric, pack, unpack, vector, with_mean
from .point import Array, PointMaterial, Response

Series = Sequence[tuple[float, float]]

_SPHERE = np.einsum("ij,kl->ijkl", np.eye(3), np.eye(3))
_EQUAL = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
_DEVIATOR = (_EQUAL + _EQUAL.transpose(0, 1, 3, 2)) / 2 - _SPHERE / 3

#: dt/tau below which a series is more accurate.
_SHORT = 0.01
#: Points and weights on a step for its reduced time.
_PLACES, _WEIGHTS = (np.polynomial.legendre.leggauss(3)[k] / 2 + (k == 0) / 2 for k in (0, 1))
#: Times of elements by which a checkpoint knows a shift again.
_SAMPLES = [0.0, *np.geomspace(0.01, 100.0, 9).tolist()]


class Relaxed(NamedTuple):
    """Maxwell elements at the end of a step.

    Attributes:
        stress: Sum of their stresses and that of the spring next to them (n, k) [MPa].
        modulus: Its derivative by the strain, a number for every point or for all (n,), (1,) [MPa].
        elastic: Strain of their springs (n, m, k).
        stored: Energy of all springs (n,) [MPa].
        dissipated: Work of the dashpots in the step (n,) [MPa].
    """

    stress: Array
    modulus: Array
    elastic: Array
    stored: Array
    dissipated: Array


class _Elements:
    """A spring and Maxwell elements in parallel.

    The strain of a spring follows de_i/dt = de/dt - e_i/tau_i: with a constant de/dt in a step and
    h = dt/tau_i exactly

        e_i = exp(-h) e_i0 + (1 - exp(-h))/h (e - e_0),

    and with w = 1 - exp(-h) the integral of e_i^2/tau_i, twice what a dashpot dissipates by its
    modulus, is

        (w - w^2/2) e_i0^2 + w^2/h e_i0.(e - e_0) + (h - w - w^2/2)/h^2 (e - e_0)^2.

    Args:
        whole: Instantaneous modulus [MPa].
        series: Share of it and relaxation time [s] of every element.
    """

    def __init__(self, whole: float, series: Series):
        pairs = np.array(series, dtype=float).reshape(-1, 2)
        self.moduli, self.times = whole * pairs[:, 0], pairs[:, 1]
        self.spring = whole * max(1 - pairs[:, 0].sum(), 0.0)

    def __call__(self, strain: Array, change: Array, past: Array, elapsed: Array) -> Relaxed:
        """
        Args:
            strain: At the end of the step (n, k).
            change: Of the strain in the step (n, k).
            past: Strains of the springs at its start, in columns (n, m k).
            elapsed: Reduced time of the step, of every point or of all (n,), (1,) [s].
        """
        past = past.reshape(len(strain), -1, strain.shape[1])
        h = elapsed[:, None] / self.times
        w = -np.expm1(-h)
        moved = h > 0
        share = np.where(moved, w / np.where(moved, h, 1.0), 1.0)
        short = h / 3 * (1 - h * (3 / 4 - h * (7 / 20 - h * (1 / 8 - h * 31 / 840))))
        long = h > _SHORT
        last = np.where(long, (h - w - w * w / 2) / np.where(long, h * h, 1.0), short)
        elastic = (1 - w)[..., None] * past + share[..., None] * change[:, None]
        squares = (w - w * w / 2) * _dot(past, past) + last * _dot(change, change)[:, None]
        squares += share * w * _dot(past, change[:, None])
        return Relaxed(
            self.spring * strain + np.einsum("m,pmk->pk", self.moduli, elastic),
            self.spring + share @ self.moduli,
            elastic,
            (self.spring * _dot(strain, strain) + _dot(elastic, elastic) @ self.moduli) / 2,
            np.maximum(squares @ self.moduli, 0.0),  # but for rounding it is
        )


class Viscoelastic(PointMaterial):
    """A body that creeps and relaxes: springs and Maxwell elements in parallel, Prony series.

    For shear and, if given, for the volume,

        G(t) = G_0 (1 - sum g_i (1 - exp(-t/tau_i))),  K(t) = K_0 (1 - sum k_i (1 - exp(-t/tau_i))),

    with the instantaneous moduli G_0, K_0 and the long-term ones G_0 (1 - sum g_i) and
    K_0 (1 - sum k_i): sigma = int 2 G(t - s) dev de/ds + K(t - s) tr de/ds 1 ds, at finite strain
    with ln U instead of the strain and the stress conjugate to it. Steps are exact for a strain
    that grows linearly in a step, otherwise of second order (Taylor, Pister and Goudreau 1970). A
    step that takes no time, such as a jump, or one at a load factor that stays, is instantaneous.

    Its history is the strain, the strains of the springs of all Maxwell elements, and the time that
    has passed if ``shift`` is given.

    Args:
        E: Young's modulus [MPa].
        nu: Poisson's ratio, -1 < nu < 0.5.
        shear: Pairs (g_i, tau_i): share of the instantaneous shear modulus, relaxation time [s].
        bulk: Pairs (k_i, tau_i) of the bulk modulus.
        moduli: Whether ``E`` and ``nu`` are the "instantaneous" or the "long-term" moduli.
        shift: Factor a(t) by which relaxation times are multiplied at the time t [s] since the
            start, as by a temperature that changes; None for 1.

    Raises:
        TypeError: a parameter is not a number, a series no list of pairs, or ``shift`` no function.
        ValueError: a parameter out of range, or shares of more than 1, of 1 with long-term moduli.
    """

    viscous = True

    def __init__(
        self,
        E: float,
        nu: float,
        shear: Series = (),
        bulk: Series = (),
        *,
        moduli: str = "instantaneous",
        shift: Callable[[float], float] | None = None,
    ):
        if moduli not in ("instantaneous", "long-term"):
            raise ValueError(
                f"Viscoelastic: moduli = {moduli!r} must be 'instantaneous' or 'long-term'"
            )
        given = NeoHookean(E=E, nu=nu).parameters
        G = given["mu"]
        K = given["lmbda"] + 2 * G / 3
        left = [1 - _checked(name, s) for name, s in (("shear", shear), ("bulk", bulk))]
        if moduli == "long-term":
            if min(left) < 1e-12:
                raise ValueError(
                    "Viscoelastic: shares of 1 leave no long-term modulus; give the instantaneous "
                    "moduli, with moduli='instantaneous'"
                )
            G, K = G / left[0], K / left[1]
        super().__init__(NeoHookean(mu=G, lmbda=K - 2 * G / 3))
        self._shear, self._bulk, self._shift = _Elements(2 * G, shear), _Elements(K, bulk), shift
        if shift is not None and not callable(shift):
            raise TypeError(
                f"Viscoelastic: shift = {shift!r} must be a function of the time or None"
            )
        self.locks = self._shear.spring == 0
        self.fields = {"strain": 6}
        known = {"deviators": (self._shear, 6), "dilatations": (self._bulk, 1)}
        for name, (elements, size) in known.items():
            if len(elements.times):
                self.fields |= {name: size * len(elements.times)}
        self.numbers = {**self.parameters}
        self.numbers |= {"shear": [list(map(float, pair)) for pair in shear]}
        self.numbers |= {"bulk": [list(map(float, pair)) for pair in bulk]}
        if shift is not None:
            self.fields |= {"time": 1}
            scale = float(max([*self._shear.times, *self._bulk.times], default=1.0))
            self.numbers |= {"shift": [self._factor(scale * t) for t in _SAMPLES]}

    def __call__(
        self, deformation: Array, state: Array, dt: float = math.inf, small: bool = False
    ) -> Response:
        n, elapsed = len(deformation), self._elapsed(state, 0.0 if math.isinf(dt) else dt)
        kinematics = None if small else Hencky(deformation)
        strain = vector(pack(deformation if kinematics is None else kinematics.strain))
        change = strain - vector(state[:, :6])
        (volume, deviator), (swelling, distortion) = deviatoric(strain), deviatoric(change)
        ends = np.cumsum([6, 6 * len(self._shear.times), len(self._bulk.times)])
        past = vector(state[:, ends[0] : ends[1]].reshape(-1, 6)).reshape(n, -1)
        s = self._shear(deviator, distortion, past, elapsed)
        p = self._bulk(volume[:, None], swelling[:, None], state[:, ends[1] : ends[2]], elapsed)
        moduli = np.empty((n, 3, 3, 3, 3))
        moduli[:] = np.multiply.outer(s.modulus, _DEVIATOR)
        moduli += np.multiply.outer(p.modulus, _SPHERE)
        stress = unpack(components(with_mean(s.stress, p.stress[:, 0])))
        if kinematics is not None:
            stress, moduli = kinematics.pushed(stress, moduli)
        history = [components(strain), components(s.elastic.reshape(-1, 6)).reshape(n, -1)]
        history.append(p.elastic[:, :, 0])
        if self._shift is not None:
            history.append(state[:, -1:] + (0.0 if math.isinf(dt) else dt))
        return Response(
            stress,
            moduli,
            np.concatenate(history, axis=1),
            s.stored + p.stored,
            s.dissipated + p.dissipated,
        )

    def _elapsed(self, state: Array, dt: float) -> Array:
        """int dt/a of a step, of every point or of all (n,), (1,) [s]."""
        if self._shift is None:
            return np.array([dt])
        starts, row = np.unique(state[:, -1], return_inverse=True)
        rates = [[1 / self._factor(float(t + x * dt)) for x in _PLACES] for t in starts]
        return dt * (np.reshape(rates, (-1, 3)) @ _WEIGHTS)[row]

    def _factor(self, t: float) -> float:
        factor = self._shift(t)
        if not isinstance(factor, Real) or not 0 < factor < math.inf:
            raise ValueError(
                f"Viscoelastic: shift({t:.6g}) = {factor!r} must be a positive, finite number"
            )
        return float(factor)


def _dot(a: Array, b: Array) -> Array:
    return (a * b).sum(axis=-1)


def _checked(name: str, series: Series) -> float:
    """Sum of the shares of a series."""
    try:
        pairs = np.array([*series], dtype=float).reshape(-1, 2)
    except (TypeError, ValueError) as error:
        raise TypeError(
            f"Viscoelastic: {name} = {series!r} must be a list of pairs (share, relaxation time)"
        ) from error
    if not ((pairs > 0) & (pairs < math.inf)).all() or not pairs[:, 0].sum() <= 1 + 1e-12:
        raise ValueError(
            f"Viscoelastic: {name} = {series!r} must have positive shares whose sum is at most 1, "
            "and positive relaxation times"
        )
    return float(pairs[:, 0].sum())
