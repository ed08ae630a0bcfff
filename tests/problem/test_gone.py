"""Problems that nobody names any more are gone at once, with their meshes and communicators."""

from __future__ import annotations

import gc
import weakref

import numpy as np
from dolfinx import fem
from support.problems import hold, joined
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg

BOTTOM, TOP = 4, 5
BOND = vmdg.Debonding(strength=10.0, critical_gap=0.05)


def loaded(comm, **interface):
    """Bonded blocks with loads and supports of every kind."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = joined(scene, BOND, interface={"name": "bond", **interface})
    find = scene.facet_tags.find
    hold(problem, scene, LEFT, component="x")
    zero = fem.Function(fem.functionspace(scene.mesh, ("P", 1, (2,))))
    problem.dirichlet(find(BOTTOM), zero, "y")
    problem.dirichlet_points(lambda x: np.isclose(x[0], 2) & (x[1] < 0.1), 0.0, "y")
    problem.traction(find(TOP), lambda t: np.array([0.0, 0.01 * t]))
    problem.body_force(lambda t: np.array([0.0, 0.01 * t]))
    problem.point_load(lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 1), (0.0, 0.01))
    problem.spring(find(TOP), 1e-3)
    problem.pressure(find(TOP), 0.01)
    problem.pressure("bond", 0.01, debonded=True)
    problem.rigid_face(find(RIGHT), "x", displacement=lambda t: 0.04 * t)
    return problem


def solved(comm):
    """A problem whose facets have opened on demand, with its stress."""
    problem = loaded(comm, activate="on-demand")
    vmdg.solve(problem, [0.5, 1.0])
    problem.stress()
    assert problem.energy().dissipated > 0
    return problem


def test_gone_with_its_last_name(comm):
    """Nothing waits for Python's collector: MPICH has 2048 communicators, a problem some 30."""
    solved(comm)  # where FFCx compiles, UFL leaves circles of its own
    gc.collect()
    gc.disable()
    try:
        problem = solved(comm)
        held = [problem, problem.mesh, problem.discretization, problem.space, problem.u]
        gone = [weakref.ref(one) for one in held]
        del problem, held
        assert [ref() for ref in gone] == [None] * len(gone)
    finally:
        gc.enable()
