"""Unloading to the origin, for laws with an initially rigid bond.

Below the largest gap so far the bond is a spring that is stress-free at zeta = 0,

    psi = K (H_n zeta_N^2 + H_s |zeta_T|^2)/2,   T = d psi/d zeta = K (H_n zeta_N N + H_s zeta_T),

with H_n = P_n/zeta_n, H_s = P_s/zeta_s, and zeta_n, zeta_s the scales of the softening curve
R = P s(x/scale) in opening and shear. K is infinite while the bond is intact (rigid, zeta = 0) and
never increases: with (cos th, sin th) = (zeta_N/zeta_n, |zeta_T|/zeta_s)/delta, delta their length,

    K = min(K_n, s(delta/m(th))/delta),

m(th) the flow factor of a mixed-mode criterion, 1 for other laws. Under proportional opening the
response is that with plastic unloading. A step dissipates the integral of -dK (H_n zeta_N^2 + H_s
|zeta_T|^2)/2, which is never negative, and zero at constant K.

With T* = T_tr + r zeta_n the step solves (K H_n + r) zeta_N = T*_N and (K H_s + r) zeta_T = T*_T.
While K falls these are the equations of the first step of an intact bond under the trial traction
T*, so the solution is unique for r > H, as there. T*_N < 0 closes the gap, zeta_N = 0 and T_N =
T*_N, and the bond acts in shear with friction in parallel, on the broken fraction d of the point
(Alfano and Sacco 2006, Int. J. Numer. Meth. Engng 68; d is the lost fraction of the strength),

    T_T = K H_s zeta_T + d mu |T_N| n,  n = dzeta_T/|dzeta_T| the direction of slip,

and zeta_T is constant while the traction beyond that of the spring is below d mu |T_N|. With g =
|zeta_T|/zeta_s and d = 1 - s(g) a step in which K falls solves

    r zeta_s g + P_s s(g) = |T*_T - d mu |T_N| n|,  n along T_tr,T - K H_s zeta_T,n.

The history Q (MPa) is that of the gap delta = g, m = 1, with the same K: on a proportional path of
a law with m = 1 it is strength - R, as with plastic unloading.
"""

from __future__ import annotations

from typing import NamedTuple, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .base import Array, Mode, Parameter, Update, add_to_diagonal, dot, outer, unit
from .compression import SofteningCurve, closes
from .roots import increasing_root

# Pieces of a slip, each with the mean over the gap of the fraction with friction, exact where the
# gap grows along the slip.
_PIECES = 8


class RigidLaw(Protocol):
    """Attributes of a law that is rigid up to its strength, see `ExtrinsicLaw`."""

    @property
    def strength(self) -> Parameter:
        """Traction at which damage starts in pure opening, MPa."""

    @property
    def friction(self) -> Parameter:
        """Coulomb coefficient."""

    def at(self, rows: NDArray) -> RigidLaw:
        """The law at some of its points."""

    @property
    def in_opening(self) -> SofteningCurve:
        """Curve in pure opening."""

    @property
    def in_shear(self) -> SofteningCurve:
        """Curve in pure shear."""

    def utilization(self, normal: Array, shear: Array) -> Array:
        """Traction on an intact point relative to its strength (n,)."""

    def first_step(self, normal: Array, shear: Array, penalty: Array) -> Array:
        """g (n,) after the first step of an intact bond, beyond its strength."""

    def flow_factor(self, cos: Array, sin: Array) -> tuple[Array, Array]:
        """m (n,) and dm/dth."""

    def with_factor(self, g: Array, m: Array) -> Array:
        """The g' of s(g')/(g' m) = s(g)/g (n,)."""


