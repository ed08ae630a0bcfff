"""The frame that turns with the interface: rotation of its mid-surface and its variation.

The mid-surface has the mean deformation gradient F of the two sides. Its tangents F.t and its
current normal n give M = F.(I - N (x) N) + n (x) N, and the polar decomposition M = R.U the
rotation R: R.N = n, and R turns in the surface like the material does on average. R is the
identity for pure stretches along the surface or across it, and Q.R for a rotated body Q.F.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..domain.materials import Bodies
from .interface import Interface

Array = NDArray[np.float64]

_EPSILON = np.zeros((3, 3, 3))
_EPSILON[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
_EPSILON[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1


def turns(interface: Interface, bodies: Bodies) -> bool:
    """Whether the law of an interface works in a frame that turns: not for ties, nor at small
    strain."""
    return interface.law.inelastic and interface.frame == "corotating" and not bodies.small


def rotation(F: Array, N: Array) -> Array:
    """R at many points.

    Args:
        F: Mean deformation gradient (n, d, d).
        N: Reference unit normal (n, d).

    Returns:
        Rotations (n, d, d).
    """
    if N.shape[1] == 2:
        t0 = _quarter_turn(N)
        t = np.einsum("pij,pj->pi", F, t0)
        t /= np.linalg.norm(t, axis=1, keepdims=True)
        return _outer(t, t0) + _outer(-_quarter_turn(t), N)
    a, b = _tangents(N)
    Fa, Fb = (np.einsum("pij,pj->pi", F, v) for v in (a, b))
    n = np.cross(Fa, Fb)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    first = Fa / np.linalg.norm(Fa, axis=1, keepdims=True)
    second = np.cross(n, first)
    # In this basis the surface part of M is [[m11, m12], [0, m22]]; the polar angle makes it
    # symmetric.
    m11, m12, m22 = (np.einsum("pi,pi->p", *v) for v in ((first, Fa), (first, Fb), (second, Fb)))
    angle = np.arctan2(-m12, m11 + m22)[:, None]
    turned_a = np.cos(angle) * first + np.sin(angle) * second
    turned_b = -np.sin(angle) * first + np.cos(angle) * second
    return _outer(turned_a, a) + _outer(turned_b, b) + _outer(n, N)


class Spin:
    """The spin of the frame at many points and its derivative.

    From M = R.U: (tr(U) I - U).omega = -eps:(R^T.dM), with dM = dF.(I - N (x) N) + dn (x) N and
    R^T.dn = -V.(R^T.dF)^T.N, V = U^-1 in the surface. In the plane omega = -n.dF.t0 / |F.t0|.

    Args:
        F: Mean deformation gradient (n, d, d).
        N: Reference unit normal (n, d).
        R: Rotation of the frame (n, d, d).

    Attributes:
        W: omega = W:dF, where dR = R.Omega and Omega.x = omega x x; (n, 3 or 1, d, d).
    """

    def __init__(self, F: Array, N: Array, R: Array):
        self._N, self._R = N, R
        if N.shape[1] == 2:
            self._t0 = _quarter_turn(N)
            self._stretch = np.linalg.norm(_apply(F, self._t0), axis=1)
            pulled = -_outer(N, self._t0) / self._stretch[:, None, None]
            self.W = (R @ pulled)[:, None]
            return
        one, NN = np.eye(3), _outer(N, N)
        self._plane = plane = one - NN
        self._U = U = R.transpose(0, 2, 1) @ (F @ plane) + NN
        self._V = V = plane @ _inverse(U) @ plane
        trace = U[:, 0, 0] + U[:, 1, 1] + U[:, 2, 2]
        self._inverse_inertia = _inverse(trace[:, None, None] * one - U)
        # Of R^T.dF to -eps:(R^T.dM).
        moment = (-_EPSILON.reshape(9, 3) @ plane).reshape(-1, 3, 3, 3)
        moment += (cross_matrix(N) @ V)[:, :, None] * N[:, None, :, None]
        self._pulled = self._inverse_inertia @ moment.reshape(-1, 3, 9)
        self.W = R[:, None] @ self._pulled.reshape(-1, 3, 3, 3)

    def gradient(self, couple: Array) -> Array:
        """c_k dW_kab/dF_cd of a couple c (n, 3 or 1), (n, d, d, d, d).

        In the plane with s = |F.t0|, t = R.t0 and n = R.N: W = -(n (x) t0)/s, ds = t.dF.t0 and
        dn = -omega t, so dW_ab/dF_cd = (t_a n_c + n_a t_c) t0_b t0_d / s^2 up to the sign of
        omega = W:dF.

        In space for two changes A = R^T.dF, A', with w = (tr(U) I - U)^-1.c, b = V.A^T.N and
        dU' = A'.(I - N (x) N) - b' (x) N - Omega'.U, where U is symmetric and V.N = 0:

            -(V.(N x w)).dU'.b + w.dU'.omega - (w.omega) tr(dU') + (c.W~):(Omega'.A)^T,

        W = R.W~ and the last term from dR, a sum of ten products of two linear functions.
        """
        N, R = self._N, self._R
        if N.shape[1] == 2:
            t, n = _apply(R, self._t0), _apply(R, N)
            both = _outer(t, n) + _outer(n, t)
            square = (couple[:, 0] / self._stretch**2)[:, None, None] * _outer(self._t0, self._t0)
            return both[:, :, None, :, None] * square[:, None, :, None, :]
        count, plane, V, W = len(N), self._plane, self._V, self.W.reshape(-1, 3, 9)
        n, w = _apply(R, N), _apply(self._inverse_inertia, couple)
        slope = (V[:, :, None, :] * n[:, None, :, None]).reshape(count, 3, 9)
        held = (couple[:, None] @ self._pulled).reshape(count, 1, 3, 3)
        turned = (R[:, None] @ _EPSILON.transpose(1, 0, 2) @ held).reshape(count, 3, 9)
        left = np.concatenate([-slope, W, turned, -w[:, None] @ W], axis=1)

        def stretch(vector: Array) -> Array:
            """vector.dU'."""
            straight = _apply(R, vector)[:, None, :, None] * plane[:, :, None]
            straight -= N[:, :, None, None] * _outer(n, _apply(V, vector))[:, None]
            return straight.reshape(count, 3, 9) + self._U @ cross_matrix(vector) @ W

        across = stretch(_apply(V, np.cross(N, w)))
        trace = (R @ plane).reshape(count, 1, 9)
        right = np.concatenate([across, stretch(w), W, trace], axis=1)
        return (left.transpose(0, 2, 1) @ right).reshape(-1, 3, 3, 3, 3)

    def of(self, points: NDArray[np.intp]) -> Spin:
        """That of some of the points."""
        some = object.__new__(Spin)
        for name, values in vars(self).items():
            setattr(some, name, values[points])
        return some


