"""Laminates of delamination tests: plies, their bond, and corrected beam theory."""

from __future__ import annotations

import math
from dataclasses import dataclass

import vmdg


@dataclass(frozen=True)
class Laminate:
    """Two arms of a unidirectional laminate, fibres along x, isotropic across them.

    Lengths in mm, moduli and strengths in MPa, energies in N/mm.
    """

    # E1, E2, G12, nu12, nu23: Elastic constants, E_3 = E_2, G_13 = G_12, nu_13 = nu_12
    E1: float
    E2: float
    G12: float
    nu12: float
    nu23: float
    h: float  # Height of an arm
    b: float  # Width
    # G_I, G_II: Energies of opening and of shear; G_II only where there is shear
    G_I: float
    # Of the bond in opening; in shear sqrt(G_II/G_I) times as much (Turon et al. 2010)
    strength: float
    G_II: float = math.nan
    exponent: float = math.nan  # Of the criterion of Benzeggagh and Kenane

    @property
    def material(self) -> vmdg.Orthotropic:
        G23 = self.E2 / (2 * (1 + self.nu23))
        return vmdg.Orthotropic(
            E=(self.E1, self.E2, self.E2),
            nu=(self.nu12, self.nu12, self.nu23),
            G=(self.G12, self.G12, G23),
        )

    @property
    def plane_strain(self) -> tuple[float, float]:
        """E_1 and E_2 of a wide beam."""
        nu21 = self.nu12 * self.E2 / self.E1
        return self.E1 / (1 - self.nu12 * nu21), self.E2 / (1 - self.nu23**2)

    @property
    def chi(self) -> float:
        """Of corrected beam theory: what an arm is longer than the crack, in units of h."""
        E1, E2 = self.plane_strain
        gamma = 1.18 * math.sqrt(E1 * E2) / self.G12
        return math.sqrt(E1 / (11 * self.G12) * (3 - 2 * (gamma / (1 + gamma)) ** 2))

    @property
    def rigidity(self) -> float:
        """b E_1 h^3 [N mm2]."""
        return self.b * self.plane_strain[0] * self.h**3

    def toughness(self, share: float) -> float:
        """G_c of Benzeggagh and Kenane at a share G_II/G_T of shear [N/mm]."""
        return self.G_I + (self.G_II - self.G_I) * share**self.exponent

    def bond(self, friction: float = 0.0) -> vmdg.Law:
        """What holds the arms together: linear softening, in mixed mode where G_II is given."""
        if math.isnan(self.G_II):
            return vmdg.Debonding(self.strength, 2 * self.G_I / self.strength, friction)
        return vmdg.MixedModeDebonding(
            normal_strength=self.strength,
            shear_strength=self.strength * math.sqrt(self.G_II / self.G_I),
            normal_energy=self.G_I,
            shear_energy=self.G_II,
            criterion="BK",
            exponent=self.exponent,
            friction=friction,
        )


#: Alfano and Crisfield 2001 (IJNME 50).
ALFANO_CRISFIELD = Laminate(135300.0, 9000.0, 5200.0, 0.24, 0.46, 1.5, 20.0, 0.28, 57.0)

#: IM7/8552, Krueger 2012, NASA/CR-2012-217562 (MMB); the strength is free in fracture mechanics.
MMB = Laminate(161e3, 11.38e3, 5.2e3, 0.32, 0.45, 2.25, 25.4, 0.212, 60.0, 0.774, 2.1)

#: T300/1076, Krueger 2008, NASA/TM-2008-215123.
T300_1076 = Laminate(139.4e3, 10.16e3, 4.6e3, 0.30, 0.436, 1.5, 25.0, 0.1703, 60.0)

#: T300/977-2, Turon et al. 2007 (Eng. Fract. Mech. 74).
T300_977 = Laminate(150e3, 11e3, 6e3, 0.25, 0.45, 1.98, 20.0, 0.352, 60.0)

#: IM7/8552, NASA/TM-2020-220498, 13 plies of 0.184 mm an arm.
IM7_8552 = Laminate(161e3, 11.38e3, 5.2e3, 0.32, 0.45, 13 * 0.184, 25.4, 0.324, 60.0, 0.777, 2.1)
