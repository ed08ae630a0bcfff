"""Derivatives of runs by parameters, against differences of whole runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from support.apart import stack
from support.arms import bent_apart
from support.bar import with_law
from support.scenes import two_blocks

import vmdg
from vmdg.solver.attempt import Attempt
from vmdg.solver.limits import Direction, Limits
from vmdg.solver.steps import Steps

CHANGE = 1e-5
LOADS = np.arange(1, 7) / 6
BOND = {"bond.strength": 50.0, "bond.critical_gap": 0.08, "bond.friction": 0.3}
BASE = BOND | {"1.E": 5000.0, "1.nu": 0.25}
MIXED = {"normal_strength": 50.0, "shear_strength": 60.0, "normal_energy": 1.0, "shear_energy": 2.0}
RUBS = {"friction": 0.3}
PLAIN = {"strength": 50.0, "critical_gap": 0.05} | RUBS
SMOOTH = {"strength": 50.0, "fracture_energy": 1.2} | RUBS
LAWS: dict[str, tuple[Callable, dict]] = {
    "linear": (vmdg.Debonding, PLAIN),
    "viscous": (vmdg.Debonding, PLAIN | {"viscosity": 100.0}),
    "secant": (partial(vmdg.Debonding, unloading="secant"), PLAIN),
    "exponential": (vmdg.ExponentialDebonding, SMOOTH),
    "exponential secant": (partial(vmdg.ExponentialDebonding, unloading="secant"), SMOOTH),
    "trapezoidal": (vmdg.TrapezoidalDebonding, PLAIN | {"plateau_gap": 0.01}),
    "intrinsic": (
        vmdg.IntrinsicExponential,
        {"strength": 50.0, "fracture_energy": 4.0, "shear_weight": 2.0},
    ),
    "BK": (partial(vmdg.MixedModeDebonding, criterion="BK"), MIXED | {"exponent": 2.0} | RUBS),
    "power secant": (
        partial(vmdg.MixedModeDebonding, criterion="power", unloading="secant"),
        MIXED | {"exponent": 1.5} | RUBS,
    ),
    "contact": (vmdg.Contact, RUBS),
}


def path(name: str, t: float) -> tuple[float, float, float]:
    """Displacement of the right end: opened, pressed and sheared, or both in turn [mm]."""
    if name == "open":
        return 0.03 * t, 0.01 * t, 0.005 * t
    if name == "pressed":
        return -0.003 * t, 0.04 * t, 0.01 * t
    times = [0.0, 0.3, 0.5, 0.8, 1.0]
    return (
        np.interp(t, times, [0, 0.03, -0.002, -0.002, 0.04]),
        np.interp(t, times, [0, 0.004, 0.004, 0.03, 0.03]),
        0.0,
    )


def blocks_of(
    comm: MPI.Comm,
    values: Mapping[str, float],
    law: Callable = vmdg.Debonding,
    cell: str = "quadrilateral",
    n: int = 1,
    move: str = "open",
    kinematics: str = "small",
    interface: Mapping | None = None,
    dead: bool = False,
    rigid: bool = False,
    **options,
) -> tuple[vmdg.Problem, Callable]:
    """Two blocks and their bond, moved at the right end, and what is watched of them."""
    scene = two_blocks(comm, cell, n)
    d = scene.mesh.geometry.dim
    material = vmdg.NeoHookean(E=values.get("1.E", 5000.0), nu=values.get("1.nu", 0.25))
    given = {name.partition(".")[2]: v for name, v in values.items() if name.startswith("bond")}
    bond = vmdg.Interface(between=(1, 2), law=law(**given), name="bond", **(interface or {}))
    bodies = {1: material, 2: vmdg.NeoHookean(E=2000.0, nu=0.35)}
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, bodies, [bond], kinematics=kinematics, **options
    )
    left, right = scene.facet_tags.find(1), scene.facet_tags.find(2)
    problem.dirichlet(left, 0.0)
    if dead:
        problem.traction(right, lambda t: np.array([30.0, 5.0, 0.0][:d]) * t)
    elif rigid:
        problem.rigid_face(right, displacement=lambda t: np.array(path(move, t)[:d]))
    else:
        problem.dirichlet(right, lambda t: np.array(path(move, t)[:d]))

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force, mean = problem.reaction(left), problem.mean("bond")
        return {
            "along [N]": force[0],
            "across [N]": force[1],
            "gap [mm]": float(np.linalg.norm(mean.gap)),
            "softening [MPa]": float(mean.softening),
        }

    return problem, monitor


def solved(
    build: Callable,
    values: Mapping[str, float],
    names: Sequence[str] | Mapping | None = None,
    **options,
) -> vmdg.History:
    problem, monitor = build(values)
    options = vmdg.SolveOptions(relative_tolerance=1e-12, **options)
    return vmdg.solve(problem, LOADS, options, monitor, derivatives=names).history


def worst(build: Callable, values: Mapping[str, float], **options) -> float:
    """Largest difference from differences of whole runs, at given load factors, of p d/dp of a
    column, relative to its largest value or derivative."""
    base, found = solved(build, values, values, **options), 0.0
    columns = ["along", "across", "gap", "softening"]
    if options.get("energy"):
        columns += ["bulk", "damage", "friction"]

    def at_loads(history: vmdg.History, column: str) -> np.ndarray:
        rows = [np.flatnonzero(np.isclose(history["load"], t))[0] for t in LOADS]
        return history[column][rows]

    for name, value in values.items():
        ends = [
            solved(build, {**values, name: value * (1 + h)}, **options) for h in (CHANGE, -CHANGE)
        ]
        for column in columns:
            higher, lower = (at_loads(end, column) for end in ends)
            rate = value * at_loads(base, f"d {column}/d {name}")
            sizes = np.abs(at_loads(base, column)).max(), np.abs(rate).max()
            apart = np.abs(rate - (higher - lower) / (2 * CHANGE)).max()
            # A force of rounding, as of bodies that do not touch, has no derivative.
            found = max(found, apart / max(*sizes, 1e-6))
    return found


@pytest.mark.parametrize(
    ("name", "move"),
    [
        pytest.param(name, move, marks=[pytest.mark.long] * (name not in ("viscous", "BK")))
        for name, move in zip(LAWS, 5 * ("pressed", "both"), strict=True)
    ],
)
def test_laws(comm, name, move):
    """Every parameter of every law, pressed together, and opened, rubbed and opened again."""
    law, given = LAWS[name]
    values = {f"bond.{k}": v for k, v in given.items()}
    build = partial(blocks_of, comm, law=law, move=move)
    assert worst(build, values, control="load") < 1e-6


SCENES = {
    "hexahedra": {"cell": "hexahedron", "move": "pressed"},
    "finite": {"kinematics": "finite", "n": 2},
    "tetrahedra, finite": {"kinematics": "finite", "cell": "tetrahedron"},
    "degree 2, finite, pressed": {"kinematics": "finite", "degree": 2, "move": "pressed"},
    "frame of reference": {"kinematics": "finite", "interface": {"frame": "reference"}},
    "axisymmetric": {"kinematics": "finite", "symmetry": "axisymmetric"},
    "mean dilatation": {"kinematics": "finite", "volumetric": "mean"},
    "plane stress": {"plane": "stress"},
    "eigenstrain": {"eigenstrain": {1: lambda t: 0.002 * t}},
    "eigenstrain, finite": {"kinematics": "finite", "eigenstrain": {1: lambda t: 0.002 * t}},
    "given safety": {"interface": {"safety": 4.0, "traction_jump": True}},
    "initial damage": {"interface": {"initial_damage": lambda x: 0.5 * (x[1] < 0.5)}, "n": 2},
    "rigid face": {"rigid": True, "n": 2},
    "dead load": {"dead": True, "n": 2},
}


@pytest.mark.filterwarnings("ignore:the body of tag 2 carries a load")
@pytest.mark.parametrize("scene", SCENES)
def test_scenes(comm, scene):
    """Dimensions, kinematics, frames, eigenstrains, loads."""
    assert worst(partial(blocks_of, comm, **SCENES[scene]), BASE) < 1e-6


@pytest.mark.parametrize(("kinematics", "energy"), [("small", True), ("finite", False)])
def test_eigenstrain(comm, kinematics, energy):
    """A factor on the eigenstrain of a group, given by its value."""

    def build(values):
        strain = {1: lambda t: values["1.eigenstrain"] * t}
        return blocks_of(comm, values, kinematics=kinematics, eigenstrain=strain, n=2)

    values = BOND | {"1.eigenstrain": 0.002}
    assert worst(build, values, energy=energy) < 1e-6


@pytest.mark.filterwarnings("ignore:the body of tag 2 carries a load")
@pytest.mark.parametrize("kinematics", ["finite", pytest.param("small", marks=pytest.mark.long)])
def test_relative_support(comm, kinematics):
    """A tool that grips a loaded body where it is: that place depends on the parameters too."""

    def build(values):
        problem, monitor = blocks_of(comm, values, kinematics=kinematics, dead=True, n=2)
        options = vmdg.SolveOptions(relative_tolerance=1e-12)
        vmdg.solve(problem, [0.1], options, derivatives=list(values))
        right = problem.mesh.geometry.x[:, 0].max()
        right = problem.comm.allreduce(right, MPI.MAX)
        problem.dirichlet(
            lambda x: np.isclose(x[0], right),
            lambda t: np.array(path("open", t - 0.1)[:2]),
            relative=True,
        )
        return problem, monitor

    assert worst(build, BASE) < 1e-6


@pytest.mark.parametrize("kinematics", ["finite", pytest.param("small", marks=pytest.mark.long)])
def test_contact_that_closes(comm, kinematics):
    """Facets that are left out while they are open, in strained cells, and rub once they close."""

    def build(values):
        problem, monitor = blocks_of(
            comm, values, vmdg.Contact, n=2, move="both", kinematics=kinematics
        )
        problem.body_force(lambda x, t: t * np.array([90 * x[1], 60 * x[0]]), 1)
        return problem, monitor

    values = {"bond.friction": 0.3, "1.E": 5000.0, "1.nu": 0.25}
    assert worst(build, values, control="load") < 1e-6


@pytest.mark.parametrize("kinematics", ["finite", pytest.param("small", marks=pytest.mark.long)])
def test_meshes_that_do_not_match(comm, kinematics):
    """Three facets on four."""

    def build(values):
        scene = stack("quadrilateral", 3, 4)
        given = {name.partition(".")[2]: v for name, v in values.items() if name.startswith("bond")}
        bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(**given), name="bond")
        bodies = {
            1: vmdg.NeoHookean(E=values["1.E"], nu=0.25),
            2: vmdg.NeoHookean(E=2000.0, nu=0.35),
        }
        problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [bond], kinematics=kinematics)
        problem.dirichlet(lambda x: np.isclose(x[1], -1.0), 0.0)
        problem.dirichlet(lambda x: np.isclose(x[1], 1.0), lambda t: (0.01 * t, 0.03 * t))

        def monitor(problem: vmdg.Problem) -> dict[str, float]:
            force = problem.reaction(lambda x: np.isclose(x[1], -1.0))
            mean = problem.mean("bond")
            values = force[0], force[1], float(mean.gap[1]), float(mean.softening)
            return dict(zip(("along", "across", "gap", "softening"), values, strict=True))

        return problem, monitor

    assert worst(build, BOND | {"1.E": 5000.0}) < 1e-6


@pytest.mark.parametrize("petsc", [None, {"ksp_type": "gmres", "pc_type": "gamg"}])
def test_systems(comm, petsc):
    """Direct and iterative systems, with and without rigid faces."""
    for rigid in (False, True):
        build = partial(blocks_of, comm, cell="hexahedron", n=2, rigid=rigid)
        assert worst(build, {"1.E": 5000.0} | BOND, petsc=petsc) < 1e-6


@pytest.mark.parametrize("kinematics", ["small", pytest.param("finite", marks=pytest.mark.long)])
def test_energies(comm, kinematics):
    """Energies too, over opening, closing and rubbing."""
    build = partial(blocks_of, comm, kinematics=kinematics, move="both")
    assert worst(build, BOND, energy=True, control="load") < 5e-6


# A cantilever beam along its path


def beam(comm: MPI.Comm, values: Mapping[str, float], kinematics: str) -> tuple:
    """A short double cantilever beam with few facets, whose load falls at every point."""
    law = vmdg.Debonding(values["bond.strength"], values["bond.critical_gap"])
    problem, sides = bent_apart(comm, 24.0, (24, 3), law, values["upper arm.E"], kinematics)
    top = sides.find("upper left")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        softening = float(problem.mean("bond").softening)
        return {"force [N]": problem.reaction(top)[1], "softening [MPa]": softening}

    return problem, monitor


@pytest.mark.parametrize("kinematics", ["small", pytest.param("finite", marks=pytest.mark.long)])
def test_path(comm, kinematics):
    """Every row of a path with limit points and a step that was cut, against runs of neighbouring
    values that are led through the same rows: at load factors t + h dt/dp."""
    values = {"bond.strength": 60.0, "bond.critical_gap": 0.16 / 60, "upper arm.E": 70e3}
    loads, h, rows = np.linspace(0, 0.5, 11)[1:], 3e-6, []
    options = vmdg.SolveOptions(relative_tolerance=1e-12, control="dissipation")
    problem, monitor = beam(comm, values, kinematics)

    def watched(problem: vmdg.Problem) -> dict[str, float]:
        if not problem.loading.nearby:
            rates = problem.step.rates.by_name
            rows.append((problem.t, problem.u.x.array.copy(), rates))
        return monitor(problem)

    few = replace(options, max_iterations=6)
    history = vmdg.solve(problem, loads, few, watched, derivatives=list(values)).history
    assert history["cuts"].any()
    assert not history["frozen"].any()
    assert (np.diff(history["load"]) < 0).any() == (kinematics == "finite")
    assert len(history) > len(loads) + 5
    for name, value in values.items():
        ends = []
        for end in (h, -h):
            problem, monitor = beam(comm, {**values, name: value * (1 + end)}, kinematics)
            ends.append(led(problem, monitor, options, rows, name, end))
        for column in ("force", "softening"):
            change = np.array(ends[0][column]) - np.array(ends[1][column])
            rate = history[f"d {column}/d {name}"] * value
            size = np.abs(history[column]).max()
            assert np.abs(rate - change / (2 * h)).max() < 1e-6 * size, (name, column)


def led(problem, monitor, options, rows, name, end) -> dict[str, list[float]]:
    steps, found = Steps(problem, options), {"force": [], "softening": []}
    owned, last = problem.discretization.owned, rows[-1][0]
    problem.step.set_out()
    for t, u, rates in rows:
        problem.loading.set_ray(0.0, last)
        there, target = u + end * rates[name].u, t + end * rates[name].t
        way = Direction((there - problem.u.x.array)[:owned], target - problem.t)
        limits = Limits(problem.t, target, last)
        attempt = steps.attempt(limits, Attempt(ahead=way))
        assert attempt.converged
        for column, value in monitor(problem).items():
            found[column.partition(" ")[0]].append(value)
    steps.close()
    return found


def test_jump():
    """A jump has no derivative; behind it the broken bond carries nothing."""
    law = vmdg.Debonding(strength=100.0, critical_gap=0.01)
    problem = with_law(MPI.COMM_SELF, law, "small")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"force [N]": problem.reaction(lambda x: np.isclose(x[0], 2.0))[0]}

    loads = np.linspace(0, 0.06, 31)[1:]
    history = vmdg.solve(
        problem, loads, monitor=monitor, derivatives=["Debonding.strength"]
    ).history
    rate, jump = history["d force/d Debonding.strength"], history["jump_steps"] > 0
    assert np.isnan(rate[jump]).all()
    assert np.isfinite(rate[~jump]).all()
    assert jump.sum() == 1
    assert np.array_equal(history["frozen"], np.cumsum(jump))
    assert np.abs(rate[np.flatnonzero(jump)[0] + 1 :]).max() < 1e-9


def test_a_body_that_floats(comm):
    """Nothing holds the right block along the interface once the bond is gone: forces that are
    rounding do not move it."""
    scene = two_blocks(comm, "quadrilateral", 2)
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(10.0, 0.02), name="bond")
    bodies = dict.fromkeys((1, 2), vmdg.NeoHookean(E=1000.0, nu=0.3))
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [bond], kinematics="small")
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: 0.06 * t, "x")

    def watch(problem: vmdg.Problem) -> dict[str, float]:
        across = np.abs(problem.u.x.array[1::2]).max()
        return {"across [mm]": comm.allreduce(float(across), MPI.MAX)}

    history = vmdg.solve(problem, LOADS, monitor=watch, derivatives=["1.E", "2.E"]).history
    assert problem.debonded() == 1
    for name in ("1.E", "2.E"):
        assert np.abs(1000.0 * history[f"d across/d {name}"]).max() < 0.1


def test_runs_without_are_the_same(comm):
    """Derivatives change nothing in a run: not a digit of a column."""
    plain = solved(partial(blocks_of, comm, n=2), BASE)
    carried = solved(partial(blocks_of, comm, n=2), BASE, ["bond.strength", "1.E"])
    for column in plain:
        assert np.array_equal(plain[column], carried[column])


@pytest.mark.parametrize("kinematics", ["finite", pytest.param("small", marks=pytest.mark.long)])
def test_parameters_together(comm, kinematics):
    """Derivatives by several parameters are those by each alone."""
    build = partial(blocks_of, comm, move="both", kinematics=kinematics)
    whole = solved(build, BASE, BASE)
    for name in BASE:
        alone = solved(build, BASE, [name])
        columns = [column for column in alone if column.endswith(f"/d {name}")]
        assert columns
        for column in columns:
            size = np.abs(whole[column]).max()
            assert whole[column] == pytest.approx(alone[column], rel=0, abs=1e-7 * size)


def test_a_second_run_continues(comm):
    """Derivatives of a run in two parts are those of one run."""
    names, whole = ["bond.strength"], solved(partial(blocks_of, comm), BASE, ["bond.strength"])
    problem, monitor = blocks_of(comm, BASE)
    options = vmdg.SolveOptions(relative_tolerance=1e-12)
    parts = [
        vmdg.solve(problem, loads, options, monitor, derivatives=names).history
        for loads in (LOADS[:4], LOADS[4:])
    ]
    column = "d along/d bond.strength"
    assert np.allclose(np.concatenate([part[column] for part in parts]), whole[column], rtol=1e-7)


def test_materials_of_a_class(comm):
    """By a factor on E of all neo-Hookean bodies: the sum of those by E of each."""
    history = solved(partial(blocks_of, comm), BOND, ["1.E", "2.E", "NeoHookean.E"])
    one, other, both = (history[f"d along/d {name}.E"] for name in ("1", "2", "NeoHookean"))
    assert np.allclose(both, 5000 * one + 2000 * other, rtol=1e-7, atol=1e-7)


class NumbersOnly(vmdg.Debonding):
    """A law from elsewhere that knows no arrays."""

    def __post_init__(self):
        super().__post_init__()
        assert np.ndim(self.strength) == 0


def test_law_of_numbers(comm):
    """Laws whose parameters cannot be arrays have the derivatives of those whose can."""
    values = {name: BOND[name] for name in ("bond.strength", "bond.critical_gap")}
    runs = [
        solved(partial(blocks_of, comm, law=law), values, list(values))
        for law in (vmdg.Debonding, NumbersOnly)
    ]
    for name in values:
        one, other = (run[f"d along/d {name}"] for run in runs)
        assert np.allclose(one, other, rtol=1e-8)


def test_refusals(comm):
    """Names that do not exist, values of zero, and problems without derivatives."""
    problem, _ = blocks_of(comm, BASE)
    with pytest.raises(ValueError, match=r"no parameter 'bond.strenght'.*'bond.strength'"):
        vmdg.solve(problem, [1.0], derivatives=["bond.strenght"])
    with pytest.raises(TypeError, match="must be a list of names"):
        vmdg.solve(problem, [1.0], derivatives="bond.strength")
    with pytest.raises(ValueError, match=r"by bond.viscosity, which is 0"):
        vmdg.solve(problem, [1.0], derivatives=["bond.viscosity"])
    vmdg.solve(problem, [0.1])
    with pytest.raises(ValueError, match=r"load factor 0\.1 already"):
        vmdg.solve(problem, [1.0], derivatives=["bond.strength"])
    problem, _ = blocks_of(comm, BASE, interface={"activate": "on-demand"})
    with pytest.raises(ValueError, match=r"derivatives are not available.*open on demand"):
        vmdg.solve(problem, [1.0], derivatives=["bond.strength"])
    problem, _ = blocks_of(comm, BASE, plane="generalized strain")
    with pytest.raises(ValueError, match=r"derivatives are not available.*unknown means"):
        vmdg.solve(problem, [1.0], derivatives=["bond.strength"])
    fatigue = partial(vmdg.FatigueDebonding, 20.0, 20.0, 0.2, 0.2)
    problem, _ = blocks_of(comm, {}, fatigue)
    with pytest.raises(ValueError, match=r"derivatives are not available.*cycles"):
        vmdg.solve(problem, [1.0], derivatives=["bond.normal_strength"])
