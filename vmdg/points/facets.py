"""The facets of an interface on a mesh, and their sides."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from dolfinx import fem, la
from dolfinx.mesh import GhostMode, Mesh, compute_midpoints, locate_entities
from numpy.typing import NDArray

from ..base.parallel import global_sum, raise_together
from ..base.words import as_numbers, at_points
from ..domain.tags import group_tag
from ..domain.topology import (
    UNTAGGED,
    cells_inside,
    checked_facets,
    facet_cells,
    local_facets,
    located,
    mark_everywhere,
    refuse_facets,
)
from ..domain.weibull import Weibull
from ..laws import Law
from .interface import ALL, Interface, PairRule


@dataclass(frozen=True)
class InterfaceFacets:
    """The facets of one interface on this rank, with their sides."""

    facets: NDArray[np.int32]  # Owned facets, ascending, (nf,)
    cells: NDArray[np.int32]  # Cell of side 1 and of side 2, (nf, 2)
    local: NDArray[np.int32]  # Number of the facet within these cells, (nf, 2)
    tags: NDArray[np.int32]  # Cell tags of the two sides, (nf, 2)
    # The same interface including the facets of other ranks known here (ghosts)
    everywhere: NDArray[np.int32]
    damage: NDArray[np.float64]  # Initial damage of the bond (nf,), 1 where it is broken
    law: Law  # The law on these facets: parameters that vary are arrays (nf,)
    label: str
    walled: bool = False  # Whether one side of every facet is a rigid wall; the same on all ranks

    @property
    def cut(self) -> NDArray[np.int32]:
        """Facets across which the space may jump, ghosts included."""
        return self.everywhere

    @property
    def chosen_side(self) -> int | None:
        """Tag of side 1 where surfaces slide; None elsewhere."""
        return None

    @property
    def first_side(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
        """Distinct facets of side 1, ascending, that are or may be open, their cells, and their
        numbers in them (n,)."""
        rows = np.unique(self.facets, return_index=True)[1]
        return self.facets[rows], self.cells[rows, 0], self.local[rows, 0]

    def rows_of(self, other: InterfaceFacets) -> NDArray[np.intp]:
        """Rows here of the facets of ``other``, a part of these."""
        return np.searchsorted(self.facets, other.facets)

    @property
    def paired(self) -> bool:
        """Whether segments of facets of two surfaces take the place of facets."""
        return False

    @property
    def slides(self) -> bool:
        return False

    @property
    def size(self) -> int:
        """Number of facets on this rank, for surfaces that slide of side 1."""
        return len(self.facets)

    def among(self, mark: NDArray[np.bool_]) -> InterfaceFacets:
        """The marked facets, with ``mark`` over all local facets of the mesh."""
        keep = mark[self.facets]
        return replace(
            self,
            facets=self.facets[keep],
            cells=self.cells[keep],
            local=self.local[keep],
            tags=self.tags[keep],
            everywhere=self.everywhere[mark[self.everywhere]],
            damage=self.damage[keep],
            law=self.law.at(keep),
        )

    def rows(self, select: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Rows (cell 1, facet in it, cell 2, facet in it) of DOLFINx, flattened."""
        columns = [self.cells[:, 0], self.local[:, 0], self.cells[:, 1], self.local[:, 1]]
        return np.column_stack(columns)[select].ravel()

    def cells_of(self, a: int) -> NDArray[np.int32]:
        """Cells that may be at side ``a`` (0 or 1)."""
        return self.cells[:, a]


def check_ghosts(mesh: Mesh) -> None:
    if mesh.comm.size == 1:
        return
    tdim = mesh.topology.dim
    mesh.topology.create_connectivity(tdim - 1, tdim)
    if global_sum(mesh.comm, len(mesh.topology.interprocess_facets())) == 0:
        return
    if global_sum(mesh.comm, mesh.topology.index_map(tdim).num_ghosts) == 0:
        raise RuntimeError(
            "the mesh has no facet ghosts, so no rank sees both sides of a facet between two "
            f"ranks; create it with ghost_mode={GhostMode.shared_facet} (or, from gmsh, "
            "partitioner=dolfinx.mesh.create_cell_partitioner(GhostMode.shared_facet))"
        )


