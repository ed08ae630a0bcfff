"""Periodic cells: laminates in closed form, cells shifted and tiled, means, mistakes."""

from __future__ import annotations

import re
import warnings
from contextlib import nullcontext
from itertools import product

from mpi4py import MPI

import numpy as np
import pytest
from numpy.typing import NDArray
from support.problems import PRECISE
from support.scenes import CELLS_BY_TURNS, DIMENSION, box

import vmdg
from vmdg.checks.model import check_model
from vmdg.checks.supports import loose_parts

MODULI = {1: (1000.0, 0.3), 2: (5000.0, 0.2), 3: (300.0, 0.4)}
#: Tags of layers of equal height from the bottom; the first and the last one are two halves.
LAYERS = {2: (1, 2, 2, 1), 3: (1, 2, 3, 1)}
BOND = vmdg.Debonding(strength=2.0, critical_gap=0.01)
SMALL, FINITE = "small", "finite"
means = vmdg.PeriodicCell


def materials(tags):
    """Two of them are isotropic in one way, three in another."""
    return {tag: vmdg.NeoHookean(E=MODULI[tag][0], nu=MODULI[tag][1]) for tag in set(tags)}


def tagged(comm, cell, divisions, tag_of, size=1.0, corner=0.0):
    """Cell [0, size]^d from a corner, with tags by midpoints from there."""
    d = DIMENSION[cell]
    ends = [np.full(d, corner), np.full(d, corner + size)]
    return box(comm, ends, divisions, lambda x: tag_of(x - corner), cell)


def laminate(comm, cell, layers, degree=1, fails=False, bond=BOND, **options):
    """Layers across y, of which the lowest bond may fail; one cell in other directions."""
    tags, d = np.array(LAYERS[layers]), DIMENSION[cell]
    divisions = [1, len(tags), 1][:d]
    mesh, cells = tagged(
        comm, cell, divisions, lambda x: tags[np.floor(x[1] * len(tags)).astype(int)]
    )
    lowest = [vmdg.Interface(lambda x: np.isclose(x[1], 1 / len(tags)), law=bond, name="bond")]
    others = [
        vmdg.Interface(lambda x, y=y: np.isclose(x[1], y), law=vmdg.Bonded())
        for y in (np.flatnonzero(np.diff(tags)) + 1) / len(tags)
    ]
    interfaces = lowest + others[1:] if fails else others
    return vmdg.Problem(mesh, cells, materials(tags), interfaces, degree, SMALL, **options)


def stiffness(tag) -> NDArray:
    E, nu = MODULI[tag]
    mu, one = E / (2 * (1 + nu)), np.eye(3)
    lmbda = E * nu / ((1 + nu) * (1 - 2 * nu))
    shear = np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)
    return lmbda * np.einsum("ij,kl->ijkl", one, one) + mu * shear


def laminate_stress(layers, strain: NDArray, fails: bool) -> NDArray:
    """Mean stress (3, 3) of a laminate across y under a mean strain of one component.

    Of a layer the strain is E + sym(a (x) n), with one traction t = C:(E + sym(a (x) n)).n of all
    and a mean of a that is -zeta, zeta the gap of the bond that fails, over a height of 1.
    """
    tags = LAYERS[layers]
    C = np.array([stiffness(tag) for tag in tags])
    Q = C[:, :, 1, :, 1]
    held = np.einsum("tijkl,kl->tij", C, strain)[:, :, 1]
    flexibility = np.linalg.inv(Q)
    K = np.linalg.inv(flexibility.mean(axis=0))
    bonded = K @ np.einsum("tij,tj->i", flexibility, held) / len(tags)
    t, size = bonded, np.linalg.norm(bonded)
    if fails and size > BOND.strength:
        along = bonded / size
        k = along @ K @ along
        gap = (size - BOND.strength) / (k - BOND.softening_modulus)
        t = bonded - min(max(gap, 0.0), size / k) * K @ along
        if gap * BOND.softening_modulus >= BOND.strength:
            t = 0 * bonded
    a = np.einsum("tij,tj->ti", flexibility, t - held)
    tilt = np.zeros((len(tags), 3, 3))
    tilt[:, :, 1] = a
    layers_strain = strain + (tilt + tilt.transpose(0, 2, 1)) / 2
    return np.einsum("tijkl,tkl->ij", C, layers_strain) / len(tags)


def loadings(d):
    """Unit strains of one component, 3 in 2D and 6 in 3D."""
    for i, j in product(range(d), repeat=2):
        if i <= j:
            strain = np.zeros((3, 3))
            strain[i, j] = strain[j, i] = 1.0
            yield strain


