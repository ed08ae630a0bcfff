"""Finds or builds a FEniCSx environment and runs Python in it.

In this order:
  1. the machine's own Python, if it has DOLFINx 0.9 - 0.11 (conda, Docker image, Debian 13;
     VMDG_PYTHON names another one);
  2. where python3 is 3.12 or newer: wheels of PyPI in a private virtual environment;
  3. as root on Debian 13 or newer: Debian's packages, installed with apt-get;
  4. a private Debian tree, built once with mmdebstrap and entered with bubblewrap.
What is private is in the user's cache folder. A tree that is there already goes before 2 and 3.

Variables a user may set: VMDG_PYTHON, VMDG_DEBIAN_MIRROR, VMDG_JIT_CACHE, XDG_CACHE_HOME,
OMP_NUM_THREADS.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
import shutil
import signal
from pathlib import Path
from typing import NamedTuple, NoReturn

import common
import debian
import wheels
from common import CACHE, default, die

#: Asks an interpreter without importing, as an import of DOLFINx starts MPI and takes a second.
DESCRIBE = """
import sys
sys.path[:] = filter(None, sys.path)  # not the current folder
import json
from importlib.metadata import version
from importlib.util import find_spec
wheel = find_spec("dolfinx_solver")
found = version("dolfinx-solver-real" if wheel else "fenics-dolfinx")
missing = [name for name in sys.argv[1:] if find_spec(name) is None]
print(json.dumps([sys.executable, found, sys.prefix if wheel else "", missing]))
"""

#: More ranks than cores are welcome, and runs side by side must not be bound to the same cores.
#: Variables rather than options of mpirun, because tests start mpirun themselves; every Open MPI
#: complains about the others' names.
OPEN_MPI = {
    4: "OMPI_MCA_rmaps_base_oversubscribe=1 OMPI_MCA_hwloc_base_binding_policy=none",
    5: "PRTE_MCA_rmaps_default_mapping_policy=:oversubscribe "
    "PRTE_MCA_hwloc_default_binding_policy=none",
    6: "PRTE_MCA_mapby=:oversubscribe PRTE_MCA_bindto=none",
}


class Environment(NamedTuple):
    """Where DOLFINx is."""

    python: str = "/usr/bin/python3"  # of this machine, or of
    tree: Path | None = None  # a private tree
    wheel: Path | None = None  # where DOLFINx is a wheel: its folder, with MPI's lib and bin
    venv: Path | None = None  # the private one of these


def prepare(latest: bool, *modules: str) -> Environment:
    """Find or build an environment that has DOLFINx, its newest version if asked, and modules."""
    if not latest and (found := machine_python(modules)):
        return found
    if not latest and not debian.tree("trixie").is_dir():
        if venv := wheels.find_or_install():
            return Environment(f"{venv}/bin/python3", wheel=venv, venv=venv)
        if debian.CAN_APT and debian.use_packages():
            return Environment()
    suite = "sid" if latest else "trixie"
    use_variables(debian.tree(suite))  # its modules are imported when it is built
    return Environment(tree=debian.find_or_build(suite))


def machine_python(modules: tuple[str, ...]) -> Environment | None:
    """The machine's own Python, or the user's choice, if it has DOLFINx."""
    chosen = os.environ.get("VMDG_PYTHON")
    candidates = [chosen] if chosen else ["python3", "/usr/bin/python3"]
    for candidate in dict.fromkeys(filter(None, map(shutil.which, candidates))):
        said = common.output(candidate, "-c", DESCRIBE, *modules)
        python, version, prefix, missing = json.loads(said or '["", "0", "", []]')
        if not common.is_supported(version):
            continue
        if missing and not chosen and python.startswith("/usr/bin/python3") and debian.CAN_APT:
            return None  # Debian's own interpreter is completed by apt-get
        if missing:
            die(
                f"{python} has DOLFINx {version} but lacks: {' '.join(missing)}",
                f"install them with:  {python} -m pip install {' '.join(missing)}",
                f"or, for Debian's Python:  apt-get install python3-{' python3-'.join(missing)}",
            )
        return Environment(python, wheel=Path(prefix) if prefix else None)
    if chosen:
        die(f"VMDG_PYTHON={chosen} has no DOLFINx 0.9 - 0.11")
    return None


def execute(found: Environment, ranks: int, arguments: list[str], *folders: str) -> NoReturn:
    """Replace this process by Python in an environment that must see these folders."""
    use_variables(found.tree)
    mpirun = ["mpirun", "-n", str(ranks)] if ranks > 1 else []
    command = [*mpirun, found.python, *arguments]
    private, jit = found.tree or found.venv, os.environ.get("VMDG_JIT_CACHE")
    if private:
        os.environ["VMDG_PIP"] = "demos/run -m pip install"  # for messages
        _kept = common.lock(f"{private}.lock", fcntl.LOCK_SH)  # see common.remove_old
        jit = jit or str(jit_folder(private))
    if jit:
        os.makedirs(jit, exist_ok=True)
        os.environ["XDG_CACHE_HOME"] = os.path.realpath(jit)
    if found.tree:
        variables = debian.variables(found.tree)
        command = debian.inside(found.tree, command, *folders)
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    else:
        own = wheels.variables(found.wheel, found.venv is not None) if found.wheel else os.environ
        variables = {**own, "PYTHONPATH": common.before(common.ROOT, own.get("PYTHONPATH"))}
        if not shutil.which(command[0], path=own["PATH"]):
            die(f"{command[0]} is not on the PATH")
    os.execvpe(command[0], command, variables)


def jit_folder(private: Path) -> Path:
    """Where kernels are kept: compiled for a processor, as a home folder may serve several."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    flags = next((line for line in lines if line.startswith("flags")), "")
    return CACHE / f"jit-{private.name}-{common.short_hash(flags, length=4)}"


def use_variables(tree: Path | None) -> None:
    """Settings of MPI, threads and pictures that the user has not chosen."""
    default("OMP_NUM_THREADS", "1")  # ranks are the parallelism; threads in addition only compete
    os.environ.update(OMPI_ALLOW_RUN_AS_ROOT="1", OMPI_ALLOW_RUN_AS_ROOT_CONFIRM="1")
    os.environ["ADIOS2_ALWAYS_USE_MPI"] = "1"  # Debian's names a serial half that its package lacks
    # More ranks than cores: a rank that waits should let the others work.
    default("OMPI_MCA_mpi_yield_when_idle", "1")
    # One machine, so shared memory is enough; TCP only complains about unusual networks.
    if not common.ON_BATCH_SYSTEM:
        default("OMPI_MCA_btl", "^tcp")
    said = "" if tree else common.output("mpirun", "--version")
    number = re.search(r"Open(?:RTE| MPI)\)? (\d+)\.", said)
    if tree or number:
        major = int(number[1]) if number else 6 if "-sid-" in tree.name else 5
        settings = OPEN_MPI[min(max(major, 4), 6)].split()
        os.environ.update(setting.split("=") for setting in settings)
    if not os.environ.get("DISPLAY") and not os.environ.get("WAYLAND_DISPLAY"):
        default("MPLBACKEND", "Agg")
