"""The script that finds or builds an environment: DOLFINx from wheels, in a virtual environment."""

from __future__ import annotations

import hashlib
import json
import os
import re
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from mpi4py import MPI

import pytest

ROOT = Path(__file__).resolve().parent.parent
pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes")

#: A machine that the wheels fit, whatever this one is.
FITS = """
import os, platform, sys, sysconfig
sys.version_info, sys.platform = (3, 12, 3), "linux"
platform.machine = lambda: "x86_64"
os.confstr = lambda name: "glibc 2.39"
sysconfig.get_path = lambda name: os.environ["HEADERS"]
sysconfig.get_config_var = lambda name: {"CC": "sh -c"}.get(name)
"""

#: Stands for the installation: an environment whose Python says what it was started with.
STUB = r"""
check_disk() { :; }
fill_venv() {
    mkdir -p "$1/bin"
    printf '#!/bin/sh\nenv; echo "arguments: $*"\n' >"$1/bin/python3"
    printf '#!/bin/sh\necho "mpirun: $1 $2"; shift 2; exec "$@"\n' >"$1/bin/mpirun"
    chmod +x "$1"/bin/*
    echo filled >>"$vmdg_cache/filled"
}
"""


class Machine:
    """A user's machine: its cache folder, and a python3 of which the script believes a lot."""

    def __init__(self, folder: Path):
        self.folder, self.cache = folder, folder / "cache" / "vmdg"
        for name in ("bin", "include"):
            (folder / name).mkdir()
        (folder / "include" / "Python.h").touch()
        self.believes(FITS)

    def believes(self, code: str) -> None:
        """Let python3 run this before what it reads."""
        (self.folder / "before.py").write_text(code)
        first = f"exec(open({str(self.folder / 'before.py')!r}).read())"
        python = self.folder / "bin" / "python3"
        python.write_text(
            f'#!/bin/sh\n[ "$1" = - ] || exec {sys.executable} "$@"\n'
            f'exec {sys.executable} -c "{first}\nexec(sys.stdin.read())"\n'
        )
        python.chmod(0o755)

    def run(self, code: str, **variables: str) -> subprocess.CompletedProcess[str]:
        """Run bash after the script has been read."""
        environment = {k: v for k, v in os.environ.items() if k not in ("CC", "VMDG_JIT_CACHE")}
        environment |= {
            "XDG_CACHE_HOME": str(self.cache.parent),
            "PATH": f"{self.folder / 'bin'}:{os.environ['PATH']}",
            "HEADERS": str(self.folder / "include"),
        }
        script = f"set -euo pipefail; . {ROOT / '.ci' / 'environment'}; {STUB}\n{code}"
        return subprocess.run(
            ["bash", "-c", script],
            env=environment | variables,
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture
def machine(tmp_path) -> Machine:
    """One with nothing in its cache."""
    return Machine(tmp_path)


@pytest.mark.parametrize(
    ("believes", "variables", "message"),
    [
        ("platform.machine = lambda: 'aarch64'", {}, "for x86_64, and this machine is aarch64"),
        ("os.confstr = lambda name: 'glibc 2.31'", {}, "this system has glibc 2.31"),
        ("os.confstr = lambda name: None", {}, "this system has none 0"),
        ("sysconfig.get_config_var = lambda name: 1", {}, "free-threaded"),
        ("", {"CC": "no-such-cc -O"}, "compiler 'no-such-cc -O' is missing"),
        ("", {"HEADERS": "/nowhere"}, "there is no Python.h"),
    ],
)
def test_wheels_that_do_not_fit(machine, believes, variables, message):
    """The reason is said, nothing is installed, and the script may try its next way."""
    machine.believes(FITS + believes)
    done = machine.run("use_wheels && exit 7; echo next", **variables)
    assert done.stdout == "next\n"
    assert message in done.stderr
    assert not machine.cache.exists()


def test_older_python(machine):
    """Where python3 is older than 3.12 there is nothing to say: Debian 12 has its private tree."""
    machine.believes(FITS + "sys.version_info = (3, 11, 2)")
    done = machine.run("use_wheels && exit 7; echo next")
    assert (done.stdout, done.stderr) == ("next\n", "")


def test_private_tree_that_is_there(machine):
    """It is kept, and nothing is installed."""
    done = machine.run('mkdir -p "$vmdg_cache/$(tree_name)"; use_wheels && exit 7; echo next')
    assert (done.stdout, done.stderr) == ("next\n", "")


def test_wheels_once(machine):
    """Installed by the first call, found by the second; with its own python3."""
    for _ in range(2):
        done = machine.run('use_wheels; echo "$vmdg_python"')
        assert done.returncode == 0, done.stderr
        python = Path(done.stdout.strip())
        assert python.is_file() and python.is_relative_to(machine.cache)
    assert (machine.cache / "filled").read_text() == "filled\n"


def test_interrupted_installation(machine):
    """A folder that was not completed is filled again."""
    machine.run('mkdir -p "$vmdg_cache/$(wheels_name)"')
    assert machine.run("use_wheels").returncode == 0
    assert (machine.cache / "filled").is_file()


def test_failed_installation(machine):
    """The end of its log, no folder left, and the next way."""
    fails = "fill_venv() { mkdir -p $1; echo no network; return 1; }; use_wheels && exit 7; "
    done = machine.run(fails + 'echo "next<$vmdg_venv$vmdg_python$vmdg_prefix>"')
    assert done.stdout == "next<>\n"
    assert "no network" in done.stderr and "could not be installed" in done.stderr
    assert "libglu1-mesa" in done.stderr
    assert not [path for path in machine.cache.glob("wheels-*") if path.is_dir()]


def test_old_environments(machine):
    """One in use is left, others go with their kernels."""
    code = """
        mkdir -p "$vmdg_cache"/{wheels-00000000,wheels-11111111,jit-wheels-00000000-ab}
        exec 8>"$vmdg_cache/wheels-11111111.lock"; flock -s 8
        use_wheels; echo "${vmdg_venv##*/}"
    """
    done = machine.run(code)
    left = {path.name for path in machine.cache.glob("*wheels-*") if path.is_dir()}
    assert left == {"wheels-11111111", done.stdout.strip()}


def test_run_in_wheels(machine):
    """Its MPI for the loader, its mpirun, no modules of the machine, kernels of its own."""
    code = "vmdg_ranks=3; use_wheels; vmdg_execute -- -m thing"
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


class Index(BaseHTTPRequestHandler):
    """An index of packages with three versions of pip."""

    def do_GET(self) -> None:
        """The list of files, or one of them."""
        name = self.path.rpartition("/")[2]
        body = name.encode()
        if self.path == "/simple/pip/":
            names = [f"pip-{version}-py3-none-any.whl" for version in ("9.1", "26.10", "27.0b1")]
            good = "" if self.server.honest else "0"
            files = [
                {
                    "filename": name,
                    "url": f"../../files/{name}",
                    "hashes": {"sha256": good + hashlib.sha256(name.encode()).hexdigest()},
                }
                for name in names
            ]
            body = json.dumps({"files": files}).encode()
        self.send_response(200)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, *_: object) -> None:
        """Nothing."""


