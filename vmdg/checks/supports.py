"""Constraints on the parts of a problem: bonds and supports, and the remaining rigid motions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag

from .. import compat
from ..assembly.means import lattice_of
from ..assembly.space import node_pieces
from ..base.parallel import global_box, global_max, global_sum, warn_together
from ..base.tables import rounded
from ..domain.geometry import rigid_motions
from ..forms.geometry import Axisymmetric
from ..interface.active import ActiveInterface, pressed
from ..problem.problem import Problem

#: Eigenvalue, relative to the largest one, below which a rigid motion is unconstrained: that of a
#: node at 1e-5 of the size of a part.
_FREE = 1e-11

#: Lost fraction of the strength at which a point counts as broken.
_LOST = 0.99

_AXES = "xyz"

#: Largest number of tags listed in a message.
MOST_TAGS = 8

#: Lower half of a 64-bit number.
_LOW = 0xFFFFFFFF


class LoosePart(NamedTuple):
    """A part of a problem that can move as a rigid body."""

    name: int
    tags: list[int]
    motions: str
    cells: NDArray[np.intp]


class Parts(NamedTuple):
    """The parts that can move as rigid bodies, and their constraints; the same on every rank.

    Attributes:
        gram: Sum of m m^T over constrained dofs, m the rigid motions (parts, modes, modes).
    """

    label: NDArray[np.int64]
    names: NDArray[np.int64]
    tags: list[list[int]]
    gram: NDArray[np.float64]


def in_words(parts: Sequence[LoosePart]) -> str:
    tags = [str(tag) for tag in sorted({tag for part in parts for tag in part.tags})]
    listed = ", ".join(tags[:MOST_TAGS]) + (", ..." if len(tags) > MOST_TAGS else "")
    noun = f"tag{'s' if len(tags) > 1 else ''} {listed}"
    return f"the body of {noun}" if len(parts) == 1 else f"{len(parts)} bodies of {noun}"


def loose_parts(
    problem: Problem, interfaces: Iterable[ActiveInterface], worst: float = np.inf
) -> list[LoosePart]:
    """Parts with a free rigid motion if only some interfaces are intact; collective.

    Cells are connected by shared nodes, and across the facets of these interfaces with an initial
    damage below the worst.
    """
    return loose_among(problem, parts_of(problem, interfaces, worst))


def parts_of(
    problem: Problem, interfaces: Iterable[ActiveInterface], worst: float = np.inf
) -> Parts:
    """The rigid parts if only some interfaces are intact, see :func:`loose_parts`, found once for
    all that supports them; collective."""
    intact, known = list(interfaces), problem.loading.rigid_parts
    active = problem.discretization.active.items()
    key = (worst, *(number for number, one in active if one in intact))
    if key not in known:
        joined = [one.facets.cells[one.facets.damage < worst] for one in intact]
        known[key] = _parts(problem, joined, [])
    return known[key]


def bonds(problem: Problem) -> tuple[float, float]:
    """Energy of intact bonds on open facets, P_c^2/(2 H) times their area [N mm], and their number
    of facets; collective."""
    found = np.zeros(2)
    for active in problem.discretization.active.values():
        law = active.law
        if law.has_bond:
            per_area = law.strength**2 / (2 * law.softening_modulus)
            found += (per_area * active.quadrature.weights).sum(), len(active.facets.facets)
    energy, facets = global_sum(problem.comm, found)
    return float(problem.discretization.geometry.thickness) * energy, facets


def stabilize_pieces(problem: Problem) -> bool:
    """Stabilize detached pieces by an artificial stiffness from now on, with a warning; whether
    there is a new such piece; collective.

    At small strain a piece rotates without strain for any angle, and needs none.
    """
    step = problem.step
    if step.scales.held or problem.discretization.bodies.small:
        return False
    if piece := hanging_piece(problem):
        step.scales = replace(step.scales, held=True)
        warn_together(
            problem.comm,
            f"{piece} This motion requires no force. From load factor {problem.t:.6g} on, a small "
            "artificial stiffness in the tangent, which carries no force, keeps the piece in "
            "place. If no force remains, until= of vmdg.solve can end the run; problem.spring "
            "would constrain the piece itself",
        )
    return bool(piece)


def hanging_piece(problem: Problem) -> str:
    """A sentence about the smallest piece constrained by a single point only, or not at all; empty
    if there is none; collective.

    If only one point of the facets around a piece is intact, or in 3D collinear points, the piece
    rotates about it without resistance. A point is intact if part of its strength remains or it is
    in contact. Chains of such pieces are not detected.
    """
    joined, links = [], []
    for active in problem.discretization.active.values():
        q, holds = active.quadrature, _holding(active)
        every = holds[q.points_of_facet].all(axis=1)
        joined.append(active.facets.cells[every])
        single = holds & ~every[q.facet]
        links.append((active.facets.cells[q.facet[single]], q.points[single]))
    loose = loose_among(problem, _parts(problem, joined, links))
    found = [(_box(problem, part.cells), part) for part in loose]
    if not found:
        return ""
    box, part = min(found, key=lambda one: np.linalg.norm(one[0][1] - one[0][0]))
    low, high = rounded(box)
    return (
        f"A piece of {in_words([part])}, between {low} and {high} before the deformation, is "
        f"unconstrained against {part.motions}: its bonds are broken, except perhaps at one point."
    )


def _holding(active: ActiveInterface) -> NDArray[np.bool_]:
    """Whether the points of an interface were intact at the last converged state (nq,)."""
    history, law = active.history, active.law
    if not law.inelastic:
        return np.ones(len(active.quadrature.weights), dtype=bool)
    bonded = history.softening < _LOST * law.strength if law.has_bond else False
    return bonded | pressed(active)


def _box(problem: Problem, cells: NDArray[np.intp]) -> NDArray[np.float64]:
    """Lowest and highest coordinates of cells, over all ranks (2, d); collective [mm]."""
    geometry = problem.mesh.geometry
    x = geometry.x[compat.geometry_dofmap(problem.mesh)[cells].ravel(), : geometry.dim]
    return global_box(problem.comm, x)


def loose_among(problem: Problem, parts: Parts) -> list[LoosePart]:
    result = []
    for name, tags, matrix in zip(parts.names, parts.tags, parts.gram, strict=True):
        if motions := _motions_in_words(matrix, problem):
            cells = np.flatnonzero(parts.label == name)
            result.append(LoosePart(int(name), tags, motions, cells))
    return result


def _parts(
    problem: Problem,
    joined: list[NDArray[np.int32]],
    links: list[tuple[NDArray[np.int32], NDArray[np.float64]]],
) -> Parts:
    """The rigid parts and their constraints; collective.

    Args:
        joined: Pairs of cells (n, 2) connected in addition to those that share a node.
        links: Pairs of cells (n, 2) connected at a point (n, 3).
    """
    mesh, comm = problem.mesh, problem.comm
    label = node_pieces(problem.space, joined)[problem.space.dofmap.list[:, 0]]
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    # Part and tag are packed into one number, which is faster to sort.
    code = np.unique(
        (label[:owned] << 32) | (problem.discretization.bodies.tags[:owned].astype(np.int64) & _LOW)
    )
    code = np.unique(np.concatenate(comm.allgather(code)))
    part_of, tag_of = code >> 32, (code & _LOW).astype(np.uint32).view(np.int32)
    parts = np.unique(part_of)
    gram = _gram(problem, label, parts)
    size, geometry = size_of(problem), problem.discretization.geometry
    for cells, points in links:
        m = rigid_motions(points[:, : mesh.geometry.dim] / size, geometry)
        apart = label[cells[:, 0]] != label[cells[:, 1]]
        works = np.einsum("mpi,kpi->pmk", m, m)[apart]
        for side in label[cells[apart]].T:
            np.add.at(gram, np.searchsorted(parts, side), works)
    gram = _with_faces(problem, label, parts, global_sum(comm, gram))
    tags = [tag_of[part_of == part].tolist() for part in parts]
    return Parts(label, parts, tags, gram)


def _gram(
    problem: Problem, label: NDArray[np.int64], parts: NDArray[np.int64]
) -> NDArray[np.float64]:
    """Sum of m m^T over this rank's prescribed dofs of every part, m the rigid motions there.

    Includes the work m.K.m of springs, and in a periodic cell the difference of motions of opposite
    nodes: a body that continues beyond the boundary cannot rotate.
    """
    held, means = problem.loading.owned_prescribed, problem.discretization.means
    if means is not None:
        held = np.setdiff1d(held, means.owned_rows)
    part, m = motions_at(problem, label, parts, held)
    gram = np.zeros((len(parts), m.shape[1], m.shape[1]))
    np.add.at(gram, part, m[:, :, None] * m[:, None, :])
    if lattice_of(means) is not None:
        nodes, (here, there) = means.shifts()
        geometry, size = problem.discretization.geometry, size_of(problem)
        m = rigid_motions(here / size, geometry) - rigid_motions(there / size, geometry)
        part = _part_of_nodes(problem, label, parts)[means.nodes[nodes]]
        np.add.at(gram, part, np.einsum("mni,kni->nmk", m, m))
    surface = problem.discretization.surface
    if surface.sprung:
        every = np.arange(len(problem.u.x.array), dtype=np.int32)
        part, m = motions_at(problem, label, parts, every)
        np.add.at(gram, part, surface.spring_work(m.T.copy()))
    return gram


def _with_faces(
    problem: Problem,
    label: NDArray[np.int64],
    parts: NDArray[np.int64],
    gram: NDArray[np.float64],
) -> NDArray[np.float64]:
    """The sum of :func:`_gram` plus the constraints of rigid faces on motions m of their nodes;
    collective.

    They constrain |m|^2 - |T^T.m|^2, with m those of all parts jointly, since a face may connect
    parts. For a part the Schur complement is used, in which all other parts follow.
    """
    rigid = problem.loading.rigid
    if not rigid:
        return gram
    count, modes = gram.shape[:2]
    part, m = motions_at(problem, label, parts, rigid.dofs)
    moved = np.zeros((len(rigid.dofs), count, modes))
    moved[np.arange(len(m)), part] = m
    moved = moved.reshape(len(m), count * modes)
    work = global_sum(problem.comm, moved.T @ moved)
    along = global_sum(problem.comm, rigid.columns[:, rigid.dofs] @ moved)
    whole = block_diag(*gram) + work - along.T @ along
    result = gram.copy()
    for i in np.flatnonzero(np.diag(work).reshape(count, modes).any(axis=1)):
        own = np.arange(len(whole)) // modes == i
        between = whole[own][:, ~own]
        others = np.linalg.pinv(whole[~own][:, ~own], rcond=_FREE, hermitian=True)
        result[i] = whole[own][:, own] - between @ others @ between.T
    return result


def _nothing(gram: NDArray[np.float64]) -> float:
    """Eigenvalue of a part's matrix up to which a motion is unconstrained."""
    return _FREE * max(np.linalg.eigvalsh(gram)[-1], np.finfo(float).tiny)


