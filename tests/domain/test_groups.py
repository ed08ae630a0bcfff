"""Groups by name, level sets and predicates select what tags and facets do, on any ranks."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx.mesh import CellType, GhostMode, create_rectangle

import vmdg
from vmdg import meshes
from vmdg.meshes import distribute, fibre_matrix, model

STEEL = vmdg.NeoHookean(E=5000.0, nu=0.25)
SOFT = vmdg.NeoHookean(E=1000.0, nu=0.3)
LAW = vmdg.Debonding(strength=10.0, critical_gap=0.2)


def radius(x):
    return np.hypot(x[0] - 0.5, x[1] - 0.5) - 0.25


def points(problem: vmdg.Problem) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the first interface on all ranks, sorted by place."""
    state = problem.state[0]
    rows = np.column_stack([state.points[:, :2].round(9), state.normal])
    rows = np.concatenate(problem.comm.allgather(rows))
    rows = rows[np.lexsort(rows[:, :2].T)]
    return rows[:, :2], rows[:, 2:]


def make(tagged, materials, **where) -> vmdg.Problem:
    interface = vmdg.Interface(**where, law=LAW)
    return vmdg.Problem(tagged.mesh, tagged.cell_tags, materials, [interface])


@pytest.fixture(scope="module")
def cell(comm):
    return fibre_matrix(comm, "triangle", element_size=0.15)


def test_names_are_tags(comm, cell):
    """Materials, interfaces, body forces, eigenstrains and facets by name and by number agree."""
    found = []
    for fibre, matrix, left in (("fibre", "matrix", "left"), (1, 2, 1)):
        interface = vmdg.Interface(between=(fibre, matrix), law=LAW)
        problem = vmdg.Problem(
            cell.mesh,
            cell.cell_tags,
            {fibre: STEEL, matrix: SOFT},
            [interface],
            eigenstrain={matrix: -0.001},
        )
        problem.dirichlet(cell.facet_tags.find(left), 0.0)
        problem.body_force([1.0, 0.0], tag=matrix)
        vmdg.solve(problem, [1.0])
        found.append(problem.reaction(cell.facet_tags.find(left)))
        assert sorted(problem.materials) == [1, 2]
    assert found[0] == pytest.approx(found[1], rel=1e-9)
    assert found[0][0] == pytest.approx(-(1 - np.pi / 16), rel=0.02)
    assert repr(cell.cell_tags) == "<NamedTags: fibre (1), matrix (2)>"


@pytest.mark.parametrize("way", ["level set", "predicate", "facets"])
def test_one_interface_in_several_ways(cell, way):
    """A level set, a predicate on vertices and facets by name are the facets between the tags."""
    where = {
        "level set": {"level_set": radius},
        "predicate": {"facets": lambda x: np.isclose(radius(x), 0, atol=1e-6)},
        "facets": {"facets": cell.facet_tags.find("interface")},
    }
    expected = points(make(cell, {1: STEEL, 2: SOFT}, between=(1, 2)))
    found = points(make(cell, {1: STEEL, 2: SOFT}, **where[way]))
    assert len(expected[0]) > 10
    for a, b in zip(found, expected, strict=True):
        assert a == pytest.approx(b, abs=1e-8)


@pytest.mark.parametrize("shape", [CellType.triangle, CellType.quadrilateral])
def test_level_set_on_a_mesh_without_tags(comm, shape):
    """Cells split by a level set: counts, names, and the normal leaves the inside."""
    corners = [(0.0, 0.0), (1.0, 1.0)]
    mesh = create_rectangle(comm, corners, (12, 12), shape, ghost_mode=GhostMode.shared_facet)
    tags = vmdg.split_cells(mesh, radius, "fibre")
    assert tags.names == {"outside": 1, "fibre": 2}
    number = mesh.topology.index_map(2)
    inside = comm.allreduce(int((tags.find("fibre") < number.size_local).sum()))
    assert inside / number.size_global == pytest.approx(np.pi / 16, rel=0.15)
    one = vmdg.split_cells(mesh, lambda x: -np.ones(x.shape[1]), "all")
    both = [
        vmdg.Problem(mesh, tags, {"outside": SOFT, "fibre": STEEL}, [interface])
        for interface in (
            vmdg.Interface(between=("outside", "fibre"), law=LAW),
            vmdg.Interface(level_set=radius, law=LAW),
        )
    ]
    both.append(vmdg.Problem(mesh, one, {"all": SOFT}, [vmdg.Interface(level_set=radius, law=LAW)]))
    found = [points(problem) for problem in both]
    for x, _ in found[1:]:
        assert x == pytest.approx(found[0][0], abs=1e-8)
    x, normal = found[2]
    assert (np.sum((x - 0.5) * normal, axis=1) > 0).all()
    # The tags decide where they differ: the matrix is side 1 there.
    assert found[1][1] == pytest.approx(-normal, abs=1e-8)


def test_split_one_group(comm, cell):
    """Only the cells of the group are split; others keep tag and name."""
    half = vmdg.split_cells(cell.mesh, lambda x: x[0] - 0.5, "half", cell.cell_tags, "matrix")
    assert half.names == {"fibre": 1, "matrix": 2, "half": 3}
    assert np.array_equal(half.find("fibre"), cell.cell_tags.find("fibre"))
    both = np.union1d(half.find("matrix"), half.find("half"))
    assert np.isin(cell.cell_tags.find("matrix"), both).all()
    with pytest.raises(ValueError, match="there is a group 'fibre' already"):
        vmdg.split_cells(cell.mesh, radius, "fibre", cell.cell_tags)
    with pytest.raises(ValueError, match="negative at no cell midpoint"):
        vmdg.split_cells(cell.mesh, radius, "core", cell.cell_tags, "matrix")


def test_mesh_without_groups_of_facets(comm):
    """Bodies alone are enough; there are no names of facets then."""
    with model("bodies") as gmsh_model:
        if comm.rank == 0:
            gmsh_model.occ.addRectangle(0, 0, 0, 1, 1, 1)
            gmsh_model.occ.synchronize()
            gmsh_model.addPhysicalGroup(2, [1], 5, "plate")
            gmsh_model.mesh.generate(2)
        tagged = distribute(gmsh_model, comm, 2)
    assert tagged.cell_tags.names == {"plate": 5}
    assert tagged.facet_tags.names == {}
    assert len(tagged.facet_tags.indices) == 0
    with pytest.raises(
        ValueError, match=r"no named group of dimension 1.*\(1, \[...\], name='left'"
    ):
        tagged.facet_tags.find("left")


SCENES = {
    "beams": {"divisions": (2, 3)},
    "blocks": {"cell": "hexahedron"},
    "fibre_cell": {"count": 2, "fraction": 0.3, "shape": "cylinder", "coating": 0.2},
    "fibre_matrix": {"element_size": 0.3},
    "polycrystal": {"count": 2, "dim": 3, "element_size": 0.4},
    "plates": {},
    "pushout": {"layers": 1, "around": 4, "fibre_rings": 1, "hole_rings": 1, "matrix_rings": 1},
    "pushout_section": {"layers": 1, "fibre_cells": 1, "matrix_cells": 1},
}


@pytest.mark.parametrize("scene", SCENES)
def test_scenes_name_all_their_groups(comm, scene):
    """Every tag of cells and facets of a scene has one name."""
    tagged = getattr(meshes, scene)(comm=comm, **SCENES[scene])
    for tags in (tagged.cell_tags, tagged.facet_tags):
        there = np.unique(np.concatenate(comm.allgather(np.unique(tags.values))))
        assert sorted(tags.names.values()) == there.tolist()
