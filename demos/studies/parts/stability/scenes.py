"""What a stress run is made of: meshes of few cells, motions of their ends, and the case itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import basix
import basix.ufl
import numpy as np
from dolfinx.mesh import (
    Mesh,
    compute_midpoints,
    create_mesh,
    entities_to_geometry,
    exterior_facet_indices,
    meshtags,
)
from numpy.typing import NDArray
from parts.topology import facet_cells

import vmdg
from vmdg.meshes import cell_partitioner

if TYPE_CHECKING:
    from parts.stability.checks import Run

Array = NDArray[np.float64]
Predicate = Callable[[Array], NDArray[np.bool_]]

# Motions: displacement as a function of the load factor, at points x (3, n) where it varies


@dataclass(frozen=True)
class Path:
    """Straight legs between points."""

    points: Array  # Displacements (n, d) at t = 0, 1, .. n - 1 [mm]

    def __call__(self, t: float) -> Array:
        """Displacement (d,) [mm]."""
        corners = np.arange(len(self.points))
        return np.array([np.interp(t, corners, column) for column in self.points.T])


@dataclass(frozen=True)
class Affine:
    """u = t H.x."""

    gradient: Array  # H (d, d)

    def __call__(self, x: Array, t: float) -> Array:
        """Displacement (d, n) [mm]."""
        return t * self.gradient @ x[: len(self.gradient)]


@dataclass(frozen=True)
class OpenAndTurn:
    """Moves up to t = 1, then turns about the origin: rotated once more from one t to the next."""

    move: Array  # Displacement (d,) at t = 1 [mm]
    axis: Array  # Unit vector (3,); (0, 0, 1) in the plane
    angle: float  # Of every turn [rad]

    def __call__(self, x: Array, t: float) -> Array:
        """Displacement (d, n) [mm]."""
        d = len(self.move)
        moved = x[:d] + min(t, 1.0) * self.move[:, None]
        return rotation(self.axis, self.angle * max(t - 1.0, 0.0))[:d, :d] @ moved - x[:d]


def rotation(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit vector."""
    W = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W


# Meshes


@dataclass(frozen=True)
class Cells:
    """A box of cells."""

    kind: str  # Type of the cells
    nodes: Array  # Positions (n, d) [mm]
    cells: NDArray[np.int64]  # Nodes of the cells (m, corners), in DOLFINx's order
    lines: tuple[Array, ...]  # Where the grid lines of every axis were before nodes were moved [mm]

    @property
    def d(self) -> int:
        return self.nodes.shape[1]

    @property
    def midpoints(self) -> Array:
        """Of the cells (m, d) [mm]."""
        return self.nodes[self.cells].mean(axis=1)

    @property
    def size(self) -> Array:
        """Lengths of the box (d,) [mm]."""
        return np.array([line[-1] - line[0] for line in self.lines])

    def side(self, axis: int, end: int) -> Predicate:
        """Predicate of the side at the low (0) or high (-1) end of an axis."""
        line = self.lines[axis]
        value, small = line[end], 1e-9 * (line[-1] - line[0])
        return lambda x: np.abs(x[axis] - value) < small

    def jacobians(self, nodes: Array | None = None) -> Array:
        """det dX/dxi at the corners of the cells (m, corners) [mm^d]."""
        cell = basix.CellType[self.kind]
        element = basix.create_element(
            basix.ElementFamily.P, cell, 1, basix.LagrangeVariant.equispaced
        )
        slopes = element.tabulate(1, basix.geometry(cell))[1:, :, :, 0]
        x = (self.nodes if nodes is None else nodes)[self.cells]
        return np.linalg.det(np.einsum("tqn,cni->cqit", slopes, x))


