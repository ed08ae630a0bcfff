"""Section 7.3: the mesh of the two plates and the coarse run of the demo."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import tearing as demo
import ufl
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from support.budgets import over_budget
from support.checks import integral

import vmdg
from vmdg.domain.topology import facet_cells
from vmdg.meshes import tearing

WIDTH, PRECRACK = 1.62, 0.405


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
def test_wrong_arguments(comm, wrong):
    """Arguments that cannot work are named."""
    with pytest.raises(ValueError, match=next(iter(wrong))):
        tearing(comm, **wrong)


def test_neo_hookean(comm, out):
    """Tearing starts at 4 % strain and ends at 14.75 %; iterations, energy and the law hold."""
    history = demo.main(mesh="coarse", out=str(out))
    comm.barrier()
    force, strain = history["force"], history["load"]
    assert np.isclose(strain[np.argmax(force)], 0.04, atol=1e-9)
    assert np.isclose(force.max(), 232.13, rtol=1e-4)
    assert 0.147 < strain[force < 1e-6 * force.max()][0] < 0.1482
    assert np.isclose(history["broken"][-1], 1.0)
    # On the line of the law at the tip; at the end Q counts the turning path of the gap too.
    opening, traction = history["tip_opening"], history["tip_traction"]
    open_points = (opening > 0.002) & (opening < 0.19)
    line = 200.0 * (1 - opening / 0.2)
    assert np.allclose(traction[open_points], line[open_points], atol=0.5)
    assert np.isclose(history["damage"][-1], 200.0 * 0.2 / 2 * (WIDTH - PRECRACK))
    assert abs(history["imbalance"][-1]) < 1e-3 * history["external"][-1]
    assert not over_budget("tearing", history)
    assert history["jump_steps"].sum() == 0
    assert (out / "tearing_neo-hookean.png").stat().st_size > 10_000


def test_rubber_does_not_tear(out):
    """Ogden, nu = 0.49986: the crack stays and blunts, the force still grows, nothing locks."""
    history = demo.tear("ogden", "coarse", 13, out, lambda problem, strain: None)
    assert history["broken"].max() == 0.0 and history["damaged"][-1] < 0.1
    assert (np.diff(history["force"]) > 0).all()
    assert np.isclose(history["force"][-1], 3.521, rtol=2e-3)
    assert not over_budget("tearing of rubber", history)
