"""Meshes of two arms or plates with a crack between them."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from support.checks import integral
from support.scenes import cell_count

import vmdg
from vmdg.base.parallel import global_sum
from vmdg.domain.topology import facet_cells
from vmdg.meshes import beams, plates
from vmdg.meshes.beams import INTERFACE, SLIT

X, Y = (0.0, 2.0, 3.0, 3.5, 5.0), (0.0, 1.0, 4.0)


def test_slit_is_open(comm):
    """Lips are boundary; the bond starts at the tip; arms differ in height and rows."""
    mesh, cells, facets = beams(comm, "quadrilateral", (0, 1, 4), (6, 18), (2.0, 1.0), (5, 3), 1)
    lips = facets.find("slit")
    assert (facet_cells(mesh)[lips, 1] == -1).all()
    dx = ufl.Measure("dx", domain=mesh, subdomain_data=cells)
    one = fem.Constant(mesh, 1.0)
    assert [integral(comm, one * dx(tag)) for tag in (1, 2)] == pytest.approx([8.0, 4.0])
    bodies = dict.fromkeys((1, 2), vmdg.NeoHookean(E=4000.0, nu=0.44))
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(strength=200.0, critical_gap=0.2))
    problem = vmdg.Problem(mesh, cells, bodies, [bond])
    assert comm.allreduce(len(problem.state[0].weights)) == 2 * 18
    assert comm.allreduce(problem.state[0].weights.sum()) == pytest.approx(3.0)
    # 25 x 6 nodes below and 25 x 4 above.
    assert problem.space.dofmap.index_map.size_global == 25 * (6 + 4)


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


def test_beams_refused(comm):
    """Refused with the name of what is wrong."""
    with pytest.raises(ValueError, match="cell = 'hexahedron'"):
        beams(comm, "hexahedron")
    with pytest.raises(ValueError, match="stations must ascend"):
        beams(comm, stations=(0.0, 30.0, 20.0))
    with pytest.raises(ValueError, match="precrack = 31"):
        beams(comm, precrack=31.0)
    with pytest.raises(ValueError, match="contact = 60"):
        beams(comm, stations=(0.0, 30.0, 60.0, 100.0), divisions=(3, 3, 4), contact=60.0)


def test_groups_of_plates(comm):
    """Cells, and areas of all groups of facets: every facet is in its place once."""
    tagged = plates(comm, X, Y, height=0.5, rows=2, precrack=3.0)
    mesh, cells, facets = tagged
    owned = mesh.topology.index_map(3).size_local
    assert global_sum(comm, owned) == 2 * 2 * 4 * 2
    middles = compute_midpoints(mesh, 3, np.arange(cell_count(mesh), dtype=np.int32))
    assert ((middles[:, 2] > 0) == (cells.values == cells.names["upper plate"])).all()
    mesh.topology.create_connectivity(2, 3)
    own = mesh.topology.index_map(2).size_local
    counts = {
        name: int(global_sum(comm, int((facets.find(name) < own).sum()))) for name in facets.names
    }
    assert counts == {
        "lower left": 4,
        "upper left": 4,
        "right": 8,
        "bottom": 8,
        "top": 8,
        "interface": 4,
        "slit": 8,
    }
    for tag, (low, high) in {INTERFACE: (3, 5), SLIT: (0, 3)}.items():
        at = compute_midpoints(mesh, 2, facets.find(tag))
        assert (at[:, 2] == 0).all()
        assert ((low < at[:, 0]) & (at[:, 0] < high)).all()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"x": (0.0, 2.0, 2.0)}, "x = .* must ascend"),
        ({"y": (0.0,)}, "y = .* two at least"),
        ({"precrack": 2.5}, "precrack = 2.5 must be one of the planes inside"),
        ({"precrack": 5.0}, "precrack = 5.0 must be one of the planes inside"),
    ],
)
def test_plates_refused(comm, changed, message):
    """Planes that make no plates."""
    with pytest.raises(ValueError, match=message):
        plates(comm, **({"x": X, "y": Y, "precrack": 3.0} | changed))
