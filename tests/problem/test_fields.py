"""Moduli and eigenstrains that vary from cell to cell, and anisotropic eigenstrains."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from dolfinx.mesh import compute_midpoints
from support.problems import of_two
from support.scenes import section, tag_cells, two_blocks

import vmdg

SOFT, STIFF = 1000.0, 4000.0
STRAIN = np.array([[0.02, 0.01, 0.0], [0.01, -0.03, 0.0], [0.0, 0.0, 0.015]])


def stiffness(x):
    return np.where(x[0] < 1, SOFT, STIFF)


def energy(F, p):
    return vmdg.NeoHookean(E=1.0, nu=0.3).energy(F, p)


def displacement(mesh, tags, materials, **options) -> np.ndarray:
    """Of blocks held at the left and pulled at the right, at all nodes of this rank."""
    tie = vmdg.Interface(lambda x: np.isclose(x[0], 1), law=vmdg.Bonded())
    problem = vmdg.Problem(mesh, tags, materials, [tie], **options)
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], 2), lambda t: 0.1 * t, "x")
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(relative_tolerance=1e-13))
    return problem.u.x.array.copy()


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_moduli_equal_groups(comm, kinematics):
    """One group with E(x), an array or a Function, and a group for each modulus."""
    scene = two_blocks(comm, "quadrilateral", 2)
    mesh = scene.mesh
    groups = {tag: vmdg.NeoHookean(E=E, nu=0.3) for tag, E in ((1, SOFT), (2, STIFF))}
    expected = displacement(mesh, scene.cell_tags, groups, kinematics=kinematics)
    one = tag_cells(mesh, {1: lambda x: x[0] > -1})
    cells = mesh.topology.index_map(2)
    cells = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    field = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    field.interpolate(stiffness)
    array = stiffness(compute_midpoints(mesh, 2, cells).T)
    lame = (lambda x: stiffness(x) / 2.6), (lambda x: stiffness(x) * 0.3 / 1.3 / 0.4)
    for material in (
        vmdg.NeoHookean(E=stiffness, nu=0.3),
        vmdg.NeoHookean(E=array, nu=lambda x: 0.3 + 0 * x[0]),
        vmdg.NeoHookean(E=field, nu=0.3),
        vmdg.NeoHookean(mu=lame[0], lmbda=lame[1]),
        vmdg.Hyperelastic(energy, dict(zip(("mu", "lmbda"), lame, strict=True))),
    ):
        found = displacement(mesh, one, {1: material}, kinematics=kinematics)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    random = vmdg.NeoHookean(E=vmdg.Weibull(SOFT, 8.0), nu=0.3)
    assert np.isfinite(displacement(mesh, one, {1: random}, kinematics=kinematics)).all()


@pytest.mark.parametrize(
    ("cell", "kinematics", "volumetric"),
    [
        ("quadrilateral", "small", "pointwise"),
        ("quadrilateral", "finite", "pointwise"),
        ("quadrilateral", "finite", "mean"),
        ("tetrahedron", "small", "pointwise"),
    ],
)
def test_free_expansion(comm, cell, kinematics, volumetric):
    """A body free to take its strain takes it: F = I + e, no stress, whatever the strain varies."""
    scene = two_blocks(comm, cell, 1, distortion=0.1)
    d, strain = scene.mesh.geometry.dim, STRAIN if cell == "tetrahedron" else STRAIN.copy()
    strain[2, 2] *= d - 2  # what the plane keeps
    material = vmdg.NeoHookean(E=SOFT, nu=0.3)
    problem = of_two(
        scene,
        vmdg.Debonding(30.0, 0.1),
        (material,) * 2,
        kinematics=kinematics,
        eigenstrain={1: lambda t: t * strain, 2: lambda x, t: t * strain[..., None] + 0 * x[0]},
        volumetric=volumetric,
    )
    problem.dirichlet(scene.facet_tags.find(1), lambda x, t: t * strain[:d] @ x)
    vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(relative_tolerance=1e-13))
    x = problem.space.tabulate_dof_coordinates()
    expected = x @ strain[:, :d]
    np.testing.assert_allclose(problem.u.x.array.reshape(-1, d), expected, rtol=0, atol=1e-11)
    assert np.abs(problem.state[0].traction).max(initial=0.0) < 1e-8
    assert problem.energy().bulk == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize("symmetry", [None, "axisymmetric"])
def test_tensor_of_a_number(comm, symmetry):
    """e I is e; a Function, an array and f(x, t) of it are too."""
    scene = section(comm, radii=(0.5, 1.0, 2.0)) if symmetry else two_blocks(comm, "triangle", 2)
    mesh, material = scene.mesh, vmdg.NeoHookean(E=SOFT, nu=0.3)
    cells = mesh.topology.index_map(2)
    count = cells.size_local + cells.num_ghosts
    number = fem.Function(fem.functionspace(mesh, ("DG", 0)))
    number.x.array[:] = 0.01
    tensor = fem.Function(fem.functionspace(mesh, ("DG", 0, (3, 3))))
    tensor.x.array.reshape(-1, 9)[:] = 0.01 * np.eye(3).ravel()
    forces = []
    for strain in (
        0.01,
        0.01 * np.eye(3),
        number,
        tensor,
        np.full(count, 0.01),
        np.tile(0.01 * np.eye(3), (count, 1, 1)),
        lambda x, t: 0.01 + 0 * x[0],
    ):
        problem = vmdg.Problem(
            mesh,
            scene.cell_tags,
            {1: material, 2: material},
            [vmdg.Interface(between=(1, 2), law=vmdg.Bonded())],
            eigenstrain={1: strain},
            symmetry=symmetry,
        )
        problem.step.begin(1.0, 1.0)
        forces.append(problem.step.assemble_residual())
    assert comm.allreduce(np.abs(forces[0]).max(initial=0.0)) > 1
    for other in forces[1:]:
        np.testing.assert_allclose(other, forces[0], rtol=0, atol=1e-10)
