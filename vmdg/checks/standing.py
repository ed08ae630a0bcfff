"""Loads that can be carried without bonds: limit analysis with rigid parts, contact and friction.

Without bonds the parts of a problem carry by contact the loads not taken by supports. Rigid parts
are in equilibrium if forces at the points of the interfaces, each within its friction cone, balance
the loads f in all unconstrained rigid motions m,

    sum_points m.g + sum_nodes m.f = 0 for all m,   g = sum_k lambda_k (-N + mu T_k),  lambda >= 0

on side 1, and -g on side 2: a linear programme (Livesley 1978, International Journal for Numerical
Methods in Engineering 12, 1853). In 3D the cone has eight edges T_k. The residual of least absolute
sum identifies the parts that are not supported.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, eye_array, hstack

from ..assembly.space import at_owners
from ..base.parallel import global_sum
from ..domain.geometry import rigid_motions
from ..interface.active import ActiveInterface
from ..problem.problem import Problem
from .supports import Parts, free_motions, motions_at, size_of

Array = NDArray[np.float64]

#: Admissible residual relative to the largest work of loads in a motion.
_LEFT = 1e-6

#: Directions of friction in space.
_EDGES = 8


def falling(
    problem: Problem, parts: Parts, interfaces: Sequence[ActiveInterface], t: float
) -> set[int]:
    """Names of the parts not supported by constraints, contact and friction; collective."""
    comm = problem.comm
    forces = _forces(problem, t)
    every = np.arange(len(forces), dtype=np.int32)
    owner, motions = motions_at(problem, parts.label, parts.names, every)
    load = np.zeros(parts.gram.shape[:2])
    np.add.at(load, owner, forces[:, None] * motions)
    load = global_sum(comm, load)
    gathered = comm.gather([_between(problem, parts, active) for active in interfaces])
    found = None
    if comm.rank == 0:
        columns = [columns for of_rank in gathered for columns in of_rank]
        pairs, works = (np.concatenate(arrays) for arrays in zip(*columns, strict=True))
        found = {int(name) for name in parts.names[_left_over(parts.gram, load, pairs, works)]}
    return comm.bcast(found)


def _forces(problem: Problem, t: float) -> Array:
    """All loads at a load factor and the current displacement, on owned dofs; collective [N]."""
    loading, now = problem.loading, problem.t
    loading.move(t)
    forces = at_owners(problem.space, loading.vector.copy())
    loading.move(now)
    return forces


def _between(
    problem: Problem, parts: Parts, active: ActiveInterface
) -> tuple[NDArray[np.intp], Array]:
    """Parts of both sides (n, 2) and works (n, modes) in motions of side 1 of unit forces at the
    points, along the edges of their cones."""
    q, d = active.quadrature, problem.mesh.geometry.dim
    pairs = np.searchsorted(parts.names, parts.label[active.facets.cells])[q.facet]
    friction = np.broadcast_to(active.law.friction, len(q.weights))[:, None]
    tangents = [np.stack([-q.normal[:, 1], q.normal[:, 0]], axis=1)]
    if d == 3:
        # Across the axis most perpendicular to the normal.
        axis = np.eye(3)[np.abs(q.normal).argmin(axis=1)]
        tangents = [np.cross(q.normal, axis)]
        tangents[0] /= np.linalg.norm(tangents[0], axis=1, keepdims=True)
        tangents.append(np.cross(q.normal, tangents[0]))
    angles = np.arange(_EDGES) * 2 * np.pi / _EDGES
    around = [(c, s) for c, s in zip(np.cos(angles), np.sin(angles), strict=True)]
    edges = around if d == 3 else [(1.0,), (-1.0,)]
    m = rigid_motions(q.points[:, :d] / size_of(problem), problem.discretization.geometry)
    works = []
    for edge in edges:
        along = sum(share * tangent for share, tangent in zip(edge, tangents, strict=True))
        works.append(np.einsum("mpi,pi->pm", m, -q.normal + friction * along))
    return np.tile(pairs, (len(edges), 1)), np.concatenate(works)


def _left_over(gram: Array, load: Array, pairs: NDArray[np.intp], works: Array) -> NDArray[np.intp]:
    """Parts whose loads cannot be balanced by contact forces.

    Args:
        gram: Constraint matrix of every part (parts, modes, modes).
        load: Work of loads in their motions (parts, modes).
        pairs: Parts on both sides of forces (n, 2).
        works: Works of forces in motions of side 1 (n, modes).
    """
    free = [free_motions(matrix) for matrix in gram]
    starts = np.cumsum([0, *(motions.shape[1] for motions in free)])
    f = np.concatenate([motions.T @ row for motions, row in zip(free, load, strict=True)])
    largest = np.abs(load).max(initial=0.0)
    owner = np.repeat(np.arange(len(free)), np.diff(starts))
    if not np.abs(f).max(initial=0.0) > _LEFT * largest:
        return np.zeros(0, dtype=np.intp)
    f /= largest
    blocks = [
        _rows(free, starts, side, sign * works) for side, sign in zip(pairs.T, (1, -1), strict=True)
    ]
    A = (blocks[0] + blocks[1]).T
    rows = starts[-1]
    system = hstack([A, eye_array(rows), -eye_array(rows)])
    cost = np.concatenate([np.zeros(A.shape[1]), np.ones(2 * rows)])
    solved = scipy.optimize.linprog(cost, A_eq=system, b_eq=-f, method="highs")
    if solved.x is None:
        return np.unique(owner[f != 0])
    slack = solved.x[A.shape[1] :].reshape(2, rows).sum(axis=0)
    return np.unique(owner[slack > _LEFT])


def _rows(
    free: Sequence[Array], starts: NDArray[np.intp], side: NDArray[np.intp], works: Array
) -> csr_array:
    """Works in the free motions of a part each (n, all free motions)."""
    data, rows, columns = [np.zeros(0)], [np.zeros(0, dtype=int)], [np.zeros(0, dtype=int)]
    for part in np.unique(side):
        chosen = np.flatnonzero(side == part)
        count = free[part].shape[1]
        data.append((works[chosen] @ free[part]).ravel())
        rows.append(np.repeat(chosen, count))
        columns.append(np.tile(np.arange(starts[part], starts[part + 1]), len(chosen)))
    entries = np.concatenate(data), (np.concatenate(rows), np.concatenate(columns))
    return coo_array(entries, shape=(len(side), starts[-1])).tocsr()
