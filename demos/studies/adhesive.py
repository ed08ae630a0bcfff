"""An adhesive as an interface, as an elastic layer and as a plastic layer: what it changes.

Two plates are peeled apart at one end, or sheared along each other and held against bending. The
bond is the same everywhere; a layer has it in its middle.
"""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import CellType, create_rectangle, meshtags
from parts.options import run
from parts.tables import markdown, report
from tqdm import tqdm

import vmdg

PLATE = vmdg.NeoHookean(E=70e3, nu=0.33)
LAYER = {"E": 2000.0, "nu": 0.35}  # MPa
BOND = vmdg.MixedModeDebonding(
    normal_strength=40.0, shear_strength=40.0, normal_energy=1.0, shear_energy=3.0
)
HEIGHT = 3.0  # of a plate [mm]
#: Thickness of the layer [mm], and its yield stress [MPa]; None for an elastic one.
LAYERS = {
    "interface": (0.0, None),
    "elastic, 0.2 mm": (0.2, None),
    "elastic, 1 mm": (1.0, None),
    "yields at 60 MPa, 0.2 mm": (0.2, 60.0),
    "yields at 30 MPa, 0.2 mm": (0.2, 30.0),
    "yields at 30 MPa, 1 mm": (1.0, 30.0),
}


def plates(
    length: float, crack: float, layer: float, yields: float | None, facet: float
) -> vmdg.Problem:
    """Two plates, and half a layer on each of them; lengths in mm, the yield stress in MPa."""
    upper = [0.0] * (layer > 0) + [layer / 2, *(layer / 2 + np.linspace(0, HEIGHT, 4)[1:])]
    levels = np.unique([*upper, *(-y for y in upper)])
    corner = np.array([length, len(levels) - 1.0])
    size = round(length / facet), len(levels) - 1
    mesh = create_rectangle(MPI.COMM_WORLD, [0 * corner, corner], size, CellType.quadrilateral)
    x = mesh.geometry.x
    x[:, 1] = levels[np.rint(x[:, 1]).astype(int)]
    middle = x[mesh.geometry.dofmap, 1].mean(axis=1)
    parts = 2 * (np.abs(middle) < layer / 2) + (middle > 0)
    tags = meshtags(mesh, 2, np.arange(len(middle), dtype=np.int32), parts.astype(np.int32))
    glue = vmdg.NeoHookean(**LAYER)
    if yields:
        glue = vmdg.J2(**LAYER, yield_stress=yields, hardening=50.0)
    bodies = {0: PLATE, 1: PLATE} | ({2: glue, 3: glue} if layer else {})
    precrack = {"initial_damage": lambda x: 1.0 * (x[0] < crack)} if crack else {}
    bond = vmdg.Interface(between=(2, 3) if layer else (0, 1), law=BOND, name="bond", **precrack)
    return vmdg.Problem(mesh, tags, bodies, [bond], degree=2, kinematics="small")


def peeled(layer: float, yields: float | None, facet: float) -> vmdg.History:
    """Opened at the end with the crack; the load factor is the opening [mm]."""
    problem, top = plates(80.0, 30.0, layer, yields, facet), HEIGHT + layer / 2

    def corner(x: np.ndarray, side: int = 1) -> np.ndarray:
        return np.isclose(x[0], 0.0) & np.isclose(x[1], side * top)

    problem.dirichlet_points(corner, lambda t: t / 2, "y")
    problem.dirichlet_points(lambda x: corner(x, -1), lambda t: -t / 2, "y")
    problem.dirichlet(lambda x: np.isclose(x[0], 80.0), 0.0)
    return loaded(problem, 6.0, lambda problem: problem.reaction_points(corner)[1])


def sheared(layer: float, yields: float | None, facet: float) -> vmdg.History:
    """Pulled at opposite ends; the load factor is the displacement of the upper plate [mm]."""
    problem, top = plates(25.0, 0.0, layer, yields, facet), HEIGHT + layer / 2

    def end(x: np.ndarray) -> np.ndarray:
        return np.isclose(x[0], 25.0) & (x[1] > layer / 2 - 1e-6)

    problem.dirichlet(lambda x: np.isclose(x[0], 0.0) & (x[1] < 1e-6 - layer / 2), 0.0, "x")
    problem.dirichlet(end, lambda t: t, "x")
    problem.dirichlet(lambda x: np.isclose(abs(x[1]), top), 0.0, "y")
    return loaded(problem, 0.5, lambda problem: problem.reaction(end)[0])


def loaded(
    problem: vmdg.Problem, most: float, force: Callable[[vmdg.Problem], float]
) -> vmdg.History:
    loads = np.linspace(0.0, most, 31)[1:]
    return vmdg.solve(
        problem, loads, monitor=lambda problem: {"force [N/mm]": force(problem)}
    ).history


def main(
    layers: list[str] | None = None, facet: float = 1.0, out: str = "results/adhesive"
) -> dict[str, dict[str, vmdg.History]]:
    """Pull all joints; histories by joint and layer.

    Args:
        layers: Some of LAYERS, all by default.
        facet: Size of the facets [mm].
        out: Folder for table and picture.
    """
    joints = {"peeled": peeled, "sheared": sheared}
    found: dict[str, dict[str, vmdg.History]] = {name: {} for name in joints}
    figure, axes = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    rows = []
    for (joint, pull), ax in zip(joints.items(), axes, strict=True):
        for i, name in enumerate(tqdm(layers or LAYERS, desc=joint, disable=None)):
            found[joint][name] = history = pull(*LAYERS[name], facet)
            way, force = history["load"], history["force"]
            # Curves that lie on each other are seen by their widths.
            ax.plot(np.append(0.0, way), np.append(0.0, force), lw=3.5 - 0.45 * i, label=name)
            stiffness, peak = force[0] / way[0], force.argmax()
            numbers = (f"{x:.4g}" for x in (stiffness, force[peak], way[peak]))
            rows.append((joint, name, *numbers))
        ax.set(title=joint, xlabel="displacement [mm]", ylabel="force [N/mm]", ylim=(0, None))
    axes[0].legend(loc="lower right")
    head = "joint", "layer", "stiffness [N/mm2]", "largest force [N/mm]", "displacement there [mm]"
    report(out, "adhesive", markdown(head, rows), figure)
    return found


if __name__ == "__main__":
    run(main)