def free_motions(gram: NDArray[np.float64]) -> NDArray[np.float64]:
    """Unconstrained motions of a part, by columns (modes, n)."""
    values, vectors = np.linalg.eigh(gram)
    return vectors[:, values <= _nothing(gram)]


def motions_at(
    problem: Problem,
    label: NDArray[np.int64],
    parts: NDArray[np.int64],
    dofs: NDArray[np.int32],
) -> tuple[NDArray[np.intp], NDArray[np.float64]]:
    """Part of every dof, as index into ``parts``, and rigid motions there (n, modes)."""
    space = problem.space
    d = space.dofmap.index_map_bs
    coordinates = space.tabulate_dof_coordinates()[:, :d]
    part_of_node = _part_of_nodes(problem, label, parts)
    node, component = dofs // d, dofs % d
    motions = rigid_motions(coordinates[node] / size_of(problem), problem.discretization.geometry)
    return part_of_node[node], motions[:, np.arange(len(node)), component].T


def _part_of_nodes(
    problem: Problem, label: NDArray[np.int64], parts: NDArray[np.int64]
) -> NDArray[np.intp]:
    dofmap = problem.space.dofmap
    result = np.zeros(dofmap.index_map.size_local + dofmap.index_map.num_ghosts, dtype=np.intp)
    result[dofmap.list] = np.searchsorted(parts, label)[:, None]
    return result


def size_of(problem: Problem) -> float:
    """Largest coordinate; collective [mm]."""
    largest = float(np.abs(problem.mesh.geometry.x).max(initial=0.0))
    return max(global_max(problem.comm, largest), np.finfo(float).tiny)


def _motions_in_words(gram: NDArray[np.float64], problem: Problem) -> str:
    """Description of free rigid motions; empty if all are constrained."""
    free = free_motions(gram).shape[1]
    if not free:
        return ""
    d = problem.mesh.geometry.dim
    held = np.diag(gram) > _nothing(gram)
    if isinstance(problem.discretization.geometry, Axisymmetric):
        return "translation along y"
    names = [f"translation along {_AXES[k]}" for k in range(d) if not held[k]]
    if free > len(names):
        names.append("rotation")
    return ", ".join(names)
