"""Time series of .vtu files, which meshio writes."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from dolfinx import fem
from dolfinx.plot import vtk_mesh
from numpy.typing import NDArray

from ..base.disk import replacing
from ..base.words import pip_install

#: Names of meshio for cells of degree 1 and 2.
_CELLS = {
    "interval": ("line", "line3"),
    "triangle": ("triangle", "triangle6"),
    "quadrilateral": ("quad", "quad9"),
    "tetrahedron": ("tetra", "tetra10"),
    "hexahedron": ("hexahedron", "hexahedron27"),
}


def check_meshio() -> None:
    if find_spec("meshio") is None:
        raise ImportError(
            f"FieldWriter: format='vtu' needs meshio: {pip_install('meshio')}; format='bp' does not"
        )


class Series:
    """A folder with a .vtu file for every time and rank, and a .pvd file that lists them, complete
    after every time. Cells have points of their own.

    Args:
        functions: Discontinuous functions on one mesh; shown with degree 2 at most.
    """

    def __init__(self, folder: Path, functions: list[fem.Function], titles: list[str]):
        mesh = functions[0].function_space.mesh
        degree = min(2, max(one.function_space.ufl_element().degree for one in functions))
        self._given, self._folder, self._comm = functions, folder, mesh.comm
        self._titles = titles
        self._times: list[float] = []
        spaces = [
            fem.functionspace(mesh, ("DG", degree, one.function_space.value_shape))
            for one in functions
        ]
        self._shown = list(map(fem.Function, spaces))
        self._nodes = list(map(_nodes, spaces))
        self._points = spaces[0].tabulate_dof_coordinates()[self._nodes[0].ravel()]
        count = self._nodes[0].shape[0]
        self._cells = np.arange(self._nodes[0].size).reshape(self._nodes[0].shape)
        self._kind = _CELLS[mesh.basix_cell().name][degree - 1]
        self._writing = [rank for rank, some in enumerate(self._comm.allgather(count > 0)) if some]
        if self._comm.rank == 0:
            folder.mkdir()

    def write(self, t: float) -> None:
        """Write the functions as they are; an error is this rank's."""
        number, name = len(self._times), self._folder.name
        if self._comm.rank in self._writing:
            import meshio

            data = dict(zip(self._titles, map(self._values, range(len(self._given))), strict=True))
            cells = [(self._kind, self._cells)]
            mesh = meshio.Mesh(self._points, cells, point_data=data)
            mesh.write(self._folder / self._file(number, self._comm.rank))
        self._times.append(t)
        if self._comm.rank == 0:
            with replacing(self._folder / f"{name}.pvd") as file:
                file.write(self._collection().encode())

    def _values(self, i: int) -> NDArray[np.float64]:
        """At the points; vectors and tensors have three components a row, as ParaView wants."""
        shown, V = self._shown[i], self._shown[i].function_space
        shown.interpolate(self._given[i])
        values = shown.x.array.reshape(-1, *V.value_shape)[self._nodes[i].ravel()]
        missing = [(0, 0), *((0, 3 - n) for n in V.value_shape)]
        return np.pad(values, missing).reshape(len(values), -1).squeeze()

    def _file(self, number: int, rank: int) -> str:
        part = f"_{rank}" if self._comm.size > 1 else ""
        return f"{self._folder.name}_{number:06}{part}.vtu"

    def _collection(self) -> str:
        rows = [
            f'<DataSet timestep="{t:.17g}" part="{part}" file="{self._file(number, rank)}"/>'
            for number, t in enumerate(self._times)
            for part, rank in enumerate(self._writing)
        ]
        head = [
            '<?xml version="1.0"?>',
            '<VTKFile type="Collection" version="0.1">',
            "<Collection>",
        ]
        return "\n".join([*head, *rows, "</Collection>", "</VTKFile>", ""])

    def close(self) -> None:
        """Nothing is left to write."""


def _nodes(space: fem.FunctionSpace) -> NDArray[np.int32]:
    """Nodes of this rank's cells in the order of VTK."""
    count = space.mesh.topology.index_map(space.mesh.topology.dim).size_local
    each = space.dofmap.dof_layout.num_dofs
    return vtk_mesh(space)[0].reshape(count, each + 1)[:, 1:]