class Scaled:
    """A softening curve as s(g): R = P s, x = scale g."""

    def __init__(self, curve: SofteningCurve):
        self._curve = curve
        self.strength = curve.strength
        self.modulus = curve.softening_modulus
        self.scale = self.strength / self.modulus

    def at(self, g: Array) -> tuple[Array, Array]:
        """s(g) and ds/dg."""
        left, slope = self._curve.soften(np.full_like(g, self.strength), self.scale * g)
        return left / self.strength, slope / self.modulus

    def area(self, g: Array) -> Array:
        """Integral of s from 0 to g."""
        curve, whole = self._curve, np.full_like(g, self.strength)
        left = curve.remaining(whole, self.scale * g)
        spent = curve.bond_energy(whole) - curve.bond_energy(left)
        return spent / (self.strength * self.scale)

    def dissipated(self, g: Array) -> Array:
        """Area minus the triangle s g/2 recovered by unloading."""
        return self.area(g) - 0.5 * self.at(g)[0] * g

    def parted(self, g: Array) -> Array:
        return self.area(g) - self.at(g)[0] * g

    def stiffness(self, g: Array) -> Array:
        """K = s(g)/g, infinite where g = 0."""
        return np.divide(self.at(g)[0], g, out=np.full_like(g, np.inf), where=g > 0.0)


class Start(NamedTuple):
    """Points at the start of a step."""

    rows: NDArray[np.intp]
    load: Array  #: T* = T_tr + r zeta_n (m, d)
    normal: Array  #: N (m, d)
    gap: Array  #: zeta_n (m, d)
    penalty: Array  #: r (m,)
    g: Array  #: largest gap so far, from the K of the point at m = 1 (m,)
    damage: Array  #: Q_n/strength (m,)


def advance(
    law: RigidLaw, trial: Array, normal: Array, gap: Array, softening: Array, penalty: Array
) -> Update:
    update = Update.elastic(trial, gap, softening)
    load = trial + penalty[:, None] * gap
    damage = np.minimum(softening / law.strength, 1.0)
    everywhere = (load, normal, gap, penalty, law.in_opening.extent(damage), damage)
    pressed = dot(load, normal) < 0.0
    for branch, mask in ((_open, ~pressed), (_pressed, pressed)):
        rows = np.flatnonzero(mask)
        if rows.size:
            branch(law.at(rows), update, Start(rows, *(array[rows] for array in everywhere)))
    return update


def some_of(points: Points, rows: NDArray) -> Points:
    return type(points)(*(array[rows] for array in points))


def stored_energy(law: RigidLaw, gap: Array, normal: Array, softening: Array) -> Array:
    """psi (n,), N/mm."""
    opening, shear = Scaled(law.in_opening), Scaled(law.in_shear)
    g = law.in_opening.extent(np.minimum(softening / law.strength, 1.0))
    gap_n = dot(gap, normal)
    tangential = gap - gap_n[:, None] * normal
    squares = opening.modulus * gap_n**2 + shear.modulus * dot(tangential, tangential)
    # an intact bond has no gap
    return 0.5 * np.divide(opening.at(g)[0], g, out=np.zeros_like(g), where=g > 0.0) * squares


def rubbing(law: RigidLaw, softening: Array) -> Array:
    """d = 1 - s (n,)."""
    g = law.in_opening.extent(np.minimum(softening / law.strength, 1.0))
    return 1.0 - Scaled(law.in_shear).at(g)[0]


