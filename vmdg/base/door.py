"""Wrong arguments of public names: an error from inside becomes one that names the argument.

Checks in the functions say best what is wrong. What they miss ends in an error of Python or numpy
somewhere inside. It is compared with the annotations of the arguments here, in one place, and only
then: calls that work cost nothing and cannot be refused.
"""

from __future__ import annotations

import inspect
import sys
import types
from collections.abc import Callable, Collection, Iterable, Mapping
from enum import EnumMeta
from functools import cache, wraps
from numbers import Integral, Real
from opcode import opmap
from os import PathLike
from pathlib import Path
from reprlib import Repr
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin

import numpy as np

from .words import near

Called = TypeVar("Called", bound=Callable[..., Any])

_HERE = str(Path(__file__).parent.parent)
#: Other places whose functions are not the user's.
_LIBRARIES = (sys.prefix, sys.base_prefix, "<frozen", "<__array", "<string>")
_RAISE = {opmap[name] for name in ("RAISE_VARARGS", "RERAISE") if name in opmap}

#: Errors that arguments may cause.
_WRONG = (TypeError, ValueError, AttributeError, LookupError, ArithmeticError)

_BULK = "with the bulk modulus K and the shear modulus G, lmbda=K - 2*G/3 and mu=G", ["lmbda", "mu"]
_ENERGY = (
    "with the fracture energy G_c of a linear law, critical_gap=2*G_c/strength",
    ["critical_gap", "strength"],
)
#: Arguments of other programs: what they are here, and where this is an answer.
_ELSEWHERE = {name: _ENERGY for name in ("fracture_energy", "G_c", "Gc", "GIc", "toughness")}
_ELSEWHERE |= {name: _BULK for name in ("K", "G", "kappa", "bulk_modulus", "shear_modulus")}

#: Arguments by other names: those of PETSc and DOLFINx, and of what is close to them.
_OTHERWISE = {
    "SolveOptions": {
        **dict.fromkeys(("rtol", "snes_rtol", "tolerance", "tol"), "relative_tolerance"),
        **dict.fromkeys(("max_it", "snes_max_it", "maxiter"), "max_iterations"),
        "solver_options": "petsc",
    },
    "Interface": {
        "tags": "between",
        "groups": "between",
        "tag": "within",
        "group": "within",
        "material": "law",
    },
    "read_mesh": {"tags": "cell_tags", "physical": "groups", "tolerance": "merge"},
}
_SHORT = Repr()
_SHORT.maxother = _SHORT.maxstring = 80


def door(called: Called, inner: bool = True, largest: float = np.inf) -> Called:
    """Decorate a public function, or a class, whose ``__init__`` is decorated.

    Args:
        inner: Whether any error from inside is one of the arguments; not where a run may fail.
        largest: Largest number but a seed, where libraries end the process at larger ones; counts
            are below 1e6.
    """
    function = cast(Any, called).__init__ if inspect.isclass(called) else called
    if (
        not isinstance(function, types.FunctionType)
        or hasattr(function, "_door")
        or _is(called, EnumMeta)
    ):
        return called
    name = called.__name__

    @wraps(function)
    def checked(*arguments: Any, **keywords: Any) -> Any:
        try:
            if largest < np.inf:
                _check(name, function, _given(function, arguments, keywords), largest)
            return function(*arguments, **keywords)
        except Exception as error:
            if not isinstance(error, _WRONG) and type(error) is not Exception:  # of gmsh
                raise
            if error.__traceback__ is not None and error.__traceback__.tb_next is None:
                raise _miscalled(name, function, arguments, keywords, error) from None
            if not _from_inside(error):
                raise
            given = _given(function, arguments, keywords)
            try:
                _check(name, function, given)
            except TypeError as told:
                raise told from error
            if not inner:
                raise
            said = ", ".join(f"{argument} = {_SHORT.repr(one)}" for argument, one in given.items())
            kind = TypeError if isinstance(error, TypeError) else ValueError
            raise kind(
                f"{name} cannot use these arguments ({type(error).__name__}: {error}): {said}"
            ) from error

    checked._door = True  # type: ignore[attr-defined]
    if not inspect.isclass(called):
        return cast(Called, checked)
    cast(Any, called).__init__ = checked
    return called


def _check(
    name: str, function: Callable[..., Any], given: Mapping[str, Any], largest: float = np.inf
) -> None:
    for argument, value in given.items():
        if not fits(value, _hint(function, argument)):
            annotation = function.__annotations__[argument]
            word = annotation if isinstance(annotation, str) else str(annotation)
            raise TypeError(f"{name}: {argument} = {_SHORT.repr(value)} must be {word}")
        for one in np.ravel(np.asarray(value, dtype=object)) if largest < np.inf else ():
            most = 1e6 if isinstance(one, int) else largest
            if isinstance(one, Real) and not abs(one) <= most and argument != "seed":
                raise ValueError(f"{name}: {argument} = {one!r} must be finite, up to {most:g}")


