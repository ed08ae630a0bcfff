"""Pressures that turn with their surface or fill a crack, springs: tangents and closed forms."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from scipy.integrate import quad
from scipy.optimize import brentq
from support import bar
from support.checks import tangent_error, tangent_matrix
from support.problems import MATERIALS, displace, joined, through
from support.scenes import DIMENSION, OUTER, box, section, two_blocks

import vmdg

E, NU = 5000.0, 0.25
MU, LMBDA = E / (2 * (1 + NU)), NU * E / ((1 + NU) * (1 - 2 * NU))
STIFF = E / (1 - NU**2)
MATERIAL = vmdg.NeoHookean(E=E, nu=NU)
EXACT = vmdg.SolveOptions(relative_tolerance=1e-12, energy=True)
LAW = vmdg.Debonding(strength=150.0, critical_gap=0.15, friction=0.3)


def uneven(x, t):
    """A pressure that differs from place to place [MPa]."""
    return 300 * t * (1 + x[0] + 0.5 * x[1])


# Tangents


@pytest.mark.parametrize(
    ("cell", "frame"),
    [
        ("triangle", "corotating"),
        ("quadrilateral", "reference"),
        ("tetrahedron", "reference"),
        ("hexahedron", "corotating"),
    ],
)
def test_tangent(comm, cell, frame):
    """Pressure on the boundary and in a bond that fails, springs: equal to differences to 1e-9."""
    flat = DIMENSION[cell] == 2
    scene = two_blocks(comm, cell, 2 if flat else 1, distortion=0.05)
    interface = {"safety": 4.0, "frame": frame, "name": "bond"}
    problem = joined(scene, LAW, interface=interface, degree=2 if cell == "quadrilateral" else 1)
    displace(problem, scene, 1.02)
    without = tangent_matrix(problem)
    problem.u.x.array[:] = 0
    problem.pressure(scene.facet_tags.find(2), uneven)
    problem.pressure("bond", uneven)
    problem.spring(scene.facet_tags.find(1), (30.0, 7.0))
    through(problem, *(lambda s=s: displace(problem, scene, s) for s in (1.0, 1.02)))
    matrix = tangent_matrix(problem)
    assert tangent_error(problem, matrix) < 1e-9
    without.axpy(-1.0, matrix)
    assert without.norm() > 1e-3 * matrix.norm()


@pytest.mark.parametrize(
    ("symmetry", "volumetric"), [(None, "mean"), ("axisymmetric", "pointwise")]
)
def test_tangent_of_bodies_of_revolution_and_mean_dilatation(comm, symmetry, volumetric):
    """The hoop stretch is part of the area; J of a cell is not that of its surface."""
    scene = section(comm, "quadrilateral", (2, 2), (0.5, 1.0, 2.0), distortion=0.02)
    interface = {"safety": 4.0, "frame": "corotating", "name": "bond"}
    options = {"symmetry": symmetry, "volumetric": volumetric}
    problem = joined(scene, LAW, MATERIALS, interface, **options)
    problem.pressure(scene.facet_tags.find(OUTER), uneven)
    problem.pressure("bond", uneven)
    through(problem, *(lambda s=s: displace(problem, scene, s) for s in (1.0, 1.02)))
    assert tangent_error(problem) < 1e-9


def test_what_the_solver_is_told(comm):
    """A pressure that turns makes the tangent unsymmetric; at small strain it does not turn."""
    for kinematics, symmetric in (("finite", False), ("small", True)):
        scene = two_blocks(comm, "quadrilateral", 1)
        law = vmdg.Debonding(strength=10.0, critical_gap=0.1)
        problem = joined(scene, law, kinematics=kinematics)
        assert problem.discretization.symmetric
        problem.pressure(scene.facet_tags.find(2), 1.0)
        assert problem.discretization.symmetric == symmetric


# Boundaries


def block(comm, cell, **options):
    """Two blocks tied into [0, 2] x [0, 1] (x [0, 1]), held at its planes of symmetry."""
    scene = two_blocks(comm, cell, 2)
    problem = joined(scene, vmdg.Bonded(), (MATERIAL,) * 2, **options)
    planes = {"x": 1, "y": 4, "z": 6}
    for axis, _ in zip(planes, range(DIMENSION[cell]), strict=False):
        problem.dirichlet(scene.facet_tags.find(planes[axis]), 0.0, axis)
    return problem, scene


def test_pressure_from_all_sides(comm):
    """A cube under p: P = -p lambda^2; the work of p is p dV and balances what is stored."""
    problem, scene = block(comm, "hexahedron")
    for tag in (2, 5, 7):
        problem.pressure(scene.facet_tags.find(tag), lambda x, t: np.full(x.shape[1], 800.0 * t))
    result = vmdg.solve(problem, np.linspace(0.05, 1, 20), EXACT)

    def pressure(stretch):
        return -(MU * (stretch - 1 / stretch) + LMBDA * (stretch**3 - 1) * stretch**2) / stretch**2

    stretch = brentq(lambda s: pressure(s) - 800.0, 0.8, 1.0, xtol=1e-15)
    x = problem.space.tabulate_dof_coordinates()
    assert np.abs(problem.u.x.array.reshape(-1, 3) - (stretch - 1) * x).max() < 1e-9
    work = 2 * quad(lambda s: pressure(s) * 3 * s**2, stretch, 1.0)[0]
    energy = problem.energy()
    assert energy.stored == pytest.approx(work, rel=1e-9)
    assert energy.external == pytest.approx(work, rel=3e-4)
    assert result.history["imbalance"][-1] == pytest.approx(energy.imbalance, abs=1e-9)


def test_small_strain_is_the_dead_traction(comm):
    """-p N, whatever turns; on the path of a bar that breaks too."""
    found = []
    for follows in (True, False):
        scene = two_blocks(comm, "triangle", 3, distortion=0.02)
        law = vmdg.Debonding(strength=100.0, critical_gap=0.1)
        problem = joined(scene, law, (MATERIAL,) * 2, kinematics="small")
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        problem.dirichlet(scene.facet_tags.find(2), lambda t: [0.2 * t, 0.0])
        top = scene.facet_tags.find(5)
        if follows:
            problem.pressure(top, lambda x, t: 20 * t * x[0])
        else:
            x, N = ufl.SpatialCoordinate(problem.mesh), ufl.FacetNormal(problem.mesh)
            problem.traction(top, -20 * problem.load_factor * x[0] * N)
        result = vmdg.solve(problem, np.linspace(0.1, 1, 10), EXACT)
        found.append((problem.u.x.array.copy(), result.history["external"][-1]))
    assert problem.debonded() > 0
    assert np.abs(found[0][0] - found[1][0]).max() < 1e-8
    assert found[0][1] == pytest.approx(found[1][1], rel=1e-6)


# Fluids between lips


@pytest.mark.parametrize(("kinematics", "critical_gap"), [("small", 0.02), ("finite", 0.05)])
def test_fluid_parts_a_bar(comm, kinematics, critical_gap):
    """A bar with held ends, p in its bond: p = T_c(g) - P(1 - g/2); traced over a limit point."""
    law = vmdg.Debonding(strength=bar.STRENGTH, critical_gap=critical_gap)
    scene = two_blocks(comm, "quadrilateral", 2)
    interface = {"frame": "corotating"}
    problem = joined(scene, law, (MATERIAL,) * 2, interface, kinematics=kinematics)
    for tag, axis in ((1, "x"), (2, "x"), (5, "y")):
        problem.dirichlet(scene.facet_tags.find(tag), 0.0, axis)
    problem.pressure(problem.interfaces[0], lambda t: 150.0 * t)
    options = vmdg.SolveOptions(unstable="trace", energy=True, relative_tolerance=1e-9)
    result = vmdg.solve(problem, np.linspace(0.1, 2, 20), options, monitor=bar.means)
    history = result.history
    load, T, gap = history["load"], history["traction"], history["gap"]
    loaded = gap > 0
    assert T[loaded] == pytest.approx(
        bar.STRENGTH * np.maximum(1 - gap[loaded] / critical_gap, 0), abs=1e-6
    )
    wide = 1.0 if kinematics == "small" else None
    for t, traction, g in zip(load, T, gap, strict=True):
        stretch = 1 - g / 2
        P = bar.stress(stretch, kinematics)
        area = wide or lateral(stretch)
        assert traction - 150.0 * t * area == pytest.approx(P, abs=1e-5)
    assert (np.diff(load) < 0).any() == (critical_gap == 0.02)
    assert gap[-1] > critical_gap


@pytest.mark.long
def test_pressure_as_a_function_of_the_opening(comm):
    """The same bar with p exp(-g/.02), g of the step before; the share has to fit the points."""
    law = vmdg.Debonding(strength=bar.STRENGTH, critical_gap=0.05)
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = joined(scene, law, (MATERIAL,) * 2, {"name": "bond"}, kinematics="small")
    for tag, axis in ((1, "x"), (2, "x"), (5, "y")):
        problem.dirichlet(scene.facet_tags.find(tag), 0.0, axis)
    with pytest.raises(ValueError, match="share must return one finite number"):
        problem.pressure("bond", 1.0, share=lambda opening: np.full(len(opening) + 1, 0.5))
    problem.pressure("bond", lambda t: 150 * t, share=lambda opening: np.exp(-opening / 0.02))
    history = vmdg.solve(problem, np.linspace(0.1, 3, 30), EXACT, monitor=bar.means).history
    gap, T = history["gap"], history["traction"]
    before = np.append(0.0, gap[:-1])
    p = 150 * history["load"] * np.exp(-before / 0.02)
    assert T - p == pytest.approx(-STIFF * gap / 2, abs=1e-7)
    assert gap[-1] > 0.02


def lateral(stretch):
    """Stretch across a bar in plane strain that is free across."""

    def traction(b):
        return MU * (b - 1 / b) + LMBDA * (stretch * b - 1) * stretch

    return brentq(traction, 0.5, 1.5, xtol=1e-15)


def cracked(comm, cells, law=None, **options):
    """Half of a body of 40 x 40 mm with a crack |x| < 1 in its middle, cells of 2/cells mm there.

    With a law there is a bond ahead of the crack, to |x| < 1.5.
    """
    x = [2 * i / cells for i in range(cells + 1)]
    size = 2 / cells
    while x[-1] < 20:
        size *= 1.25
        x.append(x[-1] + size)
    x = np.array(x)
    far = x > 2
    x[far] = 2 + (x[far] - 2) * 18 / (x[-1] - 2)
    y = np.concatenate([-x[:0:-1], x])
    shape = len(x) - 1, len(y) - 1
    mesh, tags = box(comm, [[0, 0], shape], shape)
    nodes = mesh.geometry.x
    columns = [values[np.rint(nodes[:, i]).astype(int)] for i, values in enumerate((x, y))]
    nodes[:, :2] = np.column_stack(columns)

    def between(start, end):
        return lambda x: (np.abs(x[1]) < 1e-9) & (x[0] > start - 1e-9) & (x[0] < end + 1e-9)

    interfaces = [vmdg.Interface(facets=between(0, 1), law=vmdg.Contact(), name="crack")]
    if law is not None:
        interfaces.append(vmdg.Interface(facets=between(1, 1.5), law=law, name="bond"))
    problem = vmdg.Problem(mesh, tags, {1: MATERIAL}, interfaces, **options)
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0, "x")
    problem.dirichlet_points(lambda x: np.isclose(x[0], 20) & np.isclose(x[1], 0), 0.0, "y")
    return problem


@pytest.mark.parametrize(("kinematics", "balance"), [("small", 1e-11), ("finite", 1e-3)])
def test_pressurised_crack(comm, kinematics, balance):
    """Sneddon: w = 4 (1 - nu^2) p/E sqrt(a^2 - x^2) between the lips, within .5%; no contact."""
    problem = cracked(comm, 40, kinematics=kinematics, degree=2)
    problem.pressure("crack", lambda t: 10.0 * t)
    vmdg.solve(problem, [1.0], EXACT)
    state, energy = problem.state["crack"], problem.energy()
    opening = 4 / STIFF * 10.0 * np.sqrt(1 - state.points[:, 0] ** 2)
    inner = state.points[:, 0] < 0.9
    assert np.abs(state.opening[inner, 1] / opening[inner] - 1).max(initial=0.0) < 5e-3
    volume, exact = comm.allreduce(state.weights @ np.array([state.opening[:, 1], opening]).T)
    assert volume == pytest.approx(exact, rel=5e-3)
    assert not state.traction.any()
    assert abs(energy.imbalance) < balance * energy.external
    assert energy.external == pytest.approx(10.0 * exact / 2, rel=1e-2)


# Springs


def test_kinds_of_springs(comm):
    """A number, normal and tangential, and a matrix, loaded as for a rigid displacement."""
    move = np.array([0.02, -0.03])
    for stiffness, K in (
        (50.0, 50 * np.eye(2)),
        ((50.0, 20.0), np.diag([50.0, 20.0])),
        ([[50.0, 10.0], [10.0, 30.0]], np.array([[50.0, 10.0], [10.0, 30.0]])),
    ):
        scene = two_blocks(comm, "triangle", 2)
        problem = joined(scene, vmdg.Bonded(), kinematics="small")
        right = scene.facet_tags.find(2)
        problem.spring(right, stiffness)
        problem.traction(right, K @ move)
        vmdg.solve(problem, [1.0], EXACT)
        assert problem.u.x.array.reshape(-1, 2) == pytest.approx(
            np.tile(move, (len(problem.u.x.array) // 2, 1)), rel=1e-9
        )
        assert problem.reaction(right) == pytest.approx(-K @ move, rel=1e-9)
        assert problem.energy().springs == pytest.approx(move @ K @ move / 2, rel=1e-9)


def test_reaction_at_points(comm):
    """A beam on two points: half of the load each; points that nothing holds bear none."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = joined(scene, vmdg.Bonded(), (MATERIAL,) * 2, kinematics="small")
    corners = [lambda x, a=a: np.isclose(x[0], a) & np.isclose(x[1], 0) for a in (0.0, 2.0)]
    problem.dirichlet_points(corners[0], 0.0)
    problem.dirichlet_points(corners[1], 0.0, "y")
    problem.body_force([0.0, -3.0])
    vmdg.solve(problem, [1.0], EXACT)
    for corner in corners:
        assert problem.reaction_points(corner) == pytest.approx([0.0, 3.0], abs=1e-9)
    free = problem.reaction_points(lambda x: np.isclose(x[1], 1))
    assert free == pytest.approx([0.0, 0.0], abs=1e-9)
    with pytest.raises(ValueError, match="reaction_points: no node is selected"):
        problem.reaction_points(lambda x: x[0] > 9)


