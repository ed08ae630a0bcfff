"""Values at the facet points of one interface, for users and from the last residual."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..laws import Update


@dataclass(frozen=True)
class InterfaceState:
    """Converged values at the facet points this rank owns, possibly none; side 1 first.

    Where bodies slide these are the points of the present pairs. What was bonded at the start and
    has no partner now is one more point for each facet of side 1: broken, without traction, opened
    by the way to the nearest point of side 2.

    The gap is zeta, the inelastic part of the opening g; in contact mechanics the gap is g.

    Attributes:
        points: Reference positions, those of side 1 where meshes do not match (nq, 3) [mm].
        weights: Reference area of the points (nq,) [mm2; mm in plane strain], of the full circle in
            axisymmetry.
        normal: Reference normal N outward from side 1 (nq, d).
        opening: g = phi_2 - phi_1, positive along N (nq, d) [mm]; less the initial gap where meshes
            do not match.
        gap: Inelastic gap zeta (nq, d) [mm].
        softening: Q (nq,) [MPa].
        traction: T = {P.N} + tau_s.(g - zeta) (nq, d) [MPa]; with a fluid the effective traction on
            bond and contact.
        mode: Active branch of the return map, :class:`vmdg.Mode` (nq,).
        rotation: R of the corotational frame (nq, d, d), R.N the current normal; R^T.gap and
            R^T.traction are the components used by the law. The identity where the frame is fixed.
        facet: Number of the facet of side 1 on this rank (nq,).
        damage: Q relative to the strength, 1 where there is no bond (nq,).
    """

    points: NDArray[np.float64]
    weights: NDArray[np.float64]
    normal: NDArray[np.float64]
    opening: NDArray[np.float64]
    gap: NDArray[np.float64]
    softening: NDArray[np.float64]
    traction: NDArray[np.float64]
    mode: NDArray[np.int8]
    rotation: NDArray[np.float64]
    facet: NDArray[np.int32]
    damage: NDArray[np.float64]

    def __repr__(self) -> str:
        points, facets = len(self.weights), len(np.unique(self.facet))
        damaged, area = np.count_nonzero(self.damage), self.weights.sum()
        return (
            f"<InterfaceState: {points} points, {damaged} of them damaged; {facets} facets, "
            f"area {area:.6g}>"
        )

    @classmethod
    def empty(cls, d: int) -> InterfaceState:
        """State of an interface with no open facet, in ``d`` dimensions."""
        vectors, scalars = np.zeros((0, d)), np.zeros(0)
        return cls(
            points=np.zeros((0, 3)),
            weights=scalars,
            normal=vectors,
            opening=vectors,
            gap=vectors,
            softening=scalars,
            traction=vectors,
            mode=np.zeros(0, dtype=np.int8),
            rotation=np.zeros((0, d, d)),
            facet=np.zeros(0, dtype=np.int32),
            damage=scalars,
        )


@dataclass(frozen=True)
class PointValues:
    """Values at the points at the last evaluation, in the current configuration."""

    opening: NDArray[np.float64]  # g (nq, d)
    jump: NDArray[np.float64]  # [[P.N]] (nq, d)
    gap: NDArray[np.float64] | None  # zeta (nq, d); None for a tie
    traction: NDArray[np.float64]  # T (nq, d)
    # C~ = d zeta~/dT~ of the last return map, in the frame of the law (nq, d, d); None for a tie
    compliance: NDArray[np.float64] | None = None
    # R of the frame (nq, d, d); None where the frame is fixed
    rotation: NDArray[np.float64] | None = None
    # M of the frame's couple (nq, d, d); None where the frame is fixed
    moment: NDArray[np.float64] | None = None
    # Mean deformation gradient of the last return map (nq, d, d); with the next three the data for
    # the tangent of the rotating frame; None where it is fixed
    frame_gradient: NDArray[np.float64] | None = None
    # R^T.({P.N} + r g) of the last return map (nq, d)
    frame_total: NDArray[np.float64] | None = None
    frame_gap: NDArray[np.float64] | None = None  # zeta~ of the last return map (nq, d)
    frame_traction: NDArray[np.float64] | None = None  # T~ of the last return map (nq, d)
    # Result of the return map; None where zeta is at its converged value, and for a tie
    update: Update | None = None

    @property
    def elastic_opening(self) -> NDArray[np.float64]:
        """s = g - zeta (nq, d) [mm]."""
        return self.opening if self.gap is None else self.opening - self.gap

    def width(self, normal: NDArray[np.float64]) -> NDArray[np.float64]:
        """g along the current normal (nq,) [mm], of the reference normal (nq, d)."""
        if self.rotation is not None:
            normal = np.einsum("pij,pj->pi", self.rotation, normal)
        return np.einsum("pi,pi->p", self.opening, normal)


#: Array attributes of PointValues.
VALUE_ARRAYS = tuple(field.name for field in fields(PointValues) if field.name != "update")


Rows = TypeVar("Rows")


def joined(parts: Sequence[Rows]) -> Rows:
    """Concatenate records of arrays, one row per point; attributes that are None stay None."""
    if len(parts) == 1:
        return parts[0]
    values = {f.name: [getattr(part, f.name) for part in parts] for f in fields(parts[0])}
    arrays = {name: None if v[0] is None else np.concatenate(v) for name, v in values.items()}
    return replace(parts[0], **arrays)


def rows_of(record: Rows, rows: slice) -> Rows:
    """Some rows of a record of arrays, nested records included."""

    def chosen(value: Any) -> Any:
        if is_dataclass(value):
            return rows_of(value, rows)
        return None if value is None else value[rows]

    return replace(record, **{f.name: chosen(getattr(record, f.name)) for f in fields(record)})
