"""The tangent of bodies with two random features each is the derivative of the residual."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from support.checks import modes, tangent_error
from support.problems import partly_damaged
from support.scenes import pairs_of_features

import vmdg
from vmdg import Mode

ELASTIC = vmdg.NeoHookean(E=8000.0, nu=0.3)
METAL = vmdg.J2(4000.0, 0.3, 60.0, hardening=400.0, saturation=90.0, exponent=20.0)
SOIL = vmdg.DruckerPrager(4000.0, 0.3, 15.0, 35.0, dilatancy=10.0, hardening=60.0)
PLY = vmdg.Orthotropic(E=(9000.0, 4000.0, 3000.0), nu=(0.3,) * 3, G=(1500.0,) * 3, angle=30.0)


def loaded(problem: vmdg.Problem, scene) -> None:
    """A pressure on the boundary and in the bond, and springs."""

    def uneven(x, t):
        return 300 * t * (1 + x[0] + 0.5 * x[1])

    problem.pressure(scene.facet_tags.find(2), uneven)
    problem.pressure("bond", uneven)
    problem.spring(scene.facet_tags.find(1), (30.0, 7.0))


MATERIALS = {
    "metals": (METAL, METAL),
    "a metal": (METAL, ELASTIC),
    "soil": (ELASTIC, SOIL),
    "ply": (PLY, ELASTIC),
}
FEATURES: Mapping[str, Mapping[str, Any]] = {
    **{name: {"materials": both} for name, both in MATERIALS.items()},
    "small": {"kinematics": "small"},
    "turning": {"frame": "corotating"},
    "degree 2": {"degree": 2},
    "mean dilatation": {"volumetric": "mean"},
    "of revolution": {"symmetry": "axisymmetric"},
    "plane stress": {"plane": "stress"},
    "both forms": {"interface": {"traction_jump": True}},
    "swelling": {"eigenstrain": dict.fromkeys((1, 2), 0.004)},
    "strained": {"eigenstrain": dict.fromkeys((1, 2), np.diag([0.006, -0.004, 0.002]))},
    "pressures": {"loads": loaded},
}
EXCLUDE = [
    {*MATERIALS},
    {"of revolution", "plane stress"},
    {"mean dilatation", "plane stress"},
    {"mean dilatation", "degree 2"},
    {"swelling", "strained"},
    {"pressures", "plane stress"},  # F_33 at the faces of a crack is not that of the fluid
    *({"both forms", at_points} for at_points in ("metals", "a metal", "soil")),
]
#: What has been wrong, or is a form of its own.
MORE = [
    ("metals", "pressures"),
    ("a metal", "mean dilatation"),
    ("metals", "pressures", "mean dilatation"),
    ("a metal", "pressures", "of revolution"),
]
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


def cells_of(pair: tuple[str, ...]) -> list[str]:
    """Cells that can have the features."""
    cells = list(CELLS)
    if {"of revolution", "plane stress"} & {*pair}:
        cells = cells[:2]
    return cells[1::2] if "mean dilatation" in pair else cells


@pytest.mark.filterwarnings("ignore:plastic flow keeps the volume")
@pytest.mark.parametrize(
    ("pair", "cell"),
    [
        (pair, cells_of(pair)[number % len(cells_of(pair))])
        for number, pair in enumerate([*pairs_of_features(FEATURES, EXCLUDE, each=2), *MORE])
    ],
    ids=str,
)
def test_tangent(comm, pair, cell):
    """By differences, while the bond softens at some points and bodies flow."""
    options = {"degree": 1} | {"materials": (ELASTIC, ELASTIC)}
    for name in pair:
        options |= FEATURES[name]
    problem = partly_damaged(comm, cell, **options)
    assert tangent_error(problem) < 1e-7
    assert Mode.TENSION in modes(problem)
