"""vmdg: interface failure at finite strain by the Variational Multiscale DG method, on DOLFINx.

The public names are loaded when they are first used, so that ``vmdg.laws`` can be imported where
only numpy is installed.
"""

from importlib import import_module

_HOME = {
    "Bonded": "laws",
    "Contact": "laws",
    "Debonding": "laws",
    "ExponentialDebonding": "laws",
    "IntrinsicExponential": "laws",
    "Law": "laws",
    "MixedModeDebonding": "laws",
    "Mode": "laws",
    "History": "output.history",
    "Interface": "interface.interface",
    "ModelWarning": "problem.checks",
    "NamedTags": "domain.tags",
    "split_cells": "domain.marking",
    "Material": "forms.materials",
    "NeoHookean": "forms.materials",
    "Hyperelastic": "forms.materials",
    "Ogden": "forms.ogden",
    "Problem": "problem.problem",
    "Snapshot": "problem.states",
    "SolveOptions": "solver.options",
    "StepFailure": "solver.result",
    "solve": "solver.stepping",
    "switchboard": "solver.features",
    "FieldWriter": "output.fields",
    "read_checkpoint": "checkpoint.checkpoint",
    "write_checkpoint": "checkpoint.checkpoint",
}

__all__ = [*_HOME]
__version__ = "0.1.0"


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'vmdg' has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
