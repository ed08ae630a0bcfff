"""Generalized plane strain: one F_33 of bodies and interfaces, against closed forms and 3D."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from support.budgets import over_budget
from support.problems import PRECISE, of_two
from support.scenes import LEFT, RIGHT, box, two_blocks

import vmdg

PLANE = "generalized strain"
E, NU, THICKNESS = 2000.0, 0.3, 2.5
SOFT, STIFF = vmdg.NeoHookean(E=E, nu=NU), vmdg.NeoHookean(E=5 * E, nu=0.2)
# About as stiff.
OGDEN = vmdg.Ogden(c=(6300.0, 12.0, -10.0), m=(1.3, 5.0, -2.0), kappa=3000.0)


def tagged(comm, divisions, tag_of, size=(1.0, 1.0), depth=None):
    """Quadrilaterals of a rectangle, or hexahedra, one over the depth, with tags by midpoints."""
    d = 2 if depth is None else 3
    ends = [np.zeros(d), np.array([*size, depth][:d])]
    return box(comm, ends, [*divisions, 1][:d], tag_of)


def included(comm, materials, n=4, kinematics="small", law=None, plane=PLANE, **options):
    """A square inclusion, half as wide as its periodic cell."""
    mesh, tags = tagged(
        comm, (n, n), lambda x: np.where((np.abs(x[:2] - 0.5) < 0.25).all(axis=0), 2, 1)
    )
    bond = vmdg.Interface(between=(1, 2), law=law or vmdg.Bonded(), name="bond")
    bodies = dict(enumerate(materials, start=1))
    return vmdg.Problem(mesh, tags, bodies, [bond], 1, kinematics, plane=plane, **options)


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


@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_macroscopic_tangent(comm, kinematics):
    """With F_33 at hand, while bonds break and rub: that of differences, along one direction.

    Of Ogden's energy UFL puts sums in order in more than a quarter of an hour, where there are any.
    """
    law = vmdg.Debonding(strength=5.0, critical_gap=0.004, friction=0.4)
    start, end = np.diag([0.015, 0.0, -0.002]), np.diag([-0.006, 0.001, 0.003])
    along, h = np.array([[0.3, 0.5, 0], [0.5, -0.4, 0], [0, 0, 0.7]]), 1e-6
    scale = [0.0]

    def mean(t):
        late = end + [[0, 0.004, 0], [0.004, 0, 0], [0, 0, 0]] + scale[0] * along
        return start * t if t < 1 else (2 - t) * start + (t - 1) * late

    if kinematics == "small":
        drive = vmdg.Periodic(strain=lambda t: mean(t)[:2, :2])
    else:
        drive = vmdg.Periodic(gradient=lambda t: np.eye(2) + mean(t)[:2, :2])
    plane = vmdg.GeneralizedStrain(strain=lambda t: mean(t)[2, 2])
    options = {"periodic": drive, "thickness": THICKNESS, "plane": plane}
    stiff = STIFF if kinematics == "small" else OGDEN
    cell = included(comm, (SOFT, stiff), 4, kinematics, law, **options)
    options = vmdg.SolveOptions(relative_tolerance=1e-13, control="load")
    vmdg.solve(cell, [1.0], options)
    begin, stresses = cell.step.snapshot(), []
    for step in (-h, h, 0.0):
        scale[0] = step
        cell.step.return_to(begin)
        history = vmdg.solve(cell, [2.0], options).history
        stresses.append(vmdg.PeriodicCell(cell).stress)
    assert cell.energy().damage > 0 and cell.energy().friction > 0
    assert np.abs(history["hill_mandel"]).max() < 1e-10
    found = np.einsum("ijkl,kl->ij", vmdg.macroscopic_tangent(cell), along)
    expected = (stresses[1] - stresses[0]) / (2 * h)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-3)


@pytest.mark.parametrize("activate", ["all", "on-demand"])
def test_path_and_checkpoint(comm, out, activate):
    """A brittle bond snaps back, free along z; a run goes on from its middle on other ranks."""

    def laminate(where):
        mesh, tags = tagged(where, (1, 4), lambda x: np.where(np.abs(x[1] - 0.5) < 0.25, 2, 1))
        bond = vmdg.Interface(
            lambda x: np.isclose(x[1], 0.25),
            law=vmdg.Debonding(2.0, 0.0005),
            activate=activate,
            name="bond",
        )
        drive = vmdg.Periodic(strain={"yy": lambda t: 0.01 * t})
        bodies = {1: SOFT, 2: STIFF}
        options = {"kinematics": "small", "periodic": drive, "plane": PLANE}
        return vmdg.Problem(mesh, tags, bodies, [bond], **options)

    trace = vmdg.SolveOptions(relative_tolerance=1e-11, unstable="trace")
    first = laminate(comm)
    history = vmdg.solve(first, [1.0], trace, until=lambda p: p.debonded() > 0.5).history
    vmdg.write_checkpoint(first, out / "cell", history)
    ends = []
    for where in (comm, MPI.COMM_SELF)[: comm.size]:
        other = laminate(where)
        before = vmdg.read_checkpoint(other, out / "cell")
        axial, there = vmdg.AxialMotion(other), vmdg.AxialMotion(first)
        assert axial.strain == pytest.approx(there.strain, rel=1e-13)
        after = vmdg.solve(other, [1.0], trace, until=lambda p: p.debonded() > 0.9).history
        ends.append((axial.strain, after["stress_yy"][-1]))
    assert ends[0] == pytest.approx(ends[-1], rel=1e-8)
    t, strain = (
        np.append(before[f"{name}_yy"], after[f"{name}_yy"]) for name in ("stress", "strain")
    )
    # Free to contract across and along z, the laminate has the compliance of its first row.
    gap = np.clip(2.0 - t, 0, None) / (2.0 / 0.0005)
    holds = t > 1e-3
    assert strain[holds] == pytest.approx((t * strain[0] / t[0] + gap)[holds], rel=1e-7)
    assert np.abs(np.append(before["stress_zz"], after["stress_zz"])).max() < 1e-9
    loads = np.append(before["load"], after["load"])
    assert (np.diff(loads[holds]) < 0).any() or activate == "on-demand"


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
