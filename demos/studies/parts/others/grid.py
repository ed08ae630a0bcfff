"""The mesh of two layers that other codes are given; numpy alone, for their Python."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Layers:
    """Quadrilaterals or hexahedra in two layers, each with nodes of its own."""

    nodes: np.ndarray  # Positions (n, d) [mm]
    # Of the lower and of the upper layer, nodes around every cell, in 3D its lower face first (m,
    # 2^d)
    cells: tuple[np.ndarray, np.ndarray]
    faces: np.ndarray  # Bonded facets, nodes of their lower and upper sides (k, 2, 2^(d-1))
    twins: np.ndarray  # Pairs of nodes of the interface (p, 2), where it is cracked too


def _around(ids: np.ndarray) -> np.ndarray:
    """Nodes of all cells of a grid of nodes, in the order around a square, layer by layer."""
    d = ids.ndim
    square = [(0, 0), (1, 0), (1, 1), (0, 1)]
    corners = [(0,), (1,)] if d == 1 else [c[::-1] for c in product((0, 1), repeat=d - 2)]
    if d > 1:
        corners = [(*c, *above) for above in corners for c in square]
    ends = [[slice(o, o + n - 1) for o, n in zip(c, ids.shape, strict=True)] for c in corners]
    return np.stack([ids[tuple(end)].ravel() for end in ends], axis=1)


def layers(divisions: Sequence[int], sizes: Sequence[float], crack: float) -> Layers:
    """Equal cells in a box, cut in the middle of its last direction.

    Args:
        divisions: Cells in every direction, both layers together.
        sizes: [mm].
        crack: Length of the first direction where the layers are not bonded [mm].
    """
    *along, last = (np.linspace(0, s, n + 1) for s, n in zip(sizes, divisions, strict=True))
    half = len(last) // 2
    nodes, cells, sides, first = [], [], [], 0
    for body, side in ((last[: half + 1], -1), (last[half:], 0)):
        points = np.stack(np.meshgrid(*along, body, indexing="ij"), axis=-1)
        ids = first + np.arange(points[..., 0].size).reshape(points.shape[:-1])
        nodes.append(points.reshape(-1, len(sizes)))
        cells.append(_around(ids))
        sides.append(ids[..., side])
        first += ids.size
    nodes = np.concatenate(nodes)
    faces = np.stack([_around(side) for side in sides], axis=1)
    bonded = nodes[faces[:, 0], 0].mean(axis=1) > crack
    return Layers(nodes, tuple(cells), faces[bonded], np.stack([s.ravel() for s in sides], axis=1))


def answer(run: Callable[..., tuple[float, int, list[tuple[float, float]]]]) -> None:
    """Do what the file of the first argument asks; write what was found to that of the second.

    That is the least seconds of some runs, the linear systems, displacement and force of every
    step, and the slope of a run of a single, small step, which also warms the process up. What a
    run raises is not caught: the process ends with its last words.

    Args:
        run: Takes a scene, its end, the number of steps and options.
    """
    asked: dict[str, Any] = json.loads(Path(sys.argv[1]).read_text())
    scene, options = asked["scene"], asked["options"]
    _, _, ((u, force),) = run(scene, asked["small"], 1, **options)
    runs = [run(scene, scene["end"], asked["steps"], **options) for _ in range(asked["repeats"])]
    seconds, solves, curve = min(runs)
    found = {"seconds": seconds, "solves": solves, "curve": curve, "slope": force / u}
    Path(sys.argv[2]).write_text(json.dumps(found))
