"""How much larger tau_s must be where the stress is computed at points.

Condition (*) of :mod:`vmdg.interface.coercivity` has the flux h = (A : GRAD u).N of elastic moduli.
A body at points has h_p = sum_q E_pq (A_q : GRAD u(X_q)).N with moduli A_q of every point, anywhere
between zero and the elastic A, and E_K = sum_q w_q GRAD u : A_q : GRAD u. With the stresses
sigma_q = A_q : GRAD u, and since A_q^-1 >= A^-1,

    int_f |h|^2 / E_K <= max sum_p w_p |sum_q E_pq sigma_q.N|^2 / sum_q w_q sigma_q : A^-1 : sigma_q

over all stresses at the points, in which A and E separate: the largest squared singular value of
sqrt(w_p) E_pq / sqrt(w_q) times the largest eigenvalue of N.A.N. It depends on no state, however
small A_q: a facet with a history of its own could be elastic while its cell is plastic, and the
ratio would be unbounded. With mean dilatation it holds for the gradients of u_bar.
"""

from __future__ import annotations

from functools import cache

import basix
import basix.ufl
import numpy as np

from ..base.quadrature import facet_degree
from ..domain.point_bodies import extrapolation


@cache
def free_stress_factor(cell: str, degree: int, bulk: int, mean: bool = False) -> float:
    """The largest such maximum over that of the elastic flux of a facet, on the reference cell.

    For A of Poisson's ratio zero, which gives the largest ratio: 1 for triangles and tetrahedra of
    degrees 1 and 2, where any stress at the points is that of a displacement, 2.8 and 2.1 for
    quadrilaterals and 2.5 and 2.1 for hexahedra of these degrees.

    With mean dilatation the elastic flux of a nearly incompressible cell has no more than that of
    uniform strains, of which the largest eigenvalue is that of N.A.N times area over volume: 4.
    """
    kind = basix.CellType[cell]
    corners, d = basix.geometry(kind), basix.geometry(kind).shape[1]
    points, weights = basix.make_quadrature(kind, bulk)
    element, coefficients = extrapolation(kind, points)
    shape = basix.ufl.element("Lagrange", kind, degree)
    # A : e is the symmetric part of e, in units of E.
    one = np.eye(d)
    A = (np.einsum("ik,jl->ijkl", one, one) + np.einsum("il,jk->ijkl", one, one)) / 2

    def gradients(x: np.ndarray) -> np.ndarray:
        """(points, d, d, dofs)."""
        slopes = shape.tabulate(1, x)[1:]
        return np.einsum("jpn,ki->pkjni", slopes, one).reshape(len(x), d, d, -1)

    B = gradients(points)
    energies, modes = np.linalg.eigh(np.einsum("q,qijn,ijkl,qklm->nm", weights, B, A, B))
    strained = energies > 1e-10 * energies[-1]
    modes = modes[:, strained] / np.sqrt(energies[strained])
    facet = basix.cell.subentity_types(kind)[d - 1][0]
    places, areas = basix.make_quadrature(facet, facet_degree(degree))
    ratios = []
    for nodes in basix.topology(kind)[d - 1]:
        edges = corners[nodes[1:d]] - corners[nodes[0]]
        x = np.ascontiguousarray(corners[nodes[0]] + places @ edges)
        N = np.linalg.svd(edges)[2][-1]
        area = areas * np.sqrt(np.linalg.det(edges @ edges.T))
        flux = np.einsum("j,ijkl,pklm->pim", N, A, gradients(x)) @ modes
        most = np.linalg.eigvalsh(np.einsum("j,ijkl,l->ik", N, A, N))[-1]
        if mean:
            elastic = most * area.sum() / weights.sum()
        else:
            elastic = np.linalg.eigvalsh(np.einsum("p,pim,pin->mn", area, flux, flux))[-1]
        E = element.tabulate(0, x)[0] @ coefficients
        size = np.linalg.norm(np.sqrt(area)[:, None] * E / np.sqrt(weights), ord=2)
        ratios.append(size**2 * most / elastic)
    return max(1.0, *ratios)
