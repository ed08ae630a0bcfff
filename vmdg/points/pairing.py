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
from functools import cached_property
from typing import NamedTuple

from mpi4py import MPI

import basix
import numpy as np
import scipy
from dolfinx import fem
from dolfinx.common import IndexMap
from dolfinx.mesh import Mesh, compute_midpoints
from numpy.typing import NDArray

from .. import compat
from ..base.parallel import (
    gathered,
    global_any,
    global_box,
    global_max,
    global_sum,
    raise_together,
    warn_together,
)
from ..domain.shapes import determinants, places_in_cells
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
from .segments import (
    OPEN_REACH,
    OPPOSITE,
    FlatFacets,
    Segments,
    cut,
    inside,
    passed,
    soon_paired,
)

#: Least share of the smaller surface that must lie opposite the other one.
_LEAST_SHARE = 0.01

#: By how much the segments of a facet may exceed it, relative to its area.
_TWICE = 1e-6

#: Gaps that need no warning, relative to the radius of the larger facet: of two polygons along one
#: curve.
_MISFIT = 0.5

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
    """Facets of one body, possibly none of which lies opposite the other one."""

    facets: NDArray[np.int32]  # Local facets, ascending (n,): owned ones of side 1, all of side 2
    cells: NDArray[np.int32]  # Their cells (n,)
    local: NDArray[np.int32]  # Their numbers in these (n,)
    # Distances from a sharp edge or an end of the surface, see :func:`_with_ends` (n,) [mm]
    ends: NDArray[np.float64]

    def owned(self, mesh: Mesh) -> Surface:
        count = mesh.topology.index_map(mesh.topology.dim - 1).size_local
        return Surface(*(array[self.facets < count] for array in self))


