"""Energy book-keeping: stored, dissipated, external work."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from support.problems import SAME, STRONG, couple, driven, joined
from support.scenes import two_blocks

import vmdg
from vmdg.meshes import blocks

P_C, ZETA_C = 100.0, 0.2
LAW = vmdg.Debonding(strength=P_C, critical_gap=ZETA_C)
SPENT = ("bulk", "interface", "damage", "friction", "viscosity")
COLUMNS = (*SPENT, "external", "discretization", "imbalance")


def pull(comm, thickness=1.0, steps=20, law=LAW, end=0.3):
    """7.1.1 in the plane with sides on rollers, pulled to separation."""
    scene = blocks(comm, "quadrilateral", (2, 2), height=1.0)
    interface = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, dict(enumerate(SAME, 1)), [interface], thickness=thickness
    )
    problem.dirichlet(scene.facet_tags.find(1), 0.0, "x")
    problem.dirichlet(scene.facet_tags.find(2), lambda t: t, "x")
    for tag in (4, 5):
        problem.dirichlet(scene.facet_tags.find(tag), 0.0, "y")
    options = vmdg.SolveOptions(relative_tolerance=1e-12, energy=True)
    return vmdg.solve(problem, end * np.arange(1, steps + 1) / steps, options).history, problem


@pytest.mark.parametrize("thickness", [1.0, 2.5])
def test_separation(comm, thickness):
    """Pulled apart, P_c zeta_c/2 per area is spent on damage and nothing is stored any more.

    Exact for any number of steps, since the law integrates its softening line; the bodies are free
    of stress to the solver's tolerance. The columns of the history are those of Problem.energy(),
    which evaluates tractions again, to rounding.
    """
    history, problem = pull(comm, thickness)
    final = history.rows[-1]
    assert final["damage"] == pytest.approx(P_C * ZETA_C / 2 * thickness, rel=1e-10)
    assert abs(final["bulk"] + final["interface"]) < 1e-10
    assert final["friction"] == final["viscosity"] == 0
    energy = problem.energy()
    for name in COLUMNS:
        assert final[name] == pytest.approx(getattr(energy, name), rel=1e-12, abs=1e-20)
    assert (np.diff(history["damage"]) >= 0).all()
    assert (history["bulk"] > -1e-12).all()


def test_overstress_that_relaxes_is_dissipated(comm):
    """At rest a viscous bond goes on opening without work from outside: what is stored less goes
    into damage and viscosity, with the curvature of the bodies' energy."""
    law = vmdg.Debonding(strength=P_C, critical_gap=ZETA_C, viscosity=20 * P_C / ZETA_C)
    history, problem = pull(comm, steps=5, law=law, end=0.1)
    before = history.rows[-1]
    options = vmdg.SolveOptions(relative_tolerance=1e-12, energy=True)
    after = vmdg.solve(problem, [0.1], options).history.rows[-1]
    released = before["bulk"] + before["interface"] - after["bulk"] - after["interface"]
    assert after["external"] == pytest.approx(before["external"], rel=1e-14)
    assert after["viscosity"] > before["viscosity"]
    assert abs(after["imbalance"] - before["imbalance"]) < 1e-6 * released


RATED = {
    "linear": lambda nu: vmdg.Debonding(P_C, ZETA_C, viscosity=nu),
    "weak links": lambda nu: vmdg.Debonding(vmdg.Weibull(P_C, 4.0, seed=1), ZETA_C, 0.3, nu),
    "exponential": lambda nu: vmdg.ExponentialDebonding(P_C, 10.0, viscosity=nu),
    "mixed": lambda nu: vmdg.MixedModeDebonding(P_C, 60.0, 10.0, 18.0, viscosity=nu),
    "intrinsic": lambda nu: vmdg.IntrinsicExponential(P_C, 10.0, viscosity=nu),
}


