"""What is compared between two ways of telling a scene, and by how much they may differ.

Forces are compared relative to the largest of the run, energies relative to all that is stored and
dissipated. A scene that is told in another way has the same rows; where rounding has put one more
into a path that bonds make unstable, histories differ by the error of a step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from time import perf_counter

from mpi4py import MPI

import numpy as np

from parts.interfaces.scenes import WAYS, Scene, View, draw, turns
from parts.stability.checks import EPS, Run, stiffest
from parts.stability.execution import execute
from parts.stability.runner import Outcome
from parts.stability.scenes import Array, Case

#: Ways that differ by rounding and by the residuals that are left, a thousandth of this.
SAME = 1e-8

#: Ranks: sums in another order.
RANKS = 1e-9

#: Ways that differ by the rows of the path.
ROWS = 2e-2

#: Side 1 of surfaces that do not coincide: pressures meet the normals of side 1, an error of second
#: order in the angle between the surfaces; edges of a body that slides. More is right where it
#: vanishes on a finer mesh.
SIDE = 0.03

#: Change of the forces by a finer mesh that need not be smaller than the change before: where that
#: is small by chance.
MESH = 0.05

#: Energy of a body next to an open interface; of a row that is lost or gained, of all that is
#: stored and spent; work of the reactions against the one reported.
NEAR, IMBALANCE, WORK = 0.01, 0.02, 0.01


@dataclass(frozen=True)
class Told:
    """Rows at the given load factors in units of 1, at home.

    Attributes:
        forces: Reactions of all supports (n, m) [N].
        energies: Stored, damage, friction, plastic, external (n, 5) [N mm].
        rows: Load factors of all rows.
        residuals: Assembled by the solver.
        stopped: Message of the error that ended the run.
    """

    forces: Array
    energies: Array
    rows: list[float]
    residuals: int
    stopped: str

    @classmethod
    def of(cls, run: Run, scene: Scene, view: View) -> Told:
        """The rows of a run."""
        rows = [record.t for record in run.records]
        given = [run.records[rows.index(t)] for t in run.case.loads if t in rows]
        power = 2 if scene.d == 3 or scene.axisymmetric else 1
        force = view.stress * view.length**power
        turn = np.eye(scene.d) if view.turn is None else view.turn
        forces = [np.concatenate([turn.T @ f for f in r.reactions]) / force for r in given]
        energies = [
            np.array([e.stored, e.damage, e.friction, e.plastic, e.external])
            / (force * view.length)
            for e in (record.energy for record in given)
        ]
        return cls(np.array(forces), np.array(energies), rows, run.residuals, run.stopped)

    def same_rows(self, other: Told) -> bool:
        """Whether both have gone by the same load factors."""
        return len(self.rows) == len(other.rows) and np.allclose(self.rows, other.rows, 0, SAME)

    def differs(self, other: Told) -> tuple[float, float]:
        """Largest difference of forces and of energies, over their sizes in this one."""
        n = min(len(self.forces), len(other.forces))
        if n == 0:
            return 0.0, 0.0
        force, energy = np.abs(self.forces).max(), np.abs(self.energies[:, :4]).sum(axis=1).max()
        return (
            float(np.abs(self.forces[:n] - other.forces[:n]).max() / force),
            float(np.abs(self.energies[:n] - other.energies[:n]).max() / energy),
        )


def told(scene: Scene, view: View, comm: MPI.Comm = MPI.COMM_SELF) -> Told:
    """A scene run as it is told; no rows where it is refused."""
    try:
        return Told.of(execute(scene.case(view), comm), scene, view)
    except ValueError as error:
        return Told(np.zeros((0, 1)), np.zeros((0, 5)), [], 0, str(error))


def views(scene: Scene, number: int) -> dict[str, tuple[View, float]]:
    """Ways in which the solution is the same, and by how much it may differ."""
    rng = np.random.default_rng([number, 1])
    length, stress = 2.0 ** rng.integers(-12, 12, 2)
    found = {"other units": (View(length=float(length), stress=float(stress)), 0.0)}
    for name, turn in turns(scene, rng).items():
        shift = 0.0 if scene.axisymmetric else 0.3
        found[name] = View(turn=turn, shift=shift), SAME
    if scene.way == "matching":
        found["points"] = View(residual="points"), SAME
        found["apart"] = View(apart=True), SAME
    same = scene.way == "matching" or (scene.plane and not scene.slides)
    found["sides swapped"] = View(swapped=True), SAME if same else SIDE
    return found


def fault(name: str, one: Told, other: Told, allowed: float, rounded: float = 0.0) -> str:
    """What is wrong with another way of telling a scene; empty if nothing is.

    Args:
        name: Of the way.
        one, other: The scene at home and told in this way.
        allowed: Difference.
        rounded: Rounding of the energies, which may come on top unless all digits are to be equal.
    """
    if bool(one.stopped) != bool(other.stopped):
        return f"{name}: stopped, {one.stopped or other.stopped}"
    force, energy = one.differs(other)
    if not one.same_rows(other):
        if allowed == 0:
            return f"{name}: {len(other.rows)} rows for {len(one.rows)}, or at other loads"
        allowed = max(allowed, ROWS)
    if allowed == 0 and one.residuals != other.residuals:
        return f"{name}: {other.residuals} residuals for {one.residuals}"
    if force <= allowed and energy <= allowed + rounded * (allowed > 0):
        return ""
    rows = f"{len(one.rows)} and {len(other.rows)} rows"
    return f"{name}: forces differ by {force:.1e}, energies by {energy:.1e}, {rows}"


def settles(
    scene: Scene, coarse: Told, told: Callable[[Scene, View], Told] = told
) -> tuple[str, float]:
    """Whether forces settle as the mesh gets finer, and how much they change at first."""
    meshes, changes = [coarse], []
    levels = (2, 4, 8) if scene.d == 2 else (2, 3) if scene.degree == 1 else ()
    for level in levels:
        meshes.append(told(scene, View(level=level)))
        if meshes[-1].stopped:
            return f"finer: stopped, {meshes[-1].stopped}", max(changes, default=0.0)
        changes.append(meshes[-1].differs(meshes[-2])[0])
        if len(changes) > 1 and changes[-1] <= max(changes[-2], MESH):
            return "", changes[0]
    shown = ", then by ".join(f"{change:.1e}" for change in changes)
    return f"finer: forces change by {shown}" if changes else "", max(changes, default=0.0)


def swapped_settles(scene: Scene, here: Told, other: Told) -> bool:
    """Whether sides differ on a mesh twice as fine by half of what they do here at most, in all:
    two or three facets along a curve are far from where the error is one of second order."""
    fine = [told(scene, View(level=2, swapped=swapped)) for swapped in (False, True)]
    if here.stopped or other.stopped or fine[0].stopped or fine[1].stopped:
        return False
    return max(fine[0].differs(fine[1])) <= max(here.differs(other)) / 2


def open_faults(case: Case, run: Run) -> str:
    """Whether a body behaves next to an open interface as if there were none."""
    if any(np.abs(T).max() > 0 for record in run.records for T in record.traction if T.size):
        return ""
    free = execute(replace(case, bonds=()))
    here, there = (each.records[-1].energy.stored for each in (run, free))
    if abs(here - there) <= NEAR * there:
        return ""
    return f"open: strain energy {here / there:.4f} of that without an interface"


def own_faults(scene: Scene, run: Run) -> list[str]:
    """Energies of the rows: their balance, and the work of the supports.

    In a step in which the reactions change by dR, in whatever order, the mean of both ends misses
    dR.du/2 of the work at most.
    """
    found, work, kinks = [], 0.0, 0.0
    size = max(record.energy.stored + record.energy.dissipated for record in run.records)
    before = run.records[0]
    values = run.problem.loading.prescribed_values
    for record in run.records[1:]:
        energy = record.energy
        yielded = energy.plastic > 0  # where in a step bodies begin to flow, nothing says
        if abs(energy.imbalance) > IMBALANCE * size and not found and not yielded:
            share = energy.imbalance / size
            found.append(f"imbalance {share:.1e} at t = {record.t:.3g}")
        moved = values(record.t) - values(before.t)
        first, last = (each.forces[record.prescribed] for each in (before, record))
        work += (first + last) @ moved / 2
        kinks += np.abs(last - first) @ np.abs(moved) / 2
        off, before = abs(work - energy.external), record
        if scene.strain is None and scene.traction is None and off > WORK * size + kinks:
            return [*found, f"external off the work of the supports by {off / size:.1e}"]
    return found


def judged(number: int) -> Case:
    """Case of a number with all that it is compared with."""
    scene = draw(number)
    case = scene.case()

    def judge(run: Run) -> list[str]:
        found = own_faults(scene, run)
        here = Told.of(run, scene, View())
        if run.stopped:
            return found
        settled, change = settles(scene, here)
        rounded = 10 * run.rounding / run.force
        size = max(record.energy.stored + record.energy.dissipated for record in run.records)
        # W is the difference of numbers of the size of the moduli.
        of_W = EPS * stiffest(run) * run.reach**scene.d / size
        for name, (view, allowed) in views(scene, number).items():
            if allowed == SAME:
                allowed += rounded
            elif allowed == SIDE:
                allowed = max(SIDE, change)
            other = told(scene, view)
            wrong = fault(name, here, other, allowed, of_W)
            vanishes = wrong and allowed >= SIDE and swapped_settles(scene, here, other)
            found.append("" if vanishes else wrong)
        found.append(settled)
        if scene.way == "open":
            found.append(open_faults(case, run))
        return [text for text in found if text]

    return replace(case, judge=judge)


def numbers(each: int, first: int = 0) -> range:
    """Numbers of some scenes of every way."""
    return range(first, first + each * len(WAYS))


def ranks(number: int) -> Outcome:
    """A scene solved by all ranks together and by every rank alone; collective."""
    start, scene = perf_counter(), draw(number)
    case = scene.case()
    together, alone = (told(scene, View(), comm) for comm in (MPI.COMM_WORLD, MPI.COMM_SELF))
    faults = MPI.COMM_WORLD.allgather(fault("ranks", alone, together, RANKS))
    found = "; ".join(sorted(set(filter(None, faults))))
    verdict = "wrong" if found else "stopped" if alone.stopped else "correct"
    work = len(alone.rows) - 1, 0, alone.residuals, perf_counter() - start
    return Outcome(number, case.family, verdict, *work, str(case), found or alone.stopped)
