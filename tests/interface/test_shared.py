"""Interfaces with equal laws share one return map."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from dolfinx.mesh import compute_midpoints
from support.problems import MATERIALS

import vmdg
from vmdg.meshes import blocks


@dataclass(frozen=True)
class Counted(vmdg.Debonding):
    """Remembers how many points each of its return maps had."""

    sizes: ClassVar[list[int]] = []

    def return_map(self, trial, *others):
        self.sizes.append(len(trial))
        return super().return_map(trial, *others)


def split(comm, number: int, kinematics: str) -> tuple[vmdg.Problem, vmdg.Law]:
    """Two blocks that are joined by ``number`` interfaces with equal laws, one above the other."""
    scene = blocks(comm, "quadrilateral", (2, 12, 2), length=2.0, height=3.0, interface=(1.0, 1.0))
    facets = scene.facet_tags.find("interface")
    height = compute_midpoints(scene.mesh, 1, facets)[:, 1]
    part = np.minimum((height / 3.0 * number).astype(int), number - 1)
    laws = [Counted(strength=20.0, critical_gap=0.1, friction=0.3) for _ in range(number)]
    interfaces = [vmdg.Interface(facets=facets[part == i], law=laws[i]) for i in range(number)]
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, dict(enumerate(MATERIALS, 1)), interfaces, 1, kinematics
    )
    problem.dirichlet(scene.facet_tags.find("left"), 0.0)
    problem.dirichlet(
        scene.facet_tags.find("right"),
        lambda x, t: t * np.stack([0.03 * (x[1] - 1.0), 0.02 + 0 * x[0]]),
    )
    return problem, laws[0]


@pytest.mark.parametrize("kinematics", ["finite"])
def test_one_return_map(comm, kinematics):
    """One for all of six interfaces, and forces, softening and energies as of a single one."""
    results = []
    for number in (1, 6):
        problem, law = split(comm, number, kinematics)
        vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(relative_tolerance=1e-11))
        points = sum(len(state.weights) for state in problem.state)
        law.sizes.clear()
        problem.step.assemble_residual()
        assert law.sizes == [points]
        states = [np.column_stack([s.points, s.traction, s.softening]) for s in problem.state]
        rows = np.concatenate(comm.allgather(np.concatenate(states)))
        order = np.lexsort(rows[:, :2].round(9).T)
        results.append((rows[order], problem.energy()))
    (one, energy), (six, energies) = results
    assert one[:, -1].max() > 1
    assert six == pytest.approx(one, rel=1e-8, abs=1e-8)
    assert energies.damage == pytest.approx(energy.damage, rel=1e-8)


@dataclass(frozen=True)
class Mistaken(vmdg.Debonding):
    """Answers with a gap of NaN, or of another shape."""

    def return_map(self, trial, normal, gap, *others):
        """As that of Debonding, whose arguments it overwrites."""
        update = super().return_map(trial, normal, gap, *others)
        if self.strength > 1.0:
            trial[:] = normal[:] = gap[:] = 7.0
            return update
        wrong = np.full_like(update.gap, np.nan) if self.friction else update.gap[:, 0]
        return replace(update, gap=wrong)


def test_answers_of_a_law(comm):
    """What a law of the user's returns is checked, and it cannot overwrite what it is given."""
    scene, runs = blocks(comm, "quadrilateral", (2, 2)), {}
    for kind, strength, friction in (
        (vmdg.Debonding, 20.0, 0.3),
        (Mistaken, 20.0, 0.3),
        (Mistaken, 1.0, 0.3),
        (Mistaken, 1.0, 0.0),
    ):
        law = kind(strength=strength, critical_gap=0.1, friction=friction)
        bodies = dict(enumerate(MATERIALS, 1))
        bond = vmdg.Interface(between=(1, 2), law=law)
        problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [bond])
        problem.dirichlet(scene.facet_tags.find("left"), 0.0)
        problem.dirichlet(scene.facet_tags.find("right"), lambda t: (0.05 * t, 0.02 * t))
        reason = r"Mistaken.return_map: gap (\[nan|of \d+ points has shape)"
        with pytest.raises(ValueError, match=reason) if strength == 1.0 else nullcontext():
            vmdg.solve(problem, [0.5, 1.0])
            runs[kind] = problem.u.x.array.copy()
    assert np.array_equal(*runs.values())
