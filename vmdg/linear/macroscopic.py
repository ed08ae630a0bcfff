"""The tangent of the means of a periodic cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..output.cell import PeriodicCell
from ..problem.problem import Problem
from .ksp import Choice
from .system import System


def macroscopic_tangent(problem: Problem, options: Choice | None = None) -> NDArray[np.float64]:
    """dP_ij/dF_kl of the mean stress by the mean deformation gradient; collective [MPa].

    At small strain d sigma_ij/dE_kl. The tangent of the last step, consistent with its return maps,
    for all components of F_bar, whichever are prescribed: the fluctuation is eliminated by one
    factorization and one solve per component.

    Args:
        problem: A periodic cell at the end of a step, for example in a monitor.
        options: As :class:`vmdg.SolveOptions`, for their ``petsc``; None for the default.

    Returns:
        (n, n, n, n), n = 3 in generalized plane strain, else d.

    Raises:
        ValueError: the problem is not a periodic cell.
    """
    cell, discretization = PeriodicCell(problem), problem.discretization
    discretization.update_means()
    means = discretization.means
    system = System(problem, options.petsc if options else None)
    stiffness = system.condensed(means.unit_vectors(problem.comm.bcast(means.dofs)))
    system.free()
    result = np.zeros(4 * cell.gradient.shape[:1])
    i, j = np.transpose(means.entries)
    result[i[:, None], j[:, None], i, j] = stiffness * means.length**2 / cell.volume
    return result
