"""The broken space has the dofs of the continuous one and duplicates on the cuts only."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from support.checks import gather
from support.scenes import (
    CELLS,
    DIMENSION,
    cell_count,
    distort,
    everywhere,
    interior_facets,
    pairs,
    unit_box,
)

from vmdg import compat
from vmdg.assembly.space import broken_space, count_pieces
from vmdg.domain.topology import facet_cells

N = 4  # cells along each side: even, so that half the box is a whole number of cells
CELLS_OF_BOX = {"triangle": 2, "quadrilateral": 1, "tetrahedron": 6, "hexahedron": 1}

CUTS = {
    "none": lambda x: np.zeros(x.shape[1], dtype=bool),
    "full": lambda x: np.isclose(x[0], 0.5),
    "tip": lambda x: np.isclose(x[0], 0.5) & (x[1] < 0.5),
    "cross": lambda x: np.isclose(x[0], 0.5) | np.isclose(x[1], 0.5),
    "inclusion": lambda x: (
        np.isclose(np.abs(x[:2] - 0.5).max(axis=0), 0.25) & (np.abs(x[:2] - 0.5).min(axis=0) < 0.25)
    ),
    "every": everywhere,
}


def expected_nodes(cell: str, degree: int, cut: str) -> int:
    """Nodes of the unit box with N cells a side: m a side, and what the cut adds."""
    d, m, half = DIMENSION[cell], degree * N + 1, degree * N // 2
    depth = m if d == 3 else 1  # every cut but "every" extends through the third direction
    added = {
        "none": 0,
        "full": m,  # both sides of a line of m nodes
        "tip": half,  # half + 1 nodes, of which the tip stays single
        "cross": 2 * (m - 1) + 3,  # two lines, four nodes in place of one where they meet
        "inclusion": 4 * half,  # a closed line
    }
    if cut == "every":
        per_cell = {
            "triangle": (degree + 1) * (degree + 2) // 2,
            "quadrilateral": (degree + 1) ** 2,
            "tetrahedron": (degree + 1) * (degree + 2) * (degree + 3) // 6,
            "hexahedron": (degree + 1) ** 3,
        }
        return CELLS_OF_BOX[cell] * N**d * per_cell[cell]
    return m**d + added[cut] * depth


@pairs(cell=CELLS, degree=(1, 2), cut=list(CUTS))
def test_cells_share_dofs_across_kept_facets_only(comm, cell, degree, cut):
    """Two cells share all nodes of a kept facet; of a cut facet only those of a crack tip: CG nodes
    plus duplicates on the cut, counted by hand, on any number of ranks."""
    mesh = unit_box(comm, cell, N)
    facets = interior_facets(mesh, CUTS[cut])
    V = broken_space(mesh, degree, facets)
    assert V.dofmap.index_map.size_global == expected_nodes(cell, degree, cut)
    assert V.dofmap.index_map_bs == DIMENSION[cell]
    pairs = facet_cells(mesh)
    interior = np.flatnonzero((pairs >= 0).all(axis=1))
    dofs = V.dofmap.list
    first, second = dofs[pairs[interior, 0]], dofs[pairs[interior, 1]]
    shared = (first[:, :, None] == second[:, None, :]).any(axis=2)
    is_cut = np.isin(interior, facets)
    on_facet = len(V.dofmap.dof_layout.entity_closure_dofs(mesh.topology.dim - 1, 0))
    counts = gather(comm, np.column_stack([shared.sum(axis=1), is_cut]))
    assert (counts[counts[:, 1] == 0, 0] == on_facet).all()
    nodes = gather(comm, V.tabulate_dof_coordinates()[first[is_cut][shared[is_cut]]])
    if cut == "tip":
        # The crack front: one node in 2D, a line of nodes in 3D.
        assert len(nodes) > 0
        assert np.allclose(nodes[:, :2], 0.5)
    else:
        assert len(nodes) == 0


@pairs(cell=CELLS, degree=(1, 2), cut=("full", "tip", "cross", "every"))
def test_affine_field_is_exact(comm, cell, degree, cut):
    """An affine field is reproduced inside all cells, so nodes and basis functions belong."""
    mesh = unit_box(comm, cell, N)
    facets = interior_facets(mesh, CUTS[cut])
    distort(mesh, 0.02)
    V = broken_space(mesh, degree, facets)
    d = DIMENSION[cell]
    A = np.arange(1.0, d * d + 1).reshape(d, d)
    u = fem.Function(V)
    u.interpolate(lambda x: A @ x[:d] + 3.0)
    u.x.scatter_forward()
    cells = np.arange(cell_count(mesh), dtype=np.int32)
    corners = mesh.geometry.x[compat.geometry_dofmap(mesh)]
    weights = np.arange(1.0, corners.shape[1] + 1)
    points = np.einsum("cvx,v->cx", corners, weights / weights.sum())  # inside, off the centre
    error = np.abs(u.eval(points, cells) - points[:, :d] @ A.T - 3.0).max()
    # Rounding of values up to 30, and of pulling the points back on distorted cells.
    assert comm.allreduce(error) < 1e-12


@pytest.mark.parametrize(
    ("cut", "pieces"),
    [("none", 1), ("full", 2), ("tip", 1), ("cross", 4), ("inclusion", 2), ("every", N * N)],
)
def test_pieces(comm, cut, pieces):
    """Around a crack tip a body is one piece; a cut that goes through makes two, on any ranks."""
    mesh = unit_box(comm, "quadrilateral", N)
    assert count_pieces(broken_space(mesh, 2, interior_facets(mesh, CUTS[cut]))) == pieces
