"""One interface at work: values at its points, its return map, and its terms of the forms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from ufl.core.expr import Expr

from ..base.parallel import global_max, raise_together
from ..base.quadrature import facet_degree
from ..domain.materials import Bodies
from ..forms import kinematics
from ..forms import residual as terms
from ..forms.geometry import Geometry
from ..forms.kinematics import Body
from ..laws import Mode, Update
from . import frame
from .coercivity import MARGIN
from .facets import InterfaceFacets
from .interface import AUTO, Interface
from .points import HISTORY_ARRAYS, VALUE_ARRAYS, InterfaceState, PointHistory, PointValues
from .quadrature import FacetQuadrature, SideEvaluators, region_pairs, side_evaluators
from .stabilization import Stabilization, Stabilizer
from .tangent import StagedTangent

#: H / r from which on a wrong unit is as likely as a coarse mesh.
FAR = 3.0

#: r / H of a well-conditioned return map, and the factor up to which "auto" raises r for it.
AMPLE, REPORT_SAFETY = 2.0, 4.0


Frozen = tuple[Stabilization, NDArray[np.float64]]


@dataclass(frozen=True)
class Group:
    """Facets of an interface whose two sides belong to the same pair of material regions."""

    select: NDArray[np.bool_]
    bodies: tuple[Body, Body]


class ActiveInterface:
    """The interface terms of the problem and the history they need.

    A tie (law without history) has the tensor tau_s and neither zeta nor a return map; any other
    law has the scalar r = |tau_s| in the residual and in the return map, and where its frame turns
    also the isotropic part of the flux weights delta.

    Args:
        interface: The user's description.
        facets: Its facets on this rank.
        u: Displacement, changed by the solver.
        bodies: Materials.
        degree: Degree of the displacement.
        geometry: Gradient and measure.
    """

    def __init__(
        self,
        interface: Interface,
        facets: InterfaceFacets,
        u: fem.Function,
        bodies: Bodies,
        degree: int,
        geometry: Geometry,
    ):
        mesh = u.function_space.mesh
        self.interface = interface
        self.facets = facets
        self.law = interface.law
        self._acting_law = interface.law
        self._u = u
        self._d = d = mesh.geometry.dim
        self._bodies = bodies
        self._geometry = geometry
        region_of = bodies.region[facets.cells]
        self.groups = [
            Group((region_of == pair).all(axis=1), tuple(bodies.regions[i].body for i in pair))
            for pair in region_pairs(facets, bodies, mesh.comm)
        ]
        self.quadrature = FacetQuadrature(mesh, facets, facet_degree(degree), geometry)
        self._stabilizer = Stabilizer(interface, facets, self.quadrature, u, bodies)
        self.stabilization: Stabilization | None = None
        self._weights: NDArray[np.float64] | None = None
        self._N = ufl.FacetNormal(mesh)("+")

        facet_space = self.quadrature.facet_space
        self._delta = fem.Function(facet_space((d, d)))
        self._tau = fem.Function(facet_space(() if self.law.inelastic else (d, d)))
        self._zeta = fem.Function(self.quadrature.space((d,))) if self.law.inelastic else None
        self._delta_s = fem.Function(facet_space((d, d))) if interface.traction_jump else None
        small = bodies.regions[0].body.small
        self.turns = self.law.inelastic and interface.frame == "corotating" and not small
        self._moment = fem.Function(self.quadrature.space((d, d))) if self.turns else None
        size = 2 * d + d * d if self.turns else 2 * d
        self._flux = self._evaluators((size,), self._flux_of, "flux")
        self._tangent: StagedTangent | None = None

        count = len(self.quadrature.weights)
        history = count if self.law.inelastic else 0
        self.gap = np.zeros((history, d))
        self.softening = np.zeros(history)
        self.mode = np.zeros(history, dtype=np.int8)
        zero = np.zeros((count, d))
        self._now = PointValues(zero, zero, None, zero)
        if self.law.inelastic:
            self._now = replace(self._now, gap=zero, compliance=np.zeros((count, d, d)))
        if self.turns:
            self._now = replace(
                self._now,
                rotation=np.tile(np.eye(d), (count, 1, 1)),
                moment=np.zeros((count, d, d)),
                frame_gradient=np.tile(np.eye(d), (count, 1, 1)),
                frame_total=zero,
                frame_gap=zero,
                frame_traction=zero,
            )
        self._converged = self._now
        self._former = self.frozen
        self._converged_traction = np.zeros((history, d))
        self._dt = 1.0

    def _evaluators(
        self,
        shape: tuple[int, ...],
        expression: Callable[[Body, Expr, Expr, int], Expr],
        name: str,
    ) -> SideEvaluators:
        return side_evaluators(self.quadrature, self._u, self._bodies, shape, expression, name)

    def _flux_of(self, body: Body, F: Expr, N: Expr, a: int) -> Expr:
        """P.N, u and, where the frame turns, GRAD u of one side."""
        values = [*kinematics.traction(body, F, N), *self._u]
        if self.turns:
            gradient = ufl.grad(self._u)
            values += [gradient[i, j] for i in range(self._d) for j in range(self._d)]
        return ufl.as_vector(values)

    # Terms of the forms

    def residual_term(self, eta: Expr, group: Group) -> Expr:
        """Interface integrand of (27)."""
        moment = self._moment("+") if self.turns else None
        return terms.residual(
            eta,
            group.bodies,
            self._geometry,
            self._u,
            self._N,
            *self._coefficients(),
            moment=moment,
        )

    def energy_term(self, group: Group) -> Expr:
        """Stored energy of the interface, the interface integrand of (30) [N/mm]."""
        return terms.energy(group.bodies, self._geometry, self._u, self._N, *self._coefficients())

    def _coefficients(self) -> tuple[Expr, Expr, Expr | None, Expr | None]:
        """delta_1, tau_s, zeta and delta_s on the facets, None where the form has none."""
        zeta = None if self._zeta is None else self._zeta("+")
        delta_s = None if self._delta_s is None else self._delta_s("+")
        return self._delta("+"), self._tau("+"), zeta, delta_s

    def tangent_term(self, eta: Expr, du: Expr) -> Expr:
        """Interface integrand of (84)-(85) in the staged coefficients."""
        return self._staging.integrand(eta, du, self._tau("+"))

    def traction_term(self, q: Expr, du: Expr) -> Expr:
        """q.Tt(du) of (84) in the staged coefficients."""
        return self._staging.traction_term(q, du, self._tau("+"))

    @property
    def submeshes(self):
        """Submeshes on which coefficients of the terms live."""
        return [self.quadrature.submesh]

    # Work at the points

    @property
    def seeks_safety(self) -> bool:
        """Whether :mod:`vmdg.interface.coercivity` decides how far tau_s is raised."""
        return self.interface.safety == AUTO and self.interface.stabilization is None

    def derive_stabilization(self, known: Frozen | None = None) -> None:
        """Evaluate tau_s and delta at the current displacement, tau_s not raised yet.

        Args:
            known: What an earlier evaluation at this displacement has left in :attr:`frozen`.
        """
        if known is not None:
            self.stabilization, self._weights = known
            return
        self.stabilization = self._stabilizer()
        self._weights = self.stabilization.delta
        if self.turns:
            # A frozen tensor would lag behind a body that turns: take numbers, as r is one.
            share = np.trace(self._weights, axis1=2, axis2=3) / self._d
            self._weights = share[:, :, None, None] * np.eye(self._d)

    def falls_short(self, frozen: Frozen, factor: NDArray[np.float64]) -> bool:
        """Whether a frozen tau_s is less than coercivity asks for where it was derived last.

        What :mod:`vmdg.interface.coercivity` keeps of the bulk energy may be used up in a step.

        Args:
            frozen: The stabilization of the step.
            factor: What coercivity asks for on the derived one (nf,).
        """
        if not self.seeks_safety:
            return False
        needed = (1 - MARGIN) * factor * self.stabilization.norm
        return bool((frozen[0].norm < needed).any())

    @property
    def bonded_penalty(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """tau (nf, d, d) and delta (nf, 2, d, d) of the bonded form, as the residual has them."""
        tau = self.stabilization.tau
        if self.law.inelastic:
            tau = self.stabilization.norm[:, None, None] * np.eye(self._d)
        return tau, self._weights

    def freeze_stabilization(self, factor: NDArray[np.float64], dt: float | None) -> None:
        """Raise the derived tau_s, where ``safety="auto"`` says so, and give it to the forms.

        Where the interface can fail r is raised to twice H too, as far as the factor 4 of the
        report's tables reaches: close to H a return map with its dgamma = f / (r - H) would
        magnify every change of the trial traction. A larger r never harms coercivity.

        Args:
            factor: What coercivity asks for (nf,); 1 is the least.
            dt: Time step [s]; None where it is not known yet, then only a law without viscosity
                is checked.

        Raises:
            ValueError: r <= H - eta on a facet: the softening is too steep for the mesh.
        """
        if self.seeks_safety:
            factor = np.maximum(factor, 1.0)
            if self.law.inelastic:
                enough = AMPLE * self.law.softening_modulus / self.stabilization.norm
                factor = np.maximum(factor, np.minimum(enough, REPORT_SAFETY))
            self.stabilization = self.stabilization.raised(factor)
        self._set_stabilization()
        if self.law.inelastic and (dt is not None or self._acting_law.viscosity == 0):
            self._check_softening(1.0 if dt is None else dt)

    def _set_stabilization(self) -> None:
        """Give the forms tau_s and the flux weights."""
        stabilization = self.stabilization
        self.quadrature.set_facet_values(self._delta, self._weights[:, 0])
        if self._delta_s is not None:
            self.quadrature.set_facet_values(self._delta_s, stabilization.delta_s)
        self.quadrature.set_facet_values(
            self._tau, stabilization.norm if self.law.inelastic else stabilization.tau
        )

    def _check_softening(self, dt: float) -> None:
        r, H = self.stabilization.norm, self.law.softening_modulus
        bad = np.flatnonzero(~self._acting_law.admissible(r, dt))
        message = None
        worst = -global_max(self._u.function_space.mesh.comm, -r[bad].min(initial=np.inf))
        if len(bad) and r[bad].min() == worst:
            f = bad[np.argmin(r[bad])]
            size = self.quadrature.extent[f]
            message = (
                f"{self.interface}: facet {self.facets.facets[f]} has r = |tau_s| = {r[f]:.6g} "
                f"MPa/mm, not above the softening modulus H = {H:.6g} MPa/mm (dt = {dt:g}): the "
                f"bond would break faster than the element can unload. Refine the facet from "
                f"{size:.3g} to below {size * r[f] / H:.3g} mm, raise the critical gap, or give "
                "the law a viscosity"
            )
            if H > FAR * r[f]:
                message += (
                    "; do the units of strength, moduli, critical gap and mesh go together (MPa "
                    "with mm)?"
                )
        raise_together(self._u.function_space.mesh.comm, message)

    def update_points(self, dt: float, hold: bool = False) -> None:
        """T of (31) by the return map (Boxes 2 and 3); sets zeta of the residual.

        Args:
            dt: Time step [s].
            hold: Keep zeta at its converged value.
        """
        d, facet = self._d, self.quadrature.facet
        flux1, flux2 = self._flux[0](), self._flux[1]()
        delta = self._weights[facet]
        # The kernels take the outward normal of their own side, -N on side 2.
        mean = _apply(delta[:, 0], flux1[:, :d]) - _apply(delta[:, 1], flux2[:, :d])
        jump = flux1[:, :d] + flux2[:, :d]
        opening = flux2[:, d : 2 * d] - flux1[:, d : 2 * d]
        if not self.law.inelastic:
            traction = mean + _apply(self.stabilization.tau[facet], opening)
            self._now = PointValues(opening, jump, None, traction)
            return
        r = self.stabilization.norm[facet]
        total = mean + r[:, None] * opening
        if self.turns:
            F = np.eye(d) + (flux1[:, 2 * d :] + flux2[:, 2 * d :]).reshape(-1, d, d) / 2
            values = self._map_in_frame(opening, total, r, F, dt, hold)
        else:
            values = self._map(opening, total, r, dt, hold)
        self._now = replace(values, jump=jump)
        self._set_gap()

    def _set_gap(self) -> None:
        """Give the residual the gap of the current values, and the couple where the frame turns."""
        if not self.law.inelastic:
            return
        self._zeta.x.array[:] = self._now.gap.ravel()
        if self.turns:
            self._moment.x.array[:] = self._now.moment.ravel()

    def _map(
        self, opening: NDArray, total: NDArray, r: NDArray, dt: float, hold: bool
    ) -> PointValues:
        """The return map on T_tr = {P.N} + r g - r zeta_n of (66); ``total`` is {P.N} + r g."""
        trial = total - r[:, None] * self.gap
        if hold:
            return replace(self._now, opening=opening, gap=self.gap, traction=trial, update=None)
        update = self.map_back(trial, dt)
        return PointValues(
            opening, self._now.jump, update.gap, update.traction, update.tangent, update=update
        )

    def map_back(self, trial: NDArray, dt: float) -> Update:
        """The return map of the step on trial tractions (nq, d) [MPa]; nothing is changed."""
        r, N = self.stabilization.norm[self.quadrature.facet], self.quadrature.normal
        return self._acting_law.return_map(trial, N, self.gap, self.softening, r, dt)

    def _map_in_frame(
        self, opening: NDArray, total: NDArray, r: NDArray, F: NDArray, dt: float, hold: bool
    ) -> PointValues:
        """The return map in the turning frame R: zeta = R.zeta~, T~ = R^T.T, N stays.

        The couple c = zeta~ x T~ gives M = c_k W_k / 2 of ``forms.residual.frame_couple``, with
        omega = W:dF the axial vector of R^T.dR.
        """
        N = self.quadrature.normal
        R = frame.rotation(F, N)
        W = frame.spin(F, N, R)
        q = _apply_transposed(R, total)
        mapped = self._map(opening, q, r, dt, hold)
        values = replace(
            mapped,
            gap=_apply(R, mapped.gap),
            traction=_apply(R, mapped.traction),
            rotation=R,
            moment=np.einsum("pk,pkab->pab", _couple(mapped.gap, mapped.traction), W) / 2,
        )
        if hold:
            return values
        return replace(
            values,
            frame_gradient=F,
            frame_total=q,
            frame_gap=mapped.gap,
            frame_traction=mapped.traction,
        )

    def _turning_tangent(self) -> tuple[NDArray, tuple[NDArray, NDArray, NDArray]]:
        """C and the coefficients Z, dM/dT and dM/dS of the turning frame at the points.

        With q = R^T.({P.N} + r g), dR = R.Omega and omega = W:dF its axial vector,
        d zeta = C.Tt(du) + R.(Omega.zeta~ - C~.Omega.q), C = R.C~.R^T. The couple changes by
        dc = D.dT~_tr with D = [zeta~]^T - [q]^T.C~, where [x].omega = omega x x.
        """
        now, N = self._now, self.quadrature.normal
        F, C, q = now.frame_gradient, now.compliance, now.frame_total
        R = frame.rotation(F, N)
        W = frame.spin(F, N, R)
        turn, turn_q = frame.cross_matrix(now.frame_gap), frame.cross_matrix(q)
        # dF is the mean of both sides: half of each side's gradient.
        d, half = self._d, W.reshape(*W.shape[:2], self._d**2) / 2
        halves = half.transpose(0, 2, 1)
        spin = (R @ (turn - C @ turn_q) @ half).reshape(-1, d, d, d)
        D = turn.transpose(0, 2, 1) - turn_q.transpose(0, 2, 1) @ C
        by_traction = (halves @ (D @ R.transpose(0, 2, 1))).reshape(-1, d, d, d)
        by_gradient = -(halves @ (D @ turn_q @ half)).reshape(-1, d, d, d, d)
        couple = _couple(now.frame_gap, now.frame_traction)
        loaded = np.flatnonzero(np.abs(couple).max(axis=1) > 0)
        change = frame.spin_gradient(F[loaded], N[loaded], R[loaded])
        by_gradient[loaded] += np.einsum("pk,pkabcd->pabcd", couple[loaded] / 4, change)
        return R @ C @ R.transpose(0, 2, 1), (spin, by_traction, by_gradient)

    def stage_tangent(self, damage: bool = True) -> None:
        """First stage of the tangent: H, K and C at the points.

        Args:
            damage: Include C = d zeta/dT; without it zeta is held.
        """
        now, facet = self._now, self.quadrature.facet
        delta, delta_s = self._weights[facet], None
        directions = np.einsum("paji,pj->pai", delta, self._slip())
        if self.interface.traction_jump:
            delta_s = self.stabilization.delta_s[facet]
            more = _apply(delta_s, now.jump)
            directions += np.stack([-more, more], axis=1)
        compliance, turning = None, None
        if self.law.inelastic and damage:
            compliance = now.compliance
            if self.turns:
                compliance, turning = self._turning_tangent()
        self._staging.fill(delta, directions, delta_s, compliance, turning)

    @property
    def trial_traction(self) -> NDArray[np.float64]:
        """T_tr of the last residual whose zeta was held, where no frame turns (nq, d) [MPa]."""
        return self._now.traction

    @property
    def compliance(self) -> NDArray[np.float64]:
        """d zeta/dT of the last return map (nq, d, d) [mm3/N]."""
        return self._now.compliance

    def _slip(self) -> NDArray[np.float64]:
        """s = g - zeta (nq, d) [mm]."""
        now = self._now
        return now.opening if now.gap is None else now.opening - now.gap

    def fine_scales(self) -> NDArray[np.float64]:
        """Fine-scale displacement (24) of sides 1 and 2 at the points (nq, 2, d) [mm].

        In the signs of the code: -delta_s.[[P.N]] + delta_1^T.s and -delta_s.[[P.N]] - delta_2^T.s.
        """
        facet = self.quadrature.facet
        flux = _apply(self.stabilization.delta_s[facet], self._now.jump)
        share = np.einsum("paji,pj->pai", self._weights[facet], self._slip())
        return np.array([1.0, -1.0])[:, None] * share - flux[:, None]

    @property
    def _staging(self) -> StagedTangent:
        if self._tangent is None:
            self._tangent = StagedTangent(
                self.quadrature,
                self._evaluators,
                damage=self.law.inelastic,
                turns=self.turns,
                geometric=not self._bodies.regions[0].body.small,
                jump=self.interface.traction_jump,
            )
        return self._tangent

    # History

    def begin_step(self, overstress: float, dt: float) -> None:
        """Remember the converged values and choose the law of the step.

        Args:
            overstress: Added to the overstress per gap increment, in multiples of H, to carry an
                unstable stage over; 0 for the law as it is.
            dt: Time step [s].
        """
        self._converged = self._now
        self._former = self.frozen
        self._dt = dt
        self._acting_law = self.law
        if self.law.inelastic and overstress > 0:
            viscosity = self.law.viscosity + overstress * self.law.softening_modulus * dt
            self._acting_law = self.law.with_viscosity(viscosity)

    def cancel_step(self) -> None:
        """Return to the values of :meth:`begin_step`."""
        self._now = self._converged
        self.frozen = self._former
        self._set_gap()

    @property
    def frozen(self) -> Frozen:
        """The stabilization of the last step and its flux weights, as the forms have them.

        After :meth:`derive_stabilization` what it found, which the forms have not been given yet.
        """
        return self.stabilization, self._weights

    @frozen.setter
    def frozen(self, frozen: Frozen) -> None:
        self.stabilization, self._weights = frozen
        self._set_stabilization()

    def history(self) -> PointHistory:
        """The converged history; its arrays are never changed in place."""
        return PointHistory(
            self.gap, self.softening, self.mode, self._converged_traction, self._now
        )

    def set_history(self, history: PointHistory) -> None:
        """Return to a converged history."""
        self.gap, self.softening, self.mode = history.gap, history.softening, history.mode
        self._converged_traction, self._now = history.traction, history.values
        self._set_gap()

    def take_over(self, other: ActiveInterface) -> None:
        """Take the history of the facets that ``other`` has too; new facets start without one."""
        theirs = other.quadrature.points_of_facet
        position = np.searchsorted(self.facets.facets, other.facets.facets)
        mine = self.quadrature.points_of_facet[position]
        if not np.allclose(self.quadrature.points[mine], other.quadrature.points[theirs]):
            raise RuntimeError("the points of a facet changed their order")
        old, new = other.history(), self.history()

        def moved(now: NDArray | None, before: NDArray | None) -> NDArray | None:
            if now is None or before is None:
                return None
            result = now.copy()
            result[mine] = before[theirs]
            return result

        values = {
            name: moved(getattr(new.values, name), getattr(old.values, name))
            for name in VALUE_ARRAYS
        }
        history = {name: moved(getattr(new, name), getattr(old, name)) for name in HISTORY_ARRAYS}
        self.set_history(PointHistory(**history, values=PointValues(**values)))

    def overstress(self) -> float:
        """Largest viscous overstress of the last step on this rank, relative to the strength."""
        update = self._now.update
        if update is None or len(update.multiplier) == 0:
            return 0.0
        eta = self._acting_law.overstress(self._dt)
        if eta == 0:
            return 0.0
        return float(eta * update.multiplier.max() / self.law.strength)

    def works(self) -> NDArray[np.float64]:
        """What this rank's points dissipate in the step, (39), by damage, friction and viscosity.

        [N mm; N in plane strain], (3,).
        """
        update = self._now.update
        if update is None:
            return np.zeros(3)
        works = np.array([update.damage_work, update.friction_work, update.viscous_work])
        if self.law.friction > 0:
            works[1] = np.maximum(works[1] + self._friction_between(update), 0.0)
        if self._acting_law is not self.law:
            # In a jump the overstress does most of the work.
            works[2] = self._overstress_between(update, works)
        elif self.law.viscosity > 0:
            # The law charges the overstress of the end, too little where it relaxes.
            works[2] = np.maximum(works[2], self._overstress_between(update, works))
        return works @ self.quadrature.weights

    def _overstress_between(self, update: Update, works: NDArray) -> NDArray[np.float64]:
        """Work of the overstress by the mean traction of both ends of the step (nq,) [N/mm].

        The integral of T.dzeta by the trapezoidal rule, exact for linear bodies, less what the bond
        can give back and what bond and friction take.
        """
        mean = (self._converged_traction + update.traction) / 2
        total = np.einsum("pi,pi->p", mean, update.gap - self.gap)
        total -= self.law.stored_energy(update.gap, update.softening)
        total += self.law.stored_energy(self.gap, self.softening)
        return total - works[0] - works[1]

    def _friction_between(self, update: Update) -> NDArray[np.float64]:
        """Friction work that the law does not see, since it knows the end of the step only (nq,).

        It charges friction at the pressure of the end. Where a point slides, the mean of both ends
        is accurate to second order: mu (|T_N,n| - |T_N,n+1|) dgamma / 2 more. Where a sliding point
        lifts off, the pressure falls to zero within the share s = |T_N,n| / (|T_N,n| + r dzeta_N)
        of the step: mu |T_N,n| s |dzeta_T| / 2 [N/mm].
        """
        N, mu = self.quadrature.normal, self.law.friction
        before, after = (
            np.maximum(-np.einsum("pi,pi->p", T, N), 0.0)
            for T in (self._converged_traction, update.traction)
        )
        slips = update.mode == Mode.FRICTION
        work = slips * mu * (before - after) * update.multiplier / 2
        lifts = (self.mode == Mode.FRICTION) & (update.mode == Mode.OPEN) & (before > 0)
        change = (update.gap - self.gap)[lifts]
        opening = np.einsum("pi,pi->p", change, N[lifts])
        slip = np.linalg.norm(change - opening[:, None] * N[lifts], axis=1)
        pressure, r = before[lifts], self.stabilization.norm[self.quadrature.facet[lifts]]
        share = pressure / (pressure + r * np.maximum(opening, 0.0))
        work[lifts] = mu * pressure * share * slip / 2
        return work

    def commit(self) -> None:
        """Take the last return map as the converged history."""
        update = self._now.update
        if update is not None:
            self.gap, self.softening, self.mode = update.gap, update.softening, update.mode
            self._converged_traction = update.traction

    def recoverable_energy(self) -> float:
        """What the law of this rank's points can give back of the work in the gap [N mm]."""
        if not self.law.inelastic:
            return 0.0
        return float(self.quadrature.weights @ self.law.stored_energy(self.gap, self.softening))

    def state(self) -> InterfaceState:
        """Converged values at the points."""
        q = self.quadrature
        count = len(q.weights)
        inelastic = self.law.inelastic
        return InterfaceState(
            points=q.points,
            weights=q.weights,
            normal=q.normal,
            opening=self._now.opening,
            gap=self._now.gap if inelastic else np.zeros((count, self._d)),
            softening=self.softening if inelastic else np.zeros(count),
            traction=self._now.traction,
            mode=self.mode if inelastic else np.full(count, Mode.ELASTIC, dtype=np.int8),
            rotation=(
                np.tile(np.eye(self._d), (count, 1, 1))
                if self._now.rotation is None
                else self._now.rotation
            ),
        )


def _couple(gap: NDArray[np.float64], traction: NDArray[np.float64]) -> NDArray[np.float64]:
    """zeta~ x T~ (nq, 3 or 1) [N/mm]."""
    return np.einsum("pmk,pm->pk", frame.cross_matrix(gap), traction)


def _apply_transposed(
    tensor: NDArray[np.float64], vector: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Row-wise transpose(tensor).vector."""
    return np.einsum("pji,pj->pi", tensor, vector)


def _apply(tensor: NDArray[np.float64], vector: NDArray[np.float64]) -> NDArray[np.float64]:
    """Row-wise tensor.vector."""
    return np.einsum("pij,pj->pi", tensor, vector)
