"""What a problem says of itself: stress, fine scales, a line and tables in notebooks."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import PRECISE, couple, joined
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg

MU, LMBDA = 2000.0, 3000.0
BODIES = (vmdg.NeoHookean(mu=MU, lmbda=LMBDA),) * 2
LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2)


@pytest.mark.parametrize(
    ("kinematics", "volumetric"), [("finite", "mean"), ("finite", "pointwise"), ("small", "mean")]
)
def test_stress_out_of_the_plane(comm, kinematics, volumetric):
    """All of sigma in plane strain of a body that swells by theta, against the closed form.

    sigma = mu/J_e (b_e - I) + lambda (J_e - 1) I with F_e = F / (1 + theta), F_33 = 1.
    """
    theta = 0.02 if kinematics == "finite" else 1e-3
    H = np.array([[0.1, 0.05], [-0.02, -0.05]]) * (1 if kinematics == "finite" else 1e-2)
    options = {"kinematics": kinematics, "volumetric": volumetric}
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = joined(scene, LAW, BODIES, eigenstrain={1: theta, 2: theta}, **options)
    problem.u.interpolate(lambda x: H @ x[:2])
    found = problem.stress().x.array.reshape(-1, 3, 3)
    F = np.eye(3)
    F[:2, :2] += H
    if kinematics == "finite":
        F /= 1 + theta
        J = np.linalg.det(F)
        exact = MU / J * (F @ F.T - np.eye(3)) + LMBDA * (J - 1) * np.eye(3)
    else:
        strain = (F + F.T) / 2 - (1 + theta) * np.eye(3)
        exact = 2 * MU * strain + LMBDA * np.trace(strain) * np.eye(3)
    assert found == pytest.approx(np.broadcast_to(exact, found.shape), rel=1e-10, abs=1e-9)


def test_stress_is_one_function(comm):
    """Its values follow the displacement, also where facets have been opened on demand."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = couple(scene, LAW, BODIES, activate="on-demand")
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(scene.facet_tags.find(RIGHT), lambda t: (t, 0.0))
    function, before = problem.stress(), problem.discretization
    assert not function.x.array.any()
    vmdg.solve(problem, [0.05, 0.1])
    assert problem.discretization is not before
    assert problem.stress() is function
    middle = problem.mean(0).traction[0]
    x = function.function_space.tabulate_dof_coordinates()[:, 0]
    found = function.x.array.reshape(-1, 9)[x > 1.99, 0]
    assert found == pytest.approx(np.full(len(found), middle), rel=0.2)


def test_fine_scales(comm):
    """Zero where the elements have the solution, of order h^(k+1) where they do not."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = couple(scene, LAW, BODIES)
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0, "x")
    problem.dirichlet(scene.facet_tags.find(RIGHT), lambda t: t, "x")
    problem.dirichlet(scene.facet_tags.find("bottom"), 0.0, "y")
    vmdg.solve(problem, [0.01], PRECISE)
    assert vmdg.average(problem, 0, "fine_scale") < 1e-12
    errors = []
    for n in (4, 8):
        problem = couple(two_blocks(comm, "quadrilateral", n), vmdg.Bonded(), BODIES)
        problem.u.interpolate(lambda x: 0.01 * np.stack([np.sin(x[0] + x[1]), np.cos(x[0] * x[1])]))
        problem.discretization.update_stabilization()
        problem.step.assemble_residual()
        errors.append(vmdg.average(problem, 0, "fine_scale"))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(2, abs=0.2)


def test_snapshot(comm):
    """It stays as it is while the run goes on, and the problem as it was when it is looked at."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem, right = couple(scene, LAW, BODIES), scene.facet_tags.find(RIGHT)
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(right, lambda t: (t, 0.0))
    kept, seen = [], []

    def monitor(problem: vmdg.Problem) -> None:
        kept.append(problem.snapshot())
        seen.append((problem.t, problem.u.x.array.copy(), problem.reaction(right)))

    vmdg.solve(problem, [0.05, 0.1, 0.2], monitor=monitor)
    assert len(kept) >= 3
    for snapshot, (t, u, force) in zip(kept, seen, strict=True):
        assert snapshot.t == t
        assert (snapshot.u == u).all()
        problem.step.return_to(snapshot)
        assert problem.t == t
        assert (problem.u.x.array == u).all()
        assert problem.reaction(right) == pytest.approx(force, abs=0)


def test_lines_and_tables(comm):
    """In a line: sizes, bodies, interfaces, work; in a notebook tables too."""
    scene = two_blocks(comm, "quadrilateral", 2)
    problem = couple(scene, LAW, name="bond")
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(scene.facet_tags.find(RIGHT), lambda t: (t, 0.0))
    result = vmdg.solve(problem, [0.001, 0.002])
    assert repr(problem) == (
        "<Problem: 8 cells (quadrilateral), 36 dofs; materials 1: NeoHookean, 2: NeoHookean; "
        "interfaces bond; t = 0.002>"
    )
    assert repr(vmdg.NeoHookean(mu=2.0, lmbda=3.0)) == "<NeoHookean: mu=2, lmbda=3>"
    soil = vmdg.DruckerPrager(50.0, 0.3, 0.02, 30.0)
    assert repr(soil).endswith("friction=30, dilatancy=30, hardening=0, fit=compression>")
    assert repr(problem.snapshot()) == "<Snapshot: t = 0.002>"
    if comm.size == 1:
        said = "<InterfaceState: 4 points, 0 of them damaged; 2 facets, area 1>"
        assert repr(problem.state[0]) == said
    table = problem._repr_html_()
    assert "&lt;Problem: 8 cells" in table and "<td>0</td><td>bond</td><td>Interface(" in table
    assert repr(result).startswith("<Result: 2 steps, ") and str(result.counts) in repr(result)
    assert result.history._repr_html_() in result._repr_html_()
    assert "failed attempt" not in result._repr_html_()
    result.failures.append((0.5, "a < b"))
    assert "<td>0.5</td><td>a &lt; b</td>" in result._repr_html_()
