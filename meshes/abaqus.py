"""Abaqus and CalculiX input files (.inp) with a single flat mesh.

A reader of our own, since meshio 5.3.5 assigns sets of ``*ELEMENT, ELSET=`` to the wrong cells
where a section has none, and does not support plane strain, axisymmetric and cohesive elements or
surfaces.

Source: Abaqus Analysis User's Guide, Input Syntax Rules and the pages of the elements (nodes and
faces).
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Collection, Iterable, Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .arrays import EDGES_OF, HEXAHEDRON_20, Block, MeshArrays

#: Element families, with dimension and gmsh type for every number of nodes.
_LINES = {2: (1, 1), 3: (1, 8)}
_PLANE = {3: (2, 2), 4: (2, 3), 6: (2, 9), 8: (2, 16), 9: (2, 10)}
_SOLID = {
    4: (3, 4),
    5: (3, 7),
    6: (3, 6),
    8: (3, 5),
    10: (3, 11),
    15: (3, 18),
    20: (3, 17),
}
_FAMILIES = {
    "C3D|DC3D|COH3D": _SOLID,
    "CPE|CPS|CPEG|CAX|CGAX|DC2D|DCAX|COH2D|COHAX|STRI|S|M3D|SFM3D|R3D": _PLANE,
    "T2D|T3D|R2D|RAX": _LINES,
}

#: Nodes of the faces S1, S2, ... of cells with these corners, by dimension and number.
_FACES: dict[tuple[int, int], list[tuple[int, ...]]] = {
    (2, 3): [(0, 1), (1, 2), (2, 0)],
    (2, 4): [(0, 1), (1, 2), (2, 3), (3, 0)],
    (3, 4): [(0, 1, 2), (0, 3, 1), (1, 3, 2), (2, 3, 0)],
    (3, 8): [
        (0, 1, 2, 3),
        (4, 7, 6, 5),
        (0, 4, 5, 1),
        (1, 5, 6, 2),
        (2, 6, 7, 3),
        (3, 7, 4, 0),
    ],
}

#: Corners of the cells of these types, and the type of their faces.
_SHAPE = {2: (2, 3), 3: (2, 4), 4: (3, 4), 5: (3, 8), 9: (2, 3), 10: (2, 4), 11: (3, 4)}
_SHAPE |= {16: (2, 4), 17: (3, 8)}
_FACE_KIND = {2: 1, 3: 1, 4: 2, 5: 3, 9: 8, 10: 8, 11: 9, 16: 8, 17: 16}

#: Edges of cells of degree 2 in the order of the nodes on them, of gmsh.
_EDGES: dict[int, tuple[tuple[int, ...], ...]] = {
    9: ((0, 1), (1, 2), (0, 2)),
    10: EDGES_OF[16],
    11: ((0, 1), (1, 2), (0, 2), (0, 3), (2, 3), (1, 3)),
    **EDGES_OF,
}

#: Node order of Abaqus in terms of that of gmsh, where they differ.
_TO_GMSH = {11: [*range(8), 9, 8], 17: HEXAHEDRON_20}

#: Keywords that generate nodes or elements, or include them from elsewhere.
_GENERATE = ("INCLUDE", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM")


class _Section(NamedTuple):
    """A keyword, its parameters and its lines of data."""

    keyword: str
    given: dict[str, str]
    lines: list[list[str]]


def read_abaqus(path: Path) -> MeshArrays:
    """The mesh of a file; sets of elements and surfaces of element faces are its groups.

    Internal sets of Abaqus/CAE are ignored. Groups keep their names; tags follow their order.
    """
    number: dict[int, int] = {}
    points: list[list[float]] = []
    elements: dict[int, tuple[int, int, NDArray[np.int64]]] = {}
    sets: dict[str, dict[int, None]] = defaultdict(dict)
    node_sets: dict[str, dict[int, None]] = defaultdict(dict)
    internal: set[str] = set()
    surfaces: dict[str, list[list[str]]] = defaultdict(list)
    seen: dict[str, int] = defaultdict(int)
    spelt: dict[str, str] = {}

    def called(word: str) -> str:
        """A name in its first spelling; Abaqus ignores case."""
        return spelt.setdefault(word.upper(), word)

    sections = list(_sections(path))
    made: dict[int, list[int]] = {}
    for place, (keyword, given, lines) in enumerate(sections):
        seen[keyword] += 1
        if keyword in ("PART", "INSTANCE") and (seen[keyword] > 1 or any(map(any, lines))):
            raise ValueError(
                "it has several parts or instances, or one that is moved; write one flat mesh: in "
                "Abaqus/CAE mdb.models[...].setValues(noPartsInputFile=ON)"
            )
        if keyword in _GENERATE:
            raise ValueError(
                f"*{keyword} is not read; write a file with all nodes and elements in it"
            )
        if keyword == "NODE":
            made[place] = [_whole(words[0]) for words in lines]
            for label, words in zip(made[place], lines, strict=True):
                number[label] = len(points)
                points.append([_number(word) for word in (words[1:] + ["0", "0"])[:3]])
        elif keyword == "ELEMENT":
            found = list(_elements(given.get("TYPE", "").upper(), lines, number))
            elements |= {label: (dim, kind, nodes) for label, dim, kind, nodes in found}
            made[place] = [label for label, *_ in found]
    for place, (keyword, given, lines) in enumerate(sections):
        of_nodes = keyword in ("NODE", "NSET")
        known, called_sets = (number, node_sets) if of_nodes else (elements, sets)
        key = "NSET" if of_nodes else "ELSET"
        if place in made and key in given:
            called_sets[called(given[key])] |= dict.fromkeys(made[place])
        elif of_nodes and "ELSET" in given:
            labels, cells = list(number), sets[called(given["ELSET"])]
            nodes = (labels[i] for label in cells if label in elements for i in elements[label][2])
            node_sets[called(given.get(key, ""))] |= dict.fromkeys(nodes)
        elif keyword == key:
            name = called(given.get(key, ""))
            named = [[called(word) for word in line] for line in lines]
            members = _members(named, "GENERATE" in given, called_sets, known)
            called_sets[name] |= dict.fromkeys(members)
            if "INTERNAL" in given:
                internal.add(name)
        elif keyword == "SURFACE" and given.get("TYPE", "ELEMENT").upper() == "ELEMENT":
            named = [[called(words[0]), *words[1:]] for words in lines]
            surfaces[given.get("NAME", "")] += named
    if not elements:
        raise ValueError("it has no elements (*ELEMENT)")
    blocks, names = _blocks(elements, {n: s for n, s in sets.items() if n not in internal})
    faces, more = _faces(elements, sets, surfaces, names)
    dim = max(block.dim for block in blocks)
    blocks, names = blocks + faces, names | more
    there = {(block.dim, block.group) for block in blocks}
    by_dim = {d: {n: t for n, t in names.items() if (d, t) in there} for d in (dim, dim - 1)}
    nodes = {
        name: np.array([number[label] for label in members if label in number], dtype=np.int64)
        for name, members in node_sets.items()
        if name not in internal
    }
    return MeshArrays(np.array(points), blocks, by_dim, nodes=nodes)


def _sections(path: Path) -> Iterator[_Section]:
    """Keywords with their parameters and lines of data; lines that end in a comma continue."""
    section, unfinished = None, ""
    text = path.read_text(errors="replace")
    if not text.endswith("\n"):
        raise ValueError(
            "its last line has no line break; is the file truncated? If it is complete, add one"
        )
    for line in text.splitlines():
        if line.startswith("**") or not line.strip():
            continue
        if line.startswith("*") or unfinished:
            whole = unfinished + line.strip()
            unfinished = whole if whole.endswith(",") else ""
            if unfinished:
                continue
            if section:
                yield section
            keyword, *parameters = (word.strip() for word in whole[1:].split(","))
            pairs = (word.partition("=") for word in parameters)
            given = {key.strip().upper(): value.strip().strip('"') for key, _, value in pairs}
            section = _Section(keyword.upper(), given, [])
        elif section is None:
            raise ValueError("it does not begin with a keyword (*HEADING, *NODE)")
        else:
            section.lines.append([word.strip() for word in line.split(",")])
    if section:
        yield section


def _whole(word: str) -> int:
    try:
        return int(np.int64(int(word)))
    except (ValueError, OverflowError):
        raise ValueError(
            f"{word:.40} is not a node or element number; is it a complete Abaqus input file?"
        ) from None


def _number(word: str) -> float:
    """A coordinate; 0 where it is left out."""
    try:
        return float(word or 0)
    except ValueError:
        raise ValueError(f"{word:.40} is not a coordinate; is the file complete?") from None


def _elements(
    type_: str, lines: list[list[str]], number: dict[int, int]
) -> Iterator[tuple[int, int, int, NDArray[np.int64]]]:
    """Label, dimension, type in gmsh and nodes of every element of a section."""
    dim, kind, count = _kind(type_)
    words = [_whole(word) for line in lines for word in line if word]
    if len(words) % (count + 1):
        raise ValueError(
            f"the elements {type_} are truncated: they have {count} nodes each, and "
            f"{len(words) % (count + 1)} numbers are left over; is the file complete?"
        )
    order = _TO_GMSH.get(kind, slice(None))
    for label, *nodes in np.array(words, dtype=np.int64).reshape(-1, count + 1).tolist():
        missing = [node for node in nodes if node not in number]
        if missing:
            raise ValueError(f"element {label} has node {missing[0]}, which does not exist")
        yield label, dim, kind, np.array([number[node] for node in nodes])[order]


def _kind(type_: str) -> tuple[int, int, int]:
    beam = re.fullmatch(r"B[23]([12])[A-Z]*", type_)
    if beam:
        return (*_LINES[int(beam[1]) + 1], int(beam[1]) + 1)
    for family, kinds in _FAMILIES.items():
        found = re.fullmatch(rf"(?:{family})(\d+)(?:[A-Z]\w*)?", type_.replace("STRI65", "STRI6"))
        if found and int(found[1]) in kinds:
            return (*kinds[int(found[1])], int(found[1]))
    raise ValueError(
        f"elements of type {type_ or '(none)'} are not read; delete them from the file (vmdg "
        "supports triangles, quadrilaterals, tetrahedra and hexahedra: C3D4, CPE4, CAX3, ...)"
    )


def _members(
    lines: list[list[str]],
    generate: bool,
    sets: Mapping[str, Mapping[int, None]],
    known: Collection[int],
) -> Iterator[int]:
    """Labels of a set, which may be given by first, last and step, or by names of other sets."""
    for line in lines:
        words = [word for word in line if word]
        if generate:
            if len(words) not in (2, 3):
                raise ValueError("a set with GENERATE needs first, last and step")
            first, last, step = map(_whole, [*words, "1"][:3])
            labels = range(first, last + 1, max(step, 1))
            yield from labels if len(labels) <= len(known) else filter(labels.__contains__, known)
            continue
        for word in words:
            if word.isdecimal():
                yield _whole(word)
            elif word in sets:
                yield from sets[word]
            else:
                raise ValueError(f"a set names the set {word!r}, which does not exist")


def _blocks(
    elements: dict[int, tuple[int, int, NDArray[np.int64]]], sets: dict[str, dict[int, None]]
) -> tuple[list[Block], dict[str, int]]:
    names = {name: tag for tag, name in enumerate(sets, 1)}
    rest = dict.fromkeys(elements)
    blocks = []
    for name, members in sets.items():
        there = [label for label in members if label in elements]
        blocks += _by_kind((elements[label] for label in there), names[name])
        for label in there:
            rest.pop(label, None)
    return blocks + _by_kind((elements[label] for label in rest), 0), names


def _by_kind(cells: Iterable[tuple[int, int, NDArray[np.int64]]], group: int) -> list[Block]:
    found: dict[tuple[int, int], list[NDArray[np.int64]]] = defaultdict(list)
    for dim, kind, nodes in cells:
        found[dim, kind].append(nodes)
    return [
        Block(dim, kind, np.array(nodes), group, number)
        for number, ((dim, kind), nodes) in enumerate(found.items(), 1)
    ]


def _faces(
    elements: dict[int, tuple[int, int, NDArray[np.int64]]],
    sets: dict[str, dict[int, None]],
    surfaces: dict[str, list[list[str]]],
    taken: dict[str, int],
) -> tuple[list[Block], dict[str, int]]:
    blocks: list[Block] = []
    names: dict[str, int] = {}
    for name, lines in surfaces.items():
        facets = []
        for where, face, *_ in (words for words in lines if len(words) > 1):
            labels = [_whole(where)] if where.isdecimal() else sets.get(where, {})
            if re.fullmatch(r"S[1-9]", face.upper()):
                cells = (elements[label] for label in labels if label in elements)
                found = (_face(cell, int(face[1])) for cell in cells)
                facets += [facet for facet in found if facet is not None]
        if facets:
            names[name] = taken.get(name, len(taken) + len(names) + 1)
            blocks += _by_kind(facets, names[name])
    return blocks, names


def _face(
    cell: tuple[int, int, NDArray[np.int64]], number: int
) -> tuple[int, int, NDArray[np.int64]] | None:
    """A face of a cell; None for an unsupported type."""
    dim, kind, nodes = cell
    faces = _FACES.get(_SHAPE.get(kind, (0, 0)), [])
    if number > len(faces):
        return None
    corners = faces[number - 1]
    facet = [nodes[corner] for corner in corners]
    for edge in pairwise([*corners, corners[0]] if dim == 3 else corners):
        if kind in _EDGES:
            facet.append(nodes[_SHAPE[kind][1] + _EDGES[kind].index(tuple(sorted(edge)))])
    return dim - 1, _FACE_KIND[kind], np.array(facet)