def _open(law: RigidLaw, update: Update, at: Start) -> None:
    """Points with T*_N >= 0."""
    opening, shear = Scaled(law.in_opening), Scaled(law.in_shear)
    normal, r, rows = at.normal, at.penalty, at.rows
    load_n = dot(at.load, normal)
    tangential = at.load - load_n[:, None] * normal
    load_t = np.sqrt(dot(tangential, tangential))

    g = at.g.copy()
    beyond = law.utilization(load_n, load_t) > 1.0
    first = law.at(beyond).first_step(load_n[beyond], load_t[beyond], r[beyond])
    g[beyond] = np.maximum(first, g[beyond])
    growing = (g > at.g) & (at.damage < 1.0)
    s, s_slope = opening.at(g)

    # zeta = (c_n N (x) N + c_t (I - N (x) N)) T*, c = 1/(K H + r)
    c_n, c_t = g / (s * opening.modulus + r * g), g / (s * shear.modulus + r * g)
    gap_n, gap_t = (c_n * load_n)[:, None] * normal, c_t[:, None] * tangential
    gap = gap_n + gap_t
    share_n, share_t = (s * c.modulus / (s * c.modulus + r * g) for c in (opening, shear))
    update.gap[rows] = gap
    update.traction[rows] = (share_n * load_n)[:, None] * normal + share_t[:, None] * tangential

    tangent = outer((c_n - c_t)[:, None] * normal, normal)
    add_to_diagonal(tangent, c_t)
    some = np.flatnonzero(growing)
    part = law.at(some)
    y_n, y_t = c_n * load_n / opening.scale, c_t * load_t / shear.scale
    delta = np.sqrt(y_n * y_n + y_t * y_t)[some]
    cos, sin = y_n[some] / delta, y_t[some] / delta
    m, m_by_angle = part.flow_factor(cos, sin)
    opening, shear = Scaled(part.in_opening), Scaled(part.in_shear)
    # -dK/dT* from E = K delta - s(delta/m(th)) = 0, with f = 1/(K + r/H) in opening and shear
    K, w, turn = s[some] / g[some], -s_slope[some] / m, m_by_angle / m
    f_n, f_t = c_n[some] * opening.modulus, c_t[some] * shear.modulus
    by_opening = f_n * ((K + w) * cos + w * turn * sin) / opening.strength
    by_shear = f_t * ((K + w) * sin - w * turn * cos) / shear.strength
    q_n, q_t = r[some] / opening.modulus, r[some] / shear.modulus
    by_K = cos * cos * f_n * (q_n - w) + sin * sin * f_t * (q_t - w)
    by_K -= w * turn * cos * sin * (f_n - f_t)
    fall = by_opening[:, None] * normal[some]
    fall += by_shear[:, None] * unit(tangential[some], load_t[some])
    fall /= (delta * by_K)[:, None]
    softer = f_n[:, None] * gap_n[some] + f_t[:, None] * gap_t[some]
    tangent[some] += outer(softer, fall)
    update.tangent[rows] = tangent
    th_by = (cos * c_t[some] / (shear.scale * delta))[:, None] * unit(
        tangential[some], load_t[some]
    )
    th_by -= (sin * c_n[some] / (opening.scale * delta))[:, None] * normal[some]
    th_by -= (cos * sin * (f_n - f_t))[:, None] * fall

    damage = part.in_opening.damage(g[some])
    update.softening[rows[some]] = np.maximum(
        update.softening[rows[some]], part.strength * np.minimum(damage, 1.0)
    )
    step = (gap - at.gap)[some]
    update.multiplier[rows[some]] = np.sqrt(dot(step, step))
    update.mode[rows[some]] = Mode.TENSION
    update.mode[rows[update.softening[rows] >= law.strength]] = Mode.OPEN
    spent = _spent(part, some_of(at, some), g[some], cos, sin)
    update.damage_work[rows[some]] = spent.work
    assert update.work_gradient is not None
    update.work_gradient[rows[some]] = (
        spent.by_angle[:, None] * th_by - spent.by_stiffness[:, None] * fall
    )


def reduced_gap(law: RigidLaw, at: Start) -> tuple[Array, Array]:
    """(zeta_N/zeta_n, |zeta_T|/zeta_s) at the start of the step (m,)."""
    gap_n = dot(at.gap, at.normal)
    tangential = at.gap - gap_n[:, None] * at.normal
    length = np.sqrt(dot(tangential, tangential))
    return gap_n / Scaled(law.in_opening).scale, length / Scaled(law.in_shear).scale


class Spent(NamedTuple):
    """Dissipation of a step in which K falls, N/mm, and its derivatives by K and th at its end."""

    work: Array  #: (m,)
    by_stiffness: Array
    by_angle: Array


