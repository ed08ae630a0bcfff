"""Pictures with matplotlib: curves, interfaces, stress, animations.

Functions of a problem are collective: every rank calls them, rank 0 draws and saves.
"""

from .animation import animate
from .drawing import cell_means, curve, deformed_corners, deformed_polygons, draw_cells, stress
from .drawing_interface import interface_profile, mode_map
from .profile import profile

__all__ = [
    "animate",
    "cell_means",
    "curve",
    "deformed_corners",
    "deformed_polygons",
    "draw_cells",
    "interface_profile",
    "mode_map",
    "profile",
    "stress",
]
