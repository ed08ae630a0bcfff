"""Files of other programs are read right, or refused in words on every rank."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gmsh
import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.io import XDMFFile
from dolfinx.mesh import compute_midpoints, create_unit_square, meshtags
from support import foreign
from support.foreign import CELLS, FACETS, POINTS

import vmdg
from vmdg.meshes import read_mesh, write_mesh

meshio = pytest.importorskip("meshio")
pytest.importorskip("h5py")

#: What the blocks are: area or volume by group, and place of the facets by group.
BODIES, PLACES = {"left": 1.0, "right": 2.0}, {"join": 1.0, "end": 0.0}


@dataclass
class Read:
    """A file that is read: how it is written, what it has, and how it is asked for.

    Attributes:
        write: Writes it.
        bodies: Area or volume by name or tag of the cells.
        places: x of all facets by name or tag.
        given: Arguments of ``read_mesh``.
        ending: Of its name.
        said: The warning.
    """

    write: Callable[[Path], object]
    ending: str = "msh"
    bodies: dict = field(default_factory=lambda: BODIES)
    places: dict = field(default_factory=lambda: PLACES)
    given: dict[str, Any] = field(default_factory=dict)
    said: str = ""


@dataclass
class Refused:
    """A file that is refused: how it is written, the words, and how it is asked for."""

    write: Callable[[Path], object]
    words: str
    ending: str = "msh"
    given: dict[str, Any] = field(default_factory=dict)


def by_meshio(form: str | None = None, order: int = 1, data: str = "tag", **options) -> Callable:
    """The blocks in the plane, written by meshio with whole numbers as tags."""
    names = {"gmsh22": "gmsh:physical"}
    name = names.get(form, data)

    def write(path: Path) -> None:
        given = {**CELLS, **FACETS}
        points, of = POINTS, given
        if order == 2:
            points, (of,) = foreign.second(POINTS, given)
        kinds = {3: "triangle", 6: "triangle6"}, {2: "line", 3: "line3"}
        cells = [(kinds[0][3 * order], of["left"] + of["right"])]
        cells.append((kinds[1][order + 1], of["join"] + of["end"]))
        values = [np.array([1, 1, 2, 2]), np.array([1, 2])]
        cell_data = {name: values}
        if form == "gmsh22":
            cell_data["gmsh:geometrical"] = [np.ones_like(tags) for tags in values]
        field_data = {"left": [1, 2], "right": [2, 2], "join": [1, 1], "end": [2, 1]}
        mesh = meshio.Mesh(points, cells, cell_data=cell_data, field_data=field_data)
        meshio.write(path, mesh, file_format=form, **options)

    return write


#: Groups of data that have no names.
BY_TAG = {"bodies": {1: 1.0, 2: 2.0}, "places": {1: 1.0, 2: 0.0}}


def changed(write: Callable, *changes: tuple[str, str]) -> Callable:
    def write_changed(path: Path) -> None:
        write(path)
        text = path.read_text()
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        path.write_text(text)

    return write_changed


def cut(write: Callable, share: float, of: str | None = None) -> Callable:
    """The same file, or the one beside it of another ending, cut short."""

    def write_cut(path: Path, *comm) -> None:
        write(path, *comm)
        if comm and comm[0].rank:
            return
        path = path.with_suffix(of) if of else path
        content = path.read_bytes()
        path.write_bytes(content[: int(share * len(content))])

    write_cut.collective = getattr(write, "collective", False)
    return write_cut


def text(words: str) -> Callable:
    return lambda path: path.write_text(words)


# -------------------------------------------------------------------------------------- gmsh


def in_parts(ghosts: bool = False, split: bool = False) -> None:
    gmsh.option.setNumber("Mesh.PartitionCreateGhostCells", ghosts)
    gmsh.option.setNumber("Mesh.PartitionSplitMeshFiles", split)
    gmsh.model.mesh.partition(3)


def a_part(version: float) -> Callable:
    def write(path: Path) -> None:
        foreign.of_gmsh(path, lambda: in_parts(split=True), version)
        path.with_name(f"{path.stem}_1.msh").rename(path)

    return write


def of_neper(dim: int, order: int = 1, interface: str = "continuous") -> Callable:
    """The blocks as grains."""

    def write(path: Path) -> None:
        points, cells, facets = (POINTS, CELLS, FACETS) if dim == 2 else foreign.solid()
        flat = {}
        if interface != "continuous":
            points, cells, facets, flat = foreign.apart(points, cells, facets)
        if order == 2:
            points, (cells, facets) = foreign.second(points, cells, facets)
        kinds = {(2, 1): (2, 1), (3, 1): (4, 2), (2, 2): (9, 8), (3, 2): (11, 9)}[dim, order]
        groups = [(kinds[1], facets), (kinds[0], cells)]
        if interface == "cohesive":
            groups.append(({2: 3, 3: 6}[dim], flat))
        foreign.neper(path, points, *groups)

    return write


def turned(degree: int = 1, bodies: int = 2, recombined: bool = False) -> Callable:
    """The cells of the first blocks go the other way round."""

    def turn() -> None:
        if recombined:
            gmsh.model.mesh.recombine()
        gmsh.model.mesh.setOrder(degree)
        gmsh.model.mesh.reverse([(2, body) for body in range(1, bodies + 1)])

    return lambda path: foreign.of_gmsh(path, turn, 2.2)


def with_corners_turned(path: Path) -> None:
    """One cell of degree 2 has its corners the other way round, and its other nodes as before."""
    turned(2, 0)(path)
    lines = path.read_text().splitlines()
    of_cells = [n for n, line in enumerate(lines) if line.split()[1:2] == ["9"]]
    words = lines[of_cells[-1]].split()
    words[5:8] = reversed(words[5:8])
    lines[of_cells[-1]] = " ".join(words)
    path.write_text("\n".join(lines))


def in_negative_groups() -> None:
    """The right block and its end are in their groups the other way round."""
    g = gmsh.model
    for dim, tag, name in ((2, 2, "right"), (1, 1, "end")):
        entities = g.getEntitiesForPhysicalGroup(dim, tag)
        g.removePhysicalGroups([(dim, tag)])
        g.addPhysicalGroup(dim, -entities, tag, name)


def two_groups() -> None:
    gmsh.model.addPhysicalGroup(2, [1, 2], 7, "all")


def rotated(*angles: tuple[int, float]) -> Callable:
    def turn() -> None:
        for axis, angle in angles:
            c, s, rotation = np.cos(angle), np.sin(angle), np.eye(3)
            one, two = [n for n in range(3) if n != axis]
            rotation[[one, one, two, two], [one, two, one, two]] = c, -s, s, c
            affine = np.column_stack([rotation, np.zeros(3)])
            gmsh.model.mesh.affineTransform(affine.ravel().tolist())

    return lambda path: foreign.of_gmsh(path, turn)


def on_a_roof(path: Path) -> None:
    points = POINTS + np.outer(POINTS[:, 0] > 1, [0, 0, 1])
    foreign.neper(path, points, (2, CELLS))


def of_universal(path: Path) -> None:
    """Groups of elements of I-DEAS, as Salome writes them too."""
    option = gmsh.option.setNumber
    foreign.of_gmsh(path, lambda: option("Mesh.SaveGroupsOfElements", 1))


def incomplete(path: Path, rise: float = 0.0) -> None:
    """Quadrilaterals of 8 nodes; the nodes in the middle of edges at the bottom rise."""
    with foreign.model("serendipity") as g:
        gmsh.option.setNumber("Mesh.SecondOrderIncomplete", 1)
        g.occ.addRectangle(0, 0, 0, 1, 1)
        g.occ.synchronize()
        g.addPhysicalGroup(2, [1])
        g.mesh.setTransfiniteSurface(1)
        g.mesh.setRecombine(2, 1)
        for curve in range(1, 5):
            g.mesh.setTransfiniteCurve(curve, 2)
        g.mesh.generate(2)
        g.mesh.setOrder(2)
        g.mesh.setNode(g.mesh.getNodes(1, 1)[0][0], [0.5, rise, 0.0], [])
        gmsh.write(str(path))


def of_many_nodes(path: Path) -> None:
    """36 nodes on a square of 1 mm."""
    with foreign.model("many") as g:
        g.occ.addRectangle(0, 0, 0, 1, 1)
        g.occ.synchronize()
        g.addPhysicalGroup(2, [1])
        g.mesh.setTransfiniteSurface(1)
        for curve in range(1, 5):
            g.mesh.setTransfiniteCurve(curve, 6)
        g.mesh.generate(2)
        gmsh.write(str(path))


GMSH = {
    f"gmsh {version}": Read(lambda path, v=version: foreign.of_gmsh(path, version=v))
    for version in (2.2, 4.0, 4.1)
}
for version in (2.2, 4.1):
    GMSH[f"gmsh {version} in parts"] = Read(
        lambda path, v=version: foreign.of_gmsh(path, lambda: in_parts(v == 4.1), v)
    )
    GMSH[f"gmsh {version} one part"] = Refused(a_part(version), "one part of a mesh split")
    GMSH[f"gmsh {version} no groups"] = Refused(
        lambda path, v=version: foreign.of_gmsh(path, version=v, groups=False),
        r"no group of cells .* groups='entities' makes every surface of it one \(2 here\)",
    )
    GMSH[f"gmsh {version} surfaces as groups"] = Read(
        lambda path, v=version: foreign.of_gmsh(path, version=v, groups=False),
        bodies={"surface 1": 1.0, "surface 2": 2.0, 1: 1.0, 2: 2.0},
        places={"curve 2": 1.0, 2: 1.0},
        given={"groups": "entities"},
    )
    GMSH[f"gmsh {version} groups the other way round"] = Read(
        lambda path, v=version: foreign.of_gmsh(path, in_negative_groups, v)
    )
for degree, bodies, recombined in ((1, 1, False), (1, 2, True), (2, 1, True), (2, 2, False)):
    GMSH[f"gmsh degree {degree}, {bodies} turned{', recombined' * recombined}"] = Read(
        turned(degree, bodies, recombined)
    )
GMSH |= {
    "gmsh, corners of a triangle turned": Refused(
        with_corners_turned, "Triangle 6 do not have their nodes in the order of gmsh"
    ),
    "gmsh 4.1 binary": Read(
        lambda path: foreign.of_gmsh(path, lambda: gmsh.option.setNumber("Mesh.Binary", 1))
    ),
    "gmsh 2.2 of meshio": Read(by_meshio("gmsh22", binary=False)),
    "gmsh 2.2 of meshio, degree 2": Read(by_meshio("gmsh22", order=2)),
    "gmsh 4.1, two groups": Refused(
        lambda path: foreign.of_gmsh(path, two_groups),
        r"cells are both in 'left' and in 'all', .* groups=\[\.\.\.\]",
    ),
    "gmsh, a group of two": Read(
        lambda path: foreign.of_gmsh(path, two_groups),
        given={"groups": ["left", "right", "join", "end"]},
    ),
    "gmsh, a wrong group": Refused(
        lambda path: foreign.of_gmsh(path),
        "there is no group 'centre'; it has .*'left'",
        given={"groups": ["centre"]},
    ),
    "gmsh, a group left out": Refused(
        lambda path: foreign.of_gmsh(path),
        r"cells, the first in surface 2, are in no group and would be lost",
        given={"groups": ["left"]},
    ),
    "gmsh, a distance beyond the mesh": Refused(
        of_many_nodes,
        r"more than 20 others within 100; is merge= in its units",
        given={"merge": 100.0},
    ),
    "gmsh serendipity": Read(
        incomplete, bodies={1: 1.0}, places={}, said="cells of 8 nodes become cells of 4 nodes"
    ),
    "gmsh, faces curved with 8 nodes": Read(
        lambda path: incomplete(path, 0.1),
        bodies={1: 1.0 - 0.1 * 2 / 3},
        places={},
        said="of 9 nodes",
    ),
    # gmsh names the groups of cells; those of facets with the same numbers have these only.
    "universal file": Read(of_universal, "unv", places={2: 1.0, 1: 0.0}),
    "universal file of another program": Refused(text("<html>\n"), "first line is not -1", "unv"),
    "gmsh cut in the elements": Refused(cut(foreign.of_gmsh, 0.8), "truncated"),
    "gmsh empty": Refused(text(""), "the file is empty"),
    "gmsh nothing in it": Refused(
        text("$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$EndElements\n"), "has no cells|cannot read"
    ),
    "msh of another program": Refused(
        text('(0 "GAMBIT to Fluent File")\n(2 2)\n'), r"not a gmsh file: it begins with '\(0 \"GAM"
    ),
}

# -------------------------------------------------------------------------------------- planes


PLANES = {
    "section in x-z": Refused(
        rotated((0, np.pi / 2)), r"differ by 1 in z .*; plane='xz' maps them"
    ),
    "section in x-z mapped": Read(rotated((0, np.pi / 2)), given={"plane": "xz"}),
    "section in the wrong plane": Refused(
        rotated((0, np.pi / 2)), "differ by 3 across plane='yz' .*'xz'", given={"plane": "yz"}
    ),
    "tilted": Refused(
        rotated((0, np.pi / 3)), r"differ by 0\.866\d* in z.*\(\(1, 0, 0\), \(0, 0\.5, 0\.8660"
    ),
    "tilted and mapped": Read(
        rotated((0, np.pi / 3)), given={"plane": ((1, 0, 0), (0, 0.5, np.sqrt(0.75)))}
    ),
    "surface in space": Refused(on_a_roof, "lie in no plane .* mesh the volume"),
    "no plane": Refused(foreign.of_gmsh, "plane='xx' is not a plane", given={"plane": "xx"}),
    "plane of a body": Refused(
        lambda path: foreign.neper(path, foreign.solid()[0], (4, foreign.solid()[1])),
        "for 2D meshes",
        given={"plane": "xz"},
    ),
}

# -------------------------------------------------------------------------------------- XDMF


def of_dolfinx(facets: bool = True) -> Callable:
    """A mesh and tags with names of their own; written by all ranks."""

    def write(path: Path, comm) -> None:
        mesh = create_unit_square(comm, 2, 2)
        mesh.name = "plate"
        with XDMFFile(comm, str(path), "w") as file:
            file.write_mesh(mesh)
            for dim, name in ((2, "bodies"), (1, "facet_tags"))[: 1 + facets]:
                mesh.topology.create_connectivity(dim, 2)
                count = mesh.topology.index_map(dim).size_local
                tags = meshtags(mesh, dim, np.arange(count), np.full(count, dim, dtype=np.int32))
                tags.name = name
                file.write_meshtags(tags, mesh.geometry)

    write.collective = True
    return write


def tetrahedra(order: int, first_tag: int, dtype: type = np.float64) -> Callable:
    def write(path: Path) -> None:
        points, cells, _ = foreign.solid()
        if order == 2:
            points, (cells,) = foreign.second(points, cells)
            # VTK has the last two nodes of gmsh in the other order.
            cells = {name: [(*c[:8], c[9], c[8]) for c in group] for name, group in cells.items()}
        tags = first_tag + np.repeat([0, 1], [len(cells["left"]), len(cells["right"])])
        kind = {1: "tetra", 2: "tetra10"}[order]
        both = [(kind, cells["left"] + cells["right"])]
        mesh = meshio.Mesh(points.astype(dtype), both, cell_data={"MaterialIDs": [tags]})
        meshio.write(path, mesh)

    return write


def two_data(path: Path) -> None:
    data = {"material": [np.array([1, 1, 2, 2])], "part": [np.array([4, 4, 4, 4])]}
    cells = [("triangle", CELLS["left"] + CELLS["right"])]
    meshio.write(path, meshio.Mesh(POINTS[:, :2], cells, cell_data=data))


XDMF = {
    "XDMF of meshio inline": Read(by_meshio(data_format="XML"), "xdmf", **BY_TAG),
    "XDMF of meshio HDF5": Read(by_meshio(data_format="HDF"), "xdmf", **BY_TAG),
    "XDMF of meshio, degree 2": Read(tetrahedra(2, 5), "xdmf", {5: 1.0, 6: 2.0}, {}),
    "XDMF, no such tags": Refused(
        by_meshio(), "no tags 'bodies'; .* cell data are 'tag'", "xdmf", {"cell_tags": "bodies"}
    ),
    "XDMF, two data": Refused(
        two_data, "several data .* 'material', 'part': .* cell_tags='material'", "xdmf"
    ),
    "XDMF, one of two data": Read(
        two_data, "xdmf", {1: 1.0, 2: 2.0}, {}, {"cell_tags": "material"}
    ),
    "XDMF cut short": Refused(cut(by_meshio(data_format="XML"), 0.7), "not a complete XML", "xdmf"),
    "XDMF, HDF5 cut short": Refused(cut(by_meshio(), 0.5, ".h5"), "meshio cannot read", "xdmf"),
    "XDMF without its HDF5": Refused(
        lambda path: (by_meshio()(path), path.with_suffix(".h5").unlink()), "is missing", "xdmf"
    ),
    "XDMF of DOLFINx": Read(of_dolfinx(), "xdmf", {2: 1.0}, {1: None}, {"cell_tags": "bodies"}),
    "XDMF of DOLFINx, HDF5 cut short": Refused(
        cut(of_dolfinx(), 0.5, ".h5"), "DOLFINx cannot read it", "xdmf", {"cell_tags": "bodies"}
    ),
    "XDMF of DOLFINx, names": Refused(
        of_dolfinx(), "no tags 'cell_tags'; its grids are 'plate', 'bodies', 'facet_tags'", "xdmf"
    ),
    "XDMF of DOLFINx, merge": Refused(
        of_dolfinx(), "files of other programs", "xdmf", {"merge": True}
    ),
}

# -------------------------------------------------------------------------------------- Neper


NEPER = {
    "Neper 2D discontinuous": Read(of_neper(2, 1, "discontinuous"), given={"merge": True}),
    "Neper 2D left apart": Read(of_neper(2, 1, "discontinuous"), given={"merge": False}),
    "Neper 2D, nodes with gaps": Read(
        changed(
            of_neper(2),
            ("\n6 3.0", "\n60 3.0"),
            (" 2 3 6\n", " 2 3 60\n"),
            (" 2 6 5\n", " 2 60 5\n"),
        )
    ),
    "Neper 3D order 2, discontinuous": Read(of_neper(3, 2, "discontinuous"), given={"merge": True}),
    "Neper 3D cohesive": Read(of_neper(3, 1, "cohesive"), given={"merge": True}),
    "Neper 3D cohesive, not merged": Refused(
        of_neper(3, 1, "cohesive"), "coincident nodes, like .* cohesive .* merge=True drops"
    ),
    "Neper 3D, too far": Refused(of_neper(3), "are not flat; collapsed", given={"merge": 1.0}),
    "Neper 3D, a distance in words": Refused(
        of_neper(3), "merge='yes' is not a dist", given={"merge": "yes"}
    ),
}

# -------------------------------------------------------------------------------------- Abaqus

#: Surfaces of the faces of elements, as Abaqus/CAE writes them, of the blocks in the plane.
SURFACES = """
*Elset, elset=_join_S2, internal
 1,
