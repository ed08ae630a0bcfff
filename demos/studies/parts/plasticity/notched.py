"""A notched round bar that tears at its smallest section, against a test of code_aster.

Test ssna120a (document V6.01.120; command file astest/ssna120a.comm): the specimen AE4 of a steel
whose middle plane is a cohesive zone with a trapezoidal law. Its values are those of that test, and
of a computation with the porous plasticity of Rousselier that the test quotes and is to meet within
5 %. It has half of the bar and of the crack, so openings here are twice its own, and strains of
updated small increments (PETIT_REAC); here they are finite.

Material, law and loads are published, the drawing is not. Fits of the six values with free lengths
gave 3.00 mm for the smallest radius and 28 to 30 mm for half of the length; the radii of notch and
bar were then fitted to all six values. Four lengths for six values: that forces and contractions
agree before and after the middle has torn says that law and steel act as they should, not more.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

import vmdg
from parts.plasticity.rows import Row
from parts.verification.checks import describe
from vmdg.base.parallel import global_max
from vmdg.laws.base import Law, Mode, Update, add_to_diagonal, dot, outer
from vmdg.meshes import blocks
from vmdg.meshes.two_blocks import LEFT, RIGHT

#: Smallest radius, that of the notch, that of the bar, half of the length [mm].
NECK, NOTCH, BAR, HALF = 3.0, 1.15, 5.5, 30.0
#: Tension curve: strain [-] and true stress [MPa]; beyond it the last slope continues.
E = 2.07e5
CURVE = np.array(
    [
        (0.0025, 495.0),
        *((0.01, 530.0), (0.02, 570.0), (0.03, 604.0), (0.04, 634.0), (0.05, 660.0)),
        *((0.06, 681.0), (0.07, 700.0), (0.08, 716.0), (0.09, 730.0), (0.1, 740.0)),
        *((0.11, 749.0), (0.12, 755.0), (0.13, 765.0), (0.137, 770.0), (0.14, 771.0)),
        *((0.15, 778.0), (0.2, 809.0), (0.3, 855.0), (0.4, 889.0), (0.5, 917.0)),
        *((0.6, 940.0), (0.7, 960.0), (0.8, 977.0), (0.9, 993.0), (1.0, 1008.0), (3.0, 1308.0)),
    ]
)
#: Pull of each end [mm]: force [kN] and contraction of the diameter at the root [mm], with the
#: cohesive zone and with the model of Rousselier.
COHESIVE = {0.2: (29.3851, 0.333262), 0.3: (28.8693, 0.605776), 0.4: (23.6023, 0.931633)}
ROUSSELIER = {0.2: (29.3597, 0.349885), 0.3: (28.6069, 0.620591), 0.4: (22.6731, 0.954683)}


@dataclass(frozen=True)
class ElasticTrapezoid(Law):
    """CZM_TRA_MIX of code_aster (R7.02.11): |T| rises linearly to the strength, stays there, and
    falls linearly; T is along the gap, unloading returns to the origin, contact carries pressure.

    r |zeta| + |T|(|zeta|) = |T_tr + r zeta_n| has one root on one of the four branches. The history
    is Q = strength times the largest gap over the critical one.
    """

    strength: float  # Largest traction [MPa]
    elastic_gap: float  # Where it is reached [mm]
    plateau_gap: float  # Where the traction begins to fall [mm]
    critical_gap: float  # Where the bond is broken [mm]

    @property
    def softening_modulus(self) -> float:
        """Of the descent [MPa/mm]."""
        return self.strength / (self.critical_gap - self.plateau_gap)

    @property
    def unloads_to_origin(self) -> bool:
        """Always."""
        return True

    def stored_energy(self, gap: NDArray, normal: NDArray, softening: NDArray) -> NDArray:
        """Of the secant to the largest gap (n,) [N/mm]."""
        largest = self._largest(softening)
        return self._traction(largest) / largest * dot(gap, gap) / 2

    def _largest(self, softening: NDArray) -> NDArray:
        return np.maximum(softening / self.strength * self.critical_gap, self.elastic_gap)

    def _traction(self, gap: NDArray) -> NDArray:
        """Beyond the elastic branch [MPa]."""
        falling = self.softening_modulus * np.maximum(self.critical_gap - gap, 0.0)
        return np.minimum(self.strength, falling)

    def _spent(self, gap: NDArray) -> NDArray:
        """Dissipated up to a largest gap beyond the elastic branch [N/mm]."""
        P, e, p = self.strength, self.elastic_gap, self.plateau_gap
        fallen = np.clip(gap, p, self.critical_gap) - p
        area = P * (np.minimum(gap, p) - e / 2 + fallen) - self.softening_modulus * fallen**2 / 2
        return area - self._traction(gap) * gap / 2

    def _advance(
        self,
        trial: NDArray,
        normal: NDArray,
        gap: NDArray,
        softening: NDArray,
        penalty: NDArray,
        eta: float | NDArray,
    ) -> Update:
        """Solve T_tr - r (zeta - zeta_n) = T(zeta)."""
        r, H, largest = penalty, self.softening_modulus, self._largest(softening)
        b = trial + r[:, None] * gap
        pressed = dot(b, normal) < 0.0
        b = b - np.minimum(dot(b, normal), 0.0)[:, None] * normal
        load = np.sqrt(dot(b, b))
        secant = self._traction(largest) / largest
        level, falling = (load - self.strength) / r, (load - H * self.critical_gap) / (r - H)
        branches = [level <= self.plateau_gap, falling <= self.critical_gap]
        grown = np.select(branches, [level, falling], load / r)
        grows = load > (r + secant) * largest
        slope = np.where(grows, np.select(branches, [0.0, -H], 0.0), secant)
        secant = np.where(grows, self._traction(grown) / np.where(grows, grown, 1.0), secant)
        update = Update.elastic(trial, b / (r + secant)[:, None], softening)
        step = update.gap - gap
        update.traction[:] -= r[:, None] * step
        reached = np.minimum(grown / self.critical_gap, 1.0)
        update.softening[grows] = self.strength * reached[grows]
        update.multiplier[grows] = np.sqrt(dot(step, step))[grows]
        add_to_diagonal(update.tangent, 1 / (r + secant))
        held = normal[pressed]
        update.tangent[pressed] -= outer(held / (r + secant)[pressed, None], held)
        along = b / np.where(load > 0.0, load, 1.0)[:, None]
        update.tangent[:] += outer((1 / (r + slope) - 1 / (r + secant))[:, None] * along, along)
        update.mode[:] = np.where(pressed, Mode.SHEAR, Mode.TENSION)
        update.mode[(softening >= self.strength) & ~pressed] = Mode.OPEN
        spent = self._spent(self._largest(update.softening)) - self._spent(largest)
        update.damage_work[grows] = spent[grows]
        return replace(update, work_gradient=None)


STEEL = vmdg.J2(
    E, 0.3, hardening=[(max(e - s / E, 0.0) * (n > 0), s) for n, (e, s) in enumerate(CURVE)]
)
BOND = ElasticTrapezoid(1200.0, elastic_gap=0.02, plateau_gap=0.14, critical_gap=0.94 / 3)


def specimen(across: int) -> tuple[vmdg.Problem, vmdg.NamedTags]:
    """The section of the bar, of two halves that meet at the notch, and the tags of its ends.

    The notch is half a circle, and its flanks widen by 45 degrees to the radius of the bar.
    """
    wide = NOTCH + BAR - NECK - NOTCH
    counts = (across // 2, across // 4, 3 * across // 4)
    ends = (0.0, NOTCH, wide)
    rows = [np.linspace(*ends[i : i + 2], n + 1)[:-1] for i, n in enumerate(counts[:2])]
    rows.append(wide + (HALF - wide) * np.linspace(0.0, 1.0, counts[2] + 1) ** 2)
    heights = np.concatenate(rows)
    along = len(heights) - 1
    mesh, cells, facets = blocks(
        MPI.COMM_WORLD, "quadrilateral", (along, across), 2.0, 1.0, interface=(1.0, 1.0)
    )
    x = mesh.geometry.x
    place, depth = x[:, 0] - 1.0, x[:, 1].copy()
    y = heights[np.rint(along * np.abs(place)).astype(int)]
    circle = NECK + NOTCH - np.sqrt(NOTCH**2 - np.minimum(y, NOTCH) ** 2)
    x[:, 0] = depth * np.minimum(circle + np.maximum(y - NOTCH, 0.0), BAR)
    x[:, 1] = np.sign(place) * y
    problem = vmdg.Problem(
        mesh,
        cells,
        {1: STEEL, 2: STEEL},
        [vmdg.Interface(between=(1, 2), law=BOND)],
        degree=2,
        symmetry="axisymmetric",
    )
    problem.dirichlet(facets.find(LEFT), lambda t: -t, "y")
    problem.dirichlet(facets.find(RIGHT), lambda t: t, "y")
    problem.dirichlet_points(lambda x: np.isclose(x[0], 0.0), 0.0, "x")
    return problem, facets


def tear(across: int, steps: int) -> tuple[vmdg.History, str]:
    """Pull each end by 0.4 mm: force [kN] and contraction [mm], and the mesh."""
    problem, facets = specimen(across)
    x = problem.space.tabulate_dof_coordinates()
    root = np.isclose(x[:, 1], 0.0) & np.isclose(x[:, 0], NECK)
    end = facets.find(RIGHT)

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        inwards = -problem.u.x.array.reshape(-1, 2)[root, 0]
        contraction = 2 * global_max(problem.comm, inwards.max(initial=-np.inf))
        return {"force [kN]": problem.reaction(end)[1] / 1e3, "contraction [mm]": contraction}

    loads = np.linspace(0.0, max(COHESIVE), steps + 1)[1:]
    return vmdg.solve(problem, loads, monitor=monitor).history, describe(problem, 2)


def notched(coarse: bool = False) -> tuple[list[Row], vmdg.History]:
    """Force and contraction against the published ones."""
    across, steps = (8, 16) if coarse else (16, 32)
    history, mesh = tear(across, steps)
    rows = []
    for name, published in {"": COHESIVE, ", Rousselier": ROUSSELIER}.items():
        for pull, values in published.items():
            for quantity, reference in zip(("force [kN]", "contraction [mm]"), values, strict=True):
                column, unit = quantity.split()
                found = float(np.interp(pull, history["load"], history[column]))
                label, source = f"{column} at {pull:g} mm {unit}", f"code_aster ssna120a{name}"
                rows.append(Row("notched bar", label, found, reference, source, mesh))
    return rows, history
