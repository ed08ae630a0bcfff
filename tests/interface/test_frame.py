"""The frame that turns with the interface: what makes it the frame of the interface law."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmdg.interface.frame import Frame, cross_matrix

COUNT = 50
EVERY_DIMENSION = pytest.mark.parametrize("d", [2, 3])
FRAMES = {d: Frame(d, MPI.COMM_SELF) for d in (2, 3)}
SEEDS = given(seed=st.integers(0, 2**32 - 1))

# Rounding of a few dozen operations on numbers of order 1, times the condition of F: sample()
# keeps det F above .1 and the entries of F - I within a few tenths.
ROUNDING = 1e-12


def sample(seed: int, d: int):
    """Deformation gradients and unit normals at many points; the turns in F are not small."""
    rng = np.random.default_rng(seed)
    N = rng.normal(size=(COUNT, d))
    N /= np.linalg.norm(N, axis=1, keepdims=True)
    F = np.eye(d) + 0.3 * rng.uniform(-1, 1, size=(COUNT, d, d))
    F = rotations(rng, d) @ F
    keep = np.linalg.det(F) > 0.1
    return rng, F[keep], N[keep]


def rotation(F, N):
    return FRAMES[N.shape[1]].at(F, N)[0]


def spin(F, N):
    return FRAMES[N.shape[1]].at(F, N)[1]


def rotations(rng, d: int):
    """Random proper rotations (COUNT, d, d)."""
    Q = np.linalg.qr(rng.normal(size=(COUNT, d, d)))[0]
    Q[:, 0] *= np.sign(np.linalg.det(Q))[:, None]
    return Q


def apply(tensor, vector):
    return np.einsum("pij,pj->pi", tensor, vector)


@EVERY_DIMENSION
@SEEDS
def test_proper_rotation(d, seed):
    """R^T.R = I and det R = 1."""
    _, F, N = sample(seed, d)
    R = rotation(F, N)
    assert np.abs(R.transpose(0, 2, 1) @ R - np.eye(d)).max() < ROUNDING
    assert np.abs(np.linalg.det(R) - 1).max() < ROUNDING


@EVERY_DIMENSION
@SEEDS
def test_normal_is_the_current_one(d, seed):
    """R.N is the normal of the deformed surface, cof(F).N / |cof(F).N| (Nanson)."""
    _, F, N = sample(seed, d)
    n = apply(np.linalg.inv(F).transpose(0, 2, 1), N)
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    assert np.abs(apply(rotation(F, N), N) - n).max() < ROUNDING


@SEEDS
def test_turns_in_the_surface_by_the_polar_decomposition(seed):
    """In 3D R^T.F is a symmetric positive stretch of the surface: R is the polar rotation."""
    _, F, N = sample(seed, 3)
    P = np.eye(3) - N[:, :, None] * N[:, None, :]
    U = rotation(F, N).transpose(0, 2, 1) @ F @ P
    assert np.abs(U - U.transpose(0, 2, 1)).max() < ROUNDING
    assert np.linalg.eigvalsh(U + N[:, :, None] * N[:, None, :]).min() > 0


@EVERY_DIMENSION
@SEEDS
def test_spin_is_the_derivative(d, seed):
    """dR.x = R.(omega x x) with omega = W:dF equals central differences of R(F).x.

    The step 1e-5 leaves an error of 1e-10 times the third derivative, which grows with the inverse
    cube of the smallest stretch of the surface; rounding adds 1e-11.
    """
    rng, F, N = sample(seed, d)
    R = rotation(F, N)
    dF = rng.uniform(-1, 1, size=F.shape)
    x = rng.uniform(-1, 1, size=N.shape)
    omega = np.einsum("pkij,pij->pk", spin(F, N), dF)
    change = apply(R, apply(cross_matrix(x), omega))
    h = 1e-5
    difference = (rotation(F + h * dF, N) - rotation(F - h * dF, N)) / (2 * h)
    assert change == pytest.approx(apply(difference, x), abs=1e-7)


@EVERY_DIMENSION
@SEEDS
def test_tangent(d, seed):
    """What turns with the frame equals central differences along random changes, as accurately.

    A law zeta~ = q / 2 + zeta_0 with q = R^T.T, so that C~ = I / 2, and T~ = q - r zeta~ with
    r = 1: zeta = R.zeta~ and M = (zeta~ x T~).W / 2 follow from F and T.
    """
    rng, F, N = sample(seed, d)
    T, shift, dT = rng.uniform(-1, 1, size=(3, *N.shape))
    dF = rng.uniform(-1, 1, size=F.shape)

    def state(F, T):
        R, W = FRAMES[d].at(F, N)
        q = apply(R.transpose(0, 2, 1), T)
        gap = q / 2 + shift
        traction = q - gap
        couple = np.einsum("pmk,pm->pk", cross_matrix(gap), traction)
        return q, gap, traction, apply(R, gap), np.einsum("pk,pkab->pab", couple, W) / 2

    half = np.tile(np.eye(d) / 2, (len(N), 1, 1))
    C, (Z, MT, MS) = FRAMES[d].tangent(F, N, half, *state(F, T)[:3])
    h = 1e-5
    ahead, behind = state(F + h * dF, T + h * dT), state(F - h * dF, T - h * dT)
    gap, moment = ((a - b) / (2 * h) for a, b in zip(ahead[3:], behind[3:], strict=True))
    # Each side has half of F.
    assert apply(C, dT) + 2 * np.einsum("piab,pab->pi", Z, dF) == pytest.approx(gap, abs=1e-6)
    changes = np.einsum("pabi,pi->pab", MT, dT) + 2 * np.einsum("pabcd,pcd->pab", MS, dF)
    assert changes == pytest.approx(moment, abs=1e-6)