def _inverse(A: Array) -> Array:
    """Inverse of (n, 3, 3) by the vector products of its rows."""
    a, b, c = A[:, 0], A[:, 1], A[:, 2]
    columns = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=2)
    return columns / np.einsum("pi,pi->p", a, columns[:, :, 0])[:, None, None]


def _apply(tensor: Array, vector: Array) -> Array:
    """Row-wise tensor.vector."""
    return (tensor @ vector[..., None])[..., 0]


def cross_matrix(x: Array) -> Array:
    """X with X.omega = omega x x at many points, (n, d, 3 or 1)."""
    if x.shape[1] == 2:
        return _quarter_turn(x)[:, :, None]
    return (x @ _EPSILON.reshape(9, 3).T).reshape(-1, 3, 3)


def _quarter_turn(x: Array) -> Array:
    return np.column_stack([-x[:, 1], x[:, 0]])


def _outer(a: Array, b: Array) -> Array:
    return a[:, :, None] * b[:, None, :]


def _tangents(N: Array) -> tuple[Array, Array]:
    """Two unit vectors that make a right-handed basis with N."""
    least = np.eye(3)[np.argmin(np.abs(N), axis=1)]
    a = np.cross(N, least)
    a /= np.linalg.norm(a, axis=1, keepdims=True)
    return a, np.cross(N, a)
