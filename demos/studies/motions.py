"""Random scenes in time, each judged by its energies, its momenta, and by being told otherwise.

Bars that meet and part, bodies that fly, spin and tear, blocks that are thrown at a floor with a
corner first or slide down a slope, bonds that a support tears, plastic bodies: with both schemes,
in few and in many steps, on one mesh and on separate ones, where surfaces stay or slide. A number
fixes everything. What must hold, whatever was drawn:

* kinetic and stored energy never exceed those of the start and the work, that of tau_s included, by
  more than 1 %, nor do they with what is dissipated, which is never negative;
* of a body that is free in space momentum stays, and the moment of momentum where the scheme keeps
  it: in explicit steps, and at small strain on one mesh. (Where plastic bodies turn, moduli of the
  start of a step at the interfaces miss some 1e-5 of it, and implicit steps an error of theirs);
* a scheme that loses more than 5 % of the energy in motion says so, and says it once;
* in other units every digit is the same, and turned or mirrored it is the same motion;
* a run that stops is in the state of its last row, which is judged as any other.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from time import perf_counter
from typing import Any

from mpi4py import MPI

import basix.ufl
import numpy as np
from dolfinx import fem
from dolfinx.mesh import create_mesh, meshtags
from interfaces import scaled_law
from numpy.random import Generator
from parts.options import run
from parts.stability.runner import BAD, Outcome, run_all, time_limit
from parts.stability.scenes import Array, box, distorted, rotation

import vmdg

#: What scenes are about; they take turns.
WAYS = ("bars", "flight", "thrown", "slope", "torn", "plastic")

#: Energy from nothing, relative to the largest at hand; momentum and its moment, relative to the
#: sum of the sizes of all parts; displacement of a scene that was turned, of the largest.
GAINED, KEPT, MOMENT, TURNED = 0.01, 1e-10, 1e-8, 1e-6

#: Share of the energy in motion that a scheme may lose without a word.
SILENT = 0.05

PATIENCE = 900


@dataclass(frozen=True)
class View:
    """A way of telling a scene."""

    turn: Array | None = None  # Orthogonal matrix (d, d); None for none
    length: float = 1.0  # Unit of length
    stress: float = 1.0  # Unit of stress
    time: float = 1.0  # Unit of time


@dataclass(frozen=True)
class Scene:
    """What is drawn, in units of its own: moduli from 1 to 10, lengths and densities about 1."""

    way: str  # One of WAYS
    kind: str  # Cells
    nodes: Array  # Positions (n, d)
    cells: Array  # Nodes of the cells (m, corners)
    tags: Array  # Of the cells (m,)
    bodies: dict[int, Callable[[float], vmdg.Material]]  # Material in units of stress, by tag
    density: dict[int, float]
    laws: dict[tuple[int, int], vmdg.Law]  # By pair of tags
    pairs: dict[str, Any]  # How surfaces meet, as for vmdg.Interface
    velocity: Callable[[Array, int], Array]  # At positions (d, n) of the body of a tag: (d, n)
    times: Array
    scheme: Any
    kinematics: str
    what: str  # Description of the rest
    gravity: Array | None = None  # Force by volume (d,)
    held: tuple = ()  # Predicate on positions (d, n) at home and displacement t -> (d,), pairs
    matching: bool = field(default=True)  # Whether all bodies share nodes

    @property
    def d(self) -> int:
        """Dimension."""
        return self.nodes.shape[1]

    @property
    def free(self) -> bool:
        """Whether nothing outside acts on the bodies."""
        rigid = any(isinstance(body(1.0), vmdg.Rigid) for body in self.bodies.values())
        return not self.held and self.gravity is None and not rigid

    def __str__(self) -> str:
        laws = ", ".join(str(law) for law in self.laws.values())
        steps = f"{len(self.times)} steps to {self.times[-1]:.3g}"
        return f"{self.kind}, {self.kinematics}, {self.scheme}, {steps}, {laws}, {self.what}"

    def problem(self, view: View) -> tuple[vmdg.Problem, fem.Function]:
        """The scene as it is told, and its velocity at the start."""
        d, L, S, T = self.d, view.length, view.stress, view.time
        Q = np.eye(d) if view.turn is None else view.turn
        element = basix.ufl.element("Lagrange", self.kind, 1, shape=(d,))
        nodes = L * self.nodes @ Q.T
        mesh = create_mesh(MPI.COMM_SELF, cells=self.cells, x=nodes, e=element)
        tags = self.tags[mesh.topology.original_cell_index].astype(np.int32)
        numbers = np.arange(len(tags), dtype=np.int32)
        units = np.array([L, S, T])
        problem = vmdg.Problem(
            mesh,
            meshtags(mesh, d, numbers, tags),
            {tag: body(S) for tag, body in self.bodies.items()},
            [
                vmdg.Interface(between=pair, law=scaled_law(law, units), **self.pairs)
                for pair, law in self.laws.items()
            ],
            kinematics=self.kinematics,
            density={tag: rho * S * T**2 / L**2 for tag, rho in self.density.items()},
        )
        if self.gravity is not None:
            problem.body_force(S / L * Q @ self.gravity)
        for where, moved in self.held:
            problem.dirichlet(
                lambda x, where=where: where(Q.T @ x[:d] / L),
                lambda t, moved=moved: L * Q @ moved(t / T),
            )
        velocity = fem.Function(problem.space)
        x = problem.space.tabulate_dof_coordinates()[:, :d] @ Q / L
        v = velocity.x.array.reshape(-1, d)
        for tag in self.density:
            mine = np.unique(problem.space.dofmap.list[numbers[tags == tag]])
            v[mine] = L / T * (Q @ self.velocity(x[mine].T, tag)).T
        return problem, velocity


@dataclass
class Told:
    """Rows of a run, in units of 1, at home."""

    problem: vmdg.Problem
    velocity: Array  # At the start
    moved: list[Array]  # Displacement of the rows (n, d)
    momenta: list[tuple[Array, Array]]  # Velocity and displacement of the rows, as they are
    history: vmdg.History
    failures: list[tuple[float, str]]
    warned: list[str]
    stopped: str


def told(scene: Scene, view: View) -> Told:
    """A scene run as it is told."""
    problem, velocity = scene.problem(view)
    Q = np.eye(scene.d) if view.turn is None else view.turn
    start, rows = velocity.x.array.copy(), []

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        rows.append((problem.velocity.x.array.copy(), problem.u.x.array.copy()))
        motion = problem.step.motion
        a = motion.acceleration.copy()
        a[problem.loading.owned_prescribed] = 0.0
        return {"a.M.a": 0.0 if motion.lumped is None else a @ (motion.lumped * a)}

    history, stopped = vmdg.History(), ""
    options = vmdg.SolveOptions(energy=True)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", vmdg.ModelWarning)
        try:
            times = view.time * scene.times
            result = vmdg.solve_dynamics(problem, times, scene.scheme, velocity, monitor, options)
        except vmdg.StepFailure as error:
            stopped, result = str(error), error.result
    history = result.history
    warned = [str(w.message) for w in caught if "of the energy in motion" in str(w.message)]
    moved = [u.reshape(-1, scene.d) @ Q / view.length for _, u in rows]
    return Told(problem, start, moved, rows, history, result.failures, warned, stopped)


def own_faults(scene: Scene, here: Told) -> list[str]:
    """What is wrong with energies, momenta and warnings."""
    found, history = [], here.history
    if not len(history):
        return found
    names = ("kinetic", "bulk", "interface")
    energy = sum(history[name] for name in names)
    put, lost = history["external"] + history["discretization"], history["imbalance"]
    size = np.maximum.accumulate(np.maximum(put, energy))
    # In central differences E - h^2 a.M.a/8 of linear bodies is constant.
    step = np.diff(history["time"], prepend=0.0) / history["steps"]
    allowed = GAINED * size + step**2 * history["a.M.a"] / 8
    if not np.isfinite(energy).all():
        return ["energies are not finite"]
    if (energy - put > allowed).any():
        found.append(f"energy exceeds start and work by {((energy - put) / size).max():.1e}")
    # What bonds take in explicit steps is not exactly what they are given.
    if (lost < -allowed).any() and not explicit(here):
        found.append(f"imbalance {(lost / size).min():.1e}")
    for name in ("damage", "friction", "viscosity", "plastic"):
        if name in history.columns and (history[name] < -1e-9 * size).any():
            found.append(f"{name} {(history[name] / size).min():.1e}")
    # Of the kinetic and stored energy, that before the first row included.
    largest = np.maximum.accumulate(np.maximum(energy, started(here)))
    share = (np.abs(lost) / largest).max()
    near = abs(share / SILENT - 1) < 0.2  # between the rows
    if len(here.warned) > 1 or (not near and bool(here.warned) != (share > SILENT)):
        found.append(f"{len(here.warned)} warnings, imbalance {share:.1%}")
    if scene.free:
        found += momentum_faults(scene, here)
    return found


def started(here: Told) -> float:
    """Kinetic energy at the start."""
    motion = here.problem.step.motion
    momentum = motion.of(here.velocity) if motion.lumped is None else motion.lumped * here.velocity
    return float(here.velocity @ momentum) / 2


def momentum_faults(scene: Scene, here: Told) -> list[str]:
    """What is wrong with momentum and its moment."""
    problem, d = here.problem, scene.d
    motion = problem.step.motion
    X = problem.space.tabulate_dof_coordinates()[:, :d]
    explicit = motion.lumped is not None

    def parts(v: Array, u: Array) -> tuple[Array, Array]:
        P = (motion.lumped * v if explicit else motion.of(v)).reshape(-1, d)
        x = X + (0.0 if scene.kinematics == "small" else u.reshape(-1, d))
        products = np.einsum("ni,nj->ij", x, P)
        return P.sum(axis=0), products - products.T

    masses = motion.lumped if explicit else motion.row_sums
    P0, L0 = parts(here.velocity, 0 * here.velocity)
    found, size = [], np.abs(masses * here.velocity).sum()
    every = [parts(*row) for row in here.momenta]
    off = max(np.abs(P - P0).max() for P, _ in every) / size
    if not off < KEPT:
        found.append(f"momentum is off by {off:.1e}")
    small = scene.kinematics == "small"
    if scene.matching if small else explicit and scene.way != "plastic":
        off = max(np.abs(L - L0).max() for _, L in every) / (size * np.ptp(X, axis=0).max())
        if not off < MOMENT:
            found.append(f"moment of momentum is off by {off:.1e}")
    return found


def views(scene: Scene, rng: Generator) -> dict[str, tuple[View, float]]:
    """Ways in which the motion is the same, and by how much it may differ."""
    d = scene.d
    length, stress, time = (float(2.0**n) for n in rng.integers(-20, 21, 3))
    axis = rng.normal(size=3) if d == 3 else np.array([0.0, 0.0, 1.0])
    turn = rotation(axis / np.linalg.norm(axis), rng.uniform(0, 2 * np.pi))[:d, :d]
    if rng.random() < 0.5:
        turn = turn @ np.diag([1.0, -1.0, 1.0][:d])
    return {
        "in other units": (View(None, length, stress, time), 0.0),
        "turned": (View(turn), TURNED),
    }


def explicit(here: Told) -> bool:
    """Whether steps are explicit."""
    return here.problem.step.motion.lumped is not None


def differs(here: Told, other: Told, allowed: float) -> str:
    """What differs in a scene that was told otherwise; empty if nothing does."""
    if bool(here.stopped) != bool(other.stopped):
        return f"stopped: {here.stopped or other.stopped}"
    if len(here.failures) != len(other.failures) and allowed == 0:
        return f"{len(other.failures)} failed steps for {len(here.failures)}"
    if explicit(here) and list(here.history["steps"]) != list(other.history["steps"]) and allowed:
        return ""  # the critical step is an estimate
    size = max((np.abs(u).max() for u in here.moved), default=0.0)
    for number, (one, two) in enumerate(zip(here.moved, other.moved, strict=False), 1):
        off = np.abs(one - two).max() / size
        if off > allowed:
            return f"row {number} differs by {off:.1e}"
    return ""


def judge(number: int) -> Outcome:
    """A scene with all that it is compared with."""
    start, scene = perf_counter(), draw(number)
    here, found, verdict = None, [], "correct"
    with warnings.catch_warnings():
        # As in the test suite: an overflow or a NaN in the engine is a failure.
        warnings.filterwarnings("error", category=RuntimeWarning, module="vmdg")
        with time_limit(PATIENCE):
            here = told(scene, View())
            found = own_faults(scene, here)
            for name, (view, allowed) in views(scene, np.random.default_rng([number, 1])).items():
                if wrong := differs(here, told(scene, view), allowed):
                    found.append(f"{name}: {wrong}")
    verdict = "wrong" if found else "stopped" if here.stopped else "correct"
    detail = "; ".join([*found, here.stopped])
    work = len(here.history), len(here.failures), 0, perf_counter() - start
    return Outcome(number, scene.way, verdict, *work, str(scene), detail)


# What is drawn


def draw(number: int) -> Scene:
    """Scene of a number."""
    rng, way = np.random.default_rng(number), WAYS[number % len(WAYS)]
    return {"thrown": thrown, "slope": slope}.get(way, row)(rng, way)


def log_uniform(rng: Generator, low: float, high: float) -> float:
    """Uniform in its logarithm."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def scheme_of(rng: Generator) -> Any:
    """One of both schemes."""
    if rng.random() < 0.4:
        return vmdg.CentralDifferences(float(rng.uniform(0.3, 0.9)), int(rng.choice([10, 100])))
    return vmdg.GeneralizedAlpha(float(rng.choice([0.0001, 0.5, 0.8, 1.0])))


