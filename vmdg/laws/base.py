"""Base class of interface laws: attributes, result of a return map, and input checks.

Conventions (one for all laws): a point has the unit normal N of side 1, the inelastic gap zeta (mm,
positive along N when open) and the traction T (MPa), T_N = T.N > 0 in tension. A return map starts
from the trial traction T_tr = {P.N} + r (g - zeta_n), with r the penalty (MPa/mm), and returns
zeta_{n+1} with T = T_tr - r (zeta_{n+1} - zeta_n).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from enum import IntEnum
from functools import cached_property
from numbers import Real
from typing import TYPE_CHECKING, Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

if TYPE_CHECKING:
    from typing import Self  # of Python 3.11

Array = NDArray[np.float64]

#: A number, one number for every facet or point, or f(x) of the midpoints x (3, n) of facets.
#: Annotated as a number or anything for type checkers, because laws and users read resolved values
#: from it.
Parameter = float | Any


class Mode(IntEnum):
    """Branch of the return map that was active at a point."""

    ELASTIC = 0  #: zeta unchanged: bonded, unloading, or sticking
    TENSION = 1  #: damage with T_N >= 0, some bond left
    SHEAR = 2  #: damage in contact: the bond resists more than friction
    FRICTION = 3  #: slip in contact: friction resists more, or no bond is left
    OPEN = 4  #: T_N >= 0 and no bond left
    CLOSING = 5  #: the normal inelastic gap decreased (slip, if any, is in the multiplier)


@dataclass(frozen=True, slots=True)
class Update:
    """Result of a return map at n points in d dimensions.

    The three works are the dissipation of the step at the point, (32), per reference area: the
    resistance integrated along the gap path of the step, zeta_n to zeta_{n+1}, at the direction,
    pressure and overstress of its end. Their sum, plus the change of `Law.stored_energy`, is the
    integral of T . dzeta over that path. A law does not know the overstress at the start of the
    step; `vmdg.interface.gap_work` does, and accounts for its change within the step.

    Attributes:
        traction: T_{n+1} (n, d), MPa.
        gap: zeta_{n+1} (n, d), mm.
        softening: Q_{n+1} (n,), MPa; never decreases; the bond is broken at Q = law.strength.
        multiplier: dgamma (n,), mm: length of the gap increment due to yielding.
        tangent: d zeta_{n+1} / d T_tr (n, d, d), mm/MPa.
        mode: `Mode` (n,).
        damage_work: spent on the bond (n,), N/mm.
        friction_work: spent on friction in excess of the bond (n,), N/mm.
        viscous_work: spent on the overstress (n,), N/mm.
        overstress: V (n, d), MPa: the rate-dependent part of T; None if unknown.
        work_gradient: d damage_work/d T_tr (n, d), mm, zero where nothing yields; None if unknown,
            see the function `work_gradient`.
    """

    traction: Array
    gap: Array
    softening: Array
    multiplier: Array
    tangent: Array
    mode: NDArray[np.int8]
    damage_work: Array
    friction_work: Array
    viscous_work: Array
    overstress: Array | None = None
    work_gradient: Array | None = None

    @classmethod
    def elastic(cls, trial: Array, gap: Array, softening: Array) -> Update:
        """Step in which nothing yields: T = T_tr, zeta and Q as they were (copies).

        Args:
            trial: T_tr (n, d), MPa.
            gap: zeta_n (n, d), mm.
            softening: Q_n (n,), MPa.
        """
        n, d = trial.shape
        return cls(
            traction=trial.copy(),
            gap=gap.copy(),
            softening=softening.copy(),
            multiplier=np.zeros(n),
            tangent=np.zeros((n, d, d)),
            mode=np.full(n, Mode.ELASTIC, dtype=np.int8),
            damage_work=np.zeros(n),
            friction_work=np.zeros(n),
            viscous_work=np.zeros(n),
            overstress=np.zeros((n, d)),
            work_gradient=np.zeros((n, d)),
        )


class Law(ABC):
    """Interface law: traction as a function of the inelastic gap at a point.

    A new law is one class. With one softening curve for all directions derive from `RadialLaw`;
    with another yield surface from `ExtrinsicLaw`; otherwise from this class, whose interface is
    `return_map` (or `_advance`, for checked arguments) and the attributes below. Its `Update` need
    not have `work_gradient`, which is otherwise computed by differences.

    Strengths, energies, gaps and friction may vary along an interface. Callers resolve functions
    (`with_values`) and select points (`at`); such a parameter is then an array (n,), so methods
    must handle both numbers and arrays. Other parameters are one number.
    """

    inelastic: bool = True  #: False: a tie, without history or return map
    fatigues: bool = False  #: whether cycles degrade it; `return_map` then has `cycles` after dt
    strength: Parameter  #: traction at which damage starts in pure opening, MPa
    friction: Parameter = 0.0  #: Coulomb coefficient mu
    viscosity: float = 0.0  #: overstress of the intact bond per opening rate, MPa s/mm

    @property
    @abstractmethod
    def softening_modulus(self) -> float:
        """H, the steepest descent of traction against gap, MPa/mm; the penalty must exceed it.

        Viscosity does not relax this: it decreases with the bond, which finally softens by H.
        """

    def __str__(self) -> str:
        if not is_dataclass(self):
            return repr(self)
        values = ((field.name, getattr(self, field.name)) for field in fields(self) if field.repr)
        given = ", ".join(f"{name}={_in_short(value)}" for name, value in values)
        return f"{type(self).__name__}({given})"

    @property
    def symmetric(self) -> bool:
        """Whether the tangent is symmetric in every branch."""
        return is_number(self.friction, 0.0)

    @property
    def unloads_to_origin(self) -> bool:
        """Whether zeta and Q depend on T_tr + r zeta_n and Q_n only, apart from friction."""
        return False

    @property
    def has_bond(self) -> bool:
        """Whether there is a bond that can fail, unlike in a tie or in pure contact."""
        return self.inelastic and not is_number(self.strength, 0.0)

    @cached_property
    def varying(self) -> dict[str, Any]:
        """Parameters that vary along an interface, by name: functions, or arrays (n,)."""
        given = vars(self)
        return {
            name: given[name]
            for name in VARYING
            if given.get(name) is not None and not isinstance(given[name], Real)
        }

    @property
    def resolved(self) -> bool:
        """Whether no parameter is a function, which has values on an interface only."""
        return not any(callable(value) for value in self.varying.values())

    def with_values(self, values: Mapping[str, Array]) -> Self:
        """The law with arrays (n,) for parameters that vary.

        Args:
            values: Arrays by name of the parameter.

        Raises:
            ValueError: a value is out of range.
        """
        return cast(Any, replace)(self, **values) if values else self

    def weakened(self, largest: float) -> Self:
        """The law with a strength of at most this and the same fracture energy.

        All strengths are multiplied by s = min(largest/strength, 1) and all gaps divided by it, so
        that curves keep their shape. Such a bond softens over a longer process zone.

        Args:
            largest: Of `strength` [MPa], positive. Parameters must be numbers or arrays.
        """
        s = np.minimum(largest / self.strength, 1.0)
        given = vars(self)
        values = {name: given[name] * s for name in _STRENGTHS if name in given}
        values |= {name: given[name] / s for name in _GAPS if name in given}
        return cast(Any, replace)(self, **values)

    def at(self, rows: NDArray | slice) -> Self:
        """The law at some of its points; the law itself if no parameter varies.

        Args:
            rows: Indices of points, repeats allowed, or a mask.
        """
        if not self.varying:
            return self
        return _with(self, {name: array[rows] for name, array in _at_points(self).items()})

    # Tiny strengths and tails of exponentials underflow to zero, as intended.
    @np.errstate(under="ignore")
    def return_map(
        self,
        trial: ArrayLike,
        normal: ArrayLike,
        gap: ArrayLike,
        softening: ArrayLike,
        penalty: ArrayLike,
        dt: float | Array = 1.0,
    ) -> Update:
        """Advance n points by one backward-Euler step.

        Args:
            trial: T_tr (n, d), MPa, d = 2 or 3.
            normal: unit normal N (n, d).
            gap: zeta_n (n, d), mm.
            softening: Q_n (n,), MPa.
            penalty: r (n,) or one number, MPa/mm.
            dt: time step, s, one number or (n,); only used where viscosity > 0.

        Raises:
            ValueError: shapes do not match, dt <= 0 with viscosity > 0, or r <= H at a point.
        """
        points = self._checked(trial, normal, gap, softening, penalty)
        return self._advance(*points, self.damping(dt))

    def _advance(
        self,
        trial: Array,
        normal: Array,
        gap: Array,
        softening: Array,
        penalty: Array,
        eta: float | Array,
    ) -> Update:
        """`return_map` for checked arguments: matching shapes, admissible r, eta from `damping`."""
        raise NotImplementedError

    def damping(self, dt: float | Array) -> float | Array:
        """eta = viscosity/dt, MPa/mm: overstress of the intact bond per gap increment of the step.

        Args:
            dt: time step, s, one number or (n,).

        Raises:
            ValueError: dt <= 0 with viscosity > 0.
        """
        if self.viscosity == 0.0:
            return 0.0
        if not np.greater(dt, 0.0).all():
            raise ValueError(f"dt = {dt}: a law with viscosity requires a positive time step")
        return self.viscosity / dt

    def utilization(self, normal: Array, shear: Array) -> Array:
        """Traction on an intact point relative to its strength (n,).

        Args:
            normal: T.N (n,), MPa.
            shear: |T_T| (n,), MPa.
        """
        return np.sqrt(np.maximum(normal, 0.0) ** 2 + shear**2) / self.strength

    def admissible(self, penalty: ArrayLike) -> NDArray[np.bool_]:
        """Where r > H, so that the step has a unique solution.

        Args:
            penalty: r, MPa/mm.

        Returns:
            Marks shaped like `penalty`.
        """
        return np.asarray(penalty, dtype=float) > self.softening_modulus

    def stored_energy(self, gap: Array, normal: Array, softening: Array) -> Array:
        """Recoverable energy (n,), N/mm, in the gap; zero unless part of the gap is elastic.

        Args:
            gap: zeta (n, d), mm.
            normal: N (n, d).
            softening: Q (n,), MPa.
        """
        return np.zeros(len(softening))

    def rubbing(self, softening: Array) -> Array:
        """Fraction of a point subject to friction (n,): its friction is mu |T_N| times this.

        Args:
            softening: Q (n,), MPa.
        """
        return np.ones(len(softening))

    def _checked(self, *arrays: ArrayLike) -> tuple[Array, Array, Array, Array, Array]:
        """The inputs of `return_map` as float arrays of matching shapes, r admissible."""
        names, made = ("trial", "normal", "gap", "softening", "penalty"), []
        for name, array in zip(names, arrays, strict=True):
            try:
                made.append(np.asarray(array, dtype=float))
            except (TypeError, ValueError):
                raise TypeError(f"return_map: {name} must be an array of numbers") from None
        trial, normal, gap, softening, penalty = made
        if trial.ndim != 2 or trial.shape[1] not in (2, 3):
            raise ValueError(f"trial has shape {trial.shape}: it must be (n, 2) or (n, 3)")
        for name, array, shape in (
            ("normal", normal, trial.shape),
            ("gap", gap, trial.shape),
            ("softening", softening, trial.shape[:1]),
        ):
            if array.shape != shape:
                raise ValueError(f"{name} has shape {array.shape}: trial requires {shape}")
        if penalty.shape not in ((), softening.shape):
            raise ValueError(
                f"penalty has shape {penalty.shape}: it must be () or {softening.shape}"
            )
        for name, value in self.varying.items():
            if callable(value) or value.shape != softening.shape:
                raise ValueError(
                    f"{name} varies: at {len(softening)} points it must be one number or "
                    f"{len(softening)}, law.with_values({{{name!r}: array}}) sets them"
                )
        penalty = np.broadcast_to(penalty, softening.shape)
        admissible = self.admissible(penalty)
        if not admissible.all():
            worst = int(np.argmin(admissible))
            H = np.broadcast_to(self.softening_modulus, softening.shape)[worst]
            raise ValueError(
                f"penalty r = {penalty[worst]:.6g} MPa/mm at point {worst} does not exceed the "
                f"softening modulus H = {H:.6g} MPa/mm: the step would not "
                "have one solution only. Use smaller elements at the interface (r grows as 1/h), "
                "or a tougher or weaker bond (smaller H)"
            )
        return trial, normal, gap, softening, penalty


SomeLaw = TypeVar("SomeLaw", bound=Law)

#: Step of finite differences in the trial traction, relative to the strength.
TRACTION_STEP = 1e-6


def work_gradient(law: Law, update: Update, trial: Array, *known: Array | float) -> Array:
    """d damage_work/d T_tr (n, d), mm: from the return map, or by central differences.

    By differences where a law returns None, and where it damages an unbroken bond but returns zero,
    as a law may that starts from `Update.elastic`.

    Args:
        known: Further arguments of the return map in order: normal, gap, softening, penalty etc.,
            arrays with one row per point or one number.
    """
    given = update.work_gradient
    gradient, unknown = np.zeros_like(trial), update.damage_work > 0.0
    if given is not None:
        unknown &= ~given.any(axis=1) & (update.softening < law.strength)
        gradient[:] = given
    rows = np.flatnonzero(unknown)
    if not rows.size:
        return gradient
    part, step = law.at(rows), np.broadcast_to(TRACTION_STEP * law.strength, len(trial))[rows]
    known = tuple(
        array[rows] if isinstance(array, np.ndarray) and array.ndim else array for array in known
    )
    for i in range(trial.shape[1]):
        works = []
        for end in (step, -step):
            load = trial[rows]
            load[:, i] += end
            works.append(part.return_map(load, *known).damage_work)
        gradient[rows, i] = (works[0] - works[1]) / (2.0 * step)
    return gradient


#: Gap at which any bond is broken, relative to strength/H.
_FAR = 1e6


def separation(law: Law, d: int, axis: int) -> tuple[Array, Array]:
    """Strength, MPa, and energy G_c, N/mm, of bonds in opening or shear, each (n,) or (1,).

    By one return map to a gap at which every softening law has lost its bond: for all laws, the
    damage work of a step is the integral of the resistance along its gap.

    Args:
        law: A law with a bond; parameters that vary are arrays (n,).
    """
    one = np.ones(max((len(value) for value in law.varying.values()), default=1))
    direction = np.zeros((len(one), d))
    direction[:, axis] = 1.0
    use = law.utilization(*((one, 0.0 * one) if axis == 0 else (0.0 * one, one)))
    strength, H = 1.0 / use, law.softening_modulus * one
    r = 4.0 * H
    load = (strength + r * _FAR * strength / H)[:, None] * direction
    normal = np.zeros_like(direction)
    normal[:, 0] = 1.0
    update = law.return_map(load, normal, np.zeros_like(normal), np.zeros(len(one)), r)
    return strength, update.damage_work


#: Parameters that change at constant fracture energy: strengths, and gaps inversely.
_STRENGTHS, _GAPS = (
    ("strength", "normal_strength", "shear_strength"),
    ("critical_gap", "plateau_gap"),
)

#: Parameters of laws that must be positive, with their meaning or an alternative.
_POSITIVE = {
    **dict.fromkeys(
        _STRENGTHS,
        "for an interface that never opens use Bonded()",
    ),
    **dict.fromkeys(
        ("fracture_energy", "normal_energy", "shear_energy"),
        "it is the energy in N/mm to separate a unit area",
    ),
    "critical_gap": "it is the gap in mm at which the bond is broken",
    "shear_weight": "use 1 for equal weights",
    "slip_distance": "it is the slip in mm after which friction is dynamic_friction",
}

#: Parameters that may vary along an interface.
VARYING = (*_POSITIVE, "friction", "dynamic_friction", "plateau_gap")

#: Parameters that may be None.
OPTIONAL = ("dynamic_friction", "slip_distance")

#: Unloading behaviours of a rigid bond.
UNLOADINGS = ("plastic", "secant")

#: Parameters that may be zero.
_NOT_NEGATIVE = {
    "friction": "use 0 for no friction",
    "dynamic_friction": "use 0 for no friction after slip_distance",
    "viscosity": "use 0 for no rate dependence",
    "plateau_gap": "use 0 for no plateau",
}


def check_parameters(law: Law) -> None:
    """Check the parameters of a law for type and range.

    Integers become floats, arrays are copied and made read-only, functions are accepted as they
    are.
    """
    for name in parameter_names(law):
        value = getattr(law, name)
        # What is not given may be None.
        if name in _POSITIVE | _NOT_NEGATIVE and (value is not None or name not in OPTIONAL):
            _check_parameter(law, name, value)
    unloading = getattr(law, "unloading", "plastic")
    if unloading not in UNLOADINGS:
        raise ValueError(f"unloading = {unloading!r}: must be one of {UNLOADINGS}")
    gradual = getattr(law, "gradual_friction", None)
    if gradual not in (None, True, False):
        raise ValueError(f"gradual_friction = {gradual!r}: must be True, False or None")
    if unloading == "secant" and gradual is False:
        raise ValueError(
            'gradual_friction = False: with unloading="secant" the bond is a spring and friction '
            "acts in parallel, on the broken fraction; leave it None"
        )
    if unloading == "secant" and law.viscosity > 0.0:
        raise ValueError(
            f'viscosity = {law.viscosity}: a law with unloading="secant" does not depend on the '
            'rate; use viscosity=0, or unloading="plastic"'
        )


def _check_parameter(law: Law, name: str, value: Any) -> None:
    if not isinstance(value, Real):
        if name not in VARYING:
            raise TypeError(
                f"{name} = {value!r}: must be one number; if it varies along an interface give "
                "each part its own law by Interface(facets=...)"
            )
        if callable(value):
            return
        try:
            value = np.array(value)
        except ValueError:
            value = np.zeros(())
        if value.ndim != 1 or value.dtype.kind not in "biuf":
            raise TypeError(
                f"{name} = {getattr(law, name)!r}: must be one number, an array with a number for "
                "every facet of Interface(facets=...), or f(x) of midpoints x (3, n) of facets"
            )
        value = value.astype(float)
        value.flags.writeable = False
    else:
        value = float(value)
    object.__setattr__(law, name, value)
    values, positive = np.atleast_1d(value), name in _POSITIVE
    bad = ~(np.isfinite(values) & ((values > 0.0) if positive else (values >= 0.0)))
    if bad.any():
        wanted = "positive" if positive else "zero or positive"
        remedy = (_POSITIVE if positive else _NOT_NEGATIVE)[name]
        raise ValueError(f"{name} = {values[bad][0]}: must be {wanted} and finite; {remedy}")


def is_number(value: Any, number: float) -> bool:
    return isinstance(value, Real) and value == number


def parameter_names(law: Law) -> list[str]:
    return [field.name for field in fields(cast(Any, law))]


def _in_short(value: Any) -> str:
    """A parameter for messages."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"<{len(value)} values>"
    return "<function>" if callable(value) and not is_dataclass(value) else repr(value)


