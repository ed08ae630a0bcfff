"""Tangents of cells by products of small matrices are those of the symbolic form."""

from __future__ import annotations

from petsc4py import PETSc

import ufl
from dolfinx.fem import petsc as fem_petsc
from support.problems import displace, joined
from support.scenes import pairs, two_blocks

import vmdg
from vmdg.assembly.cell_tangents import CellTangents


@pairs(cell=("tetrahedron", "hexahedron"), degree=(1, 2), options=({}, {"kinematics": "small"}))
def test_equal_to_form(comm, cell, degree, options):
    """Distorted cells of two materials, whose matrices have 4 to 27 nodes and 1 to 27 points."""
    check(two_blocks(comm, cell, distortion=0.05), degree=degree, **options)


def test_mean_dilatation(comm):
    """The moduli have the entry of theta besides."""
    check(two_blocks(comm, "hexahedron", distortion=0.05), volumetric="mean")


def check(scene, **options):
    problem = joined(scene, vmdg.Bonded(), **options)
    displace(problem, scene, 1.0)
    problem.step.assemble_residual()
    discretization = problem.discretization
    weak, space = discretization.weak_form, problem.space
    expected, found = discretization.create_matrix(), discretization.create_matrix()
    form = weak.bulk_tangent(ufl.TestFunction(space), ufl.TrialFunction(space))
    fem_petsc.assemble_matrix(expected, weak.compile(form))
    CellTangents(problem.u, discretization.bodies).add_to(found)
    for matrix in (expected, found):
        matrix.assemble()
    size = expected.norm()
    found.axpy(-1.0, expected, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    assert size > 1
    assert found.norm() < 1e-14 * size
