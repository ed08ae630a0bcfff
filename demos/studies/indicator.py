"""The error that the fine scales estimate against the true one: a ring, a beam, a tearing plate.

Four meshes each. At equilibrium under given displacements, or dead loads, what a mesh has too much
of the energy of bodies and bonds, dPi, is half the square of its error, relative to the energy
norm (dPi/W)^1/2 with the energy W of the bodies. Pi is that of a much finer mesh. The picture has
the second mesh of each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import la
from parts.delamination.beams import at
from parts.options import run
from parts.tables import markdown, report
from parts.verification.checks import core_and_ring

import vmdg
from vmdg.meshes import beams, refined


@dataclass(frozen=True)
class Scene:
    """A state on a mesh of any size: sizes, and the finer one that stands for the truth [mm]."""

    solve: Callable[[float], vmdg.Problem]
    sizes: tuple[float, ...]
    truth: float
    energy: Callable[[vmdg.Energy], float]
    magnify: float


def ring(size: float) -> vmdg.Problem:
    """A core in a ring that is pulled to an oval by dead loads; curved triangles of degree 2."""
    mesh, cells, sides = core_and_ring(MPI.COMM_WORLD, 2.0, size, 2)
    core, around = vmdg.NeoHookean(E=40e3, nu=0.2), vmdg.NeoHookean(E=10e3, nu=0.33)
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(mesh, cells, {1: core, 2: around}, [tie], 2, "small")
    problem.dirichlet(sides.find(1), 0.0, "y")
    problem.dirichlet(sides.find(2), 0.0, "x")
    problem.traction(sides.find(4), lambda x, t: 25.0 * t * np.stack([x[0], -x[1]]))
    vmdg.solve(problem, [1.0])
    return problem


def beam(size: float) -> vmdg.Problem:
    """A double cantilever beam whose crack has begun to grow; triangles of degree 2."""
    height, crack = 1.5, 12.0
    root = beams(
        cell="triangle",
        stations=(0.0, crack, 30.0),
        divisions=(8, 12),
        height=height,
        rows=1,
        precrack=crack,
    )
    mesh, cells, sides = refined(root, lambda x: np.full(x.shape[1], size))
    bond = vmdg.Debonding(strength=20.0, critical_gap=0.02)
    interface = vmdg.Interface(sides.find("interface"), law=bond)
    arm = vmdg.NeoHookean(E=70e3, nu=0.3)
    problem = vmdg.Problem(mesh, cells, {1: arm, 2: arm}, [interface], 2, "small")
    for side in (-1, 1):
        problem.dirichlet_points(at(0.0, side * height), lambda t, s=side: s * t / 2, "y")
    problem.dirichlet(sides.find("right"), 0.0)
    vmdg.solve(problem, [0.2, 0.4])
    return problem


def tear(size: float, degree: int) -> vmdg.Problem:
    """A soft plate that begins to tear off a stiff one, at finite strain; nu = 0.44."""
    width, height = 1.62, 1.35
    root = beams(
        cell="triangle",
        stations=(0.0, width / 4, width),
        divisions=(2, 6),
        height=(height, height / 2),
        rows=(6, 3),
        precrack=width / 4,
    )
    mesh, cells, sides = refined(root, lambda x: np.full(x.shape[1], size))
    bond = vmdg.Debonding(strength=200.0, critical_gap=0.2)
    interface = vmdg.Interface(between=(1, 2), law=bond)
    bodies = {1: vmdg.NeoHookean(E=4e3, nu=0.44), 2: vmdg.NeoHookean(E=16e3, nu=0.44)}
    problem = vmdg.Problem(mesh, cells, bodies, [interface], degree)
    problem.dirichlet(sides.find("bottom"), lambda t: (0.0, -height * t))
    problem.dirichlet(sides.find("top"), 0.0)
    vmdg.solve(problem, [0.02, 0.04])
    return problem


def bonded(energy: vmdg.Energy) -> float:
    return energy.stored + energy.damage


TEARING = 0.3, 0.15, 0.075, 0.038
SCENES = {
    "ring": Scene(ring, (0.4, 0.2, 0.1, 0.05), 0.02, lambda energy: -energy.stored, 100.0),
    "DCB": Scene(beam, (2.5, 1.25, 0.63, 0.32), 0.1, bonded, 5.0),
    "tearing": Scene(partial(tear, degree=2), TEARING, 0.02, bonded, 1.0),
    "tearing-1": Scene(partial(tear, degree=1), TEARING, 0.01, bonded, 1.0),
}


def measure(name: str, ax: plt.Axes) -> list[list[object]]:
    """The lines of a scene, and its picture."""
    scene, lines = SCENES[name], []
    exact = scene.energy(scene.solve(scene.truth).energy())
    for count, size in enumerate(scene.sizes):
        problem = scene.solve(size)
        energy, share = problem.energy(), la.norm(problem.indicator().x)
        error = np.sqrt(abs(scene.energy(energy) - exact) / energy.bulk)
        bonds = [i for i, one in enumerate(problem.interfaces) if one.law.has_bond]
        most = vmdg.extremes(problem, 0, "indicator")[1] if bonds else None
        shown = "" if most is None else f"{most:.4f}"
        lines.append([name, size, f"{error:.4f}", f"{share:.4f}", f"{error / share:.2f}", shown])
        if count == 1:
            vmdg.plot.indicator(problem, scene.magnify, ax)
            ax.set_title(name)
    return lines


def main(names: list[str] | None = None, out: str = "results/indicator") -> list[list[object]]:
    """Measure the scenes; the lines of the table.

    Args:
        names: Of scenes, all without one.
        out: Folder for table and picture.
    """
    names = names or list(SCENES)
    figure, axes = plt.subplots(len(names), 1, figsize=(6, 3.2 * len(names)), squeeze=False)
    lines = [line for name, ax in zip(names, axes.flat, strict=True) for line in measure(name, ax)]
    head = ["scene", "size [mm]", "error", "estimate", "error/estimate", "bond"]
    figure.tight_layout()
    report(out, "indicator", markdown(head, lines), figure)
    return lines


if __name__ == "__main__":
    run(main)
