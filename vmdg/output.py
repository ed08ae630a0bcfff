"""Fields for ParaView, and cell values for plots."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.io import VTXWriter

from . import compat
from .forms import kinematics
from .forms.dilatation import without_dilatation
from .forms.geometry import Axisymmetric
from .kernels import compile_expression
from .problem import Problem


class CauchyStress:
    """Cauchy stress sigma = P.F^T / J of the bodies, (d, d) [MPa], discontinuous of degree k.

    In axisymmetry it is (3, 3) in the order r, z, theta: the hoop stress is component (2, 2).
    """

    def __init__(self, problem: Problem):
        n = 3 if isinstance(problem.geometry, Axisymmetric) else problem.mesh.geometry.dim
        degree = problem.space.ufl_element().degree
        space = fem.functionspace(problem.mesh, ("DG", degree, (n, n)))
        self.function = fem.Function(space, name="stress")
        points = compat.interpolation_points(space)
        self._problem = problem
        self._points = points
        self._u: fem.Function | None = None

    def _make_expressions(self) -> None:
        self._u = self._problem.u
        self._expressions = []
        for family in self._problem.families:
            F = ufl.variable(self._problem.geometry.nodal_deformation(self._u))
            P = kinematics.first_piola(family.body, F)
            own = without_dilatation(F) if family.body.mean_dilatation else F
            stress = P * own.T / ufl.det(own)
            expression = compile_expression(stress, self._points, self._problem.comm)
            self._expressions.append((expression, family.cells))

    def update(self) -> fem.Function:
        """Evaluate at the current displacement."""
        if self._u is not self._problem.u:
            self._make_expressions()
        self._problem.discretization.update_dilatation()
        for expression, cells in self._expressions:
            self.function.interpolate(expression, cells)
        self.function.x.scatter_forward()
        return self.function


class Displacement:
    """The displacement in a discontinuous space that stays when facets open on demand."""

    def __init__(self, problem: Problem):
        self._problem = problem
        element = problem.space.ufl_element()
        shape = (problem.mesh.geometry.dim,)
        space = fem.functionspace(problem.mesh, ("DG", element.degree, shape))
        self.function = fem.Function(space, name="displacement")

    def update(self) -> None:
        """Take the current displacement, cell by cell."""
        u, d = self._problem.u, self._problem.mesh.geometry.dim
        mine, theirs = self.function.function_space.dofmap.list, u.function_space.dofmap.list
        self.function.x.array.reshape(-1, d)[mine] = u.x.array.reshape(-1, d)[theirs]


class InterfaceFields:
    """Facet means of an interface's state as fields on a mesh of all its facets.

    Facets that have not been opened show zeros.
    """

    def __init__(self, problem: Problem, i: int):
        self._problem, self._i = problem, i
        facets = problem.interface_facets(i).facets
        submesh = compat.facet_submesh(problem.mesh, facets)
        mesh = submesh.mesh
        self._facets = facets
        self._cell_of_facet = np.argsort(submesh.facets[: len(facets)])
        vector = fem.functionspace(mesh, ("DG", 1, (problem.mesh.geometry.dim,)))
        scalar = fem.functionspace(mesh, ("DG", 1))
        self.vectors = {
            name: fem.Function(vector, name=name) for name in ("traction", "opening", "gap")
        }
        self.scalars = {name: fem.Function(scalar, name=name) for name in ("softening", "mode")}

    def update(self) -> None:
        """Take the values of the current state."""
        coupling = self._problem.couplings[self._i]
        if coupling is None:
            return
        state, q = coupling.state(), coupling.quadrature
        open_cells = self._cell_of_facet[np.searchsorted(self._facets, coupling.facets.facets)]
        for name, function in (self.vectors | self.scalars).items():
            values = np.asarray(getattr(state, name), dtype=float)
            values = values.reshape(len(state.weights), function.function_space.dofmap.index_map_bs)
            mean = np.zeros((len(q.area), values.shape[1]))
            np.add.at(mean, q.facet, values * state.weights[:, None])
            mean /= q.area[:, None]
            dofs = function.function_space.dofmap.list[open_cells]
            function.x.array.reshape(-1, values.shape[1])[dofs] = mean[:, None, :]
            function.x.scatter_forward()


class FieldWriter:
    """Writes displacement, Cauchy stress and interface fields as VTX (.bp) time series.

    Open the folders in ParaView; warp by the displacement. Use as a context manager.

    Args:
        problem: The problem.
        folder: Made if missing; holds displacement.bp, stress.bp and interface_<i>_*.bp.
    """

    def __init__(self, problem: Problem, folder: str | Path):
        folder = Path(folder)
        if problem.comm.rank == 0:
            folder.mkdir(parents=True, exist_ok=True)
        problem.comm.barrier()
        self._displacement = Displacement(problem)
        self._stress = CauchyStress(problem)
        self._interfaces = [InterfaceFields(problem, i) for i in range(len(problem.interfaces))]
        outputs = [
            ("displacement", [self._displacement.function]),
            ("stress", [self._stress.function]),
        ]
        for i, fields in enumerate(self._interfaces):
            outputs.append((f"interface_{i}_vectors", list(fields.vectors.values())))
            outputs.append((f"interface_{i}_scalars", list(fields.scalars.values())))
        self._writers = [
            VTXWriter(functions[0].function_space.mesh.comm, folder / f"{name}.bp", functions)
            for name, functions in outputs
        ]

    def write(self, t: float) -> None:
        """Write the current state as time ``t``; collective."""
        self._displacement.update()
        self._stress.update()
        for fields in self._interfaces:
            fields.update()
        for writer in self._writers:
            writer.write(t)

    def close(self) -> None:
        """Complete the files; collective."""
        for writer in self._writers:
            writer.close()

    def __enter__(self) -> FieldWriter:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
