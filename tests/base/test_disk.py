"""What vmdg did not make is neither deleted nor cut; it writes where it was asked to."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest
from support.problems import pulled

import vmdg

WORDS = "precious"


def on_root(comm, *calls) -> None:
    """Call functions on rank 0, while the others wait."""
    comm.barrier()
    if comm.rank == 0:
        for call in calls:
            call()
    comm.barrier()


def test_folders_of_others(comm, out):
    """Folders of the names that checkpoints use, a link to one, and a file among its own."""
    others = out / "others" / "a"
    on_root(comm, lambda: others.mkdir(parents=True), lambda: (others / "x.npy").write_text(WORDS))
    problem = pulled(comm)
    for call in (
        lambda f: vmdg.discard_checkpoint(comm, f),
        lambda f: vmdg.write_checkpoint(problem, f),
    ):
        with pytest.raises(OSError, match=r"vmdg did not write 'a'|'latest' is missing"):
            call(out / "others")
    assert os.listdir(out / "others") == ["a"]
    folder = out / "own"
    vmdg.write_checkpoint(problem, folder)
    slot = next(path for path in folder.iterdir() if path.is_dir())
    on_root(comm, lambda: (slot / "notes.txt").write_text(WORDS))
    with pytest.raises(OSError, match=r"vmdg did not write '[ab]/notes.txt' in it"):
        vmdg.discard_checkpoint(comm, folder)
    on_root(comm, (slot / "notes.txt").unlink)
    other = folder / ("b" if slot.name == "a" else "a")
    on_root(comm, lambda: other.symlink_to(others))
    with pytest.raises(OSError, match=r"vmdg did not write '[ab]' in it"):
        vmdg.write_checkpoint(problem, folder)
    assert vmdg.read_checkpoint(problem, folder) is not None
    on_root(comm, other.unlink)
    vmdg.discard_checkpoint(comm, folder)
    comm.barrier()
    assert not any(folder.iterdir())
    assert (others / "x.npy").read_text() == WORDS


@pytest.mark.parametrize("name", [".t.csv.lock", "t.csv.partial", "t.csv", "run/checkpoint.lock"])
@pytest.mark.parametrize("link", [True, False])
def test_names_that_are_taken(comm, out, name, link):
    """Links lead nowhere, and files of these names stay."""
    notes, place = out / "notes.txt", out / name
    made = [place.parent.mkdir] if place.parent != out else []
    made.append(lambda: notes.write_text(WORDS))
    made.append(lambda: place.symlink_to(notes) if link else place.write_text(WORDS))
    on_root(comm, *made)
    options = vmdg.SolveOptions(csv=out / "t.csv", checkpoint=out / "run")
    problem = pulled(comm)
    if name.endswith(".lock"):
        with pytest.raises(OSError, match="is a link; remove it" if link else "not a lock of vmdg"):
            vmdg.solve(problem, [1e-3], options)
    else:
        vmdg.solve(problem, [1e-3], options)
    kept = out / "t.1.csv" if name == "t.csv" else place
    comm.barrier()
    assert notes.read_text() == WORDS and kept.read_text() == WORDS
    assert kept.is_symlink() == link


def test_tables_of_earlier_runs_are_kept(comm, out):
    """Each has a number; a run that goes on with its history writes to the same."""
    options = vmdg.SolveOptions(csv=out / "t.csv")
    for load in (1e-3, 2e-3, 3e-3):
        problem = pulled(comm)
        history = vmdg.solve(problem, [load], options).history
    vmdg.solve(problem, [4e-3], options, history=history)
    comm.barrier()
    found = {
        name: vmdg.History.from_csv(out / f"{name}.csv")["load"].tolist()
        for name in ("t", "t.1", "t.2")
    }
    assert found == {"t.1": [1e-3], "t.2": [2e-3], "t": [3e-3, 4e-3]}


@pytest.mark.parametrize("replaced", [False, True])
def test_table_that_disappears(comm, out, replaced):
    """The run ends in the state of the row that is lost."""
    problem, table = pulled(comm), out / "out" / "t.csv"

    def monitor(problem: vmdg.Problem) -> dict:
        if 1.5e-3 < problem.t < 2.5e-3 and comm.rank == 0:
            shutil.rmtree(table.parent)
            if replaced:
                table.parent.mkdir()
                table.write_text(WORDS)
        return {}

    with pytest.raises(OSError, match=r"t\.csv cannot be written: it was removed or replaced"):
        vmdg.solve(problem, [1e-3, 2e-3, 3e-3], vmdg.SolveOptions(csv=table), monitor)
    assert problem.t == 2e-3
    assert not replaced or table.read_text() == WORDS


def test_a_monitor_that_goes_elsewhere(comm, out, monkeypatch):
    """Relative paths are those of the start."""
    (out / "here").mkdir(exist_ok=True)
    comm.barrier()
    monkeypatch.chdir(out / "here")
    options = vmdg.SolveOptions(csv="t.csv", checkpoint="run", checkpoint_every=1)
    problem = pulled(comm)
    with vmdg.FieldWriter(problem, "fields") as fields:

        def monitor(problem: vmdg.Problem) -> dict:
            os.chdir(out)
            fields.write(problem.t)
            return {}

        vmdg.solve(problem, [1e-3, 2e-3], options, monitor)
    comm.barrier()
    assert {path.name for path in Path(out).iterdir()} == {"here"}
    assert {path.name for path in Path(out / "here").iterdir()} == {"t.csv", "run", "fields"}
