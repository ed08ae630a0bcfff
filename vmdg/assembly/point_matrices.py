"""Matrices of an interface from products of small matrices at its points."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import cpp, fem
from numpy.typing import NDArray
from scipy.sparse import csr_array

from .. import compat
from ..base.arrays import joined_axes
from ..interface.active import ActiveInterface
from ..interface.point_flux import FluxChange
from ..points.jets import FacetJets, Field

Array = NDArray[np.float64]

#: Number of matrix entries per batch of facets: they fit in a core's cache.
_BATCH = 60_000


def _batches(active: ActiveInterface) -> Iterator[slice]:
    facets, nodes = len(active.facets.facets), active.point_tangent.jets.nodes
    count = max(_BATCH // (2 * nodes * active.quadrature.d) ** 2, 1)
    return (slice(start, start + count) for start in range(0, facets, count))


def sparsity(
    test: fem.FunctionSpace, trial: fem.FunctionSpace, active: Sequence[ActiveInterface]
) -> cpp.la.SparsityPattern:
    """The pattern that couples the dofs of every cell, and those of both sides of every facet."""
    tdim = test.mesh.topology.dim
    cells = np.arange(test.mesh.topology.index_map(tdim).size_local, dtype=np.int32)
    facets = np.concatenate([np.zeros(0, dtype=np.int32), *(one.couplings for one in active)])
    return compat.sparsity(test, trial, cells, facets)


def create_matrix(
    comm: MPI.Comm, pattern: cpp.la.SparsityPattern, kind: PETSc.Mat.Type = PETSc.Mat.Type.AIJ
) -> PETSc.Mat:
    return cpp.la.petsc.create_matrix(comm, pattern, kind)


def add_tangent(
    matrix: PETSc.Mat, active: ActiveInterface, D: Array, change: FluxChange | None = None
) -> None:
    """Add int j(eta).D.j(du) dA of (84)-(85) over an interface, for displacements.

    Args:
        D: With dA, of its points (nq, jet, jet).
        change: What the flux of bodies at points changes, if there are any.
    """
    tangent = active.point_tangent
    for rows in _batches(active):
        nodes = tangent.jets.nodes_at(rows)
        matrices = tangent.of_facets(D, rows)
        if change is not None:
            displacement = FacetJets.displacement
            change.add_to(matrices, rows, tangent.jets.displacement(rows).matrix, displacement)
        matrix.setValuesBlockedLocalRCV(nodes, nodes, matrices, PETSc.InsertMode.ADD_VALUES)


def add_couplings(
    matrix: PETSc.Mat,
    active: ActiveInterface,
    test: Field = FacetJets.displacement,
    trial: Field = FacetJets.displacement,
) -> None:
    """Add zeros where surfaces that slide may be paired soon: PETSc drops entries of the pattern
    that are not set before the first assembly."""
    if not active.facets.slides:
        return
    jets = active.point_tangent.jets
    cells = np.ascontiguousarray(active.couplings.reshape(-1, 4)[:, [0, 2]])

    def blocks(field: Field) -> tuple[NDArray[np.int32], int]:
        if field is FacetJets.dilatation:
            return cells, 2
        nodes = jets.nodes_of(cells)
        return nodes, nodes.shape[1] * active.quadrature.d

    (rows, height), (columns, width) = blocks(test), blocks(trial)
    zeros = np.zeros((len(cells), height, width))
    matrix.setValuesBlockedLocalRCV(rows, columns, zeros, PETSc.InsertMode.ADD_VALUES)


def add_fields(
    matrix: PETSc.Mat,
    active: ActiveInterface,
    D: Array,
    test: Field,
    trial: Field,
    change: FluxChange | None = None,
) -> None:
    """The same for general fields, the sum of B^T.D.B over the points: rows are those of test
    functions, columns of trial functions."""
    points, jets = active.quadrature.points_of_facet, active.point_tangent.jets
    for rows in _batches(active):
        left, right = test(jets, rows), trial(jets, rows)
        product = D[points[rows]] @ right.matrix
        # Sums over the points of a facet and its jets in one product.
        count, points_of_one, size = left.matrix.shape[:3]
        B, DB = (
            part.reshape(count, points_of_one * size, part.shape[3])
            for part in (left.matrix, product)
        )
        matrices = B.transpose(0, 2, 1) @ DB
        if change is not None:
            change.add_to(matrices, rows, left.matrix, trial)
        matrix.setValuesBlockedLocalRCV(
            left.blocks, right.blocks, matrices, PETSc.InsertMode.ADD_VALUES
        )


def uniform_flux(active: ActiveInterface, D: Array, gradient: Array) -> Array:
    """D.j(E.X) dA at the points of an interface (nq, jet), for a displacement without jump."""
    return D @ active.point_tangent.jets.of_gradient(gradient)


def add_uniform(
    vector: Array, dofs: NDArray[np.int32], active: ActiveInterface, flux: Array
) -> None:
    """Add int j(eta).flux over an interface, the forces from :func:`uniform_flux`, at nodes of the
    cells (cells, nodes of a cell)."""
    active.point_tangent.add_forces(flux, dofs, vector)


def add_forces(vector: Array, nodes: NDArray[np.int32], d: int, forces: Array) -> None:
    """Add forces (f, n) on the nodes of cells (f, ...), or (f, nodes, d), to a vector over local
    dofs."""
    places = nodes[..., None] * d + np.arange(d)
    np.add.at(vector, places.reshape(forces.shape), forces)


def local_tractions(active: ActiveInterface) -> csr_array:
    """The transpose of int q.Tt(du) dA over an interface, q the test functions of its points.

    Tt(du) = {(A : GRAD du).N} + r (du_2 - du_1) of (84). One column per component at the points of
    this rank, one row per dof known on this rank.
    """
    quadrature, jets = active.quadrature, active.point_tangent.jets
    values, d = active.tangent(damage=False)[1], quadrature.d
    known = jets.index_map.size_local + jets.index_map.num_ghosts
    total = csr_array((len(quadrature.weights) * d, known * d))
    for rows in _batches(active):
        nodes, B = jets.displacement(rows)
        points = quadrature.points_of_facet[rows]
        data = values[points] @ B
        lines = points[..., None] * d + np.arange(d)
        columns = joined_axes(nodes[..., None] * d + np.arange(d), 1)[:, None, None]
        where = (np.broadcast_to(a, data.shape).ravel() for a in (lines[..., None], columns))
        total += csr_array((data.ravel(), tuple(where)), shape=total.shape)
    return total.T.tocsr()
