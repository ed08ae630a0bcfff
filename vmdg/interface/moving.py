"""An interface of surfaces that slide: its points are paired again in every state.

A point of side 1 and its partner are those that lie opposite each other in the current
configuration, so that both change with the displacement. What a point has undergone is counted by
pairs: its slip so far is such that the relative displacement of the present pair in the step is
what slides,

    zeta_T,n = [R^T.(x_2 - x_1)]_T(u_n) - s_n,    zeta_N,n >= 0,

with s_n the elastic opening between the nearest points of the facet at the end of the last step,
see :meth:`CommittedPoints.at`; points next to each other have one.
(Carrying zeta itself from point to point is a ratchet: a block without friction would lose half of
its normal force within 1.2 of its lengths.) The tangent knows how pairs move. tau_s of a pair
follows from its facets, for which it is derived once a step.

The frame is that of side 1, so that moments balance for any pair.

A facet of side 1 keeps its pairs of the reference configuration while a point of it is bonded: a
surface may debond in one place and slide in another.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import scipy
from dolfinx import fem
from numpy.typing import NDArray

from ..base.parallel import gathered, global_any, global_sum
from ..domain.materials import Bodies
from ..domain.topology import box_sides
from ..laws import Mode
from ..points.interface import AUTO, Interface
from ..points.pair_points import NO_GAP, PairPoints
from ..points.pairing import PairedFacets
from .active import ActiveInterface
from .coercivity import margin
from .frame import TurningTangent
from .history import InterfaceSnapshot, PointHistory, with_rows
from .parted import BondedArea, turned
from .partners import PartnerTangent
from .stabilization import GOOD_RATIO, BubbleIntegrals, Stabilization, Stabilizer
from .values import InterfaceState, PointValues, joined

Array = NDArray[np.float64]

#: Distance of points of two facets, relative to their radii, by which points find the nearest one
#: of their own facet.
_FAR = 1e3

#: Distance of points, relative to the radius of their facet, within which they carry one s.
_CLOSE = 0.05

#: Distances below this, relative to the size of the surface, are rounding.
_SAME = 1e-12

#: Relative difference of int |T_n - T_n+1| dA that is more than rounding.
_CLOSER = 1e-9


@dataclass(frozen=True)
class SurfaceStabilization(Stabilization):
    """By facets of both surfaces, those of side 1 first: c of :mod:`.coercivity` in ``norm``."""

    own: Array  # tau_1 or tau_2 of (21) (n, d, d) [MPa/mm]


@dataclass(frozen=True)
class PairStabilization(Stabilization):
    """Of pairs.

    Attributes:
        taken_in: Numbers of the pairs that are not left out, see :class:`.ActiveInterface`; None
            for all.
    """

    surfaces: SurfaceStabilization
    taken_in: NDArray[np.intp] | None = None


class EachFacet(NamedTuple):
    """Facets of both surfaces, each as both sides of a pair."""

    cells: NDArray[np.int32]  # Cells (n, 2)
    local: NDArray[np.int32]  # Numbers of the facets in them (n, 2)
    slides: bool = True  # As for :class:`.InterfaceFacets`


class SurfaceStabilizer(Stabilizer):
    """Derives what the stabilization of any pair follows from, on all facets of two surfaces."""

    def __init__(
        self, interface: Interface, quadrature: PairPoints, u: fem.Function, bodies: Bodies
    ):
        self.interface, self._quadrature, self._turns = interface, quadrature, True
        self.automatic = interface.safety == AUTO
        degree = u.function_space.ufl_element().degree
        self.margin = margin(interface.law, degree)
        sides = quadrature.facets.surfaces.sides
        self._first = len(sides[0].facets)
        own = [np.concatenate([getattr(one, name) for one in sides]) for name in ("cells", "local")]
        self.facets = EachFacet(*(np.column_stack([array, array]) for array in own))
        self._stiffness = BubbleIntegrals(u, bodies, *own)
        self._factor = quadrature.bubble_factors_of(*own)
        self._rigid = bodies.rigid[own[0]]
        # Of the facets alone: that of a pair enters in :meth:`of_pairs`.
        self.stretch = self.area = np.ones(len(own[0]))

    def derive(self) -> SurfaceStabilization:
        """tau_a of (21) of all facets at the current displacement."""
        own = self._factor[:, None, None] * np.linalg.inv(self._stiffness())
        own[self._rigid] = 0.0
        return self.of_facets(own)

    def of_facets(self, own: Array) -> SurfaceStabilization:
        """The stabilization of all facets with these tau_a (n, d, d) [MPa/mm], before scaling."""
        count, d = len(own), self._quadrature.d
        delta = np.zeros((count, 2, d, d))
        delta[: self._first, 0] = delta[self._first :, 1] = np.eye(d)
        one, tau = np.ones(count), np.tile(np.eye(d), (count, 1, 1))
        return SurfaceStabilization(tau, delta, delta, tau, np.zeros_like(tau), one, one, own)

    def scaled(self, derived: Stabilization, factor: Array, floor: Array) -> Stabilization:
        """c of all facets, not below ``floor``."""
        return derived.with_norm(np.maximum(factor, floor)) if self.automatic else derived

    def suffices(self, applied: Stabilization, derived: Stabilization, factor: Array) -> bool:
        assert isinstance(applied, PairStabilization)
        return super().suffices(applied.surfaces, derived, factor)

    def of_pairs(self, known: SurfaceStabilization, facets: PairedFacets) -> PairStabilization:
        """The stabilization of the present pairs: r = c_1 delta_1^2 + rho c_2 delta_2^2."""
        d, rows = self._quadrature.d, facets.segments
        i, j = rows.first, self._first + rows.second
        tau1, tau2 = known.own[i], known.own[j]
        bonded = np.linalg.inv(tau1 + tau2)
        delta1 = bonded @ tau1
        delta = np.stack([delta1, np.eye(d) - delta1], axis=1)
        share = np.trace(delta, axis1=2, axis2=3) / d
        order = "fro" if self.interface.norm == "frobenius" else 2
        size = np.linalg.norm(bonded, ord=order, axis=(1, 2))
        if self.automatic:
            c1, c2 = known.norm[i], self._quadrature.stretch * known.norm[j]
            r = c1 * share[:, 0] ** 2 + c2 * share[:, 1] ** 2
            r = np.maximum(r, GOOD_RATIO * facets.law.softening_modulus)
        else:
            r = self.interface.safety * size
        weights, tau = self.flux_weights(delta), r[:, None, None] * np.eye(d)
        both = tau1 @ bonded @ tau2
        return PairStabilization(tau, delta, weights, tau, both, r, r / size, known)

    def check_softening(self, stabilization: Stabilization) -> None:
        """Not needed: r is automatic where there is a bond."""


@dataclass(frozen=True)
class CommittedPoints:
    """Points at the end of the last step."""

    u: Array  # Displacement there, local dofs [mm]
    places: Array  # Of the points on their facets of side 1, as in :meth:`MovingInterface._places`
    rows: NDArray[np.intp]  # That number (nq,)
    normal: Array  # Of side 1 (nq, d)
    elastic: Array  # s in the frame of the law (nq, d) [mm]
    history: PointHistory
    stiffness: Array  # r dA (nq,)
    both: tuple[Array, Array]  # X on both sides of the points of all ranks (n, d) [mm]
    # Of side 1, of these, by side whose points at one place have one normal (n, d)
    normals: tuple[Array, Array]
    tractions: tuple[Array, Array]  # Of these, in the frame of the law, likewise (n, d) [MPa]
    pressed: float  # Integral of the pressure over all ranks [N; N/mm in plane strain]

    @cached_property
    def tree(self) -> scipy.spatial.cKDTree:
        """For the nearest of the points, if there is one on the same facet."""
        return scipy.spatial.cKDTree(self.places)

    @cached_property
    def _by_place(self) -> tuple[scipy.spatial.cKDTree, NDArray[np.intp], Array, NDArray[np.int8]]:
        """Places, a point at each, s and zeta_N (n, d + 1) [mm], and mode.

        Points next to each other, as on the pieces that remain where two facets hardly overlap, are
        one place: the mean of their s, with the same sum of r dA times it, and the last mode. With
        one s for each, s would have any slope.
        """
        place = _numbered(self.places, _CLOSE)[0]
        points = np.unique(place, return_index=True)[1]
        weight = np.maximum(self.stiffness, np.finfo(float).tiny)
        share = weight / np.bincount(place, weight)[place]
        parted = np.einsum("pi,pi->p", self.history.gap, self.normal)
        columns = np.column_stack([self.places, self.elastic, parted]).T
        means = np.column_stack([np.bincount(place, share * column) for column in columns])
        places, values = np.split(means, [self.places.shape[1]], axis=1)
        mode = np.zeros(len(points), dtype=self.history.mode.dtype)
        np.maximum.at(mode, place, self.history.mode)
        return scipy.spatial.cKDTree(places), points, values, mode

    def at(
        self, places: Array, rows: NDArray[np.intp], normal: Array
    ) -> tuple[Array, Array, NDArray[np.int8], NDArray[np.bool_]]:
        """s in the frame of the law (nq, d), zeta_N [mm] and mode at the end of the last step at
        other points, and whether there was one on their facet (nq,).

        The n nearest places of the facet count by ((1/d - 1/R)_+)^2, with R the distance of the
        last of them (Franke and Little; Renka 1988): at a place its value, in between a continuous
        function. If the nearest alone counted, s and friction would jump as a point
        passes the middle between two of them, and Newton's method alternate.
        """
        tree, points, values, mode = self._by_place
        d = normal.shape[1]
        distance, near = tree.query(places, np.arange(1, 2 ** (d - 1) + 2))
        near = np.minimum(near, len(points) - 1)
        distance[self.rows[points[near]] != rows[:, None]] = np.inf
        some = np.isfinite(distance[:, 0])
        distance = distance[some]
        ratio = np.ones_like(distance)  # of the least to each
        np.divide(distance[:, :1], distance, out=ratio, where=distance > 0)
        share = (ratio - ratio[:, -1:]) ** 2
        share[share.sum(axis=1) == 0, 0] = 1.0
        share /= share.sum(axis=1, keepdims=True)
        elastic, parted = np.zeros_like(normal), np.zeros(len(normal))
        for k, part in enumerate(share.T):
            at = near[some, k]
            s = turned(values[at, :d], self.normal[points[at]], normal[some])
            elastic[some] += part[:, None] * s
            parted[some] += part * values[at, d]
        return elastic, parted, mode[near[:, 0]], some

    @cached_property
    def nearby(self) -> tuple[scipy.spatial.cKDTree, scipy.spatial.cKDTree]:
        """For the nearest of the points on any facet of any rank, by X on either side."""
        one, two = map(scipy.spatial.cKDTree, self.both)
        return one, two


class MovingPairs(NamedTuple):
    """Pairs in a snapshot.

    Attributes:
        committed: Points at the end of the last step; None before the first one.
        elastic: For a resumed run, in the place of ``committed``: s of the points at the end of the
            last step, in the frame of the law (nq, d) [mm].
        near: For a resumed run, rows of the two surfaces that were coupled in matrices (n, 2): with
            another pattern their factors are rounded otherwise.
    """

    facets: PairedFacets
    committed: CommittedPoints | None
    bonded: NDArray[np.bool_]
    elastic: Array | None = None
    near: NDArray[np.intp] | None = None


class MovingInterface(ActiveInterface):
    """An interface of surfaces that slide, with its present pairs."""

    facets: PairedFacets
    quadrature: PairPoints
    stabilizer: SurfaceStabilizer

    def __init__(self, interface: Interface, facets: PairedFacets, u: fem.Function, bodies: Bodies):
        super().__init__(interface, facets, u, bodies)
        sides = facets.surfaces.sides
        self._comm = facets.surfaces.mesh.comm
        self._spheres = facets.surfaces.spheres
        self._size = float(box_sides(facets.surfaces.mesh).max())
        self.floor = np.zeros(sum(len(side.facets) for side in sides))
        self._paired = u.x.array.copy()
        self._committed: CommittedPoints | None = None
        self._near = np.zeros((0, 2), dtype=np.intp)
        self._resumed_near: NDArray[np.intp] | None = None
        self._bonded = facets.surfaces.intact()
        self._area = BondedArea(self.quadrature)
        self._damage = facets.damage[self.quadrature.facet]
        self._slowed = (0.0, 0.0)
        self.history = self._carried_history()

    def _make_stabilizer(self) -> SurfaceStabilizer:
        return SurfaceStabilizer(self.interface, self.quadrature, self._u, self._bodies)

    def _make_evaluators(self) -> None:
        super()._make_evaluators()
        self.__dict__.pop("_partners", None)

    # Pairs

    @property
    def couplings(self) -> NDArray[np.int32]:
        sides = zip(self.facets.surfaces.sides, self._near.T, strict=True)
        return np.column_stack(
            [array[rows] for side, rows in sides for array in (side.cells, side.local)]
        ).ravel()

    def couple(self) -> bool:
        resumed = self._resumed_near is not None
        self._near, self._resumed_near = self.near, None
        if np.isin(self._labels, self._numbers(self._near)).all():
            return resumed
        near = [self.facets.surfaces.near(self._u), self._rows]
        self._near = np.unique(np.concatenate(near), axis=0)
        return True

    @property
    def _rows(self) -> NDArray[np.intp]:
        """Rows of the two surfaces of all pairs (ns, 2)."""
        return np.column_stack([self.facets.segments.first, self.facets.segments.second])

    @property
    def _labels(self) -> NDArray[np.intp]:
        return self._numbers(self._rows)

    def _numbers(self, rows: NDArray[np.intp]) -> NDArray[np.intp]:
        return rows[:, 0] * len(self.facets.surfaces.sides[1].facets) + rows[:, 1]

    def pair(self, release: bool = False) -> None:
        bonded, kept = self._bonded, self.quadrature.kept
        if release:
            bonded = np.zeros_like(bonded)
            intact = (self.history.softening < self.law.strength)[kept]
            bonded[self._first()[kept][intact]] = True
        same = np.array_equal(bonded, self._bonded)
        same &= np.array_equal(self._u.x.array, self._paired)
        if not global_any(self._comm, not same):
            return
        self._bonded = bonded
        values, tree, rows = self.values, scipy.spatial.cKDTree(self._places()), self._first()
        self._take(self.facets.surfaces.pairs(self._u, self._bonded))
        nearest, same = _nearest(tree, rows, self._places(), self._first())
        self.history = self._carried_history()
        self.values = self._carried_values(values, nearest, same)
        super().slow_down(*self._slowed)

    def _take(self, facets: PairedFacets) -> None:
        full = self.quadrature.take(facets, self._u)
        self.facets, self._paired = facets, self._u.x.array.copy()
        self.law = facets.law.at(self.quadrature.facet)
        if full:
            self._make_evaluators()
        if isinstance(self.stabilization, PairStabilization):
            taken_in = self.stabilization.taken_in
            known = self.stabilizer.of_pairs(self.stabilization.surfaces, facets)
            self.stabilization = replace(known, taken_in=taken_in)
            if taken_in is not None:
                self._leave_out(~np.isin(self._labels, taken_in))

    def _leave_out(self, out: NDArray[np.bool_]) -> None:
        super()._leave_out(out)
        known, taken_in = self.stabilization, self._labels[~out]
        assert isinstance(known, PairStabilization)
        if known.taken_in is not None and not self._at_rest:  # others may come back in this step
            taken_in = np.union1d(known.taken_in, taken_in)
        self.stabilization = replace(known, taken_in=taken_in)

    def _open_gaps(self, gap: Array, rows: NDArray[np.bool_]) -> None:
        super()._open_gaps(gap, rows)
        known = self._committed
        if known is None or not np.array_equal(known.u, self._u.x.array):
            return
        places, history = self._places(), self.history
        if not np.array_equal(places, known.places):  # a bond was released
            tree = scipy.spatial.cKDTree(places)
            nearest, same = _nearest(tree, self._first(), known.places, known.rows)
            rows = same & rows[nearest]
            at = nearest[rows]
            opened = known.history.gap.copy()
            opened[rows] = turned(gap[at], self.quadrature.normal[at], known.normal[rows])
            history = replace(known.history, gap=opened)
        elastic = np.where(rows[:, None], 0.0, known.elastic)
        self._committed = replace(known, elastic=elastic, history=history)

    # What points carry

    def _first(self) -> NDArray[np.intp]:
        """Number of the facet of side 1 of every point (nq,)."""
        return self.facets.segments.first[self.quadrature.facet]

    def _places(self) -> Array:
        """X of the points relative to the radius of their facet of side 1, and how far that is from
        others (nq, d + 1)."""
        first, (centres, radii) = self._first(), self._spheres
        way = self.quadrature.points[:, : self.quadrature.d] - centres[first]
        return np.column_stack([way / radii[first, None], _FAR * first])

    def _carried_history(self) -> PointHistory:
        """History of the present points at the end of the last step, see the module."""
        q, d, before = self.quadrature, self.quadrature.d, self._committed
        N, count = q.normal, len(q.weights)
        u = np.zeros_like(self._u.x.array) if before is None else before.u
        moved, gradients = q.jets(self._u.function_space).of_field(u.reshape(-1, d))
        opening = (moved[:, :, 1] - moved[:, :, 0]).reshape(-1, d) + q.distance
        R = self._return_map.frame(q.leading(gradients))[0]
        gap = np.einsum("pji,pj->pi", R, opening)
        normal = np.einsum("pi,pi->p", gap, N)
        softening = np.array(np.broadcast_to(self.law.strength, count), dtype=float)
        mode, traction = np.full(count, Mode.OPEN, dtype=np.int8), np.zeros((count, d))
        if before is None:
            bonded = np.flatnonzero(q.facet < self.facets.bonded)
            gap[bonded] = normal[bonded] = 0.0
            rounding = NO_GAP * q.extent[q.facet]
            gap[np.abs(gap) <= rounding[:, None]] = 0.0
            normal[np.abs(normal) <= rounding] = 0.0
            softening[bonded] *= self._damage[bonded]
            mode[bonded] = Mode.ELASTIC
        elif len(before.rows):
            elastic, parted, modes, same = before.at(self._places(), self._first(), N)
            gap -= elastic
            normal[same], mode[same] = parted[same], modes[same]
        if before is not None and len(before.both[0]):
            traction = self._carried_traction(before, 0)
        along = np.einsum("pi,pi->p", gap, N)
        gap += (np.maximum(normal, 0.0) - along)[:, None] * N
        found = PointHistory(gap, softening, mode, traction)
        if before is None or not self.facets.bonded:
            return found
        # Points of a bond are the same as before.
        bonded = np.flatnonzero(q.facet < self.facets.bonded)
        nearest = before.tree.query(self._places()[bonded])[1]
        return with_rows(found, bonded, before.history, nearest)

    def _carried_values(
        self, values: PointValues, nearest: NDArray[np.intp], same: NDArray[np.bool_]
    ) -> PointValues:
        """The values of the last points at the present ones; new ones are open."""
        count, d = len(self.quadrature.weights), self.quadrature.d
        fresh = self._return_map.start()
        r = self.stabilization.norm[self.quadrature.facet]
        fresh = replace(fresh, compliance=np.eye(d) / r[:, None, None])
        carried = {}
        for field in fields(PointValues):
            mine, theirs = getattr(fresh, field.name), getattr(values, field.name)
            if isinstance(mine, np.ndarray):
                carried[field.name] = mine.copy()
                carried[field.name][same] = theirs[nearest[same]]
        assert all(len(array) == count for array in carried.values())
        return replace(fresh, **carried)

    # The tangent

    def tangent(
        self, damage: bool = True
    ) -> tuple[Array, Array, Array | None, TurningTangent | None]:
        D, traction, C, turning = super().tangent(damage)
        self._add_partners(D, traction, C)
        return D, traction, C, turning

    def _add_partners(self, D: Array, traction: Array, C: Array | None) -> None:
        """Add to D dA what the motion of the pairs changes."""
        maps, known = self._return_map, (self.stabilization, self.values)
        gradients = self.quadrature.field(self._u)[1]
        frame, terms = maps.frame(self.quadrature.leading(gradients)), self.terms(*known)
        state = self.stabilization, frame, self.values.traction, terms, maps.flux()[1]
        self._partners.add_to(D, traction, C, *state)

    @cached_property
    def _partners(self) -> PartnerTangent:
        return PartnerTangent(self.quadrature, self._u, self._bodies, self.point_tangent)

    # Steps

    def passed(self) -> bool:
        """Whether the bodies have moved into or through each other in the step, where nothing is
        paired; collective, the answer is that of this rank."""
        before = self._committed
        start = np.zeros_like(self._u.x.array) if before is None else before.u
        return self.facets.surfaces.passed(self.facets.segments, self._u, start)

    def slow_down(self, overstress: float, cycles: float = 0.0) -> None:
        self._slowed = overstress, cycles
        super().slow_down(overstress, cycles)

    def apply(self, stabilization: Stabilization) -> float:
        assert isinstance(stabilization, SurfaceStabilization)
        return super().apply(self.stabilizer.of_pairs(stabilization, self.facets))

    def _set_stabilization(self, stabilization: Stabilization) -> None:
        assert isinstance(stabilization, PairStabilization)
        # Without a bond a facet needs a large r only as long as something digs into its cell.
        known = stabilization.surfaces.norm
        self.floor = known if self.interface.law.has_bond else np.zeros_like(known)
        self.stabilization = stabilization

    @property
    def bonded_area(self) -> float:
        """See the base class; by the pairs of the reference configuration."""
        return self._area.whole

    def settle(self) -> None:
        """See the base class.

        Where contact travels along a surface, its tractions go with the other one: a block that is
        drawn over a base has the pressure of its own points, wherever these are. T of the start is
        that of the surface with which it is closer to T of the end, int |T_n - T_n+1| dA, of side 1
        where both are as close but for rounding, as are pressures that grow everywhere; where it
        presses the gap was closed.
        """
        before, update, q = self._committed, self.values.update, self.quadrature
        if before is None or update is None or not len(before.both[0]):
            return
        found = [self._carried_traction(before, side) for side in range(2)]
        misses = [q.weights @ np.linalg.norm(T - update.traction, axis=1) for T in found]
        one, two = global_sum(self._comm, misses)
        T, gap, bonded = found[int(two < (1 - _CLOSER) * one)], self.history.gap.copy(), q.kept
        T[bonded] = self.history.traction[bonded]
        pressed = np.einsum("pi,pi->p", T, q.normal) < 0
        pressed[bonded] = False
        N = q.normal[pressed]
        gap[pressed] -= np.einsum("pi,pi->p", gap[pressed], N)[:, None] * N
        self.history = replace(self.history, traction=T, gap=gap)

    def _carried_traction(self, before: CommittedPoints, side: int) -> Array:
        """T of the nearest points on one side at the start of the step, turned to the present
        normals, for points without a bond; collective.

        A facet that had no partner counts as loaded like those nearby, and the sum of the pressures
        stays as it was.
        """
        nearby = before.nearby[side].query(self._both_places()[side])[1]
        known = before.tractions[side][nearby], before.normals[side][nearby]
        T = turned(*known, self.quadrature.normal)
        pressed = self._pressed(T)
        return T * (before.pressed / pressed if pressed > 0 else 1.0)

    def _both_places(self) -> tuple[Array, Array]:
        """X on both sides of the points (nq, d) [mm]."""
        X = self.quadrature.points[:, : self.quadrature.d]
        return X, X + self.quadrature.distance

    def state(self) -> InterfaceState:
        """Public values at the points, and in the middle of what has lost its partner."""
        return joined([super().state(), self._area.parted(self.quadrature, self._u)])

    def _pressed(self, traction: Array) -> float:
        """Integral of -T_N >= 0, of a traction in the frame of the law; collective."""
        pressure = np.maximum(-np.einsum("pi,pi->p", traction, self.quadrature.normal), 0.0)
        return float(global_sum(self._comm, pressure @ self.quadrature.weights))

    def commit(self) -> None:
        s = self.values.elastic_opening
        if (R := self.values.rotation) is not None:
            s = np.einsum("pji,pj->pi", R, s)
        super().commit()
        self._remember(s)

    def _remember(self, s: Array) -> None:
        """Keep the points with their history and s as those of the end of a step; collective."""
        q, T, size = self.quadrature, self.history.traction, self._size
        stiffness = q.weights * self.stabilization.norm[q.facet]
        X = tuple(gathered(self._comm, x) for x in self._both_places())
        known = [gathered(self._comm, array) for array in (T, q.normal, q.weights)]
        found = [tractions_at(x, size, *known) for x in X]
        given = self._u.x.array.copy(), self._places(), self._first(), q.normal, s, self.history
        normals, tractions = zip(*found, strict=True)
        given += stiffness, X, normals, tractions, self._pressed(T)
        self._committed = CommittedPoints(*given)

    def snapshot(self) -> InterfaceSnapshot:
        pairs = MovingPairs(self.facets, self._committed, self._bonded)
        return replace(super().snapshot(), pairs=pairs)

    def return_to(self, snapshot: InterfaceSnapshot) -> None:
        """Return to a state; the displacement is there already; for a resumed run collective."""
        pairs = snapshot.pairs
        self._committed, self._bonded = pairs.committed, pairs.bonded
        if pairs.facets is not self.facets:
            self._take(pairs.facets)
        if isinstance(known := snapshot.stabilization, SurfaceStabilization):
            snapshot = replace(snapshot, stabilization=self.stabilizer.of_pairs(known, self.facets))
        super().return_to(snapshot)
        super().slow_down(*self._slowed)
        if pairs.elastic is not None:
            self._remember(pairs.elastic)
            self._resumed_near = pairs.near

    # Checkpoints

    @property
    def elastic(self) -> Array:
        """s of the points at the end of the last step, in the frame of the law (nq, d) [mm]."""
        return (
            np.zeros_like(self.history.gap) if self._committed is None else self._committed.elastic
        )

    def facet_state(self) -> dict[str, NDArray]:
        """What the facets of both surfaces keep from step to step, those of side 1 first."""
        assert isinstance(self.stabilization, PairStabilization)
        known, count = self.stabilization.surfaces, len(self._bonded)
        bonded = np.zeros(len(known.norm), dtype=bool)
        bonded[:count] = self._bonded
        return {"own": known.own, "norm": known.norm, "bonded": bonded}

    def pairs_at(self, u: fem.Function, bonded: NDArray[np.bool_]) -> PairedFacets:
        """The pairs at a displacement, of facets of which some are ``bonded``, as in
        :meth:`facet_state`."""
        surfaces = self.facets.surfaces
        return surfaces.pairs(u, bonded[: len(surfaces.sides[0].facets)])

    @property
    def near(self) -> NDArray[np.intp]:
        """Rows of the two surfaces that are coupled in matrices (n, 2)."""
        return self._near if self._resumed_near is None else self._resumed_near

    def restored(
        self,
        facets: PairedFacets,
        own: Array,
        norm: Array,
        bonded: NDArray[np.bool_],
        s: Array,
        near: NDArray[np.intp],
    ) -> tuple[SurfaceStabilization, MovingPairs]:
        """Stabilization of the facets of both surfaces and pairs of a snapshot, from
        :meth:`pairs_at`, :meth:`facet_state`, :attr:`elastic` and :attr:`near`."""
        known = self.stabilizer.of_facets(own).with_norm(norm)
        count = len(self.facets.surfaces.sides[0].facets)
        pairs = MovingPairs(facets, None, bonded[:count], s, near if len(near) else None)
        return known, pairs

    def continue_from(self, other: ActiveInterface) -> None:
        """The state of the same interface in another discretization."""
        assert isinstance(other, MovingInterface)
        self.return_to(other.snapshot())


def tractions_at(
    places: Array, size: float, traction: Array, normal: Array, weights: Array
) -> tuple[Array, Array]:
    """Normals and tractions (n, d), in the frame of the law, of points, those at one place with
    their means by dA: which of them is the nearest would be a matter of rounding."""
    place, count = _numbered(places, _SAME * size)
    if count is None:
        return normal, traction

    def mean(values: Array) -> Array:
        sums = [np.bincount(place, weights * column) for column in values.T]
        return np.column_stack(sums)[place]

    shared, tiny = mean(normal), np.finfo(float).tiny
    shared /= np.maximum(np.linalg.norm(shared, axis=1, keepdims=True), tiny)
    area = np.bincount(place, weights)[place, None]
    several = (count > 1)[place, None] & (area > 0)
    shared = np.where(several, shared, normal)
    means = mean(turned(traction, normal, shared)) / np.maximum(area, tiny)
    return shared, np.where(several, means, traction)


def _numbered(places: Array, apart: float) -> tuple[NDArray[np.intp], NDArray[np.intp] | None]:
    """Number of the place of every point (n,), and of the points at every place, None where each
    has its own; those not farther apart than this are at one."""
    near = scipy.spatial.cKDTree(places).query_pairs(apart, output_type="ndarray")
    if not len(near):
        return np.arange(len(places)), None
    graph = scipy.sparse.coo_array((np.ones(len(near)), near.T), shape=2 * (len(places),))
    place = scipy.sparse.csgraph.connected_components(graph, directed=False)[1]
    return place, np.bincount(place)


def _nearest(
    tree: scipy.spatial.cKDTree, rows: NDArray[np.intp], places: Array, mine: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """The nearest of other points, and whether it is on the same facet of side 1 (nq,)."""
    if not len(rows) or not len(mine):
        return np.zeros(len(mine), dtype=np.intp), np.zeros(len(mine), dtype=bool)
    nearest = tree.query(places)[1]
    return nearest, rows[nearest] == mine
