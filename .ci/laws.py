"""Pictures of the guide: traction against gap of every law, lives of that of fatigue.

demos/run .ci/laws.py demos/gallery
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import vmdg

PENALTY, PRESSURE, END = 5e4, 8.0, 0.07  # MPa/mm, MPa, mm
TURN, BACK = 0.02, 0.008  # mm, where the opening turns back and grows again

#: Pictures by the end of their names.
LAWS = {
    "bonded": vmdg.Bonded(),
    "debonding": vmdg.Debonding(strength=10.0, critical_gap=0.05, friction=0.5),
    "secant": vmdg.Debonding(strength=10.0, critical_gap=0.05, friction=0.5, unloading="secant"),
    "exponential": vmdg.ExponentialDebonding(strength=10.0, fracture_energy=0.25, friction=0.5),
    "trapezoidal": vmdg.TrapezoidalDebonding(
        strength=10.0, plateau_gap=0.01, critical_gap=0.04, friction=0.5
    ),
    "intrinsic": vmdg.IntrinsicExponential(strength=10.0, fracture_energy=0.25, shear_weight=2.0),
    "mixed_mode": vmdg.MixedModeDebonding(
        normal_strength=10.0,
        shear_strength=14.0,
        normal_energy=0.25,
        shear_energy=0.35,
        friction=0.5,
    ),
    "contact": vmdg.Contact(friction=0.5),
}

#: The law of the S-N lines.
FATIGUE = vmdg.FatigueDebonding(10.0, 14.0, 0.25, 0.35)


def followed(law: vmdg.Law, path: np.ndarray, component: int, pressure: float = 0.0) -> np.ndarray:
    """Traction of a point between rigid bodies that open (0) or slide (1) along a path [MPa].

    Args:
        law: The law.
        path: Openings or slips [mm].
        component: Which of the two.
        pressure: On the point while it slides [MPa].
    """
    normal, gap, softening = np.array([[1.0, 0.0]]), np.zeros((1, 2)), np.zeros(1)
    tractions = []
    for g in path:
        trial = -PENALTY * gap
        trial[0, component] += PENALTY * g
        trial[0, 0] -= pressure
        update = law.return_map(trial, normal, gap, softening, PENALTY)
        gap, softening = update.gap, update.softening
        tractions.append(update.traction[0, component])
    return np.array(tractions)


def draw(law: vmdg.Law, file: Path) -> None:
    """Opening with a turn, slip, and slip under pressure."""
    once = np.linspace(0, END, 1401)
    there, back = np.linspace(0, TURN, 401), np.linspace(TURN, BACK, 241)
    opening = np.concatenate([there, back, np.linspace(BACK, END, 1241)])
    fig, axes = plt.subplots(figsize=(4, 2.7), layout="constrained")
    for path, component, pressure, style, label in (
        (opening, 0, 0.0, {"color": "C0"}, "opening"),
        (once, 1, 0.0, {"color": "C1", "ls": "--"}, "slip"),
        (once, 1, PRESSURE, {"color": "C2", "ls": ":", "lw": 2.2}, f"slip at {PRESSURE:g} MPa"),
    ):
        traction = followed(law, path, component, pressure)
        axes.plot(1e3 * path, traction, label=label, **style)
    axes.set(
        xlim=(-2, 1e3 * END),
        ylim=(-0.5, 15),
        xlabel="opening or slip [µm]",
        ylabel="traction [MPa]",
    )
    axes.legend(loc="upper right", frameon=False)
    fig.savefig(file)
    plt.close(fig)


def draw_lives(law: vmdg.FatigueDebonding, file: Path) -> None:
    """Lives at a constant traction relative to the strength, at two load ratios."""
    p = np.linspace(0.1, 1.0, 400)
    fig, axes = plt.subplots(figsize=(4, 2.7), layout="constrained")
    for ratio, style in ((-1.0, "-"), (0.1, "--")):
        for mode, color in (("opening", "C0"), ("slip", "C1")):
            at_ratio = replace(law, ratio=ratio)
            lives = at_ratio.cycles_to_failure(p, np.pi / 2 * (mode == "slip"))
            axes.plot(lives, p, style, color=color, label=f"{mode}, R = {ratio:g}")
    axes.set(
        xlim=(1, 1e8), xscale="log", ylim=(0, 1), xlabel="cycles", ylabel="traction / strength"
    )
    axes.legend(loc="upper right", frameon=False)
    fig.savefig(file)
    plt.close(fig)


def main(folder: str) -> None:
    """Draw all laws."""
    draw_lives(FATIGUE, Path(folder) / "law_fatigue.png")
    for name, law in LAWS.items():
        draw(law, Path(folder) / f"law_{name}.png")


if __name__ == "__main__":
    main(sys.argv[1])
