"""Errors of users' functions, on one rank too, and Ctrl-C: a run ends on all ranks, in a state."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import textwrap
import threading
import time
from contextlib import suppress
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import couple, of_two
from support.scenes import SEVERAL_RANKS, two_blocks

import vmdg

ROOT = Path(__file__).resolve().parents[2]
LAW = vmdg.Debonding(strength=20.0, critical_gap=1.0)
BRITTLE = vmdg.Debonding(strength=20.0, critical_gap=0.05)
LOADS = np.linspace(0.01, 0.05, 5)


def pulled(comm: MPI.Comm, n: int = 2, move=lambda t: t, law=LAW) -> vmdg.Problem:
    scene = two_blocks(comm, "quadrilateral", n)
    problem = couple(scene, law)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), move, "x")
    problem.dirichlet(scene.facet_tags.find(2), lambda t: 0.2 * t, "y")
    return problem


def last(comm: MPI.Comm) -> bool:
    """Whether this is the last rank, on which something fails."""
    return comm.rank == comm.size - 1


@pytest.mark.parametrize("who", ["monitor", "until"])
def test_error_on_one_rank(comm, who):
    """It is raised on all; the run goes on from the last row as if nothing had happened."""

    def wrong(problem: vmdg.Problem) -> None:
        if fails and problem.t > 0.025 and last(comm):
            raise IndexError("no points here")

    problem, history, fails = pulled(comm), vmdg.History(), True
    functions = {"monitor": wrong} if who == "monitor" else {"until": lambda p: bool(wrong(p))}
    with pytest.raises(IndexError, match="no points here"):
        vmdg.solve(problem, LOADS, history=history, **functions)
    assert problem.t == history["load"][-1] == (0.02 if who == "monitor" else 0.03)
    fails, whole = False, vmdg.solve(pulled(comm), LOADS).history
    vmdg.solve(problem, LOADS[LOADS > problem.t], history=history, **functions)
    assert history["load"] == pytest.approx(whole["load"], rel=1e-12)


class Odd(Exception):
    """What cannot be sent to another rank."""

    def __init__(self, one, other):
        super().__init__(f"{one} and {other}")


def test_error_that_cannot_be_sent(comm):
    """Other ranks are told its words, and where it was."""

    def monitor(problem: vmdg.Problem) -> None:
        if last(comm):
            raise Odd("this", "that")

    kind = Odd if last(comm) else RuntimeError
    with pytest.raises(kind, match="this and that"):
        vmdg.solve(pulled(comm), LOADS, monitor=monitor)


WRONG_COLUMNS = {
    "text": lambda p: "fine",
    "nothing": lambda p: None,
    "array": lambda p: np.array([1.0, 2.0]),
    "expression": lambda p: p.load_factor * 3.0,
    "complex": lambda p: 1j,
}


@pytest.mark.parametrize("name", WRONG_COLUMNS)
def test_column_that_is_no_number(comm, name):
    """The error names the column, and what would do."""
    problem = pulled(comm)
    with pytest.raises(TypeError, match=r"column 'mine \[mm\]'.*must be a number, such as problem"):
        vmdg.solve(problem, LOADS, monitor=lambda p: {"a": 1, "mine [mm]": WRONG_COLUMNS[name](p)})
    assert problem.t == 0


def test_numbers(comm):
    """Of Python, of numpy, and a Constant of UFL as it is then."""
    monitor = lambda p: {"p": p.load_factor, "n": np.float32(2), "a": np.array(3), "b": True}  # noqa: E731
    rows = vmdg.solve(pulled(comm), LOADS, monitor=monitor).history.rows
    assert [row["p"] for row in rows] == pytest.approx(LOADS)
    assert {type(rows[0][name]) for name in "pnab"} == {float, int, bool}


@SEVERAL_RANKS
def test_rows_that_differ(comm):
    """Values and columns: the error names them and the rank."""
    local = lambda p: {"top": float(len(p.state[0].points)) + comm.rank}  # noqa: E731
    with pytest.raises(
        ValueError, match=r"column 'top' of the monitor is .* on rank 0 and .* rank 1"
    ):
        vmdg.solve(pulled(comm), LOADS, monitor=local)
    some = lambda p: {"mine": 1.0} if comm.rank == 0 else None  # noqa: E731
    with pytest.raises(ValueError, match=r"'mine' of the monitor is 1.0 .* nothing on rank 1"):
        vmdg.solve(pulled(comm), LOADS, monitor=some)
    odd = lambda p: {"a": np.nan if comm.rank == 0 else float("nan")}  # noqa: E731
    vmdg.solve(pulled(comm), LOADS, monitor=odd)


def test_functions_that_do_more_than_look(comm):
    """A monitor that solves or moves, and an ``until`` that says neither yes nor no."""
    problem = pulled(comm)
    with pytest.raises(TypeError, match=r"until gave nan .* must return True or False"):
        vmdg.solve(problem, LOADS, until=lambda p: float("nan"))
    problem = pulled(comm)
    with pytest.raises(RuntimeError, match="its monitor must not solve it"):
        vmdg.solve(problem, LOADS, monitor=lambda p: vmdg.solve(p, [0.5]) and None)

    def solve(problem: vmdg.Problem) -> None:
        with pytest.raises(RuntimeError, match="its monitor must not solve it"):
            vmdg.solve(problem, [0.5])

    found = vmdg.solve(pulled(comm), LOADS, monitor=solve).history
    assert found["load"] == pytest.approx(LOADS)

    def move(problem: vmdg.Problem) -> None:
        problem.u.x.array[:] *= 2

    with pytest.raises(ValueError, match="monitor has changed the problem"):
        vmdg.solve(problem, LOADS, monitor=move)
    assert not problem.u.x.array.any()
    assert len(vmdg.solve(problem, LOADS).history) == len(LOADS)

    def hold(problem: vmdg.Problem) -> None:
        problem.dirichlet_points(lambda x: np.isclose(x[0], 0.0), 0.0, "y")

    with pytest.raises(ValueError, match="monitor has added a support or a load at load factor"):
        vmdg.solve(pulled(comm), LOADS, monitor=hold)


def test_what_is_no_function(comm):
    """Before the run begins; and a column that is not called by a word."""
    problem = pulled(comm)
    for name in ("monitor", "until"):
        with pytest.raises(TypeError, match=rf"solve: {name} = 0.5 must be a function of the prob"):
            vmdg.solve(problem, LOADS, **{name: 0.5})
    with pytest.raises(TypeError, match=r"returned a column 1; its name must be a str"):
        vmdg.solve(problem, LOADS, monitor=lambda p: {1: 2.0})


# Loads


@pytest.mark.parametrize("kind", ["displacement", "load", "pressure", "eigenstrain"])
def test_load_that_is_not_finite(comm, kind):
    """Between loads that are: the error names it and its load factor, the state is kept."""
    scene = two_blocks(comm, "quadrilateral", 2)
    square = lambda t: t * t if abs(t - 0.03) > 1e-9 else np.nan  # noqa: E731
    strain = {1: lambda t: 0.1 * square(t)} if kind == "eigenstrain" else None
    body = vmdg.NeoHookean(E=1e3, nu=0.3)
    problem = of_two(scene, LAW, (body,) * 2, eigenstrain=strain)
    right = scene.facet_tags.find(2)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(right, square if kind == "displacement" else 0.0)
    bottom = lambda x: np.isclose(x[1], 0)  # noqa: E731
    if kind == "load":
        problem.traction(lambda x: np.isclose(x[1], 1), lambda t: (0.0, t))
        problem.traction(bottom, lambda t: (0.0, square(t)))
    elif kind == "pressure":
        problem.pressure(lambda x: np.isclose(x[1], 1), lambda x, t: t + 0 * x[0])
        problem.pressure(bottom, square)
    call = {
        "displacement": r"call 2 of dirichlet, with a point at \[2.0, ",
        "load": r"call 2 of traction, with a point at \[\S+ [0.]+\d*, 0.0\]",
        "pressure": r"call 2 of pressure, with a point at \[\S+ 0.0, 0.0\]",
        "eigenstrain": "eigenstrain of tag 1",
    }
    with pytest.raises(
        ValueError, match=rf"{kind} \({call[kind]}.*\) is not finite at load factor 0.03"
    ):
        vmdg.solve(problem, LOADS)
    assert problem.t == 0.02
    assert np.isfinite(problem.u.x.array).all()
    vmdg.solve(problem, [0.04, 0.05])


@pytest.mark.parametrize("control", ["auto", "load"])
def test_load_that_raises_on_one_rank(comm, control):
    """Along a line and by load factors."""

    def move(t: float) -> float:
        if t > 0.025 and last(comm):
            raise ZeroDivisionError("no such time")
        return t

    problem = pulled(comm, move=move)
    with pytest.raises(ZeroDivisionError, match="no such time"):
        vmdg.solve(problem, LOADS[:2], vmdg.SolveOptions(control=control))
        vmdg.solve(problem, [0.024, 0.05], vmdg.SolveOptions(control=control))
    assert problem.t in (0.02, 0.024)


def test_share_that_raises_on_one_rank(comm):
    """Of a fluid, between two steps."""

    def share(width: np.ndarray) -> np.ndarray:
        if last(comm) and problem.t > 0.015:
            raise FloatingPointError("too wide")
        return np.ones_like(width)

    problem = pulled(comm)
    problem.pressure(problem.interfaces[0], lambda t: t, share=share)
    with pytest.raises(FloatingPointError, match="too wide"):
        vmdg.solve(problem, LOADS)
    assert problem.t == 0.02


# Ctrl-C

INTERRUPTS = int(os.environ.get("VMDG_INTERRUPTS", "3"))


def interrupt(after: float, times: int) -> threading.Thread:
    """Ctrl-C for this process, once or more often, after some seconds."""

    def press() -> None:
        time.sleep(after)
        for _ in range(times):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.003)

    thread = threading.Thread(target=press)
    thread.start()
    return thread


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="times are those of one rank")
@pytest.mark.parametrize("times", [2])
def test_interrupted_at_any_moment(comm, tmp_path, times):
    """The problem is in the state of its last row, and the rest is the same to the last bit.

    More of them: VMDG_INTERRUPTS=200, others: VMDG_SEED=2.
    """
    loads = np.linspace(0.004, 0.052, 13)
    # All that a run has found out is forgotten at its checkpoints.
    options = vmdg.SolveOptions(
        control="load", checkpoint_every=1, checkpoint=tmp_path, energy=True
    )

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        kept[problem.t] = problem.u.x.array.copy()
        return {"force": problem.reaction(lambda x: np.isclose(x[0], 0))[0]}

    kept = {0.0: 0.0}
    vmdg.solve(pulled(comm, 3, law=BRITTLE), loads, options, monitor)
    start = time.monotonic()
    whole = vmdg.solve(
        pulled(comm, 3, law=BRITTLE), loads, options, monitor, vmdg.History()
    ).history
    duration = time.monotonic() - start
    random, found = np.random.default_rng(int(os.environ.get("VMDG_SEED", "1"))), 0
    for _ in range(INTERRUPTS):
        problem, history, kept = pulled(comm, 3, law=BRITTLE), vmdg.History(), {0.0: 0.0}
        pressing = interrupt(random.random() * duration, times)
        with suppress(KeyboardInterrupt):
            try:
                vmdg.solve(problem, loads, options, monitor, history)
            finally:
                pressing.join()
        while pressing.is_alive():
            with suppress(KeyboardInterrupt):
                pressing.join()
        found += len(history) < len(loads)
        assert problem.t == (history["load"][-1] if len(history) else 0.0)
        assert (problem.u.x.array == kept[problem.t]).all()
        vmdg.solve(problem, loads[loads > problem.t], options, monitor, history)
        for column in whole.columns:
            assert (history[column] == whole[column]).all(), column
    assert found


def test_interrupted_on_one_rank(comm):
    """All ranks end with KeyboardInterrupt at the same row."""

    def monitor(problem: vmdg.Problem) -> None:
        if problem.t > 0.025 and last(comm):
            os.kill(os.getpid(), signal.SIGINT)

    problem, history = pulled(comm), vmdg.History()
    with pytest.raises(KeyboardInterrupt):
        vmdg.solve(problem, LOADS, monitor=monitor, history=history)
    assert problem.t == history["load"][-1] == 0.03
    assert len(set(comm.allgather(len(history)))) == 1


# Ranks that wait for others

START = """
    import numpy as np
    import vmdg
    from mpi4py import MPI
    from vmdg.base import agreement, parallel
    from vmdg.meshes import blocks

    agreement.PATIENCE = parallel.PATIENCE = agreement.REMINDER = 1.0  # s
    comm = MPI.COMM_WORLD
    mesh, cells, facets = blocks(comm, "quadrilateral", (4, 4))
    body = vmdg.NeoHookean(E=1e3, nu=0.3)
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(10.0, 0.1))
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond])
    problem.dirichlet(facets.find(1), 0.0)
    problem.dirichlet(facets.find(2), lambda t: (t, 0.0))
