"""Values of loads, supports and eigenstrains as users of DOLFINx give them: right, or refused."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from support.problems import of_two
from support.scenes import two_blocks

import vmdg

STEEL = vmdg.NeoHookean(E=5000.0, nu=0.25)  # MPa
TIE = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())


@pytest.fixture
def scene(comm):
    """Blocks [0, 1] and [1, 2] x [0, 1]."""
    return two_blocks(comm, "quadrilateral", 2)


@pytest.fixture
def problem(scene):
    """Both blocks, tied."""
    return vmdg.Problem(scene.mesh, scene.cell_tags, {1: STEEL, 2: STEEL}, [TIE])


def displacement(scene, degree=1) -> fem.Function:
    """(.1 x, .2 y) in a space of DOLFINx."""
    u = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", degree, (2,))))
    u.interpolate(lambda x: np.stack([0.1 * x[0], 0.2 * x[1]]))
    return u


def prescribed(problem, t):
    """Prescribed values of both components at load factor ``t`` (n, 2), and where."""
    dofs = problem.loading.prescribed.reshape(-1, 2)[:, 0] // 2
    return (
        problem.loading.prescribed_values(t).reshape(-1, 2),
        problem.space.tabulate_dof_coordinates()[dofs],
    )


def total(problem, t):
    """Sum of the dead loads at load factor ``t`` (2,) [N]."""
    problem.loading.move(t)
    problem.u.x.array[:] = 0
    forces = -problem.step.assemble_residual().reshape(-1, 2)
    return problem.comm.allreduce(forces.sum(axis=0))


def test_bound_variable(problem, scene):
    """Arguments with a default bind the variable of a loop: v t, not t X."""
    side = scene.facet_tags.find(2)
    for v in (0.3, -0.1):
        problem.dirichlet(side, lambda t, v=v: (v * t, 0.0))
    values, _ = prescribed(problem, 2.0)
    assert values == pytest.approx(np.broadcast_to([-0.2, 0.0], values.shape))
    for v in (1.0, 3.0):
        problem.traction(scene.facet_tags.find(5), lambda t, v=v: (0.0, v * t))
        problem.body_force(lambda x, t, v=v: v * t * np.stack([x[0], 0 * x[0]]))
    assert total(problem, 2.0) == pytest.approx([2 * 4.0 * 2.0, 2 * 4.0 * 2.0])


def test_constant(problem, scene):
    """A Constant has the value that it has when a step begins."""
    u, load = fem.Constant(scene.mesh, (0.1, 0.2)), fem.Constant(scene.mesh, (1.0, 3.0))
    problem.dirichlet(scene.facet_tags.find(1), u)
    problem.traction(scene.facet_tags.find(5), load)
    assert (prescribed(problem, 1.0)[0] == u.value).all()
    assert total(problem, 1.0) == pytest.approx([2.0, 6.0])
    u.value[:], load.value[:] = (0.0, -0.5), (5.0, 0.0)
    assert (prescribed(problem, 1.0)[0] == u.value).all()
    assert total(problem, 1.0) == pytest.approx([10.0, 0.0])


@pytest.mark.parametrize("degree", [1, 2])
def test_function(problem, scene, degree):
    """A Function of any degree is a field of displacements, or of tractions."""
    field = displacement(scene, degree)
    problem.dirichlet(scene.facet_tags.find(2), field)
    problem.traction(scene.facet_tags.find(5), field)
    values, x = prescribed(problem, 1.0)
    assert values == pytest.approx(x[:, :2] * [0.1, 0.2])
    assert total(problem, 1.0) == pytest.approx([0.2, 0.4])


def eigenstrain(scene, value) -> vmdg.Problem:
    """Both blocks, one of them with an eigenstrain."""
    materials = {1: STEEL, 2: STEEL}
    return vmdg.Problem(scene.mesh, scene.cell_tags, materials, [], eigenstrain={1: value})


@pytest.mark.parametrize("kind", ["bound variable", "Constant"])
def test_eigenstrain(scene, kind):
    """f(t) with a bound variable, and a Constant: forces of a body that is kept from growing."""
    reference = eigenstrain(scene, 2e-3)
    constant = fem.Constant(scene.mesh, 2e-3)
    given = {"bound variable": lambda t, v=1e-3: v * t, "Constant": constant}
    problem = eigenstrain(scene, given[kind])
    for one in (reference, problem):
        one.step.begin(2.0, 1.0)
    forces = reference.step.assemble_residual()
    assert problem.step.assemble_residual() == pytest.approx(forces, rel=1e-12, abs=1e-12)
    assert problem.comm.allreduce(np.abs(forces).max()) > 1


def of_place(x):
    """f(x), as DOLFINx interpolates it."""
    return 0.1 * x[:2]


#: Values that could be meant otherwise: what is said of each.
UNCLEAR = {
    "f(x)": (of_place, r"the function takes \(x\); write lambda t: .* or lambda x, t:"),
    "f(x) as a number": (lambda x: 0.1, r"the function takes \(x\); write lambda t:"),
    "f(t, x)": (lambda t, x: t * x[:2], r"takes \(t, x\); write .* lambda x, t: "),
    "no argument": (lambda v=1.0: v, r"takes \(\); .* lambda t, v=v: \.\.\., are ignored"),
    "three arguments": (lambda x, y, t: x, r"takes \(x, y, t\); write"),
    "f(p) of points": (lambda p: p[0], "'float' object is not subscriptable; write lambda t"),
    "fails": (lambda x, t: 1 / 0, "division by zero; write lambda t"),
}


@pytest.mark.parametrize(
    ("value", "door"),
    zip(UNCLEAR, 2 * ["dirichlet", "traction", "body_force", "eigenstrain"], strict=False),
)
def test_unclear_function(problem, scene, door, value):
    """Refused on every rank, with the ways to write it."""
    function, message = UNCLEAR[value]
    if door == "eigenstrain":
        message = message.replace("; write lambda t", "; (write lambda t|give a number e)")
    give = {
        "dirichlet": lambda: problem.dirichlet(scene.facet_tags.find(1), function),
        "traction": lambda: problem.traction(scene.facet_tags.find(1), function),
        "body_force": lambda: problem.body_force(function),
        "eigenstrain": lambda: eigenstrain(scene, function),
    }
    with pytest.raises(ValueError, match=message):
        give[door]()


#: Texts for numbers where a problem is described, which numpy would read: what is made, and words.
TEXTS = [
    (lambda: vmdg.Ogden(c=("3.0",), m=(2.0,), kappa=1.0), r"c = \('3.0',\) and m = .* numbers"),
    (lambda: vmdg.NeoHookean(E="3.0", nu=0.3), "NeoHookean: E = '3.0' must be one number"),
    (
        lambda: vmdg.Laminate(
            [vmdg.Orthotropic(E=(1.0,) * 3, nu=(0.0,) * 3, G=(1.0,) * 3)], thickness="0.1"
        ),
        "thickness = '0.1' must be positive",
    ),
    (lambda: vmdg.Debonding("3.0", 0.1), "strength = '3.0': must be one number, an"),
    (lambda: vmdg.Debonding(3.0, 0.1, viscosity="1.0"), "viscosity = '1.0': must be one number;"),
    (
        lambda: vmdg.Interface(within=1, law=vmdg.Debonding(3.0, 0.1), activate_at="0.4"),
        "activate_at = '0.4' must lie in",
    ),
]


@pytest.mark.parametrize(("make", "message"), TEXTS)
def test_text_for_a_number(make, message):
    """A text is no number, though it may look like one."""
    with pytest.raises((TypeError, ValueError), match=message):
        make()


def bonded(scene, law=None, material=STEEL) -> vmdg.Problem:
    """Both blocks, with a bond between them."""
    return of_two(scene, law or vmdg.Debonding(3.0, 0.1), (material, STEEL))


#: Doors of a problem, and how a value gets there.
DOORS = {
    "dirichlet": lambda scene, v: bonded(scene).dirichlet(scene.facet_tags.find(2), v, "x"),
    "traction": lambda scene, v: bonded(scene).traction(scene.facet_tags.find(2), v),
    "body_force": lambda scene, v: bonded(scene).body_force(v),
    "pressure": lambda scene, v: bonded(scene).pressure(scene.facet_tags.find(2), v),
    "point_load": lambda scene, v: bonded(scene).point_load(lambda x: x[0] < 1e-9, v, "x"),
    "rigid_face": lambda scene, v: bonded(scene).rigid_face(scene.facet_tags.find(2), "x", force=v),
    "eigenstrain": lambda scene, v: eigenstrain(scene, v),
}


@pytest.mark.parametrize("door", DOORS)
def test_text_at_a_door(scene, door):
    """Named with the door, on every rank, also where a function gives it."""
    for value in ("3.0", lambda t: "3.0"):
        with pytest.raises(ValueError, match=f"{door}.*: '3.0' is text, not a number; write"):
            DOORS[door](scene, value)


def test_text_from_a_function_of_place(scene):
    """Moduli and strengths too."""

    def text(x):
        return ["3.0"] * x.shape[1]

    with pytest.raises(ValueError, match=r"(?s)material of tag 1.*'3.0' is text, not a number"):
        bonded(scene, material=vmdg.NeoHookean(E=text, nu=0.3))
    with pytest.raises(ValueError, match=r"strength of the law .*'3.0' is text, not a number"):
        bonded(scene, vmdg.Debonding(text, 0.1))


def test_fails_on_one_rank(problem, scene):
    """A function that fails at the points of one rank is refused on every rank."""

    def fails(x, t):
        return x[:2] / 0 if (x[1] > 0.9).any() else 0 * x[:2]

    with (
        np.errstate(all="raise"),
        pytest.raises(ValueError, match="is not a number, an array or a func"),
    ):
        problem.dirichlet(scene.facet_tags.find(1), fails)


#: What is no eigenstrain of a plane body, and what is said of it.
NO_STRAIN = {
    "array": (np.ones(99), r"shape \(99,\), and there are \d+ cells and \d+ ghosts"),
    "expression": (None, "a UFL expression has no cell values"),
    "Function of degree 1": (None, "a Function must be of degree 0 on the mesh of the problem"),
    "skew": (np.triu(np.ones((3, 3))), "the tensor is not symmetric"),
    "out of the plane": (np.ones((3, 3)), "no shear strains 13 and 23"),
    "not finite": (np.diag([np.nan, 0, 0]), "not finite"),
}


@pytest.mark.parametrize("kind", NO_STRAIN)
def test_no_eigenstrain(scene, kind):
    """Refused on every rank, with the ways to give one."""
    value, message = NO_STRAIN[kind]
    if kind == "expression":
        value = ufl.SpatialCoordinate(scene.mesh)[0]
    elif value is None:
        value = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1)))
    with pytest.raises(ValueError, match=f"(?s)eigenstrain of tag 1 is .*{message}.*; give a num"):
        eigenstrain(scene, value)


def test_eigenstrain_without_tags(scene):
    """One number for all bodies says how to give it."""
    with pytest.raises(
        TypeError, match=r"eigenstrain = 0\.01 must be a dict of strains by cell tag"
    ):
        vmdg.Problem(scene.mesh, scene.cell_tags, {1: STEEL, 2: STEEL}, [], eigenstrain=0.01)


def test_expression_as_displacement(problem, scene):
    """An expression of UFL, and Functions of another shape or mesh, have no values at the nodes."""
    facets, X = scene.facet_tags.find(1), ufl.SpatialCoordinate(scene.mesh)
    with pytest.raises(ValueError, match="UFL expression has no nodal values; write lambda"):
        problem.dirichlet(facets, 0.1 * X)
    scalar = fem.Function(fem.functionspace(scene.mesh, ("Lagrange", 1)))
    with pytest.raises(ValueError, match=r"the Function has shape \(\); it must be .* \(2,\)"):
        problem.dirichlet(facets, scalar, "x")
    other = two_blocks(problem.comm, "quadrilateral", 2)
    with pytest.raises(ValueError, match=r"shape \(2,\) and another mesh; it must be"):
        problem.dirichlet(facets, displacement(other))


@pytest.mark.parametrize("place", [0, 1, 2])
def test_condition_of_dolfinx(problem, scene, place):
    """fem.dirichletbc belongs to another space: the answer is how to prescribe here."""
    space, facets = displacement(scene).function_space, scene.facet_tags.find(1)
    condition = fem.dirichletbc(np.zeros(2), fem.locate_dofs_topological(space, 1, facets), space)
    given = [(condition,), (condition, 0.0), (facets, condition)][place]
    with pytest.raises(TypeError, match=r"DirichletBC .* two at a node .* problem.dirichlet\("):
        problem.dirichlet(*given)


def test_no_value(problem, scene):
    """So is a value that was forgotten."""
    with pytest.raises(TypeError, match=r"the value is missing; 0\.0 fixes the nodes"):
        problem.dirichlet(scene.facet_tags.find(1))
