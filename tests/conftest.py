"""Settings of the whole suite: one terminal under MPI, reproducible hypothesis examples."""

from __future__ import annotations

import faulthandler
import gc
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from mpi4py import MPI

import pytest
from _pytest.terminal import TerminalReporter
from hypothesis import settings

# Ranks must draw the same examples, and a shared machine is no place for deadlines.
settings.register_profile("vmdg", derandomize=True, deadline=None, database=None)
settings.load_profile("vmdg")


#: Folders and files with the mark "ranks": what the number of ranks can change, one of each kind,
#: in addition to tests with `support.scenes.SEVERAL_RANKS`, which compare ranks with one.
RANKS = (
    *("assembly/test_space.py", "assembly/test_loads.py", "base", "checkpoint"),
    *("dynamics/test_checkpoints.py", "interface/test_interface.py", "interface/test_symbolic.py"),
    *("interface/test_nonmatching_bodies.py", "linear/test_system.py", "linear/test_ksp.py"),
    *("meshes/test_partition.py", "output", "points/test_gaps.py", "problem/test_periodic.py"),
    *("problem/test_rigid_face.py", "problem/test_surface.py", "problem/test_supports.py"),
    *("meshes/test_refined.py", "remeshing/test_adaptive.py", "sensitivity"),
)

#: Seconds after which a test is taken for a deadlock, cold compilers included.
PATIENCE = 900


class FailuresOnly:
    """Reporter of the ranks above 0: silent, unless something fails there."""

    def __init__(self, rank: int):
        self._rank = rank
        # Ranks that tidy up one folder of temporary files get into each other's way.
        self._temporary = tempfile.TemporaryDirectory()
        os.environ["PYTEST_DEBUG_TEMPROOT"] = self._temporary.name

    def _show(self, what: str, text: str) -> None:
        print(f"\n[rank {self._rank}] {what}\n{text}", file=sys.stderr, flush=True)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Show a failed test."""
        if report.failed:
            self._show(f"FAILED {report.nodeid} ({report.when})", report.longreprtext)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Show a file that cannot be collected."""
        if report.failed:
            self._show(f"ERROR {report.nodeid}", report.longreprtext)

    def pytest_internalerror(self, excrepr: object) -> None:
        """Show an error of pytest itself."""
        self._show("INTERNAL ERROR", str(excrepr))


@pytest.hookimpl(trylast=True)
def pytest_configure(config: pytest.Config) -> None:
    """Rank 0 speaks; the exit code of any rank is that of mpirun."""
    rank = MPI.COMM_WORLD.rank
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if rank > 0 and reporter is not None:
        # pytest asks its reporter how to show a failed comparison, so there must be one.
        config.pluginmanager.unregister(reporter)
        nowhere = open(os.devnull, "w")  # lives as long as the process
        config.pluginmanager.register(TerminalReporter(config, nowhere), "terminalreporter")
        config.pluginmanager.register(FailuresOnly(rank), "failures-only")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol() -> Iterator[None]:
    """End a process that waits for ever, as a rank does for another that failed.

    What runs alone may stop in a debugger.
    """
    if MPI.COMM_WORLD.size == 1 and "PYTEST_XDIST_WORKER" not in os.environ:
        return (yield)
    faulthandler.dump_traceback_later(PATIENCE, exit=True, file=sys.__stderr__)
    try:
        return (yield)
    finally:
        faulthandler.cancel_dump_traceback_later()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item: pytest.Item, nextitem: pytest.Item | None) -> Iterator[None]:
    """Give back the figures of a file, and its communicators: tracebacks of errors that were asked
    for hold problems in circles, and MPICH has no more than 2,048.
    """
    yield
    if nextitem is None or nextitem.path != item.path:
        if "matplotlib.pyplot" in sys.modules:
            sys.modules["matplotlib.pyplot"].close("all")
        gc.collect()


def pytest_addoption(parser: pytest.Parser) -> None:
    """``tests/run --all`` adds what takes long."""
    parser.addoption("--all", action="store_true", help='run tests with the mark "long" too')


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark what the number of ranks can change; leave out what takes long, unless it is named."""
    named = "long" in config.option.markexpr or any("::" in place for place in config.args)
    if not config.option.all and not named:
        long = [item for item in items if item.get_closest_marker("long")]
        config.hook.pytest_deselected(items=long)
        items[:] = [item for item in items if not item.get_closest_marker("long")]
    here = Path(__file__).parent
    chosen = [here / place for place in RANKS]
    ranked = {
        path: any(path.is_relative_to(place) for place in chosen)
        for path in {item.path for item in items}
    }
    for item in items:
        # What is not given the ranks does the same on each of them; two folders take all of them.
        asks = {"comm", "out"} & {*item.fixturenames}
        asks = asks or item.path.parent.name in ("base", "output")
        if asks and ranked[item.path]:
            item.add_marker("ranks")


def pytest_collection_finish() -> None:
    """Let the garbage collector pass over what imports have made, which stays to the end."""
    gc.collect()
    gc.freeze()


def pytest_report_header() -> str:
    """Number of ranks, in the head of the report."""
    return f"MPI ranks: {MPI.COMM_WORLD.size}"


@pytest.fixture
def out(comm: MPI.Comm, tmp_path: Path) -> Path:
    """One folder for all ranks."""
    return Path(comm.bcast(str(tmp_path)))


@pytest.fixture(scope="session")
def comm() -> MPI.Comm:
    """All ranks of the run."""
    return MPI.COMM_WORLD
