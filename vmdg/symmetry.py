"""The geometry of a problem from the user's words, and the axis of a body of revolution."""

from __future__ import annotations

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from .forms.geometry import Axisymmetric, Cartesian, Geometry
from .parallel import global_max

SYMMETRIES = (None, "axisymmetric")

# Nodes within this share of the largest radius lie on the axis: the rounding of a mesher.
_ON_AXIS = 1e-10


def make_geometry(mesh: Mesh, symmetry: str | None, thickness: float) -> Geometry:
    """The geometry that the forms work with; collective.

    Args:
        mesh: The mesh.
        symmetry: None or "axisymmetric".
        thickness: Of a plane body [mm].

    Raises:
        ValueError: unknown word, a mesh that is no half section, or a thickness that has no
            meaning.
    """
    if symmetry not in SYMMETRIES:
        raise ValueError(f"Problem: symmetry = {symmetry!r} must be one of {SYMMETRIES}")
    d = mesh.geometry.dim
    if symmetry is None:
        if not thickness > 0 or (d == 3 and thickness != 1):
            raise ValueError(f"Problem: thickness = {thickness} must be positive, and 1 in 3D")
        return Cartesian(fem.Constant(mesh, float(thickness)) if thickness != 1 else 1)
    if d != 2:
        raise ValueError(
            f"Problem: symmetry='axisymmetric' needs a 2D mesh, x = r and y = z; this one is {d}D"
        )
    if thickness != 1:
        raise ValueError(
            f"Problem: thickness = {thickness} has no meaning with symmetry='axisymmetric', where "
            "every integral is that of the whole body of revolution"
        )
    r = mesh.geometry.x[:, 0]
    largest = global_max(mesh.comm, float(np.abs(r).max(initial=0.0)))
    least = -global_max(mesh.comm, float(-r.min(initial=np.inf)))
    if least < -_ON_AXIS * largest:
        raise ValueError(
            f"Problem: the mesh has nodes at x = r = {least:.6g} < 0; with "
            "symmetry='axisymmetric' it must be a half section, r >= 0"
        )
    return Axisymmetric(ufl.SpatialCoordinate(mesh), _ON_AXIS * largest)


def axis_dofs(space: fem.FunctionSpace, geometry: Geometry) -> NDArray[np.int32]:
    """Local dofs (component-wise numbers) of the radial displacement on the axis."""
    if not isinstance(geometry, Axisymmetric):
        return np.zeros(0, dtype=np.int32)
    nodes = fem.locate_dofs_geometrical(space, lambda x: x[0] <= geometry.axis)
    return (nodes * space.dofmap.index_map_bs).astype(np.int32)
