"""The command line of the studies: every option with its default, physical ones with their unit."""

from __future__ import annotations

import inspect
import re
from importlib import import_module
from pathlib import Path
from typing import Annotated, get_type_hints

import pytest
from parts.options import descriptions, parser, run

STUDIES = sorted(
    path.stem for path in (Path(__file__).resolve().parents[2] / "demos" / "studies").glob("*.py")
)
UNIT = re.compile(r"\[(mm|MPa|-|N|N/mm|s|degrees)\]")


@pytest.mark.parametrize("name", STUDIES)
def test_help(comm, capsys, name):
    """``--help`` on rank 0 only: name, text, default and unit of every argument of main."""
    main = import_module(name).main
    with pytest.raises(SystemExit) as error:
        run(main, ["--help"])
    assert error.value.code == 0
    said = " ".join(capsys.readouterr().out.split())
    if comm.rank > 0:
        assert said == ""
        return
    assert inspect.getdoc(import_module(name)).splitlines()[0] in said
    types = get_type_hints(main)
    for option, argument in inspect.signature(main).parameters.items():
        flag = f"--{option.replace('_', '-')}"
        text = descriptions(main)[option]
        default = {None: "none", True: "yes", False: "no"}
        value = argument.default
        value = default[value] if value is None or isinstance(value, bool) else value
        assert f"{text} (default: {value})" in said
        assert flag in said or types[option] == list[str] | None
        if types[option] in (float, float | None):
            assert UNIT.search(text), f"{option} of {name} has no unit"


def scene(
    words: list[str] | None = None,
    size: float = 0.5,
    end: float | None = None,
    kind: Annotated[str, {"soft": 1, "stiff": 2}] = "soft",
    is_fine: bool = False,
) -> dict:
    """What it was given.

    Args:
        words: Any; 100 % of them.
        size: Of a cell
            [mm].
        end: Where to stop [mm].
        kind: Of the body.
        is_fine: Small cells.

    Returns:
        All of it.
    """
    found.append(locals())
    return locals()


found: list[dict] = []


def test_types():
    """Options are converted to the types of the signature, and main is called with them."""
    found.clear()
    run(scene, ["a", "b", "--size", "2", "--end", "1e-3", "--kind", "stiff", "--is-fine"])
    run(scene, ["--no-is-fine"])
    given = {"words": ["a", "b"], "size": 2.0, "end": 1e-3, "kind": "stiff", "is_fine": True}
    assert found[0] == given
    assert found[1]["is_fine"] is False
    assert descriptions(scene)["size"] == "Of a cell [mm]"
    assert "100 % of them" in parser(scene).format_help()


@pytest.mark.parametrize("wrong", [["--kind", "liquid"], ["--size", "big"], ["--colour", "red"]])
def test_wrong_options(comm, capsys, wrong):
    """Refused by all ranks, said by one."""
    with pytest.raises(SystemExit) as error:
        run(scene, wrong)
    assert error.value.code == 2
    assert bool(capsys.readouterr().err) == (comm.rank == 0)
