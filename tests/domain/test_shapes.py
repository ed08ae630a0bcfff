"""Shape functions at the points of facets, against what DOLFINx evaluates there."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from support.scenes import EVERY_CELL, distort, unit_box

from vmdg import compat
from vmdg.domain.shapes import ShapeGradients
from vmdg.forms.geometry import CARTESIAN


@EVERY_CELL
def test_facet_points_in_the_order_of_expressions(comm, cell):
    """GRAD u of an expression on facets is that of the shape functions, point by point."""
    mesh = unit_box(comm, cell, 3)
    distort(mesh, 0.04)
    tdim = mesh.topology.dim
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 2)))
    u.interpolate(lambda x: np.sin(2 * x[0]) + x[1] ** 2)
    shapes = ShapeGradients(mesh, CARTESIAN, 2)
    mesh.topology.create_connectivity(tdim, tdim - 1)
    count = mesh.topology.connectivity(tdim, tdim - 1).links(0).size
    cells = np.repeat(np.arange(mesh.topology.index_map(tdim).size_local), count).astype(np.int32)
    pairs = np.column_stack([cells, np.arange(len(cells)) % count]).astype(np.int32)
    size = (len(cells), len(shapes.facet_points), tdim)

    def evaluated(expression):
        compiled = fem.Expression(expression, shapes.facet_points)
        return compat.evaluate(compiled, mesh, pairs).reshape(size)

    found = shapes.on_facets(*pairs.T).at(evaluated(ufl.SpatialCoordinate(mesh)))
    values = u.x.array[u.function_space.dofmap.list[cells]]
    gradients = np.einsum("cqni,cn->cqi", found.gradients, values)
    assert np.abs(gradients - evaluated(ufl.grad(u))).max() < 1e-12
