"""The bodies' part of the tangent in 3D: sums of B^T.A.B over the quadrature points of the
cells."""

from __future__ import annotations

from pathlib import Path

from petsc4py import PETSc

import basix.ufl
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..base.kernels import compile_source
from ..base.quadrature import bulk_degree
from ..domain.materials import Bodies
from ..domain.moduli import cell_moduli
from ..domain.shapes import GeometryMap

#: Number of cells, A, nodes, derivatives of both sets of shape functions, weights, matrices.
_DECLARATION = "void cell_tangents(long, void *, void *, void *, void *, void *, void *);"

#: Number of matrix entries per batch of cells: they and A fit in a core's cache.
_BATCH = 60_000


class CellTangents:
    """First term of (85) in 3D, int GRAD eta : A : GRAD du dV of the bodies.

    A is derived in UFL and evaluated at the points, the products are those of cell_tangents.c.

    Args:
        bodies: Materials; with mean dilatation the displacement block at fixed theta and p.
    """

    def __init__(self, u: fem.Function, bodies: Bodies):
        space = u.function_space
        mesh, degree = space.mesh, space.ufl_element().degree
        cell, geometry = mesh.basix_cell(), bodies.geometry
        points, self._weights = basix.make_quadrature(
            cell, bulk_degree(mesh.topology.cell_name(), degree, geometry)
        )
        self._regions, self._dofs = bodies.regions, space.dofmap.list
        self._at_points = bodies.points
        size = len(geometry.entries(mesh.geometry.dim))
        self._rows, self._columns = np.triu_indices(size)
        # Place of every A_rc among the independent ones.
        self._places = np.empty((size, size), dtype=int)
        self._places[self._rows, self._columns] = np.arange(len(self._rows))
        self._places[self._columns, self._rows] = np.arange(len(self._rows))
        self._symmetric = bodies.points is None or bodies.points.symmetric
        self._moduli = cell_moduli(u, bodies, range(len(bodies.regions)), points)
        self._map = GeometryMap(mesh, points)
        shape = basix.ufl.element("Lagrange", cell, degree)
        self._slopes = np.array(shape.tabulate(1, points)[1:])
        self._size = mesh.geometry.dim * shape.dim
        module = compile_source(
            Path(__file__).with_suffix(".c"),
            _DECLARATION,
            {
                "NODES": shape.dim,
                "MAP_NODES": self._map.slopes.shape[2],
                "POINTS": len(points),
                "ENTRIES": size,
                "SYMMETRIC": int(self._symmetric),
            },
            mesh.comm,
            name="bodies' tangent",
        )
        self._kernel, self._pointer = module.lib.cell_tangents, module.ffi.from_buffer

    def add_to(self, matrix: PETSc.Mat, chosen: NDArray[np.bool_] | None = None) -> None:
        """Add the tangent at the current displacement to a matrix that couples the dofs of every
        cell, of all cells or of those marked among the local ones."""
        batch = max(_BATCH // self._size**2, 1)
        matrices = np.empty((batch, self._size, self._size))
        for number, region in enumerate(self._regions):
            owned = region.cells if chosen is None else region.cells[chosen[region.cells]]
            for start in range(0, len(owned), batch):
                cells = owned[start : start + batch]
                arrays = (
                    self._moduli_of(number, cells),
                    self._map.nodes(cells),
                    self._slopes,
                    self._map.slopes,
                    self._weights,
                    matrices,
                )
                self._kernel(len(cells), *map(self._pointer, arrays))
                dofs = self._dofs[cells]
                matrix.setValuesBlockedLocalRCV(
                    dofs, dofs, matrices[: len(cells)], PETSc.InsertMode.ADD_VALUES
                )

    def _moduli_of(self, number: int, cells: NDArray[np.int32]) -> NDArray[np.float64]:
        """The independent moduli in some cells of a region (n, points, components)."""
        if self._regions[number].body.points is None:
            moduli = self._moduli.in_region(number, cells)
            return moduli if self._symmetric else np.ascontiguousarray(moduli[..., self._places])
        moduli = np.ascontiguousarray(self._at_points.moduli_in(cells))
        if not self._symmetric:
            return moduli
        return np.ascontiguousarray(moduli[:, :, self._rows, self._columns])
