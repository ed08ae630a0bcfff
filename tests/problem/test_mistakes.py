"""Typical mistakes of a beginner, each answered by an error or a warning that names the cure."""

from __future__ import annotations

from contextlib import nullcontext

from mpi4py import MPI
from petsc4py import PETSc

import basix.ufl
import numpy as np
import pytest
import ufl
from dolfinx.mesh import CellType, create_mesh, create_rectangle, create_unit_square, meshtags

import vmdg
from vmdg import plot
from vmdg.checks.model import check_model
from vmdg.meshes import TaggedMesh, blocks, distribute, model, read_mesh, write_mesh

STEEL = vmdg.NeoHookean(E=5000.0, nu=0.25)  # MPa
BOND = vmdg.Debonding(strength=100.0, critical_gap=0.2)  # MPa, mm
TIE = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())


def scene(comm: MPI.Comm, size: float = 2.0, cell: str = "quadrilateral") -> TaggedMesh:
    """Two blocks side by side, together 2 mm wide."""
    half = size / 2
    return blocks(comm, cell, (2, 2, 2), length=size, height=half, interface=(half, half))


def bonded(
    tagged: TaggedMesh, law: vmdg.Law = BOND, material: vmdg.Material = STEEL, **options
) -> vmdg.Problem:
    """Both blocks of one material, joined by a law; ``options`` are those of the interface."""
    return vmdg.Problem(
        tagged.mesh,
        tagged.cell_tags,
        {"left": material, "right": material},
        [vmdg.Interface(between=("left", "right"), law=law, **options)],
    )


def held(tagged: TaggedMesh, problem: vmdg.Problem, *names: str) -> vmdg.Problem:
    """The same problem with these sides held, and moved a little with the load factor."""
    along = np.eye(tagged.mesh.geometry.dim)[0]
    for name in names:
        problem.dirichlet(tagged.facet_tags.find(name), lambda t: 1e-3 * t * along)
    return problem


def warned(comm: MPI.Comm, match: str):
    """The first rank warns, the others are quiet."""
    return pytest.warns(vmdg.ModelWarning, match=match) if comm.rank == 0 else nullcontext()


def look(problem: vmdg.Problem) -> None:
    check_model(problem, np.array([0.5, 1.0]))


# Units

WRONG_UNITS = [
    (
        2.0,
        vmdg.NeoHookean(E=70e9, nu=0.25),
        BOND,
        "strength 100 is less than 1e-08 of the adjacent elastic moduli.* in the same unit",
    ),
    (0.002, STEEL, BOND, r"critical gap is about 0.2, the mesh 0.002 wide: .* in the same unit"),
    (
        2.0,
        STEEL,
        vmdg.Debonding(strength=0.2, critical_gap=100.0),
        "critical gap is about 100, the mesh 2 wide: .* the strength before the critical gap",
    ),
    (
        2.0,
        STEEL,
        vmdg.Debonding(strength=100.0, critical_gap=0.2, friction=30.0),
        "friction = 30 is Coulomb's coefficient mu, .* neither in degrees nor in percent",
    ),
]


@pytest.mark.parametrize(("size", "material", "law", "message"), WRONG_UNITS)
def test_units(comm, size, material, law, message):
    """Numbers out of all proportion are warned of."""
    tagged = scene(comm, size)
    problem = held(tagged, bonded(tagged, law, material), "left", "right")
    with warned(comm, message):
        look(problem)


def test_units_of_densities(comm):
    """A density in kg/m3 with N, mm and s is found by a motion that no wave can follow."""
    tagged = scene(comm)

    def made(**density: float) -> vmdg.Problem:
        body = {"left": STEEL, "right": STEEL}
        return vmdg.Problem(tagged.mesh, tagged.cell_tags, body, [TIE], density=density)

    with warned(comm, "in 2e-06 s no wave crosses a cell, .* densities are in t/mm3"):
        vmdg.solve_dynamics(made(left=7850.0, right=7850.0), [1e-6, 2e-6])
    with warned(
        comm, "the densities 7.85e-09 of tag 2 and 7850 of tag 1 are probably in different"
    ):
        made(left=7850.0, right=7.85e-9)
    vmdg.solve_dynamics(made(left=7.85e-9, right=1e-11), [1e-7])


