"""Meshes from files give the problem that the same mesh gives from gmsh directly."""

from __future__ import annotations

from pathlib import Path

import gmsh
import numpy as np
import pytest
from support.problems import joined

import vmdg
from vmdg.meshes import blocks, gmsh_model, read_mesh, write_mesh
from vmdg.meshes.two_blocks import build_blocks

LAW = vmdg.Debonding(strength=60.0, critical_gap=0.2)


@pytest.fixture(scope="module")
def folder(comm, tmp_path_factory) -> Path:
    """One folder for all ranks."""
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
    """The blocks as a file of gmsh."""
    if comm.rank == 0:
        with gmsh_model.model("blocks") as model:
            build_blocks(model, cell, (3, 3, 3), 2.0, 1.0, 1.0, (1.0, 1.0))
            gmsh.write(str(path))
    comm.barrier()


@pytest.mark.parametrize("kind", ["msh", "xdmf"])
@pytest.mark.parametrize("cell", ["triangle", "hexahedron"])
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
    with pytest.raises(ValueError, match=r"no file .*missing\.msh"):
        read_mesh(folder / "missing.msh", comm)
    with pytest.raises(ValueError, match="must end in"):
        read_mesh(folder / "mesh.vtk", comm)
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
    with pytest.raises(ValueError, match="no physical group of dimension 2"):
        read_mesh(path, comm)
    write_mesh(blocks(comm, "triangle"), folder / "named.xdmf")
    with pytest.raises(ValueError, match="no tags 'bodies'"):
        read_mesh(folder / "named.xdmf", comm, cell_tags="bodies")
