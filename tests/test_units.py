"""Results do not depend on the units of length, force and load factor.

Lengths times 2^a and stresses times 2^b leave the digits of every number as they are: what has the
unit mm^p MPa^q is 2^(p a + q b) times as large, to the last bit.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from mpi4py import MPI

import numpy as np
import pytest
from numpy.typing import NDArray
from support.checks import tangent_matrix
from support.problems import set_displacement

import vmdg
from vmdg.assembly.means import lattice_of
from vmdg.base.tables import rounded
from vmdg.checks.model import check_model
from vmdg.domain.lattice import Lattice
from vmdg.linear.ksp import GMRES_GAMG, GMRES_LDLT, LU
from vmdg.linear.system import System
from vmdg.meshes import TaggedMesh, blocks, fibre_cell
from vmdg.output.profile import profile

pytestmark = pytest.mark.skipif(
    MPI.COMM_WORLD.size > 1, reason="partitions of a mesh differ from time to time"
)

#: Powers of two of the units of length and stress.
A, B = -30, 7

SOFT, STIFF = 2000.0, 5000.0


class Units(NamedTuple):
    """How many units of length and of stress 1 mm and 1 MPa are."""

    L: float
    S: float


Made = tuple[TaggedMesh, vmdg.Problem]
Scene = Callable[[Units, MPI.Comm], Made]


def bodies(S: float) -> dict[int, vmdg.Material]:
    return {i: vmdg.NeoHookean(E=E * S, nu=0.3) for i, E in enumerate((STIFF, SOFT), start=1)}


def two(
    units: Units, comm: MPI.Comm, cell: str, law: vmdg.Law, inner: dict | None = None, **options
) -> Made:
    """Two blocks with an inclined interface, held on the left."""
    L, S = units
    tagged = blocks(comm, cell, (2, 2, 1), 2 * L, L, L, (0.9 * L, 1.1 * L))
    interface = vmdg.Interface(**({"between": (1, 2), "law": law, "name": "bond"} | (inner or {})))
    if tagged.mesh.geometry.dim == 2 and "symmetry" not in options:
        options["thickness"] = 0.4 * L
    options = {"materials": bodies(S)} | options
    problem = vmdg.Problem(tagged.mesh, tagged.cell_tags, interfaces=[interface], **options)
    if not options.get("symmetry"):
        problem.dirichlet(tagged.facet_tags.find("left"), 0.0)
    return tagged, problem


def tied(units: Units, comm: MPI.Comm) -> Made:
    """A tie of an orthotropic sheet and one that swells, in plane stress."""
    S = units.S
    ply = vmdg.Orthotropic((9e3 * S, 3e3 * S, 3e3 * S), (0.3,) * 3, (1e3 * S,) * 3, angle=30.0)
    return two(
        units,
        comm,
        "quadrilateral",
        vmdg.Bonded(),
        materials={1: ply, 2: bodies(S)[2]},
        eigenstrain={2: lambda t: 0.01 * t},
        plane="stress",
    )


def loaded(units: Units, comm: MPI.Comm) -> Made:
    """Debonding with friction under all kinds of loads."""
    L, S = units
    law = vmdg.Debonding(30 * S, 0.1 * L, friction=0.4, viscosity=20 * S / L)
    tagged, problem = two(units, comm, "triangle", law)
    top, bottom = (tagged.facet_tags.find(side) for side in ("top", "bottom"))
    problem.pressure(top, lambda x, t: t * S * (1 + x[0] / L))
    problem.pressure("bond", lambda t: 2 * S * t, share=lambda g: np.clip(9 * g / L, 0, 1))
    problem.traction(bottom, (0.3 * S, 0.2 * S))
    problem.spring(bottom, [[5 * S / L, S / L], [S / L, 7 * S / L]])
    problem.body_force((0.1 * S / L, 0.2 * S / L), tag=2)
    corner = np.array([[2 * L], [L], [0]])
    problem.point_load(lambda x: (abs(x - corner) < 1e-9 * L).all(axis=0), 3 * S * L**2, "y")
    return tagged, problem


def solid(units: Units, comm: MPI.Comm) -> Made:
    """Mixed modes, a bond that unloads to the origin and is damaged at one end."""
    L, S = units
    law = vmdg.MixedModeDebonding(
        30 * S,
        40 * S,
        1.5 * S * L,
        4 * S * L,
        0.3,
        criterion="BK",
        exponent=2.0,
        unloading="secant",
    )
    damage = lambda x: np.where(x[1] < 0.5 * L, 0.4, 0.0)  # noqa: E731
    return two(units, comm, "hexahedron", law, {"initial_damage": damage})


def thick(units: Units, comm: MPI.Comm) -> Made:
    """Mean dilatation of a body that is hardly compressible."""
    L, S = units
    rubber = vmdg.NeoHookean(E=STIFF * S, nu=0.499)
    law = vmdg.ExponentialDebonding(30 * S, 2 * S * L, 0.3)
    materials = {1: rubber, 2: bodies(S)[2]}
    return two(units, comm, "quadrilateral", law, materials=materials, volumetric="mean")


def plate(units: Units, comm: MPI.Comm) -> Made:
    """Small strain and a rigid face that tilts; strengths scatter."""
    L, S = units
    law = vmdg.Debonding(vmdg.Weibull(30 * S, 6.0, seed=2), 0.1 * L, 0.4, unloading="secant")
    tagged, problem = two(units, comm, "quadrilateral", law, kinematics="small")
    right = tagged.facet_tags.find("right")
    problem.rigid_face(right, tilts=True, at=(2 * L, 0.25 * L), force=(3 * S * L**2, S * L**2))
    return tagged, problem


def revolved(units: Units, comm: MPI.Comm) -> Made:
    L, S = units
    law = vmdg.TrapezoidalDebonding(30 * S, 0.03 * L, 0.1 * L, friction=0.4)
    return two(units, comm, "triangle", law, symmetry="axisymmetric")


def cracking(units: Units, comm: MPI.Comm) -> Made:
    """Facets that open on demand, in generalized plane strain."""
    L, S = units
    law = vmdg.Debonding(30 * S, 0.1 * L)
    inner, plane = {"activate": "on-demand"}, vmdg.GeneralizedStrain()
    return two(units, comm, "quadrilateral", law, inner, plane=plane)


def cell(units: Units, comm: MPI.Comm) -> Made:
    L, S = units
    tagged = fibre_cell(3, 0.3, 1, size=L, comm=comm)
    periodic = vmdg.Periodic(gradient=lambda t: np.eye(2) + 0.01 * t * np.eye(2)[::-1])
    law = vmdg.Debonding(30 * S, 0.1 * L, 0.4)
    inner = vmdg.Interface(between=(1, 2), law=law, name="bond")
    materials = bodies(S)
    options = {"periodic": periodic, "thickness": 0.4 * L}
    return tagged, vmdg.Problem(tagged.mesh, tagged.cell_tags, materials, [inner], **options)


SCENES = (tied, loaded, solid, thick, plate, revolved, cracking, cell)


def move(problem: vmdg.Problem, tagged: TaggedMesh, L: float, size: float) -> None:
    """A rough deformation of both bodies, the second one away from the first and along it."""
    d = problem.mesh.geometry.dim
    push = np.array([0.03, 0.06, -0.02])[:d, None]

    def field(x: NDArray, tag: int) -> NDArray:
        x = x[:d] / L
        # zero where displacements are prescribed or have images
        lattice = lattice_of(problem.discretization.means)
        bump = x[0] if lattice is None else 4 * np.prod(x * (1 - x), axis=0)
        return size * L * bump * (0.02 * np.sin(3 * x[::-1] + tag) + (tag == 2) * push)

    set_displacement(problem.u, tagged.cell_tags, field)


Found = dict[str, tuple[NDArray, int, int]]


def results(scene: Scene, units: Units, comm: MPI.Comm) -> Found:
    """What two steps to given displacements leave: value, powers of mm and of MPa."""
    tagged, problem = scene(units, comm)
    found: Found = {}

    def add(name: str, value: object, length: int, stress: int) -> None:
        found[name] = np.array(value, dtype=float), length, stress

    for step, size in enumerate((0.6, 1.0), start=1):
        problem.step.begin(float(step), 1.0)
        move(problem, tagged, units.L, size)
        add(f"residual {step}", problem.step.assemble_residual(), 2, 1)
        if problem.step.activation:
            marks = problem.step.activation.utilization()
            for facets in marks.facets.values():
                add(f"utilization {step}", facets, 0, 0)
            problem.step.commit()
            add(f"opened {step}", problem.step.open_facets(marks), 0, 0)
            problem.step.begin(step + 0.5, 1.0)
            problem.step.assemble_residual()
        matrix = tangent_matrix(problem)
        add(f"tangent {step}", matrix.getValuesCSR()[2], 1, 1)
        matrix.destroy()
        problem.step.commit()
    for one in problem.stabilization:
        add("tau", one.tau, -1, 1)
        add("safety", one.safety, 0, 0)
        add("delta", one.delta, 0, 0)
        add("delta_s", one.delta_s, 1, -1)
    for one in problem.state:
        units_of = {"points": (1, 0), "opening": (1, 0), "gap": (1, 0), "softening": (0, 1)}
        units_of |= {"traction": (0, 1), "mode": (0, 0), "rotation": (0, 0), "normal": (0, 0)}
        for name, powers in units_of.items():
            add(name, getattr(one, name), *powers)
    for name, value in vars(problem.energy()).items():
        add(f"energy {name}", value, 3, 1)
    add("stress", problem.stress().x.array, 0, 1)
    add("fine scale", problem.fine_scale("bond"), 1, 0)
    add("debonded", problem.debonded(), 0, 0)
    rigid = problem.loading.rigid
    if rigid:
        # Of motions of one face; which of them make its columns may be a matter of rounding.
        add("rigid", rigid.columns.T @ rigid.columns, 0, 0)
    if problem.mesh.geometry.dim == 2:
        for rows in profile(problem, "bond", "opening", "x" if problem.step.activation else "arc"):
            add("profile", rows, 1, 0)
    return found


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_results(comm, scene):
    """In units that differ by powers of two to the last bit; in m and Pa to rounding."""
    reference = results(scene, Units(1.0, 1.0), comm)
    found = results(scene, Units(2.0**A, 2.0**B), comm)
    assert found.keys() == reference.keys()
    for name, (value, p, q) in found.items():
        digits = np.ldexp(value, -p * A - q * B)
        np.testing.assert_array_equal(digits, reference[name][0], name)
    for name, (value, p, q) in results(scene, Units(1e-3, 1e6), comm).items():
        expected = reference[name][0]
        allowed = 1e-9 * np.abs(expected).max(initial=0.0)
        np.testing.assert_allclose(value / 1e-3**p / 1e6**q, expected, 0, allowed, err_msg=name)


@pytest.mark.parametrize("petsc", [LU, GMRES_GAMG, GMRES_LDLT], ids=["lu", "gamg", "lagged"])
def test_linear_systems(comm, petsc):
    """Solutions and iterations, also where stiffnesses are far from 1."""

    def solved(units: Units) -> tuple[NDArray, int]:
        L, S = units
        law = vmdg.Debonding(30 * S, 0.1 * L, friction=0.4)
        tagged, problem = two(units, comm, "hexahedron", law)
        for t in (1.0, 2.0):
            problem.step.begin(t, 1.0)
            move(problem, tagged, L, t / 2)
            forces = -problem.step.assemble_residual()
            if t == 1.0:
                problem.step.commit()
        system = System(problem, petsc)
        found = np.array(system.solve([forces], [np.zeros_like(forces)], 1e-9))
        iterations = system.iterations
        system.free()
        return found / L, iterations

    expected, iterations = solved(Units(1.0, 1.0))
    for a, b in ((-20, -41), (20, 40)):
        found = solved(Units(2.0**a, 2.0**b))
        assert found[1] == iterations
        np.testing.assert_array_equal(found[0], expected)


def test_run_goes_on_in_any_unit(comm, out):
    """Checks before a run, the length of a crack, and checkpoints."""
    rows = []
    for name, units in (("mm", Units(1.0, 1.0)), ("small", Units(2.0**-30, 2.0**8))):
        tagged, problem = loaded(units, comm)
        crack = vmdg.CrackGrowth(problem, "bond")
        assert not check_model(problem, np.array([1.0]))
        problem.step.begin(1.0, 1.0)
        move(problem, tagged, units.L, 1.0)
        problem.step.assemble_residual(1.0)
        problem.step.commit()
        rows.append(np.array(list(crack().values())) / (units.L * np.array([1, 1, *[units.S] * 3])))
        vmdg.write_checkpoint(problem, out / name)
        again = loaded(units, comm)[1]
        vmdg.read_checkpoint(again, out / name)
        np.testing.assert_array_equal(again.u.x.array, problem.u.x.array)
    np.testing.assert_array_equal(*rows)
    assert rows[0][0] > 0


@pytest.mark.parametrize("kinematics", ["small", pytest.param("finite", marks=pytest.mark.long)])
def test_load_factor(comm, kinematics):
    """A path along which points break one by one, to the last bit."""
    law = vmdg.Debonding(vmdg.Weibull(30.0, 6.0, seed=2), 0.02, unloading="secant")

    def path(factor: float) -> NDArray:
        tagged, problem = two(Units(1.0, 1.0), comm, "quadrilateral", law, kinematics=kinematics)
        right = tagged.facet_tags.find("right")
        problem.dirichlet(right, lambda t: (t / factor, 0.0))
        rows = []
        loads = factor * np.linspace(0.01, 0.04, 4)
        vmdg.solve(problem, loads, monitor=lambda p: rows.append([p.t / factor, *p.u.x.array]))
        return np.array(rows)

    expected = path(1.0)
    assert len(expected) > 6
    for power in (-9, 3, 40):
        np.testing.assert_array_equal(path(2.0**power), expected)


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_what_is_refused(comm, size):
    """Whatever the unit: an image that is missing, a stiffness that is not symmetric."""
    line = np.array([[[0.0, 0.0], [0.0, size]]])
    with pytest.raises(ValueError, match="has no image at"):
        Lattice(size * np.eye(2), np.zeros(2)).images(line)
    tagged, problem = tied(Units(1.0, 1.0), comm)
    with pytest.raises(ValueError, match="or a symmetric matrix"):
        problem.spring(tagged.facet_tags.find("top"), size * np.array([[1.0, 0.1], [0.0, 1.0]]))


def test_numbers_in_messages():
    """Six digits of the largest one."""
    assert rounded([1.23456789e-9, 2e-17]) == [1.23457e-9, 0.0]
    assert rounded([[0.5, 0.25], [123456789.0, 0.0]]) == [[0.0, 0.0], [123457000.0, 0.0]]
    assert rounded([0.0, 0.0]) == [0.0, 0.0]
