"""Patch test: a uniform traction passes a straight bonded interface, whatever the contrast."""

from __future__ import annotations

import numpy as np
import pytest
from support.checks import gather
from support.problems import joined
from support.scenes import DIMENSION, EVERY_CELL, EVERY_DEGREE, two_blocks

import vmdg

SOFT = 5000.0  # E of block 2, MPa; nu = 0 on both sides
STRETCH = 1.05  # of block 2
CONTRAST = 1e6  # of the moduli
TRACTION = SOFT / 2 * (STRETCH - 1 / STRETCH)  # P of (86) for nu = 0: mu (s - 1/s)

LAWS = {
    "tie": vmdg.Bonded(),
    # Not reached: onset at twice the traction. H = 250 MPa/mm is far below r.
    "law": vmdg.Debonding(strength=2 * TRACTION, critical_gap=2 * TRACTION / 250.0),
}

# u, g and T relative to the imposed displacement and traction. The stiff block is held and the soft
# one pulled: the other way round u of the stiff one would be rounded to eps |u|, and its stress,
# in any code, to eps E1/E2 of the traction, 2e-10 at a contrast of 1e6.
ROUNDING = 1e-12


def shift_nodes(mesh) -> None:
    """Cells of general shape, while all faces of the blocks and the interface stay plane."""
    x = mesh.geometry.x
    other = np.roll(x, 1, axis=1)
    x += 0.08 * np.sin(np.pi * x) * (1 + 0.5 * np.cos(2 * other))


@EVERY_CELL
@EVERY_DEGREE
@pytest.mark.parametrize("law", LAWS.values(), ids=LAWS.keys())
def test_uniform_traction(comm, cell, degree, law):
    """u is piecewise linear and T = P.N at every point and in the reaction, to 1e-12.

    With nu = 0 lateral stretches are 1 under uniaxial stress, so the exact solution is homogeneous
    in each block and lies in the space.
    """
    d = DIMENSION[cell]
    scene = two_blocks(comm, cell, n=2)
    shift_nodes(scene.mesh)
    materials = (vmdg.NeoHookean(E=SOFT * CONTRAST, nu=0.0), vmdg.NeoHookean(E=SOFT, nu=0.0))
    problem = joined(scene, law, materials, degree=degree)

    ratio = TRACTION / materials[0].parameters["mu"]
    strain = (ratio + np.sqrt(ratio**2 + 4)) / 2 - 1  # of block 1: the root of P(s) = TRACTION
    end = strain + STRETCH - 1
    left, right = scene.facet_tags.find(1), scene.facet_tags.find(2)
    problem.dirichlet(left, 0.0, "x")
    problem.dirichlet(right, lambda t: t * end, "x")
    # Lateral displacements vanish everywhere: hold them at the left end only, as rigid motions.
    for component in ("y", "z")[: d - 1]:
        problem.dirichlet(left, 0.0, component)

    # Repeating a load factor is one more Newton correction, beyond what the tolerance can ask:
    # the residual of the stiff block is rounded to eps E1, which hides that of the soft one.
    options = vmdg.SolveOptions(relative_tolerance=1e-13)
    vmdg.solve(problem, [0.5, 1.0, 1.0, 1.0], options)

    state = problem.state[0]
    x = problem.space.tabulate_dof_coordinates()[:, 0]
    u = problem.u.x.array.reshape(-1, d)
    exact = np.where(x < 1, strain * x, strain + (STRETCH - 1) * (x - 1))
    error = np.abs(u - np.outer(exact, np.eye(d)[0])).max(initial=0.0)
    traction, opening = gather(comm, state.traction), gather(comm, state.opening)
    pulled = problem.reaction(right)
    assert comm.allreduce(error) < ROUNDING * end
    assert np.abs(opening).max() < ROUNDING * end
    assert np.abs(traction - TRACTION * np.eye(d)[0]).max() < ROUNDING * TRACTION
    assert np.abs(pulled - TRACTION * np.eye(d)[0]).max() < ROUNDING * TRACTION
    assert np.abs(gather(comm, state.gap)).max() == 0
