"""Oracle twins of `vmdg.laws`: one point at a time, plain `math`, every equation by bisection.

They share no formula for dgamma, no tangent and no work with the package: a step is found by
bisecting the statement of the law itself, its works by summing the resistance over small pieces of
the path.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

PIECES = 400


class Step(NamedTuple):
    """One point after one step, in the names of `vmdg.laws.Update`."""

    traction: list
    gap: list
    softening: float
    multiplier: float
    mode: str
    damage_work: float
    friction_work: float
    viscous_work: float


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def combine(*terms):
    """Sum of factor * vector."""
    return [sum(f * v[i] for f, v in terms) for i in range(len(terms[0][1]))]


def bisect(function, lower, upper):
    """Root of an increasing function to the last bit."""
    while True:
        middle = 0.5 * (lower + upper)
        if not lower < middle < upper:
            return middle
        if function(middle) > 0.0:
            upper = middle
        else:
            lower = middle


def trapezoids(function, length):
    """Integral over (0, length)."""
    points = [function(length * i / PIECES) for i in range(PIECES + 1)]
    return length / PIECES * (sum(points) - 0.5 * (points[0] + points[-1]))


@dataclass
class Linear:
    """R(x) after x more slip."""

    strength: float
    critical_gap: float

    def after(self, resistance, x):
        return max(resistance - self.strength / self.critical_gap * x, 0.0)


@dataclass
class Exponential:
    strength: float
    energy: float

    def after(self, resistance, x):
        return resistance * math.exp(-x * self.strength / self.energy)


@dataclass
class Trapezoid:
    """What is left of the bond is strength (1 - kappa/critical_gap)."""

    strength: float
    plateau_gap: float
    critical_gap: float

    def remaining(self, left, x):
        return max(left - self.strength / self.critical_gap * x, 0.0)

    def after(self, left, x):
        kappa = self.critical_gap * (1 - left / self.strength) + x
        if kappa <= self.plateau_gap:
            return self.strength
        return max(self.steepest() * (self.critical_gap - kappa), 0.0)

    def steepest(self):
        return self.strength / (self.critical_gap - self.plateau_gap)


def remaining(curve, left, x):
    """strength - Q: R, unless the curve does not fall all the way."""
    return curve.remaining(left, x) if isinstance(curve, Trapezoid) else curve.after(left, x)


def borne(curve, eta, left, x):
    """Overstress after the slip x in this step: that of the bond at its start, eta x R_n/P."""
    return eta * x * curve.after(left, 0.0) / curve.strength


def pressed(curve, mu, eta, trial, normal, gap, r, resistance, gradual=False):
    """Closing and shear for T_tr.N < 0: gap, traction, slip, R, mode and the three works."""
    trial_n, gap_n = dot(trial, normal), dot(gap, normal)
    closed_by = min(max(gap_n, 0.0), -trial_n / r)
    traction_n = min(trial_n + r * closed_by, 0.0) if closed_by == max(gap_n, 0.0) else 0.0
    shear = combine((1.0, trial), (-trial_n, normal))
    s = math.sqrt(dot(shear, shear))
    cap = mu * -traction_n

    def held(x, overstress):
        left = curve.after(resistance, x)
        if gradual:
            return left + overstress + (1 - left / curve.strength) * cap
        return max(left + overstress, cap)

    slip = 0.0
    if s > held(0.0, 0.0):
        slip = bisect(lambda x: held(x, borne(curve, eta, resistance, x)) - (s - r * x), 0.0, s / r)
    left, overstress = curve.after(resistance, slip), borne(curve, eta, resistance, slip)
    mode = "ELASTIC"
    if slip > 0.0:
        mode = "FRICTION" if (left == 0 if gradual else cap >= left + overstress) else "SHEAR"
    if closed_by > 1e-12:
        mode = "CLOSING"
    direction = combine((1.0 / s if s else 0.0, shear))
    bond = trapezoids(lambda x: curve.after(resistance, x), slip)
    viscous = trapezoids(
        lambda x: overstress if gradual or curve.after(resistance, x) + overstress > cap else 0.0,
        slip,
    )
    total = trapezoids(lambda x: held(x, overstress), slip)
    new_gap = combine((1.0, gap), (-closed_by, normal), (slip, direction))
    traction = combine((traction_n, normal), (s - r * slip, direction))
    left = remaining(curve, resistance, slip)
    return new_gap, traction, slip, left, mode, (bond, total - bond - viscous, viscous)


def radial(curve, mu, eta, trial, normal, gap, softening, r, gradual=False):
    """`Debonding` (curve Linear) and `ExponentialDebonding` (curve Exponential)."""
    resistance = max(curve.strength - softening, 0.0)
    if dot(trial, normal) < 0.0:
        new_gap, traction, slip, left, mode, works = pressed(
            curve, mu, eta, trial, normal, gap, r, resistance, gradual
        )
    else:
        s = math.sqrt(dot(trial, trial))
        slip = 0.0
        if s > curve.after(resistance, 0.0):
            slip = bisect(
                lambda x: (
                    curve.after(resistance, x) + borne(curve, eta, resistance, x) - (s - r * x)
                ),
                0.0,
                s / r,
            )
        left = remaining(curve, resistance, slip)
        n = combine((1.0 / s if s else 0.0, trial))
        new_gap = combine((1.0, gap), (slip, n))
        traction = combine((1.0, trial), (-r * slip, n))
        mode = "TENSION" if slip > 0.0 else "ELASTIC"
        if curve.strength - left >= curve.strength:
            mode = "OPEN"
        bond = trapezoids(lambda x: curve.after(resistance, x), slip)
        works = (bond, 0.0, borne(curve, eta, resistance, slip) * slip)
    return Step(traction, new_gap, max(softening, curve.strength - left), slip, mode, *works)


def interaction(law, cos, sin):
    """m(th) of `MixedModeDebonding`: the energy of the criterion over that of the linear one."""
    g_n, g_s, x = law.normal_energy, law.shear_energy, law.exponent
    linear = g_n * cos**2 + g_s * sin**2
    share = g_s * sin**2 / linear
    if law.criterion == "BK":
        return (g_n + (g_s - g_n) * share**x) / linear
    if law.criterion == "power":
        return (((1 - share) / g_n) ** x + (share / g_s) ** x) ** (-1 / x) / linear
    return 1.0


def steepest(law):
    """H of `MixedModeDebonding`: the least r with one root only, by differences of m."""
    p_n, p_s = law.normal_strength, law.shear_strength
    h_n, h_s = p_n**2 / (2 * law.normal_energy), p_s**2 / (2 * law.shear_energy)

    def needed(th):
        cos, sin, step = math.cos(th), math.sin(th), 1e-6
        m = interaction(law, cos, sin)
        ahead, behind = (interaction(law, math.cos(x), math.sin(x)) for x in (th + step, th - step))
        bend = (ahead - behind) / (2 * step * m) * (h_n - h_s) * sin * cos
        return max(h_n, h_s, h_n * cos**2 + h_s * sin**2 + bend) / m

    return max(needed(0.5 * math.pi * i / 2000) for i in range(2001))


def mixed(law, eta, trial, normal, gap, softening, r):
    """`MixedModeDebonding`: bisection for th and d_{n+1} in the statement of flow and yield."""
    p_n, p_s = law.normal_strength, law.shear_strength
    z_n, z_s = 2.0 * law.normal_energy / p_n, 2.0 * law.shear_energy / p_s
    rho_n = max(1.0 - softening / p_n, 0.0)
    trial_n = dot(trial, normal)
    if trial_n < 0.0:
        new_gap, traction, slip, left, mode, works = pressed(
            *(Linear(p_s, z_s), law.friction, eta, trial, normal, gap, r, p_s * rho_n),
            gradual=law.gradual_friction,
        )
        return Step(traction, new_gap, max(softening, p_n * (1 - left / p_s)), slip, mode, *works)

    shear = combine((1.0, trial), (-trial_n, normal))
    t = math.sqrt(dot(shear, shear))

    def direction(g, m):
        """(cos th, sin th) that the trial traction asks for, not yet of length one."""
        rho = max(rho_n - g, 0.0)
        # of the penalty and of the overstress
        flow = (r * g + eta * rho_n * g) * m
        return trial_n / (p_n * rho + flow * z_n), t / (p_s * rho + flow * z_s)

    def growth(m):
        parting = math.hypot(trial_n / z_n, t / z_s) / ((r + eta * rho_n) * m)
        if parting >= rho_n:
            return parting
        return bisect(lambda g: 1.0 - math.hypot(*direction(g, m)), 0.0, rho_n)

    def turned(th):
        m = interaction(law, math.cos(th), math.sin(th))
        cos, sin = direction(growth(m), m)
        return th - math.atan2(sin, cos)

    if math.hypot(trial_n / p_n, t / p_s) <= rho_n and rho_n > 0.0:
        return Step(list(trial), list(gap), softening, 0.0, "ELASTIC", 0.0, 0.0, 0.0)
    cos, sin = trial_n / z_n, t / z_s
    length = math.hypot(cos, sin) or 1.0
    cos, sin = cos / length, sin / length
    if length / (r + eta * rho_n) >= rho_n * interaction(law, cos, sin):
        step = combine((1.0 / (r + eta * rho_n), trial))
        rho, mode = 0.0, "OPEN"
    else:
        m = 1.0
        if law.criterion != "linear":
            th = bisect(turned, 0.0, 0.5 * math.pi)
            m = interaction(law, math.cos(th), math.sin(th))
        g = growth(m)
        rho, mode = rho_n - g, "TENSION"
        cos, sin = direction(g, m)
        step = combine((m * g * z_n * cos, normal), (m * g * z_s * sin / t if t else 0.0, shear))
    length = math.sqrt(dot(step, step))
    energy = interaction(law, cos, sin) * (law.normal_energy * cos**2 + law.shear_energy * sin**2)
    work = trapezoids(lambda g: 2 * (rho_n - g) * energy, rho_n - rho)
    return Step(
        combine((1.0, trial), (-r, step)),
        combine((1.0, gap), (1.0, step)),
        max(softening, p_n * (1.0 - rho)),
        length,
        mode,
        work,
        0.0,
        eta * rho_n * length**2,
    )


def intrinsic(law, eta, trial, normal, gap, softening, r):
    """`IntrinsicExponential`: bisection for the length of zeta along b = T_tr + r zeta_n."""
    scale = law.fracture_energy / (math.e * law.strength)
    stiffness = law.fracture_energy / scale**2
    b = combine((1.0, trial), (r, gap))
    b_n = dot(b, normal)
    contact = min(b_n, 0.0)
    b = combine((1.0, b), (-contact, normal))
    b_t = combine((1.0, b), (-dot(b, normal), normal))
    d_n = softening / law.strength
    length = math.sqrt(dot(b, b))
    if length == 0.0:
        return Step(combine((contact, normal)), [0.0] * len(b), softening, 0.0, "ELASTIC", 0, 0, 0)
    per_length = math.hypot(max(b_n, 0.0), law.shear_weight * math.sqrt(dot(b_t, b_t))) / length

    def damage(x):
        return max(d_n, -math.expm1(-per_length * x / scale))

    x_n = -math.log(max(1.0 - d_n, 1e-300)) * scale / per_length

    def overstress(x):
        """Only where damage grows, by what was left at the start."""
        return eta * (1.0 - d_n) * max(x - x_n, 0.0)

    def bond(x):
        return stiffness * (1 - damage(x)) * x + overstress(x)

    x = bisect(lambda x: r * x + bond(x) - length, 0.0, length / r)
    d = damage(x)
    new_gap = combine((x / length, b))
    traction = combine((bond(x) / length, b), (contact, normal))
    grows = d > d_n
    step = combine((1.0, new_gap), (-1.0, gap))
    # dissipation = integral of K |zeta|^2/2 dd, dd = exp(-y) dy, |zeta|^2 = scale^2 y^2 ray2, with
    # the mean of ray2 at both ends, where there is a gap at the start
    ray2 = per_length**-2
    if (size := math.sqrt(dot(gap, gap))) > 0.0:
        open_n = dot(gap, normal)
        gap_t = combine((1.0, gap), (-open_n, normal))
        sliding = law.shear_weight * math.sqrt(dot(gap_t, gap_t))
        ray2 = (ray2 + (size / math.hypot(open_n, sliding)) ** 2) / 2
    y_n = -math.log(max(1.0 - d_n, 1e-300))
    y = per_length * x / scale
    work = trapezoids(
        lambda g: 0.5 * stiffness * ray2 * (scale * (y_n + g)) ** 2 * math.exp(-(y_n + g)),
        min(y, 40.0) - y_n if grows else 0.0,
    )
    mode = "ELASTIC"
    if grows:
        mode = "SHEAR" if b_n < 0.0 else "TENSION"
    if d_n >= 1.0 and b_n >= 0.0:
        mode = "OPEN"
    softening = law.strength * d if grows else softening
    slip = math.sqrt(dot(step, step)) if grows else 0.0
    viscous = overstress(x) * (x - x_n) if grows else 0.0
    return Step(traction, new_gap, softening, slip, mode, work, 0.0, viscous)


def returns_to_origin(law):
    return getattr(law, "unloading", "plastic") == "secant"


def softening_curve(law):
    """s(g), P_n, P_s and the scales of the gap, P_n/H_n and P_s/H_s."""
    if hasattr(law, "normal_strength"):
        p_n, p_s = law.normal_strength, law.shear_strength
        scales = 2 * law.normal_energy / p_n, 2 * law.shear_energy / p_s
        return (lambda g: max(1 - g, 0.0)), p_n, p_s, *scales
    p = law.strength
    if hasattr(law, "plateau_gap"):
        scale = law.critical_gap - law.plateau_gap
        curve = Trapezoid(p, law.plateau_gap, law.critical_gap)
        return (lambda g: curve.after(p, g * scale) / p), p, p, scale, scale
    if hasattr(law, "fracture_energy"):
        scale = law.fracture_energy / p
        return (lambda g: math.exp(-g)), p, p, scale, scale
    return (lambda g: max(1 - g, 0.0)), p, p, law.critical_gap, law.critical_gap


def secant(law, trial, normal, gap, softening, r):
    """Laws with unloading="secant": bisection for K, or for the largest gap under pressure."""
    s, p_n, p_s, z_n, z_s = softening_curve(law)
    h_n, h_s = p_n / z_n, p_s / z_s
    d = softening / p_n
    # g where the bond is gone
    most = 800.0 if hasattr(law, "fracture_energy") else 1.0
    if hasattr(law, "plateau_gap"):
        most = law.critical_gap / (law.critical_gap - law.plateau_gap)
    g_n = most * d
    if hasattr(law, "fracture_energy"):
        g_n = -math.log1p(-d) if d < 1 else most
    K_n = s(g_n) / g_n if g_n > 0 else math.inf
    b = combine((1.0, trial), (r, gap))
    b_n = dot(b, normal)
    b_t = combine((1.0, b), (-b_n, normal))
    t = math.sqrt(dot(b_t, b_t))
    old_n = dot(gap, normal)
    old_t = combine((1.0, gap), (-old_n, normal))

    def history(K):
        """g of m = 1."""
        if K == 0.0:
            return most
        return bisect(lambda g: g * K - s(g), 0.0, 800.0)

    def factor(cos, sin):
        return interaction(law, cos, sin) if hasattr(law, "criterion") else 1.0

    def spent(g, y_n, y_t):
        """Integral of -dK (H_n zeta_N^2 + H_s zeta_T^2)/2 at a fixed direction."""
        length = math.hypot(y_n, y_t)
        cos, sin = y_n / length, y_t / length
        m, energy = factor(cos, sin), p_n * z_n * cos**2 + p_s * z_s * sin**2

        def along(g):
            return bisect(lambda x: s(g) * m * x - g * s(x), 0.0, 800.0) if s(g) > 0 else g

        first = along(g_n) if g_n > 0 else 0.0
        h = 1e-8

        def rate(x):
            slope = (s(x + h) - s(x - h)) / (2 * h)
            return 0.5 * m * energy * (s(x) - x * slope)

        last = max(min(along(g), most, 60.0), first)
        knee = min(max(getattr(law, "plateau_gap", 0.0) / z_n, first), last)
        parts = ((first, knee - h, knee - h), (knee + h, last, knee + h))
        return sum(
            trapezoids(lambda x, a=a: rate(a + x), b - a) + h * rate(beside)
            for a, b, beside in parts
            if b > a
        )

    if b_n >= 0.0:

        def openings(K):
            return (b_n / (K * h_n + r) / z_n, t / (K * h_s + r) / z_s) if K < 1e300 else (0.0, 0.0)

        def excess(K):
            """Scaled traction less what the curve bears at this K."""
            y = openings(K)
            delta = math.hypot(*y)
            return K * delta - s(delta / factor(y[0] / delta, y[1] / delta))

        K, grows = K_n, False
        if math.hypot(b_n / p_n, t / p_s) > 1.0 and K_n > 0:
            reached = 1 / bisect(lambda x: -excess(1 / x), 1e-30, 1e12)
            reached = 0.0 if reached < 1e-11 else reached
            grows = reached < K_n
            K = min(K_n, reached)
        y = openings(K)
        new_gap = combine((y[0] * z_n, normal), (y[1] * z_s / t if t else 0.0, b_t))
        traction = combine((1.0, b), (-r, new_gap))
        g = history(K) if grows else g_n
        mode = "TENSION" if grows else "ELASTIC"
        step = combine((1.0, new_gap), (-1.0, gap))
        slip = math.sqrt(dot(step, step)) if grows else 0.0
        rubbed = 0.0
    else:
        cap = -law.friction * b_n
        g, shear = g_n, combine((1.0, trial), (-dot(trial, normal), normal))

        def slid(g):
            """zeta_T, |dzeta_T| and its direction where the largest gap is g."""
            K = s(g) / g if g > 0 else 0.0
            force = combine((1.0, shear), (-K * h_s, old_t))
            size = math.sqrt(dot(force, force))
            x = 0.0 if g == 0 else max(size - cap * (1 - s(g)), 0.0) / (r + K * h_s)
            n = combine((1.0 / size if size else 0.0, force))
            return combine((1.0, old_t), (x, n)), x, n

        def length(g):
            end = slid(g)[0]
            return math.sqrt(dot(end, end)) / z_s

        grows = d < 1 and (length(g_n) > g_n if g_n > 0 else t > p_s)
        if grows:
            g = bisect(lambda g: g - length(g), max(g_n, 1e-18), (t + cap) / (r * z_s))
        new_gap, x, n = slid(g)
        traction = combine((1.0, b), (-r, new_gap))
        rubs_at_end = cap * (1 - s(g)) > 0.0 or d >= 1.0
        mode = "FRICTION" if x > 0.0 and rubs_at_end else "ELASTIC"
        mode = "SHEAR" if grows else mode
        mode = "CLOSING" if old_n > 1e-12 else mode
        slip = x if grows or rubs_at_end else 0.0

        def rubs(x):
            end = combine((1.0, old_t), (x, n))
            return 1 - s(max(g_n, math.sqrt(dot(end, end)) / z_s))

        rubbed = cap * trapezoids(rubs, x)
    work = 0.0
    if grows:
        ends = []
        for zeta in (new_gap, gap):
            zeta_t = combine((1.0, zeta), (-dot(zeta, normal), normal))
            ends.append((dot(zeta, normal) / z_n, math.sqrt(dot(zeta_t, zeta_t)) / z_s))
        ends = [end for end in ends if end != (0.0, 0.0)]
        work = sum(spent(g, *end) for end in ends) / len(ends)
    d = min(-math.expm1(-g) if hasattr(law, "fracture_energy") else g / most, 1.0)
    softening = max(softening, p_n * d) if grows else softening
    if softening >= p_n and b_n >= 0.0:
        mode = "OPEN"
    return Step(traction, new_gap, softening, slip, mode, work, rubbed, 0.0)


class State(NamedTuple):
    """Arguments of `return_map`."""

    trial: np.ndarray
    normal: np.ndarray
    gap: np.ndarray
    softening: np.ndarray
    penalty: np.ndarray


def random_state(rng, law, n, d, ratio):
    """n points that visit every branch, with r = ratio H.

    Loads reach three strengths, a third of the points each is intact, partly worn and debonded, and
    half of the gaps are open in the normal direction.
    """
    normal = rng.normal(size=(n, d))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    direction = rng.normal(size=(n, d))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    trial = direction * (law.strength * 3.0 * rng.random(n))[:, None]
    modulus = law.softening_modulus
    penalty = np.full(n, ratio * modulus)
    gap = rng.normal(size=(n, d)) * law.strength / (3.0 * modulus)
    opening = np.einsum("ij,ij->i", gap, normal)
    wanted = np.where(rng.random(n) < 0.5, 0.0, np.abs(opening))
    gap += (wanted - opening)[:, None] * normal
    softening = law.strength * rng.choice([0.0, 1.0, 2.0], n)
    worn = softening == 2.0 * law.strength
    softening[worn] = law.strength * rng.random(worn.sum())
    if returns_to_origin(law):
        # within the largest gap that the history tells of, in any direction
        damage = np.minimum(softening / law.strength, 0.999)
        smallest = min(softening_curve(law)[3:])
        length = 0.6 * smallest * damage * rng.random(n)
        length[softening == law.strength] *= 3.0
        gap *= (length / np.linalg.norm(gap, axis=1))[:, None]
    return State(trial, normal, gap, softening, penalty)
