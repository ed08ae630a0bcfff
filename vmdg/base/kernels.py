"""Compilation of forms, expressions and C files to kernels, with a cache shared by processes."""

from __future__ import annotations

import fcntl
import gc
import hashlib
import importlib.machinery
import importlib.util
import json
import os
import random
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
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
from ffcx.naming import compute_signature
from numpy.typing import NDArray
from ufl.algorithms import extract_coefficients
from ufl.algorithms.analysis import extract_constants, has_type
from ufl.core.expr import Expr
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction
from ufl.variable import Label

from .. import compat
from .parallel import global_any, raise_together
from .timers import timer

T = TypeVar("T")

#: C function of points.c.
_EVALUATE = "void evaluate(long" + 6 * ", void *" + ");"

# gcc's variable tracking under Python's own -g dominates the compile time of large kernels, and
# the default register allocator is slow on the straight-line code of the interface.
JIT_OPTIONS: dict[str, Any] = {
    # Time for which a rank waits for the one that compiles [s].
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
# hexahedra takes 0.16 s instead of 0.26 s. Sums may be reordered; NaN is preserved.
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

# Residuals of the bodies, of which an explicit step consists: at -O3 two to four times as fast on
# quadrilaterals, tetrahedra and hexahedra, for a third more compile time.
UNROLLED = {
    **JIT_OPTIONS,
    "cffi_extra_compile_args": [
        "-O3",
        "-march=native",
        "-g0",
        "-fassociative-math",
        "-fno-signed-zeros",
        "-fno-trapping-math",
        "-fno-math-errno",
    ],
}


# C files with explicit blocking: at -O3, gcc 14 reorders their loops, and products of small
# matrices take three times as long.
_PRODUCTS = ["-O2", "-fopenmp-simd", "-funroll-loops", "-march=native", "-g0"]
# Headers of such C files.
_VECTORS = Path(__file__).with_name("vectors.h")


@dataclass(frozen=True)
class Kernel:
    """A compiled form, expression or C file; ``seconds`` to compile it or load it from the
    cache."""

    name: str
    seconds: float  # Time to compile it, or to load it from the cache [s]
    lines: int


#: All kernels that this process has requested, in order.
requested: list[Kernel] = []

#: What this process has loaded, by signatures of expressions or C files: code or module of cffi,
#: module, and the source, if it was compiled. The code is the same for all meshes.
_loaded: dict[str, tuple[Any, object, object]] = {}


def _record(name: str, start: float, code: object) -> None:
    lines = _lines(code)
    if lines:
        # UFL's algorithms leave reference cycles, which would keep the mesh and its communicators.
        compat.forget_traversals()
        gc.collect()
    requested.append(Kernel(name, perf_counter() - start, lines))


def _lines(code: object) -> int:
    """Lines of the source that FFCx returns with its result: nested strings, or None."""
    if isinstance(code, str):
        return code.count("\n")
    return 0 if code is None else sum(map(_lines, cast(Iterable[object], code)))


def compile_form(
    form: ufl.Form,
    comm: MPI.Comm,
    options: dict = JIT_OPTIONS,
    name: str = "form",
    submeshes: Sequence[compat.FacetSubmesh] = (),
) -> fem.Form:
    """Compile a form, or load it from the cache; collective."""
    start = perf_counter()
    # Python's import system lists the whole folder for every kernel it loads. With thousands of
    # kernels this takes several milliseconds, as long as the rest of the set-up of a small problem.
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
    would never find one again: they are renumbered here.
    """
    numbered = map_expr_dag(_NumberLabels(), expression)
    start = perf_counter()
    with timer("kernels"):
        compiled = _compiled(
            comm,
            options,
            _expression_folder(_signature(numbered, points)),
            lambda ordered: fem.Expression(numbered, points, comm=comm, jit_options=ordered),
        )
    _record(name, start, compiled.code)
    return compiled


def _signature(expression: Expr, points: NDArray[np.float64]) -> str:
    return compute_signature([(expression, points)], "")


def _expression_folder(key: str) -> str:
    return f"expression_{key[:2]}"


def compile_source(
    source: Path, declaration: str, sizes: Mapping[str, int], comm: MPI.Comm, name: str
) -> ModuleType:
    """A module of cffi of a C file, compiled or loaded from the cache; collective."""

    def compiled(options: dict) -> tuple[ModuleType, None, str | None]:
        folder = options["cache_dir"]
        return _source_module(comm, source.read_text(), declaration, dict(sizes), folder)

    return _loaded_once(f"{source} {sizes}", comm, "sources", compiled, name)[0]


def _loaded_once(
    key: str,
    comm: MPI.Comm,
    folder_name: str,
    compile_in: Callable[[dict], tuple[Any, object, object]],
    name: str,
) -> tuple[Any, object, object]:
    """What ``compile_in`` of :func:`_compiled` returns, of this process if it has asked for it
    before; collective."""
    start, source = perf_counter(), None
    with timer("kernels"):
        if global_any(comm, key not in _loaded):
            _loaded[key] = _compiled(comm, JIT_OPTIONS, folder_name, compile_in)
            source = _loaded[key][2]
    _record(name, start, source)
    return _loaded[key]


def call(module: ModuleType, name: str, *arrays: NDArray | None) -> None:
    """Call a function of a module of :func:`compile_source`.

    Args:
        name: A function of the number of rows of the first array, and of pointers.
        arrays: Contiguous where the function writes to them; NULL for None.
    """
    ffi, function = module.ffi, getattr(module.lib, name)
    given = [None if one is None else np.ascontiguousarray(one) for one in arrays]
    assert given[0] is not None
    function(len(given[0]), *(ffi.NULL if one is None else ffi.from_buffer(one) for one in given))


class PointKernel:
    """An expression of fields with one value at every point, evaluated point by point.

    Attributes:
        fields: The fields, in the order in which the kernel reads them.
    """

    def __init__(self, expression: Expr, comm: MPI.Comm, name: str):
        numbered, point = map_expr_dag(_NumberLabels(), expression), np.array([[0.5]])
        key = _signature(numbered, point)
        code = _loaded_once(
            key,
            comm,
            _expression_folder(key),
            lambda ordered: dolfinx.jit.ffcx_jit(comm, (numbered, point), jit_options=ordered),
            name,
        )[0]
        order, fields = code.original_coefficient_positions, extract_coefficients(numbered)
        self.fields = [fields[order[i]] for i in range(code.num_coefficients)]
        self._constants, self._size = extract_constants(numbered), expression.ufl_shape[0]
        self._placed = has_type(numbered, ufl.SpatialCoordinate)
        address = cffi.FFI().cast("uintptr_t", code.tabulate_tensor_float64)
        self._address = np.array([int(address)], dtype=np.uintp)
        source, declaration = Path(__file__).with_name("points.c"), _EVALUATE
        self._module = compile_source(source, declaration, {}, comm, "points")

    def __call__(
        self, rows: NDArray[np.integer] | slice, X: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Values at some points (n, components), of the present values of the fields."""
        values = [f.x.array.reshape(-1, f.function_space.dofmap.index_map_bs) for f in self.fields]
        count = rows.stop if isinstance(rows, slice) else len(rows)
        w = np.concatenate([np.zeros((count, 0)), *(array[rows] for array in values)], axis=1)
        c = np.concatenate([np.zeros(0), *(np.ravel(one.value) for one in self._constants)])
        result, sizes = np.zeros((len(w), self._size)), np.array([w.shape[1], self._size])
        nodes = np.repeat(X[rows], 2, axis=0) if self._placed else None
        call(self._module, "evaluate", w, sizes, c, nodes, self._address, result)
        return result


@dolfinx.jit.mpi_jit_decorator
def _source_module(
    code: str, declaration: str, sizes: dict[str, int], folder: Path
) -> tuple[ModuleType, None, str | None]:
    arguments = [*_PRODUCTS, *(f"-D{macro}={value}" for macro, value in sizes.items())]
    read = [code, _VECTORS.read_text(), declaration, arguments]
    key = hashlib.sha1(json.dumps(read).encode()).hexdigest()
    name, built = f"vmdg_{key}", None
    file = folder / (name + importlib.machinery.EXTENSION_SUFFIXES[0])
    if not file.exists():
        builder, built = cffi.FFI(), code
        builder.cdef(declaration)
        folders = [str(_VECTORS.parent)]
        builder.set_source(name, code, extra_compile_args=arguments, include_dirs=folders)
        # Another process that compiles it at the same time writes the same file.
        with TemporaryDirectory(dir=folder) as work:
            Path(builder.compile(tmpdir=work)).replace(file)
    spec = importlib.util.spec_from_file_location(name, file)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module, None, built


def cache_folder(options: dict = JIT_OPTIONS) -> Path:
    """Folder whose subfolders hold the compiled kernels for later runs."""
    return options.get("cache_dir") or Path(dolfinx.jit.get_options()["cache_dir"]) / "vmdg"


def _compiled(
    comm: MPI.Comm, options: dict, folder_name: str, compile_in: Callable[[dict], T]
) -> T:
    """Compile into a folder of the cache, or load from it; collective.

    FFCx claims a kernel by its C file and marks it when it is ready. A process killed in between
    leaves its claim behind, and later processes would wait for the mark until they time out. So one
    process at a time uses a folder: the first rank of ``comm`` holds a lock, which ends with the
    process. It knows that claims without a mark are stale, and that no other process is writing.
    The ranks that it waits for wait for no lock: they have come here too. Processes that compile
    without the lock do not interfere: the kernels of vmdg have a subfolder of their own in
    DOLFINx's cache, unless ``options`` name a folder.
    """
    folder = cache_folder(options) / folder_name
    patience = options.get("timeout", JIT_OPTIONS["timeout"])
    lock, message = None, None
    comm.barrier()
    try:
        if comm.rank == 0:
            try:
                lock = _locked(folder, patience)
                _check_kernels(folder, lock is not None)
            except OSError as error:
                message = str(error)
        raise_together(comm, message, OSError)
        return compile_in({**options, "cache_dir": folder})
    except (OSError, ImportError, RuntimeError, cffi.VerificationError) as error:
        raise RuntimeError(
            f"a kernel cannot be compiled or loaded: {error}. Kernels are kept in {folder}, which "
            "may be full or not writable, or another process is compiling there: free some space, "
            "remove the folder (its kernels are then compiled again), or set the variable "
            "XDG_CACHE_HOME to another one"
        ) from error
    finally:
        if lock is not None:
            lock.close()


def _locked(folder: Path, patience: float) -> TextIO | None:
    """The lock of a folder, which is made if missing; None in a read-only folder, or without locks
    of the file system."""
    try:
        for path in (folder.parent, folder):
            path.mkdir(mode=0o700, parents=True, exist_ok=True)
        lock = (folder / "vmdg.lock").open("a")
    except OSError:  # the compiler reports it
        return None
    end = time.monotonic() + patience
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock
        except BlockingIOError:
            if time.monotonic() > end:
                lock.close()
                raise TimeoutError(f"another process has compiled for {patience:g} s") from None
            time.sleep(random.uniform(0.001, 0.01))
        except OSError:
            lock.close()
            return None


#: Modification times of the folders when last checked [ns].
checked_folders: dict[Path, int] = {}


def _check_kernels(folder: Path, locked: bool) -> None:
    """Check who can write kernels, whose code will run, and remove what is not whole; if files were
    added since the last check.

    Kernels of this user and of root are loaded, in folders that no other user can write to. Loading
    a truncated library would kill the process.

    Args:
        locked: Whether it is locked, so that no process is writing there.
    """
    if not folder.is_dir() or checked_folders.get(folder) == folder.stat().st_mtime_ns:
        return
    opened = any([_open_to_others(path) for path in (folder.parent, folder)])
    names = set()
    for library in folder.glob("*.so"):
        name = library.name.partition(".")[0]
        if (_open_to_others(library) and opened) or (locked and not _is_whole(library)):
            _remove(folder, name, library)
        else:
            names.add(name)
    if locked:
        for source in folder.glob("*.c"):
            if source.stem not in names or not source.with_suffix(".c.cached").exists():
                _remove(folder, source.stem)
    checked_folders[folder] = folder.stat().st_mtime_ns


def _remove(folder: Path, name: str, *others: Path) -> None:
    for file in (*(folder / f"{name}.{end}" for end in ("c.cached", "o", "c")), *others):
        file.unlink(missing_ok=True)


def _open_to_others(path: Path) -> bool:
    """Whether others can write to a folder or a file of this user; a folder is closed to them."""
    status, me = path.stat(), os.getuid()
    wide = bool(status.st_mode & 0o022)
    if status.st_uid not in (me, 0) or (wide and status.st_uid != me):
        raise PermissionError(
            f"{path} belongs to user {status.st_uid} and has mode {status.st_mode & 0o777:o}: its "
            f"code would run as user {me}. Kernels must belong to this user or to root, and no "
            "other user may write to them: set the variable XDG_CACHE_HOME to a folder of your "
            "own (see vmdg/CLUSTER.md), or remove them"
        )
    if wide and path.is_dir():
        path.chmod(0o700)
    return wide


def _is_whole(library: Path) -> bool:
    with library.open("rb") as file:
        header = file.read(64)
    if sys.platform != "linux":
        return True
    if len(header) < 64 or not header.startswith(b"\x7fELF"):
        return False
    (start,), (size, count) = (unpack_from(*at) for at in (("=Q", header, 40), ("=HH", header, 58)))
    return library.stat().st_size >= start + size * count


class _NumberLabels(MultiFunction):
    """Numbers the variables of an expression 0, 1, ... in the order of traversal."""

    def __init__(self) -> None:
        super().__init__()
        self._labels: dict[Label, Label] = {}

    expr = MultiFunction.reuse_if_untouched

    def label(self, o: Label) -> Label:
        """A label that depends on the expression only."""
        return self._labels.setdefault(o, Label(len(self._labels)))
