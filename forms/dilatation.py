"""Mean dilatation for nearly incompressible bodies of linear quadrilaterals and hexahedra.

For a large bulk modulus J = det F must be close to 1 at all quadrature points of a cell: more
constraints than the cell has degrees of freedom, so it locks. Mean dilatation imposes one per cell
(Nagtegaal, Parks & Rice 1974; Hughes 1980; Simo, Taylor & Pister 1985; de Souza Neto et al. 1996).
The dilatation theta is constant in a cell and F is replaced by

    F_bar = (theta / J)^(1/n) F,   theta = 1/V int_K J dV,

n = 2 in plane strain, where F_33 stays 1, and 3 otherwise. W(F_bar) is a function w(F, theta), and
the form is the derivative of its integral with theta eliminated: symmetric, with an energy. With p
the mean of dw/dtheta over the cell (and what interfaces add, see :mod:`vmdg.assembly.dilatation`)

    dPi = int (dw/dF + p dJ/dF) : GRAD eta dV,

dw/dF a deviatoric and p the pressure in the cell. The first Piola-Kirchhoff stress at a point is

    P = dw/dF + dw/dtheta dJ/dF,

equal to dW/dF where theta = J; the tractions P.N of interfaces are made with it. At small strain
J - 1 = tr(eps), theta - 1 is its mean and F_bar - I = eps + (theta - J)/n I, the B-bar method.

Here theta is an independent field of the forms, stored as an additional diagonal entry (n, n) of F,
of GRAD and of all derivatives by F. A test or trial function of theta is a scalar, so one formula
gives all blocks of the two-field form.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import ufl
from ufl.core.expr import Expr

from .geometry import Axisymmetric, Cartesian, Entries, with_entry

if TYPE_CHECKING:
    _Plain = Cartesian  # base of the mixin below, or an axisymmetric geometry
else:
    _Plain = object


def dilatation(tensor: Expr) -> Expr:
    """The entry of a tensor (n + 1, n + 1) that belongs to theta."""
    n = tensor.ufl_shape[0] - 1
    return tensor[n, n]


def volume_ratio(F: Expr, small: bool) -> Expr:
    """J of F (n, n); 1 + tr(F - I) at small strain."""
    return 1 + ufl.tr(F) - F.ufl_shape[0] if small else ufl.det(F)


def mean_dilated(F: Expr, theta: Expr, small: bool) -> Expr:
    """F_bar (n, n): F with its volume ratio replaced by ``theta``."""
    n = F.ufl_shape[0]
    J = volume_ratio(F, small)
    return F + (theta - J) / n * ufl.Identity(n) if small else (theta / J) ** (1 / n) * F


@dataclass(frozen=True, eq=False, kw_only=True)
class MeanDilatation(_Plain):
    """A geometry whose F and GRAD have an additional entry for theta."""

    theta: Expr
    pressure: Expr  # p of the cells, positive in tension [MPa]

    def size(self, d: int) -> int:
        return super().size(d) + 1

    def entries(self, d: int) -> Entries:
        n = super().size(d)
        return [*super().entries(d), (n, n)]

    def gradient(self, w: Expr) -> Expr:
        """GRAD w of a displacement, or of a dilatation, a scalar, (n + 1, n + 1)."""
        if w.ufl_shape:
            return with_entry(super().gradient(w), 0)
        n = super().size(len(ufl.grad(w)))
        return with_entry(ufl.zero((n, n)), w)

    def deformation(self, u: Expr) -> Expr:
        """diag(F, theta)."""
        return with_entry(super().deformation(u), self.theta)

    def nodal_deformation(self, u: Expr) -> Expr:
        """diag(F, theta) for points that may be nodes."""
        return with_entry(super().nodal_deformation(u), self.theta)


@dataclass(frozen=True, eq=False)
class MeanCartesian(MeanDilatation, Cartesian):
    """Solids in 3D and in plane strain, with mean dilatation."""


@dataclass(frozen=True, eq=False)
class MeanAxisymmetric(MeanDilatation, Axisymmetric):
    """Bodies of revolution with mean dilatation."""