*Surface, type=ELEMENT, name=join
_JOIN_S2, S2
*Surface, name=end
2, S3
*Nset, nset=corner, generate
 1, 4, 3
"""


def inp(kind: str = "CPE3", more: str = SURFACES, cells: dict = CELLS) -> Callable:
    return lambda path: path.write_text(foreign.abaqus(kind, POINTS, cells, more))


def inp_cohesive(path: Path) -> None:
    points, cells, _, flat = foreign.apart(*foreign.solid())
    path.write_text(foreign.abaqus("C3D4", points, cells | flat))


def inp_solid(path: Path) -> None:
    """Tetrahedra of degree 2 and surfaces of them."""
    points, cells, facets = foreign.solid()
    lines = []
    faces = [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)]
    for name, triangles in facets.items():
        lines.append(f"*Surface, type=element, name={name}")
        for number, cell in enumerate(cells["left"], 1):
            for face, corners in enumerate(faces, 1):
                if {cell[c] for c in corners} in map(set, triangles):
                    lines.append(f"{number}, S{face}")
    points, (cells,) = foreign.second(points, cells)
    # Abaqus has the last two nodes of gmsh in the other order.
    cells = {name: [(*c[:8], c[9], c[8]) for c in group] for name, group in cells.items()}
    path.write_text(foreign.abaqus("C3D10M", points, cells, "\n".join(lines)))


def hexahedra_20(bulge: float) -> Callable:
    """Two bricks of 20 nodes; the middles of the edges of the joint bulge out in x."""

    def write(path: Path) -> None:
        points, (_, one, two), lines = [], ({}, [], []), []
        corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
        corners += [(x, y, 1) for x, y, _ in corners]
        edges = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)]
        edges += [(0, 4), (1, 5), (2, 6), (3, 7)]
        for nodes, start, length in ((one, 0, 1), (two, 1, 2)):
            at = np.array(corners, dtype=float) * [length, 1, 1] + [start, 0, 0]
            middles = np.array([at[list(edge)].mean(axis=0) for edge in edges])
            middles[:, 0] += bulge * (middles[:, 0] == 1)
            for x in [*at, *middles]:
                place = next((n for n, y in enumerate(points) if np.allclose(x, y)), len(points))
                points += [x] * (place == len(points))
                nodes.append(place)
        more = "*Surface, name=join\n1, S4\n*Surface, name=end\n1, S6\n"
        more += "*Nset, nset=tip\n1, 4\n" + "\n".join(lines)
        cells = {"left": [tuple(one)], "right": [tuple(two)]}
        path.write_text(foreign.abaqus("C3D20R", np.array(points), cells, more))

    return write


def inp_sections(path: Path) -> None:
    """A section without a set first, sets by range and by other sets, lines that go on.

    meshio 5.3.5 gives the second section's set to the cells of the first one.
    """
    path.write_text(
        foreign.abaqus("CPS3", POINTS, CELLS)
        .replace(", elset=left", "")
        .replace("type=CPS3, elset=right", "elset=right,\n type=CPS3")
        + "*Elset, elset=first, generate\n1, 2, 1\n*Elset, elset=left\nfirst\n"
    )


ABAQUS = {
    "Abaqus": Read(inp(), "inp"),
    "Abaqus in a part": Read(
        lambda path: path.write_text(
            foreign.abaqus(
                "CPS3", POINTS, CELLS, "*End Part\n*Assembly\n*Instance, part=A" + SURFACES
            ).replace("*Node\n", "*Part, name=A\n*Node\n")
        ),
        "inp",
    ),
    "Abaqus in space, degree 2": Read(inp_solid, "inp"),
    "Abaqus C3D20R": Read(hexahedra_20(0.0), "inp", said="become cells of 8 nodes"),
    # The integral of the function of a node on an edge is 1/3 of the face.
    "Abaqus C3D20R, degree 2": Read(
        hexahedra_20(0.1),
        "inp",
        {"left": 1 + 0.4 / 3, "right": 2 - 0.4 / 3},
        {"end": 0.0},
        said="27 nodes",
    ),
    "Abaqus cohesive": Read(inp_cohesive, "inp", places={"bound1": 1.0}, given={"merge": True}),
    "Abaqus cohesive, not merged": Refused(inp_cohesive, "merge=True drops them", "inp"),
    "Abaqus sets of sets": Refused(inp_sections, r"both in 'first' and in 'left'|both in", "inp"),
    "Abaqus sets chosen": Read(inp_sections, "inp", places={}, given={"groups": ["left", "right"]}),
    "Abaqus without sets": Read(
        lambda path: path.write_text(
            foreign.abaqus("CPS3", POINTS, CELLS)
            .replace(", elset=left", "")
            .replace(", elset=right", "")
        ),
        "inp",
        {1: 3.0, "surface 1": 3.0},
        {},
        {"groups": "entities"},
    ),
    "Abaqus, two parts": Refused(
        inp(more="*Instance, name=A\n*Instance, name=B"), "noPartsInputFile=ON", "inp"
    ),
    "Abaqus, a part moved": Refused(inp(more="*Instance, name=A\n1., 0., 0."), "is moved", "inp"),
    "Abaqus, include": Refused(inp(more="*Include, input=b.inp"), r"\*INCLUDE is not read", "inp"),
    "Abaqus, springs": Refused(
        changed(inp(), ("type=CPE3, elset=left", "type=SPRINGA")),
        "type SPRINGA are not read",
        "inp",
    ),
    "Abaqus serendipity": Refused(
        inp("CPE8R", cells={"left": [(0, 1, 4, 3, 0, 1, 4, 3)]}), "coincident nodes", "inp"
    ),
    "Abaqus cut short": Refused(
        lambda path: path.write_text(
            foreign.abaqus("CPS3", POINTS, CELLS).partition("2, 1, 5")[0] + "2, 1\n"
        ),
        "truncated: they have 3 nodes each, and 2 numbers",
        "inp",
    ),
    "Abaqus, a lost node": Refused(
        changed(inp(), ("\n5, 1, 1, 0", "")), "element 1 has node 5", "inp"
    ),
    "inp of another program": Refused(text("NATOMS 5\n"), "does not begin with a keyword", "inp"),
}

# -------------------------------------------------------------------------------------- others


def of_salome(path: Path) -> None:
    """Groups of MED, each a family."""
    cells = [("triangle", CELLS["left"] + CELLS["right"]), ("line", FACETS["join"] + FACETS["end"])]
    families = [np.array([-1, -1, -2, -2]), np.array([-3, -4])]
    mesh = meshio.Mesh(POINTS[:, :2], cells, cell_data={"cell_tags": families})
    mesh.cell_tags = {-1: ["left"], -2: ["right"], -3: ["join"], -4: ["end"]}
    mesh.point_tags = {}
    meshio.write(path, mesh)


OTHERS = {
    "MED of Salome": Read(of_salome, "med"),
    "VTU": Read(tetrahedra(1, 1), "vtu", {1: 1.0, 2: 2.0}, {}),
    "VTU, tags from 0": Read(tetrahedra(1, 0), "vtu", {0: 1.0, 1: 2.0}, {}),
    "VTU, one tag from 0": Refused(
        tetrahedra(1, 0), "6 of 12 cells, .* in no group", "vtu", {"groups": [0]}
    ),
    "VTU, tags too large": Refused(tetrahedra(1, 2**40), "must be below 2", "vtu"),
    "Medit": Read(by_meshio(data="medit:ref"), "mesh", **BY_TAG),
    "nodes that are no numbers": Refused(
        lambda path: meshio.write(
            path, meshio.Mesh(POINTS * np.nan, [("triangle", CELLS["left"])])
        ),
        "are not finite",
        "vtk",
    ),
    "another ending": Refused(
        text("mesh"), r"must be \.msh, \.unv, \.inp, \.xdmf or .*\.vtu", "docx"
    ),
}

ALL = GMSH | PLANES | XDMF | NEPER | ABAQUS | OTHERS


@pytest.fixture(scope="module")
def folder(comm, tmp_path_factory) -> Path:
    return Path(comm.bcast(str(tmp_path_factory.mktemp("foreign"))))


def written(comm, folder: Path, case: Read | Refused) -> Path:
    name = next(n for n, other in ALL.items() if other is case)
    path = folder / f"{''.join(c if c.isalnum() else '_' for c in name)}.{case.ending}"
    if getattr(case.write, "collective", False):
        case.write(path, comm)
    elif comm.rank == 0:
        case.write(path)
    comm.barrier()
    return path


def measures(tagged, groups) -> dict:
    mesh, cells, _ = tagged
    one = fem.Constant(mesh, 1.0)
    found = {}
    for group in groups:
        tag = cells.names[group] if isinstance(group, str) else group
        dx = ufl.Measure("dx", mesh, subdomain_data=cells)
        found[group] = mesh.comm.allreduce(fem.assemble_scalar(fem.form(one * dx(tag))))
    return found


@pytest.mark.parametrize("name", [name for name, case in ALL.items() if isinstance(case, Read)])
def test_read(comm, folder, name):
    """Bodies have their area, facets their place, and a problem can be made."""
    case = ALL[name]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        tagged = read_mesh(written(comm, folder, case), comm, **case.given)
    assert [case.said in str(warning.message) for warning in caught] == [True] * len(caught)
    assert bool(caught) == bool(case.said and comm.rank == 0)
    mesh, cells, facets = tagged
    assert measures(tagged, case.bodies) == pytest.approx(case.bodies, rel=2e-7)
    for group, x in case.places.items():
        found = facets.find(group)
        assert comm.allreduce(len(found)) > 0
        if x is not None:
            middles = compute_midpoints(mesh, mesh.topology.dim - 1, found)
            assert middles[:, 0] == pytest.approx(np.full(len(found), x), abs=1e-6)
    tags = np.unique(np.concatenate(comm.allgather(np.unique(cells.values))))
    grain = vmdg.NeoHookean(E=1.0, nu=0.3)
    degree = 2 if "degree 2" in name or "order 2" in name else 1
    if len(tags) < 2 or case.given.get("merge") is False or "27 nodes" in case.said:
        return
    bond = vmdg.Interface(between="all", law=vmdg.Debonding(strength=1.0, critical_gap=0.1))
    problem = vmdg.Problem(mesh, cells, dict.fromkeys(tags.tolist(), grain), [bond], degree=degree)
    assert comm.allreduce(problem.state[0].weights.sum()) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("name", [name for name, case in ALL.items() if isinstance(case, Refused)])
def test_refused(comm, folder, name):
    """On every rank, by the name of the file and what is wrong."""
    case = ALL[name]
    path = written(comm, folder, case)
    with pytest.raises(ValueError, match=f"^read_mesh: {path}: .*{case.words}"):
        read_mesh(path, comm, **case.given)


def test_flat_cells_become_facets(comm, folder):
    """Their group has its name, and the interface is there; those of the file keep theirs."""
    path = written(comm, folder, NEPER["Neper 3D cohesive"])
    _, cells, facets = read_mesh(path, comm, merge=True)
    assert cells.names == {"left": 1, "right": 2}
    assert set(facets.names) == {"join", "end"}
    path = written(comm, folder, ABAQUS["Abaqus cohesive"])
    mesh, cells, facets = read_mesh(path, comm, merge=True)
    assert set(cells.names) == {"left", "right"} and set(facets.names) == {"bound1"}
    bond = vmdg.Interface(
        facets=facets.find("bound1"), law=vmdg.Debonding(strength=1.0, critical_gap=0.1)
    )
    grain = vmdg.NeoHookean(E=1.0, nu=0.3)
    problem = vmdg.Problem(mesh, cells, {"left": grain, "right": grain}, [bond])
    assert comm.allreduce(problem.state[0].weights.sum()) == pytest.approx(1.0)


def test_sets_of_nodes(comm, folder):
    """They say which points are theirs, turned with the mesh into its plane too."""
    tagged = read_mesh(written(comm, folder, ABAQUS["Abaqus"]), comm)
    assert set(tagged.nodes) == {"corner"} and len(tagged) == 3
    assert tagged.nodes["corner"](POINTS.T).tolist() == [True, False, False, True, False, False]


def test_bodies_that_seem_to_touch(comm, folder):
    """Nodes at one place are warned of, and the remedy is said."""
    path = written(comm, folder, NEPER["Neper 2D discontinuous"])
    if comm.rank == 0:
        with pytest.warns(vmdg.ModelWarning, match="2 nodes coincide .* merge=True merges"):
            read_mesh(path, comm)
    else:
        read_mesh(path, comm)


def test_without_meshio(comm, folder, monkeypatch):
    """The extra is named, on every rank."""
    path = written(comm, folder, OTHERS["VTU"])
    monkeypatch.setitem(sys.modules, "meshio", None)
    with pytest.raises(ImportError, match=r"no meshio: pip install 'vmdg\[mesh\]'"):
        read_mesh(path, comm)


def test_written_again(comm, folder):
    """A foreign file becomes one that all ranks read, with its groups."""
    tagged = read_mesh(written(comm, folder, ABAQUS["Abaqus"]), comm)
    path = folder / "again.xdmf"
    write_mesh(tagged, path)
    again = read_mesh(path, comm)
    assert again.cell_tags.names == tagged.cell_tags.names
    assert again.facet_tags.names == tagged.facet_tags.names
    assert measures(again, BODIES) == pytest.approx(BODIES)
