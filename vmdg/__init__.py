"""vmdg: interface failure at finite strain by the Variational Multiscale DG method, on DOLFINx.

``__init__.pyi`` lists the public names and where they are, for editors and for this module, which
imports a name on first use: ``vmdg.laws`` needs nothing but numpy.
"""

import ast
import ctypes
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

_STUB = ast.parse(Path(__file__).with_suffix(".pyi").read_bytes()).body
_IMPORTS = [part for part in _STUB if isinstance(part, ast.ImportFrom)]
#: Module of every public name; None for subpackages.
_HOME = {item.name: line.module for line in _IMPORTS for item in line.names}


def _load_mpi() -> None:
    """Load the MPI library of DOLFINx's wheel (dolfinx-solver-real), which the loader does not
    find.

    It is in the lib folder of the environment. Once loaded, every library that needs it finds it by
    name. This does not initialise MPI.
    """
    library = Path(sys.prefix) / "lib" / "libmpi.so.12"
    if find_spec("dolfinx_solver") and library.is_file():
        ctypes.CDLL(str(library))


_load_mpi()

#: Functions in which more may fail than what is given.
_RUNS = ("solve", "solve_dynamics", "identify", "macroscopic_tangent")

__all__ = [name for name, module in _HOME.items() if module]
__version__ = "0.1.0"


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'vmdg' has no attribute {name!r}")
    if _HOME[name] is None:
        return import_module(f"{__name__}.{name}")
    home = import_module(f"{__name__}.{_HOME[name]}")
    door = import_module(f"{__name__}.base.door").door
    return globals().setdefault(name, door(getattr(home, name), name not in _RUNS))


def __dir__() -> list[str]:
    return sorted(_HOME)
