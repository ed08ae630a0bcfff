"""Meshes of the scenes, made by gmsh; every size is a parameter."""

from .gmsh_model import TaggedMesh
from .plate import tearing
from .two_blocks import blocks

__all__ = ["TaggedMesh", "blocks", "tearing"]