def steps_of(rng: Generator) -> int:
    """Few or many."""
    return int(rng.choice([1, 2, 3, 5, 10, 20, 40]))


def body_of(E: float, nu: float, strain: float = 0.0) -> Callable[[float], vmdg.Material]:
    """Elastic, or plastic from a strain on."""
    if strain:
        return lambda S: vmdg.J2(S * E, nu, S * E * strain, hardening=S * E / 20)
    return lambda S: vmdg.NeoHookean(E=S * E, nu=nu)


def law_of(rng: Generator, strain: float) -> vmdg.Law:
    """Contact, a tie, or a bond that parts at about this strain of a body of modulus 1."""
    which, friction = rng.random(), float(rng.choice([0.0, rng.uniform(0.1, 0.8)]))
    strength = strain * log_uniform(rng, 0.1, 3.0)
    if which < 0.35:
        return vmdg.Contact(friction)
    if which < 0.45:
        return vmdg.Bonded()
    gap = strength * log_uniform(rng, 0.3, 10.0)
    unloading = str(rng.choice(["plastic", "secant"]))
    if which < 0.85:
        return vmdg.Debonding(strength, gap, friction, unloading=unloading)
    return vmdg.ExponentialDebonding(strength, strength * gap, unloading=unloading)


def row(rng: Generator, way: str) -> Scene:
    """Two or three bodies in a row, free, or held at one end and led at the other."""
    kind = str(rng.choice(["triangle", "quadrilateral", "tetrahedron", "hexahedron"]))
    d, count = 2 + (kind in ("tetrahedron", "hexahedron")), int(rng.integers(2, 4))
    if way == "bars":
        kind = "quadrilateral" if d == 2 else "hexahedron"
    lengths = rng.uniform(0.5, 1.5, count)
    ends = np.concatenate([[0.0], np.cumsum(lengths)])
    fine = int(rng.integers(1, 13 if way == "bars" else 4))
    lines = [np.linspace(a, b, fine + 1) for a, b in pairwise(ends)]
    wide = [1 if way == "bars" else int(rng.integers(1, 4)) for _ in range(d - 1)]
    across = [np.linspace(0.0, rng.uniform(0.3, 1.0), n + 1) for n in wide]
    mesh = box(kind, (np.unique(np.concatenate(lines)), *across))
    if way != "bars" and fine > 1 and rng.random() < 0.5:
        mesh = distorted(mesh, rng, float(rng.uniform(0.3, 0.8)), ends[1:-1])
    tags = 1 + np.searchsorted(ends[1:-1], mesh.midpoints[:, 0])
    moduli = 10 ** rng.uniform(0, 1, count)
    strain = log_uniform(rng, 1e-3, 0.1)
    flows = strain * log_uniform(rng, 0.1, 1.0) if way == "plastic" else 0.0
    nu = 0.0 if way == "bars" else float(rng.uniform(0.0, 0.4))
    density = {tag: log_uniform(rng, 0.1, 10.0) for tag in range(1, count + 1)}
    laws = {(tag, tag + 1): law_of(rng, strain) for tag in range(1, count)}
    speed = strain * np.sqrt(moduli.min() / max(density.values()))
    own, rate = rng.uniform(-speed, speed, (count, d)), rng.uniform(-speed, speed, (d, d))
    if way == "bars":
        own[:, 1:], rate = 0.0, 0 * rate
    held: tuple = ()
    span = ends[-1] * np.sqrt(max(density.values()) / moduli.min()) * log_uniform(rng, 0.3, 3.0)
    if way == "torn":
        own, rate = 0 * own, 0 * rate
        to = strain * ends[-1] * rng.uniform(-1, 1, d)
        to[0] = abs(to[0])
        bend = float(rng.choice([1.0, 2.0]))
        held = (
            (lambda x: np.isclose(x[0], 0.0), lambda t: np.zeros(d)),
            (lambda x: np.isclose(x[0], ends[-1]), lambda t: to * (t / span) ** bend),
        )
    return Scene(
        way,
        kind,
        mesh.nodes,
        mesh.cells,
        tags,
        {tag: body_of(E, nu, flows) for tag, E in enumerate(moduli, 1)},
        density,
        laws,
        {},
        lambda x, tag: own[tag - 1][:, None] + rate @ x,
        span * np.linspace(0.0, 1.0, steps_of(rng) + 1)[1:],
        scheme_of(rng),
        str(rng.choice(["small", "finite"])),
        f"{count} bodies of {fine} x {wide} cells, strain {strain:.2g}",
        held=held,
    )


