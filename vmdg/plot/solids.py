"""Solids in axes of matplotlib: their surfaces are images, which PyVista renders."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from ctypes.util import find_library
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.transforms import nonsingular, offset_copy
from numpy.typing import NDArray

from ..base.words import pip_install
from ..domain.topology import facet_cells, local_facets, outer_facets
from ..output.corners import corners_of_local
from ..problem.problem import Problem

#: Direction from a body to its viewer; pixels of the longer side of a picture of it.
VIEW, PIXELS = (-1.0, -1.3, 0.8), 1500
#: Length of the arrows along x, y and z [points].
ARROW = 22
#: Angle between two facets from which the edge between them is drawn [degrees].
EDGE = 30.0


def reason_against() -> str:
    """Why no solid can be drawn here, and the cure; empty if it can."""
    try:
        import pyvista  # noqa: F401
    except ImportError as error:
        return f"pictures of solids need PyVista ({error}): {pip_install('pyvista')}"
    if sys.platform != "linux" or os.environ.get("DISPLAY"):
        return ""
    windows = {"EGL": "vtkEGLRenderWindow", "OSMesa": "vtkOSOpenGLRenderWindow"}
    there = [window for library, window in windows.items() if find_library(library)]
    if not there:
        return (
            "pictures of solids need a display, or libEGL or libOSMesa: apt-get install libegl1 "
            "libgl1-mesa-dri"
        )
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", there[0])
    return ""


def surface(problem: Problem, faces: bool = True) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Facets of owned cells on the boundary and, with ``faces``, on both faces of interfaces: cells
    (n,) and corner numbers in them, in order around each facet (n, c); collective.
    """
    mesh = problem.mesh
    shown = outer_facets(mesh)
    for active in problem.discretization.active.values():
        if faces and not active.facets.paired:  # those are boundary facets
            shown[active.facets.everywhere] = True
    facets = np.flatnonzero(shown).astype(np.int32)
    cells = facet_cells(mesh)[facets].ravel()
    facets = np.repeat(facets, 2)
    owned = (cells >= 0) & (cells < mesh.topology.index_map(3).size_local)
    local = local_facets(mesh, cells[owned], facets[owned])
    return cells[owned], corners_of_local(mesh, local)


def widen(drawn: ScalarMappable) -> None:
    """Let colours range over all values, and around a value that is the only one."""
    drawn.autoscale_None()
    low, high = drawn.get_clim()
    if low == high:
        drawn.set_clim(*nonsingular(low, high, expander=0.1))


def axes_of(ax: Axes | None) -> Axes:
    if ax is None:
        return plt.subplots(layout="constrained")[1]
    if ax.name == "3d":
        raise ValueError("solids are drawn into axes without projection='3d'")
    return ax


