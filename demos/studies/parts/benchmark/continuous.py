"""Newton's method with plain finite elements, written by hand: what vmdg is compared with.

The same hyperelastic bodies, meshes, quadrature, compiler flags and linear solvers. On request the
space is broken and held together by springs, as intrinsic cohesive elements are before damage.
"""

from __future__ import annotations

from collections.abc import Mapping

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from dolfinx.la import InsertMode
from numpy.typing import NDArray
from ufl.core.expr import Expr

import vmdg
from vmdg.assembly.space import broken_space
from vmdg.base.kernels import JIT_OPTIONS, VECTORIZED, compile_form
from vmdg.base.quadrature import bulk_degree, facet_degree, load_degree
from vmdg.domain.topology import facet_cells, local_facets, tags_of_cells
from vmdg.forms.geometry import CARTESIAN
from vmdg.forms.kinematics import Body
from vmdg.linear.ksp import Petsc, destroy, make_ksp
from vmdg.meshes import TaggedMesh


class Plain:
    """Bodies without interfaces, or with springs between them.

    Args:
        springs: Stiffness K [MPa/mm] with which the bodies are tied, T = K g; None for a continuous
            displacement.
        loads: Body force of every tag [N/mm3].

    Attributes:
        u: Displacement [mm].
        forces: Internal minus external forces, at ghosts a share of them [N].
        iterations: Of Newton's method in the last :meth:`solve`.
    """

    def __init__(
        self,
        tagged: TaggedMesh,
        materials: Mapping[int, vmdg.Material],
        degree: int = 1,
        springs: float | None = None,
        loads: Mapping[int, Expr] | None = None,
    ):
        mesh = self.mesh = tagged.mesh
        d = mesh.geometry.dim
        if springs is None:
            self.space = fem.functionspace(mesh, ("Lagrange", degree, (d,)))
        else:
            tags, pairs = tags_of_cells(mesh, tagged.cell_tags), facet_cells(mesh)
            inside = (pairs >= 0).all(axis=1)
            between = inside & (tags[pairs[:, 0]] != tags[pairs[:, 1]])
            self.space = broken_space(mesh, degree, np.flatnonzero(between).astype(np.int32))
        self.u = u = fem.Function(self.space)
        eta, du = ufl.TestFunction(self.space), ufl.TrialFunction(self.space)

        def dx(quadrature: int) -> ufl.Measure:
            metadata = {"quadrature_degree": quadrature}
            return ufl.Measure("dx", mesh, subdomain_data=tagged.cell_tags, metadata=metadata)

        F = ufl.Identity(d) + ufl.grad(u)
        inner = dx(bulk_degree(mesh.topology.cell_name(), degree, CARTESIAN))
        energy = ufl.Form([])
        for tag, material in materials.items():
            constants = {k: fem.Constant(mesh, v) for k, v in material.parameters.items()}
            energy += Body(material, constants).energy(F) * inner(tag)
        residual = ufl.derivative(energy, u, eta)
        if springs is not None:
            metadata = {"quadrature_degree": facet_degree(degree)}
            K, jump = fem.Constant(mesh, springs), u("-") - u("+")
            dS = ufl.Measure("dS", mesh, subdomain_data=_rows(tagged, between), metadata=metadata)
            residual += K * ufl.inner(eta("-") - eta("+"), jump) * dS(0)
        outer = dx(load_degree(degree))
        given = (loads or {}).items()
        load = sum((ufl.inner(f, eta) * outer(tag) for tag, f in given), start=ufl.Form([]))
        options = VECTORIZED if d == 3 else JIT_OPTIONS
        self._residual, self._tangent = (
            compile_form(form, mesh.comm, options)
            for form in (residual, ufl.derivative(residual, u, du))
        )
        self._load = np.zeros_like(u.x.array)
        if loads:
            fem.assemble_vector(self._load, compile_form(load, mesh.comm, options))
        self.matrix = fem_petsc.create_matrix(self._tangent)
        self.matrix.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._forces = fem.Function(self.space).x
        self.forces = self._forces.array
        self.prescribed = np.zeros(0, dtype=np.int32)
        self.iterations = 0

    @property
    def size(self) -> int:
        """Number of unknowns, prescribed ones included."""
        return self.space.dofmap.index_map.size_global * self.space.dofmap.index_map_bs

    def prescribe(self, facets: NDArray[np.int32]) -> None:
        """Hold the displacement that ``u`` has on these facets."""
        d = self.mesh.geometry.dim
        nodes = fem.locate_dofs_topological(self.space, d - 1, facets)
        self.prescribed = (d * nodes[:, None] + np.arange(d, dtype=np.int32)).ravel()

    def assemble_residual(self) -> NDArray[np.float64]:
        """Forces on owned dofs, zero on prescribed ones [N]; collective."""
        self.forces[:] = -self._load
        fem.assemble_vector(self.forces, self._residual)
        self._forces.scatter_reverse(InsertMode.add)
        free = self.forces.copy()
        free[self.prescribed] = 0
        return free[: self.matrix.getLocalSize()[0]]

    def assemble_tangent(self) -> None:
        """Fill the matrix, prescribed rows included."""
        self.matrix.zeroEntries()
        fem_petsc.assemble_matrix(self.matrix, self._tangent)
        self.matrix.assemble()

    def hold(self) -> None:
        """Take the prescribed dofs out of the matrix."""
        self.matrix.zeroRowsColumnsLocal(self.prescribed, 1.0)

    def solve(
        self,
        options: Petsc,
        tolerance: float,
        given: NDArray[np.float64] | None = None,
        most: int = 20,
    ) -> None:
        """Newton's method from the present displacement, on one rank.

        Args:
            tolerance: Of the residual relative to all forces on prescribed dofs.
            given: Displacement of the prescribed dofs, to which the first correction moves them;
                None leaves them where they are [mm].
        """
        ksp = make_ksp(self.matrix, options)
        x, b = self.matrix.createVecs()
        moved = np.zeros(len(self.prescribed))
        if given is not None:
            moved += given - self.u.x.array[self.prescribed]
        self.iterations = 0
        while True:
            free = self.assemble_residual()
            reaction = np.linalg.norm(self.forces[self.prescribed])
            if not moved.any() and np.linalg.norm(free) <= tolerance * reaction:
                break
            if self.iterations == most:
                raise RuntimeError(f"no convergence in {most} iterations")
            self.assemble_tangent()
            if moved.any():
                x.array[:] = 0
                x.array[self.prescribed] = moved
                self.matrix.mult(x, b)
                free += b.array_r
                free[self.prescribed] = -moved
                moved[:] = 0
            self.hold()
            b.array[:] = -free
            ksp.setOperators(self.matrix)
            ksp.solve(b, x)
            self.u.x.array[:] += x.array_r
            self.iterations += 1
        destroy(ksp)
        for item in (x, b):
            item.destroy()


def _rows(tagged: TaggedMesh, between: NDArray[np.bool_]) -> list[tuple[int, NDArray[np.int32]]]:
    """The facets for a measure; side '+' is the first cell."""
    facets = np.flatnonzero(between).astype(np.int32)
    cells = facet_cells(tagged.mesh)[facets]
    local = [local_facets(tagged.mesh, cells[:, a], facets) for a in range(2)]
    return [(0, np.column_stack([cells[:, 0], local[0], cells[:, 1], local[1]]).ravel())]
