"""Curves of a run, and cells coloured by stress."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem
from dolfinx.mesh import exterior_facet_indices
from matplotlib.axes import Axes
from matplotlib.collections import Collection, PolyCollection, TriMesh
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox, TransformedBbox
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from ..base.parallel import global_box, global_max
from ..domain.topology import facet_cells, local_facets
from ..forms.geometry import Axisymmetric
from ..output.cell import whole_displacement
from ..output.corners import (
    cell_corners,
    corner_dofs,
    corners_of_local,
    nodal_means,
    positions_and_displacements,
)
from ..output.history import History
from ..problem.problem import Problem

Limits = tuple[float, float]
Component = Callable[[NDArray[np.float64]], NDArray[np.float64]]
Drawn = TypeVar("Drawn", bound=Collection)

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
    """Draw one column of a history over another.

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
    ax.set(xlabel=ax.get_xlabel() or named.get(x, x), ylabel=ax.get_ylabel() or named.get(y, y))
    return ax


# Stress


def stress(
    problem: Problem,
    component: str = "mises",
    magnify: float = 1.0,
    ax: Axes | None = None,
    limits: Limits | None = None,
    facets: NDArray[np.int32] | None = None,
    edges: float = 0.1,
    colorbar: bool = True,
) -> Axes:
    """Draw a component of the Cauchy stress on the deformed shape; collective.

    In 2D cell values are averaged over the cells around each node of the displacement: smooth in
    the bodies, with jumps at interfaces. In 3D boundary facets have the mean of their cell. A
    component within the tolerance of equilibrium everywhere, as in detached bodies, is drawn as
    zero, with the threshold in the label of the colour bar.

    Args:
        problem: The problem.
        component: "mises", "principal" (the largest), or two of x, y, z (of r, z, t in
            axisymmetry), for example "xy" [MPa].
        magnify: Factor on the displacement.
        ax: Axes, with projection "3d" for solids; None for a new figure.
        limits: Stresses at both ends of the colours [MPa]; None for the full range.
        facets: In 3D, the boundary facets to draw; None for all.
        edges: Width of the lines between cells [points].
        colorbar: Whether to add a colour bar.

    Returns:
        The axes; only those of rank 0 contain the plot.

    Raises:
        ValueError: no such component.
    """
    sigma, take, label = seen_stress(problem, component)
    solid = problem.mesh.geometry.dim == 3
    if ax is None:
        figure = plt.figure(layout="none" if solid else "constrained")
        ax = figure.add_subplot(projection="3d" if solid else None)
    if solid:
        facets = boundary_facets(problem) if facets is None else facets
        corners, cells = deformed_corners(problem, facets, magnify)
        drawn = draw_cells(ax, problem, corners, take(cell_means(sigma))[cells], limits)
        drawn.set_linewidth(edges)
        if not edges:  # or there would be white seams in space
            drawn.set(linewidth=0.3, edgecolor="face")
        ax.auto_scale_xyz(*on_first_rank(problem, corners.reshape(-1, 3))[0].T)
        ax.set(aspect="equal", zlabel="z [mm]")
        for axis, share in zip((ax.xaxis, ax.yaxis, ax.zaxis), _sides(ax), strict=True):
            axis.set_major_locator(MaxNLocator(max(round(6 * share), 1)))
    else:
        polygons, cells = deformed_polygons(problem, magnify=magnify)
        drawn = _draw_smooth(ax, problem, polygons, _corner_values(problem, sigma, take), limits)
        if edges:
            lines = draw_cells(ax, problem, polygons, np.zeros(len(cells)))
            lines.set(array=None, facecolor="none", linewidth=edges)
    if colorbar:
        add_colorbar(ax, drawn, label)
    names = axis_names(problem)
    ax.set(xlabel=f"{names[0]} [mm]", ylabel=f"{names[1]} [mm]")
    return ax


def add_colorbar(ax: Axes, drawn: Collection, label: str = "") -> None:
    """Add a colour bar as long as the adjacent side of the axes.

    In 2D it belongs to the axes, since the layout of a figure does not account for equal scales
    along x and y, and is placed above a flat body; in 3D it is on the left, where the z axis has no
    tick labels.

    Args:
        ax: The axes.
        drawn: The coloured collection.
        label: Label of the colour bar.
    """
    if ax.name == "3d":
        size = 0.3 if _sides(ax)[2] < FLAT else 0.6
        ax.figure.colorbar(drawn, ax=ax, label=label, location="left", shrink=size, pad=0.02)
        return
    flat = ax.dataLim.height < FLAT * ax.dataLim.width
    bar = ax.inset_axes((0, 0, 1, 1))

    def place(_bar: Axes, _renderer: object) -> TransformedBbox:
        width, height = ax.bbox.size / ax.figure.dpi
        over = (0, 1 + GAP / height, 1, THICKNESS / height)
        beside = (1 + GAP / width, 0, THICKNESS / width, 1)
        bounds = Bbox.from_bounds(*(over if flat else beside))
        return TransformedBbox(bounds, ax.transAxes - ax.figure.transSubfigure)

    bar.set_axes_locator(place)
    ax.figure.colorbar(drawn, cax=bar, label=label, location="top" if flat else "right")


