"""Interfaces between meshes that share no nodes: the form, its tangent, patch tests, refusals."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx.graph import partitioner
from dolfinx.mesh import compute_midpoints, create_mesh, exterior_facet_indices, meshtags
from support.apart import block, moved, rings, separated, stack
from support.checks import tangent_error, tangent_matrix
from support.problems import (
    FRICTION,
    PRECISE,
    SAME,
    joined,
    rotation,
    set_displacement,
    through,
)
from support.scenes import CELLS, DIMENSION, EVERY_DEGREE, SEVERAL_RANKS, pairs, two_blocks

import vmdg
from vmdg import Mode, NamedTags, compat
from vmdg.base.parallel import global_sum
from vmdg.domain.topology import facet_cells, tags_of_cells
from vmdg.interface.active import interface_flux
from vmdg.interface.coercivity import margin
from vmdg.meshes import apart, blocks
from vmdg.output.values import facet_scalar, scalar

RATIOS = [(3, 4), (7, 5), (4, 13), (2, 20)]
BOTH = "small", "finite"
#: Radii of two rings [mm], and their bodies.
RADII = (0.5, 1.0, 2.0)
STRAIN = np.array([[0.3, 0.2, 0.05], [0.05, -0.12, -0.1], [0.1, 0.0, 0.08]])


# The form


def dense(matrix):
    start, columns, values = matrix.getValuesCSR()
    rows = np.repeat(np.arange(len(start) - 1), np.diff(start))
    array = np.zeros(matrix.getSize())
    array[rows, columns] = values
    return array


#: Large bodies: differences of residuals reach across few switches of points [mm].
SIZE = 50.0


def wavy(x):
    """A curved interface, on which polygons of different meshes do not coincide."""
    x[-1] += 0.1 * np.sin(2 * x[0] + 0.5) * (1 - np.abs(x[-1]))
    return SIZE * x


def bent(problem, scene, opening, angle):
    """Bend both bodies, open the interface, and turn everything."""
    d = scene.mesh.geometry.dim

    def field(x, tag):
        y = x[:d] + 0.03 * SIZE * np.sin(2 / SIZE * x[:d][::-1] + tag)
        y[d - 1] += SIZE * opening * (tag == 2)
        y[0] += 0.5 * SIZE * opening * (tag == 2)
        return rotation(d, angle) @ y - x[:d]

    set_displacement(problem.u, scene.cell_tags, field)


@pairs(
    cell=CELLS,
    law=(vmdg.Bonded(), FRICTION, vmdg.Contact(friction=0.3)),
    degree=(1, 2),
    frame=("corotating", "reference"),
)
def test_tangent(cell, degree, frame, law):
    """With initial gaps, open, damaged and sliding points: the derivative of the residual."""
    scene = stack(cell, *((3, 4) if DIMENSION[cell] == 2 else (1, 2)), (1, 1), move=wavy)
    if law is FRICTION:
        law = vmdg.Debonding(strength=50.0, critical_gap=0.2 * SIZE, friction=0.5)
    problem = joined(scene, law, interface={"frame": frame}, degree=degree)
    assert problem.discretization.active[0].quadrature.initial_gap is not None
    angle = 0.4 if frame == "corotating" else 0.0
    through(problem, *(lambda s=s: bent(problem, scene, s, angle) for s in (0.02, 0.025)))
    matrix = tangent_matrix(problem)
    assert tangent_error(problem, matrix) < 1e-7
    if not law.inelastic:
        assert matrix.isSymmetric(1e-12 * matrix.norm())
        return
    modes = set(problem.discretization.active[0].values.update.mode.tolist())
    assert len(modes) > 1
    assert modes != {Mode.ELASTIC}


@pytest.mark.parametrize("cell", ["triangle", "tetrahedron"])
@pytest.mark.parametrize("law", [vmdg.Bonded(), FRICTION], ids=["tie", "bond"])
def test_balance(cell, law):
    """Forces and moments of the interface balance, about any point of the deformed bodies."""
    scene = stack(cell, 2, 3, (1, 1), move=wavy)
    problem = joined(scene, law, interface={"frame": "corotating"}, degree=2)
    through(problem, *(lambda s=s: bent(problem, scene, s, 0.4) for s in (0.002, 0.004)))
    active = problem.discretization.active[0]
    problem.step.assemble_residual()
    d = scene.mesh.geometry.dim
    forces = np.zeros_like(problem.u.x.array)
    nodes = problem.space.dofmap.list
    active.point_tangent.add_forces(interface_flux(active), nodes, forces)
    forces = forces.reshape(-1, d)
    x = problem.space.tabulate_dof_coordinates()[:, :d] + problem.u.x.array.reshape(-1, d)
    scale = np.abs(forces).sum()
    assert scale > 1.0
    assert np.abs(forces.sum(axis=0)).max() < 1e-14 * scale
    moments = np.einsum("ni,nj->ij", x, forces)
    assert np.abs(moments - moments.T).max() < 1e-13 * scale


# Patch tests


def stretched(scene, law, degree, kinematics, **options):
    """Two blocks of one material whose outer surface is deformed uniformly."""
    problem = joined(
        scene, law, SAME, {"frame": "corotating"}, degree=degree, kinematics=kinematics, **options
    )
    d = scene.mesh.geometry.dim
    H = STRAIN[:d, :d]
    outside = np.concatenate([scene.facet_tags.find(tag) for tag in (10, 11, 20, 22)])
    problem.dirichlet(outside, lambda x, t: t * H @ x[:d])
    vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(relative_tolerance=1e-13))
    X = problem.space.tabulate_dof_coordinates()[:, :d]
    error = np.abs(problem.u.x.array.reshape(-1, d) - X @ H.T).max() / np.abs(H).max()
    return problem, error


@pairs(cell=CELLS, degree=(1, 2), kinematics=BOTH, law=(vmdg.Bonded(), vmdg.Debonding(1e5, 1e3)))
def test_uniform_strain(cell, degree, kinematics, law):
    """Bonded blocks at 30 % strain: exact on every pair of meshes."""
    for ratio in RATIOS if DIMENSION[cell] == 2 else [(2, 3)]:
        problem, error = stretched(stack(cell, *ratio), law, degree, kinematics)
        assert error < 1e-11
        assert np.ptp(problem.state[0].traction, axis=0).max() < 1e-8


def test_several_bodies():
    """A facet that lies opposite two bodies is divided between them."""
    parts = [
        block("quadrilateral", (5, 2), (0.0, -1.0), (2.0, 0.0), 1),
        block("quadrilateral", (3, 2), (0.0, 0.0), (0.9, 1.0), 2),
        block("quadrilateral", (4, 3), (0.9, 0.0), (2.0, 1.0), 3),
    ]
    scene = apart(parts)
    body = vmdg.NeoHookean(E=1000.0, nu=0.3)
    pairs = ((1, 2), (1, 3), (2, 3))
    interfaces = [vmdg.Interface(between=pair, law=vmdg.Bonded()) for pair in pairs]
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, dict.fromkeys((1, 2, 3), body), interfaces)
    areas = [problem.state[i].weights.sum() for i in range(3)]
    assert areas == pytest.approx([0.9, 1.1, 1.0], abs=1e-14)
    H = STRAIN[:2, :2]

    def outside(x):
        return (np.abs(x[0] - 1) > 1 - 1e-9) | (np.abs(x[1]) > 1 - 1e-9)

    problem.dirichlet(outside, lambda x, t: t * H @ x[:2])
    vmdg.solve(problem, [0.5, 1.0], PRECISE)
    X = problem.space.tabulate_dof_coordinates()[:, :2]
    assert np.abs(problem.u.x.array.reshape(-1, 2) - X @ H.T).max() < 1e-12
    again = [*interfaces, vmdg.Interface(between=(1, 2), law=vmdg.Bonded())]
    with pytest.raises(
        ValueError, match=r"interface 0 .* and interface 3 .* both join or separate"
    ):
        vmdg.Problem(scene.mesh, scene.cell_tags, dict.fromkeys((1, 2, 3), body), again)


# Coercivity


@pairs(
    cell=CELLS,
    degree=(1, 2),
    bodies=((0.0, 1.0), (0.499, 1e3)),
    law=(vmdg.Bonded(), vmdg.Debonding(1e12, 1e12)),
)
def test_coercive(cell, degree, bodies, law):
    """The bonded form keeps the fraction alpha of the bulk energy, for all displacements."""
    nu, contrast = bodies
    materials = vmdg.NeoHookean(E=1000.0, nu=nu), vmdg.NeoHookean(E=1000.0 * contrast, nu=0.3)
    alpha = margin(law, degree)
    flat = DIMENSION[cell] == 2
    for ratio in ((1, 1), (3, 4), (2, 20), (20, 2)) if flat else ((1, 1), (1, 2), (2, 1)):
        scene = stack(cell, *ratio, (1, 1), move=wavy)
        problem = joined(scene, law, materials, degree=degree, kinematics="small")
        assert_keeps(problem, alpha)


@pytest.mark.parametrize("law", [vmdg.Bonded(), vmdg.Contact()], ids=["tie", "contact"])
@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_r_does_not_ask_whether_nodes_are_shared(comm, cell, law):
    """At small strain, where delta is a tensor, in cells with one facet and with several."""
    scene = two_blocks(comm, cell, 2, 0.1)
    materials = vmdg.NeoHookean(E=1000.0, nu=0.49), vmdg.NeoHookean(E=3000.0, nu=0.2)
    found = []
    for each in (scene, separated(scene)):
        problem = joined(each, law, materials, kinematics="small")
        problem.step.begin(1.0, 1.0)
        found.append(np.sort(problem.stabilization[0].norm))
    assert found[1] == pytest.approx(found[0], rel=1e-12)


@pytest.mark.parametrize(
    ("law", "sliding"),
    [
        (vmdg.Bonded(), False),
        (vmdg.Debonding(1e12, 1e12), False),
        (vmdg.Debonding(1e12, 1e12), True),
    ],
    ids=["tie", "bond", "sliding"],
)
@EVERY_DEGREE
def test_coercive_where_surfaces_are_not_parallel(law, sliding, degree):
    """The teeth of a block over a wall, at 60 degrees: with half of its r, that of parallel facets,
    the form of a bond would be short of alpha."""
    wide, slope = 0.25, np.tan(np.pi / 3)

    def toothed(x):
        teeth = np.round(x[0] / wide) % 2
        x[1] += 0.01 + wide * slope * teeth * (1.0 - x[1])
        return x

    upper = moved(block("quadrilateral", (8, 2), [0.0, 0.0], [2.0, 1.0], 2), toothed)
    scene = apart([block("quadrilateral", (2, 1), [-0.1, -0.3], [2.1, 0.0], 1), upper])
    interface = vmdg.Interface(between=(1, 2), law=law, sliding=sliding)
    bodies = {1: vmdg.Rigid(), 2: vmdg.NeoHookean(E=1e3, nu=0.3)}
    kinematics = "finite" if sliding else "small"
    problem = vmdg.Problem(
        scene.mesh, scene.cell_tags, bodies, [interface], degree=degree, kinematics=kinematics
    )
    normals = problem.discretization.active[0].quadrature.outward[1]
    assert np.linalg.norm(normals, axis=1) == pytest.approx(2.0)
    assert_keeps(problem, margin(law, degree))


def assert_keeps(problem, alpha):
    """The bonded form keeps this fraction of the bulk energy."""
    K = dense(tangent_matrix(problem))
    weak = problem.discretization.weak_form
    w = ufl.TestFunction(problem.space), ufl.TrialFunction(problem.space)
    bulk = fem.assemble_matrix(weak.compile(weak.bulk_tangent(*w))).to_dense()
    lowest = np.linalg.eigvalsh(K - alpha * bulk)[0]
    assert lowest > -1e-11 * np.abs(K).max()
    assert np.abs(K - K.T).max() < 1e-12 * np.abs(K).max()


# Rates


# Runs


def test_opens_on_demand_elsewhere():
    """Facets of another interface open one after the other: pairs keep their history."""
    scene = stack("triangle", 3, 4, (1, 1))
    bond = vmdg.Interface(between=(1, 2), law=vmdg.Debonding(40.0, 0.2))
    cracks = vmdg.Interface(within=2, law=vmdg.Debonding(45.0, 0.2), activate="on-demand")
    body = vmdg.NeoHookean(E=1000.0, nu=0.3)
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, {1: body, 2: body}, [bond, cracks])
    problem.dirichlet(scene.facet_tags.find(11), 0.0)
    problem.dirichlet(scene.facet_tags.find(22), lambda t: (0.0, t))
    lost, opened = [], []
    for load in (0.02, 0.04, 0.06, 0.08, 0.1):
        vmdg.solve(problem, [load])
        lost.append(problem.state[0].softening.copy())
        opened.append(len(problem.state[1].weights))
    assert opened[0] < opened[-1]
    assert lost[-1].max() > 1.0
    assert (np.diff(lost, axis=0) >= 0).all()


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_output(cell, tmp_path):
    """Fields and values of facets of side 1."""
    scene = stack(cell, 2, 3, (1, 2))
    d = scene.mesh.geometry.dim
    law = vmdg.Debonding(20.0, 0.2, friction=0.3)
    first = joined(scene, law, SAME, {"frame": "corotating", "name": "bond"})
    first.dirichlet(scene.facet_tags.find(11), 0.0)
    move = np.array([0.5, 0.0, 1.0] if d == 3 else [0.5, 1.0])
    first.dirichlet(scene.facet_tags.find(22), lambda t: t * move)
    vmdg.solve(first, [0.04, 0.08])
    assert (first.state[0].softening > 0).any()
    with vmdg.FieldWriter(first, tmp_path / "fields") as writer:
        writer.write(first.t)
    state, means = first.state[0], facet_scalar(first, "bond", "traction")
    segments = first.discretization.active[0].facets.facets
    facets, where = np.unique(state.facet, return_inverse=True)
    assert len(facets) == len(np.unique(segments)) < len(segments)
    areas = np.bincount(where, state.weights)
    assert areas @ means == pytest.approx(state.weights @ scalar(first, "bond", "traction"))
    if d == 2:
        rows = vmdg.profile(first, "bond", "opening")
        assert [len(piece) for piece in rows] == [len(state.weights)]
        assert (np.diff(rows[0][:, 0]) > 0).all()


# Refusals


def with_interface(scene, interface=None, materials=SAME, **options):
    given = {"between": (1, 2), "law": vmdg.Bonded(), **(interface or {})}
    bodies = dict(enumerate(materials, start=1))
    return vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [vmdg.Interface(**given)], **options)


@pytest.mark.parametrize(
    ("interface", "options", "words"),
    [
        ({"traction_jump": True}, {}, "cannot have traction_jump=True"),
        ({"stabilization": lambda a, b, c: (a, b)}, {}, "stabilization= of its own"),
        ({"law": FRICTION, "activate": "on-demand"}, {}, "cannot open on demand"),
        ({}, {"periodic": vmdg.Periodic(gradient={"xx": 1.0})}, "combined with a periodic cell"),
    ],
    ids=["jump", "rule", "on demand", "periodic"],
)
def test_refused(interface, options, words):
    """What interfaces between meshes that do not match cannot have, in words."""
    with pytest.raises(ValueError, match="meshes do not match") as error:
        with_interface(stack("quadrilateral", 2, 3), interface, **options)
    assert words in str(error.value)


def test_refused_places():
    """Surfaces that do not meet, that are inside or given twice, and fluids."""
    scene = stack("quadrilateral", 2, 3)
    find = scene.facet_tags.find
    law = {"between": None, "law": vmdg.Bonded()}
    for surfaces, words in (
        ((find(11), find(22)), "opposite each other on 0 %"),
        ((find(12), find(12)), "in both of the surfaces"),
        ((find(12), find(99)), "has no facet on side 2"),
        ((find(12), np.array([0, 1, 2, 3, 4])), "lies inside the mesh"),
    ):
        with pytest.raises(ValueError, match=words):
            with_interface(scene, {**law, "surfaces": surfaces})
    for surfaces in (find(12), (find(12), 3.5), "both", (find(12),)):
        with pytest.raises(TypeError, match="surfaces"):
            vmdg.Interface(surfaces=surfaces, law=vmdg.Bonded())
    far = [
        block("quadrilateral", (2, 2), (0.0, -1.0), (2.0, 0.0), 1),
        block("quadrilateral", (3, 2), (0.0, 5.0), (2.0, 6.0), 2),
    ]
    with pytest.raises(ValueError, match=r"has no facet: .* units and origins"):
        with_interface(apart(far))


@pytest.mark.parametrize("what", ["traction", "pressure", "spring"])
def test_loads_opposite_another_body(what):
    """A load on facets of pairs would change the traction of the interface: where pairs stay it is
    refused, where they move there is a warning; other facets may be loaded."""
    scene = stack("quadrilateral", 2, 3)
    joined, free = (scene.facet_tags.find(tag) for tag in (12, 22))
    value = {"traction": (0.0, 1.0), "pressure": 1.0, "spring": 1.0}[what]
    problem = with_interface(scene, {"law": vmdg.Bonded()})
    getattr(problem, what)(free, value)
    with pytest.raises(ValueError, match=f"{what}: facet .* opposite the other side"):
        getattr(problem, what)(joined, value)
    problem = with_interface(scene, {"law": vmdg.Contact(), "sliding": True})
    getattr(problem, what)(free, value)
    with pytest.warns(vmdg.ModelWarning, match=f"{what}: a facet lies opposite"):
        getattr(problem, what)(joined, value)


@SEVERAL_RANKS
@pytest.mark.parametrize("by", ["tags", "surfaces"])
def test_ghosts_are_needed(comm, by):
    """A mesh with facet ghosts only is refused on every rank; with those of surfaces it is not."""
    scene = stack("triangle", 16, 24, (6, 6))
    x = scene.mesh.geometry.x[:, :2]
    cells = compat.geometry_dofmap(scene.mesh).astype(np.int64)
    if comm.rank > 0:
        x, cells = x[:0], cells[:0]
    facet_ghosts = compat.facet_ghost_partitioner(partitioner())
    for ghosts in (facet_ghosts, vmdg.meshes.cell_partitioner()):
        domain = ufl.Mesh(scene.mesh.ufl_domain().ufl_coordinate_element())
        mesh = create_mesh(comm, cells, x=x, e=domain, partitioner=ghosts)
        count = mesh.topology.index_map(2).size_local + mesh.topology.index_map(2).num_ghosts
        here = np.arange(count, dtype=np.int32)
        upper = compute_midpoints(mesh, 2, here)[:, 1] > 0
        given = {"between": (1, 2)}
        if by == "surfaces":
            mesh.topology.create_connectivity(1, 2)
            outer = exterior_facet_indices(mesh.topology)
            flat = outer[np.abs(compute_midpoints(mesh, 1, outer)[:, 1]) < 1e-9]
            above = upper[facet_cells(mesh)[flat, 0]]
            given = {"surfaces": (flat[~above], flat[above])}
        interface = vmdg.Interface(**given, law=vmdg.Bonded())
        bodies = dict(enumerate(SAME, start=1))
        arguments = mesh, meshtags(mesh, 2, here, np.int32(1) + upper), bodies, [interface]
        if ghosts is facet_ghosts:
            with pytest.raises(ValueError, match=r"ghosts: .*vmdg.meshes.cell_partitioner"):
                vmdg.Problem(*arguments)
    problem = vmdg.Problem(*arguments)
    assert global_sum(comm, problem.state[0].weights.sum()) == pytest.approx(2.0, rel=1e-13)


@pytest.mark.parametrize("cell", ["quadrilateral", "tetrahedron"])
def test_parts_on_several_ranks(comm, cell, tmp_path_factory):
    """Cells in the order of the parts, tags at the same places, on any number of ranks; and from a
    file."""
    found = []
    for where in (MPI.COMM_SELF, comm):
        scene = stack(cell, 3, 4, (2, 3), comm=where)
        mesh, dim = scene.mesh, scene.mesh.topology.dim
        owned = np.arange(mesh.topology.index_map(dim).size_local, dtype=np.int32)
        rows = [
            (int(number), int(tag), *np.round(middle, 9))
            for number, tag, middle in zip(
                compat.input_numbers(mesh),
                tags_of_cells(mesh, scene.cell_tags)[owned],
                compute_midpoints(mesh, dim, owned) + 0.0,
                strict=True,
            )
        ]
        facets = scene.facet_tags.indices
        facets = zip(scene.facet_tags.values, compute_midpoints(mesh, dim - 1, facets), strict=True)
        places = {(int(tag), *(np.round(x, 9) + 0.0)) for tag, x in facets}
        cells = sorted(row for mine in where.allgather(rows) for row in mine)
        found.append((cells, set().union(*where.allgather(places))))
    assert found[0] == found[1]
    path = Path(comm.bcast(str(tmp_path_factory.mktemp("parts")))) / "parts.xdmf"
    vmdg.meshes.write_mesh(scene, path)
    problem = with_interface(vmdg.meshes.read_mesh(path, comm))
    area = 2.0 ** (dim - 1)
    assert global_sum(comm, problem.state[0].weights.sum()) == pytest.approx(area, rel=1e-13)


def test_parts_put_together():
    """Tags and their names stay; what does not fit together is refused."""
    one, two = (rings("triangle", (4, 4), radii) for radii in (RADII, (3.0, 4.0, 5.0)))
    with pytest.raises(ValueError, match="cell tag 1 is in two parts"):
        apart([one, two])
    with pytest.raises(ValueError, match="several types and degrees"):
        apart([one, rings("quadrilateral", (4, 4), RADII)])
    low, high = (blocks(MPI.COMM_SELF, "triangle", (2, 2)) for _ in range(2))
    shifted = meshtags(high.mesh, 2, high.cell_tags.indices, high.cell_tags.values + 2)
    both = apart([low, (high.mesh, shifted, high.facet_tags)])
    assert both.cell_tags.names == {"left": 1, "right": 2}
    assert both.facet_tags.names == low.facet_tags.names
    for tag in (1, 4):
        found = compute_midpoints(both.mesh, 1, both.facet_tags.find(tag))
        given = compute_midpoints(low.mesh, 1, low.facet_tags.find(tag))
        assert len(found) == 2 * len(given)
        assert {*map(tuple, np.round(found, 9))} == {*map(tuple, np.round(given, 9))}
    for tag in (1, 2, 3, 4):
        assert len(both.cell_tags.find(tag)) == len(low.cell_tags.find((tag + 1) % 2 + 1))
    assert not len(apart([low._replace(facet_tags=None)]).facet_tags.values)
    renamed = NamedTags(shifted, {"left": 3})
    with pytest.raises(ValueError, match="'left' is tag 1 in one part and 3 in another"):
        apart([low, (high.mesh, renamed, high.facet_tags)])


def test_both_ways_to_give_it():
    """``surfaces=`` or ``between=``: the same pairs; with surfaces the first is side 1."""
    scene = stack("hexahedron", 2, 3, (1, 1))
    find = scene.facet_tags.find
    one = with_interface(scene)
    for sides in ((12, 21), (21, 12)):
        given = {"between": None, "surfaces": tuple(map(find, sides))}
        other = with_interface(scene, given)
        assert other.state[0].weights.sum() == pytest.approx(one.state[0].weights.sum())
        assert np.allclose(other.state[0].normal[:, 2], 1.0 if sides[0] == 12 else -1.0)
        assert "<side 1: the first>" in repr(other.interfaces[0])
    assert np.allclose(one.state[0].normal[:, 2], 1.0)
