"""The state of a problem on another mesh of the same bodies.

The displacement at a node is that of the old mesh at its place, in its own body. Points of an
interface at the place of an old one have its history. At others T and Q are fitted linearly to the
points nearby on the surface, and zeta follows from them,

    zeta = g - (T - {P.N})/r,

with g, {P.N} and r of the new mesh: (31) solved for zeta. An interpolated zeta would be wrong by
the difference of two numbers that are large against T/r. Neither r nor tau_s is carried: they are
of the mesh. Bodies with a history have that of the nearest point of the same body, and are
returned to their yield surface.

What interpolation leaves unbalanced is balanced with zeta held, by Newton's method. The change of
the stored energy is that of the discretization, :attr:`.Energy.discretization`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import scipy
from dolfinx import fem
from numpy.typing import NDArray

from ..assembly.means import lattice_of
from ..base.parallel import gathered, global_norm, global_sum
from ..checkpoint.identity import differences, identity
from ..domain.point_bodies import PointBodies
from ..domain.topology import box_sides
from ..interface.active import ActiveInterface, resume, total_in_frame
from ..interface.guess import hold_here
from ..interface.history import PointHistory
from ..interface.parted import turned
from ..linear.ksp import Petsc
from ..linear.system import PRECISE, System
from ..problem.problem import Problem
from ..problem.states import Energy
from ..problem.step import energy_of
from ..solver.snes import rounding_of_forces
from .location import Location

Array = NDArray[np.float64]

#: Distance of points, relative to the size of the facet, within which they are the same.
_SAME = 1e-9

#: Softening relative to the strength up to which a point is intact, and has no zeta.
_INTACT = 1e-12

#: Cosine of the largest angle between normals of points of one piece of a surface.
_ONE_SIDE = 0.5

#: Residual relative to the forces at which the state is balanced, and most corrections.
_BALANCED, _MOST = 1e-10, 12

#: Entries of an identity that are of the mesh.
_OF_MESH = ("cell type", "number of cells", "number of mesh", "sum of", "degree", "facets of")


@dataclass(frozen=True)
class Transfer:
    """What a change of the mesh has changed.

    Attributes:
        before: Energies on the old mesh [N mm].
        after: Energies on the new mesh; ``discretization`` has the change of the stored energy.
        same: Share of the points of interfaces that are at the place of an old one; 1 without any.
        unbalanced: Norm of the forces on free nodes before they were balanced [N].
        corrections: Number of corrections of Newton's method for that.
    """

    before: Energy
    after: Energy
    same: float
    unbalanced: float
    corrections: int


def transfer(old: Problem, new: Problem, petsc: Petsc | None = None) -> Transfer:
    """Give a problem the state of another one on another mesh of the same bodies; collective.

    Bodies are recognised by their tags, interfaces by their order. Displacement, load factor,
    history of interfaces and of bodies, works and what the path knows are carried; the new state is
    in equilibrium with its inelastic gaps. The next :func:`.solve` of the new problem continues the
    run.

    Args:
        old: A problem in a converged state; it is not changed.
        new: The same problem on another mesh, with all its supports and loads; its state is
            replaced.
        petsc: Linear solver, as of :class:`vmdg.SolveOptions`.

    Raises:
        ValueError: the problems differ in more than the mesh, or have what cannot be carried:
            surfaces that slide, separate meshes, facets that open on demand, fluids, periodic
            cells, motion, derivatives.
        RuntimeError: the new state cannot be balanced; the new problem is as it was.
    """
    _check(old, new)
    step, starts = new.step, [values.copy() for values in new.loading.given.starts]
    before = step.snapshot(), step.scales, step.sliding
    try:
        return _carry(old, new, petsc)
    except BaseException:
        state, step.scales, step.sliding = before
        for mine, values in zip(new.loading.given.starts, starts, strict=True):
            mine[:] = values
        step.return_to(state)
        raise


def _check(old: Problem, new: Problem) -> None:
    for name, problem in (("old", old), ("new", new)):
        if not isinstance(problem, Problem):
            raise TypeError(f"transfer: {name} = {problem!r} must be a vmdg.Problem")
    what = next(filter(None, map(_refused, (old, new))), "")
    if what:
        raise ValueError(
            f"transfer: the state of {what} cannot be carried to another mesh yet; mesh the scene "
            "finely enough from the start"
        )
    of_mesh = lambda name: name.startswith(_OF_MESH) or name.endswith("by facet")  # noqa: E731
    one, two = (
        {k: v for k, v in identity(problem).items() if not of_mesh(k.split(": ")[-1])}
        for problem in (old, new)
    )
    if lines := differences(one, two):
        raise ValueError(
            f"transfer: the problems differ in more than the mesh (old there, new here: "
            f"{'; '.join(lines)}); set up the new one like the old one"
        )


def _refused(problem: Problem) -> str:
    """What of a problem cannot be carried; empty if all can."""
    active = problem.discretization.active.values()
    found = {
        "surfaces that slide": any(one.facets.slides for one in active),
        "bodies meshed separately": any(one.facets.paired for one in active),
        "facets that open on demand": any(
            interface.activate == "on-demand" for interface in problem.interfaces
        ),
        "a fluid between crack faces": bool(problem.loading.given.filled),
        "a periodic cell": lattice_of(problem.discretization.means) is not None,
        "means that are unknown": problem.discretization.means is not None,
        "bodies that crack": problem.step.damage is not None,
        "bodies in motion": problem.step.motion is not None,
        "derivatives": problem.step.rates is not None,
    }
    return next((what for what, there in found.items() if there), "")


def _carry(old: Problem, new: Problem, petsc: Petsc | None) -> Transfer:
    comm, step, now = new.comm, new.step, new.discretization
    before = energy_of(old.step)
    stored = old.discretization.stored_energy().sum()
    where = Location(now.space, now.bodies.tags, old.mesh, old.discretization.bodies.tags)
    starts = old.loading.given.starts
    fields = [old.discretization.u.x.array, *starts]
    u, *carried = [where.values(_field(old, values)) for values in fields]
    for mine, values in zip(new.loading.given.starts, carried, strict=True):
        mine[:] = values
    if carried:
        new.loading.rebuild(now)
    now.u.x.array[:] = u
    if bodies := now.bodies.points:
        _carry_bodies(old.discretization.bodies.points, bodies, comm)
    step.scales, step.sliding = old.step.scales, old.step.sliding
    new.loading.move(old.t)
    points = [
        _carried(*both)
        for both in zip(old.discretization.active.values(), now.active.values(), strict=True)
    ]
    step.ledger.works = replace(old.step.ledger.works, increment=None, pending=None)
    now.update_stabilization()
    step.assemble_residual(hold=True)
    failing = [
        (active, known)
        for active, known in zip(now.active.values(), points, strict=True)
        if known is not None
    ]
    for active, known in failing:
        active.history = _with_gap(active, known)
        resume(active, known.gradient)
    step.assemble_residual(hold=True)
    for active, known in failing:
        hold_here(active, np.zeros_like(known.compliance))
    unbalanced, corrections = _balance(new, petsc)
    for active, known in failing:
        active.take_traction()
        r = active.stabilization.norm[active.quadrature.facet]
        hold_here(active, _compliance(known, r))
    if bodies:
        bodies.commit()
        bodies.renew()
    step.ledger.enter_opening(now.stored_energy().sum() - stored)
    step.return_to(step.snapshot())
    found, count = global_sum(
        comm, [sum(f(known.same) for _, known in failing) for f in (np.count_nonzero, len)]
    )
    same = float(found / count) if count else 1.0
    return Transfer(before, energy_of(step), same, unbalanced, corrections)


def _field(problem: Problem, values: Array) -> fem.Function:
    field = fem.Function(problem.discretization.space)
    field.x.array[:] = values
    return field


# Interfaces


class Carried(NamedTuple):
    """What points carry to another mesh."""

    history: PointHistory  # With the zeta of the nearest old point
    gradient: Array  # :meth:`.ActiveInterface.work_gradient` (nq, d)
    compliance: Array  # C = d zeta/dT of the nearest old point (nq, d, d)
    penalty: Array  # r of that point (nq,) [MPa/mm]
    same: NDArray[np.bool_]  # Whether it is at the same place (nq,)


def _carried(old: ActiveInterface, new: ActiveInterface) -> Carried | None:
    """What the points of the new mesh have from the old one; None for a tie; collective."""
    if not old.law.inelastic:
        return None
    mine, theirs, history = new.quadrature, old.quadrature, old.history
    known = theirs.points, theirs.normal, history.traction, history.softening, history.gap
    known += history.mode, old.work_gradient(1.0), old.values.compliance
    known += (old.stabilization.norm[theirs.facet],)
    x, N, T, Q, zeta, mode, gradient, C, r = (gathered(mine.mesh.comm, a) for a in known)
    away, nearest = scipy.spatial.cKDTree(x).query(mine.points)
    same = away <= _SAME * mine.extent[mine.facet]
    traction, softening, other = T[nearest], Q[nearest], np.flatnonzero(~same)
    if len(other):
        near, shares = _shares(mine.points[other], mine.normal[other], x, N)
        sides = np.broadcast_to(mine.normal[other, None], (*near.shape, mine.d))
        there = turned(*(a.reshape(-1, mine.d) for a in (T[near], N[near], sides)))
        traction[other] = (shares[..., None] * there.reshape(sides.shape)).sum(axis=1)
        softening[other] = (shares * Q[near]).sum(axis=1)
        softening = np.clip(softening, 0.0, new.law.strength)
    found = PointHistory(zeta[nearest], softening, mode[nearest], traction)
    return Carried(found, gradient[nearest], C[nearest], r[nearest], same)


def _compliance(known: Carried, r: Array) -> Array:
    """C with the r of the new mesh (nq, d, d): dT = (C^-1 - r I).d zeta is the law's own."""
    d = known.compliance.shape[1]
    change = (r - known.penalty)[:, None, None]
    return known.compliance @ np.linalg.inv(np.eye(d) + change * known.compliance)


