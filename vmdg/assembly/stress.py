"""Cauchy stress of the bodies as a field."""

from __future__ import annotations

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

from .. import compat
from ..base.kernels import compile_expression
from ..forms import kinematics
from ..forms.geometry import with_entry, without_entry
from .discretization import Discretization


class CauchyStress:
    """Cauchy stress sigma = P.F^T / J of the bodies, (3, 3) [MPa], discontinuous of degree k.

    At small strain sigma = P.

    In axisymmetry the order is r, z, hoop; in plane strain sigma_zz = (dW/dF_33) / J is the last
    entry; in plane stress it is 0, and J includes the thickness stretch.
    """

    def __init__(self, discretization: Discretization):
        mesh, degree = discretization.mesh, discretization.degree
        space = fem.functionspace(mesh, ("DG", degree, (3, 3)))
        self.function = fem.Function(space, name="stress")
        self._compile(discretization)

    def _compile(self, discretization: Discretization) -> None:
        self._u = u = discretization.u
        points = compat.interpolation_points(self.function.function_space)
        self._expressions = []
        for region in discretization.bodies.regions:
            F = ufl.variable(discretization.geometry.nodal_deformation(u))
            stress = _cauchy(region.body, F)
            expression = compile_expression(stress, points, discretization.mesh.comm)
            self._expressions.append((expression, region.cells))

    def update(self, discretization: Discretization) -> fem.Function:
        if self._u is not discretization.u:
            self._compile(discretization)
        discretization.update_means()
        for expression, cells in self._expressions:
            compat.interpolate(self.function, expression, cells)
        self.function.x.scatter_forward()
        return self.function


def _cauchy(body: kinematics.Body, F: Expr) -> Expr:
    P = kinematics.first_piola(body, F)
    own = without_entry(F) if body.mean_dilatation else F
    # At small strain F is replaced by 1.
    forward, J = (ufl.Identity(own.ufl_shape[0]), 1) if body.small else (own.T, ufl.det(own))
    if body.plane_stress:
        J = J if body.small else J * body.thickness_stretch(own)
        return with_entry(P * forward / J, 0)
    stress = P * forward / J
    if own.ufl_shape[0] == 3:
        return stress
    if body.points is not None:
        return with_entry(stress, body.points.facet_stress[2, 2] / J)
    solid = ufl.variable(with_entry(body.effective(F), 1))
    out_of_plane = kinematics.first_piola(body.pointwise, solid)[2, 2] / J
    return with_entry(stress, out_of_plane)
