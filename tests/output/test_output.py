"""Files for ParaView: what is in them is what the problem has."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

from mpi4py import MPI

import numpy as np
import pytest
from support.problems import couple, joined
from support.scenes import LEFT, RIGHT, two_blocks
from support.vtx import read_vtx

import vmdg
from vmdg.base.parallel import global_max, global_sum
from vmdg.meshes import blocks
from vmdg.output.fields import INTERFACE_FIELDS, FieldWriter, InterfaceFields
from vmdg.output.values import VECTORS, facet_modes, scalar

LAW = vmdg.Debonding(strength=100.0, critical_gap=0.2, friction=0.3)
CELLS = pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])


def torn(comm, cell: str) -> vmdg.Problem:
    """The bond is damaged, more so at the top, and slides."""
    scene = blocks(comm, cell, (2, 2, 1))
    problem = couple(scene, LAW)

    def pull(x: np.ndarray, t: float) -> np.ndarray:
        parts = [0.06 + 0.1 * x[1], np.full(x.shape[1], 0.02), np.zeros(x.shape[1])]
        return t * np.stack(parts[: problem.mesh.geometry.dim])

    problem.dirichlet(scene.facet_tags.find(LEFT), 0.0)
    problem.dirichlet(scene.facet_tags.find(RIGHT), pull)
    vmdg.solve(problem, [0.2, 0.4, 0.6, 0.8, 1.0])
    damage = global_max(comm, scalar(problem, 0, "damage").max(initial=0.0))
    assert 0.2 < damage < 1
    return problem


@pytest.mark.filterwarnings("ignore:.*process zone:vmdg.ModelWarning")  # two cells
@CELLS
def test_files(comm, out, cell):
    """One file for the bodies, one for the interface, and all fields in them."""
    problem = torn(comm, cell)
    with FieldWriter(problem, out) as fields:
        fields.write(0.5)
    comm.barrier()
    assert {path.name for path in out.iterdir()} == {"bodies.bp", "interface_0.bp"}
    mean = problem.mean(0)
    if comm.size > 1:
        return
    bodies, interface = read_vtx(out / "bodies.bp"), read_vtx(out / "interface_0.bp")
    points = bodies["geometry"]
    assert bodies["displacement"].shape == points.shape
    assert bodies["stress"].shape == (len(points), 9)
    held = np.isclose(points[:, 0], 0.0)
    assert held.any() and not bodies["displacement"][held].any()
    d = problem.mesh.geometry.dim
    for name in VECTORS:  # facets of equal area, to the last digits of gmsh
        found = interface[name].mean(axis=0)
        assert found[:d] == pytest.approx(getattr(mean, name), rel=1e-9)
    assert interface["damage"].mean() == pytest.approx(mean.softening / LAW.strength, rel=1e-9)
    assert set(interface["mode"].ravel()) == {vmdg.Mode.TENSION}
    for name in ("slip", "fine_scale"):
        assert (interface[name] > 0).all()


@pytest.mark.filterwarnings("ignore:.*process zone:vmdg.ModelWarning")  # two cells
@CELLS
def test_interface_fields(comm, cell):
    """Facet values hold the integrals of the points, corners have the displacement of side 1."""
    problem = torn(comm, cell)
    fields = InterfaceFields(problem, 0, INTERFACE_FIELDS)
    fields.update()
    state, q = problem.state[0], problem.discretization.active[0].quadrature

    def on_facets(name: str) -> np.ndarray:
        function = fields.functions[name]
        dofmap = function.function_space.dofmap
        dofs = dofmap.list[fields.cell_of_facet, 0]
        return function.x.array.reshape(-1, dofmap.index_map_bs)[dofs]

    for name in ("traction", "opening", "gap", "slip", "damage"):
        values = getattr(state, name) if name in VECTORS else scalar(problem, 0, name)[:, None]
        found, exact = global_sum(comm, [q.area @ on_facets(name), q.weights @ values])
        assert found == pytest.approx(exact, rel=1e-12, abs=1e-14), name
    square, area = global_sum(comm, [q.area @ on_facets("fine_scale")[:, 0] ** 2, q.area.sum()])
    mean = vmdg.average(problem, 0, lambda state: scalar(problem, 0, "fine_scale") ** 2)
    assert square / area == pytest.approx(mean, rel=1e-12)
    assert (on_facets("mode") == vmdg.Mode.TENSION).all()

    # What is pulled is side 2: the interface is warped with side 1.
    d = problem.mesh.geometry.dim
    H = np.array([[0.1, 0.2, 0.0], [0.0, -0.1, 0.3], [0.2, 0.0, 0.1]])[:d, :d]
    problem.u.interpolate(lambda x: H @ x[:d])
    facets, dofs = problem.step.activation.facets[0], problem.space.dofmap.list
    only_two = np.setdiff1d(dofs[facets.cells[:, 1]], dofs[facets.cells[:, 0]])
    problem.u.x.array.reshape(-1, d)[only_two] = 7.0
    fields.update()
    u = fields.functions["displacement"]
    X = u.function_space.tabulate_dof_coordinates()[:, :d]
    assert u.x.array.reshape(-1, d) == pytest.approx(X @ H.T, abs=1e-13)


@CELLS
def test_chosen_fields(comm, out, cell):
    """Only what is asked for is written, and an unknown name is told with the known ones."""
    problem = couple(two_blocks(comm, cell), LAW, name="bond")
    with FieldWriter(problem, out / "a", fields="stress") as fields:
        fields.write(0.0)
    with FieldWriter(problem, out / "b", fields=["damage", "mode"]) as fields:
        fields.write(0.0)
    comm.barrier()
    assert [path.name for path in (out / "a").iterdir()] == ["bodies.bp"]
    assert [path.name for path in (out / "b").iterdir()] == ["bond.bp"]
    if comm.size == 1:
        assert "displacement" not in read_vtx(out / "a" / "bodies.bp")
        assert not {"traction", "displacement"} & set(read_vtx(out / "b" / "bond.bp"))
    with FieldWriter(problem, out / "d", fields="stress") as fields:
        for wrong in (np.nan, "0.1", problem):
            with pytest.raises(ValueError, match="must be a finite number, for example pro"):
                fields.write(wrong)
    with pytest.raises(ValueError, match=r"no field 'strain'; choose from \('displacement'"):
        FieldWriter(problem, out / "c", fields=["strain"])
    with pytest.raises(ValueError, match="format = 'xdmf' must be one of"):
        FieldWriter(problem, out / "c", format="xdmf")


def parts_of(folder: Path, t: float) -> list:
    """What meshio reads of a time that the list of a series has."""
    meshio = pytest.importorskip("meshio")
    sets = ElementTree.parse(folder / f"{folder.name}.pvd").iter("DataSet")
    names = [one.get("file") for one in sets if float(one.get("timestep")) == t]
    return [meshio.read(folder / name) for name in names]


@pytest.mark.filterwarnings("ignore:.*process zone:vmdg.ModelWarning")  # two cells
@CELLS
def test_files_of_meshio(comm, out, cell):
    """Numbers of a .vtu series are those of the problem, on both sides of the interface; the list
    is complete while the files are open, and earlier ones stay."""
    problem = torn(comm, cell)
    for _ in range(2):
        with FieldWriter(problem, out, format="vtu") as fields:
            fields.write(0.25)
            fields.write(0.5)
            comm.barrier()
            bodies, bonds = (parts_of(out / name, 0.5) for name in ("bodies", "interface_0"))
    comm.barrier()
    assert {path.name for path in out.iterdir()} == {
        f"{name}{earlier}" for name in ("bodies", "interface_0") for earlier in ("", ".1")
    }
    points = np.concatenate([part.points for part in bodies])
    u = np.concatenate([part.point_data["displacement [mm]"] for part in bodies])
    assert not u[points[:, 0] == 0.0].any()
    opening = np.concatenate([part.point_data["opening [mm]"] for part in bonds])
    inside = np.isclose(points[:, 0], points[:, 0].max() / 2)
    apart = np.ptp(u[inside, 0])
    assert opening[:, 0].max() / 2 < apart < 2 * opening[:, 0].max()
    mean = problem.mean(0)
    d = problem.mesh.geometry.dim
    assert opening.mean(axis=0)[:d] == pytest.approx(mean.opening, rel=1e-9)
    assert np.concatenate([part.point_data["stress [MPa]"] for part in bodies]).shape[1] == 9


#: Ends of the sides whose middles are the first nodes behind the corners.
SIDES = {
    "quad9": (4, [(0, 1), (1, 2), (2, 3), (3, 0)]),
    "tetra10": (4, [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]),
    "hexahedron27": (
        8,
        [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)]
        + [(0, 4), (1, 5), (2, 6), (3, 7)],
    ),
}


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron", "hexahedron"])
def test_nodes_have_the_order_of_vtk(comm, out, cell):
    scene = blocks(comm, cell, (2, 1, 1))
    problem = joined(scene, LAW, degree=2)
    with FieldWriter(problem, out, ["displacement"], format="vtu") as fields:
        fields.write(0.0)
    comm.barrier()
    for part in parts_of(out / "bodies", 0.0):
        (block,) = part.cells
        corners, sides = SIDES[block.type]
        X = part.points[block.data]
        middles = X[:, np.array(sides)].mean(axis=2)
        assert X[:, corners : corners + len(sides)] == pytest.approx(middles, abs=1e-12)


def test_mode_of_a_facet():
    """The mode of the larger part; of halves that differ by rounding the later one."""
    mode = np.array([[0, 3, 3], [0, 2, 2], [0, 2, 4], [0, 0, 2], [4, 4, 4]], dtype=float)
    halves = [0.5, 0.25, 0.25 - 1e-16]
    weights = np.array([[0.3, 0.1, 0.1], halves, halves, [0.2, 0.1, 0.3 + 1e-17], halves])
    empty, facet = vmdg.InterfaceState.empty(2), np.repeat([3, 4, 6, 8, 9], 3)
    given = {"mode": mode.ravel(), "weights": weights.ravel(), "facet": facet}
    assert facet_modes(replace(empty, **given)).tolist() == [0, 2, 0, 2, 4]
    assert facet_modes(empty).tolist() == []


# Files that are there, that are gone, that are too large


def at_rest(comm) -> vmdg.Problem:
    return couple(blocks(comm, "quadrilateral", (4, 4)), LAW)


def test_earlier_files_stay(comm, out):
    """Those of a run that goes on get a number, and have all that was in them."""
    problem = at_rest(comm)
    for t in (1.0, 2.0, 3.0):
        with FieldWriter(problem, out, "displacement") as fields:
            fields.write(t)
        problem.u.x.array[:] += 1.0
    comm.barrier()
    assert {path.name for path in out.iterdir()} == {"bodies.bp", "bodies.1.bp", "bodies.2.bp"}
    if comm.size == 1:
        names = ("bodies.1", "bodies.2", "bodies")
        found = [read_vtx(out / f"{name}.bp")["displacement"][0, 0] for name in names]
        assert found == [0.0, 1.0, 2.0]


def test_one_writer_a_folder(comm, out):
    """And none after its end."""
    problem = at_rest(comm)
    with FieldWriter(problem, out) as fields:
        with pytest.raises(OSError, match=r"cannot be written: process .* is writing it"):
            FieldWriter(problem, out)
        fields.write(1.0)
    with pytest.raises(ValueError, match="are closed; write before close"):
        fields.write(2.0)
    fields.close()


def test_folder_of_fields_that_cannot_be(comm, out):
    """All ranks are told."""
    if comm.rank == 0:
        (out / "file").write_text("")
    comm.barrier()
    with pytest.raises(OSError, match=r"fields in .*file.fields cannot be written"):
        FieldWriter(at_rest(comm), out / "file" / "fields")


GONE = """
import resource, shutil, signal, sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import patch
import vmdg
from mpi4py import MPI
from vmdg.base import agreement
from vmdg.meshes import blocks

