"""The smallest tau_s on every facet with which the bonded form is coercive.

With opening g, flux h_a = (A : GRAD u_a).N and bulk energy E_K = int_K GRAD u : A : GRAD u, the
bonded form is the sum over the cells of E_K and over the interface facets of

    int 2 g.(delta_1.h_1 + delta_2.h_2) + g.tau.g.

Split tau on every facet as w_1 tau + w_2 tau with w_a = tr(delta_a) / d, so w_1 + w_2 = 1. For any
lambda_a > 0, 2 x.y >= -x.Q.x - y.Q^-1.y with Q = lambda_a w_a tau gives

    int 2 g.delta_a.h_a + lambda_a w_a g.tau.g >= -1/lambda_a int h_a.T_a.h_a,
    T_a = delta_a^T.tau^-1.delta_a / w_a.

So if on every cell the lambda of its interface facets fulfil

    sum_f 1/lambda_f int_f h.T_f.h <= E_K(u) for all u,                                       (*)

then with tau multiplied by s = (w_1 lambda_1 + w_2 lambda_2) / (1 - alpha) the form is bounded
below by alpha sum_K E_K: up to rigid motions it is coercive and keeps the fraction alpha of the
bulk energy, for any degree, shape and contrast. Where alpha differs from facet to facet, this holds
with the least. (*) is a generalised eigenvalue problem of one
cell, in the basis and at the points that the forms use, so it holds for under-integration too;
where surfaces slide, at those of :class:`.ShapeGradients` for pieces of facets. A
cell divides its energy among its facets in proportion to what each would need alone: with lambda_f
the largest eigenvalue of facet f alone and m that of sum_f 1/lambda_f int_f h.T_f.h, (*) holds for
m lambda_f.

Where meshes do not match, a facet has several partners, of other tau and delta. Its T is then the
mean of the above over its pairs by area, and for every pair

    int 2 g.delta_a.h_a + lambda_a (delta_a^T.g).T_a^-1.(delta_a^T.g)
        >= -1/lambda_a int h_a.T_a.h_a.

Where the facets of a pair are not parallel, the flux of side 2 enters per area of side 1, as
rho h_2 with rho = dS_2/dS_1 = |M_2|, and as int rho h_2.T_2.h_2 dS_1 = int h_2.T_2.h_2 dS_2,

    int 2 rho g.delta_2.h_2 + rho lambda_2 (delta_2^T.g).T_2^-1.(delta_2^T.g) dS_1
        >= -1/lambda_2 int h_2.T_2.h_2 dS_2.

So s tau = s' tau / (1 - alpha) suffices for every pair, s' the least factor with

    s' tau >= lambda_1 delta_1.T_1^-1.delta_1^T + rho lambda_2 delta_2.T_2^-1.delta_2^T,    (**)

for scalars r = (c_1 delta_1^2 + rho c_2 delta_2^2) / (1 - alpha) with c_a = lambda_a / T_a in
MPa/mm, which knows the cell alone. With one partner delta_a.T_a^-1.delta_a^T = w_a tau, and s' is
the s above.

alpha decides how near the solution is to that of continuous elements. The flux of the best
approximation in the cells misses that of the solution by f, of order h^k, whatever the shape of the
interface, and the form answers by opening. With r_c the r of alpha = 0, a gap g to which the cells
adapt costs no less than (r - r_c) g^2 / 2 per area, so

    g = f / (r - r_c) = (1 - alpha) / alpha f / r_c.

The additional error of u grows with this, that of GRAD u, whose energy adds to that of the other
errors, at least as fast. Both are those of the cells at the interface, and so of a share h of the
body. f is the mean of both sides by delta: for odd k and equal bodies the two cancel; with a soft
and a stiff body, or for even k, they do not. See :func:`margin`.

E_K gives no bound where A is not positive, as in compression, where cells lower their energy by
rotation. There GRAD u : |A| : GRAD u replaces it, |A| having the absolute eigenvalues of A. The
interface uses the fraction theta of that, which leaves (1 - theta) M of a deformation with
eigenvalue M and -(1 + theta) G of a rotation with -G. A body may be stable only because M - G > 0.
To keep the fraction alpha of this, and avoid premature buckling, requires

    theta = (1 - alpha) (1 - gamma) / (1 + gamma),    gamma = G / M,

M the softest deformation of A, the lowest eigenvalue above those that vanish at rest.

With mean dilatation the forms are those of :mod:`forms.dilatation`: GRAD u has the mean dilatation
of the cell as an additional entry, A and the fluxes have the derivatives by theta, and A that of p
J.

In generalized plane strain F_33 is an additional dof of every cell, although the body has only one:
(*) is then conservative.

The form is (27) while everything is bonded, at a state with s = 0. The additional term of (26) uses
energy of the cells that no tau restores. A facet whose safety is a number uses its share of a
cell's energy like any other.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

import basix
import numpy as np
import ufl
from dolfinx import fem, la
from numpy.typing import NDArray
from ufl.core.expr import Expr

from .. import compat
from ..base.arrays import joined_axes, power_of_two
from ..base.kernels import compile_expression
from ..domain.materials import Bodies
from ..domain.moduli import RegionExpressions, cell_moduli
from ..domain.shapes import ShapeGradients
from ..forms import kinematics
from ..forms.geometry import Axisymmetric, GeneralizedPlane
from ..forms.kinematics import Body
from ..laws.base import Law
from ..points.facets import InterfaceFacets
from .free_stress import free_stress_factor

#: alpha of :func:`margin`: of ties, of bonds from degree 2 on, and of all others.
_TIED, _BONDED, _LEAST = 2 / 3, 3 / 5, 1 / 4

# Relative shift that makes A factorizable, whose rotations have no energy: far above rounding and
# far below the softest deformation, bending of a nearly incompressible cell with an aspect ratio of
# 1000.
_REGULAR = 1e-13

#: Largest gamma: above it a body buckles cell by cell, whatever the interface.
_MOST_PRESSED = 0.75

# Size of the largest array of a batch of cells.
_BATCH = 2**22

#: Rows of an array.
_Rows = NDArray[np.intp]

#: Penalties tau (nf, d, d) [MPa/mm] and flux weights delta (nf, 2, d, d) of an interface.
Stabilized = tuple[NDArray[np.float64], NDArray[np.float64]]


class Moduli(NamedTuple):
    """Of some cells and pairs at a displacement."""

    bulk: NDArray[np.float64]  # Upper triangle of A (cells, points, m)
    traction: NDArray[np.float64]  # dP.N/dF of pairs (pairs, points, m)
    # dJ/dF (cells, points, m); None without mean dilatation, and at small strain
    volume: NDArray[np.float64] | None


def margin(law: Law, degree: int) -> float:
    """alpha: fraction of the bulk energy that the bonded form keeps at least.

    With 2/3, r is three times what coercivity requires, and errors are those of continuous elements
    within 4 % from two cells across a body; with 3/5, r is two and a half times it, and from degree
    2 on they are within 3 %; with 1/4, r is four thirds of it, and GRAD u is up to a third worse.
    But a larger r lets points of a failing bond break one by one, in more and smaller steps, at
    degree 1 up to eight times as many. Hence bonds of degree 1 have 1/4, as has contact without a
    bond, whose tractions and openings are no better with more. Where bodies flow, bonds of degree 2
    have u within 2 % and GRAD u within 1 % with 3/5, and on triangles 7 and 1.5 % with 1/4; with
    hardly any hardening 4 and 2 % instead of 19 and 10 %.
    """
    if not law.inelastic:
        return _TIED
    return _BONDED if law.has_bond and degree > 1 else _LEAST


def _contract(
    tensor: NDArray[np.float64],
    gradients: NDArray[np.float64],
    dilatations: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """tensor : GRAD of every shape function in every direction.

    Args:
        tensor: (cells, points, entries of GRAD, m).
        gradients: (cells, points, nodes, d), with the hoop column in axisymmetry.
        dilatations: Change of theta (cells, nodes, d), if GRAD has it as its last entry.

    Returns:
        (cells, points, m, nodes, d).
    """
    theta = None
    if dilatations is not None:
        tensor, theta = tensor[:, :, :-1], tensor[:, :, -1]
    hoop = tensor.shape[2] != gradients.shape[3] ** 2
    d = gradients.shape[3] - hoop
    cells, points, _, m = tensor.shape
    section = tensor[:, :, : d * d].reshape(cells, points, d, d, m).transpose(0, 1, 4, 2, 3)
    # (m, i) j by j a: einsum uses no BLAS for products at each point.
    result = section.reshape(cells, points, m * d, d) @ gradients[..., :d].transpose(0, 1, 3, 2)
    result = result.reshape(cells, points, m, d, gradients.shape[2]).transpose(0, 1, 2, 4, 3)
    if hoop:
        result[..., 0] += np.einsum("cqm,cqa->cqma", tensor[:, :, -1], gradients[..., -1])
    if theta is not None:
        result += np.einsum("cqm,cai->cqmai", theta, dilatations)
    return result


class CellProblems:
    """The eigenvalue problems (*) of cells that have interface facets.

    Args:
        cells: Local cells, ascending; a cell with several interface facets is repeated.
    """

    def __init__(
        self,
        u: fem.Function,
        bodies: Bodies,
        cells: NDArray[np.int32],
        local: NDArray[np.int32],
        in_pieces: bool = False,
    ):
        space, geometry = u.function_space, bodies.geometry
        mesh = space.mesh
        self._d = d = mesh.geometry.dim
        self._axial = isinstance(geometry, GeneralizedPlane)
        self._entries = entries = geometry.entries(d)
        self._triangle = np.triu_indices(len(entries))
        shapes = ShapeGradients(mesh, geometry, space.ufl_element().degree, in_pieces)
        self._cells, self._first, self._cell_of_pair = np.unique(
            cells, return_index=True, return_inverse=True
        )
        self._bulk = shapes.in_cells(self._cells)
        # F_33 - 1 times this length has the unit of the other unknowns.
        self._length = power_of_two(np.sqrt(self._bulk[1].sum(axis=1)))
        self._free = d * (d - 1) // 2 + bodies.mean_dilatation
        # In axisymmetry a translation along r strains the cell.
        self._free_dofs: slice | list[int] = slice(d, None)
        if isinstance(geometry, Axisymmetric):
            self._free_dofs = [0, *range(d, d * shapes.nodes_of_cell)]
        self._pairs = np.column_stack([cells, local]).astype(np.int32)
        positions = compile_expression(
            ufl.SpatialCoordinate(mesh), shapes.facet_points, mesh.comm, name="facet points"
        )
        X = compat.evaluate(positions, mesh, self._pairs).reshape(
            len(cells), len(shapes.facet_points), d
        )
        self._facets = shapes.on_facets(cells, local).at(X)[:2]
        self._region = bodies.region[self._cells]
        here = np.unique(self._region)
        # Compilation is collective.
        regions = np.unique(np.concatenate(mesh.comm.allgather(here)))

        N = ufl.FacetNormal(mesh)
        self._bulk_moduli = cell_moduli(u, bodies, regions, shapes.bulk_points)
        self._mean_dilatation = bodies.mean_dilatation
        self._volume_gradient: RegionExpressions | None = None
        # At small strain dJ/dF is the identity, which is not an expression on a mesh.
        if self._mean_dilatation and not bodies.small:
            self._volume_gradient = RegionExpressions(
                u,
                bodies,
                regions,
                lambda body, F: kinematics.volume_gradient(body, F, entries),
                shapes.bulk_points,
                "coercivity",
            )

        def moduli(body: Body, F: Expr) -> Expr:
            H = kinematics.traction_moduli(body.elastic, F, N)
            return ufl.as_vector([H[k, i, j] for k in range(d) for i, j in entries])

        self._traction_moduli = RegionExpressions(
            u, bodies, regions, moduli, shapes.facet_points, "coercivity"
        )
        rows = len(shapes.bulk_points) * len(entries) + shapes.nodes_of_cell * d
        self._batch = max(_BATCH // (rows * shapes.nodes_of_cell * d), 1)

    def moduli(self, needed: NDArray[np.bool_] | None = None) -> Iterator[Moduli]:
        """What (*) has of the current displacement, batch by batch."""
        for cells, pairs in self._batches(needed):
            region, dJ = self._region[cells], None
            if self._volume_gradient is not None:
                dJ = self._volume_gradient(region, self._cells[cells])
            H = self._traction_moduli(self._region[self._cell_of_pair[pairs]], self._pairs[pairs])
            yield Moduli(self._bulk_moduli(region, self._cells[cells]), H, dJ)

    def _batches(self, needed: NDArray[np.bool_] | None) -> Iterator[tuple[_Rows, _Rows]]:
        """Cells that are solved, and the pairs that belong to them."""
        bounds = np.append(self._first, len(self._pairs))
        for start in range(0, len(self._cells), self._batch):
            end = min(start + self._batch, len(self._cells))
            cells, pairs = np.arange(start, end), np.arange(bounds[start], bounds[end])
            if needed is not None:
                of_cell = self._cell_of_pair[pairs]
                cells = np.unique(of_cell[needed[pairs]])
                pairs = pairs[np.isin(of_cell, cells)]
            if len(cells):
                yield cells, pairs

    def __call__(
        self,
        weights: NDArray[np.float64],
        states: Sequence[Iterable[Moduli]],
        needed: NDArray[np.bool_] | None = None,
    ) -> NDArray[np.float64]:
        """m lambda_f of every pair of cell and facet in some states (states, n).

        Args:
            weights: T of every pair (states, n, d, d) [mm3/N].
            needed: Pairs whose cells are solved, others have 0 (n,); None for all.
        """
        result, count = np.zeros(weights.shape[:2]), len(weights)
        for (cells, pairs), *known in zip(self._batches(needed), *states, strict=True):
            number = self._cell_of_pair[pairs]  # ascending
            of_cell = np.cumsum(np.diff(number, prepend=number[:1]) > 0)
            of_cell = (of_cell + len(cells) * np.arange(count)[:, None]).ravel()
            joined = Moduli(
                *(
                    None if one[0] is None else np.concatenate(one)
                    for one in zip(*known, strict=True)
                )
            )
            T = weights[:, pairs].reshape(-1, *weights.shape[2:])
            rows = np.tile(cells, count), np.tile(pairs, count), of_cell
            result[:, pairs] = self._solve(*rows, joined, T).reshape(count, -1)
        return result

    def _solve(
        self,
        cells: _Rows,
        pairs: _Rows,
        of_cell: _Rows,
        known: Moduli,
        weights: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """:meth:`__call__` for some cells and the pairs that belong to them, ``of_cell`` the place
        of the cell of every pair among the cells, ascending (pairs,)."""
        dilatations = self._dilatations(cells, known.volume)
        factor, energy, pressed = self._energy_factor(cells, known.bulk, dilatations)
        # int_f h.T.h = |Z u|^2 and E = |R u|^2: with S = Z.R^-1 the eigenvalues are those of S.S^T,
        # but for the factors of both.
        Z, flux = self._flux_factor(
            pairs, known.traction, weights, None if dilatations is None else dilatations[of_cell]
        )
        S = np.linalg.solve(factor.transpose(0, 2, 1)[of_cell], Z.transpose(0, 2, 1))
        alone = np.linalg.eigvalsh(S.transpose(0, 2, 1) @ S)[:, -1]
        alone = np.maximum(alone, np.finfo(float).tiny)
        factors = flux / energy[of_cell]
        count = np.bincount(of_cell, minlength=len(factor))
        several = np.flatnonzero(count > 1)
        if not len(several):
            return pressed[of_cell] * alone * factors
        chosen = np.flatnonzero(count[of_cell] > 1)
        each = S[chosen] @ S[chosen].transpose(0, 2, 1) / alone[chosen, None, None]
        starts = np.flatnonzero(np.diff(of_cell[chosen], prepend=-1))
        together = np.add.reduceat(each, starts, axis=0)
        pressed[several] *= np.linalg.eigvalsh(together)[:, -1]
        return pressed[of_cell] * alone * factors

    def _dilatations(
        self, cells: _Rows, dJ: NDArray[np.float64] | None
    ) -> NDArray[np.float64] | None:
        """Change of theta with every shape function in every direction (cells, nodes, d).

        None if GRAD has no entry for theta.
        """
        if not self._mean_dilatation:
            return None
        gradients, volumes = (values[cells] for values in self._bulk)
        if dJ is None:
            identity = [float(i == j) for i, j in self._entries[:-1]]
            dJ = np.broadcast_to(identity, (*volumes.shape, len(identity)))
        shares = volumes / volumes.sum(axis=1, keepdims=True)
        changes = _contract(dJ[..., None], gradients)[:, :, 0]
        return np.einsum("cq,cqai->cai", shares, changes)

    def _energy_factor(
        self, cells: _Rows, A: NDArray[np.float64], dilatations: NDArray[np.float64] | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """R with E_K(u) = e |R.u|^2 (cells, n, n), regular, e (cells,), and the factor due to
        compression (cells,)."""
        gradients, volumes = (values[cells] for values in self._bulk)
        size = len(self._entries)
        first, second = self._triangle
        full = np.empty((*A.shape[:2], size, size))
        full[..., first, second] = full[..., second, first] = A
        modulus = power_of_two(np.trace(full, axis1=2, axis2=3).max(axis=1))
        volume = power_of_two(volumes.max(axis=1))
        L, pressed = _square_root(full / modulus[:, None, None, None], self._free)
        L *= np.sqrt(volumes / volume[:, None])[:, :, None, None]
        Y = self._columns(L, gradients, dilatations, self._length[cells])
        return np.linalg.qr(Y, mode="r"), modulus * volume, pressed

    def _flux_factor(
        self,
        pairs: _Rows,
        H: NDArray[np.float64],
        weights: NDArray[np.float64],
        dilatations: NDArray[np.float64] | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Z with int_f h.T.h = f |Z.u|^2 (pairs, rows, n), and f (pairs,)."""
        d = self._d
        gradients, areas = (values[pairs] for values in self._facets)
        cells = self._cell_of_pair[pairs]
        H = H.reshape(*H.shape[:2], d, H.shape[2] // d)
        # tau from an indefinite A may be indefinite: only its positive part can be matched.
        values, vectors = np.linalg.eigh(weights)
        compliance, area = power_of_two(values[:, -1]), power_of_two(areas.max(axis=1))
        root = vectors * np.sqrt(np.maximum(values / compliance[:, None], 0))[:, None]
        H = np.einsum("pqke,pkm->pqem", H, root)
        H *= np.sqrt(areas / area[:, None])[:, :, None, None]
        return self._columns(H, gradients, dilatations, self._length[cells]), compliance * area

    def _columns(
        self,
        tensor: NDArray[np.float64],
        gradients: NDArray[np.float64],
        dilatations: NDArray[np.float64] | None,
        length: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """tensor : GRAD by the dofs of a cell (cells, rows, n), see :func:`_contract`.

        The first node is fixed, as translations change neither energy nor fluxes. In generalized
        plane strain F_33 - 1 times the ``length`` (cells,) is an additional dof, in the last
        column.
        """
        if self._axial:
            tensor, axial = tensor[:, :, :-1], tensor[:, :, -1]
        of_nodes = joined_axes(_contract(tensor, gradients, dilatations), 3)
        count, points, m, size = of_nodes.shape
        columns = of_nodes.reshape(count, points * m, size)[..., self._free_dofs]
        if not self._axial:
            return columns
        return np.concatenate(
            [columns, axial.reshape(count, points * m, 1) / length[:, None, None]], axis=2
        )


def _square_root(
    A: NDArray[np.float64], free: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """L with L.L^T = |A| (cells, points, n, n), and (1 + gamma) / (1 - gamma) of the cells."""
    size = np.trace(A, axis1=2, axis2=3).max(axis=1)
    regular = (_REGULAR * size)[:, None, None]
    try:
        return np.linalg.cholesky(A + regular[..., None] * np.eye(A.shape[-1])), np.ones(len(A))
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(A)
        G, M = np.maximum(-values[..., 0], 0), values[..., free]
        gamma = G / np.maximum(M, G / _MOST_PRESSED + regular[..., 0])
        pressed = ((1 + gamma) / (1 - gamma)).max(axis=1)
        return vectors * np.sqrt(np.abs(values) + regular)[..., None, :], pressed


def _of_pairs(
    tau: NDArray[np.float64],
    delta: NDArray[np.float64],
    T: NDArray[np.float64],
    lambdas: NDArray[np.float64],
    stretch: NDArray[np.float64],
) -> NDArray[np.float64]:
    """s' of (**) (n,).

    Args:
        tau: Penalties (n, d, d) [MPa/mm].
        delta: Flux weights (n, 2, d, d).
        T: Of both facets (n, 2, d, d) [mm3/N].
        lambdas: Of both facets (n, 2).
        stretch: rho (n,).
    """
    per_area = np.column_stack([lambdas[:, 0], stretch * lambdas[:, 1]])
    compliances = delta @ np.linalg.solve(T, delta.swapaxes(2, 3))
    least = (per_area[:, :, None, None] * compliances).sum(axis=1)
    # Of tau^-1.least, whose eigenvalues are those of a symmetric matrix.
    return np.linalg.eigvals(np.linalg.solve(tau, least)).real.max(axis=1)


class Coercivity:
    """Factors on the penalties of all interfaces of a problem that keep the bonded form coercive.

    Cells see the facets of all interfaces, on whichever rank: the rank of a cell solves its
    problem, the rank of a facet raises the penalty. Collective.

    Args:
        stretches: rho of them (nf,).
        areas: Their areas (nf,) [mm2; mm in plane strain].
    """

    def __init__(
        self,
        u: fem.Function,
        bodies: Bodies,
        interfaces: Sequence[InterfaceFacets],
        stretches: Sequence[NDArray[np.float64]],
        areas: Sequence[NDArray[np.float64]],
    ):
        mesh = u.function_space.mesh
        self._d = mesh.geometry.dim
        self._cell_map = mesh.topology.index_map(mesh.topology.dim)
        cell = basix.CellType[mesh.topology.cell_name()]
        self._facets_of_cell = len(basix.topology(cell)[self._d - 1])
        self._slots = [f.cells * self._facets_of_cell + f.local for f in interfaces]
        self._stretches, self._areas = stretches, areas
        # Cells of a rigid wall have no energy; tau is chosen for the deformable side.
        soft = ~bodies.rigid
        marks = self._to_owners([1.0 * soft[f.cells][:, :, None] for f in interfaces])
        marks = marks[: self._cell_map.size_local * self._facets_of_cell, 0]
        self._solved = np.flatnonzero(marks)
        cells, local = np.divmod(self._solved, self._facets_of_cell)
        cells, local = cells.astype(np.int32), local.astype(np.int32)
        in_pieces = any(f.slides for f in interfaces)
        self._problems = CellProblems(u, bodies, cells, local, in_pieces)
        # A body at points may have any moduli between zero and the elastic ones.
        self._free = np.ones(len(cells))
        if bodies.points is not None:
            degree = u.function_space.ufl_element().degree
            name, rule = mesh.topology.cell_name(), bodies.points.rule
            most = free_stress_factor(name, degree, rule, bodies.mean_dilatation)
            self._free[bodies.points.has(cells)] = most

    def _to_owners(self, values: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
        """Sums of values (nf, 2, n) of the sides of pairs, by cell and facet in it (slots, n)."""
        vector, by_slot = self._by_slot(values[0].shape[2])
        for slots, value in zip(self._slots, values, strict=True):
            np.add.at(by_slot, slots, value)
        vector.scatter_reverse(la.InsertMode.add)
        return by_slot

    def _by_slot(self, size: int) -> tuple[la.Vector, NDArray[np.float64]]:
        """A vector of zeros, and its array by cell and facet in it (slots, size)."""
        vector = la.vector(self._cell_map, self._facets_of_cell * size)
        return vector, vector.array.reshape(-1, size)

    def moduli(self, chosen: Sequence[NDArray[np.bool_]] | None = None) -> Iterator[Moduli]:
        """What the factors have of the current displacement, see :meth:`__call__`."""
        return self._problems.moduli(self._needed(chosen))

    def _needed(self, chosen: Sequence[NDArray[np.bool_]] | None) -> NDArray[np.bool_] | None:
        if chosen is None:
            return None
        marks = [np.repeat(1.0 * one, 2).reshape(-1, 2, 1) for one in chosen]
        return self._to_owners(marks)[self._solved, 0] > 0

    def __call__(
        self,
        every: Sequence[Sequence[Stabilized]],
        states: Sequence[Iterable[Moduli]],
        chosen: Sequence[NDArray[np.bool_]] | None = None,
    ) -> list[list[NDArray[np.float64]]]:
        """The factors on the penalties for alpha = 0, per facet of every interface, in some states.

        Args:
            chosen: Facets whose factors are needed, those of others may be too small (nf,); None
                for all.
        """
        d = self._d
        means = np.array([self._means(one) for one in every])
        shape = len(every), len(self._solved), d, d
        lambdas = self._problems(means.reshape(shape), states, self._needed(chosen))
        return [self._factors(*one) for one in zip(every, means, lambdas, strict=True)]

    def _means(self, interfaces: Sequence[Stabilized]) -> NDArray[np.float64]:
        """T of every pair of cell and facet (n, d^2) [mm3/N]."""
        d, sums = self._d, []
        for (tau, delta), area in zip(interfaces, self._areas, strict=True):
            share = np.trace(delta, axis1=2, axis2=3)[..., None] / d
            # That of a side without a flux is not known, nor needed.
            weight = area[:, None, None] * (share != 0)
            T = np.einsum("faki,fakj->faij", delta, np.linalg.solve(tau[:, None], delta))
            T = T.reshape(-1, 2, d * d) / np.where(share == 0, 1.0, share)
            sums.append(np.concatenate([weight * T, weight], axis=2))
        total = self._to_owners(sums)[self._solved]
        some = total[:, -1:] > 0
        return np.where(some, total[:, :-1] / np.where(some, total[:, -1:], 1.0), np.eye(d).ravel())

    def _factors(
        self,
        interfaces: Sequence[Stabilized],
        means: NDArray[np.float64],
        lambdas: NDArray[np.float64],
    ) -> list[NDArray[np.float64]]:
        """Of T and lambda of every pair of cell and facet, the factors of every interface (nf,)."""
        d, results = self._d, []
        vector, by_slot = self._by_slot(d * d + 1)
        by_slot[self._solved, :-1] = means
        by_slot[self._solved, -1] = self._free * lambdas
        vector.scatter_forward()
        for slots, one, stretch in zip(self._slots, interfaces, self._stretches, strict=True):
            T, lambdas = by_slot[slots, :-1].reshape(-1, 2, d, d), by_slot[slots, -1]
            T = np.where((lambdas == 0)[..., None, None], np.eye(d), T)
            results.append(_of_pairs(*one, T, lambdas, stretch))
        return results
