"""Small files of other programs: two blocks, "left" from x = 0 to 1 and "right" from 1 to 3.

They are one unit wide (and high); facets "join" lie between them, facets "end" at x = 0. They are
written by gmsh or meshio where these can, else by hand: Neper's after its manual (Mesh File) and
references of its tests, Abaqus' after its manual.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import permutations
from pathlib import Path

import gmsh
import numpy as np

from vmdg.meshes.gmsh_model import model

#: Points of the 2D mesh, its triangles by block, and its edges.
POINTS = np.array([(x, y, 0.0) for y in (0.0, 1.0) for x in (0.0, 1.0, 3.0)])
CELLS = {"left": [(0, 1, 4), (0, 4, 3)], "right": [(1, 2, 5), (1, 5, 4)]}
FACETS = {"join": [(1, 4)], "end": [(0, 3)]}


def solid() -> tuple[np.ndarray, dict, dict]:
    """Points, tetrahedra and triangles of the blocks in space."""
    points = np.array([(x, y, z) for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0, 3.0)])
    steps = np.array([1, 3, 6])
    paths = [np.cumsum([0, *steps[list(order)]]) for order in permutations(range(3))]
    cells = {
        name: [tuple(first + path) for path in paths] for name, first in (("left", 0), ("right", 1))
    }
    sides = [(0, 3, 9), (0, 6, 9)]
    facets = {
        name: [tuple(n + first for n in side) for side in sides]
        for name, first in (("end", 0), ("join", 1))
    }
    return points, cells, facets


def apart(points: np.ndarray, cells: dict, facets: dict) -> tuple[np.ndarray, dict, dict, dict]:
    """Nodes of the joint twice: those of the right block are new ones; and the flat cells there."""
    joint = np.flatnonzero(points[:, 0] == 1)
    new = {old: len(points) + number for number, old in enumerate(joint)}
    right = [tuple(new.get(node, node) for node in cell) for cell in cells["right"]]
    flat = []
    for facet in facets["join"]:
        other = [new[node] for node in facet]
        # Quadrilaterals go round, wedges have one triangle above the other.
        flat.append((*facet, *(other if len(facet) == 3 else reversed(other))))
    return np.vstack([points, points[joint]]), cells | {"right": right}, facets, {"bound1": flat}


def second(points: np.ndarray, *groups: dict) -> tuple[np.ndarray, list[dict]]:
    """Nodes in the middle of the edges too, in the order of gmsh."""
    edges = {
        2: [(0, 1)],
        3: [(0, 1), (1, 2), (2, 0)],
        4: [(0, 1), (1, 2), (2, 0), (3, 0), (2, 3), (1, 3)],
    }
    points, known, result = list(points), {}, []
    for group in groups:
        result.append({})
        for name, cells in group.items():
            result[-1][name] = []
            for cell in cells:
                middles = []
                for a, b in edges[len(cell)]:
                    edge = tuple(sorted((cell[a], cell[b])))
                    if edge not in known:
                        known[edge] = len(points)
                        points.append((points[edge[0]] + points[edge[1]]) / 2)
                    middles.append(known[edge])
                result[-1][name].append((*cell, *middles))
    return np.array(points), result


#: Dimension of elements in files of gmsh by the number of their type.
DIMENSION = {1: 1, 8: 1, 2: 2, 3: 2, 9: 2, 4: 3, 6: 3, 11: 3}


def neper(path: Path, points: np.ndarray, *groups: tuple[int, dict]) -> None:
    """A mesh as Neper writes it: three tags an element, sections of its own, names behind them.

    Those of cohesive elements have no quotes, in versions before 4.6 none has.
    """
    lines, names, number = [], [], 0
    for kind, cells_of in groups:
        for cells in cells_of.values():
            for cell in cells:
                number += 1
                tag = next(t for t, n in enumerate(cells_of, 1) if cells_of[n] is cells)
                tag += 7 * ("bound1" in cells_of)
                nodes = " ".join(str(node + 1) for node in cell)
                lines.append(f"{number} {kind} 3 {tag} {tag} 0 {nodes}")
        quoted = '"{}"' if "bound1" not in cells_of else "{}"
        shift = 7 * ("bound1" in cells_of)
        names += [
            f"{DIMENSION[kind]} {tag + shift} " + quoted.format(name)
            for tag, name in enumerate(cells_of, 1)
        ]
    nodes = [f"{i} {x:.12f} {y:.12f} {z:.12f}" for i, (x, y, z) in enumerate(points, 1)]
    first, last = (np.flatnonzero(points[:, 0] == x) + 1 for x in np.unique(points[:, 0])[[0, -1]])
    pairs = [f"{there} {here} 1 0 0" for here, there in zip(first, last, strict=True)]
    sides = [facet for _, of in groups for facet in of.get("end", [])]
    fasets = [f"{i} " + " ".join(str(node + 1) for node in side) for i, side in enumerate(sides, 1)]
    sections = {
        "MeshFormat": ["2.2 0 8"],
        "MeshVersion": ["2.2.3"],
        "Domain": ["cube"],
        "Topology": ["1"],
        "Nodes": [str(len(nodes)), *nodes],
        "Elements": [str(len(lines)), *lines],
        "Periodicity": [str(len(pairs)), *pairs],
        "NSets": ["1", "x0", str(len(first)), *map(str, first)],
        "Fasets": ["1", "x0", str(len(fasets)), *fasets],
        "NodePartitions": [str(len(nodes)), *(f"{i} 1" for i in range(1, len(nodes) + 1))],
        "PhysicalNames": [str(len(names)), *names],
        "ElsetOrientations": ["2 rodrigues:active", "1 0.1 0.2 0.3", "2 -0.2 0.0 0.1"],
        "ElsetCrySym": ["triclinic"],
        "Groups": ["elset", "2", "1 1", "2 1"],
    }
    of_all = ("\n".join([f"${name}", *of, f"$End{name}", ""]) for name, of in sections.items())
    path.write_text("".join(of_all))


#: How a mesh of gmsh is written: sets options, or changes the mesh.
Finish = Callable[[], None]


def of_gmsh(
    path: Path, finish: Finish = lambda: None, version: float = 4.1, groups: bool = True
) -> None:
    """The blocks in the plane, meshed and written by gmsh."""
    with model("blocks") as g:
        gmsh.option.setNumber("Mesh.MshFileVersion", version)
        g.occ.fragment(
            [(2, g.occ.addRectangle(0, 0, 0, 1, 1))], [(2, g.occ.addRectangle(1, 0, 0, 2, 1))]
        )
        g.occ.synchronize()
        if groups:
            for dim, names in ((2, {"left": 0.5, "right": 2}), (1, {"end": 0, "join": 1})):
                for tag, (name, x) in enumerate(names.items(), 1):
                    near = [
                        e
                        for _, e in g.getEntities(dim)
                        if abs(g.occ.getCenterOfMass(dim, e)[0] - x) < 1e-6
                    ]
                    g.addPhysicalGroup(dim, near, tag, name)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.5)
        g.mesh.generate(2)
        finish()
        gmsh.write(str(path))


def abaqus(kind: str, points: np.ndarray, cells: dict, more: str = "", first: int = 1) -> str:
    """A flat input file: nodes, and elements by set."""
    nodes = [f"{i}, {x:.7g}, {y:.7g}, {z:.7g}" for i, (x, y, z) in enumerate(points, 1)]
    lines, number = ["*HEADING", "two blocks", "** a comment", "*Node", *nodes], first - 1
    for name, group in cells.items():
        type_ = kind if name != "bound1" else {6: "COH3D6", 4: "COH2D4"}[len(group[0])]
        lines.append(f"*Element, type={type_}, elset={name}")
        for cell in group:
            number += 1
            lines.append(f"{number}, " + ", ".join(str(node + 1) for node in cell))
    return "\n".join(
        [*lines, more.strip("\n"), "*Material, name=steel", "*Elastic", "2.1e5, .3", ""]
    )