def _spent(law: RigidLaw, at: Start, g: Array, cos: Array, sin: Array) -> Spent:
    """The integral over -dK at a fixed direction.

    It is the mean over the directions at both ends of the step, of second order where the gap
    rotates. With G = P_n zeta_n cos^2 + P_s zeta_s sin^2 it is m G (D(x) - D(x_n)), where K =
    s(x)/(x m) and D' = (s - s' x)/2, so that its derivative by K is -G (m x)^2/2 and by m G (D(x) -
    s x/2 - D(x_n) + s_n x_n/2).
    """
    opening, shear = Scaled(law.in_opening), Scaled(law.in_shear)
    y_n, y_t = reduced_gap(law, at)
    delta = np.sqrt(y_n * y_n + y_t * y_t)
    some = np.where(delta > 0.0, delta, 1.0)
    cos_n, sin_n = (np.where(delta > 0.0, a, b) for a, b in ((y_n / some, cos), (y_t / some, sin)))

    def along(cos: Array, sin: Array) -> Spent:
        m, m_by_angle = law.flow_factor(cos, sin)
        in_n, in_s = (curve.strength * curve.scale for curve in (opening, shear))
        energy, by_angle = in_n * cos * cos + in_s * sin * sin, 2.0 * (in_s - in_n) * sin * cos
        first, last = law.with_factor(at.g, m), law.with_factor(g, m)
        work = opening.dissipated(last) - opening.dissipated(first)
        by_m = opening.parted(last) - opening.parted(first)
        return Spent(
            m * energy * work,
            -0.5 * energy * (m * last) ** 2,
            m * by_angle * work + m_by_angle * energy * by_m,
        )

    one, other = along(cos_n, sin_n), along(cos, sin)
    return Spent(
        np.maximum(0.5 * (one.work + other.work), 0.0),
        0.5 * (one.by_stiffness + other.by_stiffness),
        np.where(delta > 0.0, 0.5, 1.0) * other.by_angle,
    )


class Sheared(NamedTuple):
    """Shear of compressed points at the start of a step."""

    load: Array  #: T*_T (m, d)
    held: Array  #: zeta_T,n (m, d)
    cap: Array  #: mu |T_N| (m,)
    penalty: Array  #: r (m,)


class Rubbing(NamedTuple):
    """Shear of compressed points at a given K: spring, friction and slip."""

    c: Array  #: 1/(K H_s + r) (m,), mm/MPa
    damage: Array  #: d, the fraction with friction (m,)
    size: Array  #: |f|, f = T_tr,T - K H_s zeta_T,n beyond the spring (m,), MPa
    n: Array  #: f/|f| (m, d)
    slip: Array  #: |dzeta_T| (m,), mm
    slips: NDArray[np.bool_]
    gap: Array  #: zeta_T (m, d)
    traction: Array  #: T_T (m, d)


Points = TypeVar("Points", Start, Sheared, Rubbing)


def rub(shear: Scaled, at: Sheared, g: Array) -> Rubbing:
    """Friction parallel to the spring for a known largest gap g (m,), zero where the bond is intact
    and rigid."""
    load, held, cap, r = at
    s, _ = shear.at(g)
    bonded = np.divide(s * shear.modulus, g, out=np.zeros_like(g), where=g > 0.0)
    c = g / (s * shear.modulus + r * g)
    force = load - (r + bonded)[:, None] * held
    size = np.sqrt(dot(force, force))
    n, rubs = unit(force, size), cap * (1.0 - s)
    slips = (g > 0.0) & ((size > rubs) | (rubs == 0.0))
    slip = np.where(slips, c * (size - rubs), 0.0)
    gap = held + slip[:, None] * n
    friction = np.where(slips[:, None], rubs[:, None] * n, force)
    return Rubbing(c, 1.0 - s, size, n, slip, slips, gap, bonded[:, None] * gap + friction)


