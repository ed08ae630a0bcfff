"""Generalized plane strain: one F_33 of bodies and interfaces, against closed forms and 3D."""

from __future__ import annotations

import numpy as np
import pytest
from support.budgets import over_budget
from support.problems import PRECISE, of_two
from support.scenes import LEFT, RIGHT, box, two_blocks

import vmdg

PLANE = "generalized strain"
E, NU, THICKNESS = 2000.0, 0.3, 2.5
SOFT = vmdg.NeoHookean(E=E, nu=NU)


def tagged(comm, divisions, tag_of, size=(1.0, 1.0), depth=None):
    """Quadrilaterals of a rectangle, or hexahedra, one over the depth, with tags by midpoints."""
    d = 2 if depth is None else 3
    ends = [np.zeros(d), np.array([*size, depth][:d])]
    return box(comm, ends, [*divisions, 1][:d], tag_of)


@pytest.mark.parametrize(
    ("cell", "degree", "plane"), [("triangle", 2, PLANE), ("quadrilateral", 1, "stress")]
)
def test_bar_with_a_bond_that_fails(comm, cell, degree, plane):
    """Equal contractions nu/E: sigma = u/c to the strength, then (zeta_c - u)/(1/H - c)."""
    P, gap = 30.0, 0.1
    bodies = {1: vmdg.NeoHookean(E=E, nu=0.2), 2: vmdg.NeoHookean(E=2 * E, nu=0.4)}
    scene = two_blocks(comm, cell, 2)
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(P, gap))
    options = {"kinematics": "small", "thickness": THICKNESS, "plane": plane}
    bar = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [bond], degree=degree, **options)
    bar.dirichlet(scene.facet_tags.find(LEFT), 0.0, "x")
    bar.dirichlet(scene.facet_tags.find(RIGHT), lambda t: t, "x")
    # At the origin, where the node of F_33 must not be taken for one of the mesh.
    bar.dirichlet_points(lambda x: np.isclose(x[:2], 0).all(axis=0), 0.0, "y")
    loads, facets = np.array([0.01, 0.04, 0.07, 0.12]), scene.facet_tags.find(RIGHT)
    options = vmdg.SolveOptions(relative_tolerance=1e-13, energy=True)
    history = vmdg.solve(
        bar, loads, options, lambda p: {"force": p.reaction(facets)[0] / THICKNESS}
    ).history
    c = 1 / E + 1 / (2 * E)
    expected = np.where(loads < P * c, loads / c, np.clip((gap - loads) / (gap / P - c), 0, None))
    force = history["force"]
    found = np.interp(loads, history["load"], force)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10 * P)
    assert bar.energy().damage == pytest.approx(THICKNESS * P * gap / 2, rel=1e-10)
    if plane == PLANE:
        np.testing.assert_allclose(history["axial_strain"], -0.2 / E * force, rtol=0, atol=1e-13)
        np.testing.assert_allclose(history["axial_force"], 0.0, rtol=0, atol=1e-9)


def test_rigid_face_and_force_along_z(comm):
    """A plate presses one end, a force pulls along z: the strains of a cube, at once."""
    scene, sigma = two_blocks(comm, "quadrilateral", 1), np.array([-3.0, 0, 5.0])
    pulled = vmdg.GeneralizedStrain(force=lambda t: sigma[2] * 2 * t)
    cube = of_two(
        scene,
        vmdg.Bonded(),
        (SOFT,) * 2,
        degree=1,
        kinematics="small",
        thickness=THICKNESS,
        plane=pulled,
    )
    cube.dirichlet(scene.facet_tags.find(LEFT), 0.0, "x")
    cube.dirichlet(lambda x: np.isclose(x[1], 0), 0.0, "y")
    plate = cube.rigid_face(scene.facet_tags.find(RIGHT), "x", force=sigma[0] * THICKNESS)
    axial = vmdg.AxialMotion(cube)
    result = vmdg.solve(cube, [1.0], PRECISE)
    strain = ((1 + NU) * sigma - NU * sigma.sum()) / E
    assert not over_budget("cube under a plate", result)
    assert plate.displacement() == pytest.approx(2 * strain[0], rel=1e-10)
    assert axial.strain == pytest.approx(strain[2], rel=1e-10)
    assert axial.force == pytest.approx(2 * sigma[2], rel=1e-10)
    found = cube.stress().x.array.reshape(-1, 3, 3)
    np.testing.assert_allclose(found, np.broadcast_to(np.diag(sigma), found.shape), atol=1e-9)


