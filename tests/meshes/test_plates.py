"""Two plates of hexahedra with a slit between them."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx.mesh import compute_midpoints
from support.scenes import cell_count

from vmdg.base.parallel import global_sum
from vmdg.meshes import plates
from vmdg.meshes.beams import INTERFACE, SLIT

X, Y = (0.0, 2.0, 3.0, 3.5, 5.0), (0.0, 1.0, 4.0)


def test_groups(comm):
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
def test_refused(comm, changed, message):
    """Planes that make no plates."""
    with pytest.raises(ValueError, match=message):
        plates(comm, **({"x": X, "y": Y, "precrack": 3.0} | changed))
