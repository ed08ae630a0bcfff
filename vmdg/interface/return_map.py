"""Values at the points of an interface: fluxes, return map and corotational frame."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..domain.materials import Bodies
from ..forms import kinematics
from ..laws import Law, Update
from ..points.interface import Interface
from ..points.points import Points
from .frame import Frame, TurningTangent, cross_matrix, turns
from .history import PointHistory
from .stabilization import Stabilization
from .values import PointValues

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Trial:
    """Input of return maps at the points of one interface, or of several with one law."""

    total: Array  # {P.N} + r g, for a tie with the tensor tau_s: T (nq, d) [MPa]
    opening: Array  # g (nq, d) [mm]
    jump: Array  # [[P.N]] (nq, d) [MPa]
    N: Array  # Reference normal (nq, d)
    r: Array | None = None  # |tau_s| (nq,) [MPa/mm]; this and the following are None for a tie
    gap: Array | None = None  # zeta_n (nq, d) [mm]
    softening: Array | None = None  # Q_n (nq,) [MPa]
    # k of :func:`map_back` (nq,) [MPa/mm]; None for the plain law
    overstress_modulus: Array | None = None
    cycles: Array | None = None  # Load cycles that the step represents (nq,); None for none
    # Mean deformation gradient (nq, d, d); this and the following are None where the frame is fixed
    F: Array | None = None
    R: Array | None = None
    W: Array | None = None
    # Position on side 2 minus that on side 1, which turns with the frame (nq, d) [mm]; None where
    # they coincide
    initial_gap: Array | None = None


class ReturnMap:
    """T of (31) at the points of an interface, by the return map of its law (Boxes 2 and 3).

    Attributes:
        turns: Whether the law works in a frame that rotates with the interface.
    """

    def __init__(
        self,
        interface: Interface,
        quadrature: Points,
        u: fem.Function,
        bodies: Bodies,
        fluid: fem.Function | None = None,
    ):
        self._law = interface.law
        self._quadrature = quadrature
        self._d = d = quadrature.d
        self.turns = turns(interface, bodies, quadrature)
        self._frame = Frame(d, quadrature.mesh.comm) if self.turns else None
        self._u = u
        self._traction = quadrature.evaluator(
            u, bodies, (d,), kinematics.traction, "traction", fluid
        )

    def start(self) -> PointValues:
        d, count = self._d, len(self._quadrature.weights)
        zero, tensor = np.zeros((count, d)), np.zeros((count, d, d))
        values = PointValues(zero, zero, None, zero)
        if self._law.inelastic:
            values = replace(values, gap=zero)
        if self._law.inelastic or self.turns:
            values = replace(values, compliance=tensor)
        if self.turns:
            one = np.tile(np.eye(d), (count, 1, 1))
            values = replace(
                values,
                rotation=one,
                moment=tensor,
                frame_gradient=one,
                frame_total=zero,
                frame_gap=zero,
                frame_traction=zero,
            )
        return values

    def trial(
        self,
        stabilization: Stabilization,
        history: PointHistory,
        overstress_modulus: Array | None,
        cycles: Array | None,
    ) -> Trial:
        """{P.N} + r g at the current displacement, and the other input of the law."""
        d, facet = self._d, self._quadrature.facet
        one, two = self._traction()
        displacement, gradients = self._quadrature.field(self._u)
        delta = stabilization.weights[facet]
        # The kernels use the outward normal of their side, -N on side 2.
        mean = apply(delta[:, 0], one) - apply(delta[:, 1], two)
        jump = one + two
        opening = (displacement[:, :, 1] - displacement[:, :, 0]).reshape(-1, d)
        N, initial_gap = self._quadrature.normal, self._quadrature.initial_gap
        if self._quadrature.distance is not None:
            opening += self._quadrature.distance
        if not self._law.inelastic and self._frame is None:
            total = mean + apply(stabilization.penalty[facet], opening)
            return Trial(total, opening, jump, N)
        F, frame = None, ()
        if self._frame is not None:
            F = np.eye(d) + self._quadrature.leading(gradients)
            frame = self._frame.at(F, N)
            if initial_gap is not None:
                opening += initial_gap - apply(frame[0], initial_gap)
        r = stabilization.norm[facet]
        total = mean + apply(stabilization.penalty[facet], opening)
        known = (
            total,
            opening,
            jump,
            N,
            r,
            history.gap,
            history.softening,
            overstress_modulus,
            cycles,
        )
        return Trial(*known) if F is None else Trial(*known, F, *frame, initial_gap)

    def frame(self, gradient: Array) -> tuple[Array, Array]:
        """R and W of :meth:`.Frame.at` for GRAD u of the frame in the section (nq, d, d)."""
        assert self._frame is not None
        return self._frame.at(np.eye(self._d) + gradient, self._quadrature.normal)

    def flux(self) -> Array:
        """P.N of both sides at the current displacement, N outward (2, nq, d) [MPa]."""
        return self._traction()

    def tangent(self, values: PointValues) -> tuple[Array | None, TurningTangent | None]:
        """C = d zeta/dT (nq, d, d) [mm3/N], and the contributions of the rotating frame; None for
        what the interface does not have."""
        if self._frame is None:
            return values.compliance, None
        inside = values.frame_total, values.frame_gap, values.frame_traction
        F, N = values.frame_gradient, self._quadrature.normal
        return self._frame.tangent(F, N, values.compliance, *inside)


def evaluate(law: Law, trial: Trial, dt: float, last: PointValues | None = None) -> PointValues:
    """T of (31) by T_tr = {P.N} + r g - r zeta_n of (66).

    Args:
        last: Values of the last residual, with the tangent of its return map; if given, zeta is
            zeta_n. None for a return map.
    """
    if not law.inelastic and trial.F is None:
        return PointValues(trial.opening, trial.jump, None, trial.total)

    def mapped(total: Array) -> PointValues:
        new = {"opening": trial.opening, "jump": trial.jump}
        if not law.inelastic:
            return PointValues(**new, gap=None, traction=total, compliance=np.zeros_like(trial.F))
        load = total - trial.r[:, None] * trial.gap
        if last is not None:
            return replace(last, **new, gap=trial.gap, traction=load, update=None)
        update = map_back(law, load, trial, dt)
        return PointValues(
            **new,
            gap=update.gap,
            traction=update.traction,
            compliance=update.tangent,
            update=update,
        )

    return mapped(trial.total) if trial.F is None else in_frame(trial, mapped)


def map_back(law: Law, load: Array, trial: Trial, dt: float, keep: bool = True) -> Update:
    """The return map of the law, with or without an overstress.

    T_tr - r dzeta = T(dzeta) + k dzeta is the law's equation with r + k instead of r. With k > H
    the step has a unique solution even where the bodies follow a softening bond.

    Args:
        load: T_tr (nq, d) [MPa].
        keep: A law that writes into what it is given writes into copies. False if nothing but this
            call uses the arrays of a trial without k.
    """
    k = None if trial.cycles is not None else trial.overstress_modulus
    known = load, trial.N, trial.gap, trial.softening
    if keep:
        known = tuple(array.copy() for array in known)
    cycles = () if trial.cycles is None else (trial.cycles,)
    update = law.return_map(*known, trial.r + (0.0 if k is None else k), dt, *cycles)
    _check_answer(law, load, update)
    if k is None:
        return update
    borne = k[:, None] * (update.gap - trial.gap)
    return replace(update, traction=update.traction + borne)


def _check_answer(law: Law, load: Array, update: Update) -> None:
    """Check what a law returns for T_tr (n, d)."""
    n, d = load.shape
    name, shapes = type(law).__name__, {"traction": (n, d), "gap": (n, d), "softening": (n,)}
    shapes |= {"multiplier": (n,), "tangent": (n, d, d), "mode": (n,)}
    shapes |= {f"{kind}_work": (n,) for kind in ("damage", "friction", "viscous")}
    for key, shape in shapes.items():
        if (given := np.shape(getattr(update, key))) != shape:
            raise ValueError(
                f"{name}.return_map: {key} of {n} points has shape {given}, expected {shape}, see "
                "vmdg.Update"
            )
    history = np.isfinite(update.gap).all(axis=1) & np.isfinite(update.softening)
    wrong = np.flatnonzero(np.isfinite(update.traction).all(axis=1) & ~history)
    if len(wrong):
        i = wrong[0]
        raise ValueError(
            f"{name}.return_map: gap {update.gap[i].tolist()}, softening {update.softening[i]} for "
            f"the trial traction {load[i].tolist()}, where the traction is finite; they must be "
            "finite too, see vmdg.Update"
        )


def in_frame(trial: Trial, mapped: Callable[[Array], PointValues]) -> PointValues:
    """The return map in the rotating frame R: zeta = R.zeta~, T~ = R^T.T, N fixed.

    The couple c = zeta~ x T~ gives M = c_k W_k / 2 of ``forms.residual.frame_couple``, with
    omega = W:dF the axial vector of R^T.dR. With an initial gap g_0 the opening is
    x_2 - x_1 - R.g_0, so that what turns is R.(zeta~ + g_0) in place of R.zeta~, in the couple and,
    with r g_0 added to q, in the tangent.
    """
    R = trial.R
    q = np.einsum("pji,pj->pi", R, trial.total)
    inside = mapped(q)
    gap = np.zeros_like(q) if inside.gap is None else inside.gap
    if trial.initial_gap is not None:
        gap = gap + trial.initial_gap
        q = q + trial.r[:, None] * trial.initial_gap
    values = replace(
        inside,
        gap=None if inside.gap is None else apply(R, inside.gap),
        traction=apply(R, inside.traction),
        rotation=R,
        moment=np.einsum("pk,pkab->pab", _couple(gap, inside.traction), trial.W) / 2,
    )
    if inside.gap is not None and inside.update is None:
        return values
    return replace(
        values,
        frame_gradient=trial.F,
        frame_total=q,
        frame_gap=gap,
        frame_traction=inside.traction,
    )


def _couple(gap: Array, traction: Array) -> Array:
    """zeta~ x T~ (nq, 3 or 1) [N/mm]."""
    return np.einsum("pmk,pm->pk", cross_matrix(gap), traction)


def apply(tensor: Array, vector: Array) -> Array:
    return np.einsum("pij,pj->pi", tensor, vector)