def same_law(a: Law, b: Law) -> bool:
    """Whether two laws are equal, functions and arrays among their parameters too."""
    if a is b or type(a) is not type(b):
        return a is b
    if not (a.varying or b.varying):
        return a == b
    pairs = ((getattr(a, name), getattr(b, name)) for name in parameter_names(a))
    return all(x is y or (not callable(x) and np.array_equal(x, y)) for x, y in pairs)


def joined_laws(laws: Sequence[Law]) -> Law:
    """Equal laws at the points of several interfaces, as one law at all of them."""
    if len(laws) == 1 or not laws[0].varying:
        return laws[0]
    found = [_at_points(law) for law in laws]
    shared = [name for name in found[0] if all(name in arrays for arrays in found)]
    return _with(laws[0], {n: np.concatenate([arrays[n] for arrays in found]) for n in shared})


def _at_points(law: Law) -> dict[str, Array]:
    """Parameters that vary, and values cached from them, by name (n,)."""
    counts = [value.shape for value in law.varying.values()]
    arrays = {k: v for k, v in vars(law).items() if isinstance(v, np.ndarray)}
    return {name: array for name, array in arrays.items() if array.shape in counts}


def _with(law: SomeLaw, arrays: Mapping[str, Array]) -> SomeLaw:
    """A law with other arrays, known to be in range; other cached values are recomputed."""
    result = copy(law)
    parameters = parameter_names(law)
    vars(result).clear()
    vars(result).update({k: v for k, v in vars(law).items() if k in parameters} | dict(arrays))
    return result


def dot(a: Array, b: Array) -> Array:
    """Row-wise a . b, (n, d) and (n, d) to (n,)."""
    return np.einsum("ij,ij->i", a, b)


def outer(a: Array, b: Array) -> Array:
    """Row-wise a (x) b, (n, d) and (n, d) to (n, d, d)."""
    return a[:, :, None] * b[:, None, :]


def add_to_diagonal(tensor: Array, value: Array) -> None:
    """Add value (n,) times the identity to tensor (n, d, d), in place."""
    np.einsum("ijj->ij", tensor)[...] += value[:, None]


def unit(vector: Array, length: Array) -> Array:
    """vector/length per row, zero where the length is zero."""
    return vector / np.where(length > 0.0, length, 1.0)[:, None]