@CELLS_BY_TURNS
def test_bonded_laminate(comm, cell, degree):
    """The mean stress is that of the closed form in all loadings, one after the other."""
    d, layers = DIMENSION[cell], degree + 1
    units = [np.zeros((3, 3)), *loadings(d)]

    def strain(t):
        return 0.01 * (units[int(t)] if t == int(t) else (units[int(t)] + units[int(t) + 1]) / 2)

    drive = vmdg.Periodic(strain=lambda t: strain(t)[:d, :d])
    problem = laminate(comm, cell, layers, degree, periodic=drive)

    def compare(problem):
        expected = laminate_stress(layers, strain(problem.t), fails=False)[:d, :d]
        assert means(problem).strain == pytest.approx(strain(problem.t)[:d, :d], abs=1e-15)
        assert means(problem).stress == pytest.approx(expected, rel=1e-10, abs=1e-9)

    vmdg.solve(problem, np.arange(1.0, len(units)), PRECISE, compare)


def test_cell_that_leans(comm):
    """A cell that is no box: the same laminate, cut along other planes."""
    tags, strain = np.array(LAYERS[2]), 0.01 * np.array([[1.0, 2.0], [2.0, 3.0]])
    mesh, cells = tagged(comm, "triangle", (2, 4), lambda x: tags[np.floor(4 * x[1]).astype(int)])
    mesh.geometry.x[:, 0] += 0.3 * mesh.geometry.x[:, 1]
    bonds = [vmdg.Interface(between=(1, 2), law=vmdg.Bonded())]
    drive = vmdg.Periodic(strain=strain, vectors=[[1.0, 0.0], [0.3, 1.0]])
    problem = vmdg.Problem(mesh, cells, materials(tags), bonds, kinematics=SMALL, periodic=drive)
    vmdg.solve(problem, [1.0], PRECISE)
    full = np.zeros((3, 3))
    full[:2, :2] = strain
    expected = laminate_stress(2, full, fails=False)[:2, :2]
    assert means(problem).stress == pytest.approx(expected, rel=1e-10)


@pytest.mark.parametrize(("cell", "layers"), [("quadrilateral", 3), ("hexahedron", 2)])
def test_laminate_that_fails(comm, cell, layers):
    """Before, while and after a bond breaks, in all loadings; shear along x and z spares it."""
    d, broken, unit = DIMENSION[cell], 0, np.zeros((3, 3))
    drive = vmdg.Periodic(strain=lambda t: t * unit[:d, :d])
    problem = laminate(comm, cell, layers, fails=True, periodic=drive)
    whole = problem.step.snapshot()

    def compare(problem):
        expected = laminate_stress(layers, problem.t * unit, fails=True)[:d, :d]
        assert means(problem).stress == pytest.approx(expected, rel=1e-10, abs=1e-9)

    for loading in loadings(d):
        problem.step.return_to(whole)
        unit[:] = loading
        vmdg.solve(problem, [0.0005, 0.003, 0.03], PRECISE, compare)
        broken += problem.debonded() == 1.0
    assert broken == {2: 3, 3: 5}[d]


def included(comm, periodic, shift=(0, 0), tiles=1, kinematics=SMALL, n=8, activate="all"):
    """Square inclusions in cells of n x n, shifted by numbers of cells, in tiles x tiles."""

    def tag_of(x):
        X = np.mod(np.floor(n * x[:2] + 1e-9).T - np.array(shift), n)
        return np.where(((X >= n / 4) & (X < 3 * n / 4)).all(axis=1), 2, 1)

    mesh, tags = tagged(comm, "quadrilateral", (n * tiles,) * 2, tag_of, float(tiles))
    law = vmdg.Debonding(strength=5.0, critical_gap=0.004, friction=0.4)
    bond = vmdg.Interface(between=(1, 2), law=law, name="bond", activate=activate)
    return vmdg.Problem(mesh, tags, materials((1, 2)), [bond], 1, kinematics, periodic=periodic)


#: Of a mean strain that opens the bond on two sides, and then closes it and shears it.
CYCLE = np.array([np.diag([0.01, 0.0]), [[-0.004, 0.003], [0.003, -0.003]]])
STRAIN = vmdg.Periodic(strain=lambda t: min(t, 1) * CYCLE[0] + max(t - 1, 0) * CYCLE[1])
GRADIENT = vmdg.Periodic(
    gradient=lambda t: np.eye(2) + min(t, 1) * CYCLE[0] + max(t - 1, 0) * CYCLE[1]
)
CYCLES = np.linspace(0.125, 2.0, 16)
COMPONENTS = ("xx", "xy", "yy")