def test_rows_of_a_run_that_is_ended(comm):
    """What ends a run in a monitor has the rows so far."""

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        if problem.t > 0.15:
            raise KeyboardInterrupt
        return {"twice": 2 * problem.t}

    tagged = scene(comm)
    problem = held(tagged, bonded(tagged), "left", "right")
    with pytest.raises(KeyboardInterrupt) as ended:
        vmdg.solve(problem, [0.1, 0.2, 0.3], monitor=monitor)
    assert ended.value.result.history["twice"].tolist() == [0.2]
    assert problem.t == 0.1


@pytest.mark.filterwarnings("ignore:the body of tag 2 carries a load", "ignore:A piece of the body")
def test_force_beyond_the_strength(comm):
    """The message begins with the cause, and with the load factor of the peak: 100 MPa at 0.5."""
    tagged = scene(comm)
    problem = held(tagged, bonded(tagged), "left")
    problem.traction(tagged.facet_tags.find("right"), lambda t: (200 * t, 0.0))
    with pytest.raises(
        vmdg.StepFailure, match=r"^no equilibrium was found beyond load factor 0.4[89]"
    ):
        vmdg.solve(problem, [0.25, 1.0], vmdg.SolveOptions(max_cuts=1))


@pytest.mark.parametrize(("E", "critical_gap"), [(5000.0, 0.2e-3), (5.0, 0.2)])
def test_softening_too_steep_by_far(comm, E, critical_gap):
    """Critical gap in m, or E in GPa: H above tau_s by a large factor, the message asks for units.

    Refused with a factor on tau_s, r <= H; with "auto" r exceeds H, and it is a warning.
    """
    law = vmdg.Debonding(strength=100.0, critical_gap=critical_gap)
    material, tagged = vmdg.NeoHookean(E=E, nu=0.25), scene(comm)
    message = r"Refine .* are the units of .* consistent \(MPa with mm"
    with pytest.raises(ValueError, match=message):
        bonded(tagged, law, material, safety=1.0)
    with warned(comm, message):
        look(held(tagged, bonded(tagged, law, material), "left", "right"))


# Supports and loads


def test_nothing_prescribed(comm):
    """A problem without supports is refused, with what moves."""
    tagged = scene(comm)
    with pytest.raises(
        ValueError, match=r"no constraint on the body of tags 1, 2 against translation"
    ):
        vmdg.solve(bonded(tagged), [1.0])


@pytest.mark.parametrize(
    ("cell", "free"), [("triangle", "y"), ("hexahedron", "y, translation along z")]
)
def test_symmetry_forgotten(comm, cell, free):
    """Ends that are only pulled leave the body free across; planes of symmetry hold it."""
    tagged = scene(comm, cell=cell)
    problem = bonded(tagged)
    for name in ("left", "right"):
        problem.dirichlet(tagged.facet_tags.find(name), lambda t: 1e-3 * t, "x")
    with pytest.raises(ValueError, match=f"against translation along {free}.*planes of symmetry"):
        look(problem)
    problem.dirichlet(tagged.facet_tags.find("bottom"), 0.0, "y")
    if cell == "hexahedron":
        problem.dirichlet(tagged.facet_tags.find("back"), 0.0, "z")
    look(problem)


def test_rotation_left_free(comm):
    """A body pinned at one point turns about it."""
    tagged = scene(comm)
    problem = bonded(tagged)
    problem.dirichlet_points(lambda x: np.isclose(x[0], 0) & np.isclose(x[1], 0), 0.0)
    with pytest.raises(ValueError, match="against rotation"):
        look(problem)


