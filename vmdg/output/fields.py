"""Fields for ParaView."""

from __future__ import annotations

import ctypes
import os
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from numbers import Real
from pathlib import Path
from typing import Protocol

import numpy as np
from dolfinx import fem
from dolfinx.io import VTXWriter
from numpy.typing import NDArray

from .. import compat
from ..base.agreement import same_arguments, together
from ..base.claims import Claim
from ..base.disk import put_aside
from ..base.parallel import global_sum
from ..base.words import checked_path
from ..points.interface import Which, interface_names, number_of
from ..problem.problem import Problem
from .cell import whole_displacement
from .corners import corners_of_local, positions_and_displacements
from .values import VECTORS, facet_means, facet_scalar, open_facets
from .vtu import Series, check_meshio

#: Fields of the bodies, and of the interfaces.
DISPLACEMENT, STRESS, DAMAGE = "displacement", "stress", "damage"
INTERFACE_FIELDS = (DISPLACEMENT, *VECTORS, "slip", DAMAGE, "mode", "fine_scale")

FIELDS = tuple(dict.fromkeys((DISPLACEMENT, STRESS, *INTERFACE_FIELDS)))

UNITS = {
    **dict.fromkeys((DISPLACEMENT, "opening", "gap", "slip", "fine_scale"), "mm"),
    **dict.fromkeys((STRESS, "traction"), "MPa"),
    **dict.fromkeys((DAMAGE, "mode"), "-"),
}
#: Free disk space required before fields are written, relative to their size, by format; points
#: and cells are written at every time, and put together in memory.
ROOM = {"bp": 2.0, "vtu": 8.0}


def discontinuous(problem: Problem) -> fem.Function:
    """A cell-wise discontinuous displacement, in a space that does not change when facets open on
    demand."""
    degree, shape = problem.space.ufl_element().degree, (problem.mesh.geometry.dim,)
    return fem.Function(fem.functionspace(problem.mesh, ("DG", degree, shape)), name=DISPLACEMENT)


def body_damage(problem: Problem) -> fem.Function:
    """Damage d of bodies of :class:`vmdg.GradientDamage` at the nodes [-], zero in others.

    Like the displacement it may jump at interfaces; the next call overwrites it.

    Raises:
        TypeError: the problem is not a problem.
        ValueError: no body cracks.
    """
    if not isinstance(problem, Problem):
        raise TypeError(f"body_damage: problem = {problem!r} must be a vmdg.Problem")
    if problem.step.damage is None:
        raise ValueError(
            "body_damage: no body cracks; give one the material vmdg.GradientDamage(...)"
        )
    return problem.step.damage.field


def _copied_damage(problem: Problem) -> tuple[fem.Function, Callable[[], None]]:
    """A cell-wise discontinuous damage of bodies, and what updates it."""
    degree = problem.space.ufl_element().degree
    function = fem.Function(fem.functionspace(problem.mesh, ("DG", degree)), name=DAMAGE)
    cells = np.arange(len(function.function_space.dofmap.list), dtype=np.int32)
    return function, lambda: compat.interpolate(function, body_damage(problem), cells)


def copy_displacement(problem: Problem, function: fem.Function) -> None:
    u, d = whole_displacement(problem), problem.mesh.geometry.dim
    mine, theirs = function.function_space.dofmap.list, u.function_space.dofmap.list
    function.x.array.reshape(-1, d)[mine] = u.x.array.reshape(-1, d)[theirs]