@dataclass(frozen=True)
class Surfaces:
    """Two surfaces that share no nodes, side 1 first."""

    mesh: Mesh
    whole: tuple[Surface, Surface]
    tags: NDArray[np.int32]
    damage: NDArray[np.float64]  # Initial damage of the bond, by facets of side 1 (n,)
    law: Law
    label: str
    walled: bool
    first: int
    gaps: bool
    slides: bool  # Whether bodies slide: damage and law are those of the facets of side 1
    moves: bool  # Whether they are paired again in every state, which they are not at small strain
    thickness: float  # Of the thicker body, see :func:`_thickness` [mm]

    @cached_property
    def sides(self) -> tuple[Surface, Surface]:
        """The surfaces, of side 1 the facets that this rank owns."""
        return self.whole[0].owned(self.mesh), self.whole[1]

    @property
    def index_map(self) -> IndexMap:
        return self.mesh.topology.index_map(self.mesh.topology.dim - 1)

    @cached_property
    def names(self) -> list[NDArray[np.int64]]:
        """Global numbers of the facets of both whole surfaces."""
        return [self.index_map.local_to_global(side.facets) for side in self.whole]

    @cached_property
    def _owned(self) -> NDArray[np.intp]:
        """Rows of the facets of side 1 that this rank owns."""
        return np.flatnonzero(np.isin(self.whole[0].facets, self.sides[0].facets))

    @cached_property
    def reference(self) -> tuple[FlatFacets, FlatFacets]:
        """The whole surfaces in the reference configuration."""
        one, two = self.whole
        return _flat_facets(self.mesh, one, None), _flat_facets(self.mesh, two, None)

    def flat(self, u: fem.Function | None) -> tuple[FlatFacets, FlatFacets]:
        """The whole surfaces in the configuration of a displacement; None for the reference
        configuration."""
        if u is None:
            return self.reference
        one, two = self.whole
        return _flat_facets(self.mesh, one, u), _flat_facets(self.mesh, two, u)

    def _cut(
        self, flat: tuple[FlatFacets, FlatFacets], rows: NDArray[np.intp], bonded: bool
    ) -> Segments:
        """The segments of some facets of side 1, by their rows in ``sides``.

        What holds bodies together spans gaps up to the thickness of the thicker one, contact any
        gap; where it is searched again in every state what is far and open is left out.
        """
        numbers = self._owned[rows]
        most = self.thickness if bonded or not self.gaps else np.inf
        reach = OPEN_REACH if self.moves and not bonded else np.inf
        found = cut(flat[0].rows(numbers), flat[1], most, reach, (flat[0], numbers))
        return found._replace(first=rows[found.first])

    def pairs(
        self, u: fem.Function | None = None, bonded: NDArray[np.bool_] | None = None
    ) -> PairedFacets:
        """The pairs in the configuration of a displacement.

        Args:
            bonded: Facets of side 1 whose bond holds, (n,): their pairs, the first ones, are those
                of the reference configuration. None for none.
        """
        flat, rows = self.flat(u), np.arange(len(self.sides[0].facets))
        if bonded is None or not bonded.any():
            return self._from(flat, self._cut(flat, rows, False), 0)
        reference = self.reference
        parts = [
            self._cut(reference, rows[bonded], True),
            self._cut(flat, rows[~bonded], False),
        ]
        return self._from(reference, Segments.joined(parts), len(parts[0].first))

    def _from(
        self, flat: tuple[FlatFacets, FlatFacets], segments: Segments, bonded: int
    ) -> PairedFacets:
        """The pairs of some segments; areas are those of ``flat``."""
        both = list(zip(self.sides, (segments.first, segments.second), strict=True))
        cells = np.column_stack([side.cells[rows] for side, rows in both])
        numbers = self._owned[segments.first], segments.second
        areas = [one.measures[rows] for one, rows in zip(flat, numbers, strict=True)]
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
            segments=segments,
            extent=measures.max(axis=1, initial=0.0) ** (1 / (self.mesh.topology.dim - 1)),
            surfaces=self,
            bonded=bonded,
        )

    @cached_property
    def spheres(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Centres (n, d) and radii (n,) of the facets of side 1 before deformation [mm]."""
        flat = self.reference[0].rows(self._owned)
        return flat.centres, flat.radii

    def intact(self) -> NDArray[np.bool_]:
        """Facets of side 1 that are bonded at the start (n,)."""
        return (self.damage < 1.0) & self.law.has_bond

    def overlap(
        self, segments: Segments, u: fem.Function | None = None
    ) -> tuple[float, NDArray[np.float64] | None]:
        """The largest depth by which one body is in the other though nothing is paired nearby, and
        the place, on this rank [mm]; collective."""
        flat, paired = self.flat(u), self._paired(segments)
        deepest = global_max(self.mesh.comm, -segments.away.min(initial=0.0))
        most, place = 0.0, None
        for a, b in ((0, 1), (1, 0)):
            rows = self._alone(a, paired[a])
            facets = flat[a].rows(rows)
            depth = inside(facets, flat[b], np.flatnonzero(paired[b]), deepest)
            if len(depth) and depth.max() > most:
                most, place = float(depth.max()), facets.centres[depth.argmax()]
        return most, place

    def passed(self, segments: Segments, u: fem.Function, start: NDArray[np.float64]) -> bool:
        """Whether in a step from a displacement, local dofs [mm], one body has moved into or
        through the other one, where nothing is paired; collective, the answer is that of this
        rank."""
        found = [self.overlap(segments, u)[1] is not None]
        before = u.copy()
        before.x.array[:] = start
        now, then = self.flat(u), self.flat(before)
        for a, paired in enumerate(self._paired(segments)):
            rows, b = self._alone(a, paired), 1 - a
            found.append(passed(now[a].rows(rows), now[b], (then[a].rows(rows), then[b])))
        return any(found)

    def _paired(self, segments: Segments) -> list[NDArray[np.bool_]]:
        """Which facets of the whole surfaces are paired on any rank; collective."""
        numbers, comm = (self._owned[segments.first], segments.second), self.mesh.comm
        return [
            np.isin(names, gathered(comm, np.unique(names[rows])))
            for names, rows in zip(self.names, numbers, strict=True)
        ]

    def _alone(self, a: int, paired: NDArray[np.bool_]) -> NDArray[np.intp]:
        """Rows of the facets of a whole surface that this rank owns and that are not paired."""
        owned = np.isin(self.whole[a].facets, self.whole[a].owned(self.mesh).facets)
        return np.flatnonzero(owned & ~paired)

    def near(self, u: fem.Function) -> NDArray[np.intp]:
        """Rows of the two surfaces whose facets are or may soon be paired (n, 2)."""
        one, two = self.flat(u)
        return np.column_stack(soon_paired(one.rows(self._owned), two, OPEN_REACH))


@dataclass(frozen=True, kw_only=True)
class PairedFacets(InterfaceFacets):
    """Pairs of facets of two surfaces, in the place of facets: one row for every segment.

    Attributes:
        facets: Facet of side 1 (ns,).
        everywhere: Facets of both surfaces that belong to a pair.
        others: Facet of side 2 (ns,).
        extent: Length of the larger facet of a pair, in 3D the square root of its area (ns,) [mm].
        bonded: Number of leading rows that keep the pairs of the reference configuration, though
            surfaces slide.
    """

    others: NDArray[np.int32]
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
    def chosen_side(self) -> int | None:
        return self.surfaces.first if self.surfaces.slides else None

    @property
    def first_side(self) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int32]]:
        """See the base class; of surfaces that slide all facets of side 1."""
        return tuple(self.surfaces.sides[0][:3]) if self.slides else super().first_side

    def rows_of(self, other: InterfaceFacets) -> NDArray[np.intp]:
        return np.arange(len(self.facets))

    @property
    def paired(self) -> bool:
        return True

    @property
    def slides(self) -> bool:
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

    def shared(self, other: PairedFacets) -> NDArray[np.int64]:
        """Pairs of facets, by global numbers, that belong to another interface too, or may where
        surfaces slide (n, 2); collective."""
        if self.slides and other.slides:
            mine, theirs = (one.surfaces.names for one in (self, other))
            ways = [
                [np.intersect1d(*both) for both in zip(mine, order, strict=True)]
                for order in (theirs, theirs[::-1])
            ]
            return np.array([[a[0], b[0]] for a, b in ways if len(a) and len(b)]).reshape(-1, 2)
        if self.slides:
            return other.shared(self)
        pairs = self._named_pairs
        if other.slides:
            a, b = other.surfaces.names
            one, two = pairs.T
            found = np.isin(one, a) & np.isin(two, b) | np.isin(one, b) & np.isin(two, a)
            return pairs[found]
        both = [np.unique(np.sort(each, axis=1), axis=0) for each in (pairs, other._named_pairs)]
        found, counts = np.unique(np.concatenate(both), axis=0, return_counts=True)
        return found[counts > 1]

    @cached_property
    def _named_pairs(self) -> NDArray[np.int64]:
        """Global numbers of the facets of all pairs of all ranks (n, 2); collective."""
        index_map = self.surfaces.index_map
        names = [index_map.local_to_global(each) for each in (self.facets, self.others)]
        return gathered(self.surfaces.mesh.comm, np.column_stack(names))

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
    """The facets of an interface, or the pairs of facets where its bodies share no nodes, side 1 of
    surfaces that slide by the stiffness of cells [MPa]; collective."""
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
    count = len(one.owned(mesh).facets)
    found = Surfaces(
        mesh,
        (one, two),
        cell_tags,
        damage=np.zeros(count),
        law=interface.law,
        label=label,
        walled=False,
        first=tags[0],
        gaps=interface.gap == KEEP,
        slides=interface.sliding,
        moves=interface.sliding and not small,
        thickness=max(_thickness(mesh, cell_tags, side) for side in (one, two)),
    )
    one = found.sides[0]
    given, whole = (mesh, interface), interface.surfaces is None
    if found.slides:
        # The partners of a facet are not known in advance.
        each = [cell_tags[side.cells] for side in (one, two.owned(mesh))]
        each[0] = np.column_stack([each[0], np.full(len(each[0]), tags[1])])
        each[1] = np.column_stack([np.full(len(each[1]), tags[0]), each[1]])
        both, sides = np.concatenate(each), np.column_stack([one.cells, one.cells])
        damage, law, _, walled = facet_properties(*given, one.facets, sides, both, walls, label)
        found = replace(found, damage=damage, law=law, walled=walled)
    pairs = found.pairs(bonded=found.intact() if found.slides else None)
    if not found.slides:
        given = *given, pairs.facets, pairs.cells, pairs.tags, walls, label
        damage, law, _, walled = facet_properties(*given)
        pairs = replace(pairs, damage=damage, law=law, walled=walled)
    _check_pairs(comm, pairs, whole)
    return pairs


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
    """Refuse what an interface between meshes that do not match cannot have."""
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
    """Check that every rank knows all facets of both surfaces; collective."""
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


def _thickness(mesh: Mesh, cell_tags: NDArray[np.int32], side: Surface) -> float:
    """Mean thickness of the body of a surface, 2 V/A, of a plate its own [mm]; collective."""
    tags, cell = np.unique(cell_tags[side.cells]), mesh.basix_cell()
    owned = mesh.topology.index_map(mesh.topology.dim).size_local
    cells = np.flatnonzero(np.isin(cell_tags[:owned], tags)).astype(np.int32)
    points, weights = basix.make_quadrature(cell, compat.coordinate_element(mesh).degree + 1)
    _, J = places_in_cells(mesh, cells, np.broadcast_to(points, (len(cells), *points.shape)))
    mine = np.isin(cell_tags[facet_cells(mesh)[:, 0]], tags) & outer_facets(mesh)
    outer = _surface(mesh, np.flatnonzero(mine).astype(np.int32)).owned(mesh)
    area = _flat_facets(mesh, outer, None).measures.sum()
    volume, area = global_sum(mesh.comm, [(np.abs(determinants(J)) @ weights).sum(), area])
    return 2 * float(volume / area)


def _check_pairs(comm: MPI.Comm, pairs: PairedFacets, whole: bool) -> None:
    """Check the first pairs of two surfaces, or of the ``whole`` surfaces of two groups;
    collective."""
    surfaces, segments = pairs.surfaces, pairs.segments
    flat, label = surfaces.reference, surfaces.label
    if surfaces.gaps:
        _refuse_overlap(comm, surfaces, segments)
    if surfaces.moves:
        if not global_any(comm, surfaces.intact().any()):
            return
        segments = segments.rows(slice(0, pairs.bonded))
    area, two = flat[0].measures[surfaces._owned], flat[1].measures.sum()
    common, one, count = global_sum(comm, [segments.measures.sum(), area.sum(), len(area)])
    share = common / min(one, two)
    joined = not surfaces.gaps or surfaces.moves
    facing = "their normals are opposite and nothing is between them"
    if joined:
        facing += (
            f", and no farther apart than the mean thickness of the thicker body, "
            f"{surfaces.thickness:.3g} mm"
        )
    if whole and share == 0.0:
        raise ValueError(
            f"{label} has no facet: the tags are not adjacent, nor do the surfaces of their bodies "
            f"lie opposite each other (facets form a pair where {facing}); {_REMEDY}"
        )
    if not whole and share < _LEAST_SHARE:
        apart = global_sum(comm, flat[0].centres[surfaces._owned].sum(axis=0)) / count
        apart -= flat[1].centres.mean(axis=0)
        raise ValueError(
            f"{label}: its two surfaces lie opposite each other on {100 * share:.2g} % of the "
            f"smaller one: facets form a pair where {facing}. The centres of the surfaces are "
            f"{np.linalg.norm(apart):.3g} mm apart: are these the surfaces that touch, and do both "
            "meshes have the same units and origin?"
        )
    if joined:
        _check_joined(comm, surfaces, segments, area)


def _refuse_overlap(comm: MPI.Comm, surfaces: Surfaces, segments: Segments) -> None:
    """Refuse bodies that overlap at the start where there is no pair, or by more than the thicker
    one is thick; collective."""
    depth, place = surfaces.overlap(segments)
    message, why = None, "where no facet faces it"
    if len(segments.away) and -segments.away.min() > surfaces.thickness:
        k = segments.away.argmin()
        depth, place = -segments.away[k], segments.origins[k]
        why = f"more than the thicker one is thick, {surfaces.thickness:.3g} mm"
    if place is not None:
        at = ", ".join(f"{x:.6g}" for x in place)
        message = (
            f"{surfaces.label}: at the start the facet at ({at}) is {depth:.3g} mm inside the "
            f"other body, {why}: do both meshes have the same units and origin? Else give only the "
            "facets that may touch, by surfaces=(facets_1, facets_2), or a smaller overlap"
        )
    raise_together(comm, message)


def _check_joined(
    comm: MPI.Comm, surfaces: Surfaces, segments: Segments, area: NDArray[np.float64]
) -> None:
    """Check bodies that are joined across gaps, if any, and say how much of side 1, with facets of
    this ``area``, they leave out; collective."""
    flat, label = surfaces.reference, surfaces.label
    covered = np.bincount(segments.first, segments.measures, minlength=len(area))
    twice, message = np.flatnonzero(covered > (1 + _TWICE) * area), None
    if len(twice):
        place = ", ".join(f"{x:.6g}" for x in flat[0].centres[surfaces._owned[twice[0]]])
        message = (
            f"{label}: the facet at ({place}) of side 1 lies opposite side 2 more than once; give "
            "only the facets that touch, by surfaces=(facets_1, facets_2)"
        )
    raise_together(comm, message)
    rows = np.flatnonzero(surfaces.intact()) if surfaces.moves else np.arange(len(area))
    numbers = surfaces._owned[rows]
    facing = cut(flat[0].rows(numbers), flat[1], whole=(flat[0], numbers))
    wide = np.abs(segments.away) > _MISFIT * np.maximum(
        flat[0].radii[surfaces._owned[segments.first]], flat[1].radii[segments.second]
    )
    given = facing.measures, segments.measures, segments.measures[wide]
    faces, joins, spans = global_sum(comm, [each.sum() for each in given])
    widest = global_max(comm, np.abs(segments.away).max(initial=0.0))
    said = []
    if joins < (1 - _TWICE) * faces:
        said.append(
            f"{100 * (1 - joins / faces):.3g} % of what faces the other body is left out: it is "
            f"farther away than the thicker body is thick, {surfaces.thickness:.3g} mm"
        )
    if spans > 0:
        said.append(
            f"{100 * spans / joins:.3g} % of it spans gaps, of up to {widest:.3g} mm, as if the "
            "bodies touched"
        )
    text = "; ".join(said)
    hint = "give the facets that are joined, by surfaces=(facets_1, facets_2), or move the meshes"
    warn_together(comm, f"{label}: {text}; if that is not meant, {hint}" if said else None)
