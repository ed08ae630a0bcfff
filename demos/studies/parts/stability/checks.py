"""Checks of the state in which a stress run ended, independent of what the solver reports.

Each check returns descriptions of what is wrong; an empty list is a pass. Points are examined in
the frame of the law: zeta~ = R^T.zeta, T~ = R^T.T. Tolerances are those of the solver, or a bound
of rounding where that is larger.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property

from petsc4py import PETSc

import basix
import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from parts.stability.scenes import Array, Case

import vmdg

EPS = np.finfo(float).eps

#: Residual relative to the reactions that no solution may exceed, and deviation from a closed form.
LOOSE, EXACT = 1e-6, 1e-6

#: Laws whose resistance follows from the length of the gap.
RADIAL = (vmdg.Debonding, vmdg.ExponentialDebonding, vmdg.Contact)

#: Share of the bulk energy by which that of a finite deformation may differ from the quadratic form
#: of its tangent.
NONLINEAR = 0.05


@dataclass(frozen=True)
class Record:
    """A converged state, as it was reported."""

    t: float  # Load factor
    u: Array  # Displacement
    forces: Array  # Internal minus external forces
    prescribed: NDArray[np.int32]  # Prescribed dofs
    softening: list[Array]  # Q of every interface
    weights: list[Array]  # dA of its points
    gap: list[Array]  # zeta~ of every interface
    traction: list[Array]  # T~ of every interface
    energy: vmdg.Energy  # Energies
    reactions: list[Array]  # Of every support (d,), of all ranks

    @classmethod
    def of(cls, problem: vmdg.Problem, case: Case) -> Record:
        states = problem.state
        return cls(
            problem.t,
            problem.u.x.array.copy(),
            problem.discretization.forces.x.array.copy(),
            problem.loading.prescribed,
            [state.softening.copy() for state in states],
            [state.weights.copy() for state in states],
            [in_frame(state.gap, state.rotation) for state in states],
            [in_frame(state.traction, state.rotation) for state in states],
            problem.energy(),
            [problem.reaction(s.where) for s in case.supports],
        )


@dataclass
class Run:
    """A run that has ended, converged or not."""

    case: Case  # What was to be done
    problem: vmdg.Problem  # In its last converged state
    records: list[Record]  # The start and all converged states
    history: vmdg.History = field(default_factory=vmdg.History)  # The table of the run
    stopped: str = ""  # Message of the error that ended it early; "" where it got to the end
    # Load factor and reason of every step that had to be cut
    failures: list[tuple[float, str]] = field(default_factory=list)
    residuals: int = 0  # Assembled in all of its solves

    @property
    def force(self) -> float:
        """Largest force of the run [N]: the norm of the reactions."""
        return max(float(np.linalg.norm(r.forces[r.prescribed])) for r in self.records)

    @property
    def unsettled(self) -> bool:
        """Whether facets may have opened on demand since the last step: bonded, not balanced."""
        return bool(self.stopped) and self.case.on_demand

    @cached_property
    def new(self) -> vmdg.Problem:
        """A new problem with displacement, history and frozen penalties of the run, zeta constant.

        Facets that have opened on demand are interfaces there; all others are not.
        """
        problem = self.problem
        active = problem.discretization.active

        def frozen(i: int) -> Callable | None:
            if i not in active or active[i].facets.paired:
                return None
            stabilization = problem.stabilization[i]
            return lambda tau1, tau2, context: (stabilization.tau, stabilization.delta[:, 0])

        stabilizations = tuple(frozen(i) for i in range(len(self.case.bonds)))
        opened = tuple(
            active[i].facets.facets if i in active else None for i in range(len(self.case.bonds))
        )
        new = self.case.problem(stabilizations, opened)
        for i, mine in new.discretization.active.items():
            theirs = active[i]
            past = theirs.history
            mine.history = replace(mine.history, gap=past.gap, softening=past.softening)
        new.u.x.array[:] = problem.u.x.array
        for i, mine in new.discretization.active.items():
            if mine.facets.paired:
                mine.return_to(active[i].snapshot())
        new.loading.move(problem.t)
        if bodies := new.discretization.bodies.points:
            bodies.take(problem.discretization.bodies.points.state)
        new.step.assemble_residual(hold=True)
        return new

    @property
    def laws(self) -> list[vmdg.Law]:
        """Laws of the interfaces at their points, whose parameters may be arrays."""
        active = self.problem.discretization.active
        return [
            active[i].law if i in active else bond.law for i, bond in enumerate(self.case.bonds)
        ]

    def faults(self) -> list[str]:
        return [fault for check in CHECKS for fault in check(self)]

    @cached_property
    def rounding(self) -> float:
        """Bound of the rounding of nodal forces [N]: eps |K| times the size of the body."""
        matrix = self.new.discretization.create_matrix()
        self.new.discretization.assemble_tangent(matrix, damage=False)
        result = EPS * self.reach * matrix.norm(PETSc.NormType.NORM_INFINITY)
        matrix.destroy()
        return result

    @property
    def reach(self) -> float:
        """Size of the body and its largest displacement together [mm]."""
        return np.linalg.norm(self.case.mesh.size) + np.abs(self.problem.u.x.array).max()

    @property
    def tolerance(self) -> float:
        """Of nodal forces [N]: that of the solver, and never more than LOOSE of the reactions."""
        asked = 10 * self.case.options.relative_tolerance * self.problem.step.scales.force
        return min(asked, LOOSE * self.force) + 10 * self.rounding


def in_frame(vectors: Array, rotation: Array) -> Array:
    """R^T.v at many points."""
    return np.einsum("pji,pj->pi", rotation, vectors)


def finite(run: Run) -> list[str]:
    """No NaN and no infinity in any state or in the table."""
    arrays = [
        *(a for r in run.records for a in (r.u, r.forces, *r.softening, *r.gap, *r.traction)),
        *([*vars(r.energy).values()] for r in run.records),
        *(run.history[name] for name in run.history.columns),
        run.problem.u.x.array,
    ]
    return ["a value is not finite"] * (not all(np.isfinite(a).all() for a in arrays))


def at_last_record(run: Run) -> list[str]:
    """The problem is in the state that was reported last, to the last bit.

    A step that failed may have opened facets on demand: all of them are intact.
    """
    now, last = Record.of(run.problem, run.case), run.records[-1]
    if len(now.u) > len(last.u):
        held = np.allclose([*vars(now.energy).values()], [*vars(last.energy).values()], rtol=1e-9)
        intact = now.t == last.t and held
        return ["opening facets has changed the state"] * (not intact)
    same = (
        now.t == last.t
        and np.array_equal(now.u, last.u)
        and np.array_equal(now.forces, last.forces)
        and all(map(np.array_equal, now.softening, last.softening))
        and all(map(np.array_equal, now.gap, last.gap))
        and all(map(np.array_equal, now.traction, last.traction))
    )
    return ["the problem is not in its last converged state"] * (not same)


def equilibrium(run: Run) -> list[str]:
    """Forces of a new assembly vanish at free nodes, balance as a whole, and are those reported."""
    if run.unsettled:
        return []
    new, limit = run.new, run.tolerance
    forces, d = new.discretization.forces.x.array, run.case.mesh.d
    free = np.setdiff1d(np.arange(len(forces)), new.loading.prescribed)
    found = []
    if (left := np.linalg.norm(forces[free])) > limit:
        found.append(f"residual {left:.2e} N of {run.force:.2e} N")
    if (off := np.abs(forces - run.problem.discretization.forces.x.array).max()) > limit:
        found.append(f"reported forces are off by {off:.2e} N")
    axes = slice(1, None) if run.case.symmetry else slice(None)
    total = (forces.reshape(-1, d).sum(axis=0) + run.case.load(run.problem.t))[axes]
    if (sum_ := np.abs(total).max()) > limit:
        found.append(f"forces add up to {sum_:.2e} N of {run.force:.2e} N")
    if _balances_moments(run.case):
        x = new.space.tabulate_dof_coordinates()[:, :d] + run.problem.u.x.array.reshape(-1, d)
        products = np.einsum("ni,nj->ij", x, forces.reshape(-1, d))
        moment = np.abs(products - products.T).max()
        if moment > limit * np.abs(x).max():
            found.append(f"moments add up to {moment:.2e} N mm")
    return found


def _balances_moments(case: Case) -> bool:
    """Whether reactions alone must, and the form does not change under rotations.

    A tensor tau_s would stay behind a body that turns, and so do the moduli of the start of the
    step, with which the adjoint term of bodies at points is made.
    """
    if any(isinstance(material, vmdg.PointMaterial) for material in case.materials.values()):
        return False
    turning = all(bond.law.inelastic for bond in case.bonds) and case.kinematics == "finite"
    return turning and case.symmetry is None and case.traction is None


def positive_volume(run: Run) -> list[str]:
    """No cell is inverted: det F > 0 wherever the bulk is integrated."""
    if run.case.kinematics == "small":
        return []
    problem, d = run.problem, run.case.mesh.d
    cell = problem.mesh.basix_cell()
    points, _ = basix.make_quadrature(cell, 2 * run.case.degree + 1)
    F = ufl.Identity(d) + ufl.grad(problem.u)
    volume = ufl.det(F)
    if run.case.symmetry:
        volume *= 1 + problem.u[0] / ufl.SpatialCoordinate(problem.mesh)[0]
    cells = np.arange(problem.mesh.topology.index_map(d).size_local, dtype=np.int32)
    J = fem.Expression(volume, points).eval(problem.mesh, cells)
    return [f"det F = {J.min():.2e}"] * bool(J.min() <= 0)


def admissible(run: Run) -> list[str]:
    """Tractions lie in the set that law and history allow, and gaps obey contact."""
    if run.unsettled:
        return []
    found = []
    new = run.new
    for i, active in new.discretization.active.items():
        law, state, stabilization = run.laws[i], new.state[i], run.problem.stabilization[i]
        if not law.inelastic:
            continue
        if law.viscosity > 0 and run.stopped:
            continue  # overstress, until it has relaxed
        r = stabilization.norm[active.quadrature.facet]
        if not law.admissible(r).all():
            found.append(
                f"r = {r.min():.3g} does not exceed H = {np.max(law.softening_modulus):.3g}"
            )
            continue
        here = slice(len(r))  # then follow facets whose points have lost their partners
        R = state.rotation[here]
        points = Points(
            law,
            state.normal[here],
            in_frame(state.gap[here], R),
            in_frame(state.traction[here], R),
            state.softening[here],
            r,
            1e-9 * law.strength + 100 * EPS * r * run.reach + _flux_rounding(run),
        )
        found += [*history_in_range(points), *fixed_point(points), *criterion(points)]
    return found


def _flux_rounding(run: Run) -> float:
    """Rounding of {P.N}, gradients of cells as thin as they come [MPa]."""
    thinnest = min(np.diff(line).min() for line in run.case.mesh.lines)
    return 100 * EPS * stiffest(run) * run.reach / thinnest


def stiffest(run: Run) -> float:
    """Largest modulus of confined tension [MPa]."""
    return max(map(_confined, run.case.materials.values()))


def _confined(material: vmdg.Material) -> float:
    values = material.parameters
    if isinstance(material, vmdg.Ogden):
        shear = sum(values[f"c{a + 1}"] for a in range(material.terms)) / 2
        return values["kappa"] + 4 / 3 * shear
    if isinstance(material, vmdg.Orthotropic):
        return max(values.values())
    return values["lmbda"] + 2 * values["mu"]


@dataclass(frozen=True)
class Points:
    """Converged points of one interface that can fail, in the frame of the law."""

    law: vmdg.Law  # The law
    normal: Array  # N (n, d)
    gap: Array  # zeta~ (n, d) [mm]
    traction: Array  # T~ (n, d) [MPa]
    softening: Array  # Q (n,) [MPa]
    penalty: Array  # r (n,) [MPa/mm]
    tolerance: Array  # Of tractions (n,) [MPa]

    def split(self, vectors: Array) -> tuple[Array, Array]:
        """Normal component and length of the rest (n,)."""
        normal = np.einsum("pi,pi->p", vectors, self.normal)
        return normal, np.linalg.norm(vectors - normal[:, None] * self.normal, axis=1)


def history_in_range(points: Points) -> list[str]:
    """0 <= Q <= strength, no negative normal gap, and no gap without the damage it takes."""
    law, Q = points.law, points.softening
    gap, _ = points.split(points.gap)
    small = points.tolerance / points.penalty
    found = []
    if not ((Q >= 0) & (Q <= law.strength)).all():
        found.append(f"Q in [{Q.min():.3e}, {Q.max():.3e}], strength {np.max(law.strength):.3e}")
    if (gap < -small).any():
        found.append(f"zeta.N = {gap.min():.3e}")
    if isinstance(law, vmdg.Debonding):
        whole = Q < law.strength
        length = np.linalg.norm(points.gap, axis=1)
        excess = law.softening_modulus * (length - small) - Q
        if ((excess > 1e-9 * law.strength) & whole).any():
            found.append(f"a bond left with |zeta| = {length[whole].max():.3e}")
    return found


def fixed_point(points: Points) -> list[str]:
    """Mapped back once more from its end, a point stays where it is."""
    again = points.law.return_map(
        points.traction, points.normal, points.gap, points.softening, points.penalty, np.inf
    )
    moved = np.linalg.norm(again.gap - points.gap, axis=1) * points.penalty
    # Close to r = H the map magnifies what is left over by r / (r - H).
    magnified = points.penalty / (points.penalty - points.law.softening_modulus)
    excess = moved - 10 * points.tolerance * magnified
    return [f"a point would move by {moved.max():.2e} MPa"] * bool((excess > 0).any())


def criterion(points: Points) -> list[str]:
    """Boxes 2 and 3 by hand, for the law with linear softening.

    |T| <= R in tension; |T_T| <= max(R, mu |T_N|) under pressure, or R + Q/P mu |T_N| with gradual
    friction; pressure on closed points only.
    """
    law = points.law
    if not isinstance(law, vmdg.Debonding):
        return []
    R = law.strength - points.softening
    normal, shear = points.split(points.traction)
    gap, _ = points.split(points.gap)
    tolerance = 10 * points.tolerance
    pressed = normal < 0
    rubs = -law.friction * normal
    held = (
        R + points.softening / law.strength * rubs
        if law.unloads_to_origin or law.gradual_friction
        else np.maximum(R, rubs)
    )
    allowed = np.where(pressed, held, R)
    size = np.where(pressed, shear, np.hypot(normal, shear))
    found = []
    if (over := size - allowed - tolerance).max(initial=-1) > 0:
        found.append(f"traction exceeds the criterion by {over.max():.2e} MPa")
    open_ = gap > 10 * points.tolerance / points.penalty
    if (normal[open_] < -tolerance[open_]).any():
        found.append(f"pressure {-normal[open_].min():.2e} MPa on an open point")
    return found


def irreversible(run: Run) -> list[str]:
    """Damage and dissipation never decrease, rounding of the energies apart; of points, where no
    facets have opened."""
    found = []
    for before, after in zip(run.records, run.records[1:], strict=False):
        pairs = zip(run.laws, run.case.bonds, before.softening, after.softening, strict=True)
        for law, bond, Q0, Q1 in pairs:
            if not bond.slides and len(Q1) == len(Q0) and (Q1 < Q0).any():
                share = (Q0 - Q1).max() / np.max(law.strength)
                found.append(f"Q falls by {share:.1e} of the strength")
        dissipated, stored = abs(after.energy.dissipated), abs(after.energy.stored)
        scale = 1e-9 * dissipated + 10 * EPS * (dissipated + stored)
        for name in ("damage", "friction", "plastic"):
            spent = getattr(after.energy, name) - getattr(before.energy, name)
            if spent < -scale:
                share = f"{spent:.2e} of {after.energy.dissipated:.2e} N mm"
                found.append(f"{name} heals at t = {after.t:.4g}, by {share}")
    return found[:1]


def damage_energy(run: Run) -> list[str]:
    """Damage has taken from the bond what its softening says, whatever the path was.

    With unloading to the origin the bond still stores half of R times the largest gap.
    """
    first, last = run.records[0], run.records[-1]
    bonds = [k for k, law in enumerate(run.laws) if law.inelastic]
    if not all(isinstance(run.laws[k], RADIAL) for k in bonds):
        return []

    def left(law: vmdg.Law, Q: Array) -> Array:
        """What damage can still take: nothing where surfaces have slid to points of their own."""
        whole = law.strength + 0 * Q
        with np.errstate(invalid="ignore"):  # of an exponential bond that is gone
            stored = np.nan_to_num((whole - Q) * law.slip_to(whole, whole - Q)) / 2
        return law.bond_energy(whole - Q) + (stored if law.unloads_to_origin else 0.0)

    spent = whole = 0.0
    for k in bonds:
        law, opens = run.laws[k], len(first.softening[k]) < len(last.softening[k])
        start = last if opens and not run.case.bonds[k].slides else first
        Q0, dA = (0 if start is last else 1) * start.softening[k], start.weights[k]
        spent += dA @ left(law, Q0) - last.weights[k] @ left(law, last.softening[k])
        whole += dA @ law.bond_energy(law.strength + 0 * Q0)
    damage = last.energy.damage
    return [f"damage took {damage:.6e}, the bonds lost {float(spent):.6e} N mm"] * bool(
        abs(damage - spent) > 1e-9 * whole
    )


def energy_balance(run: Run) -> list[str]:
    """No step creates or loses more than the trapezoidal rule can miss of its work.

    External work is the mean of the reactions at both ends of a step times its displacement. On the
    way the reactions stay within what the run has seen and what the bonds can carry, and the true
    work differs by less than that times the displacement. Steps over a jump also have the work of
    the jump, and so, to a small fraction, has a step at constant load, which relaxes. What the
    curvature of the path adds to the work of a step is known with the next one. Energies are known
    no better than the rounding of W.
    """
    found = []
    rounding = 10 * EPS * stiffest(run) * run.reach**run.case.mesh.d
    borne = sum(
        state.weights.sum()
        * np.max([*map(np.max, (law.strength, getattr(law, "shear_strength", 0)))])
        for law, state in zip(run.laws, run.problem.state, strict=True)
        if law.inelastic
    )
    jumps = [0, *run.history["jump_steps"]] if len(run.history) else [0]
    last = 0.0
    for before, after, jumped in zip(run.records, run.records[1:], jumps[1:], strict=False):
        values = [run.problem.loading.prescribed_values(record.t) for record in (before, after)]
        moved = np.abs(values[1] - values[0])
        reactions = [np.abs(record.forces[record.prescribed]) for record in run.records]
        if len({len(forces) for forces in reactions}) == 1:
            bound = np.max(reactions, axis=0) @ moved
        else:  # nodes of the ends have been duplicated
            bound = max(forces.sum() for forces in reactions) * moved.max()
        bound += borne * run.case.mesh.d * moved.max()
        if run.case.traction is not None:
            load = max(np.linalg.norm(run.case.load(record.t)) for record in run.records)
            bound += load * np.abs(after.u - before.u).max()
        strains = [_swelling(run.case, record.t) for record in (before, after)]
        grown, most = np.abs(strains[1] - strains[0]).max(), np.abs(strains).max()
        bound += stiffest(run) * most * grown * run.case.mesh.size.prod()
        bound, last = bound + last, bound
        change = abs(after.energy.imbalance - before.energy.imbalance)
        if jumped:
            bound += before.energy.stored
        elif after.t == before.t:
            bound += NONLINEAR * before.energy.stored
        if change > bound + rounding:
            found.append(f"{change:.2e} N mm lost at t = {after.t:.4g}, {bound:.2e} allowed")
    return found[:1]


def _swelling(case: Case, t: float) -> Array:
    return np.array([np.zeros((3, 3)), *(e(t) for e in (case.eigenstrain or {}).values())])


def judged(run: Run) -> list[str]:
    """All rows are those of the independent solution of the case."""
    return run.case.judge(run) if run.case.judge else []


def exact(run: Run) -> list[str]:
    """The end state is that of the closed form, as far as F = I + GRAD u tells it from rest."""
    if run.case.exact is None or run.stopped:
        return []
    rounding = 10 * EPS * run.reach / np.abs(run.problem.u.x.array).max()
    deviation = run.case.exact(run.problem)
    return [f"off the closed form by {deviation:.2e}"] * (not deviation < EXACT + rounding)


CHECKS: tuple[Callable[[Run], list[str]], ...] = (
    at_last_record,
    equilibrium,
    positive_volume,
    admissible,
    irreversible,
    damage_energy,
    energy_balance,
    exact,
    judged,
)
