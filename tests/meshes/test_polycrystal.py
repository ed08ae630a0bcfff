"""Grains fill the cell, follow the sizes asked for, and match across the sides."""

from __future__ import annotations

import numpy as np
import pytest
from support.cells import mismatch, volumes

import vmdg
from vmdg import compat
from vmdg.meshes import pack, polycrystal
from vmdg.meshes.tessellation import tessellate

GRAINS = {
    "plane": {"count": 12, "seed": 2, "size": 0.3},
    "spread": {"count": 12, "spread": 0.35, "cell": "quadrilateral"},
    "coarse": {"count": 60, "seed": 1, "element_size": 0.05},
    "two": {"count": 2, "seed": 4, "element_size": 0.05},
    "solid": {"count": 4, "dim": 3, "element_size": 0.2},
}


@pytest.mark.parametrize("name", GRAINS)
def test_grains_fill_the_cell(comm, name):
    """Volumes add up, sides match, and the facets between groups are those of the group."""
    tagged = polycrystal(**GRAINS[name], comm=comm)
    mesh, cells, facets = tagged
    size, dim = GRAINS[name].get("size", 1.0), mesh.geometry.dim
    assert sorted(cells.names.values()) == list(range(1, GRAINS[name]["count"] + 1))
    parts = list(volumes(tagged).values())
    assert min(parts) > 0.05 * size**dim / len(parts)
    assert sum(parts) == pytest.approx(size**dim)
    assert mismatch(tagged) < 1e-10 * size
    boundary = vmdg.Interface(facets.find("boundary"), law=vmdg.Bonded())
    bodies = dict.fromkeys(cells.names, vmdg.NeoHookean(E=1.0, nu=0.3))
    problem = vmdg.Problem(mesh, cells, bodies, [boundary], kinematics="small")
    tags = problem.step.activation.facets[0].tags
    assert comm.allreduce(int((tags[:, 0] != tags[:, 1]).sum())) > 10


def shortest_edge(mesh):
    """Of all cells, triangles or tetrahedra."""
    corners = mesh.geometry.x[compat.geometry_dofmap(mesh)]
    one, two = np.triu_indices(corners.shape[1], 1)
    lengths = np.linalg.norm(corners[:, one] - corners[:, two], axis=2)
    return min(mesh.comm.allgather(lengths.min(initial=np.inf)))


def test_no_short_edges(comm):
    """Grains of a few cells, ten times: no edge of a cell is much shorter than asked for."""
    for seed in range(10):
        mesh = polycrystal(15, seed, periodic=seed % 2 == 0, element_size=0.08, comm=comm).mesh
        assert shortest_edge(mesh) > 0.25 * 0.08


def test_short_edges_of_solids_are_points(comm):
    """Bodies stay whole, and sides fit, where edges of grains become points."""
    tagged = polycrystal(12, 1, dim=3, element_size=0.15, comm=comm)
    assert shortest_edge(tagged.mesh) > 0.1 * 0.15
    parts = list(volumes(tagged).values())
    assert min(parts) > 0.05 / len(parts)
    assert sum(parts) == pytest.approx(1.0)
    assert mismatch(tagged) < 1e-10


@pytest.mark.parametrize("dim", [2, 3])
def test_pieces_belong_to_the_nearest_seed(dim):
    """Every grain is the power cell of its seed: |x - s|^2 - r^2 is least at its midpoint."""
    seeds, radii = pack(12, 0.4, 5, False, 2.0, dim, 0.0, 0.3)
    grains = tessellate(seeds, radii**2, 2.0, False, 0.0)
    assert [grain for grain, _ in grains.pieces] == list(range(12))
    for grain, faces in grains.pieces:
        middle = grains.points[np.unique(np.concatenate(faces))].mean(axis=0)
        power = ((middle - seeds) ** 2).sum(axis=1) - radii**2
        assert power.argmin() == grain


def test_wrong_grains():
    """Errors say what is wrong."""
    with pytest.raises(ValueError, match="dim = 1 must be 2 or 3"):
        polycrystal(10, dim=1)
    with pytest.raises(ValueError, match="cell = 'hexahedron' in 3D must be one of"):
        polycrystal(10, dim=3, cell="hexahedron")
    with pytest.raises(ValueError, match="must be positive"):
        polycrystal(0)
    seeds, weights = np.array([[0.5, 0.5], [0.6, 0.5]]), np.array([0.0, 1.0])
    with pytest.raises(ValueError, match="the weight of seed 0 leaves it no cell"):
        tessellate(seeds, weights, 1.0, False, 0.0)
