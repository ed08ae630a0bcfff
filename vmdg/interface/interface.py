"""Interfaces: where the displacement may jump, and which side is which."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from dolfinx.mesh import GhostMode, Mesh, compute_midpoints, locate_entities
from numpy.typing import ArrayLike, NDArray

from ..base.parallel import global_sum, raise_together
from ..domain.tags import Group, group_tag
from ..domain.topology import (
    UNTAGGED,
    LevelSet,
    Locator,
    cells_inside,
    facet_cells,
    local_facets,
    mark_everywhere,
)
from ..laws import Law

NORMS = ("frobenius", "spectral")
FRAMES = ("corotating", "reference")
ACTIVATIONS = ("all", "on-demand")
AUTO = "auto"

Stabilizer = Callable[[NDArray, NDArray, "StabilizationContext"], tuple[NDArray, NDArray]]


@dataclass(frozen=True)
class StabilizationContext:
    """What a user's ``stabilization(tau1, tau2, context)`` may need; side 1 first.

    Attributes:
        u: Displacement at which tau is evaluated.
        cells: Local cells of the two sides, (nf, 2).
        local_facets: Number of the facet within these cells, (nf, 2).
        facets: Local facets of the mesh, (nf,).
        N: Mean reference normal, outward from side 1, (nf, d).
        area: meas(gamma_s) [mm2; mm in plane strain], (nf,); all around in axisymmetry.
    """

    u: Any
    cells: NDArray[np.int32]
    local_facets: NDArray[np.int32]
    facets: NDArray[np.int32]
    N: NDArray[np.float64]
    area: NDArray[np.float64]


class Interface:
    """A set of interior facets across which the displacement may jump, with its law.

    Give exactly one of ``facets``, ``between``, ``within`` and ``level_set``. A group of cells is
    given by its tag, or by its name where the problem has :class:`vmdg.NamedTags`. What an
    interface is cannot be changed afterwards.

    Args:
        facets: Local facet indices, for example ``facet_tags.find("crack")``, where on several
            ranks each rank gives those it knows; or a predicate on coordinates (3, n), true at
            all vertices of a facet inside the mesh.
        between: The facets that separate cells of these two groups.
        within: All facets that separate two cells of this group (cracks through a region).
        level_set: The facets between cells where phi(x), x (3, n) [mm], is negative at the
            midpoint and all others. Of two cells of one tag side 1 is the negative one.
        law: ``vmdg.Bonded()`` (tie), ``vmdg.Debonding(...)`` or another :class:`vmdg.laws.Law`.
        safety: Factor on tau_s. "auto" raises the derived tau_s facet by facet, only where the
            bonded form would not be coercive (:mod:`vmdg.interface.coercivity`) or r too near to H;
            the report's Tables 1 and 2 were made with 4.
        norm: |tau_s| of (57): "frobenius" or "spectral".
        frame: "corotating" keeps zeta and N in a frame that turns with the interface;
            "reference" is the report's boxes to the letter, for small rotations, and saves the
            frame's work. At small strain rotations are small by assumption and no frame turns.
        traction_jump: Add the term -[[(GRAD eta : A).N]].delta_s.[[P.N]] of (26); (27) drops it.
        activate: "all" opens every facet from the start; "on-demand" keeps a facet continuous, at
            no cost, until its traction nears the strength (cracks through a region).
        activate_at: Traction relative to the strength at which a facet opens on demand. Averaged
            over continuous cells, the traction near a crack tip or a corner is about half of what
            the interface feels, hence the default.
        stabilization: ``f(tau1, tau2, context) -> (tau_s (nf, d, d), delta1 (nf, d, d))``
            replaces (21)-(25), for research and tests; ``safety`` does not apply to its result.

    Raises:
        ValueError: the description is incomplete or contradictory.
        TypeError: ``law`` is not an interface law.
    """

    def __init__(
        self,
        facets: ArrayLike | Locator | None = None,
        *,
        between: tuple[Group, Group] | None = None,
        within: Group | None = None,
        level_set: LevelSet | None = None,
        law: Law,
        safety: float | str = AUTO,
        norm: str = "frobenius",
        frame: str = "corotating",
        traction_jump: bool = False,
        activate: str = "all",
        activate_at: float = 0.4,
        stabilization: Stabilizer | None = None,
    ):
        places = {"facets": facets, "between": between, "within": within, "level_set": level_set}
        given = [name for name, value in places.items() if value is not None]
        if len(given) != 1:
            raise ValueError(
                "Interface needs exactly one of facets=, between=(tag, tag), within=tag, "
                f"level_set=phi; given: {', '.join(given) or 'none'}"
            )
        if isinstance(law, type) and issubclass(law, Law):
            raise TypeError(
                f"Interface: law = {law.__name__} is a class; give an instance with its "
                f"parameters, {law.__name__}(...)"
            )
        if not isinstance(law, Law):
            raise TypeError(f"Interface: law = {law!r} is no interface law; try vmdg.Bonded()")
        if level_set is not None and not callable(level_set):
            raise TypeError(
                f"Interface: level_set = {level_set!r} must be a function of points x (3, n), for "
                "example lambda x: np.hypot(x[0], x[1]) - 0.25"
            )
        if safety != AUTO and (isinstance(safety, str) or not (np.isfinite(safety) and safety > 0)):
            raise ValueError(f'Interface: safety = {safety!r} must be positive, or "{AUTO}"')
        if norm not in NORMS:
            raise ValueError(f"Interface: norm = {norm!r} must be one of {NORMS}")
        if frame not in FRAMES:
            raise ValueError(f"Interface: frame = {frame!r} must be one of {FRAMES}")
        if activate not in ACTIVATIONS:
            raise ValueError(f"Interface: activate = {activate!r} must be one of {ACTIVATIONS}")
        if not 0 < activate_at <= 1:
            raise ValueError(f"Interface: activate_at = {activate_at} must lie in (0, 1]")
        if activate == "on-demand" and not law.inelastic:
            raise ValueError("Interface: a tie never fails, so it cannot open on demand")
        if isinstance(between, str) or (
            between is not None and (len(between) != 2 or between[0] == between[1])
        ):
            raise ValueError(
                f"Interface: between = {between!r} must be two different tags; for the facets "
                "inside one tag use within=tag"
            )
        indices = facets is not None and not callable(facets)
        self.facets = np.asarray(facets, dtype=np.int32) if indices else facets
        self.between = between
        self.within = within
        self.level_set = level_set
        self.law = law
        self.safety = safety if safety == AUTO else float(safety)
        self.norm = norm
        self.frame = frame
        self.traction_jump = bool(traction_jump)
        self.activate = activate
        self.activate_at = float(activate_at)
        self.stabilization = stabilization
        self._complete = True

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, "_complete"):
            raise AttributeError(
                f"Interface: {name} cannot be changed, a problem would not notice; make a new "
                "Interface and a new Problem"
            )
        super().__setattr__(name, value)

    def __repr__(self) -> str:
        if self.between is not None:
            where = f"between={self.between}"
        elif self.within is not None:
            where = f"within={self.within!r}"
        elif self.level_set is not None:
            where = "level_set=<function>"
        elif callable(self.facets):
            where = "facets=<function>"
        else:
            where = f"facets=<{len(self.facets)}>"
        return f"Interface({where}, law={self.law!r})"


@dataclass(frozen=True)
class InterfaceFacets:
    """The facets of one interface on this rank, with their sides.

    Attributes:
        facets: Owned facets, ascending, (nf,).
        cells: Cell of side 1 and of side 2, (nf, 2).
        local: Number of the facet within these cells, (nf, 2).
        tags: Cell tags of the two sides, (nf, 2).
        everywhere: The same interface with the facets of other ranks known here (ghosts).
    """

    facets: NDArray[np.int32]
    cells: NDArray[np.int32]
    local: NDArray[np.int32]
    tags: NDArray[np.int32]
    everywhere: NDArray[np.int32]

    def among(self, mark: NDArray[np.bool_]) -> InterfaceFacets:
        """The facets that are marked, ``mark`` given for all local facets of the mesh."""
        keep = mark[self.facets]
        return InterfaceFacets(
            self.facets[keep],
            self.cells[keep],
            self.local[keep],
            self.tags[keep],
            self.everywhere[mark[self.everywhere]],
        )

    def rows(self, select: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Rows (cell 1, facet in it, cell 2, facet in it) of DOLFINx, flattened."""
        columns = [self.cells[:, 0], self.local[:, 0], self.cells[:, 1], self.local[:, 1]]
        return np.column_stack(columns)[select].ravel()

    def side(self, a: int, select: NDArray[np.bool_]) -> NDArray[np.int32]:
        """Rows (cell, facet in it) of side ``a`` (0 or 1), flattened."""
        return np.column_stack([self.cells[:, a], self.local[:, a]])[select].ravel()