def test_only_contact_holds_a_body(comm):
    """A block that leans on another one without any support is warned of, once: no bond holds it,
    whether it bears a load or not."""
    tagged = scene(comm)
    problem = held(tagged, bonded(tagged, vmdg.Contact(friction=0.3)), "left")
    problem.pressure(tagged.facet_tags.find("right"), lambda t: t)
    with warned(comm, "only contact constrains the body of tag 2 .* prescribe") as caught:
        look(problem)
    assert comm.rank > 0 or len(caught) == 1


def test_only_a_bond_bears_a_load(comm):
    """A load that no support takes once the bond is gone is warned of; a tie is enough."""
    tagged = scene(comm)
    for law, warning in ((BOND, True), (vmdg.Bonded(), False)):
        problem = held(tagged, bonded(tagged, law), "left")
        problem.traction(tagged.facet_tags.find("right"), lambda t: [t, 0.0])
        with (
            warned(comm, "tag 2 carries a load, .*only bonds constrain")
            if warning
            else nullcontext()
        ):
            look(problem)


def test_two_values_at_a_node(comm):
    """Overlapping conditions that differ are warned of; equal ones are not."""
    tagged = scene(comm)
    problem = held(tagged, bonded(tagged), "left", "right")
    problem.dirichlet(tagged.facet_tags.find("bottom"), 0.0, "y")
    look(problem)
    problem.dirichlet(tagged.facet_tags.find("top"), lambda t: 0.1 * t, "y")
    message = r"along y of the node at \[\S+, 1.0, 0.0\] is prescribed as 0 and as 0.05 .* Remove"
    with warned(comm, message):
        look(problem)


def test_warnings_reach_the_user(comm):
    """solve warns, and still solves."""
    tagged = scene(comm)
    problem = held(tagged, bonded(tagged), "left")
    problem.traction(tagged.facet_tags.find("right"), lambda t: [t, 0.0])
    with warned(comm, "only bonds constrain it") as caught:
        result = vmdg.solve(problem, [1.0])
    assert len(result.history) == 1
    # At the line that has called vmdg.
    assert comm.rank > 0 or caught[0].filename == __file__


# Refusals at the door


def make(tagged: TaggedMesh, **changes) -> vmdg.Problem:
    given = {"mesh": tagged.mesh, "cell_tags": tagged.cell_tags, "interfaces": [TIE]}
    return vmdg.Problem(**(given | {"materials": {1: STEEL, 2: STEEL}} | changes))


def bond(tagged: TaggedMesh, **where) -> vmdg.Problem:
    return make(tagged, interfaces=[vmdg.Interface(**where, law=BOND)])


def apart(tagged: TaggedMesh) -> vmdg.Problem:
    far = vmdg.split_cells(tagged.mesh, lambda x: 1.5 - x[0], "far", tagged.cell_tags)
    materials = {"left": STEEL, "right": STEEL, "far": STEEL}
    interface = vmdg.Interface(between=(1, 3), law=BOND)
    return make(tagged, cell_tags=far, materials=materials, interfaces=[interface])


def prescribe(tagged: TaggedMesh, value, component=None) -> None:
    bonded(tagged).dirichlet(tagged.facet_tags.find("left"), value, component)


def run(tagged: TaggedMesh, **arguments) -> None:
    problem = held(tagged, bonded(tagged), "left", "right")
    vmdg.solve(**({"problem": problem, "loads": [1.0]} | arguments))


def ended(tagged: TaggedMesh, value) -> vmdg.Problem:
    problem = held(tagged, bonded(tagged), "left")
    problem.dirichlet(tagged.facet_tags.find("right"), value, "x")
    problem.dirichlet(tagged.facet_tags.find("right"), 0.0, "y")
    return problem


def scaled(problem: vmdg.Problem) -> vmdg.Problem:
    problem.mesh.geometry.x[:] *= 1e-3
    return problem


def tie(**options) -> vmdg.Interface:
    return vmdg.Interface(**({"law": vmdg.Bonded()} | options))


