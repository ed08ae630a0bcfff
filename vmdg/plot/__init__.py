"""Plots with matplotlib: curves, interfaces, stress, animations; solids are rendered by PyVista.

Functions of a problem are collective: every rank calls them, rank 0 draws and saves. Where PyVista
is not installed, axes of solids say so. The pictures of the gallery have the style
``plt.style.use("vmdg.plot.paper")``.
"""

from ..output.profile import profile
from .animation import animate, film
from .interface import interface_map, interface_profile, mode_map
from .stress import add_colorbar, curve, indicator, stress

__all__ = [
    "add_colorbar",
    "animate",
    "curve",
    "film",
    "indicator",
    "interface_map",
    "interface_profile",
    "mode_map",
    "profile",
    "stress",
]
