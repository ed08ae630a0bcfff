"""Pictures: what is drawn is what the problem has, on any number of ranks."""

from __future__ import annotations

import subprocess
import sys

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image
from support.problems import couple
from support.scenes import LEFT, RIGHT, two_blocks

import vmdg
from vmdg import compat, plot
from vmdg.meshes import fibre_matrix, pushout
from vmdg.output.corners import nodal_means
from vmdg.output.values import scalar
from vmdg.plot.interface import unrolled
from vmdg.plot.stress import stress_means

LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2)
SOFT, STIFF = vmdg.NeoHookean(mu=1000.0, lmbda=2000.0), vmdg.NeoHookean(mu=3000.0, lmbda=2000.0)


@pytest.fixture(autouse=True)
def closed_figures():
    yield
    plt.close("all")


def bonded(comm, cell: str = "quadrilateral", n: int = 2) -> vmdg.Problem:
    return couple(two_blocks(comm, cell, n), LAW, (SOFT, STIFF))


def cell_with_fibres(comm, centres, radius: float = 0.2) -> vmdg.Problem:
    scene = fibre_matrix(comm, "triangle", 1.0, radius, centres, element_size=0.08)
    return couple(scene, LAW, (STIFF, SOFT))


def with_opening(problem: vmdg.Problem, field) -> vmdg.Problem:
    """The values at the points after the displacement ``field``."""
    problem.u.interpolate(field)
    problem.discretization.update_stabilization()
    problem.step.assemble_residual()
    return problem


# Curves and profiles


def test_curve():
    """The columns are drawn, with their names, from the origin if it is asked for."""
    history = vmdg.History()
    for t in (1.0, 2.0):
        history.append({"load": t, "force [N]": 3 * t})
    ax = plot.curve(history, "load", "force [N]", origin=True, label="run")
    assert ax.lines[0].get_xydata().tolist() == [[0, 0], [1, 3], [2, 6]]
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("load factor", "force [N]")
    assert plot.curve(history, "load", "load", ax).get_ylabel() == "force [N]"
    assert ax.lines[1].get_xydata().tolist() == [[1, 1], [2, 2]]
    with pytest.raises(KeyError, match="no column 'work'"):
        plot.curve(history, "load", "work")


def test_arc_length_of_circles(comm):
    """Arcs run counterclockwise from the right end of every fibre, once around the polygon."""
    centres, radius = np.array([[0.26, 0.3], [0.74, 0.7]]), 0.2
    problem = with_opening(cell_with_fibres(comm, centres, radius), lambda x: 0.01 * x[:2])
    pieces = plot.profile(problem, 0, "traction")
    angles = plot.profile(problem, 0, "traction", along="angle")
    assert len(pieces) == len(angles) == 2
    for arc, angle in zip(pieces, angles, strict=True):
        assert (np.diff(arc[:, 0]) > 0).all()
        assert 0 < arc[0, 0] < arc[-1, 0] < 2 * np.pi * radius
        # Chords are shorter than arcs by (h/r)^2/24, here .7%.
        assert np.radians(angle[:, 0]) * radius == pytest.approx(arc[:, 0], rel=0.01)
        assert angle[:, 1] == pytest.approx(arc[:, 1])
    count = comm.allreduce(len(problem.state[0].weights))
    assert sum(map(len, pieces)) == count


def test_profile_of_a_line(comm):
    """Along an open interface the arc length is the way from its lower end; values belong to it."""
    problem = bonded(comm, "triangle")
    with_opening(problem, lambda x: np.stack([0.01 * x[0] * x[1], 0 * x[0]]))
    (arc,), (y,) = (plot.profile(problem, 0, "traction", along=s) for s in ("arc", "y"))
    assert arc == pytest.approx(y, abs=1e-12)
    assert comm.allgather(arc.tobytes()) == [arc.tobytes()] * comm.size
    state = problem.state[0]
    for position, traction in zip(state.points[:, 1], scalar(problem, 0, "traction"), strict=True):
        assert np.abs(arc - [position, traction]).max(axis=1).min() < 1e-9
    ax = plot.interface_profile(problem, 0, "traction", color="red")
    assert ax.lines[0].get_xydata() == pytest.approx(arc)
    assert "MPa" in ax.get_ylabel() and ax.get_xlabel() == "arc length [mm]"


