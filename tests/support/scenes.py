"""Meshes that the tests share: unit boxes, two blocks, sections of bodies of revolution."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping, Sequence, Set
from itertools import combinations, product

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import (
    CellType,
    GhostMode,
    Mesh,
    MeshTags,
    compute_midpoints,
    create_box,
    create_rectangle,
    create_unit_cube,
    create_unit_square,
    meshtags,
)
from numpy.typing import NDArray

from vmdg.domain.topology import facet_cells
from vmdg.meshes import TaggedMesh, blocks

DIMENSION = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
CELLS = tuple(DIMENSION)
EVERY_CELL = pytest.mark.parametrize("cell", CELLS)
EVERY_DEGREE = pytest.mark.parametrize("degree", [1, 2])
#: Every cell, and both degrees in the plane and in space.
CELLS_BY_TURNS = pytest.mark.parametrize(
    ("cell", "degree"),
    [("triangle", 2), ("quadrilateral", 1), ("tetrahedron", 2), ("hexahedron", 1)],
)


def SEVERAL_RANKS(test: Callable) -> Callable:
    """Mark of a test that compares several ranks with one: of those that ranks can change."""
    alone = MPI.COMM_WORLD.size == 1
    skipped = pytest.mark.skipif(alone, reason="one rank does not differ from itself")
    return pytest.mark.ranks(skipped(test))


def pairs(**values: Sequence) -> pytest.MarkDecorator:
    """Combinations in which every two values of different arguments meet, in place of all."""
    names, missing = list(values), set()
    every = list(product(*(range(len(choice)) for choice in values.values())))

    def met(row):
        return set(combinations(enumerate(row), 2))

    for row in every:
        missing |= met(row)
    chosen = []
    while missing:
        row = max(every, key=lambda row: len(met(row) & missing))
        missing -= met(row)
        chosen.append([choice[i] for choice, i in zip(values.values(), row, strict=True)])
    return pytest.mark.parametrize(names, chosen)


def pairs_of_features(
    features: Iterable[str], exclude: Sequence[Set[str]], each: int = 1
) -> list[tuple[str, str]]:
    """Pairs in which every feature occurs ``each`` times or more, the same on every rank, none of
    two that exclude each other; VMDG_PAIRS=all takes all of them, VMDG_SEED chooses others."""
    every = [p for p in combinations(features, 2) if not any(row >= set(p) for row in exclude)]
    if os.environ.get("VMDG_PAIRS") == "all":
        return every
    random = np.random.default_rng(int(os.environ.get("VMDG_SEED", "1")))
    every = [every[i] for i in random.permutation(len(every))]
    found: list[tuple[str, str]] = []
    left = dict.fromkeys(features, each)
    while any(left.values()):
        found.append(max(every, key=lambda pair: sum(left[name] > 0 for name in pair)))
        every.remove(found[-1])
        left |= {name: max(left[name] - 1, 0) for name in found[-1]}
    return found


LEFT, RIGHT = 1, 2  # facet tags of the ends
#: Facet tags of a section: the inner surface (or the axis), the outer one, the two ends.
INNER, OUTER, INTERFACE, BOTTOM, TOP = 1, 2, 3, 4, 5
Predicate = Callable[[NDArray], NDArray]


def unit_box(comm: MPI.Comm, cell: str, n: int, ghosts: GhostMode = GhostMode.shared_facet) -> Mesh:
    """Unit square or cube with n cells (or n split ones) along each side."""
    create = create_unit_square if DIMENSION[cell] == 2 else create_unit_cube
    return create(comm, *[n] * DIMENSION[cell], CellType[cell], ghost_mode=ghosts)


def two_blocks(comm: MPI.Comm, cell: str, n: int = 1, distortion: float = 0.0) -> TaggedMesh:
    """Blocks 1 and 2 that share the interface x = 1, n cells along each unit of length."""
    scene = blocks(comm, cell, divisions=(n, n, n))
    distort(scene.mesh, distortion)
    return scene


def section(
    comm: MPI.Comm,
    cell: str = "quadrilateral",
    divisions: Sequence[int] = (2, 2),
    radii: tuple[float, float, float] = (0.0, 1.0, 2.0),
    height: float = 1.0,
    top: float | None = None,
    distortion: float = 0.0,
) -> TaggedMesh:
    """Body 1 [r_0, r_1] and body 2 [r_1, r_2] x [0, height].

    ``divisions`` along r of each body and along z; ``top`` is the radius of the interface at the
    top, for a cone; ``distortion`` moves nodes inside of the bodies [mm].
    """
    inner, middle, outer = radii
    upper = middle if top is None else top
    scene = blocks(
        comm,
        cell,
        divisions,
        length=outer - inner,
        height=height,
        interface=(middle - inner, upper - inner),
    )
    x = scene.mesh.geometry.x
    x[:, 0] += inner
    # Rounding of the mesher would leave nodes beside the surfaces.
    x[:, :2] = np.round(x[:, :2], 12)
    if distortion:
        before = x.copy()
        distort(scene.mesh, distortion)
        for column, ends in ((0, (inner, outer)), (1, (0.0, height))):
            edge = np.isin(before[:, column], np.round(ends, 12))
            x[edge, column] = before[edge, column]
    return scene


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


def everywhere(x: NDArray) -> NDArray:
    """Predicate that always holds."""
    return np.ones(x.shape[1], dtype=bool)


def cell_count(mesh: Mesh) -> int:
    """Local cells, ghosts included."""
    cells = mesh.topology.index_map(mesh.topology.dim)
    return cells.size_local + cells.num_ghosts


def box(
    comm: MPI.Comm,
    ends: Sequence,
    divisions: Sequence[int],
    tag_of: Callable[[NDArray], NDArray] = lambda x: 1 + 0 * x[0],
    cell: str | None = None,
) -> tuple[Mesh, MeshTags]:
    """A rectangle or box between two corners, and tags of its cells by their midpoints (3, n)."""
    d = len(divisions)
    create = create_rectangle if d == 2 else create_box
    kind = CellType[cell or ("quadrilateral" if d == 2 else "hexahedron")]
    mesh = create(comm, ends, divisions, kind, ghost_mode=GhostMode.shared_facet)
    cells = np.arange(cell_count(mesh), dtype=np.int32)
    values = tag_of(compute_midpoints(mesh, d, cells).T).astype(np.int32)
    return mesh, meshtags(mesh, d, cells, values)


def tag_cells(mesh: Mesh, predicates: Mapping[int, Predicate]) -> MeshTags:
    """Tag every cell by the last predicate that holds at its midpoint (3, n)."""
    tdim = mesh.topology.dim
    cells = np.arange(cell_count(mesh), dtype=np.int32)
    midpoints = compute_midpoints(mesh, tdim, cells).T
    values = np.zeros(len(cells), dtype=np.int32)
    for tag, predicate in predicates.items():
        values[predicate(midpoints)] = tag
    return meshtags(mesh, tdim, cells, values)


def interior_facets(mesh: Mesh, predicate: Predicate = everywhere) -> NDArray[np.int32]:
    """Local facets between two cells whose midpoint fulfils the predicate."""
    mesh.topology.create_entities(mesh.topology.dim - 1)
    facets = np.flatnonzero((facet_cells(mesh) >= 0).all(axis=1)).astype(np.int32)
    return facets[predicate(compute_midpoints(mesh, mesh.topology.dim - 1, facets).T)]