def find_facets(
    mesh: Mesh,
    cell_tags: NDArray[np.int32],
    interface: Interface,
    names: Mapping[str, int] | None = None,
    label: str | None = None,
    walls: Collection[int] = (),
) -> InterfaceFacets:
    """Select the facets of an interface and determine their sides.

    Side 1 has the lower tag; for equal tags it is the cell inside the level set, or else the cell
    whose midpoint comes first along the first coordinate in which the two midpoints differ, which
    is independent of the partition.
    """
    comm, label = mesh.comm, label or str(interface)
    fdim = mesh.topology.dim - 1
    pairs = facet_cells(mesh)
    interior = (pairs >= 0).all(axis=1)
    known = set(np.unique(np.concatenate(comm.allgather(np.unique(cell_tags)))).tolist())
    known.discard(UNTAGGED)
    several = callable(interface.between) or interface.between == ALL
    groups = () if several else interface.between or ()
    if interface.within is not None:
        groups = (interface.within,)
    wanted = [group_tag(group, names or {}, label) for group in groups]
    for tag in wanted:
        if tag not in known:
            raise ValueError(f"{label}: no cell has tag {tag}; tags are {sorted(known)}")
    tags = np.where(interior[:, None], cell_tags[pairs], UNTAGGED)
    inside = None
    if callable(interface.facets):
        mesh.topology.create_connectivity(fdim, 0)
        chosen = interior.copy()
        found = located(mesh, lambda f: locate_entities(mesh, fdim, f), interface.facets, label)
        chosen &= mark_everywhere(mesh, fdim, found)
    elif interface.facets is not None:
        chosen = _given_facets(mesh, interface.facets, interior, label)
    elif interface.level_set is not None:
        inside = cells_inside(mesh, interface.level_set)
        chosen = interior & (inside[pairs[:, 0]] != inside[pairs[:, 1]])
    elif several:
        chosen = _between_groups(mesh, interface.between, tags, label)
    elif interface.between is not None:
        chosen = (np.sort(tags, axis=1) == np.sort(np.array(wanted))).all(axis=1)
    else:
        chosen = interior & (tags == wanted[0]).all(axis=1)
    everywhere = np.flatnonzero(chosen).astype(np.int32)
    facets = everywhere[everywhere < mesh.topology.index_map(fdim).size_local]
    if global_sum(comm, len(facets)) == 0:
        raise ValueError(f"{label} has no facet: {_why_empty(interface)}")
    cells = pairs[facets]
    cells = np.where(_reversed(mesh, cell_tags, cells, inside)[:, None], cells[:, ::-1], cells)
    local = np.column_stack([local_facets(mesh, cells[:, a], facets) for a in range(2)])
    tags = cell_tags[cells]
    given = facet_properties(mesh, interface, facets, cells, tags, walls, label)
    return InterfaceFacets(facets, cells, local, tags, everywhere, *given)


def facet_properties(
    mesh: Mesh,
    interface: Interface,
    facets: NDArray[np.int32],
    cells: NDArray[np.int32],
    tags: NDArray[np.int32],
    walls: Collection[int],
    label: str,
) -> tuple[NDArray[np.float64], Law, str, bool]:
    """Initial damage, law, label, and whether one side is a rigid wall, as in
    :class:`InterfaceFacets`; collective."""
    damage = _initial_damage(mesh, interface, facets, cells, label)
    law = _law_on(mesh, interface, facets, cells, label)
    return damage, law, label, _on_walls(mesh, tags, walls, label)


def _on_walls(mesh: Mesh, tags: NDArray[np.int32], walls: Collection[int], label: str) -> bool:
    """Whether the facets, with cell tags (nf, 2), lie on rigid walls; collective."""
    sides = np.isin(tags, list(walls)).sum(axis=1)
    counts = [int(global_sum(mesh.comm, (sides == k).sum())) for k in range(3)]
    if counts[2]:
        raise ValueError(
            f"{label}: {counts[2]} of its facets have a rigid wall on both sides, where nothing "
            "deforms; exclude them, or give both walls one tag"
        )
    if counts[1] and counts[0]:
        raise ValueError(
            f"{label}: {counts[1]} of its facets lie on a rigid wall and {counts[0]} do not; use "
            "a separate interface for those on the wall"
        )
    return counts[1] > 0


