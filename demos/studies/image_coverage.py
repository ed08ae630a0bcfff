"""Errors of parameters with and without images, and how often their 95 % intervals are right.

The beam of ``demos/measured_images.py`` with other noise and other motions of the camera for every
seed. Fits begin at the truth: what is judged are the intervals. Ranks share the seeds.
"""

from __future__ import annotations

import warnings
from functools import partial

from mpi4py import MPI

import numpy as np
from parts.options import run
from parts.scenes import measured_images
from parts.tables import markdown, report

import vmdg

TRUTH = measured_images.TRUTH
#: And G_c = P_c zeta_c / 2.
NAMES = (*TRUTH, "G_c of bond")
HEAD = ("data", "parameter", "relative error [%]", "scatter [%]", "intervals with the truth")


def outcome(found: vmdg.Identified) -> np.ndarray:
    """Error, log of the estimate over the truth, and whether the interval has it, by parameter."""
    energy = TRUTH["bond.strength"] * TRUTH["bond.critical_gap"] / 2
    value, error = found.energies["bond"]
    rows = [
        (found.relative_errors[name], np.log(found.estimate[name] / true))
        for name, true in TRUTH.items()
    ]
    rows.append((error, np.log(value / energy)))
    return np.array([(s, off, abs(off) <= 1.96 * s) for s, off in rows])


def main(
    seeds: int = 50, images: int = 5, facet: float = 0.5, out: str = "results/image_coverage"
) -> dict[str, np.ndarray]:
    """Fit the measurements of all seeds; error, scatter and share of right intervals by parameter.

    Args:
        seeds: Number of measurements.
        images: Number of images of each.
        facet: Size of the facets [mm].
        out: Folder for the table.
    """
    world, alone = MPI.COMM_WORLD, MPI.COMM_SELF
    openings = np.linspace(0, 0.7, images + 1)[1:]
    truth = measured_images.exact(openings, facet, alone)
    make = partial(measured_images.beam, facet=facet, comm=alone)
    every: dict[str, list] = {"force": [], "force and images": []}
    for seed in range(world.rank, seeds, world.size):
        curve, field = measured_images.measured(openings, truth, seed)
        for name, data in zip(every, ([curve], [curve, field]), strict=True):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", vmdg.ModelWarning)
                found = vmdg.identify(make, data, TRUTH, comm=alone)
            every[name].append(outcome(found))
    lines, means = [], {}
    for name, mine in every.items():
        rows = np.array([one for part in world.allgather(mine) for one in part])
        error, scatter, right = np.median(rows[..., 0], 0), rows[..., 1].std(0), rows[..., 2].sum(0)
        means[name] = np.column_stack([error, scatter, right / len(rows)])
        for i, parameter in enumerate(NAMES):
            sizes = f"{100 * error[i]:.2g}", f"{100 * scatter[i]:.2g}"
            lines.append((name, parameter, *sizes, f"{right[i]:.0f} of {len(rows)}"))
    report(out, "image_coverage", markdown(HEAD, lines))
    return means


if __name__ == "__main__":
    run(main)