@pytest.mark.parametrize("honest", [True, False])
def test_pip_from_the_index(machine, honest):
    """The newest release, and only if it is what the index says."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), Index)
    server.honest = honest
    threading.Thread(target=server.serve_forever, daemon=True).start()
    index = f"http://127.0.0.1:{server.server_port}/simple"
    try:
        bin = machine.folder / "v" / "bin"
        code = f"mkdir -p {bin}; ln -s {sys.executable} {bin}/python3; fetch_pip {bin.parent}"
        done = machine.run(code, PIP_INDEX_URL=index, no_proxy="*")
    finally:
        server.shutdown()
        server.server_close()
    path = machine.folder / "v" / "pip-26.10-py3-none-any.whl"
    assert path.is_file() == honest
    if honest:
        assert done.stdout.strip() == str(path)
    else:
        assert done.returncode == 1
        assert "is not what the index says" in done.stderr


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


def test_process_that_dies(tmp_path):
    """``tests/run -j`` ends where a process ends in a test, fails, and names the test once."""
    (tmp_path / "test_dies.py").write_text("import os\n\ndef test_dies():\n    os._exit(0)\n")
    (tmp_path / "test_lives.py").write_text("def test_lives():\n    pass\n")
    own = {"VMDG_PYTHON": sys.executable, "XDG_CACHE_HOME": str(tmp_path)}
    done = subprocess.run(
        ["bash", str(ROOT / "tests" / "run"), "-j", "2", str(tmp_path)],
        env=os.environ | own,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    assert len(re.findall("crashed while running '.*test_dies.py::test_dies'", done.stdout)) == 1


def test_ranks_after_arguments_of_pytest():
    """``tests/run -q -n 2`` would share a serial suite between two processes, on one rank each."""
    own = {"VMDG_PYTHON": sys.executable}
    done = subprocess.run(
        ["bash", str(ROOT / "tests" / "run"), "-q", "-n", "2"],
        env=os.environ | own,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode != 0
    assert "-n comes before the arguments of pytest" in done.stderr
