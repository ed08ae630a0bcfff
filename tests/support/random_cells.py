"""Random patches of cells whose facets are interfaces, and the eigenvalues of their tangents."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import basix.ufl
import numpy as np
from dolfinx.mesh import create_mesh, meshtags
from numpy.typing import NDArray
from scipy.sparse import csr_matrix

import vmdg
from vmdg.domain.topology import facet_cells

from .scenes import DIMENSION

#: Eigenvalues of the tangent scaled to a unit diagonal that rounding cannot tell from zero.
ROUNDING = 1e-11


@dataclass(frozen=True)
class Patch:
    """Cells that meet at interfaces on all facets they share."""

    nodes: NDArray[np.float64]  # Positions (n, d) with interfaces at and between integer x
    cells: NDArray[np.int64]  # Nodes of the cells


def grid(cell: str, counts: tuple[int, ...]) -> Patch:
    """A box of cells, split into simplices where ``cell`` is one."""
    d = DIMENSION[cell]
    shape = [n + 1 for n in counts]
    nodes = np.stack(np.meshgrid(*[np.arange(n) for n in shape], indexing="ij"), -1).reshape(-1, d)
    corners = np.stack(np.meshgrid(*[np.arange(n) for n in counts], indexing="ij"), -1)
    # The first axis of the reference cell runs fastest.
    offsets = np.array(np.unravel_index(np.arange(2**d), [2] * d)).T[:, ::-1]
    boxes = np.ravel_multi_index(
        tuple((corners.reshape(-1, 1, d) + offsets).transpose(2, 0, 1)), shape
    )
    split = {
        "triangle": [[0, 1, 3], [0, 2, 3]],
        "tetrahedron": [[0, *path, 7] for path in [(1, 3), (1, 5), (2, 3), (2, 6), (4, 5), (4, 6)]],
    }.get(cell)
    return Patch(
        nodes.astype(float), boxes if split is None else boxes[:, split].reshape(-1, d + 1)
    )


def pair(cell: str) -> Patch:
    """Two cells that share the facet at x = 0."""
    d = DIMENSION[cell]
    if cell in ("quadrilateral", "hexahedron"):
        patch = grid(cell, (2,) + (1,) * (d - 1))
        return Patch(patch.nodes - np.eye(d)[0], patch.cells)
    facet = np.vstack([np.zeros(d), np.eye(d)[1:]])
    middle = np.full(d - 1, 1 / d)
    nodes = np.vstack([facet, [-1, *middle], [1, *middle]])
    return Patch(nodes, np.array([[*range(d), d], [*range(d), d + 1]]))


@dataclass(frozen=True)
class Range:
    """What is drawn; ranges are uniform in the exponent of 10 where the name says so."""

    aspect: float = 3.0  # Largest exponent of height to width, either sign
    contrast: float = 8.0  # Largest exponent of the ratio of moduli
    # Poisson's ratio, lowest and highest; drawn uniform in the exponent of 1 - 2 nu
    nu: tuple[float, float] = (0.0, 0.4999)
    strain: float = 0.5  # Largest |F - I|
    distortion: float = 0.15  # Largest shift of a node relative to its cell


def positive_moduli(F: NDArray, mu: NDArray, lmbda: NDArray) -> bool:
    """Whether A of (86) at F is not negative for any pair of parameters, in plane strain or 3D."""
    d = len(F)
    J, inverse = np.linalg.det(F), np.linalg.inv(F)
    one = np.einsum("ik,jl->ijkl", np.eye(d), np.eye(d))
    swapped = np.einsum("jk,li->ijkl", inverse, inverse)
    outer = np.einsum("ji,lk->ijkl", inverse, inverse)
    p = lmbda * (J - 1) * J
    A = np.multiply.outer(mu, one) + np.multiply.outer(mu - p, swapped)
    A += np.multiply.outer(lmbda * (2 * J - 1) * J, outer)
    eigenvalues = np.linalg.eigvalsh(A.reshape(len(mu), d * d, d * d))
    return bool((eigenvalues[:, 0] >= -1e-12 * eigenvalues[:, -1]).all())


class Configurations:
    """Many random copies of a patch in one mesh, apart from each other."""

    def __init__(self, cell: str, patch: Patch, count: int, degree: int, draw: Range, seed: int):
        self._rng = np.random.default_rng(seed)
        self._degree = degree
        self._count, self._cells_each = count, len(patch.cells)
        self._d = DIMENSION[cell]
        shapes = [self._shape(patch, draw) for _ in range(count)]
        cells = np.concatenate([patch.cells + i * len(patch.nodes) for i in range(count)])
        element = basix.ufl.element("Lagrange", cell, 1, shape=(self._d,))
        self._mesh = create_mesh(MPI.COMM_SELF, cells=cells, x=np.concatenate(shapes), e=element)
        #: Copy that every cell belongs to.
        self._original = np.asarray(self._mesh.topology.original_cell_index)
        self._copy = self._original // self._cells_each
        self._draw_materials(draw)

    def _shape(self, patch: Patch, draw: Range) -> NDArray[np.float64]:
        rng, d = self._rng, self._d
        shift = draw.distortion * rng.uniform(-1, 1, patch.nodes.shape)
        stretch = 10.0 ** rng.uniform(-draw.aspect, draw.aspect, 3)
        # The halves of a pair have heights of their own; what lies between moves by the smaller.
        side = np.sign(patch.nodes[:, 0])
        x = patch.nodes + shift
        x[:, 0] = patch.nodes[:, 0] * np.where(side < 0, stretch[0], stretch[1])
        x[:, 0] += shift[:, 0] * np.choose(
            side.astype(int) + 1, [stretch[0], stretch[:2].min(), stretch[1]]
        )
        if d == 3:
            x[:, 2] *= stretch[2] ** (1 / 3)
        shear = np.eye(d) + rng.uniform(-0.3, 0.3, (d, d))
        return x @ shear.T

    def _draw_materials(self, draw: Range) -> None:
        rng = self._rng
        exponents = np.log10(1 - 2 * np.array(draw.nu))
        shape = (self._count, self._cells_each)
        E = 10.0 ** (rng.uniform(0, draw.contrast, (self._count, 1)) * rng.random(shape))
        nu = (1 - 10.0 ** rng.uniform(*exponents[::-1], (self._count, 1)) * np.ones(shape)) / 2
        # Half of the copies have cells of different compressibility.
        other = (1 - 10.0 ** rng.uniform(*exponents[::-1], shape)) / 2
        nu = np.where(rng.random((self._count, 1)) < 0.5, nu, other)
        self._materials = [
            vmdg.NeoHookean(E=e, nu=n) for e, n in zip(E.ravel(), nu.ravel(), strict=True)
        ]
        parameters = np.array([list(m.parameters.values()) for m in self._materials])
        parameters = parameters.reshape(*shape, 2)
        self._F = np.stack([self._deformation(draw, *p.T) for p in parameters])

    def _deformation(self, draw: Range, mu: NDArray, lmbda: NDArray) -> NDArray[np.float64]:
        """F with |F - I| up to the range and positive A in all cells of a copy."""
        rng, one = self._rng, np.eye(self._d)
        size = rng.uniform(0, draw.strain)
        while size > 1e-3:
            H = rng.uniform(-1, 1, one.shape)
            F = one + size * H / np.linalg.norm(H)
            # A pressure lambda (J - 1) J between none and mu, where A is sure to be positive.
            p = rng.random() / max((lmbda / mu).max(), 0.5)
            J = (1 + np.sqrt(1 + 4 * p)) / 2
            F = F * (J / np.linalg.det(F)) ** (1 / self._d)
            if np.linalg.norm(F - one) <= draw.strain and positive_moduli(F, mu, lmbda):
                return F
            size *= 0.8
        return one

    def problem(self, volumetric: str = "pointwise", **interface) -> vmdg.Problem:
        """The problem, deformed, with ``interface`` options."""
        mesh, d = self._mesh, self._d
        mesh.topology.create_entities(d - 1)
        facets = np.flatnonzero((facet_cells(mesh) >= 0).all(axis=1))
        tags = meshtags(
            mesh, d, np.arange(len(self._copy), dtype=np.int32), self._original.astype(np.int32)
        )
        problem = vmdg.Problem(
            mesh,
            tags,
            dict(enumerate(self._materials)),
            [vmdg.Interface(facets, **interface)],
            self._degree,
            volumetric=volumetric,
        )
        X = problem.space.tabulate_dof_coordinates()[:, :d]
        copy = self._copy_of_dofs(problem)
        H = self._F[copy] - np.eye(d)
        problem.u.x.array[:] = np.einsum("nij,nj->ni", H, X).ravel()
        # As of a run that starts here: what the undeformed cells ask for is no floor.
        active = problem.discretization.active[0]
        active.floor = np.zeros_like(active.floor)
        problem.discretization.update_stabilization()
        return problem

    def _copy_of_dofs(self, problem: vmdg.Problem) -> NDArray[np.int64]:
        dofs = problem.space.dofmap.list
        copy = np.empty(dofs.max() + 1, dtype=np.int64)
        copy[dofs] = self._copy[:, None]
        return copy

    def lowest(self, problem: vmdg.Problem) -> NDArray[np.float64]:
        """Smallest eigenvalue of every copy's tangent scaled to a unit diagonal (count,)."""
        problem.step.assemble_residual(hold=True)
        matrix = problem.discretization.create_matrix()
        problem.discretization.assemble_tangent(matrix, damage=False)
        rows, columns, values = matrix.getValuesCSR()
        matrix.destroy()
        dense = csr_matrix((values, columns, rows))
        order = np.argsort(np.repeat(self._copy_of_dofs(problem), self._d), kind="stable")
        size = len(order) // self._count
        dense = dense[order][:, order].tobsr((size, size))
        blocks = np.zeros((self._count, size, size))
        blocks[dense.indices] = dense.data
        scale = 1 / np.sqrt(np.abs(np.diagonal(blocks, axis1=1, axis2=2)))
        blocks *= scale[:, :, None] * scale[:, None, :]
        return np.linalg.eigvalsh(blocks)[:, 0]


@dataclass(frozen=True)
class Case:
    """A class of configurations."""

    cell: str  # Type of the cells
    degree: int  # Degree of the displacement
    alone: bool  # Two cells and the facet between them; else a patch with interfaces on all facets
    count: int  # Number of configurations

    def __str__(self) -> str:
        return f"{self.cell} {self.degree}, {'pair' if self.alone else 'patch'}"

    @property
    def patch(self) -> Patch:
        """What is copied."""
        if self.alone:
            return pair(self.cell)
        return grid(self.cell, PATCHES[self.cell])

    def draw(self, seed: int = 0) -> Configurations:
        """The configurations."""
        return Configurations(self.cell, self.patch, self.count, self.degree, Range(), seed)


PATCHES = {
    "triangle": (2, 2),
    "quadrilateral": (2, 2),
    "tetrahedron": (1, 1, 1),
    "hexahedron": (2, 2, 1),
}