def test_what_has_no_profile(comm):
    """The messages say what to do instead."""
    problem = bonded(comm, "tetrahedron", n=1)
    with pytest.raises(ValueError, match="a surface has no arc length; use 'angle'"):
        plot.profile(problem, 0, "traction")
    with pytest.raises(ValueError, match="along = 'r' must be one of"):
        plot.profile(problem, 0, "traction", along="r")
    with pytest.raises(ValueError, match="'force' is not a scalar of an interface; use one of"):
        plot.profile(problem, 0, "force", along="x")
    scene, inside = two_blocks(comm, "triangle", 2), {"between": None, "within": 1}
    problem = couple(scene, LAW, **inside)
    with pytest.raises(ValueError, match="branches and has no arc length"):
        plot.profile(problem, 0, "traction")
    problem = couple(scene, LAW, **inside, activate="on-demand")
    assert plot.profile(problem, 0, "fine_scale") == []
    assert not len(problem.indicator(0))
    plot.mode_map(problem, 0, axis="y")


# Maps


def testunrolled_cylinder():
    """Any cylinder, a quarter or a whole: the axis is found, no facet is cut by the jump."""
    centre, count = np.array([3.0, -2.0]), 12
    for sweep in (np.pi / 2, 2 * np.pi):
        ends = np.linspace(0, sweep, count + 1) + 0.3
        rim = centre + np.column_stack([np.cos(ends), np.sin(ends)])
        low, high = rim[:-1], rim[1:]
        # Cylinder along y: angles from z to x.
        points = [[[q[1], y, q[0]] for q, y in zip(f, (0, 0, 5, 5), strict=True)]
                  for f in zip(low, high, high, low, strict=True)]  # fmt: skip
        middle = (ends[1:] + ends[:-1]) / 2
        normals = np.column_stack([np.sin(middle), 0 * middle, np.cos(middle)])
        polygons, names = unrolled(np.array(points), normals, "y")
        assert names == ("angle [°]", "y [mm]")
        width = np.ptp(polygons[..., 0], axis=1)
        assert width == pytest.approx(np.degrees(sweep) / count)
        assert np.sort(polygons[..., 0].mean(axis=1)) == pytest.approx(
            np.sort(np.degrees(middle) % 360)
        )
        assert np.ptp(polygons[..., 1], axis=1) == pytest.approx(5.0)


def test_mode_map_in_3d(comm):
    """The quarter of a fibre becomes the rectangle of 90 degrees and its length."""
    scene = pushout(comm, 2, 2, 1, 1, 2)
    problem = couple(scene, LAW, (STIFF, SOFT))
    height = comm.allreduce(scene.mesh.geometry.x[:, 2].max(), max)
    ax = plot.mode_map(problem, 0, axis="z")
    boxes = [path.get_extents() for path in ax.collections[0].get_paths()]
    assert sum(box.width * box.height for box in boxes) == pytest.approx(90 * height, rel=1e-6)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ["bonded or sticking"]
    flat = bonded(comm, "hexahedron")
    ax = plot.mode_map(flat, 0, "damage")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("y [mm]", "z [mm]")


@pytest.fixture
def coloured(monkeypatch) -> list:
    """What has got a colour bar, in order."""
    drawn, colorbar = [], Figure.colorbar

    def seen(figure, mappable, *args, **kwargs):
        drawn.append(mappable)
        return colorbar(figure, mappable, *args, **kwargs)

    monkeypatch.setattr(Figure, "colorbar", seen)
    return drawn


def values_of(drawn) -> np.ndarray:
    return np.asarray(drawn.get_array()).ravel()


def label_of(drawn) -> str:
    bar = drawn.colorbar.ax
    return bar.get_xlabel() + bar.get_ylabel()


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_map_of_interfaces(comm, cell, coloured):
    """All facets of all interfaces on rank 0, coloured by their means; few where it is asked."""
    problem = bonded(comm, cell, 4)
    ax = plot.interface_map(problem, lambda state: state.points[:, 1], limits=(0, 2))
    plot.interface_map(problem, lambda state: state.points[:, 1], above=0.5)
    plot.interface_map(problem)
    middles = np.repeat([0.125, 0.375, 0.625, 0.875], 1 if cell == "quadrilateral" else 4)
    if comm.rank == 0:
        every, few, named = coloured
        assert np.sort(values_of(every)) == pytest.approx(middles)
        assert np.sort(values_of(few)) == pytest.approx(middles[middles > 0.5])
        assert every.get_clim() == (0, 2)
        assert "damage" in label_of(named)
        if cell == "quadrilateral":
            lines = np.array(ax.collections[1].get_segments())
            assert lines[..., 0] == pytest.approx(1.0)
            assert lines[..., 1].mean(axis=1) == pytest.approx(values_of(every))
    with pytest.raises(ValueError, match="not a scalar of an interface"):
        plot.interface_map(problem, "colour")


# Stress


