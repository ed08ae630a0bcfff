"""Steps of central differences by Akantu: seconds of a step of two cubes on which waves run."""

from __future__ import annotations

import sys
from time import process_time

import akantu
from grid import layers
from run_akantu import INPUT, material, read

#: Of one body, as INPUT is with an interface.
BODY = "model solid_mechanics_model [\n{materials}]\n"
STEPS, REPEATS = 30, 3


def seconds(n: int, finite: bool, bonded: bool) -> float:
    """The least of some runs.

    Args:
        n: Cells along an edge of a cube.
        finite: At finite strain, else small.
        bonded: With intrinsic cohesive elements between the cubes, all of which soften.
    """
    elastic = {"rho": 1.0, "E": 1.0, "nu": 0.3, "finite_deformation": str(finite).lower()}
    law = {"sigma_c": 1e-5, "beta": 1.0, "G_c": 5e-6, "delta_0": 1e-4, "penalty": 0.1}
    materials = material("elastic", name="lower", **elastic)
    materials += material("elastic", name="upper", **elastic)
    if bonded:
        materials += material("cohesive_bilinear", name="bond", **law)
    text = (INPUT if bonded else BODY).format(materials=materials)
    mesh = read(layers((n, n, 2 * n), (1.0, 1.0, 2.0), -1.0), -1.0, text)
    explicit = akantu.AnalysisMethod.__members__["_explicit_lumped_mass"]
    if bonded:
        model = akantu.SolidMechanicsModelCohesive(mesh)
        model.initFull(_analysis_method=explicit, _is_extrinsic=False)
    else:
        model = akantu.SolidMechanicsModel(mesh)
        model.initFull(_analysis_method=explicit)
    model.setTimeStep(0.5 * model.getStableTimeStep())
    model.getVelocity()[:, 2] = 1e-2 * (mesh.getNodes()[:, 2] - 1)
    model.solveStep()
    taken = []
    for _ in range(REPEATS):
        start = process_time()
        for _ in range(STEPS):
            model.solveStep()
        taken.append((process_time() - start) / STEPS)
    return min(taken)


if __name__ == "__main__":
    number, *chosen = map(int, sys.argv[1:])
    print(seconds(number, *map(bool, chosen)))
