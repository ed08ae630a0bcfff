"""Meshes that do not match, of plastic and of nearly incompressible bodies, bonded and sliding."""

from __future__ import annotations

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from support.apart import block, moved, order_of_dofs, separated, stack
from support.checks import tangent_error, tangent_matrix
from support.problems import FRICTION, displace, joined, rotation, through
from support.scenes import DIMENSION, two_blocks

import vmdg
from vmdg import Mode
from vmdg.base.parallel import global_max, global_sum
from vmdg.interface.moving import MovingInterface
from vmdg.meshes import apart

E, NU, MU = 4000.0, 0.3, 0.3
TIGHT = vmdg.SolveOptions(relative_tolerance=1e-8)
METAL = vmdg.J2(E, NU, 60.0, hardening=400.0, saturation=90.0, exponent=20.0)
SOIL = vmdg.DruckerPrager(E, NU, 15.0, 35.0, dilatancy=10.0, hardening=60.0)
RUBBER = vmdg.NeoHookean(E=E, nu=0.4999)
ELASTIC = vmdg.NeoHookean(E=2 * E, nu=NU)
HARD = vmdg.NeoHookean(E=1e6, nu=0.3)
MEAN = {"volumetric": "mean"}
BOTH = "small", "finite"
LOCKS = pytest.mark.filterwarnings("ignore:plastic flow keeps the volume")
#: Cells and options of plastic bodies.
PLASTIC = (
    *((cell, {"degree": 2}) for cell in ("triangle", "quadrilateral", "tetrahedron")),
    ("quadrilateral", MEAN),
    ("hexahedron", MEAN),
    ("quadrilateral", {"plane": "stress"}),
)

#: Materials and options of problems.
KINDS = {
    "plastic": ((METAL, METAL), {}),
    "degree 2": ((METAL, ELASTIC), {"degree": 2}),
    "mean": ((METAL, ELASTIC), MEAN),
    "rubber": ((RUBBER, ELASTIC), MEAN),
    "plane stress": ((METAL, ELASTIC), {"plane": "stress"}),
    "axisymmetric": ((METAL, ELASTIC), {"symmetry": "axisymmetric"}),
    "axisymmetric, mean": ((RUBBER, METAL), {"symmetry": "axisymmetric"} | MEAN),
    "generalized": ((METAL, ELASTIC), {"plane": "generalized strain"}),
    "soil": ((SOIL, ELASTIC), {"degree": 2}),
    "swelling": ((ELASTIC, ELASTIC), {"eigenstrain": {1: 0.02, 2: lambda t: 0.01 * t}}),
}
#: Cells and kinds, with kinematics and laws by turns.
FORMS = [
    *(("triangle", kind) for kind in KINDS if "volumetric" not in KINDS[kind][1]),
    *(("quadrilateral", kind) for kind in ("degree 2", "mean", "rubber", "axisymmetric, mean")),
    *(("tetrahedron", kind) for kind in ("plastic", "degree 2")),
    *(("hexahedron", kind) for kind in ("mean", "rubber")),
]


def flow(problem):
    state = problem.discretization.bodies.points.state
    here = max((part[:, 0].max(initial=0.0) for part in state.next), default=0.0)
    return global_max(problem.comm, here)


# The form


