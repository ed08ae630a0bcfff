"""vmdg: interface failure at finite strain by the Variational Multiscale DG method, on DOLFINx.

The public names are loaded when they are first used, so that ``vmdg.laws`` can be imported where
only numpy is installed.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:  # the public names, as editors and type checkers read them
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

# The same imports, made when a name is first used: subpackages have no module here.
_SOURCE = ast.parse(Path(__file__).read_bytes()).body
_IMPORTS = next(part.body for part in _SOURCE if isinstance(part, ast.If))
_HOME = {item.name: line.module for line in _IMPORTS for item in line.names}

__all__ = [name for name, module in _HOME.items() if module]
__version__ = "0.1.0"


def __getattr__(name: str):
    if name not in _HOME:
        raise AttributeError(f"module 'vmdg' has no attribute {name!r}")
    if _HOME[name] is None:
        return import_module(f"{__name__}.{name}")
    return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOME])
