"""The door for materials whose stress is computed at points, all points at once, in numpy."""

from __future__ import annotations

import math
from collections.abc import Hashable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..forms.materials import Material

Array = NDArray[np.float64]


class Response(NamedTuple):
    """What a material answers at n points.

    Attributes:
        stress: First Piola-Kirchhoff stress, at small strain the stress (n, 3, 3) [MPa].
        moduli: Its consistent derivative by the deformation gradient, at small strain by the
            strain (n, 3, 3, 3, 3) [MPa].
        state: History at the end of the step (n, m).
        stored: Recoverable energy per reference volume (n,) [MPa].
        dissipated: Dissipated energy per reference volume in the step (n,) [MPa].
    """

    stress: Array
    moduli: Array
    state: Array
    stored: Array
    dissipated: Array


class PointMaterial(Material):
    """A material with a history, given by a function of all points of its bodies at once.

    A new material is a subclass with :attr:`fields` and :meth:`__call__`, and :meth:`start` if its
    history does not start at zero. Whatever computes the stress may stand behind it: numpy, a
    library of constitutive models, a table.

    The stabilization does not use the moduli that it returns: tau_s follows from ``elastic`` and
    suffices for every state whose moduli lie between zero and those (see
    :mod:`vmdg.interface.coercivity`), as those of a plastic body with an associated flow rule do.

    Args:
        elastic: Its elastic part, a hyperelastic material: moduli at small elastic strains.

    Attributes:
        elastic: As given.
        fields: Names of the quantities of the history and their number per point, in the order of
            the columns of ``state``.
        symmetric: Whether the moduli have major symmetry, A_ijkl = A_klij, as those of an
            associated flow rule do.
        viscous: Whether the stress depends on the time step; runs then need a duration, and the
            path is followed by load, as with laws that depend on the rate.
        locks: Whether it may flow at constant volume, so that cells of degree 1 lock.
        kinematics: Kinds of strain for which it is defined: "small", "finite".
        numbers: Values by which a checkpoint knows the material again.

    Raises:
        TypeError: ``elastic`` is not a hyperelastic material.
    """

    fields: Mapping[str, int] = {}
    symmetric = True
    viscous, locks = False, True
    kinematics: tuple[str, ...] = ("small", "finite")

    def __init__(self, elastic: Material):
        if not isinstance(elastic, Material) or isinstance(elastic, PointMaterial):
            raise TypeError(
                f"{type(self).__name__}: elastic = {elastic!r} must be a hyperelastic material, "
                "for example vmdg.NeoHookean(E=..., nu=...)"
            )
        self.elastic, self.mirrored = elastic, elastic.mirrored
        self.parameters = dict(elastic.parameters)
        self.numbers: Mapping[str, Any] = dict(elastic.parameters)

    @property
    def kernel_key(self) -> Hashable:
        """Materials of equal key share the forms: their stress is a coefficient."""
        return PointMaterial, self.elastic.kernel_key, self.symmetric

    @property
    def size(self) -> int:
        """Numbers per point in the history."""
        return sum(self.fields.values())

    def start(self, n: int) -> Array:
        """The history of n points before loading, (n, m)."""
        return np.zeros((n, self.size))

    def __call__(
        self, deformation: Array, state: Array, dt: float = math.inf, small: bool = False
    ) -> Response:
        """Stress and moduli at the end of a step.

        A stress or moduli that are not finite make the attempt of a step fail. With a finite stress
        a history or energies that are not finite are an error.

        Args:
            deformation: Deformation gradient F, at small strain the symmetric strain (n, 3, 3).
            state: History at the start of the step (n, m).
            dt: Time step [s]; infinite in a jump, or at a load factor that stays.
        """
        raise NotImplementedError(
            f"{type(self).__name__} has no stress: define __call__(deformation, state, dt, small)"
        )

    # The elastic part, for the stabilization and for checks

    def energy(self, F: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """W of the elastic part."""
        return self.elastic.energy(F, parameters)

    def linear_energy(self, strain: Expr, parameters: Mapping[str, Expr]) -> Expr:
        """Quadratic energy of the elastic part."""
        return self.elastic.linear_energy(strain, parameters)