def check_ghosts(mesh: Mesh) -> None:
    """Refuse a distributed mesh whose ranks do not see both cells of every facet.

    Raises:
        RuntimeError: the mesh was made without facet ghosts on more than one rank.
    """
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
) -> InterfaceFacets:
    """Select the facets of an interface and decide their sides.

    Side 1 has the lower tag; for equal tags it is the cell inside the level set, or else the cell
    whose midpoint comes first along the first coordinate in which the two midpoints differ, which
    no partition of the mesh can change.

    Args:
        mesh: Mesh with facet ghosts.
        cell_tags: Tag of every local cell, ghosts included.
        interface: The user's description.
        names: Tag by name of the groups of cells.

    Raises:
        ValueError: a facet is not interior, a tag is unknown, or nothing is selected.
    """
    comm = mesh.comm
    fdim = mesh.topology.dim - 1
    pairs = facet_cells(mesh)
    interior = (pairs >= 0).all(axis=1)
    known = set(np.unique(np.concatenate(comm.allgather(np.unique(cell_tags)))).tolist())
    known.discard(UNTAGGED)
    groups = interface.between or ((interface.within,) if interface.within is not None else ())
    wanted = [group_tag(group, names or {}, f"{interface}") for group in groups]
    for tag in wanted:
        if tag not in known:
            raise ValueError(f"{interface}: no cell has tag {tag}; tags are {sorted(known)}")
    tags = np.where(interior[:, None], cell_tags[pairs], UNTAGGED)
    inside = None
    if callable(interface.facets):
        fdim = mesh.topology.dim - 1
        mesh.topology.create_connectivity(fdim, 0)
        chosen = interior.copy()
        chosen &= mark_everywhere(mesh, fdim, locate_entities(mesh, fdim, interface.facets))
    elif interface.facets is not None:
        chosen = _given_facets(mesh, interface, interior)
    elif interface.level_set is not None:
        inside = cells_inside(mesh, interface.level_set)
        chosen = interior & (inside[pairs[:, 0]] != inside[pairs[:, 1]])
    elif interface.between is not None:
        chosen = (np.sort(tags, axis=1) == np.sort(np.array(wanted))).all(axis=1)
    else:
        chosen = interior & (tags == wanted[0]).all(axis=1)
    everywhere = np.flatnonzero(chosen).astype(np.int32)
    facets = everywhere[everywhere < mesh.topology.index_map(fdim).size_local]
    if global_sum(comm, len(facets)) == 0:
        raise ValueError(f"{interface} has no facet: {_why_empty(interface)}")
    cells = pairs[facets]
    cells = np.where(_reversed(mesh, cell_tags, cells, inside)[:, None], cells[:, ::-1], cells)
    local = np.column_stack([local_facets(mesh, cells[:, a], facets) for a in range(2)])
    return InterfaceFacets(facets, cells, local, cell_tags[cells], everywhere)


