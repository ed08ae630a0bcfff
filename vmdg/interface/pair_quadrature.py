"""Quadrature points on the segments of two surfaces, each with a place in both cells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh, create_interval
from numpy.typing import NDArray
from ufl.algorithms import extract_coefficients
from ufl.constantvalue import Zero
from ufl.core.expr import Expr

from .. import compat
from ..base.kernels import compile_expression
from ..base.parallel import global_any
from ..domain.materials import Bodies
from ..domain.shapes import (
    GeometryMap,
    ShapeGradients,
    determinants,
    reference_facets,
)
from ..forms import kinematics
from ..forms.dilatation import MeanDilatation
from ..forms.geometry import CARTESIAN, GeneralizedPlane, Geometry
from ..forms.kinematics import Body
from .facet_places import FacetPlaces, FacetPolynomials
from .jets import FacetJets
from .pairing import PairedFacets
from .quadrature import (
    Evaluator,
    InterfaceQuadrature,
    SideEvaluators,
    SideExpression,
    bubble_values,
)

Array = NDArray[np.float64]

#: Kinds of segments by their number of corners.
_KINDS = {
    2: basix.CellType.interval,
    3: basix.CellType.triangle,
    4: basix.CellType.quadrilateral,
}

#: Room for points of surfaces that slide, relative to their number, and least number.
_ROOM, _FEW = 2.0, 64

#: Fields of a body at points that facets need.
_FACET_FIELDS = "facet_stress", "facet_moduli", "facet_stretch"

#: Initial gaps below this, relative to the facet, are rounding.
_NO_GAP = 1e-10


class Shifts(NamedTuple):
    """How points of side 1 move within the planes of their segments where side 2 moves by g + h.v
    relative to side 1, v from the point, by components in the plane.

    Attributes:
        place, place_slope: Change of the place by g (nq, d - 1, d - 1), and by h (nq, d - 1, d - 1,
            d - 1).
        area, area_slope: Change of dA, relative to it, by g (nq, d - 1), and by h (nq, d - 1,
            d - 1).
    """

    place: Array
    place_slope: Array
    area: Array
    area_slope: Array


class PairQuadrature(InterfaceQuadrature):
    """The segments of an interface and their quadrature points.

    Point p of side 1 and its partner on side 2 have one projection into the plane of the segment,
    along the normal of the facet of side 1. On quadrilaterals, some of which are triangles with a
    repeated corner, the rule is one of Gauss in each direction.

    Args:
        mesh: The mesh.
        facets: The pairs of facets.
        degree: Degree of the rule.
        geometry: Gradient and measure.
    """

    facets: PairedFacets

    def __init__(
        self, mesh: Mesh, facets: PairedFacets, degree: int, geometry: Geometry = CARTESIAN
    ):
        self.mesh, self.geometry = mesh, geometry
        self.d = mesh.geometry.dim
        self._degree = degree
        corners = facets.segments.corners.shape[1]
        kind = _KINDS[corners]
        self._order = [0, 1, 3, 2] if corners == 4 else list(range(corners))
        rule, self._rule = basix.make_quadrature(kind, degree)
        self._corners, *slopes = basix.ufl.element("Lagrange", kind, 1).tabulate(1, rule)
        self._slopes = np.array(slopes)
        # Products of two displacements are integrated exactly.
        given = len(rule), (degree + 1) // 2
        self._polynomials = [FacetPolynomials(mesh, side, *given) for side in facets.surfaces.sides]
        self.leads = facets.slides
        self._room = -1
        self.take(facets)

    def take(self, facets: PairedFacets, u: fem.Function | None = None) -> bool:
        """Take other pairs; collective.

        Args:
            facets: The pairs.
            u: Displacement in whose configuration they are; None for the reference configuration.

        Returns:
            Whether evaluators and functions of points must be made again: on some rank there are
            more points than room.
        """
        self.facets, segments, d = facets, facets.segments, self.d
        corners = segments.corners[:, self._order]
        plane = self._corners @ corners
        edges = np.einsum("tqc,sck->sqtk", self._slopes, corners)
        areas = np.abs(determinants(edges)) * self._rule
        one, two = (self._places_of(facets, plane, a, u) for a in range(2))
        circumference = self.geometry.circumference
        around = [circumference(np.moveaxis(side.positions, 2, 0)) for side in (one, two)]
        self._places = one.reference, two.reference
        count = areas.size
        self.points = np.zeros((count, 3))
        self.points[:, :d] = one.positions.reshape(-1, d)
        self.weights = (areas * one.stretch * around[0]).ravel()
        self.normal = one.normals.reshape(-1, d)
        ratio = two.stretch * around[1] / (one.stretch * around[0])
        other = two.normals * np.broadcast_to(ratio, areas.shape)[..., None]
        self.outward = np.stack([self.normal, other.reshape(-1, d)])
        self.points_of_facet = np.arange(count, dtype=np.int32).reshape(areas.shape)
        self.facet = np.repeat(np.arange(len(areas), dtype=np.int32), areas.shape[1])
        self.area = self.weights.reshape(areas.shape).sum(axis=1)
        self.extent = facets.extent
        gap = (two.positions - one.positions).reshape(-1, d)
        if facets.surfaces.gaps:
            # Where surfaces slide, a bond spans their distance, as if they touched.
            bonded = (self.facet < facets.bonded)[:, None]
            self.distance = np.where(bonded, 0.0, gap)
            if facets.surfaces.law.has_bond:
                self.initial_gap = np.where(bonded, gap, 0.0)
        else:
            large = np.abs(gap).max(initial=0.0) > _NO_GAP * self.extent.max(initial=0.0)
            # Frames and forms are the same on all ranks, and in all states.
            if self.initial_gap is not None or global_any(self.mesh.comm, large):
                self.initial_gap = gap
        self.__dict__.pop("by_facet", None)
        self._jets: FacetJets | None = None
        self._last: tuple[Array, tuple[Array, Array]] | None = None
        full = global_any(self.mesh.comm, count > self._room)
        if full:
            self._room = max(int(_ROOM * count), _FEW) if facets.slides else max(count, 1)
            # One cell for every point: kernels are evaluated there with its F and N as
            # coefficients.
            self._cells_of_points = create_interval(MPI.COMM_SELF, self._room, [0.0, 1.0])
        return full

    def shifts(self) -> Shifts:
        """How points move with side 2; not with a bond."""
        segments, order, t = self.facets.segments, self._order, self.d - 1
        corners, follows = segments.corners[:, order], segments.follows[:, order]
        follows[: self.facets.bonded] = 0.0
        places = self._corners @ corners
        edges = np.einsum("tqc,sck->sqkt", self._slopes, corners)
        slopes = np.einsum("tqc,sqtk->sqck", self._slopes, np.linalg.inv(edges))
        # Sums over the corners of what follows, and of its products with their places.
        flat = follows.reshape(*follows.shape[:2], t * t)
        both = flat[..., None] * corners[:, :, None]
        shape = *places.shape[:2], t, t
        place = (self._corners @ flat).reshape(shape)
        product = self._corners @ both.reshape(*flat.shape[:2], t**3)
        place_slope = product.reshape(*shape, t) - place[..., None] * places[:, :, None, None]
        grown = np.einsum("sqck,sckl->sqlc", slopes, follows, optimize=True)
        area = grown.sum(axis=3)
        area_slope = grown @ corners[:, None] - area[..., None] * places[:, :, None]
        found = place, place_slope, area, area_slope
        return Shifts(*(array.reshape(-1, *array.shape[2:]) for array in found))

    def _places_of(
        self, facets: PairedFacets, plane: Array, a: int, u: fem.Function | None
    ) -> FacetPlaces:
        """Places on side ``a`` of all points, of leading pairs in the reference configuration."""
        polynomials, segments = self._polynomials[a], facets.segments
        whole = (segments.first, segments.second)[a]
        if not facets.bonded:
            return polynomials.places(whole, segments, plane, u)
        parts = []
        for rows, given in ((slice(0, facets.bonded), None), (slice(facets.bonded, None), u)):
            where = segments.rows(rows)
            parts.append(polynomials.places(whole[rows], where, plane[rows], given))
        return FacetPlaces(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    def space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        """See the base class."""
        return fem.functionspace(self._cells_of_points, ("DG", 0, shape))

    def shapes(self, degree: int) -> list[tuple[Array, Array]]:
        """See the base class."""
        shapes = ShapeGradients(self.mesh, self.geometry, degree)
        sides = zip(self.facets.cells.T, self._places, strict=True)
        return [shapes.in_places(*side) for side in sides]

    def places(self, degree: int) -> tuple[Array, Array]:
        """See the base class."""
        return self._places

    @property
    def kept(self) -> slice:
        """The points that stay in a step: where surfaces slide those of the bond."""
        if not self.facets.slides:
            return slice(None)
        return slice(self.facets.bonded * self.points_of_facet.shape[1])

    def jets(self, space: fem.FunctionSpace) -> FacetJets:
        """B at the points, for a space, always the same."""
        if self._jets is None:
            self._jets = FacetJets(self, space)
        return self._jets

    def field(self, u: fem.Function) -> tuple[Array, Array]:
        """The current displacement on both sides (ns, points, 2, d) [mm], and its entries of GRAD
        (ns, points, 2, entries), without those of a dilatation or of F_33.

        Computed once for all evaluators.

        Args:
            u: The displacement, always the same function.
        """
        if self._last is None or not np.array_equal(self._last[0], u.x.array):
            found = self.jets(u.function_space).of_field(u.x.array.reshape(-1, self.d))
            self._last = u.x.array.copy(), found
        return self._last[1]

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

        def one_side(a: int) -> Evaluator:
            return _PointExpressions(self, u, bodies, a, shape, expression, name, fluid)

        return one_side(0), one_side(1)

    def flux_evaluators(
        self, u: fem.Function, bodies: Bodies, turns: bool, fluid: fem.Function | None
    ) -> SideEvaluators:
        """See the base class."""
        d = self.d
        tractions = self.side_evaluators(
            u,
            bodies,
            (d,),
            lambda body, F, N, a: kinematics.traction(body, F, N),
            "flux",
            fluid=fluid,
        )

        def one_side(a: int) -> Evaluator:
            def evaluate() -> Array:
                displacement, gradient = self.field(u)
                values = [tractions[a](), displacement[:, :, a].reshape(-1, d)]
                if turns:
                    values.append(gradient[:, :, a, : d * d].reshape(-1, d * d))
                return np.hstack(values)

            return evaluate

        return one_side(0), one_side(1)

    def bubble_factors(self) -> Array:
        """See the base class."""
        sides = zip(self.facets.cells.T, self.facets.local.T, strict=True)
        return np.stack([self.bubble_factors_of(*side) for side in sides])

    def bubble_factors_of(self, cells: NDArray[np.int32], local: NDArray[np.int32]) -> Array:
        """The same for facets ``local`` of cells (n,)."""
        return _bubble_factors(self.mesh, self.geometry, self._degree, cells, local)


class _PointExpressions:
    """An expression of the body, F and N at the points of one side, by a kernel for every region.

    Args:
        quadrature: The points.
        u: Displacement, changed by the solver.
        bodies: Materials.
        a: The side, 0 or 1.
        shape: Shape of the expression.
        expression: Of the body, F, N and the side.
        name: Its purpose.
        fluid: Fluid pressure at the points; None for none.
    """

    def __init__(
        self,
        quadrature: PairQuadrature,
        u: fem.Function,
        bodies: Bodies,
        a: int,
        shape: tuple[int, ...],
        expression: SideExpression,
        name: str,
        fluid: fem.Function | None = None,
    ):
        self._quadrature, self._u, self._a = quadrature, u, a
        d = quadrature.d
        n = quadrature.geometry.size(d)
        self._entries = quadrature.geometry.entries(d)
        self._F, self._N = (fem.Function(quadrature.space(s)) for s in ((n, n), (d,)))
        self._region, self._points = bodies.region, bodies.points
        self._size = int(np.prod(shape, dtype=int))
        # Fields on the mesh, and their values at the points.
        self._fields: dict[fem.Function, fem.Function] = {}
        self._parts: list[tuple[int, fem.Expression]] = []
        self._mesh, middle = self._F.function_space.mesh, np.array([[0.5]])
        self._cell_of_point = np.argsort(self._F.function_space.dofmap.list[:, 0]).astype(np.int32)
        used: set[fem.Function] = set()
        here = np.unique(bodies.region[quadrature.facets.surfaces.sides[a].cells])
        for number in np.unique(np.concatenate(quadrature.mesh.comm.allgather(here))):
            body = replace(self._at_points(bodies.regions[number].body), fluid=fluid)
            value = expression(body, ufl.variable(self._F), self._N, a)
            if isinstance(value, Zero):
                continue
            entries = [value[i] for i in np.ndindex(*shape)] if shape else [value]
            vector = ufl.as_vector(entries)
            compiled = compile_expression(vector, middle, quadrature.mesh.comm, name=name)
            self._parts.append((int(number), compiled))
            used.update(extract_coefficients(vector))
        self._fields = {field: there for field, there in self._fields.items() if there in used}

    def _at_points(self, body: Body) -> Body:
        """The body with its parameters, its eigenstrain and the stress on facets at the points."""

        def there(field: fem.Function) -> fem.Function:
            if field not in self._fields:
                self._fields[field] = fem.Function(self._quadrature.space(field.ufl_shape))
            return self._fields[field]

        parameters: Mapping[str, Expr] = {k: there(v) for k, v in body.parameters.items()}
        strain = None if body.eigenstrain is None else there(body.eigenstrain)
        points = body.points
        if points is not None:
            fields = {name: there(getattr(points, name)) for name in _FACET_FIELDS}
            points = replace(points, **fields)
        return replace(body, parameters=parameters, eigenstrain=strain, points=points)

    def _values(self, field: fem.Function, cells: NDArray[np.int32]) -> Array:
        """A field at the points, in their cells (nq, ...)."""
        dofmap = field.function_space.dofmap
        values = field.x.array.reshape(-1, dofmap.index_map_bs)[dofmap.list[cells]]
        if values.shape[1] == 1:
            return values[:, 0]
        places = self._quadrature.places(self._u.function_space.ufl_element().degree)[self._a]
        assert self._points is not None
        basis = self._points.element.tabulate(0, places.reshape(len(cells), -1))[0]
        return np.einsum("pm,pmi->pi", basis, values)

    def __call__(self) -> Array:
        """Values at the points (nq, components)."""
        quadrature, n = self._quadrature, self._F.ufl_shape[0]
        cells = quadrature.facets.cells[quadrature.facet, self._a]
        _, gradients = quadrature.field(self._u)
        F = np.tile(np.eye(n), (len(cells), 1, 1))
        rows, columns = zip(*self._entries, strict=True)
        known = gradients.shape[3]
        F[:, rows[:known], columns[:known]] += gradients[:, :, self._a].reshape(len(F), known)
        if known < len(rows):
            F[:, -1, -1] = _last_entry(quadrature.geometry, cells)
        quadrature.write(self._F, F)
        quadrature.write(self._N, quadrature.outward[self._a])
        for field, function in self._fields.items() if len(cells) else ():
            quadrature.write(function, self._values(field, cells))
        result, region = np.zeros((len(cells), self._size)), self._region[cells]
        for number, expression in self._parts:
            points = np.flatnonzero(region == number)
            values = compat.evaluate(expression, self._mesh, self._cell_of_point[points])
            result[points] = values.reshape(len(points), self._size)
        return result


def _last_entry(geometry: Geometry, cells: NDArray[np.int32]) -> Array | float:
    """The last entry of F on the diagonal where it is no derivative of the displacement: theta of
    cells (n,), or F_33."""
    if isinstance(geometry, MeanDilatation):
        theta = geometry.theta
        return theta.x.array[theta.function_space.dofmap.list[cells, 0]]
    assert isinstance(geometry, GeneralizedPlane)
    return 1.0 + float(geometry.axial.value)


def _bubble_factors(
    mesh: Mesh,
    geometry: Geometry,
    degree: int,
    cells: NDArray[np.int32],
    local: NDArray[np.int32],
) -> Array:
    """(int b_s dA)^2 / int dA of facets ``local`` of cells (n,), see :func:`.bubble_integrals`; the
    area by a rule of this degree."""
    cell = basix.cell.subentity_types(mesh.basix_cell())[mesh.topology.dim - 1][0]
    points, weights = basix.make_quadrature(cell, 3 + 2 * compat.coordinate_element(mesh).degree)
    bubble = bubble_values(cell, points)
    measure = _facet_integrals(mesh, geometry, cells, local, *basix.make_quadrature(cell, degree))
    return _facet_integrals(mesh, geometry, cells, local, points, weights * bubble) ** 2 / measure


def _facet_integrals(
    mesh: Mesh,
    geometry: Geometry,
    cells: NDArray[np.int32],
    local: NDArray[np.int32],
    points: Array,
    weights: Array,
) -> Array:
    """Integrals over facets of cells (n,), by reference points of a facet and their weights."""
    found = np.zeros(len(cells))
    for number, (origin, edges) in enumerate(zip(*reference_facets(mesh), strict=True)):
        chosen = np.flatnonzero(local == number)
        geometry_map = GeometryMap(mesh, origin + points @ edges)
        nodes = geometry_map.nodes(cells[chosen])
        tangents = geometry_map.jacobians(nodes) @ edges.T
        metric = tangents.transpose(0, 1, 3, 2) @ tangents
        around = geometry.circumference(geometry_map.positions(nodes))
        found[chosen] = (np.sqrt(determinants(metric)) * around) @ weights
    return found