def on_floor(rng: Generator, tilt: float, gap: float) -> tuple[str, Array, Array, Array]:
    """Cells of a floor (tag 1) and, above it by a gap, of a block (2) that is tilted."""
    kind = str(rng.choice(["triangle", "quadrilateral", "hexahedron"], p=[0.4, 0.4, 0.2]))
    d = 3 if kind == "hexahedron" else 2
    half, deep = 1.5, [np.linspace(0.0, 1.0, 2)] * (d - 2)
    n = int(rng.integers(1, 4))
    high = rng.uniform(0.5, 1.0)
    floor = box(
        kind,
        (np.linspace(-half, half, int(rng.integers(2, 9)) + 1), np.linspace(-0.5, 0.0, 2), *deep),
    )
    block = box(
        kind,
        (
            np.linspace(-0.5, 0.5, n + 1),
            np.linspace(0.0, high, int(rng.integers(1, 4)) + 1),
            *[0.2 + 0.6 * line for line in deep],
        ),
    )
    x = block.nodes @ rotation(np.array([0.0, 0.0, 1.0]), tilt)[:d, :d].T
    x[:, 1] += gap - x[:, 1].min()
    nodes = np.concatenate([floor.nodes, x])
    cells = np.concatenate([floor.cells, block.cells + len(floor.nodes)])
    return kind, nodes, cells, np.repeat([1, 2], [len(floor.cells), len(block.cells)])


