"""Regular polygons that roll down a slope, with one or two sides a step."""

from __future__ import annotations

import basix.ufl
import numpy as np
import pytest
from dolfinx.mesh import create_mesh, exterior_facet_indices, meshtags
from support.apart import all_cells, block
from support.problems import of_two

import vmdg
from vmdg.meshes import apart

pytestmark = pytest.mark.filterwarnings("ignore:solve_dynamics. up to")  # long steps


def polygon(x, sides):
    """A square grid with 4 n sides, -1 to 1, as a polygon whose corners are on a circle."""
    size = np.maximum(np.abs(x).max(axis=0), 1e-12)
    along = np.where(np.abs(x[0]) >= np.abs(x[1]), x[1], x[0]) / size
    axis = np.abs(x[0]) >= np.abs(x[1])
    angle = np.pi / 4 * along
    cos, sin = np.sign(np.where(axis, x[0], x[1])) * np.cos(angle), np.sin(angle)
    turned = size * np.where(axis, [cos, sin], [sin, cos])
    turn = np.pi / sides * (sides // 4 % 2 == 0)  # a side below
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, -s], [s, c]]) @ turned


def disc(sides, radius, comm):
    """A polygon of 4 n sides that stands on the x axis, tag 2: a rounded square of n x n cells, and
    rings of 4 n cells around it, so that no cell has two sides of the polygon."""
    n, rings = sides // 4, max(2, sides // 12)
    line, a = np.linspace(-1, 1, n + 1), np.arange(n)
    square = np.array(np.meshgrid(line, line, indexing="ij")).reshape(2, -1)
    inner = 0.3 * (square + polygon(square, sides))
    edge = np.concatenate([a * (n + 1), n * (n + 1) + a, (n - a) * (n + 1) + n, n - a])
    first = ((n + 1) * a[:, None] + a).ravel()
    rows = [np.column_stack([first, first + n + 1, first + 1, first + n + 2])]
    nodes, last = [inner], edge
    for ring in range(1, rings + 1):
        share = ring / rings
        nodes.append((1 - share) * inner[:, edge] + share * polygon(square[:, edge], sides))
        here = (n + 1) ** 2 + (ring - 1) * sides + np.arange(sides)
        rows.append(np.column_stack([last, np.roll(last, -1), here, np.roll(here, -1)]))
        last = here
    x, cells = radius * np.concatenate(nodes, axis=1).T, np.concatenate(rows)
    x[:, 1] -= x[:, 1].min()
    if comm.rank:
        x, cells = x[:0], cells[:0]
    element = basix.ufl.element("Lagrange", "quadrilateral", 1, shape=(2,))
    mesh = create_mesh(comm, cells=cells, x=x, e=element)
    mesh.topology.create_connectivity(1, 2)
    facets = exterior_facet_indices(mesh.topology)
    return mesh, all_cells(mesh, 2), meshtags(mesh, 1, facets, np.full(len(facets), 20, np.int32))


def rolled(comm, sides, radius, slope, strain, steps, floor, rho_inf=0.8):
    """Way of a disc down a slope over a quarter turn, relative to that of one that rolls, and the
    energy of its translation relative to the work of its weight, over the second half.

    Args:
        slope: Its angle [rad].
        strain: Stress of the weight on a radius, over Young's modulus.
        floor: Number of facets of the rigid slope.
    """
    way = np.pi / 2 * radius
    part = disc(sides, radius, comm)
    ends = [-1.5 * radius, -0.5 * radius], [way + 2.5 * radius, 0.0]
    scene = apart([block("quadrilateral", (floor, 1), *ends, 1, comm), part])
    bodies = vmdg.Rigid(), vmdg.NeoHookean(E=np.pi * radius / strain, nu=0.3)
    law = vmdg.Contact(friction=0.8)
    problem = of_two(scene, law, bodies, {"sliding": True}, density={2: 1.0})
    force = np.array([np.sin(slope), -np.cos(slope)])
    problem.body_force(force)
    span = np.sqrt(2 * way / (2 / 3 * force[0]))

    def watched(problem):
        motion, owned = problem.step.motion, problem.discretization.owned
        u, v = (one.x.array[:owned] for one in (problem.u, problem.velocity))
        P, moment = (comm.allreduce(motion.of(one).reshape(-1, 2).sum(axis=0)) for one in (v, u))
        mass = comm.allreduce(motion.row_sums[::2].sum())
        return {"moved": P @ P / (2 * mass), "work": force @ moment, "way": moment[0] / mass}

    times = np.linspace(0.0, span, steps + 1)[1:]
    scheme = vmdg.GeneralizedAlpha(rho_inf)
    history = vmdg.solve_dynamics(problem, times, scheme, monitor=watched).history
    half = times > span / 2
    return history["way"][-1] / way, history["moved"][half].sum() / history["work"][half].sum()


def drawn(number):
    """A disc, its slope, and its steps, of up to two sides at the end of its way: its slope is at
    least twice that on which the polygon would stay."""
    rng = np.random.default_rng(number)
    sides = 4 * int(rng.integers(6, 17))
    return {
        "sides": sides,
        "radius": float(np.exp(rng.uniform(-2, 2))),
        "slope": float(rng.uniform(2 * np.pi / sides, 0.6)),
        "strain": float(10 ** rng.uniform(-3.5, -2.5)),
        "steps": int(np.ceil(sides / 4 / rng.uniform(0.2, 1.0))),
        "floor": int(rng.integers(4, 40)),
        "rho_inf": float(rng.choice([0.5, 0.8])),
    }


@pytest.mark.parametrize(
    "number", [pytest.param(n, marks=[pytest.mark.long] * (n != 14)) for n in range(24)]
)
def test_disc_rolls_down(comm, number):
    """A disc that rolls has 2/3 of the work of its weight in its translation and 1/3 in its spin,
    whatever its sides, radius, slope and steps; a polygon of few sides sets out later."""
    way, share = rolled(comm, **drawn(number))
    assert 0.85 < way < 1.05
    assert share == pytest.approx(2 / 3, rel=0.05)
