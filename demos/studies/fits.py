"""Fits of random curves, with good models and bad ones.

Two squares with a bond are pulled apart, or sheared, with random noise, starts and mistakes, and
strength, critical gap and modulus identified. A fit is right if the truth is within four standard
errors, "said" if it warns, "given" if it says by how much the estimates follow the parameter that
is wrong, and "hidden" if no data with that noise can show the mistake: forces without noise are
then fitted as well. Else it is SILENT, and an ALARM where nothing is wrong and it warns; of a start
ten times off it may say that it found nothing. Ranks share the fits.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import chain

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from parts.options import run
from parts.tables import markdown, report

import vmdg
from vmdg.meshes import blocks

TRUTH = {"bond.strength": 15.0, "bond.critical_gap": 0.05, "NeoHookean.E": 1000.0}
OPENINGS = np.linspace(0, 0.08, 21)[1:]
LAWS: dict[str, Callable] = {
    "linear": vmdg.Debonding,
    "trapezoidal": lambda P, gap: vmdg.TrapezoidalDebonding(P, gap / 2, gap),
    "exponential": lambda P, gap: vmdg.ExponentialDebonding(P, P * gap / 2),
}
#: What may be wrong; every kind has its turn.
KINDS = (
    *("nothing", "start", "law", "nu", "supports"),
    *("outlier", "offset", "nothing, two tests", "one of two load cells", "opening"),
)
#: Sum of squares over sigma that a mistake adds to those of noise, below which it is hidden.
SEEN = 10.0


@dataclass(frozen=True)
class Test:
    """Two squares of 1 mm; the lower one is held, the upper one moved along x, or along y."""

    law: str = "linear"
    nu: float = 0.3
    free: bool = False
    sheared: bool = False

    def __call__(self, values: dict[str, float]) -> tuple[vmdg.Problem, Callable]:
        """The problem and its monitor, as ``vmdg.identify`` wants them."""
        mesh, cells, facets = blocks(MPI.COMM_SELF, "quadrilateral", (2, 2))
        law = LAWS[self.law](values["bond.strength"], values["bond.critical_gap"])
        bond = vmdg.Interface(between=(1, 2), law=law, name="bond")
        body = vmdg.NeoHookean(E=values["NeoHookean.E"], nu=self.nu)
        problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond], kinematics="small")
        problem.dirichlet(facets.find(1), 0.0)
        moved = int(self.sheared)
        problem.dirichlet(facets.find(2), lambda t: t, "xy"[moved])
        if not self.free:
            problem.dirichlet(facets.find(2), 0.0, "yx"[moved])
        return problem, lambda problem: {"force [N]": problem.reaction(facets.find(2))[moved]}

    def forces(self) -> NDArray[np.float64]:
        """At the openings, of the truth (n,)."""
        problem, monitor = self(TRUTH)
        history = vmdg.solve(problem, OPENINGS, monitor=monitor).history
        return history["force"][[np.abs(history["load"] - t).argmin() for t in OPENINGS]]


def fit(number: int, seed: int) -> tuple[str, ...]:
    """A line of the table: what was wrong, and what the fit says."""
    random = np.random.default_rng((seed, number))
    wrong, known = KINDS[number % len(KINDS)], bool(random.integers(2))
    noise = float(random.choice([0.002, 0.005, 0.01]))
    sizes = np.array([*TRUTH.values()])
    start = dict(zip(TRUTH, sizes * random.uniform(0.7, 1.4, 3), strict=True))
    test, model, openings = Test(), Test(), OPENINGS
    if wrong == "start":
        start = dict(zip(TRUTH, sizes * random.choice([0.1, 1.0, 10.0], 3), strict=True))
    elif wrong == "law":
        test = Test(law=str(random.choice(["trapezoidal", "exponential"])))
    elif wrong == "nu":
        model = Test(nu=float(random.choice([0.25, 0.35])))
    elif wrong == "supports":
        model = Test(free=True)
    elif wrong == "opening":
        openings = OPENINGS + 0.004
    tests = {"pull": (test, model)}
    if "two" in wrong:
        tests["shear"] = (Test(sheared=True), Test(sheared=True))
    exact, measured, makes = {}, {}, {}
    for name, (true, makes[name]) in tests.items():
        force = true.forces()
        sigma = noise * np.abs(force).max()
        if wrong == "outlier":
            force[random.integers(3, 17)] += 12 * sigma
        elif wrong == "offset":
            force += 0.08 * force.max()
        elif wrong == "one of two load cells" and name == "shear":
            force *= 1.15
        exact[name] = vmdg.Curve(openings, force, sigma=sigma)
        noisy = force + sigma * random.standard_normal(len(force))
        measured[name] = vmdg.Curve(openings, noisy, sigma=sigma if known else None)
    found = identified(makes, measured, start)
    off = np.array([np.log(found.estimate[name] / true) for name, true in TRUTH.items()])
    far, largest = np.abs(off / [*found.relative_errors.values()]).max(), np.abs(off).max()
    verdict = "right" if far < 4 else "SILENT"
    if found.warnings:
        verdict = "ALARM" if wrong.startswith("nothing") else "said"
    elif far >= 4 and wrong == "nu":
        effects = np.array([*found.given["NeoHookean.nu"].effects.values()])
        rest = off + effects * np.log(test.nu / model.nu)
        verdict = "given" if np.abs(rest).max() < largest / 2 else "SILENT"
    elif far >= 4:
        left = identified(makes, exact, found.estimate).residuals.values()
        verdict = "hidden" if sum(float(r @ r) for one in left for r in one) < SEEN else "SILENT"
    return (
        *(str(number), wrong, "known" if known else "free", f"{100 * noise:.1f}"),
        *(f"{100 * largest:.2g}", f"{far:.2g}", str(len(found.runs)), verdict),
        "; ".join(found.warnings),
    )


def identified(makes: dict, measured: dict, start: dict[str, float]) -> vmdg.Identified:
    """A fit on this rank, without its warnings on the screen."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", vmdg.ModelWarning)
        return vmdg.identify(makes, measured, start, comm=MPI.COMM_SELF)


HEAD = ("", "wrong", "sigma", "noise [%]", "off [%]", "errors off", "runs", "", "says")


def main(count: int = 40, seed: int = 0, out: str = "results/fits") -> list[tuple[str, ...]]:
    """Fit random curves; the lines of the table.

    Args:
        count: Number of fits.
        seed: Of the mistakes.
        out: Folder for the table.
    """
    world, mine = MPI.COMM_WORLD, []
    for number in range(world.rank, count, world.size):
        mine.append(fit(number, seed))
        print(*mine[-1][:-1], mine[-1][-1][:60], sep=" | ", flush=True)
    lines = sorted(chain(*world.allgather(mine)), key=lambda line: int(line[0]))
    report(out, "fits", markdown(HEAD, lines))
    return lines


if __name__ == "__main__":
    run(main)
