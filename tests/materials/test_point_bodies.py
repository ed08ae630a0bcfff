"""Bodies whose stress is computed at points, in the forms: residual, tangent, states."""

from __future__ import annotations

import re
from contextlib import nullcontext
from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
from support.checks import multiply, product_error, tangent_matrix
from support.plastic_bar import BAR, BOND, LENGTH, LOADS, NU, SIGMA, E, series
from support.problems import joined, partly_damaged
from support.scenes import SEVERAL_RANKS, two_blocks

import vmdg
from vmdg.domain.point_evaluator import PointEvaluator

METAL = vmdg.J2(E, NU, 60.0, hardening=400.0, saturation=90.0, exponent=20.0)
ELASTIC = vmdg.NeoHookean(E=2 * E, nu=NU)
BODIES = {"both": (METAL, METAL), "one": (METAL, ELASTIC)}
LOCKS = pytest.mark.filterwarnings("ignore:plastic flow keeps the volume")
KINEMATICS = pytest.mark.parametrize("kinematics", ["small", "finite"])


def test_stress_of_a_sheet(comm):
    """Cauchy stress of a strip that is pulled: tau/J with tau = P l, J = exp((1 - 2 nu) tau/E)."""
    scene = two_blocks(comm, "triangle")
    sheet = joined(scene, vmdg.Bonded(), (BAR, BAR), plane="stress")
    sheet.dirichlet(scene.facet_tags.find(1), 0.0, "x")
    sheet.dirichlet(scene.facet_tags.find(2), lambda t: 0.2 * t, "x")
    sheet.dirichlet(lambda x: np.isclose(x[1], 0.0), 0.0, "y")
    vmdg.solve(sheet, 4, vmdg.SolveOptions(relative_tolerance=1e-12))
    tau = -sheet.reaction(scene.facet_tags.find(1))[0] * (1 + 0.2 / LENGTH)
    assert tau > 1.2 * SIGMA
    expected = np.zeros((3, 3))
    expected[0, 0] = tau * np.exp(-(1 - 2 * NU) * tau / E)
    found = sheet.stress().x.array.reshape(-1, 3, 3)
    assert np.abs(found - expected).max(initial=0.0) < 1e-9 * tau


MEANS = {
    "generalized": {"plane": "generalized strain"},
    "periodic": {"periodic": vmdg.Periodic(stress={"xx": 1.0})},
    "both": {"periodic": vmdg.Periodic(stress={"xx": 1.0}), "plane": "generalized strain"},
}


class Skewed(vmdg.PointMaterial):
    """C : e + c (e : B)^2 D, whose moduli have no symmetry, as those of non-associated flow."""

    symmetric, kinematics = False, ("small",)
    C = METAL(np.zeros((1, 3, 3)), np.zeros((1, 7)), 1.0, True).moduli[0]
    B = np.array([[1.0, 0.5, 0.2], [0.5, -0.3, 0.1], [0.2, 0.1, 0.4]])
    D = np.array([[0.2, -0.4, 0.1], [-0.4, 0.8, 0.3], [0.1, 0.3, -0.5]])

    def __call__(self, strain, state, dt, small):
        size = np.einsum("pij,ij->p", strain, self.B)
        bent = 1e4 * size[:, None, None] ** 2 * self.D
        stress = np.einsum("ijkl,pkl->pij", self.C, strain) + bent
        turn = 2e4 * np.einsum("p,ij,kl->pijkl", size, self.D, self.B)
        nothing = np.zeros(len(strain))
        return vmdg.Response(stress, self.C + turn, state, nothing, nothing)


