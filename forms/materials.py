"""Strain energies of the report, section 7, as UFL expressions."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping
from numbers import Real
from typing import Any, cast

import numpy as np
import ufl
from ufl.core.expr import Expr

from .geometry import with_entry
from .invariants import Invariants


class Parameters(Mapping[str, Any]):
    """Immutable values by name: a problem has copied them.

    Args:
        values: By name.
    """

    def __init__(self, values: Mapping[str, float]):
        self._values = dict(values)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __setitem__(self, name: str, value: float) -> None:
        raise TypeError(
            f"the parameter {name!r} of a material cannot be changed, an existing problem would "
            "not notice; create a new material and a new Problem"
        )

    def __repr__(self) -> str:
        return repr(self._values)


def _short(value: Any) -> str:
    if isinstance(value, str):
        return value
    return f"{value:.6g}" if isinstance(value, Real) else type(value).__name__


class FromOthers:
    """A parameter computed cell by cell from others that vary.

    Args:
        function: Function of numbers or arrays (n,), in the order of ``given``; may raise
            ValueError.
        given: The user's values by name.
    """

    def __init__(self, function: Callable[..., Any], given: Mapping[str, Any]):
        self.function, self.given = function, dict(given)


def varies(value: Any) -> bool:
    """Whether a parameter varies from cell to cell.

    Args:
        value: f(x), a Function, an array, or a constant.
    """
    return not isinstance(value, Real) and (callable(value) or np.ndim(value) == 1)


def one_number(what: str, value: Any) -> float:
    """A parameter as a number.

    Args:
        what: Its name, for the message.
        value: What the user gave.

    Raises:
        TypeError: it is an array, a function or an expression.
    """
    if not isinstance(value, Real):
        raise TypeError(
            f"{what} = {value!r} must be one number; for moduli that vary in space give parts of "
            "the body separate tags and materials, for example by vmdg.split_cells"
        )
    return float(value)


def least(energy: Callable[[Expr], Expr]) -> tuple[Expr, Expr]:
    """Minimum W(0) - W'^2/(2 W'') of a quadratic energy W(x), and its x = -W'/W''.

    Args:
        energy: W.
    """
    x = ufl.variable(ufl.as_ufl(0.0))
    at_zero = energy(x)
    slope = ufl.diff(at_zero, x)
    curvature = ufl.diff(slope, x)
    return at_zero - slope**2 / (2 * curvature), -slope / curvature


class Material:
    """A hyperelastic material: named parameters and a strain energy W(F).

    A new material is a subclass with :meth:`energy`. Parameters become cell-wise constant
    coefficients, so that all materials of one :attr:`kernel_key` share one compiled kernel.

    Attributes:
        parameters: Values by name, in the user's consistent units (N, mm, MPa); set once.
        free_at_rest: Whether the stress at F = I is known to vanish; otherwise a problem checks it.
        mirrored: Whether xy is a plane of symmetry, so that in-plane strains cause no shear stress
            out of the plane, as plane stress requires.
    """

    parameters: Mapping[str, Any]
    free_at_rest = False
    mirrored = True

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "parameters":
            if name in self.__dict__:
                raise AttributeError(
                    f"{type(self).__name__}: parameters are set once, an existing problem would "
                    "not notice a change; create a new material and a new Problem"
                )
            value = Parameters(value)
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        # A subclass may lack them, which is then told; those at points have more.
        given = getattr(self, "numbers", None) or getattr(self, "parameters", {})
        values = ", ".join(f"{name}={_short(value)}" for name, value in given.items())
        return f"<{type(self).__name__}: {values}>"

    @property
    def kernel_key(self) -> Hashable:
        """Materials of equal key have the same energy up to the values of the parameters."""
        return cast(Hashable, type(self))

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """W per reference volume [MPa].

        Args:
            F: Deformation gradient, 3 x 3; F_33 = 1 in plane strain.
            parameters: Values by name, cell-wise constants.
        """
        raise NotImplementedError

    def invariant_energy(
        self,
        F: Expr,
        out_of_plane: Expr | None,
        parameters: Mapping[str, Expr],
        dilatation: Expr | None = None,
    ) -> Invariants | None:
        """The same W as a function of a few invariants; None to use :meth:`energy`.

        Worth defining for energies whose kernels would otherwise be large and slow.

        Args:
            F: Deformation gradient, 3 x 3, or 2 x 2 in plane strain.
            out_of_plane: F_33 in plane strain, else None.
            parameters: Values by name.
            dilatation: theta of :mod:`forms.dilatation`, which replaces det F in F_bar; given with
                mean dilatation only.
        """
        return None

    def free_stretch(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """F_33 at which P_33 = dW/dF_33 vanishes, for plane stress at finite strain.

        Args:
            F: In-plane deformation gradient, 2 x 2.
            parameters: Values by name, cell-wise constants.
        """
        raise NotImplementedError(
            f"{type(self).__name__} has no closed form of the thickness stretch: for plane stress "
            "use kinematics='small', NeoHookean or Orthotropic, or define free_stretch(F, "
            "parameters)"
        )

    def plane_stress_energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """W at :meth:`free_stretch`, the minimum over F_33 [MPa].

        Args:
            F, parameters: As of :meth:`free_stretch`.
        """
        return self.energy(with_entry(F, self.free_stretch(F, parameters)), parameters)

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """Quadratic energy at small strain [MPa].

        Args:
            strain: Symmetric, 3 x 3.
            parameters: Values by name, cell-wise constants.
        """
        raise NotImplementedError(
            f"{type(self).__name__} has no small-strain energy: use kinematics='finite', "
            "or define linear_energy(strain, parameters)"
        )


class NeoHookean(Material):
    """Compressible neo-Hookean material, eq. (86), lambda = nu E / ((1 + nu)(1 - 2 nu)).

    W = mu/2 (tr(F^T F) - 3) - mu ln J + lambda/2 (J - 1)^2.

    Args:
        E: Young's modulus [MPa].
        nu: Poisson's ratio, -1 < nu < 0.5.
        mu: Shear modulus [MPa]; give either (E, nu) or (mu, lmbda).
        lmbda: First Lame parameter [MPa].

    Each may be a number, f(x) at midpoints x (3, n) of cells, a Function of degree 0, or an array
    with a value for each local cell of the mesh, ghosts included.

    Raises:
        TypeError: a constant is none of these.
        ValueError: a pair of constants is incomplete or outside its range.
    """

    free_at_rest = True

    def __init__(
        self,
        *,
        E: Any = None,
        nu: Any = None,
        mu: Any = None,
        lmbda: Any = None,
    ):
        if (
            (E is None) != (nu is None)
            or (mu is None) != (lmbda is None)
            or (E is None) == (mu is None)
        ):
            raise ValueError("NeoHookean needs either E and nu, or mu and lmbda")
        pair = {"mu": mu, "lmbda": lmbda} if E is None else {"E": E, "nu": nu}
        known = {k: v if varies(v) else one_number(f"NeoHookean: {k}", v) for k, v in pair.items()}
        lame = _lame_given if E is None else _lame_of_moduli
        if not any(varies(v) for v in known.values()):
            mu, lmbda = lame(*known.values())
            self.parameters = {"mu": float(mu), "lmbda": float(lmbda)}
        else:
            self.parameters = {
                name: FromOthers(lambda a, b, i=i: lame(a, b)[i], known)
                for i, name in enumerate(("mu", "lmbda"))
            }

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """Eq. (86)."""
        mu, lmbda = parameters["mu"], parameters["lmbda"]
        J = ufl.det(F)
        return mu / 2 * (ufl.inner(F, F) - 3) - mu * ufl.ln(J) + lmbda / 2 * (J - 1) ** 2

    def invariant_energy(
        self,
        F: Expr,
        out_of_plane: Expr | None,
        parameters: Mapping[str, Expr],
        dilatation: Expr | None = None,
    ) -> Invariants | None:
        """Eq. (86) as a function of |F|^2 and J, at F_bar also of theta; None in the plane without
        theta."""
        if dilatation is None and out_of_plane is not None:
            return None
        mu, lmbda = parameters["mu"], parameters["lmbda"]
        square, J = ufl.variable(ufl.inner(F, F)), ufl.variable(ufl.det(F))
        variables: tuple[Expr, ...] = (square, J)
        first, volume = square, J
        if dilatation is not None:
            volume = ufl.variable(dilatation)
            variables = *variables, volume
            # |F_bar|^2 with the stretch out of the plane, unchanged by mean dilatation.
            first = (volume / J) ** (2 / F.ufl_shape[0]) * square
        first, volume = arguments = ufl.variable(first), ufl.variable(volume)
        F33 = 1 if out_of_plane is None else out_of_plane
        rest = 0 if out_of_plane is None else F33**2
        j = volume * F33
        energy = mu / 2 * (first + rest - 3) - mu * ufl.ln(j) + lmbda / 2 * (j - 1) ** 2
        return Invariants(energy, arguments, variables)

    def free_stretch(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """Positive root of (mu + lambda j^2) F_33^2 - lambda j F_33 - mu = 0, j = det F."""
        mu, lmbda = parameters["mu"], parameters["lmbda"]
        j = ufl.det(F)
        square = mu + lmbda * j**2
        return (lmbda * j + ufl.sqrt((lmbda * j) ** 2 + 4 * mu * square)) / (2 * square)

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """mu eps:eps + lambda/2 tr(eps)^2, the limit of (86) at small strain."""
        mu, lmbda = parameters["mu"], parameters["lmbda"]
        return mu * ufl.inner(strain, strain) + lmbda / 2 * ufl.tr(strain) ** 2


def _lame_of_moduli(E: Any, nu: Any) -> tuple[Any, Any]:
    _check_range("E", E, np.isfinite(E) & np.greater(E, 0), "must be positive and finite")
    _check_range(
        "nu",
        nu,
        np.greater(nu, -1) & np.less(nu, 0.5),
        "must lie in (-1, 0.5); for a nearly incompressible body take for example nu = 0.4998",
    )
    return _lame_given(E / (2 * (1 + nu)), nu * E / ((1 + nu) * (1 - 2 * nu)))


def _lame_given(mu: Any, lmbda: Any) -> tuple[Any, Any]:
    _check_range("mu", mu, np.isfinite(mu) & np.greater(mu, 0), "must be positive and finite")
    least = -2 * np.asarray(mu) / 3
    _check_range(
        "lmbda",
        lmbda,
        np.isfinite(lmbda) & np.greater(lmbda, least),
        f"must be finite and exceed -2 mu / 3 = {np.max(least, initial=-np.inf)}",
    )
    return mu, lmbda


def _check_range(name: str, value: Any, good: Any, rule: str) -> None:
    bad = ~np.atleast_1d(good)
    if bad.any():
        worst = np.broadcast_to(value, bad.shape)[bad][0]
        raise ValueError(f"NeoHookean: {name} = {worst} {rule}")


class Hyperelastic(Material):
    """A material given by its strain energy, a UFL expression.

    Materials with the same function share a kernel, whatever their parameters: pass one function to
    all of them, not a new lambda each time. Stress and moduli are derived by UFL, so the energy
    must be smooth (three times differentiable) in the range of use; in plane strain it is called
    with the 3 x 3 F, F_33 = 1.

    With mean dilatation in 3D the kernels of W(F_bar) take minutes to compile, once: a subclass of
    Material with :meth:`Material.invariant_energy`, as of :class:`NeoHookean`, takes seconds.

    Args:
        energy: W(F, parameters) per reference volume [MPa] of the 3 x 3 ``F``.
        parameters: Values by name, passed to ``energy`` as cell-wise constants: numbers, or one per
            cell as for :class:`NeoHookean`.

    Raises:
        TypeError: ``energy`` cannot be called, or a parameter is none of these.
        ValueError: a parameter is not finite.
    """

    def __init__(
        self,
        energy: Callable[[Expr, Mapping[str, Expr]], Expr],
        parameters: Mapping[str, Any] | None = None,
    ):
        if not callable(energy):
            raise TypeError(f"Hyperelastic: energy(F, parameters) must be callable, got {energy!r}")
        given = dict(parameters or {})
        for name, value in given.items():
            if varies(value):
                continue
            given[name] = one_number(f"Hyperelastic: {name}", value)
            if not math.isfinite(given[name]):
                raise ValueError(f"Hyperelastic: {name} = {value!r} must be a finite number")
        self.parameters = given
        self._energy = energy

    @property
    def kernel_key(self) -> Hashable:
        """One kernel for every function and set of names."""
        return type(self), self._energy, tuple(self.parameters)

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """The user's W."""
        return self._energy(F, parameters)

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """eps:A:eps/2 with A = d2W/dF2 of the user's W at F = I."""
        F = ufl.variable(ufl.Identity(3))
        P = ufl.diff(self._energy(F, parameters), F)
        i, j, k, m = ufl.indices(4)
        return strain[i, j] * ufl.diff(P, F)[i, j, k, m] * strain[k, m] / 2
