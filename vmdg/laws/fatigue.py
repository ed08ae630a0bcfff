"""Fatigue of bonds under cyclic loads."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import secant
from .base import Array, Mode, Update, add_to_diagonal, dot, outer, unit
from .mixed_mode import MixedModeDebonding
from .roots import increasing_root
from .secant import Scaled, Sheared, Start

if TYPE_CHECKING:
    from typing import Self  # of Python 3.11

# Negligible growth of damage in a step: round-off.
_ROUND_OFF = 1e-15

# Replaces zero in a logarithm.
_LEAST = 1e-100


class Wear(NamedTuple):
    """Rate of the damage at points of known mode, see `FatigueDebonding`."""

    endurance: Array  #: E (m,)
    endurance_by_angle: Array  #: dE/dth
    exponent: Array  #: beta
    exponent_by_angle: Array  #: dbeta/dth

    def log_rate(self, ratio: Array, life: float) -> Array:
        """ln dd/dN at lambda = `ratio`, without the limit of endurance (m,)."""
        by_ratio = self.exponent * np.log(ratio / self.endurance)
        return by_ratio - np.log(life * (self.exponent + 1.0))


class Worn(NamedTuple):
    """Equation of a branch and what it depends on, at points of known g."""

    value: Array  #: Phi (m,), grows with g
    slope: Array  #: its derivative by g at a given load
    by_load: tuple[Array, Array]  #: by T*_N and |T*_T|, mm2/N
    ratio: Array  #: lambda
    cos: Array  #: of th
    sin: Array


@dataclass(frozen=True)
class FatigueDebonding(MixedModeDebonding):
    """`MixedModeDebonding` with unloading="secant" whose bond is degraded by load cycles.

    The law CF20 (Davila 2020, NASA/TP-2020-220584 and "From S-N to the Paris law with a new
    mixed-mode cohesive fatigue model", NASA/TP-2018-219838), for a bond that is rigid up to its
    strength. A step is at the largest load of the cycles that it represents (cycle jump). With
    lambda the traction relative to the strength of the damaged bond at this mode,

        dd/dN = (lambda/E)^beta/(gamma (beta + 1))  where lambda >= E, otherwise 0,
        E = 2 e/(e + 1 + R (e - 1)),  e = endurance (1 - (1 - shear_factor) phi),
        beta = -7 brittleness/log10 E.

    d is the damage at the current mode, 1 - residual strength/strength, R the `ratio` of least to
    largest load, phi the shear fraction of the energy, gamma the `life`. CF20 compares the opening
    delta with that at which its elastic bond of stiffness k softens further, delta* = (1 - d)
    strength/k + d delta_c: both have the current secant stiffness, so that delta/delta* is the
    ratio of the tractions for any k. In the limit k -> infinity, with secant stiffness K and the
    gap (zeta_N/zeta_n, |zeta_T|/zeta_s) = D (cos th, sin th),

        lambda = D/(m d),  d = 1/(1 + m K),

    and the traction relative to the strength where the bond is intact. At a constant traction T the
    life of a point is, with p = T/strength,

        N = gamma (E/p)^beta (1 - p^(beta + 1)),

    an S-N line that passes through (E, gamma) and nearly (1, gamma^(1 - brittleness)) at gamma =
    1e7. While a crack grows, lambda is about sqrt(G/G_c) throughout its process zone, of length l,
    so that da/dN = l (G/(G_c E^2))^(beta/2)/(gamma (beta + 1)): a Paris law with exponent beta/2.

    Backward Euler: d - d_n = n dd/dN at the end of a step of n cycles; the monotonic law, lambda <=
    1, is a lower bound for d, attained for n = 0. At a given load lambda decreases with d for r >
    H, so that there is a unique root at a given mode. If lambda falls to E within the step, damage
    stops there. A step dissipates the integral of G_c lambda^2 dd.

    Attributes:
        normal_strength, shear_strength: P_n and P_s, MPa.
        normal_energy, shear_energy: G_n and G_s, N/mm.
        friction: Coulomb coefficient mu; gradual.
        viscosity: 0 MPa s/mm, as unloading="secant" requires.
        criterion, exponent: as in `MixedModeDebonding`.
        endurance: fraction of the strength with a life of `life` cycles at R = -1 in opening.
        ratio: R, least load over largest load of a cycle.
        life: gamma, cycles at the limit of endurance.
        brittleness: eta; for 1 the S-N line reaches the strength at one cycle.
        shear_factor: endurance in shear relative to that in opening.

    Raises:
        ValueError: a parameter is out of range.
    """

    unloading: str = field(default="secant", init=False)
    gradual_friction: bool | None = field(default=None, init=False)
    endurance: float = field(default=0.2, kw_only=True)
    ratio: float = field(default=0.1, kw_only=True)
    life: float = field(default=1e7, kw_only=True)
    brittleness: float = field(default=0.95, kw_only=True)
    shear_factor: float = field(default=0.58, kw_only=True)

    fatigues = True

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, low, high, remedy in (
            ("endurance", 0.0, 1.0, "a fraction of the strength, 0.2 for carbon/epoxy"),
            ("ratio", -math.inf, 1.0, "least load over largest load, 1 means no cycles"),
            ("life", 1.0, math.inf, "the number of cycles at the limit of endurance, 1e7"),
            ("brittleness", 0.0, math.inf, "0.95 for carbon/epoxy"),
            ("shear_factor", 0.0, math.inf, "endurance in shear over that in opening, 0.58"),
        ):
            value = getattr(self, name)
            if isinstance(value, str) or not low < value < high:
                raise ValueError(f"{name} = {value!r}: must be in ({low:g}, {high:g}); {remedy}")
        if not self.endurance * self.shear_factor < 1.0:
            raise ValueError(
                f"shear_factor = {self.shear_factor}: the endurance in shear, endurance * "
                "shear_factor, must be less than the strength; use a smaller value"
            )

    @property
    def symmetric(self) -> bool:
        """As without cycles, if the endurance is the same in all modes."""
        return super().symmetric and self.shear_factor == 1.0

    def wear(self, cos: ArrayLike, sin: ArrayLike) -> Wear:
        """Endurance and exponent of a mode.

        Args:
            cos, sin: of th (n,).
        """
        cos, sin = np.asarray(cos, dtype=float), np.asarray(sin, dtype=float)
        k = self.shear_energy / self.normal_energy
        linear = cos * cos + k * sin * sin
        return self._wear(k * sin * sin / linear, 2.0 * k * sin * cos / linear**2)

    def _wear(self, share: Array, share_by_angle: Array) -> Wear:
        """From the shear fraction phi of the energy, and its derivative by th."""
        fall = 1.0 - self.shear_factor
        e = self.endurance * (1.0 - fall * share)
        e_by_angle = -self.endurance * fall * share_by_angle
        below = e + 1.0 + self.ratio * (e - 1.0)
        E, by_angle = 2.0 * e / below, 2.0 * (1.0 - self.ratio) / below**2 * e_by_angle
        log = np.log(E)
        beta = self._decades / -log
        return Wear(E, by_angle, beta, beta * by_angle / (-log * E))

    @cached_property
    def _decades(self) -> float:
        """7 brittleness ln 10 = -beta ln E."""
        return 7.0 * self.brittleness * math.log(10.0)

    def cycles_to_failure(self, stress: ArrayLike, mixity: ArrayLike = 0.0) -> Array:
        """N of the class docstring, infinite below the limit of endurance.

        Args:
            stress: largest traction of the cycles relative to the strength of the mode.
            mixity: th as in `energy_at`, radians.
        """
        p, th = np.broadcast_arrays(
            np.asarray(stress, dtype=float), np.asarray(mixity, dtype=float)
        )
        wear = self.wear(np.cos(th), np.sin(th))
        lives = self.life * (wear.endurance / p) ** wear.exponent
        lives = np.maximum(lives * (1.0 - p ** (wear.exponent + 1.0)), 0.0)
        return np.where(p < wear.endurance, np.inf, lives)

    def cycles_at_strength(self, loss: float) -> float:
        """Cycles in which a point loaded to its residual strength loses a fraction of its strength.

        Args:
            loss: The fraction.
        """
        pure = self._wear(np.array([0.0, 1.0]), np.zeros(2))
        return float(loss / np.exp(pure.log_rate(np.ones(2), self.life)).max())

    @np.errstate(under="ignore")
    def return_map(
        self,
        trial: ArrayLike,
        normal: ArrayLike,
        gap: ArrayLike,
        softening: ArrayLike,
        penalty: ArrayLike,
        dt: float | Array = 1.0,
        cycles: ArrayLike = 0.0,
    ) -> Update:
        """Advance n points by one backward-Euler step of a number of cycles.

        Args:
            cycles: number of cycles (n,) or one number.

        Raises:
            ValueError: as of `Law.return_map`, or cycles < 0.
        """
        trial, normal, gap, softening, penalty = self._checked(
            trial, normal, gap, softening, penalty
        )
        cycles = np.broadcast_to(np.asarray(cycles, dtype=float), softening.shape)
        if not (np.isfinite(cycles) & (cycles >= 0.0)).all():
            raise ValueError("cycles: must be zero or positive and finite at all points")
        update = self._advance(trial, normal, gap, softening, penalty, 0.0)
        load = trial + penalty[:, None] * gap
        damage = np.minimum(softening / self.strength, 1.0)
        worn = (cycles > 0.0) & (damage < 1.0)
        pressed = dot(load, normal) < 0.0
        everywhere = (load, normal, gap, penalty, damage, damage)
        for branch, mask in ((_Open, worn & ~pressed), (_Pressed, worn & pressed)):
            rows = np.flatnonzero(mask)
            if rows.size:
                at = Start(rows, *(array[rows] for array in everywhere))
                _wear_down(branch, self.at(rows), update, at, cycles[rows])
        return update


def _wear_down(
    branch: type[_Open] | type[_Pressed],
    law: FatigueDebonding,
    update: Update,
    at: Start,
    cycles: Array,
) -> None:
    """Overwrite the rows of `update` in which cycles cause more damage than the monotonic law."""
    static = update.softening[at.rows] / law.strength
    points = branch(law, at, cycles)
    first = points.start()
    # the rate at the start gives an upper bound
    most = np.where(first.ratio >= first.endurance, cycles * np.exp(first.log_rate), 0.0)
    some = most > _ROUND_OFF
    if not some.any():
        return
    points, static = points.of(some), static[some]
    g, held = points.root(np.minimum(points.at.g + most[some], 1.0))
    further = g > static
    if further.any():
        points.of(further).write(update, g[further], held[further])


class Spent(NamedTuple):
    """Dissipation of a step, N/mm, and its derivatives by g, th and lambda at its end."""

    work: Array  #: (m,)
    by_g: Array
    by_angle: Array
    by_ratio: Array


class Beginning(NamedTuple):
    """Points with the damage at the start of the step."""

    ratio: Array  #: lambda (m,)
    endurance: Array  #: E (m,)
    log_rate: Array  #: ln dd/dN (m,)


class _Points:
    """Points of a branch with fatigue."""

    def __init__(self, law: FatigueDebonding, at: Start, cycles: Array):
        self.law, self.at, self.cycles = law, at, cycles

    def of(self, mask: NDArray[np.bool_]) -> Self:
        return type(self)(self.law.at(mask), secant.some_of(self.at, mask), self.cycles[mask])

    def root(self, start: Array) -> tuple[Array, NDArray[np.bool_]]:
        """g at the end, at most 1, and where damage has stopped at the endurance limit."""
        lower, upper = self.at.g, np.ones_like(start)
        start = np.where(start < 1.0, start, 0.5 * (lower + 1.0))

        def equation(held: bool, g: Array) -> tuple[Array, Array]:
            worn = self.worn(g, np.full(len(g), held))
            return worn.value, worn.slope

        by_rate, by_endurance = partial(equation, False), partial(equation, True)
        fails = by_rate(upper)[0] <= 0.0
        g = np.where(fails, 1.0, increasing_root(by_rate, lower, upper, start=start))
        held = by_endurance(g)[0] > 0.0
        if held.any():
            ended = increasing_root(by_endurance, lower, g, start=0.5 * (lower + g))
            g = np.where(held, ended, g)
        return g, held

    def worn(self, g: Array, held: NDArray[np.bool_]) -> Worn:
        """The equation at the end of the step: that of endurance where it stops damage."""
        raise NotImplementedError

    def _spent(self, g: Array, worn: Worn) -> Spent:
        """Integral of G_c lambda^2 dd: the mean of its values at both ends of the step."""
        law, at = self.law, self.at
        y_n, y_t = secant.reduced_gap(law, at)
        y_n = np.maximum(y_n, 0.0)
        length = np.sqrt(y_n * y_n + y_t * y_t)
        there = (length > 0.0) & (at.g > 0.0)
        some = np.where(there, length, 1.0)
        cos, sin = np.where(there, y_n / some, worn.cos), np.where(there, y_t / some, worn.sin)
        m, _ = law.flow_factor(cos, sin)
        ratio = length / np.where(there, law.with_factor(at.g, m) * m, 1.0)

        def along(cos: Array, sin: Array, ratio: Array) -> Spent:
            m, m_by_angle = law.flow_factor(cos, sin)
            energy, by_angle = law._energy(cos, sin)
            w, w_n = g + m * (1.0 - g), at.g + m * (1.0 - at.g)
            grown = g / w - at.g / w_n
            by_m = at.g * (1.0 - at.g) / w_n**2 - g * (1.0 - g) / w**2
            return Spent(
                energy * ratio**2 * grown,
                energy * ratio**2 * m / w**2,
                ratio**2 * (by_angle * grown + energy * by_m * m_by_angle),
                2.0 * energy * ratio * grown,
            )

        first = along(cos, sin, np.where(there, np.minimum(ratio, 1.0), worn.ratio))
        last, share = along(worn.cos, worn.sin, worn.ratio), np.where(there, 0.5, 1.0)
        return Spent(
            np.maximum(0.5 * (first.work + last.work), 0.0),
            0.5 * (first.by_g + last.by_g),
            share * last.by_angle,
            share * last.by_ratio,
        )


class _Open(_Points):
    """T*_N >= 0: (zeta_N/zeta_n, |zeta_T|/zeta_s) = g (x_n, x_t), x = (T*/P)/(1 - g + g r/H)."""

    def __init__(self, law: FatigueDebonding, at: Start, cycles: Array):
        super().__init__(law, at, cycles)
        self._load_n = dot(at.load, at.normal)
        self._tangential = at.load - self._load_n[:, None] * at.normal
        self._load_t = np.sqrt(dot(self._tangential, self._tangential))
        self._curves = Scaled(law.in_opening), Scaled(law.in_shear)

    def start(self) -> Beginning:
        """At g_n."""
        g = self.at.g
        u, cos, sin, _ = self._direction(g)
        m, _ = self.law.flow_factor(cos, sin)
        wear, ratio = self.law.wear(cos, sin), u * (1.0 - g + g / m)
        some = np.maximum(ratio, _LEAST)
        # d grows by m/(g + m (1 - g))^2 times less than g
        rate = wear.log_rate(some, self.law.life) + 2.0 * np.log(g + m * (1.0 - g)) - np.log(m)
        return Beginning(ratio, wear.endurance, rate)

    def _direction(self, g: Array) -> tuple[Array, Array, Array, tuple[Array, Array]]:
        """|x|, its direction (cos, sin), and 1 - g + g r/H in opening and shear."""
        n, s = self._curves
        e_n, e_t = (1.0 - g + g * self.at.penalty / curve.modulus for curve in (n, s))
        x_n, x_t = self._load_n / (n.strength * e_n), self._load_t / (s.strength * e_t)
        u = np.maximum(np.sqrt(x_n * x_n + x_t * x_t), _LEAST)
        return u, x_n / u, x_t / u, (e_n, e_t)

    def worn(self, g: Array, held: NDArray[np.bool_]) -> Worn:
        """ln(d - d_n) - ln(n dd/dN), or ln(E/lambda), with its derivatives.

        With lambda = |x| (1 - g + g/m) and d - d_n = m (g - g_n)/(w w_n), w = g + m (1 - g).
        """
        law, g_n = self.law, self.at.g
        u, cos, sin, (e_n, e_t) = self._direction(g)
        m, m_by_angle = law.flow_factor(cos, sin)
        wear = law.wear(cos, sin)
        w, w_n = g + m * (1.0 - g), g_n + m * (1.0 - g_n)
        ratio, beta = u * w / m, wear.exponent
        grown = np.maximum(g - g_n, _LEAST)
        value = np.log(m * grown / (w * w_n)) - np.log(self.cycles)
        value -= wear.log_rate(ratio, law.life)
        by_m = 1.0 / m - (1.0 - g) / w - (1.0 - g_n) / w_n + beta * g / (m * w)
        by_beta = 1.0 / (beta + 1.0) - np.log(ratio)
        by_angle = by_m * m_by_angle + by_beta * wear.exponent_by_angle
        # beta ln E does not depend on the mode
        by_g, by_u = 1.0 / grown - (1.0 + beta) * (1.0 - m) / w, -beta / u

        value = np.where(held, np.log(wear.endurance / ratio), value)
        ended = wear.endurance_by_angle / wear.endurance + g / (m * w) * m_by_angle
        by_angle = np.where(held, ended, by_angle)
        by_g, by_u = np.where(held, -(1.0 - m) / w, by_g), np.where(held, -1.0 / u, by_u)

        n, s = self._curves
        k_n, k_t = (
            (self.at.penalty / curve.modulus - 1.0) / e for curve, e in ((n, e_n), (s, e_t))
        )
        slope = by_g - by_u * u * (cos * cos * k_n + sin * sin * k_t)
        slope += by_angle * cos * sin * (k_n - k_t)
        by_load = (
            (by_u * cos - by_angle * sin / u) / (e_n * n.strength),
            (by_u * sin + by_angle * cos / u) / (e_t * s.strength),
        )
        return Worn(value, slope, by_load, ratio, cos, sin)

    def write(self, update: Update, g: Array, held: NDArray[np.bool_]) -> None:
        law, at, rows = self.law, self.at, self.at.rows
        n, s = self._curves
        u, cos, sin, (e_n, e_t) = self._direction(g)
        worn = self.worn(g, held)
        c_n, c_t = g / (n.modulus * e_n), g / (s.modulus * e_t)
        gap = (c_n * self._load_n)[:, None] * at.normal + c_t[:, None] * self._tangential
        traction = ((1.0 - g) / e_n * self._load_n)[:, None] * at.normal
        traction += ((1.0 - g) / e_t)[:, None] * self._tangential

        tangent = outer((c_n - c_t)[:, None] * at.normal, at.normal)
        add_to_diagonal(tangent, c_t)
        t = unit(self._tangential, self._load_t)
        # dc/dg = 1/(H e^2)
        softer = (self._load_n / (n.modulus * e_n**2))[:, None] * at.normal
        softer += (self._load_t / (s.modulus * e_t**2))[:, None] * t
        growth = -worn.by_load[0][:, None] * at.normal - worn.by_load[1][:, None] * t
        growth *= np.where(g < 1.0, 1.0 / worn.slope, 0.0)[:, None]
        update.tangent[rows] = tangent + outer(softer, growth)

        step = gap - at.gap
        update.gap[rows], update.traction[rows] = gap, traction
        update.softening[rows] = np.maximum(update.softening[rows], law.strength * g)
        update.multiplier[rows] = np.sqrt(dot(step, step))
        update.mode[rows] = np.where(g < 1.0, Mode.TENSION, Mode.OPEN)
        spent = self._spent(g, worn)
        update.damage_work[rows] = spent.work
        # x, |x| and th by the load, then lambda = |x| (1 - g + g/m)
        k_n, k_t = (at.penalty / curve.modulus - 1.0 for curve in (n, s))
        x_n = at.normal - (u * cos * n.strength * k_n)[:, None] * growth
        x_n /= (n.strength * e_n)[:, None]
        x_t = (t - (u * sin * s.strength * k_t)[:, None] * growth) / (s.strength * e_t)[:, None]
        u_by = cos[:, None] * x_n + sin[:, None] * x_t
        th_by = (cos[:, None] * x_t - sin[:, None] * x_n) / u[:, None]
        m, m_by_angle = law.flow_factor(cos, sin)
        ratio_by = (1.0 - g + g / m)[:, None] * u_by + (u * (1.0 / m - 1.0))[:, None] * growth
        ratio_by -= (u * g * m_by_angle / m**2)[:, None] * th_by
        assert update.work_gradient is not None
        update.work_gradient[rows] = (
            spent.by_g[:, None] * growth
            + spent.by_angle[:, None] * th_by
            + spent.by_ratio[:, None] * ratio_by
        )


class _Pressed(_Points):
    """T*_N < 0: spring and friction in shear, lambda = |zeta_T|/(zeta_s g), as in `secant`."""

    def __init__(self, law: FatigueDebonding, at: Start, cycles: Array):
        super().__init__(law, at, cycles)
        self._curve = Scaled(law.in_shear)
        self._pressure = -dot(at.load, at.normal)
        load = at.load + self._pressure[:, None] * at.normal
        held = at.gap - dot(at.gap, at.normal)[:, None] * at.normal
        self._sheared = Sheared(load, held, law.friction * self._pressure, at.penalty)
        zero = np.zeros_like(self._pressure)
        self._wear = law.wear(zero, zero + 1.0)

    def start(self) -> Beginning:
        ratio, _ = self._ratio(self.at.g)
        some = np.maximum(ratio, _LEAST)
        rate = self._wear.log_rate(some, self.law.life)
        return Beginning(ratio, self._wear.endurance, rate)

    def _ratio(self, g: Array) -> tuple[Array, Array]:
        curve, r = self._curve, self.at.penalty
        rubbing = secant.rub(curve, self._sheared, g)
        w, change = secant.borne(curve, self._sheared, g)
        length = np.sqrt(dot(w, w))
        s, s_slope = curve.at(g)
        M = curve.strength * s + r * curve.scale * g
        slips = length / M
        slope = (dot(unit(w, length), change) - slips * self._stiffening(s_slope)) / M
        held = self._sheared.held
        sticks = np.sqrt(dot(held, held)) / curve.scale
        stuck = (g > 0.0) & ~rubbing.slips
        some = np.where(g > 0.0, g, 1.0)
        return np.where(stuck, sticks / some, slips), np.where(stuck, -sticks / some**2, slope)

    def _stiffening(self, s_slope: Array) -> Array:
        """dM/dg."""
        return self._curve.strength * s_slope + self.at.penalty * self._curve.scale

    def worn(self, g: Array, held: NDArray[np.bool_]) -> Worn:
        """ln(g - g_n) - ln(n dd/dN), or ln(E/lambda), with its derivatives."""
        wear, beta = self._wear, self._wear.exponent
        ratio, ratio_slope = self._ratio(g)
        some = np.maximum(ratio, _LEAST)
        grown = np.maximum(g - self.at.g, _LEAST)
        value = np.log(grown) - np.log(self.cycles) - wear.log_rate(some, self.law.life)
        value = np.where(held, np.log(wear.endurance / some), value)
        steep = np.where(held, 1.0, beta) / some
        slope = np.where(held, 0.0, 1.0 / grown) - steep * ratio_slope
        zero, one = np.zeros_like(g), np.ones_like(g)
        return Worn(value, slope, (zero, zero), ratio, zero, one)

    def write(self, update: Update, g: Array, held: NDArray[np.bool_]) -> None:
        law, at, rows, curve = self.law, self.at, self.at.rows, self._curve
        worn = self.worn(g, held)
        rubbing = secant.rub(curve, self._sheared, g)
        step = rubbing.gap - self._sheared.held
        # derivative of g by the load, as on the softening curve
        s, _ = curve.at(g)
        M = curve.strength * s + at.penalty * curve.scale * g
        steep = np.where(held, 1.0, self._wear.exponent) / np.maximum(worn.ratio, _LEAST)
        resists = np.where(held, 0.0, M / (steep * (g - at.g)))
        update.tangent[rows], growth = secant.pressed_tangent(
            law, at, self._sheared, g, g < 1.0, rubbing, (worn.ratio, resists)
        )
        update.gap[rows] = rubbing.gap
        update.traction[rows] = rubbing.traction - self._pressure[:, None] * at.normal
        update.softening[rows] = np.maximum(update.softening[rows], law.strength * g)
        update.multiplier[rows] = np.sqrt(dot(step, step))
        closing = update.mode[rows] == Mode.CLOSING
        update.mode[rows] = np.where(closing, Mode.CLOSING, Mode.SHEAR)
        spent, (_, slope) = self._spent(g, worn), self._ratio(g)
        update.damage_work[rows] = spent.work
        w, _ = secant.borne(curve, self._sheared, g)
        e = unit(w, np.sqrt(dot(w, w)))
        ratio_by = secant.borne_by_load(law, self._sheared, at.normal, e, rubbing)
        ratio_by *= (rubbing.slips / M)[:, None]
        ratio_by += slope[:, None] * growth
        assert update.work_gradient is not None
        update.work_gradient[rows] = (
            spent.by_g[:, None] * growth + spent.by_ratio[:, None] * ratio_by
        )
        update.friction_work[rows] = self._sheared.cap * rubbing.slip * 0.5 * (at.g + g)
