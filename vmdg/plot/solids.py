"""Pictures of solids with PyVista, if installed; :mod:`vmdg.plot` does not need it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..base.parallel import raise_together
from ..problem.problem import Problem
from .stress import (
    Limits,
    boundary_facets,
    cell_means,
    deformed_corners,
    on_first_rank,
    seen_stress,
)


def picture(
    path: str | Path,
    problem: Problem,
    component: str = "mises",
    magnify: float = 1.0,
    limits: Limits | None = None,
    facets: NDArray[np.int32] | None = None,
    view: tuple[float, float, float] = (-1.0, -1.0, 0.7),
    size: tuple[int, int] = (1200, 900),
) -> None:
    """Write a rendered picture of the Cauchy stress on the deformed surface of a solid; collective.

    Args:
        path: A file .png; its folder is created if missing.
        problem: The problem, in 3D.
        component: As for :func:`vmdg.plot.stress`.
        magnify: Factor on the displacement.
        limits: Stresses at both ends of the colours [MPa]; None for the full range.
        facets: Boundary facets to draw; None for all.
        view: Direction from the centre of the body to the viewer.
        size: Size of the picture [pixels].

    Raises:
        ImportError: PyVista is not installed.
        ValueError: a plane problem, or no such component.
    """
    try:
        import pyvista
    except ImportError as error:
        raise ImportError(
            f"vmdg.plot.solids needs PyVista ({error}): pip install pyvista, and without a display "
            "the library OSMesa too (Debian: libosmesa6); or use vmdg.plot.stress"
        ) from error
    message = None
    if problem.mesh.geometry.dim != 3:
        message = "solids.picture: the problem is plane; use vmdg.plot.stress"
    raise_together(problem.comm, message)
    sigma, take, _ = seen_stress(problem, component)
    facets = boundary_facets(problem) if facets is None else facets
    corners, cells = deformed_corners(problem, facets, magnify)
    values = take(cell_means(sigma))[cells]
    corners, values = on_first_rank(problem, corners, values)
    if problem.comm.rank > 0:
        return
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    count, c = corners.shape[:2]
    polygons = np.column_stack([np.full(count, c), np.arange(count * c).reshape(count, c)])
    surface = pyvista.PolyData(corners.reshape(-1, 3), polygons.ravel())
    plotter = pyvista.Plotter(off_screen=True, window_size=size)
    bar = {"title": f"{component} stress [MPa]\n", "vertical": True, "position_x": 0.85}
    style = {"ambient": 0.45, "diffuse": 0.6, "show_edges": True, "edge_opacity": 0.2}
    plotter.add_mesh(surface, scalars=values, clim=limits, scalar_bar_args=bar, **style)
    plotter.view_vector(view)
    plotter.screenshot(path)
    plotter.close()
