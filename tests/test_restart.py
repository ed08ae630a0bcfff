"""Checkpoints: the same run goes on, on any number of ranks, from a state that is always whole."""

from __future__ import annotations

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from mpi4py import MPI

import killed_run
import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import CellType, GhostMode, create_rectangle
from scenes import MATERIALS, by_position, everywhere, interior_facets, tag_cells, two_blocks

import vmdg
from vmdg.checkpoint import discard_checkpoint, latest
from vmdg.facet_records import facet_keys
from vmdg.lookup import look_up

# Between partitions linear systems differ by rounding, which softening magnifies; 1e-10 of the
# largest value is the promise, 1e-12 what is seen.
SAME = 1e-10
BOND = vmdg.Debonding(strength=60.0, critical_gap=0.2, friction=0.3)
MATERIAL = vmdg.NeoHookean(E=1000.0, nu=0.3)


#: A problem and the facets at which it is held.
Held = tuple[vmdg.Problem, Any]


def sheared(cell: str, degree: int = 1, **options):
    """Two different blocks pulled apart off their axis: some points fail, others do not."""

    def build(comm: MPI.Comm) -> Held:
        scene = two_blocks(comm, cell, n=2, distortion=0.03)
        interface = vmdg.Interface(between=(1, 2), law=BOND)
        bodies = dict(enumerate(MATERIALS, start=1))
        problem = vmdg.Problem(
            scene.mesh, scene.cell_tags, bodies, [interface], degree=degree, **options
        )
        d = problem.mesh.geometry.dim
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        problem.dirichlet(
            scene.facet_tags.find(2),
            lambda x, t: t * np.vstack([0.03 + 0.04 * x[1], *[0.02 * x[:1]] * (d - 1)]),
        )
        return problem, scene.facet_tags.find(1)

    return build, np.linspace(0.3, 2.4, 8)


def plate(comm: MPI.Comm, cell: str, interface) -> Held:
    """A square, clamped at the left, whose right side is pulled in its upper half."""
    mesh = create_rectangle(
        comm, [[0, 0], [1, 1]], [6, 6], CellType[cell], ghost_mode=GhostMode.shared_facet
    )
    tags = tag_cells(mesh, {1: everywhere})
    problem = vmdg.Problem(mesh, tags, {1: MATERIAL}, [interface(mesh)])
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], 1) & (x[1] >= 0.5 - 1e-9), lambda t: t, "x")
    return problem, lambda x: np.isclose(x[0], 0)


def cracked_plate():
    """Crack tip in the middle of the plate."""

    def interface(mesh):
        law = vmdg.Debonding(strength=4.0, critical_gap=0.02)
        line = interior_facets(mesh, lambda x: np.isclose(x[0], 0.5) & (x[1] > 0.5))
        return vmdg.Interface(line, law=law)

    loads = np.linspace(0.002, 0.012, 6)
    return lambda comm: plate(comm, "triangle", interface), loads


def cracking_plate():
    """Every facet may open, on demand."""

    def interface(mesh):
        law = vmdg.Debonding(strength=10.0, critical_gap=0.1)
        return vmdg.Interface(within=1, law=law, activate="on-demand")

    loads = np.linspace(0.002, 0.015, 6)
    return lambda comm: plate(comm, "quadrilateral", interface), loads


SCENES = {
    "quadrilateral": sheared("quadrilateral"),
    "hexahedron": sheared("hexahedron"),
    "triangle of degree 2": sheared("triangle", degree=2),
    "small strain": sheared("quadrilateral", kinematics="small"),
    "crack tip": cracked_plate(),
    "on demand": cracking_plate(),
}


def run(held: Held, loads, history=None, **options) -> vmdg.History:
    """Solve with the tolerance and the columns of all runs here."""
    problem, facets = held
    chosen = vmdg.SolveOptions(relative_tolerance=1e-10, energy=True, **options)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"force": problem.reaction(facets)[0]}

    return vmdg.solve(problem, loads, chosen, monitor, history).history


def first_ranks(comm: MPI.Comm, size: int) -> MPI.Comm | None:
    """The first ``size`` ranks; None on the others."""
    some = comm.Split(0 if comm.rank < size else MPI.UNDEFINED, comm.rank)
    return None if some == MPI.COMM_NULL else some


def ways(comm: MPI.Comm) -> list[tuple[int, int]]:
    """Numbers of ranks that write and read: all pairs of 1 and all, and of neighbours."""
    n = comm.size
    return [(1, 1)] if n == 1 else [(1, n), (n, 1), (n, n), *([(1, 2), (2, n)] if n > 2 else [])]


