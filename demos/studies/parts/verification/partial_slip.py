"""Partial slip of a conforming interface under a pressure that varies along it."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from parts.topology import global_max
from parts.verification.checks import Check, compare, compare_field, describe

import vmdg
from vmdg.meshes import blocks


@dataclass(frozen=True)
class PartialSlip:
    """Two half-planes of one material, pressed by p(X) = p0 + p1 X^2 and sheared by tau > mu p0.

    Slip spreads from the least pressure, X = 0, to |X| < c. There the shear traction falls from tau
    to mu p, so that the slip zone is a shear crack under f(X) = tau - mu p(X) whose stress
    intensity vanishes, since it ends in stick:

        int_-c^c f(X)/sqrt(c^2 - X^2) dX = 0,  hence  c^2 = 2 (tau - mu p0)/(mu p1).

    (Bilby, Cottrell and Swinden 1963 for the condition; the integrals are in Hills, Kelly, Dai and
    Korsunsky, Solution of Crack Problems, 1996.) With f0 = tau - mu p0 and
    E' = E/(1 - nu^2) slip and shear traction are

        delta = 8 f0/(3 E' c^2) (c^2 - X^2)^(3/2)               |X| < c,
        q = mu p - mu p1 |X| sqrt(X^2 - c^2)                    |X| > c.

    The second line is the theorem of Jaeger and Ciavarella again: q is mu times the difference of
    the pressure and of one that acts on the stick region only. It holds at every moment of a
    growing tau, since the slip grows everywhere.

    In the plane z = X + i Y the stresses of the pressure come from the harmonic Airy function
    -Re(p0 z^2/2 + p1 z^4/12), those of the slip from Westergaard's function of mode II,

        Z = -f0 (1 - 2 z^2/c^2 + 2 z sqrt(z^2 - c^2)/c^2),

    so that displacements are known everywhere and a finite body needs no remote boundary.

    Lengths in mm, stresses in MPa, p1 in MPa/mm2.
    """

    E: float = 10e3
    nu: float = 0.3
    friction: float = 0.5
    p0: float = 10.0
    p1: float = 10.0

    @property
    def G(self) -> float:
        """Shear modulus [MPa]."""
        return self.E / (2 * (1 + self.nu))

    def pressure(self, X: NDArray) -> NDArray:
        """p on Y = 0 [MPa]."""
        return self.p0 + self.p1 * X**2

    def excess(self, c: float) -> float:
        """f0 = tau - mu p0 at which slip has spread to c [MPa]."""
        return self.friction * self.p1 * c**2 / 2

    def slip(self, X: NDArray, c: float) -> NDArray:
        """delta, the displacement of Y > 0 less that of Y < 0 [mm]."""
        modulus = self.E / (1 - self.nu**2)
        bracket = np.maximum(c**2 - X**2, 0.0)
        return 8 * self.excess(c) / (3 * modulus * c**2) * bracket**1.5

    def shear(self, X: NDArray, c: float) -> NDArray:
        """q on Y = 0 [MPa]."""
        held = np.abs(X) * np.sqrt(np.maximum(X**2 - c**2, 0.0))
        return self.friction * (self.pressure(X) - self.p1 * held)

    def displacement(self, z: NDArray, load: float, c: float) -> tuple[NDArray, NDArray]:
        """(U_X, U_Y) at z (n,) [mm].

        Args:
            load: Share of the pressure and of tau = mu p0, before slip starts; 1 afterwards.
            c: How far slip has spread; 0 before.
        """
        f0 = self.excess(c)
        gradient = load * (self.p0 * z + self.p1 * z**3 / 3)
        tau = load * self.friction * self.p0 + f0
        U_X = gradient.real + 2 * tau * z.imag
        U_Y = -gradient.imag
        if c > 0:
            root = np.sqrt(z - c) * np.sqrt(z + c)
            Z = -f0 * (1 - 2 * z**2 / c**2 + 2 * z * root / c**2)
            integral = -f0 * (z - 2 * z**3 / (3 * c**2) + 2 * root**3 / (3 * c**2))
            U_X = U_X + 2 * (1 - self.nu) * integral.imag + z.imag * Z.real
            U_Y = U_Y - (1 - 2 * self.nu) * integral.real - z.imag * Z.imag
        return U_X / (2 * self.G), U_Y / (2 * self.G)


def partial_slip(
    element_size: float = 0.05,
    end: float = 1.27,
    steps: int = 10,
    degree: int = 2,
    verbose: bool = False,
) -> list[Check]:
    """Slip spreads to ``end`` [mm] in a body of 2 x 4 mm with the exact displacement on its sides.

    The load factor is the share of the pressure up to 1, then 1 + c. The interface is upright in
    the mesh: X = y - 2, Y = 1 - x.
    """
    model = PartialSlip()
    count = round(1 / element_size)
    mesh, cells, facets = blocks(
        MPI.COMM_WORLD, "quadrilateral", (count, 4 * count), length=2.0, height=4.0
    )
    law = vmdg.Contact(friction=model.friction)
    interface = vmdg.Interface(between=(1, 2), law=law, frame="reference")
    material = vmdg.NeoHookean(E=model.E, nu=model.nu)
    bodies = {1: material, 2: material}
    problem = vmdg.Problem(mesh, cells, bodies, [interface], degree, kinematics="small")

    def sides(x: NDArray, t: float) -> NDArray:
        U_X, U_Y = model.displacement(x[1] - 2 + 1j * (1 - x[0]), min(t, 1.0), max(t - 1, 0.0))
        return np.stack([-U_Y, U_X])

    problem.dirichlet(np.concatenate([facets.find(tag) for tag in (1, 2, 4, 5)]), sides)
    loads = np.r_[0.5, 1 + end * np.linspace(0, 1, steps + 1)[1:]]
    vmdg.solve(problem, loads, vmdg.SolveOptions(relative_tolerance=1e-10, verbose=verbose))
    state, mesh = problem.state[0], describe(problem, degree)
    X = state.points[:, 1] - 2
    # Side 1 is Y > 0, with N = -e_Y, and the gap is side 2 less side 1.
    slip, shear = -state.gap[:, 1], -state.traction[:, 1]
    edge = global_max(problem.comm, np.abs(X[slip > 0]).max(initial=0.0))
    return [
        compare("partial slip", "slip zone c [mm]", edge, end, mesh),
        compare_field("partial slip", "slip [mm]", slip, model.slip(X, end), mesh),
        compare_field("partial slip", "shear traction [MPa]", shear, model.shear(X, end), mesh),
    ]
