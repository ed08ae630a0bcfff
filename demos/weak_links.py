"""Weak links: bars that break one after the other, by jumps and along the equilibrium path.

Bars between rigid grips, each with a bond of different strength in its middle, so brittle that it
cannot unload its bar in equilibrium while the grips move apart: at its strength a bar snaps. A
testing machine jumps to the next equilibrium; the path turns back instead until the bond is broken
and rises again along a softer line.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx.mesh import locate_entities_boundary

import vmdg
from vmdg.meshes import distribute, model


def bundle(
    comm: MPI.Comm,
    strengths: np.ndarray,
    critical_gap: float | Callable[[np.ndarray], np.ndarray],
    way: Callable[[float], float] = lambda t: t,
    **law: str,
) -> tuple[vmdg.Problem, Callable[[vmdg.Problem], dict[str, float]]]:
    """Bars between rigid grips, each of two bonded halves, and a monitor of the force on the grip.

    The grip moves so that an unbroken bar carries 10 MPa times ``way(t)``. Other parameters of the
    bonds go to :class:`vmdg.Debonding`.
    """
    length, width, E = 1.0, 0.05, 1000.0
    with model("bundle") as g:
        for n in range(len(strengths)):
            for x in (0.0, length):
                g.occ.addRectangle(x, 2 * n * width, 0, length, width)
        g.occ.removeAllDuplicates()
        g.occ.synchronize()
        for _, curve in g.getEntities(1):
            g.mesh.setTransfiniteCurve(curve, 2)
        for _, surface in g.getEntities(2):
            g.mesh.setTransfiniteSurface(surface)
            g.mesh.setRecombine(2, surface)
        for half in (1, 2):
            g.addPhysicalGroup(2, range(half, 2 * len(strengths) + 1, 2), half)
        g.mesh.generate(2)
        mesh, cells, _ = distribute(g, comm, 2)
    debonding = vmdg.Debonding(
        strength=lambda x: strengths[np.floor(x[1] / (2 * width)).astype(int)],
        critical_gap=critical_gap,
        **law,
    )
    body, bond = vmdg.NeoHookean(E=E, nu=0.0), vmdg.Interface(between=(1, 2), law=debonding)
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond], kinematics="small")
    grip = locate_entities_boundary(mesh, 1, lambda x: np.isclose(x[0], 2 * length))
    problem.dirichlet(lambda x: np.isclose(x[0], 0.0), 0.0)
    problem.dirichlet(grip, lambda t: (20.0 * length / E * way(t), 0.0))
    return problem, lambda p: {"force": p.reaction(grip)[0] / width}


def order_statistics(strengths: np.ndarray, stress: float) -> float:
    """Force of brittle bars over their width: those of enough strength carry the stress [MPa]."""
    return stress * (strengths > stress).sum()


def main(
    bars: int = 4,
    critical_gap: float = 0.006,
    steps: int = 20,
    seed: int = 3,
    out: str = "results/weak_links",
) -> dict[str, vmdg.History]:
    """Pull the grips apart twice; the histories of both ways."""
    strengths = np.sort(np.random.default_rng(seed).uniform(4.0, 10.0, bars))
    figure, ax = plt.subplots(figsize=(8, 4.5), layout="constrained")
    stress, histories = np.linspace(0, 10, 1000), {}
    exact = [order_statistics(strengths, each) for each in stress]
    ax.plot(stress, exact, color="0.8", lw=6, label="order statistics")
    for unstable, style in (("trace", "C0.-"), ("jump", "C1--")):
        problem, monitor = bundle(MPI.COMM_WORLD, strengths, critical_gap)
        shown = {"progress": True, "csv": f"{out}/{unstable}.csv"}
        options = vmdg.SolveOptions(unstable=unstable, energy=True, **shown)
        histories[unstable] = history = vmdg.solve(problem, steps, options, monitor).history
        label = f'unstable="{unstable}"'
        ax.plot(10 * history["load"], history["force"], style, lw=1, ms=4, label=label)
    ax.set(xlabel="stress of an unbroken bar [MPa]", ylabel="force over width of a bar [MPa]")
    ax.set(xlim=(0, None), ylim=(0, None))
    ax.legend(loc="upper left")
    if MPI.COMM_WORLD.rank == 0:
        figure.savefig(f"{out}/weak_links.png")
        print(f"results are in {out}")
    return histories


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--bars", type=int, default=4, help="number, of strength 4 to 10 MPa")
    snap = "gap at which a bond is broken [mm]; below 2 L P_c/E = 0.008 mm every bar snaps"
    command.add_argument("--critical-gap", type=float, default=0.006, help=snap)
    command.add_argument("--steps", type=int, default=20, help="load steps")
    command.add_argument("--seed", type=int, default=3, help="seed of the strengths")
    command.add_argument("--out", default="results/weak_links", help="folder for the results")
    main(**vars(command.parse_args()))
