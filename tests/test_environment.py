"""What finds or builds an environment: wheels in a virtual environment, Debian trees, commands."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

from mpi4py import MPI

import pytest

ROOT = Path(__file__).resolve().parent.parent
SETUP = ROOT / ".ci" / "setup"
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes")

#: A machine that the wheels fit, whatever this one is, and what stands for the installation: an
#: environment whose Python says what it was started with.
FITS = r'''
import os, platform, sys, sysconfig
from pathlib import Path
sys.path.insert(0, os.environ["SETUP"])
import common, debian, environment, wheels
from common import CACHE

sys.version_info, sys.platform = (3, 12, 3), "linux"
platform.machine = lambda: "x86_64"
os.confstr = lambda name: "glibc 2.39"
sysconfig.get_path = lambda name: os.environ["HEADERS"]
sysconfig.get_config_var = lambda name: {"CC": "sh -c"}.get(name)

FILL = r"""
    mkdir -p "$1/bin"
    printf '#!/bin/sh\nenv; echo "arguments: $*"\n' >"$1/bin/python3"
    printf '#!/bin/sh\necho "mpirun: $1 $2"; shift 2; exec "$@"\n' >"$1/bin/mpirun"
    chmod +x "$1"/bin/*
    echo filled >>"$1/../filled"
"""
wheels.steps = lambda venv: [["sh", "-c", FILL, "sh", str(venv)]]
'''


class Machine:
    """A user's machine: its cache folder, and a Python of which the modules believe a lot."""

    def __init__(self, folder: Path):
        self.cache, self.headers = folder / "cache" / "vmdg", folder / "include"
        self.headers.mkdir()
        (self.headers / "Python.h").touch()

    def run(self, code: str, **variables: str) -> subprocess.CompletedProcess[str]:
        environment = {k: v for k, v in os.environ.items() if k not in ("CC", "VMDG_JIT_CACHE")}
        environment |= {
            "XDG_CACHE_HOME": str(self.cache.parent),
            "HEADERS": str(self.headers),
            "SETUP": str(SETUP),
        }
        return subprocess.run(
            [sys.executable, "-Es", "-c", FITS + code],
            env=environment | variables,
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture
def machine(tmp_path) -> Machine:
    return Machine(tmp_path)


@pytest.mark.parametrize(
    ("believes", "variables", "message"),
    [
        ("platform.machine = lambda: 'aarch64'", {}, "for x86_64, and this machine is aarch64"),
        ("os.confstr = lambda name: 'glibc 2.31'", {}, "this system has glibc 2.31"),
        ("os.confstr = lambda name: None", {}, "this system has none 0"),
        ("", {"CC": "no-such-cc -O"}, "compiler 'no-such-cc -O' is missing"),
        ("", {"HEADERS": "/nowhere"}, "there is no Python.h"),
    ],
)
def test_wheels_that_do_not_fit(machine, believes, variables, message):
    """The reason is said, nothing is installed, and the next way may be tried."""
    done = machine.run(f"{believes}\nprint(wheels.find_or_install())", **variables)
    assert done.stdout == "None\n"
    assert message in done.stderr
    assert not machine.cache.exists()


#: No DOLFINx on the machine itself, and no tools to look for.
PREPARE = """
environment.machine_python = lambda modules: None
debian.install_tools = debian.check_sandbox = lambda *_: None
found = environment.prepare(False)
"""


def test_wheels_once(machine):
    """Installed by the first call, found by the second; with its own python3."""
    for _ in range(2):
        done = machine.run(PREPARE + "print(found.python)")
        assert done.returncode == 0, done.stderr
        python = Path(done.stdout.strip())
        assert python.is_file() and python.is_relative_to(machine.cache)
    assert (machine.cache / "filled").read_text() == "filled\n"


def test_failed_installation(machine):
    """The end of its log, no folder left, and the next way."""
    code = 'FILL = "mkdir -p $1; echo no network; exit 1"\nprint(wheels.find_or_install())'
    done = machine.run(code)
    assert done.stdout == "None\n"
    assert "no network" in done.stderr and "could not be installed" in done.stderr
    assert "libglu1-mesa" in done.stderr
    assert not [path for path in machine.cache.glob("wheels-*") if path.is_dir()]


def test_run_in_wheels(machine):
    """Its MPI for the loader, its mpirun, no modules of the machine, kernels of its own."""
    code = PREPARE + 'environment.execute(found, 3, ["-m", "thing"])'
    strange = {"PYTHONPATH": "/strange", "PETSC_DIR": "/strange"}
    done = machine.run(code, **strange)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert "mpirun: -n 3" in lines and "arguments: -m thing" in lines
    variables = dict(line.split("=", 1) for line in lines if "=" in line)
    venv = Path(variables["PATH"].split(":")[0]).parent
    assert venv.parent == machine.cache
    assert variables["LD_LIBRARY_PATH"].split(":")[0] == str(venv / "lib")
    assert variables["PYTHONPATH"] == str(ROOT)
    assert variables["PYTHONNOUSERSITE"] == "1"
    assert Path(variables["XDG_CACHE_HOME"]).name.startswith(f"jit-{venv.name}-")
    assert "PETSC_DIR" not in variables


def test_run_in_a_tree(machine):
    """A sandbox that dies with its parent, without settings of the host, with links of the tree."""
    code = """
tree = debian.tree("trixie")
(tree / "usr" / "bin").mkdir(parents=True)
(tree / "bin").symlink_to("usr/bin")
os.execvpe = lambda name, command, variables: print(command, variables, sep="\\n")
environment.execute(environment.Environment(tree=tree), 2, ["-m", "thing"])
"""
    done = machine.run(code, LD_LIBRARY_PATH="/strange", LC_ALL="C", PYTHONHOME="/strange")
    assert done.returncode == 0, done.stderr
    command, variables = map(ast.literal_eval, done.stdout.splitlines())
    assert command[:2] == ["bwrap", "--die-with-parent"]
    assert command[-6:] == ["mpirun", "-n", "2", "/usr/bin/python3", "-m", "thing"]
    place = command.index("--symlink")
    assert command[place + 1 : place + 3] == ["usr/bin", "/bin"]
    assert not {"LD_LIBRARY_PATH", "PYTHONHOME"} & set(variables)
    assert (variables["LC_ALL"], variables["PYTHONPATH"]) == ("C.UTF-8", str(ROOT))
    assert Path(variables["XDG_CACHE_HOME"]).is_dir()


def test_modules_are_for_older_python():
    """Python 3.9, the oldest that the two commands are started with, can read them."""
    for path in SETUP.glob("*.py"):
        ast.parse(path.read_text(), feature_version=(3, 9))


def command(name: str, *arguments: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run one of the two commands as users do, in this environment."""
    own = {"VMDG_PYTHON": sys.executable, **variables}
    return subprocess.run(
        ["bash", str(ROOT / name / "run"), *arguments],
        env=os.environ | own,
        capture_output=True,
        text=True,
        check=False,
    )


def test_list_of_demos():
    """Every example and study with the first line of its docstring; a wrong name shows it, too."""
    done = command("demos")
    assert done.returncode == 0, done.stderr
    for path in (*ROOT.glob("demos/*.py"), *ROOT.glob("demos/studies/*.py")):
        first = ast.get_docstring(ast.parse(path.read_text())).splitlines()[0]
        assert re.search(rf"^  {path.stem} +{re.escape(first)}$", done.stdout, re.MULTILINE)
    wrong = command("demos", "nonsense", "x")
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert "no demo and no script is called 'nonsense'" in wrong.stderr
    assert done.stdout.endswith(wrong.stderr.partition("\n")[2])


def test_wheels_are_locked():
    """Every package that is asked for has a version, and every version hashes."""
    asked = re.sub("#.*", "", (SETUP / "wheels.in").read_text())
    locked = (SETUP / "wheels.lock").read_text()
    name, digest = r"^([\w-]+)==\S.*\\$", r"(?:\n    --hash=sha256:[0-9a-f]{64}(?: \\)?)+"
    versions = re.findall(name, locked, re.MULTILINE)
    assert {*re.findall(r"^[\w-]+", asked, re.MULTILINE)} <= {*versions}
    assert re.findall(name + digest, locked, re.MULTILINE) == versions


def test_python_that_has_no_dolfinx(tmp_path):
    """The interpreter of a user's choice is not replaced by another one."""
    python = tmp_path / "python3"
    python.write_text(f'#!/bin/sh\nexec {sys.executable} -I -S "$@"\n')
    python.chmod(0o755)
    done = command("demos", "-m", "vmdg", VMDG_PYTHON=str(python))
    assert done.returncode == 1
    assert f"VMDG_PYTHON={python} has no DOLFINx 0.9 - 0.11" in done.stderr


@pytest.mark.parametrize("wheel", [True, False])
def test_mpi_of_the_wheel(tmp_path, wheel):
    """``import vmdg`` lets later imports of DOLFINx's wheel find its MPI; others are left alone."""
    library = tmp_path / "lib" / "libmpi.so.12"
    library.parent.mkdir()
    library.touch()
    (tmp_path / "dolfinx_solver").mkdir()
    (tmp_path / "dolfinx_solver" / "__init__.py").touch()
    code = f"import ctypes, sys; sys.prefix = {str(tmp_path)!r}; ctypes.CDLL = print; "
    code += "" if wheel else "sys.modules['dolfinx_solver'] = None; "
    done = subprocess.run(
        [sys.executable, "-c", code + "import vmdg"],
        env=os.environ | {"PYTHONPATH": f"{tmp_path}:{ROOT}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == (str(library) if wheel else "")