def _pressed(law: RigidLaw, update: Update, at: Start) -> None:
    """Points with T*_N < 0: zeta_N = 0, spring and friction in shear."""
    shear, rows, r = Scaled(law.in_shear), at.rows, at.penalty
    pressure = -dot(at.load, at.normal)
    load = at.load + pressure[:, None] * at.normal
    gap_n = dot(at.gap, at.normal)
    start = Sheared(load, at.gap - gap_n[:, None] * at.normal, law.friction * pressure, r)

    rubbing = rub(shear, start, at.g)
    length2 = dot(rubbing.gap, rubbing.gap)
    # The largest gap, at which friction sticks, is as long as itself up to rounding only.
    further = rubbing.slips & (length2 > (shear.scale * at.g) ** 2)
    growing = np.where(at.g > 0.0, further, dot(load, load) > shear.strength * shear.strength)
    growing &= at.damage < 1.0
    g, some = at.g.copy(), np.flatnonzero(growing)
    part = law.at(some)
    g[some] = _grown(Scaled(part.in_shear), some_of(start, some), g[some])
    rubbing = rub(shear, start, g)

    update.gap[rows] = rubbing.gap
    update.traction[rows] = rubbing.traction - pressure[:, None] * at.normal
    damage = np.minimum(part.in_shear.damage(g[some]), 1.0)
    update.softening[rows[some]] = np.maximum(update.softening[rows[some]], part.strength * damage)
    update.tangent[rows], growth = pressed_tangent(law, at, start, g, growing, rubbing)

    rubs = rubbing.slips & ((start.cap * rubbing.damage > 0.0) | (at.damage >= 1.0))
    update.multiplier[rows] = np.where(growing | rubs, rubbing.slip, 0.0)
    mode = np.where(rubs, Mode.FRICTION, Mode.ELASTIC)
    mode = np.where(growing, Mode.SHEAR, mode)
    closing = closes(gap_n, at.gap, r, np.maximum(pressure, law.strength))
    update.mode[rows] = np.where(closing, Mode.CLOSING, mode)
    one = np.ones(len(some))
    spent = _spent(part, some_of(at, some), g[some], np.zeros_like(one), one)
    update.damage_work[rows[some]] = spent.work
    s, s_slope = Scaled(part.in_shear).at(g[some])
    by_g = spent.by_stiffness * (s_slope * g[some] - s) / g[some] ** 2
    assert update.work_gradient is not None
    update.work_gradient[rows[some]] = by_g[:, None] * growth[some]
    update.friction_work[rows] = start.cap * _rubbed(shear, start.held, at.g, growing, rubbing)


def _grown(shear: Scaled, at: Sheared, start: Array) -> Array:
    """Root g > g_n of r zeta_s g + P_s s(g) = |T*_T - d mu |T_N| n|, where K falls, from g_n
    (m,)."""
    r = at.penalty

    def imbalance(g: Array) -> tuple[Array, Array]:
        w, change = borne(shear, at, g)
        length = np.sqrt(dot(w, w))
        s, s_slope = shear.at(g)
        value = r * shear.scale * g + shear.strength * s - length
        slope = r * shear.scale + shear.strength * s_slope - dot(unit(w, length), change)
        return value, slope

    upper = (np.sqrt(dot(at.load, at.load)) + at.cap) / (r * shear.scale)
    return increasing_root(imbalance, start, upper, start=start)


def borne(shear: Scaled, at: Sheared, g: Array) -> tuple[Array, Array]:
    """w = T*_T - d mu |T_N| n = (K H_s + r) zeta_T at a g (m, d), and dw/dg."""
    s, s_slope = shear.at(g)
    rubbing = rub(shear, at, g)
    n = rubbing.n
    K_slope = np.divide(s_slope * g - s, g * g, out=np.zeros_like(g), where=g > 0.0)
    across = at.held - dot(n, at.held)[:, None] * n
    size = np.where(rubbing.size > 0.0, rubbing.size, 1.0)
    n_slope = -(shear.modulus * K_slope / size)[:, None] * across
    rubs = at.cap * rubbing.damage
    change = (at.cap * s_slope)[:, None] * n - rubs[:, None] * n_slope
    return at.load - rubs[:, None] * n, change


