"""Length of the process zone where a crack grows, compared with the facets that resolve it.

Softening takes place in a zone ahead of a crack, where the bond carries tractions of the order of
its strength P up to gaps of the order of 2 G/P, with G its fracture energy. The zone is as long as
it must be for the bodies of both sides, i = 1, 2, to give way by this gap under these tractions,

    l_p = ((2 G/P^2)/(c_1 + c_2))^(1/p),

with a power p and compliances c of

    1, 1/E'             large bodies: l_1 = E' G/P^2 (Hillerborg, Modeer and Petersson 1976, Cement
                        and Concrete Research 6, 773),
    4, 12/(E_x t^3)     a plate of thickness t that bends, E_x t^3/12 d4w/dx4 = -P (Suo, Bao and
                        Fan 1992, Journal of the Mechanics and Physics of Solids 40, 1),
    2, 1/(E_x t)        a plate that slides, E_x t d2u/dx2 = P.

In opening it is the smaller one of l_1 and l_4, in shear of l_1 and l_2, with P and G of the mode.
x is the direction in which the crack grows. With the moduli A, and m = x cos a + N sin a,
n = N cos a - x sin a,

    H(a) = Q - R.T^-1.R^T,  Q_ik = A_ijkl m_j m_l,  R_ik = A_ijkl m_j n_l,  T_ik = A_ijkl n_j n_l

is the stiffness of a thin layer along m with free faces, E_x = x.H(0).x, and the diagonal of L^-1,
L the mean of H over a, is 2/E' in opening and in shear (the tensor L of Barnett and Lothe; Ting
1996, Anisotropic Elasticity, section 7.6). For isotropic bodies E_x = E' = E/(1 - nu^2).

A layer thinner than l, as of an adhesive between plates, has other bodies behind it, which decide
about l: nothing is told of it.

A facet of degree k and length h has k + 1 points along x. With fewer than three in the zone,

    y = 3 h/((k + 1) l) > 1,

a point reaches its strength without the others: the bond resists beyond its fracture energy (Turon,
Davila, Camanho and Costa 2007, Engineering Fracture Mechanics 74, 1665, whose remedy is a lower
strength with the same energy, here such that y = 1). Double cantilever beams and beams in shear,
isotropic and orthotropic, of degree 1 and 2, have peaks higher by 0.04 y^2 to 0.09 y^2 up to y = 4
(`demos/ACCURACY.md`).
"""

from __future__ import annotations

from numbers import Real
from typing import NamedTuple
from weakref import WeakSet

import basix
import numpy as np
import ufl
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..assembly.space import node_pieces
from ..base.parallel import global_any, global_max, global_sum, warn_together
from ..domain.moduli import RegionExpressions
from ..domain.shapes import GeometryMap, determinants
from ..domain.topology import facet_corners
from ..forms import kinematics
from ..forms.kinematics import Body
from ..interface.active import ActiveInterface
from ..laws.base import separation
from ..problem.problem import Problem

Array = NDArray[np.float64]

#: Traction relative to the strength below which a bond is sound.
CARRIED = 0.5

#: y above which a facet is too long: the numbers that a warning names are rounded.
TOLD = 1.01

#: Excess of a peak, relative to y^2, and the y up to which it was measured.
EXCESS, MEASURED = 0.07, 4.0

#: Thicknesses that differ by this, relative, are those of different bodies; loads likewise.
SAME = 1e-6

#: Number of angles of the mean of H, which is periodic: the trapezoidal rule converges fast.
ANGLES = 24

#: Bulk modulus with mean dilatation, relative to the largest of the moduli, which are deviatoric.
INCOMPRESSIBLE = 1e4

#: Problems with a warning.
_told: WeakSet[Problem] = WeakSet()


