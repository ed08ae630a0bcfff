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
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from support import bar, killed_run
from support.checks import by_position
from support.problems import MATERIALS, joined
from support.scenes import box, interior_facets, two_blocks

import vmdg
from vmdg.checkpoint.files import latest

# Between partitions linear systems differ by rounding, which softening magnifies, and where a step
# along the path ends by that of a difference of works; 1e-9 of the largest value is the promise,
# 1e-12 what is seen under load control and 4e-10 on a path.
SAME = 1e-9
SPENT = ("bulk", "interface", "damage", "friction", "viscosity")
ENERGIES = (*SPENT, "external", "discretization")
BOND = vmdg.Debonding(strength=60.0, critical_gap=0.2, friction=0.3)
MATERIAL = vmdg.NeoHookean(E=1000.0, nu=0.3)
TURNING = {"frame": "corotating"}

#: A problem and the facets at which it is held.
Held = tuple[vmdg.Problem, Any]


def sheared(cell: str, **options):
    """Two different blocks pulled apart off their axis: some points fail, others do not."""

    def build(comm: MPI.Comm) -> Held:
        scene = two_blocks(comm, cell, n=2, distortion=0.03)
        problem = joined(scene, BOND, interface=TURNING, **options)
        d = problem.mesh.geometry.dim
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        problem.dirichlet(
            scene.facet_tags.find(2),
            lambda x, t: t * np.vstack([0.03 + 0.04 * x[1], *[0.02 * x[:1]] * (d - 1)]),
        )
        return problem, scene.facet_tags.find(1)

    return build, np.linspace(0.4, 2.4, 6)


def plate(comm: MPI.Comm, cell: str, interface) -> Held:
    """A square, clamped at the left, whose right side is pulled in its upper half."""
    mesh, tags = box(comm, [[0, 0], [1, 1]], [6, 6], cell=cell)
    problem = vmdg.Problem(mesh, tags, {1: MATERIAL}, [interface(mesh)])
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], 1) & (x[1] >= 0.5 - 1e-9), lambda t: t, "x")
    return problem, lambda x: np.isclose(x[0], 0)


def cracked_plate(critical_gap=0.02):
    def interface(mesh):
        law = vmdg.Debonding(strength=4.0, critical_gap=critical_gap)
        line = interior_facets(mesh, lambda x: np.isclose(x[0], 0.5) & (x[1] > 0.5))
        return vmdg.Interface(line, law=law)

    loads = np.linspace(0.002, 0.012, 6)
    return lambda comm: plate(comm, "triangle", interface), loads


def cracking_plate(critical_gap=0.1):
    """Every facet may open, on demand."""

    def interface(mesh):
        law = vmdg.Debonding(strength=10.0, critical_gap=critical_gap)
        return vmdg.Interface(within=1, law=law, activate="on-demand")

    loads = np.linspace(0.002, 0.015, 6)
    return lambda comm: plate(comm, "quadrilateral", interface), loads


def filled(scene, pressure):
    """The same with a fluid where the bond is gone [MPa per unit of load factor]."""
    build, loads = scene

    def fill(comm: MPI.Comm) -> Held:
        problem, facets = build(comm)
        problem.pressure(problem.interfaces[0], lambda t: pressure * t, debonded=True)
        return problem, facets

    return fill, loads


