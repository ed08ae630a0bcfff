"""Meshes of scenes: the push-out in 3D, plates with a slit, beams with a crack."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from support.checks import integral

import vmdg
from vmdg.domain.topology import facet_cells
from vmdg.meshes import beams, core_and_ring, pushout, tearing
from vmdg.meshes.pushout import (
    FIBRE,
    FIBRE_BOTTOM,
    FIBRE_TOP,
    HOLE,
    INTERFACE,
    MATRIX,
    MATRIX_TOP,
    OUTER,
    SUPPORT,
    SYMMETRY_X,
    SYMMETRY_Y,
    layer_tops,
)

R_F, R_S, R_M, H = 0.95, 1.025, 4.3, 5.36
COARSE = {"layers": 6, "around": 6, "fibre_rings": 2, "hole_rings": 1, "matrix_rings": 5}
WIDTH, PRECRACK = 1.62, 0.405


def test_pushout(comm):
    """Areas of a polygon with 24 corners, numbers of cells and facets, on any number of ranks."""
    mesh, cells, facets = pushout(comm, **COARSE)
    count = mesh.topology.index_map(3).size_local
    found = [comm.allreduce(int((cells.find(tag) < count).sum())) for tag in (FIBRE, MATRIX)]
    assert found == [6 * (9 + 12), 6 * 6 * 6]
    polygon = 6 * np.sin(np.pi / 12)  # quarter of a polygon of 24 corners, radius 1
    side = 12 * np.sin(np.pi / 24) * H  # quarter of its prism
    exact = {
        FIBRE_TOP: polygon / 2 * R_F**2,
        FIBRE_BOTTOM: polygon / 2 * R_F**2,
        MATRIX_TOP: polygon / 2 * (R_M**2 - R_F**2),
        HOLE: polygon / 2 * (R_S**2 - R_F**2),
        SUPPORT: polygon / 2 * (R_M**2 - R_S**2),
        OUTER: side * R_M,
        SYMMETRY_X: R_M * H,
        SYMMETRY_Y: R_M * H,
        INTERFACE: side * R_F,
    }
    for tag, area in exact.items():
        kind = "dS" if tag == INTERFACE else "ds"
        measure = ufl.Measure(kind, mesh, subdomain_data=facets, subdomain_id=tag)
        form = fem.Constant(mesh, 1.0) * measure
        assert integral(comm, form) == pytest.approx(area, rel=1e-9), tag


def test_layers_of_the_pushout():
    """Graded layers are symmetric, fill the height, and the middle one is the highest."""
    sizes = np.diff([0.0, *layer_tops(7, 3.0)])
    assert sizes.sum() == pytest.approx(1)
    assert sizes == pytest.approx(sizes[::-1])
    assert sizes[3] / sizes[0] == pytest.approx(3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hole_radius": 0.9}, "must increase from 0"),
        ({"around": 5}, "even"),
        ({"layers": 0}, "positive"),
        ({"grading": 0.0}, "positive"),
    ],
)
def test_errors_of_the_pushout(comm, options, message):
    """Radii out of order, counts that make no mesh."""
    with pytest.raises(ValueError, match=message):
        pushout(comm, **(COARSE | options))


def count(mesh, dim: int, entities) -> int:
    """Owned ones of local entities, over all ranks."""
    owned = mesh.topology.index_map(dim).size_local
    return mesh.comm.allreduce(int((np.asarray(entities) < owned).sum()))


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_plates(comm, cell):
    """Areas and tags of both plates; the sizes are parameters."""
    mesh, cells, facets = tearing(comm, cell, 2.0, 1.0, 0.5, (8, 4, 2), 0.5)
    split = 2 if cell == "triangle" else 1
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=cells)
    one = fem.Constant(mesh, 1.0)
    areas = [integral(comm, one * dx(tag)) for tag in (1, 2)]
    assert np.allclose(areas, [2.0, 1.0])
    assert [count(mesh, 2, cells.find(tag)) for tag in (1, 2)] == [32 * split, 16 * split]
    numbers = [count(mesh, 1, facets.find(tag)) for tag in range(1, 8)]
    assert numbers == [8, 8, 6, 2, 2, 6, 6]


def test_slit_is_open(comm):
    """Lips are boundary; the bond starts at the tip, whose two sides are nodes of their own."""
    mesh, cells, facets = tearing(comm, divisions=(24, 20, 10))
    lips = np.concatenate([facets.find(4), facets.find(5)])
    assert (facet_cells(mesh)[lips, 1] == -1).all()
    x = compute_midpoints(mesh, 1, facets.find(3))
    assert comm.allreduce(x[:, 0].min(initial=9.0), op=MPI.MIN) > PRECRACK
    materials = {1: vmdg.NeoHookean(E=4000.0, nu=0.44), 2: vmdg.NeoHookean(E=16000.0, nu=0.44)}
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(strength=200.0, critical_gap=0.2))
    problem = vmdg.Problem(mesh, cells, materials, [bond])
    assert comm.allreduce(len(problem.state[0].weights)) == 2 * 18
    length = comm.allreduce(problem.state[0].weights.sum())
    assert np.isclose(length, WIDTH - PRECRACK)
    # 25 x 21 nodes below and 25 x 11 above.
    assert problem.space.dofmap.index_map.size_global == 25 * 21 + 25 * 11


@pytest.mark.parametrize("wrong", [{"cell": "hexahedron"}, {"precrack": 0.0}, {"precrack": 1.62}])
def test_wrong_plates(comm, wrong):
    """Arguments that cannot work are named."""
    with pytest.raises(ValueError, match=next(iter(wrong))):
        tearing(comm, **wrong)


@pytest.mark.parametrize(("contact", "slit", "touching"), [(None, 8, 0), (1.0, 4, 2), (2.0, 0, 4)])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_mesh_of_beams(comm, cell, contact, slit, touching):
    """The parts of the crack have tags; a slit has twice the facets, one for each lip."""
    tagged = beams(comm, cell, (0.0, 1.0, 2.0, 5.0), (2, 2, 6), 1.0, 2, 2.0, contact)
    tags = tagged.facet_tags
    own = tagged.mesh.topology.index_map(1).size_local

    def count(tag):
        return comm.allreduce(int((tags.find(tag) < own).sum()))

    assert [count(tag) for tag in range(1, 9)] == [2, 2, 4, 10, 10, 6, slit, touching]


def test_errors_of_the_meshes(comm):
    """Refused with the name of what is wrong."""
    with pytest.raises(ValueError, match="cell = 'hexahedron'"):
        beams(comm, "hexahedron")
    with pytest.raises(ValueError, match="stations must ascend"):
        beams(comm, stations=(0.0, 30.0, 20.0))
    with pytest.raises(ValueError, match="precrack = 31"):
        beams(comm, precrack=31.0)
    with pytest.raises(ValueError, match="contact = 60"):
        beams(comm, stations=(0.0, 30.0, 60.0, 100.0), divisions=(3, 3, 4), contact=60.0)
    with pytest.raises(ValueError, match="radius = 3"):
        core_and_ring(comm, radius=3.0)
