"""A block with a round bottom is pressed into a soft foundation and drawn along it, with friction.

The shallow ironing test of Fischer and Wriggers (2006) in plane strain, with the measures of
Yastrebov (2011): bodies with meshes of their own, a foundation that gives way by a quarter of its
height, and a way of fifty of its facets. Published forces differ by a quarter at the end of
pressing, and by a factor of two along the foundation.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import (
    CellType,
    Mesh,
    MeshTags,
    create_rectangle,
    meshtags,
)
from numpy.typing import ArrayLike, NDArray

import vmdg
from vmdg.meshes import apart

#: Foundation [0, 12] x [0, 4], block [0.2, 1.4] x [4.2, 5.4] with an arc of 0.3 at its bottom [mm].
LENGTH, HEIGHT, LEFT, WIDTH, GAP, RISE, TOP = 12.0, 4.0, 0.2, 1.2, 0.2, 0.3, 5.4
FOUNDATION, BLOCK = vmdg.NeoHookean(E=689.6, nu=0.32), vmdg.NeoHookean(E=6896.0, nu=0.32)  # MPa
FRICTION, DOWN, ALONG = 0.3, 1.0, 10.0  # down [mm] until t = 1, then along [mm] until t = 2
#: Forces down and along at t = 1 and 1.5 [N/mm], as solids4foam tabulates them.
PUBLISHED = {
    "Fischer and Wriggers 2006": ((297.9, 365.1), (62.1, 188.8)),
    "Hartmann et al. 2009": ((319.5, 408.4), (67.2, 160.2)),
    "Yastrebov 2011": ((289.7, 359.5), (58.5, 170.8)),
    "Poulios and Renard 2015": ((267.9, 337.4), (55.3, 102.1)),
    "code_aster SSNP153": ((332.0, 421.0), (71.0, 143.3)),
    "solids4foam": ((316.4, 395.1), (55.0, 122.7)),
}


def bottom(x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of the bottom of the block [mm]; of its ends where it is not."""
    radius = (WIDTH**2 / 4 + RISE**2) / (2 * RISE)
    away = np.clip(x - LEFT - WIDTH / 2, -WIDTH / 2, WIDTH / 2)
    return HEIGHT + GAP + radius - np.sqrt(radius**2 - away**2)


def part(tag: int, corners: ArrayLike, n: tuple[int, int]) -> tuple[Mesh, MeshTags, MeshTags]:
    """A rectangle of quadrilaterals, as if from a file of its own."""
    mesh = create_rectangle(MPI.COMM_WORLD, np.array(corners), n, CellType.quadrilateral)
    cells = np.arange(mesh.topology.index_map(2).size_local, dtype=np.int32)
    none = np.zeros(0, dtype=np.int32)
    return mesh, meshtags(mesh, 2, cells, np.full_like(cells, tag)), meshtags(mesh, 1, none, none)


def main(cells: int = 60, steps: int = 60, end: float = 2.0, out: str = "results/ironing"):
    """Press the block down and draw it along; the history."""
    foundation = part(1, [[0.0, 0.0], [LENGTH, HEIGHT]], (cells, cells // 4))
    block = part(2, [[LEFT, 0.0], [LEFT + WIDTH, 1.0]], (cells // 7, cells // 10))
    x = block[0].geometry.x
    x[:, 1] = (1 - x[:, 1]) * bottom(x[:, 0]) + x[:, 1] * TOP
    mesh, tags, _ = apart([foundation, block])
    contact = vmdg.Contact(friction=FRICTION)
    interface = vmdg.Interface(between=(1, 2), law=contact, sliding=True)
    problem = vmdg.Problem(mesh, tags, {1: FOUNDATION, 2: BLOCK}, [interface])

    def top(x):
        return np.isclose(x[1], TOP)

    problem.dirichlet(lambda x: np.isclose(x[1], 0.0), 0.0)
    problem.dirichlet(top, lambda t: (ALONG * max(t - 1, 0), -DOWN * min(t, 1)))

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        along, down = problem.reaction(top)
        return {"down [N/mm]": -down, "along [N/mm]": along}

    press, draw = np.linspace(0, 1, steps // 4 + 1)[1:], np.linspace(1, 2, steps + 1)[1:]
    loads = np.append(press, draw)
    shown = {"progress": True, "show": ("down", "along"), "csv": Path(out) / "history.csv"}
    history = vmdg.solve(
        problem, loads[loads <= end + 1e-9], vmdg.SolveOptions(**shown), monitor
    ).history

    figure, (curve, bodies) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    for name, style in (("down", "C0"), ("along", "C1")):
        curve.plot(history["load"], history[name], style, label=name)
    for k, (name, forces) in enumerate(PUBLISHED.items()):
        curve.plot(2 * [1.0, 1.5], np.ravel(forces), "ov^sDx"[k], color="0.4", ms=4, label=name)
    curve.set(xlabel="load factor: pressed until 1, then drawn along", ylabel="force [N/mm]")
    figure.legend(loc="outside upper left", ncols=4)
    vmdg.plot.stress(problem, "mises", ax=bodies)
    figure.savefig(Path(out) / "ironing.png")
    print(f"last forces {history['down'][-1]:.4g} N/mm down, {history['along'][-1]:.4g} along")
    print(f"results are in {out}")
    return history


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--cells", type=int, default=60, help="cells along the foundation")
    command.add_argument("--steps", type=int, default=60, help="load steps of the way along")
    command.add_argument("--end", type=float, default=2.0, help="last load factor, at most 2 [-]")
    command.add_argument("--out", default="results/ironing", help="folder for the results")
    main(**vars(command.parse_args()))