def test_cooled_laminate(comm):
    """Plies along x and along z, stacked along y: sigma = Q.(e - alpha T), no mean stress."""
    along, across = (9000.0, 800.0, 800.0), (800.0, 800.0, 9000.0)
    shrinkage = -0.01 * np.array([0.02, 1.0, 1.0])
    share = 0.25  # of the plies along z, in the middle
    plies = {
        1: vmdg.Orthotropic(E=along, nu=(0.3, 0.3, 0.4), G=(500, 500, 300)),
        2: vmdg.Orthotropic(E=across, nu=(0.4, 0.3 / 9000 * 800, 0.3 / 9000 * 800), G=(300,) * 3),
    }
    strains = {1: shrinkage, 2: shrinkage[::-1]}
    mesh, tags = tagged(comm, (1, 8), lambda x: np.where(np.abs(x[1] - 0.5) < share / 2, 2, 1))
    between = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(1e4, 10.0))
    # Fluctuations are free, and so is the mean of all components but xy.
    free = vmdg.Periodic(strain={"xy": 0.0})
    laminate = vmdg.Problem(
        mesh,
        tags,
        plies,
        [between],
        kinematics="small",
        eigenstrain={tag: lambda t, e=e: t * np.diag(e) for tag, e in strains.items()},
        plane=PLANE,
        periodic=free,
    )
    vmdg.solve(laminate, [0.5, 1.0], PRECISE)
    Q = np.linalg.inv([[1 / 9000, -0.3 / 9000], [-0.3 / 9000, 1 / 800]])
    both = {1: Q, 2: Q[::-1, ::-1]}
    shares = {1: 1 - share, 2: share}
    stiffness = sum(shares[k] * both[k] for k in both)
    shrinks = sum(shares[k] * both[k] @ strains[k][[0, 2]] for k in both)
    e = np.linalg.solve(stiffness, shrinks)
    cell = vmdg.PeriodicCell(laminate)
    np.testing.assert_allclose(np.diag(cell.strain)[[0, 2]], e, rtol=1e-10)
    np.testing.assert_allclose(cell.stress, 0.0, atol=1e-10)
    assert vmdg.AxialMotion(laminate).strain == pytest.approx(e[1], rel=1e-10)
    sigma = np.zeros((2, 3))
    for k in both:
        sigma[k - 1, [0, 2]] = both[k] @ (e - strains[k][[0, 2]])
    stress = laminate.stress()
    cells = stress.function_space.dofmap.list
    known = np.zeros(len(cells), dtype=int)
    known[tags.indices] = tags.values
    found = np.diagonal(stress.x.array.reshape(-1, 3, 3)[cells], axis1=2, axis2=3)
    expected = np.broadcast_to(sigma[known - 1][:, None], found.shape)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(sigma).max())


def test_refused(comm):
    """At the door, with what to do instead."""
    scene = two_blocks(comm, "quadrilateral", 1)
    one = {"materials": {1: SOFT, 2: SOFT}, "interfaces": []}
    with pytest.raises(ValueError, match="cannot be combined with volumetric='mean'"):
        vmdg.Problem(scene.mesh, scene.cell_tags, **one, plane=PLANE, volumetric="mean")
    with pytest.raises(ValueError, match="is for plane bodies"):
        vmdg.Problem(scene.mesh, scene.cell_tags, **one, plane=PLANE, symmetry="axisymmetric")
    with pytest.raises(ValueError, match="in generalized plane strain only"):
        vmdg.AxialMotion(vmdg.Problem(scene.mesh, scene.cell_tags, **one))
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, **one, plane=PLANE)
    with pytest.raises(ValueError, match="changes its thickness"):
        problem.pressure(scene.facet_tags.find(RIGHT), 1.0)
    for given, words in (
        ({"strain": 0.1, "force": 1.0}, "give strain= or force="),
        ({"strain": lambda t: np.zeros(2)}, "GeneralizedStrain: strain"),
    ):
        with pytest.raises(ValueError, match=words):
            vmdg.Problem(scene.mesh, scene.cell_tags, **one, plane=vmdg.GeneralizedStrain(**given))
