"""Potential interfaces: facets stay continuous until their traction nears the strength."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ..base.parallel import global_any, global_max
from ..base.quadrature import facet_degree
from ..domain.materials import Bodies
from ..domain.topology import mark_everywhere
from ..forms import kinematics
from ..forms.geometry import Geometry
from .facets import InterfaceFacets
from .interface import Interface
from .quadrature import FacetQuadrature, SideEvaluators, side_evaluators
from .stabilization import Stabilizer

#: Nearness is relative to ``Interface.activate_at``. A facet at NEAR is opened after the step, and
#: with it all facets above COMPANY, so that facets open in batches; a step that brings one above
#: TOO_LATE is done again with it open.
NEAR, COMPANY, TOO_LATE = 1.0, 0.75, 1.5


class PotentialFacets:
    """The facets of one interface that opens on demand, with their traction while closed.

    The traction is {P.N} with the weights delta of (23) at F = I: the softer side counts more.
    """

    def __init__(
        self,
        mesh: Mesh,
        interface: Interface,
        facets: InterfaceFacets,
        degree: int,
        geometry: Geometry,
    ):
        self.interface = interface
        self.facets = facets
        self._quadrature = FacetQuadrature(mesh, facets, facet_degree(degree), geometry)
        #: Of all facets on this rank [mm2; mm in plane strain].
        self.area = float(self._quadrature.area.sum())
        self._delta: NDArray[np.float64] | None = None
        self._tractions: SideEvaluators | None = None

    def follow(self, u: fem.Function, bodies: Bodies) -> None:
        """Evaluate with this displacement from now on."""
        if self._delta is None:
            stabilizer = Stabilizer(self.interface, self.facets, self._quadrature, u, bodies)
            self._delta = stabilizer.derive().delta
        d = self._quadrature.d
        self._tractions = side_evaluators(
            self._quadrature,
            u,
            bodies,
            (d,),
            lambda body, F, N, a: kinematics.traction(body, F, N),
            "traction",
        )

    def nearness(self) -> NDArray[np.float64]:
        """Largest traction of every facet relative to where it is to be opened (nf,)."""
        q = self._quadrature
        delta = self._delta[q.facet]
        first, second = (evaluate() for evaluate in self._tractions)
        # The kernels take the outward normal of their own side, -N on side 2.
        T = np.einsum("pij,pj->pi", delta[:, 0], first)
        T -= np.einsum("pij,pj->pi", delta[:, 1], second)
        normal = np.einsum("pi,pi->p", T, q.normal)
        shear = np.linalg.norm(T - normal[:, None] * q.normal, axis=1)
        ratio = self.interface.law.nearness(normal, shear) / self.interface.activate_at
        return ratio[q.points_of_facet].max(axis=1, initial=0.0)


class Activation:
    """Which facets of every interface are open.

    Attributes:
        open: For every interface, a mark on all local facets of the mesh.
    """

    def __init__(
        self,
        mesh: Mesh,
        interfaces: Sequence[Interface],
        facets: Sequence[InterfaceFacets],
        bodies: Bodies,
        degree: int,
        geometry: Geometry,
    ):
        self._mesh = mesh
        self._bodies = bodies
        self.open: list[NDArray[np.bool_]] = []
        self._potential: dict[int, PotentialFacets] = {}
        fdim = mesh.topology.dim - 1
        mesh.topology.create_entities(fdim)
        facet_map = mesh.topology.index_map(fdim)
        count = facet_map.size_local + facet_map.num_ghosts
        for i, (interface, selected) in enumerate(zip(interfaces, facets, strict=True)):
            on_demand = interface.activate == "on-demand"
            self.open.append(np.full(count, not on_demand))
            if on_demand:
                self._potential[i] = PotentialFacets(mesh, interface, selected, degree, geometry)

    def __bool__(self) -> bool:
        return bool(self._potential)

    def follow(self, u: fem.Function) -> None:
        """Evaluate closed facets with this displacement from now on."""
        for potential in self._potential.values():
            potential.follow(u, self._bodies)

    def area(self, i: int) -> float | None:
        """Of all facets of interface ``i`` on this rank [mm2; mm in plane strain].

        None where they do not open on demand but are open from the start.
        """
        return self._potential[i].area if i in self._potential else None

    def nearness(self) -> dict[int, NDArray[np.float64]]:
        """How near the owned facets of every potential interface are to being opened.

        Open facets count as zero.
        """
        return {
            i: np.where(self.open[i][potential.facets.facets], 0.0, potential.nearness())
            for i, potential in self._potential.items()
        }

    def largest(self, nearness: dict[int, NDArray[np.float64]]) -> float:
        """Largest value on any rank."""
        here = max((values.max(initial=0.0) for values in nearness.values()), default=0.0)
        return global_max(self._mesh.comm, float(here))

    def mark(self, nearness: dict[int, NDArray[np.float64]]) -> bool:
        """Open the facets above COMPANY; whether there were any on any rank."""
        changed = False
        for i, values in nearness.items():
            chosen = self._potential[i].facets.facets[values > COMPANY]
            changed |= len(chosen) > 0
            # A copy: snapshots keep the marks of their time.
            self.open[i] = self.open[i] | mark_everywhere(
                self._mesh, self._mesh.topology.dim - 1, chosen
            )
        return global_any(self._mesh.comm, changed)
