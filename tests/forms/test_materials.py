"""Materials: stress, moduli and their derivatives at a point against independent formulas."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from numpy.typing import NDArray
from support.problems import user_energy
from support.scenes import unit_box

import vmdg
from vmdg.base.kernels import compile_expression
from vmdg.forms import kinematics
from vmdg.forms.geometry import CARTESIAN

#: c and m of Table 3, and a bulk modulus five times the shear modulus.
OGDEN = vmdg.Ogden(c=(6.3, 0.012, -0.010), m=(1.3, 5.0, -2.0), kappa=16.0)
NEO_HOOKEAN = vmdg.NeoHookean(mu=3.0, lmbda=7.0)

#: One point: not worth optimizing.
QUICK = {"cffi_extra_compile_args": ["-O0", "-g0"]}

EVERY_DIMENSION = pytest.mark.parametrize("d", [2, 3])


USER = vmdg.Hyperelastic(user_energy, NEO_HOOKEAN.parameters)


class Point:
    """W, P, A and K of a material at one deformation gradient, by the engine's forms.

    Args:
        material: Its key decides on the kernel; values are those of the last :meth:`use`.
        d: Dimension.
        swelling: Value of theta.
        small: Small-strain kinematics.
    """

    def __init__(self, material: vmdg.Material, d: int, swelling: float | None, small: bool):
        self.d = d
        self._mesh = unit_box(MPI.COMM_SELF, "triangle" if d == 2 else "tetrahedron", 1)
        scalar = fem.functionspace(self._mesh, ("DG", 0))
        self._parameters = {name: fem.Function(scalar) for name in material.parameters}
        theta = None
        if swelling is not None:
            theta = fem.Function(scalar)
            theta.x.array[:] = swelling
        body = kinematics.Body(material, self._parameters, small, theta)
        gradient = fem.Function(fem.functionspace(self._mesh, ("DG", 0, (d, d))))
        vector = fem.functionspace(self._mesh, ("DG", 0, (d,)))
        self._inputs = gradient, fem.Function(vector), fem.Function(vector)
        F = ufl.variable(gradient)
        values = [
            body.energy(F),
            kinematics.first_piola(body, F),
            kinematics.acoustic_tensor(body, F),
        ]
        if not small:
            K = kinematics.projected_third_derivative(body, F, *self._inputs[1:])
            values.append(kinematics.major_components(K, CARTESIAN.entries(d)))
        self._expressions = [
            compile_expression(value, np.full((1, d), 0.2), self._mesh.comm, QUICK)
            for value in values
        ]

    def use(self, material: vmdg.Material) -> Point:
        """Take the parameters of ``material``."""
        for name, value in material.parameters.items():
            self._parameters[name].x.array[:] = value
        return self

    def __call__(self, F: NDArray, N: NDArray | None = None, v: NDArray | None = None):
        """W, P (d, d), A and K (d^2, d^2) at F; K contracted with N and v, unit vectors else."""
        n = self.d**2
        vectors = (np.eye(self.d)[0] if vector is None else vector for vector in (N, v))
        for function, value in zip(self._inputs, (F, *vectors), strict=True):
            function.x.array[:] = np.tile(np.ravel(value), function.x.array.size // np.size(value))
        cell = np.zeros(1, dtype=np.int32)
        W, P, A, *third = (e.eval(self._mesh, cell).ravel() for e in self._expressions)
        K = np.zeros((n, n))
        if third:
            K[np.triu_indices(n)] = third[0]
            K += np.triu(K, 1).T
        return W[0], P.reshape(self.d, self.d), A.reshape(n, n), K


POINTS: dict[tuple, Point] = {}


def point(material, d: int, swelling: float | None = None, small: bool = False) -> Point:
    """The kernel of a material, with the parameters of this one."""
    key = material.kernel_key, d, swelling, small
    if key not in POINTS:
        POINTS[key] = Point(material, d, swelling, small)
    return POINTS[key].use(material)


def embed(F: NDArray) -> NDArray:
    result = np.eye(3)
    result[: len(F), : len(F)] = F
    return result


def rotation(rng: np.random.Generator, d: int) -> NDArray:
    Q, _ = np.linalg.qr(rng.standard_normal((d, d)))
    Q[:, 0] *= np.sign(np.linalg.det(Q))
    return Q


def stretched(rng: np.random.Generator, stretches) -> NDArray:
    """F of given principal stretches along random axes, rotated at random."""
    d = len(stretches)
    return rotation(rng, d) @ np.diag(stretches) @ rotation(rng, d).T


def spectral(material: vmdg.Ogden, F: NDArray) -> tuple[float, NDArray]:
    """W and P (3, 3) of (87)-(88) by principal stretches."""
    c, m, kappa = ogden_constants(material)
    U, stretches, Vt = np.linalg.svd(F)
    J = np.prod(stretches)
    powers = (stretches * J ** (-1 / 3)) ** m[:, None]
    W = (c / m**2) @ (powers.sum(axis=1) - 3) + kappa / 2 * ((J**2 - 1) / 2 - np.log(J))
    kirchhoff = (c / m) @ (powers - powers.mean(axis=1, keepdims=True)) + kappa / 2 * (J**2 - 1)
    return W, U @ np.diag(kirchhoff / stretches) @ Vt


def ogden_constants(material: vmdg.Ogden):
    """c, m and kappa as arrays."""
    p = material.parameters
    terms = range(1, material.terms + 1)
    return np.array([p[f"c{a}"] for a in terms]), np.array([p[f"m{a}"] for a in terms]), p["kappa"]


def check_derivatives(evaluate: Point, F: NDArray, rng: np.random.Generator) -> None:
    """A symmetric, P = dW, A = dP and v.K.N = dA by differences, along random directions."""
    d = evaluate.d
    N, v, D = rng.standard_normal(d), rng.standard_normal(d), rng.standard_normal((d, d))
    D /= np.linalg.norm(D)
    # Small next to the smallest stretch, of which A and K are powers.
    h = 5e-4 * np.linalg.svd(F, compute_uv=False)[-1]
    _, P, A, K = evaluate(F, N, v)
    # Central differences of fourth order: truncation and rounding both near 1e-11.
    states = [evaluate(F + k * h * D) for k in (-2, -1, 1, 2)]
    dW, dP, dA = (
        sum(w * np.asarray(state[i]) for w, state in zip((1, -8, 8, -1), states, strict=True))
        / (12 * h)
        for i in range(3)
    )
    size = np.abs(A).max()
    assert np.abs(A - A.T).max() < 1e-13 * size
    assert abs(dW - np.sum(P * D)) < 1e-8 * size
    assert np.abs(dP.ravel() - A @ D.ravel()).max() < 1e-8 * size
    # K D = dA : (v (x) N), by the symmetry of third derivatives.
    assert np.abs(dA @ np.outer(v, N).ravel() - K @ D.ravel()).max() < 1e-7 * max(
        np.abs(K).max(), size
    )


# Neo-Hookean and user-written energies


@EVERY_DIMENSION
@pytest.mark.parametrize("material", [NEO_HOOKEAN, USER], ids=["own", "user"])
def test_neo_hookean_closed_form(material, d):
    """P and A of (86) at random F are those of the closed form."""
    rng = np.random.default_rng(1)
    mu, lmbda = NEO_HOOKEAN.parameters["mu"], NEO_HOOKEAN.parameters["lmbda"]
    for _ in range(4):
        F = stretched(rng, rng.uniform(0.4, 2.5, d))
        W, P, A, _ = point(material, d)(F)
        full = embed(F)
        J, inverse = np.linalg.det(full), np.linalg.inv(full)
        pressure = lmbda * (J - 1) * J - mu
        assert W == pytest.approx(
            mu / 2 * (np.sum(full**2) - 3) - mu * np.log(J) + lmbda / 2 * (J - 1) ** 2, rel=1e-12
        )
        np.testing.assert_allclose(P, (mu * full + pressure * inverse.T)[:d, :d], rtol=1e-11)
        expected = (
            mu * np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))
            + lmbda * (2 * J - 1) * J * np.einsum("ji,lk->ijkl", inverse, inverse)
            - pressure * np.einsum("li,jk->ijkl", inverse, inverse)
        )[:d, :d, :d, :d].reshape(d * d, d * d)
        np.testing.assert_allclose(A, expected, atol=1e-12 * np.abs(expected).max())
        check_derivatives(point(material, d), F, rng)


@pytest.mark.parametrize("material", [NEO_HOOKEAN, USER, OGDEN], ids=["neo", "user", "ogden"])
def test_small_strain(material):
    """The small-strain moduli are A at F = I."""
    F = np.eye(2)
    np.testing.assert_allclose(
        point(material, 2, small=True)(F)[2], point(material, 2)(F)[2], atol=1e-12
    )


def test_user_energy_parameters():
    """Materials of one function share one kernel; the defaults are empty."""
    assert vmdg.Hyperelastic(user_energy, {"mu": 1, "lmbda": 2}).kernel_key == USER.kernel_key
    assert vmdg.Hyperelastic(lambda F, p: ufl.tr(F)).parameters == {}


@pytest.mark.parametrize(
    ("make", "error", "message"),
    [
        (lambda: vmdg.NeoHookean(E=1.0), ValueError, "either E and nu"),
        (lambda: vmdg.NeoHookean(E=1.0, nu=0.2, mu=1.0, lmbda=1.0), ValueError, "either E and nu"),
        (lambda: vmdg.NeoHookean(E=-1.0, nu=0.2), ValueError, "E = -1"),
        (lambda: vmdg.NeoHookean(E=1.0, nu=0.5), ValueError, "nu = 0.5"),
        (lambda: vmdg.NeoHookean(mu=0.0, lmbda=1.0), ValueError, "mu = 0"),
        (lambda: vmdg.NeoHookean(mu=3.0, lmbda=-2.0), ValueError, "lmbda = -2"),
        (lambda: vmdg.Ogden(c=(1.0, 2.0), m=(2.0,), kappa=1.0), ValueError, "number of entries"),
        (lambda: vmdg.Ogden(c=(), m=(), kappa=1.0), ValueError, "at least one"),
        (lambda: vmdg.Ogden(c=(1.0,), m=(0.0,), kappa=1.0), ValueError, "must not be zero"),
        (lambda: vmdg.Ogden(c=(np.nan,), m=(1.0,), kappa=1.0), ValueError, "finite"),
        (lambda: vmdg.Ogden(c=(1.0, -2.0), m=(1.0, 2.0), kappa=1.0), ValueError, "shear modulus"),
        (lambda: vmdg.Ogden(c=(1.0,), m=(1.0,), kappa=0.0), ValueError, "kappa = 0"),
        (lambda: vmdg.Hyperelastic(3.0), TypeError, "callable"),
        (lambda: vmdg.Hyperelastic(user_energy, {"mu": "x"}), TypeError, "mu = 'x'"),
    ],
)
def test_input_errors(make, error, message):
    """Constants that cannot work are refused by name."""
    with pytest.raises(error, match=message):
        make()


# Ogden

COALESCENT = {
    "identity": (1.0, 1.0, 1.0),
    "triple": (1.6, 1.6, 1.6),
    "upper pair": (1.8, 1.8, 0.4),
    "lower pair": (0.5, 0.5, 3.0),
}


@EVERY_DIMENSION
@pytest.mark.parametrize("name", COALESCENT)
def test_ogden_at_equal_stretches(name, d):
    """Stress and moduli are exact and finite where stretches coincide."""
    rng = np.random.default_rng(2)
    F = stretched(rng, COALESCENT[name][:d])
    check_ogden(OGDEN, F)
    check_derivatives(point(OGDEN, d), F, rng)


@EVERY_DIMENSION
@pytest.mark.parametrize("distance", [1e-12, 1e-9, 1e-6, 1e-4, 1e-3, 1e-2, 0.05, 0.08, 0.1, 0.2])
def test_ogden_near_equal_stretches(distance, d):
    """... and on the way there, across the switches between series and closed forms."""
    rng = np.random.default_rng(3)
    spread = np.array([1 - distance, 1 + distance, 1 + 0.3 * distance])
    for stretches in (spread, spread * (1.4, 1.4, 0.5), spread * (0.6, 0.6, 2.5)):
        F = stretched(rng, stretches[:d])
        check_ogden(OGDEN, F)
        check_derivatives(point(OGDEN, d), F, rng)


@EVERY_DIMENSION
def test_ogden_at_random_stretches(d):
    """Stretches from 0.3 to 3, and other values of all constants by the same kernel."""
    rng = np.random.default_rng(4)
    other = vmdg.Ogden(c=(2.0, -0.3, 1.0), m=(-1.0, -4.0, 3.2), kappa=5.0)
    assert other.kernel_key == OGDEN.kernel_key
    for material in (OGDEN, other):
        for _ in range(8):
            F = stretched(rng, np.exp(rng.uniform(np.log(0.3), np.log(3), d)))
            check_ogden(material, F)
            check_derivatives(point(material, d), F, rng)


def check_ogden(material: vmdg.Ogden, F: NDArray) -> None:
    """W and P equal the spectral formula, and W(QF) = W(F)."""
    d = len(F)
    W, P, _, _ = point(material, d)(F)
    expected, stress = spectral(material, embed(F))
    assert abs(W - expected) < 1e-13 * max(1, abs(expected))
    np.testing.assert_allclose(P, stress[:d, :d], atol=1e-12 * max(1, np.abs(stress).max()))
    turned, _, _, _ = point(material, d)(rotation(np.random.default_rng(5), d) @ F)
    assert turned == pytest.approx(W, rel=1e-12, abs=1e-13)
