"""Interfaces between surfaces that share no nodes: their facets in pairs, segment by segment."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import basix
import numpy as np
from dolfinx.mesh import Mesh, exterior_facet_indices
from numpy.typing import NDArray

from .. import compat
from ..domain.tags import group_tag
from ..domain.topology import (
    UNTAGGED,
    checked_facets,
    facet_cells,
    local_facets,
    refuse_facets,
)
from .facets import InterfaceFacets, facet_properties, find_facets
from .interface import Interface
from .segments import FlatFacets, Segments, cut

#: Least share of the smaller surface that must lie opposite the other one.
_LEAST_SHARE = 0.01

#: By how much the segments of a facet may exceed it, relative to its area.
_TWICE = 1e-6

#: What an interface between meshes that do not match cannot have.
NONMATCHING = "an interface whose meshes do not match"


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
    """

    others: NDArray[np.int32]
    shares: NDArray[np.float64]
    segments: Segments
    extent: NDArray[np.float64]

    @property
    def cut(self) -> NDArray[np.int32]:
        """None: the bodies share no nodes."""
        return np.zeros(0, dtype=np.int32)

    @property
    def distinct(self) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Of side 1."""
        _, rows, where = np.unique(self.facets, return_index=True, return_inverse=True)
        return rows, where.ravel()

    def rows_of(self, other: InterfaceFacets) -> NDArray[np.intp]:
        """All: the pairs do not change."""
        return np.arange(len(self.facets))

    @property
    def paired(self) -> bool:
        """Always."""
        return True

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
) -> InterfaceFacets:
    """The facets of an interface, or the pairs of facets where its bodies share no nodes;
    collective.

    Args:
        mesh, cell_tags, interface, names, label, walls: As for :func:`.find_facets`.

    Raises:
        ValueError: as in :func:`.find_facets`; the surfaces do not lie opposite each other, a facet
            lies inside the mesh or in both of them, or the interface has options that those between
            meshes that do not match do not have.
    """
    label = label or str(interface)
    fdim = mesh.topology.dim - 1
    if interface.surfaces is not None:
        surfaces = [np.unique(checked_facets(mesh, given, label)) for given in interface.surfaces]
        inside = (facet_cells(mesh) >= 0).all(axis=1)
        reason = (
            "lies inside the mesh; surfaces= takes facets of the surfaces of two bodies that share "
            "no nodes, for facets inside the mesh use facets="
        )
        for surface in surfaces:
            refuse_facets(mesh, surface, inside, label, reason)
        shared = np.zeros(len(inside), dtype=bool)
        shared[np.intersect1d(*surfaces)] = True
        reason = "is in both of the surfaces; give each facet to one side"
        refuse_facets(mesh, surfaces[0], shared, label, reason)
    else:
        surfaces = _apart(mesh, cell_tags, interface, names or {}, label)
        if surfaces is None:
            return find_facets(mesh, cell_tags, interface, names, label, walls)
    _check_options(mesh, interface, label)
    if not all(map(len, surfaces)):
        raise ValueError(
            f"{label} has no facet on side {1 if not len(surfaces[0]) else 2}: surfaces= has an "
            "empty array; does the mesh have facets with this tag?"
        )
    cells, local, flat = zip(*(_flat_facets(mesh, surface) for surface in surfaces), strict=True)
    segments = cut(*flat)
    _check_overlap(label, flat, segments, interface.surfaces is None)
    rows = segments.first, segments.second
    of_cells, of_local = (
        np.column_stack([side[row] for side, row in zip(sides, rows, strict=True)])
        for sides in (cells, local)
    )
    both = [surface[row] for surface, row in zip(surfaces, rows, strict=True)]
    areas = np.column_stack([one.measures[row] for one, row in zip(flat, rows, strict=True)])
    tags = cell_tags[of_cells]
    properties = facet_properties(mesh, interface, both[0], of_cells, tags, walls, label)
    everywhere = np.unique(np.concatenate(both)).astype(np.int32)
    return PairedFacets(
        both[0],
        of_cells,
        of_local,
        tags,
        everywhere,
        *properties,
        others=both[1],
        shares=segments.measures[:, None] / areas,
        segments=segments,
        extent=areas.max(axis=1) ** (1 / fdim),
    )


def _apart(
    mesh: Mesh,
    cell_tags: NDArray[np.int32],
    interface: Interface,
    names: Mapping[str, int],
    label: str,
) -> list[NDArray[np.int32]] | None:
    """Boundary facets of two groups that share no facet; None where they do, for other interfaces,
    and on several ranks."""
    between = interface.between
    several = not isinstance(between, Sequence | np.ndarray) or isinstance(between, str)
    if several or mesh.comm.size > 1:
        return None
    wanted = sorted(group_tag(group, names, label) for group in between)
    cells = facet_cells(mesh)
    tags = np.where(cells >= 0, cell_tags[cells], UNTAGGED)
    if (np.sort(tags, axis=1) == wanted).all(axis=1).any():
        return None
    outer = exterior_facet_indices(mesh.topology)
    surfaces = [outer[tags[outer, 0] == tag] for tag in wanted]
    return surfaces if all(map(len, surfaces)) else None


def _check_options(mesh: Mesh, interface: Interface, label: str) -> None:
    """Raises:
    ValueError: what an interface between meshes that do not match cannot have.
    """
    what = f"{label}: {NONMATCHING} cannot"
    if mesh.comm.size > 1:
        raise ValueError(
            f"{what} be distributed to {mesh.comm.size} ranks; run it on one, or make the meshes "
            "match (gmsh.model.occ.fragment)"
        )
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


def _flat_facets(
    mesh: Mesh, facets: NDArray[np.int32]
) -> tuple[NDArray[np.int32], NDArray[np.int32], FlatFacets]:
    """Cells of boundary facets, their numbers in them, and the facets by their corners."""
    cells = facet_cells(mesh)[facets, 0]
    local = local_facets(mesh, cells, facets)
    d, cell = mesh.topology.dim, mesh.basix_cell()
    corners = np.array(basix.topology(cell)[d - 1], dtype=np.int32)
    if corners.shape[1] == 4:
        corners = corners[:, [0, 1, 3, 2]]
    nodes = compat.geometry_dofmap(mesh)[cells]
    x = mesh.geometry.x[:, :d]
    count = len(basix.topology(cell)[0])
    inside = x[nodes[:, :count]].mean(axis=1)
    return cells, local, FlatFacets.of(x[np.take_along_axis(nodes, corners[local], axis=1)], inside)


def _check_overlap(label: str, flat: Sequence[FlatFacets], segments: Segments, whole: bool) -> None:
    """Check that the surfaces, or the ``whole`` surfaces of two groups, lie opposite each other.

    Raises:
        ValueError: they do not, or more than once.
    """
    areas = [one.measures for one in flat]
    share = segments.measures.sum() / min(area.sum() for area in areas)
    pairs = (
        "facets form a pair where their normals are opposite and their distance is at most half "
        "the radius of the larger one"
    )
    if whole and share == 0.0:
        raise ValueError(
            f"{label} has no facet: the tags are not adjacent, nor do the surfaces of their bodies "
            f"lie opposite each other ({pairs}); check units and origins of meshes that were made "
            "separately, or make the mesh conforming, for example by gmsh.model.occ.fragment"
        )
    if not whole and share < _LEAST_SHARE:
        apart = flat[0].centres.mean(axis=0) - flat[1].centres.mean(axis=0)
        raise ValueError(
            f"{label}: its two surfaces lie opposite each other on {100 * share:.2g} % of the "
            f"smaller one: {pairs}. The centres of the surfaces are {np.linalg.norm(apart):.3g} mm "
            "apart: are these the surfaces that touch, and do both meshes have the same units and "
            "origin?"
        )
    covered = np.bincount(segments.first, segments.measures, minlength=len(areas[0]))
    twice = np.flatnonzero(covered > (1 + _TWICE) * areas[0])
    if len(twice):
        place = ", ".join(f"{x:.6g}" for x in flat[0].centres[twice[0]])
        raise ValueError(
            f"{label}: the facet at ({place}) of side 1 lies opposite side 2 more than once; give "
            "only the facets that touch, by surfaces=(facets_1, facets_2)"
        )