@LOCKS
@pytest.mark.parametrize(
    ("cell", "kinematics", "means"),
    [
        ("triangle", "small", "generalized"),
        ("quadrilateral", "finite", "both"),
        ("triangle", "skewed", "both"),
        ("quadrilateral", "finite", "generalized"),
        ("tetrahedron", "skewed", "periodic"),
        ("hexahedron", "finite", "periodic"),
        ("quadrilateral", "small", "periodic"),
    ],
)
def test_tangent_with_means(comm, cell, kinematics, means):
    """Of F_33 and of the mean gradient too, whose rows are those of the transposed tangent."""
    bodies, small = BODIES["one"], kinematics != "finite"
    if kinematics == "skewed":
        bodies = Skewed(ELASTIC), ELASTIC
    options = MEANS[means] | {"materials": bodies, "kinematics": "small" if small else "finite"}
    problem = partly_damaged(comm, cell, 1, **options)
    matrix, parts = tangent_matrix(problem), problem.discretization
    unknown = parts.means
    units = unknown.unit_vectors(comm.bcast(unknown.owned_dofs))
    rows = [parts.uniform_forces(unknown.gradient_of_owned(one), adjoint=True) for one in units]

    def product(v):
        result = multiply(matrix, v) + parts.uniform_forces(unknown.gradient_of_owned(v))
        forces = comm.allreduce(np.array(rows) @ v)
        result[unknown.owned_dofs] = forces[: len(unknown.owned_dofs)]
        return result

    assert product_error(problem, product) < 1e-7
    if kinematics != "skewed":
        alpha = problem.discretization.bodies.points.state.next[0][:, 0]
        assert comm.allreduce(float(alpha.max(initial=0.0)), MPI.MAX) > 1e-3


@pytest.mark.parametrize(
    ("cell", "options", "kinematics"),
    [
        pytest.param("hexahedron", {"degree": 2}, "small", marks=pytest.mark.long),
        pytest.param("tetrahedron", {"degree": 2}, "finite", marks=pytest.mark.long),
        ("hexahedron", {"volumetric": "mean"}, "finite"),
        ("triangle", {"plane": "stress"}, "small"),
        ("quadrilateral", {"plane": "stress", "degree": 2}, "finite"),
        ("quadrilateral", {"plane": "generalized strain", "degree": 2}, "finite"),
    ],
)
def test_bar_in_series_with_a_bond(comm, cell, options, kinematics):
    """Loading, flow, debonding with elastic unloading, unloading and reloading: closed form."""
    scene = two_blocks(comm, cell, n=1)
    problem = joined(scene, BOND, (BAR, BAR), kinematics=kinematics, **options)
    facets = scene.facet_tags
    problem.dirichlet(facets.find(1), 0.0, "x")
    problem.dirichlet(facets.find(2), lambda t: t, "x")
    for k, name in ((1, "y"), (2, "z"))[: scene.mesh.geometry.dim - 1]:
        problem.dirichlet(lambda x, k=k: np.isclose(x[k], 0.0), 0.0, name)
    found = []
    for load in LOADS:
        vmdg.solve(problem, [load], vmdg.SolveOptions(relative_tolerance=1e-12))
        found.append(-problem.reaction(facets.find(1))[0])
    expected = list(series(LOADS, kinematics == "small"))
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * SIGMA)


FAILING = vmdg.Debonding(strength=70.0, critical_gap=0.1, friction=0.3)


def pulled(comm, kinematics="finite", law=FAILING):
    """Two metals that flow while their bond fails, and the facets of the end that is pulled."""
    scene = two_blocks(comm, "quadrilateral", n=2, distortion=0.03)
    soft = vmdg.J2(E, NU, 50.0, hardening=300.0)
    problem = joined(scene, law, (METAL, soft), kinematics=kinematics, degree=2)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: (t, 0.3 * t))
    return problem, scene.facet_tags.find(2)


@KINEMATICS
def test_energies_balance(comm, kinematics):
    """Work of the loads, stored energy, plastic and damage work; with 8 steps, of which one passes
    the yield stress, 1e-4 at small and 3e-3 at finite strain are seen, with 40 steps 2e-4.
    """
    problem, _ = pulled(comm, kinematics)
    vmdg.solve(problem, np.linspace(0.0, 0.06, 9)[1:])
    energy = problem.energy()
    assert energy.plastic > 0.1 * energy.external
    assert abs(energy.imbalance) < 5e-3 * energy.external