#: How a mistake comes about, and what the ValueError says.
WRONG_VALUES = [
    (
        lambda s: tie(),
        r"exactly one of facets=, surfaces=.*, between=.*, within=tag, level_set=phi; given: none",
    ),
    (lambda s: tie(between=(1, 2), within=1), r"exactly one of .*; given: between, within"),
    (lambda s: tie(between=(1, 1)), r"between = \(1, 1\) must be two different tags.*within=tag"),
    (lambda s: tie(within=1, safety="high"), r"safety = 'high' must be positive, or \"auto\""),
    (lambda s: tie(within=1, frame="moving"), "frame = 'moving' must be one of"),
    (lambda s: tie(within=1, activate="on-demand"), "a tie never fails"),
    (lambda s: tie(within=1, law=BOND, activate="later"), "activate"),
    (lambda s: tie(within=1, law=BOND, activate="on-demand", activate_at=1.5), "activate_at"),
    (
        lambda s: make(s, interfaces=[tie(between=(1, 2), law=vmdg.Debonding(lambda x: 1j, 1.0))]),
        "strength of the law must be one finite number .* it is complex",
    ),
    (
        lambda s: vmdg.Debonding(strength=0.0, critical_gap=0.2),
        r"strength = 0.0: must be positive .* use Bonded\(\)",
    ),
    (
        lambda s: vmdg.NeoHookean(E=1.0, nu=0.5),
        r"nu = 0.5 must lie in \(-1, 0.5\); .* take for example nu = 0.4998",
    ),
    (
        lambda s: held(s, bonded(s), "interface"),
        r"facet \d+ at \[1.0, .*lies on an interface, .* prescribe boundary facets",
    ),
    (
        lambda s: bonded(s).traction(s.facet_tags.find("interface"), [1.0, 0.0]),
        r"facet \d+ at \[1.0, .*lies inside the mesh .* give boundary facets",
    ),
    (
        lambda s: s.facet_tags.find("Botom"),
        r"no group is called 'Botom'; the mesh has 'left' \(1\), .*Did you mean 'bottom'\?",
    ),
    (
        lambda s: bond(s, between=("fibre", "matrix")),
        r"no group is called 'fibre'; the mesh has 'left' \(1\), 'right' \(2\)$",
    ),
    (
        lambda s: make(s, materials={"left": STEEL, "rigth": STEEL}),
        "materials: no group is called 'rigth'.*Did you mean 'right'",
    ),
    (
        lambda s: make(s, materials={1: STEEL}),
        r"no material for cell tag 2: materials has \[1\], the mesh has \[1, 2\]",
    ),
    (
        lambda s: make(s, materials={tag: STEEL for tag in (1, 2, 3)}),
        r"materials names cell tag 3, but the mesh has only \[1, 2\]",
    ),
    (
        lambda s: make(s, materials={1: STEEL, "left": STEEL, 2: STEEL}),
        "'left' is tag 1, which has a value already",
    ),
    (lambda s: make(s, cell_tags=s.facet_tags), "dimension 1, .*tags of facets given"),
    (lambda s: make(s, cell_tags=scene(s.mesh.comm).cell_tags), "belong to another mesh; give"),
    (lambda s: make(s, degree=0), "degree = 0 must be an integer, at least 1"),
    (lambda s: make(s, kinematics="large"), "kinematics = 'large' must be one of"),
    (lambda s: make(s, thickness=0.0), "thickness = 0.0 must be positive"),
    (lambda s: bond(s, between=(1, 5)), r"no cell has tag 5; tags are \[1, 2\]"),
    (
        lambda s: make(s, interfaces=[TIE, tie(facets=s.facet_tags.find(3))]),
        r"facet \d+ belongs to both interface 0 \(between=\(1, 2\)\) and interface 1 \(facets=",
    ),
    (
        lambda s: bond(s, facets=s.facet_tags.find("left")),
        "lies on the boundary of the mesh; an interface takes interior facets only",
    ),
    (apart, "has no facet: the tags are not adjacent, .*make the mesh conforming"),
    (
        lambda s: bond(s, level_set=lambda x: x[0] + 1),
        "the level set has one sign .* check its units",
    ),
    (
        lambda s: bond(s, level_set=lambda x: x),
        r"returns values of shape \(3, \d+\) .* must return one finite number per point",
    ),
    (
        lambda s: bond(s, facets=lambda x: x[0] == 0.9999),
        "true at all vertices of no interior facet; compare coordinates by np.isclose",
    ),
    (
        lambda s: prescribe(s, 0.0, "w"),
        r"unknown component 'w'; in 2D it is one of 0\.\.1 or x, y, or None for all",
    ),
    (
        lambda s: bonded(s).dirichlet(np.zeros(0, dtype=np.int32), 0.0),
        "dirichlet: no facet is selected on any rank",
    ),
    (lambda s: prescribe(s, [0.0, 0.0, 0.0]), r"a value of shape \(3,\) does not fit 2 components"),
    (lambda s: prescribe(s, lambda t: None), "must return the value"),
    (lambda s: bonded(s).dirichlet(np.array([10**6]), 0.0), "does not exist on this"),
    (
        lambda s: bonded(s).body_force([0.0, 0.0, -9.81]),
        r"body_force: the value has shape \(3,\), expected \(2,\)",
    ),
    (
        lambda s: bonded(s).body_force(ufl.SpatialCoordinate(scene(s.mesh.comm).mesh)),
        "the expression belongs to another mesh",
    ),
    (
        lambda s: look(ended(s, lambda t: t if t < 1.0 else np.nan)),
        r"a prescribed displacement \(call 2 of dirichlet.*\) is not finite at load factor 1",
    ),
    (
        lambda s: look(
            held(s, make(s, eigenstrain={1: lambda t: t if t < 1.0 else np.nan}), "left")
        ),
        r"an eigenstrain \(eigenstrain of tag 1\) is not finite at load factor 1: check its",
    ),
    (
        lambda s: look(held(s, make(s, eigenstrain={1: lambda t: -3.0 * t}), "left")),
        r"an eigenstrain of -1.5 at load factor 0.5 would shrink .*must be positive.* 1 % is 0.01",
    ),
    (
        lambda s: tie(within=[1, 2]),
        r"within = \[1, 2\] must be one tag; create an interface for each",
    ),
    (
        lambda s: bond(s, between=(1, 2), initial_damage="half"),
        r"initial_damage = 'half' must lie in \[0, 1\]: the lost fraction of the strength",
    ),
    (
        lambda s: bond(s, level_set=lambda x: x[0] < 1),
        "the level set returns True or False; .* negative inside",
    ),
    (
        lambda s: bonded(s).reaction(s.facet_tags.find("interface")),
        r"reaction: facet \d+ at \[1.0, .*are unconstrained; .* vmdg.integral\(problem, interface",
    ),
    (
        lambda s: run(s, loads=["0.5", "1.0"]),
        r"loads = \['0.5', '1.0'\] must be one or more finite load factors",
    ),
    (
        lambda s: look(scaled(held(s, bonded(s), "left", "right"))),
        "nodes of the mesh were moved after the problem was created, .*scale the mesh first",
    ),
    (lambda s: vmdg.FieldWriter(bonded(s), "run", []), "FieldWriter: fields is empty; choose from"),
    (
        lambda s: vmdg.CrackGrowth(bonded(s), 0, width=-1.0),
        "CrackGrowth: width = -1.0 must be positive and finite",
    ),
    (lambda s: run(s, loads=0), "loads = 0 is a number of steps"),
]

