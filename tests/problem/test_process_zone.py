"""Facets that are too long for the process zone of a crack."""

from __future__ import annotations

import warnings

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import meshtags
from support.scenes import box

import vmdg
from vmdg.base.parallel import global_max
from vmdg.checks.zone import EXCESS, layer
from vmdg.laws.base import separation
from vmdg.meshes import beams
from vmdg.meshes.beams import INTERFACE, LOWER_LEFT, RIGHT, UPPER_LEFT, plates

E, NU, P, G, T, CRACK = 70e3, 0.3, 60.0, 0.2, 1.5, 20.0
PLANE = E / (1 - NU**2)


def run(problem: vmdg.Problem, loads, **options) -> tuple[vmdg.Result, list[str]]:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = vmdg.solve(problem, loads, **options)
    return result, [str(one.message) for one in caught if "process zone" in str(one.message)]


def beam(
    comm: MPI.Comm, facets: int, degree: int, unit: float = 1.0, stress: float = 1.0, **options
) -> vmdg.Problem:
    """Two arms, opened by the load factor [mm]; lengths in another unit, and stresses."""
    stations = (0.0, CRACK, CRACK + 30.0)
    mesh, cells, sides = beams(
        comm, stations=stations, divisions=(8, facets), height=T, precrack=CRACK
    )
    mesh.geometry.x[:] *= unit
    steel = vmdg.NeoHookean(E=E * stress, nu=NU)
    law = vmdg.Debonding(P * stress, 2 * G / P * unit)
    bond = vmdg.Interface(facets=sides.find("interface"), law=law, name="bond", **options)
    arms = dict.fromkeys(("lower arm", "upper arm"), steel)
    problem = vmdg.Problem(mesh, cells, arms, [bond], degree=degree, kinematics="small")
    problem.dirichlet(sides.find("right"), 0.0)
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * T * unit: np.isclose(x[0], 0) & np.isclose(x[1], y),
            lambda t, side=side: side * t * unit,
            "y",
        )
    return problem


def force(problem: vmdg.Problem) -> dict[str, float]:
    top = problem.mesh.comm.allreduce(problem.mesh.geometry.x[:, 1].max(), MPI.MAX)
    return {
        "force [N]": problem.reaction_points(lambda x: np.isclose(x[0], 0) & np.isclose(x[1], top))[
            1
        ]
    }


LENGTH = (PLANE * T**3 * G / (12 * P**2)) ** 0.25  # both arms bend: 2 (G/P) each


@pytest.mark.parametrize("layered", [False, True])
def test_layer_thinner_than_its_zone(comm, layered):
    """Nothing is told of a soft layer between stiff plates, which decide; of soft plates it is."""
    stations = (0.0, CRACK, CRACK + 30.0)
    mesh, _, sides = beams(
        comm, stations=stations, divisions=(8, 12), height=T, rows=2, precrack=CRACK
    )
    map_ = mesh.topology.index_map(2)
    cells = np.arange(map_.size_local + map_.num_ghosts, dtype=np.int32)
    height = mesh.geometry.x[mesh.geometry.dofmap, 1].mean(axis=1)
    tags = meshtags(mesh, 2, cells, (np.abs(height) > T / 2).astype(np.int32))
    soft = vmdg.NeoHookean(E=2000.0, nu=NU)
    outer = vmdg.NeoHookean(E=E, nu=NU) if layered else vmdg.NeoHookean(E=2000.0, nu=NU)
    law = vmdg.Debonding(10.0, 2 * G / 10.0)
    bond = vmdg.Interface(facets=sides.find("interface"), law=law)
    problem = vmdg.Problem(mesh, tags, {0: soft, 1: outer}, [bond], kinematics="small")
    problem.dirichlet(sides.find("right"), 0.0)
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * T: np.isclose(x[0], 0) & np.isclose(x[1], y),
            lambda t, side=side: side * t,
            "y",
        )
    told = run(problem, [2.0 if layered else 8.0])[1]
    assert global_max(comm, problem.state[0].damage.max(initial=0.0)) > 0
    assert len(told) == (comm.rank == 0 and not layered)