SCENES = {
    "hexahedron": sheared("hexahedron"),
    "triangle of degree 2": sheared("triangle", degree=2),
    "small strain": sheared("quadrilateral", kinematics="small"),
    "on demand": cracking_plate(),
    "crack tip with a fluid": filled(cracked_plate(0.003), 100.0),
    "on demand with a fluid": filled(cracking_plate(0.004), 100.0),
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
    n = comm.size
    return sorted({(1, n), (n, 1), (min(n, 2), n)} - ({(2, 2)} if n == 2 else set()))


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


@pytest.mark.filterwarnings("ignore:.*process zone:vmdg.ModelWarning")  # facets 14 % too long
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
            there, count = values(problem), len(before)
            whole = run(held, loads[half:], before)
            told = (
                whole.rows,
                count,
                there,
                values(problem),
                problem.space.dofmap.index_map.size_global,
            )
            some.Free()
        rows, count, there, end, dofs = comm.bcast(told)
        assert 0 < there[3].max(), "no damage at the checkpoint"
        some = first_ranks(comm, readers)
        if some is None:
            comm.barrier()
            continue
        held = problem, _ = build(some)
        history = vmdg.read_checkpoint(problem, folder)
        assert history.rows == rows[:count]
        for mine, expected in zip(values(problem), there, strict=True):
            assert_same(mine, expected, 1e-14, "state that was read")
        resumed = run(held, loads[half:], history)
        assert problem.space.dofmap.index_map.size_global == dofs
        expected = vmdg.History()
        expected.rows = rows
        exact = 0.0 if writers == readers == 1 else SAME
        assert_same(resumed["force"], expected["force"], exact, "force")
        energies = [
            np.column_stack([history[name] for name in ENERGIES]) for history in (resumed, expected)
        ]
        # Steps of a jump are rough, and their viscous work keeps what rounding does to them.
        assert_same(*energies, 10 * SAME, "energies")
        for mine, expected in zip(values(problem), end, strict=True):
            assert_same(mine, expected, 1e-9, "state at the end")
        some.Free()
        comm.barrier()


def left(x: np.ndarray) -> np.ndarray:
    return np.isclose(x[0], 0)


def gripped(comm: MPI.Comm) -> Held:
    """Two blocks whose right one is pulled, before something grips it."""
    problem = small(comm)
    problem.dirichlet(left, 0.0)
    problem.traction(lambda x: np.isclose(x[0], 2), lambda t: (4.0 * min(t, 1.0), 0.0))
    return problem, left


def grip(problem: vmdg.Problem) -> None:
    """From where the body is, and with it."""
    problem.dirichlet(lambda x: np.isclose(x[0], 2), lambda t: (0.01 * (t - 1), 0.0), relative=True)


# What is refused, and what a failure leaves


def small(comm: MPI.Comm, cell="triangle", n=2, law=BOND, **options) -> vmdg.Problem:
    interface = TURNING | options.pop("interface", {})
    return joined(two_blocks(comm, cell, n), law, interface=interface, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"n": 3}, "number of cells: "),
        ({"degree": 2}, "degree: 1 there, 2 here"),
        ({"kinematics": "small"}, "kinematics: finite there, small here"),
        ({"thickness": 2.0}, "thickness: 1.0 there, 2.0 here"),
        ({"law": vmdg.Debonding(strength=61.0, critical_gap=0.2)}, "strength': 61.0"),
        ({"materials": MATERIALS[::-1]}, "material 1: "),
        ({"interface": {"initial_damage": lambda x: 0.5 * (x[1] < 0.5)}}, "initial damage: "),
    ],
)
def test_another_problem(comm, out, options, message):
    """The error names what differs, and the problem keeps its state."""
    vmdg.write_checkpoint(small(comm), out / "one")
    other = small(comm, **options)
    other.u.x.array[:] = 1e-3
    with pytest.raises(ValueError, match=message):
        vmdg.read_checkpoint(other, out / "one")
    assert (other.u.x.array == 1e-3).all()


def test_same_numbers_at_other_places(comm, out):
    """Nodes whose sums are the same, but that lie elsewhere, are not taken for the same."""
    problem = small(comm)
    vmdg.write_checkpoint(problem, out)
    other = small(comm)
    x = other.mesh.geometry.x
    x[:, 1] = comm.allreduce(x[:, 1].max(), MPI.MAX) - x[:, 1]  # the blocks start at y = 0
    with pytest.raises(ValueError, match="in another order or at other positions"):
        vmdg.read_checkpoint(other, out)


