"""Strain energies of the report, section 7, as UFL expressions."""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Iterator, Mapping
from numbers import Real
from typing import Any

import ufl
from ufl.core.expr import Expr

from .invariants import Invariants


class Parameters(Mapping[str, float]):
    """Values by name, which cannot be changed: a problem has taken them over.

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
            f"the parameter {name!r} of a material cannot be changed, a problem would not notice; "
            "make a new material and a new Problem"
        )

    def __repr__(self) -> str:
        return repr(self._values)


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
            "the body tags and materials of their own, by vmdg.split_cells for example"
        )
    return float(value)


class Material:
    """A hyperelastic material: named parameters and a strain energy W(F).

    A new material is one subclass with :meth:`energy`. Parameters become cell-wise constant
    coefficients, so that all materials of one :attr:`kernel_key` share one compiled kernel.

    Attributes:
        parameters: Values by name, in the user's consistent units (N, mm, MPa); set once.
        free_at_rest: Whether it is known that there is no stress at F = I; else a problem looks.
    """

    parameters: Mapping[str, float]
    free_at_rest = False

    def __setattr__(self, name: str, value: Any) -> None:
        if name == "parameters":
            if name in self.__dict__:
                raise AttributeError(
                    f"{type(self).__name__}: parameters are set once, a problem would not notice "
                    "a change; make a new material and a new Problem"
                )
            value = Parameters(value)
        super().__setattr__(name, value)

    @property
    def kernel_key(self) -> Hashable:
        """Materials of equal key have the same energy up to the values of the parameters."""
        return type(self)

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
        """The same W as a function of few invariants; None where :meth:`energy` serves as it is.

        Worth defining for energies whose kernels are slow to compile otherwise.

        Args:
            F: Deformation gradient, 3 x 3, or 2 x 2 in plane strain.
            out_of_plane: F_33 in plane strain, else None.
            parameters: Values by name.
            dilatation: theta of :mod:`forms.dilatation`, which F_bar has in place of det F; given
                with mean dilatation only.
        """
        return None

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """Quadratic energy [MPa] of small strain.

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

    Raises:
        TypeError: a constant is no number.
        ValueError: a pair of constants is incomplete or outside its range.
    """

    free_at_rest = True

    def __init__(
        self,
        *,
        E: float | None = None,
        nu: float | None = None,
        mu: float | None = None,
        lmbda: float | None = None,
    ):
        if (
            (E is None) != (nu is None)
            or (mu is None) != (lmbda is None)
            or (E is None) == (mu is None)
        ):
            raise ValueError("NeoHookean needs either E and nu, or mu and lmbda")
        for name, value in {"E": E, "nu": nu, "mu": mu, "lmbda": lmbda}.items():
            if value is not None:
                one_number(f"NeoHookean: {name}", value)
        if E is not None:
            if not (math.isfinite(E) and E > 0):
                raise ValueError(f"NeoHookean: E = {E} must be positive and finite")
            if not -1 < nu < 0.5:
                raise ValueError(
                    f"NeoHookean: nu = {nu} must lie in (-1, 0.5); for a nearly incompressible "
                    "body take for example nu = 0.4998"
                )
            mu = E / (2 * (1 + nu))
            lmbda = nu * E / ((1 + nu) * (1 - 2 * nu))
        if not (math.isfinite(mu) and mu > 0):
            raise ValueError(f"NeoHookean: mu = {mu} must be positive and finite")
        if not (math.isfinite(lmbda) and lmbda > -2 * mu / 3):
            raise ValueError(
                f"NeoHookean: lmbda = {lmbda} must be finite and exceed -2 mu / 3 = {-2 * mu / 3}"
            )
        self.parameters = {"mu": float(mu), "lmbda": float(lmbda)}

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
        """Eq. (86) at F_bar by |F|^2, J and theta; None without a ``dilatation``."""
        if dilatation is None:
            return None
        mu, lmbda = parameters["mu"], parameters["lmbda"]
        square, J = ufl.variable(ufl.inner(F, F)), ufl.variable(ufl.det(F))
        theta = ufl.variable(dilatation)
        # |F_bar|^2 and det F_bar with the stretch out of the plane, which mean dilatation leaves.
        first = ufl.variable((theta / J) ** (2 / F.ufl_shape[0]) * square)
        volume = ufl.variable(theta)
        F33 = 1 if out_of_plane is None else out_of_plane
        rest = 0 if out_of_plane is None else F33**2
        j = volume * F33
        energy = mu / 2 * (first + rest - 3) - mu * ufl.ln(j) + lmbda / 2 * (j - 1) ** 2
        return Invariants(energy, (first, volume), (square, J, theta))

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """mu eps:eps + lambda/2 tr(eps)^2, the limit of (86) at small strain."""
        mu, lmbda = parameters["mu"], parameters["lmbda"]
        return mu * ufl.inner(strain, strain) + lmbda / 2 * ufl.tr(strain) ** 2


class Hyperelastic(Material):
    """A material given by its strain energy, a UFL expression.

    Materials with the same function share a kernel, whatever their parameters: pass one function
    to all of them, not a new lambda to each. Stress and moduli are derived by UFL, so the energy
    must be smooth (three times differentiable) in the range of use; in plane strain it is given
    the 3 x 3 F with F_33 = 1.

    With mean dilatation in 3D the kernels of W(F_bar) take minutes to compile, once: a subclass of
    Material with :meth:`Material.invariant_energy`, as of :class:`NeoHookean`, takes seconds.

    Args:
        energy: W(F, parameters) per reference volume [MPa] of the 3 x 3 ``F``.
        parameters: Values by name, given to ``energy`` as cell-wise constants.

    Raises:
        TypeError: ``energy`` cannot be called, or a parameter is no number.
        ValueError: a parameter is not finite.
    """

    def __init__(
        self,
        energy: Callable[[Expr, Mapping[str, Expr]], Expr],
        parameters: Mapping[str, float] | None = None,
    ):
        if not callable(energy):
            raise TypeError(f"Hyperelastic: energy(F, parameters) must be callable, got {energy!r}")
        for name, value in (parameters or {}).items():
            if not math.isfinite(one_number(f"Hyperelastic: {name}", value)):
                raise ValueError(f"Hyperelastic: {name} = {value!r} must be a finite number")
        self.parameters = {name: float(value) for name, value in (parameters or {}).items()}
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
