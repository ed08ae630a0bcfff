"""The cache of kernels: what a killed process leaves there does not stop the next one."""

import fcntl
import gc
import subprocess
import sys
import time
import weakref

import dolfinx.jit
import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square

from vmdg.base.kernels import JIT_OPTIONS, compile_form
from vmdg.base.parallel import global_sum


@pytest.fixture
def options(out):
    """Compiler options with a cache of their own, and little patience."""
    return {**JIT_OPTIONS, "cache_dir": out / "cache", "timeout": 2}


def area(comm, options):
    """1, by a kernel from the cache of ``options``."""
    mesh = create_unit_square(comm, 2, 2)
    form = fem.Constant(mesh, 1.0) * ufl.dx(mesh)
    compiled = compile_form(form, [], comm, options)
    return global_sum(comm, fem.assemble_scalar(compiled))


def claim(comm, cache):
    """Make the only kernel of a cache one that was claimed and never became ready."""
    comm.barrier()
    if comm.rank == 0:
        (ready,) = cache.glob("*/*.c.cached")
        ready.unlink()
        ready.with_suffix("").write_text("")
    comm.barrier()


def test_claim_of_a_killed_process_is_void(comm, options):
    assert area(comm, options) == pytest.approx(1.0)
    claim(comm, options["cache_dir"])
    assert area(comm, options) == pytest.approx(1.0)


def test_claim_of_a_living_process_counts(comm, options):
    """The process that holds the lock may still be compiling: wait for it, and give up in time."""
    area(comm, options)
    claim(comm, options["cache_dir"])
    (lock,) = options["cache_dir"].glob("*/vmdg.lock")
    with lock.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        with pytest.raises(TimeoutError if comm.size == 1 else RuntimeError):
            area(comm, options)


def test_mesh_is_not_kept(comm, options):
    """What UFL leaves of a form that was compiled does not keep the mesh, and communicators."""
    gc.disable()
    try:
        mesh = create_unit_square(comm, 2, 2)
        u = fem.Function(fem.functionspace(mesh, ("P", 1)))
        form = ufl.derivative(u**2 * ufl.dx, u)
        compile_form(form, [], comm, options)
        gone = weakref.ref(mesh)
        del mesh, u, form
        assert gone() is None
    finally:
        gc.enable()


COMPILE = """
import sys
from pathlib import Path
import ufl
from mpi4py import MPI
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from vmdg.base.kernels import JIT_OPTIONS, compile_form
mesh = create_unit_square(MPI.COMM_SELF, 2, 2)
form = fem.Constant(mesh, 1.0) * ufl.dx(mesh)
compile_form(form, [], mesh.comm, {**JIT_OPTIONS, "cache_dir": Path(sys.argv[1]), "timeout": 2})
"""


def test_kill_while_compiling(comm, options):
    """A process is killed once it has claimed its kernel; the next compiles it at once."""
    if comm.size > 1:
        pytest.skip("a process of its own on one rank")
    cache = options["cache_dir"]
    process = subprocess.Popen([sys.executable, "-c", COMPILE, str(cache)])
    while process.poll() is None and not list(cache.glob("*/*.c")):
        time.sleep(0.001)
    process.kill()
    process.wait()
    assert list(cache.glob("*/*.c")) and not list(cache.glob("*/*.c.cached"))
    assert area(comm, options) == pytest.approx(1.0)


def test_claims_elsewhere_are_left_alone(comm, out, monkeypatch):
    """Who compiles with DOLFINx itself holds no lock: vmdg's kernels have their own folder."""
    defaults = dolfinx.jit.get_options
    monkeypatch.setattr(
        dolfinx.jit,
        "get_options",
        lambda options=None: {**defaults(), "cache_dir": out, **(options or {})},
    )
    stranger = out / "libffcx_forms_of_a_stranger.c"
    if comm.rank == 0:
        stranger.write_text("")
    comm.barrier()
    assert area(comm, JIT_OPTIONS) == pytest.approx(1.0)
    assert stranger.exists()
    assert len(list((out / "vmdg").glob("*/*.c.cached"))) == 1
