"""Weak links side by side and in a row between rigid grips, against order statistics."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator
from scipy.optimize import brentq

import vmdg
from parts.stability.cases import E, log_uniform
from parts.stability.checks import EXACT, Run
from parts.stability.points import resistance
from parts.stability.scenes import Array, Bond, Case, Cells, Support, box

#: Of bars, and between them [mm].
WIDTH = 0.05


def bars(kind: str, count: int, links: int) -> tuple[Cells, Array]:
    """Slender bars of pieces a mm long with a link between any two, and their tags."""
    whole = box(kind, (np.arange(links + 2.0), WIDTH * np.arange(2.0 * count)))
    lane = (whole.midpoints[:, 1] / WIDTH).astype(int)
    used, cells = np.unique(whole.cells[lane % 2 == 0], return_inverse=True)
    cells = cells.reshape(-1, whole.cells.shape[1])
    return Cells(kind, whole.nodes[used], cells, whole.lines), 1 + lane[lane % 2 == 0] // 2


def weak_links(rng: Generator, family: str, count: int, links: int) -> Case:
    """Every link has a strength of its own; the weakest one of a bar decides, the others hold.

    A bar knows nothing of the others. It carries the force of its elastic pieces up to the strength
    of its weakest link; when the path comes to a displacement beyond that for the first time, it
    is on the softening branch that does not snap back, or broken.
    """
    kind = str(rng.choice(["triangle", "quadrilateral"]))
    kinematics = str(rng.choice(["finite", "small"]))
    mesh, tags = bars(kind, count, links)
    strengths = E * log_uniform(rng, 1e-3, 1e-2) * rng.weibull(rng.uniform(2, 10), (count, links))
    length = links + 1.0

    def stretched(T: float) -> float:
        """Elongation of a bar without Poisson's effect under P = T [mm]."""
        e = T / E
        return length * (e if kinematics == "small" else e + np.hypot(1, e) - 1)

    shares = rng.uniform(0.1, 0.8, strengths.shape)  # of its elongation a bar needs less to part
    stable = rng.random(strengths.shape) < 0.3
    shares[stable] = rng.uniform(1.3, 4.0, stable.sum())
    gaps = shares * np.vectorize(stretched)(strengths)
    exponential = rng.random() < 0.3
    # A gap that stays would close where the path turns back, and be damaged again.
    stays = not exponential and not stable.any() and rng.random() < 0.5
    unloading = "plastic" if stays else "secant"

    def law(
        strength: float | Callable[[Array], Array], gap: float | Callable[[Array], Array]
    ) -> vmdg.Law:
        if exponential:
            return vmdg.ExponentialDebonding(strength, gap, unloading=unloading)
        return vmdg.Debonding(strength, gap, unloading=unloading)

    second = strengths * gaps / 2 if exponential else gaps  # energy, or critical gap

    def at(values: Array) -> Callable[[Array], Array]:
        return lambda x: values[place(x)]

    def place(x: Array) -> tuple[Array, Array]:
        """Bar and link of points (2 or 3, n)."""
        return (x[1] // (2 * WIDTH)).astype(int), np.rint(x[0] - 1).astype(int)

    def everywhere(x: Array, tags: Array) -> Array:
        return np.isclose(x[0], np.rint(x[0]))

    peaks = np.sort([stretched(bar.min()) for bar in strengths])
    last = peaks[-1] * rng.uniform(0.8, 1.3)
    # No given load factor is a peak but for rounding.
    loads = np.arange(1, rng.integers(3, 13) + 1) * last
    loads = loads / len(loads) * (1 + 1e-4)
    unstable = str(rng.choice(["jump", "trace"]))

    def off(law: vmdg.Law, T: float, u: float) -> float:
        gap = u - stretched(T)
        return T - resistance(law, gap)

    def carries(law: vmdg.Law, u: float) -> float:
        if u <= stretched(law.strength):
            low, high = 0.0, law.strength
            return brentq(lambda T: stretched(T) - u, low, high * (1 + 1e-9))
        branch = np.linspace(0, 1, 4000)[:-1] * law.strength
        gaps = np.array([u - stretched(T) for T in branch])
        beyond = branch - [resistance(law, gap) for gap in gaps] >= 0
        if beyond[0]:
            return 0.0
        at = int(np.argmax(beyond))
        return brentq(lambda T: off(law, T, u), branch[at - 1], branch[at], xtol=1e-16)

    def judge(run: Run) -> list[str]:
        bar, link = place(run.problem.state[0].points.T)
        weakest = strengths.argmin(axis=1)
        curves = [law(strengths[b, i], second[b, i]) for b, i in enumerate(weakest)]
        tops = np.array([stretched(curve.strength) for curve in curves])
        size, t = strengths.max(), [record.t for record in run.records]
        for u in loads[loads <= t[-1]]:
            T = np.array([carries(curve, u) for curve in curves])[bar]
            off = np.abs(run.records[t.index(u)].traction[0][:, 0] - T).max() / size
            if not off < EXACT:
                return [f"a bar at u = {u:.6g} mm is off by {off:.1e}"]
        # Where a bar is damaged the path has been at its peak, and has left every weaker bar that
        # snaps back on its far branch there.
        snaps = shares[np.arange(count), weakest] < 1
        least = {
            u: np.array(
                [
                    c.strength - carries(c, u) if u > top else 0.0
                    for c, top in zip(curves, tops, strict=True)
                ]
            )
            * snaps
            for u in tops
        }
        for record in run.records:
            Q = record.softening[0]
            if Q[link != weakest[bar]].any():
                return ["a link is damaged that is not the weakest"]
            soft = link == weakest[bar]
            if Q.any() and (Q < 0.9 * least[tops[bar][Q > 0].max()][bar])[soft].any():
                return [f"at t = {record.t:.6g} a bar has yielded before a weaker one was gone"]
        return []

    inputs = {
        "mesh": mesh,
        "tags": tags,
        "materials": dict.fromkeys(range(1, count + 1), vmdg.NeoHookean(E=E, nu=0.0)),
        "bonds": (Bond(law(at(strengths), at(second)), facets=everywhere),),
        "supports": (
            Support(mesh.side(0, 0), 0.0),
            Support(mesh.side(0, -1), lambda t: t, 0),
            # Guided: a bar that tilts where it parts would have other paths.
            Support(lambda x: x[0] > -1, 0.0, 1),
        ),
        "loads": loads,
        "kinematics": kinematics,
        "options": vmdg.SolveOptions(unstable=unstable),
        "judge": judge,
    }
    what = f"{count} bars of {links} links, {unstable}, to {last / peaks[-1]:.2f} of the last peak"
    return Case(family, what, **inputs)


def bundles(rng: Generator) -> Case:
    """Bars side by side."""
    return weak_links(rng, "bundles", int(rng.integers(2, 9)), 1)


def rows(rng: Generator) -> Case:
    """Links in a row, or two or three rows of them."""
    return weak_links(rng, "rows of links", int(rng.integers(1, 4)), int(rng.integers(2, 6)))
