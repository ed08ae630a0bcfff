"""Measured images: strength, gap and modulus of a beam from its force and a series of images.

Displacements of 84 points around the tip of a double cantilever beam, in ten images of a camera
that moves a little between them, and its force stand for a measurement, both with noise. The force
alone tells the fracture energy, but strength and modulus only together; with the images all three
follow within 1 %. Cracks show up in the field where they are, whatever the force.
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

#: A bond of a composite, arms of aluminium.
TRUTH = {"bond.strength": 30.0, "bond.critical_gap": 0.02, "NeoHookean.E": 70e3}
HEIGHT, CRACK = 1.5, 12.0
#: Points that the camera sees, around the tip [mm].
POINTS = np.array([(x, y) for x in CRACK + np.linspace(-1, 6, 21) for y in (-1.2, -0.4, 0.4, 1.2)])


def beam(
    values: dict[str, float], facet: float = 0.5, comm: MPI.Comm = MPI.COMM_WORLD
) -> tuple[vmdg.Problem, Callable]:
    """Two arms of aluminium, 1.5 mm high, and the force on the upper one."""
    stations = (0.0, CRACK - 2, CRACK, 20.0, 30.0)
    divisions = np.ceil(np.diff(stations) / (facet * np.array([4, 1, 1, 4]))).astype(int).tolist()
    mesh, cells, sides = beams(
        comm, stations=stations, divisions=divisions, height=HEIGHT, rows=2, precrack=CRACK
    )
    law = vmdg.Debonding(values["bond.strength"], values["bond.critical_gap"])
    bond = vmdg.Interface(facets=sides.find("interface"), law=law, name="bond")
    arm = vmdg.NeoHookean(E=values["NeoHookean.E"], nu=0.3)
    arms = {"lower arm": arm, "upper arm": arm}
    problem = vmdg.Problem(mesh, cells, arms, [bond], degree=2, kinematics="small")
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * HEIGHT: np.isclose(x[0], 0.0) & np.isclose(x[1], y),
            lambda t, side=side: side * t / 2,
            "y",
        )
    problem.dirichlet(sides.find("right"), 0.0)
    pulled = sides.find("upper left")
    return problem, lambda problem: {"force [N]": problem.reaction(pulled)[1]}


def exact(
    openings: np.ndarray, facet: float, comm: MPI.Comm = MPI.COMM_WORLD
) -> tuple[np.ndarray, np.ndarray]:
    """Forces (m,) and displacements of the points (m, n, 2) without noise."""
    problem, monitor = beam(TRUTH, facet, comm)
    shape = len(openings), *POINTS.shape
    sample = vmdg.Field(POINTS, openings, np.zeros(shape), sigma=1.0).watch(problem)
    history = vmdg.solve(
        problem, openings, monitor=lambda problem: monitor(problem) | {"field": sample()}
    ).history
    rows = [int(np.abs(history["load"] - t).argmin()) for t in openings]
    return history["force"][rows], history["field"][rows].reshape(shape)


def measured(
    openings: np.ndarray,
    truth: tuple[np.ndarray, np.ndarray],
    seed: int,
    force_noise: float = 0.005,
    noise: float = 2e-4,
) -> tuple[vmdg.Curve, vmdg.Field]:
    """Force and images with noise, of a camera that moves by some micrometres and milliradians."""
    random = np.random.default_rng(seed)
    force, u = truth
    sigma = force_noise * force.max()
    force = force + sigma * random.standard_normal(force.shape)
    u = u + noise * random.standard_normal(u.shape)
    moved = 5e-3 * random.standard_normal((len(u), 1, 2))
    turn = 1e-3 * random.standard_normal((len(u), 1, 1))
    u += moved + turn * (POINTS[:, ::-1] * [-1, 1])
    along = "load [mm]"
    curve = vmdg.Curve(openings, force, "force [N]", along, sigma=sigma)
    return curve, vmdg.Field(POINTS, openings, u, sigma=noise, along=along, column="field [mm]")


def main(
    images: int = 10,
    facet: float = 0.5,
    noise: float = 2e-4,
    seed: int = 1,
    out: str = "results/measured_images",
) -> dict[str, vmdg.Identified]:
    """Measure, identify with and without images, draw; what was identified."""
    openings = np.linspace(0, 0.7, images + 1)[1:]
    curve, field = measured(openings, exact(openings, facet), seed, noise=noise)
    start = dict(zip(TRUTH, (40.0, 0.016, 60e3), strict=True))
    found = {
        name: vmdg.identify(lambda values: beam(values, facet), data, start)
        for name, data in {"force": [curve], "force and images": [curve, field]}.items()
    }
    figure = found["force and images"].plot(plt.figure(figsize=(9.5, 4.5), layout="constrained"))
    if MPI.COMM_WORLD.rank == 0:
        for name, one in found.items():
            print(f"{name}\n{one}\n")
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(f"{out}/measured_images.png")
    return found


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--images", type=int, default=10, help="number of images")
    command.add_argument("--facet", type=float, default=0.5, help="size of facets [mm]")
    deviation = "standard deviation of the measured displacements [mm]"
    command.add_argument("--noise", type=float, default=2e-4, help=deviation)
    command.add_argument("--seed", type=int, default=1, help="seed of the noise")
    command.add_argument("--out", default="results/measured_images", help="folder for the results")
    main(**vars(command.parse_args()))
