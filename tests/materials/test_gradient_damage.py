"""Bodies that crack: bar in closed form, patch at an interface, bounds, energies, refusals."""

from __future__ import annotations

from importlib import util

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import CellType, create_rectangle, meshtags
from support.problems import joined
from support.scenes import SEVERAL_RANKS, two_blocks, unit_box

import vmdg

HAS_MESHIO = util.find_spec("meshio") is not None
if HAS_MESHIO:
    import meshio

E, NU, ENERGY, LENGTH = 1000.0, 0.3, 1.0, 1.0
BODY = vmdg.GradientDamage(E, NU, ENERGY, LENGTH)
STRAIN = BODY.strength / E
OPTIONS = vmdg.SolveOptions(energy=True)


def field(problem):
    return vmdg.body_damage(problem).x.array


@pytest.mark.parametrize("split", ["volumetric", "none"])
def test_moduli_and_energy(split):
    """Stress is the derivative of the stored energy and moduli that of the stress; what is closed
    neither drives damage nor feels it."""
    body = vmdg.GradientDamage(E, NU, ENERGY, LENGTH, split)
    random = np.random.default_rng(1)
    strain = random.normal(0.0, 0.01, (40, 3, 3))
    strain = (strain + strain.transpose(0, 2, 1)) / 2
    state = np.column_stack([random.uniform(0, 1, 40), np.zeros((40, 3))])
    answer, h = body(strain, state), 1e-6
    change = random.normal(0.0, 1.0, (3, 3))
    change = h * (change + change.T)
    ahead, behind = body(strain + change, state), body(strain - change, state)
    slope = np.einsum("pij,ij->p", answer.stress, change)
    assert (ahead.stored - behind.stored) / 2 == pytest.approx(slope, rel=1e-6, abs=1e-9)
    slope = np.einsum("pijkl,kl->pij", answer.moduli, change)
    assert (ahead.stress - behind.stress) / 2 == pytest.approx(slope, rel=1e-6, abs=1e-9)
    pressed = -0.01 * np.eye(3)[None]
    crushed = body(pressed, np.array([[1.0, 0.0, 0.0, 0.0]]))
    K = E / 3 / (1 - 2 * NU)
    carried, drive = (0.03 * K, 0.0) if split == "volumetric" else (3e-8 * K, 4.5e-4 * K)
    assert crushed.stress[0, 0, 0] == pytest.approx(-carried, rel=1e-9)
    assert crushed.state[0, 1] == pytest.approx(drive, abs=1e-15)


@pytest.mark.parametrize(
    ("cell", "options"),
    [
        ("quadrilateral", {"plane": "stress"}),
        ("triangle", {"plane": "stress", "degree": 2}),
        ("triangle", {"symmetry": "axisymmetric"}),
        ("tetrahedron", {}),
        ("hexahedron", {}),
    ],
)
def test_bar(comm, cell, options):
    """1 - d = (eps_c/eps)^2 beyond the strength, uniform in a bar no longer than a crack is wide;
    external work by the trapezoidal rule, of second order."""
    ends, errors = np.array([0.5, 0.9, 1.05, 1.4, 1.8]), []
    axis = 1 if options.get("symmetry") else 0
    for count in (1, 2):
        mesh = unit_box(comm, cell, 2)
        tags = meshtags(mesh, mesh.topology.dim, *_every_cell(mesh))
        problem = vmdg.Problem(mesh, tags, {1: BODY}, [], kinematics="small", **options)
        end = lambda x: np.isclose(x[axis], 1)  # noqa: E731
        for i in range(mesh.geometry.dim):
            problem.dirichlet(lambda x, i=i: np.isclose(x[i], 0), 0.0, i)
        problem.dirichlet(end, lambda t: t * STRAIN, axis)
        loads = np.interp(np.arange(1, 5 * count + 1) / count, range(6), [0, *ends])
        area = np.pi if axis else 1.0

        def monitor(problem, area=area, end=end):
            d = (
                comm.allreduce(field(problem).min(), MPI.MIN),
                comm.allreduce(field(problem).max(), MPI.MAX),
            )
            return {"stress": problem.reaction(end)[axis] / area, "low": d[0], "high": d[1]}

        h = vmdg.solve(problem, loads, OPTIONS, monitor).history
        e = h["load"]
        d = np.where(e < 1, 0, 1 - 1 / e**2)
        numbers = vmdg.PathOptions()
        assert h["low"] == pytest.approx(d, abs=numbers.damage)
        assert h["high"] == pytest.approx(d, abs=numbers.damage)
        stress = BODY.strength * np.where(e < 1, e, e**-3.0)
        assert h["stress"] == pytest.approx(stress, rel=3e-3)
        spent = 3 * ENERGY / 8 / LENGTH * d * area
        assert h["plastic"] == pytest.approx(spent, abs=1e-3 * area)
        errors.append(h["imbalance"][-1] / h["external"][-1])
    assert abs(errors[1]) < 0.35 * abs(errors[0]) < 0.02


