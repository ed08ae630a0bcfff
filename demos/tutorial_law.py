"""Tutorial: your own interface law. Delamination with fibre bridging, softening in two lines.

Behind the tip of a delamination fibres still bridge the crack: after the steep softening of the
matrix a small traction remains over a large opening. The law is written here, checked without a
mesh, and used in a double cantilever beam, whose resistance rises while the bridges build up.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import vmdg
from vmdg.laws import RadialLaw
from vmdg.meshes import beams
from vmdg.meshes.beams import INTERFACE, LOWER_LEFT, RIGHT, UPPER_LEFT
from vmdg.plot import curve, profile, stress

# 1. The law. `RadialLaw` is for laws with one softening curve R(x) for all directions: x is the
# length of the inelastic gap, R the traction the bond still carries. It brings the return map, its
# tangent, contact, friction, viscosity and energies; a law without such a curve would derive from
# `vmdg.Law` and write `return_map`. Four functions of the curve are left to write, vectorized over
# points. The history of a point is R, so the curve must fall everywhere. `critical_gap` and
# `softening_modulus` are the names that other laws use.


@dataclass(frozen=True)
class BridgedDebonding(RadialLaw):
    """R falls from `strength` to `bridging` at x = `knee`, and from there to 0 at `critical_gap`.

    Attributes:
        strength: Traction at which damage starts [MPa].
        bridging: Traction of the bridges at the knee [MPa].
        knee: Gap at which the matrix is broken [mm].
        critical_gap: Gap at which the last bridge is broken [mm].
        friction: Coulomb coefficient.
        viscosity: Overstress per rate of the gap [MPa s/mm].
    """

    strength: float
    bridging: float
    knee: float
    critical_gap: float
    friction: float = 0.0
    viscosity: float = 0.0

    def __post_init__(self) -> None:
        first, second = self.slopes
        if not (first > second > 0 and 0 < self.bridging and 0 < self.knee < self.critical_gap):
            raise ValueError(f"{self}: the curve must fall, steeply first; check bridging and knee")

    @property
    def slopes(self) -> tuple[float, float]:
        """Slopes of both lines, positive [MPa/mm]."""
        tail = self.bridging / (self.critical_gap - self.knee)
        return (self.strength - self.bridging) / self.knee, tail

    @property
    def softening_modulus(self) -> float:
        """The steepest slope [MPa/mm]; vmdg checks that the mesh is fine enough for it."""
        return self.slopes[0]

    @property
    def energy(self) -> float:
        """Area under the curve [N/mm]."""
        return (self.strength * self.knee + self.bridging * self.critical_gap) / 2

    def gap_at(self, resistance: NDArray) -> NDArray:
        """Gap x at which the resistance is R [mm]."""
        gaps = [self.critical_gap, self.knee, 0.0]
        return np.interp(resistance, [0.0, self.bridging, self.strength], gaps)

    def slip(self, load: NDArray, resistance: NDArray, stiffness: NDArray) -> NDArray:
        """How far the gap grows: the root s of load - stiffness s = R(x + s) [mm].

        R is the largest of three falling lines, so s is the smallest of their roots.
        """
        x, (first, second) = self.gap_at(resistance), self.slopes
        roots = [
            (load - self.strength + first * x) / (stiffness - first),
            (load - second * (self.critical_gap - x)) / (stiffness - second),
            load / stiffness,
        ]
        return np.min(roots, axis=0)

    def soften(self, resistance: NDArray, slip: NDArray) -> tuple[NDArray, NDArray]:
        """R [MPa] after ``slip``, and the slope there [MPa/mm]."""
        x = self.gap_at(resistance) + slip
        curve = [self.strength, self.bridging, 0.0]
        slope = np.select([x < self.knee, x < self.critical_gap], [-s for s in self.slopes], 0.0)
        return np.interp(x, [0.0, self.knee, self.critical_gap], curve), slope

    def slip_to(self, resistance: NDArray, target: NDArray) -> NDArray:
        """How far the gap grows until R has fallen to ``target`` [mm]."""
        return np.maximum(self.gap_at(target) - self.gap_at(resistance), 0.0)

    def bond_energy(self, resistance: NDArray) -> NDArray:
        """Area under the rest of the curve [N/mm]."""
        x, low = self.gap_at(resistance), np.minimum(resistance, self.bridging)
        head = (resistance + self.bridging) * np.maximum(self.knee - x, 0.0)
        return (head + low * (self.critical_gap - np.maximum(x, self.knee))) / 2


# 2. Checks, without a mesh: laws need numpy only. `return_map` takes trial traction T_tr, normal,
# gap, history Q = strength - R and penalty r of all points, and gives traction, new gap, Q and the
# tangent d gap / d T_tr, on which the quadratic convergence of Newton's method depends.


def tangent_error(law: BridgedDebonding, points: int = 2000) -> float:
    """Largest error of r times the tangent against central differences, away from kinks [-]."""
    random = np.random.default_rng(0)
    r, h = 5 * law.softening_modulus, 1e-6 * law.strength
    trial, normal = random.normal(scale=law.strength, size=(2, points, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    gap = random.uniform(0, law.critical_gap / 4, (points, 1)) * normal
    softening = random.uniform(0, law.strength, points)

    def update(trial: NDArray) -> vmdg.laws.Update:
        return law.return_map(trial, normal, gap, softening, r)

    exact, error = update(trial), np.zeros(points)
    smooth = np.ones(points, dtype=bool)
    for j, axis in enumerate(np.eye(3)):
        ends = update(trial + h * axis), update(trial - h * axis)
        difference = (ends[0].gap - ends[1].gap) / (2 * h)
        error = np.maximum(error, r * np.abs(difference - exact.tangent[:, :, j]).max(axis=1))
        for end in ends:  # the derivative does not exist where the branch of the law changes
            sides = [u.softening > law.strength - law.bridging for u in (end, exact)]
            smooth &= (end.mode == exact.mode) & (sides[0] == sides[1])
    return float(error[smooth].max())


def dissipation(law: BridgedDebonding, steps: int) -> float:
    """Damage work [N/mm] until the bond is broken, opened in equal steps."""
    r, normal = 5 * law.softening_modulus, np.array([[1.0, 0.0]])
    gap, softening, work = np.zeros((1, 2)), np.zeros(1), 0.0
    for opening in np.linspace(0, 2 * law.critical_gap, steps + 1)[1:]:
        update = law.return_map(r * (opening * normal - gap), normal, gap, softening, r)
        gap, softening, work = update.gap, update.softening, work + update.damage_work[0]
    return float(work)


# 3. Use it like any other law: here in a double cantilever beam, compared with a linear law of
# the same energy.


def peel(law: vmdg.Law, steps: int, opening: float) -> tuple[vmdg.Problem, vmdg.History]:
    """Pull the ends of both arms apart, by ``opening`` [mm] in all."""
    mesh, cells, facets = beams(stations=(0, 10, 40), divisions=(10, 60), precrack=10, rows=2)
    interface = vmdg.Interface(facets.find(INTERFACE), law=law)
    arms = vmdg.NeoHookean(E=50e3, nu=0.3)
    problem = vmdg.Problem(mesh, cells, {1: arms, 2: arms}, [interface])
    problem.dirichlet(facets.find(RIGHT), 0.0)
    upper = facets.find(UPPER_LEFT)
    problem.dirichlet(upper, lambda t: t / 2, "y")
    problem.dirichlet(facets.find(LOWER_LEFT), lambda t: -t / 2, "y")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        gap, traction = (profile(problem, 0, name, "x")[0][0, 1] for name in ("gap", "traction"))
        row = {"opening [mm]": problem.t, "force [N]": problem.reaction(upper)[1]}
        return row | {"gap [mm]": gap, "traction [MPa]": traction}

    loads = np.linspace(0, opening, steps + 1)[1:]
    options = vmdg.SolveOptions(relative_tolerance=1e-8, energy=True, progress=True)
    return problem, vmdg.solve(problem, loads, options, monitor).history


def main(
    steps: int = 40, opening: float = 3.0, out: str = "results/tutorial_law"
) -> dict[str, vmdg.History]:
    """Check the law, then peel with it and without bridges; the history of both."""
    bridged = BridgedDebonding(strength=30.0, bridging=3.0, knee=0.02, critical_gap=0.3)
    same = vmdg.Debonding(strength=30.0, critical_gap=2 * bridged.energy / 30.0)
    laws = {"with bridges": bridged, "one line, same energy": same}
    print(f"tangent off by {tangent_error(bridged):.1e}")
    print(f"dissipation {dissipation(bridged, 50):.6f}, closed form {bridged.energy:.6f} N/mm")
    runs = {name: peel(law, steps, opening) for name, law in laws.items()}
    histories = {name: history for name, (_, history) in runs.items()}
    figure = picture(bridged, runs["with bridges"][0], histories)
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        histories["with bridges"].to_csv(Path(out) / "history.csv")
        figure.savefig(Path(out) / "tutorial_law.png", dpi=120)
        print(f"results are in {out}")
    return histories


def picture(
    law: BridgedDebonding, problem: vmdg.Problem, histories: dict[str, vmdg.History]
) -> Figure:
    """The law with what a point has seen of it, the forces, and the beam at the end; collective."""
    figure = plt.figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplot_mosaic([["law", "force"], ["shape", "shape"]], height_ratios=(3, 2))
    x = np.linspace(0, 1.1 * law.critical_gap, 200)
    axes["law"].plot(x, law.soften(np.full_like(x, law.strength), x)[0], "0.7", lw=4, label="law")
    tip = histories["with bridges"]
    axes["law"].plot(tip["gap"], tip["traction"], ".", label="first point of the interface")
    axes["law"].set(xlabel="gap [mm]", ylabel="traction [MPa]", xlim=(-0.01, x[-1]))
    for name, history in histories.items():
        curve(history, "opening", "force", axes["force"], origin=True, label=name)
    stress(problem, "xx", ax=axes["shape"])
    axes["shape"].set_ylim(-4, 4)
    for name in ("law", "force"):
        axes[name].legend()
    return figure


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--steps", type=int, default=40, help="load steps")
    command.add_argument(
        "--opening", type=float, default=3.0, help="of the ends of the arms, at the end [mm]"
    )
    command.add_argument("--out", default="results/tutorial_law", help="folder for the results")
    main(**vars(command.parse_args()))
