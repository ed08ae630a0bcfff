"""Viscous forces in explicit steps, lumped at the nodes like masses."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ..problem.motion import moving
from ..problem.problem import Problem

Array = NDArray[np.float64]


class ViscousNodes:
    """C.v of a problem in explicit steps.

    alpha M and dashpots are lumped and act at the velocity of the end of the step, which leaves the
    critical step as it is; beta K acts at that of its middle, which shortens it.
    """

    def __init__(self, problem: Problem, masses: Array):
        self._damping, self._masses = moving(problem.step.motion).damping, masses
        self._d = d = problem.mesh.geometry.dim
        self._nodes = np.zeros(0, dtype=np.intp)
        self._blocks = np.zeros((0, d, d))
        if not self._damping.dashpots:
            return
        matrix = self._damping.matrix()
        x, y = matrix.createVecs()
        sums = np.zeros((len(masses) // d, d, d))
        for j in range(d):
            x.array[:] = np.tile(np.arange(d) == j, len(masses) // d)
            matrix.mult(x, y)
            sums[:, :, j] = y.array.reshape(-1, d)
        self._nodes = np.flatnonzero(sums.any(axis=(1, 2)))
        self._blocks = sums[self._nodes]
        for item in (matrix, x, y):
            item.destroy()

    def stable(self, critical: float) -> float:
        """The critical step with damping, 2/omega (sqrt(1 + xi^2) - xi), xi = beta omega/2, from
        that without, 2/omega [s]."""
        xi = self._damping.rayleigh.beta / critical
        return critical * (math.sqrt(1 + xi**2) - xi)

    def solve(self, forces: Array, inverse: Array, v: Array, h: float) -> Array:
        """Acceleration a of M.a = forces - C.(v + h a/2) of owned dofs, C without beta K."""
        if not self._damping.exists:
            return forces * inverse
        alpha, d = self._damping.rayleigh.alpha, self._d
        forces = forces - alpha * self._masses * v
        a = forces * inverse / (1 + h / 2 * alpha)
        if len(self._nodes):
            dofs = d * self._nodes[:, None] + np.arange(d)
            there = forces[dofs] - np.einsum("nij,nj->ni", self._blocks, v[dofs])
            M = self._masses[dofs][:, :, None] * np.eye(d) * (1 + h / 2 * alpha)
            a[dofs] = np.linalg.solve(M + h / 2 * self._blocks, there[..., None])[..., 0]
        return a

    def drag(self, v: Array) -> Array:
        """C.v of owned dofs, C without beta K [N]."""
        if not self._damping.exists:
            return np.zeros_like(v)
        return self._damping.rayleigh.alpha * self._masses * v + self.of_dashpots(v)

    def of_dashpots(self, v: Array) -> Array:
        forces, dofs = np.zeros_like(v), self._d * self._nodes[:, None] + np.arange(self._d)
        forces[dofs] = np.einsum("nij,nj->ni", self._blocks, v[dofs])
        return forces
