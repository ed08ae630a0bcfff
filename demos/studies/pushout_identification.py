"""Friction and energy of the push-out of section 7.4, from the forces that the report prints.

The largest force, 412.2 N, and the last one, 105.5 N at 0.174 mm, are taken as measured with an
error of 1 %. Which friction and critical gap, and so which energy, fit them best at a given
strength? Fits at three strengths show what two forces leave open.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
from parts.options import run
from parts.scenes import pushout
from parts.tables import markdown

import vmdg

FRICTION, GAP = "interface_0.friction", "interface_0.critical_gap"
#: The largest and the last force of the report [N], and their error.
LARGEST, LAST, END, ERROR = 412.21, 105.52, 0.174, 0.01


def fit(strength: float, refine: float, steps: int) -> vmdg.Identified:
    """Friction and critical gap at a strength [MPa]."""
    options = vmdg.SolveOptions(unstable="trace", relative_tolerance=1e-8)
    start = {FRICTION: 0.4, GAP: 0.011 * 22.0 / strength}

    def make(values: dict[str, float]) -> tuple:
        model = pushout.build(
            False, 25, refine, values[FRICTION], pushout.FIBRE_MODULUS, False, strength, values[GAP]
        )
        vmdg.solve(model.problem, np.linspace(0.25, 1, 4), options, derivatives=list(start))
        model.problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
        return model.problem, model.measures

    # An infinite abscissa stands for the largest value.
    forces = np.array([LARGEST, LAST])
    curve = vmdg.Curve([np.inf, END], forces, along="punch", sigma=ERROR * forces)
    loads = 1 + np.linspace(0, END, steps + 1)[1:]
    return vmdg.identify(make, curve, start, loads=loads, options=options)


def main(
    refine: float = 0.5, steps: int = 40, out: str = "results/pushout_identification"
) -> dict[float, vmdg.Identified]:
    """Fit at three strengths; what was identified, by strength.

    Args:
        refine: Factor on all counts of cells.
        steps: Load steps of the punch.
        out: Folder for the table.
    """
    found, lines = {}, []
    for strength in (11.0, 22.0, 33.0):
        found[strength] = one = fit(strength, refine, steps)
        gap, errors = one.estimate[GAP], one.relative_errors
        lines.append(
            (
                f"{strength:g}",
                f"{one.estimate[FRICTION]:.4f} ({100 * errors[FRICTION]:.2g} %)",
                f"{gap:.5f}",
                f"{strength * gap / 2:.4f} ({100 * errors[GAP]:.2g} %)",
                f"{one.correlation[0, 1]:.2f}",
                len(one.runs),
            )
        )
    head = ("strength [MPa]", "friction", "critical gap [mm]", "energy [N/mm]", "correlation")
    text = markdown((*head, "runs"), lines)
    if MPI.COMM_WORLD.rank == 0:
        print(text)
        Path(out).mkdir(parents=True, exist_ok=True)
        (Path(out) / "pushout_identification.md").write_text(text + "\n")
    return found


if __name__ == "__main__":
    run(main)
