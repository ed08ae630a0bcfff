"""vmdg: interface failure at finite strain by the Variational Multiscale DG method, on DOLFINx.

The public names are loaded when they are first used, so that ``vmdg.laws`` can be imported where
only numpy is installed.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # for editors and type checkers, which do not follow the table below
    from . import forms as forms
    from . import laws as laws
    from . import meshes as meshes
    from . import plot as plot
    from .checkpoint.checkpoint import discard_checkpoint as discard_checkpoint
    from .checkpoint.checkpoint import read_checkpoint as read_checkpoint
    from .checkpoint.checkpoint import write_checkpoint as write_checkpoint
    from .domain.tags import NamedTags as NamedTags
    from .domain.tags import split_cells as split_cells
    from .forms.materials import Hyperelastic as Hyperelastic
    from .forms.materials import Material as Material
    from .forms.materials import NeoHookean as NeoHookean
    from .forms.ogden import Ogden as Ogden
    from .interface.interface import Interface as Interface
    from .interface.points import InterfaceState as InterfaceState
    from .laws import Bonded as Bonded
    from .laws import Contact as Contact
    from .laws import Debonding as Debonding
    from .laws import ExponentialDebonding as ExponentialDebonding
    from .laws import IntrinsicExponential as IntrinsicExponential
    from .laws import Law as Law
    from .laws import MixedModeDebonding as MixedModeDebonding
    from .laws import Mode as Mode
    from .output.fields import FieldWriter as FieldWriter
    from .output.history import History as History
    from .problem.checks import ModelWarning as ModelWarning
    from .problem.problem import Problem as Problem
    from .problem.states import Energy as Energy
    from .problem.states import Snapshot as Snapshot
    from .solver.features import switchboard as switchboard
    from .solver.options import SolveOptions as SolveOptions
    from .solver.result import Counts as Counts
    from .solver.result import Result as Result
    from .solver.result import StepFailure as StepFailure
    from .solver.stepping import solve as solve

_SUBPACKAGES = ("forms", "laws", "meshes", "plot")
_HOME = {
    "Bonded": "laws",
    "Contact": "laws",
    "Counts": "solver.result",
    "Debonding": "laws",
    "Energy": "problem.states",
    "ExponentialDebonding": "laws",
    "FieldWriter": "output.fields",
    "History": "output.history",
    "Hyperelastic": "forms.materials",
    "Interface": "interface.interface",
    "InterfaceState": "interface.points",
    "IntrinsicExponential": "laws",
    "Law": "laws",
    "Material": "forms.materials",
    "MixedModeDebonding": "laws",
    "Mode": "laws",
    "ModelWarning": "problem.checks",
    "NamedTags": "domain.tags",
    "NeoHookean": "forms.materials",
    "Ogden": "forms.ogden",
    "Problem": "problem.problem",
    "Result": "solver.result",
    "Snapshot": "problem.states",
    "SolveOptions": "solver.options",
    "StepFailure": "solver.result",
    "discard_checkpoint": "checkpoint.checkpoint",
    "read_checkpoint": "checkpoint.checkpoint",
    "solve": "solver.stepping",
    "split_cells": "domain.tags",
    "switchboard": "solver.features",
    "write_checkpoint": "checkpoint.checkpoint",
}

__all__ = [*_HOME]
__version__ = "0.1.0"


def __getattr__(name: str):
    if name in _SUBPACKAGES:
        return import_module(f"{__name__}.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'vmdg' has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_SUBPACKAGES, *_HOME])