def _between_groups(
    mesh: Mesh, between: str | PairRule, tags: NDArray[np.int32], label: str
) -> NDArray[np.bool_]:
    """Mask of the facets between any two groups, or between those selected by a user's function."""
    chosen = (tags[:, 0] != tags[:, 1]) & (tags != UNTAGGED).all(axis=1)
    if between == ALL:
        return chosen
    pairs = np.sort(tags[chosen], axis=1)
    message = None
    try:
        wanted = np.asarray(between(*pairs.T))
    except Exception as error:  # a user's function may raise anything
        wanted, message = np.zeros(0), f"it fails: {error}"
    if message is None and (wanted.shape != pairs.shape[:1] or wanted.dtype != bool):
        message = f"it returns values of shape {wanted.shape} and type {wanted.dtype}"
    if message is not None:
        message = (
            f"{label}: the function of two tags, arrays ({len(pairs)},), must return True or False "
            f"for each pair, for example lambda a, b: angle[a] == angle[b]; {message}"
        )
    raise_together(mesh.comm, message)
    chosen[chosen] = wanted
    return chosen


def _why_empty(interface: Interface) -> str:
    if interface.level_set is not None:
        return (
            "the level set has one sign at the midpoints of all cells; check its units, or refine "
            "the mesh"
        )
    if callable(interface.facets):
        return (
            "the predicate is true at all vertices of no interior facet; compare coordinates by "
            "np.isclose, with an atol= far below the cell size, and check that the mesh has facets "
            "there"
        )
    if callable(interface.between):
        return "the function is true for no two adjacent groups"
    return (
        "the tags are not adjacent; make the mesh conforming, for example by "
        "gmsh.model.occ.fragment"
    )


def _given_facets(
    mesh: Mesh, given: NDArray[np.int32], interior: NDArray[np.bool_], label: str
) -> NDArray[np.bool_]:
    facets = checked_facets(mesh, given, label)
    chosen = mark_everywhere(mesh, mesh.topology.dim - 1, facets)
    # A ghost facet may have one cell here; its owner sees both.
    reason = "lies on the boundary of the mesh; an interface takes interior facets only"
    everywhere = np.flatnonzero(chosen).astype(np.int32)
    refuse_facets(mesh, everywhere, ~interior, label, reason)
    return chosen & interior


def _initial_damage(
    mesh: Mesh,
    interface: Interface,
    facets: NDArray[np.int32],
    cells: NDArray[np.int32],
    label: str,
) -> NDArray[np.float64]:
    """Initial damage of the bond on owned facets (nf,); collective."""
    if interface.initial_damage is None:
        return np.zeros(len(facets))
    given, what = interface.initial_damage, f"{label}: initial_damage"
    values = facet_values(mesh, interface, given, facets, cells, what)
    message = None
    if not ((values >= 0) & (values <= 1)).all():
        message = (
            f"{what} gives values from {values.min():g} to {values.max():g} on "
            "its facets; it must be a number from 0 to 1 for each, for example lambda x: "
            "np.where(x[0] < 30, 1.0, 0.0)"
        )
    raise_together(mesh.comm, message)
    return values


def _law_on(
    mesh: Mesh,
    interface: Interface,
    facets: NDArray[np.int32],
    cells: NDArray[np.int32],
    label: str,
) -> Law:
    """The law on owned facets; collective."""
    law = interface.law
    values = {
        name: facet_values(mesh, interface, given, facets, cells, f"{label}: {name} of the law")
        for name, given in law.varying.items()
    }
    message = None
    try:
        law = law.with_values(values)
        if interface.largest_strength is not None:
            law = law.weakened(interface.largest_strength)
        # Computed once here: laws at points and their subsets copy it.
        _ = law.softening_modulus
    except ValueError:
        message = f"{label}: {_why_refused(mesh, interface.law, values, facets)}"
    raise_together(mesh.comm, message)
    return law


