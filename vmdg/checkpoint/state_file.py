"""Fields and tables in ADIOS2 files that any number of ranks reads.

Displacement fields are adios4dolfinx's: values cell by cell in the order of the input mesh. It
cannot store what lives on the facets of interfaces: a facet submesh has no
``original_cell_index`` to write in the order of ("Mixed topology unsupported"), and
adios4dolfinx takes the dofs of a cell for ordered by its nodes, which quadrature points on a
submesh are not between partitions. These rows are written as ADIOS2 arrays, every rank its block,
with their keys.
"""

from __future__ import annotations

import os
from pathlib import Path
from types import ModuleType
from typing import Any

from mpi4py import MPI

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..base.parallel import raise_together

ENGINE = "BP4"

Table = tuple[NDArray[np.int64], NDArray[np.float64]]


def adios() -> tuple[ModuleType, Any]:
    """adios4dolfinx, and the classes of ADIOS2 that it works with.

    Raises:
        ImportError: they are not installed, or not built for MPI.
    """
    # Debian has a serial build beside that with MPI and chooses when it is imported.
    os.environ.setdefault("ADIOS2_ALWAYS_USE_MPI", "1")
    try:
        import adios2
        import adios4dolfinx
    except ImportError as error:
        raise ImportError(
            f"checkpoints need adios4dolfinx and ADIOS2 with MPI ({error}); install "
            "python3-adios4dolfinx (Debian) or adios4dolfinx (conda-forge), in the version of your "
            "DOLFINx, or run without checkpoints (checkpoint=None, demos: --checkpoint-every 0)"
        ) from error
    return adios4dolfinx, getattr(adios2, "bindings", adios2)


def write_fields(path: Path, fields: dict[str, fem.Function]) -> None:
    """Write functions of one mesh by name; collective."""
    adios4dolfinx, adios2 = adios()
    mode = adios2.Mode.Write
    for name, function in fields.items():
        adios4dolfinx.write_function_on_input_mesh(path, function, ENGINE, mode, name=name)
        mode = adios2.Mode.Append


def read_field(path: Path, name: str, function: fem.Function) -> None:
    """Read into a function of the same element on the same input mesh; collective."""
    adios4dolfinx, _ = adios()
    adios4dolfinx.read_function(path, function, ENGINE, name=name)
    function.x.scatter_forward()


def write_tables(comm: MPI.Comm, path: Path, tables: dict[str, Table]) -> None:
    """Write tables by name, every rank its keys (n,) and rows (n, width); collective."""
    _, adios2 = adios()
    file, io, close = _open(comm, path, adios2, adios2.Mode.Write)
    try:
        file.BeginStep()
        for name, (keys, rows) in tables.items():
            total, start = comm.allreduce(len(keys)), comm.scan(len(keys)) - len(keys)
            for what, values in (("keys", keys[:, None]), ("rows", rows)):
                values = np.ascontiguousarray(values)
                width = values.shape[1]
                place = [total, width], [start, 0], [len(values), width]
                variable = io.DefineVariable(f"{name}_{what}", values, *place)
                file.Put(variable, values, adios2.Mode.Sync)
        file.EndStep()
    finally:
        close()


def read_tables(comm: MPI.Comm, path: Path, names: list[str]) -> dict[str, Table]:
    """Read an even share of the rows of every table; collective.

    Raises:
        ValueError: a table is missing.
    """
    _, adios2 = adios()
    file, io, close = _open(comm, path, adios2, adios2.Mode.Read)
    tables, message = {}, None
    try:
        file.BeginStep()
        for name in names:
            arrays = []
            for what, kind in (("keys", np.int64), ("rows", np.float64)):
                variable = io.InquireVariable(f"{name}_{what}")
                if variable is None:
                    message = f"{path} has no {name}: the checkpoint is damaged; remove its folder"
                    continue
                total, width = variable.Shape()
                start, end = (total * rank // comm.size for rank in (comm.rank, comm.rank + 1))
                values = np.empty((end - start, width), dtype=kind)
                if values.size:
                    variable.SetSelection([[start, 0], [end - start, width]])
                    file.Get(variable, values, adios2.Mode.Sync)
                arrays.append(values)
            if len(arrays) == 2:
                tables[name] = arrays[0][:, 0], arrays[1]
        file.EndStep()
    finally:
        close()
    raise_together(comm, message)
    return tables


def _open(comm: MPI.Comm, path: Path, adios2: Any, mode: Any):
    """Engine, io and what closes them."""
    library = adios2.ADIOS(comm)
    io = library.DeclareIO("tables")
    io.SetEngine(ENGINE)
    file = io.Open(str(path), mode)

    def close() -> None:
        file.Close()
        library.RemoveIO("tables")

    return file, io, close