def pressed_tangent(
    law: RigidLaw,
    at: Start,
    start: Sheared,
    g: Array,
    growing: NDArray[np.bool_],
    rubbing: Rubbing,
    worn: tuple[Array, Array] | None = None,
) -> tuple[Array, Array]:
    """d zeta/d T_tr (m, d, d) of `_pressed`: at given K, plus the contribution of dK where K falls;
    dg/d T_tr (m, d).

    Args:
        worn: For points with fatigue, at r zeta_s g + P_s s = |w|/lambda instead of on their curve:
            lambda and, in MPa, lambda times the left-hand side over d ln(rate)/d ln(lambda) and the
            growth of g (m,).
    """
    normal, r, n = at.normal, at.penalty, rubbing.n
    c, rubs = np.where(rubbing.slips, rubbing.c, 0.0), start.cap * rubbing.damage
    some = rubbing.size > 0.0
    turns = np.where(some, 1.0 - rubs / np.where(some, rubbing.size, 1.0), 1.0)
    tangent = outer((c * (1.0 - turns))[:, None] * n, n)
    tangent -= outer((c * turns)[:, None] * normal, normal)
    add_to_diagonal(tangent, c * turns)
    # the friction of a point grows with its pressure
    by_normal = law.friction * rubbing.damage
    tangent += outer((c * by_normal)[:, None] * n, normal)

    growth, rows = np.zeros_like(n), np.flatnonzero(growing & rubbing.slips)
    part, start = law.at(rows), some_of(start, rows)
    shear = Scaled(part.in_shear)
    g, r, c, normal = (a[rows] for a in (g, r, c, normal))
    w, change = borne(shear, start, g)
    s, s_slope = shear.at(g)
    e = unit(w, np.sqrt(dot(w, w)))
    slope = r * shear.scale + shear.strength * s_slope
    if worn is not None:
        ratio, resistance = worn
        slope = ratio[rows] * slope + resistance[rows]
    slope -= dot(e, change)
    by_load = borne_by_load(part, start, normal, e, some_of(rubbing, rows))
    growth[rows] = by_load / slope[:, None]
    K_slope = (s_slope * g - s) / (g * g)
    softer = change - (shear.modulus * K_slope * c)[:, None] * w
    tangent[rows] += outer(c[:, None] * softer, growth[rows])
    return tangent, growth


def borne_by_load(
    law: RigidLaw, start: Sheared, normal: Array, e: Array, rubbing: Rubbing
) -> Array:
    """d|w|/d T_tr at a given g (m, d), w of `borne` and e its direction."""
    rubs, some = start.cap * rubbing.damage, rubbing.size > 0.0
    share = np.where(some, rubs / np.where(some, rubbing.size, 1.0), 0.0)
    along = dot(e, rubbing.n)
    turned = (1.0 - share)[:, None] * e + (share * along)[:, None] * rubbing.n
    # the friction of a point grows with its pressure
    return turned + (law.friction * rubbing.damage * along)[:, None] * normal


def _rubbed(
    shear: Scaled,
    held: Array,
    g_n: Array,
    growing: NDArray[np.bool_],
    rubbing: Rubbing,
) -> Array:
    """Integral of d along the slip from zeta_T,n (m, d) (m,), mm: d_n up to the largest gap so far,
    then d of the gap."""
    forward, reach = dot(held, rubbing.n), shear.scale * g_n
    room = forward * forward + reach * reach - dot(held, held)
    first = np.sqrt(np.maximum(room, 0.0)) - forward
    first = np.where(growing, np.clip(first, 0.0, rubbing.slip), rubbing.slip)
    result, piece = first * (1.0 - shear.at(g_n)[0]), (rubbing.slip - first) / _PIECES
    last = g_n
    for i in range(_PIECES):
        gap = held + (first + (i + 1) * piece)[:, None] * rubbing.n
        g = np.maximum(np.sqrt(dot(gap, gap)) / shear.scale, last)
        grows = g > last
        spent = (shear.area(g) - shear.area(last)) / np.where(grows, g - last, 1.0)
        result += piece * (1.0 - np.clip(np.where(grows, spent, shear.at(g)[0]), 0.0, 1.0))
        last = g
    return result