def test_stress_of_bodies(comm):
    """Uniform in each body, although nodes of both lie at the interface; as by hand."""
    problem = bonded(comm)
    H = np.array([[0.1, 0.05], [0.0, -0.04]])
    with_opening(problem, lambda x: H @ x[:2])
    F = np.eye(3)
    F[:2, :2] += H
    J = np.linalg.det(F)
    exact = {}
    for material in (SOFT, STIFF):
        mu, lmbda = material.parameters["mu"], material.parameters["lmbda"]
        sigma = mu / J * (F @ F.T - np.eye(3)) + lmbda * (J - 1) * np.eye(3)
        deviator = sigma - np.trace(sigma) / 3 * np.eye(3)
        for name, value in (
            ("xy", sigma[0, 1]),
            ("zz", sigma[2, 2]),
            ("principal", np.linalg.eigvalsh(sigma)[-1]),
            ("mises", np.sqrt(1.5 * (deviator**2).sum())),
        ):
            exact.setdefault(name, []).append(value)
    for name, values in exact.items():
        means = stress_means(problem, name)
        assert np.unique(means.round(8)) == pytest.approx(np.unique(np.round(values, 8)))
        ax = plot.stress(problem, name)
        if comm.rank == 0:
            drawn = np.asarray(ax.collections[0].get_array())
            assert len(drawn) == 4 * 8  # corners of all cells of all ranks
            assert np.unique(drawn.round(8)) == pytest.approx(np.unique(np.round(values, 8)))
            if name != "zz":  # which is equal in both bodies
                assert ax.collections[0].get_clim() == pytest.approx((min(values), max(values)))
    with pytest.raises(ValueError, match="component = 'rr' must be 'mises', 'principal' or two of"):
        plot.stress(problem, "rr")


def test_nodal_means(comm):
    """Of a linear field sampled in the cells: exact inside, jumps at the interface stay."""
    problem = bonded(comm, n=4)
    with_opening(problem, lambda x: np.stack([np.where(x[0] < 1 - 1e-9, 0.0, x[0]), 0 * x[1]]))
    mesh = problem.mesh
    owned = mesh.topology.index_map(2).size_local
    x = mesh.geometry.x[compat.geometry_dofmap(mesh)[:owned]]
    middle = np.broadcast_to(x.mean(axis=1, keepdims=True), x.shape)
    field = np.where(middle[..., 0] < 1, 0.0, 1.0) + 0 * x[..., 0]
    assert nodal_means(problem, field) == pytest.approx(field)
    means = nodal_means(problem, middle[..., 1].copy())
    inner = (x[..., 1] > 0.1) & (x[..., 1] < 0.9)
    assert means[inner] == pytest.approx(x[..., 1][inner])


@pytest.mark.parametrize("cell", ["quadrilateral", "hexahedron"])
def test_rounding_is_drawn_as_zero(comm, cell, coloured):
    """Of blocks that have come free; a stress is drawn, however small the load that makes it."""
    scene = two_blocks(comm, cell)
    problem = couple(scene, LAW, (SOFT, STIFF))
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(
        scene.facet_tags.find(RIGHT), lambda t: (t, *np.zeros(scene.mesh.geometry.dim - 1))
    )
    tight = vmdg.SolveOptions(relative_tolerance=1e-9)
    for t, free in ((1e-11, False), (0.4, True)):
        vmdg.solve(problem, [t], tight)
        plot.stress(problem, "xx")
        means = stress_means(problem, "xx")
        sigma = comm.allreduce(np.abs(problem.stress().x.array).max(), max)
        assert 0 < sigma < 1e-6
        assert (means == 0).all() == free
        if comm.rank == 0:
            assert (values_of(coloured[-1]) == 0).all() == free
            assert ("(0: below" in label_of(coloured[-1])) == free
    # So is what is rounding beside another component.
    problem = bonded(comm, cell)
    stretch = np.diag([0.01, 0.0, 0.0])[: problem.mesh.geometry.dim]
    with_opening(problem, lambda x: stretch @ x)
    assert (stress_means(problem, "xy") == 0).all()
    assert (stress_means(problem, "xx") > 1).all()


# Animations


