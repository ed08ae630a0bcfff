"""Every demo runs at a coarse size and returns the numbers it is there for."""

from __future__ import annotations

from collections.abc import Iterator

from mpi4py import MPI

import crack_speed
import ductile_grains
import ductile_matrix
import fault
import impact
import matplotlib.pyplot as plt
import numpy as np
import plastic_peel
import pytest
import spall


@pytest.fixture(autouse=True)
def closed() -> Iterator[None]:
    """No picture stays open."""
    yield
    plt.close("all")


def test_patch_tension(comm, out):
    """7.1.1: zeta and T of the closed form at every load, picture, fields and history written.

    The demo solves to 1e-11 of the largest force; 1e-9 of the critical gap and the strength.
    """
    import patch_tension

    history = patch_tension.main(out=str(out))
    comm.barrier()
    assert len(history) == 20
    assert history["zeta"] == pytest.approx(history["zeta_exact"], abs=1e-9 * 0.2)
    assert history["traction"] == pytest.approx(history["traction_exact"], abs=1e-9 * 100.0)
    assert (out / "patch_tension.png").stat().st_size > 10_000
    assert (out / "history.csv").read_text().count("\n") == 21
    assert list(out.glob("**/*.bp"))


def test_table_1():
    """Table 1 of the report: residual norms of delta = .10 to .12 in its 8 printed digits.

    The fourth norm is rounding in the report and here.
    """
    import patch_tension

    norms = patch_tension.table()
    assert norms[:3] == pytest.approx(patch_tension.TABLE_1[:3], rel=1e-6)
    assert norms[3] < 1e-11


def test_patch_shear(comm, out):
    """7.1.2: Table 2 in its 5 printed digits for both facets; in the end the block is free."""
    import patch_shear

    history = patch_shear.main(out=str(out))
    comm.barrier()
    for name, column in patch_shear.TABLE_2.items():
        assert [f"{value:.4e}" for value in history[name]] == [f"{value:.4e}" for value in column]
    assert abs(history["force"][-1]) < 1e-6
    assert history["softening"][-1] == pytest.approx(50.0)
    assert np.all(np.diff(history["slip"]) >= 0)
    assert (out / "patch_shear.png").stat().st_size > 10_000
    assert list(out.glob("**/*.bp"))


def test_lap_joint(comm, out):
    """The glue between two meshes shears off at the force of the closed form."""
    import lap_joint

    history = lap_joint.main(element_size=2.0, steps=10, out=str(out))
    comm.barrier()
    assert history["force"].max() == pytest.approx(lap_joint.critical_force(), rel=2e-3)
    assert 0.1 < history["off"][-1] < 0.6
    assert (out / "lap_joint.png").stat().st_size > 10_000


@pytest.mark.long
def test_push_through(comm, out):
    """The largest force is that of one mesh, 412.2 N; friction fades as the fibre leaves."""
    import push_through

    history = push_through.main(layers=15, steps=4, end=0.8, out=str(out))
    comm.barrier()
    punch, force = history["punch"], history["force"]
    assert force.max() == pytest.approx(412.2, rel=0.01)
    # With points that keep their partners it stays at 105.5 N; here some of the fibre has left.
    slides = punch > 0.13
    assert 0.95 * 105.5 < force[slides][0] < 105.5
    assert (np.diff(force[slides]) < 0).all()
    assert history["iterations"][slides].mean() <= 8
    assert force[-1] < 0.85 * force[slides][0]
    assert (out / "push_through.png").stat().st_size > 10_000


def test_pressing_does_not_alternate(comm, out):
    """Facets of 0.2 mm, of which pieces of 3e-4 mm meet as the block spreads: where s of the
    nearest point counted alone, Newton's method alternated between two of them at 0.73."""
    import ironing

    history = ironing.main(steps=60, end=0.8, out=str(out))
    assert len(history["load"]) <= 15


