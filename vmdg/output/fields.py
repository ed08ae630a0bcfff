"""Fields for ParaView."""

from __future__ import annotations

import ctypes
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from itertools import count
from numbers import Real
from pathlib import Path

import numpy as np
from dolfinx import fem
from dolfinx.io import VTXWriter
from numpy.typing import NDArray

from .. import compat
from ..base.agreement import together
from ..base.claims import Claim
from ..base.parallel import global_sum
from ..interface.interface import Which, interface_names, number_of
from ..problem.problem import Problem
from .cell import whole_displacement
from .corners import corners_of_local, positions_and_displacements
from .values import VECTORS, facet_scalar

#: Fields of the bodies, and of the interfaces.
DISPLACEMENT, STRESS = "displacement", "stress"
INTERFACE_FIELDS = (DISPLACEMENT, *VECTORS, "slip", "damage", "mode", "fine_scale")
#: Room on the disk that is left before fields are written, relative to their size.
ROOM = 2.0

FIELDS = tuple(dict.fromkeys((DISPLACEMENT, STRESS, *INTERFACE_FIELDS)))


def discontinuous(problem: Problem) -> fem.Function:
    """A displacement cell by cell, in a space that stays when facets open on demand."""
    degree, shape = problem.space.ufl_element().degree, (problem.mesh.geometry.dim,)
    return fem.Function(fem.functionspace(problem.mesh, ("DG", degree, shape)), name=DISPLACEMENT)


def copy_displacement(problem: Problem, function: fem.Function) -> None:
    """Set a function of :func:`discontinuous` to the current displacement."""
    u, d = whole_displacement(problem), problem.mesh.geometry.dim
    mine, theirs = function.function_space.dofmap.list, u.function_space.dofmap.list
    function.x.array.reshape(-1, d)[mine] = u.x.array.reshape(-1, d)[theirs]


class InterfaceFields:
    """An interface's state as fields on a mesh of all its facets, one value a facet.

    Scalars are those of :func:`vmdg.output.values.facet_scalar`, vectors facet means. Facets
    that have not been opened show zeros. The displacement is that of side 1, at the corners, so
    that the interface can be warped with the bodies.

    Args:
        problem: The problem.
        interface: Its number, its name or itself.
        names: Of :data:`INTERFACE_FIELDS`.

    Attributes:
        functions: The fields, by name.
        cell_of_facet: Cell of their mesh for every facet of the interface (nf,).
    """

    def __init__(self, problem: Problem, interface: Which, names: Sequence[str]):
        self._problem, self._i = problem, number_of(problem.interfaces, interface)
        self._facets = problem.step.activation.facets[interface]
        submesh = compat.facet_submesh(problem.mesh, self._facets.facets)
        self._mesh = submesh.mesh
        self.cell_of_facet = np.argsort(submesh.facets[: len(self._facets.facets)])
        vector = fem.functionspace(self._mesh, ("DG", 1, (problem.mesh.geometry.dim,)))
        scalar = fem.functionspace(self._mesh, ("DG", 1))
        self.functions = {
            name: fem.Function(vector if name in (DISPLACEMENT, *VECTORS) else scalar, name=name)
            for name in names
        }

    def update(self) -> None:
        """Take the values of the current state."""
        active = self._problem.discretization.active.get(self._i)
        for name, function in self.functions.items():
            if name == DISPLACEMENT:
                self._set(function, self.cell_of_facet, self._displacement())
            elif active is not None:
                position = np.searchsorted(self._facets.facets, active.facets.facets)
                values = self._facet_values(name)
                self._set(function, self.cell_of_facet[position], values[:, None])

    def _facet_values(self, name: str) -> NDArray[np.float64]:
        """Of the open facets, (nf,) or (nf, d)."""
        if name not in VECTORS:
            return facet_scalar(self._problem, self._i, name)
        quadrature = self._problem.discretization.active[self._i].quadrature
        return quadrature.facet_means(getattr(self._problem.state[self._i], name))

    def _displacement(self) -> NDArray[np.float64]:
        """Of side 1 at the corners of all facets, in the order of their cells (nf, corners, d)."""
        mesh = self._problem.mesh
        cells, local = self._facets.cells[:, 0], self._facets.local[:, 0]
        corners = corners_of_local(mesh, local)
        X, u = positions_and_displacements(self._problem, cells, corners)
        nodes = compat.geometry_dofmap(self._mesh)[self.cell_of_facet][:, : corners.shape[1]]
        apart = np.linalg.norm(self._mesh.geometry.x[nodes][:, :, None] - X[:, None], axis=-1)
        return np.take_along_axis(u, apart.argmin(axis=2)[:, :, None], axis=1)

    @staticmethod
    def _set(function: fem.Function, cells: NDArray[np.intp], values: NDArray) -> None:
        """Write values (n, corners or 1, ...) at the corners of cells."""
        bs = function.function_space.dofmap.index_map_bs
        dofs = function.function_space.dofmap.list[cells]
        function.x.array.reshape(-1, bs)[dofs] = values.reshape(*values.shape[:2], bs)
        function.x.scatter_forward()


def _writer(file: Path, functions: list[fem.Function]) -> VTXWriter:
    """Of the engine BP4: where a disk gets full it raises an error on the rank that writes, with
    which the job ends; with BP5, the default, all ranks wait for ever."""
    return VTXWriter(functions[0].function_space.mesh.comm, file, functions, "BP4")


