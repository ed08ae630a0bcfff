"""The motion of a rigid face."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .loading import Loading


class RigidMotion:
    """Motion of a rigid face, see :meth:`vmdg.Problem.rigid_face`.

    Args:
        loading: The loading with the face.
        number: Number of the face.
    """

    def __init__(self, loading: Loading, number: int):
        self._loading, self._number = loading, number

    def displacement(self) -> float | NDArray[np.float64]:
        """Displacement of its point, a number with one component, else (d,) [mm]; collective."""
        faces = self._loading.rigid
        face = faces.faces[self._number]
        found = faces.displacement(face)
        return found if face.component is None else float(found[0])

    def rotation(self) -> float | NDArray[np.float64]:
        """Rotation, about z in 2D, about the axes (3,) in 3D [rad]; collective."""
        faces = self._loading.rigid
        angles = faces.rotation(faces.faces[self._number])
        if len(angles) == 1:
            return float(angles[0])
        xy, xz, yz = angles
        return np.array([yz, -xz, xy])
