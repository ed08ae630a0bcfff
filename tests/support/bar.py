"""The bar of 7.1.1 in plane strain: two squares of 1 mm, the right end pulled; its closed form."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from scipy.integrate import quad
from scipy.optimize import brentq

import vmdg
from vmdg.meshes import blocks

E, NU, STRENGTH = 5000.0, 0.25, 100.0
MU, LMBDA = E / (2 * (1 + NU)), NU * E / ((1 + NU) * (1 - 2 * NU))
LOADS = 0.002 * np.arange(1, 31)


def with_law(
    comm: MPI.Comm,
    law: vmdg.Law,
    kinematics: str = "finite",
    dead: bool = False,
    most: float = np.inf,
) -> vmdg.Problem:
    """The bar; its right end moved by the load factor [mm], or pulled by it [MPa], at `most`."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (2, 2))
    material = vmdg.NeoHookean(E=E, nu=NU)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(
        mesh, cells, {1: material, 2: material}, [interface], kinematics=kinematics
    )
    problem.dirichlet(facets.find(1), 0.0, "x")
    if dead:
        problem.traction(facets.find(2), lambda t: (min(t, most), 0.0))
    else:
        problem.dirichlet(facets.find(2), lambda t: t, "x")
    problem.dirichlet(facets.find(5), 0.0, "y")
    return problem


def build(comm: MPI.Comm, critical_gap: float, kinematics: str = "finite", dead: bool = False):
    """The bar with the linear law."""
    law = vmdg.Debonding(strength=STRENGTH, critical_gap=critical_gap)
    return with_law(comm, law, kinematics, dead)


def stress(stretch: float, kinematics: str = "finite") -> float:
    """First Piola-Kirchhoff stress of (86), or its linear limit, for a stretch; free laterally."""
    if kinematics == "small":
        return E / (1 - NU**2) * (stretch - 1)

    def lateral(b: float) -> float:
        return MU * (b - 1 / b) + LMBDA * (stretch * b - 1) * stretch

    b = brentq(lateral, 0.5, 1.5, xtol=1e-15)
    return MU * (stretch - 1 / stretch) + LMBDA * (stretch * b - 1) * b


def stretch(traction: float, kinematics: str = "finite") -> float:
    """Stretch s for a traction [MPa]."""
    return brentq(lambda s: stress(s, kinematics) - traction, 0.9, 1.2, xtol=1e-15)


def opening(gap: float, critical_gap: float, kinematics: str = "finite") -> float:
    """delta = 2 (s - 1) + zeta while the bond softens, P(s) = P_c (1 - zeta / zeta_c) [mm]."""
    traction = STRENGTH * (1 - gap / critical_gap)
    return 2 * (stretch(traction, kinematics) - 1) + gap


def elastic_energy(traction: float, kinematics: str = "finite") -> float:
    """Of both squares under a traction [N mm]."""
    end = stretch(traction, kinematics)
    return 2 * quad(lambda s: stress(s, kinematics), 1.0, end, epsabs=1e-13)[0]


def means(problem: vmdg.Problem) -> dict[str, float]:
    """Traction and gap, the same at all points, and how far the gaps are apart."""
    mean, gap = problem.mean(0), problem.state[0].gap[:, 0]
    low = problem.comm.allreduce(gap.min(initial=np.inf), MPI.MIN)
    high = problem.comm.allreduce(gap.max(initial=-np.inf), MPI.MAX)
    return {"traction": mean.traction[0], "gap": mean.gap[0], "spread": high - low}
