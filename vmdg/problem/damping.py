"""Viscous forces C.v on bodies in motion: Rayleigh damping, and dashpots on their surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from numbers import Real

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem, la
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import ArrayLike, NDArray
from ufl.core.expr import Expr

from ..assembly.discretization import Discretization
from ..base.kernels import UNROLLED
from ..base.quadrature import facet_degree
from ..domain.topology import boundary_rows
from ..forms import kinematics, surface
from ..forms.kinematics import Body

#: Viscosity of a surface that no wave comes back from.
ABSORBING = "absorbing"

#: Given viscosity: a number, one along and one across the normal, or ABSORBING.
Viscosity = ArrayLike | str


@dataclass(frozen=True)
class Rayleigh:
    """Damping of the bodies, C = alpha M + beta K, in :func:`vmdg.solve_dynamics`.

    A mode of circular frequency omega has the damping ratio (alpha/omega + beta omega)/2. M is the
    mass matrix; K is that of the bodies without interfaces, so that what separates is not held
    back. At finite strain beta K is the viscosity beta F.dS/dt, S the second Piola-Kirchhoff
    stress: a body that turns is damped by alpha only.

    Args:
        alpha: Of the mass [1/s].
        beta: Of the stiffness [s].

    Raises:
        ValueError: one is not a number >= 0.
    """

    alpha: float = 0.0
    beta: float = 0.0

    def __post_init__(self) -> None:
        for name, value in (("alpha", self.alpha), ("beta", self.beta)):
            if isinstance(value, bool) or not isinstance(value, Real) or not 0 <= value < np.inf:
                raise ValueError(f"Rayleigh: {name} = {value!r} must be a number >= 0")


def checked_viscosity(viscosity: Viscosity) -> Viscosity:
    """A viscosity of :meth:`.Problem.spring`, two numbers or the word."""
    if isinstance(viscosity, str):
        if viscosity == ABSORBING:
            return viscosity
    else:
        values = np.asarray(viscosity)
        if values.shape in ((), (2,)) and values.dtype.kind in "iuf":
            if np.isfinite(values).all() and (values >= 0).all() and values.any():
                return np.broadcast_to(values.astype(float), 2)
    raise ValueError(
        f"spring: the viscosity {viscosity!r} must be a positive number, a pair (normal, "
        f"tangential), in MPa s/mm, or {ABSORBING!r}"
    )


class Damping:
    """Viscous forces of a problem."""

    def __init__(self, discretization: Discretization, density: fem.Function, rayleigh: Rayleigh):
        self.rayleigh = rayleigh
        self.dashpots: list[tuple[NDArray[np.int32], Viscosity]] = []
        self._discretization, self._density = discretization, density
        # Of the last step.
        self._before = fem.Function(discretization.space)
        self._per_time = fem.Constant(discretization.mesh, 1.0)

    @property
    def exists(self) -> bool:
        return bool(self.dashpots or self.rayleigh.alpha or self.rayleigh.beta)

    def refuse(self) -> None:
        """Refuse bodies whose viscosity beta F.dS/dt is not defined here."""
        bodies = self._discretization.bodies
        others = bodies.points is not None or bodies.mean_dilatation
        if self.rayleigh.beta and (others or self._discretization.means is not None):
            raise ValueError(
                "Problem: Rayleigh(beta=) damps hyperelastic bodies with pointwise volumetric "
                "strain, neither in periodic cells nor in generalized plane strain; with others "
                "use alpha alone, or the rate of the material"
            )

    @cached_property
    def _stiffness(self) -> tuple[fem.Form, fem.Form]:
        """beta F.(S - S_0)/h against GRAD eta, and its derivative by the displacement."""
        discretization, weak = self._discretization, self._discretization.weak_form
        F_0 = ufl.variable(discretization.geometry.deformation(self._before))

        def rate(body: Body, F: Expr) -> Expr:
            stress, first = (
                kinematics.bulk_stress(body, discretization.geometry, G) for G in (F, F_0)
            )
            if not body.small:
                first = ufl.dot(F, ufl.dot(ufl.inv(F_0), first))
            return ufl.inner(virtual, stress - first)

        virtual = discretization.geometry.gradient(ufl.TestFunction(discretization.space))
        form = self.rayleigh.beta * self._per_time * weak.over_bodies(rate)
        tangent = ufl.derivative(form, discretization.u, ufl.TrialFunction(discretization.space))
        return weak.compile(form, "damping", UNROLLED), weak.compile(tangent, "damping")

    def resist(self, before: NDArray[np.float64], h: float) -> NDArray[np.float64]:
        """Forces of beta K in a step to the current displacement, of owned dofs; collective [N].

        beta F.dS/dt, with the change of S in the step: nothing for a rotation, and no moment.
        """
        discretization = self._discretization
        if not self.rayleigh.beta:
            return np.zeros(discretization.owned)
        self._before.x.array[:] = before
        self._per_time.value = 1 / h
        forces = fem.Function(discretization.space).x
        fem.assemble_vector(forces.array, self._stiffness[0])
        forces.scatter_reverse(la.InsertMode.add)
        return forces.array[: discretization.owned]

    def tangent(self, matrix: PETSc.Mat) -> None:
        """Assemble the derivative of the last :meth:`resist` by the displacement; collective."""
        matrix.zeroEntries()
        fem_petsc.assemble_matrix(matrix, self._stiffness[1])
        matrix.assemble()

    def matrix(self, kind: PETSc.Mat.Type = PETSc.Mat.Type.AIJ) -> PETSc.Mat:
        """A new matrix of the dashpots, with moduli of the current displacement; collective."""
        discretization = self._discretization
        eta, v = ufl.TestFunction(discretization.space), ufl.TrialFunction(discretization.space)
        matrix, form = discretization.create_matrix(kind), self._dashpot_form(eta, v)
        if not form.empty():
            fem_petsc.assemble_matrix(matrix, discretization.weak_form.compile(form, "dashpots"))
        matrix.assemble()
        return matrix

    def _dashpot_form(self, eta: Expr, v: Expr) -> ufl.Form:
        """Forces of dashpots; of absorbing ones by the moduli next to them (Lysmer and Kuhlemeyer
        1969): rho c_p along the normal and rho c_s across."""
        discretization, mesh = self._discretization, self._discretization.mesh
        N, F = (
            ufl.FacetNormal(mesh),
            ufl.variable(discretization.geometry.deformation(discretization.u)),
        )
        rows, terms = [], []
        for facets, viscosity in self.dashpots:
            cells = boundary_rows(mesh, facets).reshape(-1, 2)
            for number, region in enumerate(discretization.bodies.regions):
                chosen = cells[discretization.bodies.region[cells[:, 0]] == number]
                rows.append((len(rows), chosen.ravel()))
                if isinstance(viscosity, str):
                    along, across = self._impedance(region.body, F, N)
                else:
                    along, across = (fem.Constant(mesh, float(c)) for c in np.ravel(viscosity))
                Z = surface.foundation(along, across, N)
                terms.append(discretization.geometry.weight * ufl.inner(eta, ufl.dot(Z, v)))
        ds = ufl.Measure(
            "ds",
            domain=mesh,
            subdomain_data=rows,
            metadata={"quadrature_degree": facet_degree(discretization.degree) + 1},
        )
        return sum((term * ds(i) for i, term in enumerate(terms)), start=ufl.Form([]))

    def _impedance(self, body: Body, F: Expr, N: Expr) -> tuple[Expr, Expr]:
        """rho c of waves along N that move along it, and, as a mean, across."""
        A, d = kinematics.acoustic_tensor(body.elastic, F), len(N)
        Q = [
            [sum(A[i, a, j, b] * N[a] * N[b] for a in range(d) for b in range(d)) for j in range(d)]
            for i in range(d)
        ]
        along = sum(N[i] * Q[i][j] * N[j] for i in range(d) for j in range(d))
        across = (sum(Q[i][i] for i in range(d)) - along) / (d - 1)
        return ufl.sqrt(self._density * along), ufl.sqrt(self._density * across)
