"""A debonded layer that buckles: the scene, and what closed forms say of it.

Clamped at the ends of a crack of length L the layer of thickness h buckles when the strain e' of
the body of height H below it is

    e_c = pi^2/3 (h/L)^2,    and rises by    w = 2 L/pi sqrt(e' - e_c).

The crack grows when (Chai, Babcock and Knauss 1981, for a body that yields as the layer buckles)

    G = E' h/2 (e' - e_c) (k (e' - e_c) + 4 e_c) = G_c,    E' = E/(1 - nu^2),  k = H/(H + h).
"""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import MeshTags

import vmdg
from vmdg.meshes import tearing
from vmdg.meshes.plate import BOTTOM, LEFT, RIGHT

BODY, LAYER, CRACK, WIDTH = 4.0, 0.5, 10.0, 30.0  # mm; half of the crack, of the width
WAVE = LAYER / 500  # mm
E, NU, STRENGTH, ENERGY = 70e3, 0.3, 100.0, 1.2  # MPa, MPa, N/mm
BOND = vmdg.Debonding(strength=STRENGTH, critical_gap=2 * ENERGY / STRENGTH)


def build(cells: int) -> tuple[vmdg.Problem, MeshTags]:
    """The problem, its load factor the strain of the ends, and its facets; cells along a mm."""
    divisions = int(cells * WIDTH), 4, 1
    mesh, tags, facets = tearing(
        MPI.COMM_WORLD, "quadrilateral", WIDTH, BODY, LAYER, divisions, CRACK
    )
    x, y, _ = mesh.geometry.x.T
    y += WAVE * np.cos(np.pi / 2 * x / CRACK) ** 2 * (x < CRACK) * (y > BODY - 1e-9)
    bodies = dict.fromkeys((1, 2), vmdg.NeoHookean(E=E, nu=NU))
    problem = vmdg.Problem(mesh, tags, bodies, [vmdg.Interface(between=(1, 2), law=BOND)], degree=2)
    problem.dirichlet(facets.find(LEFT), 0.0, "x")
    problem.dirichlet(facets.find(BOTTOM), 0.0, "y")
    problem.dirichlet(facets.find(RIGHT), lambda e: -WIDTH * e, "x")
    return problem, facets


def critical(crack: float) -> float:
    """e_c of a layer that is debonded over 2 ``crack`` [mm]."""
    return np.pi**2 / 12 * (LAYER / crack) ** 2


def at_ends(below: float, crack: float) -> float:
    """e, where the body below the layer has the strain e': the force is the same all along."""
    bonded = (BODY * below + LAYER * critical(crack)) / (BODY + LAYER)
    return (crack * below + (WIDTH - crack) * bonded) / WIDTH


def growth(crack: float) -> float:
    """e at which G = G_c."""
    e_c, k = critical(crack), BODY / (BODY + LAYER)
    root = np.sqrt(4 * e_c**2 + 2 * k * ENERGY * (1 - NU**2) / (E * LAYER))
    return at_ends(e_c + (root - 2 * e_c) / k, crack)