def test_wide_facets_of_a_straight_front(comm):
    """What counts is their size along the way of the crack, not that along its front."""
    x = [0.0, 5.0, 10.0, 15.0, *np.arange(18.0, 26.0, 0.5), 30.0, 40.0]
    mesh, cells, facets = plates(comm, x, (0, 4.0), T, precrack=CRACK)
    law = vmdg.Debonding(P, 2 * G / P)
    bond = vmdg.Interface(facets=facets.find(INTERFACE), law=law)
    arms = dict.fromkeys((1, 2), vmdg.NeoHookean(E=E, nu=NU))
    problem = vmdg.Problem(mesh, cells, arms, [bond], kinematics="small", degree=2)
    problem.dirichlet(facets.find(LOWER_LEFT), lambda t: -t, "z")
    problem.dirichlet(facets.find(UPPER_LEFT), lambda t: t, "z")
    problem.dirichlet(facets.find(RIGHT), 0.0)
    told = run(problem, [0.65])[1]
    assert global_max(comm, problem.state[0].damage.max(initial=0.0)) > 0
    assert not told


@pytest.mark.parametrize(("degree", "facets"), [(1, 20), (2, 12)])
def test_zone_of_a_beam(comm, degree, facets):
    """The length of the zone, the facets and the strength that would do, and no word with them,
    nor before the crack is loaded; in any unit, and once."""
    loads, size = [0.65], 30 / facets
    y = 3 * size / ((degree + 1) * LENGTH)
    problem = beam(comm, facets, degree)
    assert not run(problem, [0.02])[1]
    found = [run(problem, loads)[1], run(problem, [0.7])[1]]
    scaled = run(beam(comm, facets, degree, unit=2.0**-10, stress=2.0**6), loads)[1]
    assert [len(one) for one in (*found, scaled)] == [comm.rank == 0, 0, comm.rank == 0]
    if comm.rank == 0:
        words = found[0][0]
        assert f"{size:.3g} mm, too long for its process zone, {LENGTH:.3g} mm next to" in words
        assert f"about {100 * EXCESS * y**2:.0f} % too high" in words
        assert f"facets of about {(degree + 1) / 3 * LENGTH:.3g} mm" in words
        assert f"largest_strength={P / y**2:.3g})" in words
        assert f"largest_strength={64 * P / y**2:.3g})" in scaled[0]
    enough = int(np.ceil(30 / ((degree + 1) / 3 * LENGTH)))
    assert not run(beam(comm, enough, degree), loads)[1]


def test_strength_that_facets_can_carry(comm):
    """With it the peak is met that the given strength misses by 40 %, without a word."""
    loads, need = np.linspace(0.1, 1.5, 15), 1.5 * 30 / 14
    small = vmdg.SolveOptions(max_share=0.02)
    options = {"options": small, "monitor": force, "until": lambda p: p.debonded() > 0.2}
    fine, _ = run(beam(comm, 40, 2), loads, **options)
    coarse, _ = run(beam(comm, 14, 1), loads, **options)
    carried = P * (LENGTH / need) ** 2
    lower, told = run(beam(comm, 14, 1, largest_strength=carried), loads, **options)
    peaks = [one.history["force"].max() for one in (fine, coarse, lower)]
    assert peaks[1] > 1.5 * peaks[0]
    assert peaks[2] == pytest.approx(peaks[0], rel=0.2)
    assert not told