@pytest.mark.long
def test_ironing(comm, out):
    """Coarse forces of pressing and of drawing lie between the published ones; F/N is near mu.

    F/N rises and falls with every facet of the foundation, 0.3 mm, here from 0.316 to 0.346. Its
    mean over the last three of them is 0.332, 0.327 and 0.323 with 40, 80 and 160 cells and 160
    steps: mu and what the bulge ahead of the block takes. Without points at corners it is 0.321
    and 0.323 with 40 and 80.
    Where points at a common corner had an s each, pressing stopped at 0.65.
    """
    import ironing

    history = ironing.main(cells=40, steps=80, end=1.2, out=str(out))
    comm.barrier()
    pressed = np.argmin(np.abs(history["load"] - 1.0))
    for name, known in zip(
        ("down", "along"), zip(*ironing.PUBLISHED.values(), strict=True), strict=True
    ):
        values = np.array(known)
        assert values[:, 0].min() < history[name][pressed] < values[:, 0].max()
        assert values[:, 1].min() < history[name][-1] < values[:, 1].max()
    drawn = history["load"] > 1.1 + 1e-9
    ratio = np.mean(history["along"][drawn] / history["down"][drawn])
    assert ratio == pytest.approx(0.323, rel=0.06)
    assert (out / "ironing.png").stat().st_size > 10_000


def test_shrink_fit(comm, out):
    """The force is mu p A within what free ends change, and falls to zero as the shaft leaves."""
    import shrink_fit

    history = shrink_fit.main(cells=14, steps=16, out=str(out))
    comm.barrier()
    pulled, force = history["pulled"], history["force"]
    friction = shrink_fit.FRICTION * shrink_fit.pressure() * 2 * np.pi * 10.0 * 20.0
    assert force.max() == pytest.approx(friction, rel=0.06)
    slides = pulled > 0.1
    assert (np.diff(force[slides]) < 1e-6 * friction).all()
    half = np.interp(10.0, pulled, force)
    assert half == pytest.approx(0.55 * friction, rel=0.08)
    assert (force[slides] > -1e-6 * friction).all() and abs(force[-1]) < 1e-6 * friction
    assert (out / "shrink_fit.png").stat().st_size > 10_000


def test_load_cycle(comm, out):
    """All branches of the law in one run: damage never heals, the energies balance.

    Equal steps contain the kinks of the law: the trapezoidal work errs by 7e-4 at 200 steps and
    100 times less at 2000 (test_motion lands its steps on the kinks instead). Compressed cells ask
    for more tau_s during the run, which takes 3e-4 more from what the interface stores: 300 steps.
    """
    import load_cycle

    history = load_cycle.main(steps=300, out=str(out))
    comm.barrier()
    assert (out / "load_cycle.png").stat().st_size > 10_000
    assert (np.diff(history["softening"]) >= 0).all()
    assert history["softening"][-1] == load_cycle.LAW.strength
    assert history["friction"][-1] > 0.1
    assert np.abs(history["imbalance"]).max() < 1e-3 * np.abs(history["external"]).max()


@pytest.mark.long
def test_plastic_peel(comm, out):
    """The bond takes its toughness whatever the strip does; a thick strip stays elastic and stores
    as much, a thin one flows and takes several times as much."""
    found = plastic_peel.main(thinnest=0.2, thickest=0.5, count=2, facet=0.34, out=str(out))
    thin, thick = found.values()
    for shares in found.values():
        assert shares["damage"] == pytest.approx(1.0, abs=0.05)
        balance = sum(shares[name] for name in plastic_peel.SHARES)
        assert shares["external"] == pytest.approx(balance, rel=0.02)
    assert thick["plastic"] < 1e-3
    assert thick["external"] == pytest.approx(2.0, rel=0.12)
    assert thin["plastic"] > 1.0
    comm.barrier()
    assert (out / "plastic_peel.png").exists()


@pytest.mark.long
def test_crack_speed(comm, out):
    """The crack starts at tau, is never faster than Rayleigh waves, and its speed is Freund's
    estimate 1 - tau/t to 0.06 c_R."""
    found = crack_speed.main(cells=60, out=str(out))
    share, tau = found["speed"] / crack_speed.C_R, found["tau"]
    times, runs = found["times"], found["times"] > 1.3 * found["tau"]
    assert share.max() < 0.9
    assert share[times < 0.8 * tau].max() < 0.1
    assert share[runs] == pytest.approx(1 - tau / times[runs], abs=0.06)
    assert share[-6:].mean() > share[runs][:6].mean() + 0.3
    assert found["length"][-1] == pytest.approx(found["freund"][-1], rel=0.1)
    assert np.all(np.diff(found["length"]) >= 0)
    if comm.rank == 0:
        assert (out / "crack_speed.gif").stat().st_size > 1e4


