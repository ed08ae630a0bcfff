"""Scenes do not depend on the number of ranks: the same unknowns, iterations and forces."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from mpi4py import MPI

import pytest
import scaling
from scaling import measure, modelled_ghosts
from support import ranks
from support.budgets import over_budget

ROOT = Path(__file__).resolve().parent.parent
SCENES = ["load cycle", "fibres, on demand", "push-out"]


@pytest.mark.long
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
def test_any_number_of_ranks(tmp_path):
    """Reversals, facets that open on demand, three dimensions, on one rank and on three.

    Steps are solved to 1e-11; scenes of the demos, past the peak of the push-out too, differ by
    3e-12 at most.
    """
    compare(SCENES, (3,), tmp_path)


@pytest.mark.long
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
def test_bodies_meshed_separately(tmp_path):
    """Bonds between curved and straight meshes 2:3, blocks that slide, on one rank and on two."""
    compare(list(ranks.APART), (2,), tmp_path)


@pytest.mark.long
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
def test_bonds_of_plastic_bodies(tmp_path):
    """The same steps while boundaries of grains that flow fail and come off, on one rank and on
    two."""
    compare(list(ranks.FLOWS), (2,), tmp_path)


def compare(scenes: list[str], counts: tuple[int, ...], folder: Path) -> None:
    """Check that scenes give the same on these numbers of ranks as on one."""
    ranks.main(scenes, folder)
    folders = (str(ROOT), os.environ.get("PYTHONPATH", ""))
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(folders)}
    program = [sys.executable, str(ROOT / "tests" / "support" / "ranks.py")]
    for count in counts:
        command = ["mpirun", "-n", str(count), *program, str(folder), *scenes]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
    found = ranks.differences(folder)
    assert len(found) == (1 + len(counts)) * len(scenes)
    assert max(largest for *_, largest in found) < 1e-9, found


def test_scaling(comm, tmp_path_factory):
    """A line a run; the cubes of all ranks are those of one, their ghosts those of the model."""
    folder = comm.bcast(str(tmp_path_factory.mktemp("scaling")))
    for fresh in (True, False):
        rows = scaling.main(cells=4, share=0.1, out=folder, fresh=fresh)
    row, alone = rows[-1], measure(4, MPI.COMM_SELF, share=0.1)
    assert len(rows) == 2
    assert (row.unknowns, row.newton) == (alone.unknowns, alone.newton)
    assert row.force == pytest.approx(alone.force, rel=1e-8)
    assert row.seconds > sum(row.parts.values()) / comm.size
    # Exact where the graph partitioner cuts along planes, as it does for 2 and 4 ranks.
    assert 0.8 * row.model <= row.ghosts <= 1.6 * row.model


def test_apart(comm):
    """The bond is gone in the end, and no attempt has looked for work that is not there."""
    row = measure(3, comm, share=0.1, apart=True)
    assert abs(row.force) < 1e-6
    assert not over_budget("blocks that come apart", solves=row.systems)


def test_modelled_ghosts():
    """Cubes of 4 cells: a cut at the interface of 25 double nodes, then one of 25 in every cube."""
    assert [modelled_ghosts(ranks, 4) for ranks in (1, 2, 4)] == [0, 100, 250]
