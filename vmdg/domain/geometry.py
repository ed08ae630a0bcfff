"""The geometry of a problem from the user's input, its axis and its rigid motions."""

from __future__ import annotations

from itertools import combinations
from numbers import Real

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray

from ..base.parallel import global_max, global_sum
from ..forms.dilatation import MeanAxisymmetric, MeanCartesian
from ..forms.geometry import Axisymmetric, Cartesian, GeneralizedPlane, Geometry

Array = NDArray[np.float64]

SYMMETRIES = (None, "axisymmetric")
VOLUMETRIC = ("pointwise", "mean")

# Nodes within this fraction of the largest radius lie on the axis (rounding of mesh generators).
_ON_AXIS = 1e-10

# Squared width over length of a set of points below which a rotation about their longest line is
# undetermined.
_WIDTH = 1e-6


def make_geometry(
    mesh: Mesh,
    symmetry: str | None,
    thickness: float,
    volumetric: str = "pointwise",
    degree: int = 1,
    periodic: bool = False,
    axial: bool = False,
) -> Geometry:
    """The geometry that the forms work with; collective."""
    if volumetric not in VOLUMETRIC:
        raise ValueError(f"Problem: volumetric = {volumetric!r} must be one of {VOLUMETRIC}")
    if periodic and (symmetry is not None or volumetric == "mean"):
        raise ValueError(
            f"Problem: periodic cannot be combined with symmetry={symmetry!r}, "
            f"volumetric={volumetric!r}: a periodic cell is plane or 3D with pointwise J; omit "
            "both, and use degree=2 near incompressibility"
        )
    if volumetric == "mean":
        return _with_mean_dilatation(mesh, make_geometry(mesh, symmetry, thickness), degree)
    if symmetry not in SYMMETRIES:
        raise ValueError(f"Problem: symmetry = {symmetry!r} must be one of {SYMMETRIES}")
    d = mesh.geometry.dim
    if symmetry is None:
        number = isinstance(thickness, Real) and 0 < thickness < np.inf
        if not number or (d == 3 and thickness != 1):
            raise ValueError(
                f"Problem: thickness = {thickness!r} must be positive and finite, in 3D equal to 1"
            )
        constant = fem.Constant(mesh, float(thickness)) if thickness != 1 else 1
        macroscopic = fem.Constant(mesh, np.zeros((d, d))) if periodic else None
        if axial:
            return GeneralizedPlane(constant, macroscopic, axial=fem.Constant(mesh, 0.0))
        return Cartesian(constant, macroscopic)
    if d != 2:
        raise ValueError(
            f"Problem: symmetry='axisymmetric' needs a 2D mesh, x = r and y = z; this one is {d}D"
        )
    if thickness != 1:
        raise ValueError(
            f"Problem: thickness = {thickness} has no meaning with symmetry='axisymmetric', where "
            "every integral is over the whole body of revolution"
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


def _with_mean_dilatation(mesh: Mesh, geometry: Geometry, degree: int) -> Geometry:
    """The same geometry with the fields of mean dilatation, undeformed and without pressure."""
    cell = mesh.topology.cell_name()
    if cell not in ("quadrilateral", "hexahedron") or degree != 1:
        raise ValueError(
            "Problem: volumetric='mean' is for quadrilaterals and hexahedra of degree 1, not for a "
            f"{cell} of degree {degree}: a linear simplex has constant J and locks regardless, "
            "degree 2 does not lock; use quadrilaterals or hexahedra, or degree=2 with "
            "volumetric='pointwise'"
        )
    space = fem.functionspace(mesh, ("DG", 0))
    theta = fem.Function(space, name="dilatation")
    theta.x.array[:] = 1.0
    fields = {"theta": theta, "pressure": fem.Function(space, name="pressure")}
    if isinstance(geometry, Axisymmetric):
        return MeanAxisymmetric(geometry.x, geometry.axis, **fields)
    return MeanCartesian(geometry.thickness, **fields)


def axis_dofs(space: fem.FunctionSpace, geometry: Geometry) -> NDArray[np.int32]:
    """Local dofs (component-wise numbers) of the radial displacement on the axis."""
    if not isinstance(geometry, Axisymmetric):
        return np.zeros(0, dtype=np.int32)
    nodes = fem.locate_dofs_geometrical(space, lambda x: x[0] <= geometry.axis)
    return (nodes * space.dofmap.index_map_bs).astype(np.int32)


def rigid_motions(x: NDArray[np.float64], geometry: Geometry) -> NDArray[np.float64]:
    """Translations, then rotations, of small angle (modes, n, d); along z only in axisymmetry."""
    d = x.shape[1]
    translations = [np.tile(direction, (len(x), 1)) for direction in np.eye(d)]
    if isinstance(geometry, Axisymmetric):
        return np.array(translations[1:])
    rotations = []
    for i, j in combinations(range(d), 2):
        rotation = np.zeros((len(x), d))
        rotation[:, i], rotation[:, j] = -x[:, j], x[:, i]
        rotations.append(rotation)
    return np.array([*translations, *rotations])


def rigid_part(comm: MPI.Comm, x: Array, y: Array) -> tuple[Array, Array, Array] | None:
    """The best-fit rigid motion between two sets of points (Kabsch 1976); collective.

        R = argmin sum_i |y_i - c' - R (x_i - c)|^2,    c and c' the mean positions.

    Returns:
        Rotation (d, d), mean of all x and mean of all y; None where they do not determine the
        rotation.
    """
    d = x.shape[1]
    count = int(global_sum(comm, len(x)))
    if count < d:
        return None
    before, after = (global_sum(comm, points.sum(axis=0)) / count for points in (x, y))
    U, sizes, V = np.linalg.svd(global_sum(comm, (y - after).T @ (x - before)))
    # Collinear points in 3D, or a single point in 2D, do not determine the rotation.
    if sizes[d - 2] <= _WIDTH * sizes[0]:
        return None
    mirror = np.ones(d)
    mirror[-1] = np.sign(np.linalg.det(U @ V))
    return U @ (mirror[:, None] * V), before, after
