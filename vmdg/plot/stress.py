"""Curves of a run, and cells coloured by stress."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.cm import ScalarMappable
from matplotlib.collections import Collection, PolyCollection, TriMesh
from matplotlib.transforms import Bbox, TransformedBbox
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from ..base.parallel import global_box, global_max
from ..forms.geometry import Axisymmetric
from ..output.cell import whole_displacement
from ..output.corners import (
    cell_corners,
    corner_dofs,
    nodal_means,
    positions_and_displacements,
)
from ..output.history import History
from ..problem.problem import Problem
from .solids import VIEW, axes_of, draw_solid, surface, widen

Limits = tuple[float, float]
Component = Callable[[NDArray[np.float64]], NDArray[np.float64]]
Drawn = TypeVar("Drawn", bound=Collection)

#: Largest length up to which an axis is in µm [mm].
SMALL = 0.15
#: By unit a smaller one, its number in the unit, and the largest value up to which an axis has it.
SMALLER = {"mm": ("µm", 1e3, SMALL), "s": ("µs", 1e6, 1e-3)}
#: Height of a plane body relative to its width below which its colour bar is above it [-].
FLAT = 0.4
#: Width of a colour bar, and its distance from the body [inch].
THICKNESS, GAP = 0.14, 0.08

#: Stress, relative to the largest one and to that of the softest body strained by the displacement,
#: below which it is within the tolerance of equilibrium: a pair of free blocks has 3e-10.
NEGLIGIBLE = 1e-9


def curve(
    history: History,
    x: str,
    y: str,
    ax: Axes | None = None,
    origin: bool = False,
    **style: object,
) -> Axes:
    """Draw one column of a history over another; lengths of less than 0.15 mm in µm, times of
    less than 1 ms in µs.

    Args:
        history: The history of a run.
        x: Column along the axis, for example "load".
        y: Column that is drawn.
        ax: Axes; None for a new figure.
        origin: Start the curve at (0, 0), which is not a row of the history.
        **style: For ``Axes.plot``, for example ``label="fine mesh"``.

    Returns:
        The axes, labelled by column names and units unless they have labels.

    Raises:
        KeyError: the history has no such column.
        TypeError: it is not a history.
    """
    if not isinstance(history, History):
        raise TypeError(f"curve: history = {history!r:.80} must be a vmdg.History: result.history")
    ax = plt.subplots(layout="constrained")[1] if ax is None else ax
    start = [0.0] if origin else []
    ax.plot([*start, *history[x]], [*start, *history[y]], **style)
    named = dict(zip(history.columns, history.header, strict=True))
    for axis, column in ((ax.xaxis, x), (ax.yaxis, y)):
        if not axis.get_label_text():
            label = "load factor" if column == "load" else named.get(column, column)
            label = label.replace("_", " ").removesuffix(" [-]")
            label_axis(axis, label, np.abs(history[column]).max(initial=0.0))
    return ax


def label_axis(axis: Axis, label: str, largest: float) -> None:
    """Label an axis, in µm instead of mm, or µs instead of s, where its largest value is small."""
    for unit, (smaller, factor, bound) in SMALLER.items():
        if label.endswith(f" [{unit}]") and largest < bound:
            axis.set_major_formatter(
                lambda value, _, k=factor: f"{k * value:.6g}".replace("-", "\N{MINUS SIGN}")
            )
            label = label.replace(f"[{unit}]", f"[{smaller}]")
            break
    axis.set_label_text(label)


# Stress


def stress(
    problem: Problem,
    component: str = "mises",
    magnify: float = 1.0,
    ax: Axes | None = None,
    limits: Limits | None = None,
    edges: float = 0.0,
    colorbar: bool = True,
    view: Sequence[float] = VIEW,
    box: NDArray[np.float64] | None = None,
) -> Axes:
    """Draw a component of the Cauchy stress on the deformed shape; collective.

    Values are averaged over the cells around each node of the displacement: smooth in the bodies,
    with jumps at interfaces. Of a solid the surface and the faces of open cracks are drawn, by
    PyVista; where it is not installed the axes say so. A component within the tolerance of
    equilibrium everywhere, as in detached bodies, is drawn as zero, with the threshold in the label
    of the colour bar. The label of the axis along x has the factor on the displacement.

    Args:
        problem: The problem.
        component: "mises", "principal" (the largest), or two of x, y, z (of r, z, t in
            axisymmetry), for example "xy" [MPa].
        magnify: Factor on the displacement.
        ax: Axes, of two dimensions also for solids; None for a new figure.
        limits: Stresses at both ends of the colours [MPa]; None for the full range.
        edges: Width of the lines between cells [points].
        colorbar: Whether to add a colour bar.
        view: Direction from a solid to the viewer.
        box: Least and largest coordinates of what is seen of a solid (2, 3) [mm]; None for the
            deformed body.

    Returns:
        The axes; only those of rank 0 contain the plot.

    Raises:
        ValueError: no such component, or axes of three dimensions.
    """
    sigma, take, label = seen_stress(problem, component)
    ax = axes_of(ax)
    solid = problem.mesh.geometry.dim == 3
    cells, local = surface(problem) if solid else owned_cells(problem)
    corners = deformed_corners(problem, cells, local, magnify)
    values = _corner_values(problem, sigma, take, cells, local)
    corners, values = on_first_rank(problem, corners, values)
    scale = "" if magnify == 1 else f"displacements \N{MULTIPLICATION SIGN} {magnify:g}"
    drawn: ScalarMappable
    if solid:
        ends = deformed_ends(problem, magnify) if box is None else box
        if problem.comm.rank == 0:
            colours, both = plt.rcParams["image.cmap"], limits or (None, None)
            drawn = draw_solid(ax, corners, values, both, colours, ends, view, edges=edges)
        size = extent(global_box(problem.comm, problem.mesh.geometry.x))
        ax.set_xlabel("\n".join(filter(None, [size, scale])))
    else:
        drawn = _draw_smooth(ax, corners[..., :2], values, limits)
        if edges:
            style = {"facecolor": "none", "edgecolor": "black", "linewidth": edges}
            _add_flat(ax, PolyCollection(corners[..., :2], **style), corners[..., :2])
        label_plane(ax, problem, scale)
    if colorbar and not (solid and problem.comm.rank > 0):
        add_colorbar(ax, drawn, label)
    return ax


def indicator(
    problem: Problem,
    magnify: float = 1.0,
    ax: Axes | None = None,
    limits: Limits | None = None,
    view: Sequence[float] = VIEW,
) -> Axes:
    """Draw where the mesh of the bodies is too coarse on the deformed shape; collective.

    Every cell has the colour of its share of the error, :meth:`vmdg.Problem.indicator`, in powers
    of ten; interfaces are drawn by ``interface_map(problem, "indicator")``.

    Args:
        problem: The problem.
        magnify: Factor on the displacement.
        ax: Axes, of two dimensions also for solids; None for a new figure.
        limits: Powers of ten at both ends of the colours; None for the three largest.
        view: Direction from a solid to the viewer.

    Returns:
        The axes; only those of rank 0 contain the plot.

    Raises:
        ValueError: axes of three dimensions.
    """
    share, ax = problem.indicator().x.array, axes_of(ax)
    solid = problem.mesh.geometry.dim == 3
    cells, local = surface(problem) if solid else owned_cells(problem)
    corners = deformed_corners(problem, cells, local, magnify)
    powers = np.log10(np.maximum(share, np.finfo(float).tiny))[cells]
    most = global_max(problem.comm, powers.max(initial=-np.inf))
    limits = (most - 3, most) if limits is None else limits
    corners, powers = on_first_rank(problem, corners, powers)
    drawn: ScalarMappable
    if solid:
        ends, colours = deformed_ends(problem, magnify), plt.rcParams["image.cmap"]
        drawn = draw_solid(ax, corners, powers, limits, colours, ends, view, edges=0.3)
    else:
        style = {"array": powers, "clim": limits, "edgecolor": "face", "linewidth": 0.3}
        drawn = _add_flat(ax, PolyCollection(corners[..., :2], **style), corners[..., :2])
        ax.set_aspect("equal")
        label_plane(ax, problem)
    add_colorbar(ax, drawn, "power of ten of the share of the error")
    return ax


def label_plane(ax: Axes, problem: Problem, scale: str = "") -> None:
    """Label the axes of a plane body, collective; ``scale`` is said next to x."""
    names, ends = axis_names(problem), global_box(problem.comm, problem.mesh.geometry.x)
    for axis, name in ((ax.xaxis, names[0]), (ax.yaxis, names[1])):
        label_axis(axis, f"{name} [mm]", np.abs(ends).max())
    ax.set_xlabel("   ".join(filter(None, [ax.get_xlabel(), scale])))


def extent(box: NDArray[np.float64]) -> str:
    sides = np.ptp(box, axis=0)
    factor, unit = (1000, "µm") if sides.max() < SMALL else (1, "mm")
    return " \N{MULTIPLICATION SIGN} ".join(f"{factor * side:.3g}" for side in sides) + f" {unit}"


def add_colorbar(ax: Axes, drawn: ScalarMappable, label: str = "") -> None:
    """Add a colour bar as long as the adjacent side of the axes, above a flat body; it is pointed
    where values lie beyond its end.

    It belongs to the axes, since the layout of a figure does not account for equal scales along x
    and y.

    Args:
        ax: The axes.
        drawn: What is coloured.
        label: Label of the colour bar.
    """
    flat = ax.dataLim.height < FLAT * ax.dataLim.width
    bar = ax.inset_axes((0, 0, 1, 1))

    def place(_bar: Axes, _renderer: object) -> TransformedBbox:
        width, height = ax.bbox.size / ax.figure.dpi
        over = (0, 1 + GAP / height, 1, THICKNESS / height)
        beside = (1 + GAP / width, 0, THICKNESS / width, 1)
        bounds = Bbox.from_bounds(*(over if flat else beside))
        return TransformedBbox(bounds, ax.transAxes - ax.figure.transSubfigure)

    bar.set_axes_locator(place)
    (low, high), values = drawn.get_clim(), np.asarray(drawn.get_array())
    rounding = 1e-6 * (high - low)
    beyond = (values < low - rounding).any(), (values > high + rounding).any()
    ends = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}[beyond]
    where = "top" if flat else "right"
    ax.figure.colorbar(drawn, cax=bar, label=label, location=where, extend=ends)


def axis_names(problem: Problem) -> str:
    return "rzt" if isinstance(problem.discretization.geometry, Axisymmetric) else "xyz"


def stress_means(problem: Problem, component: str) -> NDArray[np.float64]:
    """Cell means of a component of :func:`stress`, of all ranks, on every rank (n,) [MPa]."""
    sigma, take, _ = seen_stress(problem, component)
    owned = problem.mesh.topology.index_map(problem.mesh.topology.dim).size_local
    return np.concatenate(problem.comm.allgather(take(cell_means(sigma)[:owned])))


def seen_stress(problem: Problem, component: str) -> tuple[fem.Function, Component, str]:
    """The Cauchy stress, a function that extracts the component, and its label; collective.

    A component that is negligible everywhere is zero.
    """
    take, label = component_of(problem, component)
    sigma = problem.stress()
    tensors = sigma.x.array.reshape(-1, 3, 3)
    largest = global_max(problem.comm, np.abs(tensors).max(initial=0.0))
    floor = NEGLIGIBLE * max(largest, _free_scale(problem))
    if 0 < global_max(problem.comm, np.abs(take(tensors)).max(initial=0.0)) <= floor:
        return sigma, lambda tensors: np.zeros(len(tensors)), f"{label}\n(0: below {floor:.0e})"
    return sigma, take, label


def _free_scale(problem: Problem) -> float:
    """Stress of the softest cell next to an interface, strained as if no body could move rigidly
    [MPa].

    The strain is the largest displacement relative to the size of the mesh, 1 at most; the
    stiffness is r h of the derived tau_s. Zero if no facet is open; collective.
    """
    softest = np.inf
    for active in problem.discretization.active.values():
        if active.stabilization is None:  # before the first step
            return 0.0
        stiffness = active.stabilization.norm / active.stabilization.safety
        softest = min(softest, (stiffness * active.quadrature.extent).min(initial=np.inf))
    softest = -global_max(problem.comm, -softest)
    low, high = global_box(problem.comm, problem.mesh.geometry.x)
    moved = np.abs(whole_displacement(problem).x.array).max(initial=0.0)
    strain = min(global_max(problem.comm, moved) / (high - low).max(), 1.0)
    return softest * strain if np.isfinite(softest) else 0.0


def component_of(problem: Problem, name: str) -> tuple[Component, str]:
    """A function that extracts the component from tensors (n, 3, 3), and its label."""
    letters = axis_names(problem)
    if name == "mises":
        return _mises, r"$\sigma_{\mathrm{Mises}}$ [MPa]"
    if name == "principal":
        return lambda sigma: np.linalg.eigvalsh(sigma)[:, -1], r"$\sigma_1$ [MPa]"
    if len(name) != 2 or not set(name) <= set(letters):
        raise ValueError(
            f"stress: component = {name!r} must be 'mises', 'principal' or two of {letters}"
        )
    row, column = (letters.index(letter) for letter in name)
    subscript = name.replace("t", r"\theta")
    return lambda sigma: sigma[:, row, column], rf"$\sigma_{{{subscript}}}$ [MPa]"


def _mises(sigma: NDArray[np.float64]) -> NDArray[np.float64]:
    deviator = sigma - np.trace(sigma, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    return np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))


def _corner_values(
    problem: Problem,
    sigma: fem.Function,
    take: Component,
    cells: NDArray[np.int32],
    corners: NDArray[np.int32],
) -> NDArray[np.float64]:
    """Nodal means of a component at corners (n, c) of owned cells (n,)."""
    owned = problem.mesh.topology.index_map(problem.mesh.topology.dim).size_local
    dofs = sigma.function_space.dofmap.list[:owned][:, corner_dofs(problem)]
    values = take(sigma.x.array.reshape(-1, 3, 3)[dofs.ravel()]).reshape(dofs.shape)
    return nodal_means(problem, values)[cells[:, None], corners]


def _draw_smooth(ax: Axes, polygons: NDArray, values: NDArray, limits: Limits | None) -> TriMesh:
    """Draw polygons (n, c, 2) with values at their corners (n, c)."""
    count, c = values.shape
    triangles = np.array([[0, i, i + 1] for i in range(1, c - 1)])
    triangles = (c * np.arange(count)[:, None, None] + triangles).reshape(-1, 3)
    x, y = polygons.reshape(-1, 2).T
    mesh = TriMesh(Triangulation(x, y, triangles), array=values.ravel())
    mesh.set_clim(*(limits or (None, None)))
    widen(mesh)
    ax.set_aspect("equal")
    return _add_flat(ax, mesh, polygons)


def _add_flat(ax: Axes, drawn: Drawn, polygons: NDArray) -> Drawn:
    """Add what shows polygons (n, c, 2) to 2D axes.

    The limits that matplotlib takes from a path for every polygon can cost more than the picture.
    """
    ax.add_collection(drawn, autolim=False)
    ax.update_datalim(polygons.reshape(-1, 2))
    ax.autoscale()
    return drawn


# Cells


def owned_cells(problem: Problem) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Owned cells of a plane mesh (n,) and their corners, in order around them (n, c)."""
    corners = cell_corners(problem.mesh)
    return np.arange(len(corners), dtype=np.int32), corners


