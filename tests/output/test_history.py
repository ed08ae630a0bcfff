"""The table of a run: units, CSV and back, and the file that is whole whenever a run is killed."""

from __future__ import annotations

import csv
import resource
import sys
from pathlib import Path

import numpy as np
import pytest
from support.problems import pulled

import vmdg
from vmdg.output.history import HistoryFile

OWN = [
    "step [-]",
    "load [-]",
    "iterations [-]",
    "residual [N]",
    "cuts [-]",
    "jump_steps [-]",
    "krylov [-]",
    "sliding [-]",
]


def lines(comm, path: Path) -> list[list[str]]:
    """Of a CSV file, read on rank 0."""
    text = comm.bcast(path.read_text() if comm.rank == 0 else None)
    return list(csv.reader(text.splitlines()))


def test_units():
    """A name says its unit once; columns go by the name alone, with or without the unit."""
    history = vmdg.History()
    history.append({"force [N]": 1.0, "stage": 2, "ratio [-]": 0.5})
    history.append({"force": 2.0, "a [b] c": 3.0})
    assert history.units == {"force": "N", "ratio": "-"}
    assert history.columns == ["force", "stage", "ratio", "a [b] c"]
    assert history.header == ["force [N]", "stage", "ratio [-]", "a [b] c"]
    assert history["force"].tolist() == history["force [N]"].tolist() == [1.0, 2.0]
    assert history["a [b] c"][1] == 3.0
    with pytest.raises(KeyError, match=r"no column 'gap'; it has \['force', 'stage'"):
        history["gap"]
    with pytest.raises(ValueError, match="'force' is in N so far, now in kN"):
        history.append({"force [kN]": 1.0})
    with pytest.raises(ValueError, match="two values called 'force'"):
        history.append({"force [N]": 1.0, "force": 1.0})
    assert len(history) == 2


def test_csv_and_back(tmp_path):
    """Numbers to the last bit, words with commas, arrays as lists, and what is missing."""
    history = vmdg.History()
    history.append({"step [-]": 1, "x [mm]": 1 / 3, "name": 'a "b", c', "flag": True})
    history.append({"step [-]": 2, "x": np.float64(-np.inf), "v [MPa]": np.array([0.1, np.nan])})
    history.append({"step": np.int64(3), "x": 1e-300, "flag": np.bool_(False)})
    history.to_csv(tmp_path / "history.csv")
    found = vmdg.History.from_csv(tmp_path / "history.csv")
    assert found.units == history.units
    assert found.columns == history.columns
    assert found.rows[0] == history.rows[0]
    assert found.rows[1]["x"] == -np.inf
    assert found.rows[1]["v"][0] == 0.1
    assert np.isnan(found.rows[1]["v"][1])
    assert "name" not in found.rows[1]
    assert found.rows[2] == {"step": 3, "x": 1e-300, "flag": False}
    assert isinstance(found.rows[2]["step"], int)


def test_shown(monkeypatch):
    """In a line, and as a table of few rows in a notebook."""
    history = vmdg.History()
    assert repr(history) == "<History: 0 rows x 0 columns>"
    for step in range(30):
        history.append({"step [-]": step, "force [N]": step / 3, "note": "a<b"})
    size, last = "30 rows x 3 columns", "step=29, force=9.66667, note=a<b"
    assert repr(history) == f"<History: {size}; last row: {last}>"
    table = history._repr_html_()
    assert table.startswith("<table><tr><th>step [-]</th><th>force [N]</th><th>note</th></tr>")
    assert table.count("<tr>") == 1 + 10 + 1 + 10
    assert "<td>29</td><td>9.66667</td><td>a&lt;b</td>" in table
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError, match=r"-m pip install pandas .*; or use to_csv"):
        history.to_pandas()


def test_data_frame():
    """Columns by their names, units beside them; what a row does not have is NaN."""
    pytest.importorskip("pandas")
    history = vmdg.History()
    history.append({"step [-]": 1, "force [N]": 0.5})
    history.append({"step [-]": 2})
    frame = history.to_pandas()
    assert frame["step"].tolist() == [1, 2]
    assert frame["force"].isna().tolist() == [False, True]
    assert frame.attrs["units"] == {"step": "-", "force": "N"}


def test_killed_run_leaves_all_rows(comm, out):
    """A monitor that ends the run after 3 steps: header with units, 3 whole rows, in the file."""
    path, problem = out / "new" / "history.csv", pulled(comm)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        if problem.t > 0.025:
            raise KeyboardInterrupt
        return {"opening [mm]": problem.mean(0).opening[0]}

    loads, history = np.linspace(0.01, 0.03, 3), vmdg.History()
    options = vmdg.SolveOptions(csv=path, control="load")
    vmdg.solve(problem, [0.005], options, lambda problem: {"opening [mm]": 0.0}, history)
    with pytest.raises(KeyboardInterrupt):
        vmdg.solve(problem, loads, options, monitor, history)
    header, *rows = lines(comm, path)
    assert header == [*OWN, "opening [mm]"]
    assert [float(row[1]) for row in rows] == pytest.approx([0.005, 0.01, 0.02])
    assert float(rows[-1][-1]) == history["opening"][-1]
    assert not comm.bcast(list(path.parent.glob("*.partial")))