def _why_empty(interface: Interface) -> str:
    if interface.level_set is not None:
        return (
            "the level set has one sign at the midpoints of all cells; check its units, or refine "
            "the mesh"
        )
    if callable(interface.facets):
        return (
            "the predicate is true at all vertices of no facet inside the mesh; compare "
            "coordinates by np.isclose, and the mesh must have facets there"
        )
    return (
        "the tags do not touch, or their bodies are meshed separately (make the mesh conforming, "
        "for example by gmsh.model.occ.fragment)"
    )


def _given_facets(
    mesh: Mesh, interface: Interface, interior: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    facets = interface.facets
    message = None
    outside = (facets < 0) | (facets >= len(interior))
    if outside.any():
        message = f"{interface}: facet {facets[outside][0]} does not exist on this rank"
        facets = facets[~outside]
    chosen = mark_everywhere(mesh, mesh.topology.dim - 1, facets)
    # A ghost facet may have one cell here; its owner sees both.
    owned = mesh.topology.index_map(mesh.topology.dim - 1).size_local
    boundary = np.flatnonzero(chosen[:owned] & ~interior[:owned])
    if len(boundary) and message is None:
        midpoint = _midpoints(mesh, mesh.topology.dim - 1, boundary[:1])[0]
        message = (
            f"{interface}: facet {boundary[0]} at {np.round(midpoint, 6).tolist()} lies on the "
            "boundary of the mesh; an interface takes interior facets only"
        )
    raise_together(mesh.comm, message)
    return chosen & interior


def _midpoints(mesh: Mesh, dim: int, entities: NDArray[np.int32]) -> NDArray[np.float64]:
    return compute_midpoints(mesh, dim, np.asarray(entities, dtype=np.int32))


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
    apart = _midpoints(mesh, mesh.topology.dim, cells[:, 1]) - _midpoints(
        mesh, mesh.topology.dim, cells[:, 0]
    )
    # Midpoints are sums of the same coordinates on every rank up to rounding: compare coarsely.
    apart[np.abs(apart) < 1e-6 * np.abs(apart).max(axis=1, keepdims=True, initial=0.0)] = 0
    leading = apart[np.arange(len(apart)), np.argmax(apart != 0, axis=1)]
    return (first > second) | ((first == second) & (leading < 0))
