"""The tutorials do what they teach."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq
from support.budgets import over_budget

from vmdg.base.timers import timings, timings_since


@pytest.mark.long
def test_tutorial(comm, out):
    """Coarse: the ply is stiffer than epoxy, then its fibres come off; everything is written."""
    import tutorial

    history = tutorial.main(element_size=0.0021, steps=8, out=str(out))
    comm.barrier()
    stress, strain = history["stress"], history["strain"]
    epoxy = 3.5e3 / (1 - 0.35**2) / 100  # plane strain, per %
    assert epoxy < stress[0] / strain[0] < 3 * epoxy
    assert stress[-1] / strain[-1] < epoxy
    assert history["debonded"][0] == 0 and 0 < history["debonded"][-1] < 1
    openings = 1e-3 * tutorial.RADIUS
    assert (history["fine_scales"] < openings).all()
    names = {path.relative_to(out).as_posix() for path in out.glob("**/*")}
    assert names >= {"tutorial.png", "history.csv", "fields/bodies.bp", "fields/interface_0.bp"}


@pytest.fixture(scope="module")
def bridged():
    """The law of the tutorial."""
    from tutorial_law import BridgedDebonding

    return BridgedDebonding(strength=30.0, bridging=3.0, knee=0.02, critical_gap=0.3, friction=0.4)


def test_tangent_of_the_law(bridged):
    """Equal to finite differences, which err by round-off over the step, 1e-16/1e-6 and more."""
    from tutorial_law import tangent_error

    assert tangent_error(bridged) < 1e-7


@pytest.mark.parametrize("steps", [3, 20])
def test_dissipation_of_the_law(bridged, steps):
    """The area under the curve, whatever the steps: .75 N/mm."""
    r, normal = 5 * bridged.softening_modulus, np.array([[1.0, 0.0]])
    gap, softening, work = np.zeros((1, 2)), np.zeros(1), 0.0
    for opening in np.linspace(0, 2 * bridged.critical_gap, steps + 1)[1:]:
        update = bridged.return_map(r * (opening * normal - gap), normal, gap, softening, r)
        gap, softening, work = update.gap, update.softening, work + update.damage_work[0]
    assert bridged.bond_energy(bridged.strength) == pytest.approx(0.75)
    assert work == pytest.approx(0.75, rel=1e-12)


def test_peeling_with_bridges(bridged):
    """The first point follows the curve of the law; what is spent on the bond is under it."""
    from tutorial_law import peel

    problem, history = peel(bridged, 12, 0.8)
    gap, traction = history["gap"], history["traction"]
    assert gap[-1] > bridged.knee
    curve, _ = bridged.soften(np.full_like(gap, 30.0), gap)
    damaged = gap > 0
    assert traction[damaged] == pytest.approx(curve[damaged], rel=0.01)
    state, spent = problem.state[0], problem.energy().damage
    left = bridged.bond_energy(bridged.strength - state.softening)
    expected = problem.comm.allreduce(float(state.weights @ (0.75 - left)))
    assert spent == pytest.approx(expected, rel=1e-9)


def test_material_of_the_tutorial():
    """Traction and energy are those of the closed form."""
    from tutorial_material import check

    assert max(check(theta=30.0)) < 1e-12
    assert max(check(theta=75.0)) < 1e-12


def test_peeling_of_the_artery():
    """The force is that of long strips: G_c = 2 (lambda f - h W(lambda)), f in each arm.

    Uniaxial stress in plane strain: W is least over the stretch of the thickness. The strips are
    short and thick: 3 %.
    """
    from tutorial_material import PARAMETERS, peel

    c, lmbda, k1, k2 = PARAMETERS.values()
    cos2, sin2 = 0.25, 0.75  # 60 degrees

    def stress(x: float, y: float) -> tuple[float, float, float]:
        J, E = x * y, cos2 * x**2 + sin2 - 1
        P_x = c * (x - 1 / x) + lmbda * (J - 1) * y + 4 * k1 * E * np.exp(k2 * E**2) * cos2 * x
        P_y = c * (y - 1 / y) + lmbda * (J - 1) * x
        W = c / 2 * (x**2 + y**2 - 2) - c * np.log(J) + lmbda / 2 * (J - 1) ** 2
        return P_x, P_y, W + k1 / k2 * (np.exp(k2 * E**2) - 1)

    def released(x: float) -> float:
        y = brentq(lambda y: stress(x, y)[1], 0.3, 1.0)
        P_x, _, W = stress(x, y)
        return 2 * 0.5 * (x * P_x - W)

    x = brentq(lambda x: released(x) - 0.1 * 1.2 / 2, 1.0, 2.0)
    y = brentq(lambda y: stress(x, y)[1], 0.3, 1.0)
    before = timings()
    _, history = peel(60.0, 24, 12.0)
    (residuals,) = (t.runs for t in timings_since(before) if t.name == "assemble residual")
    assert not over_budget("peeled artery", residuals=residuals)
    assert history["force"][-5:].mean() == pytest.approx(0.5 * stress(x, y)[0], rel=0.03)


@pytest.mark.long
def test_laminate_of_the_tutorial():
    """While the crack runs, the load is that of classical lamination theory."""
    from tutorial_laminate import LAYUPS, open_arms, theory

    angles = LAYUPS["[90/0]2s"]
    history = open_arms(angles, np.linspace(0.425, 3.4, 8))
    running = history["crack"] > 31
    assert running.any()
    expected = theory(angles, history["opening"][running])
    assert history["force"][running] == pytest.approx(expected, rel=0.03)


def test_delamination_past_its_peak(comm, out):
    """Load while the crack runs and initial stiffness are those of corrected beam theory.

    The process zone, 2.9 mm at most, rounds the peak, and the crack by the energy spent ends inside
    it: a quarter of the zone behind the one of the theory.
    """
    from tutorial_dcb import A_0, main, theory

    history = main(facet=0.5, end=1.0, out=str(out))
    force, opening, (load, length) = history["force"], history["load"], theory(history["load"])
    assert force[0] / load[0] == pytest.approx(1.0, abs=0.01)
    running = opening > 0.6
    assert running.sum() > 5
    assert force[running] == pytest.approx(load[running], rel=5e-3)
    assert history["crack"][running] == pytest.approx(length[running] - 0.75, abs=0.1)
    assert 0.9 * load.max() < force.max() < load.max()
    assert history["crack"][0] == pytest.approx(A_0, abs=1e-3)
    comm.barrier()
    assert (out / "tutorial_dcb.png").stat().st_size > 10_000


@pytest.mark.long
def test_film_on_a_substrate(comm, out):
    """While the crack grows far from both ends the temperature is that of the closed form.

    Three facets in the process zone: it goes up and down by .5 % as the tip passes them.
    """
    from tutorial_film import CRACK, CRITICAL, LENGTH, H, main

    history = main(facet=0.008, out=str(out))
    crack, cooling = history["crack"], history["cooling"]
    steady = (crack > CRACK + 2 * H) & (crack < LENGTH - 4 * H)
    assert steady.sum() > 5
    assert cooling[steady] == pytest.approx(CRITICAL, rel=6e-3)
    assert cooling[steady].mean() == pytest.approx(CRITICAL, rel=2e-3)
    assert history["resistance"][steady].mean() == pytest.approx(0.005, rel=0.01)
    comm.barrier()
    assert (out / "tutorial_film.png").stat().st_size > 10_000


def test_cycles_of_a_joint(comm, out):
    """Sliding at mu N, the work of a cycle, the toughness spent once, and balanced energies."""
    from tutorial_friction import COHESION, G_C, LENGTH, SLIDING, WAY, main, work_of_cycle

    history = main(divisions=4, out=str(out))
    t, force = history["load"], history["shear force"]
    row = {time: int(np.argmin(np.abs(t - time))) for time in (1.02, 2, 3, 4, 5, 6, 10)}
    assert all(abs(t[i] - time) < 1e-9 for time, i in row.items())
    first = row[1.02]
    assert history["damage"][first] == 0
    stiffness = force[first] / (0.02 * WAY)
    assert force[[row[2], row[3], row[4], row[5]]] == pytest.approx(
        [SLIDING, -SLIDING, -SLIDING, SLIDING], rel=1e-6
    )
    rubbed = history["friction"]
    for start, end in ((2, 6), (6, 10)):
        cycle = rubbed[row[end]] - rubbed[row[start]]
        assert cycle == pytest.approx(work_of_cycle(stiffness), rel=2e-3)
    assert history["damage"][-1] == pytest.approx(G_C * LENGTH, rel=1e-9)
    assert 0.9 * COHESION * LENGTH < force.max() <= COHESION * LENGTH
    assert np.abs(history["imbalance"]).max() < 1e-5 * history["external"][-1]
    comm.barrier()
    assert (out / "tutorial_friction.png").stat().st_size > 10_000
