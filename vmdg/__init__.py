"""vmdg: interface failure at finite strain by the Variational Multiscale DG method, on DOLFINx.

The public names are loaded when they are first used, so that ``vmdg.laws`` can be imported where
only numpy is installed.
"""

from importlib import import_module
from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent
if (_ROOT / "pyproject.toml").is_file():
    # A source checkout: forms/ and meshes/ lie beside this package; installed, they lie in it.
    __path__.append(str(_ROOT))

_HOME = {
    "Bonded": "laws",
    "Contact": "laws",
    "Debonding": "laws",
    "ExponentialDebonding": "laws",
    "IntrinsicExponential": "laws",
    "Law": "laws",
    "MixedModeDebonding": "laws",
    "Mode": "laws",
    "History": "history",
    "Interface": "interface",
    "ModelWarning": "sanity",
    "NamedTags": "named_tags",
    "split_cells": "marking",
    "Material": "forms.materials",
    "NeoHookean": "forms.materials",
    "Hyperelastic": "forms.materials",
    "Ogden": "forms.ogden",
    "Problem": "problem",
    "Snapshot": "states",
    "SolveOptions": "solver",
    "StepFailure": "solver",
    "solve": "solver",
    "switchboard": "switches",
    "FieldWriter": "output",
    "read_checkpoint": "checkpoint",
    "write_checkpoint": "checkpoint",
}

__all__ = [*_HOME]
__version__ = "0.1.0"


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'vmdg' has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
