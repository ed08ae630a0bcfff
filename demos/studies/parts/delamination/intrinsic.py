"""The peer: a plain intrinsic cohesive zone on the same mesh, under the same control.

What most codes have: a bilinear law with an initial penalty stiffness K, integrated at the Gauss
points of interface elements, without any stabilization. Bodies and direct solver are those of vmdg;
damage work controls the path, with a step size that aims at the same number of iterations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter

from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from numpy.polynomial.legendre import leggauss
from numpy.typing import NDArray
from scipy.sparse import csr_array

import vmdg
from parts.delamination.beams import at, open_beam
from parts.delamination.laminate import ALFANO_CRISFIELD, Laminate
from parts.tables import markdown
from vmdg.linear.ksp import LDLT, make_ksp
from vmdg.meshes.beams import UPPER_LEFT

Array = NDArray[np.float64]

#: Relative to the largest force so far, and to the work of a step; iterations aimed at, and most.
TOLERANCE, MISSED, AIM, MOST = 1e-9, 1e-7, 4, 20


class Diverged(RuntimeError):
    """A step without an equilibrium."""


@dataclass(frozen=True)
class Bilinear:
    """T = (1 - d(kappa)) K g to a strength, then down to 0; K g_N in compression.

    Attributes:
        strength: [MPa].
        energy: Under the curve [N/mm].
        K: Stiffness before damage [MPa/mm].
    """

    strength: float
    energy: float
    K: float

    @property
    def gaps(self) -> tuple[float, float]:
        """Where damage begins and where the bond has gone [mm]."""
        return self.strength / self.K, 2 * self.energy / self.strength

    def spent(self, kappa: Array) -> Array:
        """Of the largest gaps so far [N/mm]."""
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
        worse = (size >= kappa) & (size > first)
        kappa = np.maximum(kappa, size)
        reached = np.clip(kappa, first, last)
        left = first * (last - reached) / (reached * (last - first))
        C = self.K * left[:, None, None] * np.eye(2)
        softens = worse & (kappa < last)
        direction = opened / np.maximum(size, 1e-300)[:, None]
        slope = np.where(softens, self.K * first * last / (reached**2 * (last - first)), 0.0)
        C -= slope[:, None, None] * size[:, None, None] * np.einsum("pi,pj->pij", *[direction] * 2)
        T, closed = self.K * left[:, None] * opened, g[:, 1] < 0
        T[closed, 1] = self.K * g[closed, 1]
        C[closed, 1, 1] = self.K
        rate = np.where(softens, self.energy / (last - first), 0.0)
        return T, C, kappa, rate[:, None] * direction


@dataclass
class Counts:
    """Work of a run."""

    failed: int = 0
    factorizations: int = 0
    solves: int = 0
    seconds: float = 0.0
    curve: list[tuple[float, float]] = field(default_factory=list)


class Interface:
    """Interface elements between coincident nodes of the two arms, on the line y = 0.

    Args:
        problem: Whose broken space has these nodes.
        degree: Of the displacement.
        start: x of the tip of the crack [mm].
    """

    def __init__(self, problem: vmdg.Problem, degree: int, start: float):
        x = problem.space.tabulate_dof_coordinates()
        at = (np.abs(x[:, 1]) < 1e-9) & (x[:, 0] > start - 1e-9)
        rows = []
        cells, dofs = problem.mesh.topology.connectivity(2, 0), problem.space.dofmap.list
        middle = x[dofs[: cells.num_nodes], 1].mean(axis=1)
        for side in (middle < 0, middle > 0):
            nodes = np.unique(dofs[side])
            nodes = nodes[at[nodes]]
            rows.append(nodes[np.argsort(x[nodes, 0])])
        count = (len(rows[0]) - 1) // degree
        local = degree * np.arange(count)[:, None] + np.arange(degree + 1)
        ends = x[rows[0][degree * np.arange(count + 1)], 0]
        # Points and shapes on (-1, 1), nodes in ascending order.
        points, weights = leggauss(degree + 1)
        nodes = np.linspace(-1, 1, degree + 1)
        shapes = np.array(
            [np.prod([(points - b) / (a - b) for b in nodes if b != a], axis=0) for a in nodes]
        )
        thickness = float(problem.discretization.geometry.thickness)
        self.weights = (np.diff(ends)[:, None] / 2 * weights * thickness).ravel()
        #: Dofs of every element (facets, n), and opening of them at its points (points, 2, n).
        self.dofs = np.hstack(
            [(2 * rows[side][local][:, :, None] + [0, 1]).reshape(count, -1) for side in (0, 1)]
        )
        one = np.einsum("ap,ij->piaj", shapes, np.eye(2)).reshape(len(points), 2, -1)
        self.B = np.concatenate([-one, one], axis=2)

    def opening(self, u: Array) -> Array:
        """At all points (n, 2) [mm]."""
        return np.einsum("pin,fn->fpi", self.B, u[self.dofs]).reshape(-1, 2)

    def gather(self, values: Array, size: int) -> Array:
        """Values at the points (n, 2), integrated, by dofs."""
        shaped = (self.weights[:, None] * values).reshape(len(self.dofs), -1, 2)
        each = np.einsum("pin,fpi->fn", self.B, shaped)
        return np.bincount(self.dofs.ravel(), weights=each.ravel(), minlength=size)

    def stiffness(self, C: Array) -> Array:
        """Matrices of the elements (facets, n, n)."""
        weighted = (self.weights[:, None, None] * C).reshape(len(self.dofs), -1, 2, 2)
        return np.einsum("pin,fpij,pjm->fnm", self.B, weighted, self.B, optimize=True)


class Assembly:
    """One matrix of bodies and interface elements, with a one for every prescribed dof.

    Args:
        bodies: Their stiffness [N/mm].
        dofs: Of the elements (facets, n).
        free: Whether a dof is not prescribed.

    Attributes:
        matrix: PETSc's.
    """

    def __init__(self, bodies: csr_array, dofs: NDArray[np.int32], free: NDArray[np.bool_]):
        n, size, found = dofs.shape[1], len(free), bodies.tocoo()
        rows = [found.row, np.repeat(dofs, n, axis=1).ravel(), np.arange(size)]
        columns = [found.col, np.tile(dofs, (1, n)).ravel(), np.arange(size)]
        row, column = np.concatenate(rows), np.concatenate(columns)
        self._kept = free[row] & free[column]
        self._kept[-size:] = ~free
        flat = row[self._kept].astype(np.int64) * size + column[self._kept]
        place, self._to = np.unique(flat, return_inverse=True)
        self._values, self._ones = found.data, np.ones(size)
        starts = np.searchsorted(place // size, np.arange(size + 1)).astype(np.int32)
        self._csr = starts, (place % size).astype(np.int32)
        self.matrix = PETSc.Mat().createAIJ(size, csr=(*self._csr, np.zeros(len(place))))
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)

    def __call__(self, elements: Array) -> PETSc.Mat:
        """The matrix with these elements (facets, n, n) [N/mm]."""
        values = np.concatenate([self._values, elements.ravel(), self._ones])[self._kept]
        self.matrix.setValuesCSR(*self._csr, np.bincount(self._to, weights=values))
        self.matrix.assemble()
        return self.matrix


class Peer:
    """The model, of linear bodies.

    Args:
        problem: Of vmdg, for mesh and space.
        m: The laminate.
        moved: Prescribed dofs and their displacement a unit of load (n,), (n,).
        start: x of the tip of the crack [mm].
        degree: Of the displacement.
        K: Stiffness of the bond [MPa/mm].
    """

    def __init__(
        self,
        problem: vmdg.Problem,
        m: Laminate,
        moved: tuple[NDArray[np.int32], Array],
        start: float,
        degree: int,
        K: float,
    ):
        self.law = Bilinear(m.strength, m.G_I, K)
        self.interface = Interface(problem, degree, start)
        self._bodies = _bodies(problem.space, m)
        self.size = self._bodies.shape[0]
        self._fixed = moved[0]
        self._free = np.ones(self.size, dtype=bool)
        self._free[self._fixed] = False
        self._assembly = Assembly(self._bodies, self.interface.dofs, self._free)
        self._ksp = make_ksp(self._assembly.matrix, LDLT)
        self._moved = np.zeros(self.size)
        self._moved[self._fixed] = moved[1]
        # Forces of the bodies as their ends move.
        self._pull = np.where(self._free, self._bodies @ self._moved, 0.0)
        self.counts, self._largest = Counts(), 0.0

    def force(self, u: Array) -> float:
        """Conjugate to the load factor [N]."""
        return float(self._moved @ (self._bodies @ u))

    def _solve(self, C: Array, right: list[Array]) -> list[Array]:
        matrix = self._assembly(self.interface.stiffness(C))
        self._ksp.setOperators(matrix)
        self.counts.factorizations += 1
        x, b = matrix.createVecs()
        found = []
        for vector in right:
            b.array[:] = vector
            self._ksp.solve(b, x)
            self.counts.solves += 1
            found.append(x.array.copy())
        return found

    def step(self, start: tuple[Array, float], kappa: Array, work: float | None):
        """The equilibrium at a load factor, or after some work; u, t, kappa, iterations.

        Args:
            start: Predictor of u [mm] and load factor; the latter stays as it is without ``work``.
            kappa: Largest gaps before [mm].
            work: On bonds, or None [N mm].

        Raises:
            Diverged: there is none within the iterations allowed.
        """
        law, interface = self.law, self.interface
        spent = interface.weights @ law.spent(kappa)
        u, t = start
        for iteration in range(MOST + 1):
            T, C, new, rate = law(interface.opening(u), kappa)
            forces = self._bodies @ u + interface.gather(T, self.size)
            residual = np.where(self._free, forces, 0.0)
            miss = 0.0 if work is None else interface.weights @ law.spent(new) - spent - work
            self._largest = max(self._largest, np.abs(forces[self._fixed]).max())
            if not np.isfinite(residual).all():
                break
            small = np.linalg.norm(residual) <= TOLERANCE * self._largest
            if small and iteration and (work is None or abs(miss) <= MISSED * work):
                return u, t, new, iteration
            if iteration == MOST:
                break
            du, along = self._solve(C, [-residual, -self._pull])
            dt = 0.0
            if work is not None:
                gradient = interface.gather(rate, self.size)
                slope = gradient @ (along + self._moved)
                if slope == 0:
                    break
                dt = -(miss + gradient @ du) / slope
            u, t = u + du + dt * (along + self._moved), t + dt
        raise Diverged

    def run(self, loads: list[float], share: float = 0.1) -> Counts:
        """Load factors until the first damage, then by the damage work until the last of them.

        Args:
            loads: Load factors.
            share: Of all bonds, that a step breaks at most.

        Raises:
            Diverged: 20 ever smaller attempts of a step have failed, as they do where facets are
                too long for the process zone.
        """
        begin = perf_counter()
        law, interface, counts = self.law, self.interface, self.counts
        u, t, kappa = np.zeros(self.size), 0.0, np.zeros(len(interface.weights))
        most, work, last = share * law.energy * interface.weights.sum(), 0.0, (u, 0.0, 0.0)
        ahead, cuts = list(loads), 0
        while t < loads[-1] * (1 - 1e-12):
            # The last change once more; after a failure from where the path is.
            scale = ahead[0] - t
            if work:
                scale = 0.0 if cuts else work / last[2]
            change = last if work else (self._moved, 1.0)
            try:
                found = self.step(
                    (u + scale * change[0], t + scale * change[1]), kappa, work or None
                )
            except Diverged:
                counts.failed, cuts = counts.failed + 1, cuts + 1
                if cuts > 20:
                    raise
                if work:
                    work /= 4
                else:
                    ahead.insert(0, (t + ahead[0]) / 2)
                continue
            cuts = 0
            spent = interface.weights @ (law.spent(found[2]) - law.spent(kappa))
            last = found[0] - u, found[1] - t, spent
            u, t, kappa, iterations = found
            counts.curve.append((t, self.force(u)))
            if spent > 0:
                work = min(min(AIM / iterations, 2.0) * spent, most)
            else:
                ahead.pop(0)
        counts.seconds = perf_counter() - begin
        return counts


def _bodies(space: fem.FunctionSpace, m: Laminate) -> csr_array:
    """Stiffness of the bodies [N/mm]."""
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    w = fem.Function(space)

    def strain(field) -> ufl.core.expr.Expr:
        e = ufl.sym(ufl.grad(field))
        return ufl.as_matrix([[e[0, 0], e[0, 1], 0], [e[1, 0], e[1, 1], 0], [0, 0, 0]])

    energy = m.b * m.material.linear_energy(strain(w), dict(m.material.parameters)) * ufl.dx
    form = fem.form(ufl.derivative(ufl.derivative(energy, w, v), w, u))
    return csr_array(fem.assemble_matrix(form).to_scipy())


@dataclass(frozen=True)
class Line:
    """One line of the comparison.

    Attributes:
        name: Who.
        stiffness: Before damage [N/mm].
        peak: Largest load [N].
        load: At the last opening [N].
        rows, failed, factorizations, solves, seconds: Work.
    """

    name: str
    stiffness: float
    peak: float
    load: float
    rows: int
    failed: int
    factorizations: int
    solves: int
    seconds: float


def peer(problem: vmdg.Problem, m: Laminate, start: float, degree: int, K: float) -> Peer:
    """The peer of a problem of ``beams.open_beam``.

    Raises:
        RuntimeError: The problem is on several ranks: the peer factorizes on one.
    """
    if problem.comm.size > 1:
        raise RuntimeError("the peer runs on one rank: leave -n out")
    x = problem.space.tabulate_dof_coordinates()
    ends = [np.flatnonzero(at(0.0, sign * m.h)(x.T)) for sign in (-1, 1)]
    right = np.flatnonzero(np.isclose(x[:, 0], x[:, 0].max()))
    dofs = np.concatenate([2 * ends[0] + 1, 2 * ends[1] + 1, 2 * right, 2 * right + 1])
    moved = np.zeros(len(dofs))
    moved[:2] = -0.5, 0.5
    return Peer(problem, m, (dofs, moved), start, degree, K)


def side_by_side(
    element_size: float = 0.0625,
    stiffnesses: Sequence[float] = (1e4, 1e5, 1e6, 1e7),
    share: float = 0.01,
    end: float = 6.0,
    verbose: bool = False,
) -> tuple[float, list[Line]]:
    """vmdg and the peer with several K on the mesh of the DCB of Alfano and Crisfield; one rank.

    Args:
        element_size: Of facets [mm].
        stiffnesses: K [MPa/mm].
        share: Of all bonds, that a step breaks at most.
        end: Last opening [mm].
        verbose: Print the residuals of every step of vmdg.

    Returns:
        Stiffness of bonded arms on a mesh of degree 2 [N/mm]; the lines.
    """
    m, a_0, length, fine = ALFANO_CRISFIELD, 30.0, 100.0, 59.0
    loads = [end / 1000, *np.linspace(end / 40, end, 40)]

    def line(name: str, curve: Array, *work) -> Line:
        opening, force = np.transpose(curve)
        at_end = np.interp(end, opening, force)
        return Line(name, force[0] / opening[0], force.max(), float(at_end), len(curve), *work)

    smooth, _ = open_beam(4 * element_size, 4, 2, m, length, a_0, fine)
    bonded = peer(smooth, m, a_0, 2, 1e9).run(loads[:1]).curve[0]
    problem, facets = open_beam(element_size, 3, 1, m, length, a_0, fine)
    problem.discretization.compile()
    lines, begin = [], perf_counter()
    upper = facets.find(UPPER_LEFT)
    result = vmdg.solve(
        problem,
        [loads[0], end],
        vmdg.SolveOptions(control="dissipation", max_share=share, verbose=verbose),
        lambda problem: {"force": problem.reaction(upper)[1]},
    )
    seconds, counts = perf_counter() - begin, result.counts
    curve = np.column_stack([result.history["load"], result.history["force"]])
    work = len(result.failures), counts.factorizations, counts.solves, seconds
    lines.append(line("vmdg", curve, *work))
    for K in stiffnesses:
        done = peer(problem, m, a_0, 1, K).run(loads, share)
        work = done.failed, done.factorizations, done.solves, done.seconds
        lines.append(line(f"intrinsic, K = {K:.0e} MPa/mm", np.array(done.curve), *work))
    return bonded[1] / bonded[0], lines


def table(bonded: float, lines: Sequence[Line]) -> str:
    """Markdown."""
    head = ["", "stiffness [N/mm]", "peak [N]", "load at the end [N]"]
    return markdown(
        [*head, "rows", "failed", "factorizations", "solves", "s"],
        [
            (
                one.name,
                f"{one.stiffness:.2f} ({100 * (one.stiffness / bonded - 1):+.1f} %)",
                *(f"{one.peak:.2f}", f"{one.load:.2f}", one.rows, one.failed),
                *(one.factorizations, one.solves, f"{one.seconds:.1f}"),
            )
            for one in lines
        ],
    )