def test_animation(comm, out):
    """One picture a snapshot and a rest at the end, of which the problem is in the last state."""
    scene = two_blocks(comm, "quadrilateral")
    problem, right = couple(scene, LAW, (SOFT, STIFF)), scene.facet_tags.find(RIGHT)
    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(right, lambda t: (t, 0.0))
    snapshots = []

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        snapshots.append(problem.snapshot())
        return {"force": problem.reaction(right)[0]}

    by_load = vmdg.SolveOptions(control="load")
    history = vmdg.solve(problem, [0.05, 0.1, 0.2], by_load, monitor).history
    end = problem.u.x.array.copy()
    plot.animate(
        out / "a" / "film.gif", problem, snapshots, history, "load", "force", fps=2, dpi=40
    )
    assert problem.t == 0.2
    assert problem.u.x.array == pytest.approx(end, abs=0)
    if comm.rank == 0:
        with Image.open(out / "a" / "film.gif") as film:
            durations, pictures = [], []
            for number in range(film.n_frames):
                film.seek(number)
                durations.append(film.info["duration"])
                pictures.append(np.asarray(film.convert("L"), dtype=float))
        assert len(pictures) == 3 and sum(durations) == pytest.approx(500 * 4)
        assert np.abs(pictures[2] - pictures[0]).max() > 50
    with pytest.raises(ValueError, match=r"must end in .gif or .mp4"):
        plot.animate(out / "film.avi", problem, snapshots, history, "load", "force")
    with pytest.raises(ValueError, match="0 snapshots do not match a history of 3 rows"):
        plot.animate(out / "film.gif", problem, [], history, "load", "force")


def test_film_of_a_field(comm, out):
    """Two bodies with values of their own: each keeps its colour up to the interface, and nothing
    is drawn outside."""
    scene = two_blocks(comm, "quadrilateral", 3)
    problem = couple(scene, LAW, (SOFT, STIFF))
    field = np.zeros(len(problem.u.x.array) // 2)
    second = problem.discretization.bodies.cells_of[2]
    field[problem.space.dofmap.list[second]] = 1.0
    path = out / "b" / "field.gif"
    plot.film(path, problem, [field, 0 * field], ["one", "two"], "value", most=1.0)
    if comm.rank == 0:
        with Image.open(path) as film:
            assert film.n_frames == 2
            picture = np.asarray(film.convert("L"), dtype=float)
        bright = (picture > 200) & (picture < 254)
        columns = np.flatnonzero(bright.sum(axis=0) > 0.3 * bright.sum(axis=0).max())
        # Black where the field is 0: the left half of the axes.
        assert len(columns) > 50
        row = picture[picture.shape[0] // 2]
        left = row[: columns[0]]
        assert (left < 5).sum() > 0.8 * len(columns)
    for wrong in ((out / "film.avi", [field], ["one"]), (path, [field], []), (path, [], [])):
        with pytest.raises(ValueError, match=r"must end in .gif"):
            plot.film(wrong[0], problem, *wrong[1:], "value")


# PyVista


@pytest.fixture
def renderer():
    """PyVista, if it is installed and can draw here, which a process of its own finds out."""
    pytest.importorskip("pyvista")
    trial = (
        "import pyvista as p; q = p.Plotter(off_screen=True); q.add_mesh(p.Cube()); q.screenshot()"
    )
    if subprocess.run([sys.executable, "-c", trial], capture_output=True).returncode:
        pytest.skip("PyVista cannot draw without a display here")


def test_solid_picture(comm, renderer):
    """A gap between two bodies of different stress: white where nothing is, colours of both."""
    problem = with_opening(bonded(comm, "hexahedron"), lambda x: 0.02 * x * [[1], [0], [0]])
    second = problem.space.dofmap.list[problem.discretization.bodies.cells_of[2]]
    problem.u.x.array.reshape(-1, 3)[np.unique(second), 0] += 0.3
    problem.step.assemble_residual()
    assert plot.stress(problem, "xx", magnify=2).get_xlabel().endswith("displacements × 2")
    ax = plot.stress(problem, "xx", view=(0, -1, 0))
    damage = plot.interface_map(problem)
    if comm.rank == 0:
        assert ax.get_xlabel() == "2 × 1 × 1 mm"
        picture = np.asarray(ax.images[0].get_array(), dtype=float)
        middle = picture[len(picture) // 2]
        white = (middle > 254).all(axis=1)
        inner = np.flatnonzero(~white)
        gap = white[inner[0] : inner[-1]].mean()
        assert gap == pytest.approx(0.3 / 2.34, abs=0.03)
        left, right = (middle[inner[0] + 20], middle[inner[-1] - 20])
        assert np.abs(left - right).max() > 50
        assert damage.images
    with pytest.raises(ValueError, match="without projection='3d'"):
        plot.stress(problem, "xx", ax=plt.figure().add_subplot(projection="3d"))


def test_without_pyvista(comm, monkeypatch):
    """The run does not end: the axes say what is missing, and the cure."""
    monkeypatch.setitem(sys.modules, "pyvista", None)
    ax = plot.stress(bonded(comm, "hexahedron", n=1))
    if comm.rank == 0:
        assert "pip install pyvista" in ax.texts[0].get_text()
        assert not ax.images