def box(kind: str, lines: tuple[Array, ...]) -> Cells:
    """Cells between grid lines, split into simplices where ``kind`` is one."""
    d, shape = len(lines), [len(line) for line in lines]
    nodes = np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, d)
    corners = np.stack(np.meshgrid(*[np.arange(n - 1) for n in shape], indexing="ij"), -1)
    # The first axis of the reference cell runs fastest.
    offsets = np.array(np.unravel_index(np.arange(2**d), [2] * d)).T[:, ::-1]
    each = (corners.reshape(-1, 1, d) + offsets).transpose(2, 0, 1)
    cells = np.ravel_multi_index(tuple(each), shape)
    split = {
        "triangle": [[0, 1, 3], [0, 2, 3]],
        "tetrahedron": [[0, *path, 7] for path in [(1, 3), (1, 5), (2, 3), (2, 6), (4, 5), (4, 6)]],
    }.get(kind)
    cells = cells if split is None else cells[:, split].reshape(-1, d + 1)
    return Cells(kind, nodes, cells, lines)


def distorted(cells: Cells, rng: np.random.Generator, left: float, planes: Array) -> Cells:
    """Move inner nodes until the most distorted corner keeps ``left`` of its Jacobian.

    A negative ``left`` inverts cells. Nodes stay on the sides and on the ``planes`` of the first
    axis (interfaces that have to stay plane).
    """
    shift = rng.uniform(-1, 1, cells.nodes.shape) * [np.diff(line).min() for line in cells.lines]
    for axis, line in enumerate(cells.lines):
        kept = [line[0], line[-1], *(planes if axis == 0 else ())]
        shift[np.isclose(cells.nodes[:, [axis]], kept).any(axis=1), axis] = 0
    if not shift.any():
        raise ValueError("distorted: no node may move")
    whole = cells.jacobians()

    def quality(amplitude: float) -> float:
        return float((cells.jacobians(cells.nodes + amplitude * shift) / whole).min())

    high = 0.1
    while quality(high) > left:
        high *= 1.5
    low = 0.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (low, middle) if quality(middle) < left else (middle, high)
    return Cells(cells.kind, cells.nodes + low * shift, cells.cells, cells.lines)


# Cases


@dataclass(frozen=True)
class Bond:
    """An interface."""

    law: vmdg.Law  # Its law
    # Tags it separates; None where ``facets`` says where it is
    between: tuple[int, int] | None = None
    # Predicate on the midpoints (3, n) of inner facets and the tags (n, 2) of their cells
    facets: Callable[[Array, NDArray[np.int32]], NDArray[np.bool_]] | None = None
    # Traction relative to the strength at which facets open on demand; None where all are open from
    # the start
    opens_at: float | None = None
    slides: bool = False  # Whether its surfaces slide, which share no nodes
    gap: str | None = None  # As for :class:`vmdg.Interface`
    # Nodes of the surfaces (n,) of two bodies that share none, side 1 first, in place of
    # ``between``
    surfaces: tuple[NDArray[np.bool_], NDArray[np.bool_]] | None = None


@dataclass(frozen=True)
class Support:
    """Prescribed displacement of a side."""

    where: Predicate  # Predicate on coordinates (3, n)
    value: Any  # As for :meth:`vmdg.Problem.dirichlet`
    component: int | None = None  # As there


