"""Picture of the guide: a point of Debonding that opens and closes again and again.

demos/run .ci/unloading.py demos/gallery/unloading.png
"""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np

import vmdg

STRENGTH, CRITICAL, PENALTY = 10.0, 0.05, 5e4  # MPa, mm, MPa/mm
LOW, HIGH, CYCLES = 0.005, 0.02, 6  # mm


def followed(openings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """T_N and Q of a point between rigid bodies at these openings [MPa]."""
    law = vmdg.Debonding(strength=STRENGTH, critical_gap=CRITICAL)
    normal, gap, softening = np.array([[1.0, 0.0]]), np.zeros((1, 2)), np.zeros(1)
    rows = []
    for g in openings:
        trial = PENALTY * (g * normal - gap)
        update = law.return_map(trial, normal, gap, softening, PENALTY)
        gap, softening = update.gap, update.softening
        rows.append((update.traction[0, 0], softening[0]))
    return np.array(rows).T


def main(file: str) -> None:
    """Draw traction against opening, and the peaks of the cycles."""
    first = np.linspace(0, HIGH, 400)
    down, up = np.linspace(HIGH, LOW, 300), np.linspace(LOW, HIGH, 300)
    openings = np.concatenate([first, *[down, up] * (CYCLES - 1)])
    traction, softening = followed(openings)
    monotonic = np.linspace(0, 1.1 * CRITICAL, 400)

    fig, (left, right) = plt.subplots(1, 2, figsize=(9, 3.2), layout="constrained")
    left.plot(1e3 * monotonic, followed(monotonic)[0], "--", color="0.6", label="opened once")
    left.plot(1e3 * openings, traction, color="C0", label="5, 20, 5, ... µm")
    left.set(xlabel="opening $g$ [µm]", ylabel="traction $T_N$ [MPa]", title="Debonding, one point")
    left.legend()
    number = np.arange(1, CYCLES + 1)
    ends = len(first) - 1 + (number - 1) * (len(down) + len(up))
    right.plot(number, STRENGTH - softening[ends], "o-", label='Debonding: gap as "plastic"')
    right.axhline(STRENGTH - softening[ends[0]], ls="--", color="C1", label="secant unloading")
    right.set(xlabel="cycle", ylabel="strength left $P_c - Q$ [MPa]", ylim=(0, STRENGTH))
    right.legend()
    fig.savefig(file)
    print((STRENGTH - softening[ends]).round(2))


if __name__ == "__main__":
    main(sys.argv[1])
