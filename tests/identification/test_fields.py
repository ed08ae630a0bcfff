"""Displacement fields of images beside a force: derivatives, motions of the camera, errors."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
import pytest
from support.scenes import two_blocks

import vmdg
from vmdg.meshes import beams

TRUE = {"bond.strength": 30.0, "bond.critical_gap": 0.02, "NeoHookean.E": 70e3}
CRACK, HEIGHT = 12.0, 1.5
LOADS = np.linspace(0.1, 0.5, 5)
POINTS = np.array([(x, y) for x in np.arange(11.2, 17, 0.9) for y in (-1.2, -0.4, 0.4, 1.2)])
NOISE = 2e-4


def beam(values: dict[str, float]) -> tuple[vmdg.Problem, Callable]:
    stations, divisions = (0.0, 10.0, CRACK, 18.0, 30.0), (4, 3, 9, 5)
    mesh, cells, sides = beams(
        stations=stations, divisions=divisions, height=HEIGHT, rows=2, precrack=CRACK
    )
    law = vmdg.Debonding(values["bond.strength"], values["bond.critical_gap"])
    bond = vmdg.Interface(facets=sides.find("interface"), law=law, name="bond")
    arm = vmdg.NeoHookean(E=values["NeoHookean.E"], nu=0.3)
    arms = {"lower arm": arm, "upper arm": arm}
    problem = vmdg.Problem(mesh, cells, arms, [bond], degree=2, kinematics="small")
    for side in (1, -1):
        problem.dirichlet_points(
            lambda x, y=side * HEIGHT: np.isclose(x[0], 0.0) & np.isclose(x[1], y),
            lambda t, side=side: side * t / 2,
            "y",
        )
    problem.dirichlet(sides.find("right"), 0.0)
    top = sides.find("upper left")
    return problem, lambda problem: {"force [N]": problem.reaction(top)[1]}


def measured(seed: int = 0) -> tuple[vmdg.Curve, vmdg.Field]:
    """Forces and images with noise, of a camera that moves."""
    problem, monitor = beam(TRUE)
    seen = vmdg.Field(POINTS, LOADS, np.zeros((len(LOADS), *POINTS.shape)), sigma=1.0)
    sample = seen.watch(problem)
    history = vmdg.solve(
        problem, LOADS, monitor=lambda problem: monitor(problem) | {"field": sample()}
    ).history
    rows = [np.abs(history["load"] - t).argmin() for t in LOADS]
    force, u = history["force"][rows], history["field"][rows].reshape(seen.u.shape)
    random = np.random.default_rng(seed)
    sigma = 0.005 * force.max()
    u = u + NOISE * random.standard_normal(u.shape)
    for one in u:
        turn = 1e-3 * random.standard_normal()
        one += 0.05 * random.standard_normal(2) + turn * POINTS[:, ::-1] * [-1, 1]
    # Points that were lost in an image.
    u[2, :3] = np.nan
    force = force + sigma * random.standard_normal(len(force))
    return vmdg.Curve(LOADS, force, sigma=sigma), vmdg.Field(POINTS, LOADS, u, sigma=NOISE)


def test_strength_from_images():
    """Images bring the error of the strength from more than 5 % below 2.5 %, on any number of
    ranks, whatever the camera does."""
    curve, field = measured()
    start = {name: f * v for (name, v), f in zip(TRUE.items(), (1.2, 0.9, 0.95), strict=True)}
    found = vmdg.identify(beam, [curve, field], start)
    assert found.converged
    assert not found.warnings
    for name, value in TRUE.items():
        error = found.relative_errors[name]
        assert abs(np.log(found.estimate[name] / value)) < 3 * error
        assert error < 0.025
    # Its value is computed from moduli of E, which was found.
    assert list(found.given) == ["NeoHookean.nu"]
    assert field.nuisances == 3 * len(LOADS)
    count = len(LOADS) + field.data.size
    assert found.freedom == count - field.nuisances - len(TRUE)
    assert found.noise == pytest.approx(1.0, abs=0.2)
    # The same derivatives without the rows of the field: the force alone.
    J = found.jacobian[: len(LOADS)]
    alone = np.sqrt(np.linalg.inv(J.T @ J)[0, 0])
    assert alone > 0.05
    figure = found.plot()
    assert len(figure.axes) == 4


def test_derivatives():
    """Of displacements of the run, against differences of whole runs."""
    _, field = measured()
    names, found = list(TRUE), []
    for values in (TRUE, *(TRUE | {"bond.strength": 30.0 * (1 + h)} for h in (1e-4, -1e-4))):
        problem, monitor = beam(values)
        sample = field.watch(problem)
        history = vmdg.solve(
            problem,
            LOADS,
            monitor=lambda p, monitor=monitor, sample=sample: monitor(p) | {"field": sample()},
            derivatives=names,
        ).history
        found.append(field.of_run(history, names))
    here, up, down = found
    slope = (up.values - down.values) / (2e-4 * 30.0)
    assert here.reached
    assert here.slopes[:, 0] == pytest.approx(slope, abs=1e-4 * np.abs(slope).max())


def test_space(comm):
    """Moduli of two blocks in space from images of a camera that turns about all axes, to rounding,
    and with the covariance of a fit whose motions are parameters like all others."""
    true, nodes = {"1.E": 1000.0, "2.E": 400.0}, [0.2, 0.7]
    points = np.array(np.meshgrid([0.3, 0.8, 1.2, 1.7], nodes, nodes)).reshape(3, -1).T
    loads, random = np.array([0.5, 1.0]), np.random.default_rng(1)

    def make(values):
        scene = two_blocks(comm, "hexahedron")
        bodies = {tag: vmdg.NeoHookean(E=values[f"{tag}.E"], nu=0.0) for tag in (1, 2)}
        tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
        problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [tie], kinematics="small")
        left, right = (scene.facet_tags.find(tag) for tag in (1, 2))
        problem.dirichlet(left, 0.0)
        problem.dirichlet(right, lambda t: np.array([0.01 * t, 0.0, 0.0]))
        return problem, lambda problem: {"force [N]": problem.reaction(right)[0]}

    # Bars in series without contraction.
    stress = 0.01 / (1 / 1000.0 + 1 / 400.0)
    x = points[:, 0]
    along = stress * np.where(x < 1, x / 1000.0, 1 / 1000.0 + (x - 1) / 400.0)
    u = loads[:, None, None] * along[:, None] * [1.0, 0.0, 0.0]
    spins = 1e-4 * random.standard_normal((len(loads), 1, 3))
    moved = u + 0.1 * random.standard_normal((len(loads), 1, 3)) + np.cross(spins, points + u)
    sigma = 1e-5 * random.uniform(1.0, 2.0, u.shape)
    field = vmdg.Field(points, loads, moved, sigma=sigma)
    curve = vmdg.Curve(loads, loads * stress, sigma=0.01)
    found = vmdg.identify(make, [curve, field], {"1.E": 900.0, "2.E": 500.0}, comm=comm)
    assert found.estimate == pytest.approx(true, rel=1e-5)
    assert field.nuisances == 12
    # du/dlog E of both bars, by the closed form, and the motions as columns.
    share = np.array([1 / 1000.0, 1 / 400.0]) * stress / 0.01
    inside = np.minimum(x, 1.0), np.maximum(x - 1.0, 0.0)
    rates = [share[k] * along - inside[k] * stress / true[f"{k + 1}.E"] for k in (0, 1)]
    columns = [loads[:, None, None] * rate[:, None] * [1.0, 0.0, 0.0] for rate in rates]
    for image, seen in enumerate(points + moved):
        for axis in np.eye(3):
            for motion in (np.broadcast_to(axis, u[0].shape), np.cross(axis, seen)):
                columns.append(np.zeros_like(u))
                columns[-1][image] = motion
    J = np.column_stack([(column / sigma).ravel() for column in columns])
    forces = np.zeros((len(loads), len(columns)))
    forces[:, :2] = loads[:, None] * stress * share / 0.01
    J = np.vstack([J, forces])
    covariance = np.linalg.inv(J.T @ J)[:2, :2]
    assert found.covariance == pytest.approx(covariance, rel=1e-3)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"u": np.zeros((2, 3, 2))}, "u has shape"),
        ({"points": np.zeros(3)}, r"must be finite numbers \(n, 2\)"),
        ({"sigma": 0.0}, "sigma must be positive"),
        ({"loads": [np.nan, 1.0]}, "loads must be finite"),
        ({"points": np.zeros((1, 2)), "u": np.zeros((2, 1, 2))}, "image 1 has no more"),
    ],
)
def test_refusals(changes, message):
    """What is no field."""
    points = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0)])
    given = {"points": points, "loads": [0.5, 1.0], "u": np.zeros((2, 4, 2)), "sigma": 1.0}
    given |= changes
    with pytest.raises(ValueError, match=message):
        vmdg.Field(given.pop("points"), given.pop("loads"), given.pop("u"), **given)


def test_field_with_a_force_inside():
    """A field needs a force, and points that are in the bodies, on every rank."""
    curve, field = measured()
    with pytest.raises(ValueError, match="says nothing about the size of forces"):
        vmdg.identify(beam, field, TRUE)
    outside = vmdg.Field(POINTS + [0, 2.0], LOADS, field.u, sigma=NOISE)
    with pytest.raises(ValueError, match="of 28 points are outside of the bodies"):
        vmdg.identify(beam, [curve, outside], TRUE, comm=MPI.COMM_WORLD)
