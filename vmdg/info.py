"""What vmdg finds installed: versions, solvers, the cache of kernels, ranks and threads."""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Mapping
from importlib import import_module, metadata
from pathlib import Path
from typing import NamedTuple

from . import __version__


class Package(NamedTuple):
    """A Python package vmdg uses.

    Attributes:
        name: Of the module.
        needed: What does not work without it.
        source: How to get it.
        required: Whether nothing works without it.
    """

    name: str
    needed: str
    source: str
    required: bool = False


_FENICS = "install FEniCSx 0.9 to 0.11: Debian's python3-dolfinx, conda-forge's fenics-dolfinx"
PACKAGES = (
    Package("dolfinx", "everything", _FENICS, True),
    Package("ufl", "everything", _FENICS, True),
    Package("basix", "everything", _FENICS, True),
    Package("ffcx", "everything", _FENICS, True),
    Package("petsc4py", "everything", _FENICS, True),
    Package("mpi4py", "everything", _FENICS, True),
    Package("numpy", "everything", "pip install numpy", True),
    Package("scipy", "everything", "pip install scipy", True),
    Package("tqdm", "everything", "pip install tqdm", True),
    Package("matplotlib", "vmdg.plot and pictures of demos", "pip install matplotlib"),
    Package("gmsh", "vmdg.meshes and demos", "pip install gmsh, or Debian's python3-gmsh"),
    Package(
        "adios2",
        "checkpoints, reading fields back",
        "install ADIOS2 with MPI: Debian's python3-adios2-mpi, conda-forge's adios2",
    ),
    Package(
        "adios4dolfinx",
        "checkpoints",
        "install it in the version of your DOLFINx: Debian's python3-adios4dolfinx, conda-forge's "
        "adios4dolfinx",
    ),
    Package("pyvista", "pictures in space", "pip install pyvista"),
)

#: Solvers of PETSc by the name under which it knows their packages.
SOLVERS = {"MUMPS": "mumps", "SuperLU_DIST": "superlu_dist", "hypre": "hypre"}


def find(name: str) -> tuple[str | None, str]:
    """Version of a package, None where it cannot be imported, and why."""
    # Debian has a serial ADIOS2 beside that with MPI and chooses when it is imported.
    os.environ.setdefault("ADIOS2_ALWAYS_USE_MPI", "1")
    try:
        module = import_module(name)
    except Exception as error:  # broken libraries raise whatever they like
        return None, str(error)
    version = getattr(module, "__version__", None)
    if version is None:
        try:
            version = metadata.version({"ufl": "fenics-ufl"}.get(name, name))
        except metadata.PackageNotFoundError:
            version = "of unknown version"
    return str(version), ""


def petsc_solvers() -> dict[str, bool]:
    """Which of PETSc's solvers are there."""
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


def kernels() -> tuple[Path, int]:
    """Folder of the compiled kernels, and how many it has."""
    from .base.kernels import cache_folder

    folder = Path(cache_folder())
    return folder, len(list(folder.glob("*.c.cached")))


def threads(environment: Mapping[str, str] = os.environ) -> str:
    """Threads a rank may start, and cores it may use."""
    wanted = environment.get("OMP_NUM_THREADS")
    given = f"OMP_NUM_THREADS={wanted}" if wanted else "as many as cores (OMP_NUM_THREADS unset)"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"{given}, {cores} cores"


def report() -> list[tuple[str, str]]:
    """Names and what is found, for a table."""
    lines = [
        ("vmdg", f"{__version__}  {Path(__file__).parent}"),
        ("Python", f"{sys.version.split()[0]}  {sys.executable}"),
    ]
    found = {}
    for package in PACKAGES:
        found[package.name], why = find(package.name)
        text = found[package.name]
        if text is None:
            text = f"missing: {package.needed} ({why}); {package.source}"
        lines.append((package.name, text))
    if found["mpi4py"]:
        from mpi4py import MPI

        library = MPI.Get_library_version().rstrip("\0").splitlines()[0].split(", package")[0]
        lines.append(("MPI", f"{library}, standard {'.'.join(map(str, MPI.Get_version()))}"))
        lines.append(("ranks", str(MPI.COMM_WORLD.size)))
    if found["petsc4py"]:
        from petsc4py import PETSc

        import numpy as np

        kinds = [np.dtype(kind).name for kind in (PETSc.ScalarType, PETSc.IntType)]
        lines.append(("PETSc", ".".join(map(str, PETSc.Sys.getVersion()))))
        lines.append(("PETSc's numbers", ", ".join(kinds)))
        lines.append(("BLAS", blas()))
        has = petsc_solvers()
        lines.append(("solvers", ", ".join(name for name in has if has[name])))
        if missing := ", ".join(name for name in has if not has[name]):
            lines.append(("not in PETSc", missing))
    if found["dolfinx"]:
        folder, count = kernels()
        lines.append(("kernels", f"{folder}  ({count} compiled)"))
    lines.append(("C compiler", shutil.which(os.environ.get("CC", "cc").split()[0]) or "missing"))
    lines.append(("threads", threads()))
    return lines


def main() -> int:
    """Print the table on rank 0; exit code 1 where a required package is missing."""
    lines = report()
    required = {package.name for package in PACKAGES if package.required}
    lacking = [name for name, text in lines if name in required and text.startswith("missing")]
    if "mpi4py" not in lacking:
        from mpi4py import MPI

        if MPI.COMM_WORLD.rank > 0:
            return int(bool(lacking))
    width = max(len(name) for name, _ in lines)
    print("\n".join(f"{name:{width}}  {text}" for name, text in lines))
    return int(bool(lacking))
