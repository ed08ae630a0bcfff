"""The fibre push-out over a parameter: Figures 30 and 31 of the report, and meshes and steps.

Runs the example ``pushout`` with several moduli or coefficients of friction, with several meshes or
numbers of steps, or once with the values of the report, and makes a table and a picture of them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from parts.options import run
from parts.pushouts import STUDIES, studied

import vmdg


def main(
    study: Annotated[str, STUDIES] = "report",
    refine: float = 1,
    steps: int = 100,
    end: float = 0.174,
    resume: bool = False,
    out: str = "results/pushout_parameters",
) -> dict[str, vmdg.History]:
    """Run all values of a study; the histories by label.

    Args:
        study: What is changed.
        refine: Factor on all numbers of cells [-].
        steps: Load steps of the punch.
        end: Travel of the punch [mm].
        resume: Continue from the last checkpoint of every run.
        out: Folder for table, picture and the runs.
    """
    given = {"refine": refine, "steps": steps, "end": end, "resume": resume}
    return studied(study, STUDIES[study][2], Path(out), **given)


if __name__ == "__main__":
    run(main)