def _sides(ax: Axes) -> NDArray[np.float64]:
    """Lengths of the axes of a 3D plot, relative to the longest."""
    sides = np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
    return sides / sides.max()


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
        return sigma, lambda tensors: np.zeros(len(tensors)), f"{label} (0: below {floor:.0e})"
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


def _corner_values(problem: Problem, sigma: fem.Function, take: Component) -> NDArray[np.float64]:
    """Nodal means of a component at the corners of this rank's cells, in order around them."""
    corners = cell_corners(problem.mesh)
    dofs = sigma.function_space.dofmap.list[: len(corners)][:, corner_dofs(problem)]
    values = take(sigma.x.array.reshape(-1, 3, 3)[dofs.ravel()]).reshape(dofs.shape)
    return np.take_along_axis(nodal_means(problem, values), corners, axis=1)


def _draw_smooth(
    ax: Axes, problem: Problem, polygons: NDArray, values: NDArray, limits: Limits | None
) -> TriMesh:
    """Draw polygons (n, c, 2) with values at their corners (n, c); collective."""
    polygons, values = on_first_rank(problem, polygons, values)
    count, c = values.shape
    triangles = np.array([[0, i, i + 1] for i in range(1, c - 1)])
    triangles = (c * np.arange(count)[:, None, None] + triangles).reshape(-1, 3)
    x, y = polygons.reshape(-1, 2).T
    mesh = TriMesh(Triangulation(x, y, triangles), array=values.ravel())
    mesh.set_clim(*(limits or (None, None)))
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


def deformed_corners(
    problem: Problem, facets: NDArray[np.int32] | None = None, magnify: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Corners of this rank's cells (2D) or of boundary facets (3D) in the deformed body.

    Args:
        problem: The problem.
        facets: In 3D, the boundary facets.
        magnify: Factor on the displacement.

    Returns:
        Corners in order around every polygon (n, corners, 3) [mm] and the cell it belongs to (n,).
    """
    mesh, d = problem.mesh, problem.mesh.geometry.dim
    if d == 2:
        corners = cell_corners(mesh)
        cells = np.arange(len(corners), dtype=np.int32)
    else:
        assert facets is not None
        facets = facets[facets < mesh.topology.index_map(2).size_local]
        cells = facet_cells(mesh)[facets, 0]
        corners = corners_of_local(mesh, local_facets(mesh, cells, facets))
    positions, u = positions_and_displacements(problem, cells, corners)
    positions[..., :d] += magnify * u
    return positions, cells


def boundary_facets(problem: Problem) -> NDArray[np.int32]:
    topology = problem.mesh.topology
    topology.create_connectivity(topology.dim - 1, topology.dim)
    return exterior_facet_indices(topology)


def deformed_ends(problem: Problem, magnify: float = 1.0) -> NDArray[np.float64]:
    """Least and largest coordinates of the deformed body over all ranks (2, 3) [mm]."""
    d, u = problem.mesh.geometry.dim, whole_displacement(problem)
    nodes = u.function_space.tabulate_dof_coordinates()
    nodes[:, :d] += magnify * u.x.array.reshape(-1, d)
    return global_box(problem.comm, nodes)


def deformed_polygons(
    problem: Problem, facets: NDArray[np.int32] | None = None, magnify: float = 1.0
) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """:func:`deformed_corners` viewed along z.

    Args:
        problem: The problem.
        facets: In 3D, the boundary facets.
        magnify: Factor on the displacement.

    Returns:
        Corners (n, corners, 2) [mm] and the cell each polygon belongs to (n,).
    """
    corners, cells = deformed_corners(problem, facets, magnify)
    return corners[..., :2], cells


def cell_means(function: fem.Function, component: tuple[int, ...] = ()) -> NDArray[np.float64]:
    """Cell means, over the dofs, of one component of a discontinuous function.

    Args:
        function: The function.
        component: Indices of the component, empty for a scalar.
    """
    space = function.function_space
    shape = space.ufl_element().reference_value_shape
    values = function.x.array.reshape(-1, *shape)[(slice(None), *component)]
    return values[space.dofmap.list].mean(axis=1)


def draw_cells(
    ax: Axes, problem: Problem, polygons: NDArray, values: NDArray, limits: Limits | None = None
) -> Collection:
    """Draw coloured polygons of all ranks on rank 0's axes; collective.

    Args:
        ax: 2D axes for corners (n, corners, 2), 3D axes for (n, corners, 3).
        problem: The problem.
        polygons: The corners [mm].
        values: Value of every polygon (n,).
        limits: Values at both ends of the colours; None for the full range.
    """
    polygons, values = on_first_rank(problem, polygons, values)
    style = {"array": values, "edgecolors": "black", "linewidths": 0.6}
    if polygons.shape[-1] == 3:
        collection = ax.add_collection3d(Poly3DCollection(polygons, **style))
    else:
        collection = _add_flat(ax, PolyCollection(polygons, **style), polygons)
    collection.set_clim(*(limits or (None, None)))
    ax.set_aspect("equal")
    return collection


def on_first_rank(problem: Problem, *arrays: NDArray) -> list[NDArray]:
    """Rows of all ranks on rank 0; one row of zeros on the others, so they can draw too."""
    gathered = problem.comm.gather(arrays)
    if gathered is None:
        return [np.zeros((1, *array.shape[1:])) for array in arrays]
    return [np.concatenate(parts) for parts in zip(*gathered, strict=True)]
