"""Two blocks pressed along an inclined interface: 7.1.2 of the report, Table 2, Figure 7.

Pushing the right end by d shears the interface from (1, 0) to (1.5, 1). In compression only the
shear breaks the bond; when it is gone the right block slides down, free of stress. The report
prints |tau_s| of the lower (A) and the upper (B) facet for five states.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from parts.options import run
from parts.patch import MATERIAL, Snapshots, build, report_stabilization

import vmdg

LAW = vmdg.Debonding(strength=50.0, critical_gap=0.2)
LOADS = (0.0, -0.02, -0.04, -0.06, -0.10)
TABLE_2 = {
    "A": (1.3182e5, 1.3207e5, 1.3234e5, 1.3229e5, 1.3182e5),
    "B": (1.2769e5, 1.2801e5, 1.2836e5, 1.2829e5, 1.2769e5),
}
SHOWN = {-0.04: "d = -0.04 mm, bonded", -0.06: "d = -0.06 mm, damage", -0.10: "d = -0.10 mm, free"}


def facet_norms(problem: vmdg.Problem) -> dict[str, float]:
    """|tau_s| [MPa/mm] of the facets A (lower) and B (upper) at the current state."""
    problem.discretization.update_stabilization()
    active = problem.discretization.active[0]
    quadrature = active.quadrature
    heights = quadrature.points[quadrature.points_of_facet, 1].mean(axis=1)
    local = list(zip(heights, active.stabilization.norm, strict=True))
    ordered = sorted(pair for part in problem.comm.allgather(local) for pair in part)
    return dict(zip("AB", (float(norm) for _, norm in ordered), strict=True))


def main(
    out: str = "results/patch_shear", plot: bool = True, verbose: bool = False
) -> vmdg.History:
    """Press the right end by 0.10 mm; the history of the run.

    Args:
        out: Folder for picture, history and ParaView fields.
        plot: Draw the picture.
        verbose: Print the residuals of every step.
    """
    stabilization = report_stabilization(MATERIAL)
    problem, tagged = build(LAW, (2, 2, 1), (1.0, 1.5), stabilization=stabilization)
    problem.dirichlet(lambda x: np.isclose(x[1], 1) & (x[0] < 1.5 + 1e-6), 0.0, "y")
    problem.dirichlet(tagged.facet_tags.find(6), 0.0, "z")
    pictures = Snapshots(SHOWN, (-100, 0)) if plot else None

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        fields.write(-problem.t)
        if pictures:
            pictures.take(problem)
        mean = problem.mean(0)
        force = problem.reaction(tagged.facet_tags.find(2))[0]
        slip = float(np.linalg.norm(mean.gap))
        norms = {f"{name} [MPa/mm]": norm for name, norm in facet_norms(problem).items()}
        return norms | {"force [N]": force, "slip [mm]": slip, "softening [MPa]": mean.softening}

    table_file = Path(out) / "history.csv"
    # The rows of Table 2 are those of five steps.
    options = vmdg.SolveOptions(control="load", progress=True, verbose=verbose, csv=table_file)
    with vmdg.FieldWriter(problem, Path(out) / "fields") as fields:
        history = vmdg.solve(problem, LOADS, options, monitor).history

    if problem.comm.rank == 0 and pictures:
        pictures.curve.plot(-history["load"], -history["force"], "o-")
        pictures.curve.set(xlabel="end displacement -d [mm]", ylabel="force on the right end [N]")
        pictures.figure.savefig(Path(out) / "patch_shear.png")
    if problem.comm.rank == 0:
        print("Table 2, |tau_s| [MPa/mm]   A report   A vmdg     B report   B vmdg")
        for row, a, b in zip(history.rows, *TABLE_2.values(), strict=False):
            values = f"{a:.4e} {row['A']:.4e} {b:.4e} {row['B']:.4e}"
            print(f"  d = {row['load']:5.2f} mm              {values}")
        print(f"results are in {out}")
    return history


if __name__ == "__main__":
    run(main)