#: The same for a TypeError.
WRONG_TYPES = [
    (lambda s: tie(within=1, law="glue"), "law = 'glue' is not an interface law; try vmdg.Bonded"),
    (
        lambda s: tie(within=1, law=vmdg.Bonded),
        r"law = Bonded is a class; give an instance .* Bonded\(\.\.\.\)",
    ),
    (
        lambda s: make(s, materials={1: STEEL, 2: vmdg.NeoHookean}),
        "the material of 2 is the class NeoHookean; give an instance",
    ),
    (lambda s: make(s, materials={1: STEEL, 2: 5e3}), "must be a vmdg.Material"),
    (lambda s: make(s, materials=[STEEL, STEEL]), "must be a dict"),
    (lambda s: make(s, interfaces=TIE), r"a list, \[Interface"),
    (lambda s: make(s, mesh=s), "unpack what vmdg.meshes"),
    (lambda s: make(s, cell_tags=None), "not dolfinx.mesh.MeshTags; make them by"),
    (lambda s: bonded(s).dirichlet("left", 0.0), r"facet_tags.find\(group\)"),
    (
        lambda s: bonded(s).dirichlet(np.ones(4, dtype=bool), 0.0),
        "must be an array of local facets",
    ),
    (
        lambda s: bond(s, facets=np.ones(4, dtype=bool)),
        r"Interface: facets = .* must be an array of local facets.*np.flatnonzero\(mask\)",
    ),
    (
        lambda s: tie(within=1, stabilization=4.0),
        "stabilization = 4.0 must be a function of tau1, tau2 .* safety=",
    ),
    (
        lambda s: bonded(s).dirichlet_points([0, 1], 0.0),
        r"dirichlet_points: where = \[0, 1\] must be a predicate on coordinates",
    ),
    (
        lambda s: bonded(s).spring(s.facet_tags.find("left"), lambda t: 100 * t),
        "spring: the stiffness .* must be numbers in MPa/mm; springs are constant in the load",
    ),
    (
        lambda s: run(s, problem=[bonded(s)]),
        r"solve: problem = \[<Problem: .*\] must be a vmdg.Problem: solve\(problem, ",
    ),
    (
        lambda s: run(s, history=[]),
        r"solve: history = \[\] must be a History, such as result.history",
    ),
    (
        lambda s: vmdg.split_cells(s.mesh, lambda x: x[0] - 1, 5),
        "split_cells: name = 5 must be a word",
    ),
    (
        lambda s: vmdg.split_cells(s.mesh, 0.5, "inside"),
        "level set 0.5 must be a function of points",
    ),
    (
        lambda s: write_mesh(s.mesh, "part.xdmf"),
        "write_mesh: tagged = <.*> must be mesh, cell_tags, facet_tags",
    ),
    (
        lambda s: read_mesh(s.mesh.comm, "part.msh"),
        "read_mesh: path = <.*> must be a str or a Path",
    ),
    (
        lambda s: vmdg.FieldWriter("run", bonded(s)),
        "FieldWriter: problem = 'run' must be a vmdg.Problem, and the folder comes after it",
    ),
    (
        lambda s: plot.curve(vmdg.solve(held(s, bonded(s), "left"), [1.0]), "load", "step"),
        "curve: history = <Result: .* must be a vmdg.History: result.history",
    ),
    (lambda s: run(s, options={"max_cuts": 3}), r"SolveOptions\(\.\.\.\)"),
    (lambda s: run(s, loads=1.0), r"\[1.0\] for one step to 1, or an int"),
    (lambda s: vmdg.NeoHookean(K=1.0, G=1.0), r"there is no K=: .* lmbda=K - 2\*G/3 and mu=G"),
    (
        lambda s: vmdg.Debonding(strength=1.0, fracture_energy=1.0),
        r"there is no fracture_energy=: .* critical_gap=2\*G_c/strength",
    ),
    (
        lambda s: vmdg.identify(lambda v: 3.0, vmdg.Curve([1.0], [1.0], sigma=1.0), {"E": 1.0}),
        "make_problem of 'measured' returned 3.0; it must return a problem, its monitor",
    ),
]


