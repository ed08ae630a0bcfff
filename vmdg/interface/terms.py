"""One interface in the forms: the coefficients on its facets, and its integrands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..domain.materials import Bodies
from ..forms import residual
from ..forms.kinematics import Body
from .interface import Interface
from .points import PointValues
from .quadrature import FacetQuadrature, region_pairs
from .stabilization import Stabilization


@dataclass(frozen=True)
class RegionPair:
    """Facets of an interface whose two sides belong to the same pair of material regions.

    Attributes:
        rows: Integration entities (cell 1, facet in it, cell 2, facet in it), flattened.
        bodies: Bodies of side 1 and side 2.
    """

    rows: NDArray[np.int32]
    bodies: tuple[Body, Body]


class InterfaceTerms:
    """The integrands of one interface in the residual and the energy.

    A tie (law without history) has the tensor tau_s and no zeta; any other law has the scalar r =
    |tau_s|, and for a rotating frame also a couple.

    Args:
        interface: The user's description.
        quadrature: Its quadrature points.
        u: Displacement.
        bodies: Materials.
        turns: Whether the frame of the law rotates.
        fluid: Fluid pressure at the points; None for none.

    Attributes:
        pairs: The facets, by the materials of their sides.
        submesh: Mesh of the coefficients.
    """

    def __init__(
        self,
        interface: Interface,
        quadrature: FacetQuadrature,
        u: fem.Function,
        bodies: Bodies,
        turns: bool,
        fluid: fem.Function | None = None,
    ):
        facets, d = quadrature.facets, quadrature.d
        self._inelastic, self._turns = interface.law.inelastic, turns
        self._traction_jump, self._fluid = interface.traction_jump, fluid
        self._quadrature, self._u = quadrature, u
        self._geometry = quadrature.geometry
        self._N = ufl.FacetNormal(quadrature.mesh)("+")
        self.submesh = quadrature.submesh
        region_of = bodies.region[facets.cells]
        self.pairs = [
            RegionPair(
                facets.rows((region_of == pair).all(axis=1)),
                tuple(replace(bodies.regions[i].body, fluid=fluid) for i in pair),
            )
            for pair in region_pairs(facets, bodies, quadrature.mesh.comm)
        ]
        space, facet_space = quadrature.space, quadrature.facet_space
        self._delta = fem.Function(facet_space((d, d)))
        self._tau = fem.Function(facet_space(() if self._inelastic else (d, d)))
        self._zeta = fem.Function(space((d,))) if self._inelastic else None
        self._delta_s = fem.Function(facet_space((d, d))) if self._traction_jump else None
        self._moment = fem.Function(space((d, d))) if turns else None

    # Integrands

    def residual(self, eta: Expr, bodies: tuple[Body, Body]) -> Expr:
        """Interface integrand of (27), or of (26) with the traction jump."""
        moment = None if self._moment is None else self._moment("+")
        return residual.residual(
            eta, bodies, self._geometry, self._u, self._N, *self._coefficients(), moment=moment
        )

    def energy(self, bodies: tuple[Body, Body]) -> Expr:
        """Stored energy of the interface, the interface integrand of (30) [N/mm].

        Without the fluid, whose work is that of a load.
        """
        bodies = tuple(replace(body, fluid=None) for body in bodies)
        return residual.energy(bodies, self._geometry, self._u, self._N, *self._coefficients())

    def _coefficients(self) -> tuple[Expr, Expr, Expr | None, Expr | None]:
        """delta_1, tau_s, zeta and delta_s on the facets, None where absent from the form."""
        zeta = None if self._zeta is None else self._zeta("+")
        delta_s = None if self._delta_s is None else self._delta_s("+")
        return self._delta("+"), self._tau("+"), zeta, delta_s

    # Coefficients

    def set_stabilization(self, stabilization: Stabilization) -> None:
        """Set tau_s, delta and delta_s."""
        write = self._quadrature.set_facet_values
        write(self._delta, stabilization.weights[:, 0])
        if self._delta_s is not None:
            write(self._delta_s, stabilization.delta_s)
        write(self._tau, stabilization.norm if self._inelastic else stabilization.tau)

    def set_gap(self, values: PointValues) -> None:
        """Set zeta, and the couple of a rotating frame."""
        if self._zeta is not None:
            self._zeta.x.array[:] = values.gap.ravel()
        if self._moment is not None:
            self._moment.x.array[:] = values.moment.ravel()
