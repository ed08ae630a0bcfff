"""Deformation measures and the mechanical description of a body at a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
import ufl
from ufl.core.expr import Expr

from .dilatation import MeanDilatation, dilatation, mean_dilated, volume_ratio
from .geometry import Entries, Geometry, with_entry, without_entry
from .invariants import InvariantChain, Invariants
from .materials import Material, least


@dataclass(frozen=True)
class PointFields:
    """Coefficients of a body whose stress is computed at points rather than from an energy.

    In the cells they have the values at the quadrature points. On facets the stress is that of the
    points extrapolated, P_a = sum_q E_pq P_q, so that facets need no history of their own: with
    one, a facet could be elastic while its cell is plastic, and no tau_s would suffice. The moduli
    of the adjoint term are those of the last given load factor, since a residual must not jump
    where a point yields.
    """

    # P at the points of the cells (n, n) [MPa]; with mean dilatation what is conjugate to diag(F,
    # theta)
    stress: Expr
    moduli: Expr  # Its derivative by F there (m, m), rows and columns the ``entries`` [MPa]
    stored: Expr  # Stored energy there [MPa]
    facet_stress: Expr  # P at any point of a cell (3, 3) [MPa]
    facet_moduli: Expr  # dP/dF of the adjoint term, at any point of a cell (m, m) [MPa]
    facet_stretch: Expr  # F_33 at any point of a cell, at small strain the strain
    entries: tuple[tuple[int, int], ...]

    def __call__(self, side: str) -> PointFields:
        """The same on ``side`` of a facet, where the values in the cells do not exist."""
        return replace(
            self, facet_stress=self.facet_stress(side), facet_moduli=self.facet_moduli(side)
        )

    def traction_moduli(self, N: Expr) -> Expr:
        """(A.N)_mij of the moduli on facets, (d, n, n)."""
        d, n = len(N), 1 + max(i for i, _ in self.entries)

        def component(m: int, i: int, j: int) -> Expr:
            if (i, j) not in self.entries:
                return ufl.as_ufl(0.0)
            column = self.entries.index((i, j))
            rows = ((self.entries.index((m, k)), k) for k in range(d))
            return sum(self.facet_moduli[row, column] * N[k] for row, k in rows)

        return ufl.as_tensor(
            [[[component(m, i, j) for j in range(n)] for i in range(n)] for m in range(d)]
        )

    def stiffness(self, eta: Expr, du: Expr) -> Expr:
        """GRAD eta : A : GRAD du in a cell, of these gradients (n, n)."""
        pairs = list(enumerate(self.entries))
        return sum(
            eta[p] * self.moduli[row, column] * du[q] for row, p in pairs for column, q in pairs
        )


@dataclass(frozen=True)
class Body:
    """A material with its parameters at a point, as the forms use it on each side of an interface.

    Attributes:
        small: Small strains: the energy is the quadratic one of the symmetric gradient.
        eigenstrain: Stress-free strain, F = F_e F_s: e with F_s = (1 + e) I, or a symmetric tensor
            (3, 3) with F_s = I + e, without shear out of the plane in 2D; None for none.
        plane_stress: F is (2, 2), and F_33 such that the stress out of the plane vanishes;
            otherwise F_33 = 1.
        mean_dilatation: The energy is w(F, theta) of :mod:`forms.dilatation`, theta an entry of F.
        fluid: Fluid pressure p at a facet [MPa]: tractions are then those of W + p J, the part of
            P.N not due to the fluid. None for tractions P.N.
        points: The stress if it is computed at points, see :class:`PointFields`; the material is
            then the elastic one. None for hyperelastic bodies.
        incremental: At finite strain W is the quadratic energy of the strain since the current
            F_0, det F_0 W_lin(sym((F - F_0) F_0^-1)): its moduli are those of a body whose elastic
            strains are small, however large the plastic ones.
    """

    material: Material
    parameters: Mapping[str, Expr]
    small: bool = False
    eigenstrain: Expr | None = None
    mean_dilatation: bool = False
    fluid: Expr | None = None
    plane_stress: bool = False
    points: PointFields | None = None
    incremental: bool = False

    def __call__(self, side: str) -> Body:
        """The same body with its parameters restricted to ``side`` ('+' or '-') of a facet."""
        parameters = {name: value(side) for name, value in self.parameters.items()}
        eigenstrain = None if self.eigenstrain is None else self.eigenstrain(side)
        # Facet quantities are not restricted to a side.
        fluid = None if self.fluid is None else self.fluid("+")
        points = None if self.points is None else self.points(side)
        return replace(
            self, parameters=parameters, eigenstrain=eigenstrain, fluid=fluid, points=points
        )

    @property
    def elastic(self) -> Body:
        if self.points is None:
            return self
        return replace(self, points=None, incremental=not self.small)

    def energy(self, F: Expr) -> Expr:
        """Strain energy W(F) per reference volume [MPa]; F 3 x 3, or 2 x 2 in plane strain.

        With an eigenstrain: W = J_s W_e(F F_s^-1); small strains: W = W_lin(sym(F) - F_s).
        With mean dilatation F is diag(F, theta) and W that of F_bar.
        """
        if self.points is not None:
            return self.points.stored
        if self.incremental:
            return self._incremental_energy(self.effective(F), self.effective(F.ufl_operands[0]))
        if self.mean_dilatation:
            reduced = self.invariant_energy(F)
            return self.pointwise.energy(self.effective(F)) if reduced is None else reduced.energy
        if self.plane_stress:
            return self._plane_stress_energy(F)
        d = F.ufl_shape[0]
        e = 0 if self.eigenstrain is None or self.anisotropic else self.eigenstrain
        if self.small:
            strain = ufl.sym(F) - (1 + e) * ufl.Identity(d)
            if d == 2:
                strain = with_entry(strain, -e)
            if self.anisotropic:
                strain -= self.eigenstrain
            return self.material.linear_energy(strain, self.parameters)
        reduced = self.invariant_energy(F)
        if reduced is not None:
            return reduced.energy
        if d == 2:
            F = with_entry(F, 1)
        if self.eigenstrain is None:
            return self.material.energy(F, self.parameters)
        if self.anisotropic:
            F_s = ufl.Identity(3) + self.eigenstrain
            return ufl.det(F_s) * self.material.energy(F * ufl.inv(F_s), self.parameters)
        return (1 + e) ** 3 * self.material.energy(F / (1 + e), self.parameters)

    def _plane_stress_energy(self, F: Expr) -> Expr:
        """:meth:`energy` of the plane F (2, 2), minimised over F_33."""
        if not self.small:
            elastic, J_s = self._elastic(F), self._stress_free_volume
            return J_s * self.material.plane_stress_energy(elastic, self.parameters)
        strain = ufl.sym(F) - ufl.Identity(2)
        if self.anisotropic:
            strain -= without_entry(self.eigenstrain)
        elif self.eigenstrain is not None:
            strain -= self.eigenstrain * ufl.Identity(2)
        return least(
            lambda e_33: self.material.linear_energy(with_entry(strain, e_33), self.parameters)
        )[0]

    def _incremental_energy(self, F: Expr, F_0: Expr) -> Expr:
        strain = ufl.sym((F - F_0) * ufl.inv(F_0))

        def energy(e_33: Expr | float) -> Expr:
            whole = with_entry(strain, e_33) if F.ufl_shape[0] == 2 else strain
            return self.material.linear_energy(whole, self.parameters)

        # In plane stress F_33 is not known here: det F_0 = 1, as elastic strains are small.
        return least(energy)[0] if self.plane_stress else ufl.det(F_0) * energy(0)

    def thickness_stretch(self, F: Expr) -> Expr:
        """F_33 in plane stress at finite strain, of the plane F (2, 2)."""
        if self.points is not None:
            return self.points.facet_stretch
        stretch = self.material.free_stretch(self._elastic(F), self.parameters)
        if self.eigenstrain is None:
            return stretch
        e = self.eigenstrain[2, 2] if self.anisotropic else self.eigenstrain
        return (1 + e) * stretch

    @property
    def anisotropic(self) -> bool:
        return self.eigenstrain is not None and self.eigenstrain.ufl_shape != ()

    @property
    def pointwise(self) -> Body:
        return replace(self, mean_dilatation=False)

    def effective(self, F: Expr) -> Expr:
        """The deformation gradient (n, n) that :attr:`pointwise` sees, F_bar of diag(F, theta)."""
        if not self.mean_dilatation:
            return F
        return mean_dilated(without_entry(F), dilatation(F), self.small)

    def volume_ratio(self, F: Expr) -> Expr:
        """J of the displacement in diag(F, theta)."""
        return volume_ratio(without_entry(F), self.small)

    def invariant_energy(self, F: Expr) -> Invariants | None:
        """:meth:`energy` as a function of a few invariants; None where the material does not define
        it."""
        if self.small or self.plane_stress or self.incremental or self.points is not None:
            return None
        plane, more = without_entry(F) if self.mean_dilatation else F, {}
        n = plane.ufl_shape[0]
        _, out_of_plane, volume = self._elastic_part(n)
        if self.mean_dilatation:
            more["dilatation"] = volume * dilatation(F)
        elastic, out_of_plane = self._elastic(plane), ufl.as_ufl(out_of_plane) if n == 2 else None
        reduced = self.material.invariant_energy(elastic, out_of_plane, self.parameters, **more)
        if reduced is None or self.eigenstrain is None:
            return reduced
        return replace(reduced, energy=self._stress_free_volume * reduced.energy)

    @property
    def _stress_free_volume(self) -> Expr | float:
        """J_s = det F_s."""
        if self.eigenstrain is None:
            return 1
        if self.anisotropic:
            return ufl.det(ufl.Identity(3) + self.eigenstrain)
        return (1 + self.eigenstrain) ** 3

    def _elastic(self, F: Expr) -> Expr:
        """F_e = F F_s^-1 (n, n) in the plane or in space."""
        if self.eigenstrain is None:
            return F
        n = F.ufl_shape[0]
        inverse, _, _ = self._elastic_part(n)
        if self.anisotropic:
            return F * inverse
        return ufl.as_tensor([[inverse * F[i, j] for j in range(n)] for i in range(n)])

    def _elastic_part(self, n: int) -> tuple[Expr | float, Expr | float, Expr | float]:
        """F_s^-1 (n, n), or the factor of I, its entry out of the plane, and det of the former."""
        if self.eigenstrain is None:
            return 1, 1, 1
        if not self.anisotropic:
            stretch = 1 / (1 + self.eigenstrain)
            return stretch, stretch, stretch**n
        inverse = ufl.inv(ufl.Identity(3) + self.eigenstrain)
        block = ufl.as_tensor([[inverse[i, j] for j in range(n)] for i in range(n)])
        return block, inverse[2, 2], ufl.det(block)


def _chain(body: Body, F: Expr) -> InvariantChain | None:
    return None if body.invariant_energy(F) is None else InvariantChain(body.invariant_energy, F)


def _conjugate_stress(body: Body, F: Expr) -> Expr:
    """dW/dF, with the shape of F [MPa]; with mean dilatation its last entry is dw/dtheta."""
    chain = _chain(body, F)
    return ufl.diff(body.energy(F), F) if chain is None else chain.stress()


def first_piola(body: Body, F: Expr) -> Expr:
    """First Piola-Kirchhoff stress P = dW/dF, (n, n) [MPa].

    With mean dilatation P = dw/dF + dw/dtheta dJ/dF.
    """
    if body.points is not None:
        n = range(F.ufl_shape[0] - body.mean_dilatation)
        return ufl.as_tensor([[body.points.facet_stress[i, j] for j in n] for i in n])
    P = _conjugate_stress(body, F)
    if not body.mean_dilatation:
        return P
    return without_entry(P + dilatation(P) * ufl.diff(body.volume_ratio(F), F))


def area_vector(body: Body, F: Expr, N: Expr) -> Expr:
    """J F^-T.N = dJ/dF.N, oriented current area per reference area (d,); Nanson.

    At small strain N.
    """
    if body.small:
        return N
    J = body.volume_ratio(F) if body.mean_dilatation else ufl.det(F)
    dJ, d = ufl.diff(J, F), range(len(N))
    return ufl.as_vector([sum(dJ[i, j] * N[j] for j in d) for i in d])


def traction(body: Body, F: Expr, N: Expr) -> Expr:
    """P.N, traction per reference area (d,) [MPa], d the length of N; with a fluid P + p dJ/dF.

    F may have an additional hoop direction, in which N and P.N have no component.
    """
    P = first_piola(body, F)
    stress = ufl.dot(without_entry(P) if P.ufl_shape[0] > len(N) else P, N)
    return stress if body.fluid is None else stress + body.fluid * area_vector(body, F, N)


def _fluid_traction(body: Body, F: Expr, N: Expr, v: Expr) -> Expr | None:
    """p v.(dJ/dF).N, the contribution of the fluid to v.P.N; None where it does not depend on F."""
    if body.fluid is None or body.small:
        return None
    return body.fluid * ufl.dot(v, area_vector(body, F, N))


class _TractionChain:
    """Derivatives of v.P.N by F through invariants.

    v.P.N = v.(dW/dF).N, with mean dilatation + dw/dtheta j, j = v.(dJ/dF).N.
    """

    def __init__(self, chain: InvariantChain, body: Body, F: Expr, N: Sequence, v: Sequence):
        n = F.ufl_shape[0]
        v, N = ([*x, *[0] * (n - len(x))] for x in (v, N))
        self._chain = chain
        self._weights = [a * b for a in v for b in N]
        self._mean = body.mean_dilatation
        if not self._mean:
            return
        dJ = ufl.diff(body.volume_ratio(F), F)
        j = sum(weight * dJ[divmod(p, n)] for p, weight in enumerate(self._weights) if weight != 0)
        self._weights[-1] = j
        self._stress = dilatation(chain.stress())
        self._dj = ufl.diff(j, F)
        self._d2j = ufl.diff(self._dj, F)

    def moduli(self) -> Expr:
        """d(v.P.N)/dF."""
        moduli = self._chain.moduli(self._weights)
        return moduli + self._stress * self._dj if self._mean else moduli

    def third_derivative(self) -> Expr:
        """d2(v.P.N)/dF2."""
        third = self._chain.third_derivative(self._weights)
        if not self._mean:
            return third
        by_theta = self._chain.moduli([*[0] * (len(self._weights) - 1), 1])
        mixed = ufl.outer(by_theta, self._dj) + ufl.outer(self._dj, by_theta)
        return third + mixed + self._stress * self._d2j


def traction_moduli(body: Body, F: Expr, N: Expr) -> Expr:
    """H = (A.N), H_mij = d(P.N)_m/dF_ij with A of (19), (d, n, n) for F (n, n) [MPa]."""
    if body.points is not None:
        H = body.points.traction_moduli(N)
    elif (chain := _chain(body, F)) is None:
        return ufl.diff(traction(body, F, N), F)
    else:
        units = np.eye(len(N), dtype=int).tolist()
        H = ufl.as_tensor([_TractionChain(chain, body, F, N, e).moduli() for e in units])
    if body.fluid is None or body.small:
        return H
    return H + ufl.diff(body.fluid * area_vector(body, F, N), F)


def projected_traction_moduli(body: Body, F: Expr, N: Expr, v: Expr) -> Expr:
    """v.(A.N), the derivative of v.P.N by F, (n, n) [MPa times the unit of v]."""
    if body.points is not None:
        moduli = ufl.dot(v, body.points.traction_moduli(N))
    elif (chain := _chain(body, F)) is None:
        return ufl.diff(ufl.dot(v, traction(body, F, N)), F)
    else:
        moduli = _TractionChain(chain, body, F, N, v).moduli()
    fluid = _fluid_traction(body, F, N, v)
    return moduli if fluid is None else moduli + ufl.diff(fluid, F)


def projected_third_derivative(body: Body, F: Expr, N: Expr, v: Expr) -> Expr:
    """K = Xi:(v (x) N) of (85): K_ijkl = d2(v.P.N)/dF_ij dF_kl, (n, n, n, n).

    That of the fluid alone for a body at points, whose moduli on facets are constant in a step.
    """
    if body.points is not None:
        third = ufl.zero(F.ufl_shape + F.ufl_shape)
    elif (chain := _chain(body, F)) is None:
        return ufl.diff(projected_traction_moduli(body, F, N, v), F)
    else:
        third = _TractionChain(chain, body, F, N, v).third_derivative()
    fluid = _fluid_traction(body, F, N, v)
    return third if fluid is None else third + ufl.diff(ufl.diff(fluid, F), F)


def major_components(tensor: Expr, entries: Entries) -> Expr:
    """Vector of the independent T_ijkl = T_klij of a tensor, with ij and kl among ``entries``."""
    return ufl.as_vector([tensor[p + q] for p, q in combinations_with_replacement(entries, 2)])


def acoustic_tensor(body: Body, F: Expr) -> Expr:
    """A = d2W/dFdF, eq. (19), (n, n, n, n) for F (n, n) [MPa]."""
    chain = _chain(body, F)
    if chain is None:
        return ufl.diff(_conjugate_stress(body, F), F)
    n = F.ufl_shape[0]
    rows = np.eye(n * n, dtype=int).reshape(n, n, n * n).tolist()
    return ufl.as_tensor([[chain.moduli(weights) for weights in row] for row in rows])


def bulk_stress(body: Body, geometry: Geometry, F: Expr) -> Expr:
    """The stress conjugate to GRAD eta in a cell, with the shape of F [MPa].

    P; with mean dilatation diag(dw/dF + p dJ/dF, dw/dtheta).
    """
    stress = _conjugate_stress(body, F) if body.points is None else body.points.stress
    if not body.mean_dilatation:
        return stress
    assert isinstance(geometry, MeanDilatation)
    return stress + geometry.pressure * ufl.diff(body.volume_ratio(F), F)


def bulk_moduli(body: Body, geometry: Geometry, F: Expr) -> Expr:
    """Derivative of :func:`bulk_stress` by F: A, with mean dilatation d2(w + p J) [MPa]."""
    A = acoustic_tensor(body, F)
    # The incremental body has no stress.
    stressed = body.mean_dilatation and not body.incremental
    return A + _pressure_moduli(body, geometry, F) if stressed else A


def _pressure_moduli(body: Body, geometry: Geometry, F: Expr) -> Expr:
    """d2(p J) at constant p, with mean dilatation [MPa]."""
    assert isinstance(geometry, MeanDilatation)
    return geometry.pressure * ufl.diff(ufl.diff(body.volume_ratio(F), F), F)


def volume_gradient(body: Body, F: Expr, entries: Entries) -> Expr:
    """Vector of these entries of dJ/dF in diag(F, theta), except the last one, that of theta."""
    dJ = ufl.diff(body.volume_ratio(F), F)
    return ufl.as_vector([dJ[entry] for entry in entries[:-1]])


def stiffness(body: Body, geometry: Geometry, F: Expr, *gradients: Expr) -> Expr:
    """GRAD eta : A : GRAD du, the first term of (85), of these two gradients (n, n) [N/mm2]."""
    if body.points is None:
        return _contracted(bulk_moduli(body, geometry, F), *gradients)
    K = body.points.stiffness(*gradients)
    if not body.mean_dilatation or body.small:
        return K
    return K + _contracted(_pressure_moduli(body, geometry, F), *gradients)


def _contracted(A: Expr, eta: Expr, du: Expr) -> Expr:
    i, j, k, m = ufl.indices(4)
    return eta[i, j] * A[i, j, k, m] * du[k, m]
