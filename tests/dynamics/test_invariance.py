"""Motion in time does not depend on units, nor on the directions of the axes."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import of_two, set_displacement

import vmdg
from vmdg.meshes import blocks

TIMES = np.linspace(0.0, 0.02, 5)[1:]


def flight(comm, scheme, kinematics, L=1.0, S=1.0, T=1.0, angle=0.0, times=TIMES):
    """Two blocks, the left one held, whose bond tears as the right one flies off: energies, opening
    and force on the support, in units of L [mm], S [MPa] and T [s].
    """
    tagged = blocks(comm, "quadrilateral", (3, 3))
    turned = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    X = tagged.mesh.geometry.x
    X[:, :2] = L * X[:, :2] @ turned.T
    bond = vmdg.Debonding(5.0 * S, 0.01 * L, friction=0.4, viscosity=0.1 * S * T / L)
    problem = of_two(
        tagged,
        bond,
        (vmdg.NeoHookean(E=1000.0 * S, nu=0.3), vmdg.NeoHookean(E=400.0 * S, nu=0.2)),
        {"name": "bond"},
        kinematics=kinematics,
        density=dict.fromkeys((1, 2), 1e-3 * S * T**2 / L**2),
        damping=vmdg.Rayleigh(alpha=5.0 / T),
    )
    left = tagged.facet_tags.find("left")
    problem.dirichlet(left, 0.0)
    velocity = problem.velocity.copy()
    away = L / T * turned @ (9.0, 4.0)
    set_displacement(
        velocity, tagged.cell_tags, lambda x, tag: (tag - 1) * np.outer(away, x[0] ** 0)
    )

    def monitor(problem):
        energy, gap = problem.energy(), problem.mean("bond").gap / L
        parts = np.array([energy.kinetic, energy.stored, energy.dissipated]) / (S * L**2)
        force = problem.reaction(left) / (S * L)
        return dict(zip("ksdnmxy", [*parts, *(turned.T @ gap), *(turned.T @ force)], strict=True))

    history = vmdg.solve_dynamics(problem, T * times, scheme, velocity, monitor).history
    return np.array([history[name] for name in "ksdnmxy"])


@pytest.mark.filterwarnings("ignore:solve_dynamics. up to")  # long steps
@pytest.mark.parametrize(
    ("scheme", "kinematics"),
    [(vmdg.GeneralizedAlpha(), "small"), (vmdg.CentralDifferences(), "finite")],
)
def test_units_and_axes(comm, scheme, kinematics):
    """Masses of 1e-24 to 1e24 units; an angle. What is left is rounding of the iteration."""
    expected = flight(comm, scheme, kinematics)
    assert expected[2, -1] > 0.01 * expected[0, 0]
    scale = np.abs(expected).max(axis=1, keepdims=True)
    for L, S, T in ((3e-9, 2e12, 1e6), (7e5, 1e-6, 3e-9)):
        found = flight(comm, scheme, kinematics, L, S, T)
        assert (np.abs(found - expected) / scale).max() < 1e-9
    if kinematics == "finite":
        found = flight(comm, scheme, kinematics, angle=2.1)
        assert (np.abs(found - expected) / scale).max() < 1e-9


@pytest.mark.filterwarnings("ignore:solve_dynamics. up to")  # long steps
@pytest.mark.filterwarnings("ignore:.*process zone:vmdg.ModelWarning")  # few cells
@pytest.mark.parametrize("scheme", [vmdg.GeneralizedAlpha(), vmdg.CentralDifferences(renewal=3)])
def test_powers_of_two(comm, scheme):
    """Another unit of time changes no digit, of steps whose squares C rounds otherwise in it."""
    T, steps = 2.0**14, np.random.default_rng(1).uniform(0.002, 0.006, 40000).tolist()
    odd = [h for h in steps if (T * h) ** 2 != T**2 * h**2]
    times = np.cumsum((odd + steps)[:4])
    one, other = (flight(comm, scheme, "finite", T=t, times=times) for t in (1.0, T))
    assert np.array_equal(one, other)
