"""What is run, the line of each code in the table, and the environment of the other codes."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from parts.benchmark import peers

import vmdg

#: Of PyPI; with the direct solver that fedoo recommends.
PACKAGES = ("fedoo[solver]==1.1.0", "simcoon==2.2.0", "pypardiso==0.4.7", "akantu==5.0.7.post1")
#: Minor versions of Python 3 for which all of them have wheels.
WHEELS = (12, 11, 10)


def find_python(minors: Sequence[int] = WHEELS) -> str:
    """A Python that all packages have wheels for: this one, one of the PATH, or one of pyenv."""
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
    """The Python of the environment in the user's cache folder, made on the first call."""
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


#: Opening of intrinsic bonds at the strength, half a percent of the critical gap [mm].
OPENING = 1e-4
#: Of forces of other codes, relative to the strength of the bond; that of vmdg is 1e-9.
TOLERANCE = 1e-6
#: Displacement of which the slope is taken, relative to that at the strength if nothing fails.
SMALL = 0.01
#: Seconds after which another code is stopped.
PATIENCE = 1800
STEPS = {"P1": 40, "P2": 20}
COARSE = {
    "P1": replace(peers.P1, divisions=(16, 16)),
    "P2": replace(peers.P2, divisions=(3, 3, 6)),
}


@dataclass(frozen=True)
class Line:
    """What a code gave for a scene."""

    scene: peers.Scene  # P1 or P2
    kinematics: str  # "small" or "finite"
    code: str  # Its name, and the elements
    # Seconds, solves, slope [N/mm] and the curve, displacement [mm] and force [N] (n, 2); or why
    # there is none
    found: dict[str, Any] | str

    def cells(self) -> list[str]:
        """Of the table below ``HEAD``."""
        name = f"{self.scene.name}, {self.kinematics}"
        if isinstance(self.found, str):
            return [name, self.code, self.found, *[""] * (len(HEAD) - 3)]
        u, force = np.vstack([(0.0, 0.0), self.found["curve"]]).T
        work, peak = np.trapezoid(force, u), force.max()
        errors = (self.found["slope"] / self.scene.slope, peak / self.scene.peak)
        return [
            *(name, self.code, f"{self.found['seconds']:.2f}", f"{self.found['solves']}"),
            *(f"{len(u) - 1}", f"{peak:.3f}"),
            *(f"{100 * (e - 1):+.2f} %" for e in (*errors, work / self.scene.work)),
        ]


HEAD = ("scene", "code", "s", "solves", "steps", "peak [N]", "slope", "peak", "work")


def small(scene: peers.Scene) -> float:
    """Displacement of which the slope is taken [mm]."""
    return SMALL * peers.STRENGTH * scene.area / scene.slope


def ours(scene: peers.Scene, kinematics: str, even: bool, repeats: int) -> Line:
    """A scene by vmdg, in steps of equal size or of its own."""
    steps = STEPS[scene.name] if even else 40
    law = vmdg.Debonding(strength=peers.STRENGTH, critical_gap=peers.CRITICAL_GAP)
    problem, top = peers.build(scene, law, kinematics)
    first = vmdg.solve(
        problem, [small(scene)], monitor=lambda problem: {"force": problem.reaction(top)[-1]}
    ).history
    run, seconds = peers.run(scene, steps, even, kinematics, repeats)
    found = {
        "seconds": seconds,
        "solves": run.counts.solves,
        "slope": first["force"][0] / first["load"][0],
        "curve": np.column_stack([run.history["load"], run.history["force"]]).tolist(),
    }
    return Line(scene, kinematics, "vmdg" if even else "vmdg, steps of its own", found)


def theirs(
    scene: peers.Scene,
    kinematics: str,
    name: str,
    options: dict[str, Any],
    repeats: int,
    python: Path,
) -> Line:
    """A scene by another code, in a process of its own on one thread.

    Args:
        name: Of the code and its elements; the first word is that of the module.
        repeats: The least seconds of so many runs.
    """
    material = {"E": 4000.0, "nu": 0.3, "strength": peers.STRENGTH}
    asked = {
        "scene": asdict(scene)
        | material
        | {"critical_gap": peers.CRITICAL_GAP, "area": scene.area},
        **{"steps": STEPS[scene.name], "small": small(scene), "repeats": repeats},
        "options": options | {"tolerance": TOLERANCE},
    }
    threads = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    module = name.split(",")[0].lower()
    script = Path(__file__).with_name(f"run_{module}.py")
    with TemporaryDirectory() as folder:
        files = [Path(folder) / part for part in ("asked.json", "found.json")]
        files[0].write_text(json.dumps(asked))
        command = [str(python), "-E", "-s", "-W", "ignore", str(script), *map(str, files)]
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                env=os.environ | threads,
                capture_output=True,
                text=True,
                timeout=PATIENCE,
                check=False,
            )
        except subprocess.TimeoutExpired:
            return Line(scene, kinematics, name, f"not done in {PATIENCE} s")
        if done.returncode:
            said = (done.stderr.strip() or f"ends with status {done.returncode}").splitlines()[-1]
            return Line(scene, kinematics, name, said.removeprefix("RuntimeError: "))
        return Line(scene, kinematics, name, json.loads(files[1].read_text()))


def cases(
    scenes: Sequence[peers.Scene], repeats: int, python: Path | None
) -> list[Callable[[], Line]]:
    """All runs, those of a scene after each other; without ``python`` those of vmdg only."""
    found: list[Callable[[], Line]] = []
    for scene in scenes:
        for kinematics in ("small", "finite"):
            for even in (True, False):
                found.append(lambda s=scene, k=kinematics, e=even: ours(s, k, e, repeats))
            finite = {"finite": kinematics == "finite"}
            others = {
                "fedoo, intrinsic": {"opening": OPENING} | finite,
                "Akantu, intrinsic": {"opening": OPENING} | finite,
                "Akantu, extrinsic": {"opening": None} | finite,
            }
            if python is not None:
                found += [
                    lambda s=scene, k=kinematics, n=name, o=options: theirs(
                        s, k, n, o, repeats, python
                    )
                    for name, options in others.items()
                ]
    return found