class Zones(NamedTuple):
    """Process zones at facets in which a crack tip is."""

    length: Array  # l (n,) [mm]
    size: Array  # h (n,) [mm]
    thickness: Array  # t where a plate makes l short, else inf (n,) [mm]
    strength: Array  # That with y = 1 at the same fracture energy, relative to the given one (n,)
    y: Array  # Of the module (n,)


class ZoneWatch:
    """Warns once in the life of a problem where a crack grows, or on a finer mesh would grow, along
    facets that are too long."""

    def __init__(self, problem: Problem):
        self._problem, self._thickness = problem, {}
        # By interface and facet the load from which it is told, inf where it is short enough.
        self._known: dict[int, dict[int, float]] = {}

    def look(self) -> None:
        """Warn if the tip of a crack is in a facet that is too long; collective."""
        problem, worst, message = self._problem, TOLD, None
        if problem in _told:
            return
        for number, active in problem.discretization.active.items():
            if not active.law.has_bond:
                continue
            tips, loads = _tips(active)
            known = self._known.setdefault(number, {})
            new = np.array([f for f in tips if f not in known], dtype=np.int32)
            if global_any(problem.comm, len(new) > 0):
                for f, y in zip(new, self._zones(number, active, new).y, strict=True):
                    known[f] = max(1 / (1 + EXCESS * y**2), CARRIED) if y > TOLD else np.inf
            told = tips[
                np.array([a >= known[f] for f, a in zip(tips, loads, strict=True)], dtype=bool)
            ]
            if not global_any(problem.comm, len(told) > 0):
                continue
            zones = self._zones(number, active, told)
            largest = global_max(problem.comm, float(zones.y.max(initial=0.0)))
            if largest > worst:
                worst, mine = largest, zones.y.max(initial=0.0) == largest
                message = self._words(number, zones) if mine else None
        if worst > TOLD:
            _told.add(problem)
            warn_together(problem.comm, message)

    def _zones(self, number: int, active: ActiveInterface, tips: NDArray[np.int32]) -> Zones:
        """Zones of some facets; collective."""
        problem, d, k = self._problem, active.quadrature.d, self._problem.space.ufl_element().degree
        facets, q, history = active.facets, active.quadrature, active.history
        if number not in self._thickness:
            self._thickness[number] = _thickness(problem, number)
        place, load = facets.facets[q.facet], load_of(active)
        rows = np.array([np.flatnonzero(facets.facets == f)[0] for f in tips], dtype=np.intp)
        cells, corners = facets.cells[rows], facet_corners(problem.mesh, tips)[:, :, :d]
        N, x, c = np.zeros((len(tips), d)), np.zeros((len(tips), d)), np.zeros(len(tips))
        for n, f in enumerate(tips):
            points = np.flatnonzero(place == f)
            mean = q.normal[points].mean(axis=0)
            N[n] = mean / np.linalg.norm(mean)
            first = points[np.argmax(load[points])]
            X = q.points[points, :d] - q.points[points, :d].mean(axis=0)
            X -= np.outer(X @ N[n], N[n])
            # The steepest descent of the load: two points alone may lie askew to it.
            way = -np.linalg.lstsq(X, load[points] - load[points].mean(), rcond=1e-9)[0]
            if not np.abs(X @ way).max() > SAME * load[points].max():  # a peak in the middle
                way = X[np.argmin(load[points])] - X[np.argmax(load[points])]
            x[n] = way / np.linalg.norm(way)
            moved = history.gap[first] if history.gap[first].any() else history.traction[first]
            moved = moved / np.linalg.norm(moved) if moved.any() else N[n]
            c[n] = max(moved @ q.normal[first], 0.0) ** 2
        along = np.einsum("fci,fi->fc", corners, x)
        size = along.max(axis=1, initial=-np.inf) - along.min(axis=1, initial=np.inf)
        compliance, plate = _stiffness(problem, cells, N, x)
        t, depth = (values[cells] for values in self._thickness[number])
        law, need = facets.law.at(rows), 3 * size / (k + 1)
        length, strength, thickness = np.zeros((3, 2, len(tips)))
        for mode, (p, bends) in enumerate(((4, 12 / (plate * t**3)), (2, 1 / (plate * t)))):
            P, G = separation(law, d, mode)
            large = 2 * G / P**2 / compliance[:, :, mode].sum(axis=1)
            thin = (2 * G / P**2 / bends.sum(axis=1)) ** (1 / p)
            length[mode] = np.minimum(large, thin)
            strength[mode] = np.minimum((large / need) ** 0.5, (thin / need) ** (p / 2))
            thickness[mode] = np.where(thin < large, t.min(axis=1), np.inf)
        length = c * length[0] + (1 - c) * length[1]
        strength = c * strength[0] + (1 - c) * strength[1]
        thickness = np.where(c > 0.5, *thickness)
        # Behind a layer thinner than its zone are other bodies, and they decide.
        length[((depth < (1 - SAME) * t) & (depth < length[:, None])).any(axis=1)] = np.inf
        return Zones(length, size, thickness, strength, need / length)

    def _words(self, number: int, zones: Zones) -> str:
        problem, f = self._problem, int(np.argmax(zones.y))
        length, size, t, share, y = (float(values[f]) for values in zones)
        active = problem.discretization.active[number]
        strength = share * float(np.max(active.facets.law.strength))
        k = problem.space.ufl_element().degree
        excess = (
            f"about {100 * EXCESS * y**2:.0f} % too high"
            if y <= MEASURED
            else "more than twice as high as it should be"
        )
        plate = "" if t == np.inf else f" next to a part of t = {t:.3g} mm"
        return (
            f"{active.facets.label}: a crack grows, or on a finer mesh would, along facets of "
            f"{size:.3g} mm, too long for its process zone, {length:.3g} mm{plate}: the bond "
            f"resists beyond its fracture energy, and the peak of the load may be {excess}. Use "
            f"facets of about {(k + 1) / 3 * length:.3g} mm where it grows, a higher degree, or "
            f"Interface(..., largest_strength={strength:.3g}), which these facets can carry with "
            "the same fracture energy and which rounds the peak"
        )


