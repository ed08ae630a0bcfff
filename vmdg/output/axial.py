"""Strain and force along z in generalized plane strain."""

from __future__ import annotations

from ..forms.geometry import GeneralizedPlane
from ..problem.problem import Problem
from .cell import forces_on_means


class AxialMotion:
    """Current strain and force along z of a body in generalized plane strain.

    Args:
        problem: See :class:`vmdg.GeneralizedStrain`.

    Raises:
        ValueError: the problem is not in generalized plane strain.
    """

    def __init__(self, problem: Problem):
        if not isinstance(problem.discretization.geometry, GeneralizedPlane):
            raise ValueError(
                "AxialMotion: F_33 is an unknown in generalized plane strain only; give "
                'Problem(..., plane="generalized strain")'
            )
        self._problem = problem

    @property
    def strain(self) -> float:
        """F_33 - 1."""
        now = self._problem.discretization
        assert now.means is not None
        return float(now.means.gradient(now.u.x.array)[2, 2])

    @property
    def force(self) -> float:
        """Force on the section, int P_33 dA, or on the cell if periodic; collective [N]."""
        thickness = float(self._problem.discretization.geometry.thickness)
        return float(forces_on_means(self._problem)[2, 2]) / thickness

    def row(self) -> dict[str, float]:
        """Values for a row of the history; collective."""
        return {"axial_strain [-]": self.strain, "axial_force [N]": self.force}
