"""Plastic bodies between which bonds fail: bars judged row by row by scalar equations, and cells.

In confined tension bodies and bond are uniform, whatever the cells are. A row follows from the row
before by one implicit step of a point of the bond and of one of the bodies.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.random import Generator
from scipy.optimize import brentq

import vmdg
from parts.stability.cases import (
    FAILING,
    PLANE,
    E,
    block_pair,
    choose,
    described,
    dimension,
    log_uniform,
    opening_scale,
    pulled,
    random_law,
    rollers,
)
from parts.stability.checks import EXACT, Run
from parts.stability.points import Point
from parts.stability.programmes import few_steps, opening, piecewise, stable_law, turning
from parts.stability.scenes import Bond, Case, Support, distorted

#: Plastic strain along a body, of the deviator and of the volume; equivalent back stress; alpha;
#: whether it is at the apex.
History = tuple[float, float, float, float, bool]


class Confined:
    """A plastic body in confined tension, by hand: strain e along it, none across it.

    Args:
        material: Of the body.
        finite: Whether e is that of the first Piola-Kirchhoff stress of finite strain.

    Attributes:
        alpha: Of its history.
        at_apex: Whether it is at the apex of a cone, where it has no stiffness but that of volume.
    """

    def __init__(self, material: vmdg.J2 | vmdg.DruckerPrager, finite: bool):
        self.numbers, self._finite = material.numbers, finite
        mu, lmbda = (self.numbers[name] for name in ("mu", "lmbda"))
        self._G, self._K = mu, lmbda + 2 * mu / 3
        self._cone = (
            (material.eta, material.dilation, material.xi) if "friction" in self.numbers else None
        )
        self._plastic, self._volume, self._back, self.alpha = 0.0, 0.0, 0.0, 0.0
        self.at_apex = False

    def __call__(self, e: float, dt: float) -> float:
        """Stress along the body after a step to e [MPa]."""
        return self._step(e, dt)[0]

    def commit(self, e: float, dt: float) -> None:
        """End the step."""
        _, history = self._step(e, dt)
        self._plastic, self._volume, self._back, self.alpha, self.at_apex = history

    def _step(self, e: float, dt: float) -> tuple[float, History]:
        strain = np.log1p(e) if self._finite else e
        stress, history = (self._metal if self._cone is None else self._soil)(strain, dt)
        return stress / (1 + e) if self._finite else stress, history

    def _yield(self, alpha: float) -> float:
        given = self.numbers
        if isinstance(given.get("hardening"), list):
            return float(np.interp(alpha, *np.transpose(given["hardening"])))
        rise = given.get("saturation", given["yield_stress"]) - given["yield_stress"]
        linear = given["yield_stress"] + given["hardening"] * alpha
        return linear + rise * (1 - np.exp(-given["exponent"] * alpha))

    def _metal(self, strain: float, dt: float) -> tuple[float, History]:
        """q = 2 G strain - 3 G plastic, with a sign."""
        q = 2 * self._G * strain - 3 * self._G * self._plastic
        sign = np.sign(q - self._back)
        C, fades = self.numbers["kinematic"], self.numbers["recovery"]

        def back(x: float) -> float:
            if not fades:
                return self._back + sign * C * x
            return sign * C / fades + (self._back - sign * C / fades) * np.exp(-fades * x)

        def excess(x: float) -> float:
            over = sign * (q - 3 * self._G * sign * x - back(x)) - self._yield(self.alpha + x)
            return over - (self.numbers["rate"] * x / dt if np.isfinite(dt) else 0.0)

        x = 0.0
        if excess(0.0) > 0:
            x = brentq(excess, 0.0, abs(q - self._back) / self._G, xtol=1e-18, rtol=1e-14)
        q -= 3 * self._G * sign * x
        history = self._plastic + sign * x, 0.0, back(x), self.alpha + x, False
        return self._K * strain + 2 / 3 * q, history

    def _soil(self, strain: float, dt: float) -> tuple[float, History]:
        """j = sqrt(3) G |d| with d = 2/3 strain - plastic, p = K (strain - volume)."""
        G, K, (eta, etab, xi) = self._G, self._K, self._cone
        d, volume = 2 / 3 * strain - self._plastic, strain - self._volume
        sign, j, p = np.sign(d), np.sqrt(3) * G * abs(d), K * volume

        def cohesion(alpha: float) -> float:
            return self.numbers["cohesion"] + self.numbers["hardening"] * alpha

        def excess(gamma: float) -> float:
            left = j - G * gamma + eta * (p - K * etab * gamma)
            return left - xi * cohesion(self.alpha + xi * gamma)

        gamma = more = 0.0
        if excess(0.0) > 0:
            gamma = j / G
            if excess(gamma) > 0:

                def apex(more: float) -> float:
                    alpha = self.alpha + xi * gamma + xi / eta * more
                    return p - K * (etab * gamma + more) - xi / eta * cohesion(alpha)

                more = brentq(apex, 0.0, abs(volume), xtol=1e-18, rtol=1e-14)
            else:
                gamma = brentq(excess, 0.0, gamma, xtol=1e-18, rtol=1e-14)
        grown = etab * gamma + more
        plastic = self._plastic + sign * gamma / np.sqrt(3)
        alpha = self.alpha + xi * gamma + xi / eta * more
        history = plastic, self._volume + grown, 0.0, alpha, more > 0
        return p - K * grown + 2 * G * (2 / 3 * strain - plastic), history


def random_metal(rng: Generator, nu: float, stress: float, any_kind: bool) -> vmdg.J2:
    """J2 that flows at ``stress``; at finite strain without back stress."""
    hardening = E * log_uniform(rng, 1e-3, 0.3)
    kind = rng.choice(6 if any_kind else 4)
    if kind == 1:
        options = {
            "hardening": hardening,
            "saturation": stress * rng.uniform(1.1, 2),
            "exponent": 50,
        }
        return vmdg.J2(E, nu, stress, **options)
    if kind == 2:
        table = [(0.0, stress), (0.01, 1.2 * stress), (0.05, 1.5 * stress)]
        return vmdg.J2(E, nu, hardening=table)
    if kind == 3:
        return vmdg.J2(E, nu, stress, hardening=hardening, rate=stress * log_uniform(rng, 1e-2, 10))
    if kind > 3:
        fading = {"recovery": log_uniform(rng, 1, 100)} if kind == 5 else {}
        return vmdg.J2(E, nu, stress, kinematic=hardening, **fading)
    return vmdg.J2(E, nu, stress, hardening=float(rng.choice([0.0, hardening])))


def random_soil(rng: Generator, nu: float, j: float, p: float) -> vmdg.DruckerPrager:
    """A cone that is reached at this j and p [MPa]."""
    friction = rng.uniform(5, 45)
    options = {
        "dilatancy": rng.choice([None, 0.0, rng.uniform(0, friction)]),
        "hardening": float(rng.choice([0.0, E * log_uniform(rng, 1e-3, 0.1)])),
        "fit": str(rng.choice(["compression", "tension", "plane strain"])),
    }
    cone = vmdg.DruckerPrager(E, nu, 1.0, friction, **options)
    return vmdg.DruckerPrager(E, nu, (j + cone.eta * p) / cone.xi, friction, **options)


def random_plastic(rng: Generator, nu: float, tension: float, small: bool) -> vmdg.PointMaterial:
    """A body that flows at this stress of confined tension [MPa]."""
    strain = tension * (1 + nu) * (1 - 2 * nu) / (1 - nu) / E
    q = E / (1 + nu) * strain
    if rng.random() < 0.4:
        return random_soil(rng, nu, q / np.sqrt(3), E / (3 * (1 - 2 * nu)) * strain)
    return random_metal(rng, nu, q, any_kind=small)


def named(material: vmdg.PointMaterial) -> str:
    """What flows, and when."""
    given = {k: v for k, v in material.numbers.items() if k not in ("mu", "lmbda") and v}
    words = [f"{k} {v:.3g}" for k, v in given.items() if isinstance(v, float | int)]
    return f"{type(material).__name__} {', '.join(words)}"


def bars(rng: Generator) -> Case:
    """A bar that flows, whose end opens, closes, presses and holds in few steps."""
    kind, degree = choose(rng, FAILING)
    mesh, tags = block_pair(kind, rng, np.ones(dimension(kind)))
    nu, small = rng.uniform(0.0, 0.4), bool(rng.random() < 0.5)
    K = E * (1 - nu) / (1 + nu) / (1 - 2 * nu)
    law = stable_law(rng, K)
    body = random_plastic(rng, nu, law.strength * rng.uniform(0.2, 1.2), small)
    count = int(rng.integers(2, 7))
    reach = opening(law, K) * log_uniform(rng, 0.5, 2)
    draw = rng.random()
    if draw < 0.3:
        law = vmdg.Bonded() if draw < 0.2 else vmdg.Contact()
    # A contact is pressed first.
    sense = 1.0 if law.strength else -1.0
    way = piecewise(sense * reach * turning(rng, count, rng.choice([0.0, -0.5])))

    def judge(run: Run) -> list[str]:
        def faults(expected: list[float]) -> list[str]:
            # Where a contact opens, nothing is carried.
            size = max([1e-3 * K * reach, *map(abs, expected)])
            for record, T in zip(run.records[1:], expected, strict=False):
                off = np.abs(record.traction[0] - T * np.eye(mesh.d)[0]).max() / size
                if not off < EXACT:
                    return [f"the row at t = {record.t:.6g} is off by {off:.1e}"]
            return []

        point = Point(law, mesh.d) if law.inelastic else None
        one = Confined(body, not small)
        expected, e = [], 0.0
        for before, after in pairwise(run.records):
            dt = (after.t - before.t) or np.inf

            def carried(gap: float, t: float = after.t, dt: float = dt) -> float:
                return one(way(t) - gap, dt)

            T = point.pull(carried, dt) if point else carried(0.0)
            start, e = e, way(after.t) - (point.gap[0] if point else 0.0)
            between = np.array([one(x, dt) for x in np.linspace(start, e, 50)])
            one.commit(e, dt)
            if one.at_apex or (np.diff(between) * np.sign(e - start) < 0).any():
                # Without shear stiffness the cells may take any shape, and a cone that softens, as
                # one without dilatancy may, flows in one part of the bar.
                return faults(expected)
            expected.append(T)
        if found := faults(expected):
            return found
        state = run.problem.body_state(1)
        if (off := np.abs(state.history["alpha"] - one.alpha).max()) > EXACT * max(one.alpha, 1e-3):
            return [f"alpha is off by {off:.1e} of {one.alpha:.1e}"]
        return []

    inputs = {
        "mesh": mesh,
        "tags": tags,
        "materials": {1: body, 2: body},
        "degree": degree,
        "kinematics": "small" if small else "finite",
        "bonds": (Bond(law, (1, 2)),),
        "supports": (
            Support(mesh.side(0, 0), 0.0, 0),
            Support(mesh.side(0, -1), way, 0),
            *rollers(mesh),
        ),
        "loads": few_steps(rng, count),
        "judge": judge,
    }
    bond = described(law) if law.strength else type(law).__name__
    return Case("plastic bars", f"{named(body)}, {count} legs, {bond}", **inputs)


def cells(rng: Generator) -> Case:
    """Two bodies of distorted cells, one or both plastic, whose end goes to random places."""
    kind, degree = choose(rng, {**PLANE, ("tetrahedron", 2): 0.7, ("hexahedron", 2): 0.3})
    mesh, tags = block_pair(kind, rng, np.ones(dimension(kind)))
    small = bool(rng.random() < 0.5)
    law = random_law(rng, E, 1.0)
    draw = rng.random()
    tied = vmdg.Bonded() if draw < 0.2 else vmdg.Contact(0.3) if draw < 0.3 else law
    strength = law.strength
    materials = {}
    for tag in (1, 2):
        nu, share = rng.uniform(0.0, 0.4), rng.uniform(0.3, 1.2)
        materials[tag] = random_plastic(rng, nu, strength * share, small)
    if rng.random() < 0.3:
        materials[int(rng.choice([1, 2]))] = vmdg.NeoHookean(E=E * log_uniform(rng, 1, 10), nu=0.3)
    reach = min(1.5 * opening_scale(law), 0.3)
    inputs = pulled(rng, mesh, tags, materials, (Bond(tied, (1, 2)),), reach)
    planes = np.array([mesh.lines[0][len(mesh.lines[0]) // 2]])
    inputs |= {
        "mesh": distorted(mesh, rng, rng.uniform(0.4, 0.9), planes),
        "degree": degree,
        "kinematics": "small" if small else "finite",
    }
    plastic = [m for m in materials.values() if isinstance(m, vmdg.PointMaterial)]
    bond = described(tied) if tied.strength else type(tied).__name__
    return Case("plastic bodies", f"{' and '.join(map(named, plastic))}, {bond}", **inputs)
