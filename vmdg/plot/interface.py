"""Plots of an interface: values along it, and its unrolled surface."""

from __future__ import annotations

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.patches import Patch
from matplotlib.ticker import MultipleLocator
from numpy.typing import ArrayLike, NDArray

from ..base.parallel import global_box
from ..laws import Mode
from ..output.corners import corners_of_local, positions_and_displacements
from ..output.profile import profile
from ..output.values import (
    LABELS,
    Quantity,
    facet_means,
    facet_scalar,
    open_facets,
    values_at_points,
)
from ..points.interface import Which, number_of
from ..problem.problem import Problem
from .solids import axes_of, draw_solid, surface, widen
from .stress import (
    Limits,
    add_colorbar,
    axis_names,
    deformed_corners,
    extent,
    label_axis,
    label_plane,
    on_first_rank,
    owned_cells,
)

MODES = {
    Mode.ELASTIC: ("bonded or sticking", "#dddddd"),
    Mode.TENSION: ("damage in tension", "#d62728"),
    Mode.SHEAR: ("damage in compression", "#ff9f1c"),
    Mode.FRICTION: ("friction", "#1f77b4"),
    Mode.OPEN: ("open", "#9467bd"),
    Mode.CLOSING: ("closing", "#2ca02c"),
}

#: Relative rounding of coordinates and normals of a straight interface.
STRAIGHT = 1e-9


def interface_profile(
    problem: Problem,
    interface: Which,
    quantity: Quantity,
    along: str = "arc",
    centre: ArrayLike | None = None,
    ax: Axes | None = None,
    **style: object,
) -> Axes:
    """Draw a quantity along an interface; collective.

    Args:
        problem: The problem.
        interface: Its number, its name or itself.
        quantity: A scalar of :func:`vmdg.output.values.scalar`: "traction", "opening", "gap",
            "slip", "shear", "damage", "mode" or "fine_scale"; or a function of an
            :class:`vmdg.InterfaceState`.
        along: "arc", "angle", "x", "y" or "z", as for :func:`vmdg.output.profile.profile`.
        centre: For the angle, x and y of the axis [mm]; None for the centre of each piece.
        ax: Axes; None for a new figure.
        **style: For ``Axes.plot``.

    Returns:
        The axes, on every rank.

    Raises:
        ValueError: unknown ``quantity`` or ``along``; an arc length in 3D, or along branching
            lines.
    """
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    if problem.mesh.geometry.dim == 3:
        style = {"ls": "", "marker": ".", **style}
    for rows in profile(problem, interface, quantity, along, centre):
        ax.plot(*rows.T, **style)
    label = LABELS[quantity] if isinstance(quantity, str) else ""
    drawn = [line.get_xydata() for line in ax.lines]
    sizes = np.abs(np.concatenate([np.zeros((1, 2)), *drawn])).max(axis=0)
    label_axis(ax.xaxis, _along_label(problem, along), sizes[0])
    label_axis(ax.yaxis, label, sizes[1])
    ax.margins(x=0)
    if along == "angle":
        ax.xaxis.set_major_locator(MultipleLocator(45))
    return ax


