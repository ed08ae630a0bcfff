"""The state on another mesh: forces, energies, and how the run goes on."""

from __future__ import annotations

import numpy as np
import pytest
from support import arms, plastic_bar
from support.arms import opened

import vmdg
from vmdg.meshes import blocks

BOND = vmdg.Debonding(strength=20.0, critical_gap=0.02)
ENERGY = vmdg.SolveOptions(energy=True, relative_tolerance=1e-9)


def beam(comm, facets: tuple[int, int], law: vmdg.Law = BOND, kinematics: str = "small"):
    return arms.bent_apart(comm, 24.0, facets, law, kinematics=kinematics)[0]


@pytest.mark.parametrize("kinematics", ("small", "finite"))
def test_equal_mesh(comm, kinematics):
    """Nothing changes, and the run goes on as without."""
    old, new = (beam(comm, (24, 3), kinematics=kinematics) for _ in range(2))
    force = vmdg.solve(old, [0.3, 0.6], ENERGY, opened).history["force"][-1]
    found = vmdg.transfer(old, new)
    # Newton's method left a residual of 1e-9 of the force.
    assert opened(new)["force [N]"] == pytest.approx(force, rel=1e-8)
    assert (found.same, new.t) == (1.0, 0.6)
    assert found.after.damage == found.before.damage > 0
    assert found.after.stored == pytest.approx(found.before.stored, rel=1e-8)
    ends = [vmdg.solve(each, [0.9], ENERGY, opened).history for each in (old, new)]
    assert len(ends[0]) == len(ends[1])
    for column in ("force", "damage", "external"):
        assert ends[1][column] == pytest.approx(ends[0][column], rel=1e-7)


@pytest.mark.parametrize(("facets", "kinematics"), (((36, 3), "small"), ((18, 3), "finite")))
def test_other_facets(comm, facets, kinematics):
    """The force stays, the energy balance too, and the run goes on like one on the new mesh from
    the start, without an attempt more.

    Facets of a quarter of the process zone and more, in which T and Q are fitted linearly."""
    old, new = (beam(comm, each, kinematics=kinematics) for each in ((24, 3), facets))
    force = vmdg.solve(old, [0.3, 0.6], ENERGY, opened).history["force"][-1]
    found = vmdg.transfer(old, new)
    assert opened(new)["force [N]"] == pytest.approx(force, rel=1e-3)
    assert found.same < 1
    assert found.after.damage == found.before.damage
    change = found.after.stored - found.before.stored
    assert abs(change) < 1e-3 * found.before.external
    assert found.after.discretization - found.before.discretization == pytest.approx(change)
    assert found.after.imbalance == pytest.approx(found.before.imbalance, abs=1e-9 * force)
    here = vmdg.solve(new, [0.7], ENERGY, opened)
    there = vmdg.solve(beam(comm, facets, kinematics=kinematics), [0.3, 0.6, 0.7], monitor=opened)
    assert here.history["force"][-1] == pytest.approx(there.history["force"][-1], rel=5e-3)
    assert not here.failures


def test_restart_on_another_mesh(comm, tmp_path):
    """A checkpoint is read on its mesh, and the run continues on another one."""
    folder = comm.bcast(tmp_path / "run")
    old, read, new = beam(comm, (24, 3)), beam(comm, (24, 3)), beam(comm, (36, 3))
    history = vmdg.solve(old, [0.3, 0.6], ENERGY, opened).history
    vmdg.write_checkpoint(old, folder, history)
    assert len(vmdg.read_checkpoint(read, folder)) == len(history)
    vmdg.transfer(read, new)
    ends = [vmdg.solve(each, [0.7], ENERGY, opened).history for each in (old, new)]
    for column in ("force", "damage", "external"):
        assert ends[1][column][-1] == pytest.approx(ends[0][column][-1], rel=5e-3)


@pytest.mark.parametrize(
    "law",
    (
        vmdg.Debonding(strength=20.0, critical_gap=0.02, unloading="secant", friction=0.2),
        pytest.param(
            vmdg.MixedModeDebonding(20.0, 30.0, normal_energy=0.2, shear_energy=0.4),
            marks=pytest.mark.long,
        ),
        pytest.param(
            vmdg.ExponentialDebonding(strength=20.0, fracture_energy=0.2), marks=pytest.mark.long
        ),
        vmdg.IntrinsicExponential(strength=20.0, fracture_energy=0.2, shear_weight=1.0),
    ),
    ids=lambda law: type(law).__name__,
)
def test_laws(comm, law):
    """After unloading: the force on a mesh with other facets, and how it grows again."""
    old, new = (beam(comm, facets, law) for facets in ((24, 3), (31, 3)))
    force = vmdg.solve(old, [0.6, 0.5], monitor=opened).history["force"][-1]
    vmdg.transfer(old, new)
    assert opened(new)["force [N]"] == pytest.approx(force, rel=2e-3)
    ends = [vmdg.solve(each, [0.55, 0.7], monitor=opened).history["force"] for each in (old, new)]
    assert ends[1][-1] == pytest.approx(ends[0][-1], rel=1e-2)


