"""The cache of kernels: what a killed process leaves there does not stop the next one."""

import fcntl
import gc
import os
import subprocess
import sys
import time
import weakref

from mpi4py import MPI

import pytest
import ufl
from dolfinx import fem
from dolfinx.mesh import create_unit_square

from vmdg.base import kernels
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
    compiled = compile_form(form, comm, options)
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
        with pytest.raises(RuntimeError, match=r"Kernels are kept in .*cache.*XDG_CACHE_HOME"):
            area(comm, options)


def test_mesh_is_not_kept(comm, options):
    """What UFL leaves of a form that was compiled does not keep the mesh, and communicators."""
    gc.disable()
    try:
        mesh = create_unit_square(comm, 2, 2)
        u = fem.Function(fem.functionspace(mesh, ("P", 1)))
        form = ufl.derivative(u**2 * ufl.dx, u)
        compile_form(form, comm, options)
        gone = weakref.ref(mesh)
        del mesh, u, form
        assert gone() is None
    finally:
        gc.enable()


def test_folder_that_cannot_be_written(comm, out):
    """The error names it, and what helps."""
    if comm.rank == 0:
        (out / "file").write_text("")
    comm.barrier()
    options = {**JIT_OPTIONS, "cache_dir": out / "file" / "cache"}
    with pytest.raises(RuntimeError, match=r"file.cache.*full or not writable.*XDG_CACHE_HOME"):
        area(comm, options)


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="a process of its own on one rank")
@pytest.mark.parametrize("damage", ["cut", "other bytes"])
def test_damaged_kernel(comm, options, damage):
    """It is compiled anew, and does not end the process."""
    cache = options["cache_dir"]
    subprocess.run([sys.executable, "-c", COMPILE, str(cache)], check=True, timeout=120)
    (library,) = cache.glob("*/*.so")
    whole = library.read_bytes()
    cut = {"cut": whole[: len(whole) // 2], "empty": b"", "other bytes": b"x" * len(whole)}
    library.write_bytes(cut[damage])
    assert area(comm, options) == pytest.approx(1.0)
    assert library.stat().st_size == len(whole)


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="files of one rank")
@pytest.mark.parametrize("what", ["kernel", "folder", "cache"])
def test_kernels_of_others(comm, options, what):
    """They are not loaded, whoever they belong to but this user and root."""
    if os.getuid() != 0:
        pytest.skip("only root gives files away")
    area(comm, options)
    cache = options["cache_dir"]
    (library,) = cache.glob("*/*.so")
    place = {"kernel": library, "folder": library.parent, "cache": cache}[what]
    os.chown(place, 65534, 65534)
    kernels.checked_folders.clear()
    with pytest.raises(RuntimeError, match=r"belongs to user 65534.* XDG_CACHE_HOME"):
        area(comm, options)


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="files of one rank")
def test_folders_are_closed_to_others(comm, options):
    """What others could write is compiled anew, in folders that they can write to no more."""
    area(comm, options)
    cache = options["cache_dir"]
    (library,) = cache.glob("*/*.so")
    before = library.stat().st_ino
    for path in (cache, library.parent, library):
        assert path is library or path.stat().st_mode & 0o777 == 0o700
        path.chmod(0o777)
    kernels.checked_folders.clear()
    assert area(comm, options) == pytest.approx(1.0)
    (library,) = cache.glob("*/*.so")
    assert library.stat().st_ino != before or library.stat().st_mode & 0o022 == 0
    assert cache.stat().st_mode & 0o777 == library.parent.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="processes of one rank")
def test_many_processes_and_an_empty_cache(comm, options):
    """One of them compiles; the others load."""
    script = COMPILE.replace('"timeout": 2', '"timeout": 100')
    command = [sys.executable, "-c", script, str(options["cache_dir"])]
    others = [subprocess.Popen(command, stderr=subprocess.PIPE) for _ in range(6)]
    assert [process.communicate()[1] for process in others if process.wait(timeout=60)] == []
    assert len(list(options["cache_dir"].glob("*/*.so"))) == 1


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="processes of one rank")
def test_claim_of_a_process_that_dies_while_others_wait(comm, options):
    """All of them have the kernel within seconds, though each waits for the others."""
    area(comm, options)
    claim(comm, options["cache_dir"])
    (name,) = options["cache_dir"].glob("*/vmdg.lock")
    script = COMPILE.replace('"timeout": 2', '"timeout": 100')
    start = time.monotonic()
    with name.open("a") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        command = [sys.executable, "-c", script, str(options["cache_dir"])]
        others = [subprocess.Popen(command) for _ in range(2)]
        time.sleep(4)
    for process in others:
        assert process.wait(timeout=60) == 0
    assert time.monotonic() - start < 40


COMPILE = """
import sys
from pathlib import Path
import ufl
from mpi4py import MPI
from dolfinx import fem
from dolfinx.mesh import create_unit_square
from vmdg.base import kernels
from vmdg.base.kernels import JIT_OPTIONS, compile_form
mesh = create_unit_square(MPI.COMM_SELF, 2, 2)
form = fem.Constant(mesh, 1.0) * ufl.dx(mesh)
compile_form(form, mesh.comm, {**JIT_OPTIONS, "cache_dir": Path(sys.argv[1]), "timeout": 2})
"""