@pytest.mark.parametrize(
    ("error", "attempt", "message"),
    [(ValueError, *one) for one in WRONG_VALUES] + [(TypeError, *one) for one in WRONG_TYPES],
)
def test_refused(comm, error, attempt, message):
    """Refused on every rank, by a message that says what to do."""
    with pytest.raises(error, match=message):
        attempt(scene(comm))


#: By option: a value that makes no sense, and what the error says it must be.
WRONG_OPTIONS = {
    "relative_tolerance": (0.0, r"in \(0, 1\]"),
    "max_iterations": (2.5, "an integer >= 0"),
    "max_cuts": (-1, "an integer >= 0"),
    "control": ("force", r"one of \('auto', 'load', 'dissipation'\)"),
    "unstable": ("snap", r"one of \('jump', 'trace'\)"),
    "max_share": (2.0, r"in \(0, 1\]"),
    "duration": (0.0, "positive and finite"),
    "cycles": (-1.0, "zero or positive and finite"),
    "max_loss": (0.0, r"in \(0, 1\]"),
    "checkpoint_every": (0, "an integer >= 1"),
    "petsc": ("mumps", "options by name, "),
    "csv": (True, "a path or None"),
    "checkpoint": (True, "a path or None"),
    "path": ({}, r"PathOptions\(\.\.\.\)"),
    "energy": ("yes", "True or False"),
    "progress": ("yes", "True, False or a number of seconds"),
    "show": (5, "names of columns or None"),
}


