"""A short double cantilever beam of two arms that are bent apart."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import MeshTags

import vmdg
from vmdg.meshes import beams

HEIGHT, CRACK, LENGTH = 1.5, 12.0, 30.0


def bent_apart(
    comm: MPI.Comm,
    bonded: float,
    facets: tuple[int, int],
    law: vmdg.Law,
    upper: float = 70e3,
    kinematics: str = "small",
) -> tuple[vmdg.Problem, MeshTags]:
    """The beam, opened by the load factor, and its sides.

    Fine facets behind the crack end at ``bonded`` [mm]; ``facets`` are their number and that of
    those behind, ``upper`` is E of the upper arm, that of the lower one 70 GPa [MPa].
    """
    stations, divisions = (0.0, 10.0, CRACK, bonded, LENGTH), (5, 4, *facets)
    mesh, cells, sides = beams(
        comm, stations=stations, divisions=divisions, height=HEIGHT, rows=2, precrack=CRACK
    )
    arms = {"lower arm": 70e3, "upper arm": upper}
    bodies = {name: vmdg.NeoHookean(E=E, nu=0.3) for name, E in arms.items()}
    bond = vmdg.Interface(facets=sides.find("interface"), law=law, name="bond")
    problem = vmdg.Problem(mesh, cells, bodies, [bond], degree=2, kinematics=kinematics)
    open_ends(problem, sides)
    return problem, sides


def open_ends(problem: vmdg.Problem, sides: MeshTags) -> None:
    """Move the left corners apart by the load factor, and hold the right end."""
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * HEIGHT: np.isclose(x[0], 0.0) & np.isclose(x[1], y),
            lambda t, side=side: side * t / 2,
            "y",
        )
    problem.dirichlet(sides.find("right"), 0.0)


def opened(problem: vmdg.Problem) -> dict[str, float]:
    """Monitor of the force that opens the beam."""
    where = lambda x: np.isclose(x[0], 0.0) & np.isclose(x[1], HEIGHT)  # noqa: E731
    return {"force [N]": problem.reaction_points(where)[1]}
