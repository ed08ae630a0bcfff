"""A double cantilever beam of plastic arms, opened by moments."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from parts.delamination.beams import arms
from parts.verification.checks import describe

import vmdg
from vmdg.meshes.beams import INTERFACE, LOWER_LEFT, RIGHT, UPPER_LEFT

#: Aluminium arms and their bond: height [mm], initial crack [mm], toughness [N/mm].
E, NU = 70e3, 0.33  # MPa, -
METAL = vmdg.J2(E, NU, 100.0, hardening=700.0)
HEIGHT, CRACK, G_C = 2.0, 6.0, 0.5


def fibre(material: vmdg.J2, strains: NDArray) -> NDArray:
    """Axial stress [MPa] at growing axial strains in plane strain, free across the arm."""
    state, across, stresses = material.start(1), 0.0, []
    for along in strains:
        for _ in range(30):
            strain = np.diag([along, across, 0.0])[None]
            answer = material(strain, state, np.inf, True)
            across -= float(answer.stress[0, 1, 1] / answer.moduli[0, 1, 1, 1, 1])
            if abs(answer.stress[0, 1, 1]) < 1e-10 * material.numbers["yield_stress"]:
                break
        state = answer.state
        stresses.append(float(answer.stress[0, 0, 0]))
    return np.array(stresses)


def bending(curvatures: NDArray) -> NDArray:
    """Moment of an arm of unit width at growing curvatures [N]."""
    places, weights = np.polynomial.legendre.leggauss(40)
    y, w = (places + 1) / 4 * HEIGHT, weights / 4 * HEIGHT
    strains = np.linspace(0.0, curvatures[-1] * HEIGHT / 2, 2000)
    stress = np.interp(np.outer(curvatures, y), strains, fibre(METAL, strains))
    return 2 * stress @ (w * y)


def critical_moment() -> float:
    """Moment of each arm at which the crack runs [N], by J of pure bending (Rice 1968).

    Far behind the tip both arms are bent by M alone, far ahead there is no stress, so that
    J = 2 int_0^M kappa dM on a path through both: without unloading it is G_c at the tip. A strong
    bond makes the metal flow around the tip too, which takes a larger moment.
    """
    curvatures = np.linspace(0.0, 0.05, 4001)
    moments = bending(curvatures)
    steps = np.diff(moments) * (curvatures[1:] + curvatures[:-1]) / 2
    return float(np.interp(G_C, 2 * np.concatenate([[0.0], np.cumsum(steps)]), moments))


def elastic_moment() -> float:
    """The same of arms that stay elastic [N]."""
    return float(np.sqrt(G_C * E / (1 - NU**2) * HEIGHT**3 / 12))


def open_by_moments(
    size: float, rows: int, growth: float, strength: float
) -> tuple[vmdg.History, str]:
    """Bend the arms apart until the crack has grown: moment [N] and crack [mm], and the mesh."""
    stations = (0.0, CRACK, CRACK + growth + 10, CRACK + growth + 16)
    tagged = arms(stations, size * np.array([2, 1, 4]), HEIGHT, rows, CRACK)
    mesh, cells, facets = tagged
    bond = vmdg.Interface(facets.find(INTERFACE), law=vmdg.Debonding(strength, 2 * G_C / strength))
    problem = vmdg.Problem(mesh, cells, {1: METAL, 2: METAL}, [bond], degree=2, kinematics="small")
    inertia, middle = HEIGHT**3 / 12, HEIGHT / 2

    def bent(side: float) -> Callable[[NDArray, float], NDArray]:
        """Tractions of a moment t that turns an arm away from the other one."""

        def traction(x: NDArray, t: float) -> NDArray:
            along = side * t / inertia * (x[1] - side * middle)
            return np.stack([along, 0 * along])

        return traction

    problem.traction(facets.find(UPPER_LEFT), bent(1.0))
    problem.traction(facets.find(LOWER_LEFT), bent(-1.0))
    problem.dirichlet(facets.find(RIGHT), 0.0)
    crack = vmdg.CrackGrowth(problem, 0, start=CRACK)
    theory = critical_moment()
    result = vmdg.solve(
        problem,
        [0.5 * theory, 0.8 * theory, theory, 2 * theory],
        vmdg.SolveOptions(unstable="trace"),
        lambda problem: {"moment [N]": problem.t} | crack(),
        until=lambda problem: crack.length > CRACK + growth,
    )
    return result.history, describe(problem, 2)
