"""Plasticity of metals: von Mises yield stress with isotropic and kinematic hardening.

Radial return (Simo and Hughes 1998, Box 3.2), also with a back stress that fades (Armstrong and
Frederick 1966); :mod:`.plasticity` makes both kinds of strain of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from numbers import Real
from typing import Any

import numpy as np

from ..laws.roots import increasing_root
from .plasticity import (
    Plastic,
    Returned,
    check_numbers,
    components,
    deviatoric,
    dot,
    isotropic,
    vector,
    with_mean,
)
from .point import Array

Curve = Callable[[Array], tuple[Array, Array, Array]]

#: Where a function of hardening is checked, and known again by a checkpoint.
_SAMPLES = np.concatenate([[0.0], np.geomspace(1e-4, 10.0, 21)])


class J2(Plastic):
    """An elastoplastic metal with the yield stress of von Mises.

    sqrt(3/2) |dev sigma - beta| = sigma_y(alpha) + rate dalpha/dt, with the equivalent plastic
    strain alpha. The back stress beta begins at zero and follows

        d beta = 2/3 kinematic d eps_p - recovery beta d alpha,

    without ``recovery`` that of Prager, with it that of Armstrong and Frederick, whose equivalent
    stress tends towards kinematic/recovery. The yield stress is

        sigma_y = yield_stress + hardening alpha
                  + (saturation - yield_stress) (1 - exp(-exponent alpha)),

    linear and Voce hardening together, or a table, or a function.

    Args:
        E: Young's modulus [MPa].
        nu: Poisson's ratio, -1 < nu < 0.5.
        yield_stress: Initial yield stress [MPa].
        hardening: Linear hardening modulus [MPa], or a table of pairs (alpha, sigma_y) from
            alpha = 0 on, linear in between and constant beyond, or a smooth function of arrays,
            sigma_y(alpha); both replace ``yield_stress``.
        saturation: Stress towards which the exponential part tends; None for none [MPa].
        exponent: Its rate.
        kinematic: Modulus of kinematic hardening, at small strain [MPa].
        recovery: Rate at which the back stress fades; the moduli are then unsymmetric.
        rate: Perzyna viscosity; None or 0 for none [MPa s].

    Raises:
        TypeError: a parameter is not a number.
        ValueError: a parameter out of range, a yield stress that vanishes, a table that does not
            start at 0, or a table or function that decreases.
    """

    def __init__(
        self,
        E: float,
        nu: float,
        yield_stress: float | None = None,
        *,
        hardening: float | Sequence[tuple[float, float]] | Callable[[Array], Array] = 0.0,
        saturation: float | None = None,
        exponent: float | None = None,
        kinematic: float = 0.0,
        recovery: float = 0.0,
        rate: float | None = None,
    ):
        super().__init__(E, nu)
        exponent, rate = (0.0 if value is None else value for value in (exponent, rate))
        curve = None if isinstance(hardening, float | Real) else _curve(hardening)
        if curve is not None:
            first = float(curve(np.zeros(1))[0][0])
            if saturation is not None or yield_stress not in (None, first):
                raise ValueError(
                    f"J2: a table or function of hardening begins with the yield stress, {first:g} "
                    "here: give neither yield_stress nor saturation with it"
                )
            yield_stress = first
        numbers: dict[str, Any] = {
            "yield_stress": yield_stress,
            "exponent": exponent,
            "kinematic": kinematic,
            "recovery": recovery,
            "rate": rate,
        }
        if curve is None:
            numbers["hardening"] = hardening
        if saturation is not None:
            numbers |= {"saturation": saturation}
        check_numbers("J2", numbers, positive=("yield_stress", "saturation"))
        if recovery > 0 and kinematic == 0:
            raise ValueError("J2: recovery needs a back stress that fades, kinematic > 0")
        if saturation is not None and exponent == 0:
            raise ValueError("J2: saturation needs its rate, exponent > 0")
        self._yield = float(numbers["yield_stress"])
        if saturation is not None and saturation < self._yield:
            raise ValueError(
                f"J2: saturation = {saturation} is below yield_stress = {self._yield}: a body "
                "that softens localises in one row of cells, whatever their size; let an interface "
                "soften instead"
            )
        self._curve = curve
        self._hardening = float(numbers.get("hardening", 0.0))
        self._rise = 0.0 if saturation is None else float(saturation) - self._yield
        self._exponent, self._kinematic = float(exponent), float(kinematic)
        self._recovery, self._rate = float(recovery), float(rate)
        self._curved = recovery > 0 or self._rise > 0 or curve is not None
        self.numbers = dict(self.parameters) | numbers
        if curve is not None:
            known = curve(_SAMPLES)[0] if callable(hardening) else np.array(hardening, dtype=float)
            self.numbers["hardening"] = known.tolist()
        self.viscous = rate > 0
        if kinematic > 0:
            self.kinematics = ("small",)
        if recovery > 0:
            self.symmetric = False
            self.fields = {**self.fields, "back strain": 6}

    def yield_stress(self, alpha: Array) -> tuple[Array, Array, Array]:
        """sigma_y, its slope and its integral over alpha, (n,) each [MPa]."""
        if self._curve is not None:
            return self._curve(alpha)
        decay = np.exp(-self._exponent * alpha)
        stress = self._yield + self._hardening * alpha + self._rise * (1 - decay)
        slope = self._hardening + self._rise * self._exponent * decay
        work = (self._yield + self._hardening * alpha / 2) * alpha
        if self._rise > 0:
            work += self._rise * (alpha + np.expm1(-self._exponent * alpha) / self._exponent)
        return stress, slope, work

    def _return(self, trial: Array, state: Array, dt: float) -> Returned:
        """Radial return; the back strain is a = 3/2 beta/kinematic."""
        G, C, R = self._G, self._kinematic, self._recovery
        alpha = state[:, 0]
        volume, strain = deviatoric(trial)
        pull, past = 2 * G * strain, np.zeros_like(trial)
        if C > 0:
            past = vector(state[:, 7:13] if R > 0 else state[:, 1:7])
        xi = pull - 2 / 3 * C * past
        q = np.sqrt(1.5 * dot(xi, xi))
        start, slope, before = self.yield_stress(alpha)
        straight = 3 * G + (self._rate / dt if self._rate > 0 else 0.0)
        flows = q > start
        increment = np.zeros_like(q)
        if flows.any():
            over, fades = q[flows] - start[flows], R * C * dot(xi, past)[flows] / q[flows]
            root = over / (straight + C - fades + slope[flows])
            if self._curved:
                excess = self._excess(alpha[flows], pull[flows], past[flows], straight)
                root = increasing_root(excess, np.zeros_like(root), over / straight, root)
            increment[flows] = root
        _, slope, work = self.yield_stress(alpha + increment)
        left, grown = self._faded(increment)
        if R > 0:
            xi = pull - 2 / 3 * C * left[:, None] * past
            q = np.sqrt(1.5 * dot(xi, xi))
        safe = np.where(flows, q, 1.0)
        N = 1.5 / safe[:, None] * xi
        change, turn = increment[:, None] * N, 3 * G * increment / safe
        # With d increment = rate 2 G N.d eps; the share of flow that follows the strain at once,
        # and what of the back stress that fades turns N.
        along, fading = dot(N, past), 2 / 3 * C * R * left
        rate = np.where(flows, 1 / (straight + C * left + slope - fading * along), 0.0)
        column = ((3 * G * rate - turn) / 1.5)[:, None] * N
        if R > 0:
            column += (turn * fading * rate)[:, None] * (past - (along / 1.5)[:, None] * N)
        dissipated = np.maximum(work - before, 0.0)  # but for rounding it is
        if self._rate > 0:
            dissipated += self._rate * increment**2 / dt
        if R > 0:
            dissipated += 2 / 3 * C * R * self._faded_work(past, N, increment, grown)
        elastic, back = strain - change, left[:, None] * past + grown[:, None] * N
        history = [(alpha + increment)[:, None], *([components(back)] if R > 0 else ())]
        secant = 2 * G * (1 - turn)
        return Returned(
            with_mean(2 * G * elastic, self._K * volume),
            isotropic(self._K, secant, trial.shape[1]) - (2 * G * column)[:, :, None] @ N[:, None],
            secant,
            change,
            np.concatenate(history, axis=1),
            self._K / 2 * volume**2 + G * dot(elastic, elastic) + C / 3 * dot(back, back),
            dissipated,
        )

    def _excess(
        self, alpha: Array, pull: Array, past: Array, straight: float
    ) -> Callable[[Array], tuple[Array, Array]]:
        """The yield condition as an increasing function of dalpha.

        |past| is at most sqrt(3/2)/recovery, so that q grows no more than the back stress does.
        """
        C, R = self._kinematic, self._recovery
        squares, crossed, own = dot(pull, pull), dot(pull, past), dot(past, past)

        def excess(x: Array) -> tuple[Array, Array]:
            stress, slope, _ = self.yield_stress(alpha + x)
            left, grown = self._faded(x)
            k = 2 / 3 * C * left
            q = np.sqrt(1.5 * np.maximum(squares - 2 * k * crossed + k**2 * own, 0.0))
            turns = R * C * left * (crossed - k * own) / np.maximum(q, self._yield)
            return straight * x + C * grown + stress - q, straight + C * left + slope - turns

        return excess

    def _faded(self, increment: Array) -> tuple[Array, Array]:
        """w = exp(-recovery dalpha) and (1 - w)/recovery: a = w a + (1 - w)/recovery N, exactly
        where N = d eps_p/dalpha stays."""
        if self._recovery == 0:
            return np.ones_like(increment), increment
        x = -self._recovery * increment
        return np.exp(x), -np.expm1(x) / self._recovery

    def _faded_work(self, past: Array, N: Array, increment: Array, grown: Array) -> Array:
        R = self._recovery
        first = grown - R * grown**2 / 2
        last = np.maximum(increment - grown - R * grown**2 / 2, 0.0) / R**2
        return first * dot(past, past) + grown**2 * dot(past, N) + last * dot(N, N)


def _curve(given: Sequence[tuple[float, float]] | Callable[[Array], Array]) -> Curve:
    """sigma_y, its slope and its integral by alpha, of a table or a function."""
    if callable(given):
        values = np.asarray(given(_SAMPLES), dtype=float)
        if values.shape != _SAMPLES.shape or not (np.diff(values) >= 0).all():
            raise ValueError(
                "J2: a function of hardening must return the yield stress of an array of alpha, "
                "finite and not decreasing up to alpha = 10"
            )
        return partial(_of_function, given)
    table = np.array(given, dtype=float)
    if table.ndim != 2 or table.shape[1] != 2 or not np.isfinite(table).all():
        raise ValueError(
            "J2: hardening must be a number, a table of pairs (alpha, sigma_y), or a function"
        )
    if table[0, 0] != 0 or (np.diff(table[:, 0]) <= 0).any() or (np.diff(table[:, 1]) < 0).any():
        raise ValueError(
            "J2: the table of hardening must start at alpha = 0, with increasing alpha and a "
            "yield stress that does not decrease"
        )
    return partial(_of_table, table[:, 0], table[:, 1])


def _of_function(given: Callable[[Array], Array], alpha: Array) -> tuple[Array, Array, Array]:
    """sigma_y of a smooth function, its slope by differences, its integral by Gauss's rule."""
    h = 1e-4 * (alpha + 1e-2)
    first, last = np.maximum(alpha - h, 0.0), alpha + h
    slope = (given(last) - given(first)) / (last - first)
    x, weights = np.polynomial.legendre.leggauss(24)
    inside = given((alpha[:, None] * (1 + x) / 2).ravel()).reshape(len(alpha), -1)
    return np.asarray(given(alpha), dtype=float), slope, alpha / 2 * (inside @ weights)


def _of_table(x: Array, y: Array, alpha: Array) -> tuple[Array, Array, Array]:
    """sigma_y, its slope and its integral of a table with the abscissae ``x``."""
    slopes = np.append(np.diff(y) / np.diff(x), 0.0)
    works = np.append(0.0, np.cumsum(np.diff(x) * (y[1:] + y[:-1]) / 2))
    row = np.clip(np.searchsorted(x, alpha, side="right") - 1, 0, None)
    ahead = alpha - x[row]
    stress = y[row] + slopes[row] * ahead
    return stress, slopes[row], works[row] + ahead * (y[row] + stress) / 2
