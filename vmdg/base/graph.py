"""Connected components, and equal entries of arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


def components(
    first: NDArray[np.integer], second: NDArray[np.integer], count: int
) -> NDArray[np.int32]:
    """Number of the connected component of every node of a graph (count,)."""
    ones = np.ones(len(first), dtype=np.int8)
    graph = coo_array((ones, (first, second)), shape=(count, count))
    return connected_components(graph, directed=False)[1]


def occurrences(values: NDArray[np.integer]) -> NDArray[np.int64]:
    order = np.argsort(values, kind="stable")
    result = np.empty(len(values), dtype=np.int64)
    result[order] = np.arange(len(values)) - np.searchsorted(values[order], values[order])
    return result