def curve(problem, loads=CYCLES):
    """Mean stresses of all rows; the condition of Hill and Mandel holds in each."""
    history = vmdg.solve(problem, loads, PRECISE).history
    assert np.abs(history["hill_mandel"]).max() < 1e-10
    met = np.isin(history["load"], loads)
    return np.array([history[f"stress_{c}"][met] for c in COMPONENTS])


@pytest.mark.parametrize("kinematics", [SMALL, FINITE])
def test_shifted_and_tiled_cells(comm, kinematics):
    """Where the cell begins, and how many are taken, does not matter: bonds open, close, rub."""
    drive = STRAIN if kinematics == SMALL else GRADIENT
    first = included(comm, drive, kinematics=kinematics)
    expected = curve(first)
    friction = first.energy().friction
    assert first.debonded() >= 0.5 and friction > 0
    # Inclusions at all corners, across one face of a cell of four.
    for options in ({"shift": (-3, 5)}, {"shift": (3, 0), "tiles": 2}):
        other = included(comm, drive, kinematics=kinematics, **options)
        assert curve(other) == pytest.approx(expected, rel=1e-8, abs=1e-8)
    assert other.energy().friction == pytest.approx(4 * friction, rel=1e-8)
    alone = included(MPI.COMM_SELF, drive, kinematics=kinematics)
    assert curve(alone) == pytest.approx(expected, rel=1e-8, abs=1e-8)


