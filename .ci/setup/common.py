"""What the modules of this folder share: messages, the cache folder, locks, logs, variables."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from fcntl import LOCK_EX, LOCK_NB, flock
from pathlib import Path
from typing import NoReturn, TextIO

ROOT = Path(__file__).resolve().parents[2]
CACHE = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").absolute() / "vmdg"
#: What a Python must offer in addition to DOLFINx, and what tests/run needs as well.
MODULES = ("gmsh", "scipy", "matplotlib", "tqdm")
TEST_MODULES = ("adios2", "meshio", "h5py", "pytest", "xdist", "hypothesis")
#: A batch system knows better which network MPI may use.
ON_BATCH_SYSTEM = any(map(os.environ.get, ("SLURM_JOB_ID", "PBS_JOBID", "LSB_JOBID")))
PYTHON_VARIABLES = ("PYTHONHOME", "PYTHONPATH", "PYTHONSTARTUP", "PYTHONUSERBASE")


def say(*lines: str) -> None:
    """Messages to the user."""
    for line in lines:
        print("vmdg:", line, file=sys.stderr)


def die(*lines: str) -> NoReturn:
    """Messages, and the end with exit code 1."""
    say(*lines)
    sys.exit(1)


def agree(*lines: str) -> None:
    """Messages on what root is about to install; the end if a user at a terminal says no.

    With --yes, in continuous integration (CI) and without a terminal no question is asked.
    """
    say(*lines)
    if os.environ.get("VMDG_YES") or os.environ.get("CI") or not sys.stdin.isatty():
        return
    print("vmdg: continue? [Y/n] ", end="", file=sys.stderr, flush=True)
    if sys.stdin.readline().strip().lower() not in ("", "y", "yes"):
        die("nothing was installed")


def is_supported(version: str) -> bool:
    """Whether vmdg knows this version of DOLFINx."""
    return (0, 9) <= tuple(int(part) for part in version.split(".")[:2]) < (0, 12)


def short_hash(*parts: object, length: int = 8) -> str:
    """Part of a name that changes with what is given."""
    return hashlib.sha256((" ".join(map(str, parts)) + "\n").encode()).hexdigest()[:length]


def run(command: list[str], **options) -> subprocess.CompletedProcess:
    """Run a command without input."""
    # Children inherit locks: as long as any part of a killed build is alive, no other one starts.
    return subprocess.run(command, stdin=subprocess.DEVNULL, close_fds=False, **options)


def output(*command: str) -> str:
    """What a command prints, untranslated; nothing if it fails or is missing."""
    try:
        done = run([*command], capture_output=True, text=True, env={**os.environ, "LC_ALL": "C"})
    except OSError:
        return ""
    return done.stdout if done.returncode == 0 else ""


def logged(name: str, command: list[str], variables: dict[str, str] | None = None) -> bool:
    """Run a command with its output in a file of the cache; if it fails, the end is shown."""
    CACHE.mkdir(parents=True, exist_ok=True)
    with open(CACHE / name, "wb") as log:
        done = run(command, stdout=log, stderr=log, env=variables)
    if done.returncode != 0:
        lines = (CACHE / name).read_text(errors="replace").splitlines()
        print(*lines[-25:], sep="\n", file=sys.stderr)
        say(f"the whole log: {CACHE / name}")
    return done.returncode == 0


def lock(path: str | Path, how: int) -> TextIO:
    """A file that is locked until it is closed, by this process and by those that inherit it."""
    file = open(path, "a")
    os.set_inheritable(file.fileno(), True)
    flock(file, how)
    return file


def build_lock() -> TextIO:
    """One build at a time in the cache folder."""
    CACHE.mkdir(parents=True, exist_ok=True)
    try:
        return lock(CACHE / "build.lock", LOCK_EX | LOCK_NB)
    except BlockingIOError:
        say(f"waiting for another build in {CACHE}")
    return lock(CACHE / "build.lock", LOCK_EX)


def remove_old(kind: str, kept: Path, remove: Callable[[Path], None]) -> None:
    """Remove other environments of a kind, unless in use. Only called under the build lock."""
    for folder in {*CACHE.glob(f"{kind}-????????")} - {kept}:
        with suppress(BlockingIOError), lock(f"{folder}.lock", LOCK_EX | LOCK_NB):
            remove(folder)
            for path in (*CACHE.glob(f"jit-{folder.name}*"), *CACHE.glob(f"{folder.name}.*")):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def default(name: str, value: str) -> None:
    """Set a variable of the environment that the user has not set."""
    os.environ[name] = os.environ.get(name) or value


def before(folder: str | Path, others: str | None) -> str:
    """A search path with a folder before others."""
    return f"{folder}:{others}" if others else str(folder)
