"""The package as a user meets it: its names, what it imports, and what is installed."""

from __future__ import annotations

import ast
import os
import re
import runpy
import shutil
import subprocess
import sys
from importlib import import_module, metadata
from importlib.util import find_spec
from inspect import unwrap
from pathlib import Path
from zipfile import ZipFile

from mpi4py import MPI

import pytest

import vmdg

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("forms", "laws", "meshes", "plot")


def test_public_names():
    """Every public name can be loaded, and an unknown one is an AttributeError."""
    assert all(getattr(vmdg, name) is not None for name in vmdg.__all__)
    assert {*vmdg.__all__, *PACKAGES} <= set(dir(vmdg))
    with pytest.raises(AttributeError, match="no attribute 'Cohesive'"):
        vmdg.Cohesive  # noqa: B018


def test_names_for_editors():
    """What editors read in the stub is what is loaded, under the same name."""
    tree = ast.parse(Path(vmdg.__file__).with_suffix(".pyi").read_text())
    found = {}
    for node in (node for node in tree.body if isinstance(node, ast.ImportFrom)):
        home = import_module("vmdg." + node.module if node.module else "vmdg")
        found |= {alias.asname: getattr(home, alias.name) for alias in node.names}
    assert set(found) == {*vmdg.__all__, *PACKAGES}
    assert all(unwrap(item) is unwrap(getattr(vmdg, name)) for name, item in found.items())


def test_laws_need_numpy_only():
    """``vmdg.laws`` is there after ``import vmdg`` where DOLFINx, PETSc and MPI are missing."""
    code = (
        "import sys\n"
        "for name in ('dolfinx', 'petsc4py', 'mpi4py', 'ufl', 'basix', 'scipy'):\n"
        "    sys.modules[name] = None\n"
        "import vmdg\n"
        "print(vmdg.laws.Debonding(strength=1.0, critical_gap=0.5).softening_modulus)\n"
    )
    environment = {"PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"]}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "2.0"


def test_checkout_is_one_package():
    """The folders beside the engine are no part of it, and the engine none of itself."""
    assert find_spec("vmdg.forms") and find_spec("vmdg.meshes")
    assert not any(find_spec(f"vmdg.{name}") for name in ("vmdg", "tests", "demos"))


def test_one_version():
    """The citation and the history name the version of the source, from which the wheel has it."""
    read = {
        name: (ROOT / ".github" / name).read_text() for name in ("CITATION.cff", "CHANGELOG.md")
    }
    assert re.findall(r"^version: (.*)$", read["CITATION.cff"], re.MULTILINE) == [vmdg.__version__]
    released = re.findall(r"^## \[?(\d[\w.]*)", read["CHANGELOG.md"], re.MULTILINE)
    assert released[0] == vmdg.__version__
    project = (ROOT / "pyproject.toml").read_text().partition("[project]\n")[2].partition("\n[")[0]
    assert not re.search(r"^version\b", project, re.MULTILINE)


def test_environments_have_what_the_tests_need():
    """The conda environment and the extras list what ``tests/run`` asks a machine's Python for."""
    common = runpy.run_path(str(ROOT / ".ci" / "setup" / "common.py"))
    modules = {*common["MODULES"], *common["TEST_MODULES"]}
    assert {"gmsh", "scipy", "pytest", "meshio"} <= modules
    other_name = {"gmsh": "python-gmsh", "xdist": "pytest-xdist"}
    conda = (ROOT / ".ci" / "environment.yml").read_text()
    listed = set(re.findall(r"^  - ([\w-]+)", conda, re.MULTILINE))
    assert {other_name.get(module, module) for module in modules} <= listed
    project = (ROOT / "pyproject.toml").read_text().partition("[tool.")[0]
    # DOLFINx, which is not pip's, comes with adios2.
    wanted = {"xdist": "pytest-xdist"}
    names = {wanted.get(module, module) for module in modules - {"adios2"}}
    assert names <= set(re.findall(r'"([\w-]+)"', project))


@pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1 or int(metadata.version("setuptools").partition(".")[0]) < 77,
    reason="starts a process; needs setuptools 77",
)
def test_wheel(tmp_path):
    """A wheel has every module, C source and header of vmdg, and its mark of types."""
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy(ROOT / name, tmp_path)
    for name in ("forms", "meshes", "vmdg"):
        shutil.copytree(ROOT / name, tmp_path / name, symlinks=True)
    code = "from setuptools import build_meta; print(build_meta.build_wheel('.'))"
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert done.stdout.split()[-1].startswith(f"vmdg-{vmdg.__version__}-")
    with ZipFile(tmp_path / done.stdout.split()[-1]) as wheel:
        found = {name for name in wheel.namelist() if ".dist-info/" not in name}
    folders = [ROOT / "vmdg", *(path for path in (ROOT / "vmdg").iterdir() if path.is_dir())]
    modules = [
        path
        for folder in folders
        for end in ("py", "c", "h", "mplstyle")
        for path in folder.glob(f"*.{end}")
    ]
    assert found == {
        "vmdg/py.typed",
        "vmdg/__init__.pyi",
        *(str(path.relative_to(ROOT)) for path in modules),
    }