@pytest.mark.parametrize("kinematics", [SMALL, FINITE])
def test_stress_leads_to_the_same_state(comm, kinematics):
    """The mean stress of a given strain, given instead, leads back to that strain."""
    drive = STRAIN if kinematics == SMALL else GRADIENT
    led = included(comm, drive, kinematics=kinematics)
    loads = [0.25, 0.5]
    history = vmdg.solve(led, loads, PRECISE).history
    assert led.energy().damage > 0
    stress = means(led).stress
    given = {
        name: lambda t, rows=(0.0, *history[f"stress_{name}"]): np.interp(t, [0.0, *loads], rows)
        for name in COMPONENTS
    }
    other = included(comm, vmdg.Periodic(stress=given), kinematics=kinematics)
    vmdg.solve(other, loads, PRECISE)
    assert means(other).stress == pytest.approx(stress, rel=1e-8, abs=1e-9)
    assert means(other).strain == pytest.approx(means(led).strain, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("kinematics", [SMALL, FINITE])
def test_tangent(comm, kinematics):
    """The macroscopic tangent of a step that breaks bonds and rubs is that of differences."""
    before, after, h = np.diag([0.015, 0.0]), np.array([[-0.006, 0.004], [0.004, 0.001]]), 1e-7
    precise = vmdg.SolveOptions(relative_tolerance=1e-13, control="load")
    change = np.zeros((2, 2))

    def mean(t):
        return before * t if t < 1 else (2 - t) * before + (t - 1) * (after + change)

    drive = {SMALL: {"strain": mean}, FINITE: {"gradient": lambda t: np.eye(2) + mean(t)}}
    problem = included(comm, vmdg.Periodic(**drive[kinematics]), kinematics=kinematics, n=4)
    vmdg.solve(problem, [1.0], precise)
    begin, spent = problem.step.snapshot(), problem.energy()
    vmdg.solve(problem, [2.0], precise)
    assert problem.energy().damage > spent.damage and problem.energy().friction > spent.friction
    found = vmdg.macroscopic_tangent(problem)
    for k, m in product(range(2), repeat=2):
        stresses = []
        for step in (-h, h):
            change[:] = 0.0
            change[k, m] = step
            if kinematics == SMALL:
                change[:] = (change + change.T) / 2
            problem.step.return_to(begin)
            vmdg.solve(problem, [2.0], precise)
            stresses.append(means(problem).stress)
        expected = (stresses[1] - stresses[0]) / (2 * h)
        assert found[:, :, k, m] == pytest.approx(expected, rel=1e-6, abs=1e-3)


def test_cell_that_comes_apart(comm):
    """Layers without bonds resist shear no more, which is neither known nor unstable then."""
    bond = vmdg.Debonding(strength=2.0, critical_gap=0.0005)
    drive = vmdg.Periodic(strain={"yy": lambda t: 0.01 * t})
    problem = laminate(comm, "quadrilateral", 2, fails=True, bond=bond, periodic=drive)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        vmdg.solve(problem, [0.5, 1.0])
    assert problem.debonded() == 1.0
    assert means(problem).stress == pytest.approx(np.zeros((2, 2)), abs=1e-9)
    assert means(problem).strain == pytest.approx(np.diag([0, 0.01]), abs=1e-12)


@pytest.mark.parametrize(("cell", "along"), [("quadrilateral", "xy"), ("tetrahedron", "xyz")])
def test_a_layer_cannot_turn(comm, cell, along):
    """It goes on beyond the cell, so that nothing but a translation is left to it; one is held."""
    drive = vmdg.Periodic(strain={"yy": lambda t: 0.01 * t})
    (loose,) = loose_parts(laminate(comm, cell, 2, periodic=drive), [])
    assert loose.tags == [2]
    assert loose.motions == ", ".join(f"translation along {axis}" for axis in along)


@pytest.mark.parametrize("measure", ["strain", "stress"])
def test_path_with_snap_back(comm, measure):
    """The factor of the mean strain, or of the mean stress, falls as the one bond breaks."""
    bond = vmdg.Debonding(strength=2.0, critical_gap=0.0005)
    drive = vmdg.Periodic(
        **{measure: {"yy": lambda t: {"strain": 0.01, "stress": 10.0}[measure] * t}}
    )
    problem = laminate(comm, "quadrilateral", 2, fails=True, bond=bond, periodic=drive)
    trace = vmdg.SolveOptions(relative_tolerance=1e-11, unstable="trace")
    history = vmdg.solve(
        problem, [1.0], trace, until=lambda problem: problem.debonded() > 0.9
    ).history
    t, strain = history["stress_yy"], history["strain_yy"]
    # Free to contract across, the laminate has the compliance of its first row.
    gap = np.clip(bond.strength - t, 0, None) / bond.softening_modulus
    holds = t > 1e-3
    assert strain[holds] == pytest.approx((t * strain[0] / t[0] + gap)[holds], rel=1e-7)
    assert history["traction_bond"] == pytest.approx(t, abs=1e-9)
    assert np.abs(history["hill_mandel"]).max() < 1e-10
    assert (np.diff(history["load"][holds]) < 0).sum() > 5


def test_facets_on_demand(comm):
    """Closed facets of a cell open in it, and the state goes on."""
    results = []
    for activate in ("all", "on-demand"):
        problem = included(comm, STRAIN, (3, 1), activate=activate)
        history = vmdg.solve(problem, CYCLES[:8], PRECISE).history
        assert np.abs(history["hill_mandel"]).max() < 1e-10
        results.append((problem.debonded(), history["stress_xx"][-1]))
    assert results[1] == pytest.approx(results[0], rel=0.02)


def test_checkpoint(comm, out):
    """A run goes on from a checkpoint, on another number of ranks too."""
    first = included(comm, GRADIENT, (3, 1), kinematics=FINITE)
    history = vmdg.solve(first, CYCLES[:3], PRECISE).history
    vmdg.write_checkpoint(first, out / "cell", history)
    vmdg.solve(first, CYCLES[3:5], PRECISE)
    for where in (comm, MPI.COMM_SELF)[: comm.size]:
        other = included(where, GRADIENT, (3, 1), kinematics=FINITE)
        vmdg.read_checkpoint(other, out / "cell")
        vmdg.solve(other, CYCLES[3:5], PRECISE)
        assert means(other).stress == pytest.approx(means(first).stress, rel=1e-8, abs=1e-9)
        assert means(other).gradient == pytest.approx(means(first).gradient, abs=1e-15)
    tall = included(comm, GRADIENT, (3, 1), kinematics=FINITE, tiles=2)
    with pytest.raises(ValueError, match="another problem"):
        vmdg.read_checkpoint(tall, out / "cell")


def test_displacement(comm):
    """The whole displacement jumps across the cell by the mean gradient."""
    problem = included(comm, STRAIN, (3, 1))
    vmdg.solve(problem, [0.5])
    u, d = means(problem).displacement(), 2
    x = u.function_space.tabulate_dof_coordinates()[:, :d]
    u = u.x.array.reshape(-1, d)
    corners = [np.isclose(x, corner).all(axis=1) for corner in ((0, 0), (1, 0), (0, 1))]
    found = [np.vstack(comm.allgather(u[corner])) for corner in corners]
    for i, ends in enumerate(found[1:]):
        across = ends[0] - found[0][0]
        assert across == pytest.approx((means(problem).gradient - np.eye(d))[:, i], abs=1e-14)


def shifted_nodes(mesh):
    """Nodes of one face that are not those of the opposite one."""
    x = mesh.geometry.x
    right = np.isclose(x[:, 0], 1.0)
    x[right, 1] = x[right, 1] ** 1.2


MISTAKES = {
    "give strain": {"gradient": np.eye(2)},
    "no component 'zz'": {"strain": {"zz": 1.0}},
    "xx is given in strain and in stress": {"strain": {"xx": 1.0}, "stress": {"xx": 0.0}},
    "not symmetric": {"strain": [[0, 1], [0, 0]]},
    "give strain=, stress= or both": {},
    "shape (3, 3)": {"strain": np.eye(3)},
    "0.5 times as long": {"strain": np.eye(2), "vectors": [[2, 0], [0, 1]]},
    "sides of the cell": {"strain": np.eye(2), "vectors": [[1, 0], [2, 0]]},
}


@pytest.mark.parametrize("words", MISTAKES)
def test_mistakes(comm, words):
    """What a cell cannot do is refused by name."""
    with pytest.raises(ValueError, match=re.escape(words)):
        laminate(comm, "triangle", 2, periodic=vmdg.Periodic(**MISTAKES[words]))


#: Interfaces inside a cell that have facets on its boundary, and what may help.
ON_BOUNDARY = [
    ({"facets": lambda x: np.isclose(x[0] % 0.5, 0)}, "exclude its boundary from facets="),
    ({"level_set": lambda x: x[0] - 0.5}, "inside of it by facets="),
]


@pytest.mark.parametrize(
    "gradient", [{"xx": lambda t: 0.01 * t}, lambda t: t * np.diag([0.01, 0.0])]
)
def test_a_strain_as_gradient(comm, gradient):
    """A cell that is pressed to nothing is warned of before it is solved; one that turns is not."""
    loads = np.array([0.5, 1.0])
    with (
        pytest.warns(vmdg.ModelWarning, match="1 without strain: use 1 \\+ 0.01 \\* t")
        if (comm.rank == 0)
        else nullcontext()
    ):
        check_model(included(comm, vmdg.Periodic(gradient=gradient), kinematics="finite"), loads)
    turned = vmdg.Periodic(gradient=lambda t: np.array([[0.0, -1.0], [1.0, 0.0]]) * (1 + 0.01 * t))
    check_model(included(comm, turned, kinematics="finite"), loads)


def test_more_mistakes(comm):
    """Meshes that do not match, interfaces on the boundary, supports, rotations, checkpoints."""
    mesh, tags = tagged(comm, "triangle", (2, 4), lambda x: 1 + 0 * x[0])
    shifted_nodes(mesh)
    one = {"materials": materials((1,)), "interfaces": []}
    with pytest.raises(ValueError, match=r"facet at \[0.0, 0.125\] has no image at \[1.0, 0.125"):
        vmdg.Problem(mesh, tags, **one, kinematics=SMALL, periodic=STRAIN)
    with pytest.raises(ValueError, match="would lie on the boundary of the cell"):
        included(comm, STRAIN, (2, 0))
    mesh, tags = tagged(comm, "triangle", (2, 2), lambda x: 1 + 0 * x[0])
    half = {"materials": materials((1,)), "kinematics": SMALL, "periodic": STRAIN}
    for place, words in ON_BOUNDARY:
        with pytest.raises(ValueError, match=rf"boundary of the cell at \[0.0, 0.25\].*{words}"):
            vmdg.Problem(mesh, tags, interfaces=[vmdg.Interface(**place, law=BOND)], **half)
        vmdg.Problem(mesh, tags, interfaces=[vmdg.Interface(**place, law=vmdg.Bonded())], **half)
    turns = vmdg.Periodic(stress={"xy": 1.0, "yx": 1.0})
    with pytest.raises(ValueError, match="rotation of the cell undetermined"):
        vmdg.Problem(mesh, tags, **one, periodic=turns)
    with pytest.raises(ValueError, match="cannot be combined with symmetry"):
        vmdg.Problem(mesh, tags, **one, symmetry="axisymmetric", periodic=GRADIENT)
    with pytest.raises(TypeError, match=r"must be vmdg\.Periodic"):
        vmdg.Problem(mesh, tags, **one, periodic=True)
    problem = vmdg.Problem(mesh, tags, **one, kinematics=SMALL, periodic=STRAIN)
    with pytest.raises(ValueError, match="has no supports and loads"):
        problem.dirichlet(lambda x: np.isclose(x[0], 0), 0.0)
    with pytest.raises(ValueError, match="a periodic cell has no supports"):
        problem.reaction(lambda x: np.isclose(x[0], 0))
    mesh, tags = tagged(comm, "triangle", (2, 2), lambda x: 1 + 0 * x[0])
    with pytest.raises(ValueError, match="a body with a surface"):
        means(vmdg.Problem(mesh, tags, **one))
