"""Sides, signs and points of an interface, given by any rank."""

from __future__ import annotations

import re

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, la
from dolfinx.mesh import GhostMode, compute_midpoints
from support.checks import by_position, gather
from support.problems import MATERIALS, joined
from support.scenes import (
    CELLS,
    DIMENSION,
    EVERY_CELL,
    EVERY_DEGREE,
    SEVERAL_RANKS,
    deform,
    distort,
    everywhere,
    tag_cells,
    unit_box,
)

import vmdg
from vmdg.base.kernels import compile_form
from vmdg.base.quadrature import facet_degree
from vmdg.domain.shapes import places_in_cells
from vmdg.domain.topology import tags_of_cells
from vmdg.meshes import blocks
from vmdg.points.facets import find_facets
from vmdg.points.interface import Interface
from vmdg.points.points import FacetPoints

N = 4  # cells along each side of the unit box
SHEAR = np.array([[1.2, 0.3, 0.1], [-0.2, 0.9, 0.25], [0.15, -0.1, 1.1]])


def points_of(mesh, tags, interface: Interface, degree: int = 1) -> FacetPoints:
    facets = find_facets(mesh, tags_of_cells(mesh, tags), interface)
    return FacetPoints(mesh, facets, facet_degree(degree))


def is_inclusion(x):
    return np.abs(x - 0.5)[: 2 if np.ptp(x[2]) == 0 else 3].max(axis=0) < 0.25


# Sides and signs


@EVERY_CELL
@pytest.mark.parametrize(("inner", "outer"), [(1, 2), (7, 3)])
def test_flux_of_normal(comm, cell, inner, outer):
    """int N = 0 and int X.N = d |body 1| on a closed interface: N leaves side 1, the lower tag."""
    mesh = unit_box(comm, cell, N)
    tags = tag_cells(mesh, {outer: everywhere, inner: is_inclusion})
    deform(mesh, SHEAR)
    d = DIMENSION[cell]
    quadrature = points_of(mesh, tags, Interface(between=(outer, inner), law=vmdg.Bonded()))
    flux = comm.allreduce(quadrature.weights @ quadrature.normal)
    outward = np.sum(quadrature.points[:, :d] * quadrature.normal, axis=1)
    swept = comm.allreduce(quadrature.weights @ outward)
    volume = np.linalg.det(SHEAR[:d, :d]) * 0.5**d
    lower = np.concatenate([quadrature.facets.tags[:, 0], [min(inner, outer)]])
    assert (gather(comm, lower) == min(inner, outer)).all()
    # Rounding of sums over a few hundred points; all integrands are integrated exactly.
    assert np.abs(flux).max() < 1e-13
    sign = 1 if inner < outer else -1  # seen from outside, the inclusion is a hole
    assert swept == pytest.approx(sign * d * volume, rel=1e-12)


@SEVERAL_RANKS
@EVERY_CELL
def test_sides_of_equal_tags_ignore_the_partition(comm, cell):
    """Inside one tag every facet has the same side 1 on any number of ranks."""
    found = []
    for where in (comm, MPI.COMM_SELF)[: comm.size]:
        mesh = unit_box(where, cell, N)
        distort(mesh, 0.03)
        tags = tag_cells(mesh, {1: everywhere})
        quadrature = points_of(mesh, tags, Interface(within=1, law=vmdg.Bonded()))
        found.append(by_position(where, quadrature.points, quadrature.normal))
    assert len(found[0][0]) == len(found[-1][0])
    for distributed, alone in zip(found[0], found[-1], strict=True):
        assert np.abs(distributed - alone).max() < 1e-12


# Facet points


