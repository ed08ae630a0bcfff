"""Random scenes of two bodies and an interface, each judged by the same scene told otherwise.

Every scene has a number that fixes kinematics, cells, degree, bodies, law, how the surfaces meet
and the load. It is turned, mirrored, put into other units, given by points, as two meshes, with its
sides swapped, and on finer meshes: forces and energies must be the same. All checks of the study of
stability hold as well. On several ranks every scene is solved by all of them together and by each
alone.

Forces are compared relative to the largest of the run, energies relative to all that is stored and
dissipated. A scene that is told in another way has the same rows; where rounding has put one more
into a path that bonds make unstable, histories differ by the error of a step.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import cached_property, partial
from time import perf_counter
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.random import Generator
from parts.options import run
from parts.stability.cases import (
    TIED,
    E,
    choose,
    dimension,
    log_uniform,
    opening_scale,
    random_ogden,
)
from parts.stability.checks import EPS, Run, stiffest
from parts.stability.runner import Outcome, execute, run_all, stress
from parts.stability.scenes import (
    Array,
    Bond,
    Case,
    Cells,
    OpenAndTurn,
    Path,
    Predicate,
    Support,
    box,
    legs,
    rotation,
)

import vmdg

#: Powers of (length, stress, load factor) of parameters of laws and materials; 0 of all others.
POWERS = {
    "strength": (0, 1, 0),
    "normal_strength": (0, 1, 0),
    "shear_strength": (0, 1, 0),
    "critical_gap": (1, 0, 0),
    "fracture_energy": (1, 1, 0),
    "normal_energy": (1, 1, 0),
    "shear_energy": (1, 1, 0),
    "viscosity": (-1, 1, 1),
}

#: How the bodies meet; runs take turns.
WAYS = ("matching", "separate", "kept gap", "sliding", "open")

KINDS = {**TIED, ("tetrahedron", 2): 0.3, ("hexahedron", 2): 0.2}

#: Place of the interface along the first axis [mm].
SPLIT = 0.5

#: Of residuals, relative to the largest force.
TOLERANCE = 1e-11

#: Material in units of stress, its axes turned and mirrored with the scene.
Body = Callable[[float, Array], vmdg.Material]


@dataclass(frozen=True)
class View:
    """A way of telling a scene."""

    level: int = 1  # Cells along every edge, relative to the coarsest mesh
    turn: Array | None = None  # Orthogonal matrix (d, d); None for none
    shift: float = 0.0  # Displacement of the whole scene [mm]
    length: float = 1.0  # Unit of length
    stress: float = 1.0  # Unit of stress
    residual: str = "symbolic"  # As for :class:`vmdg.Problem`
    apart: bool = False  # Whether bodies that match share no nodes
    swapped: bool = False  # Whether side 1 is side 2


@dataclass(frozen=True)
class Placed(Cells):
    """A box that has been turned and shifted after it was meshed."""

    turn: Array  # (d, d)
    shift: float  # [mm]

    def side(self, axis: int, end: int) -> Predicate:
        """As of the box at its place."""
        at_home = super().side(axis, end)
        return lambda x: at_home(self.turn.T @ (x[: self.d] - self.shift))


@dataclass(frozen=True)
class Scene:
    """What is drawn."""

    way: str  # One of WAYS
    kind: str  # Cells
    degree: int  # Of the displacement
    bodies: tuple[Body, Body]  # Side 1 (along the first axis) and side 2
    law: vmdg.Law  # Of the interface
    what: str  # Description of the rest
    counts: tuple[int, int, int]  # Cells along x of a body, across it in body 1, in body 2
    # Offset of the interface at y in body 1 and in body 2 [mm]
    bumps: tuple[Callable[[Array], Array], Callable[[Array], Array]]
    ends: tuple[float, float]  # Of body 2 along y [mm]
    far: float  # End of body 2 along x [mm]
    gap: float  # Between the bodies; negative for an overlap [mm]
    inner: float  # Radius of the near end [mm]
    # held, led: Displacements of the two ends; ``led`` is None where body 2 is held at its side and
    # drawn by ``traction``
    held: OpenAndTurn | None
    led: Path | OpenAndTurn | None
    traction: Path | None  # On the far end [MPa]
    loads: Array  # Load factors
    strain: Array | None  # Eigenstrain of body 2 at the last load; None for none
    kinematics: str
    form: Mapping[str, Any] = field(default_factory=dict)  # Options of the problem
    slides: bool = False  # Whether the surfaces slide
    keeps: str | None = None  # ``gap`` of the interface

    @property
    def d(self) -> int:
        """Dimension."""
        return dimension(self.kind)

    @property
    def axisymmetric(self) -> bool:
        """Whether it is a half section."""
        return self.form.get("symmetry") is not None

    @property
    def plane(self) -> bool:
        """Whether the surfaces coincide, whatever their meshes are."""
        y = np.linspace(0, 1, 9)
        return self.gap == 0 and all(np.ptp(np.diff(bump(y))) < 1e-12 for bump in self.bumps)

    def case(self, view: View = View()) -> Case:
        """The scene as it is told."""
        d, n = self.d, view.level
        turn = np.eye(d) if view.turn is None else view.turn
        along, *across = (n * count for count in self.counts)
        deep = [np.linspace(0.0, 0.5, n + 1)] * (d - 2)
        lines = [
            (self.inner + np.linspace(*x, along + 1), np.linspace(*y, count + 1), *deep)
            for x, y, count in (
                ((0, SPLIT), (0, 1), across[0]),
                ((SPLIT, self.far), self.ends, across[1]),
            )
        ]
        blocks = [box(self.kind, line) for line in lines]
        tags = np.repeat([1, 2], [len(block.cells) for block in blocks])
        near = self.inner + SPLIT
        on = [np.isclose(block.nodes[:, 0], near) for block in blocks]
        for block, bump in zip(blocks, self.bumps, strict=True):
            x, y = block.nodes[:, 0] - near, block.nodes[:, 1]
            block.nodes[:, 0] += (1 - np.abs(x) / np.abs(x).max()) * bump(y)
        blocks[1].nodes[:, 0] += self.gap
        blocks[1].lines[0][:] += self.gap
        mesh = joined(*blocks)
        shares = self.way == "matching" and not view.apart
        nodes, cells = mesh.nodes, mesh.cells
        if shares:
            first, second = (np.flatnonzero(one) for one in on)
            number = np.arange(len(nodes))
            number[len(blocks[0].nodes) + second] = first
            kept, cells = np.unique(number[cells], return_inverse=True)
            nodes, cells = nodes[kept], cells.reshape(mesh.cells.shape)
        sides = [np.append(on[0], 0 * on[1]) > 0, np.append(0 * on[0], on[1]) > 0]
        length, stress = view.length, view.stress
        placed = Placed(
            self.kind,
            length * nodes @ turn.T + view.shift,
            cells,
            tuple(length * line for line in mesh.lines),
            turn,
            view.shift,
        )
        order = (-1) ** view.swapped
        bond = Bond(
            scaled_law(self.law, np.array([length, stress, 1.0])),
            (1, 2) if shares else None,
            slides=self.slides,
            gap=self.keeps,
            surfaces=None if shares else tuple(sides[::order]),
        )
        materials = {tag: body(stress, turn) for tag, body in enumerate(self.bodies, 1)}
        strained = 2
        if shares and view.swapped:
            tags, strained = 3 - tags, 1
            materials = {3 - tag: material for tag, material in materials.items()}

        def moved(motion: Path | OpenAndTurn | None) -> Any:
            if isinstance(motion, OpenAndTurn):
                return lambda x, t: (
                    length * turn @ motion(turn.T @ (x[:d] - view.shift) / length, t)
                )
            return (lambda t: length * turn @ motion(t)) if motion else 0.0

        supports = [Support(placed.side(0, 0), moved(self.held))]
        if self.led is None:
            top, low = placed.side(1, -1), length * (near + self.gap / 2)

            def side_of_body_2(x: Array) -> Array:
                return top(x) & ((turn.T @ (x[:d] - view.shift))[0] > low)

            supports.append(Support(side_of_body_2, 0.0))
        else:
            supports.append(Support(placed.side(0, -1), moved(self.led)))
        wide, end = np.eye(3), self.loads[-1]
        wide[:d, :d] = turn
        strain = None
        if self.strain is not None:
            strain = {strained: lambda t: t / end * wide @ self.strain @ wide.T}
        options = vmdg.SolveOptions(relative_tolerance=TOLERANCE)
        return Case(
            self.way,
            self.what,
            placed,
            tags,
            materials,
            (bond,),
            tuple(supports),
            self.loads,
            traction=self.traction and (lambda t: stress * turn @ self.traction(t)),
            degree=self.degree,
            kinematics=self.kinematics,
            symmetry=self.form.get("symmetry"),
            eigenstrain=strain,
            options=options,
            form={"residual": view.residual}
            | {name: value for name, value in self.form.items() if name != "symmetry"},
        )


def scaled_law(law: vmdg.Law, units: Array) -> vmdg.Law:
    """The law in other units; parameters that vary are functions of the place."""
    changes = {}
    for one in fields(law):
        value, factor = getattr(law, one.name), np.prod(units ** POWERS.get(one.name, (0, 0, 0)))
        if callable(value):
            changes[one.name] = lambda x, f=value, factor=factor: factor * f(x / units[0])
        elif factor != 1:
            changes[one.name] = factor * value
    return replace(law, **changes)


def joined(first: Cells, second: Cells) -> Cells:
    """Both, without common nodes."""
    lines = zip(first.lines, second.lines, strict=True)
    return Cells(
        first.kind,
        np.concatenate([first.nodes, second.nodes]),
        np.concatenate([first.cells, second.cells + len(first.nodes)]),
        tuple(np.unique(np.concatenate(pair)) for pair in lines),
    )


def random_body(rng: Generator, name: str, modulus: float, mean: bool) -> Body:
    """A material by its name."""
    nu = 0.495 if mean else rng.uniform(0.1, 0.4)
    if name == "Ogden":
        given = random_ogden(rng, modulus).parameters
        c, m = ([given[f"{letter}{i}"] for i in (1, 2, 3)] for letter in "cm")
        kappa = given["kappa"]
        return lambda s, Q: vmdg.Ogden(c=s * np.array(c), m=m, kappa=s * kappa)
    if name == "Orthotropic":
        E3 = modulus * np.array([rng.uniform(2, 8), 1.0, 1.0])
        G, angle = modulus * rng.uniform(0.3, 0.6, 3), rng.uniform(-np.pi / 2, np.pi / 2)
        axis = np.array([np.cos(angle), np.sin(angle)])

        def ply(s: float, Q: Array) -> vmdg.Material:
            x, y = Q[:2, :2] @ axis
            degrees = float(np.degrees(np.arctan2(y, x)))
            return vmdg.Orthotropic(E=s * E3, nu=(0.3, 0.3, 0.3), G=s * G, angle=degrees)

        return ply
    if name == "J2":
        limit, slope = modulus * log_uniform(rng, 2e-3, 2e-2), modulus * rng.uniform(0.02, 0.2)
        return lambda s, Q: vmdg.J2(s * modulus, nu, s * limit, hardening=s * slope)
    return lambda s, Q: vmdg.NeoHookean(E=s * modulus, nu=nu)


def random_bond(rng: Generator) -> vmdg.Law:
    """A bond that breaks stably between bodies of size 1 and modulus E."""
    strength = E * log_uniform(rng, 1e-3, 1e-2)
    gap = strength / E * log_uniform(rng, 3, 10)
    mu, unloading = float(rng.choice([0.0, 0.4])), str(rng.choice(["plastic", "secant"]))
    if rng.random() < 0.3:
        energy = strength * gap / 2
        shear, more = strength * rng.uniform(0.7, 2), energy * rng.uniform(1, 4)
        return vmdg.MixedModeDebonding(strength, shear, energy, more, mu, unloading=unloading)
    return vmdg.Debonding(strength, gap, mu, unloading=unloading)


def _described(law: vmdg.Law) -> str:
    """The law by its numbers."""
    values = {name: value for name, value in vars(law).items() if value not in (None, 0.0)}
    numbers = (f"{v:.2g}" if isinstance(v, float) else str(v) for v in values.values())
    return f"{type(law).__name__} {' '.join(numbers)}"


def _path(rng: Generator, load: str, d: int, reach: float, press: float) -> Path:
    """Way of the led end: out along x, or in along x and then across."""
    shear = np.zeros(d)
    shear[1] = reach * rng.choice([1, -1])
    if d == 3:
        shear[2] = reach * rng.uniform(-0.5, 0.5)
    out, into = reach * np.eye(d)[0], -press * np.eye(d)[0]
    points = {
        "opening": [out + 0.1 * shear, 0 * out, 0.5 * out],
        "shear": [shear, -0.5 * shear],
        "pressing": [into, into + 0.3 * shear],
        "sliding": [into, into + shear, into - shear],
    }[load]
    return Path(np.vstack([0 * out, *points]))


def draw(number: int) -> Scene:
    """The scene of a number."""
    rng = np.random.default_rng(number)
    way = WAYS[number % len(WAYS)]
    kind, degree = choose(rng, KINDS)
    d = dimension(kind)
    kinematics = str(rng.choice(["finite", "small"], p=[0.7, 0.3]))
    feature = str(
        rng.choice(["", "mean", "eigenstrain", "axisymmetric", "generalized strain", "stress"])
    )
    if feature == "mean" and (degree == 2 or kind in ("triangle", "tetrahedron")):
        feature = ""
    if d == 3 and feature in ("axisymmetric", "generalized strain", "stress"):
        feature = ""
    if way == "open" and feature == "axisymmetric":
        feature = ""
    names = ["NeoHookean", "Ogden", "Orthotropic", "J2"]
    allowed = names[:1] if (d == 3 and degree == 2) or feature == "mean" else names
    if feature in ("stress", "axisymmetric"):
        allowed = ["NeoHookean", "J2"]
    other = str(rng.choice(allowed))
    contrast = float(rng.choice([1.0, log_uniform(rng, 0.1, 10), 1e4]))
    mean = feature == "mean"
    bodies = (
        random_body(rng, "NeoHookean", E * contrast, mean),
        random_body(rng, other, E, mean),
    )
    friction = float(rng.choice([0.0, 0.3]))
    law = {
        "matching": lambda: vmdg.Bonded() if rng.random() < 0.3 else random_bond(rng),
        "separate": lambda: vmdg.Bonded() if rng.random() < 0.4 else random_bond(rng),
        "sliding": lambda: random_bond(rng) if rng.random() < 0.4 else vmdg.Contact(friction),
    }.get(way, lambda: vmdg.Contact(friction))()
    if way == "matching" and rng.random() < 0.2:
        law = vmdg.Contact(friction)
    loads = ["opening", "shear", "pressing", "sliding"]
    loads += ["turning"] if kinematics == "finite" and feature != "axisymmetric" else []
    if isinstance(law, vmdg.Contact):
        loads = ["pressing", "sliding"]
    load = str(rng.choice(loads))
    slides = way == "sliding" or (way == "open" and rng.random() < 0.7)
    n = int(rng.integers(3, 5)) if d == 2 else 3
    counts = (2, n, n) if way == "matching" else (2, n, int(rng.choice([n - 1, n + 1, n + 2])))
    shape = str(rng.choice(["plane", "inclined", "curved"], p=[0.4, 0.3, 0.3]))
    height = rng.uniform(-0.25, 0.25) if shape == "inclined" else rng.uniform(0.01, 0.06)
    if load == "sliding" and shape == "inclined":
        shape = "plane"

    def bump(y: Array) -> Array:
        if shape == "inclined":
            return height * (y - 0.5)
        return height * np.sin(np.pi * y) if shape == "curved" else 0 * y

    ends, far, gap, bumps = (0.0, 1.0), 1.0, 0.0, (bump, bump)
    if way in ("kept gap", "sliding"):
        gap = float(rng.choice([0.0, 0.01, 0.1, -0.005]))
        gap = 0.0 if law.has_bond else gap
        ends = (0.25, 0.75) if way == "sliding" or rng.random() < 0.5 else ends
    reach = 1.5 * opening_scale(law) if law.has_bond else 0.1
    reach = 0.02 if isinstance(law, vmdg.Bonded) else reach
    path: Path | OpenAndTurn | None = None
    held = traction = None
    steps = int(rng.integers(3, 6))
    if way == "open":
        tilt, gap = float(rng.choice([0.0, rng.uniform(0, 60)])), 0.02
        slope = np.tan(np.radians(tilt))
        far, bumps = 1.0 + slope, (lambda y: 0 * y, lambda y: slope * y)
        pulls = np.zeros(d)
        pulls[0], pulls[1] = rng.uniform(0.2, 1.0), rng.uniform(-1.0, 1.0)
        traction, points, load = Path(np.vstack([0 * pulls, pulls])), 2, f"open, {tilt:.0f} degrees"
    elif load == "turning":
        axis, angle = np.array([0.0, 0.0, 1.0]), rng.uniform(-1.5, 1.5)
        move = reach * rng.uniform(-0.5, 1.0, d)
        move[0] = abs(move[0])
        held, path, points = OpenAndTurn(0 * move, axis, angle), OpenAndTurn(move, axis, angle), 3
    else:
        path = _path(rng, load, d, reach, rng.uniform(0.005, 0.02) + max(gap, 0.0))
        points = len(path.points)
    strain = None
    if feature == "eigenstrain":
        strain = rng.uniform(-1, 1, (3, 3)) if rng.random() < 0.5 else np.eye(3)
        strain = 3e-3 * (strain + strain.T) / 2
        strain[:2, 2] = strain[2, :2] = 0
    form: dict[str, Any] = {}
    form |= {"volumetric": "mean"} if mean else {}
    form |= {"symmetry": "axisymmetric"} if feature == "axisymmetric" else {}
    form |= {"plane": feature} if feature in ("generalized strain", "stress") else {}
    keeps = "keep" if way in ("kept gap", "open") or slides else None
    what = ", ".join(
        [
            *(way, f"{load} in {steps}", f"{feature or 'no feature'}"),
            f"NeoHookean x {contrast:.2g} on {other}, {_described(law)}",
            *(f"{shape} {height:.2g}" if shape != "plane" else "plane", f"facets {counts[1:]}"),
            *(f"gap {gap:g}", f"y {ends}", "slides" if slides else "stays"),
        ]
    )
    return Scene(
        *(way, kind, degree, bodies, law, what, counts, bumps, ends, far, gap),
        inner=0.5 if feature == "axisymmetric" else 0.0,
        held=held,
        led=path,
        traction=traction,
        loads=legs(points - 1, steps),
        strain=strain,
        kinematics=kinematics,
        form=form,
        slides=slides,
        keeps=keeps,
    )


def turns(scene: Scene, rng: Generator) -> dict[str, Array]:
    """Orthogonal matrices that a scene may be turned and mirrored by."""
    d = scene.d
    mirror = np.diag([1.0, -1.0, 1.0][:d])
    if scene.axisymmetric:
        return {"mirrored": mirror}
    quarter, any_ = (rotation(np.array([0.0, 0.0, 1.0]), a)[:d, :d] for a in (np.pi / 2, 0.7))
    quarter = np.round(quarter)
    if d == 3 and "Orthotropic" not in scene.what:
        axis = rng.normal(size=3)
        any_ = rotation(axis / np.linalg.norm(axis), 0.7)
    return {"mirrored": mirror, "turned by 90": quarter, "turned": any_}


#: Ways that differ by rounding and by the residuals that are left, a thousandth of this.
SAME = 1e-8

#: Ranks: sums in another order.
RANKS = 1e-9

#: Ways that differ by the rows of the path.
ROWS = 2e-2

#: Side 1 of surfaces that do not coincide: pressures meet the normals of side 1, an error of second
#: order in the angle between the surfaces; edges of a body that slides. More is right where it
#: vanishes on a finer mesh.
SIDE = 0.03

#: Change of the forces by a finer mesh that need not be smaller than the change before: where that
#: is small by chance.
MESH = 0.05

#: Energy of a body next to an open interface; of a row that is lost or gained, of all that is
#: stored and spent; work of the reactions against the one reported.
NEAR, IMBALANCE, WORK = 0.01, 0.02, 0.01


@dataclass(frozen=True)
class Told:
    """Rows at the given load factors in units of 1, at home."""

    forces: Array  # Reactions of all supports (n, m) [N]
    energies: Array  # Stored, damage, friction, plastic, external (n, 5) [N mm]
    rows: list[float]  # Load factors of all rows
    residuals: int  # Assembled by the solver
    stopped: str  # Message of the error that ended the run
    run: Run | None = None  # None where it was refused

    @classmethod
    def of(cls, run: Run, scene: Scene, view: View) -> Told:
        """The rows of a run."""
        rows = [record.t for record in run.records]
        given = [run.records[rows.index(t)] for t in run.case.loads if t in rows]
        power = 2 if scene.d == 3 or scene.axisymmetric else 1
        force = view.stress * view.length**power
        turn = np.eye(scene.d) if view.turn is None else view.turn
        forces = [np.concatenate([turn.T @ f for f in r.reactions]) / force for r in given]
        energies = [
            np.array([e.stored, e.damage, e.friction, e.plastic, e.external])
            / (force * view.length)
            for e in (record.energy for record in given)
        ]
        return cls(np.array(forces), np.array(energies), rows, run.residuals, run.stopped, run)

    @cached_property
    def rounded(self) -> tuple[float, float]:
        """What rounding may do to forces, over the largest, and to energies, over their size; of a
        run on one rank."""
        run = self.run
        if run is None:
            return 0.0, 0.0
        size = max(record.energy.stored + record.energy.dissipated for record in run.records)
        # W is the difference of numbers of the size of the moduli.
        of_W = EPS * stiffest(run) * run.reach**run.case.mesh.d / size
        return 10 * run.rounding / run.force, of_W

    def same_rows(self, other: Told) -> bool:
        """Whether both have gone by the same load factors."""
        return len(self.rows) == len(other.rows) and np.allclose(self.rows, other.rows, 0, SAME)

    def differs(self, other: Told) -> tuple[float, float]:
        """Largest difference of forces and of energies, over their sizes in this one."""
        n = min(len(self.forces), len(other.forces))
        if n == 0:
            return 0.0, 0.0
        force, energy = np.abs(self.forces).max(), np.abs(self.energies[:, :4]).sum(axis=1).max()
        return (
            float(np.abs(self.forces[:n] - other.forces[:n]).max() / force),
            float(np.abs(self.energies[:n] - other.energies[:n]).max() / energy),
        )


def told(scene: Scene, view: View, comm: MPI.Comm = MPI.COMM_SELF) -> Told:
    """A scene run as it is told; no rows where it is refused."""
    try:
        return Told.of(execute(scene.case(view), comm), scene, view)
    except ValueError as error:
        return Told(np.zeros((0, 1)), np.zeros((0, 5)), [], 0, str(error))


def views(scene: Scene, number: int) -> dict[str, tuple[View, float]]:
    """Ways in which the solution is the same, and by how much it may differ."""
    rng = np.random.default_rng([number, 1])
    length, stress = 2.0 ** rng.integers(-12, 12, 2)
    found = {"other units": (View(length=float(length), stress=float(stress)), 0.0)}
    for name, turn in turns(scene, rng).items():
        shift = 0.0 if scene.axisymmetric else 0.3
        found[name] = View(turn=turn, shift=shift), SAME
    if scene.way == "matching":
        found["points"] = View(residual="points"), SAME
        found["apart"] = View(apart=True), SAME
    same = scene.way == "matching" or (scene.plane and not scene.slides)
    found["sides swapped"] = View(swapped=True), SAME if same else SIDE
    return found


def fault(name: str, one: Told, other: Told, allowed: float) -> str:
    """What is wrong with another way of telling a scene; empty if nothing is.

    Args:
        name: Of the way.
        one, other: The scene at home and told in this way.
        allowed: Difference, rounding apart; 0 if all digits are to be equal.
    """
    if bool(one.stopped) != bool(other.stopped):
        return f"{name}: stopped, {one.stopped or other.stopped}"
    force, energy = one.differs(other)
    if not one.same_rows(other):
        if allowed == 0:
            return f"{name}: {len(other.rows)} rows for {len(one.rows)}, or at other loads"
        allowed = max(allowed, ROWS)
    if allowed == 0 and one.residuals != other.residuals:
        return f"{name}: {other.residuals} residuals for {one.residuals}"
    of_force, of_energy = one.rounded if allowed > 0 else (0.0, 0.0)
    allowed += of_force
    if force <= allowed and energy <= allowed + of_energy:
        return ""
    rows = f"{len(one.rows)} and {len(other.rows)} rows"
    return f"{name}: forces differ by {force:.1e}, energies by {energy:.1e}, {rows}"


def settles(
    scene: Scene, coarse: Told, told: Callable[[Scene, View], Told] = told
) -> tuple[str, float]:
    """Whether forces settle as the mesh gets finer, and how much they change at first."""
    meshes, changes = [coarse], []
    for level in finer(scene):
        meshes.append(told(scene, View(level=level)))
        if meshes[-1].stopped:
            return f"finer: stopped, {meshes[-1].stopped}", max(changes, default=0.0)
        changes.append(meshes[-1].differs(meshes[-2])[0])
        if len(changes) > 1 and changes[-1] <= max(changes[-2], MESH):
            return "", changes[0]
    shown = ", then by ".join(f"{change:.1e}" for change in changes)
    return f"finer: forces change by {shown}" if changes else "", max(changes, default=0.0)


def swapped_settles(scene: Scene, here: Told, other: Told) -> bool:
    """Whether sides differ on a finer mesh by half of what they do here at most, in all: two or
    three facets along a curve are far from where the error is one of second order, and under the
    edge of a body that slides, where stresses are singular, it falls like a root of h."""
    for level in finer(scene) or (2,):
        fine = [told(scene, View(level=level, swapped=swapped)) for swapped in (False, True)]
        if here.stopped or other.stopped or fine[0].stopped or fine[1].stopped:
            return False
        if max(fine[0].differs(fine[1])) <= max(here.differs(other)) / 2:
            return True
    return False


def finer(scene: Scene) -> tuple[int, ...]:
    """Levels of finer meshes, see :class:`View`."""
    return (2, 4, 8) if scene.d == 2 else (2, 3) if scene.degree == 1 else ()


def open_faults(case: Case, run: Run) -> str:
    """Whether a body behaves next to an open interface as if there were none."""
    if any(np.abs(T).max() > 0 for record in run.records for T in record.traction if T.size):
        return ""
    free = execute(replace(case, bonds=()))
    here, there = (each.records[-1].energy.stored for each in (run, free))
    if abs(here - there) <= NEAR * there:
        return ""
    return f"open: strain energy {here / there:.4f} of that without an interface"


def own_faults(scene: Scene, run: Run) -> list[str]:
    """Energies of the rows: their balance, and the work of the supports.

    In a step in which the reactions change by dR, in whatever order, the mean of both ends misses
    dR.du/2 of the work at most.
    """
    found, work, kinks = [], 0.0, 0.0
    size = max(record.energy.stored + record.energy.dissipated for record in run.records)
    before = run.records[0]
    values = run.problem.loading.prescribed_values
    for record in run.records[1:]:
        energy = record.energy
        yielded = energy.plastic > 0  # where in a step bodies begin to flow, nothing says
        if abs(energy.imbalance) > IMBALANCE * size and not found and not yielded:
            share = energy.imbalance / size
            found.append(f"imbalance {share:.1e} at t = {record.t:.3g}")
        moved = values(record.t) - values(before.t)
        first, last = (each.forces[record.prescribed] for each in (before, record))
        work += (first + last) @ moved / 2
        kinks += np.abs(last - first) @ np.abs(moved) / 2
        off, before = abs(work - energy.external), record
        if scene.strain is None and scene.traction is None and off > WORK * size + kinks:
            return [*found, f"external off the work of the supports by {off / size:.1e}"]
    return found


def balance_settles(scene: Scene, run: Run) -> bool:
    """Whether the imbalance where surfaces slide is half as large on a mesh twice as fine, at most:
    curves of two or three facets are rough, and pairs have no energy of their own."""

    def largest(run: Run) -> float:
        energies = [record.energy for record in run.records]
        size = max(energy.stored + energy.dissipated for energy in energies)
        return max(abs(energy.imbalance) for energy in energies) / size

    fine = execute(scene.case(View(level=2)))
    return scene.slides and not fine.stopped and largest(fine) <= largest(run) / 2


def judged(number: int) -> Case:
    """Case of a number with all that it is compared with."""
    scene = draw(number)
    case = scene.case()

    def judge(run: Run) -> list[str]:
        found = own_faults(scene, run)
        if any("imbalance" in text for text in found) and balance_settles(scene, run):
            found = [text for text in found if "imbalance" not in text]
        here = Told.of(run, scene, View())
        if run.stopped:
            return found
        settled, change = settles(scene, here)
        for name, (view, allowed) in views(scene, number).items():
            if allowed == SIDE:
                allowed = max(SIDE, change)
            other = told(scene, view)
            wrong = fault(name, here, other, allowed)
            vanishes = wrong and allowed >= SIDE and swapped_settles(scene, here, other)
            found.append("" if vanishes else wrong)
        found.append(settled)
        if scene.way == "open":
            found.append(open_faults(case, run))
        return [text for text in found if text]

    return replace(case, judge=judge)


def numbers(each: int, first: int = 0) -> range:
    """Numbers of some scenes of every way."""
    return range(first, first + each * len(WAYS))


def ranks(number: int) -> Outcome:
    """A scene solved by all ranks together and by every rank alone; collective."""
    start, scene = perf_counter(), draw(number)
    case = scene.case()
    together, alone = (told(scene, View(), comm) for comm in (MPI.COMM_WORLD, MPI.COMM_SELF))
    faults = MPI.COMM_WORLD.allgather(fault("ranks", alone, together, RANKS))
    found = "; ".join(sorted(set(filter(None, faults))))
    verdict = "wrong" if found else "stopped" if alone.stopped else "correct"
    work = len(alone.rows) - 1, 0, alone.residuals, perf_counter() - start
    return Outcome(number, case.family, verdict, *work, str(case), found or alone.stopped)


#: Seconds for a scene with all that it is compared with.
PATIENCE = 1800


def main(
    each: int = 40, only: int | None = None, first: int = 0, out: str = "results/interfaces"
) -> list[Outcome]:
    """Run some of every way in which the bodies meet, or one scene.

    Args:
        each: Scenes of every way.
        only: Number of the only scene.
        first: Number of the first scene, a multiple of 5.
        out: Folder for the table and the list of the scenes.
    """
    together = MPI.COMM_WORLD.size > 1
    judge = ranks if together else partial(stress, patience=PATIENCE, draw=judged)
    return run_all(numbers(each, first), judge, "interfaces", out, only, together=together)


if __name__ == "__main__":
    run(main)