def load_of(active: ActiveInterface) -> Array:
    """Traction relative to the strength at the points of an interface (nq,), 1 where bonds have
    begun to fail."""
    q, T, law = active.quadrature, active.history.traction, active.law
    normal = np.einsum("pi,pi->p", T, q.normal)
    shear = np.linalg.norm(T - normal[:, None] * q.normal, axis=1)
    fails = active.history.softening / law.strength > active.facets.damage[q.facet]
    return np.where(fails, 1.0, law.utilization(normal, shear))


def _tips(active: ActiveInterface) -> tuple[NDArray[np.int32], Array]:
    """Facets with the tip of a crack, and the largest load of their points (n,).

    There it varies by a factor of two at least, other than where a section fails at once.
    """
    load, rows = load_of(active), active.facets.facets[active.quadrature.facet]
    near = np.isin(rows, rows[load >= CARRIED])
    tips, place = np.unique(rows[near], return_inverse=True)
    most, least = np.zeros(len(tips)), np.full(len(tips), np.inf)
    np.maximum.at(most, place, load[near])
    np.minimum.at(least, place, load[near])
    steep = least < most / 2
    return tips[steep], most[steep]


def _stiffness(
    problem: Problem, cells: NDArray[np.int32], N: Array, x: Array
) -> tuple[Array, Array]:
    """1/E' in opening and in shear (n, 2, 2) [1/MPa] and E_x (n, 2) [MPa] of both sides, 0 and inf
    of rigid ones, for normals N of facets and directions x of growth (n, d); collective."""
    bodies, d = problem.discretization.bodies, x.shape[1]

    def moduli(body: Body, F: Expr) -> Expr:
        A = kinematics.bulk_moduli(body.elastic, bodies.geometry, F)
        r = range(d)
        return ufl.as_vector([A[i, j, k, m] for i in r for j in r for k in r for m in r])

    used = np.unique(cells)
    regions = np.unique(np.concatenate(problem.comm.allgather(np.unique(bodies.region[used]))))
    middle = basix.geometry(problem.mesh.basix_cell()).mean(axis=0, keepdims=True)
    found = RegionExpressions(problem.u, bodies, regions, moduli, middle, "stiffness")
    A = found(bodies.region[used], used)[:, 0].reshape(-1, d, d, d, d)
    if bodies.mean_dilatation:
        one = np.einsum("ij,kl->ijkl", np.eye(d), np.eye(d))
        A = (
            A
            + INCOMPRESSIBLE
            * np.abs(A).max(axis=(1, 2, 3, 4), initial=0.0)[:, None, None, None, None]
            * one
        )
    A = A[np.searchsorted(used, cells)]
    angles = np.arange(ANGLES) * np.pi / ANGLES
    layers = [layer(A, N, x, a) for a in angles]
    inverse = np.linalg.inv(np.mean(layers, axis=0)) if len(cells) else np.zeros_like(A[..., 0, 0])
    c = [np.einsum("fi,fsij,fj->fs", a, inverse, a) / 2 for a in (N, x)]
    plate = np.einsum("fi,fsij,fj->fs", x, layers[0], x)
    rigid = bodies.rigid[cells]
    return np.where(rigid[:, :, None], 0.0, np.stack(c, axis=2)), np.where(rigid, np.inf, plate)


