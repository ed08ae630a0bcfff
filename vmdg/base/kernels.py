"""Forms, expressions and C compiled to kernels, or loaded from the cache that processes share."""

from __future__ import annotations

import fcntl
import gc
import hashlib
import importlib.machinery
import importlib.util
import json
import random
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from struct import unpack_from
from tempfile import TemporaryDirectory
from time import perf_counter
from types import ModuleType
from typing import Any, TextIO, TypeVar, cast

from mpi4py import MPI

import cffi
import dolfinx.jit
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.variable import Label

from .. import compat
from .timers import timer

T = TypeVar("T")

#: What FFCx says of a kernel that another process has claimed.
_CLAIMED = "JIT compilation timed out"

# gcc's variable tracking under Python's own -g dominates the compile time of large kernels, and
# the default register allocator is slow on the straight-line code of the interface.
JIT_OPTIONS: dict[str, Any] = {
    # How long a rank waits for the one that compiles [s].
    "timeout": 600,
    "cffi_extra_compile_args": [
        "-O1",
        "-march=native",
        "-g0",
        "-fira-region=one",
        "-fira-algorithm=priority",
    ],
}

# Loops over many basis functions are worth a sixth more compile time: the tangent of 12,000
# hexahedra takes .16 s instead of .26 s. Sums are in another order; NaN keeps its meaning.
VECTORIZED = {
    **JIT_OPTIONS,
    "cffi_extra_compile_args": [
        *JIT_OPTIONS["cffi_extra_compile_args"],
        "-ftree-loop-vectorize",
        "-fvect-cost-model=dynamic",
        "-fassociative-math",
        "-fno-signed-zeros",
        "-fno-trapping-math",
        "-fno-math-errno",
    ],
}


# C that says itself what is done at a time: at -O3 gcc 14 changes the order of its loops, and its
# products of small matrices take three times as long.
_PRODUCTS = ["-O2", "-fopenmp-simd", "-funroll-loops", "-march=native", "-g0"]
# What such C files include.
_VECTORS = Path(__file__).with_name("vectors.h")


@dataclass(frozen=True)
class Kernel:
    """A compiled form, expression or C file.

    Attributes:
        name: What it is for.
        seconds: To compile it, or to find it in the cache [s].
        lines: Of C; 0 where it was in the cache.
    """

    name: str
    seconds: float
    lines: int


#: Every kernel that this process has asked for, in order.
requested: list[Kernel] = []


def _record(name: str, start: float, code: object) -> None:
    lines = _lines(code)
    if lines:
        # UFL's algorithms leave circles, which would keep the mesh and its communicators.
        compat.forget_traversals()
        gc.collect()
    requested.append(Kernel(name, perf_counter() - start, lines))


def _lines(code: object) -> int:
    """Of the source that FFCx gives for what it has compiled: nested strings, or None."""
    if isinstance(code, str):
        return code.count("\n")
    return 0 if code is None else sum(map(_lines, cast(Iterable[object], code)))


def compile_form(
    form: ufl.Form,
    submeshes: list[compat.FacetSubmesh],
    comm: MPI.Comm,
    options: dict = JIT_OPTIONS,
    name: str = "form",
) -> fem.Form:
    """Compile a form that may live on facet submeshes too, or load it; collective.

    Args:
        form: What to integrate.
        submeshes: Where arguments or coefficients live besides the mesh.
        comm: The mesh's.
        options: Of DOLFINx's just-in-time compiler.
        name: For :data:`requested`.
    """
    start = perf_counter()
    # Python's import system lists the whole folder for every kernel it loads: several milliseconds
    # where thousands lie in one, as much as all the rest of setting up a small problem.
    folder_name = form.signature()[:2]
    with timer("kernels"):
        compiled = _compiled(
            comm, options, folder_name, lambda ordered: compat.form(form, submeshes, ordered)
        )
    _record(name, start, compiled.code)
    return compiled


