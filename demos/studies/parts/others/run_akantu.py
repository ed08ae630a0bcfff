"""A scene by Akantu: its implicit static solver, Newton's method with MUMPS.

Intrinsic cohesive elements are there from the start and have an elastic branch; extrinsic ones are
inserted where the stress has reached the strength, checked once per step as in Akantu's examples:
solving a step again after an insertion, until there is no other, does not converge in P1.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

import akantu
import numpy as np
from grid import Layers, answer, layers

#: Tags of the groups of the mesh.
GROUPS = ("lower", "upper", "bond", "bottom", "top")
#: Of gmsh, by dimension: types of facets and cells.
TYPES = {2: (1, 3), 3: (3, 5)}
INPUT = """model solid_mechanics_model_cohesive [
  cohesive_inserter [
    cohesive_surfaces = [bond]
  ]
{materials}]
"""


def write_mesh(path: Path, mesh: Layers, crack: float) -> None:
    """A file of gmsh, in which layers share nodes where they are bonded."""
    d = mesh.nodes.shape[1]
    one = np.arange(len(mesh.nodes))
    lower, upper = mesh.twins[mesh.nodes[mesh.twins[:, 0], 0] > crack - 1e-9].T
    one[upper] = lower
    kept = np.unique(one)
    number = 1 + np.searchsorted(kept, one)
    below, above = mesh.cells
    half, heights = 2 ** (d - 1), mesh.nodes[:, -1]
    floor, roof = below[:, :half], above[:, half:]
    parts = (
        below,
        above,
        mesh.faces[:, 0],
        floor[(heights[floor] == heights.min()).all(axis=1)],
        roof[(heights[roof] == heights.max()).all(axis=1)],
    )
    lines = ["$MeshFormat", "2.2 0 8", "$EndMeshFormat", "$PhysicalNames", f"{len(GROUPS)}"]
    for tag, name in enumerate(GROUPS, 1):
        lines.append(f'{d - (tag > 2)} {tag} "{name}"')
    lines += ["$EndPhysicalNames", "$Nodes", f"{len(kept)}"]
    for i, x in enumerate(mesh.nodes[kept], 1):
        lines.append(f"{i} {' '.join(f'{v:.16g}' for v in (*x, 0.0)[:3])}")
    lines += ["$EndNodes", "$Elements", f"{sum(map(len, parts))}"]
    elements = ((tag, cell) for tag, cells in enumerate(parts, 1) for cell in cells)
    for i, (tag, cell) in enumerate(elements, 1):
        lines.append(f"{i} {TYPES[d][tag < 3]} 2 {tag} {tag} {' '.join(map(str, number[cell]))}")
    path.write_text("\n".join([*lines, "$EndElements", ""]))


def material(kind: str, **values: Any) -> str:
    lines = "".join(f"    {name} = {value}\n" for name, value in values.items())
    return f"  material {kind} [\n{lines}  ]\n"


def read(grid: Layers, crack: float, text: str) -> akantu.Mesh:
    """The mesh of two layers, after an input file with this text."""
    with TemporaryDirectory() as folder:
        file, given = Path(folder) / "mesh.msh", Path(folder) / "input"
        write_mesh(file, grid, crack)
        given.write_text(text)
        akantu.parseInput(str(given))
        mesh = akantu.Mesh(grid.nodes.shape[1])
        mesh.read(str(file))
    return mesh


def run(
    scene: dict[str, Any],
    end: float,
    steps: int,
    opening: float | None,
    tolerance: float,
    finite: bool,
) -> tuple[float, int, list[tuple[float, float]]]:
    """Processor seconds of the steps, linear systems, and displacement and force of every step.

    Args:
        scene: Fields of a scene of `parts.benchmark.peers`, and its material.
        end: Last displacement of the top [mm].
        opening: At the strength [mm]; None for extrinsic elements.
        tolerance: Of the forces, relative to the strength of the bond.
    """
    extrinsic, strength = opening is None, scene["strength"]
    elastic = {"rho": 1.0, "E": scene["E"], "nu": scene["nu"]}  # a density must be given
    elastic["finite_deformation"] = str(finite).lower()
    law = {"sigma_c": strength, "beta": 1.0, "G_c": strength * scene["critical_gap"] / 2}
    law |= {"penalty": 1e6} if extrinsic else {"delta_0": opening, "penalty": strength / opening}
    materials = material("elastic", name="lower", **elastic)
    materials += material("elastic", name="upper", **elastic)
    materials += material(f"cohesive_{'linear' if extrinsic else 'bilinear'}", name="bond", **law)
    grid = layers(scene["divisions"], scene["sizes"], scene["crack"])
    d = grid.nodes.shape[1]
    mesh = read(grid, scene["crack"], INPUT.format(materials=materials))
    model = akantu.SolidMechanicsModelCohesive(mesh)
    static = akantu.AnalysisMethod.__members__["_static"]
    model.initFull(_analysis_method=static, _is_extrinsic=extrinsic)
    if extrinsic:
        model.updateAutomaticInsertion()
    solver = model.getNonLinearSolver("static")
    solver.set("max_iterations", 100)
    solver.set("threshold", tolerance * strength * scene["area"])
    solver.set("convergence_type", akantu.SolveConvergenceCriteria.residual)
    *sideways, up = map(akantu.SpatialDirection, range(d))
    for axis in (*sideways, up):
        model.applyBC(akantu.FixedValue(0.0, axis), "bottom")
    for axis in sideways:
        model.applyBC(akantu.FixedValue(0.0, axis), "top")
    # A copy, because insertions move the group in memory.
    top = np.array(mesh.getElementGroup("top").getNodeGroup().getNodes()).ravel()
    solves, curve, start = 0, [], process_time()
    for u in np.linspace(end / steps, end, steps):
        model.applyBC(akantu.FixedValue(u, up), "top")
        try:
            model.solveStep("static")
        except akantu.NLSNotConvergedException:
            sys.exit(f"Newton's method does not converge at {u:g} mm")
        solves += solver.getInt("nb_iterations")
        curve.append((float(u), -float(model.getInternalForce()[top, d - 1].sum())))
        if extrinsic:
            model.checkCohesiveStress()
    return process_time() - start, solves, curve


if __name__ == "__main__":
    answer(run)
