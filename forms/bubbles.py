"""Facet bubbles b_s of (17), one function per facet of a cell, and the integrand of (22).

triangle 4 l_a l_b, tetrahedron 27 l_a l_b l_c (l the barycentric coordinates of the facet's
vertices), quadrilateral 4 x (1 - x) (1 - y), hexahedron 16 x (1 - x) y (1 - y) (1 - z) for the
facet at y = 0, z = 0; one at the midpoint of the facet, zero on the other facets of the cell.
"""

from __future__ import annotations

import basix
import basix.ufl
import numpy as np
import ufl
from numpy.typing import NDArray
from ufl.core.expr import Expr

from .geometry import Geometry
from .kinematics import Body, acoustic_tensor

# Degree of the polynomial set that holds the bubbles: total for simplices, per direction else.
_DEGREE = {"triangle": 2, "tetrahedron": 3, "quadrilateral": 2, "hexahedron": 2}

# Degree of GRAD b : GRAD b, counted the same way: (22) is exact where A is constant. Quadrature
# on quadrilaterals and hexahedra costs nothing more for an odd degree.
STIFFNESS_DEGREE = {"triangle": 2, "tetrahedron": 4, "quadrilateral": 5, "hexahedron": 5}


def tabulate(cell: str, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (number of points, number of facets) of the bubbles at reference ``points``."""
    cell_type = basix.CellType[cell]
    vertices = basix.geometry(cell_type)
    d = vertices.shape[1]
    facets = basix.topology(cell_type)[d - 1]
    values = np.empty((len(points), len(facets)))
    for f, facet in enumerate(facets):
        if cell in ("triangle", "tetrahedron"):
            barycentric = np.column_stack([1 - points.sum(axis=1), points])
            values[:, f] = d**d * np.prod(barycentric[:, facet], axis=1)
        else:
            corner = vertices[facet]
            (normal,) = np.flatnonzero(np.ptp(corner, axis=0) == 0)
            along = np.delete(points, normal, axis=1)
            decay = 1 - np.abs(points[:, normal] - corner[0, normal])
            values[:, f] = decay * np.prod(4 * along * (1 - along), axis=1)
    return values


def element(cell: str) -> basix.ufl._ElementBase:
    """Discontinuous element whose degrees of freedom are the values at the facet midpoints."""
    cell_type = basix.CellType[cell]
    degree = _DEGREE[cell]
    vertices = basix.geometry(cell_type)
    d = vertices.shape[1]
    points, weights = basix.make_quadrature(cell_type, 2 * degree)
    orthonormal = basix.tabulate_polynomials(
        basix.PolynomialType.legendre, cell_type, degree, points
    )
    coefficients = np.ascontiguousarray((tabulate(cell, points).T * weights) @ orthonormal.T)
    topology = basix.topology(cell_type)
    midpoints = np.array([vertices[facet].mean(axis=0) for facet in topology[d - 1]])
    n = len(midpoints)
    unused: list[list] = [[]] * (3 - d)  # basix expects one entry for each dimension up to 3
    entity_points = [[np.zeros((0, d)) for _ in entities] for entities in topology[:d]]
    entity_duals = [[np.zeros((0, 1, 0, 1)) for _ in entities] for entities in topology[:d]]
    return basix.ufl.custom_element(
        cell_type,
        (),
        coefficients,
        [*entity_points, [midpoints], *unused],
        [*entity_duals, [np.eye(n).reshape(n, 1, n, 1)], *unused],
        0,
        basix.MapType.identity,
        basix.SobolevSpace.L2,
        True,
        0,
        degree,
    )


def bubble_stiffness(body: Body, geometry: Geometry, u: Expr, bubble: Expr) -> Expr:
    """Integrand of (22): GRAD b : A : GRAD b, (d, d) [MPa/mm2].

    With mean dilatation A is that of W at F_bar: bubbles do not share the dilatation of their cell.
    """
    body = body.elastic
    F = ufl.variable(body.effective(geometry.deformation(u)))
    A = acoustic_tensor(body.pointwise, F)
    return geometry.bubble_stiffness(A, bubble)