def _why_refused(
    mesh: Mesh,
    law: Law,
    values: Mapping[str, NDArray[np.float64]],
    facets: NDArray[np.int32],
) -> str:

    def refused(among: range) -> ValueError | None:
        chosen = slice(among.start, among.stop)
        try:
            law.with_values({name: array[chosen] for name, array in values.items()})
        except ValueError as error:
            return error
        return None

    f = bisect_left(range(len(facets)), True, key=lambda f: refused(range(f + 1)) is not None)
    x = compute_midpoints(mesh, mesh.topology.dim - 1, facets[f : f + 1])[0]
    where = ", ".join(f"{a:.6g}" for a in x)
    reason = refused(range(f, f + 1))
    return f"facet {facets[f]} with its midpoint at ({where}): {reason}"


def facet_values(
    mesh: Mesh,
    interface: Interface,
    given: Any,
    facets: NDArray[np.int32],
    cells: NDArray[np.int32],
    what: str,
) -> NDArray[np.float64]:
    """A user's values on the facets of an interface (nf,); collective.

    Args:
        given: A number, an array like ``interface.facets``, f(x) of midpoints x (3, n) [mm], or a
            scalar Function on the mesh: the mean of both sides at the midpoints.
    """
    fdim = mesh.topology.dim - 1
    if isinstance(given, Weibull):
        given = given.on(mesh)
    if not callable(given):
        if np.ndim(given) == 0:
            return np.full(len(facets), given, dtype=float)
        # A facet may be given on ranks other than its owner, and on several.
        sums, counts = (la.vector(mesh.topology.index_map(fdim)) for _ in range(2))
        for vector, values in ((sums, given), (counts, 1.0)):
            vector.array[interface.facets] = values
            vector.scatter_reverse(la.InsertMode.add)
        return sums.array[facets] / counts.array[facets]
    x, message, values = compute_midpoints(mesh, fdim, facets), None, np.zeros(len(facets))
    try:
        found = _at_midpoints(mesh, given, x, cells)
        if found.shape not in ((), values.shape) or not np.isfinite(found).all():
            raise ValueError(f"its values have shape {found.shape}, or are not finite")
        values[:] = found
    except Exception as error:  # a user's function may raise anything
        message = (
            f"{what} must be one finite number for each of the midpoints x (3, {len(facets)}) of "
            f"its facets [mm], or a scalar Function on the mesh: {error}"
        )
    raise_together(mesh.comm, message)
    return values


def _at_midpoints(
    mesh: Mesh, given: Any, x: NDArray[np.float64], cells: NDArray[np.int32]
) -> NDArray[np.float64]:
    if not isinstance(given, fem.Function):
        return as_numbers(at_points(given, x.T))
    if given.function_space.mesh is not mesh or given.ufl_shape != ():
        raise ValueError("it must be a scalar Function on the mesh of the problem")
    if not len(x):
        return np.zeros(0)
    sides = [given.eval(x, np.ascontiguousarray(side)).reshape(len(x)) for side in cells.T]
    return (sides[0] + sides[1]) / 2


def _reversed(
    mesh: Mesh,
    cell_tags: NDArray[np.int32],
    cells: NDArray[np.int32],
    inside: NDArray[np.bool_] | None,
) -> NDArray[np.bool_]:
    """Rows whose first cell is side 2; ``inside`` marks the cells of a level set."""
    first, second = cell_tags[cells].T
    if inside is not None:
        return (first > second) | ((first == second) & ~inside[cells[:, 0]])
    dim = mesh.topology.dim
    one, two = (compute_midpoints(mesh, dim, np.ascontiguousarray(side)) for side in cells.T)
    apart = two - one
    # Midpoints are sums of the same coordinates on every rank up to rounding: compare coarsely.
    apart[np.abs(apart) < 1e-6 * np.abs(apart).max(axis=1, keepdims=True, initial=0.0)] = 0
    leading = apart[np.arange(len(apart)), np.argmax(apart != 0, axis=1)]
    return (first > second) | ((first == second) & (leading < 0))
