"""Examples can be copied and changed: each file needs vmdg and the usual libraries only."""

from __future__ import annotations

import ast
import json
import os
import re
import runpy
import shutil
import subprocess
import sys
from importlib import import_module
from inspect import getdoc, signature
from pathlib import Path

from mpi4py import MPI

import pytest

import vmdg

ROOT = Path(vmdg.__file__).resolve().parents[1]
EXAMPLES = {path.stem: path for path in sorted((ROOT / "demos").glob("*.py"))}
STUDIES = {path.stem: path for path in sorted((ROOT / "demos" / "studies").glob("*.py"))}
LIBRARIES = {"vmdg", "dolfinx", "ufl", "numpy", "mpi4py", "matplotlib", "gmsh", "tqdm"}
UNIT = re.compile(r"\[(m|mm|s|mm/s|MPa|N/mm|-|degrees)\]")
EVERY = pytest.mark.parametrize("name", EXAMPLES)
COUNT = runpy.run_path(str(ROOT / ".ci" / "lines.py"))["count"]
alone = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")

#: Coarse runs of those that take a second or two.
CHEAP = {
    "fibre_cell": "--fibres 1 --cells 2 --end .004 --steps 1",
    "load_cycle": "--steps 5",
    "weak_links": "--bars 2 --steps 4",
}


#: What every copy says about its options, in one process.
HELP = """
import io, json, runpy, sys
from contextlib import redirect_stdout

said = {}
for name in sys.argv[1:]:
    sys.argv = [name, "--help"]
    with redirect_stdout(io.StringIO()) as out:
        try:
            runpy.run_path(name, run_name="__main__")
        except SystemExit as end:
            assert not end.code, name
    said[name] = out.getvalue()
print(json.dumps(said))
"""


def run(folder: Path, *arguments: str) -> str:
    """What Python says in a folder where only vmdg can be imported."""
    package = folder / "package"
    package.mkdir()
    (package / "vmdg").symlink_to(ROOT / "vmdg")
    paths = [path for path in os.environ.get("PYTHONPATH", "").split(os.pathsep) if path]
    paths = [path for path in paths if not Path(path).resolve().is_relative_to(ROOT)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(package), *paths])}
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_examples_and_studies_are_told_apart():
    """Those of the report among them; no name twice."""
    assert {"tutorial", "fibre_matrix", "tearing", "pushout"} < set(EXAMPLES)
    assert {"patch_tension", "patch_shear", "convergence"} < set(STUDIES)
    assert not set(EXAMPLES) & set(STUDIES)


@EVERY
def test_length(name):
    """Thin enough to be read at once, copied and changed: at most 100 lines of code."""
    assert COUNT(EXAMPLES[name].read_text())["code"] <= 100


@EVERY
def test_imports(name):
    """Nothing but vmdg, the usual libraries and those of Python; no private name."""
    for node in ast.walk(ast.parse(EXAMPLES[name].read_text())):
        modules = [node.module] if isinstance(node, ast.ImportFrom) else []
        modules += [item.name for item in node.names] if isinstance(node, ast.Import) else []
        for module in modules:
            assert module.partition(".")[0] in LIBRARIES | sys.stdlib_module_names, module
        assert not (isinstance(node, ast.Attribute) and node.attr == "step"), "protocol of solvers"


@pytest.fixture(scope="module")
def answers(tmp_path_factory) -> dict[str, str]:
    """By file, what a copy of it in a folder of its own answers to ``--help``."""
    folder = tmp_path_factory.mktemp("copies")
    (folder / "help.py").write_text(HELP)
    for name, path in EXAMPLES.items():
        (folder / name).mkdir()
        shutil.copy(path, folder / name)
    return json.loads(run(folder, "help.py", *(f"{name}/{name}.py" for name in EXAMPLES)))


@alone
@EVERY
def test_help_of_a_copy(name, answers):
    """All options with their defaults, which are those of main; physical ones with their unit."""
    said = " ".join(answers[f"{name}/{name}.py"].split())
    module = import_module(name)
    assert " ".join(getdoc(module).split())[:60] in said
    for option, argument in signature(module.main).parameters.items():
        flag = option.replace("_", "-")
        if isinstance(argument.default, bool):
            assert f" --{'no-' * argument.default}{flag} " in said
            continue
        found = re.search(rf" --{flag} (?:[A-Z_]+|{{[^}}]*}}) (.*?) \(default: (.*?)\)", said)
        assert found, flag
        assert found[2] == str(argument.default)
        if "float" in str(argument.annotation):
            assert UNIT.search(found[1]), f"{option} of {name} has no unit"


@alone
@pytest.mark.parametrize("name", CHEAP)
def test_copy_runs(name, tmp_path):
    """A picture comes out."""
    shutil.copy(EXAMPLES[name], tmp_path)
    run(tmp_path, f"{name}.py", *CHEAP[name].split(), "--out", "found")
    assert (tmp_path / "found" / f"{name}.png").stat().st_size > 10_000
