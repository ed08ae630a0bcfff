"""Meshes of the scenes, made by gmsh, every size a parameter; and meshes from files."""

from .beams import beams
from .discs import core_and_ring
from .fibres import fibre_matrix, random_fibres
from .files import read_mesh, write_mesh
from .gmsh_model import TaggedMesh
from .inclusions import inclusions
from .plate import tearing
from .pushout import pushout
from .pushout_section import pushout_section
from .two_blocks import blocks

__all__ = [
    "TaggedMesh",
    "beams",
    "blocks",
    "core_and_ring",
    "fibre_matrix",
    "inclusions",
    "pushout",
    "pushout_section",
    "random_fibres",
    "read_mesh",
    "tearing",
    "write_mesh",
]
