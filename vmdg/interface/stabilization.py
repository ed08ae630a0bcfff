"""tau_s and delta: derived by (21)-(25), scaled to coercivity, checked against softening."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from ..base.graph import occurrences
from ..base.kernels import compile_form
from ..base.parallel import global_any, global_max, raise_together
from ..base.quadrature import bubble_degree
from ..base.timers import timer
from ..domain.materials import Bodies
from ..forms import bubbles
from ..points.interface import AUTO, Interface, StabilizationContext
from ..points.points import Points
from .coercivity import Coercivity, Moduli, margin
from .frame import turns

#: Least r / H of "auto": a return map, dgamma = f / (r - H), magnifies its trial by at most 2.
GOOD_RATIO = 2.0

#: H / r above which a wrong unit is as likely as a coarse mesh.
SUSPICIOUS_RATIO = 3.0
SAME_UNITS = "; are the units of strength, moduli, critical gap and mesh consistent (MPa with mm)?"


@dataclass(frozen=True)
class Stabilization:
    """Stabilization of an interface on the facets this rank owns, with the scalar r of (57)."""

    tau: NDArray[np.float64]  # tau_s, safety included (nf, d, d) [MPa/mm]
    delta: NDArray[np.float64]  # Flux weights delta_1, delta_2 of (23) (nf, 2, d, d)
    # Flux weights of the forms: delta, or its isotropic part for a rotating frame; zero where a
    # facet is left out, see :class:`.ActiveInterface` (nf, 2, d, d)
    weights: NDArray[np.float64]
    # tau_s of the forms (nf, d, d) [MPa/mm]: ``tau``, or r I where the law can fail, so that r is
    # also that of the return map, or where its frame turns
    penalty: NDArray[np.float64]
    # (tau_1^-1 + tau_2^-1)^-1 of (25)-(26), without safety (nf, d, d) [mm3/N]
    delta_s: NDArray[np.float64]
    norm: NDArray[np.float64]  # |tau_s|, the scalar r of (57) (nf,) [MPa/mm]
    safety: NDArray[np.float64]  # Factor in ``tau`` and ``norm`` on the derived tau_s (nf,)

    @property
    def left_out(self) -> NDArray[np.bool_]:
        """Facets without fluxes in the forms (nf,)."""
        return ~self.weights.any(axis=(1, 2, 3))

    @classmethod
    def empty(cls, d: int) -> Stabilization:
        tensors, pairs, numbers = np.zeros((0, d, d)), np.zeros((0, 2, d, d)), np.zeros(0)
        return cls(tensors, pairs, pairs, tensors, tensors, numbers, numbers)

    def with_norm(self, norm: NDArray[np.float64]) -> Stabilization:
        """The same with tau_s scaled to the norm ``norm`` (nf,) [MPa/mm]."""
        factor = norm / self.norm
        tau, penalty = (factor[:, None, None] * one for one in (self.tau, self.penalty))
        return replace(self, tau=tau, penalty=penalty, norm=norm, safety=factor * self.safety)


class BubbleIntegrals:
    """Assembles int_K GRAD b : A : GRAD b dV of (22) for chosen (cell, facet in it) pairs.

    A bubble Function selects one facet per cell and pass, so there are as many passes as the
    largest number of interface facets of a cell.
    """

    def __init__(
        self,
        u: fem.Function,
        bodies: Bodies,
        cells: NDArray[np.int32],
        local_facets: NDArray[np.int32],
    ):
        mesh, geometry = u.function_space.mesh, bodies.geometry
        cell_name = mesh.topology.cell_name()
        self._d = mesh.geometry.dim
        self._cells = cells
        self._bubble = fem.Function(fem.functionspace(mesh, bubbles.element(cell_name)))
        self._selected = self._bubble.function_space.dofmap.list[cells, local_facets]
        self._pass_of = occurrences(cells)
        space = fem.functionspace(mesh, ("DG", 0, (self._d, self._d)))
        self._dofs = space.dofmap.list[cells, 0]
        index_map = space.dofmap.index_map
        self._size = (index_map.size_local + index_map.num_ghosts) * self._d**2
        test = ufl.TestFunction(space)
        present = np.unique(cells)
        self._forms = []
        for number, region in enumerate(bodies.regions):
            of_region = present[bodies.region[present] == number]
            dx = ufl.Measure(
                "dx",
                domain=mesh,
                subdomain_data=[(0, of_region)],
                subdomain_id=0,
                metadata={"quadrature_degree": bubble_degree(cell_name, geometry)},
            )
            integrand = bubbles.bubble_stiffness(region.body, geometry, u, self._bubble)
            weight = geometry.circumference(ufl.SpatialCoordinate(mesh))
            form = weight * ufl.inner(test, integrand) * dx
            self._forms.append(compile_form(form, mesh.comm, name="bubble stiffness"))

    def __call__(self) -> NDArray[np.float64]:
        """The integrals (number of pairs, d, d) [MPa mm; MPa in plane strain]."""
        result = np.empty((len(self._cells), self._d, self._d))
        for number in range(int(self._pass_of.max(initial=-1)) + 1):
            chosen = self._pass_of == number
            self._bubble.x.array[:] = 0
            self._bubble.x.array[self._selected[chosen]] = 1
            assembled = np.zeros(self._size)
            for form in self._forms:
                fem.assemble_vector(assembled, form)
            values = assembled.reshape(-1, self._d, self._d)
            result[chosen] = values[self._dofs[chosen]]
        return result


def _distinct(rows: NDArray[np.int32]) -> tuple[NDArray[np.int32], NDArray[np.intp]]:
    """Columns of the distinct rows of an array (n, 2), and where each row is among them (n,)."""
    found, where = np.unique(rows, axis=0, return_inverse=True)
    return np.ascontiguousarray(found.T), where.ravel()


class SoftensTooFast(ValueError):
    """A bond has no equilibrium in the current state: a step that ends elsewhere may have one."""


class Stabilizer:
    """The stabilization of one interface, derived and scaled.

    tau_a = (int_gamma b)^2 / meas(gamma) inv(int_K GRAD b : A : GRAD b dV)   (21)-(22)
    tau_s = safety inv(tau_1 + tau_2),  delta_a = inv(tau_1 + tau_2).tau_a    (23)
    delta_s = tau_1.inv(tau_1 + tau_2).tau_2                                  (25)

    In axisymmetry the fine scale is a ring, u' = b_s (beta_r e_r + beta_z e_z), and (21)-(22)
    follow in the same way from the weak form on its cell, all integrals with dA = 2 pi r ds and dV
    = 2 pi r dr dz and GRAD(b e_r) with its hoop part b/r: tau_a = (int b 2 pi r ds)^2 / (int 2 pi r
    ds) inv(int GRAD b : A : GRAD b 2 pi r dr dz). Numerators and denominators have one more length,
    so tau is per reference area as before, and tends to that of plane strain for r much larger than
    the cell.

    tau_a of a rigid wall is zero, see :mod:`forms.rigid`.

    Attributes:
        stretch: rho of :mod:`vmdg.interface.coercivity` (nf,).
        area: Reference area (nf,) [mm2; mm in plane strain].
    """

    def __init__(self, interface: Interface, quadrature: Points, u: fem.Function, bodies: Bodies):
        self.interface = interface
        self.facets = facets = quadrature.facets
        self.stretch = quadrature.stretch
        self.automatic = interface.safety == AUTO and interface.stabilization is None
        degree = u.function_space.ufl_element().degree
        self.margin = margin(interface.law, degree)
        self._quadrature = quadrature
        self._turns = turns(interface, bodies, quadrature)
        # A facet may be that of several segments.
        sides = np.column_stack([facets.cells.T.ravel(), facets.local.T.ravel()])
        (cells, local), self._side = _distinct(sides)
        self._stiffness = BubbleIntegrals(u, bodies, cells, local)
        self._rigid = bodies.rigid[facets.cells.T]
        self._factor = quadrature.bubble_factors()
        self.area = area = quadrature.area
        N = np.zeros((len(area), quadrature.d))
        np.add.at(N, quadrature.facet, quadrature.normal * quadrature.weights[:, None])
        N /= np.linalg.norm(N, axis=1, keepdims=True)
        self._context = StabilizationContext(u, facets.cells, facets.local, facets.facets, N, area)

    def derive(self) -> Stabilization:
        """tau_s and delta at the current displacement, with ``safety="auto"`` before scaling."""
        number, d = len(self.facets.facets), self._quadrature.d
        inverse = np.linalg.inv(self._stiffness())[self._side].reshape(2, number, d, d)
        both = self._factor[:, :, None, None] * inverse
        both[self._rigid] = 0.0
        tau1, tau2 = both
        bonded = np.linalg.inv(tau1 + tau2)
        safety = 1.0
        if self.interface.stabilization is not None:
            tau, delta1 = self.interface.stabilization(tau1, tau2, self._context)
            for name, value in (("tau_s", tau), ("delta1", delta1)):
                if np.shape(value) != (number, d, d):
                    raise ValueError(
                        f"{self.facets.label}: stabilization returned {name} of shape "
                        f"{np.shape(value)}, expected {(number, d, d)}"
                    )
        else:
            if not self.automatic:
                safety = self.interface.safety
            tau, delta1 = safety * bonded, bonded @ tau1
        delta = np.stack([delta1, np.eye(d) - delta1], axis=1)
        weights = self.flux_weights(delta)
        order = "fro" if self.interface.norm == "frobenius" else 2
        norm = np.linalg.norm(tau, ord=order, axis=(1, 2))
        scalar = self.interface.law.inelastic or self._turns
        penalty = norm[:, None, None] * np.eye(d) if scalar else tau
        delta_s = tau1 @ bonded @ tau2
        safeties = np.full(number, float(safety))
        return Stabilization(tau, delta, weights, penalty, delta_s, norm, safeties)

    def flux_weights(self, delta: NDArray[np.float64]) -> NDArray[np.float64]:
        """Flux weights of the forms from delta (nf, 2, d, d)."""
        if not self._turns:
            return delta
        # A tensor from the start of a step would not rotate with the body; scalars are unaffected.
        share = np.trace(delta, axis1=2, axis2=3) / delta.shape[3]
        return share[:, :, None, None] * np.eye(delta.shape[3])

    def scaled(
        self,
        derived: Stabilization,
        factor: NDArray[np.float64],
        floor: NDArray[np.float64],
    ) -> Stabilization:
        """The stabilization of a step: with ``safety="auto"`` tau_s as required by coercivity.

        r = max(factor |tau_s|, floor, 2 H)

        For a cell with a large aspect ratio the bubble gives a tau_s far above that required by
        coercivity, which costs iterations without benefit. Near H a return map, dgamma = f / (r -
        H), would magnify every change of the trial traction; a larger r never harms coercivity.
        tau_s is evaluated once per step, so u and tau_s depend on each other from step to step: if
        r could decrease, states under constant load could drift.

        Args:
            factor: Factor required by coercivity (nf,).
            floor: Largest r so far (nf,) [MPa/mm].
        """
        if not self.automatic:
            return derived
        least = np.maximum(floor, GOOD_RATIO * self.facets.law.softening_modulus)
        return derived.with_norm(np.maximum(factor * derived.norm, least))

    def suffices(
        self, applied: Stabilization, derived: Stabilization, factor: NDArray[np.float64]
    ) -> bool:
        """Whether a tau_s satisfies coercivity at another displacement, on this rank.

        The fraction of the bulk energy reserved by :mod:`vmdg.interface.coercivity` may be used up.
        """
        if not self.automatic:
            return True
        needed = (1 - self.margin) * factor * derived.norm
        return not (applied.norm < needed).any()

    def check_softening(self, stabilization: Stabilization) -> None:
        """Refuse a penalty at which the bond would soften faster than the bodies unload, by
        :class:`SoftensTooFast`; collective."""
        comm = self._quadrature.mesh.comm
        r, law = stabilization.norm, self.facets.law
        H = np.broadcast_to(law.softening_modulus, r.shape)
        bad = np.flatnonzero(~law.admissible(r))
        message = None
        worst = -global_max(comm, -r[bad].min(initial=np.inf))
        if len(bad) and r[bad].min() == worst:
            f = bad[np.argmin(r[bad])]
            size = self._quadrature.extent[f]
            message = (
                f"{self.facets.label}: facet {self.facets.facets[f]} has r = |tau_s| = {r[f]:.6g} "
                f"MPa/mm, not above the softening modulus H = {H[f]:.6g} MPa/mm: the bond would "
                f"soften faster than the element can unload. Refine the facet from {size:.3g} to "
                f"below {size * r[f] / H[f]:.3g} mm, or raise the critical gap"
            )
            if H[f] > SUSPICIOUS_RATIO * r[f]:
                message += SAME_UNITS
        raise_together(comm, message, SoftensTooFast)


#: Stabilization of every interface before scaling, and its factors (nf,).
_Needed = tuple[list[Stabilization], list[NDArray[np.float64]]]

#: The same, and what the factors have of the displacement, see :meth:`.Coercivity.moduli`.
Sample = tuple[list[Stabilization], Iterable[Moduli]]


class Stabilizers:
    """The stabilization of all active interfaces, which share the energy of their cells.

    Attributes:
        constant: Whether tau_s and delta are the same at every displacement. At small strain the
            moduli in the bubble integrals (22) are constant; a user's function may depend on the
            displacement nevertheless.
    """

    def __init__(self, interfaces: Sequence[Stabilizer], u: fem.Function, bodies: Bodies):
        self._interfaces = interfaces
        self._u, self._bodies = u, bodies
        self._derived = all(one.interface.stabilization is None for one in interfaces)
        self.constant = bodies.small and self._derived
        # At the last two displacements, those of the start and the end of a step.
        self._known: list[tuple[list[NDArray[np.float64]], _Needed]] = []
        self._automatic = any(one.automatic for one in interfaces)
        self._chosen = [
            i for i, one in enumerate(interfaces) if one.interface.stabilization is None
        ]
        self._constants: list[Stabilization] | None = None

    def for_step(self, floors: Sequence[NDArray[np.float64]]) -> list[Stabilization]:
        """Stabilization of every interface for a step from the current displacement, above the
        largest r of the run so far (nf,) [MPa/mm]; collective."""
        if self._constants is not None:
            return self._constants
        scaled = self.scaled(*self.needed(), floors)
        if self.constant:
            self._constants = scaled
        return scaled

    def scaled(
        self,
        derived: Sequence[Stabilization],
        factors: Sequence[NDArray[np.float64]],
        floors: Sequence[NDArray[np.float64]],
    ) -> list[Stabilization]:
        """Of every interface, see :meth:`.Stabilizer.scaled`."""
        arguments = zip(self._interfaces, derived, factors, floors, strict=True)
        return [one.scaled(*values) for one, *values in arguments]

    def suffice(self, applied: Sequence[Stabilization]) -> bool:
        """Whether these suffice at the current displacement too, on this rank; collective.

        At finite strain a long step may end in a spurious equilibrium that exists only because
        tau_s is too small there.
        """
        if self._bodies.small:
            return True
        checks = zip(self._interfaces, applied, *self.needed(), strict=True)
        return all([one.suffices(*values) for one, *values in checks])

    def needed(self) -> _Needed:
        """:meth:`sample` and :meth:`factors` at the current displacement; collective.

        A step starts where the last one was checked at its end, so they are computed once for both.
        A user's function may depend on more and is always called.
        """
        comm = self._u.function_space.mesh.comm
        state = [f.x.array.copy() for f in (self._u, *self._bodies.fields)]
        for known, needed in self._known if self._derived else ():
            if not global_any(comm, not all(map(np.array_equal, state, known))):
                return needed
        sample = self.sample()
        needed = sample[0], self.factors([sample])[0]
        self._known = [(state, needed), *self._known[:1]]
        return needed

    def sample(self, chosen: Sequence[NDArray[np.bool_]] | None = None) -> Sample:
        """Of the current displacement, laws and bodies; collective."""
        derived = [one.derive() for one in self._interfaces]
        moduli = self._coercivity.moduli(self._of_derived(chosen)) if self._automatic else ()
        return derived, moduli

    def factors(
        self, samples: Sequence[Sample], chosen: Sequence[NDArray[np.bool_]] | None = None
    ) -> list[list[NDArray[np.float64]]]:
        """Factors on tau_s required by coercivity on every facet (nf,) in some states, together;
        collective.

        Interfaces with a user-defined stabilization are left out.
        """
        factors = [[np.ones(len(one.norm)) for one in derived] for derived, _ in samples]
        if not (samples and self._automatic):
            return factors
        every = [
            [(one.penalty, one.weights) for one in self._of_derived(derived)]
            for derived, _ in samples
        ]
        states = [moduli for _, moduli in samples]
        with timer("coercivity"):
            found = self._coercivity(every, states, self._of_derived(chosen))
        for mine, theirs in zip(factors, found, strict=True):
            for i, factor in zip(self._chosen, theirs, strict=True):
                mine[i] = factor / (1 - self._interfaces[i].margin)
        return factors

    def _of_derived(self, values: Sequence[Any] | None) -> list[Any] | None:
        """Those of values of every interface whose tau_s is derived."""
        return None if values is None else [values[i] for i in self._chosen]

    @cached_property
    def _coercivity(self) -> Coercivity:
        interfaces = self._of_derived(self._interfaces)
        given = ([one.facets for one in interfaces], [one.stretch for one in interfaces])
        areas = [one.area for one in interfaces]
        return Coercivity(self._u, self._bodies, *given, areas)
