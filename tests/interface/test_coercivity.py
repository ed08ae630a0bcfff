"""safety="auto": no more than coercivity asks for, no coarser than fixed factors, on any ranks."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support import random_cells
from support.checks import by_position, gather
from support.problems import MATERIALS, joined
from support.scenes import (
    DIMENSION,
    EVERY_CELL,
    SEVERAL_RANKS,
    deform,
    distort,
    everywhere,
    tag_cells,
    two_blocks,
    unit_box,
)

import vmdg
from vmdg.interface import coercivity

# Coercivity

#: 1 - alpha of a tie.
USED = 1 - coercivity.margin(vmdg.Bonded(), 1)


def multiplied(problem: vmdg.Problem, factor: float):
    """A stabilization that multiplies the tau_s of ``problem`` by ``factor``."""
    safety = factor * problem.stabilization[0].safety

    def stabilization(tau1, tau2, context):
        bonded = np.linalg.inv(tau1 + tau2)
        return safety[:, None, None] * bonded, bonded @ tau1

    return {"law": vmdg.Bonded(), "stabilization": stabilization}


@EVERY_CELL
def test_margin(cell):
    """1 - alpha times the factor suffices for all u: the rest is what keeps alpha of the energy."""
    configurations = random_cells.Case(cell, 1, True, 60).draw(1)
    auto = configurations.problem(law=vmdg.Bonded())
    less = configurations.problem(**multiplied(auto, USED))
    assert (configurations.lowest(less) > -random_cells.ROUNDING).all()


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_no_more_than_needed(cell):
    """Alike cells near incompressibility: .95 (1 - alpha) times the factor is too little."""
    draw = random_cells.Range(aspect=0.0, contrast=0.0, nu=(0.499, 0.499), strain=0, distortion=0)
    configurations = random_cells.Configurations(cell, random_cells.pair(cell), 20, 1, draw, 2)
    auto = configurations.problem(law=vmdg.Bonded())
    assert (USED * auto.stabilization[0].safety > 1.5).all()
    short = configurations.problem(**multiplied(auto, 0.95 * (USED)))
    assert (configurations.lowest(short) < -random_cells.ROUNDING).all()


@pytest.mark.parametrize("frame", ["reference", "corotating"])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_interface_that_can_fail(cell, frame):
    """The scalar r with tensor or isotropic flux weights, while it is bonded."""
    law = vmdg.Debonding(strength=1e12, critical_gap=1e12)
    for alone in (True, False):
        configurations = random_cells.Case(cell, 1, alone, 60).draw(3)
        problem = configurations.problem(law=law, frame=frame)
        assert (configurations.lowest(problem) > -random_cells.ROUNDING).all()


# States in which A is not positive


# r and H


def test_r_stays_clear_of_softening(comm):
    """r = 2 H wherever coercivity asks for less."""
    scene = two_blocks(comm, "quadrilateral")

    def r(H):
        law = vmdg.Debonding(strength=100.0, critical_gap=100.0 / H)
        return gather(comm, joined(scene, law).stabilization[0].norm)

    needed = r(1e-6)
    assert r(0.49 * needed[0]) == pytest.approx(needed, rel=1e-12)
    for factor in (0.51, 4.1, 1e3):
        assert r(factor * needed[0]) == pytest.approx(2 * factor * needed[0], rel=1e-12)


# Ranks


@SEVERAL_RANKS
@EVERY_CELL
def test_factors_do_not_depend_on_ranks(comm, cell):
    """All facets of a distorted mesh are interfaces: the same factors on one rank and on all."""

    def build(comm):
        mesh = unit_box(comm, cell, 3)
        deform(mesh, np.diag([0.3, 1.0, 1.0]))
        distort(mesh, 0.02)
        interface = vmdg.Interface(within=1, law=vmdg.Bonded())
        problem = vmdg.Problem(
            mesh, tag_cells(mesh, {1: everywhere}), {1: MATERIALS[0]}, [interface]
        )
        problem.u.interpolate(lambda x: 0.1 * np.sin(3 * x[: DIMENSION[cell]]))
        problem.u.x.scatter_forward()
        problem.discretization.update_stabilization()
        quadrature = problem.discretization.active[0].quadrature
        points = quadrature.points[quadrature.points_of_facet].mean(axis=1)
        return by_position(comm, points, problem.stabilization[0].safety)

    build(comm)  # compiles on one rank before every rank works alone
    (here, factors), (there, alone) = build(comm), build(MPI.COMM_SELF)
    assert here == pytest.approx(there, abs=1e-12)
    assert factors == pytest.approx(alone, rel=1e-9)
    assert factors.max() > 1.1


# Accuracy: polynomials that solve Lame's equations on both sides of x = 1 without body force