class FieldWriter:
    """Writes fields of the bodies and of the interfaces as VTX (.bp) time series for ParaView.

    Open bodies.bp and the files of the interfaces together and warp all by the displacement. Use as
    a context manager. Nothing is evaluated for fields that are not asked for. Files of an earlier
    run, of one that goes on for example, stay: bodies.bp becomes bodies.1.bp, and so on. One run at
    a time writes to a folder.

    Args:
        problem: The problem.
        folder: Made if missing; holds bodies.bp and a file named as each interface, such as
            bond.bp, or interface_0.bp where it has no name.
        fields: Names of what to write, or one name; None for all. Of the bodies: "displacement"
            [mm] and "stress" [MPa]; of the interfaces: "traction" [MPa], "opening" and "gap" [mm],
            which are vectors, "slip" [mm], "damage" [-], "mode" and "fine_scale" [mm], see
            :func:`vmdg.output.values.scalar`. The interfaces have the displacement too, where it
            is chosen.

    Raises:
        ValueError: an unknown name, or none.
        TypeError: the problem is none.
        OSError: the folder cannot be written to, or another run does so; on all ranks.

    Where a disk gets full in the middle of writing on several ranks, the job ends.
    """

    def __init__(
        self, problem: Problem, folder: str | Path, fields: Sequence[str] | str | None = None
    ):
        if not isinstance(problem, Problem):
            raise TypeError(
                f"FieldWriter: problem = {problem!r} must be a vmdg.Problem, and the folder comes "
                "after it"
            )
        fields = (fields,) if isinstance(fields, str) else fields
        names = FIELDS if fields is None else tuple(dict.fromkeys(fields))
        for name in names:
            if name not in FIELDS:
                raise ValueError(f"FieldWriter: there is no field {name!r}; choose from {FIELDS}")
        if not names:
            raise ValueError(f"FieldWriter: fields is empty; choose from {FIELDS}, None for all")
        self._comm, self._folder = problem.comm, Path(folder)
        self._updates: list[Callable[[], object]] = []
        files: dict[str, list[fem.Function]] = {"bodies": []}
        if DISPLACEMENT in names:
            displacement = discontinuous(problem)
            self._updates.append(partial(copy_displacement, problem, displacement))
            files["bodies"].append(displacement)
        if STRESS in names:
            self._updates.append(problem.stress)
            files["bodies"].append(problem.stress())
        chosen = [name for name in names if name in INTERFACE_FIELDS]
        if set(chosen) - {DISPLACEMENT}:
            for name in interface_names(problem.interfaces):
                interface = InterfaceFields(problem, name, chosen)
                self._updates.append(interface.update)
                files[name] = list(interface.functions.values())
        self._files = [self._folder / f"{name}.bp" for name in files if files[name]]
        written = [functions for functions in files.values() if functions]
        local = sum(function.x.array.nbytes for part in written for function in part)
        self._bytes = float(global_sum(self._comm, local))
        self._claim = Claim(self._comm, self._folder / "fields.lock", f"fields in {folder}")
        self._writers: list[VTXWriter] = []
        self._do(self._keep_earlier_files)
        self._do(lambda: self._writers.extend(map(_writer, self._files, written)))

    def _keep_earlier_files(self) -> None:
        """Give those of an earlier run the first number that is free."""
        if self._comm.rank > 0:
            return
        for file in filter(Path.exists, self._files):
            names = (file.with_name(f"{file.stem}.{number}{file.suffix}") for number in count(1))
            file.rename(next(name for name in names if not name.exists()))

    def write(self, t: float) -> None:
        """Write the current state as time ``t``; collective.

        Raises:
            ValueError: the files are closed, or the time is no finite number.
            OSError: the disk is full, or files are gone; on all ranks. The files are closed then.
        """
        if not (isinstance(t, Real) and np.isfinite(t)):
            raise ValueError(
                f"FieldWriter: t = {t!r} must be a finite number, for example problem.t"
            )
        if not self._writers:
            raise ValueError(
                f"FieldWriter: the files in {self._folder} are closed; write before close() and "
                "the end of `with`, or make another FieldWriter, which keeps them"
            )
        for update in self._updates:
            update()
        self._do(self._check_files)
        if self._comm.bcast(self._comm.rank == 0 and self._full()):
            self.close()
            raise OSError(
                self._complaint(f"they take {self._bytes / 1e6:.3g} MB, the disk is full")
            )
        self._do(lambda: [writer.write(t) for writer in self._writers])

    def _check_files(self) -> None:
        """Raises:
        OSError: one was removed.
        """
        gone = [file.name for file in self._files if self._comm.rank == 0 and not file.exists()]
        if gone:
            raise OSError(f"{gone[0]} was removed")

    def _full(self) -> bool:
        """Asked before ranks wait for each other in what writes."""
        return shutil.disk_usage(self._folder).free < ROOM * self._bytes

    def _complaint(self, why: object) -> str:
        return (
            f"fields in {self._folder} cannot be written: {why}. Make room or name a folder that "
            "can be written to"
        )

    def _do(self, action: Callable[[], object]) -> None:
        """What may fail on any rank; the files are given up where it does; collective."""
        try:
            together(self._comm, action)
        except (OSError, RuntimeError) as error:
            self._give_up()
            raise OSError(self._complaint(error)) from error

    def _give_up(self) -> None:
        """Leave the files as they are: closing them would end the process if it failed."""
        for writer in self._writers:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer))
        self._writers = []
        self._claim.release()

    def close(self) -> None:
        """Complete the files; collective, and a second time without effect.

        Raises:
            OSError: they cannot be completed; on all ranks.
        """
        if self._writers:
            self._do(self._check_files)
            self._do(lambda: [writer.close() for writer in self._writers])
        self._writers = []
        self._claim.release()

    def __enter__(self) -> FieldWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