def test_format(comm, out):
    """Another format is named with the version that wrote it; damaged files and none at all."""
    problem = small(comm)
    assert vmdg.read_checkpoint(problem, out) is None
    vmdg.write_checkpoint(problem, out)
    about = latest(out) / "checkpoint.json"
    stored = json.loads(about.read_text())
    comm.barrier()
    assert stored["vmdg"] == vmdg.__version__
    if comm.rank == 0:
        about.write_text(json.dumps(stored | {"format": 99, "vmdg": "9.9"}))
    with pytest.raises(ValueError, match=r"format 99, written by vmdg 9\.9"):
        vmdg.read_checkpoint(problem, out)
    if comm.rank == 0:
        about.write_text(json.dumps(stored))
        os.truncate(about.with_name("cells.npy"), 1000)
    with pytest.raises(ValueError, match=r"cells.npy was modified or truncated"):
        vmdg.read_checkpoint(problem, out)
    if comm.rank == 0:
        about.write_text("{")
    with pytest.raises(ValueError, match="damaged"):
        vmdg.read_checkpoint(problem, out)
    vmdg.discard_checkpoint(comm, out)
    assert vmdg.read_checkpoint(problem, out) is None


#: Calls that the system may refuse.
FAULTS = {"folder": "pathlib.Path.mkdir", "flush": "os.fsync", "name": "pathlib.Path.replace"}


@contextmanager
def faulty_disk(monkeypatch, fault: str) -> Iterator[None]:
    """One of FAULTS, or the number of bytes at which files end."""

    def full(*_, **__):
        raise OSError("No space left on device")

    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with monkeypatch.context() as patch:
        if fault in FAULTS:
            patch.setattr(FAULTS[fault], full)
        else:
            resource.setrlimit(resource.RLIMIT_FSIZE, (int(fault), before[1]))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("fault", ["100", "2000", *FAULTS])
def test_failure_leaves_the_former(comm, out, monkeypatch, fault):
    """An error of rank 0 is raised by all, and the former checkpoint is still there.

    100 bytes are less than the description, 2000 less than the cells.
    """
    problem = small(comm)
    history = vmdg.History()
    history.append({"load": 1.0})
    vmdg.write_checkpoint(problem, out, history)
    problem.u.x.array[:] = 1e-3
    told = pytest.raises(OSError, match=r"previous one, if any, is still valid|cannot be written")
    with faulty_disk(monkeypatch, fault), told:
        vmdg.write_checkpoint(problem, out)
    assert vmdg.read_checkpoint(problem, out).rows == history.rows
    assert not problem.u.x.array.any()
    problem.u.x.array[:] = 1e-3
    vmdg.write_checkpoint(problem, out)
    assert vmdg.read_checkpoint(problem, out).rows == []
    assert (problem.u.x.array == 1e-3).all()


# Killed runs

KILLS = int(os.environ.get("VMDG_KILLS", "2"))