def _shares(x: Array, normals: Array, points: Array, N: Array) -> tuple[NDArray[np.intp], Array]:
    """Points of a surface near others and their shares (n, k) in a linear fit along the surface,
    which is not beyond the values of the points.

    Weights are (1 - d/R)^2 with the distance d, beyond the last one of them at R.
    """
    d = normals.shape[1]
    distance, near = scipy.spatial.cKDTree(points).query(x, min(4 ** (d - 1), len(points)))
    near, distance = near.reshape(len(x), -1), distance.reshape(len(x), -1)
    one_side = np.einsum("nkd,nd->nk", N[near], normals) > _ONE_SIDE
    R = 1.25 * distance.max(axis=1, keepdims=True)
    weight = one_side * (1 - distance / np.where(R > 0, R, 1.0)) ** 2
    weight[~weight.any(axis=1), 0] = 1.0
    way = (points[near] - x[:, None])[..., :d] / np.where(R > 0, R, 1.0)[..., None]
    way -= np.einsum("nkd,nd->nk", way, normals)[..., None] * normals[:, None]
    basis = np.concatenate([np.ones((*near.shape, 1)), way], axis=2)
    normal = np.einsum("nk,nka,nkb->nab", weight, basis, basis)
    first = np.linalg.pinv(normal, rcond=1e-8, hermitian=True)[:, 0]
    shares = weight * np.einsum("na,nka->nk", first, basis)
    # Negative shares extrapolate: there the mean of the nearby values is surer.
    outside = (shares < -0.25).any(axis=1)
    mean = weight / weight.sum(axis=1, keepdims=True)
    shares[outside] = mean[outside]
    return near, shares / shares.sum(axis=1, keepdims=True)