comm, folder = MPI.COMM_WORLD, Path(sys.argv[1])
n = 60 if sys.argv[2] == "midway" else 4
mesh, cells, _ = blocks(comm, "quadrilateral", (n, n))
bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(10.0, 0.1))
body = vmdg.NeoHookean(E=1e3, nu=0.3)
problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond])
fields = vmdg.FieldWriter(problem, folder)
fields.write(0.0)
full = patch("shutil.disk_usage", shutil.disk_usage)
if sys.argv[2] == "gone":
    comm.barrier()
    if comm.rank == 0:
        shutil.rmtree(folder)
    comm.barrier()
elif sys.argv[2] == "midway":
    agreement.PATIENCE = 1.0  # s
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (9_000_000, 9_000_000))
else:
    full = patch("shutil.disk_usage", lambda path: SimpleNamespace(free=0))
with full:
    try:
        for t in range(1, 20 if sys.argv[2] == "midway" else 2):
            fields.write(float(t))
    except OSError as error:
        print("told:", error, flush=True)
fields.close()
print("end", flush=True)
"""


def run_gone(folder: Path, what: str, ranks: int) -> subprocess.CompletedProcess:
    """The script above, on ranks of its own."""
    root = str(Path(__file__).resolve().parents[2])
    path = os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])
    command = ["mpirun", "-n", str(ranks), sys.executable, "-c", GONE, str(folder), what]
    environment = os.environ | {"PYTHONPATH": path}
    return subprocess.run(
        command, env=environment, capture_output=True, text=True, check=False, timeout=120
    )


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
@pytest.mark.parametrize(
    ("what", "words"),
    [pytest.param("gone", "was removed", marks=pytest.mark.long), ("full", "the disk is full")],
)
def test_disk_fails(tmp_path, what, words):
    """A clear error on every rank, and the process ends as it should."""
    done = run_gone(tmp_path / "f", what, 2)
    assert done.returncode == 0, done.stderr[-2000:]
    assert done.stdout.count(words) == done.stdout.count("end") == 2


@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts its own ranks")
@pytest.mark.parametrize("ranks", [pytest.param(1, marks=pytest.mark.long), 2])
def test_disk_that_gets_full_midway(tmp_path, ranks):
    """What writes knows, and not before: an error alone, the end of the job on several ranks."""
    done = run_gone(tmp_path / "f", "midway", ranks)
    if ranks == 1:
        assert done.returncode == 0, done.stderr[-2000:]
        assert "told: fields in" in done.stdout
        assert "cannot be written" in done.stdout
    else:
        assert done.returncode != 0
        assert "couldn't write to file" in done.stderr
        assert "the job is aborted on all ranks" in done.stderr
