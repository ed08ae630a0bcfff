"""What acts on a problem at its load factor: prescribed displacements, dead loads, eigenstrains."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..assembly.dirichlet import (
    DirichletConditions,
    Value,
    Where,
    find_boundary_facets,
    refuse_facets,
)
from ..assembly.discretization import Discretization
from ..assembly.loads import DeadLoads
from ..domain.geometry import axis_dofs
from ..domain.tags import Group, group_tag
from ..domain.topology import Locator, facet_cells
from ..interface.activation import Activation


class _Prescription(NamedTuple):
    """A prescribed displacement on facets, or at nodes that a predicate selects."""

    what: str
    where: NDArray[np.int32] | Locator
    value: Value
    component: int | str | None
    relative: bool = False


class _Load(NamedTuple):
    """A dead load on facets or cells, and how it is added to others."""

    add: Callable[[DeadLoads, NDArray[np.int32], Value | Expr], None]
    entities: NDArray[np.int32]
    value: Value | Expr


class Loading:
    """Prescribed displacements, dead loads and eigenstrains, as functions of the load factor.

    All is remembered as it was given, because facets that open on demand change the space.

    Args:
        discretization: Its space is loaded.
        activation: Facets of the interfaces.
        names: Tag by name of the groups of cells.

    Attributes:
        load_factor: t as a UFL constant.
        loaded: Whether dead loads act on a cell, for every local cell.
    """

    def __init__(
        self, discretization: Discretization, activation: Activation, names: dict[str, int]
    ):
        self._mesh = mesh = discretization.mesh
        self._bodies = discretization.bodies
        self._activation = activation
        self._names = names
        self._prescriptions: list[_Prescription] = []
        self._dead_loads: list[_Load] = []
        self.load_factor = fem.Constant(mesh, 0.0)
        self.loaded = np.zeros(len(self._bodies.tags), dtype=bool)
        self.follow(discretization)

    def follow(self, discretization: Discretization) -> None:
        """Load the space of another discretization from now on."""
        self._discretization, space = discretization, discretization.space
        self._vector: NDArray[np.float64] | None = None
        self._dirichlet = DirichletConditions(space, axis_dofs(space, discretization.geometry))
        for prescription in self._prescriptions:
            self._prescribe(prescription)
        self._loads = DeadLoads(space, discretization.geometry)
        for load in self._dead_loads:
            load.add(self._loads, load.entities, load.value)

    # Prescribed displacements

    def add_dirichlet(
        self,
        facets: Where,
        value: Value,
        component: int | str | None = None,
        relative: bool = False,
    ) -> None:
        """See :meth:`vmdg.Problem.dirichlet`."""
        facets = find_boundary_facets(self._mesh, facets, "dirichlet")
        inside = np.zeros(len(facet_cells(self._mesh)), dtype=bool)
        for selected in self._activation.facets:
            inside[selected.everywhere] = True
        reason = (
            "lies on an interface, whose two sides would be held together; prescribe boundary "
            "facets, or leave these out of the interface"
        )
        refuse_facets(self._mesh, facets, inside, "dirichlet", reason)
        if relative and self._activation:
            raise ValueError(
                "dirichlet: relative=True does not go with activate='on-demand'; prescribe the "
                "displacement from the start"
            )
        self._add(_Prescription("dirichlet", facets, value, component, relative))

    def add_dirichlet_points(
        self, where: Locator, value: Value, component: int | str | None = None
    ) -> None:
        """See :meth:`vmdg.Problem.dirichlet_points`."""
        self._add(_Prescription("dirichlet_points", where, value, component))

    def _add(self, prescription: _Prescription) -> None:
        self._prescribe(prescription)
        self._prescriptions.append(prescription)

    def _prescribe(self, prescription: _Prescription) -> None:
        what, where, value, component, relative = prescription
        space = self._discretization.space
        if callable(where):
            dofs = fem.locate_dofs_geometrical(space, where)
        else:
            dofs = fem.locate_dofs_topological(space, self._mesh.topology.dim - 1, where)
        u = self._discretization.u.x.array.reshape(-1, space.dofmap.index_map_bs)
        self._dirichlet.add(dofs, value, component, what, u[dofs] if relative else None)

    @property
    def prescribed(self) -> NDArray[np.int32]:
        """Prescribed local dofs (component-wise numbers), ghosts included."""
        return self._dirichlet.dofs

    @property
    def owned_prescribed(self) -> NDArray[np.int32]:
        """Those of :attr:`prescribed` that this rank owns."""
        return self.prescribed[self.prescribed < self._discretization.owned]

    def prescribed_values(self, t: float) -> NDArray[np.float64]:
        """Prescribed displacement of :attr:`prescribed` at load factor ``t`` [mm]."""
        return self._dirichlet.values(t)

    def conflict(self, t: float) -> str | None:
        """Prescribed displacements that differ at a node of this rank, in words; None if none do.

        Args:
            t: Load factor.
        """
        return self._dirichlet.conflict(t)

    # Dead loads

    def add_traction(self, facets: Where, value: Value | Expr) -> None:
        """See :meth:`vmdg.Problem.traction`."""
        facets = find_boundary_facets(self._mesh, facets, "traction")
        reason = (
            "lies inside the mesh and would load one side of it; give boundary facets, or let an "
            "interface transmit the traction"
        )
        cells = facet_cells(self._mesh)
        refuse_facets(self._mesh, facets, (cells >= 0).all(axis=1), "traction", reason)
        self._add_load(_Load(DeadLoads.add_traction, facets, value))
        self.loaded[cells[facets, 0]] = True

    def add_body_force(self, value: Value | Expr, tag: Group | None = None) -> None:
        """See :meth:`vmdg.Problem.body_force`."""
        if np.ndim(tag) != 0:
            raise ValueError(f"body_force: tag = {tag} must be one tag; call it once for each")
        tag, cells_of = group_tag(tag, self._names, "body_force"), self._bodies.cells_of
        if tag is not None and tag not in cells_of:
            raise ValueError(f"body_force: no cell has tag {tag}; tags are {sorted(cells_of)}")
        cells = np.arange(len(self._bodies.tags)) if tag is None else cells_of[tag]
        self._add_load(_Load(DeadLoads.add_body_force, cells.astype(np.int32), value))
        self.loaded[cells] = True

    def _add_load(self, load: _Load) -> None:
        load.add(self._loads, load.entities, load.value)
        self._dead_loads.append(load)
        self._vector = None

    @property
    def vector(self) -> NDArray[np.float64]:
        """Dead loads at the load factor over local dofs, ghosts still to be added to their owners
        [N]; collective."""
        if self._vector is None:
            nothing = np.zeros_like(self._discretization.u.x.array)
            self._vector = self._loads.vector(self.t) if self._loads else nothing
        return self._vector

    # Load factor

    @property
    def t(self) -> float:
        """Load factor."""
        return float(self.load_factor.value)

    def apply(self, t: float) -> None:
        """Set loads and eigenstrains to load factor ``t``; prescribed displacements are not
        imposed here but by the solver's predictor."""
        self.load_factor.value = t
        self._bodies.apply_eigenstrain(t)
        self._vector = None