def compile_expression(
    expression: Expr,
    points: NDArray[np.float64],
    comm: MPI.Comm,
    options: dict = JIT_OPTIONS,
    name: str = "expression",
) -> fem.Expression:
    """Compile an expression at reference ``points``, or load it from the cache; collective.

    The cache knows expressions, unlike forms, by the running numbers of their UFL variables, and
    would never find one again: give them numbers of their own.
    """
    numbered = map_expr_dag(_NumberLabels(), expression)
    start = perf_counter()
    with timer("kernels"):
        compiled = _compiled(
            comm,
            options,
            "expressions",
            lambda ordered: fem.Expression(numbered, points, comm=comm, jit_options=ordered),
        )
    _record(name, start, compiled.code)
    return compiled


def compile_source(
    source: Path, declaration: str, sizes: Mapping[str, int], comm: MPI.Comm, name: str
) -> ModuleType:
    """Compile a C file, or load it from the cache; collective.

    Args:
        source: The file.
        declaration: Of its functions, for cffi.
        sizes: Values of its macros.
        comm: Of the ranks that ask for it.
        name: For :data:`requested`.

    Returns:
        A module of cffi, with ``lib`` and ``ffi``.
    """
    start = perf_counter()
    with timer("kernels"):
        module, lines = _compiled(
            comm,
            JIT_OPTIONS,
            "sources",
            lambda ordered: _source_module(
                comm, source.read_text(), declaration, dict(sizes), ordered["cache_dir"]
            ),
        )
    requested.append(Kernel(name, perf_counter() - start, lines))
    return module


def call(module: ModuleType, name: str, *arrays: NDArray | None) -> None:
    """Call a function of a module of :func:`compile_source`.

    Args:
        module: The module.
        name: Of a function of the number of rows of the first array, and of pointers.
        arrays: Contiguous where they are written to; NULL for None.
    """
    ffi, function = module.ffi, getattr(module.lib, name)
    given = [None if one is None else np.ascontiguousarray(one) for one in arrays]
    assert given[0] is not None
    function(len(given[0]), *(ffi.NULL if one is None else ffi.from_buffer(one) for one in given))


@dolfinx.jit.mpi_jit_decorator
def _source_module(
    code: str, declaration: str, sizes: dict[str, int], folder: Path
) -> tuple[ModuleType, int]:
    """The module, and its lines of C; 0 where it was in the cache."""
    arguments = [*_PRODUCTS, *(f"-D{macro}={value}" for macro, value in sizes.items())]
    read = [code, _VECTORS.read_text(), declaration, arguments]
    key = hashlib.sha1(json.dumps(read).encode()).hexdigest()
    name, lines = f"vmdg_{key}", 0
    file = folder / (name + importlib.machinery.EXTENSION_SUFFIXES[0])
    if not file.exists():
        builder, lines = cffi.FFI(), code.count("\n")
        builder.cdef(declaration)
        folders = [str(_VECTORS.parent)]
        builder.set_source(name, code, extra_compile_args=arguments, include_dirs=folders)
        # Whoever else compiles it at the same time puts the same into its place.
        with TemporaryDirectory(dir=folder) as work:
            Path(builder.compile(tmpdir=work)).replace(file)
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, lines


def cache_folder(options: dict = JIT_OPTIONS) -> Path:
    """Where compiled kernels are kept for all later runs, in folders of this folder."""
    return options.get("cache_dir") or Path(dolfinx.jit.get_options()["cache_dir"]) / "vmdg"


def _compiled(
    comm: MPI.Comm, options: dict, folder_name: str, compile_in: Callable[[dict], T]
) -> T:
    """What a compiler gives that knows a folder of the cache; collective.

    FFCx claims a kernel by its C file and marks it when it is ready. A process that was killed in
    between leaves its claim, and all later ones would wait for the mark until their time is out.
    So whoever compiles holds a shared lock, which ends with the process; who gets the same lock
    exclusively knows that nobody is compiling, and that claims without a mark are void. Who finds
    a claim lets go of the lock before looking again. Those who compile without the lock have their
    kernels elsewhere: these are in a folder of their own in DOLFINx's, unless ``options`` name one.
    Only the first rank of ``comm`` claims kernels.

    Args:
        comm: The ranks.
        options: Of DOLFINx's just-in-time compiler.
        folder_name: Of the folder in the cache.
        compile_in: Compiles or loads, with options that name the folder.

    Raises:
        RuntimeError: a kernel is being compiled elsewhere for too long, or cannot be.
    """
    folder = cache_folder(options) / folder_name
    end = time.monotonic() + options.get("timeout", JIT_OPTIONS["timeout"])
    ordered = {**options, "cache_dir": folder}
    if comm.rank == 0:
        ordered["timeout"] = 1
    while True:
        try:
            with _in_order(comm, folder):
                return compile_in(ordered)
        except (OSError, ImportError, RuntimeError, cffi.VerificationError) as error:
            if not comm.bcast(_CLAIMED in str(error) and time.monotonic() < end):
                raise RuntimeError(
                    f"a kernel cannot be compiled or loaded: {error}. Kernels are kept in "
                    f"{folder}, which may be full or not yours to write to, or another process is "
                    "compiling there: make room, remove the folder (what it holds is compiled "
                    "anew), or let the variable XDG_CACHE_HOME name another one"
                ) from error
        if comm.rank == 0:
            _wait_for_claim(folder)