@dataclass(frozen=True)
class Case:
    """One stress run, before it runs."""

    family: str  # What it is to stress
    what: str  # Description of the numbers that were drawn
    mesh: Cells  # Cells
    tags: NDArray[np.int32]  # Of the cells (m,)
    materials: Mapping[int, vmdg.Material]  # By tag
    bonds: tuple[Bond, ...]  # Interfaces
    supports: tuple[Support, ...]  # Prescribed displacements
    loads: Array  # Load factors
    # Dead traction on the high end of the first axis [MPa]; None for none
    traction: Path | None = None
    degree: int = 1  # Of the displacement
    kinematics: str = "finite"  # "finite" or "small"
    symmetry: str | None = None  # None or "axisymmetric"
    # Deviation of the end state from a closed form, relative; None where there is none
    exact: Callable[[vmdg.Problem], float] | None = None
    refusal: str = ""  # Pattern of the error on input that is a correct answer; "" without one
    must_refuse: bool = False  # Whether nothing else is
    options: vmdg.SolveOptions = field(default_factory=vmdg.SolveOptions)  # Of the run
    eigenstrain: Mapping[int, Any] | None = None  # As for :class:`vmdg.Problem`
    # Compares all rows of a run with an independent solution; says what is wrong
    judge: Callable[[Run], list[str]] | None = None
    form: Mapping[str, Any] = field(default_factory=dict)  # More options of :class:`vmdg.Problem`

    def __str__(self) -> str:
        geometry = self.symmetry or self.kinematics
        return f"{self.mesh.kind} {self.degree}, {geometry}, {self.what}"

    @property
    def on_demand(self) -> bool:
        return any(bond.opens_at is not None for bond in self.bonds)

    def problem(
        self,
        stabilizations: tuple[Callable | None, ...] | None = None,
        opened: tuple[NDArray[np.int32] | None, ...] | None = None,
        comm: MPI.Comm = MPI.COMM_SELF,
    ) -> vmdg.Problem:
        """The problem at its start.

        Args:
            stabilizations: One for every interface in place of (21)-(23).
            opened: Open facets of interfaces that open on demand, which are interfaces from the
                start then; None for none.
        """
        mesh, d = self.mesh, self.mesh.d
        element = basix.ufl.element("Lagrange", mesh.kind, 1, shape=(d,))
        some = slice(None) if comm.rank == 0 else slice(0)
        cells, nodes, split = mesh.cells[some], mesh.nodes[some], cell_partitioner()
        dolfinx_mesh = create_mesh(comm, cells=cells, x=nodes, e=element, partitioner=split)
        original = np.asarray(dolfinx_mesh.topology.original_cell_index)
        numbers = np.arange(len(original), dtype=np.int32)
        tags = self.tags[original].astype(np.int32)
        dolfinx_mesh.topology.create_entities(d - 1)
        pairs = facet_cells(dolfinx_mesh)
        inner = np.flatnonzero((pairs >= 0).all(axis=1)).astype(np.int32)
        midpoints = compute_midpoints(dolfinx_mesh, d - 1, inner).T
        interfaces = []
        none = (None,) * len(self.bonds)
        for bond, own, open_ in zip(
            self.bonds, stabilizations or none, opened or none, strict=True
        ):
            turns = self.kinematics == "finite" or bond.slides
            frame = "corotating" if turns else "reference"
            options = {"law": bond.law, "frame": frame, "stabilization": own}
            options |= {"sliding": bond.slides, "gap": bond.gap}
            if bond.surfaces is not None:
                options["surfaces"] = tuple(facets_of(dolfinx_mesh, on) for on in bond.surfaces)
            if bond.opens_at is not None and open_ is None:
                options |= {"activate": "on-demand", "activate_at": bond.opens_at}
            facets = open_ if bond.opens_at is not None else None
            if bond.facets is not None and facets is None:
                facets = inner[bond.facets(midpoints, tags[pairs[inner]])]
            interfaces.append(vmdg.Interface(facets, between=bond.between, **options))
        problem = vmdg.Problem(
            dolfinx_mesh,
            meshtags(dolfinx_mesh, d, numbers, tags),
            self.materials,
            interfaces,
            self.degree,
            self.kinematics,
            symmetry=self.symmetry,
            eigenstrain=self.eigenstrain,
            **self.form,
        )
        for support in self.supports:
            problem.dirichlet(support.where, support.value, support.component)
        if self.traction is not None:
            problem.traction(mesh.side(0, -1), self.traction)
        return problem

    def load(self, t: float) -> Array:
        """Resultant (d,) of the dead traction [N]."""
        if self.traction is None:
            return np.zeros(self.mesh.d)
        return self.traction(t) * self.mesh.size[1:].prod()


def facets_of(mesh: Mesh, on: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Facets of the boundary all of whose nodes, by their number in the input, are chosen (n,)."""
    d = mesh.topology.dim
    mesh.topology.create_connectivity(d - 1, d)
    facets = exterior_facet_indices(mesh.topology)
    nodes = mesh.geometry.input_global_indices[entities_to_geometry(mesh, d - 1, facets)]
    return facets[on[nodes].all(axis=1)]


def legs(count: int, steps: int) -> Array:
    """Load factors of ``count`` legs of unit length in equal steps."""
    return np.concatenate([np.linspace(a, b, steps + 1)[1:] for a, b in pairwise(range(count + 1))])
