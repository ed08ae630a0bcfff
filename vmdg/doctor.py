"""Checks an installation with a small run: two blocks that are pulled apart until the bond breaks.

The blocks are 1 mm long and high, of a neo-Hookean material with nu = 0, whose stress is
P = mu (s - 1/s) at a stretch s without any lateral strain: half way down the softening branch
T = P_c - H zeta, the end has moved by 2 (s(T) - 1) + zeta, in closed form.
"""

from __future__ import annotations

import math
import os
import shutil
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

from . import __version__
from .info import PACKAGES, blas, find, petsc_solvers

if TYPE_CHECKING:
    from mpi4py import MPI

    from .problem.problem import Problem

STRENGTH, CRITICAL_GAP, SHEAR_MODULUS = 50.0, 0.1, 1000.0  # MPa, mm, MPa

#: Largest error of traction and gap relative to the closed form.
EXACT = 1e-8

#: What tells a process how many ranks mpirun has started, by MPI.
RANKS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS")


class Missing(Exception):
    """An optional part is not installed."""


class Bench:
    """What the checks hand on to each other.

    Args:
        comm: Communicator.
        folder: For files, seen by all ranks.

    Attributes:
        problem: The blocks; None before they are built.
    """

    def __init__(self, comm: MPI.Comm, folder: Path):
        self.comm = comm
        self.folder = folder
        self.problem: Problem | None = None


class Check(NamedTuple):
    """One check.

    Attributes:
        name: What is checked.
        run: Checks it, on all ranks; what it found. Raises where it fails.
        cure: What to do then.
    """

    name: str
    run: Callable[[Bench], str]
    cure: str


def packages(bench: Bench) -> str:
    """All required packages are there, in versions that fit."""
    versions = {}
    for package in PACKAGES:
        if package.required:
            versions[package.name], why = find(package.name)
            if versions[package.name] is None:
                raise RuntimeError(f"{package.name} cannot be imported ({why}); {package.source}")
    found = tuple(int(part) for part in versions["dolfinx"].split(".")[:2])
    if not (0, 9) <= found <= (0, 11):
        raise RuntimeError(f"DOLFINx {versions['dolfinx']} is not 0.9 to 0.11")
    return f"vmdg {__version__}, DOLFINx {versions['dolfinx']}"


def ranks(bench: Bench, environment: Mapping[str, str] = os.environ) -> str:
    """mpirun and mpi4py belong to one MPI."""
    started = next((int(environment[name]) for name in RANKS if name in environment), 1)
    if started > 1 and bench.comm.size == 1:
        raise RuntimeError(
            f"mpirun has started {started} processes that do not see each other: each is alone"
        )
    threads = environment.get("OMP_NUM_THREADS")
    hint = "" if threads or bench.comm.size == 1 else "; OMP_NUM_THREADS=1 would be faster"
    return f"{bench.comm.size} of {bench.comm.size} ranks answer{hint}"


def numbers(bench: Bench) -> str:
    """PETSc has real numbers and the direct solver that vmdg uses."""
    from petsc4py import PETSc

    import numpy as np

    if np.dtype(PETSc.ScalarType) != np.float64:
        raise RuntimeError(f"PETSc has {np.dtype(PETSc.ScalarType).name}, vmdg needs float64")
    has = petsc_solvers()
    if not has["MUMPS"]:
        raise RuntimeError("PETSc has no MUMPS")
    slow = "; its BLAS is slow, install libopenblas0-pthread" if blas() == "reference" else ""
    return f"real, {', '.join(name for name in has if has[name])}{slow}"


def kernels(bench: Bench) -> str:
    """Forms are compiled, or found in the cache."""
    from .base import kernels

    before = len(kernels.requested)
    bench.problem = blocks(bench.comm)
    bench.problem.compile()
    compiled = sum(kernel.lines > 0 for kernel in kernels.requested[before:])
    compiled = bench.comm.bcast(compiled)
    known = len(kernels.requested) - before - compiled
    return f"{compiled} compiled (once), {known} found in {kernels.cache_folder()}"