def _every_cell(mesh):
    cells = mesh.topology.index_map(mesh.topology.dim)
    every = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    return every, np.ones_like(every)


@pytest.mark.parametrize("cell", ["quadrilateral", "triangle"])
@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Debonding(strength=1e4, critical_gap=10.0)])
def test_patch(comm, cell, degree, law):
    """Bodies of different damage in series, that of each being uniform up to the interface."""
    body = vmdg.GradientDamage(E, 0.0, 1e6, 0.5)
    for one, two in ((0.0, 0.0), (0.5, 0.5), (0.9, 0.0), (0.99, 0.9)):
        scene = two_blocks(comm, cell, n=2)
        problem = joined(scene, law, (body, body), kinematics="small", degree=degree)
        problem.dirichlet(scene.facet_tags.find(1), 0.0, "x")
        problem.dirichlet(scene.facet_tags.find(2), 0.01, "x")
        problem.dirichlet(lambda x: np.isclose(x[1], 0), 0.0, "y")
        points = problem.discretization.bodies.points
        given = np.zeros_like(points.state.damage)
        for tag, d in ((1, one), (2, two)):
            given[points.cracking[tag]] = d
        problem.step.damage.apply(given)
        points.commit()
        vmdg.solve(problem, [1.0], vmdg.SolveOptions(relative_tolerance=1e-12))
        left = [(1 - 1e-6) * (1 - d) ** 2 + 1e-6 for d in (one, two)]
        force = 0.01 * E / sum(1 / g for g in left)
        traction = problem.state[0].traction[:, 0]
        assert traction == pytest.approx(np.full_like(traction, force), rel=1e-9)
        assert problem.reaction(scene.facet_tags.find(2))[0] == pytest.approx(force, rel=1e-9)


def notched(comm, n=8, cell="quadrilateral"):
    """The upper half of a plate with a crack in its plane of symmetry, body 2 of a weak bond to a
    body that does not crack; pulled apart, pressed together, and pulled further."""
    scene = two_blocks(comm, cell, n=n)
    body = vmdg.GradientDamage(E, NU, 0.2, 0.25)
    materials = vmdg.NeoHookean(E=E, nu=NU), body
    law = vmdg.Debonding(strength=8.0, critical_gap=0.05)
    problem = joined(scene, law, materials, kinematics="small")
    problem.dirichlet(lambda x: np.isclose(x[1], 0) & (x[0] < 1.6), 0.0)
    problem.dirichlet(lambda x: np.isclose(x[1], 1), lambda t: t, "y")
    return problem


UP_AND_DOWN = np.array([0.01, 0.02, 0.03, 0.035, 0.0, -0.01, 0.02, 0.035, 0.045])


def test_bounds_and_irreversibility(comm):
    """In every row, while bonds break too, and to the last digit."""
    rows = []

    def monitor(problem):
        rows.append(field(problem).copy())
        energy = problem.energy()
        return {"spent": energy.plastic, "bond": energy.damage}

    problem = notched(comm)
    h = vmdg.solve(problem, UP_AND_DOWN, OPTIONS, monitor).history
    damage = np.array(rows)
    assert damage.min() >= 0 and damage.max() <= 1
    assert (np.diff(damage, axis=0) >= 0).all()
    assert (np.diff(h["spent"]) >= 0).all() and (np.diff(h["bond"]) >= 0).all()
    assert comm.allreduce(damage.max(), MPI.MAX) > 0.5 and h["bond"][-1] > 0
    outside = [tag for tag in (1, 2) if tag not in problem.discretization.bodies.points.cracking]
    assert outside == [1]


