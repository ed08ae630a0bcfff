"""Damage of a body by a gradient model: a crack is a band of a given width, without a path given.

The phase field AT1 (Pham, Amor, Marigo and Maurini 2011, International Journal of Damage Mechanics
20, 618): among all u and d with d_n <= d <= 1, d_n the damage of the last step, steps have the
least

    W = int g(d) psi_+ + psi_- dV + (3 G_c/8) int d/l + l |grad d|^2 dV,

g = (1 - k) (1 - d)^2 + k. It is chosen among its kind since it is elastic up to a strength, as AT2
is not, since the problem of d at a given u is quadratic with bounds and so has one solution, as
that of a cohesive phase field is not, and since it has closed forms:

- a bar in tension is elastic up to sigma_c = (3 G_c E/(8 l))^1/2; strained beyond
  eps_c = sigma_c/E without localization it has 1 - d = (eps_c/eps)^2, sigma = E eps_c^4/eps^3;
- a crack has d = (1 - |x|/(2 l))^2, and its two halves, of G_c/2 each, are as wide as 2 l.

psi_+ is what cracks release: the energy of the deviator and of an increase of the volume (Amor,
Marigo and Maurini 2009, Journal of the Mechanics and Physics of Solids 57, 1209), so that what
closes a crack is carried by it.
"""

from __future__ import annotations

import math
from numbers import Real

import numpy as np

from ..forms.materials import NeoHookean
from .plasticity import check_numbers
from .point import Array, PointMaterial, Response

#: k, the share of the stiffness that a crack keeps.
REMAINING = 1e-6

SPLITS = ("volumetric", "none")

_SPHERE = np.einsum("ij,kl->ijkl", np.eye(3), np.eye(3))
_EQUAL = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
_DEVIATOR = (_EQUAL + _EQUAL.transpose(0, 1, 3, 2)) / 2 - _SPHERE / 3


class GradientDamage(PointMaterial):
    """An elastic body that cracks where it likes, at small strain: a phase field, AT1.

    One scalar field d per body, 0 in whole material and 1 in a crack, continuous where the
    displacement is and free at interfaces and boundaries. It never decreases. Every step alternates
    between the displacement at a given d and d at a given displacement, passes that all begin in
    the state of its start, until d changes by less than ``PathOptions.damage``. Cells must be
    smaller than ``length``, say a fifth. A crack is at least a row of cells wide, and cells of size
    h raise its energy by the factor 1 + 3 h/(8 l) (Bourdin, Francfort and Marigo 2008, Journal of
    Elasticity 91, 5), along a plane of symmetry twice that; ``cell`` takes it away again.

    Its history is "damage" d, "drive" psi_+ [MPa], and "surface", the energy of cracks per volume,
    with its value at the start of the step, "spent" [MPa]. The energy of cracks is in the column
    ``plastic`` of a run.

    Args:
        E: Young's modulus [MPa].
        nu: Poisson's ratio, -1 < nu < 0.5.
        G_c: Energy of a crack per area [N/mm].
        length: l [mm], half of the half width of a crack; with it goes the strength.
        split: "volumetric": cracks do not release the energy of a decrease of the volume; "none":
            they release all, in compression too.
        cell: Size h of cells where cracks run [mm], to divide the energy of the model by
            1 + 3 h/(8 l) so that a crack takes ``G_c``; twice that size for a plane of symmetry. 0
            for the model as it is.

    Attributes:
        toughness: Energy of a crack in the model per area, G_c/(1 + 3 h/(8 l)) [N/mm].
        strength: Uniaxial strength sigma_c = (3 toughness E/(8 l))^1/2 [MPa].

    Raises:
        TypeError: a parameter is not a number.
        ValueError: a parameter is out of range.
    """

    kinematics = ("small",)
    locks = False

    def __init__(
        self,
        E: float,
        nu: float,
        G_c: float,
        length: float,
        split: str = "volumetric",
        cell: float = 0.0,
    ):
        if split not in SPLITS:
            raise ValueError(f"GradientDamage: split = {split!r} must be one of {SPLITS}")
        given = {"E": E, "G_c": G_c, "length": length}
        check_numbers("GradientDamage", given | {"cell": cell}, positive=tuple(given))
        if not isinstance(nu, Real):
            raise TypeError(f"GradientDamage: nu = {nu!r} must be a number")
        super().__init__(NeoHookean(E=E, nu=nu))
        self.fields = {"damage": 1, "drive": 1, "surface": 1, "spent": 1}
        lame = self.elastic.parameters
        self._shear = lame["mu"]
        self._bulk = lame["lmbda"] + 2 * self._shear / 3
        self.length, self.split = float(length), split
        self.toughness = G_c / (1 + 3 * cell / (8 * length))
        self.strength = math.sqrt(3 * self.toughness * E / (8 * length))
        self.numbers = {**self.parameters, "toughness": self.toughness, "length": self.length}
        self.numbers |= {"split": split}

    def __call__(
        self, deformation: Array, state: Array, dt: float = math.inf, small: bool = True
    ) -> Response:
        damage, surface, spent = state[:, 0], state[:, 2], state[:, 3]
        g = (1 - REMAINING) * (1 - damage) ** 2 + REMAINING
        volume = np.trace(deformation, axis1=1, axis2=2)
        deviator = deformation - volume[:, None, None] * np.eye(3) / 3
        pressed = (volume < 0) & (self.split == "volumetric")
        bulk = self._bulk * np.where(pressed, 1.0, g)
        dilated = self._bulk * volume**2 / 2
        sheared = self._shear * np.einsum("pij,pij->p", deviator, deviator)
        drive = sheared + np.where(pressed, 0.0, dilated)
        stress = (bulk * volume)[:, None, None] * np.eye(3)
        stress += 2 * self._shear * g[:, None, None] * deviator
        moduli = np.multiply.outer(bulk, _SPHERE)
        moduli += np.multiply.outer(2 * self._shear * g, _DEVIATOR)
        return Response(
            stress,
            moduli,
            np.column_stack([damage, drive, surface, surface]),
            g * drive + np.where(pressed, dilated, 0.0),
            surface - spent,
        )
