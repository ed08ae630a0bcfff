"""The derivative of the work on bonds by the displacement, from what return maps say."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import driven, partly_damaged

import vmdg
from vmdg.base.parallel import global_sum
from vmdg.interface.active import total_in_frame


def by_displacement(problem, dt: float = 1.0) -> tuple[float, float]:
    """dD along a random displacement: by differences of D, and from `work_gradient` [N mm]."""
    active = problem.discretization.active[0]
    gradient, u = active.work_gradient(dt), problem.u.x.array
    x = problem.u.function_space.tabulate_dof_coordinates()
    d = problem.mesh.geometry.dim
    way = np.sin(3 * x[:, :d] + np.arange(d)).ravel() * 1e-7
    works, totals = [], []
    for sign in (1, -2, 1):
        u += sign * way
        problem.u.x.scatter_forward()
        problem.discretization.update_points(dt)
        works.append(problem.step.bond_work())
        totals.append(total_in_frame(active))
    spent = np.einsum("p,pi,pi->", active.quadrature.weights, gradient, totals[0] - totals[1])
    return works[0] - works[1], float(global_sum(problem.mesh.comm, spent))


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
@pytest.mark.parametrize("kinematics", ["small", "finite"])
def test_work_on_bonds_by_the_displacement(comm, cell, kinematics):
    """dD = sum of dA (d damage work/d T_tr).dT_tr, in a frame that turns too."""
    problem = partly_damaged(comm, cell, 1, kinematics=kinematics)
    by_differences, by_laws = by_displacement(problem)
    assert abs(by_laws) > 0
    assert by_laws == pytest.approx(by_differences, rel=1e-5)


class Silent(vmdg.Debonding):
    """A law of one's own that does not say its gradient."""

    def return_map(self, *arguments):
        update = super().return_map(*arguments)
        update.work_gradient[:] = 0.0
        return update


@pytest.mark.parametrize("overstress", [3.0])
def test_laws_of_ones_own_and_steps_of_a_jump(comm, overstress):
    """The same by differences, and with the drag of a jump in the return map."""
    for law in (vmdg.Debonding(100.0, 0.2), Silent(100.0, 0.2)):
        problem, _ = driven(comm, "quadrilateral", law, lambda t: ((0.15 * t, 0.02 * t), 0.0))
        vmdg.solve(problem, [1.0], vmdg.SolveOptions(relative_tolerance=1e-12))
        problem.step.begin(1.1, 1.0, overstress)
        problem.u.x.array[:] *= 1.1
        problem.step.assemble_residual()
        by_differences, by_laws = by_displacement(problem)
        assert abs(by_laws) > 0
        assert by_laws == pytest.approx(by_differences, rel=1e-5)
