"""A punch in a perfectly plastic body: cells that do not lock find the load of Prandtl."""

from __future__ import annotations

import numpy as np
import pytest
from support.scenes import box

import vmdg

DEPTH, WIDTH, YIELD = 3.0, 4.0, 1.0
#: 5.14 k, k = sigma_y/sqrt(3), in plane strain (Prandtl 1920; Hill 1950).
LIMIT = (2 + np.pi) * YIELD / np.sqrt(3)


def limit_load(comm, n, degree, volumetric):
    """Force on half of a punch [0, 1], n graded cells along it, relative to the limit load.

    A tie lies across the slip lines.
    """
    mesh, tags = box(
        comm, [np.zeros(2), np.ones(2)], [3 * n, 2 * n], lambda x: 1 + (x[1] ** 2 > 1 / 4)
    )
    x = mesh.geometry.x
    s = 3 * x[:, 0] - 1
    x[:, 0] = np.where(s < 0, 1 - s**2, 1 + (WIDTH - 1) * (s / 2) ** 2)
    x[:, 1] = -DEPTH * x[:, 1] ** 2
    metal = vmdg.J2(1000.0, 0.3, YIELD)
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(
        mesh, tags, {1: metal, 2: metal}, [tie], degree, "small", volumetric=volumetric
    )
    punch = lambda x: np.isclose(x[1], 0) & (x[0] < 1 + 1e-9)  # noqa: E731
    problem.dirichlet(lambda x: np.isclose(x[1], -DEPTH), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[0], 0) | np.isclose(x[0], WIDTH), 0.0, "x")
    problem.dirichlet(punch, lambda t: -t, "y")
    vmdg.solve(problem, np.linspace(0, 0.06, 11)[1:])
    return -problem.reaction(punch)[1] / LIMIT


@pytest.mark.parametrize(("degree", "volumetric"), [(1, "mean"), (2, "pointwise")])
def test_punch(comm, degree, volumetric):
    """Limit loads are bounds from above: 1.017 and 1.012 are seen, 1.052 and 1.040 with n = 3."""
    assert 1.0 < limit_load(comm, 6, degree, volumetric) < 1.02


@pytest.mark.filterwarnings("ignore:plastic flow keeps the volume")
def test_locked(comm):
    """Cells of degree 1 without mean dilatation have no limit load, 1.15 and rising is seen."""
    assert limit_load(comm, 6, 1, "pointwise") > 1.1
