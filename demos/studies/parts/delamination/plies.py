"""Double cantilever beams in 3D, whose crack front becomes curved (Krueger 2008)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from parts.delamination.beams import Run
from parts.delamination.laminate import T300_1076
from parts.topology import global_max, global_sum
from parts.verification.checks import Check, compare, describe

import vmdg
from vmdg.meshes import plates
from vmdg.meshes.beams import INTERFACE, RIGHT, UPPER_LEFT


@dataclass(frozen=True)
class Plates:
    """A specimen of Krueger 2008, NASA/TM-2008-215123."""

    arms: tuple[vmdg.Material, vmdg.Material]  # Materials of the lower and of the upper arm
    height: float  # Of an arm [mm]
    width: float  # Of both [mm]
    G_c: float  # Of the bond between them, opening [N/mm]
    strength: float  # Strength of a bond whose zone, 0.9 mm, is short against the arms [MPa]
    # By crack length, opening [mm] and load [N] at which a straight front begins to grow in its
    # middle, where G, by VCCT, is G_c first
    points: Mapping[float, tuple[float, float]]


#: C12K/R6376, plies of one arm from below (the other has the opposite angles), and the specimen.
#: Plies of 5 mil, as the other lengths are whole inches: with plies of 0.125 mm the stiffness is
#: 4.1 to 4.8 % below that of all four published points, with these within 0.5 %.
PLY = {"E": (146.9e3, 10.6e3, 10.6e3), "nu": (0.33, 0.33, 0.33), "G": (5450.0, 5450.0, 3985.0)}
ANGLES = (30, -30, 0, -30, 0, 30, 0, 0, 0, 0, 30, 0, -30, 0, -30, 30)
THICKNESS = 0.127


def _arm(sign: int, bottom: float) -> vmdg.Laminate:
    plies = [vmdg.Orthotropic(**PLY, angle=sign * angle) for angle in ANGLES]
    return vmdg.Laminate(plies, THICKNESS, bottom, rows=2)


D30 = Plates(
    arms=(_arm(1, -THICKNESS * len(ANGLES)), _arm(-1, 0.0)),
    height=THICKNESS * len(ANGLES),
    width=25.4,
    G_c=0.3405,
    strength=50.0,
    points={31.0: (1.600, 102.4), 33.0: (1.790, 96.7), 35.0: (1.996, 91.3), 40.0: (2.534, 79.8)},
)
T300 = Plates(
    arms=(T300_1076.material, T300_1076.material),
    height=T300_1076.h,
    width=T300_1076.b,
    G_c=T300_1076.G_I,
    strength=35.0,
    points={30.0: (1.500, 60.7), 35.0: (2.002, 52.5), 40.0: (2.548, 46.7)},
)


class Specimen:
    """Two arms with a straight front, opened at the ends of their outer faces.

    Two layers of cells over an arm, degree 2, small strain as in the reference. Behind the fine
    cells come 40 mm of coarse ones; what is further away moves as a rigid body.

    Args:
        a: Crack length [mm].
        fine: Length of fine cells from the front on [mm].
        size: Of their sides along x [mm].
        strength: Of the bond [MPa].
        columns: Cells over the width, shorter at the edges.
    """

    def __init__(
        self,
        tested: Plates,
        a: float,
        fine: float,
        size: float,
        strength: float,
        columns: int = 10,
    ):
        height = tested.height
        end = a + size * math.ceil(fine / size)
        x = np.concatenate(
            [
                np.linspace(0.0, a - 2, 6),
                [a - 1],
                np.linspace(a, end, math.ceil(fine / size) + 1),
                end + np.array([2.0, 5.0, 15.0, 40.0]),
            ]
        )
        s = np.linspace(-1, 1, columns + 1)
        self.y = tested.width / 2 * (1 + 1.3 * s - 0.3 * s**3)
        self.tagged = plates(MPI.COMM_WORLD, x, self.y, height, rows=2, precrack=a)
        facets = self.tagged.facet_tags
        bond = vmdg.Debonding(strength, 2 * tested.G_c / strength)
        self.problem = vmdg.Problem(
            self.tagged.mesh,
            self.tagged.cell_tags,
            dict(enumerate(tested.arms, 1)),
            [vmdg.Interface(facets.find(INTERFACE), law=bond)],
            degree=2,
            kinematics="small",
        )
        for z, sign in ((-height, -1), (height, 1)):
            self.problem.dirichlet_points(
                lambda X, z=z: np.isclose(X[0], 0) & np.isclose(X[2], z),
                lambda t, sign=sign: sign * t / 2,
                "z",
            )
        self.problem.dirichlet(facets.find(RIGHT), 0.0)
        self._a, self._strength = a, strength
        self.growth = vmdg.CrackGrowth(self.problem, 0, width=tested.width, start=a)

    def front(self) -> NDArray[np.float64]:
        """Crack length of every column of cells, of the energy spent there; collective [mm]."""
        state = self.problem.state[0]
        column = np.searchsorted(self.y, state.points[:, 1]) - 1
        area = state.weights * state.softening / self._strength
        spent = np.bincount(column, weights=area, minlength=len(self.y) - 1)
        return self._a + global_sum(self.problem.comm, spent) / np.diff(self.y)

    def worst(self) -> float:
        """Damage of the most damaged point; collective."""
        softening = self.problem.state[0].softening
        return float(global_max(self.problem.comm, softening.max(initial=0.0))) / self._strength

    def monitor(self, _problem: vmdg.Problem) -> dict[str, float]:
        """Load, crack growth, worst damage, and the front, one column of the table a column."""
        middles = (self.y[1:] + self.y[:-1]) / 2
        front = zip(middles, self.front(), strict=True)
        return {
            "force [N]": self.problem.reaction(self.tagged.facet_tags.find(UPPER_LEFT))[2],
            **self.growth(),
            "worst [-]": self.worst(),
            **{f"front_{y:.2f} [mm]": length for y, length in front},
        }


def options(verbose: bool, **more) -> vmdg.SolveOptions:
    shown = {"progress": True, "verbose": verbose, "show": ("force", "crack")}
    return vmdg.SolveOptions(**shown, **more)


def first_growth(
    tested: Plates, a: float, verbose: bool = False, columns: int = 10
) -> tuple[float, float, vmdg.Result]:
    """When the first point of a straight front breaks, in its middle.

    Between two rows the load follows the damage of the point linearly.

    Returns:
        Load [N], stiffness at small load [N/mm], and the run.
    """
    specimen = Specimen(tested, a, fine=2.0, size=0.4, strength=tested.strength, columns=columns)
    opening = tested.points[a][0]
    result = vmdg.solve(
        specimen.problem,
        opening * np.array([0.1, 0.6, 0.9, *np.arange(0.98, 1.3, 0.02)]),
        options(verbose),
        specimen.monitor,
        until=lambda problem: specimen.worst() > 0.999,
    )
    history = result.history
    stiffness = history["force"][0] / history["load"][0]
    load = np.interp(0.999, history["worst"], history["force"])
    return float(load), float(stiffness), result


def first_points(
    tested: Plates, verbose: bool = False, columns: int = 10
) -> tuple[list[Check], list[tuple[float, float]], vmdg.Result, int]:
    """First growth of straight fronts at the lengths of the published points.

    Compared are load, stiffness, and their quotient, the opening of a front without a zone.

    Returns:
        Lines of the table, openings [mm] and loads [N], the last run, and the factorizations of
        those before it.
    """
    checks: list[Check] = []
    points, factorizations = [], 0
    for a in tested.points:
        load, stiffness, result = first_growth(tested, a, verbose, columns)
        points.append((load / stiffness, load))
        values = {"stiffness [N/mm]": stiffness, "load [N]": load, "opening [mm]": points[-1][0]}
        checks += [
            compare("DCB in 3D", f"a = {a:g} mm: {name}", value, math.nan, f"front at {a:g} mm")
            for name, value in values.items()
        ]
        factorizations += result.counts.factorizations
    return checks, points, result, factorizations - result.counts.factorizations


def straight(tested: Plates, verbose: bool = False) -> Run:
    """First growth of straight fronts alone."""
    checks, points, result, factorizations = first_points(tested, verbose)
    return Run(result, checks, factorizations, points)


def d30(
    end: float = 2.534,
    size: float = 1.0,
    strength: float = 20.0,
    columns: int = 10,
    verbose: bool = False,
) -> Run:
    """First growth of four straight fronts, then the first of them opened to ``end`` [mm].

    The published points are loads and openings at which the energy release rate (VCCT) is G_c in
    the middle of a straight front: the mean over the front, P^2/(2 b) dC/da of these points, is
    0.83 G_c, and at the edges it is a fifth. So the front grows in the middle first and becomes
    curved, and where G is G_c all along it the load is above that of the points. In the run a bond
    of 20 MPa has a zone of 2.5 mm, with facets of 1 mm.
    """
    checks, points, first, factorizations = first_points(D30, verbose, columns)
    factorizations += first.counts.factorizations
    a_0 = min(D30.points)
    specimen = Specimen(D30, a_0, fine=11.0, size=size, strength=strength, columns=columns)
    loads = [*np.linspace(0.4, 1.4, 4), *np.arange(1.5, end, 0.1), end]
    result = vmdg.solve(specimen.problem, loads, options(verbose), specimen.monitor)
    front = specimen.front()
    lag = front[columns // 2] - front[0]
    checks.append(
        compare("D+-30", "lag of the edges [mm]", lag, math.nan, describe(specimen.problem, 2))
    )
    return Run(result, checks, factorizations, points)