@EVERY_CELL
@EVERY_DEGREE
def test_points_line_up_on_both_sides(comm, cell, degree):
    """A point has the same position by its place in the cell of either side, and the area of its
    facet by its weight."""
    mesh = unit_box(comm, cell, 3)
    distort(mesh, 0.04)
    tags = tag_cells(mesh, {1: everywhere, 2: lambda x: x[0] + x[1] > 1.0})
    quadrature = points_of(mesh, tags, Interface(between=(1, 2), law=vmdg.Bonded()), degree)
    facets, d = quadrature.facets, DIMENSION[cell]
    for cells, places in zip(facets.cells.T, quadrature.places(), strict=True):
        X = places_in_cells(mesh, cells, places)[0].reshape(-1, d)
        assert np.abs(X - quadrature.points[:, :d]).max(initial=0.0) < 1e-14
    dS = ufl.Measure(
        "dS",
        domain=mesh,
        subdomain_data=[(0, facets.rows(facets.tags[:, 0] > 0))],
        metadata={"quadrature_degree": quadrature.degree},
    )
    area = fem.assemble_scalar(compile_form(fem.Constant(mesh, 1.0) * dS(0), comm))
    assert comm.allreduce(quadrature.weights.sum()) == pytest.approx(comm.allreduce(area))


# Refusals


@pytest.mark.parametrize("cell", CELLS)
def test_steep_softening_names_a_size_that_works(comm, cell):
    """r <= H is refused with facet, r, H and an element size; just below this size it works."""
    d = DIMENSION[cell]
    law = vmdg.Debonding(strength=100.0, critical_gap=1e-4)

    def build(size: float):
        scene = blocks(
            comm, cell, (1,) * d, length=2 * size, height=size, depth=size, interface=(size, size)
        )
        return joined(scene, law, (MATERIALS[0],) * 2, {"safety": 4.0})

    message = (
        r"facet (\d+) has r = \|tau_s\| = (\S+) MPa/mm, not above the softening modulus "
        r"H = (\S+) MPa/mm: .* Refine the facet from (\S+) to below (\S+) mm"
    )
    with pytest.raises(ValueError, match=message) as refusal:
        build(2.0)
    _, r, H, now, size = map(float, re.search(message, str(refusal.value)).groups())
    assert r <= H == 1e6
    assert size < now
    # The message has three digits.
    factor = size / now
    with pytest.raises(ValueError, match="softening modulus"):
        build(2.0 * factor * 1.01)
    assert comm.allreduce(build(2.0 * factor * 0.99).stabilization[0].norm.sum()) > H


@SEVERAL_RANKS
def test_mesh_without_ghosts(comm):
    """A distributed mesh without facet ghosts is refused, with the option that makes them."""
    mesh = unit_box(comm, "triangle", 8, ghosts=GhostMode.none)
    tags = tag_cells(mesh, {1: everywhere})
    with pytest.raises(RuntimeError, match=r"no facet ghosts.*GhostMode.shared_facet"):
        vmdg.Problem(mesh, tags, {1: MATERIALS[0]}, [Interface(within=1, law=vmdg.Bonded())])


def test_facets_given_by_any_rank(comm):
    """Facets that several ranks know may be given by any of them: nothing is lost or doubled."""
    found = []
    for who in ("everyone", "owner", "others"):
        mesh = unit_box(comm, "quadrilateral", 6)
        tags = tag_cells(mesh, {1: everywhere})
        mesh.topology.create_connectivity(1, 2)
        facets = mesh.topology.index_map(1)
        # Of a ghost facet a rank may see one cell only, so it cannot tell that it is interior.
        local = np.arange(facets.size_local + facets.num_ghosts, dtype=np.int32)
        chosen = local[np.isclose(compute_midpoints(mesh, 1, local)[:, 0], 0.5)]
        if who == "owner":
            chosen = chosen[chosen < facets.size_local]
        if who == "others":
            ghosts = la.vector(facets)
            ghosts.array[facets.size_local :] = 1
            ghosts.scatter_reverse(la.InsertMode.add)  # to owners: how many others know it
            given = (ghosts.array == 0) | (local >= facets.size_local)
            chosen = chosen[given[chosen]]
        quadrature = points_of(mesh, tags, Interface(facets=chosen, law=vmdg.Bonded()))
        found.append(by_position(comm, quadrature.points, quadrature.weights))
    for points, weights in found:
        assert weights.sum() == pytest.approx(1.0, rel=1e-13)
        assert np.abs(points - found[0][0]).max() < 1e-13