def start(folder: Path, log: Path) -> subprocess.Popen:
    script = Path(killed_run.__file__)
    root = script.parents[2]
    path = os.pathsep.join([str(root), str(root / "demos"), os.environ.get("PYTHONPATH", "")])
    environment = {k: v for k, v in os.environ.items() if not k.startswith(("PMIX_", "OMPI_COMM"))}
    return subprocess.Popen(
        [sys.executable, script, folder, log],
        env=environment | {"PYTHONPATH": path},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def steps_in(log: Path) -> np.ndarray:
    """Load factor and time of the steps that were complete, parts of cut ones included, (n, 2)."""
    lines = log.read_text().split("\n")[:-1] if log.exists() else []
    return np.array([line.split() for line in lines], dtype=float).reshape(-1, 2)


@pytest.mark.filterwarnings("ignore:.*process zone:vmdg.ModelWarning")  # coarse
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="processes of one rank are killed")
def test_killed_at_any_moment(comm, tmp_path):
    """kill -9 at random moments: what was written is whole, and the rest of the curve the same.

    The time from the first step to the last has one kill in each of equal parts, so that steps,
    the snap and the files are all met. More of them: VMDG_KILLS=20, others: VMDG_SEED=2.
    """
    random = np.random.default_rng(int(os.environ.get("VMDG_SEED", "1")))
    whole = killed_run.main(tmp_path / "whole", tmp_path / "whole.log")
    duration = np.ptp(steps_in(tmp_path / "whole.log")[:, 1])
    given = np.searchsorted(killed_run.LOADS, np.maximum.accumulate(whole["load"]) - 1e-12)
    longest = np.bincount(given).max()
    assert longest > 1, "no stage is followed by the work on bonds"
    lost, worst = [], 0.0
    for number in range(KILLS):
        folder, log = tmp_path / str(number), tmp_path / f"{number}.log"
        process = start(folder, log)
        while len(steps_in(log)) == 0 and process.poll() is None:
            time.sleep(0.01)
        time.sleep((number + random.random()) / KILLS * duration)
        process.send_signal(signal.SIGKILL)
        process.wait()
        done = steps_in(log)[:, 0]
        resumed = killed_run.main(folder, tmp_path / f"{number}.resumed")
        again = steps_in(tmp_path / f"{number}.resumed")[:, 0]
        lost.append(int((again <= done.max()).sum()))
        assert resumed.columns == whole.columns
        for column in whole.columns:
            assert_same(resumed[column], whole[column], SAME, f"{column} after kill {number}")
            difference = np.abs(resumed[column] - whole[column]).max()
            worst = max(worst, difference / max(np.abs(whole[column]).max(), 1e-12))
        shutil.rmtree(folder)
    # Checkpoints are written at given load factors: the last one may be lost with all its rows.
    print(f"steps done again: {lost}; largest difference of a column: {worst:.1e}")
    assert max(lost) <= killed_run.EVERY + longest


# Damaged files

FLIPS = int(os.environ.get("VMDG_FLIPS", "40"))


def test_flips_and_cuts(comm, out):
    """A bit that has changed and a file that was cut are refused, or have no effect."""
    held = problem, _ = SCENES["on demand"][0](comm)
    history = run(held, SCENES["on demand"][1][:3], checkpoint=out / "whole")
    expected = problem.u.x.array.copy()
    files = sorted(path.relative_to(out / "whole") for path in (out / "whole").rglob("*"))
    files = [path for path in files if (out / "whole" / path).is_file()]
    random, refused = np.random.default_rng(int(os.environ.get("VMDG_SEED", "1"))), 0
    fresh, _ = SCENES["on demand"][0](comm)
    for number in range(FLIPS):
        folder, name = out / str(number), files[random.integers(len(files))]
        at, cut = random.random(), random.random() < 0.3
        if comm.rank == 0:
            shutil.copytree(out / "whole", folder)
            content = bytearray((folder / name).read_bytes())
            place = int(at * len(content))
            content[place] ^= 1 << number % 8
            (folder / name).write_bytes(content[:place] if cut else content)
        comm.barrier()
        before = fresh.u.x.array.copy()
        try:
            assert vmdg.read_checkpoint(fresh, folder).rows == history.rows
        except ValueError as error:
            refused += 1
            assert "damaged" in str(error) or "has format" in str(error)
            assert (fresh.u.x.array == before).all()
        else:
            assert (fresh.u.x.array == expected).all()
        comm.barrier()
    assert refused > 0.5 * FLIPS


