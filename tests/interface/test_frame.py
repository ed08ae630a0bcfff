"""The frame that turns with the interface: what makes it the frame of the interface law."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vmdg.interface.frame import Frame

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
