"""Critical steps with interfaces relative to those of plain elements, from all eigenvalues."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigvalsh

import vmdg
from vmdg.meshes import blocks

Array = NDArray[np.float64]

#: Cells along the sides of each of the two blocks, by type.
DIVISIONS = {
    "triangle": (3, 3),
    "quadrilateral": (3, 3),
    "tetrahedron": (2, 2, 2),
    "hexahedron": (2, 2, 2),
}
HEAD = ("cells", "degree", "masses", "E_2/E_1", "tied", "debonding", "broken, closed", "open")


def critical(problem: vmdg.Problem, damage: bool) -> float:
    """2/omega, omega^2 the largest eigenvalue of M^-1.K: of lumped masses, or where one of them is
    not positive of consistent ones.

    Args:
        damage: With the tangent of points that are damaged, or with that of the bond.
    """
    problem.step.assemble_residual(hold=not damage)
    matrix = problem.discretization.create_matrix()
    problem.discretization.assemble_tangent(matrix, damage=damage)
    K, M = full(matrix), full(problem.step.motion.mass)
    matrix.destroy()
    sums = M.sum(axis=1)
    if sums.min() > 1e-12 * sums.max():
        M = np.diag(sums)
    return 2 / np.sqrt(eigvalsh((K + K.T) / 2, M, subset_by_index=[len(K) - 1] * 2)[0])


def full(matrix: PETSc.Mat) -> Array:
    """A PETSc matrix as an array."""
    rows, columns, values = matrix.getValuesCSR()
    dense = np.zeros(matrix.getSize())
    dense[np.repeat(np.arange(len(rows) - 1), np.diff(rows)), columns] = values
    return dense


def steps(cell: str, degree: int, contrast: float) -> tuple:
    """Row of the table: shares of the critical step of plain elements on the same mesh."""
    scene = blocks(MPI.COMM_SELF, cell, DIVISIONS[cell])
    bodies = {1: vmdg.NeoHookean(E=1.0, nu=0.3), 2: vmdg.NeoHookean(E=contrast, nu=0.3)}
    bond = vmdg.Debonding(strength=1e-3, critical_gap=1e-3)

    def made(law: vmdg.Law | None, start: float = 0.0, move: float = 0.0) -> float:
        damage = (lambda x: start + 0 * x[0]) if start else None
        interfaces = [vmdg.Interface(between=(1, 2), law=law, initial_damage=damage)] if law else []
        problem = vmdg.Problem(
            scene.mesh,
            scene.cell_tags,
            bodies,
            interfaces,
            degree,
            kinematics="small",
            density={1: 1.0, 2: 1.0},
        )
        if move:
            d = scene.mesh.geometry.dim
            moved = np.unique(problem.space.dofmap.list[scene.cell_tags.find(2)])
            problem.u.x.array.reshape(-1, d)[moved, 0] += move
        return critical(problem, damage=bool(start))

    plain = made(None)
    shares = [made(vmdg.Bonded()), made(bond), made(bond, 1.0, -1e-4), made(bond, 1.0, 1e-2)]
    lumped = degree == 1 or cell in ("quadrilateral", "hexahedron")
    masses = "lumped" if lumped else "consistent"
    return (cell, degree, masses, f"{contrast:g}", *(f"{share / plain:.2f}" for share in shares))