@pytest.mark.parametrize("missing", ["latest", "cells.npy", "interface_0.npy", "checkpoint.json"])
def test_missing_file(comm, out, missing):
    """It is not taken for a folder without a checkpoint, and is not written over."""
    problem = small(comm)
    vmdg.write_checkpoint(problem, out)
    if comm.rank == 0:
        next(out.rglob(missing)).unlink()
    comm.barrier()
    with pytest.raises(ValueError, match=r"damaged.*restore a copy"):
        vmdg.read_checkpoint(problem, out)
    if missing == "latest":
        with pytest.raises(OSError, match="'latest' is missing"):
            vmdg.write_checkpoint(problem, out)
    vmdg.discard_checkpoint(comm, out)
    assert vmdg.read_checkpoint(problem, out) is None


def test_state_that_is_not_finite(comm, out):
    """It does not take the place of one that is."""
    problem = small(comm)
    vmdg.write_checkpoint(problem, out)
    problem.u.x.array[:1] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        vmdg.write_checkpoint(problem, out)
    vmdg.read_checkpoint(problem, out)
    assert not problem.u.x.array.any()


def test_table_that_no_file_holds(comm, out):
    """All ranks are told what it is, and the former checkpoint is still there."""
    problem, history = small(comm), vmdg.History()
    vmdg.write_checkpoint(problem, out, history)
    history.append({"load": 1.0, "comm": MPI.COMM_SELF})
    with pytest.raises(ValueError, match=r"cannot store.*Intracomm"):
        vmdg.write_checkpoint(problem, out, history)
    assert vmdg.read_checkpoint(problem, out).rows == []


OTHER_RUN = """
import fcntl, pathlib, sys, time
file = open(sys.argv[1], "a+")
fcntl.flock(file, fcntl.LOCK_EX)
file.write("process 1 on mars")
file.flush()
print("locked", flush=True)
time.sleep(600)
"""


@contextmanager
def other_run(comm: MPI.Comm, lock: Path) -> Iterator[None]:
    process = None
    if comm.rank == 0:
        lock.parent.mkdir(parents=True, exist_ok=True)
        command = [sys.executable, "-c", OTHER_RUN, str(lock)]
        process = subprocess.Popen(command, stdout=subprocess.PIPE)
        assert process.stdout.readline() == b"locked\n"
    comm.barrier()
    try:
        yield
    finally:
        comm.barrier()
        if process is not None:
            process.kill()
            process.wait()
        comm.barrier()


def test_two_runs_in_one_folder(comm, out):
    """The second one is told which process is there, before its first step; a dead one is none."""
    held = problem, _ = gripped(comm)
    grip(problem)
    with other_run(comm, out / "checkpoint.lock"):
        with pytest.raises(OSError, match="process 1 on mars is writing it"):
            run(held, [0.5], checkpoint=out)
        with pytest.raises(OSError, match="process 1 on mars is writing it"):
            vmdg.write_checkpoint(problem, out)
        with pytest.raises(OSError, match="process 1 on mars is writing it"):
            vmdg.discard_checkpoint(comm, out)
    vmdg.discard_checkpoint(comm, out / "none")
    assert problem.t == 0
    with other_run(comm, out / ".table.csv.lock"), pytest.raises(OSError, match="mars"):
        run(held, [0.5], csv=out / "table.csv")
    run(held, [0.5], checkpoint=out, csv=out / "table.csv")
    comm.barrier()
    assert not list(out.rglob("*.lock"))


def test_what_was_breaking_breaks_further(comm, out):
    """The first step of a resumed run knows which way the path goes: the gradient of the work."""
    loads = bar.LOADS[bar.LOADS < 0.05]
    problem, other = (bar.build(comm, 0.2) for _ in range(2))
    vmdg.solve(problem, loads)
    vmdg.write_checkpoint(problem, out / "checkpoint")
    vmdg.read_checkpoint(other, out / "checkpoint")
    (one,), (two,) = (p.discretization.active.values() for p in (problem, other))
    assert (np.abs(one.work_gradient(1.0)).max(axis=1) > 0).all()
    assert np.array_equal(one.work_gradient(1.0), two.work_gradient(1.0))