def interface_map(
    problem: Problem,
    quantity: Quantity = "damage",
    ax: Axes | None = None,
    limits: Limits | None = None,
    above: float = -np.inf,
    colorbar: bool = True,
    colours: str = "YlOrRd",
) -> Axes:
    """Draw all interfaces in the undeformed body by a quantity; collective.

    In the plane every open facet is a line with the colour of its mean, see
    :func:`vmdg.output.values.facet_scalar`; of a solid interfaces are smooth surfaces between the
    edges of the body, drawn by PyVista.

    Args:
        problem: The problem.
        quantity: As for :func:`interface_profile`.
        ax: Axes, of two dimensions also for solids; None for a new figure.
        limits: Values at both ends of the colours; None for the full range, of damage 0 to 1.
        above: Omit facets with a value that is not larger, which would hide others in a solid.
        colorbar: Whether to add a colour bar.
        colours: Name of a colour map.

    Returns:
        The axes; only those of rank 0 contain the plot.

    Raises:
        ValueError: unknown ``quantity``, or axes of three dimensions.
    """
    d = problem.mesh.geometry.dim
    ax = axes_of(ax)
    limits = (0.0, 1.0) if limits is None and quantity == "damage" else limits
    every = [_open_facets(problem, i, quantity) for i in range(len(problem.interfaces))]
    corners, values = (np.concatenate([some[k] for some in every]) for k in (0, 2))
    corners, values = corners[values > above], values[values > above]
    solid = d == 3
    cells, local = surface(problem, faces=False) if solid else owned_cells(problem)
    (body,) = on_first_rank(problem, deformed_corners(problem, cells, local, 0.0))
    box, drawn = global_box(problem.comm, problem.mesh.geometry.x), None
    if not solid:
        (tags,) = on_first_rank(problem, shades(problem, cells))
        greys = {"cmap": "gray", "clim": (0, 1), "edgecolor": "face", "linewidth": 0.3}
        ax.add_collection(PolyCollection(body[..., :2], array=tags, **greys))
        drawn = LineCollection(corners[..., :2], array=values, cmap=colours, linewidths=2.0)
        drawn.set_clim(*(limits or (None, None)))
        widen(drawn)
        ax.add_collection(drawn)
        ax.autoscale()
        ax.set_aspect("equal")
        label_plane(ax, problem)
    else:
        if problem.comm.rank == 0:
            both = limits or (None, None)
            drawn = draw_solid(ax, corners, values, both, colours, box, outline=body)
        ax.set_xlabel(extent(box))
    if colorbar and drawn is not None:
        add_colorbar(ax, drawn, LABELS[quantity] if isinstance(quantity, str) else "")
    return ax


def shades(problem: Problem, cells: NDArray[np.int32]) -> NDArray[np.float64]:
    """A light grey for every cell, by its body: 0 is black, 1 white."""
    bodies = problem.discretization.bodies.cells_of
    tags = sorted(set().union(*problem.comm.allgather(set(bodies))))
    result = np.zeros(problem.mesh.topology.index_map(problem.mesh.topology.dim).size_local)
    for tag, members in bodies.items():
        result[members[members < len(result)]] = 0.96 - 0.14 * tags.index(tag) / len(tags)
    return result[cells]


def _along_label(problem: Problem, along: str) -> str:
    labels = {"arc": "arc length [mm]", "angle": "angle [°]"}
    return labels.get(along) or f"{axis_names(problem)['xyz'.index(along)]} [mm]"


def mode_map(
    problem: Problem,
    interface: Which,
    quantity: str = "mode",
    axis: str | None = None,
    ax: Axes | None = None,
    legend: bool = True,
) -> Axes:
    """Draw the active branch of the law on the unrolled interface, or a quantity; collective.

    Every open facet has one colour, see :func:`vmdg.output.values.facet_scalar`.

    Args:
        problem: The problem.
        interface: Its number, its name or itself.
        quantity: "mode", or another scalar of :func:`vmdg.output.values.scalar`.
        axis: "x", "y" or "z": in 3D a cylinder along it, or a part of one, is unrolled to angle and
            position along the axis; in 2D the interface is drawn as a strip over this coordinate.
            None: a surface in 3D is viewed along the largest component of its mean normal, a strip
            uses the coordinate in which it is longest. A plane, and a line without extent along
            the axis, are drawn as with None.
        ax: Axes; None for a new figure.
        legend: Whether to add the legend of the modes, or the scale of colours.

    Returns:
        The axes; only those of rank 0 contain the plot.

    Raises:
        ValueError: an unknown ``quantity`` or ``axis``.
    """
    axes = "xyz"[: problem.mesh.geometry.dim]
    if axis is not None and axis not in tuple(axes):
        raise ValueError(f"mode_map: axis = {axis!r} must be one of {', '.join(axes)}, or None")
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    corners, normals, values = _open_facets(problem, interface, quantity)
    if problem.mesh.geometry.dim == 2:
        axis = _extended(corners, axis)
        polygons, names = _strip(corners, axis), ("interface", _along_label(problem, axis))
        ax.set_xticks([])
    elif axis is None or _plane(normals):
        polygons, names = _projected(corners, normals)
    else:
        polygons, names = unrolled(corners, normals, axis)
    drawn = PolyCollection(polygons, array=values, edgecolors="face", linewidths=0.2)
    if quantity == "mode":
        drawn.set_norm(BoundaryNorm(np.arange(len(MODES) + 1) - 0.5, len(MODES)))
        drawn.set_cmap(ListedColormap([colour for _, colour in MODES.values()]))
    ax.add_collection(drawn)
    ax.autoscale_view()
    ax.margins(0)
    for axis, name, k in ((ax.xaxis, names[0], 0), (ax.yaxis, names[1], 1)):
        label_axis(axis, name, np.abs(np.asarray(polygons)[..., k]).max(initial=0.0))
    if legend and quantity == "mode":
        present = [MODES[mode] for mode in np.unique(values)]
        ax.legend(
            handles=[Patch(color=colour, label=name) for name, colour in present],
            bbox_to_anchor=(0.5, 1.0),
            loc="lower center",
            frameon=False,
        )
    elif legend:
        ax.figure.colorbar(drawn, ax=ax, label=LABELS[quantity])
    return ax


