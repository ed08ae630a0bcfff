"""Deformation measures and the mechanical description of a body at a point."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import ufl
from ufl.core.expr import Expr

from .geometry import Entries, Geometry
from .invariants import InvariantChain, Invariants
from .materials import Material


def plane_strain_embedding(tensor: Expr, out_of_plane: float) -> Expr:
    """3 x 3 tensor with ``tensor`` in the plane and ``out_of_plane`` in its last diagonal entry."""
    return ufl.as_tensor(
        [
            [tensor[0, 0], tensor[0, 1], 0],
            [tensor[1, 0], tensor[1, 1], 0],
            [0, 0, out_of_plane],
        ]
    )


@dataclass(frozen=True)
class Body:
    """A material with its parameters at a point; all that the forms ask of a side of an interface.

    Attributes:
        material: The strain energy.
        parameters: UFL expressions of the material's parameters (cell-wise constants).
        small: Small strains: the energy is the quadratic one of the symmetric gradient.
        swelling: Isotropic stress-free strain theta, F = F_e F_th with F_th = (1 + theta) I;
            None where the scene has none.
    """

    material: Material
    parameters: Mapping[str, Expr]
    small: bool = False
    swelling: Expr | None = None

    def __call__(self, side: str) -> Body:
        """The same body with its parameters restricted to ``side`` ('+' or '-') of a facet."""
        parameters = {name: value(side) for name, value in self.parameters.items()}
        swelling = None if self.swelling is None else self.swelling(side)
        return replace(self, parameters=parameters, swelling=swelling)

    def energy(self, F: Expr) -> Expr:
        """Strain energy W(F) per reference volume [MPa]; F 3 x 3, or 2 x 2 in plane strain.

        With swelling: W = J_th W_e(F F_th^-1); small strains: W = W_lin(sym(F) - I - theta I).
        """
        d = F.ufl_shape[0]
        theta = 0 if self.swelling is None else self.swelling
        if self.small:
            strain = ufl.sym(F) - (1 + theta) * ufl.Identity(d)
            if d == 2:
                strain = plane_strain_embedding(strain, -theta)
            return self.material.linear_energy(strain, self.parameters)
        reduced = self.invariant_energy(F)
        if reduced is not None:
            return reduced.energy
        if d == 2:
            F = plane_strain_embedding(F, 1)
        if self.swelling is None:
            return self.material.energy(F, self.parameters)
        return (1 + theta) ** 3 * self.material.energy(F / (1 + theta), self.parameters)

    def invariant_energy(self, F: Expr) -> Invariants | None:
        """:meth:`energy` by few invariants, where the material offers that, else None."""
        if self.small:
            return None
        stretch = 1 if self.swelling is None else 1 / (1 + self.swelling)
        out_of_plane = ufl.as_ufl(stretch) if F.ufl_shape[0] == 2 else None
        elastic = F
        if self.swelling is not None:
            d = range(F.ufl_shape[0])
            elastic = ufl.as_tensor([[stretch * F[i, j] for j in d] for i in d])
        reduced = self.material.invariant_energy(elastic, out_of_plane, self.parameters)
        if reduced is None or self.swelling is None:
            return reduced
        return replace(reduced, energy=(1 + self.swelling) ** 3 * reduced.energy)


def deformation_gradient(gradient: Expr) -> Expr:
    """F = I + GRAD u as a UFL variable, so that it can be differentiated by."""
    return ufl.variable(ufl.Identity(gradient.ufl_shape[0]) + gradient)


def _chain(body: Body, F: Expr) -> InvariantChain | None:
    return None if body.invariant_energy(F) is None else InvariantChain(body.invariant_energy, F)


def _weights(v: Sequence, N: Sequence, n: int) -> list:
    """Weights of the components of P (n, n) in v.P.N."""
    v, N = ([*x, *[0] * (n - len(x))] for x in (v, N))
    return [a * b for a in v for b in N]


def _unit_vectors(d: int) -> list[list[int]]:
    return [[int(i == j) for j in range(d)] for i in range(d)]


def first_piola(body: Body, F: Expr) -> Expr:
    """P = dW/dF, first Piola-Kirchhoff stress, of the shape of F [MPa]."""
    chain = _chain(body, F)
    return ufl.diff(body.energy(F), F) if chain is None else chain.stress()


def traction(body: Body, F: Expr, N: Expr) -> Expr:
    """P.N, traction per reference area (d,) [MPa], d the length of N.

    F may have a hoop direction besides, in which neither N nor P.N has a component.
    """
    P, d = first_piola(body, F), range(len(N))
    if F.ufl_shape[0] > len(N):
        P = ufl.as_tensor([[P[i, j] for j in d] for i in d])
    return ufl.dot(P, N)


def traction_moduli(body: Body, F: Expr, N: Expr) -> Expr:
    """H = (A.N), H_mij = d(P.N)_m/dF_ij with A of (19), (d, n, n) for F (n, n) [MPa]."""
    chain = _chain(body, F)
    if chain is None:
        return ufl.diff(traction(body, F, N), F)
    n = F.ufl_shape[0]
    return ufl.as_tensor([chain.moduli(_weights(e, N, n)) for e in _unit_vectors(len(N))])


def projected_traction_moduli(body: Body, F: Expr, N: Expr, v: Expr) -> Expr:
    """v.(A.N), the derivative of v.P.N by F, (n, n) [MPa times the unit of v]."""
    chain = _chain(body, F)
    if chain is None:
        return ufl.diff(ufl.dot(v, traction(body, F, N)), F)
    return chain.moduli(_weights(v, N, F.ufl_shape[0]))


def projected_third_derivative(body: Body, F: Expr, N: Expr, v: Expr) -> Expr:
    """K = Xi:(v (x) N) of (85): K_ijkl = d2(v.P.N)/dF_ij dF_kl, (n, n, n, n)."""
    chain = _chain(body, F)
    if chain is None:
        return ufl.diff(projected_traction_moduli(body, F, N, v), F)
    return chain.third_derivative(_weights(v, N, F.ufl_shape[0]))


def major_components(tensor: Expr, entries: Entries) -> Expr:
    """Vector of the independent T_ijkl = T_klij of a tensor, with ij and kl among ``entries``."""
    return ufl.as_vector([tensor[p + q] for p, q in combinations_with_replacement(entries, 2)])


def from_major_components(vector: Expr, entries: Entries) -> Expr:
    """The (n, n, n, n) tensor of these :func:`major_components`, zero elsewhere."""
    number = {}
    for count, (p, q) in enumerate(combinations_with_replacement(entries, 2)):
        number[p + q] = number[q + p] = count
    r = range(1 + max(i for i, _ in entries))

    def entry(*ijkm: int) -> Expr | int:
        return vector[number[ijkm]] if ijkm in number else 0

    return ufl.as_tensor([[[[entry(i, j, k, m) for m in r] for k in r] for j in r] for i in r])


def acoustic_tensor(body: Body, F: Expr) -> Expr:
    """A = d2W/dFdF, eq. (19), (n, n, n, n) for F (n, n) [MPa]."""
    chain = _chain(body, F)
    if chain is None:
        return ufl.diff(first_piola(body, F), F)
    size = F.ufl_shape[0]
    units = _unit_vectors(size)
    return ufl.as_tensor([[chain.moduli(_weights(m, n, size)) for n in units] for m in units])


def stiffness(body: Body, geometry: Geometry, F: Expr, eta: Expr, du: Expr) -> Expr:
    """GRAD eta : A : GRAD du, the first term of (85) [N/mm2]."""
    A = acoustic_tensor(body, F)
    i, j, k, m = ufl.indices(4)
    return geometry.gradient(eta)[i, j] * A[i, j, k, m] * geometry.gradient(du)[k, m]
