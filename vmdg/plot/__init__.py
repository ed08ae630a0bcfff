"""Plots with matplotlib: curves, interfaces, stress, animations.

Functions of a problem are collective: every rank calls them, rank 0 draws and saves.
:mod:`vmdg.plot.solids` renders solids with PyVista, if it is installed.
"""

from ..output.profile import profile
from . import solids as solids
from .animation import animate, film
from .interface import interface_points, interface_profile, mode_map
from .stress import (
    add_colorbar,
    cell_means,
    curve,
    deformed_corners,
    deformed_polygons,
    draw_cells,
    stress,
)

__all__ = [
    "add_colorbar",
    "animate",
    "cell_means",
    "curve",
    "deformed_corners",
    "deformed_polygons",
    "draw_cells",
    "film",
    "interface_points",
    "interface_profile",
    "mode_map",
    "profile",
    "stress",
]
