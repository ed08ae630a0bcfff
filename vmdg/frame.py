"""The frame that turns with the interface: rotation of its mid-surface and its variation.

The mid-surface has the mean deformation gradient F of the two sides. Its tangents F.t and its
current normal n give M = F.(I - N (x) N) + n (x) N, and the polar decomposition M = R.U the
rotation R: R.N = n, and R turns in the surface like the material does on average. R is the
identity for pure stretches along the surface or across it, and Q.R for a rotated body Q.F.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_EPSILON = np.zeros((3, 3, 3))
_EPSILON[[0, 1, 2], [1, 2, 0], [2, 0, 1]] = 1
_EPSILON[[0, 2, 1], [2, 1, 0], [1, 0, 2]] = -1


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


def spin(F: Array, N: Array, R: Array) -> Array:
    """W with omega = W:dF, where dR = R.Omega and Omega.x = omega x x; (n, 3 or 1, d, d).

    From M = R.U: (tr(U) I - U).omega = -eps:(R^T.dM), with dM = dF.(I - N (x) N) + dn (x) N and
    R^T.dn = -U^-1.(I - N (x) N).(R^T.dF)^T.N. In the plane omega = -n.dF.t0 / |F.t0|.
    """
    if N.shape[1] == 2:
        t0 = _quarter_turn(N)
        stretch = np.linalg.norm(np.einsum("pij,pj->pi", F, t0), axis=1)
        pulled = -_outer(N, t0) / stretch[:, None, None]
        return np.einsum("pab,pca->pcb", pulled, R)[:, None]
    one = np.eye(3)
    plane = one - _outer(N, N)
    U = np.einsum("pki,pkj->pij", R, F @ plane) + _outer(N, N)
    V = plane @ np.linalg.inv(U) @ plane
    moment = -np.einsum("kaj,pbj->pkab", _EPSILON, plane) + np.einsum(
        "kij,pib,pa,pj->pkab", _EPSILON, V, N, N, optimize=True
    )
    inertia = np.trace(U, axis1=1, axis2=2)[:, None, None] * one - U
    pulled = np.einsum("pkl,plab->pkab", np.linalg.inv(inertia), moment)
    return np.einsum("pkab,pca->pkcb", pulled, R)


def spin_gradient(F: Array, N: Array) -> Array:
    """dW_kab/dF_cd by central differences, (n, 3 or 1, d, d, d, d).

    W is a smooth function of numbers of order one: the step of 1e-5 leaves an error of 1e-10.
    """
    step, d = 1e-5, N.shape[1]

    def shifted(c: int, e: int, amount: float) -> Array:
        moved = F.copy()
        moved[:, c, e] += amount
        return spin(moved, N, rotation(moved, N))

    columns = [
        [(shifted(c, e, step) - shifted(c, e, -step)) / (2 * step) for e in range(d)]
        for c in range(d)
    ]
    return np.moveaxis(np.array(columns), (0, 1), (4, 5))


def cross_matrix(x: Array) -> Array:
    """X with X.omega = omega x x at many points, (n, d, 3 or 1)."""
    if x.shape[1] == 2:
        return _quarter_turn(x)[:, :, None]
    return np.einsum("mkn,pn->pmk", _EPSILON, x)


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