@pytest.mark.long
def test_impact(comm, out):
    """A fast striker parts the plies and is slowed down, a slow one leaves them whole; the energies
    add up to that of the striker."""
    mass = impact.DENSITY["striker"] * impact.WIDTH * impact.HEIGHT
    for speed in (2e4, 2e3):
        history = impact.main(size=1.0, speed=speed, end=6e-5, out=str(out))
        start = mass * speed**2 / 2
        assert history["external"] == pytest.approx(np.full(30, start), rel=1e-9)
        assert np.abs(history["imbalance"]).max() < 0.01 * start
        assert -speed < history["striker"][-1] < 0
        assert (history["debonded"][-1] > 0.1) == (history["damage"][-1] > 0.1 * start)
        assert (history["debonded"][-1] > 0.1) == (speed == 2e4)
        if comm.rank == 0:
            assert (out / "impact.gif").stat().st_size > 1e4


@pytest.mark.long
def test_ductile_matrix(comm, out):
    """Curves agree until the matrix flows; flow limits the stress, the more the less it hardens."""
    found = ductile_matrix.main(element_size=0.4, end=0.03, steps=3, out=str(out))
    curves = {
        name: np.interp([0.01, 0.06], history["strain"], history["stress"])
        for name, history in found.items()
    }
    first = [curve[0] for curve in curves.values()]
    assert first == pytest.approx([first[0]] * 3, rel=0.05)
    elastic, hardening, perfect = (curve[1] for curve in curves.values())
    assert elastic > 2 * hardening > 2.4 * perfect
    assert found["elastic"]["plastic work"][-1] == 0.0
    # The ligaments beside the fibre flow in plane strain: 2/sqrt(3) of the yield stress.
    limit = 2 / np.sqrt(3) * ductile_matrix.YIELD * (1 - 2 * ductile_matrix.RADIUS)
    assert perfect == pytest.approx(limit, rel=0.15)


def test_ductile_grains(comm, out):
    """Elastic at first alike; elastic grains part, soft ones flow in plane strain and hold."""
    found = ductile_grains.main(grains=4, cells=2.0, end=0.006, steps=6, out=str(out))
    slope = ductile_grains.E / (1 - ductile_grains.NU**2)
    for history in found.values():
        assert history["stress"][0] == pytest.approx(slope * history["load"][0], rel=0.02)
    elastic, hard, soft = (found[name] for name in ductile_grains.YIELDS)
    assert elastic["plastic work"][-1] == 0.0
    assert elastic["stress"].max() > 0.9 * 300.0
    assert elastic["stress"][-1] < 0.05 * elastic["stress"].max()
    assert hard["plastic work"][-1] > 0.0
    assert soft["damage work"][-1] < 1e-3 * soft["plastic work"][-1]
    # Between the flow stresses of plane strain of the mean yield stress and with all scatter.
    flow = 2 / np.sqrt(3) * ductile_grains.YIELDS["soft"]
    assert soft["stress"][-1] == pytest.approx(flow, rel=0.2)
    assert soft["stress"][-1] < elastic["stress"].max()


@pytest.mark.long
def test_fault(comm, out):
    """Times of arrival and slip of PyLith at six places, as well as cells of 150 m give them; past
    the patch of high stress the rupture is faster than shear waves, and energies add up."""
    found = fault.main(size=150.0, out=str(out))
    arrivals, slip = fault.PYLITH
    assert found["arrivals"] == pytest.approx(arrivals, rel=0.06)
    assert found["slip"][-1] == pytest.approx(slip, rel=0.15)
    speed = 1e3 * 4.5 / (found["arrivals"][0] - found["arrivals"][1])
    assert fault.C_S < speed < fault.C_D
    names = ("imbalance", "friction", "external")
    imbalance, friction, external = (found["history"][name] for name in names)
    assert np.abs(imbalance - imbalance[0]).max() < 1e-4 * friction[-1]
    # What a patch that begins with more than it can carry loses in the first step.
    assert np.abs(imbalance[0]) < 1e-5 * external[0]
    if comm.rank == 0:
        assert (out / "fault.gif").stat().st_size > 1e4


def test_spall(comm, out):
    """The free face takes the speed of the flyer; a bond that holds stops it again, one that fails
    leaves the pull-back 2 P_c/(rho c) and lets the layer fly."""
    speed, strength = 1e5, 300.0
    found = spall.main(cells=10, speed=speed, strength=strength, out=str(out))
    holds, fails = (history["face"] for history in found.values())
    time = found["bond that fails"]["time"] * spall.C / (spall.FLYER + spall.PLATE)
    pushed, later = (time > 0.82) & (time < 1.15), time > 1.35
    assert holds[pushed].mean() == pytest.approx(speed, rel=0.03)
    assert abs(holds[later].mean()) < 0.05 * speed
    pull_back = 2 * strength / (spall.RHO * spall.C)
    # Waves disperse on a coarse mesh.
    assert fails[(time > 1.2) & (time < 1.35)].min() == pytest.approx(speed - pull_back, rel=0.2)
    assert fails[later].mean() == pytest.approx(speed, rel=0.1)
    ends = found["bond that fails"]
    assert ends["damage"][-1] > 0 and ends["opening"][-1] > 0.01
    kinetic = found["bond that holds"]["kinetic"][0]
    assert np.abs(ends["imbalance"]).max() < 0.02 * kinetic


