"""A ductile strip is peeled off its ground: the plastic share of the work against the thickness.

A moment bends the free end of a copper strip away from a rigid ground, so that a crack runs along
the bond at a constant moment. The work per new area, which at 90 degrees is the peel force per
width, is the toughness of the bond, the elastic energy of the bent strip and what its plastic
flow takes. A thick strip stays elastic and needs twice the toughness; the thinner a strip the more
it is bent, and the less of the work goes into the bond.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import CellType, GhostMode, create_rectangle

import vmdg

E, NU, YIELD, HARDENING = 110e3, 0.34, 150.0, 1000.0  # MPa, -, MPa, MPa
COPPER = vmdg.J2(E, NU, YIELD, hardening=HARDENING)
G_C, STRENGTH = 0.02, 30.0  # N/mm, MPa
SHARES = ("damage", "plastic", "bulk")


def peel(thickness: float, facet: float, growth: float) -> tuple[vmdg.Problem, vmdg.History]:
    """Peel a strip by a moment, the load factor [N], over ``growth`` lengths of its process zone.

    Args:
        thickness: Of the strip [mm].
        facet: Relative to the process zone [-].
        growth: Likewise [-].
    """
    zone = (E / (1 - NU**2) * thickness**3 * G_C / STRENGTH**2) ** 0.25
    count = round((growth + 6) / facet)
    corners = ((0.0, -thickness / 2), (count * facet * zone, thickness))
    kind, ghosts = CellType.quadrilateral, GhostMode.shared_facet
    mesh = create_rectangle(MPI.COMM_WORLD, corners, (count, 3), kind, ghost_mode=ghosts)
    cells = vmdg.split_cells(mesh, lambda x: -x[1], "strip")
    bond = vmdg.Interface(
        between=("outside", "strip"),
        law=vmdg.Debonding(STRENGTH, 2 * G_C / STRENGTH),
        initial_damage=lambda x: np.where(x[0] < zone, 1.0, 0.0),
    )
    bodies = {"outside": vmdg.Rigid(), "strip": COPPER}
    problem = vmdg.Problem(mesh, cells, bodies, [bond], degree=2, kinematics="small")

    def moment(x: np.ndarray, t: float) -> np.ndarray:
        stress = 12 * t / thickness**3 * (x[1] - thickness / 2)
        return np.stack([stress, 0 * stress])

    problem.traction(lambda x: np.isclose(x[0], 0.0) & (x[1] > -1e-9), moment)
    problem.dirichlet(lambda x: np.isclose(x[0], corners[1][0]) & (x[1] > -1e-9), 0.0)
    crack = vmdg.CrackGrowth(problem, 0)
    end = np.sqrt(E / (1 - NU**2) * thickness**3 * G_C / 6)  # of an elastic strip
    options = vmdg.SolveOptions(unstable="trace", energy=True, progress=True, show=("crack",))
    history = vmdg.solve(
        problem,
        end * np.array([0.3, 0.6, 2.0]),
        options,
        lambda problem: {"moment [N]": problem.t, "plastic [N mm]": problem.energy().plastic} | crack(),
        until=lambda problem: crack.length > (growth + 1) * zone,
    ).history
    return problem, history
