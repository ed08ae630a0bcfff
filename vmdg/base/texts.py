"""Arguments as one text each, to compare them between ranks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from enum import Enum
from numbers import Number
from pathlib import PurePath
from types import FunctionType, MethodType
from typing import Any

import numpy as np

#: Arrays of more numbers, and integers in arrays, may be those of this rank.
_FEW = 9

#: Objects within objects, beyond which only classes are compared.
_DEPTH = 4

_PACKAGE = __name__.partition(".")[0]


def as_text(value: Any, depth: int = _DEPTH) -> str:
    """Numbers, words, paths, small arrays, containers, functions and objects of vmdg as text that
    is equal on all ranks if they are; of other objects, such as meshes, their class.

    A function is its code with the numbers and words that it uses from outside.
    """
    if value is None or isinstance(value, Number | str | bytes | PurePath | Enum):
        return repr(value.item() if isinstance(value, np.generic) else value)
    if isinstance(value, np.ndarray):
        mine = value.size > _FEW or value.dtype.kind not in "fc"
        return f"array of {value.dtype}" if mine else f"array {value.tolist()}"
    if isinstance(value, FunctionType):
        return f"{value.__qualname__}({_of_function(value, depth)})"
    if isinstance(value, MethodType):
        return f"{value.__func__.__qualname__} of {as_text(value.__self__, depth - 1)}"
    if depth and isinstance(value, Mapping):
        items = sorted((as_text(k, 0), as_text(v, depth - 1)) for k, v in value.items())
        return f"{{{', '.join(f'{k}: {v}' for k, v in items)}}}"
    if depth and isinstance(value, list | tuple | set | frozenset):
        items = [as_text(one, depth - 1) for one in value]
        return f"[{', '.join(sorted(items) if isinstance(value, set | frozenset) else items)}]"
    name = type(value).__qualname__
    of_vmdg = type(value).__module__.partition(".")[0] == _PACKAGE and not hasattr(value, "comm")
    if depth and (of_vmdg or isinstance(getattr(value, "parameters", None), Mapping)):
        public = {k: v for k, v in getattr(value, "__dict__", {}).items() if not k.startswith("_")}
        public |= dict(getattr(value, "parameters", {}))
        return f"{name}({_named(public.items(), depth - 1)})"
    if type(value).__module__.startswith("dolfinx") and hasattr(value, "value"):
        return f"{name}({as_text(np.asarray(value.value, dtype=float), depth)})"  # a Constant
    return name


def in_full(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value


def _named(items: Iterable[tuple[str, Any]], depth: int) -> str:
    return ", ".join(f"{name}={as_text(value, depth)}" for name, value in items)


def _of_function(function: FunctionType, depth: int) -> str:
    """The code of a function as a number, and its defaults and the values from outside."""
    code = function.__code__
    cells = zip(code.co_freevars, function.__closure__ or (), strict=True)
    outside = {name: _content(cell) for name, cell in cells}
    outside |= {n: function.__globals__[n] for n in code.co_names if n in function.__globals__}
    plain = {n: v for n, v in outside.items() if isinstance(v, Number | str | np.ndarray)}
    constants = [one for one in code.co_consts if isinstance(one, Number | str | None)]
    given = [*(function.__defaults__ or ()), *(function.__kwdefaults__ or {}).values()]
    parts = [code.co_code.hex()[:400], as_text(constants), as_text(given, depth - 1)]
    return ", ".join([*parts, _named(sorted(plain.items()), 1)])


def _content(cell: Any) -> Any:
    try:
        return cell.cell_contents
    except ValueError:  # not assigned yet
        return None