def _open_facets(
    problem: Problem, interface: Which, quantity: Quantity
) -> tuple[NDArray, NDArray, NDArray]:
    """Corners (n, c, 3) [mm], mean normals (n, d) and values (n,) of all ranks, on all ranks."""
    i = number_of(problem.interfaces, interface)
    d, active = problem.mesh.geometry.dim, problem.discretization.active.get(i)
    if active is None:
        return np.zeros((0, d, 3)), np.zeros((0, d)), np.zeros(0)
    state = problem.state[i]
    facets, cells, local = active.facets.first_side
    rows = np.searchsorted(facets, open_facets(state))
    corners = corners_of_local(problem.mesh, local[rows])
    X, _ = positions_and_displacements(problem, cells[rows], corners)
    normals = facet_means(state, state.normal)
    if isinstance(quantity, str):
        values = facet_scalar(problem, i, quantity)
    else:
        values = facet_means(state, values_at_points(problem, i, quantity))
    gathered = problem.comm.allgather((X, normals, values))
    corners, normals, values = (np.concatenate(parts) for parts in zip(*gathered, strict=True))
    return corners, normals, values


def _extended(corners: NDArray, axis: str | None) -> str:
    """The coordinate of a strip: the requested one, if the lines extend along it."""
    extent = np.ptp(corners.reshape(-1, 3), axis=0) if len(corners) else np.zeros(3)
    if axis is None or extent["xyz".index(axis)] <= STRAIGHT * extent.max():
        return "xyz"[int(np.argmax(extent))]
    return axis


def _plane(normals: NDArray) -> bool:
    return len(normals) > 0 and bool((np.abs(normals @ normals[0]) > 1 - STRAIGHT).all())


def _strip(corners: NDArray, axis: str) -> NDArray:
    """Lines as rectangles of width 1 over a coordinate."""
    low, high = corners[:, :, "xyz".index(axis)].T
    across = np.tile([0.0, 1.0, 1.0, 0.0], (len(corners), 1))
    return np.stack([across, np.column_stack([low, low, high, high])], axis=2)


def _projected(corners: NDArray, normals: NDArray) -> tuple[NDArray, tuple[str, str]]:
    """A surface viewed along the largest component of its mean normal."""
    seen = int(np.argmax(np.abs(normals).mean(axis=0))) if len(normals) else 2
    first, second = (k for k in range(3) if k != seen)
    return corners[:, :, [first, second]], (f"{'xyz'[first]} [mm]", f"{'xyz'[second]} [mm]")


def unrolled(corners: NDArray, normals: NDArray, axis: str) -> tuple[NDArray, tuple[str, str]]:
    """A cylinder as angle and axial position; its axis is the intersection of all facet normals."""
    k = "xyz".index(axis)
    a, b = (k + 1) % 3, (k + 2) % 3
    middle = corners.mean(axis=1)
    system = np.column_stack([normals[:, b], -normals[:, a]])
    right = middle[:, a] * normals[:, b] - middle[:, b] * normals[:, a]
    centre = np.linalg.lstsq(system, right, rcond=None)[0]
    angle = np.degrees(np.arctan2(corners[..., b] - centre[1], corners[..., a] - centre[0]))
    # No facet is cut at the jump of the angle, and all lie between 0 and 360.
    angle = angle[:, :1] + (angle - angle[:, :1] + 180) % 360 - 180
    angle -= 360 * np.floor(angle.mean(axis=1, keepdims=True) / 360)
    return np.stack([angle, corners[..., k]], axis=2), ("angle [°]", f"{axis} [mm]")