class InterfaceFields:
    """An interface's state as fields on a mesh of all its facets, one value per facet; where meshes
    do not match, on the facets of side 1.

    Scalars are those of :func:`vmdg.output.values.facet_scalar`, vectors facet means. Closed facets
    have zeros. The displacement is that of side 1, at the corners, so the interface can be warped
    with the bodies.

    Attributes:
        cell_of_facet: Cell of the facet mesh for every facet of the interface (nf,).
    """

    def __init__(self, problem: Problem, interface: Which, names: Sequence[str]):
        self._problem, self._i = problem, number_of(problem.interfaces, interface)
        self._facets = problem.step.activation.facets[interface]
        self._shown, self._cells, self._local = self._facets.first_side
        submesh = compat.facet_submesh(problem.mesh, self._shown)
        self._mesh = submesh.mesh
        self.cell_of_facet = np.argsort(submesh.facets[: len(self._shown)])
        vector = fem.functionspace(self._mesh, ("DG", 1, (problem.mesh.geometry.dim,)))
        scalar = fem.functionspace(self._mesh, ("DG", 1))
        self.functions = {
            name: fem.Function(vector if name in (DISPLACEMENT, *VECTORS) else scalar, name=name)
            for name in names
        }

    def update(self) -> None:
        active = self._problem.discretization.active.get(self._i)
        for name, function in self.functions.items():
            if name == DISPLACEMENT:
                self._set(function, self.cell_of_facet, self._displacement())
            elif active is not None:
                shown = open_facets(self._problem.state[self._i])
                position = np.searchsorted(self._shown, shown)
                values = self._facet_values(name)
                function.x.array[:] = 0.0
                self._set(function, self.cell_of_facet[position], values[:, None])

    def _facet_values(self, name: str) -> NDArray[np.float64]:
        """Values on the open facets, (nf,) or (nf, d)."""
        if name not in VECTORS:
            return facet_scalar(self._problem, self._i, name)
        state = self._problem.state[self._i]
        return facet_means(state, getattr(state, name))

    def _displacement(self) -> NDArray[np.float64]:
        """Displacement of side 1 at the corners of all facets, in the order of their cells (nf,
        corners, d)."""
        mesh = self._problem.mesh
        cells, corners = self._cells, corners_of_local(mesh, self._local)
        X, u = positions_and_displacements(self._problem, cells, corners)
        nodes = compat.geometry_dofmap(self._mesh)[self.cell_of_facet][:, : corners.shape[1]]
        apart = np.linalg.norm(self._mesh.geometry.x[nodes][:, :, None] - X[:, None], axis=-1)
        return np.take_along_axis(u, apart.argmin(axis=2)[:, :, None], axis=1)

    @staticmethod
    def _set(function: fem.Function, cells: NDArray[np.intp], values: NDArray) -> None:
        bs = function.function_space.dofmap.index_map_bs
        dofs = function.function_space.dofmap.list[cells]
        function.x.array.reshape(-1, bs)[dofs] = values.reshape(*values.shape[:2], bs)
        function.x.scatter_forward()


def _writer(file: Path, functions: list[fem.Function]) -> VTXWriter:
    """A writer with the engine BP4: on a full disk it raises an error on the writing rank, which
    aborts the job; with BP5, the default, all ranks wait indefinitely."""
    return VTXWriter(functions[0].function_space.mesh.comm, file, functions, "BP4")


def _series(folder: Path, functions: list[fem.Function]) -> Series:
    return Series(folder, functions, [f"{one.name} [{UNITS[one.name]}]" for one in functions])


class _Writer(Protocol):
    def write(self, t: float) -> None: ...

    def close(self) -> None: ...


