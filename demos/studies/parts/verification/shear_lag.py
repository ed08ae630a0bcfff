"""Push-out of a fibre that friction holds, against the one-dimensional estimate."""

from __future__ import annotations

import numpy as np
from parts.scenes import pushout
from parts.verification.checks import Check, compare, describe
from pushout_parameters import (
    E_MATRIX,
    HEIGHT,
    NU_FIBRE,
    NU_MATRIX,
    RADIUS,
    SHRINKAGE,
    ring_pressure,
    shear_lag,
)

import vmdg
from vmdg.meshes import pushout_section
from vmdg.meshes.pushout import FIBRE, FIBRE_TOP, MATRIX, SUPPORT

E_FIBRE = 2500.0  # MPa


def _slide(
    height: float, layers: int, friction: float, punch: float, verbose: bool
) -> tuple[vmdg.Problem, float]:
    """Shrink the matrix of section 7.4 onto a fibre, then push: the end and its force [N]."""
    mesh, cells, facets = pushout_section(
        layers=layers, fibre_cells=6, matrix_cells=10, height=height
    )
    materials = {
        FIBRE: vmdg.NeoHookean(E=E_FIBRE, nu=NU_FIBRE),
        MATRIX: vmdg.NeoHookean(E=E_MATRIX, nu=NU_MATRIX),
    }
    problem = vmdg.Problem(
        mesh,
        cells,
        materials,
        [vmdg.Interface(between=(FIBRE, MATRIX), law=vmdg.Contact(friction))],
        eigenstrain={MATRIX: lambda t: -SHRINKAGE * min(t, 1.0)},
        symmetry="axisymmetric",
    )
    top = facets.find(FIBRE_TOP)
    problem.dirichlet(facets.find(SUPPORT), 0.0, "y")
    problem.dirichlet(top, lambda t: min(1 - t, 0.0), "y")
    loads = np.r_[np.linspace(0.25, 1, 4), 1 + np.linspace(0, punch, 11)[1:]]
    vmdg.solve(problem, loads, vmdg.SolveOptions(relative_tolerance=1e-8, verbose=verbose))
    return problem, -problem.reaction(top)[1]


def _growth(problem: vmdg.Problem, state: vmdg.InterfaceState, height: float) -> float:
    """lambda [1/mm] of shear tractions e^(lambda z) in the middle half of the fibre."""
    inside = np.abs(state.points[:, 1] / height - 0.5) < 0.25
    rows = np.column_stack([state.points[inside, 1], np.abs(state.traction[inside, 1])])
    z, shear = np.concatenate(problem.comm.allgather(rows)).T
    return float(np.polyfit(z, np.log(shear), 1)[0])


def push_out(
    layers: int = 80, height: float = 20.0, friction: float = 0.1, verbose: bool = False
) -> list[Check]:
    """A fibre of 21 radii, and that of section 7.4 with 5.6, once they slide.

    The estimate takes the fibre for a bar in plane rings: the pressure p = p0 + k sigma grows with
    the stress sigma in the fibre, a sigma' = 2 mu p, so that both grow as e^(lambda z) with lambda
    = 2 mu k/a, and the force is ``pushout_parameters.shear_lag`` without a bond. It holds where z
    is farther than a radius or two from both ends; there the rings are not plane, the pressure
    differs and a share of the order of a/H of the force is in doubt. It also neglects that the
    matrix carries the force back: its stress is that of the fibre times a^2/(b^2 - a^2) = 0.05.
    """
    slender, force = _slide(height, layers, friction, 0.15, verbose)
    mesh = describe(slender, 1)
    case = f"push-out, H = {height / RADIUS:.1f} a"
    _, k = ring_pressure(E_FIBRE)
    growth = _growth(slender, slender.state[0], height)
    checks = [
        compare(case, "friction force [N]", force, shear_lag(height, friction, E_FIBRE, 0.0), mesh),
        compare(case, "lambda, middle half [1/mm]", growth, 2 * friction * k / RADIUS, mesh),
    ]
    short, force = _slide(HEIGHT, round(layers * 0.4), pushout.FRICTION, 0.1, verbose)
    estimate = shear_lag(HEIGHT, pushout.FRICTION, E_FIBRE, 0.0)
    case, mesh = f"push-out, H = {HEIGHT / RADIUS:.1f} a", describe(short, 1)
    return [*checks, compare(case, "friction force [N]", force, estimate, mesh)]
