"""Two bodies and an interface, drawn by a number and told in several ways.

Every way of telling a scene (:class:`View`) has the same solution: turned, mirrored, shifted, in
other units, with the sides swapped, by points, as bodies without common nodes; on finer meshes it
has it in the limit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.random import Generator

import vmdg
from parts.stability.cases import E, choose, dimension, log_uniform, opening_scale, random_ogden
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

KINDS = {
    ("triangle", 1): 4,
    ("quadrilateral", 1): 4,
    ("triangle", 2): 2,
    ("quadrilateral", 2): 2,
    ("tetrahedron", 1): 1,
    ("hexahedron", 1): 1,
    ("tetrahedron", 2): 0.3,
    ("hexahedron", 2): 0.2,
}

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
