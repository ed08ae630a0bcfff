"""A round bar that necks, of two halves joined where the neck forms."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np

import vmdg
from parts.plasticity.rows import STEEL, Row
from parts.verification.checks import describe
from vmdg.base.parallel import global_max
from vmdg.meshes import blocks
from vmdg.meshes.two_blocks import LEFT, RIGHT

#: Radius, half of the length, radius at the middle relative to that at the ends, pull of each end.
RADIUS, HALF, WAIST, PULL = 6.413, 26.667, 0.982, 7.0  # mm, mm, -, mm
BONDS = {"tied": vmdg.Bonded(), "bonded": vmdg.Debonding(strength=5e3, critical_gap=0.1)}


def bar(
    bond: str | None, across: int, along: int, grading: float = 12.0
) -> tuple[vmdg.Problem, vmdg.NamedTags]:
    """The bar as an axisymmetric section and the tags of its ends, which pull apart along y.

    The ends may contract, as in Simo and Armero (1992); the radius grows linearly from the middle.

    Args:
        bond: Key of BONDS for what joins the halves, None for one body.
        across: Cells over the radius.
        along: Cells over half of the length.
        grading: How much longer cells are at the ends than at the middle: 1 + 2 grading.
    """
    mesh, cells, facets = blocks(
        MPI.COMM_WORLD, "quadrilateral", (along, across), 2.0, 1.0, interface=(1.0, 1.0)
    )
    x = mesh.geometry.x
    place, depth = x[:, 0] - 1.0, x[:, 1].copy()
    share = np.abs(place)
    share = (share + grading * share**2) / (1 + grading)
    x[:, 0] = depth * RADIUS * (WAIST + (1 - WAIST) * share)
    x[:, 1] = np.sign(place) * share * HALF
    interfaces = [vmdg.Interface(between=(1, 2), law=BONDS[bond])] if bond else []
    materials = {1: STEEL, 2: STEEL}
    problem = vmdg.Problem(mesh, cells, materials, interfaces, degree=2, symmetry="axisymmetric")
    problem.dirichlet(facets.find(LEFT), lambda t: -t, "y")
    problem.dirichlet(facets.find(RIGHT), lambda t: t, "y")
    problem.dirichlet_points(lambda x: np.isclose(x[0], 0.0), 0.0, "x")
    return problem, facets


def pull(
    bond: str | None, across: int, along: int, steps: int = 56
) -> tuple[vmdg.Problem, vmdg.History]:
    """Pull each end by 7 mm: the problem at the end, and the history with its force [kN]."""
    problem, facets = bar(bond, across, along)
    end = facets.find(RIGHT)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"force [kN]": problem.reaction(end)[1] / 1e3}

    loads = np.linspace(0.0, PULL, steps + 1)[1:]
    return problem, vmdg.solve(problem, loads, monitor=monitor).history


def forces(history: vmdg.History) -> dict[str, float]:
    """The largest force, and those when each end has moved 5, 6 and 7 mm [kN]."""
    found = {"largest force [kN]": float(history["force"].max())}
    for motion in (5.0, 6.0, 7.0):
        force = np.interp(motion, history["load"], history["force"])
        found[f"force at {motion:g} mm [kN]"] = float(force)
    return found


def neck(problem: vmdg.Problem) -> float:
    """Largest radius at the middle, relative to the radius of the bar."""
    x = problem.space.tabulate_dof_coordinates()
    u = problem.u.x.array.reshape(-1, 2)
    middle = np.isclose(x[:, 1], 0.0)
    return global_max(problem.comm, (x[middle, 0] + u[middle, 0]).max(initial=0.0)) / RADIUS


def necking(coarse: bool = False) -> tuple[list[Row], dict[str, vmdg.History]]:
    """Halves tied or bonded at the neck against one body and against a finer mesh."""
    (across, along), steps = ((4, 12), 28) if coarse else ((8, 24), 56)
    whole, one = pull(None, across, along, steps)
    runs, rows = {"one body": one}, []
    for bond in BONDS:
        problem, runs[bond] = pull(bond, across, along, steps)
        mesh = describe(problem, 2)
        plain = forces(one) | {"radius of the neck [-]": neck(whole)}
        found = forces(runs[bond]) | {"radius of the neck [-]": neck(problem)}
        rows += [
            Row(f"necking, {bond}", name, found[name], plain[name], "one body, same mesh", mesh)
            for name in plain
        ]
    _, runs["refined"] = pull(None, 3 * across // 2, 3 * along // 2, 3 * steps // 2)
    fine, found = forces(runs["refined"]), forces(runs["tied"])
    rows += [
        Row("necking, tied", name, found[name], fine[name], "one body, refined", mesh)
        for name in fine
    ]
    return rows, runs
