"""A scene by fedoo: Newton's method with its direct solver, PARDISO, on interface elements.

The law has an elastic branch, whose opening at the strength is given. Of the two tangents that
fedoo offers it is the consistent one: with the other, its default, steps of P1 take 4 to 15
iterations in place of 1 to 3, and some are cut. Forces are compared with the strength times the
bonded area, because a residual relative to the present force, its default, cannot converge when
the bond is gone.
"""

from __future__ import annotations

from time import process_time
from typing import Any

import fedoo
import numpy as np
from grid import answer, layers


def run(
    scene: dict[str, Any], end: float, steps: int, opening: float, tolerance: float, finite: bool
) -> tuple[float, int, list[tuple[float, float]]]:
    """Processor seconds of the steps, linear systems, and displacement and force of every step.

    Args:
        scene: Fields of a scene of `parts.benchmark.peers`, and its material.
        end: Last displacement of the top [mm].
        opening: At the strength [mm].
        tolerance: Of the forces, relative to the strength of the bond.
        finite: At finite strain (updated Lagrangian), else small.
    """
    mesh = layers(scene["divisions"], scene["sizes"], scene["crack"])
    d = mesh.nodes.shape[1]
    fedoo.ModelingSpace("2D" if d == 2 else "3D")  # plane strain
    cell, facet = {2: ("quad4", "lin2interface"), 3: ("hex8", "quad4interface")}[d]
    body = fedoo.Mesh(mesh.nodes, np.concatenate(mesh.cells), cell, ndim=d)
    bond = fedoo.Mesh(mesh.nodes, mesh.faces.reshape(len(mesh.faces), -1), facet, ndim=d)
    strength, energy = scene["strength"], scene["strength"] * scene["critical_gap"] / 2
    law = fedoo.constitutivelaw.CohesiveLaw(
        **{"GIc": energy, "SImax": strength, "KI": strength / opening},
        **{"GIIc": energy, "SIImax": strength, "KII": strength / opening},
        axis=d - 1,
        tangent_mode="consistent",
    )
    elastic = fedoo.constitutivelaw.ElasticIsotrop(scene["E"], scene["nu"])
    bodies = fedoo.Assembly.create(fedoo.weakform.StressEquilibrium(elastic), body)
    interface = fedoo.Assembly.create(fedoo.weakform.InterfaceForce(law), bond)
    problem = fedoo.problem.NonLinear(bodies + interface, nlgeom=finite)
    height = mesh.nodes[:, -1]
    top = np.flatnonzero(height == height.max())
    *sideways, up = ("DispX", "DispY", "DispZ")[:d]
    problem.bc.add("Dirichlet", np.flatnonzero(height == height.min()), "Disp", 0.0)
    for name in sideways:
        problem.bc.add("Dirichlet", top, name, 0.0)
    problem.bc.add("Dirichlet", top, up, end)
    problem.set_nr_criterion(err0=strength * scene["area"], tol=tolerance)

    solves, solve, curve = [], problem.solve, []

    def counted(**options: Any) -> None:
        solves.append(1)
        solve(**options)

    def record(problem: Any) -> None:
        curve.append((problem.time * end, float(problem.get_ext_forces(up)[top].sum())))

    problem.solve = counted
    problem.initialize()
    start = process_time()
    problem.nlsolve(
        dt=1 / steps,
        dt_max=1 / steps,
        tmax=1.0,
        print_info=0,
        callback=record,
        exec_callback_at_each_iter=True,
    )
    return process_time() - start, len(solves), curve


if __name__ == "__main__":
    answer(run)