def deformed_corners(
    problem: Problem, cells: NDArray[np.int32], corners: NDArray[np.int32], magnify: float = 1.0
) -> NDArray[np.float64]:
    """Positions of corners (n, c) of cells (n,) in the deformed body (n, c, 3) [mm]."""
    positions, u = positions_and_displacements(problem, cells, corners)
    positions[..., : u.shape[-1]] += magnify * u
    return positions


def deformed_ends(problem: Problem, magnify: float = 1.0) -> NDArray[np.float64]:
    """Least and largest coordinates of the deformed body over all ranks (2, 3) [mm]."""
    d, u = problem.mesh.geometry.dim, whole_displacement(problem)
    nodes = u.function_space.tabulate_dof_coordinates()
    nodes[:, :d] += magnify * u.x.array.reshape(-1, d)
    return global_box(problem.comm, nodes)


def cell_means(function: fem.Function) -> NDArray[np.float64]:
    space = function.function_space
    shape = space.ufl_element().reference_value_shape
    return function.x.array.reshape(-1, *shape)[space.dofmap.list].mean(axis=1)


def on_first_rank(problem: Problem, *arrays: NDArray) -> list[NDArray]:
    """Rows of all ranks on rank 0; one row of zeros on the others, so they can draw too."""
    gathered = problem.comm.gather(arrays)
    if gathered is None:
        return [np.zeros((1, *array.shape[1:])) for array in arrays]
    return [np.concatenate(parts) for parts in zip(*gathered, strict=True)]