def ghosts(bench: Bench) -> str:
    """Every facet of the interface belongs to one rank, which has both cells."""
    from .base.parallel import global_sum

    problem = bench.problem
    if bench.comm.size == 1:
        return "one rank has all cells (mpirun -n 2 checks several)"
    facets = problem.interface_facets(0)
    if (facets.cells < 0).any():
        raise RuntimeError("a rank lacks a cell at the interface")
    area = float(global_sum(bench.comm, problem.state[0].weights.sum()))
    if not math.isclose(area, 1.0, rel_tol=1e-12):
        raise RuntimeError(f"the ranks have {area:.6g} of 1 mm of the interface")
    shared = int(global_sum(bench.comm, len(problem.mesh.topology.interprocess_facets())))
    return f"{shared // 2} facets between ranks, {len(facets.facets)} of the interface here"


def debonding(bench: Bench) -> str:
    """Traction and gap of the closed form."""
    import numpy as np

    from .solver.options import SolveOptions
    from .solver.stepping import solve

    problem = bench.problem
    traction, gap, end = half_broken()
    result = solve(problem, np.linspace(0, end, 5)[1:], SolveOptions(relative_tolerance=1e-11))
    mean = problem.mean(0)
    error = max(abs(mean.traction[0] / traction - 1), abs(mean.gap[0] / gap - 1))
    corrections = int(result.history["iterations"].sum())
    if not error <= EXACT:
        raise RuntimeError(
            f"traction {mean.traction[0]:.9g} MPa and gap {mean.gap[0]:.9g} mm, exact are "
            f"{traction:.9g} and {gap:.9g}"
        )
    return f"4 steps, {corrections} corrections, error {error:.0e}"


def fields(bench: Bench) -> str:
    """Fields are written for ParaView."""
    import dolfinx

    if not dolfinx.has_adios2:
        raise Missing("DOLFINx was built without ADIOS2: vmdg.FieldWriter cannot write")
    from .output.fields import FieldWriter

    with FieldWriter(bench.problem, bench.folder / "fields") as writer:
        writer.write(bench.problem.t)
    bench.comm.barrier()
    written = sorted((bench.folder / "fields").glob("*.bp"))
    if not written or not all(any(path.iterdir()) for path in written):
        raise RuntimeError("nothing has been written")
    return f"{len(written)} VTX files"


def checkpoint(bench: Bench) -> str:
    """A state is written, and read by another problem."""
    import numpy as np

    from .base.parallel import global_max
    from .checkpoint.checkpoint import read_checkpoint, write_checkpoint
    from .checkpoint.state_file import adios

    try:
        adios()
    except ImportError as error:
        raise Missing(str(error)) from error
    problem, other = bench.problem, blocks(bench.comm)
    write_checkpoint(problem, bench.folder / "checkpoint")
    read_checkpoint(other, bench.folder / "checkpoint")
    difference = np.abs(problem.u.x.array - other.u.x.array).max(initial=0.0)
    if global_max(bench.comm, float(difference)) > 1e-14 or other.t != problem.t:
        raise RuntimeError("the state that was read is another one")
    return "written and read again"


def meshing(bench: Bench) -> str:
    """gmsh makes a mesh."""
    version, why = find("gmsh")
    if version is None:
        raise Missing(f"gmsh is missing ({why}): vmdg.meshes and the demos need it")
    from .meshes import blocks as gmsh_blocks

    mesh = gmsh_blocks(bench.comm, "triangle", (2, 2)).mesh
    return f"gmsh {version}, {mesh.topology.index_map(2).size_global} triangles"


