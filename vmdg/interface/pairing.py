"""Interfaces between surfaces that share no nodes: their facets in pairs, segment by segment.

A pair belongs to the rank that owns its facet of side 1; side 2 is known on every rank, its cells
of other ranks as ghosts, see :func:`vmdg.meshes.partition.cell_partitioner`.

Surfaces that slide are paired again in every state, see :meth:`Surfaces.pairs`. At small strain
displacements are small, so that pairs of the reference configuration are right to the same order:
there surfaces keep them, with their distance as a gap.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from mpi4py import MPI

import basix
import numpy as np
import scipy
from dolfinx import fem
from dolfinx.mesh import Mesh, compute_midpoints
from numpy.typing import NDArray

from .. import compat
from ..base.parallel import global_any, global_box, global_max, global_sum, raise_together
from ..domain.tags import group_tag
from ..domain.topology import (
    UNTAGGED,
    checked_facets,
    facet_cells,
    local_facets,
    mark_everywhere,
    outer_facets,
    refuse_facets,
)
from ..forms.geometry import CARTESIAN, Geometry
from ..laws import Law
from .facets import InterfaceFacets, facet_properties, find_facets
from .interface import KEEP, Interface
from .segments import FAR_REACH, OPPOSITE, REACH, FlatFacets, Segments, cut, passed, soon_paired

#: Least share of the smaller surface that must lie opposite the other one.
_LEAST_SHARE = 0.01

#: By how much the segments of a facet may exceed it, relative to its area.
_TWICE = 1e-6

#: Ratio of moduli above which one body is the stiffer one, difference of angles from which one
#: surface is the flatter one, and rounding of lengths.
_STIFFER, _FLATTER, _ROUNDING = 1.5, 0.01, 1e-9

#: Mean modulus of cells [MPa].
Stiffness = Callable[[NDArray[np.int32]], float]

#: What an interface between meshes that do not match cannot have.
NONMATCHING = "an interface whose meshes do not match"

_REMEDY = (
    "check units and origins of meshes that were made separately, or make the mesh conforming, for "
    "example by gmsh.model.occ.fragment"
)


class Surface(NamedTuple):
    """Facets of one body, possibly none of which lies opposite the other one.

    Attributes:
        facets: Local facets, ascending (n,): owned ones of side 1, all of side 2.
        cells: Their cells (n,).
        local: Their numbers in these (n,).
        ends: Distances from a sharp edge or an end of the surface, see :func:`_with_ends` (n,)
            [mm].
    """

    facets: NDArray[np.int32]
    cells: NDArray[np.int32]
    local: NDArray[np.int32]
    ends: NDArray[np.float64]

    def owned(self, mesh: Mesh) -> Surface:
        """The facets that this rank owns."""
        count = mesh.topology.index_map(mesh.topology.dim - 1).size_local
        return Surface(*(array[self.facets < count] for array in self))


@dataclass(frozen=True)
class Surfaces:
    """Two surfaces that share no nodes, side 1 first.

    Attributes:
        mesh: The mesh.
        sides: The surfaces.
        tags: Tag of every local cell.
        damage: Initial damage of the bond, by facets of side 1 (n,).
        law: The law on these facets.
        label: Name of the interface in messages.
        walled: Whether one side is a rigid wall.
        first: Cell tag of side 1.
        gaps: Whether their distance counts as a gap.
        slides: Whether bodies slide: damage and law are those of the facets of side 1.
        moves: Whether they are paired again in every state, which they are not at small strain.
    """

    mesh: Mesh
    sides: tuple[Surface, Surface]
    tags: NDArray[np.int32]
    damage: NDArray[np.float64]
    law: Law
    label: str
    walled: bool
    first: int
    gaps: bool
    slides: bool
    moves: bool

    @property
    def reach(self) -> float:
        """Largest distance of a pair, relative to the larger facet's radius."""
        return FAR_REACH if self.gaps else REACH

    def flat(self, u: fem.Function | None = None) -> tuple[FlatFacets, FlatFacets]:
        """Both in the configuration of a displacement; None for the reference configuration."""
        one, two = self.sides
        return _flat_facets(self.mesh, one, u), _flat_facets(self.mesh, two, u)

    def pairs(
        self, u: fem.Function | None = None, bonded: NDArray[np.bool_] | None = None
    ) -> PairedFacets:
        """The pairs in the configuration of a displacement.

        Args:
            u: The displacement; None for the reference configuration.
            bonded: Facets of side 1 whose bond holds, (n,): their pairs, the first ones, are those
                of the reference configuration. None for none.
        """
        flat = self.flat(u)
        if bonded is None or not bonded.any():
            return self._from(flat, cut(*flat, self.reach), 0)
        reference = self.flat()
        parts = []
        for one, chosen, reach in (
            (reference, bonded, REACH),
            (flat, ~bonded, self.reach),
        ):
            rows = np.flatnonzero(chosen)
            found = cut(one[0].rows(rows), one[1], reach)
            parts.append(found._replace(first=rows[found.first]))
        return self._from(reference, Segments.joined(parts), len(parts[0].first))

    def _from(
        self, flat: tuple[FlatFacets, FlatFacets], segments: Segments, bonded: int
    ) -> PairedFacets:
        """The pairs of some segments; areas are those of ``flat``."""
        both = list(zip(self.sides, (segments.first, segments.second), strict=True))
        cells = np.column_stack([side.cells[rows] for side, rows in both])
        areas = [one.measures[rows] for one, (_, rows) in zip(flat, both, strict=True)]
        measures = np.column_stack(areas)
        everywhere = np.unique(np.concatenate([side.facets[rows] for side, rows in both]))
        return PairedFacets(
            both[0][0].facets[segments.first],
            cells,
            np.column_stack([side.local[rows] for side, rows in both]),
            self.tags[cells],
            everywhere.astype(np.int32),
            self.damage[segments.first],
            self.law.at(segments.first) if self.slides else self.law,
            self.label,
            self.walled,
            others=both[1][0].facets[segments.second],
            shares=segments.measures[:, None] / measures,
            segments=segments,
            extent=measures.max(axis=1, initial=0.0) ** (1 / (self.mesh.topology.dim - 1)),
            surfaces=self,
            bonded=bonded,
        )

    def intact(self) -> NDArray[np.bool_]:
        """Facets of side 1 that are bonded at the start (n,)."""
        return (self.damage < 1.0) & self.law.has_bond

    def passed(self, u: fem.Function, start: NDArray[np.float64], paired: NDArray[np.intp]) -> bool:
        """Whether facets of side 1 have moved into the other body, too far to be paired.

        Args:
            u: Displacement.
            start: Displacement at the start of the step, local dofs [mm].
            paired: Facets that are paired.
        """
        rows = np.setdiff1d(np.arange(len(self.sides[0].facets)), paired)
        before = u.copy()
        before.x.array[:] = start
        (one, two), (first, second) = self.flat(u), self.flat(before)
        return passed(one.rows(rows), two, (first.rows(rows), second), self.reach)

    def near(self, u: fem.Function) -> NDArray[np.intp]:
        """Rows of the two surfaces whose facets are or may soon be paired (n, 2)."""
        return np.column_stack(soon_paired(*self.flat(u), self.reach))


