"""Places on facets whose projections into the planes of segments are given.

A facet is a polynomial of its own coordinates eta, by its positions and displacements on a lattice.
"""

from __future__ import annotations

from itertools import product
from pathlib import Path
from typing import NamedTuple

import basix
import numpy as np
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..base.kernels import call, compile_source
from ..domain.shapes import (
    determinants,
    displacements_in_cells,
    places_in_cells,
    reference_facets,
)
from .pairing import Surface
from .segments import Numbers, Segments

Array = NDArray[np.float64]

#: Number of segments, and the arrays of facet_places.c.
_DECLARATIONS = f"void places(long{', void *' * 13});"


class FacetPlaces(NamedTuple):
    """Places of the points on one of the two facets of their segment."""

    reference: Array  # Positions in the reference cell (ns, points, d)
    positions: Array  # X (ns, points, d) [mm]
    normals: Array  # Unit normal, outward (ns, points, d)
    stretch: Array  # Area per area in the plane of the segment (ns, points)


class FacetPolynomials:
    """Finds the places on one surface."""

    def __init__(self, mesh: Mesh, surface: Surface, points: int, degree: int):
        self._mesh, self._surface, d = mesh, surface, mesh.geometry.dim
        facet = basix.cell.subentity_types(mesh.basix_cell())[d - 1][0]
        k = max(degree, compat.coordinate_element(mesh).degree)
        self._degree = k
        lattice = basix.create_lattice(facet, k, basix.LatticeType.equispaced, True)
        triangle = facet == basix.CellType.triangle
        exponents = product(range(k + 1), repeat=d - 1)
        terms = [each for each in exponents if not triangle or sum(each) <= k]
        self._exponents = np.array(terms, dtype=np.int64)
        powers = (lattice[:, None] ** self._exponents).prod(axis=2)
        self._from_lattice = np.linalg.inv(powers)
        self._middle = np.full(d - 1, 1 / 3 if triangle else 0.5)
        origins, edges = reference_facets(mesh)
        self._origins, self._edges = (array[surface.local] for array in (origins, edges))
        self._lattice = self._origins[:, None] + lattice @ self._edges
        X, J = places_in_cells(mesh, surface.cells, self._lattice)
        self._positions = X
        self._reference = self._from_lattice @ X
        outward = basix.cell.facet_outward_normals(mesh.basix_cell())
        turns = determinants(np.concatenate([outward[:, None], edges], axis=1))
        self._signs = np.sign(determinants(J[:, 0]) * turns[surface.local])
        sizes = {"DIM": d, "POINTS": points, "DEGREE": k, "TERMS": len(lattice)}
        source = Path(__file__).with_suffix(".c")
        self._module = compile_source(source, _DECLARATIONS, sizes, mesh.comm, "places on facets")

    def places(
        self, rows: Numbers, segments: Segments, plane: Array, u: fem.Function | None = None
    ) -> FacetPlaces:
        """Places on facets of the surface, one for each of some segments, from coordinates in their
        planes (ns, points, d - 1) [mm]."""
        current, (count, points, _), d = self._reference, plane.shape, self._mesh.geometry.dim
        if u is not None:
            assert u.function_space.ufl_element().degree <= self._degree
            moved = displacements_in_cells(u, self._surface.cells, self._lattice)[0]
            current = self._from_lattice @ (self._positions + moved)
        eta, stretch = np.empty_like(plane), np.empty((count, points))
        positions, normals = np.empty((2, count, points, d))
        call(
            self._module,
            "places",
            *(rows, self._reference, current, self._exponents, self._signs, self._middle),
            *(segments.axes, segments.origins, plane, eta, positions, normals, stretch),
        )
        reference = self._origins[rows][:, None] + eta @ self._edges[rows]
        return FacetPlaces(reference, positions, normals, stretch)
