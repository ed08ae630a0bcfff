"""Whatever differs between ranks is refused on all of them, before anybody waits for another."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest

import vmdg
from vmdg.meshes import blocks

ME = MPI.COMM_WORLD.rank
DENSITY = {1: 1e-9, 2: 1e-9}
LAW = (15.0, 0.05)


def joined(law=None, body=None, density=None, held=True, interface=None, **given) -> vmdg.Problem:
    """Two blocks, one of them held and the other pulled."""
    mesh, cells, facets = blocks(MPI.COMM_WORLD, "quadrilateral", (4, 2))
    body = body or vmdg.NeoHookean(E=1000.0, nu=0.3)
    law = law or vmdg.Debonding(*LAW)
    bond = vmdg.Interface(between=(1, 2), law=law, name="bond", **(interface or {}))
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond], density=density, **given)
    if held:
        problem.dirichlet(facets.find(1), 0.0)
        problem.dirichlet(facets.find(2), lambda t: (0.001 * t, 0.0))
    return problem


def right(x):
    return np.isclose(x[0], 4.0) | (x[0] >= x[0].max(initial=-9))


def loaded(name: str, *given) -> None:
    getattr(joined(held=False), name)(right, *given)


def run(**options) -> None:
    vmdg.solve(joined(), [1.0], vmdg.SolveOptions(**options))


def moved(times=(1e-6, 2e-6), **given) -> None:
    vmdg.solve_dynamics(joined(density=DENSITY), list(times), **given)


def fitted(measured=2.0, start=1.0, sigma=1.0) -> None:
    curve = vmdg.Curve([0.1, 0.2], [1.0, measured])
    make = lambda values: (joined(), lambda problem: {})  # noqa: E731
    vmdg.identify(make, curve, {"bond.strength": start}, sigma=sigma)


CASES = {
    "degree": lambda: joined(degree=1 + ME),
    "wrong degree": lambda: joined(degree=1 if ME else "one"),
    "kinematics": lambda: joined(kinematics=("small", "finite")[ME]),
    "thickness": lambda: joined(thickness=1.0 + ME),
    "plane": lambda: joined(plane=("strain", "stress")[ME], kinematics="small"),
    "volumetric": lambda: joined(volumetric=("pointwise", "mean")[ME]),
    "eigenstrain": lambda: joined(eigenstrain={1: 1e-3 * (1 + ME)}),
    "density": lambda: joined(density={1: 1e-9 * (1 + ME), 2: 1e-9}),
    "damping": lambda: joined(density=DENSITY, damping=vmdg.Rayleigh(1.0 + ME)),
    "material": lambda: joined(body=vmdg.NeoHookean(E=1000.0 + ME, nu=0.3)),
    "law": lambda: joined(law=vmdg.Bonded() if ME else None),
    "strength": lambda: joined(law=vmdg.Debonding(15.0 + ME, 0.05)),
    "damage": lambda: joined(interface={"initial_damage": 0.1 * (1 + ME)}),
    "safety": lambda: joined(interface={"safety": 2.0 + ME}),
    "frame": lambda: joined(interface={"frame": ("reference", "corotating")[ME]}),
    "component": lambda: loaded("dirichlet", 0.001, "xy"[ME]),
    "value": lambda: loaded("dirichlet", 0.001 * (1 + ME)),
    "function": lambda: loaded("dirichlet", (lambda t: (t, 0.0)) if ME else (lambda t: (-t, 0.0))),
    "number in a function": lambda: loaded("dirichlet", lambda t: (ME * t, 0.0)),
    "traction": lambda: loaded("traction", np.array([1.0 + ME, 0.0])),
    "pressure": lambda: loaded("pressure", 1.0 + ME),
    "spring": lambda: loaded("spring", 1.0 + ME),
    "loads": lambda: vmdg.solve(joined(), [1.0 + ME]),
    "number of loads": lambda: vmdg.solve(joined(), 2 + ME),
    "derivatives": lambda: vmdg.solve(joined(), [1.0], derivatives=["bond.strength"][ME:] or None),
    "monitor": lambda: vmdg.solve(joined(), [1.0], monitor=None if ME else lambda p: {}),
    "cuts": lambda: run(max_cuts=3 + ME),
    "path": lambda: run(path=vmdg.PathOptions(aim=4 + ME)),
    "csv": lambda: moved(options=vmdg.SolveOptions(csv=None if ME else "unequal.csv")),
    "checkpoint": lambda: run(checkpoint=f"unequal{ME}"),
    "scheme": lambda: moved(scheme=vmdg.CentralDifferences() if ME else vmdg.GeneralizedAlpha()),
    "velocity": lambda: moved(velocity=None if ME else (lambda x: 0 * x[:2])),
    "times": lambda: moved(times=[1e-6 * (1 + ME)]),
    "fields": lambda: vmdg.FieldWriter(joined(), "unequal", ["stress", "displacement"][ME]),
    "folder": lambda: vmdg.FieldWriter(joined(), f"unequal{ME}"),
    "written": lambda: vmdg.write_checkpoint(joined(), f"unequal{ME}"),
    "read": lambda: vmdg.read_checkpoint(joined(), f"unequal{ME}"),
    "start": lambda: fitted(start=1.0 + ME),
    "curve": lambda: fitted(measured=2.0 + ME),
    "sigma": lambda: fitted(sigma=1.0 + ME),
}


@pytest.mark.skipif(MPI.COMM_WORLD.size != 2, reason="two ranks that differ")
@pytest.mark.parametrize("name", CASES)
def test_refused(name):
    """In words that say what each rank gives."""
    with pytest.raises(ValueError, match=r"rank 0 gives .*, rank 1 .*; give the same on all"):
        CASES[name]()


def test_what_may_differ(comm):
    """Facets of this rank, whole numbers in arrays beside a load, and what is printed."""
    problem, mine = joined(held=False), np.arange(ME)
    problem.dirichlet(lambda x: np.isclose(x[0], 0.0), 0.0)
    problem.dirichlet(right, lambda t: 0.001 * t * (1 + 0 * mine.size), "x")
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(progress=100.0 if ME else False))
    assert comm.allgather(problem.t) == [1.0] * comm.size
