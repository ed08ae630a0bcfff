"""Potential interfaces: facets stay continuous until their traction approaches the strength."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ..base.parallel import global_max
from ..base.quadrature import facet_degree
from ..domain.materials import Bodies
from ..domain.topology import mark_everywhere, refuse_facets
from ..forms import kinematics
from ..points.facets import InterfaceFacets
from ..points.interface import Interface, InterfaceList
from ..points.points import Evaluator, FacetPoints
from .stabilization import Stabilizer

#: Utilization above which a facet is opened before the next step; above which others open with it,
#: so that facets open in batches; and above which the step is repeated with the facet open.
OPENS, OPENS_WITH_OTHERS, REPEATS_STEP = 1.0, 0.75, 1.5


@dataclass(frozen=True)
class Utilization:
    """Traction on closed facets relative to the traction at which they open."""

    # Utilization of the owned facets of every interface that opens on demand, by its number (nf,);
    # zero on open facets
    facets: dict[int, NDArray[np.float64]]
    largest: float  # Maximum over all ranks; zero if no interface opens on demand


class PotentialFacets:
    """The facets of an interface that opens on demand, with their traction while closed.

    The traction is {P.N} with the weights delta of (23) at F = I: the softer side counts more.
    """

    def __init__(self, interface: Interface, quadrature: FacetPoints, bodies: Bodies):
        self.interface = interface
        self.facets = quadrature.facets
        self._quadrature = quadrature
        self._law = quadrature.facets.law.at(quadrature.facet)
        self._bodies = bodies
        #: Area of all facets on this rank [mm2; mm in plane strain].
        self.area = float(quadrature.area.sum())
        self._delta: NDArray[np.float64] | None = None
        self._tractions: Evaluator | None = None

    def follow(self, u: fem.Function) -> None:
        if self._delta is None:
            stabilizer = Stabilizer(self.interface, self._quadrature, u, self._bodies)
            self._delta = stabilizer.derive().delta
        d = self._quadrature.d
        self._tractions = self._quadrature.evaluator(
            u, self._bodies, (d,), kinematics.traction, "traction"
        )

    def utilization(self) -> NDArray[np.float64]:
        """Largest traction of every facet relative to that at which it opens (nf,)."""
        q = self._quadrature
        delta = self._delta[q.facet]
        first, second = self._tractions()
        # The kernels use the outward normal of their side, -N on side 2.
        T = np.einsum("pij,pj->pi", delta[:, 0], first)
        T -= np.einsum("pij,pj->pi", delta[:, 1], second)
        normal = np.einsum("pi,pi->p", T, q.normal)
        shear = np.linalg.norm(T - normal[:, None] * q.normal, axis=1)
        ratio = self._law.utilization(normal, shear) / self.interface.activate_at
        return ratio[q.points_of_facet].max(axis=1, initial=0.0)


class Activation:
    """Which facets of every interface are open.

    Attributes:
        facets: All facets of every interface on this rank, open or not.
        open: For every interface, a mask over all local facets of the mesh.
    """

    def __init__(
        self,
        mesh: Mesh,
        interfaces: Sequence[Interface],
        facets: Sequence[InterfaceFacets],
        bodies: Bodies,
        degree: int,
    ):
        self._mesh = mesh
        self.interfaces = interfaces
        self.facets = InterfaceList(interfaces, facets)
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
                damaged = selected.facets[selected.damage > 0]
                self.open[i] = mark_everywhere(mesh, fdim, damaged)
                quadrature = FacetPoints(mesh, selected, facet_degree(degree), bodies.geometry)
                self._potential[i] = PotentialFacets(interface, quadrature, bodies)

    def __bool__(self) -> bool:
        return bool(self._potential)

    def refuse(self, facets: NDArray[np.int32], what: str, reason: str) -> None:
        """Refuse facets of interfaces, open or not; collective."""
        index_map = self._mesh.topology.index_map(self._mesh.topology.dim - 1)
        inside = np.zeros(index_map.size_local + index_map.num_ghosts, dtype=bool)
        for selected in self.facets:
            inside[selected.everywhere] = True
        refuse_facets(self._mesh, facets, inside, what, reason)

    def follow(self, u: fem.Function) -> None:
        """Use this displacement for closed facets from now on."""
        for potential in self._potential.values():
            potential.follow(u)

    def area(self, i: int) -> float | None:
        """Area of all facets of interface ``i`` on this rank [mm2; mm in plane strain].

        None if they are open from the start.
        """
        return self._potential[i].area if i in self._potential else None

    def facets_among(self, marks: Sequence[NDArray[np.bool_]]) -> list[InterfaceFacets]:
        """The marked facets of every interface, with masks as in :attr:`open`."""
        return [facets.among(mark) for facets, mark in zip(self.facets, marks, strict=True)]

    def utilization(self) -> Utilization:
        """Utilization of all closed facets at the current displacement; collective."""
        facets = {
            i: np.where(self.open[i][potential.facets.facets], 0.0, potential.utilization())
            for i, potential in self._potential.items()
        }
        here = max((values.max(initial=0.0) for values in facets.values()), default=0.0)
        largest = global_max(self._mesh.comm, float(here)) if facets else 0.0
        return Utilization(facets, largest)

    def marks_to_open(self, utilization: Utilization) -> list[NDArray[np.bool_]]:
        """:attr:`open` with the facets above ``OPENS_WITH_OTHERS``; collective."""
        marks, fdim = list(self.open), self._mesh.topology.dim - 1
        for i, values in utilization.facets.items():
            chosen = self._potential[i].facets.facets[values > OPENS_WITH_OTHERS]
            marks[i] = marks[i] | mark_everywhere(self._mesh, fdim, chosen)
        return marks