CHECKS = (
    Check("packages", packages, "install what is named, in the environment of this Python"),
    Check("MPI", ranks, "start the ranks with the mpirun that belongs to mpi4py's MPI"),
    Check(
        "PETSc",
        numbers,
        "install PETSc with real numbers and MUMPS (conda-forge: petsc=*=real*; own builds: "
        "--download-mumps --download-scalapack); without MUMPS name another solver in "
        "SolveOptions(petsc={'ksp_type': 'preonly', 'pc_type': 'lu'}), for one rank",
    ),
    Check(
        "kernels",
        kernels,
        "FFCx needs a C compiler (gcc, or the variable CC) and a folder to write to (the variable "
        "XDG_CACHE_HOME names another one)",
    ),
    Check("ghost facets", ghosts, "this DOLFINx does not share cells between ranks: install anew"),
    Check("debonding", debonding, "the numerical libraries do not work together: install anew"),
    Check(
        "fields",
        fields,
        "install DOLFINx with ADIOS2 (Debian and conda-forge have it), and give a TMPDIR that all "
        "ranks can write to",
    ),
    Check(
        "checkpoints",
        checkpoint,
        "install adios4dolfinx in the version of DOLFINx, with an ADIOS2 built for the same MPI",
    ),
    Check(
        "meshes",
        meshing,
        "install gmsh (pip install gmsh; it needs the system's libGLU and libXrender), or bring "
        "meshes of your own",
    ),
)


def half_broken() -> tuple[float, float, float]:
    """T = P_c/2 [MPa], zeta [mm] and the displacement of the end [mm] there."""
    traction, gap = STRENGTH / 2, CRITICAL_GAP / 2
    x = traction / (2 * SHEAR_MODULUS)
    return traction, gap, gap + 2 * (x + math.sqrt(x**2 + 1) - 1)


def blocks(comm: MPI.Comm) -> Problem:
    """The two blocks, their load factor the displacement of the right end [mm]; no gmsh needed."""
    import numpy as np
    from dolfinx.mesh import CellType, GhostMode, compute_midpoints, create_rectangle, meshtags

    from .forms.materials import NeoHookean
    from .interface.interface import Interface
    from .laws import Debonding
    from .problem.problem import Problem

    ends = [np.zeros(2), np.array([2.0, 1.0])]
    mesh = create_rectangle(
        comm, ends, [8, 4], CellType.quadrilateral, ghost_mode=GhostMode.shared_facet
    )
    cells = mesh.topology.index_map(2)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    right = compute_midpoints(mesh, 2, every)[:, 0] > 1
    tags = meshtags(mesh, 2, every, np.where(right, 2, 1).astype(np.int32))
    body = NeoHookean(mu=SHEAR_MODULUS, lmbda=0.0)
    law = Debonding(strength=STRENGTH, critical_gap=CRITICAL_GAP)
    problem = Problem(mesh, tags, {1: body, 2: body}, [Interface(between=(1, 2), law=law)])
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], 2), lambda t: (t, 0.0))
    return problem


def examine(bench: Bench, check: Check) -> bool:
    """Run a check and print its line on rank 0; whether nothing has failed, on any rank."""
    start, detail, missing = perf_counter(), "", None
    failure = None
    try:
        detail = check.run(bench)
    except Missing as error:
        missing = str(error)
    except Exception as error:  # whatever a broken installation raises is the finding
        failure = f"{type(error).__name__}: {error}"
    failures = [text for text in bench.comm.allgather(failure) if text is not None]
    if bench.comm.rank == 0:
        if failures:
            state, detail = "FAILED", failures[0].strip()
        elif missing is not None:
            state, detail = "missing", missing
        else:
            state = "ok"
        print(f"{check.name:13} {state:8} {perf_counter() - start:5.1f} s  {detail}", flush=True)
        if failures or missing is not None:
            print(f"{'':13} cure: {check.cure}", flush=True)
    return not failures


def main() -> int:
    """Run all checks; exit code 1 if one has failed, others are told what is missing.

    Later checks need the first ones: the first failure of one that others build on ends the run.
    """
    version, why = find("mpi4py")
    if version is None:
        print(f"packages      FAILED   mpi4py cannot be imported: {why}")
        print(f"{'':13} cure: {CHECKS[0].cure}")
        return 1
    from mpi4py import MPI

    comm = MPI.COMM_WORLD
    folder = comm.bcast(tempfile.mkdtemp(prefix="vmdg-doctor-") if comm.rank == 0 else None)
    bench, well = Bench(comm, Path(folder)), True
    try:
        for check in CHECKS:
            good = examine(bench, check)
            well = well and good
            if not good and bench.problem is None:
                break
    finally:
        comm.barrier()
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)
    if comm.rank == 0:
        print("vmdg works here." if well else "vmdg does not work here as it should.")
    return int(not well)
