"""Measured beam: strength and energy of a bond from the curve of a double cantilever beam.

Force over opening of a beam with known strength and energy, with noise, stands for a measurement.
From a start that is 30 % off, runs with derivatives by both find them again. The second picture
shows how well: the crack is long against the process zone, so the curve says much about the energy
and little about the strength.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np

import vmdg
from vmdg.meshes import beams

STRENGTH, ENERGY = "bond.strength", "bond.fracture_energy"
TRUTH = {STRENGTH: 20.0, ENERGY: 0.3}


def beam(values: dict[str, float], facet: float = 0.5) -> tuple[vmdg.Problem, Callable]:
    """Two arms of aluminium, 1.5 mm high, and the force on the upper one."""
    height, crack = 1.5, 12.0
    stations = (0.0, crack - 2, crack, 22.0, 30.0)
    divisions = np.ceil(np.diff(stations) / (facet * np.array([4, 1, 1, 4]))).astype(int).tolist()
    mesh, cells, sides = beams(
        stations=stations, divisions=divisions, height=height, rows=2, precrack=crack
    )
    law = vmdg.ExponentialDebonding(strength=values[STRENGTH], fracture_energy=values[ENERGY])
    bond = vmdg.Interface(facets=sides.find("interface"), law=law, name="bond")
    arm = vmdg.NeoHookean(E=70e3, nu=0.3)
    arms = {"lower arm": arm, "upper arm": arm}
    problem = vmdg.Problem(mesh, cells, arms, [bond], degree=2, kinematics="small")
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * height: np.isclose(x[0], 0.0) & np.isclose(x[1], y),
            lambda t, side=side: side * t / 2,
            "y",
        )
    problem.dirichlet(sides.find("right"), 0.0)
    pulled = sides.find("upper left")
    return problem, lambda problem: {"force [N]": problem.reaction(pulled)[1]}


def main(
    noise: float = 0.01,
    points: int = 16,
    facet: float = 0.5,
    seed: int = 1,
    out: str = "results/measured_beam",
) -> vmdg.Identified:
    """Measure, identify, draw; what was identified."""
    openings = np.linspace(0, 1.5, points + 1)[1:]

    def forces(values: dict[str, float]) -> np.ndarray:
        problem, monitor = beam(values, facet)
        history = vmdg.solve(problem, openings, monitor=monitor).history
        return np.array([history["force"][np.isclose(history["load"], t)][0] for t in openings])

    exact = forces(TRUTH)
    sigma = noise * exact.max()
    measured = exact + sigma * np.random.default_rng(seed).standard_normal(points)
    start = {STRENGTH: 1.3 * TRUTH[STRENGTH], ENERGY: 0.7 * TRUTH[ENERGY]}
    curve = vmdg.Curve(openings, measured)
    found = vmdg.identify(lambda values: beam(values, facet), curve, start, sigma=sigma)
    curves = {"start": forces(start), "identified": forces(found.estimate)}

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    left.plot(openings, measured, "k.", label="measured")
    for (label, values), style in zip(curves.items(), ("C1--", "C0-"), strict=True):
        left.plot(openings, values, style, lw=1, label=label)
    left.set(xlabel="opening [mm]", ylabel="force [N/mm]", xlim=(0, None), ylim=(0, None))
    left.legend()
    circle = np.exp(2j * np.pi * np.linspace(0, 1, 200))
    ellipse = np.sqrt(5.99) * np.linalg.cholesky(found.covariance) @ [circle.real, circle.imag]
    around = [found.estimate[name] * np.exp(ellipse[i]) for i, name in enumerate(found.names)]
    way = np.array([[run.values[name] for run in found.runs] for name in found.names])
    right.plot(*around, "C0", label="95 % of measurements")
    right.plot(*way, "C1.-", lw=0.8, label="runs")
    right.plot(*TRUTH.values(), "k+", ms=12, label="truth")
    right.set(xlabel="strength [MPa]", ylabel="energy [N/mm]")
    right.legend()
    if MPI.COMM_WORLD.rank == 0:
        print(found)
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(f"{out}/measured_beam.png", dpi=110)
    return found


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    deviation = "standard deviation of the noise relative to the largest force [-]"
    command.add_argument("--noise", type=float, default=0.01, help=deviation)
    command.add_argument("--points", type=int, default=16, help="number of measured points")
    command.add_argument("--facet", type=float, default=0.5, help="size of facets [mm]")
    command.add_argument("--seed", type=int, default=1, help="seed of the noise")
    command.add_argument("--out", default="results/measured_beam", help="folder for the results")
    main(**vars(command.parse_args()))