def test_new_columns_and_rows_that_are_dropped(comm, out):
    """A column that appears later, and a file with rows that the table does not have."""
    path, history = out / "history.csv", vmdg.History()
    with HistoryFile(comm, path, history) as file:
        for row in ({"a": 1}, {"a": 2}, {"a": 3, "b [N]": 4.0}, {"b": 5.0}):
            history.append(row)
            file.update()
            assert len(lines(comm, path)) == len(history) + 1
    comm.barrier()
    assert lines(comm, path) == [["a", "b [N]"], ["1", ""], ["2", ""], ["3", "4.0"], ["", "5.0"]]
    comm.barrier()
    del history.rows[2:]
    with HistoryFile(comm, path, history):
        comm.barrier()
        assert lines(comm, path) == [["a"], ["1"], ["2"]]
        comm.barrier()


def test_resumed_run(comm, out):
    """From a checkpoint the file has the rows of one run, those after the checkpoint once."""
    table, folder = out / "history.csv", out / "checkpoint"
    options = vmdg.SolveOptions(csv=table, checkpoint=folder, checkpoint_every=2, control="load")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        if stop and problem.t > 0.035:
            raise KeyboardInterrupt
        return {"opening [mm]": problem.mean(0).opening[0]}

    stop, loads = True, np.linspace(0.01, 0.05, 5)
    with pytest.raises(KeyboardInterrupt):
        vmdg.solve(pulled(comm), loads, options, monitor)
    assert len(lines(comm, table)) == 1 + 3
    stop, problem = False, pulled(comm)
    history = vmdg.read_checkpoint(problem, folder)
    assert len(history) == 2
    assert history.units["opening"] == "mm"
    vmdg.solve(problem, loads[2:], options, monitor, history)
    header, *rows = lines(comm, table)
    assert header[-1] == "opening [mm]"
    assert [float(row[1]) for row in rows] == pytest.approx(loads)
    assert [float(row[-1]) for row in rows] == history["opening"].tolist()


def test_file_that_cannot_be_written(comm, out):
    """All ranks are told, with the name of the file."""
    if comm.rank == 0:
        (out / "file").write_text("")
    comm.barrier()
    with pytest.raises(OSError, match=r"table .*history\.csv cannot be written"):
        vmdg.solve(pulled(comm), [0.01], vmdg.SolveOptions(csv=out / "file" / "history.csv"))


def test_full_disk_keeps_whole_rows(comm, out):
    """What the disk has no room for is not there in part, and the error says which file."""
    path, history = out / "history.csv", vmdg.History()
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    with HistoryFile(comm, path, history) as file:
        try:
            with pytest.raises(OSError, match=r"table .*history\.csv cannot be written"):
                for step in range(100):
                    history.append({"a": step, "b": 1 / 3})
                    if step == 2:
                        resource.setrlimit(resource.RLIMIT_FSIZE, (200, before[1]))
                    file.update()
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
    header, *rows = lines(comm, path)
    assert header == ["a", "b"]
    assert rows == [[str(step), str(1 / 3)] for step in range(len(history) - 1)]


def test_envelope():
    """Where the load of a path falls, its envelope waits until it comes again."""
    history = vmdg.History()
    for load, force in ((1.0, 3.0), (2.0, 5.0), (1.5, 2.0), (2.0, 2.5), (2.5, 3.0)):
        history.append({"load": load, "force [N]": force})
    envelope = history.envelope()
    assert envelope["load"].tolist() == [1.0, 2.0, 2.5]
    assert envelope["force"].tolist() == [3.0, 5.0, 3.0]
    assert envelope.units == {"force": "N"}
    with pytest.raises(KeyError):
        history.envelope("displacement")


def test_rows_by_number():
    """Rows count as in a list, some of them keep columns and units, and a mistake is named."""
    history = vmdg.History()
    for k in range(4):
        history.append({"load": 0.1 * k, "force [N]": float(k)})
    assert history[-1] == {"load": pytest.approx(0.3), "force": 3.0}
    assert history[np.int64(1)]["force"] == 1.0
    some = history[1:3]
    assert isinstance(some, vmdg.History) and some.header == ["load", "force [N]"]
    assert some["force"].tolist() == [1.0, 2.0]
    history[0]["force"] = 7.0
    assert history["force"][0] == 0.0
    with pytest.raises(IndexError, match="history has 4 rows, and none of number 4"):
        history[4]


def test_names_of_columns():
    """A name is asked for, and columns are gone through, as in a dictionary."""
    history = vmdg.History()
    history.append({"load": 1.0, "force [N]": 2.0})
    assert "force" in history and "force [N]" in history
    assert "gap" not in history and 0 not in history
    assert list(history) == ["load", "force"]
    assert {name: column.tolist() for name, column in dict(history).items()} == {
        "load": [1.0],
        "force": [2.0],
    }
