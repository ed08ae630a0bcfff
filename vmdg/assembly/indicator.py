"""Where a mesh is too coarse: the energy of the fine scales, in bodies and on interfaces.

The fine scales of a facet between two cells, (20), are its bubbles with the amplitude
u~_a = tau_a.r_a, where r_a is what its tractions leave unbalanced on side a. As (18) is their
equilibrium, int_K GRAD u~ : A : GRAD u~ dV = int r_a.tau_a.r_a dA. With (23) and (24),
j = [[P.N]] and s = [[u]] - zeta,

    r_1 = -delta_2.j - tau.s,    r_2 = -delta_1.j + tau.s,    tau = (tau_1 + tau_2)^-1,
    r_1.tau_1.r_1 + r_2.tau_2.r_2 = j.delta_s.j + s.tau.s,

since tau_1.delta_2 = tau_2.delta_1 = delta_s, (25). Inside a body displacements are continuous,
s = 0, and the jump of the stress alone remains. Nothing is adjusted: tau has no safety factor.
Bubbles are what triangles and tetrahedra of degree 1 lack most, so that

    eta^2 = sum over facets int j.delta_s.j + s.tau.s dA

estimates the error of the energy norm, int GRAD e : A : GRAD e dV. What is unbalanced within cells
is left out: jumps dominate (Carstensen and Verfuerth 1999, SIAM Journal on Numerical Analysis 36,
1571), least in quadrilaterals and hexahedra, whose errors are larger than that.
"""

from __future__ import annotations

import numpy as np
from dolfinx import fem, la
from numpy.typing import NDArray

from ..base.parallel import global_sum
from ..domain.topology import facet_cells, local_facets
from ..interface.active import ActiveInterface, fine_scales, update_points
from ..laws import Bonded
from ..laws.base import separation
from ..points.facets import InterfaceFacets
from ..points.interface import Interface
from .discretization import Discretization

Array = NDArray[np.float64]


def cell_errors(now: Discretization) -> fem.Function:
    """eta of the cells, half of a facet's square in each of its two, relative to the energy norm
    (2 W)^1/2 of the displacement; of degree 0 [-]; collective."""
    space = fem.functionspace(now.mesh, ("DG", 0))
    found = fem.Function(space, name="indicator")
    inside = _inside(now)
    inside.apply(inside.stabilizer.derive())
    update_points([inside], 1.0)
    for active in (inside, *now.active.values()):
        square, cells = _squares(active), active.facets.cells
        for side in range(2):
            np.add.at(found.x.array, cells[:, side], square / 2)
    found.x.scatter_reverse(la.InsertMode.add)
    found.x.scatter_forward()
    scale = 2 * global_sum(now.mesh.comm, now.stored_energy()[0])
    thickness = float(now.geometry.thickness)
    found.x.array[:] = np.sqrt(thickness * found.x.array / scale) if scale > 0 else 0.0
    return found


def _inside(now: Discretization) -> ActiveInterface:
    """All facets inside bodies, which are closed, as a tie."""
    mesh, bodies = now.mesh, now.bodies
    pairs = facet_cells(mesh)
    chosen = (pairs >= 0).all(axis=1) & ~bodies.rigid[pairs].any(axis=1)
    for active in now.active.values():
        chosen[active.facets.cut] = False
    chosen[mesh.topology.index_map(mesh.topology.dim - 1).size_local :] = False
    facets = np.flatnonzero(chosen).astype(np.int32)
    cells, law = pairs[facets], Bonded()
    local = np.column_stack([local_facets(mesh, cells[:, a], facets) for a in range(2)])
    none, label = np.zeros(len(facets)), "inside bodies"
    placed = InterfaceFacets(facets, cells, local, bodies.tags[cells], facets, none, law, label)
    return ActiveInterface(Interface(facets=facets, law=law), placed, now.u, bodies)


def _squares(active: ActiveInterface) -> Array:
    """int j.delta_s.j + s.tau.s of every facet (nf,) [N mm; N in plane strain]."""
    known, values, q = active.stabilization, active.values, active.quadrature
    tau = known.tau / known.safety[:, None, None]
    square = np.zeros(len(q.weights))
    for vector, tensor in ((values.jump, known.delta_s), (values.elastic_opening, tau)):
        square += np.einsum("pi,pij,pj->p", vector, tensor[q.facet], vector)
    return np.bincount(q.facet, q.weights * square, minlength=len(active.facets.facets))


def facet_errors(active: ActiveInterface) -> Array:
    """Largest fine scale (24) of the points of a facet relative to the critical gap 2 G_c/P_c of
    opening (nf,) [-]."""
    sizes = np.linalg.norm(fine_scales(active), axis=2).max(axis=1)
    strength, energy = separation(active.facets.law, active.quadrature.d, 0)
    most = np.zeros(len(active.facets.facets))
    np.maximum.at(most, active.quadrature.facet, sizes)
    return most / np.broadcast_to(2 * energy / strength, most.shape)