def _with_gap(active: ActiveInterface, known: Carried) -> PointHistory:
    """The history with zeta of (31) where points are others, at the current displacement."""
    history = known.history
    r = active.stabilization.norm[active.quadrature.facet]
    gap = (total_in_frame(active) - history.traction) / r[:, None]
    failing = history.softening > _INTACT * active.law.strength
    gap = np.where(failing[:, None], gap, 0.0)
    return replace(history, gap=np.where(known.same[:, None], history.gap, gap))


# Bodies


def _carry_bodies(old: PointBodies, new: PointBodies, comm: MPI.Comm) -> None:
    """Give the points of bodies the history of the nearest one of their body; collective."""
    history = []
    for tag in new.materials:
        x, theirs = _of_tag(old, tag)
        x, theirs = gathered(comm, x), gathered(comm, theirs)
        nearest = scipy.spatial.cKDTree(x).query(_of_tag(new, tag)[0])[1]
        history.append(theirs[nearest])
    new.take(replace(new.state, history=tuple(history), next=tuple(history)))


def _of_tag(bodies: PointBodies, tag: int) -> tuple[Array, Array]:
    """Places of the points of a body (n, 3), and their history (n, m)."""
    return bodies.places(tag), bodies.state.history[list(bodies.materials).index(tag)]


# Balance


def _balance(problem: Problem, petsc: Petsc | None) -> tuple[float, int]:
    """Balance the forces with zeta held; the norm of the first ones [N], and the number of
    corrections; collective."""
    step, loading, comm, u = problem.step, problem.loading, problem.comm, problem.u.x
    owned, size = problem.discretization.owned, float(box_sides(problem.mesh).max())
    system, norms = System(problem, petsc), []
    try:
        for count in range(_MOST + 1):
            forces = step.assemble_residual(hold=True)
            scale = max(global_norm(comm, forces), step.scales.reaction)
            free, away = loading.balance(forces.copy()), loading.away(problem.t)
            norms.append(global_norm(comm, free))
            goal = max(_BALANCED * scale, rounding_of_forces(problem, size, system.norm))
            if norms[-1] <= goal and not global_norm(comm, away) > 0:
                return norms[0], count
            u.array[:owned] += system.solve([-free], [away], PRECISE)[0]
            # Krylov methods solve the equations of supports to a tolerance only.
            u.array[:owned] += loading.away(problem.t)
            u.scatter_forward()
            problem.discretization.update_means()
        raise RuntimeError(
            f"transfer: forces on the new mesh balance only to {norms[-1]:.3g} N of {scale:.3g} N "
            f"after {_MOST} corrections: carry the state between meshes that differ less, or in a "
            "state with smaller deformation"
        )
    finally:
        system.free()