def layer(A: Array, N: Array, x: Array, angle: float) -> Array:
    """H(a) of moduli A (n, 2, d, d, d, d)."""
    m, n = np.cos(angle) * x + np.sin(angle) * N, np.cos(angle) * N - np.sin(angle) * x
    Q, R, T = (
        np.einsum("fsijkl,fj,fl->fsik", A, one, two) for one, two in ((m, m), (m, n), (n, n))
    )
    return Q - R @ np.linalg.solve(T, np.swapaxes(R, 2, 3))


def _thickness(problem: Problem, number: int) -> tuple[Array, Array]:
    """Thickness of the part to which a cell belongs if only this interface separates, and of its
    own material in that part; by local cell, collective [mm].

    Thickness of a plate with the same smallest moment of inertia: exact for plates and straight
    films, of the order of the size for other parts.
    """
    joined = [
        active.facets.cells
        for i, active in problem.discretization.active.items()
        if i != number or active.interface.within is not None
    ]
    parts = node_pieces(problem.space, joined)[problem.space.dofmap.list[:, 0]]
    layers = parts.astype(np.int64) * len(problem.materials) + _materials(problem)
    owned = problem.mesh.topology.index_map(problem.mesh.topology.dim).size_local
    moments = _cell_moments(problem.mesh, owned)
    return _thickness_of(problem, parts, moments), _thickness_of(problem, layers, moments)


def _materials(problem: Problem) -> NDArray[np.int64]:
    """Number of the material of every local cell; equal for groups of equal materials."""
    known: list[object] = []
    numbers = np.zeros(len(problem.discretization.bodies.tags), dtype=np.int64)
    for tag, material in problem.materials.items():
        values = ((k, v if isinstance(v, Real) else id(v)) for k, v in material.parameters.items())
        name = material.kernel_key, tuple(values)
        if name not in known:
            known.append(name)
        numbers[problem.discretization.bodies.cells_of[tag]] = known.index(name)
    return numbers


def _thickness_of(problem: Problem, label: NDArray[np.int64], of_cells: Array) -> Array:
    """That of all cells of a label together, by local cell; collective [mm]."""
    owned, d = len(of_cells), problem.mesh.geometry.dim
    known = np.unique(np.concatenate(problem.comm.allgather(np.unique(label[:owned]))))
    place = np.searchsorted(known, label)
    moments = np.zeros((len(known), 1 + d + d * d))
    np.add.at(moments, place[:owned], of_cells)
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