@pytest.mark.parametrize(
    ("name", "value", "words"), [(name, *one) for name, one in WRONG_OPTIONS.items()]
)
def test_options(name, value, words):
    """Refused when they are given, not when a run meets them."""
    with pytest.raises(ValueError, match=f"SolveOptions: {name} = {value!r} must be {words}"):
        vmdg.SolveOptions(**{name: value})


@pytest.mark.parametrize(("name", "value"), [("aim", 0), ("small", -1.0), ("cut", "0.25")])
def test_path_options(name, value):
    """The numbers of a path are numbers."""
    with pytest.raises(ValueError, match=f"PathOptions: {name} = {value!r} must be positive and f"):
        vmdg.PathOptions(**{name: value})


@pytest.mark.parametrize("name", ["monitor", "until"])
def test_functions_of_one_rank(comm, name):
    """Refused on all ranks; alone they would wait for each other."""
    tagged = scene(comm)
    problem = held(tagged, bonded(tagged), "left", "right")
    given = {name: (lambda _: {} if name == "monitor" else False) if comm.rank == 0 else None}
    refused = pytest.raises(
        ValueError, match=f"solve: rank 0 gives {name} = 'given', rank 1 {name} = None"
    )
    with refused if comm.size > 1 else nullcontext():
        vmdg.solve(problem, [1.0], **given)


def test_a_change_after_the_fact(comm):
    """A problem has compiled its interfaces."""
    with pytest.raises(AttributeError, match="create a new Interface and a new P"):
        bonded(scene(comm)).interfaces[0].law = vmdg.Bonded()


def test_a_checkpoint_that_nobody_read(comm, out):
    """A run from the start where an earlier one left its checkpoint would lose it: a warning."""
    tagged, options = scene(comm), vmdg.SolveOptions(checkpoint=out / "run")
    first = vmdg.solve(held(tagged, bonded(tagged), "left", "right"), [0.5, 1.0], options)
    problem = held(tagged, bonded(tagged), "left", "right")
    history = vmdg.read_checkpoint(problem, out / "run")
    assert history.rows == first.history.rows
    vmdg.solve(problem, [1.5], options, history=history)
    with warned(comm, r"run holds the checkpoint of an earlier run.*read_checkpoint.*discard"):
        vmdg.solve(held(tagged, bonded(tagged), "left", "right"), [0.5], options)
    vmdg.discard_checkpoint(comm, out / "run")
    vmdg.solve(held(tagged, bonded(tagged), "left", "right"), [0.5], options)