"""
IN_A_MONITOR = """
    def monitor(problem):
        if comm.rank == 1:
            raise IndexError("no points here")
        return {"force": problem.reaction(facets.find(1))[0]}

    vmdg.solve(problem, [0.01, 0.02], monitor=monitor)
    """
STUCK = {
    "in a monitor": IN_A_MONITOR,
    "at the end of a script": """
    if comm.rank == 0:
        raise IndexError("no points here")
    """,
}


def command(folder: Path, body: str) -> list[str]:
    """A script that goes on with some lines, on two ranks."""
    script = folder / "script.py"
    script.write_text(textwrap.dedent(START) + textwrap.dedent(body))
    return ["mpirun", "-n", "2", sys.executable, str(script)]


def environment() -> dict[str, str]:
    folders = (str(ROOT), os.environ.get("PYTHONPATH", ""))
    return os.environ | {"PYTHONPATH": os.pathsep.join(folders)}


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
@pytest.mark.parametrize("name", STUCK)
def test_job_ends(tmp_path, name):
    """Where the others wait in a call of all ranks the job ends within seconds, with words."""
    done = subprocess.run(
        command(tmp_path, STUCK[name]),
        env=environment(),
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
    )
    assert done.returncode != 0
    assert "IndexError: no points here" in done.stderr
    assert "the job is aborted on all ranks" in done.stderr


@pytest.mark.long
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
def test_call_of_all_that_one_rank_makes(tmp_path):
    """Nothing fails, and nothing can go on: a rank that waits for the other says so."""
    body = """
    def monitor(problem):
        return {"force": problem.reaction(facets.find(1))[0]} if comm.rank == 0 else None

    vmdg.solve(problem, [0.01, 0.02], monitor=monitor)
    """
    process = subprocess.Popen(
        command(tmp_path, body), env=environment(), stderr=subprocess.PIPE, text=True
    )
    killer = threading.Timer(120, process.kill)
    killer.start()
    waits = "rank 1 has waited 1 s for rank 0 .* that only some"
    told = any(re.search(waits, line) for line in process.stderr)
    process.terminate()
    process.communicate()
    killer.cancel()
    assert told
