"""Parametric meshes of the scenes, made with gmsh, and meshes from files.

Groups have tags and names: ``mesh.cell_tags.names`` and ``mesh.facet_tags.names`` list them, and
``mesh.facet_tags.find("left")`` finds their facets. A geometry of your own is made with the gmsh
API in ``with model(name) as gmsh_model`` on rank 0 and becomes such a mesh by :func:`distribute`.
Files of gmsh, Neper, Abaqus, Salome, meshio and others are read by :func:`read_mesh`.
"""

from vmdg.base.door import door

from .apart import apart
from .beams import beams, plates
from .fibre_cell import fibre_cell
from .fibres import fibre_matrix, random_fibres
from .files import read_mesh, write_mesh
from .gmsh_model import TaggedMesh, distribute, model
from .packing import pack
from .partition import cell_partitioner
from .polycrystal import polycrystal
from .pushout import pushout, pushout_section
from .refined import refined
from .two_blocks import blocks
from .walls import with_wall

__all__ = [
    "TaggedMesh",
    "apart",
    "beams",
    "blocks",
    "cell_partitioner",
    "distribute",
    "fibre_cell",
    "fibre_matrix",
    "model",
    "pack",
    "plates",
    "polycrystal",
    "pushout",
    "pushout_section",
    "random_fibres",
    "read_mesh",
    "refined",
    "with_wall",
    "write_mesh",
]

#: Functions of given meshes and files. In the others numbers go to gmsh, which larger ones kill.
_GIVEN = (
    "TaggedMesh",
    "apart",
    "cell_partitioner",
    "distribute",
    "model",
    "read_mesh",
    "refined",
    "with_wall",
)

globals().update(
    {
        name: door(
            globals()[name], largest=float("inf") if name in (*_GIVEN, "write_mesh") else 1e12
        )
        for name in __all__
    }
)
