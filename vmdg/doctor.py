"""``python -m vmdg info`` lists what is installed, ``python -m vmdg doctor`` checks that it works.

The doctor pulls two blocks apart until the bond breaks. They are 1 mm long and high, of a
neo-Hookean material with nu = 0, whose stress is P = mu (s - 1/s) at a stretch s without lateral
strain. Halfway down the softening branch T = P_c - H zeta, the closed-form displacement of the end
is 2 (s(T) - 1) + zeta.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from importlib import import_module, metadata
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, NamedTuple

from . import __version__

if TYPE_CHECKING:
    from mpi4py import MPI

    from .problem.problem import Problem

STRENGTH, CRITICAL_GAP, SHEAR_MODULUS = 50.0, 0.1, 1000.0  # MPa, mm, MPa

#: Largest error of traction and gap relative to the closed form.
EXACT = 1e-8

#: Environment variable with the number of ranks that mpirun has started, by MPI library.
RANKS = ("OMPI_COMM_WORLD_SIZE", "PMI_SIZE", "MPI_LOCALNRANKS")

_FENICS = (
    "install FEniCSx 0.9 to 0.11: Debian's python3-dolfinx, conda-forge's fenics-dolfinx, "
    "or PyPI's dolfinx-solver-real (Linux, Python 3.12 or newer)"
)

#: How to install required packages, and what optional packages are for.
REQUIRED = dict.fromkeys(("dolfinx", "ufl", "basix", "ffcx", "petsc4py", "mpi4py"), _FENICS)
REQUIRED |= {name: f"pip install {name}" for name in ("numpy", "scipy", "tqdm")}
OPTIONAL = {
    "matplotlib": ("vmdg.plot and pictures of demos", "pip install matplotlib"),
    "gmsh": ("vmdg.meshes and demos", "pip install gmsh, or Debian's python3-gmsh"),
    "meshio": ("meshes of other programs than gmsh", "pip install meshio h5py"),
    "pyvista": ("pictures of solids", "pip install pyvista"),
}

#: PETSc's external solvers and the names of their packages in PETSc.
SOLVERS = {"MUMPS": "mumps", "SuperLU_DIST": "superlu_dist", "hypre": "hypre"}


# What is installed


def find(name: str) -> tuple[str | None, str]:
    """Version of a package, None where it cannot be imported, and why."""
    try:
        module = import_module(name)
    except Exception as error:  # broken libraries may raise anything
        return None, str(error)
    version = getattr(module, "__version__", None)
    if version is None:
        try:
            version = metadata.version({"ufl": "fenics-ufl"}.get(name, name))
        except metadata.PackageNotFoundError:
            version = "of unknown version"
    return str(version), ""


def petsc_solvers() -> dict[str, bool]:
    from petsc4py import PETSc

    has = {name: bool(PETSc.Sys.hasExternalPackage(key)) for name, key in SOLVERS.items()}
    return has | {"GAMG": True}  # a part of PETSc


def blas(maps: Path = Path("/proc/self/maps")) -> str:
    """The BLAS that PETSc has loaded, by the names of the libraries of this process.

    Direct solves in 3D take six times as long with the reference BLAS as with OpenBLAS.
    """
    if not maps.is_file():
        return "unknown"
    files = {line.split()[-1] for line in maps.read_text().splitlines() if "/" in line}
    loaded = {Path(file).resolve().as_posix() for file in files}
    for name in ("openblas", "mkl", "blis", "Accelerate", "atlas"):
        if any(name in file for file in loaded):
            return name
    return "reference" if any("libblas" in file for file in loaded) else "unknown"


def threads() -> str:
    wanted = os.environ.get("OMP_NUM_THREADS")
    given = f"OMP_NUM_THREADS={wanted}" if wanted else "as many as cores (OMP_NUM_THREADS unset)"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{given}, {cores} cores"


def report() -> dict[str, str]:
    """Installed versions by name; "missing: ..." for a package that cannot be imported."""
    lines = {
        "vmdg": f"{__version__}  {Path(__file__).parent}",
        "Python": f"{sys.version.split()[0]}  {sys.executable}",
    }
    packages = {name: ("everything", source) for name, source in REQUIRED.items()} | OPTIONAL
    for name, (needed, source) in packages.items():
        version, why = find(name)
        lines[name] = version or f"missing: {needed} ({why}); {source}"
    if find("mpi4py")[0]:
        from mpi4py import MPI

        library = MPI.Get_library_version().rstrip("\0").splitlines()[0].split(", package")[0]
        lines["MPI"] = f"{library}, standard {'.'.join(map(str, MPI.Get_version()))}"
        lines["ranks"] = str(MPI.COMM_WORLD.size)
    if find("petsc4py")[0]:
        from petsc4py import PETSc

        import numpy as np

        kinds = [np.dtype(kind).name for kind in (PETSc.ScalarType, PETSc.IntType)]
        has = petsc_solvers()
        lines["PETSc"] = ".".join(map(str, PETSc.Sys.getVersion()))
        lines["PETSc's numbers"] = ", ".join(kinds)
        lines["BLAS"] = blas()
        lines["solvers"] = ", ".join(name for name in has if has[name])
        lines["not in PETSc"] = ", ".join(name for name in has if not has[name])
    if find("dolfinx")[0]:
        from .base.kernels import cache_folder

        folder = Path(cache_folder())
        lines["kernels"] = f"{folder}  ({len(list(folder.glob('*/*.c.cached')))} compiled)"
    lines["C compiler"] = shutil.which(os.environ.get("CC", "cc").split()[0]) or "missing"
    lines["threads"] = threads()
    return {name: text for name, text in lines.items() if text}


def info() -> int:
    """Print the table on rank 0; exit code 1 where a required package is missing."""
    lines = report()
    lacking = {name for name in REQUIRED if lines[name].startswith("missing")}
    if "mpi4py" not in lacking:
        from mpi4py import MPI

        if MPI.COMM_WORLD.rank > 0:
            return int(bool(lacking))
    width = max(map(len, lines))
    print("\n".join(f"{name:{width}}  {text}" for name, text in lines.items()))
    return int(bool(lacking))


# Whether it works


class Missing(Exception):
    """An optional part is not installed."""


def half_broken() -> tuple[float, float, float]:
    """T = P_c/2 [MPa], zeta [mm] and the displacement of the end [mm] there."""
    traction, gap = STRENGTH / 2, CRITICAL_GAP / 2
    x = traction / (2 * SHEAR_MODULUS)
    return traction, gap, gap + 2 * (x + math.sqrt(x**2 + 1) - 1)


def blocks(comm: MPI.Comm) -> Problem:
    """The two blocks; the load factor is the displacement of the right end [mm]. Needs no gmsh."""
    import numpy as np
    from dolfinx.mesh import CellType, GhostMode, compute_midpoints, create_rectangle, meshtags

    from . import Debonding, Interface, NeoHookean, Problem

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


@contextmanager
def temporary(comm: MPI.Comm) -> Iterator[Path]:
    """A temporary folder visible to all ranks."""
    folder = comm.bcast(tempfile.mkdtemp(prefix="vmdg-doctor-") if comm.rank == 0 else None)
    try:
        yield Path(folder)
    finally:
        comm.barrier()
        if comm.rank == 0:
            shutil.rmtree(folder, ignore_errors=True)


def check_packages(comm: MPI.Comm, find: Callable = find) -> str:
    versions = {}
    for name, source in REQUIRED.items():
        versions[name], why = find(name)
        if versions[name] is None:
            raise RuntimeError(f"{name} cannot be imported ({why}); {source}")
    found = tuple(int(part) for part in versions["dolfinx"].split(".")[:2])
    if not (0, 9) <= found <= (0, 11):
        raise RuntimeError(f"DOLFINx {versions['dolfinx']} is not 0.9 to 0.11")
    return f"vmdg {__version__}, DOLFINx {versions['dolfinx']}"


def check_ranks(comm: MPI.Comm, environment: Mapping[str, str] = os.environ) -> str:
    """Check that mpirun and mpi4py use the same MPI library."""
    started = next((int(environment[name]) for name in RANKS if name in environment), 1)
    if started > 1 and comm.size == 1:
        raise RuntimeError(
            f"mpirun has started {started} processes that do not communicate: each runs alone"
        )
    threads = environment.get("OMP_NUM_THREADS")
    hint = "" if threads or comm.size == 1 else "; OMP_NUM_THREADS=1 would be faster"
    return f"{comm.size} of {comm.size} ranks answer{hint}"


def check_petsc(comm: MPI.Comm) -> str:
    """Check that PETSc has real scalars and the direct solver that vmdg uses."""
    from petsc4py import PETSc

    import numpy as np

    if np.dtype(PETSc.ScalarType) != np.float64:
        raise RuntimeError(f"PETSc has {np.dtype(PETSc.ScalarType).name}, vmdg needs float64")
    has = petsc_solvers()
    if not has["MUMPS"]:
        raise RuntimeError("PETSc has no MUMPS")
    slow = "; its BLAS is slow, install libopenblas0-pthread" if blas() == "reference" else ""
    return f"real, {', '.join(name for name in has if has[name])}{slow}"


def check_kernels(comm: MPI.Comm) -> str:
    from .base import kernels

    before = len(kernels.requested)
    blocks(comm).discretization.compile()
    compiled = comm.bcast(sum(kernel.lines > 0 for kernel in kernels.requested[before:]))
    known = len(kernels.requested) - before - compiled
    return f"{compiled} compiled (once), {known} found in {kernels.cache_folder()}"


def check_ghosts(comm: MPI.Comm) -> str:
    """Check that one rank owns each facet of the interface and has both of its cells."""
    if comm.size == 1:
        return "one rank has all cells (mpirun -n 2 checks several)"
    problem = blocks(comm)
    if (problem.step.activation.facets[0].cells < 0).any():
        raise RuntimeError("a rank is missing a cell at the interface")
    if not math.isclose(area := problem.mean(0).area, 1.0, rel_tol=1e-12):
        raise RuntimeError(f"the ranks have {area:.6g} of 1 mm of the interface")
    shared = comm.allreduce(len(problem.mesh.topology.interprocess_facets()))
    return f"{shared // 2} facets between ranks"


def check_debonding(comm: MPI.Comm, exact: tuple[float, float, float] | None = None) -> str:
    """Compare traction and gap with the closed form."""
    from . import SolveOptions, solve

    traction, gap, end = half_broken() if exact is None else exact
    problem, loads = blocks(comm), [end * n / 4 for n in range(1, 5)]
    result = solve(problem, loads, SolveOptions(relative_tolerance=1e-11))
    mean = problem.mean(0)
    error = max(abs(mean.traction[0] / traction - 1), abs(mean.gap[0] / gap - 1))
    if not error <= EXACT:
        raise RuntimeError(
            f"traction {mean.traction[0]:.9g} MPa and gap {mean.gap[0]:.9g} mm, exact are "
            f"{traction:.9g} and {gap:.9g}"
        )
    corrections = int(result.history["iterations"].sum())
    return f"4 steps, {corrections} corrections, error {error:.0e}"


def check_fields(comm: MPI.Comm) -> str:
    import dolfinx

    if not dolfinx.has_adios2:
        raise Missing("DOLFINx was built without ADIOS2: vmdg.FieldWriter cannot write")
    from . import FieldWriter

    with temporary(comm) as folder:
        with FieldWriter(blocks(comm), folder) as writer:
            writer.write(0.0)
        comm.barrier()
        written = sorted(folder.glob("*.bp"))
        if not written or not all(any(path.iterdir()) for path in written):
            raise RuntimeError("nothing was written")
    return f"{len(written)} VTX files"


def check_meshes(comm: MPI.Comm) -> str:
    version, why = find("gmsh")
    if version is None:
        raise Missing(f"gmsh is missing ({why}): vmdg.meshes and the demos need it")
    from . import meshes

    mesh = meshes.blocks(comm, "triangle", (2, 2)).mesh
    return f"gmsh {version}, {mesh.topology.index_map(2).size_global} triangles"


class Check(NamedTuple):
    """One check.

    Attributes:
        run: Runs the check on all ranks and returns its finding; raises on failure.
    """

    name: str
    run: Callable[[MPI.Comm], str]
    cure: str
    vital: bool = False


CHECKS = (
    Check("packages", check_packages, "install it, in the environment of this Python", True),
    Check("MPI", check_ranks, "start the ranks with the mpirun that belongs to mpi4py's MPI", True),
    Check(
        "PETSc",
        check_petsc,
        "install PETSc with real numbers and MUMPS (conda-forge: petsc=*=real*; own builds: "
        "--download-mumps --download-scalapack); without MUMPS name another solver in "
        "SolveOptions(petsc={'ksp_type': 'preonly', 'pc_type': 'lu'}), for one rank",
        True,
    ),
    Check(
        "kernels",
        check_kernels,
        "FFCx needs a C compiler (gcc, or the variable CC) and a folder to write to (the variable "
        "XDG_CACHE_HOME names another one)",
        True,
    ),
    Check("ghost facets", check_ghosts, "this DOLFINx creates no ghost cells: reinstall it"),
    Check("debonding", check_debonding, "the numerical libraries are inconsistent: reinstall them"),
    Check(
        "fields",
        check_fields,
        "install DOLFINx with ADIOS2 (Debian, conda-forge and PyPI's wheel have it), and give a "
        "TMPDIR that all ranks can write to",
    ),
    Check(
        "meshes",
        check_meshes,
        "install gmsh (pip install gmsh; it needs the system's libGLU and libXrender), or bring "
        "meshes of your own",
    ),
)


def examine(comm: MPI.Comm, check: Check) -> bool:
    """Run a check and print its line on rank 0; return whether it passed on all ranks."""
    start, state, failure = perf_counter(), "ok", None
    try:
        detail = check.run(comm)
    except Missing as error:
        state, detail = "missing", str(error)
    except Exception as error:  # any error of a broken installation is the finding
        failure = f"{type(error).__name__}: {error}"
    failures = [text for text in comm.allgather(failure) if text is not None]
    if failures:
        state, detail = "FAILED", failures[0].strip()
    if comm.rank == 0:
        print(f"{check.name:13} {state:8} {perf_counter() - start:5.1f} s  {detail}", flush=True)
        if state != "ok":
            print(f"{'':13} cure: {check.cure}", flush=True)
    return not failures


def doctor(checks: Sequence[Check] = CHECKS) -> int:
    """Run the checks until a vital one fails; exit code 1 if any check has failed.

    Missing optional parts are reported and do not count as failures.
    """
    version, why = find("mpi4py")
    if version is None:
        print(f"packages      FAILED   mpi4py cannot be imported: {why}")
        print(f"{'':13} cure: {_FENICS}")
        return 1
    from mpi4py import MPI

    comm, well = MPI.COMM_WORLD, True
    for check in checks:
        good = examine(comm, check)
        well = well and good
        if check.vital and not good:
            break
    if comm.rank == 0:
        print("vmdg works here." if well else "vmdg does not work correctly here.")
    return int(not well)
