"""Values at the quadrature points of interface facets, as numpy arrays and as Functions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cached_property

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from ufl.constantvalue import Zero
from ufl.core.expr import Expr

from .. import compat
from ..base.kernels import compile_form
from ..domain.materials import Bodies
from ..domain.shapes import FacetShapes, GeometryMap, ShapeGradients, determinants
from ..forms import kinematics
from ..forms.geometry import CARTESIAN, Geometry
from ..forms.kinematics import Body
from .facets import InterfaceFacets

#: Returns values at the facet points of one side (number of points, number of components).
Evaluator = Callable[[], NDArray[np.float64]]

#: Of side 1 and side 2.
SideEvaluators = tuple[Evaluator, Evaluator]

#: expression(body, F, N, side).
SideExpression = Callable[[Body, Expr, Expr, int], Expr]


class InterfaceQuadrature:
    """The points of an interface; all arrays have one row per point.

    Attributes:
        mesh: The mesh.
        facets: Facets of the interface, or the segments that take their place.
        d: Dimension.
        geometry: Gradient and measure.
        points: Reference positions, of side 1 (nq, 3) [mm].
        weights: Reference area of the points (nq,) [mm2; mm in plane strain]; of the full circle, 2
            pi r ds, in axisymmetry.
        normal: Reference normal outward from side 1 (nq, d).
        outward: Outward normals N_1, and N_2 dS_2/dS_1 = -M_2 (2, nq, d).
        facet: Index of the point's facet in ``facets.facets`` (nq,).
        points_of_facet: Points of every facet (nf, points per facet).
        area: Sum of the weights of every facet (nf,).
        extent: Length of the facets, in 3D the square root of their area (nf,) [mm].
        initial_gap: Position on side 2 minus that on side 1 where it is no opening (nq, d) [mm];
            None where they coincide.
        distance: The same where it is one; None for no such points.
        leads: Whether the frame of the law is that of side 1, not the mean of both.
    """

    mesh: Mesh
    facets: InterfaceFacets
    d: int
    geometry: Geometry
    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    normal: NDArray[np.float64]
    outward: NDArray[np.float64]
    facet: NDArray[np.int32]
    points_of_facet: NDArray[np.int32]
    area: NDArray[np.float64]
    extent: NDArray[np.float64]
    initial_gap: NDArray[np.float64] | None = None
    distance: NDArray[np.float64] | None = None
    leads: bool = False

    @property
    def kept(self) -> slice:
        """The points that stay in a step."""
        return slice(None)

    @cached_property
    def by_facet(self) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
        """Points of all segments of every distinct facet (n, most points of one), and their
        weights, zero where a facet has fewer."""
        rows, where = self.facets.distinct
        facet = where[self.facet]
        order = np.argsort(facet, kind="stable").astype(np.int32)
        counts = np.bincount(facet, minlength=len(rows))
        slots = np.arange(counts.max(initial=0))
        exists = slots < counts[:, None]
        points = np.zeros(exists.shape, dtype=np.int32)
        points[exists] = order
        return points, np.where(exists, self.weights[points], 0.0)

    def facet_means(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Means over the distinct facets, (n, ...) of values at the points (nq, ...), weighted by
        area."""
        points, weights = self.by_facet
        integral = np.einsum("fp,fp...->f...", weights, values[points])
        return (integral.T / weights.sum(axis=1)).T

    def space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        """Space of values of the given shape at every point, (44)-(45); its dofs are numbered like
        the points."""
        raise NotImplementedError

    @staticmethod
    def write(function: fem.Function, values: NDArray[np.float64]) -> None:
        """Set a function of :meth:`space` to values at the points (nq, ...)."""
        function.x.array[: values.size] = values.ravel()

    def shapes(self, degree: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """On both sides the shape functions (nf, points, nodes) and their gradients (nf, points,
        nodes, d or d + 1), N/r last."""
        raise NotImplementedError

    def places(self, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Positions of the points in the reference cells of both sides (nf, points, d).

        Args:
            degree: Degree of the displacement.
        """
        raise NotImplementedError

    def side_evaluators(
        self,
        u: fem.Function,
        bodies: Bodies,
        shape: tuple[int, ...],
        expression: SideExpression,
        name: str,
        fluid: fem.Function | None = None,
    ) -> SideEvaluators:
        """Evaluators of ``expression(body, F, N, side)`` on both sides.

        N is the outward normal of each side; where the areas of the sides differ, that of side 2 is
        its area per area of side 1.

        Args:
            u: Displacement, changed by the solver.
            bodies: Materials.
            shape: Shape of the expression.
            expression: Of the body, F, N and the side, 0 or 1.
            name: Its purpose.
            fluid: Fluid pressure at the points; None for none.
        """
        raise NotImplementedError

    def flux_evaluators(
        self, u: fem.Function, bodies: Bodies, turns: bool, fluid: fem.Function | None
    ) -> SideEvaluators:
        """Evaluators of P.N, u and, where the frame of the law turns, of GRAD u in the section."""
        raise NotImplementedError

    def bubble_factors(self) -> NDArray[np.float64]:
        """(int_gamma b_s dA)^2 / meas(gamma) of (21) on the facets of both sides (2, nf).

        [mm2; mm in plane strain].
        """
        raise NotImplementedError


class FacetQuadrature(InterfaceQuadrature):
    """The facet submesh of an interface and its quadrature points.

    Points are numbered like the dofs of the quadrature space; all arrays have one row per point on
    the facets this rank owns, so history needs no communication.
    """

    def __init__(
        self,
        mesh: Mesh,
        facets: InterfaceFacets,
        degree: int,
        geometry: Geometry = CARTESIAN,
    ):
        self.mesh = mesh
        self.facets = facets
        self.degree = degree
        self.geometry = geometry
        self.submesh = compat.facet_submesh(mesh, facets.facets)
        sub = self.submesh.mesh
        self.d = mesh.geometry.dim
        self._cell = sub.basix_cell()
        # Cell of the submesh for facet f of the interface.
        count = sub.topology.index_map(sub.topology.dim).size_local
        position = np.searchsorted(facets.facets, self.submesh.facets[:count])
        self.cell_of_facet = np.argsort(position).astype(np.int32)
        self._scalar = self.space(())
        dofs = self._scalar.dofmap.list[:count]
        self.facet = np.empty(dofs.size, dtype=np.int32)
        self.facet[dofs] = position[:, None]
        self.points_of_facet = dofs[self.cell_of_facet]

        N, X = ufl.FacetNormal(mesh), ufl.SpatialCoordinate(mesh)
        parts = [(0, np.ones(len(facets.facets), dtype=bool), ufl.as_vector([1, *N, *X]))]
        # Weights of the points on the mesh, by which evaluators divide; 1 until they are known.
        self._weights = np.ones(dofs.size)
        integrals = self.evaluator((1 + 2 * self.d,), parts)()
        self._weights = integrals[:, 0].copy()
        self.normal = integrals[:, 1 : 1 + self.d] / self._weights[:, None]
        self.normal /= np.linalg.norm(self.normal, axis=1, keepdims=True)
        self.outward = np.stack([self.normal, -self.normal])
        self.points = np.zeros((dofs.size, 3))
        self.points[:, : self.d] = integrals[:, 1 + self.d :] / self._weights[:, None]
        self.weights = self._weights * geometry.circumference(self.points.T)
        self.area = np.bincount(self.facet, self.weights, minlength=len(facets.facets))
        measure = np.bincount(self.facet, self._weights, minlength=len(facets.facets))
        self.extent = measure ** (1 / (self.d - 1))

    def space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        """Space of values of the given shape at every point, (44)-(45)."""
        element = basix.ufl.quadrature_element(self._cell, value_shape=shape, degree=self.degree)
        return fem.functionspace(self.submesh.mesh, element)

    def facet_space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        """Space of facet-wise constant values of the given shape."""
        return fem.functionspace(self.submesh.mesh, ("DG", 0, shape))

    def set_facet_values(self, function: fem.Function, values: NDArray) -> None:
        """Write one value per facet (nf, ...) into a function of :meth:`facet_space`."""
        dofmap = function.function_space.dofmap
        dofs = dofmap.list[self.cell_of_facet, 0]
        size = dofmap.index_map_bs  # not -1: a rank may have no facet
        function.x.array.reshape(-1, size)[dofs] = values.reshape(-1, size)

    def evaluator(
        self,
        shape: tuple[int, ...],
        parts: Sequence[tuple[int, NDArray[np.bool_], Expr]],
        name: str = "facet points",
    ) -> Evaluator:
        """Make an evaluator of one-sided expressions of the given shape.

        Expressions are integrated against the test function of each point and divided by its
        weight, so any expression that FFCx compiles can be evaluated, with one kernel for both
        sides.

        Args:
            shape: Shape of the expressions.
            parts: (side 0 or 1, facets of the interface, expression on them).
            name: Its purpose.
        """
        space = self.space(shape)
        test = ufl.TestFunction(space)
        forms = []
        for side, select, expression in parts:
            if isinstance(expression, Zero):
                continue
            rows = [(0, self.facets.side(side, select))]
            ds = ufl.Measure(
                "ds",
                domain=self.mesh,
                subdomain_data=rows,
                subdomain_id=0,
                metadata={"quadrature_degree": self.degree, "quadrature_rule": "default"},
            )
            integrand = ufl.inner(test, expression) * ds
            forms.append(compile_form(integrand, [self.submesh], self.mesh.comm, name=name))
        imap, bs = space.dofmap.index_map, space.dofmap.index_map_bs
        weights = self._weights[:, None]

        def evaluate() -> NDArray[np.float64]:
            result = np.zeros((imap.size_local + imap.num_ghosts) * bs)
            for form in forms:
                fem.assemble_vector(result, form)
            return result[: imap.size_local * bs].reshape(-1, bs) / weights

        return evaluate

    def shapes(self, degree: int) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """See the base class."""
        return [(side.values, side.gradients) for side in self._on_facets(degree)]

    def places(self, degree: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """See the base class."""
        one, two = self._on_facets(degree)
        return one.reference, two.reference

    def _on_facets(self, degree: int) -> list[FacetShapes]:
        facets, shapes = self.facets, ShapeGradients(self.mesh, self.geometry, degree)
        places = self.points[self.points_of_facet][..., : self.d]
        sides = zip(facets.cells.T, facets.local.T, strict=True)
        return [shapes.on_facets(*side).at(places) for side in sides]

    def side_evaluators(
        self,
        u: fem.Function,
        bodies: Bodies,
        shape: tuple[int, ...],
        expression: SideExpression,
        name: str,
        fluid: fem.Function | None = None,
    ) -> SideEvaluators:
        """See the base class."""
        N = ufl.FacetNormal(self.mesh)
        pairs = region_pairs(self.facets, bodies, self.mesh.comm)

        def one_side(a: int) -> Evaluator:
            parts = []
            for number in np.unique(pairs[:, a]):
                F = ufl.variable(self.geometry.deformation(u))
                select = bodies.region[self.facets.cells[:, a]] == number
                body = replace(bodies.regions[number].body, fluid=fluid)
                parts.append((a, select, expression(body, F, N, a)))
            return self.evaluator(shape, parts, name=name)

        return one_side(0), one_side(1)

    def flux_evaluators(
        self, u: fem.Function, bodies: Bodies, turns: bool, fluid: fem.Function | None
    ) -> SideEvaluators:
        """See the base class."""
        d = self.d
        size = 2 * d + d * d if turns else 2 * d

        def flux(body: Body, F: Expr, N: Expr, a: int) -> Expr:
            values = [*kinematics.traction(body, F, N), *u]
            if turns:
                gradient = self.geometry.section_gradient(u)
                values += [gradient[i, j] for i in range(d) for j in range(d)]
            return ufl.as_vector(values)

        return self.side_evaluators(u, bodies, (size,), flux, "flux", fluid=fluid)

    def bubble_factors(self) -> NDArray[np.float64]:
        """See the base class."""
        factor = bubble_integrals(self) ** 2 / self.area
        return np.stack([factor, factor])


def region_pairs(facets: InterfaceFacets, bodies: Bodies, comm: MPI.Comm) -> NDArray[np.int32]:
    """Pairs of material regions on the two sides of a facet on any rank, (number of pairs, 2)."""
    pairs = comm.allgather(np.unique(bodies.region[facets.cells], axis=0))
    return np.unique(np.concatenate(pairs), axis=0)


def bubble_integrals(quadrature: FacetQuadrature) -> NDArray[np.float64]:
    """int_gamma b_s dA of (21) for every facet, (nf,) [mm2; mm in plane strain].

    On the facet b_s is 4 x (1 - x) per direction, or 27 l_1 l_2 l_3 on a triangle; the geometry may
    be curved or warped. In axisymmetry dA = 2 pi r ds.
    """
    sub = quadrature.submesh.mesh
    cell = sub.basix_cell()
    points, weights = basix.make_quadrature(cell, 3 + 2 * compat.coordinate_element(sub).degree)
    bubble = bubble_values(cell, points)
    geometry_map = GeometryMap(sub, points)
    nodes = geometry_map.nodes(quadrature.cell_of_facet)
    tangents = np.einsum("tqn,fnd->fqdt", geometry_map.slopes, nodes)
    metric = np.einsum("fqds,fqdt->fqst", tangents, tangents)
    around = quadrature.geometry.circumference(geometry_map.positions(nodes))
    return (np.sqrt(determinants(metric)) * around) @ (weights * bubble)


def bubble_values(cell: basix.CellType, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """b_s at reference points (n, d - 1) of a facet (n,)."""
    if cell == basix.CellType.triangle:
        return 27 * points[:, 0] * points[:, 1] * (1 - points.sum(axis=1))
    return np.prod(4 * points * (1 - points), axis=1)
