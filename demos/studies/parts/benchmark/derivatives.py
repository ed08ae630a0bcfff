"""What derivatives by parameters cost: runs of a double cantilever beam with and without them.

A short beam of degree 2 with a mixed-mode bond is opened until half of it is broken. Of eight
parameters five belong to the bond and three to the arms.
"""

from __future__ import annotations

from dataclasses import dataclass
from time import process_time

import numpy as np

import vmdg
from vmdg.meshes import beams

BOND = {
    "normal_strength": 20.0,  # MPa
    "shear_strength": 30.0,
    "normal_energy": 0.3,  # N/mm
    "shear_energy": 0.7,
    "exponent": 2.0,
}
HEIGHT, CRACK, LENGTH = 1.5, 12.0, 30.0  # mm
OF_BOND = [f"bond.{name}" for name in BOND]
PARAMETERS = {
    "none": None,
    "two": ["bond.normal_strength", "bond.normal_energy"],
    "eight": [*OF_BOND, "upper arm.E", "lower arm.E", "upper arm.nu"],
}
HEAD = ("double cantilever beam", "facets", "rows", *(f"{name} [s]" for name in PARAMETERS))
HEAD += ("two: more by", "eight: more by")


@dataclass(frozen=True)
class Cost:
    """Processor times of runs [s].

    Attributes:
        kinematics: "small" or "finite".
        facets: Number of facets of the bond.
        rows: Of the history.
        seconds: By key of ``PARAMETERS``.
    """

    kinematics: str
    facets: int
    rows: int
    seconds: dict[str, float]

    def more(self, name: str) -> float:
        """By how much a run takes longer than one without derivatives, relative to it."""
        return self.seconds[name] / self.seconds["none"] - 1

    def row(self) -> list[str | int]:
        """Of the table below ``HEAD``."""
        times = (f"{self.seconds[name]:.3g}" for name in PARAMETERS)
        shares = (f"{100 * self.more(name):.0f} %" for name in ("two", "eight"))
        return [self.kinematics, self.facets, self.rows, *times, *shares]


def measure(kinematics: str, facets: int, repeats: int) -> Cost:
    """One row of the table; the runs take turns, the least of some.

    Args:
        kinematics: "small" or "finite".
        facets: Of the bond over the 12 mm behind the crack.
        repeats: Runs of each kind.
    """
    seconds, rows = dict.fromkeys(PARAMETERS, np.inf), 0
    for _ in range(repeats + 1):  # the first ones compile
        for name, parameters in PARAMETERS.items():
            start = process_time()
            rows = _run(kinematics, facets, parameters)
            seconds[name] = min(seconds[name], process_time() - start)
    return Cost(kinematics, facets + 3, rows, seconds)


def _run(kinematics: str, facets: int, parameters: list[str] | None) -> int:
    """The number of rows."""
    mesh, cells, sides = beams(
        stations=(0.0, 10.0, CRACK, 24.0, LENGTH),
        divisions=(5, 4, facets, 3),
        height=HEIGHT,
        rows=2,
        precrack=CRACK,
    )
    law = vmdg.MixedModeDebonding(**BOND, criterion="BK")
    bond = vmdg.Interface(facets=sides.find("interface"), law=law, name="bond")
    arms = dict.fromkeys(("lower arm", "upper arm"), vmdg.NeoHookean(E=70e3, nu=0.3))
    problem = vmdg.Problem(mesh, cells, arms, [bond], degree=2, kinematics=kinematics)
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * HEIGHT: np.isclose(x[0], 0.0) & np.isclose(x[1], y),
            lambda t, side=side: side * t / 2,
            "y",
        )
    problem.dirichlet(sides.find("right"), 0.0)
    end = sides.find("upper left")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"force [N]": problem.reaction(end)[1]}

    loads = np.linspace(0, 1.5, 16)[1:]
    return len(vmdg.solve(problem, loads, monitor=monitor, derivatives=parameters).history)