def test_weak_links(comm, out):
    """Both ways meet the closed form where the path passes a load factor for the first time.

    What a machine releases at a snap is the elastic energy of the bar, S^2 L/E of it, less that of
    its bond.
    """
    import weak_links as demo

    histories = demo.main(bars=3, critical_gap=0.006, steps=20, seed=3, out=str(out))
    comm.barrier()
    strengths = np.sort(np.random.default_rng(3).uniform(4.0, 10.0, 3))
    for history in histories.values():
        load = history["load"].tolist()
        for t in np.linspace(0, 1, 21)[1:]:
            exact = demo.order_statistics(strengths, 10 * t)
            assert history["force"][load.index(t)] == pytest.approx(exact, abs=1e-6)
        limits = [10 * t for t in load if abs(10 * t - strengths).min() < 1e-5]
        assert len({round(limit, 4) for limit in limits}) == 3
        assert history["damage"][-1] == pytest.approx(0.05 * 0.003 * strengths.sum(), rel=1e-6)
    traced, jumped = histories["trace"], histories["jump"]
    released = 0.05 * (strengths**2 / 1000 - 0.003 * strengths)
    assert jumped["viscosity"][-1] == pytest.approx(released.sum(), rel=1e-5)
    assert traced["viscosity"][-1] == 0
    assert (jumped["jump_steps"] > 0).sum() == 3
    assert (np.diff(traced["load"]) < 0).sum() > 3
    if comm.rank == 0:
        assert (out / "weak_links.png").stat().st_size > 10_000


@pytest.mark.long
def test_buckling(comm, out):
    """The layer buckles where it is to, rises, and peels off where G = G_c.

    w^2 is linear in e behind the buckling strain, and meets zero there. The ends of the layer give
    way: clamped at the tips it would buckle later, clamped its own thickness behind them earlier.
    Of G = G_c the process zone, 2 mm long, and the long way of the roots are left out.
    """
    import buckling

    history = buckling.main(cells=2, end=0.007, steps=6, out=str(out))
    comm.barrier()
    load, rise, crack = history["load"], history["rise"], history["crack"]
    assert load[-1] == 0.007
    early = (rise > 0.1) & (rise < 0.5)
    assert early.sum() >= 2
    slope, start = np.polyfit(load[early], rise[early] ** 2, 1)
    buckles = -start / slope
    latest = buckling.critical(buckling.CRACK)
    earliest = buckling.critical(buckling.CRACK + buckling.LAYER)
    assert earliest < buckles < latest
    assert (rise[load < 0.9 * earliest] < 0.02).all()
    grows = crack > 0.5
    assert grows.sum() > 10
    assert crack[-1] > 3.0
    expected = np.array([buckling.growth(buckling.CRACK + a) for a in crack])
    assert np.abs(load[grows] / expected[grows] - 1).max() < 0.02
    assert (load[crack == 0] < 1.02 * expected[0]).all()
    assert np.abs(history["imbalance"]).max() < 1e-3 * history["external"][-1]
    assert not history["jump_steps"].any()
    assert (out / "buckling.png").stat().st_size > 10_000


@pytest.mark.long
def test_measured_images(comm, out):
    """The truth lies within three standard errors, which the images make smaller."""
    import measured_images as demo

    found = demo.main(out=str(out))
    alone, both = (found[name].relative_errors for name in ("force", "force and images"))
    for name, value in demo.TRUTH.items():
        estimate = found["force and images"].estimate[name]
        assert abs(np.log(estimate / value)) < 3 * both[name]
    assert both["bond.strength"] < 0.3 * alone["bond.strength"]
    if comm.rank == 0:
        assert (out / "measured_images.png").stat().st_size > 10_000