def thrown(rng: Generator, way: str) -> Scene:
    """A block flies at a floor, flat or a corner first, with a spin."""
    E, nu, rho = 1.0, float(rng.uniform(0.0, 0.4)), 1.0
    strain = log_uniform(rng, 1e-3, 0.05)
    steps, span = steps_of(rng), float(rng.uniform(2.0, 10.0))
    gap = strain * span / steps * rng.uniform(0.0, 2.0)
    tilt = float(rng.choice([0.0, rng.uniform(0, np.pi / 2)]))
    kind, nodes, cells, tags = on_floor(rng, tilt, gap)
    d = nodes.shape[1]
    spin = float(rng.choice([0.0, strain * rng.uniform(-2, 2)]))
    along = float(rng.choice([0.0, strain * rng.uniform(-1, 1)]))
    middle = nodes[np.unique(cells[tags == 2])].mean(axis=0)
    rigid, free = rng.random() < 0.4, rng.random() < 0.5
    held = () if rigid or free else ((lambda x: np.isclose(x[1], -0.5), lambda t: np.zeros(d)),)
    other = float(10 ** rng.uniform(0, 1))
    bodies = {1: (lambda S: vmdg.Rigid()) if rigid else body_of(other, nu), 2: body_of(E, nu)}
    slides = rng.random() < 0.6

    def velocity(x: Array, tag: int) -> Array:
        v = np.zeros_like(x)
        if tag == 2:
            v[0] = along - spin * (x[1] - middle[1])
            v[1] = -strain + spin * (x[0] - middle[0])
        return v

    return Scene(
        way,
        kind,
        nodes,
        cells,
        tags,
        bodies,
        {2: rho} if rigid else {1: rho * log_uniform(rng, 0.3, 3.0), 2: rho},
        {(1, 2): vmdg.Contact(float(rng.choice([0.0, rng.uniform(0.1, 0.8)])))},
        {"sliding": True} if slides else {"gap": "keep"},
        velocity,
        span * np.linspace(0.0, 1.0, steps + 1)[1:],
        scheme_of(rng),
        "finite",
        f"tilt {np.degrees(tilt):.0f}, speed {strain:.2g}, gap {gap:.1e}, "
        f"{'rigid' if rigid else 'free' if free else 'held'} floor, {'sliding' if slides else ''}",
        held=held,
        matching=False,
    )