@dataclass(frozen=True, kw_only=True)
class PairedFacets(InterfaceFacets):
    """Pairs of facets of two surfaces, in the place of facets: one row for every segment.

    Attributes:
        facets: Facet of side 1 (ns,).
        everywhere: Facets of both surfaces that belong to a pair.
        others: Facet of side 2 (ns,).
        shares: Fraction of each of the two facets that the segment covers (ns, 2).
        segments: The segments.
        extent: Length of the larger facet of a pair, in 3D the square root of its area (ns,) [mm].
        surfaces: Where they come from.
        bonded: Number of leading rows that keep the pairs of the reference configuration, though
            surfaces slide.
    """

    others: NDArray[np.int32]
    shares: NDArray[np.float64]
    segments: Segments
    extent: NDArray[np.float64]
    surfaces: Surfaces
    bonded: int = 0

    @property
    def cut(self) -> NDArray[np.int32]:
        """None: the bodies share no nodes."""
        return np.zeros(0, dtype=np.int32)

    def cells_of(self, a: int) -> NDArray[np.int32]:
        """See the base class; of the whole surface."""
        return self.surfaces.sides[a].cells

    @property
    def distinct(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Of side 1."""
        _, rows, where = np.unique(self.facets, return_index=True, return_inverse=True)
        return rows, where.ravel()

    @property
    def chosen_side(self) -> int | None:
        """See the base class."""
        return self.surfaces.first if self.surfaces.slides else None

    @property
    def first_side(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
        """See the base class; of surfaces that slide all facets of side 1."""
        return tuple(self.surfaces.sides[0][:3]) if self.slides else super().first_side

    def rows_of(self, other: InterfaceFacets) -> NDArray[np.intp]:
        """All: the pairs do not change."""
        return np.arange(len(self.facets))

    @property
    def paired(self) -> bool:
        """Always."""
        return True

    @property
    def slides(self) -> bool:
        """Whether the pairs change with the displacement."""
        return self.surfaces.moves

    @property
    def second_leads(self) -> NDArray[np.bool_]:
        """Pairs of contact whose normal is that of side 2 (ns,).

        Where a sharp edge meets a face, pressures are normal to the face, which slides past the
        edge: v = v_2 - v_1 is along it. Normal to the other facet they would have a power p n.v at
        no change of energy. Facets of the other surface are partly covered at an edge, so that they
        are inclined there by an angle that goes to zero with h^a, a < 1/2, only, where p grows with
        h^-a.
        """
        surfaces = self.surfaces
        if not surfaces.gaps or (surfaces.law.has_bond and not surfaces.slides):
            return np.zeros(len(self.facets), dtype=bool)
        one, two = (side.ends for side in surfaces.sides)
        leads = one[self.segments.first] < (1 - _ROUNDING) * two[self.segments.second]
        leads[: self.bonded] = False
        return leads

    @property
    def size(self) -> int:
        """Number of pairs, for surfaces that slide of facets of side 1."""
        return len(self.surfaces.sides[0].facets) if self.slides else len(self.facets)

    def among(self, mark: NDArray[np.bool_]) -> PairedFacets:
        """All: such an interface is open from the start."""
        return self


def place(
    mesh: Mesh,
    cell_tags: NDArray[np.int32],
    interface: Interface,
    names: Mapping[str, int] | None = None,
    label: str | None = None,
    walls: Collection[int] = (),
    stiffness: Stiffness | None = None,
    geometry: Geometry = CARTESIAN,
    small: bool = False,
) -> InterfaceFacets:
    """The facets of an interface, or the pairs of facets where its bodies share no nodes;
    collective.

    Args:
        mesh, cell_tags, interface, names, label, walls: As for :func:`.find_facets`.
        stiffness: Of cells [MPa], to choose side 1 of surfaces that slide.
        geometry: Whose axis is no surface.
        small: Small-strain kinematics, with pairs of the reference configuration.

    Raises:
        ValueError: as in :func:`.find_facets`; the surfaces do not lie opposite each other, a facet
            lies inside the mesh or in both of them, or the interface has options that those between
            meshes that do not match do not have.
    """
    label, comm = label or str(interface), mesh.comm
    fdim = mesh.topology.dim - 1
    if interface.surfaces is not None:
        given = [np.unique(checked_facets(mesh, facets, label)) for facets in interface.surfaces]
        marks = [mark_everywhere(mesh, fdim, facets) for facets in given]
        surfaces = [np.flatnonzero(mark).astype(np.int32) for mark in marks]
        outer = outer_facets(mesh)
        reason = (
            "lies inside the mesh; surfaces= takes facets of the surfaces of two bodies that share "
            "no nodes, for facets inside the mesh use facets="
        )
        for surface in surfaces:
            refuse_facets(mesh, surface, ~outer, label, reason)
        reason = "is in both of the surfaces; give each facet to one side"
        refuse_facets(mesh, surfaces[0], marks[1], label, reason)
    else:
        found = _apart(mesh, cell_tags, interface, names or {}, label)
        if found is None and (interface.sliding or interface.gap == KEEP):
            what = "sliding=True" if interface.sliding else f'gap="{KEEP}"'
            raise ValueError(
                f"{label}: {what} needs two bodies that share no nodes: mesh them separately and "
                "put them together by vmdg.meshes.apart"
            )
        if found is None:
            return find_facets(mesh, cell_tags, interface, names, label, walls)
        surfaces = found
    _check_options(mesh, interface, label)
    middles = [compute_midpoints(mesh, fdim, facets).T for facets in surfaces]
    off = [np.abs(geometry.circumference(x) + 0 * x[0]) for x in middles]
    far = [global_max(comm, a.max(initial=0.0)) for a in off]
    surfaces = [f[a > _ROUNDING * m] for f, a, m in zip(surfaces, off, far, strict=True)]
    _check_whole(mesh, surfaces, interface, label)
    one, two = (_surface(mesh, facets) for facets in surfaces)
    one, two = _with_ends(mesh, one, two), _with_ends(mesh, two, one)
    if interface.sliding and interface.surfaces is None and stiffness is not None:
        # Means differ by rounding from rank to rank.
        first = comm.bcast(_before(mesh, one, two, stiffness))
        one, two = (one, two) if first else (two, one)
    tags = [int(comm.bcast(cell_tags[side.cells[0]])) for side in (one, two)]
    gaps, one = interface.gap == KEEP, one.owned(mesh)
    found = Surfaces(
        mesh,
        (one, two),
        cell_tags,
        damage=np.zeros(len(one.facets)),
        law=interface.law,
        label=label,
        walled=False,
        first=tags[0],
        gaps=gaps,
        slides=interface.sliding,
        moves=interface.sliding and not small,
    )
    given, whole = (mesh, interface), interface.surfaces is None
    if found.slides:
        # The partners of a facet are not known in advance.
        each = [cell_tags[side.cells] for side in (one, two.owned(mesh))]
        each[0] = np.column_stack([each[0], np.full(len(each[0]), tags[1])])
        each[1] = np.column_stack([np.full(len(each[1]), tags[0]), each[1]])
        both, sides = np.concatenate(each), np.column_stack([one.cells, one.cells])
        damage, law, _, walled = facet_properties(*given, one.facets, sides, both, walls, label)
        found = replace(found, damage=damage, law=law, walled=walled)
        pairs = found.pairs(bonded=found.intact())
        if not found.moves:
            _check_overlap(comm, label, found.flat(), pairs.segments, found.reach, whole)
        return pairs
    pairs = found.pairs()
    _check_overlap(comm, label, found.flat(), pairs.segments, found.reach, whole)
    given = *given, pairs.facets, pairs.cells, pairs.tags, walls, label
    damage, law, _, walled = facet_properties(*given)
    return replace(pairs, damage=damage, law=law, walled=walled)


def _apart(
    mesh: Mesh,
    cell_tags: NDArray[np.int32],
    interface: Interface,
    names: Mapping[str, int],
    label: str,
) -> list[NDArray[np.int32]] | None:
    """Boundary facets of two groups that share no facet; None where they do, and for other
    interfaces; collective."""
    between, comm = interface.between, mesh.comm
    if not isinstance(between, Sequence | np.ndarray) or isinstance(between, str):
        return None
    wanted = sorted(group_tag(group, names, label) for group in between)
    cells = facet_cells(mesh)
    tags = np.where(cells >= 0, cell_tags[cells], UNTAGGED)
    if global_any(comm, (np.sort(tags, axis=1) == wanted).all(axis=1).any()):
        return None
    outer = outer_facets(mesh)
    surfaces = [np.flatnonzero(outer & (tags[:, 0] == tag)).astype(np.int32) for tag in wanted]
    return surfaces if global_sum(comm, [len(facets) for facets in surfaces]).all() else None


def _check_options(mesh: Mesh, interface: Interface, label: str) -> None:
    """Raises:
    ValueError: what an interface between meshes that do not match cannot have.
    """
    what = f"{label}: {NONMATCHING} cannot"
    if interface.activate != "all":
        raise ValueError(f'{what} open on demand; omit activate="{interface.activate}"')
    if interface.traction_jump:
        raise ValueError(f"{what} have traction_jump=True; omit it")
    if interface.stabilization is not None:
        raise ValueError(f"{what} have a stabilization= of its own; scale tau_s by safety=")
    if mesh.topology.dim == 3 and compat.coordinate_element(mesh).degree > 1:
        raise ValueError(
            f"{what} lie between curved cells in 3D; mesh with straight ones (gmsh: "
            "mesh.setOrder(1))"
        )


def _check_whole(
    mesh: Mesh, surfaces: Sequence[NDArray[np.int32]], interface: Interface, label: str
) -> None:
    """Check that every rank knows all facets of both surfaces; collective.

    Raises:
        ValueError: a surface has no facet, is far from the other, or is not known as a whole.
    """
    owned = mesh.topology.index_map(mesh.topology.dim - 1).size_local
    counts = global_sum(mesh.comm, [(facets < owned).sum() for facets in surfaces])
    if not counts.all():
        raise ValueError(
            f"{label} has no facet on side {1 if not counts[0] else 2}: surfaces= has an empty "
            "array; does the mesh have facets with this tag?"
        )
    message, comm = None, mesh.comm
    known = [len(facets) for facets in surfaces] == counts.tolist()
    if global_any(comm, not known) and interface.surfaces is None and not interface.sliding:
        # Groups of one body, given by mistake, whose surfaces no rank knows as a whole.
        flat = [_flat_facets(mesh, _surface(mesh, facets), None) for facets in surfaces]
        ends = [f.centres + sign * f.radii[:, None] for f in flat for sign in (-1, 1)]
        (low, _), (_, high), (under, _), (_, over) = (global_box(comm, x) for x in ends)
        if (np.maximum(low - over, under - high) > 0).any():
            raise ValueError(
                f"{label} has no facet: the tags are not adjacent, nor are the surfaces of their "
                f"bodies near each other; {_REMEDY}"
            )
    if not known:
        message = (
            f"{label} is {NONMATCHING}, and not every rank has the cells at its surfaces as "
            "ghosts: make the mesh by vmdg.meshes (apart, distribute, read_mesh), or in DOLFINx "
            "with partitioner=vmdg.meshes.cell_partitioner()"
        )
    raise_together(mesh.comm, message)


def _surface(mesh: Mesh, facets: NDArray[np.int32]) -> Surface:
    """Boundary facets with their cells."""
    cells = facet_cells(mesh)[facets, 0]
    ends = np.full(len(facets), np.inf)
    return Surface(facets, cells, local_facets(mesh, cells, facets), ends)


def _with_ends(mesh: Mesh, surface: Surface, other: Surface) -> Surface:
    """The surface with the distances of its facets from its sharp edges and ends; infinite from the
    size of the largest facet of the other one on, which the edge may cover in part.

    An edge is sharp where it is convex and turns by more than facets of a pair may.
    """
    flat, corners = _flat_facets(mesh, surface, None), _corner_nodes(mesh, surface)
    count = corners.shape[1]
    if count == 2:
        sides = corners.reshape(-1, 1)
    else:
        sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2)
    _, first, side, times = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    side, facet = side.ravel(), np.arange(len(sides)) // count
    # The other facet of each side; itself at an end.
    neighbours = np.bincount(side, facet, minlength=len(first))[side].astype(int) - facet
    neighbours[times[side] != 2] = 0
    turn = np.einsum("si,si->s", flat.normals[facet], flat.normals[neighbours])
    way = flat.centres[neighbours] - flat.centres[facet]
    sharp = (turn < OPPOSITE) & (np.einsum("si,si->s", flat.normals[facet], way) < 0)
    sharp[times[side] == 1] = True
    if not sharp.any() or not len(other.facets):
        return surface
    x = mesh.geometry.x
    edges = scipy.spatial.cKDTree(x[np.unique(sides[sharp])])
    reach = 2 * _flat_facets(mesh, other, None).radii.max() * (1 - _ROUNDING)
    ends = edges.query(x[corners])[0].min(axis=1)
    return surface._replace(ends=np.where(ends < reach, ends, np.inf))


def _corner_nodes(mesh: Mesh, surface: Surface) -> NDArray[np.int32]:
    """Nodes of the mesh at the corners of facets, in order around (n, c)."""
    corners = np.array(basix.topology(mesh.basix_cell())[mesh.geometry.dim - 1])
    if corners.shape[1] == 4:
        corners = corners[:, [0, 1, 3, 2]]
    nodes = compat.geometry_dofmap(mesh)[surface.cells]
    return np.take_along_axis(nodes, corners[surface.local], axis=1)


def _before(mesh: Mesh, one: Surface, two: Surface, stiffness: Stiffness) -> bool:
    """Whether a surface is to be side 1 rather than another: that of the stiffer body, else the
    flatter one, else that with the longer facets."""
    stiff = [stiffness(side.cells) for side in (one, two)]
    bends = [_bend(mesh, side) for side in (one, two)]
    sizes = [_flat_facets(mesh, side, None).radii.mean() for side in (one, two)]
    if max(stiff) > _STIFFER * min(stiff):
        return stiff[0] > stiff[1]
    if abs(bends[0] - bends[1]) > _FLATTER:
        return bends[0] < bends[1]
    return sizes[0] >= (1 - _ROUNDING) * sizes[1]


def _bend(mesh: Mesh, surface: Surface) -> float:
    """Lower quartile of the angles between facets and the mean normals at their corners, which the
    corners of a body do not change."""
    normals = _flat_facets(mesh, surface, None).normals
    nodes, d = _corner_nodes(mesh, surface), mesh.topology.dim
    mean = np.zeros((len(mesh.geometry.x), d))
    np.add.at(mean, nodes, np.repeat(normals[:, None], nodes.shape[1], axis=1))
    edge = np.einsum("fni,fi->fn", mean[nodes], normals) / np.linalg.norm(mean[nodes], axis=2)
    return float(np.quantile(np.arccos(np.clip(edge.mean(axis=1), -1.0, 1.0)), 0.25))


def _flat_facets(mesh: Mesh, surface: Surface, u: fem.Function | None) -> FlatFacets:
    """The facets by their corners, moved by a displacement."""
    d, cell = mesh.topology.dim, mesh.basix_cell()
    corners = np.array(basix.topology(cell)[d - 1], dtype=np.int32)
    if corners.shape[1] == 4:
        corners = corners[:, [0, 1, 3, 2]]
    count = len(basix.topology(cell)[0])
    x = mesh.geometry.x[compat.geometry_dofmap(mesh)[surface.cells][:, :count], :d]
    if u is not None:
        # The first nodes of a cell are its corners.
        nodes = u.function_space.dofmap.list[surface.cells, :count]
        x = x + u.x.array.reshape(-1, d)[nodes]
    on_facet = np.take_along_axis(x, corners[surface.local][..., None], axis=1)
    return FlatFacets.of(on_facet, x.mean(axis=1))


def _check_overlap(
    comm: MPI.Comm,
    label: str,
    flat: Sequence[FlatFacets],
    segments: Segments,
    reach: float,
    whole: bool,
) -> None:
    """Check that the surfaces, or the ``whole`` surfaces of two groups, lie opposite each other
    within this ``reach``; collective.

    Raises:
        ValueError: they do not, or more than once.
    """
    area, two = flat[0].measures, flat[1].measures.sum()
    common, one, count = global_sum(comm, [segments.measures.sum(), area.sum(), len(area)])
    share = common / min(one, two)
    pairs = (
        f"facets form a pair where their normals are opposite and their distance is at most "
        f"{reach:g} times the radius of the larger one"
    )
    if whole and share == 0.0:
        raise ValueError(
            f"{label} has no facet: the tags are not adjacent, nor do the surfaces of their bodies "
            f"lie opposite each other ({pairs}); {_REMEDY}"
        )
    if not whole and share < _LEAST_SHARE:
        apart = global_sum(comm, flat[0].centres.sum(axis=0)) / count
        apart -= flat[1].centres.mean(axis=0)
        raise ValueError(
            f"{label}: its two surfaces lie opposite each other on {100 * share:.2g} % of the "
            f"smaller one: {pairs}. The centres of the surfaces are {np.linalg.norm(apart):.3g} mm "
            "apart: are these the surfaces that touch, and do both meshes have the same units and "
            "origin?"
        )
    covered = np.bincount(segments.first, segments.measures, minlength=len(area))
    twice, message = np.flatnonzero(covered > (1 + _TWICE) * area), None
    if len(twice):
        place = ", ".join(f"{x:.6g}" for x in flat[0].centres[twice[0]])
        message = (
            f"{label}: the facet at ({place}) of side 1 lies opposite side 2 more than once; give "
            "only the facets that touch, by surfaces=(facets_1, facets_2)"
        )
    raise_together(comm, message)