def _from_inside(error: BaseException) -> bool:
    """Whether an error has no words of vmdg, and is none of the call itself or of a function of the
    user."""
    trace = error.__traceback__
    trace = trace and trace.tb_next  # behind the door
    if trace is None:
        return False
    while trace is not None:
        code, place = trace.tb_frame.f_code, trace.tb_lasti
        file = code.co_filename
        mine = file.startswith(_HERE) or "/vmdg/" in file
        if (
            not mine
            and not file.startswith(_LIBRARIES)
            and "-packages" not in file
            and not file.endswith(".pyx")
        ):
            return False
        last, trace = (mine, code.co_code[place]), trace.tb_next
    return not (last[0] and last[1] in _RAISE)


def _miscalled(
    name: str,
    function: Callable[..., Any],
    arguments: tuple[Any, ...],
    keywords: dict[str, Any],
    error: Exception,
) -> Exception:
    """The error of a call with names that do not exist, or too many arguments without a name."""
    parameters = [one for one in inspect.signature(function).parameters.values()]
    kinds = [(one.name, one.kind) for one in parameters if one.name not in ("self", "cls")]
    if any(
        kind in (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)
        for _, kind in kinds
    ):
        return error
    names = [one for one, _ in kinds]
    for unknown in (word for word in keywords if word not in names):
        meant = near(unknown, names, _OTHERWISE.get(name))
        formula, needed = _ELSEWHERE.get(unknown, ("", []))
        if formula and not meant and {*needed} <= {*names}:
            meant = f": {formula}"
        meant = meant or f"; it takes {', '.join(names)}"
        return TypeError(f"{name}: there is no {unknown}={meant}")
    plain = [one for one, kind in kinds if kind is not inspect.Parameter.KEYWORD_ONLY]
    if len(arguments) > len(plain) + (len(parameters) > len(kinds)):
        named = ", ".join(f"{one}=" for one in names)
        return TypeError(f"{name}: give the arguments by name, {name}({named})")
    return error


def _given(
    function: Callable[..., Any], arguments: tuple[Any, ...], keywords: dict[str, Any]
) -> dict[str, Any]:
    """Arguments by name, without ``self``; none where the call itself is wrong."""
    try:
        given = inspect.signature(function).bind(*arguments, **keywords).arguments
    except TypeError:
        return {}
    return {name: one for name, one in given.items() if name not in ("self", "cls")}


@cache
def _hint(function: Callable[..., Any], argument: str) -> Any:
    """The annotation of an argument; Any where a name in it is known to type checkers only."""
    annotation = getattr(function, "__annotations__", {}).get(argument, Any)
    if not isinstance(annotation, str):
        return annotation
    inside = inspect.unwrap(function)
    try:
        return eval(annotation, getattr(inside, "__globals__", {}))
    except Exception:  # any name or operator
        return Any


def fits(value: Any, hint: Any) -> bool:
    origin, parts = get_origin(hint), get_args(hint)
    if hint in (Any, inspect.Parameter.empty) or isinstance(hint, TypeVar):
        return True
    if origin in (Union, types.UnionType):
        arrays = any(_of_arrays(part) for part in parts)
        plain = [part for part in parts if not (arrays and part in (str, bytes, complex))]
        return any(fits(value, part) for part in plain)
    if hint is None or hint is type(None):
        return value is None
    if _of_arrays(hint) or origin is np.ndarray:
        return _numbers(value)
    if origin is Literal:
        return value in parts
    if hint in (float, int, bool):
        kinds = {float: Real, int: Integral, bool: bool | np.bool_}
        if isinstance(value, np.ndarray) and value.ndim == 0 and value.dtype.kind in "iuf":
            value = value.item()
        return isinstance(value, kinds[hint]) and (hint is bool or not isinstance(value, bool))
    if hint is Path:
        return isinstance(value, PathLike)
    if origin is None:
        return _is(value, hint)
    if origin is Callable or not isinstance(origin, type):
        return callable(value) if origin is Callable else True
    if issubclass(origin, tuple):
        same = not parts or parts[-1] is Ellipsis or len(parts) == _length(value)
        return isinstance(value, tuple | list | np.ndarray) and same
    if issubclass(origin, Mapping):
        return isinstance(value, Mapping) and all(
            fits(key, parts[0]) and fits(one, parts[1]) for key, one in value.items()
        )
    if issubclass(origin, Callable):  # type: ignore[arg-type]
        return callable(value)
    if issubclass(origin, Iterable):
        if isinstance(value, np.ndarray):
            return bool(value.ndim)
        text = isinstance(value, str | bytes)
        if text or not isinstance(value, Iterable):
            return False
        items = list(value) if isinstance(value, Collection) else []
        return all(fits(one, parts[0]) for one in items) if parts else True
    return _is(value, origin)


def _is(value: Any, kind: Any) -> bool:
    try:
        return isinstance(value, kind)
    except TypeError:  # a protocol, or no class
        return True


def _of_arrays(hint: Any) -> bool:
    """Whether this is one of the types of which ``numpy.typing.ArrayLike`` consists."""
    return any(word in str(hint) for word in ("_SupportsArray", "_NestedSequence", "_Buffer"))


def _numbers(value: Any) -> bool:
    try:
        return np.asarray(value).dtype.kind in "biuf"
    except ValueError:
        return False


def _length(value: Any) -> int:
    return len(value) if isinstance(value, Collection) else -1
