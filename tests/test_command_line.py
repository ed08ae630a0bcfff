"""``python -m vmdg``: what is installed, and what the doctor says of good and broken states."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

from mpi4py import MPI

import dolfinx
import pytest

import vmdg
from vmdg import doctor
from vmdg.__main__ import main
from vmdg.doctor import CHECKS, Check, Missing

ROOT = Path(__file__).resolve().parent.parent
NAMES = [check.name for check in CHECKS]


def states(said: str) -> dict[str, str]:
    return dict(re.findall(r"^(\S[\w ]*?) +(ok|FAILED|missing) ", said, re.MULTILINE))


def with_check(name: str, run) -> list[Check]:
    """The checks, one of them replaced."""
    return [check._replace(run=run) if check.name == name else check for check in CHECKS]


def test_help(capsys):
    """The commands, without any of the libraries."""
    for arguments in (["--help"], ["doctor", "--help"], ["--version"]):
        with pytest.raises(SystemExit) as error:
            main(arguments)
        assert error.value.code == 0
    said = capsys.readouterr().out
    for word in ("info", "doctor", "mpirun", f"vmdg {vmdg.__version__}"):
        assert word in said
    assert main([]) == 0
    assert "doctor" in capsys.readouterr().out


SCRIPT = """
import logging, sys, warnings
if "log" in sys.argv:
    logging.basicConfig(stream=sys.stdout, format="logged %(message)s")
import dolfinx.fem
if "before" in sys.argv:
    warnings.warn("first", UserWarning)
import vmdg
vmdg.Problem
warnings.warn("look here", vmdg.ModelWarning)
"""


@pytest.mark.parametrize("ways", [("before",), ("log",)], ids=["before", "log"])
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts a process")
def test_warnings_of_a_script_are_seen(ways):
    """FFCx of DOLFINx 0.9 makes records for a log of them; who asks for a log gets them there."""
    command, environment = (
        [sys.executable, "-c", SCRIPT, *ways],
        os.environ | {"PYTHONPATH": str(ROOT)},
    )
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert "ModelWarning: look here" in done.stderr + done.stdout
    logged = "log" in ways and "logged" in done.stdout
    assert ("ModelWarning" in done.stdout) == logged


@pytest.mark.parametrize(
    "library, name",
    [("libopenblas-r0.so", "openblas"), ("libblas.so.3", "reference"), ("libm.so.6", "unknown")],
)
def test_blas_by_its_libraries(tmp_path, library, name):
    """The lines of /proc/self/maps end with the file that is mapped."""
    maps = tmp_path / "maps"
    maps.write_text(f"7f00-7f01 r-xp 00000000 00:00 1 /usr/lib/{library}\n7f02-7f03 rw-p 0 0 0\n")
    assert doctor.blas(maps) == name
    assert doctor.blas(tmp_path / "none") == "unknown"


def test_info(comm, capsys):
    """A line for every package, PETSc's numbers and solvers, the cache, ranks and threads."""
    assert main(["info"]) == 0
    said = capsys.readouterr().out
    if comm.rank > 0:
        assert said == ""
        return
    lines = dict(re.split(r"  +", line, maxsplit=1) for line in said.splitlines())
    assert {*doctor.REQUIRED, *doctor.OPTIONAL} < set(lines)
    assert lines["vmdg"].startswith(vmdg.__version__)
    assert lines["dolfinx"] == dolfinx.__version__
    assert lines["ranks"] == str(comm.size)
    assert lines["PETSc's numbers"].startswith("float64, int")
    assert "GAMG" in lines["solvers"]
    assert re.fullmatch(r".*\(\d+ compiled\)", lines["kernels"])


def test_info_of_what_is_missing(comm, capsys, monkeypatch):
    """What it disables and how to get it; a missing requirement is an exit code of 1."""
    monkeypatch.setitem(sys.modules, "gmsh", None)
    assert main(["info"]) == 0
    said = capsys.readouterr().out
    if comm.rank == 0:
        assert re.search(r"gmsh +missing: vmdg.meshes and demos .*pip install gmsh", said)
    monkeypatch.setitem(sys.modules, "tqdm", None)
    assert main(["info"]) == 1


def test_doctor(comm, capsys):
    """All checks of this installation are good, on any number of ranks."""
    assert main(["doctor"]) == 0
    said = capsys.readouterr().out
    if comm.rank > 0:
        assert said == ""
        return
    assert list(states(said)) == NAMES
    assert set(states(said).values()) == {"ok"}
    assert re.search(r"kernels .* \d+ compiled \(once\), \d+ found in ", said)
    assert re.search(r"debonding .* 4 steps, \d+ corrections, error \de-\d+", said)
    assert said.endswith("vmdg works here.\n")
    assert "cure" not in said


def test_wrong_numbers_are_found(comm, capsys):
    """A debonding that misses its closed form fails, with both numbers; later checks still run."""
    wrong = partial(doctor.check_debonding, exact=(25.0, 0.05, 0.07))
    assert doctor.doctor(with_check("debonding", wrong)) == 1
    said = capsys.readouterr().out
    if comm.rank == 0:
        assert states(said)["debonding"] == "FAILED"
        assert states(said)["meshes"] == "ok"
        assert re.search(r"traction \S+ MPa and gap \S+ mm, exact are 25 and 0.05", said)
        assert "does not work correctly here" in said


@pytest.mark.parametrize(
    ("version", "message"),
    [("0.8.0", "DOLFINx 0.8.0 is not 0.9 to 0.11"), (None, "dolfinx cannot be imported")],
)
def test_another_dolfinx(comm, version, message):
    """Too old, or broken."""
    with pytest.raises(RuntimeError, match=message):
        doctor.check_packages(comm, find=lambda name: (version, "broken"))


def test_mpirun_of_another_mpi():
    """Processes that do not see each other are told so."""
    with pytest.raises(RuntimeError, match="started 4 processes that do not communicate"):
        doctor.check_ranks(MPI.COMM_SELF, {"PMI_SIZE": "4"})
    assert doctor.check_ranks(MPI.COMM_SELF, {}).startswith("1 of 1 ranks")


def test_failure_on_one_rank(comm, capsys):
    """All ranks know, and rank 0 prints it."""

    def fails(comm: MPI.Comm) -> str:
        if comm.rank == comm.size - 1:
            raise OSError("no such disk")
        return "fine"

    def lacks(comm: MPI.Comm) -> str:
        raise Missing("not installed")

    assert doctor.doctor([Check("disks", fails, "buy one"), Check("tapes", lacks, "buy two")]) == 1
    said = capsys.readouterr().out
    if comm.rank == 0:
        assert states(said) == {"disks": "FAILED", "tapes": "missing"}
        assert "OSError: no such disk" in said
        assert said.index("cure: buy one") < said.index("cure: buy two")