@pytest.mark.parametrize(
    ("name", "kinematics"),
    [
        pytest.param("linear", "finite", marks=pytest.mark.long),
        ("weak links", "small"),
        pytest.param("exponential", "finite", marks=pytest.mark.long),
        ("mixed", "small"),
        pytest.param("intrinsic", "finite", marks=pytest.mark.long),
    ],
)
def test_rates_balance_as_other_bonds_do(comm, name, kinematics):
    """Opened and sheared unevenly, on the way back in between, at rest at last: no more is missing
    than without a rate, and of second order in the step."""

    def missed(nu, steps):
        scene = two_blocks(comm, "quadrilateral", 3, distortion=0.03)
        problem = joined(scene, RATED[name](nu), kinematics=kinematics)
        problem.dirichlet(scene.facet_tags.find(1), 0.0)

        def led(X, t):
            way = 0.12 * t + 0.03 * np.sin(6 * t)
            return np.array([way + 0.02 * t * X[1], 0.04 * np.sin(2 * t) + 0.01 * t * X[1]])

        problem.dirichlet(scene.facet_tags.find(2), led)
        options = vmdg.SolveOptions(relative_tolerance=1e-12, control="load", energy=True)
        vmdg.solve(problem, 2 * np.arange(1, steps + 1) / steps, options)
        vmdg.solve(problem, [2.0], options)
        energy = problem.energy()
        assert energy.viscosity > 0 or nu == 0
        return energy.imbalance / energy.external

    without = max(abs(missed(0.0, 12)), 2e-5)
    for strengths in (0.1, 1.0, 20.0):
        error = abs(missed(strengths * P_C, 12))
        assert error < 1.5 * without or abs(missed(strengths * P_C, 24)) < 0.4 * error


@pytest.mark.parametrize(
    ("law", "bounds"),
    [
        (vmdg.IntrinsicExponential(P_C, 10.0, shear_weight=2.0), (3e-2, 5e-4)),
        (vmdg.MixedModeDebonding(P_C, 80.0, 10.0, 20.0, unloading="secant"), (1e-4, 1e-6)),
    ],
)
def test_damage_of_a_gap_that_turns(comm, law, bounds):
    """Opened, then sheared while it parts, in 6 and in 60 steps: what the parts of a step charge.

    The mean of the charges at its ends misses up to 12% and .5%, and 3e-4 and 8e-6.
    """

    def path(t):
        return (0.1 * t, 0.3 * max(t - 0.5, 0.0)), 0.0

    for steps, bound in zip((6, 60), bounds, strict=True):
        problem, _ = driven(comm, "quadrilateral", law, path)
        options = vmdg.SolveOptions(relative_tolerance=1e-12, control="load", energy=True)
        vmdg.solve(problem, np.arange(1, steps + 1) / steps, options)
        energy = problem.energy()
        assert abs(energy.imbalance) < bound * energy.external


def test_friction_that_begins_within_a_step(comm):
    """A bond that is nearly gone closes at the end of a step in which it slides: friction has the
    pressure on the way; that of the end over the whole way would be 0.13 N mm."""
    law = vmdg.Debonding(P_C, ZETA_C, friction=0.5, unloading="secant")
    scene = blocks(comm, "quadrilateral", (2, 2), height=1.0)
    problem = couple(scene, law)
    x, y = np.array([[0.0, 0.9, 0.2, -0.01], [0.0, 0.0, 0.0, 0.5]]) * ZETA_C
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    path = lambda t: [np.interp(t, range(4), way) for way in (x, y)]  # noqa: E731
    problem.dirichlet(scene.facet_tags.find(2), path)
    vmdg.solve(problem, [1.0, 2.0])
    before = problem.energy()
    vmdg.solve(problem, [3.0])
    energy = problem.energy()
    assert before.friction == 0 < energy.friction
    assert abs(energy.imbalance - before.imbalance) < 1e-3


@pytest.mark.parametrize(
    ("law", "options"),
    [(vmdg.Bonded(), {}), (vmdg.Bonded(), {"traction_jump": True}), (STRONG, {})],
)
def test_tau_s_that_changes_is_counted(comm, law, options):
    """What a new tau_s adds at fixed u and zeta is the change of (30) as a form."""
    scene = blocks(comm, "quadrilateral", (1, 2))
    problem = couple(scene, law, **options)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    for component, size in (("x", 0.03), ("y", 0.05)):
        problem.dirichlet(scene.facet_tags.find(2), lambda t, size=size: size * t, component)
    vmdg.solve(problem, 2, vmdg.SolveOptions(relative_tolerance=1e-12))
    parts, energy = problem.step.discretization, problem.energy()
    added = comm.allreduce(parts.update_stabilization())
    assert abs(added) > 1e-6 * energy.external
    assert problem.energy().stored - energy.stored == pytest.approx(added, rel=1e-6)


