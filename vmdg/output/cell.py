"""Means of a periodic cell, its whole displacement, and strain and force along z."""

from __future__ import annotations

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..assembly.dirichlet import AXES
from ..assembly.means import MeanSpace, lattice_of
from ..base.parallel import global_sum
from ..domain.lattice import Lattice
from ..forms.geometry import GeneralizedPlane
from ..points.interface import interface_names
from ..problem.problem import Problem
from .values import traction_integrals

Array = NDArray[np.float64]


def whole_displacement(problem: Problem) -> fem.Function:
    """Current displacement u, for a periodic cell H.X + w, on the broken space [mm]."""
    now = problem.discretization
    return now.u if now.means is None else now.means.displacement(now.u.x.array)


def forces_on_means(problem: Problem) -> Array:
    """Forces on H from all stresses and tractions (n, n), n = 3 with F_33; collective [N mm]."""
    now = problem.discretization
    assert now.means is not None
    return now.means.forces_on_means(now.forces.x.array + problem.loading.vector)


class PeriodicCell:
    """Means of a periodic cell at the current state; see :class:`vmdg.Periodic`.

    Args:
        problem: The problem of a periodic cell.

    Raises:
        ValueError: it is not one.
    """

    def __init__(self, problem: Problem):
        if lattice_of(problem.discretization.means) is None:
            raise ValueError(
                "PeriodicCell: the problem is a body with a surface; make it a periodic cell by "
                "Problem(..., periodic=vmdg.Periodic(...))"
            )
        self._problem = problem

    @property
    def _space(self) -> MeanSpace:
        means = self._problem.discretization.means
        assert means is not None
        return means

    @property
    def _lattice(self) -> Lattice:
        lattice = self._space.lattice
        assert lattice is not None
        return lattice

    @property
    def vectors(self) -> Array:
        """Sides of the cell, one per row (d, d) [mm]."""
        return self._lattice.vectors.copy()

    @property
    def volume(self) -> float:
        """Volume of the cell, voids included; for a plane cell area times thickness [mm3]."""
        thickness = float(self._problem.discretization.geometry.thickness)
        return self._lattice.volume * thickness

    @property
    def gradient(self) -> Array:
        """Mean deformation gradient F_bar (n, n), n = 3 in generalized plane strain, else d."""
        H = self._space.gradient(self._problem.discretization.u.x.array)
        return np.eye(len(H)) + H

    @property
    def strain(self) -> Array:
        """Symmetric part of F_bar - I (n, n), at small strain the mean strain E_bar."""
        F = self.gradient
        return (F + F.T) / 2 - np.eye(len(F))

    @property
    def stress(self) -> Array:
        """Mean stress P_bar (n, n), the force on H per volume; collective [MPa].

        Conjugate to F_bar in the weak form: V P_bar:dF_bar is the work of all stresses and
        tractions of the cell on GRAD u = dF_bar.
        """
        return forces_on_means(self._problem) / self.volume

    def hill_mandel(self) -> float:
        """Relative error of the Hill-Mandel condition in the last step; collective.

        The work of all stresses and tractions of the cell on the change of the displacement, less
        that of the mean stress on the change of F_bar, V P_bar:dF_bar, relative to V |P| |dF_bar|
        with the largest mean stress of the run. It is the work of the residual on the fluctuation,
        in motion that of the inertia.
        """
        now, step = self._problem.discretization, self._problem.step
        if step.start.discretization is not now:
            return 0.0
        change = now.u.x.array - step.start.u
        forces = now.forces.x.array[: now.owned].copy()
        forces[self._space.owned_dofs] = 0
        work = global_sum(now.mesh.comm, forces @ change[: now.owned])
        length = self._space.length
        force = max(step.scales.reaction, self.volume * float(np.linalg.norm(self.stress)) / length)
        scale = force * length * np.linalg.norm(self._space.gradient(change))
        return float(work / max(scale, np.finfo(float).tiny))

    def displacement(self) -> fem.Function:
        """Whole displacement u = (F_bar - I).X + w, X from the centre of the cell [mm].

        Every call returns the same function with new values: copy it to keep them.
        """
        return whole_displacement(self._problem)

    def row(self) -> dict[str, float]:
        """Means for a row of the history; collective.

        Components of the mean strain or deformation gradient and of the mean stress, means of T_N
        and |T_T| on every interface, and :meth:`hill_mandel`.
        """
        small = self._problem.discretization.bodies.small
        measure = self.strain if small else self.gradient
        name, stress = "strain" if small else "gradient", self.stress
        row: dict[str, float] = {}
        entries = [(i, j) for i, j in self._space.entries if not small or i <= j]
        for i, j in entries:
            row[f"{name}_{AXES[i] + AXES[j]} [-]"] = float(measure[i, j])
        for i, j in entries:
            row[f"stress_{AXES[i] + AXES[j]} [MPa]"] = float(stress[i, j])
        names = interface_names(self._problem.interfaces)
        integrals = [traction_integrals(state) for state in self._problem.state]
        for name, (normal, shear, area) in zip(
            names, global_sum(self._problem.comm, np.reshape(integrals, (-1, 3))), strict=True
        ):
            row[f"traction_{name} [MPa]"] = float(normal / area) if area > 0 else 0.0
            row[f"shear_{name} [MPa]"] = float(shear / area) if area > 0 else 0.0
        return row | {"hill_mandel [-]": self.hill_mandel()}


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

    def __repr__(self) -> str:
        return f"AxialMotion(strain={self.strain:.6g})"

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