class FieldWriter:
    """Writes fields of the bodies and of the interfaces as time series for ParaView.

    Open bodies.bp and the files of the interfaces together and warp all by the displacement. Use as
    a context manager. Only requested fields are evaluated. Files of an earlier run, for example of
    one that is continued, are kept: bodies.bp becomes bodies.1.bp, etc. Only one run at a time may
    write to a folder. Every cell has corners of its own, so that both sides of an interface are
    there.

    Args:
        problem: The problem.
        folder: Created if missing; receives bodies.bp and one file per interface with its name,
            such as bond.bp, or interface_0.bp without a name.
        fields: Names of the fields, or one name; None for all. Bodies: "displacement" [mm],
            "stress" [MPa], and "damage" [-] where they crack; interfaces: "traction" [MPa],
            "opening" and "gap" [mm], which are vectors, "slip" [mm], "damage" [-], "mode" and
            "fine_scale" [mm], see :func:`vmdg.output.values.scalar`. The displacement, if chosen,
            is also written for interfaces.
        format: "bp", VTX files of ADIOS2, which are small and quick; or "vtu", which pyvista,
            meshio and vtk of PyPI read too: folders bodies, bond, ..., with bodies/bodies.pvd and
            a .vtu file for every time and rank, of degree 2 at most, by meshio. Names have their
            units there: "stress [MPa]".

    Raises:
        ValueError: an unknown name or format, or no name.
        ImportError: format="vtu" without meshio.
        TypeError: the problem is not a problem.
        OSError: the folder is not writable, or another run writes to it; on all ranks.

    If the disk becomes full while several ranks write, the job is aborted.
    """

    def __init__(
        self,
        problem: Problem,
        folder: str | Path,
        fields: Sequence[str] | str | None = None,
        format: str = "bp",
    ):
        if not isinstance(problem, Problem):
            raise TypeError(
                f"FieldWriter: problem = {problem!r} must be a vmdg.Problem, and the folder comes "
                "after it"
            )
        same_arguments(problem.comm, "FieldWriter", folder=folder, fields=fields, format=format)
        fields = (fields,) if isinstance(fields, str) else fields
        names = FIELDS if fields is None else tuple(dict.fromkeys(fields))
        for name in names:
            if name not in FIELDS:
                raise ValueError(f"FieldWriter: there is no field {name!r}; choose from {FIELDS}")
        if not names:
            raise ValueError(f"FieldWriter: fields is empty; choose from {FIELDS}, None for all")
        if format not in ROOM:
            raise ValueError(f"FieldWriter: format = {format!r} must be one of {tuple(ROOM)}")
        if format == "vtu":
            check_meshio()
        self._comm = problem.comm
        self._folder = checked_path("FieldWriter: folder", folder).absolute()
        self._updates: list[Callable[[], object]] = []
        files: dict[str, list[fem.Function]] = {"bodies": []}
        if DISPLACEMENT in names:
            displacement = discontinuous(problem)
            self._updates.append(partial(copy_displacement, problem, displacement))
            files["bodies"].append(displacement)
        if STRESS in names:
            self._updates.append(problem.stress)
            files["bodies"].append(problem.stress())
        if DAMAGE in names and problem.step.damage is not None:
            function, update = _copied_damage(problem)
            self._updates.append(update)
            files["bodies"].append(function)
        chosen = [name for name in names if name in INTERFACE_FIELDS]
        if set(chosen) - {DISPLACEMENT}:
            for name in interface_names(problem.interfaces):
                interface = InterfaceFields(problem, name, chosen)
                self._updates.append(interface.update)
                files[name] = list(interface.functions.values())
        suffix = ".bp" if format == "bp" else ""
        self._files = [self._folder / f"{name}{suffix}" for name in files if files[name]]
        written = [functions for functions in files.values() if functions]
        local = sum(function.x.array.nbytes for part in written for function in part)
        self._bytes, self._room = float(global_sum(self._comm, local)), ROOM[format]
        self._claim = Claim(self._comm, self._folder / "fields.lock", f"fields in {folder}")
        self._writers: list[_Writer] = []
        self._do(self._keep_earlier_files)
        make = _writer if format == "bp" else _series
        self._do(lambda: self._writers.extend(map(make, self._files, written)))

    def _keep_earlier_files(self) -> None:
        if self._comm.rank > 0:
            return
        for file in filter(os.path.lexists, self._files):
            put_aside(file)

    def write(self, t: float) -> None:
        """Write the current state as time ``t``; collective.

        Raises:
            ValueError: the files are closed, or the time is not a finite number.
            OSError: the disk is full, or files were removed; on all ranks. The files are then
                closed.
        """
        if not (isinstance(t, Real) and np.isfinite(t)):
            raise ValueError(
                f"FieldWriter: t = {t!r} must be a finite number, for example problem.t"
            )
        if not self._writers:
            raise ValueError(
                f"FieldWriter: the files in {self._folder} are closed; write before close() and "
                "the end of `with`, or create another FieldWriter, which keeps them"
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
        """An OSError where a file was removed."""
        gone = [file.name for file in self._files if self._comm.rank == 0 and not file.exists()]
        if gone:
            raise OSError(f"{gone[0]} was removed")

    def _full(self) -> bool:
        """Whether the disk is full, checked before collective writes."""
        return shutil.disk_usage(self._folder).free < self._room * self._bytes

    def _complaint(self, why: object) -> str:
        return (
            f"fields in {self._folder} cannot be written: {why}. Free some space or choose a "
            "writable folder"
        )

    def _do(self, action: Callable[[], object]) -> None:
        """Run an action that may fail on any rank; if it does, abandon the files; collective."""
        try:
            together(self._comm, action)
        except (OSError, RuntimeError) as error:
            self._give_up()
            raise OSError(self._complaint(error)) from error

    def _give_up(self) -> None:
        """Leave the files as they are: a failure while closing them would kill the process."""
        for writer in self._writers:
            ctypes.pythonapi.Py_IncRef(ctypes.py_object(writer))
        self._writers = []
        self._claim.release()

    def close(self) -> None:
        """Complete the files; collective. A second call has no effect.

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