@pytest.mark.parametrize(
    "law",
    [
        vmdg.Debonding(60.0, 0.01),
        vmdg.ExponentialDebonding(60.0, 0.3),
        vmdg.TrapezoidalDebonding(60.0, 0.002, 0.01),
        vmdg.IntrinsicExponential(60.0, 0.3),
        vmdg.MixedModeDebonding(60.0, 80.0, 0.3, 0.5, criterion="BK", exponent=2.0),
        vmdg.Debonding(strength=np.array([60.0, 10.0]), critical_gap=0.01),
    ],
)
def test_weaker_law_of_the_same_energy(law):
    """Of at most 20 MPa in opening, with the energies and the ratio of the strengths as before."""
    weak = law.weakened(20.0)
    for axis in (0, 1):
        (before, energy), (after, same) = (separation(one, 2, axis) for one in (law, weak))
        np.testing.assert_allclose(same, energy, rtol=1e-6)
        np.testing.assert_allclose(after, before * np.minimum(20.0 / law.strength, 1.0), rtol=1e-12)


def test_film_on_a_base(comm):
    """A film that shrinks slides: (2 E' t G_c)^1/2/P_c with its own thickness t."""
    mesh, _ = box(comm, [(0, 0), (5, 7)], (5, 7))
    y, t = mesh.geometry.x[:, 1], 0.01
    mesh.geometry.x[:, 1] = np.where(y < 6.5, y / 6, 1 + t)
    tags = vmdg.split_cells(mesh, lambda x: 1 - x[1], "film")
    base, film = vmdg.NeoHookean(E=E, nu=NU), vmdg.NeoHookean(E=200e3, nu=0.25)
    problem = vmdg.Problem(
        mesh,
        tags,
        {"outside": base, "film": film},
        [vmdg.Interface(between=("film", "outside"), law=vmdg.Debonding(60.0, 1e-3))],
        degree=2,
        kinematics="small",
        eigenstrain={"film": lambda s: -6e-3 * s},
    )
    problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0, "x")
    problem.dirichlet(lambda x: np.isclose(x[1], 0), 0.0, "y")
    told = run(problem, [0.5, 1.0])[1]
    assert len(told) == (comm.rank == 0)
    if told:
        assert "facets of 1 mm" in told[0]
        assert "next to a part of t = 0.01 mm" in told[0]


def test_stiffness_of_layers_and_large_bodies():
    """H(0) and the mean of H of an orthotropic body: E_x of a plate with free faces, and the
    modulus of Sih, Paris and Irwin (1965, International Journal of Fracture Mechanics 1, 189),
    1/E' = ((b11 b22/2) ((b22/b11)^1/2 + (2 b12 + b66)/(2 b11)))^1/2 of a crack along axis 1."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        c11, c22, c66 = rng.uniform(1.0, 20.0, 3)
        c12 = rng.uniform(-0.5, 0.9) * np.sqrt(c11 * c22)
        A = np.zeros((2, 2, 2, 2))
        A[0, 0, 0, 0], A[1, 1, 1, 1] = c11, c22
        A[0, 0, 1, 1] = A[1, 1, 0, 0] = c12
        A[0, 1, 0, 1] = A[1, 0, 1, 0] = A[0, 1, 1, 0] = A[1, 0, 0, 1] = c66
        b11, b12, _, b22 = np.linalg.inv([[c11, c12], [c12, c22]]).ravel()
        b66 = 1 / c66
        turn = rng.uniform(0, np.pi)
        R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        A = np.einsum("ia,jb,kc,ld,abcd->ijkl", R, R, R, R, A)[None, None]
        x, N = R[:, :1].T, R[:, 1:].T
        layers = [layer(A, N, x, a)[0, 0] for a in np.arange(400) * np.pi / 400]
        inverse = np.linalg.inv(np.mean(layers, axis=0))
        common = np.sqrt(b22 / b11) + (2 * b12 + b66) / (2 * b11)
        opening = np.sqrt(b11 * b22 / 2 * common)
        shear = np.sqrt(b11**2 / 2 * common)
        assert x[0] @ layers[0] @ x[0] == pytest.approx(1 / b11)
        assert N[0] @ inverse @ N[0] / 2 == pytest.approx(opening)
        assert x[0] @ inverse @ x[0] / 2 == pytest.approx(shear)
