"""Gaps, overlaps and thin bodies: what is paired is decided by the bodies, on any mesh."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import compute_midpoints, create_submesh, meshtags
from support.apart import all_cells, block, moved
from support.problems import rotation

import vmdg
from vmdg.meshes import apart

#: Surfaces that are paired again in every state, and those that keep their pairs.
ANEW = {"law": vmdg.Contact(), "sliding": True}
KINDS = {
    "anew": (ANEW, "finite"),
    "kept": ({"law": vmdg.Contact(), "gap": "keep"}, "finite"),
    "small": (ANEW, "small"),
}


def columns(n, rows, heights=(0.0, 0.0), comm=MPI.COMM_SELF, thick=(1.0, 1.0)):
    """Two blocks of 1 mm by ``thick`` mm, the upper one lifted to these heights at x = 0 and
    x = 1."""

    def lifted(x):
        return np.array([x[0], x[1] + heights[0] + x[0] * (heights[1] - heights[0])])

    upper = block("quadrilateral", (n + n // 4, rows), (0.0, 0.0), (1.0, thick[1]), 2, comm)
    lower = block("quadrilateral", (n, rows), (0.0, -thick[0]), (1.0, 0.0), 1, comm)
    return apart([lower, moved(upper, lifted)])


def problem_of(scene, options, kinematics="finite", nu=0.0):
    body = vmdg.NeoHookean(E=1000.0, nu=nu)
    interface = vmdg.Interface(**{"between": (1, 2), **options})
    return vmdg.Problem(
        scene.mesh, scene.cell_tags, {1: body, 2: body}, [interface], kinematics=kinematics
    )


def pressed(scene, options, way, kinematics="finite", loads=(1.0,)):
    """Force on the upper face, moved by ``way``, of columns that cannot widen."""
    problem = problem_of(scene, options, kinematics)
    top = scene.facet_tags.find(22)
    problem.dirichlet(scene.facet_tags.find(11), 0.0)
    problem.dirichlet(top, lambda t: (0.0, way * t))
    for sides in (10, 20):
        problem.dirichlet(scene.facet_tags.find(sides), 0.0, "x")
    vmdg.solve(problem, loads)
    return problem.reaction(top)[1]


def test_overlap_at_the_start(comm):
    """Blocks that are .05 mm in each other, of cells of .5 to .05 mm, relax to the pressure
    mu (1/lambda - lambda) at which each is shorter by half of it."""
    found = [-pressed(columns(n, n // 2, (-0.05, -0.05), comm), ANEW, -1e-9) for n in (4, 40)]
    assert np.array(found) == pytest.approx(500.0 * (1 / 0.975 - 0.975), rel=1e-6)


@pytest.mark.parametrize("kind", KINDS)
def test_wedges(kind):
    """A wedge of overlap, or a gap of .12 mm that is closed by .1 mm: the force is that of coarse
    meshes, with the error of these."""
    options, kinematics = KINDS[kind]
    for heights, way in (((0.0, -0.12), -1e-6), ((0.0, 0.12), -0.1)):
        loads = np.linspace(0.0, 1.0, 4)[1:]
        given = [columns(n, n // 2, heights) for n in (8, 32)]
        coarse, fine = (pressed(scene, options, way, kinematics, loads) for scene in given)
        assert fine < -20.0
        assert coarse == pytest.approx(fine, rel=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_open_points_carry_nothing(kind):
    """Before the first step of a scene whose axes are turned, not even rounding."""
    scene, (options, kinematics) = columns(4, 2, (0.02, 0.02)), KINDS[kind]
    turn = rotation(2, 0.7)
    scene.mesh.geometry.x[:, :2] = scene.mesh.geometry.x[:, :2] @ turn.T
    history = problem_of(scene, options, kinematics).discretization.active[0].history
    assert np.abs(history.gap).max() > 0 and not history.traction.any()


@pytest.mark.parametrize("kind", KINDS)
def test_near_is_far(kind):
    """Over a gap of any width, closed and pressed by .02 mm, the force is the same."""
    options, kinematics = KINDS[kind]
    found = [
        pressed(columns(12, 3, (gap, gap)), options, -gap - 0.02, kinematics)
        for gap in (0.0, 0.01, 3.0)
    ]
    expected = -10.0 if kinematics == "small" else 500.0 * (0.99 - 1 / 0.99)
    assert np.array(found) == pytest.approx(expected, rel=1e-5)


def test_ties_span_what_faces_them():
    """A tie over a wedge of up to .12 mm holds all of it, on any mesh, and says so."""
    found = []
    for n in (4, 20):
        with pytest.warns(vmdg.ModelWarning, match=r"spans gaps, of up to 0.1.* mm"):
            scene = columns(n, n // 2, (0.0, 0.12))
            found.append(pressed(scene, {"law": vmdg.Bonded()}, 0.01))
    assert found[0] == pytest.approx(found[1], rel=1e-3)
    assert np.array(found) == pytest.approx(500.0 * (1.005 - 1 / 1.005), rel=3e-3)


def test_ties_leave_out_what_is_far():
    """A bracket on a plate, glued by its foot, not by its arm .8 mm above: a warning has the share
    of what is left out, on any mesh."""
    for n in (4, 16):
        plate = block("quadrilateral", (2 * n, 2), (0.0, -0.2), (2.0, 0.0), 1)
        bracket = block("quadrilateral", (4 * n, 3 * n), (0.0, 0.0), (2.0, 1.2), 2)
        mesh = bracket[0]
        x = compute_midpoints(mesh, 2, np.arange(12 * n * n, dtype=np.int32))
        left = np.flatnonzero((x[:, 0] < 0.5) | (x[:, 1] > 0.8)).astype(np.int32)
        mesh = create_submesh(mesh, 2, left)[0]
        none = np.zeros(0, dtype=np.int32)
        scene = apart([plate, (mesh, all_cells(mesh, 2), meshtags(mesh, 1, none, none))])
        with pytest.warns(vmdg.ModelWarning, match=r": 75 % .* left out: it is farther away than"):
            problem = problem_of(scene, {"law": vmdg.Bonded()})
        assert problem.state[0].weights.sum() == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize("sliding", [False, True])
def test_bond_over_a_gap(sliding):
    """A bond spans .05 mm, with a warning, as far as bodies are thick; beyond it is refused."""
    options = {"law": vmdg.Debonding(10.0, 0.1), "sliding": sliding}
    with pytest.warns(vmdg.ModelWarning, match=r"100 % of it spans gaps, of up to 0.05 mm"):
        force = pressed(columns(8, 4, (0.05, 0.05)), options, 0.005)
    assert force == pytest.approx(2.5, rel=0.01)
    with pytest.raises(ValueError, match=r"has no facet: .* no farther apart than"):
        problem_of(columns(8, 4, (1.5, 1.5)), options)


@pytest.mark.parametrize("width", [1.0, 1.7])
def test_one_cell_across(width):
    """Columns of one hexahedron across, pressed by 5 % of one: the stress is that of one body."""
    corners = ((0.0, 0.0, -1.0), (width, width, 0.0)), ((0.0, 0.0, 0.0), (width, width, 1.0))
    scene = apart([block("hexahedron", (1, 1, 2), *corners[k], k + 1) for k in range(2)])
    problem = problem_of(scene, {"law": vmdg.Contact(0.3), "sliding": True}, nu=0.3)
    top = scene.facet_tags.find(22)
    problem.dirichlet(scene.facet_tags.find(11), 0.0, "z")
    problem.dirichlet(top, lambda t: -0.05 * t, "z")
    for axis in range(2):
        problem.dirichlet(lambda x, axis=axis: np.isclose(x[axis], 0.0), 0.0, axis)
    assert not vmdg.solve(problem, [0.5, 1.0]).failures
    assert -problem.reaction(top)[2] / width**2 == pytest.approx(25.4595, rel=1e-5)


def test_two_interfaces(comm):
    """Two surfaces that lie opposite each other belong to one interface, also where they slide."""
    scene = columns(4, 2, comm=comm)
    surfaces = {"surfaces": (scene.facet_tags.find(21), scene.facet_tags.find(12))}
    body, bond = vmdg.NeoHookean(E=1000.0, nu=0.3), {"law": vmdg.Debonding(30.0, 0.02)}
    for one in (ANEW, bond):
        for two in (ANEW, bond):
            both = [vmdg.Interface(between=(1, 2), **one), vmdg.Interface(**surfaces, **two)]
            with pytest.raises(ValueError, match=r"interface 0 .* and interface 1 .* both join"):
                vmdg.Problem(scene.mesh, scene.cell_tags, {1: body, 2: body}, both)


@pytest.mark.parametrize("kind", KINDS)
def test_refused_overlaps(comm, kind):
    """A film that has sunk into a block as a whole is refused with its depth; so are surfaces that
    are not those that touch."""
    options, kinematics = KINDS[kind]
    film = block("quadrilateral", (4, 1), (0.25, -0.3), (0.75, -0.25), 2, comm)
    scene = apart([block("quadrilateral", (8, 4), (0.0, -1.0), (1.0, 0.0), 1, comm), film])
    with pytest.raises(ValueError, match=r"is 0.3 mm inside the other body, where no facet"):
        problem_of(scene, options, kinematics)
    scene = columns(8, 4, comm=comm)
    find = scene.facet_tags.find
    given = {**options, "between": None, "surfaces": (find(11), find(22))}
    with pytest.raises(ValueError, match=r"is 2 mm inside the other body, more than the thicker"):
        problem_of(scene, given, kinematics)


def test_through_in_one_step(comm):
    """A film that a step carries into or through another one is noticed; not one that goes past it,
    or that moves with it."""
    scene = columns(6, 1, (0.1, 0.1), comm, (0.02, 0.02))
    problem = problem_of(scene, ANEW)
    x = problem.space.tabulate_dof_coordinates()
    upper = x[:, 1] > 0.05
    for way, both, expected in (
        ((0.0, -0.2), False, "BODIES_OVERLAP"),
        ((0.3, -0.2), False, "BODIES_OVERLAP"),
        ((1.4, -0.2), False, ""),
        ((0.0, -0.05), False, ""),
        ((0.7, -0.2), True, ""),
    ):
        problem.step.begin(1.0, 1.0)
        u = problem.u.x.array.reshape(-1, 2)
        u[:] = 0.0
        u[upper | both] = way
        problem.step.assemble_residual()
        assert problem.step.invalid() == expected, way
        problem.step.cancel()
