"""The meaning of the coordinates: gradient operator and measure of the forms.

The forms are written once, for a displacement w with d components, its gradient GRAD w (n, n), n >=
d, and integrals weighted by :attr:`weight`; a geometry supplies gradient and weight.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

import ufl
from ufl.core.expr import Expr

#: Rows and columns of entries of a (n, n) tensor.
Entries = list[tuple[int, int]]


def with_entry(tensor: Expr, value: Expr | float) -> Expr:
    """``tensor`` (n, n) with ``value`` as an additional diagonal entry, (n + 1, n + 1)."""
    n = range(tensor.ufl_shape[0])
    return ufl.as_tensor([[*(tensor[i, j] for j in n), 0] for i in n] + [[*(0 for _ in n), value]])


def without_entry(tensor: Expr) -> Expr:
    """The leading (n, n) part of a tensor (n + 1, n + 1)."""
    n = range(tensor.ufl_shape[0] - 1)
    return ufl.as_tensor([[tensor[i, j] for j in n] for i in n])


def _plus_identity(gradient: Expr) -> Expr:
    return ufl.Identity(gradient.ufl_shape[0]) + gradient


@dataclass(frozen=True, eq=False)
class Cartesian:
    """Solids in 3D, and plane strain of a given thickness; n = d."""

    thickness: Expr | float = 1  # Thickness of a plane body [mm], a factor of all integrals
    # F_bar - I of a periodic cell, the mean of GRAD u (d, d); the displacement of the forms is then
    # the fluctuation w in u = (F_bar - I).X + w. None for other bodies.
    macroscopic: Expr | None = None

    @property
    def weight(self) -> Expr | float:
        return self.thickness

    def circumference(self, x: Any) -> Any:
        """Factor of areas at positions ``x`` (d, ...) in addition to the thickness: 1."""
        return 1

    def size(self, d: int) -> int:
        return d

    def entries(self, d: int) -> Entries:
        return [(i, j) for i, j in product(range(d), repeat=2)]

    def gradient(self, w: Expr) -> Expr:
        """GRAD w, (d, d)."""
        return ufl.grad(w)

    def section_gradient(self, u: Expr) -> Expr:
        """GRAD u in the plane or the space of the mesh, (d, d)."""
        return ufl.grad(u) if self.macroscopic is None else self.macroscopic + ufl.grad(u)

    def deformation(self, u: Expr) -> Expr:
        """F = I + GRAD u, of a periodic cell F_bar + GRAD w, (d, d)."""
        return _plus_identity(self.section_gradient(u))

    def nodal_deformation(self, u: Expr) -> Expr:
        """F at points that may be nodes, (d, d)."""
        return _plus_identity(self.section_gradient(u))

    def bubble_stiffness(self, A: Expr, bubble: Expr) -> Expr:
        """GRAD b : A : GRAD b of (22), B_ik = b_,j A_ijkl b_,l, (d, d) [MPa/mm2]."""
        db = ufl.grad(bubble)
        i, j, k, m = ufl.indices(4)
        return ufl.as_tensor(db[j] * A[i, j, k, m] * db[m], (i, k))


@dataclass(frozen=True, eq=False, kw_only=True)
class GeneralizedPlane(Cartesian):
    """Generalized plane strain of a given thickness; d = 2, n = 3.

    The ends of the body stay plane and parallel, F_33 is one number: GRAD u = diag(GRAD u in the
    plane, F_33 - 1). A test or trial function of F_33 is a scalar.
    """

    axial: Expr

    def size(self, d: int) -> int:
        return 3

    def entries(self, d: int) -> Entries:
        """Entries of GRAD: in the plane, and F_33 - 1."""
        return [(0, 0), (0, 1), (1, 0), (1, 1), (2, 2)]

    def gradient(self, w: Expr) -> Expr:
        """GRAD of a displacement in the plane, or of a strain along z, a scalar, (3, 3)."""
        if w.ufl_shape:
            return with_entry(ufl.grad(w), 0)
        return with_entry(ufl.zero((2, 2)), w)

    def deformation(self, u: Expr) -> Expr:
        """F = diag(F in the plane, F_33), (3, 3)."""
        return _plus_identity(with_entry(self.section_gradient(u), self.axial))

    def nodal_deformation(self, u: Expr) -> Expr:
        """F at points that may be nodes, (3, 3)."""
        return self.deformation(u)

    def bubble_stiffness(self, A: Expr, bubble: Expr) -> Expr:
        """GRAD b : A : GRAD b of (22) in the plane, (2, 2) [MPa/mm2]."""
        db = ufl.grad(bubble)

        def component(i: int, k: int) -> Expr:
            return sum(db[j] * A[i, j, k, m] * db[m] for j, m in product(range(2), repeat=2))

        return ufl.as_tensor([[component(i, k) for k in range(2)] for i in range(2)])


@dataclass(frozen=True, eq=False)
class Axisymmetric:
    """The half section of a body of revolution, x = r and y = z, without torsion; d = 2, n = 3.

    The third axis is the hoop direction: GRAD w = [[w_r,r, w_r,z, 0], [w_z,r, w_z,z, 0],
    [0, 0, w_r/r]]. Integrals are those of the whole body, dV = 2 pi r dr dz and dA = 2 pi r ds.
    """

    x: Expr  # Position (r, z) [mm]
    axis: float  # Radius below which a node lies on the axis [mm]

    @property
    def thickness(self) -> float:
        """Factor of areas in addition to the circumference: 1."""
        return 1

    @property
    def weight(self) -> Expr:
        """Factor of every integrand, 2 pi r [mm]."""
        return self.circumference(self.x)

    def circumference(self, x: Any) -> Any:
        """2 pi r [mm] at positions ``x`` (2, ...), an array or an expression."""
        return 2 * math.pi * x[0]

    def size(self, d: int) -> int:
        return 3

    def entries(self, d: int) -> Entries:
        return [(0, 0), (0, 1), (1, 0), (1, 1), (2, 2)]

    def gradient(self, w: Expr) -> Expr:
        """GRAD w, (3, 3); regular at Gauss points, where r > 0."""
        return with_entry(ufl.grad(w), w[0] / self.x[0])

    def section_gradient(self, u: Expr) -> Expr:
        """GRAD u in the section, (2, 2)."""
        return ufl.grad(u)

    def deformation(self, u: Expr) -> Expr:
        """F = I + GRAD u, (3, 3); regular at Gauss points, where r > 0."""
        return _plus_identity(with_entry(ufl.grad(u), u[0] / self.x[0]))

    def nodal_deformation(self, u: Expr) -> Expr:
        """F, (3, 3), with the limit u_r,r of u_r/r on the axis."""
        off = ufl.gt(self.x[0], self.axis)
        radius = ufl.conditional(off, self.x[0], 1.0)
        section = ufl.grad(u)
        hoop = ufl.conditional(off, u[0] / radius, section[0, 0])
        return _plus_identity(with_entry(section, hoop))

    def bubble_stiffness(self, A: Expr, bubble: Expr) -> Expr:
        """GRAD b : A : GRAD b of (22) with the hoop part of GRAD b, (2, 2) [MPa/mm2].

        B_ik = GRAD(b e_i) : A : GRAD(b e_k), where GRAD(b e_i) has b_,r and b_,z in row i and,
        for i = r, b/r in the hoop entry: B_ik = b_,j A_ijkl b_,l for j and l in the section and,
        where i or k is r, in addition the terms of A_ij33, A_33kl and A_3333 with b/r. It is
        regular: the bubble of a facet off the axis vanishes like r on the axis.
        """
        db = ufl.as_vector([*ufl.grad(bubble), bubble / self.x[0]])
        # Entries of GRAD(b e_r) and of GRAD(b e_z); db[n] is in column n.
        filled = ([(0, 0), (0, 1), (2, 2)], [(1, 0), (1, 1)])

        def component(i: int, k: int) -> Expr:
            pairs = product(filled[i], filled[k])
            return sum(db[n] * A[m, n, p, q] * db[q] for (m, n), (p, q) in pairs)

        return ufl.as_tensor([[component(i, k) for k in range(2)] for i in range(2)])


Geometry = Cartesian | GeneralizedPlane | Axisymmetric

#: 3D, and plane strain of unit thickness.
CARTESIAN = Cartesian()
