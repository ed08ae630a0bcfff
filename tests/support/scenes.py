"""Small scenes and helpers that the tests of the engine share."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import (
    CellType,
    GhostMode,
    Mesh,
    MeshTags,
    compute_midpoints,
    create_unit_cube,
    create_unit_square,
    meshtags,
)
from numpy.typing import NDArray

import vmdg
from vmdg.base.kernels import compile_form
from vmdg.base.parallel import global_sum
from vmdg.domain.topology import facet_cells
from vmdg.meshes import blocks
from vmdg.meshes.gmsh_model import TaggedMesh

DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
CELLS = tuple(DIMENSION)
EVERY_CELL = pytest.mark.parametrize("cell", CELLS)
EVERY_DEGREE = pytest.mark.parametrize("degree", [1, 2])

#: Two different materials, and the two laws; the softening is far below every penalty here.
MATERIALS = (vmdg.NeoHookean(E=5000.0, nu=0.25), vmdg.NeoHookean(E=2000.0, nu=0.35))
STRONG = vmdg.Debonding(strength=1e5, critical_gap=1e3)

Predicate = Callable[[NDArray], NDArray]


def unit_box(comm: MPI.Comm, cell: str, n: int, ghosts: GhostMode = GhostMode.shared_facet) -> Mesh:
    """Unit square or cube with n cells (or n split ones) along each side."""
    create = create_unit_square if DIMENSION[cell] == 2 else create_unit_cube
    return create(comm, *[n] * DIMENSION[cell], CellType[cell], ghost_mode=ghosts)


def distort(mesh: Mesh, amplitude: float) -> None:
    """Move every node, also of interfaces, by a rough function of where it is.

    The same node moves the same way on every rank and in every partition.
    """
    d = mesh.geometry.dim
    x = mesh.geometry.x
    waves = np.array([[7.0, 11.0, 5.0], [-9.0, 6.0, 13.0], [8.0, -5.0, 10.0]])[:d]
    x[:, :d] += amplitude * np.sin(x @ waves.T + np.arange(1, d + 1))


def deform(mesh: Mesh, A: NDArray) -> None:
    """Map the mesh by x -> A.x."""
    d = mesh.geometry.dim
    mesh.geometry.x[:, :d] = mesh.geometry.x[:, :d] @ A[:d, :d].T


def integral(comm: MPI.Comm, form: ufl.Form) -> float:
    """Value of a functional on all ranks."""
    return float(global_sum(comm, fem.assemble_scalar(compile_form(form, [], comm))))


def two_blocks(comm: MPI.Comm, cell: str, n: int = 1, distortion: float = 0.0) -> TaggedMesh:
    """Blocks 1 and 2 that share the interface x = 1, n cells along each unit of length."""
    scene = blocks(comm, cell, divisions=(n, n, n))
    distort(scene.mesh, distortion)
    return scene


def tag_cells(mesh: Mesh, predicates: Mapping[int, Predicate]) -> MeshTags:
    """Tag every cell by the last predicate that holds at its midpoint (3, n)."""
    tdim = mesh.topology.dim
    cells = np.arange(cell_count(mesh), dtype=np.int32)
    midpoints = compute_midpoints(mesh, tdim, cells).T
    values = np.zeros(len(cells), dtype=np.int32)
    for tag, predicate in predicates.items():
        values[predicate(midpoints)] = tag
    return meshtags(mesh, tdim, cells, values)


def everywhere(x: NDArray) -> NDArray:
    """Predicate that always holds."""
    return np.ones(x.shape[1], dtype=bool)


def cell_count(mesh: Mesh) -> int:
    """Local cells, ghosts included."""
    cells = mesh.topology.index_map(mesh.topology.dim)
    return cells.size_local + cells.num_ghosts


def interior_facets(mesh: Mesh, predicate: Predicate = everywhere) -> NDArray[np.int32]:
    """Local facets between two cells whose midpoint fulfils the predicate."""
    mesh.topology.create_entities(mesh.topology.dim - 1)
    facets = np.flatnonzero((facet_cells(mesh) >= 0).all(axis=1)).astype(np.int32)
    return facets[predicate(compute_midpoints(mesh, mesh.topology.dim - 1, facets).T)]


def joined(scene: TaggedMesh, law: vmdg.Law, materials=MATERIALS, interface=None, **options):
    """Problem of two blocks and their interface; ``interface`` are further options of it."""
    return vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        dict(enumerate(materials, start=1)),
        [vmdg.Interface(between=(1, 2), law=law, frame="reference", **(interface or {}))],
        **options,
    )


def set_displacement(u: fem.Function, tags: MeshTags, field: Callable[[NDArray, int], NDArray]):
    """Interpolate ``field(x, tag)`` (d, n) on the cells of every tag."""
    for tag in np.unique(tags.values):
        u.interpolate(lambda x, tag=tag: field(x, tag), tags.find(tag))
    u.x.scatter_forward()


def gather(comm: MPI.Comm, array: NDArray) -> NDArray:
    """Rows of all ranks, on every rank."""
    return np.concatenate(comm.allgather(np.asarray(array)))


def by_position(comm: MPI.Comm, points: NDArray, *values: NDArray) -> list[NDArray]:
    """Points of all ranks and their values, in an order that no partition can change."""
    points = gather(comm, points)
    # Positions of different partitions differ by rounding; points are much further apart.
    order = np.lexsort(np.round(points, 8).T)
    return [points[order], *(gather(comm, value)[order] for value in values)]


def global_norm(comm: MPI.Comm, values: NDArray) -> float:
    """Euclidean norm of a vector of which every rank has its own entries."""
    return float(np.sqrt(comm.allreduce(float(np.sum(values**2)))))


def multiply(matrix: PETSc.Mat, vector: NDArray) -> NDArray:
    """Matrix times a vector of owned entries."""
    x, y = matrix.createVecs()
    x.array[:] = vector
    matrix.mult(x, y)
    result = y.array.copy()
    x.destroy()
    y.destroy()
    return result


def assert_residual_is_energy_derivative(problem: vmdg.Problem) -> None:
    """The residual equals d/du of the stored energies with zeta held, to rounding."""
    parts = problem.discretization
    energy = parts.bulk(lambda body, F: body.energy(F)) + parts._interfaces(
        lambda active, group: active.energy_term(group)
    )
    eta = ufl.TestFunction(problem.space)
    expected, found = (
        fem.assemble_vector(parts.compile_form(form)).array
        for form in (ufl.derivative(energy, problem.u, eta), problem.residual_ufl())
    )
    scale = problem.comm.allreduce(np.abs(found).max(initial=0), op=MPI.MAX)
    assert scale > 10
    assert np.abs(expected - found).max(initial=0) < 1e-12 * scale
