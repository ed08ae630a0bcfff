"""Positions, Jacobians and gradients of shape functions of many cells at reference points."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import basix
import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..base.quadrature import bulk_degree, facet_degree
from ..forms.geometry import Axisymmetric, Geometry

Array = NDArray[np.float64]


def determinants(A: Array) -> Array:
    """Determinants of small matrices (..., d, d), d up to 3.

    numpy computes them by logarithms, whose rounding depends on the unit.
    """
    if A.shape[-1] == 1:
        return A[..., 0, 0]
    if A.shape[-1] == 2:
        return A[..., 0, 0] * A[..., 1, 1] - A[..., 0, 1] * A[..., 1, 0]
    return (A[..., 0, :] * np.cross(A[..., 1, :], A[..., 2, :])).sum(axis=-1)


def reference_facets(mesh: Mesh) -> tuple[Array, Array]:
    """A corner of every reference facet of a cell (facets, d), and the edges from there that span
    it (facets, d - 1, d)."""
    cell, d = mesh.basix_cell(), mesh.geometry.dim
    corners, facets = basix.geometry(cell), basix.topology(cell)[d - 1]
    origins = np.array([corners[nodes[0]] for nodes in facets])
    return origins, np.array([corners[nodes[1:d]] - corners[nodes[0]] for nodes in facets])


@cache
def lagrange(
    cell: str, degree: int, variant: basix.LagrangeVariant = basix.LagrangeVariant.gll_warped
) -> basix.ufl._ElementBase:
    """The Lagrange element of a cell, made once: that takes longer than its values at points."""
    return basix.ufl.element("Lagrange", cell, degree, lagrange_variant=variant)


def coordinate_shapes(mesh: Mesh) -> basix.ufl._ElementBase:
    coordinates = compat.coordinate_element(mesh)
    variant = basix.LagrangeVariant(coordinates.variant)
    return lagrange(mesh.topology.cell_name(), coordinates.degree, variant)


def cell_nodes(mesh: Mesh, cells: NDArray[np.int32] | slice) -> Array:
    """Positions of the nodes of cells (cells, nodes, d) [mm]."""
    return mesh.geometry.x[compat.geometry_dofmap(mesh)[cells]][:, :, : mesh.geometry.dim]


class GeometryMap:
    """The map X(xi) from the reference cell to the cells of a mesh, at some points.

    Attributes:
        values: Its shape functions at the points (points, nodes).
        slopes: Their derivatives (t, points, nodes).
    """

    def __init__(self, mesh: Mesh, points: Array):
        self._mesh = mesh
        self.values, *slopes = coordinate_shapes(mesh).tabulate(1, points)
        self.slopes = np.array(slopes)

    def nodes(self, cells: NDArray[np.int32] | slice) -> Array:
        return cell_nodes(self._mesh, cells)

    def positions(self, nodes: Array) -> Array:
        """X of the points, components first (d, cells, points) [mm]."""
        return np.einsum("qn,cni->icq", self.values, nodes)

    def jacobians(self, nodes: Array) -> Array:
        """dX/dxi of the points (cells, points, d, t) [mm]."""
        return np.einsum("tqn,cni->cqit", self.slopes, nodes, optimize=True)


def places_in_cells(mesh: Mesh, cells: NDArray[np.int32], places: Array) -> tuple[Array, Array]:
    """X (n, points, d) [mm] and dX/dxi (n, points, d, t) at reference points of each cell."""
    return _interpolated(coordinate_shapes(mesh), places, cell_nodes(mesh, cells))


def _interpolated(
    element: basix.ufl._ElementBase, places: Array, nodes: Array
) -> tuple[Array, Array]:
    """Values (n, points, d) and derivatives (n, points, d, t) at reference points of each cell
    (n, points, t), from those at the nodes (n, nodes, d)."""
    values, slopes = _tabulated(element, places)
    return values @ nodes, np.moveaxis(slopes @ nodes, 0, 3)


def _tabulated(element: basix.ufl._ElementBase, places: Array) -> tuple[Array, Array]:
    """Shape functions (n, points, nodes) and derivatives (t, n, points, nodes) at reference points
    of n cells (n, points, t), possibly none."""
    count, points, t = places.shape
    if not count:
        return np.zeros((0, points, element.dim)), np.zeros((t, 0, points, element.dim))
    found = element.tabulate(1, places.reshape(-1, t)).reshape(1 + t, count, points, element.dim)
    return found[0], found[1:]


def displacements_in_cells(
    u: fem.Function, cells: NDArray[np.int32], places: Array
) -> tuple[Array, Array]:
    """u (n, points, d) [mm] and du/dxi (n, points, d, t) at reference points of each cell."""
    space = u.function_space
    cell, degree = space.mesh.topology.cell_name(), space.ufl_element().degree
    at_nodes = u.x.array.reshape(-1, space.dofmap.index_map_bs)[space.dofmap.list[cells]]
    return _interpolated(lagrange(cell, degree), places, at_nodes)


def derivatives_in_cells(
    u: fem.Function, cells: NDArray[np.int32], places: Array
) -> tuple[Array, Array]:
    """X and u with their first and second derivatives in the reference cell (kinds, n, points, d),
    in the order of ``basix.index``, at reference points of each cell.
    """
    space, (count, points, t) = u.function_space, places.shape
    mesh, degree = space.mesh, space.ufl_element().degree
    at_nodes = u.x.array.reshape(-1, space.dofmap.index_map_bs)[space.dofmap.list[cells]]
    found = []
    for element, nodes in (
        (coordinate_shapes(mesh), cell_nodes(mesh, cells)),
        (lagrange(mesh.topology.cell_name(), degree), at_nodes),
    ):
        shape = (t + 1) * (t + 2) // 2, count, points, element.dim
        table = element.tabulate(2, places.reshape(-1, t)) if count else np.zeros(shape)
        found.append(table.reshape(shape) @ nodes)
    return found[0], found[1]


class FacetShapes(NamedTuple):
    """Shape functions at the points of facets of cells."""

    gradients: Array  # GRAD (n, points, nodes, d or d + 1)
    weights: Array  # Quadrature weights (n, points)
    points: Array  # X (n, points, d) [mm]

    def at(self, positions: Array) -> FacetShapes:
        """The same with the points of each facet in the order of positions X (n, points, d) [mm].

        DOLFINx 0.10 and later order the points of a facet by its orientation in the mesh.
        """
        apart = np.linalg.norm(self.points[:, None] - positions[:, :, None], axis=3)
        order = apart.argmin(axis=2)
        rows = np.arange(len(order))[:, None]
        return FacetShapes(*(array[rows, order] for array in self))


#: Way to the centre of a facet by which its ends are left, relative to the facet.
_INSIDE = 1e-8


class ShapeGradients:
    """Gradients of the shape functions where the forms integrate over cells and their facets.

    In axisymmetry a column N_a / r follows the derivatives of a shape function N_a, for the hoop
    entry of GRAD, and the weights count the circumference.

    Args:
        in_pieces: Whether forms integrate over pieces of facets, with points at their ends or not.
            In a distorted quadrilateral a flux h is a rational function, and its square may be
            largest at a corner of the cell: the integral over pieces is then between that by the
            points of Gauss of the whole facet and that by points of Lobatto, its corners among
            them, which are taken.
    """

    def __init__(self, mesh: Mesh, geometry: Geometry, degree: int, in_pieces: bool = False):
        self._mesh = mesh
        self._geometry = geometry
        cell, d = mesh.basix_cell(), mesh.geometry.dim
        self.bulk_points, self._bulk_weights = basix.make_quadrature(
            cell, bulk_degree(mesh.topology.cell_name(), degree, geometry)
        )
        facet = basix.cell.subentity_types(cell)[d - 1][0]
        lobatto = in_pieces and facet != basix.CellType.triangle
        rule = basix.QuadratureType.gll if lobatto else basix.QuadratureType.default
        self.facet_points, self._facet_weights = basix.make_quadrature(
            facet, facet_degree(degree), rule=rule
        )
        self._shape = lagrange(mesh.topology.cell_name(), degree)
        self.nodes_of_cell = self._shape.dim
        self._hoop = isinstance(geometry, Axisymmetric)
        if lobatto and self._hoop:  # next to the axis: moduli of forms have u_r/r
            centre = self.facet_points.mean(axis=0)
            self.facet_points += _INSIDE * (centre - self.facet_points)
        self._origins, self._edges = reference_facets(mesh)

    def in_places(self, cells: NDArray[np.int32], places: Array) -> tuple[Array, Array]:
        """The shape functions (cells, points, nodes) and their GRAD at reference points of each
        cell (cells, points, d)."""
        X, J = places_in_cells(self._mesh, cells, places)
        values, of_reference = _tabulated(self._shape, places)
        gradients = np.moveaxis(of_reference, 0, 3) @ np.linalg.inv(J)
        if self._hoop:
            # On the axis u_r/r has the limit u_r,r.
            off = X[..., :1] > self._geometry.axis
            hoop = np.where(off, values / np.where(off, X[..., :1], 1.0), gradients[..., 0])
            gradients = np.concatenate([gradients, hoop[..., None]], axis=3)
        return values, gradients

    def in_cells(self, cells: NDArray[np.int32]) -> tuple[Array, Array]:
        """GRAD of the shape functions and weights (cells, points) in cells."""
        geometry_map = GeometryMap(self._mesh, self.bulk_points)
        nodes = geometry_map.nodes(cells)
        J, X = geometry_map.jacobians(nodes), geometry_map.positions(nodes)
        shape, *slopes = self._shape.tabulate(1, self.bulk_points)
        gradients = np.einsum("tqn,cqti->cqni", np.array(slopes), np.linalg.inv(J), optimize=True)
        if self._hoop:
            hoop = (shape / X[0][..., None])[..., None]
            gradients = np.concatenate([gradients, hoop], axis=3)
        around = self._geometry.circumference(X)
        return gradients, np.abs(determinants(J)) * around * self._bulk_weights

    def on_facets(self, cells: NDArray[np.int32], local: NDArray[np.int32]) -> FacetShapes:
        """The same on facet ``local`` of every cell."""
        edges = self._edges[local]
        places = self._origins[local][:, None] + self.facet_points @ edges
        X, J = places_in_cells(self._mesh, cells, places)
        tangents = J @ edges[:, None].swapaxes(2, 3)
        around = self._geometry.circumference(np.moveaxis(X, 2, 0))
        metric = np.sqrt(determinants(tangents.swapaxes(2, 3) @ tangents))
        weights = metric * around * self._facet_weights
        return FacetShapes(self.in_places(cells, places)[1], weights, X)
