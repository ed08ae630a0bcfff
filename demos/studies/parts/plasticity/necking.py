"""A round bar that necks, of two halves joined where the neck forms."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from parts.plasticity.rows import STEEL, Row
from parts.topology import global_max
from parts.verification.checks import describe

import vmdg
from vmdg.meshes import blocks
from vmdg.meshes.two_blocks import BACK, BOTTOM, LEFT, RIGHT

#: Radius, half of the length, radius at the middle relative to that at the ends, pull of each end.
RADIUS, HALF, WAIST, PULL = 6.413, 26.667, 0.982, 7.0  # mm, mm, -, mm
BONDS = {"tied": vmdg.Bonded(), "bonded": vmdg.Debonding(strength=5e3, critical_gap=0.1)}


#: How much longer cells are at the ends than at the middle: 1 + 2 GRADING.
GRADING = 12.0


def profile(place: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions along the bar of places -1 to 1, relative to half of it, and radii there [mm].

    The radius grows linearly from the middle.
    """
    share = np.abs(place)
    share = (share + GRADING * share**2) / (1 + GRADING)
    return np.sign(place) * share, RADIUS * (WAIST + (1 - WAIST) * share)


def bar(bond: str | None, across: int, along: int) -> tuple[vmdg.Problem, vmdg.NamedTags]:
    """The bar as an axisymmetric section and the tags of its ends, which pull apart along y.

    The ends may contract, as in Simo and Armero (1992).

    Args:
        bond: Key of BONDS for what joins the halves, None for one body.
    """
    mesh, cells, facets = blocks(
        MPI.COMM_WORLD, "quadrilateral", (along, across), 2.0, 1.0, interface=(1.0, 1.0)
    )
    x = mesh.geometry.x
    share, radius = profile(x[:, 0] - 1.0)
    x[:, 0] = x[:, 1] * radius
    x[:, 1] = share * HALF
    interfaces = [vmdg.Interface(between=(1, 2), law=BONDS[bond])] if bond else []
    materials = {1: STEEL, 2: STEEL}
    problem = vmdg.Problem(mesh, cells, materials, interfaces, degree=2, symmetry="axisymmetric")
    problem.dirichlet(facets.find(LEFT), lambda t: -t, "y")
    problem.dirichlet(facets.find(RIGHT), lambda t: t, "y")
    problem.dirichlet_points(lambda x: np.isclose(x[0], 0.0), 0.0, "x")
    return problem, facets


def solid_bar(bond: str | None, across: int, along: int) -> tuple[vmdg.Problem, vmdg.NamedTags]:
    """A quarter of the bar in 3D, of hexahedra, whose ends pull apart along x.

    A square becomes the quarter of a disc by (y, z) -> (y sqrt(1 - z^2/2), z sqrt(1 - y^2/2)); its
    edge of chords is moved out until it has the area of the disc. Arguments as for :func:`bar`.
    """
    counts = (along, across, across)
    mesh, cells, facets = blocks(
        MPI.COMM_WORLD, "hexahedron", counts, 2.0, 1.0, interface=(1.0, 1.0)
    )
    x = mesh.geometry.x
    share, radius = profile(x[:, 0] - 1.0)
    edge = np.arctan2(*disc(np.linspace(0.0, 1.0, across + 1), 1.0))
    chords = np.sin(np.diff(edge)).sum()
    y, z = disc(x[:, 1], x[:, 2])
    x[:, 0] = share * HALF
    x[:, 1:] = (radius * np.sqrt(np.pi / 4 / chords))[:, None] * np.column_stack([y, z])
    interfaces = [vmdg.Interface(between=(1, 2), law=BONDS[bond])] if bond else []
    problem = vmdg.Problem(mesh, cells, {1: STEEL, 2: STEEL}, interfaces, degree=2)
    problem.dirichlet(facets.find(LEFT), lambda t: -t, "x")
    problem.dirichlet(facets.find(RIGHT), lambda t: t, "x")
    problem.dirichlet(facets.find(BOTTOM), 0.0, "y")
    problem.dirichlet(facets.find(BACK), 0.0, "z")
    return problem, facets


def disc(y: np.ndarray, z: np.ndarray | float) -> tuple[np.ndarray, np.ndarray]:
    return y * np.sqrt(1 - np.square(z) / 2), z * np.sqrt(1 - np.square(y) / 2)


def pull(
    bond: str | None, across: int, along: int, steps: int = 56, solid: bool = False
) -> tuple[vmdg.Problem, vmdg.History]:
    """Pull each end by 7 mm: the problem at the end, and the history with its force [kN].

    ``solid`` is the quarter in 3D, the force that of the whole bar.
    """
    problem, facets = (solid_bar if solid else bar)(bond, across, along)
    end, axis, share = facets.find(RIGHT), 0 if solid else 1, 4 if solid else 1

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"force [kN]": share * problem.reaction(end)[axis] / 1e3}

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
    """Halves tied or bonded at the neck against one body and a finer mesh; in 3D the section."""
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
    counts = (2, 6) if coarse else (3, 8)
    _, flat = pull("tied", *counts, steps=28)
    problem, thick = pull("tied", *counts, steps=28, solid=True)
    section, found, mesh = forces(flat), forces(thick), describe(problem, 2)
    rows += [
        Row("necking in 3D, tied", name, found[name], section[name], "axisymmetric", mesh)
        for name in section
    ]
    return rows, runs
