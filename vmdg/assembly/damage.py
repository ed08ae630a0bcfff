"""The damage field of bodies that crack: its problem at a given displacement.

Of the energy of :mod:`vmdg.materials.gradient_damage` the damage d is the minimum with
d_n <= d <= 1, that of a quadratic form: for all admissible changes v of d

    int -2 (1 - k) (1 - d) psi_+ v + (3 G_c/8) (v/l + 2 l grad d . grad v) dV >= 0,

by the reduced-space active-set method of PETSc's SNESVI (Benson and Munson 2006, Optimization
Methods and Software 21, 591). The field is of degree 1 on the broken space, so that it is
continuous where the displacement is, and nothing couples it across an interface. Its points are
those of the bodies, at which psi_+ is known: then both problems lower one energy.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.la import InsertMode
from numpy.typing import NDArray

from .. import compat
from ..base.kernels import compile_expression, compile_form
from ..base.parallel import global_max
from ..base.timers import timer
from ..domain.point_bodies import PointBodies
from ..materials.gradient_damage import REMAINING, GradientDamage
from .discretization import Discretization
from .space import at_owners, broken_space

Array = NDArray[np.float64]

#: Relative residuals of the active-set method and of its linear systems.
_TOLERANCE, _LINEAR = 1e-10, 1e-12


class Damage:
    """The damage of bodies at points."""

    def __init__(self, discretization: Discretization, bodies: PointBodies):
        mesh, geometry = discretization.mesh, discretization.geometry
        self._mesh, self._bodies = mesh, bodies
        cut = [active.facets.cut for active in discretization.active.values()]
        cut = np.concatenate([np.zeros(0, dtype=np.int32), *cut])
        space = broken_space(mesh, 1, cut.astype(np.int32), scalar=True)
        self._d = fem.Function(space, name="damage")
        self._rows = np.concatenate(
            [np.arange(len(bodies.cells))[own] for own in bodies.cracking.values()]
        )
        self._cells = bodies.cells[self._rows]
        constants = fem.functionspace(mesh, ("DG", 0))
        toughness, length = fem.Function(constants), fem.Function(constants)
        for tag, own in bodies.cracking.items():
            material = bodies.materials[tag]
            assert isinstance(material, GradientDamage)
            toughness.x.array[bodies.cells[own]] = material.toughness
            length.x.array[bodies.cells[own]] = material.length
        self._drive = fem.Function(bodies.fields.stored.function_space)
        touched = self._nodal_sum(np.ones((len(bodies.cells), space.dofmap.list.shape[1])))
        self._ranks = np.maximum(touched, 1.0)
        self._outside = touched == 0
        owned = self._cells < mesh.topology.index_map(mesh.topology.dim).size_local
        dx = ufl.Measure(
            "dx",
            domain=mesh,
            subdomain_data=[(0, np.sort(self._cells[owned]))],
            metadata={"quadrature_degree": bodies.rule},
        )(0)
        d, v, of_crack = ufl.TrialFunction(space), ufl.TestFunction(space), 3 * toughness / 8
        pull, slope = 2 * (1 - REMAINING) * self._drive, ufl.inner(ufl.grad(d), ufl.grad(v))
        stiffness = (pull * d * v + 2 * of_crack * length * slope) * geometry.weight * dx
        loads = (pull - of_crack / length) * v * geometry.weight * dx
        resistance = of_crack / length * v * geometry.weight * dx
        forms = {"damage": stiffness, "drive of damage": loads, "resistance": resistance}
        self._stiffness, self._loads, resists = (
            compile_form(form, mesh.comm, name=name) for name, form in forms.items()
        )
        grad = ufl.grad(self._d)
        surface = of_crack * (self._d / length + length * ufl.inner(grad, grad))
        self._at_points = compile_expression(
            ufl.as_vector([self._d, surface]), bodies.points, mesh.comm, name="damage at points"
        )
        outside = np.flatnonzero(self._outside).astype(np.int32)
        self._fixed = [fem.dirichletbc(PETSc.ScalarType(0), outside, space)]
        self._scale = float(np.linalg.norm(self._assembled(resists)))
        self._scale = global_max(mesh.comm, self._scale)
        self._matrix = fem_petsc.create_matrix(self._stiffness)

    @property
    def field(self) -> fem.Function:
        """The damage of the current state, zero outside these bodies."""
        self._d.x.array[:] = self._nodal(self._bodies.state.damage)
        return self._d

    def _assembled(self, form: fem.Form) -> Array:
        """On owned dofs; collective."""
        vector = np.zeros_like(self._d.x.array)
        fem.assemble_vector(vector, form)
        vector[self._outside] = 0.0
        return at_owners(self._d.function_space, vector)

    def _nodal(self, damage: Array) -> Array:
        """Local dofs of values at the corners of cells; collective."""
        return self._nodal_sum(damage) / self._ranks

    def _nodal_sum(self, damage: Array) -> Array:
        """The sum of the values of all ranks with a cell of these bodies at a node, which may have
        none on the rank that owns it."""
        field = fem.Function(self._d.function_space)
        field.x.array[self._d.function_space.dofmap.list[self._cells]] = damage[self._rows]
        field.x.scatter_reverse(InsertMode.add)
        field.x.scatter_forward()
        return field.x.array

    def solve(self, least: Array) -> tuple[Array, float]:
        """The damage for the last deformation of the bodies, and by how much it changes at most,
        not a number where PETSc found none; collective.

        Args:
            least: That at the start of the step, at the corners of cells (cells, corners).
        """
        bodies, now = self._bodies, self._nodal(self._bodies.state.damage)
        with timer("damage"):
            dofs = self._drive.function_space.dofmap.list
            for tag, own in bodies.cracking.items():
                self._drive.x.array[dofs[bodies.cells[own]]] = bodies.drive(tag)
            self._d.x.array[:] = now
            found = self._minimize(self._nodal(least))
            self._d.x.scatter_forward()
        change = float(np.abs(self._d.x.array - now).max(initial=0.0))
        damage = np.zeros_like(bodies.state.damage)
        damage[self._rows] = self._d.x.array[self._d.function_space.dofmap.list[self._cells]]
        return damage, float(global_max(self._mesh.comm, change)) if found else np.nan

    def _minimize(self, least: Array) -> bool:
        """From the current field; whether PETSc has converged; collective."""
        comm, count = self._mesh.comm, self._d.function_space.dofmap.index_map.size_local
        matrix = self._matrix
        matrix.zeroEntries()
        fem_petsc.assemble_matrix(matrix, self._stiffness, self._fixed)
        matrix.assemble()
        vectors = [matrix.createVecRight() for _ in range(5)]
        x, residual, loads, low, high = vectors
        loads.array[:], low.array[:] = self._assembled(self._loads), least[:count]
        x.array[:], high.array[:] = self._d.x.array[:count], ~self._outside[:count]
        snes = PETSc.SNES().create(comm)
        snes.setType("vinewtonrsls")

        def function(_: PETSc.SNES, x: PETSc.Vec, F: PETSc.Vec) -> None:
            matrix.mult(x, F)
            F.axpy(-1.0, loads)

        snes.setFunction(function, residual)
        snes.setJacobian(lambda *_: None, matrix)
        snes.setVariableBounds(low, high)
        snes.setTolerances(rtol=0.0, atol=_TOLERANCE * self._scale, stol=0.0, max_it=200)
        snes.ksp.setType("cg")
        snes.ksp.pc.setType("jacobi")
        snes.ksp.setTolerances(rtol=_LINEAR, max_it=10_000)
        snes.solve(None, x)
        reason, found = snes.getConvergedReason(), x.array.copy()
        for one in (snes, *vectors):
            one.destroy()
        # PETSc meets bounds to rounding.
        self._d.x.array[:count] = np.clip(found, least[:count], ~self._outside[:count])
        return reason > 0

    def apply(self, damage: Array) -> None:
        """Soften the bodies in the iteration of a step by another damage; collective."""
        self._d.x.array[:] = self._nodal(damage)
        values = np.zeros((len(self._bodies.cells), len(self._bodies.points), 2))
        found = compat.evaluate(self._at_points, self._mesh, self._cells)
        values[self._rows] = found.reshape(len(self._cells), -1, 2)
        self._bodies.soften(damage, values)
