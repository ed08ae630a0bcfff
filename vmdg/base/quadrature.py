"""Quadrature degrees, all defined here, and compiler flags of the two kinds of kernels."""

from __future__ import annotations

from ..forms import bubbles
from ..forms.geometry import Axisymmetric, Geometry


def bulk_degree(cell: str, degree: int, geometry: Geometry) -> int:
    """Degree in the cells for displacement degree k.

    Simplices: 2 (k - 1), exact for a constant A, but at least 1. Quadrilaterals and hexahedra: 2 k
    per direction, k + 1 points, the fewest without spurious modes.

    Axisymmetric triangles: 2 k. The weight r adds one degree, and with a single point, sufficient
    for k = 1 in the plane, a triangle could rotate about its centroid without strain, since the
    hoop strain u_r/r vanishes there. The k + 1 points of quadrilaterals are exact to 2 k + 1, which
    is sufficient. Hoop terms have r in the denominator, which no degree integrates exactly; it
    varies across a cell by h/r, and where that is large, at the axis, u_r is a multiple of r.
    """
    if cell in ("triangle", "tetrahedron") and not isinstance(geometry, Axisymmetric):
        return max(2 * (degree - 1), 1)
    return 2 * degree


def bubble_degree(cell: str, geometry: Geometry) -> int:
    """Degree for the bubble integral (22), exact where A is constant.

    Axisymmetric triangles: b^2/r has the degree 4 of b^2 or less; the weight r takes the others to
    3. Degree five on quadrilaterals includes the weight.
    """
    if cell == "triangle" and isinstance(geometry, Axisymmetric):
        return 4
    return bubbles.STIFFNESS_DEGREE[cell]


def facet_degree(degree: int) -> int:
    """Degree on interface facets: products of two displacements are integrated exactly.

    For hexahedra of degree 1 these are the four points of the report's section 7.4. On intervals
    the k + 1 points are exact to 2 k + 1, so also for the weight r of an axisymmetric body.
    """
    return 2 * degree


def load_degree(degree: int) -> int:
    """Degree of loads: displacement times a load that is approximated to degree k + 2.

    Loads that vary in space then add no error of the order of the displacement's.
    """
    return 2 * degree + 2