@SEVERAL_RANKS
@KINEMATICS
@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Debonding(700.0, 0.1)], ids=["tie", "bond"])
def test_ranks(comm, kinematics, law):
    """The same forces, energies and plastic strains as on one rank.

    Of bodies whose bond holds: where it softens while bodies flow, rounding decides which attempts
    fail, and forces differ by what another sequence of steps changes, some 1e-3.
    """
    results = []
    for ranks in (comm, MPI.COMM_SELF):
        problem, end = pulled(ranks, kinematics, law)
        forces = []
        for load in np.linspace(0.0, 0.06, 7)[1:]:
            vmdg.solve(problem, [load], vmdg.SolveOptions(relative_tolerance=1e-11))
            forces.append(problem.reaction(end))
        state = problem.body_state(2)
        flown = ranks.allreduce(float(state.weights @ state.history["alpha"]))
        results.append((np.array(forces), [flown, problem.energy().plastic]))
    (one, values), (other, expected) = results
    assert np.abs(one - other).max() < 1e-9 * np.abs(other).max()
    assert values == pytest.approx(expected, rel=1e-9)


def test_refused(comm):
    """What materials at points do not do is said at the door, with the remedy."""
    scene = two_blocks(comm, "quadrilateral")
    kinematic = vmdg.J2(E, NU, SIGMA, kinematic=10.0)
    for materials, options, words in (
        ((METAL, METAL), {"interface": {"traction_jump": True}}, "traction_jump"),
        ((METAL, kinematic), {}, "defined for kinematics='small'"),
    ):
        with pytest.raises(ValueError, match=words):
            joined(scene, BOND, materials, degree=2, **options)
    warned = pytest.warns(vmdg.ModelWarning, match="degree=2")
    with warned if comm.rank == 0 else nullcontext():
        problem = joined(scene, BOND, (METAL, ELASTIC))
    with pytest.raises(ValueError, match="tag 2 has no values at points"):
        problem.body_state(2)


def test_material_of_a_user(comm):
    """That of the reference page: a sheared block relaxes as backward Euler says."""
    page = (Path(vmdg.__file__).parent / "GUIDE.md").read_text()
    (block,) = re.findall(r"```python\n(class Maxwell.*?)```", page, re.DOTALL)
    scope = {"np": np, "vmdg": vmdg}
    exec(block, scope)
    relaxation, dt = 2.0, 0.5
    material = scope["Maxwell"](E, NU, relaxation)
    scene = two_blocks(comm, "quadrilateral", n=2)
    problem = joined(scene, vmdg.Bonded(), (material, material), kinematics="small", degree=2)
    everything = lambda x: np.full(x.shape[1], True)  # noqa: E731
    problem.dirichlet(everything, lambda x, t: np.stack([0.01 * min(t, dt) / dt * x[1], 0 * x[0]]))
    G = E / (2 * (1 + NU))
    for step in range(1, 5):
        vmdg.solve(problem, [step * dt], vmdg.SolveOptions(duration=1.0))
        stress = problem.body_state(1).stress[:, 0, 1]
        assert stress == pytest.approx(G * 0.01 / (1 + dt / relaxation) ** step, rel=1e-9)
    assert problem.energy().plastic > 0.0


class Wrong(vmdg.PointMaterial):
    """Answers with moduli of another shape."""

    def __call__(self, deformation, state, dt, small):
        answer = METAL(deformation, np.zeros((len(deformation), 7)), dt, small)
        return answer._replace(state=state, moduli=answer.moduli.reshape(-1, 9, 9))


class Mistaken(vmdg.PointMaterial):
    """A metal that changes, from a stretch of 1.004 on, what ``mistake`` makes of its answer."""

    fields = METAL.fields

    def __init__(self, mistake):
        super().__init__(vmdg.NeoHookean(E=E, nu=NU))
        self.mistake = mistake

    def __call__(self, deformation, state, dt, small):
        answer = METAL(deformation, state, dt, small)
        late = deformation[:, 0, 0] > (0.004 if small else 1.004)
        return self.mistake(answer, late, deformation, state)


