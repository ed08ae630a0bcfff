"""Values along an interface in 2D, or over a coordinate."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import dijkstra

from ..base.graph import components
from ..points.interface import Which, number_of
from ..problem.problem import Problem
from .corners import corners_of_local, positions_and_displacements
from .values import Quantity, values_at_points

ALONG = ("arc", "angle", "x", "y", "z")


def profile(
    problem: Problem,
    interface: Which,
    quantity: Quantity,
    along: str = "arc",
    centre: ArrayLike | None = None,
) -> list[NDArray[np.float64]]:
    """Rows (s, value) at the points of every connected piece of an interface; collective.

    Args:
        problem: The problem.
        interface: Its number, its name or itself.
        quantity: As for :func:`vmdg.extremes`: a scalar of :func:`vmdg.output.values.scalar`, or a
            function of an :class:`vmdg.InterfaceState`.
        along: Meaning of s in the undeformed body: "arc" length [mm] from the left end of a piece,
            or counterclockwise from the rightmost corner of a closed one; "angle" about an axis
            along z [degrees]; "x", "y" or "z" [mm].
        centre: For the angle, x and y of the axis [mm]; None for the centre of each piece.

    Returns:
        One array (n, 2) per piece, ascending in s, the one with most points first; all points in
        one array in 3D. The same on every rank; empty if no facet is open.

    Raises:
        ValueError: unknown ``quantity`` or ``along``; an arc length in 3D, or along branching
            lines.
    """
    if along not in ALONG:
        raise ValueError(f"profile: along = {along!r} must be one of {ALONG}")
    plane = problem.mesh.geometry.dim == 2
    if along == "arc" and not plane:
        raise ValueError("profile: a surface has no arc length; use 'angle', 'x', 'y' or 'z'")
    i = number_of(problem.interfaces, interface)
    values = values_at_points(problem, i, quantity)
    if i not in problem.discretization.active:
        return []
    points, values, start, end = _gathered(problem, i, values)
    nodes, vertices = np.unique(np.concatenate([start, end]), axis=0, return_inverse=True)
    vertices = vertices.reshape(2, -1)
    pieces = np.zeros(len(points), dtype=int)
    if plane:
        pieces = components(vertices[0], vertices[1], len(nodes))[vertices[0]]
    rows = []
    for piece in range(pieces.max(initial=-1) + 1):
        here = pieces == piece
        if along == "arc":
            s = _arc_length(nodes, vertices[:, here], points[here])
        elif along == "angle":
            x, y = _around(points[here], nodes[vertices[:, here]], centre)
            s = np.degrees(np.arctan2(y, x)) % 360
        else:
            s = points[here, "xyz".index(along)]
        rows.append(np.column_stack([s, values[here]])[np.argsort(s, kind="stable")])
    return sorted(rows, key=len, reverse=True)


def _gathered(problem: Problem, i: int, values: NDArray) -> tuple[NDArray, ...]:
    """Points of all ranks (n, 3), values (n,), and the two corners of each point's facet (n, 3)."""
    state = problem.state[i]
    facets, cells, local = problem.discretization.active[i].facets.first_side
    corners = corners_of_local(problem.mesh, local)[:, :2]
    X, _ = positions_and_displacements(problem, cells, corners)
    # no negative zeros, which would duplicate corners
    ends = X[np.searchsorted(facets, state.facet)] + 0.0
    own = np.column_stack([state.points, values, ends.reshape(-1, 6)])
    rows = np.concatenate(problem.comm.allgather(own))
    return rows[:, :3], rows[:, 3], rows[:, 4:7], rows[:, 7:]


def _around(points: NDArray, corners: NDArray, centre: ArrayLike | None) -> NDArray[np.float64]:
    """x and y from the centre (2, n)."""
    if centre is None:
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        centre = (low + high)[:2] / 2
    return (points[:, :2] - np.asarray(centre, dtype=float)).T


def _arc_length(
    nodes: NDArray[np.float64], vertices: NDArray[np.intp], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Arc length of points on a chain of facets (n,), by the two corners of the facet of each (2,
    n)."""
    facets, facet = np.unique(np.sort(vertices, axis=0), axis=1, return_inverse=True)
    facet = facet.ravel()
    used, degree = np.unique(facets, return_counts=True)
    if degree.max() > 2:
        raise ValueError("profile: the interface branches and has no arc length; use 'x' or 'y'")
    lengths = np.linalg.norm(nodes[facets[0]] - nodes[facets[1]], axis=1)
    ends = used[degree == 1]
    if len(ends):
        first, closing = ends[np.lexsort(nodes[ends].T[::-1])[0]], -1
    else:
        first = used[np.argmax(nodes[used, 0])]
        closing = _closing_facet(nodes, facets, first)
    chain = np.arange(len(lengths)) != closing
    graph = coo_matrix((lengths[chain], facets[:, chain]), shape=(len(nodes), len(nodes)))
    distance = dijkstra(graph, directed=False, indices=first)[facets]
    if closing >= 0:  # this facet closes a loop and starts at its far end
        distance[facets[:, closing] == first, closing] = np.inf
    near = np.argmin(distance, axis=0)
    each = np.arange(len(near))
    corner = nodes[facets[near, each]]
    return distance[near, each][facet] + np.linalg.norm(points - corner[facet], axis=1)


def _closing_facet(nodes: NDArray, facets: NDArray, first: int) -> int:
    """The lower of the two facets at the rightmost corner, the last one of the loop."""
    both = np.flatnonzero((facets == first).any(axis=0))
    others = facets[:, both].sum(axis=0) - first
    away = nodes[others] - nodes[first]
    return int(both[np.argmin(away[:, 1] / np.linalg.norm(away, axis=1))])
