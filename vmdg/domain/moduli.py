"""Expressions of the bodies at reference points of cells and facets, the moduli A among them."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import basix
import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from ufl.core.expr import Expr

from .. import compat
from ..base.kernels import JIT_OPTIONS, VECTORIZED, compile_expression
from ..forms import kinematics
from ..forms.kinematics import Body
from .materials import Bodies


class RegionExpressions:
    """An expression of the body and F at the current displacement, by a kernel for every region."""

    def __init__(
        self,
        u: fem.Function,
        bodies: Bodies,
        regions: Iterable[int],
        expression: Callable[[Body, Expr], Expr],
        points: NDArray[np.float64],
        name: str,
    ):
        self._mesh, self._points = u.function_space.mesh, len(points)
        options = VECTORIZED if self._mesh.topology.dim == 3 else JIT_OPTIONS
        self._expressions = {}
        for number in regions:
            F = ufl.variable(bodies.geometry.deformation(u))
            vector = expression(bodies.regions[number].body, F)
            self._size = len(vector)
            self._expressions[number] = compile_expression(
                vector, points, self._mesh.comm, options, name
            )

    def in_region(self, number: int, entities: NDArray[np.int32]) -> NDArray[np.float64]:
        """Values on cells, or rows (cell, facet in it), of one region (n, points, components)."""
        values = compat.evaluate(self._expressions[number], self._mesh, entities)
        return values.reshape(len(entities), self._points, self._size)

    def __call__(
        self, region: NDArray[np.int32], entities: NDArray[np.int32]
    ) -> NDArray[np.float64]:
        """Values where ``region`` gives the region of each entity."""
        result = np.empty((len(entities), self._points, self._size))
        for number in self._expressions:
            chosen = np.flatnonzero(region == number)
            if len(chosen):
                result[chosen] = self.in_region(number, entities[chosen])
        return result


def cell_moduli(
    u: fem.Function, bodies: Bodies, regions: Iterable[int], points: NDArray[np.float64]
) -> RegionExpressions:
    """The independent A_rc, r <= c, row by row [MPa]; rows and columns are entries of GRAD.

    Those of a body at points are elastic.
    """
    geometry = bodies.geometry
    entries = geometry.entries(u.function_space.mesh.geometry.dim)

    def moduli(body: Body, F: Expr) -> Expr:
        return kinematics.major_components(
            kinematics.bulk_moduli(body.elastic, geometry, F), entries
        )

    return RegionExpressions(u, bodies, regions, moduli, points, "moduli")


def mean_modulus(mesh: Mesh, bodies: Bodies, cells: NDArray[np.int32]) -> float:
    """Mean of the diagonal of A over cells of undeformed bodies [MPa]; infinite for a rigid wall;
    collective."""
    if bodies.rigid[cells].all():
        return np.inf
    u = fem.Function(fem.functionspace(mesh, ("Lagrange", 1, (mesh.geometry.dim,))))
    middle = basix.geometry(mesh.basix_cell()).mean(axis=0)[None]
    region = bodies.region[cells]
    A = cell_moduli(u, bodies, np.unique(region), middle)(region, cells)
    size = len(bodies.geometry.entries(mesh.geometry.dim))
    rows, columns = np.triu_indices(size)
    return float(A[..., rows == columns].mean())
