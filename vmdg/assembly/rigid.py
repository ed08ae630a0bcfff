"""Faces that move as rigid plates: a few numbers determine the displacement of all their nodes.

On the nodes of a face the chosen components of the displacement are

    u = T.q,    T = m.C,

with translations and small rotations m, combined by C into orthonormal columns T. The admissible
motions are q = q_p + Z.p: all, or those that keep the prescribed displacement of one point. Nodal
forces f then balance in the sum, (T.Z)^T.f = 0, instead of node by node.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..base.parallel import global_sum
from ..domain.geometry import rigid_motions
from ..forms.geometry import Axisymmetric, Geometry
from .dirichlet import component_index
from .values import Part, Value, check_resultant, value_at

Array = NDArray[np.float64]

#: Eigenvalue of the motions of a face, relative to the largest one, below which its nodes do not
#: determine a motion.
UNTOLD = 1e-10


@dataclass(frozen=True)
class RigidFace:
    """A rigid face in a given space."""

    component: int | None  # The rigid component; None for all
    motions: list[int]
    dofs: NDArray[np.int32]  # Component-wise numbers of owned nodes (n, c)
    T: Array  # Columns of unit length (n, c, k)
    C: Array  # Motions in terms of columns (motions, k) [mm or rad]
    place: Array  # Displacement of the given point in terms of columns (c, k)
    value: Value | None  # Prescribed displacement of this point; None if it is free

    @property
    def free(self) -> Array:
        """T.Z (n, c, k)."""
        if self.value is None:
            return self.T
        # The motions that rotate the face about the point.
        turns = np.linalg.svd(self.place)[2][len(self.place) :]
        return self.T @ turns.T

    @property
    def lift(self) -> Array:
        """T.q_p for unit prescribed displacements of the point (n, c, c)."""
        return self.T @ np.linalg.pinv(self.place)

    @property
    def spread(self) -> Array:
        """Nodal forces for unit forces at the point (n, c, c)."""
        return self.T @ self.place.T


class RigidFaces:
    """The rigid faces of a space.

    Attributes:
        columns: T.Z of all faces over owned dofs (p, owned).
    """

    kind = "the displacement of a rigid face"

    def __init__(self, u: fem.Function, geometry: Geometry):
        space = u.function_space
        self._u, self._geometry, self._comm = u, geometry, space.mesh.comm
        self._d, self._nodes = space.dofmap.index_map_bs, space.dofmap.index_map.size_local
        self._x = space.tabulate_dof_coordinates()[: self._nodes, : self._d]
        self.faces: list[RigidFace] = []
        self.columns = np.zeros((0, self._nodes * self._d))

    def __bool__(self) -> bool:
        return bool(self.faces)

    def add(
        self,
        nodes: NDArray[np.int32],
        component: int | str | None,
        tilts: bool,
        at: Array | None,
        value: Value | None,
    ) -> RigidFace:
        """Add a rigid face; collective.

        Args:
            at: Point (d,) whose displacement is prescribed or returned; None for any.
            value: Prescribed displacement of the point; None if it is free.
        """
        d, index = self._d, component_index(component, self._d, "rigid_face")
        if value is not None:
            shapes = [(), (d,)] if index is None else [(), (1,)]
            check_resultant(self._comm, value, shapes, "rigid_face")
        axial = isinstance(self._geometry, Axisymmetric)
        if axial and (tilts or index != 1):
            raise ValueError(
                "rigid_face: a body of revolution moves along its axis only; give component='y' "
                "and tilts=False"
            )
        nodes = nodes[nodes < self._nodes]
        components = np.arange(d) if index is None else np.array([index])
        chosen = [0] if axial else _motions(components, d, tilts)
        x = self._x[nodes]
        # About a point among the nodes, to reduce rounding.
        centre = global_sum(self._comm, x.sum(axis=0)) / global_sum(self._comm, len(x))

        def moved(points: Array) -> Array:
            motions = rigid_motions(points - centre, self._geometry)[chosen]
            return motions[:, :, components].transpose(1, 2, 0)

        m = moved(x)
        C = self._orthonormal(m.reshape(-1, m.shape[2]))
        place = moved(centre[None] if at is None else at[None])[0]
        dofs = (nodes[:, None] * d + components).astype(np.int32)
        face = RigidFace(index, chosen, dofs, m @ C, C, place @ C, value)
        self.faces.append(face)
        columns = np.zeros((face.free.shape[2], self.columns.shape[1]))
        columns[:, dofs] = face.free.transpose(2, 0, 1)
        self.columns = np.concatenate([self.columns, columns])
        return face

    def _orthonormal(self, m: Array) -> Array:
        """C of motions m (n, motions); collective."""
        gram = global_sum(self._comm, m.T @ m)
        # Rotations times the size of the face, so that all have the same unit.
        sizes = np.sqrt(np.maximum(np.diag(gram), np.finfo(float).tiny))
        values, vectors = np.linalg.eigh(gram / np.outer(sizes, sizes))
        if values[0] <= UNTOLD * values[-1]:
            raise ValueError(
                "rigid_face: the nodes of the face do not determine its rotation, for example "
                "collinear nodes in 3D; give more facets, or tilts=False"
            )
        return vectors / np.sqrt(values) / sizes[:, None]

    @property
    def dofs(self) -> NDArray[np.int32]:
        """Owned dofs (component-wise numbers) of all faces, concatenated."""
        return _dofs(self.faces)

    # Motion

    def rotation(self, face: RigidFace) -> Array:
        """Current rotations of a face, from x to y, x to z and y to z, 0 where it does not rotate;
        collective [rad]."""
        q, rotations = face.C @ self._amplitudes(face), np.zeros(self._d * (self._d - 1) // 2)
        for number, angle in zip(face.motions, q, strict=True):
            if number >= self._d:
                rotations[number - self._d] = angle
        return rotations

    def displacement(self, face: RigidFace) -> Array:
        """Current displacement of the point of a face (c,); collective [mm]."""
        return face.place @ self._amplitudes(face)

    def _amplitudes(self, face: RigidFace) -> Array:
        u = self._u.x.array[face.dofs]
        return global_sum(self._comm, np.tensordot(u, face.T, axes=2))

    # Prescribed displacements

    @property
    def _driven(self) -> list[RigidFace]:
        return [face for face in self.faces if face.value is not None]

    @property
    def driven_dofs(self) -> NDArray[np.int32]:
        """Those of :attr:`dofs` of faces with a prescribed displacement."""
        return _dofs(self._driven)

    def values(self, t: float) -> Array:
        """Prescribed displacements at load factor ``t`` of all points, concatenated [mm]."""
        given = (np.broadcast_to(value_at(f.value, t), len(f.place)) for f in self._driven)
        return np.concatenate([np.zeros(0), *given])

    def parts(self, t: float) -> Iterator[Part]:
        for face in self.faces:
            node = face.dofs[:1].ravel()[:1] // self._d
            value = np.zeros(1) if face.value is None else np.atleast_1d(value_at(face.value, t))
            x = np.pad(self._x[node], ((0, 0), (0, 3 - self._d)))
            yield Part("rigid_face", value[None], x.T)

    def displacements(self) -> Array:
        """Current displacements of the points of :meth:`values`; collective [mm]."""
        return np.concatenate([np.zeros(0), *(self.displacement(face) for face in self._driven)])

    def lifted(self, values: Array) -> Array:
        """Displacement of owned dofs for these displacements of the points, without rotation."""
        result, start = np.zeros(self.columns.shape[1]), 0
        for face in self._driven:
            end = start + len(face.place)
            result[face.dofs] = face.lift @ values[start:end]
            start = end
        return result

    # Forces

    def balance(self, forces: Array) -> None:
        """Replace nodal forces on faces by their resultants on the motions; owned dofs, collective
        [N]."""
        if self.faces:
            moving = global_sum(self._comm, self.columns @ forces)
            forces[self.dofs] = 0
            forces += moving @ self.columns


def _dofs(faces: list[RigidFace]) -> NDArray[np.int32]:
    none = np.zeros(0, dtype=np.int32)
    return np.concatenate([none, *(face.dofs.ravel() for face in faces)])


def _motions(components: NDArray[np.intp], d: int, tilts: bool) -> list[int]:
    chosen = components.tolist()
    pairs = enumerate(combinations(range(d), 2), start=d)
    return chosen + [i for i, pair in pairs if tilts and not set(pair).isdisjoint(chosen)]
