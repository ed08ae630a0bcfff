"""Length of process zones at crack tips, compared with the distance of the points that resolve
them.

Softening takes place in a zone ahead of a crack. In large bodies the zone of a growing crack is
about as long as the characteristic length of Hillerborg, Modeer and Petersson (1976, Cement and
Concrete Research 6, 773),

    l = E' G_c / P_c^2,

shorter by a factor of 0.2 to 0.9 depending on the shape of the curve (Turon, Davila, Camanho and
Costa 2007, Engineering Fracture Mechanics 74, 1665, Table 1); between two materials 2/E' = 1/E'_1 +
1/E'_2. An adjacent part of thickness t < l acts as a beam on the bond (Suo, Bao and Fan 1992,
Journal of the Mechanics and Physics of Solids 40, 1; Bao and Suo 1992, Applied Mechanics Reviews
45, 355). Where it slides, its force N follows from the shear stress of the bond, dN/dx = tau, and
the slip from its strain, d(slip)/dx = N/(E' t). With tau of the order of P_c, up to slips of the
order of G_c/P_c,

    l_s = (E' t G_c)^(1/2) / P_c = (l t)^(1/2).

Where it opens it bends, E' t^3/12 d4w/dx4 = -sigma, which gives l^1/4 t^3/4 in the same way, less
than l_s for t < l. So min(l, l_s) is an upper bound, with the larger l of opening and shear: if it
is too short for a mesh, the zone is even shorter.

A facet of degree k has k + 1 points along a crack. If the zone is shorter than their distance, a
point reaches its strength without load sharing by those behind it: the bond resists far beyond its
fracture energy. Three facets of degree 1 in the zone give the fracture energy (Turon et al., who
reduce P_c at the same G_c for coarse meshes).
"""

from __future__ import annotations

from typing import NamedTuple

import basix
import numpy as np
import ufl
from dolfinx.mesh import Mesh, entities_to_geometry
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..assembly.space import node_pieces
from ..base.parallel import global_box, global_sum
from ..domain.moduli import RegionExpressions
from ..domain.shapes import GeometryMap, determinants
from ..forms import kinematics
from ..forms.kinematics import Body
from ..laws.base import separation
from ..points.facets import InterfaceFacets
from ..problem.problem import Problem

Array = NDArray[np.float64]

#: Number of facets along an interface below which no crack growth is assumed.
FACETS = 4

#: Strength relative to E' above which bonds are assumed unbreakable.
STRONG = 0.1


class Zones(NamedTuple):
    """Process zones at the owned facets of an interface.

    Attributes:
        length: Upper bound (nf,) [mm].
        thickness: Thickness of a thin adjacent part, inf if there is none (nf,) [mm].
        edge: Shortest one of the facets (nf,) [mm].
    """

    length: Array
    thickness: Array
    edge: Array


def process_zones(problem: Problem) -> dict[int, Zones]:
    """Zones of all interfaces with a bond, by their number; collective."""
    chosen = {
        i: facets for i, facets in enumerate(problem.step.activation.facets) if facets.law.has_bond
    }
    if not chosen:
        return {}
    cells = np.unique(np.concatenate([facets.cells.ravel() for facets in chosen.values()]))
    E = _moduli(problem, cells)
    return {i: _zones(problem, i, facets, E) for i, facets in chosen.items()}


def _zones(problem: Problem, number: int, facets: InterfaceFacets, E: Array) -> Zones:
    """Zones of one interface; ``E`` are the moduli E' of local cells."""
    d = problem.mesh.geometry.dim
    ends = [separation(facets.law, d, axis) for axis in (0, 1)]
    length = np.maximum(*(energy / strength**2 for strength, energy in ends))[:, None]
    both = np.where(problem.discretization.bodies.rigid, np.inf, E)[facets.cells]
    wide = (2 / (1 / both).sum(axis=1, keepdims=True) * length)[:, 0]
    t = _thickness(problem, number)[facets.cells]
    slender = np.sqrt(both * length * t)
    thinner = slender.argmin(axis=1)[:, None]
    narrow = np.take_along_axis(slender, thinner, axis=1)[:, 0]
    t = np.take_along_axis(t, thinner, axis=1)[:, 0]
    # No crack growth without a bond, with a strength of the order of the moduli, or along a few
    # facets that fail at once, such as the cross section of a bar.
    never = (facets.damage >= 1) | (ends[0][0] > STRONG * both.min(axis=1, initial=np.inf))
    corners = _corners(problem.mesh, facets.facets)
    edges = _shortest_edges(corners)
    low, high = global_box(problem.comm, corners.reshape(-1, 3))
    never |= edges * FACETS > (high - low).max()
    found = np.where(never, np.inf, np.minimum(wide, narrow))
    return Zones(found, np.where(narrow < wide, t, np.inf), edges)


