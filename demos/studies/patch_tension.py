"""Two bonded blocks pulled apart: the patch test 7.1.1 of the report, Table 1, Figures 4 and 5.

Two bricks of 1 mm share the interface x = 1. Pulling the right end by delta first stretches both,
then the bond softens along the straight line of Figure 2, and from zeta = zeta_c on the blocks
are free. The whole curve has a closed form, drawn with the computed points.
"""

from __future__ import annotations

from pathlib import Path
from time import perf_counter

from mpi4py import MPI

import numpy as np
from parts.options import run
from parts.patch import (
    MATERIAL,
    Snapshots,
    build,
    report_stabilization,
    residual_norms,
    softening_bar,
)

import vmdg

LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2)
TABLE_1 = (2.8833671e1, 2.9488081e-1, 2.5465645e-5, 7.6179649e-13)
SHOWN = {0.04: r"bonded: $\zeta$ = 0", 0.12: r"$\zeta$ = 0.0998 mm", 0.26: r"$\zeta$ = 0.26 mm"}


def table() -> list[float]:
    """Residual norms of the step delta = 0.10 to 0.12 with 2 x 2 x 1 bricks per block (Table 1)."""
    stabilization = report_stabilization(MATERIAL)
    problem, tagged = build(LAW, (2, 2, 1), comm=MPI.COMM_SELF, stabilization=stabilization)
    problem.dirichlet(tagged.facet_tags.find(5), 0.0, "y")
    corner = np.array([[0.0], [1.0], [0.0]])
    problem.dirichlet_points(lambda x: np.isclose(x, corner).all(axis=0), 0.0, "z")
    vmdg.solve(problem, 0.02 * np.arange(1, 6), vmdg.SolveOptions(relative_tolerance=1e-12))
    return residual_norms(problem, 0.12)


def main(
    steps: int = 20,
    end: float = 0.4,
    out: str = "results/patch_tension",
    plot: bool = True,
    verbose: bool = False,
) -> vmdg.History:
    """Pull the blocks apart; the history of the run.

    Args:
        steps: Load steps.
        end: Displacement of the right end at the end [mm].
        out: Folder for picture, history and ParaView fields.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    start = perf_counter()
    problem, tagged = build(LAW)
    problem.dirichlet(tagged.facet_tags.find(5), 0.0, "y")
    problem.dirichlet(tagged.facet_tags.find(6), 0.0, "z")
    problem.discretization.compile()
    compiled = perf_counter()
    pictures = Snapshots(SHOWN, (0, 100)) if plot else None

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        fields.write(problem.t)
        if pictures:
            pictures.take(problem)
        mean = problem.mean(0)
        zeta, traction = softening_bar(problem.t, MATERIAL, LAW)
        return {
            "zeta [mm]": mean.gap[0],
            "traction [MPa]": mean.traction[0],
            "force [N]": problem.reaction(tagged.facet_tags.find(2))[0],
            "zeta_exact [mm]": zeta,
            "traction_exact [MPa]": traction,
        }

    table_file = Path(out) / "history.csv"
    options = vmdg.SolveOptions(
        relative_tolerance=1e-11, control="load", progress=True, verbose=verbose, csv=table_file
    )
    loads = end / steps * np.arange(1, steps + 1)
    with vmdg.FieldWriter(problem, Path(out) / "fields") as fields:
        history = vmdg.solve(problem, loads, options, monitor).history

    if problem.comm.rank == 0 and pictures:
        curve = pictures.curve
        curve.plot(history["zeta_exact"], history["traction_exact"], label="closed form")
        curve.plot(history["zeta"], history["traction"], "o", mfc="none", label="vmdg")
        curve.set(xlabel=r"residual gap $\zeta_n$ [mm]", ylabel=r"traction $T_n$ [MPa]")
        curve.legend()
        pictures.figure.savefig(Path(out) / "patch_tension.png")
    if problem.comm.rank == 0:
        print(f"mesh and kernels {compiled - start:.2f} s, steps {perf_counter() - compiled:.2f} s")
        print("Table 1, residual norm [N]     report         vmdg")
        for i, (report, norm) in enumerate(zip(TABLE_1, table(), strict=False), start=1):
            print(f"  iteration {i}              {report:.7e}  {norm:.7e}")
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    run(main)
