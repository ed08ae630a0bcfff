"""Periodic cells in time: free waves of laminates, bonds that fail at a rate, limits, ranks."""

from __future__ import annotations

import re

from mpi4py import MPI

import numpy as np
import pytest
from scipy.optimize import brentq
from support.scenes import SEVERAL_RANKS, box

import vmdg

ENERGY = vmdg.SolveOptions(energy=True)
EVERY_SCHEME = pytest.mark.parametrize(
    "scheme", [vmdg.GeneralizedAlpha(1.0), vmdg.CentralDifferences()], ids=str
)
#: Layer 1 from y = 0 to a/2 and from L - a/2 to L = 1, layer 2 between: modulus (nu = 0), density.
A, LAYERS = 0.4, {1: (1.0, 1.0), 2: (3.0, 0.5)}
C = {tag: np.sqrt(E / rho) for tag, (E, rho) in LAYERS.items()}
Z = {tag: np.sqrt(E * rho) for tag, (E, rho) in LAYERS.items()}


def cell(comm, n, tag_of, interfaces, periodic, materials=LAYERS, nu=0.0, **options):
    """A cell of n squares over a height of 1, with tags by the height of their midpoints."""
    ends = [[0.0, 0.0], [2.0 / n, 1.0]]
    mesh, tags = box(comm, ends, [2, n], lambda x: tag_of(x[1]))
    return vmdg.Problem(
        mesh,
        tags,
        {tag: vmdg.NeoHookean(E=E, nu=nu) for tag, (E, _) in materials.items()},
        interfaces,
        **{"kinematics": "small"} | options,
        density={tag: rho for tag, (_, rho) in materials.items()},
        periodic=periodic,
    )


def laminate(comm, n, periodic, **options):
    """The layers, tied."""

    def tag_of(y):
        return np.where(abs(y - 0.5) < (1 - A) / 2, 2, 1)

    ties = [vmdg.Interface(between=(1, 2), law=vmdg.Bonded())]
    return cell(comm, n, tag_of, ties, periodic, **options)


def free_wave(even):
    """Frequency and shape of a wave that has the period of the laminate.

    Displacements sin or cos of omega y/c from the middle of each layer, with one displacement and
    one traction at the interfaces.
    """
    first, second = A / (2 * C[1]), (1 - A) / (2 * C[2])
    power = 1 if even else -1

    def match(omega):
        # The equation of both tangents, times both cosines.
        s, t = np.sin(omega * first), np.sin(omega * second)
        c, d = np.cos(omega * first), np.cos(omega * second)
        return Z[1] ** power * s * d + Z[2] ** power * t * c

    omega = brentq(match, 3.0, 12.0)
    wave = np.cos if even else np.sin

    def shape(y):
        y = np.mod(y, 1.0)
        from_first, from_second = np.where(y < 0.5, y, y - 1.0), y - 0.5
        size = wave(omega * first) / wave(omega * second) * (1 if even else -1)
        low, high = wave(omega * from_first / C[1]), size * wave(omega * from_second / C[2])
        return np.where(abs(from_second) < (1 - A) / 2, high, low)

    return omega, shape


@pytest.mark.parametrize(
    ("scheme", "even"), [(vmdg.GeneralizedAlpha(1.0), True), (vmdg.CentralDifferences(), False)]
)
def test_free_wave(comm, scheme, even):
    """A free wave of a laminate has the closed form of its frequency, and keeps momentum; in the
    even one no node is at rest."""
    omega, shape = free_wave(even)
    problem = laminate(comm, 100, vmdg.Periodic(strain=[[0.0, 0.0], [0.0, 0.0]]))
    owned = problem.discretization.owned

    def monitor(problem):
        motion = problem.step.motion
        v = problem.velocity.x.array[:owned]
        P = motion.of(v) if motion.lumped is None else motion.lumped * v
        return {"P": comm.allreduce(P[1::2].sum()), "amplitude": comm.allreduce(P @ start)}

    velocity = lambda x: np.array([0 * x[0], shape(x[1])])  # noqa: E731
    start = np.ravel(velocity(problem.space.tabulate_dof_coordinates().T).T)[:owned]
    start[problem.discretization.means.owned_rows] = 0.0
    times = np.linspace(0.0, 2 * np.pi / omega, 401)[1:]
    history = vmdg.solve_dynamics(problem, times, scheme, velocity, monitor, ENERGY).history
    size = history["amplitude"][-1]
    expected = np.cos(omega * times)
    assert history["amplitude"] / size == pytest.approx(expected, abs=5e-3)
    assert np.abs(history["P"]).max() < 1e-3 * size
    assert np.ptp(history["P"]) < 1e-9 * size
    assert np.abs(history["imbalance"]).max() < 1e-3 * history["external"][0]


