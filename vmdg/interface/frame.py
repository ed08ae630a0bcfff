"""The frame that turns with the interface: rotation of its mid-surface and its variation.

The mid-surface has the mean deformation gradient F of the two sides. Its tangents F.t and its
current normal n give M = F.(I - N (x) N) + n (x) N, and the polar decomposition M = R.U the
rotation R: R.N = n, and R turns in the surface like the material does on average. R is the
identity for pure stretches along the surface or across it, and Q.R for a rotated body Q.F.
"""

from __future__ import annotations

import math

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
    *_, inertia, moment = _spin_parts(F, N, R)
    return np.einsum("pkab,pca->pkcb", _solve(inertia, moment), R)


def _spin_parts(F: Array, N: Array, R: Array) -> tuple[Array, Array, Array, Array]:
    """U, V = U^-1 in the surface, tr(U) I - U, and the map of R^T.dF to -eps:(R^T.dM) in 3D."""
    one, NN = np.eye(3), _outer(N, N)
    plane = one - NN
    U = R.transpose(0, 2, 1) @ (F @ plane) + NN
    V = plane @ np.linalg.inv(U) @ plane
    inertia = np.trace(U, axis1=1, axis2=2)[:, None, None] * one - U
    moment = -np.einsum("kaj,pbj->pkab", _EPSILON, plane)
    moment += (_normal_spin(N) @ V)[:, :, None] * N[:, None, :, None]
    return U, V, inertia, moment


def _normal_spin(N: Array) -> Array:
    """eps_kij N_j (n, 3, 3)."""
    return np.einsum("kij,pj->pki", _EPSILON, N)


def _solve(inertia: Array, moment: Array) -> Array:
    """inertia^-1.moment with any number of indices behind the first of ``moment``."""
    columns = moment.reshape(len(moment), 3, math.prod(moment.shape[2:]))
    return np.linalg.solve(inertia, columns).reshape(moment.shape)


def spin_gradient(F: Array, N: Array, R: Array, couple: Array) -> Array:
    """c_k dW_kab/dF_cd of a couple c (n, 3 or 1), (n, d, d, d, d).

    In the plane with s = |F.t0|, t = R.t0 and n = R.N: W = -(n (x) t0)/s, ds = t.dF.t0 and
    dn = -omega t, so dW_ab/dF_cd = (t_a n_c + n_a t_c) t0_b t0_d / s^2 up to the sign of
    omega = W:dF. In space by the chain rule in the parts of :func:`spin`, along the unit changes
    dF = e_c (x) e_d: dU = R^T.dM - Omega.U, dV = -V.dU.V, and with w = inertia^-1.c one row of it.
    """
    if N.shape[1] == 2:
        t0 = _quarter_turn(N)
        stretch = np.linalg.norm(np.einsum("pij,pj->pi", F, t0), axis=1)
        t, n = np.einsum("pij,pj->pi", R, t0), np.einsum("pij,pj->pi", R, N)
        both = _outer(t, n) + _outer(n, t)
        square = _outer(t0, t0) * (couple[:, 0] / stretch**2)[:, None, None]
        return np.einsum("pac,pbd->pabcd", both, square)
    points = len(N)
    U, V, inertia, moment = _spin_parts(F, N, R)
    pulled = _solve(inertia, moment)
    W = np.einsum("pkab,pca->pkcb", pulled, R)
    # The nine changes are the second index.
    turn = np.einsum("ilm,plcd->pcdim", _EPSILON, W).reshape(points, 9, 3, 3)
    plane = np.eye(3) - _outer(N, N)
    along = np.einsum("pci,pi->pc", R, N)
    dM = np.einsum("pci,pdj->pcdij", R, plane) - np.einsum("pc,pid,pj->pcdij", along, V, N)
    dU = dM.reshape(points, 9, 3, 3) - turn @ U[:, None]
    d_inertia = np.trace(dU, axis1=2, axis2=3)[..., None, None] * np.eye(3) - dU
    dV = -V[:, None] @ dU @ V[:, None]
    w = _solve(inertia, couple[..., None])[:, None, None, :, 0]
    d_moment = (w @ _normal_spin(N)[:, None] @ dV) * N[:, None, :, None]
    inertial = (w @ d_inertia)[:, :, 0] @ pulled.reshape(points, 3, 9)
    d_pulled = d_moment - inertial.reshape(points, 9, 3, 3)
    # W_kgb = pulled_kab R_ga, and dR = R.Omega
    held = np.einsum("pk,pkab->pab", couple, pulled)
    result = R[:, None] @ (d_pulled + turn @ held[:, None])
    return result.reshape(points, 3, 3, 3, 3).transpose(0, 3, 4, 1, 2)


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
