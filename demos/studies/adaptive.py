"""Meshes that follow a crack against a mesh that is fine all along its way: unknowns, time, curves.

A double cantilever beam, end-notched flexure, mixed-mode bending and a strip of rubber that is
peeled at finite strain; scenes in ``parts/adaptive``.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

import matplotlib.pyplot as plt
import numpy as np
from parts.adaptive.scenes import SCENES, Scene
from parts.options import run
from parts.tables import markdown, report

import vmdg


@dataclass(frozen=True)
class Ran:
    """A run: its history, seconds of processor time, its largest number of unknowns, its meshes."""

    history: vmdg.History
    seconds: float
    unknowns: int
    meshes: int


def follow(scene: Scene) -> Ran:
    """On meshes that follow the crack."""
    start = process_time()
    found = vmdg.solve_adaptively(
        scene.make,
        scene.loads,
        scene.fine,
        scene.window,
        scene.options,
        scene.monitor,
        until=scene.until,
    )
    seconds, unknowns = process_time() - start, int(found.history["unknowns"].max())
    return Ran(found.history, seconds, unknowns, len(found.results))


def stay(scene: Scene) -> Ran:
    """On one mesh."""
    start = process_time()
    problem = scene.make(scene.everywhere)
    history = vmdg.solve(
        problem, scene.loads, scene.options, scene.monitor, until=scene.until
    ).history
    dofmap = problem.space.dofmap
    unknowns = dofmap.index_map.size_global * dofmap.index_map_bs
    return Ran(history, process_time() - start, unknowns, 1)


def differences(one: Ran, other: Ran) -> tuple[float, float]:
    """Of the peak, and the largest one of the curves, relative to the peak of the other run.

    Curves are compared where both have a row of the same load factor, or, along a path that turns
    back, where the same energy is dissipated.
    """
    force = [ran.history["force"] for ran in (one, other)]
    peak = force[1].max()
    load, there = (ran.history["load"] for ran in (one, other))
    both = np.intersect1d(load, there)
    if len(both) > 5:
        curves = [f[np.searchsorted(t, both)] for f, t in zip(force, (load, there), strict=True)]
    else:
        spent, known = (ran.history["damage"] for ran in (one, other))
        begun = spent > known[known > 0].min()
        curves = [force[0][begun], np.interp(spent[begun], known, force[1])]
    return force[0].max() / peak - 1, abs(curves[0] - curves[1]).max() / peak


def line(scene: Scene, runs: list[Ran]) -> list[object]:
    peak, curve = differences(*runs)
    cells = [scene.title, runs[0].meshes]
    for what in ("unknowns", "seconds"):
        values = [getattr(ran, what) for ran in runs]
        cells += [f"{value:,.0f}" for value in values] + [f"{values[0] / values[1]:.2f}"]
    return [*cells, f"{100 * peak:+.2f} %", f"{100 * curve:.2f} %"]


def main(names: list[str] | None = None, out: str = "results/adaptive") -> list[list[object]]:
    """Run the scenes in both ways; the lines of the table.

    Args:
        names: Scenes, all without one.
        out: Folder for table and picture.
    """
    if unknown := set(names or ()) - set(SCENES):
        raise ValueError(f"adaptive: {unknown.pop()!r} must be one of {', '.join(SCENES)}")
    chosen = {name: SCENES[name] for name in names or SCENES}
    size = (1.8 + 3.2 * len(chosen), 3.4)
    figure, axes = plt.subplots(1, len(chosen), figsize=size, squeeze=False)
    lines = []
    for ax, make in zip(axes.flat, chosen.values(), strict=True):
        scene = make()
        runs = {"mesh that follows the crack": follow(scene), "fine mesh all along": stay(scene)}
        lines.append(line(scene, list(runs.values())))
        for (label, ran), style in zip(runs.items(), ("C0-", "k--"), strict=True):
            ax.plot(ran.history["motion"], ran.history["force"], style, label=label)
        ax.set(xlabel="displacement [mm]", ylabel="force [N]", title=scene.title)
    axes.flat[0].legend()
    figure.tight_layout()
    head = ["scene", "meshes", *("unknowns", "fixed", "ratio"), *("s", "fixed", "ratio")]
    report(out, "adaptive", markdown([*head, "peak", "curve"], lines), figure)
    return lines


if __name__ == "__main__":
    run(main)
