"""Surfaces that slide far in time: blocks that slow down, are thrown, and break loose."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx import fem
from support.apart import block
from support.problems import of_two
from support.scenes import DIMENSION, SEVERAL_RANKS

import vmdg
from vmdg.meshes import apart

#: Of explicit steps, see test_critical_step_of_tilted_blocks.
pytestmark = pytest.mark.filterwarnings("ignore:solve_dynamics. surfaces that slide")

MU, RHO, N = 0.3, 1e-3, 2.0  # friction, t/mm3, MPa
ENERGY = vmdg.SolveOptions(energy=True)
#: Of a block that is thrown [s].
TIMES = np.linspace(0.0, 2e-3, 81)[1:]
EVERY_SCHEME = pytest.mark.parametrize(
    "scheme", [vmdg.GeneralizedAlpha(), vmdg.CentralDifferences()], ids=str
)


def on_base(comm, cell, cells, base, law, nu=0.0, gap=0.0, press=None, beta=0.0):
    """A block of 1 x .6 mm on a rigid base of 4 mm with another mesh, pressed by a function of
    time on its upper side; and the velocity of the block [mm/s] as a function of a vector."""
    d = DIMENSION[cell]
    wide, deep = ([0.4], [0.0]) if d == 3 else ([], [])
    low, high = [0.6, *wide, gap], [1.6, *(w + 1 for w in wide), gap + 0.6]
    parts = [
        block(cell, cells, low, high, 1, comm),
        block(cell, base, [0.0, *deep, -0.6], [4.0, *(2.0 for _ in deep), 0.0], 2, comm),
    ]
    scene = apart(parts)
    problem = of_two(
        scene,
        law,
        (vmdg.NeoHookean(E=1000.0, nu=nu), vmdg.Rigid()),
        {"sliding": True, "gap": "keep", "name": "base"},
        density={1: RHO},
        damping=vmdg.Rayleigh(beta=beta),
    )
    if press is not None:
        down = -np.eye(d)[-1]
        problem.traction(scene.facet_tags.find(12), lambda t: press(t) * down)
    moving = np.unique(problem.space.dofmap.list[problem.discretization.bodies.cells_of[1]])

    def velocity(v):
        field = fem.Function(problem.space)
        field.x.array.reshape(-1, d)[moving] = v
        return field

    return problem, velocity


def watched(problem):
    """Mean velocity of the block, the pressure on it, and the share that has debonded."""
    motion, owned, d = problem.step.motion, problem.discretization.owned, problem.mesh.geometry.dim
    v = problem.velocity.x.array[:owned]
    P = motion.of(v) if motion.lumped is None else motion.lumped * v
    m, sums = motion.row_sums, np.zeros((2, d))
    # The base is at rest, and has no mass.
    np.add.at(sums[0], np.arange(owned) % d, P)
    np.add.at(sums[1], np.arange(owned) % d, m)
    total, mass = problem.comm.allreduce(sums)
    broken = {"debonded": problem.debonded("base")} if problem.interfaces[0].law.has_bond else {}
    return dict(zip("xyz", total / mass, strict=False)) | {
        "p": -problem.mean("base").traction[-1],
        **broken,
    }


def test_block_slows_down(comm):
    """A block under a pressure that grows is slowed down by mu times it, over sixteen facets of
    the base, and stops where the closed form says."""
    speed, ramp = 60.0, 0.02

    def pressure(t):
        return N * np.sin(np.pi * min(t / ramp, 1) / 2) ** 2

    # Friction excites an elastic block that slides; its viscosity stills it.
    law = vmdg.Contact(friction=MU)
    problem, velocity = on_base(
        comm, "triangle", (5, 3), (28, 3), law, 0.3, press=pressure, beta=3e-4
    )
    times = np.linspace(0.0, 0.075, 76)[1:]
    along = velocity(speed * np.eye(2)[0])
    result = vmdg.solve_dynamics(problem, times, velocity=along, monitor=watched, options=ENERGY)
    history, rise = result.history, np.minimum(times, ramp)
    grown = N * (rise / 2 - np.sin(np.pi * rise / ramp) * ramp / (2 * np.pi))
    impulse = grown + N * np.maximum(times - ramp, 0.0)
    exact = np.maximum(speed - MU * impulse / (0.6 * RHO), 0.0)
    assert not result.failures
    moves = exact > 1.0
    assert history["x"][moves] == pytest.approx(exact[moves], abs=1e-3 * speed)
    # Where it stops the shear of the block is let go.
    assert np.abs(history["x"][~moves]).max() < 0.02 * speed
    steady = moves & (times > 1.2 * ramp)
    assert history["p"][steady] == pytest.approx(np.full(steady.sum(), N), rel=1e-3)
    kinetic = RHO * 0.6 * speed**2 / 2
    assert history["friction"][-1] == pytest.approx(kinetic, rel=2e-3)
    assert np.abs(history["imbalance"]).max() < 1e-3 * kinetic
    assert history["iterations"].mean() < 3


def thrown(comm, scheme, times=TIMES, **options):
    """A block thrown onto the base: its speeds, and the history."""
    fall, speed = 10.0, 600.0
    given = {"cell": "quadrilateral", "cells": (5, 6), "base": (28, 2)} | options
    problem, velocity = on_base(comm, law=vmdg.Contact(friction=MU), gap=2e-3, **given)
    along = np.zeros(problem.mesh.geometry.dim)
    along[0], along[-1] = speed, -fall
    result = vmdg.solve_dynamics(problem, times, scheme, velocity(along), watched, ENERGY)
    return fall, speed, result.history


@EVERY_SCHEME
def test_block_thrown_onto_a_floor(comm, scheme):
    """It touches for twice the time of a wave through it, over five facets of the floor, leaves
    nearly as fast as it came, and friction takes mu of that momentum from the one along."""
    fall, speed, history = thrown(comm, scheme)
    assert history["x"][-1] == pytest.approx(speed - MU * (fall + history["y"][-1]), rel=1e-9)
    assert 0.9 * fall < history["y"][-1] < fall
    touching = TIMES[history["p"] > 0.05 * fall * np.sqrt(1000 * RHO)]
    assert touching[0] == pytest.approx(2e-4, abs=5e-5)
    assert touching[-1] - touching[0] == pytest.approx(1.2e-3, rel=0.08)
    assert history["p"].max() < 2 * fall * np.sqrt(1000 * RHO)
    lost = history["kinetic"][0] - history["kinetic"][-1]
    assert history["friction"][-1] == pytest.approx(lost, rel=0.01)
    assert np.abs(history["imbalance"]).max() < 1e-3 * lost


def test_critical_step_of_tilted_blocks(comm):
    """A block in flight, a corner of it ahead of the floor, takes the steps of its own critical
    step in any direction of the axes, although K of pairs that move is not symmetric."""
    taken = []
    for turn in (0.0, 0.8, 2.5):
        parts = [
            block("quadrilateral", (3, 1), [-1.5, -0.5], [1.5, 0.0], 1, comm),
            block("quadrilateral", (3, 3), [-0.5, 0.0], [0.5, 0.6], 2, comm),
        ]
        for (mesh, *_), angle in zip(parts, (turn, turn + 0.9), strict=True):
            x, c, s = mesh.geometry.x, np.cos(angle), np.sin(angle)
            x[:, :2] = x[:, :2] @ [[c, s], [-s, c]]
            if angle != turn:
                x[:, :2] += 0.5 * np.array([-np.sin(turn), np.cos(turn)])
        scene, body = apart(parts), vmdg.NeoHookean(E=1.0, nu=0.3)
        pairs = {"sliding": True, "gap": "keep"}
        problem = of_two(scene, vmdg.Contact(), (body,) * 2, pairs, density={1: 1.0, 2: 1.0})
        scheme, start = vmdg.CentralDifferences(), lambda x: np.zeros((2, x.shape[1]))
        with pytest.warns(vmdg.ModelWarning, match="keep the mass of their contact nodes"):
            taken += list(vmdg.solve_dynamics(problem, [10.0], scheme, start).history["steps"])
    assert len(set(taken)) == 1
    assert 20 < taken[0] < 100


@SEVERAL_RANKS
@EVERY_SCHEME
def test_ranks(comm, scheme):
    """Any number of ranks finds the same motion."""
    found = [thrown(ranks, scheme, TIMES[:24])[-1] for ranks in (comm, MPI.COMM_SELF)]
    assert found[0]["friction"][-1] > 0
    for name in ("x", "y", "kinetic", "friction"):
        assert found[0][name] == pytest.approx(found[1][name], rel=1e-9, abs=1e-9)
