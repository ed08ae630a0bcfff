"""The partition of the mesh changes nothing: distributed runs against the same run on each rank."""

from __future__ import annotations

import time

from mpi4py import MPI

import numpy as np
import pytest
from support.checks import by_position
from support.problems import joined
from support.scenes import EVERY_CELL, SEVERAL_RANKS, two_blocks, unit_box

import vmdg
from vmdg.base.agreement import same_call
from vmdg.base.parallel import (
    global_any,
    global_max,
    global_sum,
    group_maxima,
    raise_together,
    warn_together,
)
from vmdg.meshes import blocks

# Weak enough that points are damaged at the end.
LAW = vmdg.Debonding(strength=60.0, critical_gap=0.2)
ROUNDING = 1e-9  # of forces, relative: what the solver's tolerance of 1e-11 leaves


def sheared_apart(where, cell: str, degree: int = 1):
    """Two different blocks pulled apart off their axis; some points fail, others do not."""
    scene = two_blocks(where, cell, n=2, distortion=0.03)
    problem = joined(scene, LAW, degree=degree)
    left, right = scene.facet_tags.find(1), scene.facet_tags.find(2)
    d = problem.mesh.geometry.dim
    problem.dirichlet(left, 0.0)
    problem.dirichlet(
        right, lambda x, t: t * np.vstack([0.03 + 0.04 * x[1], *[0.02 * x[:1]] * (d - 1)])
    )
    options = vmdg.SolveOptions(relative_tolerance=1e-11)
    result = vmdg.solve(problem, [0.5, 0.8, 1.0], options)
    return problem, result, (left, right)


@SEVERAL_RANKS
@EVERY_CELL
def test_same_run_on_any_number_of_ranks(comm, cell):
    """Dofs, forces, energies and the state at every point do not depend on the partition."""
    seen = []
    for where in (comm, MPI.COMM_SELF)[: comm.size]:
        problem, result, ends = sheared_apart(where, cell)
        state, energy = problem.state[0], problem.energy()
        points = by_position(
            where, state.points, state.traction, state.gap, state.softening, state.normal
        )
        forces = np.concatenate([problem.reaction(facets) for facets in ends])
        energies = np.array([energy.stored, energy.dissipated, energy.external])
        size = problem.space.dofmap.index_map.size_global
        seen.append((size, len(points[0]), forces, energies, points, len(result.history)))
    distributed, alone = seen[0], seen[-1]
    softening = alone[4][3]
    assert 0 < (softening > 0).sum()
    assert distributed[:2] == alone[:2]
    assert distributed[5] == alone[5]
    assert np.abs(distributed[2] - alone[2]).max() < ROUNDING * np.abs(alone[2]).max()
    assert np.abs(distributed[3] - alone[3]).max() < ROUNDING * np.abs(alone[3]).max()
    for mine, expected in zip(distributed[4], alone[4], strict=True):
        assert np.abs(mine - expected).max() < ROUNDING * np.abs(expected).max()


MESHES = {
    "box": lambda comm: unit_box(comm, "triangle", 8),
    # Few cells on three ranks: ghosts of a rank are shared by ranks that it sends nothing to.
    "two tiny blocks": lambda comm: blocks(comm, "tetrahedron").mesh,
}


@pytest.mark.parametrize("name", MESHES)
def test_group_maxima(comm, name):
    """Every holder of a cell has the largest of what all holders had; a group has one value."""
    mesh = MESHES[name](comm)
    cells = mesh.topology.index_map(mesh.topology.dim)
    local = np.arange(cells.size_local + cells.num_ghosts, dtype=np.int32)
    names = cells.local_to_global(local)
    values = (names * 7 + 13 * comm.rank) % 29  # what this rank thinks of its cells
    columns = np.column_stack([values, -values])
    members = np.tile([True, False], (len(local), 1))
    largest = group_maxima(comm, cells, columns, members, local)
    told = comm.allgather((names, columns))
    expected = np.full(columns.shape, -(10**6))
    position = {name: i for i, name in enumerate(names)}
    for others, theirs in told:
        for cell, value in zip(others, theirs, strict=True):
            if cell in position:
                row = position[cell]
                expected[row] = np.maximum(expected[row], value)
    assert comm.allreduce(int((largest != expected).sum())) == 0

    one_group = np.zeros(len(local), dtype=np.int32)
    largest = group_maxima(comm, cells, columns, members, one_group)[:, 0]
    assert comm.allreduce(int(len(set(largest)) > 1)) == 0


def test_raise_together(comm):
    """An error of one rank is raised by all, with the text of the lowest rank that has one."""
    last = comm.size - 1
    with pytest.raises(ValueError, match=f"from rank {last}"):
        raise_together(comm, f"from rank {last}" if comm.rank == last else None)
    raise_together(comm, None)
    assert global_any(comm, comm.rank == last)
    assert not global_any(comm, False)


@SEVERAL_RANKS
def test_calls_of_some_ranks(comm):
    """Of calls of all ranks one that only some make is refused on all, and so is a solve with
    other loads, and a law with other numbers."""
    scene = two_blocks(comm, "quadrilateral", n=2)
    problem, right = joined(scene, LAW), scene.facet_tags.find(2)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    with pytest.raises(
        ValueError, match=r"0 calls problem\.traction where rank 1 calls solve: .*if"
    ):
        if comm.rank == 0:
            problem.traction(right, [1.0, 0.0])
        vmdg.solve(problem, [1.0])
    with pytest.raises(ValueError, match=r"rank 0 gives loads = \[1.0\], rank 1 loads = \[2.0\]"):
        vmdg.solve(problem, [1.0 + (comm.rank == 1)])
    drawn = vmdg.Debonding(strength=60.0 + (comm.rank == 1), critical_gap=0.2)
    with pytest.raises(
        ValueError, match=r"Problem: rank 0 .*strength=60.*strength=61.*by one seed"
    ):
        joined(scene, drawn)


@SEVERAL_RANKS
def test_a_rank_that_waits_says_so(comm, caplog):
    """In a call of all ranks to which others come late."""
    if comm.rank > 0:
        time.sleep(2.0)
    same_call(comm, "problem.reaction", reminder=0.5)
    assert ("has waited 0.5 s in problem.reaction" in caplog.text) == (comm.rank == 0)


def test_numbers_of_any_kind(comm):
    """A rank that has nothing gives 0, others .5; integers stay integers, arrays in any order."""
    last = comm.rank == comm.size - 1
    assert global_sum(comm, 0.5 if last else 0) == 0.5
    assert global_max(comm, 0.5 if last else 0) == 0.5
    assert global_max(comm, np.inf if last else 0) == np.inf
    count = global_sum(comm, 3)
    assert count == 3 * comm.size
    assert list(range(count))[-1] == count - 1
    rows = np.arange(6.0).reshape(2, 3)
    assert np.array_equal(global_sum(comm, rows.T), comm.size * rows.T)


def test_warning_in_code_without_a_module():
    """Code that is executed from a text has no ``__name__``; it is warned as any other."""
    message = "a warning" if MPI.COMM_WORLD.rank == 0 else None
    scope = {"warn_together": warn_together, "comm": MPI.COMM_WORLD, "message": message}
    code = "def run():\n    warn_together(comm, message)\n"
    exec(code, scope)
    scope.pop("__name__", None)
    if MPI.COMM_WORLD.rank == 0:
        with pytest.warns(vmdg.ModelWarning, match="a warning"):
            scope["run"]()
    else:
        scope["run"]()