@LOCKS
@pytest.mark.parametrize(
    ("cell", "kind", "kinematics", "law"),
    [
        (*form, "small" if "soil" in form else BOTH[i % 2], (vmdg.Bonded(), FRICTION)[i // 2 % 2])
        for i, form in enumerate(FORMS)
    ],
)
def test_equals_the_form_of_meshes_that_match(cell, kind, kinematics, law):
    """Residual, tangent and energy of segments are those of interior facets."""
    materials, options = KINDS[kind]
    flat = DIMENSION[cell] == 2
    scene = two_blocks(MPI.COMM_SELF, cell, n=2 if flat else 1, distortion=0.05)
    if "symmetry" in options:
        scene.mesh.geometry.x[:, 0] += 0.5
    vectors, matrices, energies = [], [], []
    for one in (scene, separated(scene)):
        given = {"safety": 3.0, "frame": "corotating"}
        problem = joined(one, law, materials, given, kinematics=kinematics, **options)
        through(problem, *(lambda s=s, p=problem, m=one: displace(p, m, s) for s in (0.2, 0.3)))
        order = order_of_dofs(problem)
        means = problem.discretization.means
        if means is not None:
            order = np.concatenate([order, means.dofs])
        vectors.append(problem.step.assemble_residual()[order])
        matrix = tangent_matrix(problem)
        matrices.append(matrix.convert("dense").getDenseArray()[np.ix_(order, order)])
        energies.append(problem.discretization.stored_energy())
        if METAL in materials:
            assert flow(problem) > 1e-3
    for first, second in (vectors, matrices, energies):
        assert np.abs(first - second).max() < 1e-11 * np.abs(first).max()


# Patch tests


# Sliding


@LOCKS
@pytest.mark.parametrize(
    ("cell", "options", "materials"),
    [
        ("triangle", {}, (ELASTIC, HARD)),
        ("triangle", {"degree": 2}, (METAL, METAL)),
        ("quadrilateral", {"degree": 2}, (ELASTIC, METAL)),
        ("quadrilateral", {}, (ELASTIC, HARD)),
        ("quadrilateral", MEAN, (METAL, METAL)),
        ("hexahedron", MEAN, (ELASTIC, METAL)),
        ("tetrahedron", {"degree": 2}, (METAL, METAL)),
        ("tetrahedron", {}, (ELASTIC, HARD)),
    ],
    ids=range(8),
)
def test_tangent_of_fixed_pairs(comm, cell, options, materials, monkeypatch):
    """With pairs and partners fixed: the derivative of the residual, in the frame of side 1."""
    scene = stack(cell, *((3, 4) if DIMENSION[cell] == 2 else (1, 2)), (1, 1), comm=comm)
    find, d = scene.facet_tags.find, DIMENSION[cell]
    interface = vmdg.Interface(
        surfaces=(find(12), find(21)), law=vmdg.Contact(friction=MU), sliding=True
    )
    bodies = dict(enumerate(materials, start=1))
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [interface], **options)

    def press(wave, shift):
        def field(x, tag):
            y = x[:d] + wave * np.sin(2 * x[:d][::-1] + tag)
            y[d - 1] -= 0.06 * (tag == 2)
            y[0] += shift * (tag == 2)
            return rotation(d, 0.4) @ y - x[:d]

        for tag in (1, 2):
            problem.u.interpolate(partial(field, tag=tag), scene.cell_tags.find(tag))
        problem.u.x.scatter_forward()

    through(problem, partial(press, 0.02, 0.0), partial(press, 0.025, 0.03))
    assert METAL not in materials or flow(problem) > 1e-3
    modes = problem.discretization.active[0].values.update.mode
    assert global_sum(comm, (modes == Mode.FRICTION).sum()) > 0
    monkeypatch.setattr(MovingInterface, "pair", lambda self, release=False: None)
    monkeypatch.setattr(MovingInterface, "_add_partners", lambda self, *given: None)
    assert tangent_error(problem, tangent_matrix(problem)) < 1e-6


def on_a_base(comm, cell, cells, base, unit=1.0, angle=0.0):
    """A block of 1 mm, body 1, on a base of 4 mm, body 2, turned, in other units."""
    d = DIMENSION[cell]
    wide, deep = ([0.4], [0.0]) if d == 3 else ([], [])
    parts = [
        block(cell, cells, [0.6, *wide, 0.0], [1.6, *(w + 1 for w in wide), 0.6], 1, comm),
        block(cell, base, [0.0, *deep, -0.6], [4.0, *(2.0 for _ in deep), 0.0], 2, comm),
    ]
    return apart([moved(part, lambda x: unit * rotation(d, angle) @ x) for part in parts])


@pytest.mark.parametrize(
    ("cell", "options"),
    [
        *(pytest.param(*case, marks=pytest.mark.long) for case in PLASTIC[2:5]),
        ("quadrilateral", {"degree": 2}),
        PLASTIC[5],
    ],
    ids=str,
)
@LOCKS
def test_drawn_over_facets(comm, cell, options):
    """A block flows under its pressure and is drawn over the facets of a rigid base: F = mu N,
    energies balance. Moments do but for adjoint terms with the moduli of the start of a step, and
    stresses that are extrapolated."""
    cells, base = ((5, 3), (28, 2)) if DIMENSION[cell] == 2 else ((2, 2, 2), (8, 4, 1))
    scene = on_a_base(comm, cell, cells, base)
    law = vmdg.Contact(friction=MU)
    problem, table = drawn(scene, (vmdg.J2(E, NU, 40.0, hardening=400.0), HARD), law, **options)
    moves = table["load"] > 1.1
    N, F = table["N"][moves], table["F"][moves]
    assert flow(problem) > 1e-3
    assert np.abs(F - MU * N).max() < 1e-3 * F.mean()
    assert table["moment"].max() < 2e-4 * N.mean()
    assert np.ptp(table["imbalance"][moves]) < 5e-3 * np.ptp(table["work"][moves])
    assert table["iterations"].mean() <= 10


def drawn(scene, materials, law, unit=1.0, loads=(0.5, 1.0, 1.05, 1.15, 1.3, 1.5), **options):
    """Press the block of :func:`on_a_base` by .02 mm up to t = 1, then draw it along the base."""
    interface = vmdg.Interface(between=(1, 2), law=law, sliding=True)
    bodies = dict(enumerate(materials, start=1))
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [interface], **options)
    find, d = scene.facet_tags.find, problem.mesh.geometry.dim
    problem.dirichlet(find(21), 0.0)
    down, along = np.zeros(d), np.zeros(d)
    down[-1], along[0] = -0.02 * unit, unit
    problem.dirichlet(find(12), lambda t: min(t, 1.0) * down + max(t - 1.0, 0.0) * along)

    def monitor(problem):
        force, energy = problem.reaction(find(12)), problem.energy()
        return {
            "F": force[0],
            "N": -force[-1],
            "moment": moment(problem),
            "imbalance": energy.imbalance,
            "work": energy.external,
        }

    result = vmdg.solve(problem, loads, TIGHT, monitor)
    assert not result.failures
    return problem, result.history


def moment(problem):
    """Sum of the moments of all forces in the current configuration, over all ranks."""
    d, owned = problem.mesh.geometry.dim, problem.discretization.owned
    x = problem.space.tabulate_dof_coordinates()[: owned // d, :d]
    x = x + problem.u.x.array[:owned].reshape(-1, d)
    forces = problem.discretization.forces.x.array[:owned].reshape(-1, d)
    moments = global_sum(problem.comm, np.einsum("ni,nj->ij", x, forces))
    return float(np.abs(moments - moments.T).max())