@SEVERAL_RANKS
def test_ranks(comm):
    """Energies and damage of one rank, to 1e-8."""
    results = []
    for ranks in (comm, MPI.COMM_SELF):
        most = lambda p, r=ranks: {"d": r.allreduce(field(p).max(), MPI.MAX)}  # noqa: E731
        options = vmdg.SolveOptions(energy=True, relative_tolerance=1e-11)
        h = vmdg.solve(notched(ranks), UP_AND_DOWN, options, most).history
        results.append([h[name] for name in ("d", "damage", "plastic", "bulk", "passes")])
    assert np.array(results[0]) == pytest.approx(np.array(results[1]), rel=1e-8, abs=1e-12)


def test_resumed(comm, out):
    """Resumed from a checkpoint a run is the uninterrupted one, on one rank digit by digit."""
    folder, problem = out / "run", notched(comm)
    save = vmdg.SolveOptions(energy=True, checkpoint=folder, checkpoint_every=1)
    whole = vmdg.solve(problem, UP_AND_DOWN, save).history
    first = vmdg.solve(
        notched(comm),
        UP_AND_DOWN[:4],
        vmdg.SolveOptions(energy=True, checkpoint=out / "half", checkpoint_every=1),
    ).history
    resumed = notched(comm)
    known = vmdg.read_checkpoint(resumed, out / "half")
    assert len(known) == len(first)
    end = vmdg.solve(resumed, UP_AND_DOWN[4:], save, history=known).history
    # On several ranks up to rounding: sums over ranks are restored on one of them.
    rounding = 0.0 if comm.size == 1 else 1e-12
    for name in ("load", "passes", "plastic", "damage", "bulk", "external"):
        assert end[name] == pytest.approx(whole[name], rel=rounding, abs=rounding), name
    assert field(resumed) == pytest.approx(field(problem), rel=0, abs=rounding)


@pytest.mark.skipif(not HAS_MESHIO, reason="needs meshio")
def test_fields(comm, out):
    """The damage is a field of the bodies."""
    problem = notched(comm)
    vmdg.solve(problem, UP_AND_DOWN[:4])
    with vmdg.FieldWriter(problem, out / "fields", ["displacement", "damage"], "vtu") as writer:
        writer.write(1.0)
    files = list((out / "fields" / "bodies").glob("*.vtu"))
    read = [meshio.read(file).point_data["damage [-]"] for file in files]
    assert max(array.max() for array in read) == pytest.approx(
        comm.allreduce(field(problem).max(), MPI.MAX), abs=1e-6
    )


def test_nothing_where_nothing_cracks(comm):
    scene = two_blocks(comm, "quadrilateral")
    body = vmdg.J2(E, NU, 10.0)
    problem = joined(scene, vmdg.Bonded(), (body, body), kinematics="small", degree=2)
    assert problem.step.damage is None
    with pytest.raises(ValueError, match="no body cracks"):
        vmdg.body_damage(problem)
    assert problem.discretization.bodies.points.state.damage.shape[1] == 0


@pytest.mark.parametrize(
    ("options", "interface", "words"),
    [
        ({"kinematics": "finite"}, {}, "kinematics='small'"),
        ({"volumetric": "mean"}, {}, "volumetric='mean'"),
        ({"plane": "generalized strain"}, {}, "generalized strain"),
        ({"density": {1: 1e-9, 2: 1e-9}}, {}, "density="),
        ({}, {"sliding": True, "frame": "corotating"}, "sliding=True"),
        ({}, {"activate": "on-demand"}, "activate='on-demand'"),
    ],
)
def test_refused(comm, options, interface, words):
    scene, law = two_blocks(comm, "quadrilateral"), vmdg.Debonding(20.0, 0.1)
    with pytest.raises(ValueError, match=words):
        options = {"kinematics": "small"} | options
        joined(scene, law, (BODY, BODY), interface=interface, **options)


