"""Massless nodes of contact in explicit steps, and their equilibrium."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from ..assembly.discretization import Discretization, split
from ..assembly.point_matrices import add_tangent
from ..base.parallel import global_any, global_norm
from ..domain.topology import box_sides
from ..laws import Law
from ..linear.ksp import Petsc, destroy, set_options
from ..problem.motion import moving
from ..problem.problem import Problem

Array = NDArray[np.float64]
Marks = NDArray[np.bool_]

#: Most corrections of a step, and number of those after which two of three are halved.
CORRECTIONS, DAMPED = 25, 6

#: Unbalanced forces on the nodes relative to all forces, and the relative tolerance of corrections.
BALANCED, CORRECTED = 1e-10, 1e-4


class ContactNodes:
    """Nodes of interfaces without a bond, which have no mass in explicit steps.

    A node with mass stops at once where it hits another, and however fine the mesh the force of the
    contact oscillates by a third. Mass redistribution (Khenous, Laborde and Renard 2008, Eur. J.
    Mech. A 27): the nodes of the interface give their mass to the others of their cells, and are in
    equilibrium in every step. Nodes of bonds, ties and dashpots keep their mass, those of cells
    with no others, and all with beta K, mean dilatation, unknown means, or surfaces that slide.

    Momentum and energy are kept by masses that are constant in time. Where surfaces slide all nodes
    that may ever meet the other body would have none, which is all of its boundary: of a block of
    2 x 2 x 3 hexahedra nearly all, whose impact then has half of its force, one of 5 x 6
    quadrilaterals comes back at 0.86 of its speed instead of 0.90, and partners that change while
    nodes come to rest make Newton's method alternate.

    Args:
        masses: Row sums of the mass matrix, owned dofs [N s2/mm].

    Attributes:
        masses: Masses of owned dofs, zero at these nodes [N s2/mm].
    """

    def __init__(self, problem: Problem, masses: Array):
        self._problem, self._comm = problem, problem.comm
        self._parts = parts = problem.discretization
        self._d = d = parts.space.dofmap.index_map_bs
        self._cells = cells = _deformable(parts)
        marks = _massless(problem, cells)
        nodes = parts.space.dofmap.list
        self.masses = np.repeat(_redistributed(parts, masses[::d], marks, cells), d)
        mine = np.flatnonzero(marks[: parts.owned // d])
        self.dofs = (d * mine[:, None] + np.arange(d)).ravel()
        near = np.zeros(len(nodes), dtype=bool)
        near[cells] = marks[nodes[cells]].any(axis=1)
        self.exist = global_any(self._comm, bool(marks.any()))
        if not self.exist:
            return
        self._split = split(parts, near)
        self._touching = [
            active
            for active in parts.active.values()
            if global_any(self._comm, bool(near[active.facets.cells].any()))
        ]
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._largest, self._norm = 0.0, 0.0
        self._matrix = self._create_matrix(marks, len(mine))
        self._x, self._b = self._matrix.createVecs()
        self._ksp = PETSc.KSP().create(self._comm)
        # Fixed to the other nodes of its cells, the layer is well conditioned.
        options: Petsc = {"ksp_type": "gmres", "pc_type": "bjacobi", "ksp_rtol": CORRECTED}
        set_options(self._ksp, options)
        self._ksp.setOperators(self._matrix)
        held = np.isin(self.dofs, problem.loading.owned_prescribed)
        self._held = np.flatnonzero(held).astype(PETSc.IntType)

    def _create_matrix(self, marks: Marks, count: int) -> PETSc.Mat:
        """A matrix whose rows are these nodes; entries of others are dropped."""
        imap, comm, d = self._parts.space.dofmap.index_map, self._comm, self._d
        first = comm.exscan(count) or 0
        numbers = la.vector(imap, 1, dtype=np.float64)
        numbers.array[:] = -1
        numbers.array[np.flatnonzero(marks[: imap.size_local])] = first + np.arange(count)
        numbers.scatter_forward()
        rows = PETSc.LGMap().create(numbers.array.astype(PETSc.IntType), bsize=d, comm=comm)
        matrix = PETSc.Mat().create(comm)
        matrix.setSizes(((d * count, None), (d * count, None)), bsize=d)
        matrix.setType(PETSc.Mat.Type.AIJ)
        matrix.setLGMap(rows, rows)
        matrix.setUp()
        matrix.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        return matrix

    def balance(self, dt: float) -> bool:
        """Move the nodes into equilibrium and assemble the residual; whether that has succeeded;
        collective."""
        if not self.exist:
            self._problem.step.assemble_residual(dt)
            return True
        parts, loads, u = self._parts, self._problem.loading.vector, self._problem.u.x
        free = np.delete(self.dofs, self._held)
        for number in range(CORRECTIONS):
            R = parts.assemble_residual(dt, loads=loads, bulk=self._split.near)
            norm = global_norm(self._comm, R[free])
            self._largest = max(self._largest, norm)
            floor = float(np.finfo(float).eps) * self._size * self._norm
            if not norm > max(BALANCED * self._largest, floor):
                break
            # Points that alternate between sticking and slipping settle on the way between.
            share = 0.5 if number >= DAMPED and number % 3 else 1.0
            u.array[self.dofs] -= share * self._correction(R[self.dofs])
            u.scatter_forward()
        far = fem.Function(parts.space).x
        fem.assemble_vector(far.array, self._split.far)
        far.scatter_reverse(la.InsertMode.add)
        parts.forces.x.array[: parts.owned] += far.array[: parts.owned]
        parts.forces.x.scatter_forward()
        every = global_norm(self._comm, parts.forces.x.array[: parts.owned])
        self._largest = max(self._largest, every)
        return bool(norm <= max(BALANCED * self._largest, floor))

    def _correction(self, forces: Array) -> Array:
        """K^-1.R of the nodes [mm]."""
        matrix = self._matrix
        matrix.zeroEntries()
        self._split.add_near(matrix)
        self._parts.surface.add_tangents(matrix)
        for active in self._touching:
            add_tangent(matrix, active, active.tangent()[0])
        matrix.assemble()
        matrix.zeroRowsColumns(self._held + matrix.getOwnershipRange()[0], 1.0)
        self._norm = self._norm or matrix.norm(PETSc.NormType.NORM_INFINITY)
        self._b.array[:] = forces
        self._b.array[self._held] = 0.0
        self._ksp.solve(self._b, self._x)
        return self._x.array.copy()

    def free(self) -> None:
        if self.exist:
            destroy(self._ksp)
            for item in (self._matrix, self._x, self._b):
                item.destroy()


def massless(law: Law) -> bool:
    """Whether nodes of a law have no mass: those of contact without a bond."""
    return law.inelastic and not law.has_bond


def _deformable(parts: Discretization) -> NDArray[np.int32]:
    """Owned cells of the bodies that are not walls."""
    none = np.zeros(0, dtype=np.int32)
    return np.concatenate([none, *(region.cells for region in parts.bodies.regions)])


def _shared(parts: Discretization, values: Array) -> Array:
    """Sums over all ranks of values at the local nodes; collective."""
    total = la.vector(parts.space.dofmap.index_map, 1)
    total.array[:] = values
    total.scatter_reverse(la.InsertMode.add)
    total.scatter_forward()
    return total.array.copy()


def _massless(problem: Problem, cells: NDArray[np.int32]) -> Marks:
    """Marks of local nodes without mass; collective."""
    parts, prescribed = problem.discretization, problem.loading.prescribed
    dofmap, fdim = parts.space.dofmap, problem.mesh.topology.dim - 1
    size = len(problem.u.x.array) // dofmap.index_map_bs
    contact, other = np.zeros((2, size))
    for active in parts.active.values():
        law = active.interface.law
        marks = contact if massless(law) else other
        for side, facets in zip(active.facets.cells.T, active.facets.local.T, strict=True):
            for facet in np.unique(facets):
                there = dofmap.list[side[facets == facet]]
                marks[there[:, dofmap.dof_layout.entity_closure_dofs(fdim, int(facet))]] = 1
    damping = moving(problem.step.motion).damping
    for facets, _ in damping.dashpots:
        other[fem.locate_dofs_topological(parts.space, fdim, facets)] = 1
    held = np.bincount(prescribed // dofmap.index_map_bs, minlength=size) == dofmap.index_map_bs
    found = (_shared(parts, contact) > 0) & ~(_shared(parts, other) > 0) & ~held
    coupled = parts.bodies.mean_dilatation or parts.means is not None
    if coupled or damping.rayleigh.beta or parts.slides:
        # Pressure, means or damping would couple further nodes, or partners change.
        found[:] = False
    nodes, alone = dofmap.list[cells], np.zeros(size)
    alone[nodes[found[nodes].all(axis=1)]] = 1
    return found & ~(_shared(parts, alone) > 0)


def _redistributed(
    parts: Discretization, masses: Array, marks: Marks, cells: NDArray[np.int32]
) -> Array:
    """Masses of owned nodes, those of marked ones in equal parts at the others of their cells;
    collective."""
    nodes, owned = parts.space.dofmap.list[cells], len(masses)
    each, count = np.zeros((2, len(marks)))
    np.add.at(count, nodes, 1.0)
    each[:owned] = masses
    share = _shared(parts, each) / np.maximum(_shared(parts, count), 1.0)
    gives = marks[nodes]
    given = (share[nodes] * gives).sum(axis=1) / np.maximum((~gives).sum(axis=1), 1)
    taken = np.zeros(len(marks))
    np.add.at(taken, nodes, given[:, None] * ~gives)
    return np.where(marks, 0.0, each + _shared(parts, taken))[:owned]
