"""tau_s as the report's authors integrate it, to reproduce their Tables 1 and 2 digit by digit.

They integrate (22) with 2 x 2 x 2 Gauss points and the integrand divided by J, and use four times
the resulting tau_s. The product itself integrates (22) exactly; this module injects theirs through
``Interface(stabilization=...)``.
"""

from __future__ import annotations

from collections.abc import Callable

import basix
import numpy as np
from numpy.typing import NDArray

import vmdg
from vmdg import compat
from vmdg.forms import bubbles
from vmdg.points.interface import StabilizationContext

FACTOR = 4.0


def acoustic_tensor(F: NDArray, mu: float, lmbda: float) -> NDArray:
    """A_ijkl of the neo-Hookean (86) at many F (..., 3, 3) [MPa].

    A = mu I (x) I + (mu - lambda J (J - 1)) G_il G_kj + lambda J (2 J - 1) G_ij G_kl, G = F^-T.
    """
    G = np.swapaxes(np.linalg.inv(F), -1, -2)
    J = np.linalg.det(F)[..., None, None, None, None]
    one = np.eye(3)
    return (
        mu * np.einsum("ik,jl->ijkl", one, one)
        + (mu - lmbda * J * (J - 1)) * np.einsum("...il,...kj->...ijkl", G, G)
        + lmbda * J * (2 * J - 1) * np.einsum("...ij,...kl->...ijkl", G, G)
    )


def report_stabilization(material: vmdg.NeoHookean) -> Callable:
    """``stabilization`` callable for hexahedra of one material on both sides.

    tau_a = (int b)^2 / meas inv(sum_q w_q B(x_q) / J(x_q)), tau_s = 4 inv(tau_1 + tau_2).
    """
    points, weights = basix.make_quadrature(basix.CellType.hexahedron, 3)
    element = basix.ufl.element("Lagrange", "hexahedron", 1)
    shape_gradients = element.tabulate(1, points)[1:]
    step = 1e-3  # the bubbles are quadratic in every direction: central differences are exact
    offsets = step * np.eye(3)
    bubble_gradients = np.stack(
        [
            bubbles.tabulate("hexahedron", points + h) - bubbles.tabulate("hexahedron", points - h)
            for h in offsets
        ]
    ) / (2 * step)

    def one_side(context: StabilizationContext, side: int) -> NDArray:
        space = context.u.function_space
        geometry = space.mesh.geometry
        cells = context.cells[:, side]
        nodes = geometry.x[compat.geometry_dofmap(space.mesh)[cells]]
        u = context.u.x.array.reshape(-1, 3)[space.dofmap.list[cells]]
        jacobian = np.einsum("rqn,fni->fqir", shape_gradients, nodes)
        inverse = np.linalg.inv(jacobian)
        F = np.eye(3) + np.einsum("rqn,fni,fqrj->fqij", shape_gradients, u, inverse)
        A = acoustic_tensor(F, material.parameters["mu"], material.parameters["lmbda"])
        reference = bubble_gradients[:, :, context.local_facets[:, side]]
        gradient = np.einsum("rqf,fqrj->fqj", reference, inverse)
        weight = weights * np.abs(np.linalg.det(jacobian)) / np.linalg.det(F)
        B = np.einsum("fq,fqj,fqijkl,fql->fik", weight, gradient, A, gradient)
        # int b = 4/9 of the area on a parallelogram, so (int b)^2 / meas = 16/81 of the area.
        return 16 / 81 * context.area[:, None, None] * np.linalg.inv(B)

    def stabilization(tau1, tau2, context):
        tau = [one_side(context, side) for side in range(2)]
        bonded = np.linalg.inv(tau[0] + tau[1])
        return FACTOR * bonded, bonded @ tau[0]

    return stabilization