# Doors


def test_errors_at_the_door(comm):
    """Ties, facets inside, UFL, wrong shapes and springs that push are refused."""
    scene = two_blocks(comm, "triangle", 1)
    law = vmdg.Debonding(strength=10.0, critical_gap=0.1)
    problem = joined(scene, law, interface={"name": "bond"})
    end, inside = scene.facet_tags.find(2), scene.facet_tags.find(3)
    with pytest.raises(ValueError, match=r"pressure: .*inside the mesh.*interface itself"):
        problem.pressure(inside, 1.0)
    for value in (problem.load_factor, 2.0 * problem.load_factor):
        with pytest.raises(ValueError, match="pressure: a UFL expression"):
            problem.pressure(end, value)
    with pytest.raises(ValueError, match=r"pressure: the value has shape \(2,\)"):
        problem.pressure(end, [1.0, 0.0])
    with pytest.raises(ValueError, match="apply to interfaces, not to a boundary"):
        problem.pressure(end, 1.0, debonded=True)
    with pytest.raises(ValueError, match="no interface 'joint'"):
        problem.pressure("joint", 1.0)
    problem.pressure("bond", 1.0)
    with pytest.raises(ValueError, match="has a pressure already"):
        problem.pressure("bond", 1.0)
    for stiffness in (-1.0, 0.0, np.nan, [[1.0, 0.0], [0.0, -1.0]]):
        with pytest.raises(ValueError, match=r"spring: .*finite and positive"):
            problem.spring(end, stiffness)
    with pytest.raises(ValueError, match=r"a pair .normal, tangential., or a symmetric matrix"):
        problem.spring(end, [1.0, 2.0, 3.0])
    tied = joined(scene, vmdg.Bonded(), interface={"name": "bond"})
    with pytest.raises(ValueError, match="is a tie"):
        tied.pressure("bond", 1.0)
