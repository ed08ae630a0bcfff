"""Cracks over many lengths of their process zone, on a mesh of any size of cells."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from parts.delamination.beams import at, lift, node
from parts.delamination.laminate import ALFANO_CRISFIELD
from parts.delamination.laminate import MMB as PLY
from parts.delamination.mmb import LEVERS, L

import vmdg
from vmdg.meshes import beams, refined

Size = Callable[[NDArray], NDArray]

SHOWN = vmdg.SolveOptions(energy=True, progress=60.0)


@dataclass(frozen=True)
class Scene:
    """A crack that grows along y = 0.

    Attributes:
        title: Of the table.
        make: Makes the problem on a mesh with cells of a size.
        monitor: Has the columns "motion" and "force".
        loads: Load factors.
        fine: Size of cells where the crack is [mm].
        window: Of :func:`vmdg.solve_adaptively` [mm].
        path: x between which the mesh from the start is fine [mm].
        options: Of the runs.
        until: Ends the run.
    """

    title: str
    make: Callable[[Size], vmdg.Problem]
    monitor: Callable[[vmdg.Problem], dict[str, float]]
    loads: NDArray
    fine: float
    window: float
    path: tuple[float, float]
    options: vmdg.SolveOptions = SHOWN
    until: Callable[[vmdg.Problem], bool] | None = None

    def everywhere(self, x: NDArray) -> NDArray:
        """The size of cells of a mesh that is fine all along the path."""
        low, high = self.path
        away = np.hypot(np.maximum(np.maximum(low - x[0], x[0] - high), 0.0), x[1])
        return self.fine + 0.4 * np.maximum(away - self.fine, 0.0)


def opened(problem: vmdg.Problem, sides: vmdg.NamedTags, height: float) -> None:
    """Move the left corners of two arms apart, and hold the right end."""
    for side in (-1, 1):
        problem.dirichlet_points(at(0.0, side * height), lambda t, s=side: s * t / 2, "y")
    problem.dirichlet(sides.find("right"), 0.0)


def dcb() -> Scene:
    """A double cantilever beam of steel."""
    height, crack, energy, strength = 3.0, 30.0, 0.3, 200.0
    stations, divisions = (0.0, 28.0, crack, 50.0, 100.0), (14, 1, 10, 25)
    root = beams(
        cell="triangle", stations=stations, divisions=divisions, height=height, precrack=crack
    )

    def make(size: Size) -> vmdg.Problem:
        mesh, cells, sides = refined(root, size)
        bond = vmdg.Debonding(strength, 2 * energy / strength)
        interface = vmdg.Interface(facets=sides.find("interface"), law=bond)
        steel = vmdg.NeoHookean(E=210e3, nu=0.3)
        problem = vmdg.Problem(
            mesh, cells, {1: steel, 2: steel}, [interface], degree=2, kinematics="small"
        )
        opened(problem, sides, height)
        return problem

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = problem.reaction_points(at(0.0, height))[1]
        return {"motion [mm]": problem.t, "force [N]": force}

    loads = np.linspace(0.0, 1.5, 31)[1:]
    return Scene("DCB", make, monitor, loads, 0.25, 5.0, (crack - 5, 66.0))


def enf() -> Scene:
    """End-notched flexure: shear, with crack faces that touch at the support."""
    m, half, crack = ALFANO_CRISFIELD, 50.0, 40.0
    stations = (0.0, 6.0, crack - 4, crack, half, 60.0, 2 * half)
    root = beams(
        cell="triangle",
        stations=stations,
        divisions=(4, 15, 2, 5, 5, 20),
        height=m.h,
        rows=1,
        precrack=crack,
        contact=6.0,
    )

    def make(size: Size) -> vmdg.Problem:
        mesh, cells, sides = refined(root, size)
        interfaces = [
            vmdg.Interface(sides.find("interface"), law=m.bond()),
            vmdg.Interface(sides.find("contact"), law=vmdg.Contact()),
        ]
        problem = vmdg.Problem(
            mesh, cells, {1: m.material, 2: m.material}, interfaces, 2, "small", m.b
        )
        problem.dirichlet(sides.find("lower left"), 0.0, "y")
        problem.dirichlet_points(at(2 * half, -m.h), 0.0, "y")
        problem.dirichlet_points(at(2 * half, 0.0), 0.0, "x")
        problem.dirichlet_points(at(half, m.h), lambda t: -t, "y")
        return problem

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = -problem.reaction_points(at(half, m.h))[1]
        return {"motion [mm]": problem.t, "force [N]": force}

    loads = np.linspace(0.0, 2.7, 28)[1:]
    return Scene("ENF", make, monitor, loads, 0.25, 5.0, (crack - 3, 75.0))


def mmb() -> Scene:
    """Mixed-mode bending at half shear: dead loads of a lever, traced beyond their peak."""
    m, crack = PLY, 25.4
    c = LEVERS[0.5]
    stations = (-5.0, 0.0, crack - 1, crack, L, 1.75 * L, 2 * L, 2 * L + 5)
    root = beams(
        cell="triangle",
        stations=stations,
        divisions=(2, 10, 1, 10, 15, 5, 2),
        height=m.h,
        rows=1,
        precrack=crack,
    )

    def make(size: Size) -> vmdg.Problem:
        mesh, cells, sides = refined(root, size)
        interface = vmdg.Interface(sides.find("interface"), law=m.bond())
        problem = vmdg.Problem(
            mesh, cells, {1: m.material, 2: m.material}, [interface], 2, "small", m.b
        )
        problem.dirichlet_points(at(0.0, -m.h), 0.0, "y")
        problem.dirichlet_points(at(2 * L, -m.h), 0.0)
        problem.point_load(at(L, m.h), lambda t: -t * (c + L) / L, "y")
        problem.point_load(at(0.0, m.h), lambda t: t * c / L, "y")
        return problem

    def deflection(problem: vmdg.Problem) -> float:
        """Of the load on the lever, by virtual work [mm]."""
        middle, arm = (lift(problem, node(problem, x, m.h)) for x in (L, 0.0))
        return (-(c + L) * middle + c * arm) / L

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"motion [mm]": deflection(problem), "force [N]": problem.t}

    return Scene(
        "MMB",
        make,
        monitor,
        385.0 * np.array([0.3, 0.6, 20.0]),
        0.25,
        2.5,
        (crack - 2, 46.0),
        vmdg.SolveOptions(energy=True, progress=60.0, unstable="trace", max_share=0.004),
        until=lambda problem: deflection(problem) > 1.6,
    )


def peel() -> Scene:
    """A strip of rubber that is lifted off its ground at one end, at finite strain."""
    thick, free, energy, strength = 1.0, 3.0, 0.2, 0.5
    root = beams(
        cell="triangle",
        stations=(0.0, free, 40.0),
        divisions=(4, 37),
        height=thick,
        rows=1,
        precrack=free,
    )

    def make(size: Size) -> vmdg.Problem:
        mesh, cells, sides = refined(root, size)
        bond = vmdg.Debonding(strength, 2 * energy / strength)
        interface = vmdg.Interface(sides.find("interface"), law=bond)
        strip, ground = vmdg.NeoHookean(E=10.0, nu=0.4), vmdg.NeoHookean(E=1e3, nu=0.3)
        problem = vmdg.Problem(mesh, cells, {1: ground, 2: strip}, [interface], degree=2)
        problem.dirichlet(sides.find("bottom"), 0.0)
        problem.dirichlet_points(at(0.0, thick), lambda t: t, "y")
        return problem

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        force = problem.reaction_points(at(0.0, thick))[1]
        return {"motion [mm]": problem.t, "force [N]": force}

    loads = np.linspace(0.0, 24.0, 49)[1:]
    return Scene("peel", make, monitor, loads, 0.25, 2.5, (free - 1, 30.0))


SCENES = {"dcb": dcb, "enf": enf, "mmb": mmb, "peel": peel}
