"""A fluid between the faces of bodies that share no nodes."""

from __future__ import annotations

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from support.apart import block, rings, stack
from support.checks import tangent_error
from support.problems import (
    PRECISE,
    SAME,
    joined,
    set_displacement,
    through,
)
from support.scenes import DIMENSION

import vmdg
from vmdg.meshes import apart

SOFT = vmdg.NeoHookean(E=1000.0, nu=0.3)

#: Cell, degree, kinematics.
CASES = pytest.mark.parametrize(
    ("cell", "degree", "kinematics"),
    [
        ("triangle", 2, "finite"),
        ("quadrilateral", 1, "small"),
        ("quadrilateral", 2, "finite"),
        ("tetrahedron", 1, "finite"),
        ("hexahedron", 1, "small"),
    ],
)


#: Large bodies: differences of residuals reach across few switches of points [mm].
SIZE = 50.0


def bulge(problem, scene, opening):
    """Open the inside of the interface; its rim stays closed."""
    d = scene.mesh.geometry.dim

    def field(x, tag):
        x = x[:d] / SIZE
        rim = np.prod(x[: d - 1] * (2.0 - x[: d - 1]), axis=0)
        u = opening * np.sin(x[::-1])
        u[d - 1] += opening * (tag == 2) * rim
        u[0] += 0.5 * opening * (tag == 2) * rim
        return SIZE * u

    set_displacement(problem.u, scene.cell_tags, field)


@CASES
def test_tangent_and_balance(cell, degree, kinematics):
    """On other meshes: differences of residuals; a fluid in a closed crack has no resultant."""
    ratio = (3, 4) if DIMENSION[cell] == 2 else (2, 3)
    scene = stack(cell, *ratio, (1, 1), move=lambda x: SIZE * x)
    given = {"frame": "corotating", "name": "crack"}
    law = vmdg.Debonding(strength=50.0, critical_gap=0.3 * SIZE, friction=0.5)
    problem = joined(scene, law, SAME, given, degree=degree, kinematics=kinematics)
    problem.pressure("crack", lambda t: 100.0 * t)
    through(problem, *(partial(bulge, problem, scene, s) for s in (0.05, 0.08)))
    problem.loading.move(1.0)
    assert tangent_error(problem) < 1e-7
    forces, d = (
        problem.loading.vector.reshape(-1, scene.mesh.geometry.dim),
        problem.mesh.geometry.dim,
    )
    x = problem.space.tabulate_dof_coordinates()[:, :d]
    if kinematics == "finite":
        x = x + problem.u.x.array.reshape(-1, d)
    size = np.abs(forces).sum()
    assert size > 10.0
    if degree == 2 or kinematics == "small":
        # With linear cells, the rims of other meshes part.
        assert np.abs(forces.sum(axis=0)).max() < 1e-13 * size
        moments = np.einsum("ni,nj->ij", x, forces)
        assert np.abs(moments - moments.T).max() < 1e-13 * size


def fluid_ring(comm, cells, cell):
    """Largest relative error of the opening of two rings with a fluid between them, by Lame."""
    inner, middle, outer = 0.5, 1.0, 2.0
    scene = rings(cell, cells, (inner, middle, outer), 2, comm)
    find = scene.facet_tags.find
    E, nu, p = 1000.0, 0.3, 5.0
    body = vmdg.NeoHookean(E=E, nu=nu)
    crack = vmdg.Interface(surfaces=(find(12), find(21)), law=vmdg.Contact(), name="crack")
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, {1: body, 2: body}, [crack], degree=2, kinematics="small"
    )
    for k, axis in enumerate("xy"):
        problem.dirichlet(lambda x, k=k: np.isclose(x[k], 0.0), 0.0, axis)
    problem.pressure("crack", lambda t: p * t)
    vmdg.solve(problem, [1.0], PRECISE)
    state, energy = problem.state[0], problem.energy()
    assert not state.traction.any()
    assert abs(energy.imbalance) < 1e-11 * energy.external

    def widening(a, b):
        """Of a tube between radii under p at the first one [mm]."""
        return p * (1 + nu) / E * a / (b**2 - a**2) * ((1 - 2 * nu) * a**2 + b**2)

    exact = widening(middle, outer) - widening(middle, inner)
    opening = np.einsum("pi,pi->p", state.opening, state.normal)
    assert energy.external == pytest.approx(p * exact * np.pi / 2 * middle / 2, rel=1e-3)
    return comm.allreduce(np.abs(opening / exact - 1).max(initial=0.0), MPI.MAX)


@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_rings(comm, cell):
    """Rings of 2:3 and 3:2 cells around, curved: the closed form, errors of the third order and
    within 1.5 times those of meshes that match, with the fewer cells of both."""
    for cells in ((16, 24), (24, 16)):
        coarse, fine = (fluid_ring(comm, tuple(n * k for k in cells), cell) for n in (2, 4))
        assert np.log2(coarse / fine) > 3.0 - 0.2
        assert fine < 1.5 * fluid_ring(comm, (64, 64), cell)


@pytest.mark.filterwarnings("ignore:plastic flow keeps the volume")
def test_ranks_without_points(comm):
    """A column whose interface is at its foot: on two ranks and more, one has no points. Forces are
    those of one rank, also with plastic cells on one side only."""
    metal = vmdg.J2(1000.0, 0.3, 12.0, hardening=60.0)
    for bodies in ((SOFT, SOFT), (metal, SOFT)):
        found = []
        for where in (comm, MPI.COMM_SELF):
            foot = block("triangle", (1, 1), [0.0, 0.0], [1.0, 1.0], 1, where)
            column = block("triangle", (1, 8), [0.0, 1.0], [1.0, 9.0], 2, where)
            scene = apart([foot, column])
            bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(15.0, 0.06), name="bond")
            given = dict(enumerate(bodies, start=1))
            problem = vmdg.Problem(scene.mesh, scene.cell_tags, given, [bond])
            problem.dirichlet(lambda x: np.isclose(x[1], 0.0), 0.0)
            problem.dirichlet(lambda x: np.isclose(x[1], 9.0), lambda t: (0.0, 0.02 * t))
            problem.pressure("bond", lambda t: 2.0 * t)
            counts = where.allgather(len(problem.state["bond"].weights))
            assert where.size == 1 or 0 in counts
            vmdg.solve(problem, [0.5, 1.0], PRECISE)
            mean = problem.mean("bond")
            top = problem.reaction(lambda x: np.isclose(x[1], 9.0))
            found.append([*top, *mean.opening, *mean.traction, mean.area])
        assert found[0] == pytest.approx(found[1], rel=1e-8, abs=1e-10)
        assert abs(found[1][1]) > 0.1


def test_refusals():
    """Ties have no gap; where bodies slide far the end of a fluid is not known."""
    scene = stack("quadrilateral", 2, 3)
    body = vmdg.NeoHookean(E=1000.0, nu=0.3)
    for options, kinematics, message in (
        ({"law": vmdg.Bonded()}, "finite", "is a tie"),
        ({"law": vmdg.Contact(), "sliding": True}, "finite", "slides at finite strain"),
        ({"law": vmdg.Contact(), "sliding": True}, "small", None),
    ):
        joint = vmdg.Interface(between=(1, 2), name="joint", **options)
        given = scene.mesh, scene.cell_tags, {1: body, 2: body}, [joint]
        problem = vmdg.Problem(*given, kinematics=kinematics)
        if message is None:
            problem.pressure("joint", 1.0)
            continue
        with pytest.raises(ValueError, match=message):
            problem.pressure("joint", 1.0)