def hanging_bar(comm, steps: int, energy: bool) -> tuple[vmdg.Problem, int]:
    """Two bonded squares that hang, their weight put on in equal steps; the residuals it took."""
    scene = blocks(comm, "quadrilateral", (1, 2))
    problem = couple(scene, vmdg.Bonded())
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.body_force(lambda t: [100.0 * t, 20.0 * t])
    options = vmdg.SolveOptions(relative_tolerance=1e-12, energy=energy)
    return problem, vmdg.solve(problem, steps, options).counts.residuals


def test_work_of_eigenstrains(comm):
    """A block shrinks on another one at finite strain: in eight steps the balance holds to 1e-4.

    The trapezoidal rule alone misses 1e-3 of it.
    """
    mesh, cells, facets = blocks(comm, "quadrilateral", (3, 3))
    bodies = {1: vmdg.NeoHookean(E=1000.0, nu=0.3), 2: vmdg.NeoHookean(E=3000.0, nu=0.3)}
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Bonded(), safety=4.0)
    problem = vmdg.Problem(mesh, cells, bodies, [bond], eigenstrain={1: lambda t: -0.02 * t})
    problem.dirichlet(facets.find(2), 0.0)
    vmdg.solve(problem, 8)
    energy = problem.energy()
    assert abs(energy.imbalance) < 1e-4 * energy.external


@pytest.mark.parametrize(
    "form", [{"degree": 2}, {"volumetric": "mean"}, {"plane": "stress"}], ids=str
)
@pytest.mark.parametrize("limit, allowed", [(1e9, 1e-10), (4.0, 0.01)])
def test_work_of_eigenstrains_of_bodies_at_points(comm, form, limit, allowed):
    """An elastic block between supports that shrinks stores the work exactly; one that flows from
    the middle of a step on misses what the trapezoidal rule does."""
    mesh, cells, facets = blocks(comm, "quadrilateral", (3, 3))
    metal = vmdg.J2(1000.0, 0.3, limit, hardening=50.0)
    bodies = {1: metal, 2: vmdg.NeoHookean(E=3000.0, nu=0.3)}
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    options = form | {"kinematics": "small", "eigenstrain": {1: lambda t: -0.02 * t}}
    problem = vmdg.Problem(mesh, cells, bodies, [bond], **options)
    for end in (1, 2):
        problem.dirichlet(facets.find(end), 0.0)
    vmdg.solve(problem, 8, vmdg.SolveOptions(relative_tolerance=1e-11))
    energy = problem.energy()
    assert (energy.plastic > 0) == (limit < 1e9)
    assert abs(energy.imbalance) < allowed * energy.external


def test_what_costs_residuals_is_asked_for(comm):
    """The energies of the last step are exact where they are asked for; those of earlier steps,
    for which nobody asked, are of the trapezoidal rule and what two steps foretell."""
    errors, counts = {}, {}
    for asked in (True, False):
        for steps in (1, 8, 16):
            problem, counts[asked, steps] = hanging_bar(comm, steps, asked)
            energy = problem.energy()
            errors[asked, steps] = abs(energy.imbalance) / energy.external
            assert problem.energy() == energy
    assert errors[True, 1] == errors[False, 1] < 1e-4
    assert errors[True, 16] < 2e-6 < errors[False, 16] < 0.4 * errors[False, 8] < 1e-3
    assert counts[False, 8] < counts[True, 8]


class Springy(vmdg.Material):
    """W = k E:E with a Constant that may change."""

    def __init__(self, k: fem.Constant):
        self.parameters, self._k = {"unit": 1.0}, k

    def energy(self, F, parameters):
        E = (F.T * F - ufl.Identity(3)) / 2
        return self._k * ufl.inner(E, E)


@pytest.mark.parametrize("residual", ["symbolic", "points"])
def test_constant_of_a_material_that_changes(comm, residual):
    """The energy follows at once, that of interfaces too: as after a residual."""
    scene = two_blocks(comm, "quadrilateral", 2)
    k = fem.Constant(scene.mesh, 1000.0)
    problem = joined(scene, STRONG, [Springy(k)] * 2, residual=residual)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: (t, 0.2 * t))
    vmdg.solve(problem, [0.02])
    before = problem.energy()
    k.value = 2000.0
    energy = problem.energy()
    problem.discretization.assemble_residual(None)
    assert energy.bulk == pytest.approx(2 * before.bulk, rel=1e-12)
    assert energy.interface == pytest.approx(problem.energy().interface, rel=1e-12)
    assert energy.interface != pytest.approx(before.interface, rel=0.1)