def included(comm, periodic, shift=(0, 0), tiles=1, n=8):
    """Square inclusions that debond, in cells of n x n, shifted by numbers of cells, tiled."""
    ends = [[0.0, 0.0], [float(tiles), float(tiles)]]

    def tag_of(x):
        X = np.mod(np.floor(n * x[:2] + 1e-9).T - np.array(shift), n)
        return np.where(((n / 4 <= X) & (3 * n / 4 > X)).all(axis=1), 2, 1)

    mesh, tags = box(comm, ends, [n * tiles] * 2, tag_of)
    law = vmdg.Debonding(strength=5.0, critical_gap=0.004, friction=0.4)
    return vmdg.Problem(
        mesh,
        tags,
        {1: vmdg.NeoHookean(E=1000.0, nu=0.3), 2: vmdg.NeoHookean(E=5000.0, nu=0.2)},
        [vmdg.Interface(between=(1, 2), law=law, name="bond")],
        density={1: 1.0, 2: 3.0},
        periodic=periodic,
    )


#: A mean deformation that grows ever faster, along x; along y it is given, or the stress is zero.
FASTER = {"xx": lambda t: 1 + 2.0 * t**2, "xy": lambda t: t**2}
DRIVES = [
    (vmdg.GeneralizedAlpha(), vmdg.Periodic(gradient=FASTER)),
    (vmdg.CentralDifferences(), vmdg.Periodic(gradient=FASTER | {"yx": 0.0, "yy": 1.0})),
]
COLUMNS = ("stress_xx", "stress_yy", "gradient_yy")


def curve(comm, scheme, drive, **options):
    """Means, and energies of a cell, while the bond fails."""
    problem = included(comm, drive, **options)
    times, row = np.linspace(0.0, 0.1, 41)[1:], lambda p: vmdg.PeriodicCell(p).row()
    history = vmdg.solve_dynamics(problem, times, scheme, None, row, ENERGY).history
    assert 0.2 < problem.debonded("bond")
    tiles = options.get("tiles", 1) ** 2
    energies = [history[name] / tiles for name in ("kinetic", "damage", "external")]
    assert np.abs(history["imbalance"]).max() < 1e-3 * history["external"].max()
    return np.array([history[name] for name in COLUMNS] + energies)


@pytest.mark.parametrize(
    ("scheme", "drive"),
    [pytest.param(*DRIVES[0], marks=pytest.mark.long), DRIVES[1]],
    ids=["implicit", "explicit"],
)
def test_shifted_and_tiled_cells(comm, scheme, drive):
    """Where the cell begins, how many are taken and on how many ranks does not matter."""
    expected = curve(comm, scheme, drive)
    for options in ({"shift": (-3, 5)}, {"shift": (3, 0), "tiles": 2}):
        found = curve(comm, scheme, drive, **options)
        assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@SEVERAL_RANKS
@pytest.mark.parametrize(("scheme", "drive"), DRIVES, ids=["implicit", "explicit"])
def test_ranks(comm, scheme, drive):
    """Any number of ranks finds the same motion."""
    found = [curve(ranks, scheme, drive) for ranks in (comm, MPI.COMM_SELF)]
    assert found[0] == pytest.approx(found[1], rel=1e-9, abs=1e-9)


@EVERY_SCHEME
def test_generalized_plane_strain(comm, scheme):
    """With F_33 given as 1 a section moves as in plane strain; one that is free leaves no force."""
    found = []
    for plane in ("strain", vmdg.GeneralizedStrain(0.0), vmdg.GeneralizedStrain()):
        if plane == vmdg.GeneralizedStrain() and isinstance(scheme, vmdg.CentralDifferences):
            continue
        problem = laminate(comm, 10, None, nu=0.3, plane=plane)
        velocity = lambda x: np.array([0 * x[0], 0.1 * x[1]])  # noqa: E731
        vmdg.solve_dynamics(problem, [0.1, 0.2, 0.3], scheme, velocity)
        found.append(problem.energy().kinetic)
    assert found[0] > 1e-4 and found[1] == pytest.approx(found[0], rel=1e-9)
    if len(found) > 2:
        axial, energy = vmdg.AxialMotion(problem), problem.energy()
        assert abs(axial.force) < 1e-9 and abs(axial.strain) > 1e-4
        assert abs(energy.imbalance) < 1e-9 * energy.external


@pytest.mark.parametrize(
    ("periodic", "options", "words"),
    [
        ({"strain": {"yy": 0.1}}, {}, "prescribe all components of"),
        ({"strain": np.eye(2)}, {"damping": vmdg.Rayleigh(beta=1.0)}, "neither in periodic cells"),
    ],
)
def test_refused(comm, periodic, options, words):
    """What has no motion."""
    with pytest.raises(ValueError, match=re.escape(words)):
        problem = laminate(comm, 4, vmdg.Periodic(**periodic), **options)
        vmdg.solve_dynamics(problem, [1.0], vmdg.CentralDifferences())
