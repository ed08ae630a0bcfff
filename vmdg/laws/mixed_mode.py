"""Different strengths and energies in opening and shear, with a mixed-mode criterion."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .base import (
    Array,
    Mode,
    Parameter,
    Update,
    add_to_diagonal,
    check_parameters,
    dot,
    is_number,
    outer,
    unit,
)
from .criteria import Criterion, Linear, criterion_of
from .debonding import Debonding
from .extrinsic import ExtrinsicLaw, Points
from .roots import increasing_root

#: Angles at which the slope of a criterion is sampled.
_ANGLES = 20001

#: Relative difference at which ratios of slopes and energies are distinct.
_DIGITS = 12


class Flow(NamedTuple):
    """Return to the yield surface at points where some bond is left, see `MixedModeDebonding`."""

    g: Array  #: d_{n+1} - d_n
    cos: Array  #: of th
    sin: Array
    A: Array
    B: Array
    A_by: tuple[Array, Array]  #: derivatives of A by g and by th
    B_by: tuple[Array, Array]
    m: Array  #: m(th)
    m_by_angle: Array


@dataclass(frozen=True)
class MixedModeDebonding(ExtrinsicLaw):
    """Elliptic strength criterion with linear softening, contact, friction and rate dependence.

    Yield (T_N >= 0): sqrt((T_N/P_n)^2 + (|T_T|/P_s)^2) <= rho = 1 - d. With (cos th, sin th) =
    (T_N/P_n, |T_T|/P_s)/rho and critical gaps zeta_n = 2 G_n/P_n, zeta_s = 2 G_s/P_s the flow is

        dzeta = dd m(th) (zeta_n cos th N + zeta_s sin th t),  t = T_T/|T_T|,
        m(th) = G_c(phi)/(G_n cos^2 th + G_s sin^2 th),

    with phi = G_s sin^2 th/(G_n cos^2 th + G_s sin^2 th) the shear fraction of the energy. Pure
    opening dissipates G_n, pure shear G_s, and a fixed ratio of tractions G_c(phi) of the
    `criterion`:

    * "linear": G_I/G_n + G_II/G_s = 1, m = 1;
    * "power": (G_I/G_n)^exponent + (G_II/G_s)^exponent = 1;
    * "BK": G_c = G_n + (G_s - G_n) phi^exponent, Benzeggagh and Kenane (1996, Compos. Sci. Technol.
      56); in cohesive laws Camanho and Davila (2002, NASA/TM-2002-211737), Turon, Camanho, Costa
      and Davila (2006, Mech. Mater. 38).

    On any path, whatever the history of the mixity, a point dissipates 2 rho G_c(phi) dd, which is
    not negative; with the linear criterion G_I/G_n + G_II/G_s = 1 at separation. The flow is normal
    to the yield surface, and the tangent symmetric, exactly when m = 1 and G_n = G_s; equal
    strengths and energies give `Debonding`.

    Viscosity acts parallel to the bond, T = T_bond + V, V = c dzeta with c = eta rho_n, eta =
    viscosity/dt and rho_n of the start of the step, so that q = r + c replaces r. With g = d_{n+1}
    - d_n, a = T_tr.N/P_n, b = |T_tr,T|/P_s, H_n = P_n/zeta_n, H_s = P_s/zeta_s,

        A = rho + q g m/H_n,  B = rho + q g m/H_s,
        A cos th = a,  B sin th = b

    are two equations for g and th. With m = 1 they reduce to (a/A)^2 + (b/B)^2 = 1. The map from
    (g, th) to (a, b) has the determinant A_g B cos^2 + A B_g sin^2 + q g m' (1/H_n - 1/H_s) sin
    cos, A_g = q m/H_n - 1, B_g = q m/H_s - 1. It is positive for all g, and the root is unique, if
    for all th both

        r m > max(H_n, H_s)  and  r m > H_n cos^2 + H_s sin^2 + (m'/m) (H_n - H_s) sin cos;

    the least such r is H, `softening_modulus`. Where the bond breaks within the step, dzeta =
    T_tr/q and T = V. The history is Q = P_n d (MPa). In contact the law is `Debonding` with P_s,
    zeta_s.

    Attributes:
        normal_strength, shear_strength: P_n and P_s, MPa.
        normal_energy, shear_energy: G_n and G_s, N/mm.
        friction: Coulomb coefficient mu.
        viscosity: MPa s/mm.
        criterion: "linear", "power" or "BK".
        exponent: exponent of the last two, at least 1.
        unloading, gradual_friction: as in `Debonding`.

    Raises:
        ValueError: a parameter is out of range.
    """

    normal_strength: Parameter
    shear_strength: Parameter
    normal_energy: Parameter
    shear_energy: Parameter
    friction: Parameter = 0.0
    viscosity: float = 0.0
    criterion: str = field(default="linear", kw_only=True)
    exponent: float | None = field(default=None, kw_only=True)
    unloading: str = field(default="plastic", kw_only=True)
    gradual_friction: bool | None = field(default=None, kw_only=True)

    def __post_init__(self) -> None:
        check_parameters(self)
        # raises for an invalid criterion
        criterion_of(self.criterion, self.exponent, 1.0)

    @cached_property
    def interaction(self) -> Criterion:
        return criterion_of(self.criterion, self.exponent, self.shear_energy / self.normal_energy)

    @property
    def strength(self) -> Parameter:  # type: ignore[override] # a field of other laws
        """P_n, MPa."""
        return self.normal_strength

    @cached_property
    def in_opening(self) -> Debonding:
        return Debonding(self.normal_strength, 2.0 * self.normal_energy / self.normal_strength)

    @cached_property
    def in_shear(self) -> Debonding:
        return Debonding(self.shear_strength, 2.0 * self.shear_energy / self.shear_strength)

    @cached_property
    def softening_modulus(self) -> Parameter:
        """H of the class docstring, MPa/mm; max(H_n, H_s) where m = 1."""
        h_n, h_s = self.in_opening.softening_modulus, self.in_shear.softening_modulus
        if isinstance(self.interaction, Linear):
            return np.maximum(h_n, h_s) if self.varying else max(h_n, h_s)
        ratio = self.shear_energy / self.normal_energy
        if not self.varying:
            return h_n * _steepest(h_s / h_n, self.interaction)
        # strengths that vary together have one ratio of slopes and of energies
        pairs = np.stack(np.broadcast_arrays(h_s / h_n, ratio), axis=1).round(_DIGITS)
        kinds, kind = np.unique(pairs, axis=0, return_inverse=True)
        steepest = [_steepest(h, criterion_of(self.criterion, self.exponent, k)) for h, k in kinds]
        return h_n * np.array(steepest)[kind.ravel()]

    @property
    def symmetric(self) -> bool:
        """No friction, and flow normal to the yield surface."""
        if self.varying or self.normal_energy != self.shear_energy:
            return False
        return is_number(self.friction, 0.0) and self.criterion != "power"

    def energy_at(self, mixity: ArrayLike) -> Array:
        """Energy G_c to separation, N/mm.

        Args:
            mixity: th = atan((|T_T|/P_s)/(T_N/P_n)), held fixed, radians.
        """
        mixity = np.asarray(mixity, dtype=float)
        return self._energy(np.cos(mixity), np.sin(mixity))[0]

    def _energy(self, cos: Array, sin: Array) -> tuple[Array, Array]:
        """G_c of th (n,) and dG_c/dth, N/mm."""
        m, m_by_angle = self.flow_factor(cos, sin)
        linear = self.normal_energy * cos * cos + self.shear_energy * sin * sin
        by_angle = 2.0 * (self.shear_energy - self.normal_energy) * sin * cos
        return m * linear, m_by_angle * linear + m * by_angle

    def equivalent(self, normal: Array, shear: Array) -> Array:
        """T_eq = sqrt(T_N^2 + (P_n/P_s)^2 |T_T|^2)."""
        weighted = (self.normal_strength / self.shear_strength) * shear
        return np.sqrt(normal * normal + weighted * weighted)

    def flow_factor(self, cos: Array, sin: Array) -> tuple[Array, Array]:
        """m(th) and dm/dth of the criterion."""
        return self.interaction.flow_factor(cos, sin)

    def with_factor(self, g: Array, m: Array) -> Array:
        """(1 - g')/(g' m) = (1 - g)/g."""
        return g / (g + (1.0 - g) * m)

    def first_step(self, normal: Array, shear: Array, penalty: Array) -> Array:
        """g of `_flow` for d_n = 0, at the K of m = 1; 1 where the bond breaks."""
        cos, sin, length = self._ray(normal, shear, penalty)
        m, _ = self.flow_factor(cos, sin)
        result, holds = np.ones_like(normal), np.flatnonzero(length < m)
        part = self.at(holds)
        a, b = normal[holds] / part.normal_strength, shear[holds] / part.shear_strength
        flow = part._flow(a, b, np.ones_like(a), penalty[holds])
        result[holds] = part.with_factor(flow.g, 1.0 / flow.m)
        return result

    def _open(self, update: Update, at: Points) -> None:
        """The return of the class docstring, for T_tr.N >= 0."""
        rho_n = at.left / self.strength
        # dzeta = T_tr/q if the bond breaks within the step; d grows by its length in units of the
        # critical gaps, over m.
        cos, sin, length = self._ray(at.trial_n, at.shear, at.penalty + at.damping)
        m, _ = self.flow_factor(cos, sin)
        # Unbroken points have rho_n > 0, so A and B are not zero, even where a trial state has no
        # traction (NaN in an inverted cell).
        holds = length < rho_n * m
        gone, left = (Points._make(array[mask] for array in at) for mask in (~holds, holds))
        if gone.rows.size:
            self.at(~holds)._separate(update, gone)
        if left.rows.size:
            self.at(holds)._soften(update, left)

    def _ray(self, normal: Array, shear: Array, stiffness: Array) -> tuple[Array, Array, Array]:
        """(cos th, sin th) of dzeta = T_tr/q and its length, in units of the critical gaps."""
        opening = normal / (stiffness * self.in_opening.critical_gap)
        sliding = shear / (stiffness * self.in_shear.critical_gap)
        length = np.sqrt(opening * opening + sliding * sliding)
        some = np.where(length > 0.0, length, 1.0)
        return np.where(length > 0.0, opening / some, 1.0), sliding / some, length

    def _separate(self, update: Update, at: Points) -> None:
        """No bond at the end of the step: dzeta = T_tr/q, T = V."""
        stiffness = at.penalty + at.damping
        compliance = 1.0 / stiffness
        step = compliance[:, None] * at.trial
        # The mixity is that at failure on the ray of T_tr.
        cos, sin, length = self._ray(at.trial_n, at.shear, stiffness)
        energy, by_angle = self._energy(cos, sin)

        rows = at.rows
        assert update.overstress is not None and update.work_gradient is not None
        update.overstress[rows] = update.traction[rows] = at.damping[:, None] * step
        update.gap[rows] = at.gap + step
        update.softening[rows] = self.strength
        update.multiplier[rows] = np.sqrt(dot(step, step))
        update.tangent[rows] = compliance[:, None, None] * np.eye(step.shape[1])
        update.mode[rows] = Mode.OPEN
        rho_n = at.left / self.strength
        update.damage_work[rows] = rho_n * rho_n * energy
        turn = rho_n * rho_n * by_angle / (stiffness * np.where(length > 0.0, length, 1.0))
        update.work_gradient[rows] = _along(
            (-turn * sin / self.in_opening.critical_gap, turn * cos / self.in_shear.critical_gap),
            at,
        )
        update.viscous_work[rows] = at.damping * dot(step, step)

    def _soften(self, update: Update, at: Points) -> None:
        """Some bond left at the end of the step."""
        h_n, h_s = self.in_opening.softening_modulus, self.in_shear.softening_modulus
        rho_n = at.left / self.strength
        a, b = at.trial_n / self.normal_strength, at.shear / self.shear_strength
        flow = self._flow(a, b, rho_n, at.penalty + at.damping)
        g, cos, sin, A, B, m = flow.g, flow.cos, flow.sin, flow.A, flow.B, flow.m
        rho = np.maximum(rho_n - g, 0.0)

        # dzeta = (k_n N (x) N + k_t (I - N (x) N)) T_tr
        k_n, k_t = g * m / (h_n * A), g * m / (h_s * B)
        trial_normal = at.trial_n[:, None] * at.normal
        trial_shear = at.trial - trial_normal
        step = k_n[:, None] * trial_normal + k_t[:, None] * trial_shear
        length2 = dot(step, step)

        rows = at.rows
        borne = (rho / A)[:, None] * trial_normal + (rho / B)[:, None] * trial_shear
        assert update.overstress is not None and update.work_gradient is not None
        update.overstress[rows] = at.damping[:, None] * step
        update.traction[rows] = borne + update.overstress[rows]
        update.gap[rows] = at.gap + step
        update.softening[rows] = self._softened(at, rho, self.strength * g)
        update.multiplier[rows] = np.sqrt(length2)
        g_by, th_by = _inverse(flow)
        t = unit(trial_shear, at.shear)
        update.tangent[rows] = self._flow_tangent(flow, g_by, th_by, at.normal, t, k_t)
        update.mode[rows] = np.where(
            update.softening[rows] < self.strength, Mode.TENSION, Mode.OPEN
        )
        spent, (energy, by_angle) = (rho_n - rho) * (rho_n + rho), self._energy(cos, sin)
        update.damage_work[rows] = spent * energy
        by_n, by_s = (2.0 * rho * energy * g_by[i] + spent * by_angle * th_by[i] for i in (0, 1))
        update.work_gradient[rows] = _along(
            (by_n / self.normal_strength, by_s / self.shear_strength), at
        )
        update.viscous_work[rows] = at.damping * length2

    def _flow_tangent(
        self,
        flow: Flow,
        g_by: tuple[Array, Array],
        th_by: tuple[Array, Array],
        normal: Array,
        direction: Array,
        k_t: Array,
    ) -> Array:
        """d zeta/d T_tr (m, d, d), with k_t = |dzeta_T|/|T_tr,T| (m,), mm/MPa."""
        g, cos, sin, m = flow.g, flow.cos, flow.sin, flow.m
        opening = m * cos, g * (flow.m_by_angle * cos - m * sin)
        sliding = m * sin, g * (flow.m_by_angle * sin + m * cos)
        tangent = np.zeros((*normal.shape, normal.shape[1]))
        for gap, left, (by_g, by_th) in (
            (self.in_opening.critical_gap, normal, opening),
            (self.in_shear.critical_gap, direction, sliding),
        ):
            for i, right, strength in (
                (0, normal, self.normal_strength),
                (1, direction, self.shear_strength),
            ):
                entry = gap / strength * (by_g * g_by[i] + by_th * th_by[i])
                tangent += outer(entry[:, None] * left, right)
        # across N and t
        tangent -= outer(k_t[:, None] * normal, normal)
        tangent -= outer(k_t[:, None] * direction, direction)
        add_to_diagonal(tangent, k_t)
        return tangent

    def _flow(self, a: Array, b: Array, rho_n: Array, stiffness: Array) -> Flow:
        """g and th of the class docstring, where some bond is left.

        Args:
            a, b: T_tr.N/P_n and |T_tr,T|/P_s (m,).
            rho_n: 1 - d_n (m,).
            stiffness: q (m,), MPa/mm.
        """
        h_n, h_s = self.in_opening.softening_modulus, self.in_shear.softening_modulus

        def sizes(g: Array, m: Array) -> tuple[Array, ...]:
            """A and B, and their slopes by g."""
            A_g, B_g = stiffness * m / h_n - 1.0, stiffness * m / h_s - 1.0
            return rho_n + A_g * g, rho_n + B_g * g, A_g, B_g

        def growth(m: Array, a: Array, b: Array, start: Array) -> Array:

            def yield_function(g: Array) -> tuple[Array, Array]:
                # 1/|(a/A, b/B)| - 1 is nearly linear in g, unlike the equation above
                A, B, slope_a, slope_b = sizes(g, m)
                cos, sin = a / A, b / B
                inverse = 1.0 / np.sqrt(cos * cos + sin * sin)
                bend = cos * cos * slope_a / A + sin * sin * slope_b / B
                return inverse - 1.0, inverse**3 * bend

            return increasing_root(yield_function, np.zeros_like(rho_n), rho_n, start=start)

        def angle() -> Array:
            """Root th of th = atan((b/B)/(a/A)), with g of `growth` at the m of th.

            At an angle that is not the root the bond may be broken, g >= rho_n; then A and B are q
            g m/H_n and q g m/H_s, and the right-hand side is independent of th.
            """
            parted, parting = np.arctan2(b * h_s, a * h_n), np.hypot(b * h_s, a * h_n) / stiffness
            g = np.zeros_like(rho_n)

            def turn(th: Array) -> tuple[Array, Array]:
                nonlocal g
                m, m_by_angle = self.flow_factor(np.cos(th), np.sin(th))
                beyond = np.maximum(parting / (m * rho_n), 1.0)
                g = growth(m, a / beyond, b / beyond, g)
                A, B, A_g, B_g = sizes(g, m)
                x, y = a / A, b / B
                # relative changes of A and B with g and th, then with th along the root g
                by_g = A_g / A, B_g / B
                by_th = stiffness * g * m_by_angle / np.stack([h_n * A, h_s * B])
                turned = (x * x * by_th[0] + y * y * by_th[1]) / (x * x * by_g[0] + y * y * by_g[1])
                change = by_th[0] - by_th[1] - turned * (by_g[0] - by_g[1])
                gone = beyond > 1.0
                value = th - np.where(gone, parted, np.arctan2(y, x))
                return value, np.where(gone, 1.0, 1.0 - x * y * change)

            right = np.full_like(rho_n, 0.5 * np.pi)
            return increasing_root(turn, np.zeros_like(rho_n), right, start=np.arctan2(b, a))

        m, m_by_angle, start = np.ones_like(rho_n), np.zeros_like(rho_n), np.zeros_like(rho_n)
        if not isinstance(self.interaction, Linear):
            th = angle()
            m, m_by_angle = self.flow_factor(np.cos(th), np.sin(th))
        g = growth(m, a, b, start)
        A, B, A_g, B_g = sizes(g, m)
        by_th = stiffness * g * m_by_angle
        return Flow(g, a / A, b / B, A, B, (A_g, by_th / h_n), (B_g, by_th / h_s), m, m_by_angle)


def _inverse(flow: Flow) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
    """Derivatives of g and th by a and b, the inverse of d(a, b)/d(g, th)."""
    cos, sin = flow.cos, flow.sin
    (A_g, A_th), (B_g, B_th) = flow.A_by, flow.B_by
    a_th, b_th = A_th * cos - flow.A * sin, B_th * sin + flow.B * cos
    determinant = A_g * cos * b_th - a_th * B_g * sin
    g_by = b_th / determinant, -a_th / determinant
    return g_by, (-B_g * sin / determinant, A_g * cos / determinant)


def _along(parts: tuple[Array, Array], at: Points) -> Array:
    """Vector (m, d) with these parts along N and along T_tr,T."""
    t = unit(at.trial - at.trial_n[:, None] * at.normal, at.shear)
    return parts[0][:, None] * at.normal + parts[1][:, None] * t


def _steepest(slopes: float, criterion: Criterion) -> float:
    """H/H_n of the class docstring."""
    angle = np.linspace(0.0, 0.5 * np.pi, _ANGLES)
    cos, sin = np.cos(angle), np.sin(angle)
    m, m_by_angle = criterion.flow_factor(cos, sin)
    mixed = cos * cos + slopes * sin * sin + m_by_angle / m * (1.0 - slopes) * sin * cos
    return float(np.max(np.maximum(max(1.0, slopes), mixed) / m))