def _lost(name):
    """A mistake: NaN in one of the arrays."""

    def mistake(answer, late, *_):
        array = getattr(answer, name).copy()
        array[late] = np.nan
        return answer._replace(**{name: array})

    return mistake


def _overwrites(answer, late, deformation, state):
    state[:], deformation[:] = answer.state, 7.0
    return answer


def _end_forces(comm, material, kinematics):
    scene = two_blocks(comm, "quadrilateral")
    problem = joined(scene, vmdg.Bonded(), (material, material), kinematics=kinematics, degree=2)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: (0.03 * t, 0.0))
    return problem, lambda p: {"F": p.reaction(scene.facet_tags.find(2))[0]}


@KINEMATICS
def test_answers_that_are_not_finite(comm, kinematics):
    """A history or an energy of NaN is an error that names material and point, and leaves the last
    row; a stress of NaN a failed attempt that names the material."""
    loads = [0.1, 0.2, 1.0]
    for name in ("state", "stored", "dissipated"):
        problem, look = _end_forces(comm, Mistaken(_lost(name)), kinematics)
        at = []
        with pytest.raises(ValueError, match=rf"Mistaken \(tag [12]\): {name} is \[?nan.* at the"):
            vmdg.solve(problem, loads, monitor=lambda p, at=at: at.append(p.t))
        assert problem.t == at[-1] < 1.0
        assert np.isfinite(problem.step.assemble_residual()).all()
    for name in ("stress", "moduli"):
        problem, look = _end_forces(comm, Mistaken(_lost(name)), kinematics)
        options = vmdg.SolveOptions(max_cuts=1)
        with pytest.raises(vmdg.StepFailure, match=r"MATERIAL_NOT_FINITE Mistaken \(tag"):
            vmdg.solve(problem, loads, options, look)


def test_a_material_that_writes_into_its_arguments(comm):
    """It has copies: the run is that of one that does not."""
    runs = [
        vmdg.solve(problem, [0.5, 1.0], monitor=look).history["F"]
        for problem, look in (
            _end_forces(comm, material, "finite")
            for material in (Mistaken(lambda answer, *_: answer), Mistaken(_overwrites))
        )
    ]
    assert np.array_equal(*runs)


def test_wrong_answers(comm):
    """Of a user's material: an error that names it, on every rank; an iteration that diverges
    asks it nothing.
    """
    scene = two_blocks(comm, "quadrilateral")
    with pytest.raises(ValueError, match="Wrong: moduli of"):
        joined(scene, vmdg.Bonded(), (Wrong(vmdg.NeoHookean(E=E, nu=NU)),) * 2, degree=2)
    problem, _ = pulled(comm)
    problem.step.begin(1.0, 1.0)
    problem.u.x.array[:] = np.nan
    assert np.isnan(problem.step.assemble_residual()).any()
    problem.step.cancel()
    assert np.isfinite(problem.step.assemble_residual()).all()


class Ends(vmdg.PointMaterial):
    """P_33 = -1 without a stiffness, as of a point that has softened."""

    def __init__(self):
        self.parameters = {"mu": 1.0, "lmbda": 1.0}

    def __call__(self, deformation, state, dt, small):
        assert np.isfinite(deformation).all()
        n = len(deformation)
        stress = np.tile(-np.eye(3), (n, 1, 1))
        return vmdg.Response(stress, np.zeros((n, 3, 3, 3, 3)), state, np.zeros(n), np.zeros(n))


@pytest.mark.parametrize("small", [False, True])
def test_thickness_that_nothing_bounds(small):
    """In plane stress: no answer, no warning of numpy, and no question at infinity."""
    evaluate = PointEvaluator(Ends(), 1.0, small, plane_stress=True)
    deformation = np.tile(np.eye(3) * (not small), (2, 1, 1))
    found, _ = evaluate(deformation, np.zeros((2, 0)), None)
    assert np.isnan(found.stress).all()