# A published curve of a real beam is not met to the noise, and the facets are coarse: said so.
@pytest.mark.long
@pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="tests of identify have its runs on ranks")
@pytest.mark.filterwarnings("ignore:identify")
def test_bridged_beam(comm, out):
    """A published curve: with bridges of fibres it is closer, and E is that of the authors within
    5 %."""
    import bridged_dcb as study

    found = study.main(facet=2.0, every=2, out=str(out))
    assert found["bridged"].noise < found["linear"].noise
    assert abs(found["bridged"].estimate["Orthotropic.C00"] / 116e3 - 1) < 0.05
    if comm.rank == 0:
        assert "bridged" in (out / "bridged_dcb.md").read_text()


#: Grains in the plane and in space; the latter are parted to the last bond that bears something.
CELLS = {
    "plane": {"grains": 8, "cells": 3.0, "end": 0.006, "steps": 4},
    "solid": {"grains": 4, "cells": 1.0, "end": 0.008, "steps": 2, "solid": True},
}


@pytest.mark.long
@pytest.mark.parametrize("name", CELLS)
def test_polycrystal(comm, out, name):
    """Elastic as crystals are, parted at about the strength of the weak boundaries.

    In the plane the stiffness lies between the bounds of Voigt and Reuss in plane strain, of the
    softest and the stiffest direction of a crystal; in space between E of its edge and diagonal.
    """
    import polycrystal as demo

    history = demo.main(**CELLS[name], out=str(out))
    comm.barrier()
    strain, stress = history["strain_xx"], history["stress_xx"]
    C11, C12, C44 = (demo.NICKEL[name] for name in ("C11", "C12", "C44"))
    if name == "plane":
        # Along an edge of the crystal and its diagonal, no stress across, no strain along z.
        low = C11 - C12**2 / C11
        along, across = (C11 + C12) / 2 + C44, (C11 + C12) / 2 - C44
        high = along - across**2 / along
    else:
        # Young's modulus along an edge of the crystal and along its diagonal in space.
        bulk, shear = (C11 + 2 * C12) / 3, (C11 - C12) / 2
        low, high = (9 * bulk * m / (3 * bulk + m) for m in (shear, C44))
    assert low < stress[0] / strain[0] < high
    assert 0.7 * demo.STRENGTH < stress.max() < 2 * demo.STRENGTH
    assert np.abs(stress[-1]) < 1e-6 * stress.max()
    assert np.abs(history["stress_yy"]).max() < 1e-5 * stress.max()
    assert np.abs(history["hill_mandel"]).max() < 1e-6
    assert (out / "polycrystal.png").stat().st_size > 10_000


def test_fibre_cell(comm, out):
    """The cell is pulled until its matrix fails too; picture and table are written."""
    import fibre_cell as demo

    coarse = {"fibres": 1, "cells": 2.0, "end": 0.012, "steps": 3, "out": str(out)}
    history = demo.main(**coarse)
    comm.barrier()
    assert 0.5 * demo.BOND[0] < history["stress_xx"].max() < demo.MATRIX[0]
    assert np.abs(history["stress_xy"]).max() < 1e-6 * history["stress_xx"].max()
    assert (out / "fibre_cell.png").stat().st_size > 10_000
    assert (out / "history.csv").read_text().count("\n") == 1 + len(history)


@pytest.mark.long
def test_fits():
    """A good model is right, a wrong number that is given is told, and so is an outlier."""
    import fits as study

    assert [study.fit(number, 0)[-2] for number in (0, 13, 25)] == ["right", "given", "said"]


def test_strengths_of_fibre_cell(comm, out):
    """Pull and shear fail between bond and weakest cut; runs that are done are not done again."""
    import fibre_cell_strengths as study
    from parts.scenes import fibre_cell

    BOND, MATRIX = fibre_cell.BOND, fibre_cell.MATRIX
    coarse = {"fibres": 1, "cells": 2.0, "end": 0.012, "steps": 3, "out": str(out)}
    one = study.main(**coarse, seeds=1)
    both = study.main(**coarse, seeds=1, directions=2)
    comm.barrier()
    assert both[0] == pytest.approx(one[0])
    assert both[:, :2].tolist() == [[0.0, 0.0], [0.0, 90.0]]
    assert (out / "envelope.png").stat().st_size > 5_000
    pull, across = both[0, 2], both[1, 3]
    assert 0.5 * BOND[0] < across < MATRIX[0]
    for bulk, shear, cut, share in both[:, 4:]:
        assert 0.5 * BOND[0] < pull < cut < MATRIX[0]
        low, high = study.hashin_shtrikman(share)
        assert low[0] < bulk < high[0]
        assert low[1] < shear < high[1]
    assert abs(both[1, 2]) < 1e-6 * across  # free of stress