@pytest.mark.parametrize("kinematics", ("small", "finite"))
def test_sticking_and_sliding(comm, kinematics):
    """A block that is pressed on another and drawn along: friction as before, to other cells."""

    def scene(cell: str, divisions: tuple[int, ...]) -> vmdg.Problem:
        mesh, cells, facets = blocks(comm, cell, divisions)
        body = vmdg.NeoHookean(E=100.0, nu=0.3)
        law = vmdg.Contact(friction=0.4)
        problem = vmdg.Problem(
            mesh,
            cells,
            {1: body, 2: body},
            [vmdg.Interface(between=(1, 2), law=law)],
            kinematics=kinematics,
        )
        problem.dirichlet(facets.find(1), 0.0)
        problem.dirichlet(facets.find(2), lambda t: (-0.02 * min(t, 1), 0.02 * max(t - 1, 0)))
        return problem

    forces = lambda p: dict(zip("xy", p.reaction(lambda x: np.isclose(x[0], 2.0)), strict=True))  # noqa: E731
    old, new = scene("quadrilateral", (4, 6)), scene("triangle", (6, 9))
    vmdg.solve(old, [1.0, 1.5, 2.0], monitor=forces)
    before = forces(old)
    vmdg.transfer(old, new)
    for each in (2.0, 2.5):
        if each > 2:
            for problem in (old, new):
                vmdg.solve(problem, [each])
            before = forces(old)
        after = forces(new)
        for axis in "xy":
            assert after[axis] == pytest.approx(before[axis], rel=0.02)


@pytest.mark.parametrize("small", (True, False))
def test_plastic_bodies(comm, small):
    """A bar that has flowed and then debonded: its stress is uniform, so that no mesh errs."""

    def scene(divisions: tuple[int, ...]) -> vmdg.Problem:
        mesh, cells, facets = blocks(comm, "hexahedron", divisions)
        problem = vmdg.Problem(
            mesh,
            cells,
            {1: plastic_bar.BAR, 2: plastic_bar.BAR},
            [vmdg.Interface(between=(1, 2), law=plastic_bar.BOND)],
            kinematics="small" if small else "finite",
            volumetric="mean",
        )
        problem.dirichlet(facets.find(1), 0.0, "x")
        problem.dirichlet(facets.find(2), lambda t: t, "x")
        problem.dirichlet(facets.find(4), 0.0, "y")
        problem.dirichlet(facets.find(6), 0.0, "z")
        return problem

    old, new = scene((1, 1, 1)), scene((2, 2, 1))
    loads, number = plastic_bar.LOADS, 6
    exact = list(plastic_bar.series(loads, small))
    pulled = lambda x: np.isclose(x[0], plastic_bar.LENGTH)  # noqa: E731
    vmdg.solve(old, loads[:number], ENERGY)
    vmdg.transfer(old, new)
    assert new.reaction(pulled)[0] == pytest.approx(old.reaction(pulled)[0], rel=1e-8)
    for load, P in zip(loads[number:], exact[number:], strict=True):
        vmdg.solve(new, [load], ENERGY)
        vmdg.solve(old, [load], ENERGY)
        assert new.reaction(pulled)[0] == pytest.approx(old.reaction(pulled)[0], rel=1e-6)
        # Implicit steps err by the size of a step; exact where nothing flows.
        assert new.reaction(pulled)[0] == pytest.approx(P, rel=0.02)


def test_wrong_arguments(comm):
    """Other problems, and what cannot be carried, are refused; nothing changes."""
    old, new = beam(comm, (24, 3)), beam(comm, (24, 3), vmdg.Debonding(30.0, 0.02))
    with pytest.raises(ValueError, match=r"more than the mesh .*'strength': 20.0, .*there"):
        vmdg.transfer(old, new)
    with pytest.raises(TypeError, match=r"transfer: new = 3 must be a vmdg\.Problem"):
        vmdg.transfer(old, 3)
    mesh, cells, _ = blocks(comm, "quadrilateral", (2, 2))
    body = vmdg.NeoHookean(E=100.0, nu=0.3)
    bond = vmdg.Interface(between=(1, 2), law=BOND, activate="on-demand")
    on_demand = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond])
    with pytest.raises(ValueError, match="facets that open on demand cannot be carried"):
        vmdg.transfer(on_demand, on_demand)
    assert new.t == 0.0 and not new.u.x.array.any()
