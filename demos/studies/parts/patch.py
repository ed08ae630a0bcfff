"""What the two patch tests share: blocks, pictures, the closed form of 7.1.1, and tau_s as printed.

To reproduce Tables 1 and 2 digit by digit tau_s is that of the report's authors. They integrate
(22) with 2 x 2 x 2 Gauss points and the integrand divided by J, and use four times the resulting
tau_s. The product itself integrates (22) exactly; this module injects theirs through
``Interface(stabilization=...)``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from mpi4py import MPI

import basix
import matplotlib.pyplot as plt
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

import vmdg
from vmdg.forms import bubbles
from vmdg.meshes import TaggedMesh, blocks


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

    def one_side(context: Any, side: int) -> NDArray:
        space = context.u.function_space
        geometry = space.mesh.geometry
        cells = context.cells[:, side]
        nodes = geometry.x[space.mesh.geometry.dofmap[cells]]
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


MATERIAL = vmdg.NeoHookean(E=5000.0, nu=0.25)


def build(
    law: vmdg.Law, divisions=(1, 1, 1), line=(1.0, 1.0), comm=MPI.COMM_WORLD, **options
) -> tuple[vmdg.Problem, TaggedMesh]:
    """Blocks of :data:`MATERIAL` with u_x = 0 on the left and u_x = t [mm] on the right."""
    tagged = blocks(comm, "hexahedron", divisions, interface=line)
    interface = vmdg.Interface(between=(1, 2), law=law, frame="reference", **options)
    problem = vmdg.Problem(tagged.mesh, tagged.cell_tags, {1: MATERIAL, 2: MATERIAL}, [interface])
    problem.dirichlet(tagged.facet_tags.find(1), 0.0, "x")
    problem.dirichlet(tagged.facet_tags.find(2), lambda delta: delta, "x")
    return problem, tagged


class Snapshots:
    """A column of pictures of sigma_xx on the deformed blocks, one for each chosen load."""

    def __init__(self, titles: Mapping[float, str], limits: tuple[float, float]):
        self._titles, self._limits = titles, limits
        mosaic = [["curve", load] for load in titles]
        self.figure, axes = plt.subplot_mosaic(
            mosaic, figsize=(9.5, 5.2), width_ratios=[1.3, 1], layout="constrained"
        )
        self.curve = axes.pop("curve")
        self._axes = axes

    def take(self, problem: vmdg.Problem) -> None:
        """Draw the current state if its load is one of the chosen; collective."""
        for load, ax in self._axes.items():
            if not np.isclose(problem.t, load):
                continue
            vmdg.plot.stress(problem, "xx", ax=ax, limits=self._limits)
            ax.set_title(self._titles[load])