@contextmanager
def _in_order(comm: MPI.Comm, folder: Path) -> Iterator[None]:
    """Hold the lock of a folder, in which no kernel is damaged or claimed by a dead process."""
    if comm.rank > 0:
        yield
        return
    with suppress(OSError):  # without a folder to write to the compiler will say what it lacks
        folder.mkdir(parents=True, exist_ok=True)
    with _lock(folder) as lock:
        _free(folder, lock)
        with suppress(OSError):
            _remove_damaged(folder)
        if lock is not None:
            with suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_SH)
        yield


@contextmanager
def _lock(folder: Path) -> Iterator[TextIO | None]:
    """The file that is locked; None in a folder that is read only."""
    try:
        lock = (folder / "vmdg.lock").open("a")
    except OSError:
        yield None
        return
    with lock:
        yield lock


def _free(folder: Path, lock: TextIO | None) -> bool:
    """Remove claims if nobody is compiling; whether that is so."""
    if lock is not None:
        with suppress(OSError):  # held by others, or a file system without locks
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            _remove_claims(folder)
            return True
    return False


def _wait_for_claim(folder: Path) -> None:
    """Until nobody is compiling, but not for long; others who wait hold the lock now and then."""
    for _ in range(random.randint(5, 25)):
        with _lock(folder) as lock:
            if _free(folder, lock):
                return
        time.sleep(0.1)


#: When the folders that were searched for claims, and for damage, had last changed [ns].
_searched: dict[Path, int] = {}
_inspected: dict[Path, int] = {}


def _unchanged(folder: Path, seen: dict[Path, int]) -> bool:
    """Whether a folder is as it was when this was last asked."""
    changed = folder.stat().st_mtime_ns
    same = seen.get(folder) == changed
    seen[folder] = changed
    return same


def _remove_claims(folder: Path) -> None:
    """Remove C files whose kernel never became ready, where files have come since the last look."""
    if _unchanged(folder, _searched):
        return
    for source in folder.glob("*.c"):
        if not source.with_suffix(".c.cached").exists():
            source.unlink(missing_ok=True)


def _remove_damaged(folder: Path) -> None:
    """Remove kernels of which a part is missing, where files have come since the last look.

    To load a library that was cut ends the process.
    """
    if _unchanged(folder, _inspected):
        return
    for library in folder.glob("*.so"):
        source = folder / f"{library.name.partition('.')[0]}.c"
        ready = source.with_suffix(".c.cached")
        if not _is_whole(library) and ready.exists() == source.exists():
            for file in (ready, library, source.with_suffix(".o"), source):
                file.unlink(missing_ok=True)


def _is_whole(library: Path) -> bool:
    """Whether a library of Linux is as long as its header says."""
    with library.open("rb") as file:
        header = file.read(64)
    if sys.platform != "linux":
        return True
    if len(header) < 64 or not header.startswith(b"\x7fELF"):
        return False
    (start,), (size, count) = (unpack_from(*at) for at in (("=Q", header, 40), ("=HH", header, 58)))
    return library.stat().st_size >= start + size * count


class _NumberLabels(MultiFunction):
    """Gives the variables of an expression the numbers 0, 1, ... in the order they are met."""

    def __init__(self) -> None:
        super().__init__()
        self._labels: dict[Label, Label] = {}

    expr = MultiFunction.reuse_if_untouched

    def label(self, o: Label) -> Label:
        """A label that depends on the expression only."""
        return self._labels.setdefault(o, Label(len(self._labels)))
