"""The tangent of the means of a periodic cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..output.cell import PeriodicCell
from ..problem.problem import Problem
from .ksp import Petsc
from .system import AssembledSystem


def macroscopic_tangent(problem: Problem, petsc: Petsc | None = None) -> NDArray[np.float64]:
    """dP_ij/dF_kl of the mean stress by the mean deformation gradient; collective [MPa].

    At small strain d sigma_ij/dE_kl. It is the tangent of the last step, consistent with its return
    maps as Newton's is, with all of F_bar at hand, whatever leads the cell: the fluctuation is
    eliminated by one factorization and d^2 solves.

    Args:
        problem: A periodic cell at the end of a step, in a monitor for example.
        petsc: Options for KSP and PC, without prefix; None for those that fit.

    Returns:
        (d, d, d, d).

    Raises:
        ValueError: the problem is no periodic cell.
    """
    cell, parts = PeriodicCell(problem), problem.discretization
    parts.update_means()
    periodic, d = parts.periodic, problem.mesh.geometry.dim
    system = AssembledSystem(problem, petsc)
    dofs = problem.comm.bcast(periodic.dofs.ravel())
    stiffness = system.condensed(periodic.unit_vectors(dofs))
    system.free()
    return (stiffness * periodic.lattice.length**2 / cell.volume).reshape(4 * (d,))