def draw_solid(
    ax: Axes,
    corners: NDArray[np.float64],
    values: NDArray[np.float64],
    limits: tuple[float | None, float | None],
    colours: str,
    box: NDArray[np.float64],
    view: Sequence[float] = VIEW,
    outline: NDArray[np.float64] | None = None,
    edges: float = 0.0,
) -> ScalarMappable:
    """Render coloured facets seen from a direction, in parallel projection, as an image in axes.

    Where that is impossible the axes say why.

    Args:
        corners: Of the facets, in order around them (n, c, 3) [mm].
        values: At the corners (n, c), or of the facets (n,), which are smoothed.
        limits: Values at both ends of the colours; None for the least and the largest.
        box: Least and largest coordinates of what the picture shows (2, 3) [mm].
        view: Direction from the body to the viewer, upwards being z, or y if that is the direction.
        outline: Facets of which only edges are drawn (m, c, 3) [mm].

    Returns:
        What a colour bar needs.
    """
    drawn = ScalarMappable(Normalize(*limits), colours)
    drawn.set_array(values)
    widen(drawn)
    ax.set(xticks=[], yticks=[])
    ax.spines[:].set_visible(False)
    if reason := reason_against():
        ax.text(0.5, 0.5, reason, ha="center", va="center", wrap=True, transform=ax.transAxes)
        return drawn
    import pyvista
    from vtkmodules.vtkRenderingCore import vtkMapper

    vtkMapper.SetResolveCoincidentTopologyToPolygonOffset()  # lines are before their surfaces
    towards = np.asarray(view, dtype=float) / np.linalg.norm(view)
    up = np.array([0.0, 0.0, 1.0]) if abs(towards[2]) < 0.99 else np.array([0.0, 1.0, 0.0])
    right = np.cross(up, towards)
    screen = np.stack([right / np.linalg.norm(right), np.cross(towards, right)])
    screen[1] /= np.linalg.norm(screen[1])
    ends = np.stack(np.meshgrid(*np.transpose(box)), axis=-1).reshape(-1, 3) @ screen.T
    width, height = 1.04 * np.maximum(np.ptp(ends, axis=0), 1e-3 * np.ptp(ends))
    pixels = np.rint(PIXELS * np.array([width, height]) / max(width, height)).astype(int)
    plotter = pyvista.Plotter(off_screen=True, window_size=pixels.tolist(), lighting="none")
    plotter.add_light(pyvista.Light(light_type="headlight", intensity=0.5))
    plotter.set_background("white")
    if len(corners):
        shown = _polygons(pyvista, corners)
        if values.ndim == 1:
            shown.cell_data["value"] = values
            shown = shown.clean().cell_data_to_point_data()
        else:
            shown.point_data["value"] = values.ravel()
        style = {
            "ambient": 0.55,
            "diffuse": 0.9,
            "clim": drawn.get_clim(),
        }
        if edges:
            style |= {"show_edges": True, "edge_color": "0.2", "line_width": 2 * edges}
        plotter.add_mesh(shown, scalars="value", cmap=colours, show_scalar_bar=False, **style)
    for facets, colour, junctions in ((corners, "black", True), (outline, "grey", False)):
        if facets is not None and len(facets):
            lines = _polygons(pyvista, facets).clean()
            # Neighbours that are wound in opposite senses would have an edge between them.
            alike = {"consistent_normals": True, "non_manifold_traversal": False}
            lines = lines.compute_normals(point_normals=False, **alike)
            lines = lines.extract_feature_edges(EDGE, non_manifold_edges=junctions)
            if lines.n_cells:
                plotter.add_mesh(lines, color=colour, line_width=3.0, lighting=False)
    middle, far = np.mean(box, axis=0), 10 * np.linalg.norm(np.ptp(box, axis=0))
    plotter.camera_position = [middle + far * towards, middle, screen[1]]
    plotter.enable_parallel_projection()
    plotter.camera.parallel_scale = height / 2
    plotter.reset_camera_clipping_range()
    image = plotter.screenshot(return_img=True)
    plotter.close()
    ax.imshow(image)
    _draw_axes(ax, screen)
    return drawn


def _polygons(pyvista: Any, corners: NDArray[np.float64]) -> Any:
    count, c = corners.shape[:2]
    faces = np.column_stack([np.full(count, c), np.arange(count * c).reshape(count, c)])
    return pyvista.PolyData(corners.reshape(-1, 3), faces.ravel())


def _draw_axes(ax: Axes, screen: NDArray[np.float64]) -> None:
    start = offset_copy(ax.transAxes, ax.figure, x=-30, y=8, units="points")
    for name, end in zip("xyz", ARROW * screen.T, strict=True):
        if np.linalg.norm(end) > 0.1 * ARROW:
            arrow = {"arrowstyle": "<-", "lw": 0.8, "shrinkA": 0, "shrinkB": 0}
            style = {"textcoords": "offset points", "ha": "center", "va": "center"}
            ax.annotate(name, (0, 0), end, start, arrowprops=arrow, **style)