def test_other_refusals(comm):
    """Of what a problem is used for."""
    problem = notched(comm, 2)
    with pytest.raises(ValueError, match="bodies that crack cannot be carried"):
        vmdg.transfer(problem, notched(comm, 3))
    with pytest.raises(ValueError, match="history of its own"):
        vmdg.solve(problem, [0.001], derivatives=["interface 0: strength"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"G_c": 0.0}, "G_c = 0.0 must be positive"),
        ({"length": -1.0}, "length = -1.0 must be positive"),
        ({"cell": -0.1}, "cell = -0.1 must be not negative"),
        ({"length": "short"}, "must be a number"),
        ({"split": "spectral"}, "split = 'spectral' must be one of"),
        ({"nu": 0.5}, "nu"),
    ],
)
def test_mistakes(arguments, words):
    with pytest.raises((ValueError, TypeError), match=words):
        vmdg.GradientDamage(**{"E": E, "nu": NU, "G_c": ENERGY, "length": LENGTH} | arguments)


def test_energy_of_the_cells():
    """Taken off by ``cell``."""
    body = vmdg.GradientDamage(E, NU, ENERGY, LENGTH, cell=0.4)
    assert body.toughness == pytest.approx(ENERGY / 1.15)
    assert body.strength == pytest.approx(BODY.strength / 1.15**0.5)


def surfing(n, steps, length=0.1, size=(1.2, 0.6)):
    """A strip whose edges follow the field of a crack that runs along it at G = G_c; how far, and
    the history from there on, where it runs steadily."""
    e, energy = 210e3, 2.7
    shear, h = e / 2 / (1 + NU), size[0] / n
    rows = round(size[1] / h) // 2 * 2 + 1
    high = rows * h / 2
    mesh = create_rectangle(
        MPI.COMM_SELF, [(0, -high), (size[0], high)], (n, rows), CellType.quadrilateral
    )
    body = vmdg.GradientDamage(e, NU, energy, length, cell=h)
    tags = meshtags(mesh, 2, *_every_cell(mesh))
    problem = vmdg.Problem(mesh, tags, {1: body}, [], kinematics="small")

    def edge(x, t):
        x, y = x[0] - 0.3 - t, x[1]
        r, angle = np.hypot(x, y), np.arctan2(y, x)
        K = np.sqrt(e / (1 - NU**2) * energy)
        size = K / 2 / shear * np.sqrt(r / 2 / np.pi) * (3 - 4 * NU - np.cos(angle))
        return np.array([size * np.cos(angle / 2), size * np.sin(angle / 2)])

    sides = lambda x: np.isclose(np.abs(x[1]), high) | np.isclose(x[0] % size[0], 0)  # noqa: E731
    problem.dirichlet(sides, edge)
    points, space = problem.discretization.bodies.points, vmdg.body_damage(problem).function_space
    x = space.tabulate_dof_coordinates()[space.dofmap.list]
    cracked = (np.abs(x[..., 1]) < 0.51 * h) & (x[..., 0] < 0.3 + 1e-9)
    problem.step.damage.apply(cracked[points.cells].astype(float))
    points.commit()
    history = vmdg.solve(problem, np.linspace(0, 0.5, steps + 1), OPTIONS).history
    way, steady = history["load"], history["load"] > 0.199

    def per_way(values):
        return np.polyfit(way[steady], values[steady], 1)[0] / energy

    spent, released = history["plastic"], history["external"] - history["bulk"]
    lost = np.abs(np.diff(history["imbalance"][steady])).sum() / np.ptp(history["external"][steady])
    return per_way(spent), per_way(released), lost


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="one rank is enough")
@pytest.mark.parametrize(
    ("n", "steps"), [(30, 15), *(pytest.param(n, n // 2, marks=pytest.mark.long) for n in (36, 48))]
)
def test_surfing_crack(n, steps):
    """What is released, and what is dissipated along the way, are G_c per length; the energy that
    is lost in steps, each a cell or less, is their difference."""
    dissipated, released, lost = surfing(n, steps)
    assert dissipated == pytest.approx(1, abs=0.03)
    assert released == pytest.approx(1, abs=0.02)
    assert lost < 1e-3
