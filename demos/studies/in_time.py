"""Motion in time: energy where a bond opens and closes.

A bar that parts in its middle and beats for 50 periods, by vmdg and by extrinsic cohesive elements
with a penalty, which gain energy in steps close to the critical one.

Two bars of unit length, modulus and density fly apart at a rate that just reaches the strength of
the bond between them, which loses a little of it, and vibrate. Ghesquiere-Dierickx, Molinari and
Anciaux (2025, arXiv 2511.14323) name three causes for energy that grows in explicit steps with the
plain law: its stiffness at first, T/delta of a point that has just been inserted, has no bound; it
jumps where the crack closes and the penalty of the contact takes over; and it jumps where
unloading ends. All three are at work here. The case is ours, after their description.
"""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from parts.options import run
from parts.tables import markdown, report

import vmdg
from vmdg.meshes import blocks

Array = NDArray[np.float64]


Array = NDArray[np.float64]

#: Rate at which the bars are stretched, that of a free standing wave with T = rate at most.
RATE, STRENGTH, GAP = 1.05, 1.0, 0.3
#: Energy at the start, and relative to it the energy at which a run has failed.
START, FAILED = RATE**2 / 3, 100.0
#: A period of the free bars together.
PERIOD = 4.0


@dataclass(frozen=True)
class Beat:
    """A run."""

    name: str  # What it is by
    step: float  # Relative to h/c, the critical one of plain elements
    times: Array  # Of its rows
    # Of the bars, the bond and the contact, with what the bond has dissipated, relative to that at
    # the start
    energy: Array
    traction: Array  # In the middle

    @property
    def periods(self) -> float:
        """Until the energy has grown a hundredfold, or until the end."""
        return self.times[-1] / PERIOD

    def row(self) -> tuple:
        """Of the table: name, step, periods, largest energy, largest change of T at the onset."""
        first = self.times < PERIOD / 2
        jump = np.abs(np.diff(self.traction[first])).max() / STRENGTH
        most = f"{self.energy.max():.4f}" if self.energy.max() < FAILED else f"> {FAILED:g}"
        return self.name, f"{self.step:.2f}", f"{self.periods:.1f}", most, f"{jump:.2f}"


def extrinsic(n: int, penalty: float, step: float, periods: float) -> Beat:
    """By linear elements with lumped masses and the plain law in central differences.

    The node in the middle is doubled when the mean stress next to it reaches the strength. Then
    T = P_c (1 - delta/delta_c) at the largest opening delta so far, T delta/delta_max below it, and
    the penalty times the overlap.
    """
    h = 1 / n
    x = np.concatenate([np.linspace(0, 1, n + 1), np.linspace(1, 2, n + 1)])
    m = np.full(2 * n + 2, h)
    m[[0, n, n + 1, -1]] /= 2
    u, v, middle = np.zeros_like(x), RATE * (x - 1), slice(n, n + 2)
    split, largest, dt, a, rows = False, 0.0, step * h, None, []
    for k in range(int(periods * PERIOD / dt)):
        stress = np.diff(u.reshape(2, -1), axis=1) / h
        f = np.zeros((2, n + 1))
        f[:, :-1] += stress
        f[:, 1:] -= stress
        f = f.ravel()
        T, stored = (stress[0, -1] + stress[1, 0]) / 2, 0.0
        split = split or T >= STRENGTH
        if split:
            delta = u[n + 1] - u[n]
            largest = max(largest, delta)
            T = STRENGTH * max(1 - largest / GAP, 0.0)
            T = penalty / h * delta if delta < 0 else T * delta / largest if largest > 0 else T
            stored = T * delta / 2
            f[middle] += T, -T
        else:
            f[middle] = f[middle].mean()
        v = v if a is None else v + dt / 2 * (f / m)
        a = f / m
        lost = STRENGTH * min(largest, GAP) / 2
        energy = (m @ v**2 + h * (stress**2).sum()) / 2 + stored + lost
        rows.append((k * dt, energy / START, T))
        if not energy < FAILED * START:
            break
        v = v + dt / 2 * a
        u = u + dt * v
    return Beat(f"extrinsic, penalty {penalty:g} E/h", step, *np.array(rows).T)


def variational(n: int, periods: float) -> Beat:
    """By vmdg with central differences and what it takes for a step."""
    scene = blocks(MPI.COMM_SELF, "quadrilateral", (n, 1, 1))
    bar, law = vmdg.NeoHookean(E=1.0, nu=0.0), vmdg.Debonding(STRENGTH, GAP, unloading="secant")
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        {1: bar, 2: bar},
        [interface],
        kinematics="small",
        density={1: 1.0, 2: 1.0},
    )
    step = 0.8
    times = np.arange(1, int(periods * PERIOD * n / step) + 1) * step / n
    apart = lambda x: np.array([RATE * (x[0] - 1), 0 * x[0]])  # noqa: E731
    traction = lambda problem: {"T": problem.mean(0).traction[0]}  # noqa: E731
    scheme, options = vmdg.CentralDifferences(), vmdg.SolveOptions(energy=True)
    result = vmdg.solve_dynamics(problem, times, scheme, apart, traction, options)
    history = result.history
    names = ("kinetic", "bulk", "interface", "damage", "friction", "viscosity")
    energy = sum(history[name] for name in names) / START
    taken = times[-1] * n / (result.counts.residuals - 1)
    return Beat("vmdg", taken, times, energy, history["T"])


HEAD = ("bar in two by", "step c/h", "periods", "largest energy", "change of T in a step")


def draw(beats: list[Beat]) -> plt.Figure:
    """Energy over the first three periods."""
    figure, ax = plt.subplots(figsize=(10.5, 4), layout="constrained")
    for beat in beats:
        label, thick = f"{beat.name}, {beat.step:.2f}", beat.name == "vmdg"
        line = ax.semilogy(beat.times / PERIOD, beat.energy, lw=2 if thick else 0.8, label=label)
        line[0].set_color("k" if thick else line[0].get_color())
    ax.set(xlabel="periods", ylabel="energy, relative to that at the start", ylim=(0.8, FAILED))
    ax.set_xlim(0, 3)
    figure.legend(title="bond, step relative to h/c", loc="outside right upper")
    return figure


def main(
    coarse: bool = False,
    out: str = "results/in_time",
    plot: bool = True,
) -> list[Beat]:
    """Run all bars.

    Args:
        coarse: Few periods.
        out: Folder for table and picture.
        plot: Draw the picture.
    """
    if MPI.COMM_WORLD.rank > 0:
        return []
    n, periods = (10, 5.0) if coarse else (20, 50.0)
    beats = [extrinsic(n, p, step, periods) for p in (1.0, 10.0) for step in (0.8, 0.5, 0.2)]
    beats.append(variational(n, periods))
    text = markdown(HEAD, [beat.row() for beat in beats])
    report(out, "in_time", text, draw(beats) if plot else None)
    return beats


if __name__ == "__main__":
    run(main)
