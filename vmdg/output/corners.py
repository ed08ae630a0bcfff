"""Corners of cells and facets: positions and displacements."""

from __future__ import annotations

import basix
import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .. import compat
from ..problem.problem import Problem
from .cell import whole_displacement


def cell_corners(mesh: Mesh) -> NDArray[np.int32]:
    """Local corner numbers of every owned cell of a plane mesh, in order around it (n, c)."""
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    return np.tile(_around(basix.topology(mesh.basix_cell())[2]), (owned, 1))


def corners_of_local(mesh: Mesh, local: NDArray[np.int32]) -> NDArray[np.int32]:
    """Local corner numbers of facets with the number ``local`` in their cell (n, c).

    Corners of faces are in order around them.
    """
    return _around(basix.topology(mesh.basix_cell())[mesh.topology.dim - 1])[local]


def _around(entities: list[list[int]]) -> NDArray[np.int32]:
    corners = np.array(entities, dtype=np.int32)
    return corners[:, [0, 1, 3, 2]] if corners.shape[1] == 4 else corners


def positions_and_displacements(
    problem: Problem, cells: NDArray[np.int32], corners: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Reference positions (n, c, 3) and displacements (n, c, d) of corners of cells [mm]."""
    mesh = problem.mesh
    nodes = compat.geometry_dofmap(mesh)[cells[:, None], corners]
    u = whole_displacement(problem)
    dofs = u.function_space.dofmap.list[cells[:, None], corner_dofs(problem)[corners]]
    return mesh.geometry.x[nodes], u.x.array.reshape(-1, mesh.geometry.dim)[dofs]


def corner_dofs(problem: Problem) -> NDArray[np.int32]:
    """Local dof of every corner of a cell, for all fields of the displacement's degree."""
    layout = problem.space.dofmap.dof_layout
    count = len(basix.topology(problem.mesh.basix_cell())[0])
    return np.array([layout.entity_dofs(0, v)[0] for v in range(count)], dtype=np.int32)


def nodal_means(problem: Problem, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over the cells around every node, for the corners of owned cells in cell order, of
    values given in that order (n, corners); collective.

    Values on both sides of an open interface belong to different nodes.
    """
    dofs = problem.space.dofmap.list[: len(values)][:, corner_dofs(problem)]
    total = fem.Function(problem.space)
    # Two components hold sum and count.
    both = total.x.array.reshape(-1, problem.mesh.geometry.dim)
    np.add.at(both[:, 0], dofs, values)
    np.add.at(both[:, 1], dofs, 1.0)
    total.x.scatter_reverse(InsertMode.add)
    total.x.scatter_forward()
    return both[dofs, 0] / both[dofs, 1]
