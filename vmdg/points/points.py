"""Values at the quadrature points of interface facets, as numpy arrays and as Functions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh, create_mesh
from numpy.typing import NDArray
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants
from ufl.constantvalue import Zero
from ufl.core.expr import Expr

from .. import compat
from ..base.kernels import PointKernel
from ..domain.materials import Bodies
from ..domain.shapes import (
    GeometryMap,
    ShapeGradients,
    determinants,
    places_in_cells,
    reference_facets,
)
from ..forms.dilatation import MeanDilatation
from ..forms.geometry import CARTESIAN, GeneralizedPlane, Geometry
from ..forms.kinematics import Body
from .facets import InterfaceFacets
from .jets import FacetJets

Array = NDArray[np.float64]

#: Fields of a body at points that facets need.
_FACET_FIELDS = "facet_stress", "facet_moduli", "facet_stretch"

#: Returns values at the points on side 1 and on side 2 (2, nq, components).
Evaluator = Callable[[], Array]

#: expression(body, F, N) of one side.
SideExpression = Callable[[Body, Expr, Expr], Expr]


class Points:
    """The points of an interface, each with a place in the cells of both sides.

    All arrays have one row per point on the facets this rank owns, so history needs no
    communication.
    """

    mesh: Mesh
    facets: InterfaceFacets  # Facets of the interface, or the segments that take their place
    degree: int
    d: int
    geometry: Geometry
    points: NDArray[np.float64]  # Reference positions, of side 1 (nq, 3) [mm]
    # Reference area of the points (nq,) [mm2; mm in plane strain]; of the full circle, 2 pi r ds,
    # in axisymmetry
    weights: NDArray[np.float64]
    # Reference normal of the law, outward from side 1 (nq, d); that of side 2, reversed, where this
    # side leads
    normal: NDArray[np.float64]
    outward: NDArray[np.float64]  # Outward normals N_1, and N_2 dS_2/dS_1 = -M_2 (2, nq, d)
    facet: NDArray[np.int32]  # Index of the point's facet in ``facets.facets`` (nq,)
    points_of_facet: NDArray[np.int32]  # Points of every facet (nf, points per facet)
    area: NDArray[np.float64]  # Sum of the weights of every facet (nf,)
    # Length of the facets, in 3D the square root of their area (nf,) [mm]
    extent: NDArray[np.float64]
    # Position on side 2 minus that on side 1 where it is no opening (nq, d) [mm]; None where they
    # coincide
    initial_gap: NDArray[np.float64] | None = None
    distance: NDArray[np.float64] | None = None  # The same where it is one; None for no such points
    leads: Array  # Shares of both sides in the F of the frame of the law (nq, 2)

    @property
    def kept(self) -> slice:
        return slice(None)

    @property
    def stretch(self) -> Array:
        """rho = dS_2/dS_1 of every facet, the largest of its points (nf,)."""
        return np.linalg.norm(self.outward[1], axis=1)[self.points_of_facet].max(axis=1)

    def _take_places(self, one: Array, two: Array, room: int | None = None) -> None:
        """Take positions of the points in the reference cells of both sides (nf, points, d), with
        room for so many points if it changes."""
        self._places = one, two
        self._jets: FacetJets | None = None
        self._last: tuple[Array, tuple[Array, Array]] | None = None
        self.taken = object()  # another one for other points
        if room is not None:
            # One cell for every point and side: kernels are evaluated there with F and N as
            # coefficients.
            self._cells_of_points = _intervals(2 * max(room, 1), self.d)
            self._spaces: dict[tuple[int, ...], fem.FunctionSpace] = {}
            n, d = self.geometry.size(self.d), self.d
            self.F, self.N = (fem.Function(self.space(shape)) for shape in ((n, n), (d,)))
        self.write(self.N, self.outward)

    def leading(self, gradients: Array) -> Array:
        """GRAD u of the frame of the law (nq, d, d), from entries of both sides
        (nf, points, 2, entries)."""
        d = self.d
        both = gradients[..., : d * d].reshape(-1, 2, d * d)
        return np.einsum("pa,pae->pe", self.leads, both).reshape(-1, d, d)

    def space(self, shape: tuple[int, ...]) -> fem.FunctionSpace:
        """Space of values of the given shape at every point, (44)-(45), on side 1 and then on side
        2; its dofs are numbered like the points."""
        if shape not in self._spaces:
            self._spaces[shape] = fem.functionspace(self._cells_of_points, ("DG", 0, shape))
        return self._spaces[shape]

    @staticmethod
    def write(function: fem.Function, values: Array) -> None:
        """Set a function of :meth:`space` to values at the points of both sides (2, nq, ...)."""
        function.x.array[: values.size] = values.ravel()

    def shapes(self, degree: int) -> list[tuple[Array, Array]]:
        """On both sides the shape functions (nf, points, nodes) and their gradients (nf, points,
        nodes, d or d + 1), N/r last."""
        shapes = ShapeGradients(self.mesh, self.geometry, degree)
        sides = zip(self.facets.cells.T, self._places, strict=True)
        return [shapes.in_places(*side) for side in sides]

    def places(self) -> tuple[Array, Array]:
        """Positions of the points in the reference cells of both sides (nf, points, d)."""
        return self._places

    def jets(self, space: fem.FunctionSpace) -> FacetJets:
        """B at the points, for a space."""
        if self._jets is None or self._jets.space is not space:
            self._last = None
            shapes = self.shapes(space.ufl_element().degree)
            self._jets = FacetJets(space, self.geometry, self.facets, shapes)
        return self._jets

    def field(self, u: fem.Function) -> tuple[Array, Array]:
        """The current displacement on both sides (ns, points, 2, d) [mm], and its entries of GRAD
        (ns, points, 2, entries), with the mean of a periodic cell, without a dilatation or F_33.

        Computed once for all evaluators.
        """
        mean = getattr(self.geometry, "macroscopic", None)
        known = u.x.array
        if mean is not None:
            known = np.concatenate([known, mean.value.ravel()])
        if self._last is None or not np.array_equal(self._last[0], known):
            found = self.jets(u.function_space).of_field(u.x.array.reshape(-1, self.d))
            if mean is not None:
                found[1][..., : self.d**2] += mean.value.ravel()
            self._last = known.copy(), found
            self._write_deformations(found[1])
        return self._last[1]

    def _write_deformations(self, gradients: Array) -> None:
        """Set F of both sides from entries of GRAD u (nf, points, 2, entries)."""
        size = self.geometry.size(self.d)
        rows, columns = np.transpose(self.geometry.entries(self.d))[:, : gradients.shape[3]]
        at = size * rows + columns
        F = np.tile(np.eye(size).ravel(), (2, len(self.facet), 1))
        entries = gradients.reshape(len(self.facet), 2, len(rows)).swapaxes(0, 1)
        # In order, but for the hoop.
        F[:, :, slice(len(at)) if size == self.d else at] += entries
        self.write(self.F, F)

    def evaluator(
        self,
        u: fem.Function,
        bodies: Bodies,
        shape: tuple[int, ...],
        expression: SideExpression,
        name: str,
        fluid: fem.Function | None = None,
    ) -> Evaluator:
        """Evaluator of ``expression(body, F, N)`` on both sides.

        N is the outward normal of each side; where the areas of the sides differ, that of side 2 is
        its area per area of side 1.
        """
        return _PointExpressions(self, u, bodies, shape, expression, name, fluid)

    def bubble_factors(self) -> Array:
        """(int_gamma b_s dA)^2 / meas(gamma) of (21) on the facets of both sides (2, nf) [mm2; mm
        in plane strain]."""
        sides = zip(self.facets.cells.T, self.facets.local.T, strict=True)
        return np.stack([self.bubble_factors_of(*side) for side in sides])

    def bubble_factors_of(self, cells: NDArray[np.int32], local: NDArray[np.int32]) -> Array:
        """The same for facets ``local`` of cells (n,)."""
        return _bubble_factors(self.mesh, self.geometry, self.degree, cells, local)


class FacetPoints(Points):
    """The quadrature points of facets between cells that match."""

    def __init__(
        self, mesh: Mesh, facets: InterfaceFacets, degree: int, geometry: Geometry = CARTESIAN
    ):
        self.mesh, self.facets, self.degree, self.geometry = mesh, facets, degree, geometry
        self.d = d = mesh.geometry.dim
        facet = basix.cell.subentity_types(mesh.basix_cell())[d - 1][0]
        rule, weights = basix.make_quadrature(facet, degree)
        origins, edges = reference_facets(mesh)
        one, two = (origins[side][:, None] + rule @ edges[side] for side in facets.local.T)
        X, J = places_in_cells(mesh, facets.cells[:, 0], one)
        # The points of side 2 in the order of those of side 1.
        other = places_in_cells(mesh, facets.cells[:, 1], two)[0]
        order = np.linalg.norm(other[:, None] - X[:, :, None], axis=3).argmin(axis=2)
        two = np.take_along_axis(two, order[..., None], axis=1)
        tangents = J @ edges[facets.local[:, 0], None].swapaxes(2, 3)
        metric = tangents.swapaxes(2, 3) @ tangents
        areas = np.sqrt(determinants(metric)) * weights
        outward = basix.cell.facet_outward_normals(mesh.basix_cell())[facets.local[:, 0]]
        N = np.einsum("fqji,fj->fqi", np.linalg.inv(J), outward).reshape(-1, d)
        self.normal = N / np.linalg.norm(N, axis=1, keepdims=True)
        self.outward = np.stack([self.normal, -self.normal])
        self.leads = np.full((len(N), 2), 0.5)
        self.points = np.zeros((areas.size, 3))
        self.points[:, :d] = X.reshape(-1, d)
        self.weights = areas.ravel() * geometry.circumference(self.points.T)
        self.points_of_facet = np.arange(areas.size, dtype=np.int32).reshape(areas.shape)
        self.facet = np.repeat(np.arange(len(areas), dtype=np.int32), areas.shape[1])
        self.area = self.weights.reshape(areas.shape).sum(axis=1)
        self.extent = areas.sum(axis=1) ** (1 / (d - 1))
        self._take_places(one, two, areas.size)


class _PointExpressions:
    """An expression of the body, F and N at the points of both sides, with a kernel for every
    region."""

    def __init__(
        self,
        quadrature: Points,
        u: fem.Function,
        bodies: Bodies,
        shape: tuple[int, ...],
        expression: SideExpression,
        name: str,
        fluid: fem.Function | None,
    ):
        self._quadrature, self._u, self._fluid = quadrature, u, fluid
        self._region, self._points = bodies.region, bodies.points
        self._size = int(np.prod(shape, dtype=int))
        # Fields on the mesh, and their values at the points.
        self._fields: dict[fem.Function, fem.Function] = {}
        self._constants: list[tuple[fem.Constant, fem.Constant]] = []
        self._parts: list[tuple[int, PointKernel]] = []
        self._taken: object = None
        F, N = quadrature.F, quadrature.N
        # The last entry of F on the diagonal may be no derivative of the displacement.
        self._free_entry = isinstance(quadrature.geometry, MeanDilatation | GeneralizedPlane)
        used: set[fem.Function] = set()
        cells = np.concatenate([quadrature.facets.cells_of(a) for a in (0, 1)])
        here = np.unique(bodies.region[cells])
        for number in np.unique(np.concatenate(quadrature.mesh.comm.allgather(here))):
            body = self._at_points(bodies.regions[number].body)
            body = replace(body, fluid=None if fluid is None else self._there(fluid))
            value = expression(body, ufl.variable(F), N)
            if isinstance(value, Zero):
                continue
            entries = [value[i] for i in np.ndindex(*shape)] if shape else [value]
            vector = self._moved(ufl.as_vector(entries))
            kernel = PointKernel(vector, quadrature.mesh.comm, name)
            self._parts.append((int(number), kernel))
            used.update(kernel.fields)
        self._fields = {field: there for field, there in self._fields.items() if there in used}

    def _there(self, field: fem.Function) -> fem.Function:
        if field not in self._fields:
            self._fields[field] = fem.Function(self._quadrature.space(field.ufl_shape))
        return self._fields[field]

    def _moved(self, vector: Expr) -> Expr:
        """An expression with the Constants and Functions of a user's energy at the points."""
        mesh, there = self._quadrature.mesh.ufl_domain(), self._quadrature.F
        given: dict[Expr, Expr] = {}
        for constant in extract_constants(vector):
            if constant.ufl_domain() == mesh:
                given[constant] = fem.Constant(there.function_space.mesh, constant.value)
        self._constants += given.items()
        for field in extract_coefficients(vector):
            if field.ufl_function_space().ufl_domain() == mesh:
                given[field] = self._there(field)
        return ufl.replace(vector, given) if given else vector

    def _at_points(self, body: Body) -> Body:
        """The body with its parameters, its eigenstrain and the stress on facets at the points."""
        there = self._there
        parameters: Mapping[str, Expr] = {k: there(v) for k, v in body.parameters.items()}
        strain = None if body.eigenstrain is None else there(body.eigenstrain)
        points = body.points
        if points is not None:
            fields = {name: there(getattr(points, name)) for name in _FACET_FIELDS}
            points = replace(points, **fields)
        return replace(body, parameters=parameters, eigenstrain=strain, points=points)

    def _values(self, field: fem.Function, cells: NDArray[np.int32]) -> Array:
        """A field at the points of both sides, in their cells (2 nq, ...)."""
        if field is self._fluid:
            return np.tile(field.x.array[: len(cells) // 2], 2)
        dofmap = field.function_space.dofmap
        values = field.x.array.reshape(-1, dofmap.index_map_bs)[dofmap.list[cells]]
        if values.shape[1] == 1:
            return values[:, 0]
        if not len(cells):  # basix has no values at no points
            return values[:, 0]
        bodies = self._points
        own = bodies and any(field is getattr(bodies.fields, name) for name in _FACET_FIELDS)
        element = bodies.element if own else field.function_space.element.basix_element
        places = [side.reshape(-1, self._quadrature.d) for side in self._quadrature.places()]
        basis = element.tabulate(0, np.concatenate(places))[0]
        return np.einsum("pm,pmi->pi", basis.reshape(len(cells), -1), values)

    def _take_points(self) -> None:
        quadrature, self._taken = self._quadrature, self._quadrature.taken
        self._cells = quadrature.facets.cells[quadrature.facet].T.ravel()
        gap = quadrature.initial_gap if quadrature.distance is None else quadrature.distance
        X = quadrature.points
        self._X = np.concatenate([X, X])
        if gap is not None:
            self._X[len(X) :, : quadrature.d] += gap
        region = self._region[self._cells]
        self._rows = [np.flatnonzero(region == number) for number, _ in self._parts]

    def __call__(self) -> Array:
        quadrature = self._quadrature
        if self._taken is not quadrature.taken:
            self._take_points()
        cells, F, X = self._cells, quadrature.F, self._X
        quadrature.field(self._u)
        if self._free_entry:
            entry = _last_entry(quadrature.geometry, cells)
            F.x.array.reshape(-1, *F.ufl_shape)[: len(cells), -1, -1] = entry
        for field, function in self._fields.items() if len(cells) else ():
            quadrature.write(function, self._values(field, cells))
        for given, there in self._constants:
            there.value = given.value
        if len(self._parts) == 1 and len(self._rows[0]) == len(cells):
            result = self._parts[0][1](slice(len(cells)), X)
        else:
            result = np.zeros((len(cells), self._size))
            for (_, kernel), rows in zip(self._parts, self._rows, strict=True):
                result[rows] = kernel(rows, X)
        return result.reshape(2, -1, self._size)


def _intervals(count: int, d: int) -> Mesh:
    """A mesh of this process alone with one cell for every point, in the space of the bodies, so
    that the energies of users find their dimension; the kernels are given the positions."""
    cells = np.arange(2 * count, dtype=np.int64).reshape(count, 2)
    x = np.zeros((2 * count, d))
    x[:, 0] = np.arange(2 * count)
    element = basix.ufl.element("Lagrange", "interval", 1, shape=(d,))
    return create_mesh(MPI.COMM_SELF, cells, x=x, e=ufl.Mesh(element))


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


def bubble_values(cell: basix.CellType, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """b_s at reference points (n, d - 1) of a facet (n,)."""
    if cell == basix.CellType.triangle:
        return 27 * points[:, 0] * points[:, 1] * (1 - points.sum(axis=1))
    return np.prod(4 * points * (1 - points), axis=1)
