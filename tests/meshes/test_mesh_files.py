"""Meshes from files give the problem that the same mesh gives from gmsh directly."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np
import pytest
from dolfinx.mesh import CellType, create_unit_cube, meshtags
from support.problems import joined

import vmdg
from vmdg.meshes import blocks, gmsh_model, read_mesh, write_mesh
from vmdg.meshes.two_blocks import build_blocks

LAW = vmdg.Debonding(strength=60.0, critical_gap=0.2)


@pytest.fixture(scope="module")
def folder(comm, tmp_path_factory) -> Path:
    return Path(comm.bcast(str(tmp_path_factory.mktemp("meshes"))))


def pulled(tagged) -> tuple[vmdg.Problem, np.ndarray]:
    """Two blocks pulled apart and sheared until some points are damaged; reactions at both ends."""
    problem = joined(tagged, LAW)
    left, right = tagged.facet_tags.find(1), tagged.facet_tags.find(2)
    problem.dirichlet(left, 0.0)
    problem.dirichlet(right, lambda t: (0.07 * t, *[0.02 * t] * (tagged.mesh.geometry.dim - 1)))
    vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(relative_tolerance=1e-11))
    return problem, np.concatenate([problem.reaction(left), problem.reaction(right)])


def write_msh(comm, path: Path, cell: str) -> None:
    if comm.rank == 0:
        with gmsh_model.model("blocks") as model:
            build_blocks(model, cell, (3, 3, 3), 2.0, 1.0, 1.0, (1.0, 1.0))
            gmsh.write(str(path))
    comm.barrier()


@pytest.mark.parametrize(("cell", "kind"), [("triangle", "msh"), ("hexahedron", "xdmf")])
def test_same_problem(comm, folder, cell, kind):
    """Dofs, reactions and dissipated energy; the tolerance of the steps is 1e-11."""
    built = blocks(comm, cell, (3, 3, 3))
    path = folder / f"{cell}.{kind}"
    if kind == "msh":
        write_msh(comm, path, cell)
    else:
        write_mesh(built, path)
    found, expected = pulled(read_mesh(path, comm)), pulled(built)
    sizes = [p.space.dofmap.index_map.size_global for p, _ in (found, expected)]
    assert sizes[0] == sizes[1]
    assert expected[0].energy().dissipated > 0
    assert found[0].energy().dissipated == pytest.approx(expected[0].energy().dissipated, rel=1e-9)
    assert found[1] == pytest.approx(expected[1], abs=1e-9 * np.abs(expected[1]).max())


def test_bad_files(comm, folder):
    """Errors name the file and the remedy, on all ranks."""
    with pytest.raises(ValueError, match=r"missing\.msh: there is no file"):
        read_mesh(folder / "missing.msh", comm)
    with pytest.raises(ValueError, match="suffix must be"):
        read_mesh(folder / "mesh.stp", comm)
    with pytest.raises(ValueError, match="must end in"):
        write_mesh(blocks(comm, "triangle"), folder / "mesh.vtk")
    path = folder / "untagged.msh"
    if comm.rank == 0:
        with gmsh_model.model("untagged") as model:
            model.occ.addRectangle(0, 0, 0, 1, 1)
            model.occ.synchronize()
            model.mesh.generate(2)
            gmsh.write(str(path))
    comm.barrier()
    with pytest.raises(ValueError, match=r"untagged\.msh: .*no physical group of dimension 2"):
        read_mesh(path, comm)
    write_mesh(blocks(comm, "triangle"), folder / "named.xdmf")
    with pytest.raises(ValueError, match="no tags 'bodies'"):
        read_mesh(folder / "named.xdmf", comm, cell_tags="bodies")


def two_squares(model, *groups: int) -> None:
    """Unit squares side by side; these have physical groups."""
    occ = model.occ
    occ.fragment([(2, occ.addRectangle(0, 0, 0, 1, 1))], [(2, occ.addRectangle(1, 0, 0, 1, 1))])
    occ.synchronize()
    for group in groups:
        model.addPhysicalGroup(2, [group], group)


def triangles_and_quadrilaterals(model) -> int:
    two_squares(model, 1, 2)
    model.mesh.setTransfiniteSurface(1)
    model.mesh.setRecombine(2, 1)
    return 2


def prisms(model) -> int:
    square = model.occ.addRectangle(0, 0, 0, 1, 1)
    model.occ.extrude([(2, square)], 0, 0, 1, [2], recombine=True)
    model.occ.synchronize()
    model.addPhysicalGroup(3, [1], 1)
    return 3


def edges_of_a_lost_body(model) -> int:
    """The second square has no group, its edges have one."""
    two_squares(model, 1)
    model.addPhysicalGroup(1, [entity for _, entity in model.getEntities(1)], 5)
    return 2


def tilted(model) -> int:
    """A square turned by 60 degrees about the x axis."""
    square = model.occ.addRectangle(0, 0, 0, 1, 1)
    model.occ.rotate([(2, square)], 0, 0, 0, 1, 0, 0, np.pi / 3)
    model.occ.synchronize()
    model.addPhysicalGroup(2, [square], 1)
    return 2


#: Meshes that used to end in MPI_ABORT or a KeyError: what is said of the model and of its file.
WRONG_CELLS = {
    tilted: (
        r"^the nodes of the 2D mesh differ by 0\.866\d* in z .*; plane=\(\(1, 0, 0\), ",
        r"tilted\.msh: the nodes of the 2D mesh differ by 0\.866\d* in z",
    ),
    triangles_and_quadrilaterals: (
        r"surface 2 .* type Triangle 3, surface 1 .* Quadrilateral 4; .*\(mesh.setRecombine\)",
    )
    * 2,
    prisms: (r"volume 1 .* type Prism 6; .* one of triangle, .* extrude without recombine",) * 2,
    edges_of_a_lost_body: (
        r"surface 2 .* is meshed but in no physical group, .*\(addPhysicalGroup",
        r"curve \d .* the adjacent body has no cells here, .*\(addPhysicalGroup",
    ),
}


@pytest.mark.parametrize("kind", ["model", "file"])
@pytest.mark.parametrize("build", WRONG_CELLS, ids=lambda build: build.__name__)
def test_wrong_cells(comm, folder, build, kind):
    """Refused on every rank, by what is wrong with which part of the model."""
    message = WRONG_CELLS[build][kind == "file"]
    path = folder / f"{build.__name__}.msh"
    with gmsh_model.model("wrong") as model:
        dim = 0
        if comm.rank == 0:
            dim = build(model)
            model.mesh.generate(dim)
            gmsh.write(str(path))
        if kind == "model":
            with pytest.raises(ValueError, match=message):
                gmsh_model.distribute(model, comm, comm.bcast(dim))
            return
    comm.barrier()
    with pytest.raises(ValueError, match=message):
        read_mesh(path, comm)


def test_prisms_of_dolfinx(comm):
    """A problem refuses cells that it has no bubbles for."""
    mesh = create_unit_cube(comm, 1, 1, 2, CellType.prism)
    cells = np.arange(mesh.topology.index_map(3).size_local, dtype=np.int32)
    tags = meshtags(mesh, 3, cells, np.ones_like(cells))
    with pytest.raises(ValueError, match="cells of type prism are not supported; use one of"):
        vmdg.Problem(mesh, tags, {1: vmdg.NeoHookean(E=1.0, nu=0.3)}, [])