def _moduli(problem: Problem, cells: NDArray[np.int32]) -> Array:
    """E' of some local cells in plane strain, by local cell, 0 elsewhere; collective [MPa].

    4 G (M - G)/M, with means over the directions of the plane or space of M = A_iiii and G =
    A_ijij: E/(1 - nu^2) for isotropic bodies, and E in plane stress, where A is that of the sheet.
    """
    bodies, u = problem.discretization.bodies, problem.u
    d, cell_map = (
        problem.mesh.geometry.dim,
        problem.mesh.topology.index_map(problem.mesh.topology.dim),
    )

    def means(body: Body, F: Expr) -> Expr:
        A = kinematics.bulk_moduli(body.elastic, bodies.geometry, F)
        normal = sum(A[i, i, i, i] for i in range(d)) / d
        shear = sum(A[i, j, i, j] for i in range(d) for j in range(d) if i != j) / (d * d - d)
        return ufl.as_vector([normal, shear])

    regions = np.unique(np.concatenate(problem.comm.allgather(np.unique(bodies.region[cells]))))
    corners = basix.geometry(problem.mesh.basix_cell())
    middle = corners.mean(axis=0, keepdims=True)
    found = RegionExpressions(u, bodies, regions, means, middle, "stiffness")
    M, G = found(bodies.region[cells], cells)[:, 0].T
    result = np.zeros(cell_map.size_local + cell_map.num_ghosts)
    # With mean dilatation A contains the deviatoric part only.
    result[cells] = 4 * G if bodies.mean_dilatation else 4 * G * (M - G) / M
    return result


def _thickness(problem: Problem, number: int) -> Array:
    """Thickness of the part to which a cell belongs if only this interface separates; collective
    [mm].

    Thickness of a plate with the same smallest moment of inertia: exact for plates and straight
    films, of the order of the size for other parts. By local cell.
    """
    joined = [
        active.facets.cells
        for i, active in problem.discretization.active.items()
        if i != number or active.interface.within is not None
    ]
    label = node_pieces(problem.space, joined)[problem.space.dofmap.list[:, 0]]
    owned = problem.mesh.topology.index_map(problem.mesh.topology.dim).size_local
    parts = np.unique(np.concatenate(problem.comm.allgather(np.unique(label[:owned]))))
    place, d = np.searchsorted(parts, label), problem.mesh.geometry.dim
    moments = np.zeros((len(parts), 1 + d + d * d))
    np.add.at(moments, place[:owned], _cell_moments(problem.mesh, owned))
    volume, first, second = np.split(global_sum(problem.comm, moments), [1, 1 + d], axis=1)
    centre = first / volume
    spread = second.reshape(-1, d, d) / volume[:, :, None] - centre[:, :, None] * centre[:, None]
    least = np.linalg.eigvalsh(spread)[:, 0]
    return np.sqrt(12 * np.maximum(least, 0))[place]


def _cell_moments(mesh: Mesh, owned: int) -> Array:
    """Integrals of 1, X and X X over the owned cells (cells, 1 + d + d d)."""
    points, weights = basix.make_quadrature(mesh.basix_cell(), 4)
    shape = GeometryMap(mesh, points)
    nodes = shape.nodes(slice(0, owned))
    dV = np.abs(determinants(shape.jacobians(nodes))) * weights
    X = shape.positions(nodes)
    first = np.einsum("cq,icq->ci", dV, X)
    second = np.einsum("cq,icq,jcq->cij", dV, X, X, optimize=True)
    # A rank may own no cells.
    return np.column_stack([dV.sum(axis=1), first, second.reshape(len(dV), first.shape[1] ** 2)])


def _corners(mesh: Mesh, facets: NDArray[np.int32]) -> Array:
    """Corners of facets (nf, corners, 3) [mm]."""
    dim = mesh.topology.dim - 1
    count = len(basix.geometry(basix.cell.subentity_types(mesh.basix_cell())[dim][0]))
    if not len(facets):  # entities_to_geometry divides by their number
        return np.zeros((0, count, 3))
    return mesh.geometry.x[entities_to_geometry(mesh, dim, facets)[:, :count]]


def _shortest_edges(corners: Array) -> Array:
    """Shortest edges of facets (nf,) [mm]."""
    apart = np.linalg.norm(corners[:, :, None] - corners[:, None], axis=3)
    itself = np.arange(corners.shape[1])
    apart[:, itself, itself] = np.inf
    return apart.min(axis=(1, 2), initial=np.inf)
