"""Pictures with matplotlib."""

from __future__ import annotations

import basix
import numpy as np
from dolfinx import fem
from matplotlib.axes import Axes
from matplotlib.collections import Collection, PolyCollection
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from . import compat
from .problem import Problem
from .topology import facet_cells, local_facets


def deformed_corners(
    problem: Problem, facets: NDArray[np.int32] | None = None, magnify: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Corners of this rank's cells (2D) or of boundary facets (3D) in the deformed body.

    Args:
        problem: The problem.
        facets: In 3D, the boundary facets.
        magnify: Factor on the displacement.

    Returns:
        Corners in order around every polygon (n, corners, 3) [mm] and the cell it belongs to (n,).
    """
    mesh, d = problem.mesh, problem.mesh.geometry.dim
    topology = basix.topology(mesh.basix_cell())
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    if d == 2:
        cells = np.arange(owned, dtype=np.int32)
        corners = np.tile(np.array(topology[2][0]), (owned, 1))
    else:
        facets = facets[facets < mesh.topology.index_map(2).size_local]
        cells = facet_cells(mesh)[facets, 0]
        corners = np.array(topology[2])[local_facets(mesh, cells, facets)]
    if corners.shape[1] == 4:
        corners = corners[:, [0, 1, 3, 2]]
    layout = problem.space.dofmap.dof_layout
    vertex_dofs = np.array([layout.entity_dofs(0, v)[0] for v in range(len(topology[0]))])
    nodes = compat.geometry_dofmap(mesh)[cells[:, None], corners]
    dofs = problem.space.dofmap.list[cells[:, None], vertex_dofs[corners]]
    positions = mesh.geometry.x[nodes]
    positions[..., :d] += magnify * problem.u.x.array.reshape(-1, d)[dofs]
    return positions, cells


def deformed_polygons(
    problem: Problem, facets: NDArray[np.int32] | None = None, magnify: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """:func:`deformed_corners` seen along z.

    Args:
        problem: The problem.
        facets: In 3D, the boundary facets.
        magnify: Factor on the displacement.

    Returns:
        Corners (n, corners, 2) [mm] and the cell each polygon belongs to (n,).
    """
    corners, cells = deformed_corners(problem, facets, magnify)
    return corners[..., :2], cells


def cell_means(function: fem.Function, component: tuple[int, ...] = ()) -> NDArray[np.float64]:
    """Mean over the dofs of every local cell of one component of a discontinuous function.

    Args:
        function: The function.
        component: Indices of the component, none for a scalar.
    """
    space = function.function_space
    shape = space.ufl_element().reference_value_shape
    values = function.x.array.reshape(-1, *shape)[(slice(None), *component)]
    return values[space.dofmap.list].mean(axis=1)


def draw_cells(
    ax: Axes, problem: Problem, polygons: NDArray, values: NDArray, limits: tuple[float, float]
) -> Collection:
    """Draw coloured polygons of all ranks (on rank 0's axes); collective.

    Args:
        ax: Plane axes for corners (n, corners, 2), axes in space for (n, corners, 3).
        problem: The problem.
        polygons: The corners [mm].
        values: Value of every polygon (n,).
        limits: Values at both ends of the colours.
    """
    polygons = np.concatenate(problem.comm.allgather(polygons))
    values = np.concatenate(problem.comm.allgather(values))
    style = {"array": values, "edgecolors": "black", "linewidths": 0.6}
    if polygons.shape[-1] == 3:
        collection = ax.add_collection3d(Poly3DCollection(polygons, **style))
    else:
        collection = ax.add_collection(PolyCollection(polygons, **style))
        ax.autoscale()
    collection.set_clim(*limits)
    ax.set_aspect("equal")
    return collection
