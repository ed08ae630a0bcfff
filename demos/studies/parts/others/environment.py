"""The environment of the other codes: a Python that they have wheels for, and their packages."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

#: Of PyPI; with the direct solver that fedoo recommends.
PACKAGES = ("fedoo[solver]==1.1.0", "simcoon==2.2.0", "pypardiso==0.4.7", "akantu==5.0.7.post1")
#: Minor versions of Python 3 for which all of them have wheels.
WHEELS = (12, 11, 10)


def find_python(minors: Sequence[int] = WHEELS) -> str:
    """A Python that all packages have wheels for: this one, one of the PATH, or one of pyenv.

    Raises:
        RuntimeError: there is none.
    """
    if sys.version_info.minor in minors:
        return sys.executable
    versions = Path.home() / ".pyenv" / "versions"
    for minor in minors:
        name = f"python3.{minor}"
        found = [shutil.which(name), *map(str, sorted(versions.glob(f"3.{minor}.*/bin/{name}")))]
        if any(found):
            return next(filter(None, found))
    raise RuntimeError(
        f"Akantu has wheels for Python 3.{minors[-1]} to 3.{minors[0]}, and none of them is found: "
        "name one by --python"
    )


def prepare(python: str | None = None) -> Path:
    """The Python of the environment, in the user's cache folder, which is made on the first call.

    Args:
        python: That it is made of; None finds one.

    Raises:
        RuntimeError: there is no such Python, or its packages cannot be installed.
    """
    base = python or find_python()
    if shutil.which(base) is None:
        raise RuntimeError(f"there is no Python {base}: name another one by --python")
    cache = Path.home() / ".cache" / "vmdg"
    key = hashlib.sha256("\n".join([os.path.realpath(base), *PACKAGES]).encode()).hexdigest()
    folder = cache / f"others-{key[:8]}"
    place = folder / "bin" / "python"
    if (folder / "complete").exists():
        return place
    print(f"installing {', '.join(PACKAGES)} in {folder}", flush=True)
    shutil.rmtree(folder, ignore_errors=True)
    pip = [sys.executable, "-m", "pip", "--python", str(place), "install", "-q"]
    for command in (
        [base, "-m", "venv", "--without-pip", str(folder)],
        [*pip, "--no-user", "--only-binary", ":all:", *PACKAGES],
    ):
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            said = (done.stderr.strip() or done.stdout.strip() or "nothing").splitlines()[-1]
            raise RuntimeError(
                f"the other codes cannot be installed for {base}, which needs the network and "
                f"wheels for its version (Python 3.{WHEELS[-1]} to 3.{WHEELS[0]}): {said}"
            )
    (folder / "complete").touch()
    return place
