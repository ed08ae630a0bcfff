"""Partitions that share the cells at interfaces."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx.cpp.graph import AdjacencyList_int64
from support.apart import rings

import vmdg
from vmdg import meshes
from vmdg.base.parallel import global_max, global_sum
from vmdg.domain.topology import outer_facets
from vmdg.meshes.partition import between_bodies, with_leaves

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.3)
WEIGHT = 6


def cylinder(comm, weight: int | None) -> meshes.TaggedMesh:
    return meshes.pushout(
        comm, layers=8, around=6, fibre_rings=2, hole_rings=1, matrix_rings=8,
        interface_weight=weight,
    )  # fmt: skip


def cells_at_interface(tagged: meshes.TaggedMesh) -> tuple[int, int]:
    """Owned cells, and how many of them have a facet of the interface."""
    mesh, _, facet_tags = tagged
    owned = mesh.topology.index_map(3).size_local
    mesh.topology.create_connectivity(2, 3)
    links = mesh.topology.connectivity(2, 3)
    cells = [links.links(f) for f in facet_tags.find(6)]
    near = np.unique(np.concatenate([*cells, np.zeros(0, dtype=np.int32)]))
    return owned, int((near < owned).sum())


def test_parts_of_equal_weight(comm):
    """The weight of a rank is at most a tenth above the mean; without weights it is not."""
    if comm.size == 1:
        pytest.skip("one part")
    shares = []
    for weight in (1, WEIGHT):
        owned, near = cells_at_interface(cylinder(comm, weight))
        mine = owned + (WEIGHT - 1) * near
        mean = global_sum(comm, mine) / comm.size
        shares.append(global_max(comm, mine) / mean)
    assert shares[1] < 1.1
    assert shares[0] > shares[1]


def test_slabs(comm):
    """Across the axis every rank has its share of cells, and of those at the interface.

    Ranks differ by one layer of 6 cells at the interface, of which there are 8 for all.
    """
    owned, near = cells_at_interface(cylinder(comm, None))
    cells, interface = global_sum(comm, owned), global_sum(comm, near)
    assert abs(owned - cells / comm.size) <= 1
    assert abs(near - interface / comm.size) <= interface / 8


def test_cuts_change_nothing_else(comm):
    """The same cells, facets and forces."""
    forces = []
    for weight in (1, WEIGHT, None):
        mesh, cell_tags, facet_tags = cylinder(comm, weight)
        bodies = {1: vmdg.NeoHookean(E=2500.0, nu=0.35), 2: vmdg.NeoHookean(E=4000.0, nu=0.35)}
        interface = vmdg.Interface(between=(1, 2), law=LAW)
        problem = vmdg.Problem(mesh, cell_tags, bodies, [interface])
        problem.dirichlet(facet_tags.find(4), 0.0)
        problem.dirichlet(facet_tags.find(1), lambda t: (0.0, 0.0, -0.02 * t))
        vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(relative_tolerance=1e-11))
        forces.append(problem.reaction(facet_tags.find(1)))
    assert problem.energy().dissipated > 0
    for other in forces[1:]:
        assert other == pytest.approx(forces[0], abs=1e-8 * np.abs(forces[0]).max())


def test_ghosts_of_surfaces(comm):
    """Of several pieces every rank has all cells at the surfaces, of one piece those of facets."""
    for scene in (rings("triangle", (24, 36), (1.0, 2.0, 3.0), comm=comm), cylinder(comm, WEIGHT)):
        mesh = scene.mesh
        dim, imap = mesh.topology.dim, mesh.topology.index_map(mesh.topology.dim - 1)
        outer = outer_facets(mesh)
        count = global_sum(comm, outer[: imap.size_local].sum())
        assert (outer.sum() == count) == (dim == 2 or comm.size == 1)
        names = imap.local_to_global(np.flatnonzero(outer).astype(np.int32))
        everywhere = np.concatenate(comm.allgather(names[: outer[: imap.size_local].sum()]))
        assert set(names) <= set(everywhere)
        assert len(everywhere) == count == len(set(everywhere))


def test_leaves(comm):
    """A ring of all ranks' cells: neighbours stay, leaves hang on their cell, names are unique."""
    per_rank, leaves = 3, np.array([0, 2, 1], dtype=np.int32)
    total, first = per_rank * comm.size, per_rank * comm.rank
    here = first + np.arange(per_rank)
    ring = np.column_stack([(here - 1) % total, (here + 1) % total]).ravel()
    offsets = np.arange(0, 2 * per_rank + 1, 2, dtype=np.int32)
    graph = with_leaves(comm, AdjacencyList_int64(ring.astype(np.int64), offsets), leaves)
    block = per_rank + leaves.sum()  # of every rank: its cells, then their leaves
    name = lambda cell: cell // per_rank * block + cell % per_rank  # noqa: E731
    start = comm.rank * block
    expected = [{name(cell) for cell in pair} for pair in ring.reshape(-1, 2)]
    expected[1] |= {start + 3, start + 4}
    expected[2] |= {start + 5}
    expected += [{start + 1}, {start + 1}, {start + 2}]
    assert [set(graph.links(i)) for i in range(block)] == expected


def test_bad_weight():
    with pytest.raises(ValueError, match="weight = 0 must be at least 1"):
        between_bodies(np.zeros(3, dtype=np.int32), 0)