def slope(rng: Generator, way: str) -> Scene:
    """A block on a slope under its weight: it sticks, slides or tumbles."""
    E, nu, rho, weight = 1.0, float(rng.uniform(0.0, 0.4)), 1.0, log_uniform(rng, 1e-4, 1e-2)
    kind, nodes, cells, tags = on_floor(rng, 0.0, 0.0)
    d, angle = nodes.shape[1], float(rng.uniform(0.0, 0.8))
    gravity = np.zeros(d)
    gravity[:2] = weight * np.sin(angle), -weight * np.cos(angle)
    rigid = rng.random() < 0.5
    held = () if rigid else ((lambda x: np.isclose(x[1], -0.5), lambda t: np.zeros(d)),)
    bodies = {1: (lambda S: vmdg.Rigid()) if rigid else body_of(3.0, nu), 2: body_of(E, nu)}
    friction = float(rng.uniform(0.0, 1.0))
    # To a way of a tenth of the block.
    span = float(min(np.sqrt(0.2 * rho / weight), 40.0)) * rng.uniform(0.3, 1.0)
    start = float(rng.choice([0.0, 0.1 / span * rng.uniform(-1, 1)]))

    def velocity(x: Array, tag: int) -> Array:
        v = np.zeros_like(x)
        v[0] = start * (tag == 2)
        return v

    return Scene(
        way,
        kind,
        nodes,
        cells,
        tags,
        bodies,
        {2: rho} if rigid else {1: rho, 2: rho},
        {(1, 2): vmdg.Contact(friction)},
        {"sliding": True},
        velocity,
        span * np.linspace(0.0, 1.0, steps_of(rng) + 1)[1:],
        scheme_of(rng),
        "finite",
        f"slope {np.tan(angle):.2f}, weight {weight:.1e}, start {start:.1e}, "
        f"{'rigid' if rigid else 'held'} floor",
        gravity=gravity,
        held=held,
        matching=False,
    )


def main(
    count: int = 40, only: int | None = None, first: int = 0, out: str = "results/motions"
) -> list[Outcome]:
    """Run some scenes, or one. Ranks take turns: every scene is one of a single rank.

    Args:
        count: Number of scenes.
        only: Number of the only scene.
        first: Number of the first scene.
        out: Folder for the table and the list of the scenes.
    """
    return run_all(range(first, first + count), judge, "motions", out, only, (*BAD, "stopped"))


if __name__ == "__main__":
    run(main)
