"""The corotational frame of an interface: rotation of its mid-surface and its variation.

The mid-surface has the mean deformation gradient F of the two sides. Its tangents F.t and its
current normal n give M = F.(I - N (x) N) + n (x) N, and the polar decomposition M = R.U the
rotation R: R.N = n, and within the surface R is the mean material rotation. R is the identity for
pure stretches along the surface or across it, and Q.R for a rotated body Q.F.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray

from ..base.kernels import call, compile_source
from ..domain.materials import Bodies
from ..points.interface import Interface
from ..points.points import Points

Array = NDArray[np.float64]

#: Z, the derivative of zeta by the gradient of either side (nq, d, d, d), and the derivatives of
#: the couple M by the traction (nq, d, d, d) and by that gradient (nq, d, d, d, d).
TurningTangent = tuple[Array, Array, Array]

#: Number of points, and the arrays of frame.c.
_DECLARATIONS = f"""
void frames(long{", void *" * 4});
void turning_tangents(long{", void *" * 10});
"""

_EPSILON = np.zeros((3, 3, 3))
_EPSILON[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
_EPSILON[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1


def turns(interface: Interface, bodies: Bodies, quadrature: Points) -> bool:
    """Whether the law of an interface works in a rotating frame: not at small strain, nor where one
    side is a rigid wall, nor for ties without an initial gap, which turns with the bodies. A frame
    of side 1 is that of the wall, or turns."""
    fixed = bodies.small or (quadrature.facets.walled and not quadrature.facets.slides)
    anything = interface.law.inelastic or quadrature.initial_gap is not None
    return anything and interface.frame == "corotating" and not fixed


class Frame:
    """R, its spin and its contribution to the tangent at many points, by frame.c.

    From M = R.U: (tr(U) I - U).omega = -eps:(R^T.dM), with dM = dF.(I - N (x) N) + dn (x) N and
    R^T.dn = -V.(R^T.dF)^T.N, V = U^-1 in the surface. In the plane omega = -n.dF.t0 / |F.t0|.

    The gradient of a couple's spin is c_k dW_kab/dF_cd. In the plane with s = |F.t0|, t = R.t0 and
    n = R.N: W = -(n (x) t0)/s, ds = t.dF.t0 and dn = -omega t, so it is c (t_a n_c + n_a t_c) t0_b
    t0_d / s^2 up to the sign of omega = W:dF. In space for two changes A = R^T.dF, A', with w =
    (tr(U) I - U)^-1.c, b = V.A^T.N and dU' = A'.(I - N (x) N) - b' (x) N - Omega'.U, where U is
    symmetric and V.N = 0:

        -(V.(N x w)).dU'.b + w.dU'.omega - (w.omega) tr(dU') + (c.W~):(Omega'.A)^T,

    W = R.W~ and the last term from dR, a sum of ten products of two linear functions.
    """

    def __init__(self, d: int, comm: MPI.Comm):
        self._d, self._spins = d, 3 if d == 3 else 1
        source = Path(__file__).with_suffix(".c")
        self._module = compile_source(source, _DECLARATIONS, {"DIM": d}, comm, "frame")

    def at(self, F: Array, N: Array) -> tuple[Array, Array]:
        """R (n, d, d), W (n, 3 or 1, d, d) of omega = W:dF, dR = R.Omega, Omega.x = omega x x."""
        d, count = self._d, len(F)
        R, W = np.empty((count, d, d)), np.empty((count, self._spins, d, d))
        call(self._module, "frames", F, N, R, W)
        return R, W

    def tangent(
        self, F: Array, N: Array, compliance: Array, total: Array, gap: Array, traction: Array
    ) -> tuple[Array, TurningTangent]:
        """C = d zeta/dT (n, d, d) [mm3/N], and the contributions of the frame rotation.

        With q = R^T.({P.N} + r g), dR = R.Omega and omega = W:dF its axial vector,
        d zeta = C.Tt(du) + R.(Omega.zeta~ - C~.Omega.q), C = R.C~.R^T. The couple changes by
        dc = D.dT~_tr with D = [zeta~]^T - [q]^T.C~, where [x].omega = omega x x.

        Args:
            compliance: C~ (n, d, d).
            total: q (n, d).
            gap: zeta~ (n, d).
            traction: T~ (n, d).
        """
        d, count = self._d, len(F)
        C, changes = np.empty((count, d, d)), [np.empty((count, *(d,) * k)) for k in (3, 3, 4)]
        given = F, N, compliance, total, gap, traction
        call(self._module, "turning_tangents", *given, C, *changes)
        return C, tuple(changes)


def cross_matrix(x: Array) -> Array:
    """X with X.omega = omega x x at many points, (n, d, 3 or 1)."""
    if x.shape[1] == 2:
        return np.stack([-x[:, 1:], x[:, :1]], axis=1)
    return (x @ _EPSILON.reshape(9, 3).T).reshape(-1, 3, 3)