def test_a_run_that_goes_on_from_its_beginning(comm):
    """All load factors again, and not those that are left, unload the bond: that is warned of."""
    tagged, loads = scene(comm), np.array([0.5, 1.0])
    problem = held(tagged, bonded(tagged), "left", "right")
    history = vmdg.solve(problem, loads[:1]).history
    vmdg.solve(problem, loads[loads > problem.t], history=history)
    with warned(comm, r"at load factor 1, but loads start .*at 0.5: .*loads\[loads > problem.t\]"):
        vmdg.solve(problem, loads, history=history)


def test_names_without_names(comm):
    """A mesh whose groups have no names says how to get them."""
    mesh = create_rectangle(comm, [(0, 0), (2, 1)], (2, 2), CellType.triangle)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    tags = meshtags(mesh, 2, cells, np.ones_like(cells))
    with pytest.raises(ValueError, match=r"groups of this mesh have no names.*setPhysicalName"):
        vmdg.Problem(mesh, tags, {"steel": STEEL}, [])


@pytest.mark.parametrize(
    ("groups", "message"),
    [
        (
            {1: [1]},
            r"surface 2 .*is meshed but in no physical group, .*create a group for every body",
        ),
        (
            {1: [1], 2: [1, 2]},
            r"surface 1 .*in the physical groups \[1, 2\]; .*assign it to one group",
        ),
    ],
)
def test_groups_of_gmsh(comm, groups, message):
    """A body without a group would be lost, one in two groups would be there twice."""
    with model("groups") as gmsh_model:
        if comm.rank == 0:
            occ = gmsh_model.occ
            occ.fragment(
                [(2, occ.addRectangle(0, 0, 0, 1, 1))], [(2, occ.addRectangle(1, 0, 0, 1, 1))]
            )
            occ.synchronize()
            for tag, surfaces in groups.items():
                gmsh_model.addPhysicalGroup(2, surfaces, tag)
            gmsh_model.mesh.generate(2)
        with pytest.raises(ValueError, match=message):
            distribute(gmsh_model, comm, 2)


def test_complex_petsc(comm, monkeypatch):
    """PETSc with complex numbers is refused before anything is assembled."""
    monkeypatch.setattr(PETSc, "ScalarType", np.complex128)
    with pytest.raises(RuntimeError, match=r"complex numbers.*choose the real build"):
        bonded(scene(comm))


def test_single_precision(comm):
    """So is a mesh of single precision."""
    mesh = create_unit_square(comm, 2, 2, dtype=np.float32)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    tags = meshtags(mesh, 2, cells, np.ones_like(cells))
    with pytest.raises(ValueError, match=r"float32; create it with dtype=numpy\.float64"):
        vmdg.Problem(mesh, tags, {1: STEEL}, [])


def test_cells_of_higher_degree(comm):
    """A displacement of degree 1 has no constant strain on cells of degree 2: both cures are named.

    The patch test of two straight blocks with one curved interface would be off by 2%.
    """
    tagged = blocks(comm, "triangle", (2, 2, 2), order=2)
    message = r"of degree 2, .* displacement has degree 1, .* degree=2, .*mesh\.setOrder\(1\)"
    with pytest.raises(ValueError, match=message):
        make(tagged)
    make(tagged, degree=2)


def test_surface_in_space():
    """A plane mesh with three coordinates, as gmsh files have them, says how to read it."""
    x = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    coordinates = basix.ufl.element("Lagrange", "triangle", 1, shape=(3,))
    cells = np.array([[0, 1, 2]], dtype=np.int64)
    mesh = create_mesh(MPI.COMM_SELF, cells=cells, x=x, e=ufl.Mesh(coordinates))
    tags = meshtags(mesh, 2, np.array([0], dtype=np.int32), np.array([1], dtype=np.int32))
    with pytest.raises(ValueError, match="3 coordinates for cells of dimension 2; pass gdim=2"):
        vmdg.Problem(mesh, tags, {1: STEEL}, [])
