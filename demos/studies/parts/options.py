"""The command line of a demo: the arguments of its ``main``, described by their docstrings.

An argument of type bool becomes ``--name`` and ``--no-name``, a list becomes positional arguments,
any other an option of its type; ``Annotated[str, CHOICES]`` takes one of ``CHOICES`` only. The help
is the text under ``Args:`` with the default.
"""

from __future__ import annotations

import inspect
import os
import re
import sys
import textwrap
from argparse import ArgumentParser, BooleanOptionalAction, RawDescriptionHelpFormatter
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from types import NoneType
from typing import Annotated, Any, get_args, get_origin, get_type_hints

from mpi4py import MPI


def run(main: Callable[..., Any], arguments: list[str] | None = None) -> None:
    """Call ``main`` with the options of the command line; rank 0 speaks.

    Args:
        arguments: Of the command line; None for those of the process.
    """
    command = parser(main)
    if MPI.COMM_WORLD.rank == 0:
        chosen = command.parse_args(arguments)
    else:
        with open(os.devnull, "w") as nowhere, redirect_stdout(nowhere), redirect_stderr(nowhere):
            chosen = command.parse_args(arguments)
    main(**vars(chosen))


def parser(main: Callable[..., Any]) -> ArgumentParser:
    module = sys.modules[main.__module__]
    command = ArgumentParser(
        prog=os.path.basename(module.__file__).removesuffix(".py"),
        description=inspect.getdoc(module),
        formatter_class=RawDescriptionHelpFormatter,
    )
    described, types = descriptions(main), get_type_hints(main, include_extras=True)
    for name, argument in inspect.signature(main).parameters.items():
        if name not in described:
            raise ValueError(f"{module.__name__}.main: Args: does not describe {name!r}")
        add(command, name, types[name], argument.default, described[name])
    return command


def add(command: ArgumentParser, name: str, kind: Any, default: Any, text: str) -> None:
    choices = None
    if get_origin(kind) is Annotated:
        kind, choices = get_args(kind)
    alternatives = [part for part in get_args(kind) if part is not NoneType]
    if NoneType in get_args(kind):
        (kind,) = alternatives
    shown = "none" if default is None else default
    details: dict[str, Any] = {
        "default": default,
        "help": f"{text} (default: {shown})".replace("%", "%%"),
    }
    flag = f"--{name.replace('_', '-')}"
    if kind is bool:
        details["help"] = f"{text} (default: {'yes' if default else 'no'})".replace("%", "%%")
        command.add_argument(flag, action=BooleanOptionalAction, **details)
        return
    if get_origin(kind) is list:
        command.add_argument(name, nargs="*", type=get_args(kind)[0], **details)
        return
    if choices is None:
        details["metavar"] = {int: "N", float: "X"}.get(kind, name.upper())
    command.add_argument(flag, type=kind, choices=choices and list(choices), **details)


def descriptions(main: Callable[..., Any]) -> dict[str, str]:
    """What the docstring says under ``Args:``, by argument."""
    parts = re.split(r"^Args:\n", inspect.getdoc(main) or "", flags=re.MULTILINE)
    if len(parts) < 2:
        return {}
    block = re.split(r"^\S", parts[1], maxsplit=1, flags=re.MULTILINE)[0]
    entries = re.split(r"^(\w+): ", textwrap.dedent(block), flags=re.MULTILINE)
    return {
        name: " ".join(text.split()).rstrip(".")
        for name, text in zip(entries[1::2], entries[2::2], strict=True)
    }
