"""(27) as UFL on interior facets and as a sum over points: the same residual, energy, tangent."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from support.checks import global_norm, tangent_matrix
from support.problems import FRICTION, MATERIALS, displace, joined, through
from support.scenes import DIMENSION, section, tag_cells, two_blocks, unit_box
from support.symbolic import SymbolicForm

import vmdg
from vmdg.base.parallel import global_sum
from vmdg.interface.active import recoverable_energy
from vmdg.meshes import TaggedMesh

SOFT = vmdg.Debonding(strength=200.0, critical_gap=0.4, friction=0.4)
PLY = vmdg.Orthotropic(E=(9e3, 2e3, 2e3), nu=(0.3, 0.3, 0.4), G=(900.0, 800.0, 900.0), angle=30.0)
RUBBER = vmdg.Ogden(c=(6.3, 0.012, -0.1), m=(1.3, 5.0, -2.0), kappa=1e3)
OTHERS = (PLY, vmdg.NeoHookean(E=5000.0, nu=0.25)), (RUBBER, MATERIALS[1])

#: Cell, degree, law, options of the interface and of the problem: every value of one beside every
#: value of most others.
SCENES = [
    ("triangle", 1, vmdg.Bonded(), {}, {}),
    ("triangle", 2, SOFT, {"frame": "corotating"}, {}),
    ("triangle", 1, FRICTION, {}, {"plane": "stress"}),
    ("triangle", 2, vmdg.Bonded(), {"traction_jump": True}, {"kinematics": "small"}),
    ("triangle", 1, SOFT, {"norm": "spectral"}, {"materials": OTHERS[1]}),
    ("quadrilateral", 1, SOFT, {"traction_jump": True}, {"materials": OTHERS[0]}),
    ("quadrilateral", 2, vmdg.Bonded(), {"frame": "corotating"}, {"symmetry": "axisymmetric"}),
    ("quadrilateral", 2, FRICTION, {}, {"kinematics": "small", "thickness": 0.3}),
    ("quadrilateral", 1, vmdg.Contact(0.3), {"frame": "corotating"}, {}),
    ("quadrilateral", 1, SOFT, {}, {"periodic": True}),
    ("tetrahedron", 1, SOFT, {"frame": "corotating"}, {}),
    ("tetrahedron", 2, FRICTION, {"safety": 4.0}, {"kinematics": "small"}),
    ("hexahedron", 1, vmdg.Bonded(), {}, {}),
]


def scene_of(comm, cell, options):
    """Mesh, tags and the place of the interface."""
    if options.get("periodic"):
        mesh = unit_box(comm, cell, 2)
        tags = tag_cells(mesh, {1: lambda x: x[0] < 0.5, 2: lambda x: x[0] > 0.5})
        options["periodic"] = vmdg.Periodic(gradient=lambda t: 0.01 * t * np.eye(2))
        inside = {"between": None, "facets": lambda x: np.isclose(x[0], 0.5)}
        return TaggedMesh(mesh, tags, None), inside
    if options.get("symmetry"):
        return section(comm, cell, radii=(0.5, 1.0, 2.0), distortion=0.03), {}
    n = 2 if DIMENSION[cell] == 2 else 1
    return two_blocks(comm, cell, n, distortion=0.05), {}


def difference(comm, one, other):
    return global_norm(comm, one - other) / global_norm(comm, other)


@pytest.mark.parametrize(
    "cell, degree, law, interface, options", SCENES, ids=[str(i) for i in range(len(SCENES))]
)
def test_two_ways(comm, cell, degree, law, interface, options):
    """Random states, damaged, pressed and open in places."""
    options = dict(options)
    materials = options.pop("materials", MATERIALS)
    scene, where = scene_of(comm, cell, options)
    found = {}
    for way in ("symbolic", "points"):
        interface = {**interface, **where}
        problem = joined(scene, law, materials, interface, degree=degree, residual=way, **options)
        rng = np.random.default_rng(5)
        parts = problem.discretization
        assert (parts.weak_form.on_facets[0] is None) == (way == "points")
        noise = fem.Function(problem.space)

        def moved(factor, problem=problem, noise=noise, rng=rng):
            displace(problem, scene, factor)
            x, size = problem.space.tabulate_dof_coordinates(), noise.function_space.dofmap.bs
            a, b = rng.uniform(1.0, 9.0, (2, size, 3))
            noise.x.array[:] = 2e-3 * (np.sin(x @ a.T) * np.cos(x @ b.T)).ravel()
            problem.u.x.array[: len(noise.x.array)] += noise.x.array

        through(problem, lambda: moved(0.5), lambda: moved(1.0))
        forces = problem.step.assemble_residual().copy()
        stored = global_sum(comm, parts.stored_energy())
        found[way] = forces, stored, problem
    (one, energies, _), (two, others, problem) = found["symbolic"], found["points"]
    assert difference(comm, one, two) < 1e-11
    assert np.abs(energies - others).max() < 1e-11 * np.abs(energies).max()

    form, parts = SymbolicForm(problem), problem.discretization
    recoverable = others[1] - integral_of(comm, form)
    gap_energy = global_sum(comm, sum(map(recoverable_energy, parts.active.values())))
    scale = abs(others[0]) + abs(others[1])
    assert abs(recoverable - gap_energy) < 1e-11 * scale
    if DIMENSION[cell] == 3 or parts.means is not None:
        return  # the symbolic kernels of 3D take minutes to compile
    matrix = tangent_matrix(problem, damage=False)
    form = SymbolicForm(problem)
    eta, du = ufl.TestFunction(problem.space), ufl.TrialFunction(problem.space)
    symbolic = fem_petsc.assemble_matrix(
        form.compile(ufl.derivative(form.residual(eta), problem.u, du))
    )
    symbolic.assemble()
    size = symbolic.norm()
    symbolic.axpy(-1.0, matrix, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    assert symbolic.norm() < 1e-11 * size


def integral_of(comm, form):
    """(30) of all interfaces."""
    energy = sum((one.energy() for one in form.interfaces), start=ufl.Form([]))
    return global_sum(comm, fem.assemble_scalar(form.compile(energy)))


def test_unknown_way_is_refused(comm):
    scene = two_blocks(comm, "triangle")
    with pytest.raises(ValueError, match="residual = 'ufl' must be one of"):
        joined(scene, vmdg.Bonded(), residual="ufl")


@pytest.mark.parametrize(
    "options",
    [{"eigenstrain": {1: 0.01}}, {"volumetric": "mean"}, {"plane": "generalized strain"}],
    ids=lambda options: next(iter(options)),
)
def test_products_of_features_are_sums_over_points(comm, options):
    """(27) is integrated over facets for plain elastic bodies only."""
    scene = two_blocks(comm, "quadrilateral")
    for given, way in (({}, True), (options, False)):
        problem = joined(scene, vmdg.Bonded(), **given)
        assert [bool(one) for one in problem.discretization.weak_form.on_facets] == [way]
