"""Measured modes: strengths, energies and mixed-mode exponent of a bond from DCB, MMB and ENF.

One specimen, two arms with a crack between them, is opened (double cantilever beam), sheared
(end-notched flexure), and both at once by a lever (mixed-mode bending). The three curves of a known
bond, with noise, stand for measurements, from which the five parameters of a law with the criterion
of Benzeggagh and Kenane are found together. The second picture shows the energy at all ratios of
modes with its uncertainty. Facets of 1.5 mm leave teeth on the curve of the sheared specimen: there
intervals from derivatives are too short, and fits from two starts end 10 % apart in shear strength.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from dolfinx import fem
from parts.options import run

import vmdg
from vmdg.meshes import beams

SPAN, CRACK, HEIGHT = 50.0, 18.0, 1.5  # mm
TRUTH = {
    "bond.normal_strength": 20.0,  # MPa
    "bond.shear_strength": 30.0,
    "bond.normal_energy": 0.3,  # N/mm
    "bond.shear_energy": 0.7,
    "bond.exponent": 2.0,
}
#: Last opening of the arms, or deflection of the specimen at midspan or of the lever [mm].
ENDS = {"DCB": 2.4, "MMB": 2.4, "ENF": 1.6}
LEVER = 0.9  # length of the lever relative to half the span


def specimen(values: dict[str, float], test: str, facet: float = 1.5) -> tuple:
    """A test of a bond with these values, what it measures, and where it ends."""
    middle, height = SPAN / 2, HEIGHT
    stations = (0.0, 4.0, CRACK - 2, CRACK, middle, 0.8 * SPAN, SPAN)
    divisions = np.ceil(np.diff(stations) / (facet * np.array([4, 4, 1, 1, 1, 4]))).astype(int)
    comm, kind = MPI.COMM_WORLD, "quadrilateral"
    mesh, cells, sides = beams(comm, kind, stations, divisions.tolist(), height, 1, CRACK, 4.0)
    given = {name.removeprefix("bond."): value for name, value in values.items()}
    law = vmdg.MixedModeDebonding(**given, criterion="BK")
    bond = vmdg.Interface(facets=sides.find("interface"), law=law, name="bond")
    faces = vmdg.Interface(facets=sides.find("contact"), law=vmdg.Contact(), name="faces")
    arms = dict.fromkeys(("lower arm", "upper arm"), vmdg.NeoHookean(E=70e3, nu=0.3))
    problem = vmdg.Problem(mesh, cells, arms, [bond, faces], degree=2, kinematics="small")

    def at(x: float, y: float) -> Callable:
        return lambda points: np.isclose(points[0], x) & np.isclose(points[1], y)

    if test == "DCB":
        problem.dirichlet(sides.find("right"), 0.0)
        for y in (height, -height):
            problem.dirichlet_points(at(0.0, y), lambda t, y=y: t * y / (2 * height), "y")
        end = sides.find("upper left")
        return problem, lambda problem: {"force [N]": problem.reaction(end)[1]}
    problem.dirichlet_points(at(0.0, -height), 0.0, "y")
    problem.dirichlet_points(at(SPAN, -height), 0.0)
    if test == "ENF":
        problem.dirichlet_points(at(middle, height), lambda t: -t, "y")
        top = sides.find("top")
        return problem, lambda problem: {"force [N]": -problem.reaction(top)[1]}
    # The load on the lever pushes down at midspan, and lifts the end of the upper arm.
    forces = {0.0: LEVER, middle: -(1 + LEVER)}
    owned, nodes = problem.space.dofmap.index_map.size_local, {}
    for x, force in forces.items():
        problem.point_load(at(x, height), lambda t, force=force: t * force, "y")
        nodes[x] = fem.locate_dofs_geometrical(problem.space, at(x, height))

    def deflection(problem: vmdg.Problem) -> float:
        u = problem.u.x.array.reshape(-1, 2)[:, 1]
        works = (force * u[nodes[x][nodes[x] < owned]].sum() for x, force in forces.items())
        return comm.allreduce(sum(works))

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"deflection [mm]": deflection(problem)}

    return problem, monitor, lambda problem: deflection(problem) > ENDS[test]


def main(
    noise: float = 0.01,
    points: int = 10,
    facet: float = 1.5,
    off: float = 0.3,
    seed: int = 1,
    out: str = "results/measured_modes",
) -> vmdg.Identified:
    """Measure, identify, draw; what was identified.

    Args:
        noise: Standard deviation of the noise relative to the largest load [-].
        points: Measured points of every test.
        facet: Size of the facets [mm].
        off: Distance of the start from the truth, relative [-].
        seed: Of the noise.
        out: Folder for the results.
    """
    makes = {test: partial(specimen, test=test, facet=facet) for test in ENDS}
    places = {test: np.linspace(0, end, points + 1)[1:] for test, end in ENDS.items()}
    columns = dict.fromkeys(ENDS, ("load", "force")) | {"MMB": ("deflection", "load")}
    # The load on the lever falls while the crack runs: its path is traced.
    loads = places | {"MMB": np.array([1e3])}
    options = vmdg.SolveOptions(unstable="trace", max_share=0.05)

    def paths(values: dict[str, float]) -> dict[str, np.ndarray]:
        found = {}
        for test, make in makes.items():
            problem, monitor, *until = make(values)
            history = vmdg.solve(problem, loads[test], options, monitor, None, *until).history
            found[test] = np.array([np.append(0.0, history[name]) for name in columns[test]])
        return found

    random, curves = np.random.default_rng(seed), {}
    for test, path in paths(TRUTH).items():
        sigma, x = noise * path[1].max(), places[test]
        y = np.interp(x, *path) + sigma * random.standard_normal(points)
        curves[test] = vmdg.Curve(x, y, *columns[test][::-1], sigma=sigma)
    factors = np.resize([1 + off, 1 - off], len(TRUTH))
    start = {name: f * value for (name, value), f in zip(TRUTH.items(), factors, strict=True)}
    bounds = {"bond.exponent": (1.01, 10.0)}
    found = vmdg.identify(makes, curves, start, bounds, loads=loads, options=options)

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    begun, ended = paths(start), paths(found.estimate)
    for i, (test, curve) in enumerate(curves.items()):
        left.plot(curve.x, curve.y, f"C{i}o", ms=4, mfc="none", label=test)
        left.plot(*begun[test], f"C{i}:", lw=1)
        left.plot(*ended[test], f"C{i}", lw=1)
    left.set(xlabel="deflection [mm]", ylabel="load [N/mm]", xlim=(0, None), ylim=(0, None))
    left.legend(title="points measured,\ndotted: start, lines: fit")
    share = np.linspace(0, 1, 50)
    logs = np.log(list(found.estimate.values()))
    drawn = np.exp(random.multivariate_normal(logs, found.covariance, 2000)).T[2:, :, None]
    cloud = drawn[0] + (drawn[1] - drawn[0]) * share ** drawn[2]
    right.fill_between(share, *np.quantile(cloud, (0.025, 0.975), axis=0), alpha=0.3, label="95 %")
    for (_, _, *of_bk), style in ((found.estimate.values(), "C0"), (TRUTH.values(), "k--")):
        first, second, exponent = of_bk
        label = "fit" if style == "C0" else "truth"
        right.plot(share, first + (second - first) * share**exponent, style, lw=1, label=label)
    right.set(xlabel="share of shear $G_{II}/G$", ylabel="energy [N/mm]", xlim=(0, 1))
    right.legend()
    if MPI.COMM_WORLD.rank == 0:
        print(found)
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(f"{out}/measured_modes.png", dpi=110)
    return found


if __name__ == "__main__":
    run(main)
