"""DOLFINx from the wheels of PyPI, in a private virtual environment in the user's cache folder.

What is asked for is in wheels.in; the versions that are installed, with the hashes of their files,
are in wheels.lock, so that nothing else is accepted from the index. To renew it:

    uv pip compile --python-version 3.12 --universal --generate-hashes --no-header --no-annotate
        --upgrade .ci/setup/wheels.in -o .ci/setup/wheels.lock
"""

from __future__ import annotations

import os
import platform
import shutil
import sys
import sysconfig
import time
from pathlib import Path

import common
from common import CACHE, MODULES, say

LOCK = Path(__file__).with_name("wheels.lock")
GMSH_NEEDS = "libglu1-mesa libxrender1 libxcursor1 libxft2 libxinerama1"  # not in its wheel
LOCKED = ("--require-hashes", "--only-binary", ":all:")  # no code of a package runs
FORMAT = 2  # raise it when the way of installing changes: a new environment replaces the old one


def lacking() -> str | None:
    """What this machine lacks for the wheels, or nothing; None if its Python is too old."""
    if sys.version_info < (3, 12) or sys.platform != "linux":
        return None
    if platform.machine() != "x86_64":
        return f"its wheels are for x86_64, and this machine is {platform.machine()}"
    name, _, libc = (os.confstr("CS_GNU_LIBC_VERSION") or "none 0").partition(" ")
    if name != "glibc" or tuple(map(int, libc.split(".")[:2])) < (2, 34):
        return f"its wheels need glibc 2.34 or newer, and this system has {name} {libc}"
    compiler = os.environ.get("CC") or sysconfig.get_config_var("CC")
    if shutil.which(compiler.split()[0]) is None:
        return f"its C compiler '{compiler}' is missing, which makes kernels (package gcc)"
    if not os.path.isfile(os.path.join(sysconfig.get_path("include"), "Python.h")):
        return "there is no Python.h for kernels (package python3-dev, or python3-devel)"
    return ""


def find_or_install() -> Path | None:
    """The environment, or None and the reason, if this Python could have one."""
    reason = lacking()
    if reason:
        say(f"python3 could have DOLFINx from PyPI, but {reason}")
    if reason != "":
        return None
    # A Python that changes under an environment breaks it; so it is part of the name.
    key = common.short_hash(FORMAT, sys.base_prefix, sys.version, LOCK.read_text())
    venv = CACHE / f"wheels-{key}"
    if not (venv / "complete").exists():
        with common.build_lock():
            if not (venv / "complete").exists() and not install(venv):
                return None
    return venv


def install(venv: Path) -> bool:
    """Whether the environment could be installed. Only called under the build lock."""
    say(f"installing DOLFINx from PyPI's wheels in {venv}, half a minute, 1.2 GB")
    start, own = time.monotonic(), variables(venv, private=True)
    if not all(common.logged(f"{venv.name}.log", step, own) for step in steps(venv)):
        shutil.rmtree(venv, ignore_errors=True)
        say("the wheels could not be installed, or do not load here")
        say(f"(gmsh needs of the system, as Debian and Ubuntu call it: {GMSH_NEEDS})")
        return False
    (venv / "complete").touch()
    say(f"installed in {time.monotonic() - start:.0f} s")
    common.remove_old("wheels", venv, shutil.rmtree)
    return True


def steps(venv: Path) -> list[list[str]]:
    """Commands that install the packages and import what scripts need."""
    python = str(venv / "bin" / "python3")
    modules = ", ".join(("dolfinx", "petsc4py.PETSc", *MODULES, "pytest", "xdist", "hypothesis"))
    return [
        [sys.executable, "-m", "venv", "--clear", str(venv)],  # clear of an interrupted one
        [python, "-m", "pip", "install", "--no-input", *LOCKED, "-r", str(LOCK)],
        [python, "-P", "-c", f"import {modules}"],
    ]


def variables(prefix: Path, private: bool) -> dict[str, str]:
    """Environment of a command where DOLFINx is a wheel, with its own PETSc and MPI."""
    # Modules of the machine's Python mean nothing (or harm) in a private environment.
    others = ("PETSC_DIR", "PETSC_ARCH", "SLEPC_DIR", *(common.PYTHON_VARIABLES if private else ()))
    kept = {name: value for name, value in os.environ.items() if name not in others}
    kept["PATH"] = common.before(prefix / "bin", kept.get("PATH"))
    kept["LD_LIBRARY_PATH"] = common.before(prefix / "lib", kept.get("LD_LIBRARY_PATH"))
    # UCX would try network cards that a virtual machine shows but may not use.
    if not common.ON_BATCH_SYSTEM:
        kept["UCX_TLS"] = kept.get("UCX_TLS") or "self,sm,tcp"
    return {**kept, "PYTHONNOUSERSITE": "1", "PIP_USER": "0"} if private else kept