def values(problem: vmdg.Problem) -> list[np.ndarray]:
    """State at the points, in an order that no partition can change."""
    state = problem.state[0]
    arrays = state.traction, state.gap, state.softening, state.opening, state.mode
    return by_position(problem.comm, state.points, *arrays)


def assert_same(found: np.ndarray, expected: np.ndarray, tolerance: float, what: str) -> None:
    """Equal relative to the largest value of the array."""
    assert found.shape == expected.shape, what
    largest = max(np.abs(expected).max(initial=0.0), 1e-12)
    assert np.abs(found - expected).max(initial=0.0) <= tolerance * largest, what


@pytest.mark.parametrize("name", SCENES)
def test_any_number_of_ranks(comm, out, name):
    """State, curve, energies and open facets of a run that goes on elsewhere are those of one run.

    On one rank the forces are equal bit by bit; on more, MUMPS adds in the order of its messages.
    """
    build, loads = SCENES[name]
    half = len(loads) // 2
    for writers, readers in ways(comm):
        folder = out / f"{writers}_{readers}"
        some, told = first_ranks(comm, writers), None
        if some is not None:
            held = problem, _ = build(some)
            before = run(held, loads[:half], checkpoint=folder)
            there = values(problem)
            whole = run(held, loads[half:], before)
            told = whole.rows, there, values(problem), problem.space.dofmap.index_map.size_global
            some.Free()
        rows, there, end, dofs = comm.bcast(told)
        assert 0 < there[3].max(), "no damage at the checkpoint"
        some = first_ranks(comm, readers)
        if some is None:
            comm.barrier()
            continue
        held = problem, _ = build(some)
        history = vmdg.read_checkpoint(problem, folder)
        assert history.rows == rows[:half]
        for mine, expected in zip(values(problem), there, strict=True):
            assert_same(mine, expected, 1e-14, "state that was read")
        resumed = run(held, loads[half:], history)
        assert problem.space.dofmap.index_map.size_global == dofs
        for column in ("load", "force", "bulk", "interface", "damage", "friction", "external"):
            expected = np.array([row[column] for row in rows])
            tolerance = 0.0 if writers == readers == 1 and column == "force" else SAME
            assert_same(resumed[column], expected, tolerance, column)
        for mine, expected in zip(values(problem), end, strict=True):
            assert_same(mine, expected, 1e-9, "state at the end")
        some.Free()
        comm.barrier()


# Killed runs

KILLS = int(os.environ.get("VMDG_KILLS", "4"))


def start(folder: Path, log: Path) -> subprocess.Popen:
    """A run in a process of its own."""
    script = Path(__file__).with_name("killed_run.py")
    root = script.parent.parent
    path = os.pathsep.join([str(root), str(root / "demos"), os.environ.get("PYTHONPATH", "")])
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PMIX_", "OMPI_COMM"))}
    return subprocess.Popen(
        [sys.executable, script, folder, log],
        env=environment | {"PYTHONPATH": path},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def steps_in(log: Path) -> list[float]:
    """Loads of the steps that were complete, cut ones included."""
    return [float(line) for line in log.read_text().splitlines()] if log.exists() else []


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="processes of one rank are killed")
def test_killed_at_any_moment(comm, tmp_path):
    """kill -9 at random moments: what was written is whole, and the rest of the curve the same.

    Moments are even in the time from before the first step to after the last one, in one share of
    it for every kill, so that the steps, the snap and the files are all met. More of them:
    VMDG_KILLS=20.
    """
    random = np.random.default_rng(int(os.environ.get("VMDG_SEED", "1")))
    began = time.perf_counter()
    whole = killed_run.main(tmp_path / "whole", tmp_path / "whole.log")
    duration = time.perf_counter() - began
    assert whole["jump_steps"].sum() > 0
    lost = []
    for number in range(KILLS):
        folder, log = tmp_path / str(number), tmp_path / f"{number}.log"
        process = start(folder, log)
        while not steps_in(log) and process.poll() is None:
            time.sleep(0.01)
        time.sleep((number + random.random()) / KILLS * duration)
        process.send_signal(signal.SIGKILL)
        process.wait()
        done = steps_in(log)
        assert done
        resumed = killed_run.main(folder, tmp_path / f"{number}.resumed")
        repeated = len([t for t in steps_in(tmp_path / f"{number}.resumed") if t <= done[-1]])
        lost.append(repeated)
        assert resumed.columns == whole.columns
        for column in whole.columns:
            assert_same(resumed[column], whole[column], SAME, f"{column} after kill {number}")
        shutil.rmtree(folder)
    # A step that was cut is not the end of one: the last one may be lost with its parts.
    print("steps repeated:", lost)
    assert max(lost) <= killed_run.EVERY + whole["cuts"].max() + 1
