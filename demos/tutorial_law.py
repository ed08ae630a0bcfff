"""Tutorial: your own interface law. Delamination with fibre bridging, softening in two lines.

Behind the tip of a delamination fibres still bridge the crack: after the steep softening of the
matrix a small traction remains over a large opening. The law is written here, checked without a
mesh, and used in a double cantilever beam, whose resistance rises while the bridges build up.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray

import vmdg
from vmdg.meshes import beams
from vmdg.plot import curve, profile, stress

# 1. The law. `RadialLaw` is for laws with one softening curve R(x) for all directions: x is the
# length of the inelastic gap, R the traction the bond still carries. It brings the return map, its
# tangent, contact, friction, viscosity and energies; a law without such a curve would derive from
# `vmdg.Law` and write `return_map`. Four functions of the curve are left to write, vectorized over
# points. The history of a point is R, so the curve must fall everywhere. `critical_gap` and
# `softening_modulus` are the names that other laws use.


@dataclass(frozen=True)
class BridgedDebonding(vmdg.laws.RadialLaw):
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

    def gap_at(self, resistance: NDArray) -> NDArray:
        """Gap x at which the resistance is R [mm]."""
        gaps = [self.critical_gap, self.knee, 0.0]
        return np.interp(resistance, [0.0, self.bridging, self.strength], gaps)

    def slip(self, load: NDArray, resistance: NDArray, stiffness: NDArray) -> NDArray:
        """How far the gap grows: the root s of load - stiffness s = R(x + s) [mm].

        R is the largest of three falling lines, so s is the smallest of their roots.
        """
        x, (first, second) = self.gap_at(resistance), self.slopes
        matrix = (load - self.strength + first * x) / (stiffness - first)
        bridges = (load - second * (self.critical_gap - x)) / (stiffness - second)
        return np.minimum(np.minimum(matrix, bridges), load / stiffness)

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
        """Area under the rest of the curve [N/mm]; for R = `strength` that of the whole."""
        x, low = self.gap_at(resistance), np.minimum(resistance, self.bridging)
        head = (resistance + self.bridging) * np.maximum(self.knee - x, 0.0)
        return (head + low * (self.critical_gap - np.maximum(x, self.knee))) / 2


# 2. A check without a mesh: laws need numpy only. `return_map` takes trial traction T_tr, normal,
# gap, history Q = strength - R and penalty r of all points, and gives traction, new gap, Q and the
# tangent d gap / d T_tr, on which the quadratic convergence of Newton's method depends.


def tangent_error(law: BridgedDebonding, n: int = 2000) -> float:
    """Largest error of r times the tangent against central differences [-]."""
    random = np.random.default_rng(0)
    r, h = 5 * law.softening_modulus, 1e-6 * law.strength
    trial, normal = random.normal(scale=law.strength, size=(2, n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    gap = random.uniform(0, law.critical_gap / 4, (n, 1)) * normal
    softening = random.uniform(0, law.strength, n)

    points = normal, gap, softening, r
    ends = [[law.return_map(trial + s * axis, *points).gap for s in (h, -h)] for axis in np.eye(3)]
    differences = np.stack([(up - down) / (2 * h) for up, down in ends], axis=2)
    return float(r * np.abs(differences - law.return_map(trial, *points).tangent).max())


# 3. Use it like any other law: here in a double cantilever beam, compared with a linear law of
# the same energy.


def peel(law: vmdg.Law, steps: int, opening: float) -> tuple[vmdg.Problem, vmdg.History]:
    """Pull the ends of both arms apart, by ``opening`` [mm] in all."""
    mesh, cells, facets = beams(stations=(0, 10, 40), divisions=(10, 60), precrack=10, rows=2)
    interface = vmdg.Interface(facets.find("interface"), law=law)
    arms = vmdg.NeoHookean(E=50e3, nu=0.3)
    problem = vmdg.Problem(mesh, cells, {1: arms, 2: arms}, [interface])
    problem.dirichlet(facets.find("right"), 0.0)
    for arm, share in (("lower left", -0.5), ("upper left", 0.5)):
        problem.dirichlet(facets.find(arm), lambda t, share=share: share * t, "y")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        gap, traction = (profile(problem, 0, name, "x")[0][0, 1] for name in ("gap", "traction"))
        force = problem.reaction(facets.find("upper left"))[1]
        row = {"gap [mm]": gap, "traction [MPa]": traction}
        return row | {"opening [mm]": problem.t, "force [N]": force}

    options = vmdg.SolveOptions(energy=True, progress=True)
    loads = np.linspace(0, opening, steps + 1)[1:]
    return problem, vmdg.solve(problem, loads, options, monitor).history


def main(steps: int = 40, out: str = "results/tutorial_law") -> dict[str, vmdg.History]:
    """Check the law, then peel with it and without bridges; the history of both."""
    bridged = BridgedDebonding(strength=30.0, bridging=3.0, knee=0.02, critical_gap=0.3)
    linear = vmdg.Debonding(30.0, 2 * float(bridged.bond_energy(np.array(30.0))) / 30.0)
    print(f"tangent off by {tangent_error(bridged):.1e}")
    figure = plt.figure(figsize=(9, 6), layout="constrained")
    axes = figure.subplot_mosaic([["law", "force"], ["shape", "shape"]], height_ratios=(3, 2))
    histories = {}
    for name, law in {"linear, same energy": linear, "with bridges": bridged}.items():
        problem, histories[name] = peel(law, steps, 3.0)
        curve(histories[name], "gap", "traction", axes["law"], marker=".", label=name)
        curve(histories[name], "opening", "force", axes["force"], origin=True, label=name)
    axes["law"].set(xlim=(-0.01, 0.35), title="first point of the interface")
    axes["law"].legend()
    stress(problem, "xx", ax=axes["shape"])
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(Path(out) / "tutorial_law.png")
    return histories


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--steps", type=int, default=40, help="load steps")
    command.add_argument("--out", default="results/tutorial_law", help="folder for the results")
    main(**vars(command.parse_args()))
