"""Plasticity that depends on the pressure: the cone of Drucker and Prager.

Returns to the cone and to its apex as in de Souza Neto, Peric and Owen (2008), section 8.3;
:mod:`.plasticity` makes both kinds of strain of them.
"""

from __future__ import annotations

import math

import numpy as np

from .plasticity import Plastic, Returned, check_numbers, deviatoric, dot, isotropic, with_mean
from .point import Array

#: Stiffness of points at the apex in the tangent, relative to the elastic one: without hardening
#: they have none, and a body that flows there through all of a section has a singular tangent.
_HELD = 1e-8

#: How the cone meets the pyramid of Mohr and Coulomb: sign of sin(friction) in 3 -/+ sin(friction).
_EDGES = {"compression": -1, "tension": 1}
_FITS = (*_EDGES, "plane strain")


class DruckerPrager(Plastic):
    """Soil, rock, concrete or a polymer whose yield stress grows with the pressure.

    With the mean stress p, positive in tension, and s = dev sigma

        sqrt(s:s/2) + eta p = xi c(alpha),  c = cohesion + hardening alpha,

    where eta and xi are those of friction angle and cohesion of Mohr and Coulomb. Flow is that of
    the potential sqrt(s:s/2) + etab p, with etab of the dilatancy angle as eta of the friction
    angle, and d alpha = xi dgamma. At the apex p = xi c/eta the rest of the volumetric flow, after
    etab of the deviatoric one, adds xi/eta of itself to alpha: this is the associated rule, leaves
    the stress continuous for any dilatancy, and lets bodies without dilatancy reach the apex (there
    the book differs). In uniaxial stress the cone is reached at 3 xi c/(sqrt(3) + eta) in tension
    and 3 xi c/(sqrt(3) - eta) in compression. Without hardening a point at the apex has no
    stiffness in any direction; the tangent has 1e-8 of the elastic one there. With less dilatancy
    than friction a confined body may soften, and then flows in one part only, in one row of cells,
    whatever their size.

    Args:
        E: Young's modulus [MPa].
        nu: Poisson's ratio, -1 < nu < 0.5.
        cohesion: Initial cohesion [MPa].
        friction: Friction angle, between 0 and 90 [degrees].
        dilatancy: Dilatancy angle, at most ``friction``; None for the associated rule. The moduli
            are unsymmetric where it is less [degrees].
        hardening: Increase of the cohesion with alpha [MPa].
        fit: Where the cone meets the pyramid: at its edges of "compression" or "tension", or in
            "plane strain", where both fail at the same load under the associated rule.

    Attributes:
        eta, xi, dilation: eta, xi and etab.

    Raises:
        TypeError: a parameter is not a number.
        ValueError: a parameter out of range, or a fit that does not exist.
    """

    def __init__(
        self,
        E: float,
        nu: float,
        cohesion: float,
        friction: float,
        *,
        dilatancy: float | None = None,
        hardening: float = 0.0,
        fit: str = "compression",
    ):
        super().__init__(E, nu)
        dilatancy = friction if dilatancy is None else dilatancy
        numbers = {
            "cohesion": cohesion,
            "friction": friction,
            "dilatancy": dilatancy,
            "hardening": hardening,
        }
        check_numbers("DruckerPrager", numbers, positive=("cohesion", "friction"))
        if not friction < 90:
            raise ValueError(f"DruckerPrager: friction = {friction!r} must be below 90 degrees")
        if dilatancy > friction:
            raise ValueError(
                f"DruckerPrager: dilatancy = {dilatancy!r} is above friction = {friction!r}: flow "
                "would create energy"
            )
        if fit not in _FITS:
            raise ValueError(f"DruckerPrager: fit = {fit!r} must be one of {', '.join(_FITS)}")
        self.eta, self.xi = _cone(friction, fit)
        self.dilation, _ = _cone(dilatancy, fit)
        self._cohesion, self._hardening = float(cohesion), float(hardening)
        self.symmetric = dilatancy == friction
        self.numbers = {**self.parameters, **numbers, "fit": fit}

    def cohesion(self, alpha: Array) -> Array:
        """c after an accumulated flow ``alpha``, (n,) each [MPa]."""
        return self._cohesion + self._hardening * alpha

    def _return(self, trial: Array, state: Array, dt: float) -> Returned:
        G, K, H = self._G, self._K, self._hardening
        eta, xi, etab = self.eta, self.xi, self.dilation
        alpha = state[:, 0]
        volume, strain = deviatoric(trial)
        p, size = K * volume, np.sqrt(dot(strain, strain))
        j = math.sqrt(2) * G * size
        start = self.cohesion(alpha)
        resists = G + K * eta * etab + xi**2 * H
        gamma = np.maximum(j + eta * p - xi * start, 0.0) / resists
        flows, apex = gamma > 0, G * gamma > j
        gamma = np.minimum(gamma, j / G)
        # What is left of the deviator, and the volumetric flow that etab gamma leaves out.
        share = np.where(apex, 0.0, 1 - G * gamma / np.where(j > 0, j, 1.0))
        ratio = xi / eta
        stiff = K + H * ratio**2
        more = p - K * etab * gamma - ratio * (start + H * xi * gamma)
        # Not negative but for rounding.
        more = np.where(apex, np.maximum(more / stiff, 0.0), 0.0)
        grown = etab * gamma + more
        change = with_mean((1 - share)[:, None] * strain, grown / 3)
        increment = xi * gamma + ratio * more
        p, left = p - K * grown, 2 * G * share
        end = self.cohesion(alpha + increment)
        spent = share * j * gamma + p * grown
        # Derivatives, by the direction n of the deviator and by the volume: of gamma, of p.
        n = strain / np.where(size > 0, size, 1.0)[:, None]
        cone = flows & ~apex
        by_n = np.where(cone, math.sqrt(2) * G / resists, 0.0)
        by_volume = np.where(cone, eta * K / resists, 0.0)
        p_by_n = -K * etab * by_n
        p_by_volume = K - K * etab * by_volume
        # At the apex gamma = j/G, and p = ratio c.
        at_apex = H * ratio * (xi - ratio * etab) * math.sqrt(2) * K / stiff
        p_by_n = np.where(apex, at_apex, p_by_n)
        p_by_volume = np.where(apex, H * ratio**2 * K / stiff, p_by_volume)
        turned = np.where(cone, 2 * G - left, 0.0) - math.sqrt(2) * G * by_n
        one = np.zeros(trial.shape[1])
        one[:3] = 1.0
        bulk, shear = (
            np.where(apex, np.maximum(found, _HELD * elastic), found)
            for found, elastic in ((p_by_volume, K), (left, 2 * G))
        )
        tangent = isotropic(bulk, shear, trial.shape[1])
        row = turned[:, None] * n - (math.sqrt(2) * G * by_volume)[:, None] * one
        tangent += n[:, :, None] @ row[:, None]
        tangent += one[:, None] * (p_by_n[:, None] * n)[:, None]
        elastic = share[:, None] * strain
        return Returned(
            with_mean(left[:, None] * strain, p),
            tangent,
            left,
            change,
            (alpha + increment)[:, None],
            K / 2 * (p / K) ** 2 + G * dot(elastic, elastic),
            spent * (start + end) / (2 * end),
        )


def _cone(angle: float, fit: str) -> tuple[float, float]:
    """eta and xi of an angle [degrees]."""
    sine, cosine = math.sin(math.radians(angle)), math.cos(math.radians(angle))
    if fit == "plane strain":
        size = math.sqrt(9 + 12 * (sine / cosine) ** 2)
        return 3 * sine / cosine / size, 3 / size
    size = math.sqrt(3) * (3 + _EDGES[fit] * sine)
    return 6 * sine / size, 6 * cosine / size
