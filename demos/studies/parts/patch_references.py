"""What the patch tests are compared with: the closed form of 7.1.1 and the steps of Table 1."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq

import vmdg


def uniaxial_stress(stretch: float, material: vmdg.NeoHookean) -> float:
    """P(s) of (86) [MPa] with free sides: the lateral stretch b makes the lateral P zero."""
    mu, lmbda = material.parameters["mu"], material.parameters["lmbda"]

    def lateral(b: float) -> float:
        return mu * (b - 1 / b) + lmbda * (stretch * b**2 - 1) * stretch * b

    b = brentq(lateral, 0.5, 1.5, xtol=1e-15)
    return mu * (stretch - 1 / stretch) + lmbda * (stretch * b**2 - 1) * b**2


def softening_bar(
    delta: float, material: vmdg.NeoHookean, law: vmdg.Debonding
) -> tuple[float, float]:
    """zeta [mm] and T [MPa] of two bonded 1 mm cubes whose end has moved by delta [mm].

    P(s) = P_c (1 - zeta/zeta_c) with delta = 2 (s - 1) + zeta.
    """

    def excess(zeta: float) -> float:
        strength = law.strength * (1 - zeta / law.critical_gap)
        return uniaxial_stress(1 + (delta - zeta) / 2, material) - strength

    if excess(0.0) <= 0:
        return 0.0, uniaxial_stress(1 + delta / 2, material)
    if delta >= law.critical_gap:
        return delta, 0.0
    zeta = brentq(excess, 0.0, delta, xtol=1e-15)
    return zeta, law.strength * (1 - zeta / law.critical_gap)


def residual_norms(problem: vmdg.Problem, t: float, iterations: int = 5) -> list[float]:
    """Residual norms [N] of the step to ``t`` by the recipe behind Table 1; one rank, dense.

    The predictor holds zeta; tau_s is re-evaluated at the predictor and at the first two
    residuals, then frozen.
    """
    problem.step.begin(t, dt=1.0)
    fixed, u = problem.loading.prescribed, problem.u.x.array
    K = problem.discretization.create_matrix()
    free = np.setdiff1d(np.arange(len(u)), fixed)
    move = problem.loading.prescribed_values(t) - u[fixed]

    residual = problem.step.assemble_residual(hold=True).copy()
    problem.discretization.assemble_tangent(K, damage=False)
    A = K[:, :][free]
    u[fixed] += move
    u[free] -= np.linalg.solve(A[:, free], residual[free] + A[:, fixed] @ move)
    norms = []
    for iteration in range(iterations):
        if iteration < 2:
            problem.discretization.update_stabilization()
        residual = problem.step.assemble_residual()[free].copy()
        norms.append(float(np.linalg.norm(residual)))
        problem.discretization.assemble_tangent(K)
        u[free] -= np.linalg.solve(K[:, :][np.ix_(free, free)], residual)
    return norms
