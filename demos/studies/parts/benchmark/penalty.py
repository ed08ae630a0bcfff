"""A plain penalty law on the mesh of a double cantilever beam, under the same control.

What most codes have: a bilinear law with an initial stiffness K, T = K g, integrated at the Gauss
points of interface elements, without stabilization. Bodies, matrix and direct solver are those of
vmdg; the damage work controls the path, with steps that aim at the same number of iterations.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from parts.delamination.beams import at
from parts.delamination.laminate import Laminate
from scipy.sparse import csr_array

import vmdg
from vmdg.linear.ksp import LDLT, make_ksp

Array = NDArray[np.float64]

#: Of the residual relative to the largest force so far, of the work relative to that of a step;
#: iterations aimed at, and most.
TOLERANCE, MISSED, AIM, MOST = 1e-9, 1e-7, 4, 20


class Diverged(RuntimeError):
    """A step without an equilibrium."""


@dataclass(frozen=True)
class Bilinear:
    """T = (1 - d) K g up to the strength, then down to 0 at 2 G/strength; K g_N in compression.

    Attributes:
        strength: [MPa].
        energy: G, under the curve [N/mm].
        K: [MPa/mm].
    """

    strength: float
    energy: float
    K: float

    @property
    def gaps(self) -> tuple[float, float]:
        """Where damage begins and where the bond has gone [mm]."""
        return self.strength / self.K, 2 * self.energy / self.strength

    def spent(self, kappa: Array) -> Array:
        """Energy of the largest gaps so far [N/mm]."""
        first, last = self.gaps
        return self.energy * (np.clip(kappa, first, last) - first) / (last - first)

    def __call__(self, g: Array, kappa: Array) -> tuple[Array, Array, Array, Array]:
        """Traction (n, 2), tangent (n, 2, 2), largest gap (n,) and d spent/dg (n, 2).

        Args:
            g: Opening, tangential and normal (n, 2) [mm].
            kappa: Largest gap at the start of the step (n,) [mm].
        """
        first, last = self.gaps
        opened = np.column_stack([g[:, 0], np.maximum(g[:, 1], 0.0)])
        size = np.linalg.norm(opened, axis=1)
        softens = (size >= kappa) & (size > first)
        kappa = np.maximum(kappa, size)
        softens &= kappa < last
        reached = np.clip(kappa, first, last)
        left = first * (last - reached) / (reached * (last - first))
        C = self.K * left[:, None, None] * np.eye(2)
        n = opened / np.maximum(size, 1e-300)[:, None]
        slope = np.where(softens, self.K * first * last / (reached**2 * (last - first)), 0.0)
        C -= (slope * size)[:, None, None] * n[:, :, None] * n[:, None, :]
        T, closed = self.K * left[:, None] * opened, g[:, 1] < 0
        T[closed, 1] = self.K * g[closed, 1]
        C[closed, 1, 1] = self.K
        rate = np.where(softens, self.energy / (last - first), 0.0)
        return T, C, kappa, rate[:, None] * n


class Elements:
    """Interface elements between coincident nodes of the two arms, on the line y = 0.

    Args:
        problem: Whose broken space has these nodes.
        degree: Of the displacement.
        start: x of the tip of the crack [mm].

    Attributes:
        weights: Areas of the points (n,) [mm²].
        dofs: Of every element (facets, m).
    """

    def __init__(self, problem: vmdg.Problem, degree: int, start: float):
        x = problem.space.tabulate_dof_coordinates()
        bonded = (np.abs(x[:, 1]) < 1e-9) & (x[:, 0] > start - 1e-9)
        cells, dofs = problem.mesh.topology.connectivity(2, 0), problem.space.dofmap.list
        middle = x[dofs[: cells.num_nodes], 1].mean(axis=1)
        rows = []
        for side in (middle < 0, middle > 0):
            nodes = np.unique(dofs[side])
            nodes = nodes[bonded[nodes]]
            rows.append(nodes[np.argsort(x[nodes, 0])])
        count = (len(rows[0]) - 1) // degree
        local = degree * np.arange(count)[:, None] + np.arange(degree + 1)
        ends = x[rows[0][degree * np.arange(count + 1)], 0]
        points, weights = leggauss(degree + 1)
        nodes = np.linspace(-1, 1, degree + 1)
        shapes = [np.prod([(points - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes]
        thickness = float(problem.discretization.geometry.thickness)
        self.weights = (np.diff(ends)[:, None] / 2 * weights * thickness).ravel()
        self.dofs = np.hstack(
            [(2 * row[local][:, :, None] + [0, 1]).reshape(count, -1) for row in rows]
        )
        one = np.einsum("ap,ij->piaj", shapes, np.eye(2)).reshape(len(points), 2, -1)
        self._B = np.concatenate([-one, one], axis=2)

    def opening(self, u: Array) -> Array:
        """At all points (n, 2) [mm]."""
        return np.einsum("pin,fn->fpi", self._B, u[self.dofs]).reshape(-1, 2)

    def integrated(self, values: Array, size: int) -> Array:
        """Of values at the points (n, 2), by dofs (size,)."""
        shaped = (self.weights[:, None] * values).reshape(len(self.dofs), -1, 2)
        each = np.einsum("pin,fpi->fn", self._B, shaped)
        return np.bincount(self.dofs.ravel(), weights=each.ravel(), minlength=size)

    def stiffness(self, C: Array) -> Array:
        """Matrices of the elements (facets, m, m) [N/mm]."""
        weighted = (self.weights[:, None, None] * C).reshape(len(self.dofs), -1, 2, 2)
        return np.einsum("pin,fpij,pjm->fnm", self._B, weighted, self._B, optimize=True)


class Matrix:
    """The tangent of bodies and elements, with a one for every prescribed dof.

    Args:
        bodies: Their stiffness [N/mm].
        dofs: Of the elements (facets, m).
        free: Whether a dof is not prescribed.
    """

    def __init__(self, bodies: csr_array, dofs: NDArray[np.int32], free: NDArray[np.bool_]):
        m, size, found = dofs.shape[1], len(free), bodies.tocoo()
        row = np.concatenate([found.row, np.repeat(dofs, m, axis=1).ravel(), np.arange(size)])
        column = np.concatenate([found.col, np.tile(dofs, (1, m)).ravel(), np.arange(size)])
        self._kept = free[row] & free[column]
        self._kept[-size:] = ~free
        flat = row[self._kept].astype(np.int64) * size + column[self._kept]
        place, self._to = np.unique(flat, return_inverse=True)
        self._bodies, self._ones = found.data, np.ones(size)
        starts = np.searchsorted(place // size, np.arange(size + 1)).astype(np.int32)
        self._csr = starts, (place % size).astype(np.int32)
        self.petsc = PETSc.Mat().createAIJ(size, csr=(*self._csr, np.zeros(len(place))))
        self.petsc.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def fill(self, elements: Array) -> PETSc.Mat:
        """The matrix with these elements (facets, m, m) [N/mm]."""
        values = np.concatenate([self._bodies, elements.ravel(), self._ones])[self._kept]
        self.petsc.setValuesCSR(*self._csr, np.bincount(self._to, weights=values))
        self.petsc.assemble()
        return self.petsc


@dataclass
class Work:
    """Work of a run, and its curve of load factor and force."""

    failed: int = 0
    factorizations: int = 0
    curve: list[tuple[float, float]] = field(default_factory=list)


class Penalty:
    """The beam of ``beams.open_beam`` with the law in place of the bond; one rank.

    Args:
        problem: Of vmdg, for mesh and space.
        m: The laminate.
        start: x of the tip of the crack [mm].
        degree: Of the displacement.
        K: Of the law [MPa/mm].
    """

    def __init__(self, problem: vmdg.Problem, m: Laminate, start: float, degree: int, K: float):
        self.law = Bilinear(m.strength, m.G_I, K)
        self.elements = Elements(problem, degree, start)
        self._bodies = _stiffness(problem.space, m)
        self.size, self.work, self._largest = self._bodies.shape[0], Work(), 0.0
        x = problem.space.tabulate_dof_coordinates()
        ends = [np.flatnonzero(at(0.0, sign * m.h)(x.T)) for sign in (-1, 1)]
        right = np.flatnonzero(np.isclose(x[:, 0], x[:, 0].max()))
        self._fixed = np.concatenate([2 * ends[0] + 1, 2 * ends[1] + 1, 2 * right, 2 * right + 1])
        self._free = np.ones(self.size, dtype=bool)
        self._free[self._fixed] = False
        self._matrix = Matrix(self._bodies, self.elements.dofs, self._free)
        self._ksp = make_ksp(self._matrix.petsc, LDLT)
        self._moved = np.zeros(self.size)
        self._moved[self._fixed[:2]] = -0.5, 0.5
        # Forces of the bodies as their ends move.
        self._pull = np.where(self._free, self._bodies @ self._moved, 0.0)

    def _solve(self, C: Array, right: list[Array]) -> list[Array]:
        self._ksp.setOperators(matrix := self._matrix.fill(self.elements.stiffness(C)))
        self.work.factorizations += 1
        x, b = matrix.createVecs()
        found = []
        for vector in right:
            b.array[:] = vector
            self._ksp.solve(b, x)
            found.append(x.array.copy())
        return found

    def step(self, u: Array, t: float, kappa: Array, work: float):
        """The equilibrium at a load factor, or after some work; u, t, kappa, iterations.

        Args:
            u: Predictor [mm].
            t: That of the load factor, which it keeps without ``work``.
            kappa: Largest gaps before [mm].
            work: On bonds; 0 for a step by load [N mm].

        Raises:
            Diverged: there is none within the iterations allowed.
        """
        law, elements = self.law, self.elements
        spent = elements.weights @ law.spent(kappa)
        for iteration in range(MOST + 1):
            T, C, new, rate = law(elements.opening(u), kappa)
            forces = self._bodies @ u + elements.integrated(T, self.size)
            residual = np.where(self._free, forces, 0.0)
            miss = elements.weights @ law.spent(new) - spent - work if work else 0.0
            self._largest = max(self._largest, np.abs(forces[self._fixed]).max())
            small = np.linalg.norm(residual) <= TOLERANCE * self._largest
            if small and iteration and abs(miss) <= MISSED * work:
                return u, t, new, iteration
            if iteration == MOST or not np.isfinite(residual).all():
                break
            du, along = self._solve(C, [-residual, -self._pull])
            along, dt = along + self._moved, 0.0
            if work:
                gradient = elements.integrated(rate, self.size)
                if (slope := gradient @ along) == 0:
                    break
                dt = -(miss + gradient @ du) / slope
            u, t = u + du + dt * along, t + dt
        raise Diverged

    def run(self, loads: list[float], share: float = 0.1) -> Work:
        """Load factors until the first damage, then by the damage work until the last of them.

        Args:
            share: Of all bonds, that a step breaks at most.

        Raises:
            Diverged: 20 ever smaller attempts of a step have failed.
        """
        law, weights, done = self.law, self.elements.weights, self.work
        u, t, kappa = np.zeros(self.size), 0.0, np.zeros(len(weights))
        most, work, last = share * law.energy * weights.sum(), 0.0, (u, 0.0, 0.0)
        ahead, cuts = list(loads), 0
        while t < loads[-1] * (1 - 1e-12):
            # The last change once more; after a failure from where the path is.
            scale = (0.0 if cuts else work / last[2]) if work else ahead[0] - t
            way = last if work else (self._moved, 1.0)
            try:
                found = self.step(u + scale * way[0], t + scale * way[1], kappa, work)
            except Diverged:
                done.failed, cuts, work = done.failed + 1, cuts + 1, work / 4
                if cuts > 20:
                    raise
                if not work:
                    ahead.insert(0, (t + ahead[0]) / 2)
                continue
            spent = weights @ (law.spent(found[2]) - law.spent(kappa))
            last, cuts = (found[0] - u, found[1] - t, spent), 0
            u, t, kappa, iterations = found
            done.curve.append((t, float(self._moved @ (self._bodies @ u))))
            if spent > 0:
                work = min(min(AIM / iterations, 2.0) * spent, most)
            else:
                ahead.pop(0)
        return done


def _stiffness(space: fem.FunctionSpace, m: Laminate) -> csr_array:
    """Stiffness of the bodies [N/mm]."""
    u, v, w = ufl.TrialFunction(space), ufl.TestFunction(space), fem.Function(space)

    def strain(field) -> ufl.core.expr.Expr:
        e = ufl.sym(ufl.grad(field))
        return ufl.as_matrix([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, 0]])

    energy = m.b * m.material.linear_energy(strain(w), dict(m.material.parameters)) * ufl.dx
    form = fem.form(ufl.derivative(ufl.derivative(energy, w, v), w, u))
    return csr_array(fem.assemble_matrix(form).to_scipy())
