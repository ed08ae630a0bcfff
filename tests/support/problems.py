"""Problems of two bodies: joined, opened, sheared, pressed, turned, partly damaged."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import MeshTags
from numpy.typing import NDArray

import vmdg
from support.checks import gather
from support.scenes import DIMENSION, LEFT, RIGHT, tag_cells, two_blocks, unit_box
from vmdg.meshes import TaggedMesh, blocks

#: Two different materials, and the two laws; the softening is far below every penalty here.
MATERIALS = (vmdg.NeoHookean(E=5000.0, nu=0.25), vmdg.NeoHookean(E=2000.0, nu=0.35))
SAME = (vmdg.NeoHookean(E=5000.0, nu=0.25),) * 2
STRONG = vmdg.Debonding(strength=1e5, critical_gap=1e3)
WEAK = vmdg.Debonding(strength=20.0, critical_gap=0.05)
FRICTION = vmdg.Debonding(strength=50.0, critical_gap=0.2, friction=0.5)
PRECISE = vmdg.SolveOptions(relative_tolerance=1e-12)
STRETCH = np.array([[0.06, 0.03, -0.02], [0.02, -0.03, 0.04], [-0.03, 0.02, 0.05]])
PUSH = np.array([0.03, 0.008, -0.006])
#: Means of the gradient, of as many as a body has.
MEANS = np.array([0.03, 0.01, -0.02, -0.02, 0.015, 0.01, 0.02, -0.01, 0.02])


def joined(
    scene: TaggedMesh,
    law: vmdg.Law,
    materials: Sequence[vmdg.Material] = MATERIALS,
    interface: Mapping | None = None,
    **options,
) -> vmdg.Problem:
    """Problem of two bodies and their interface; ``interface`` are further options of it."""
    return vmdg.Problem(
        scene.mesh,
        scene.cell_tags,
        dict(enumerate(materials, start=1)),
        [vmdg.Interface(law=law, **{"between": (1, 2), "frame": "reference", **(interface or {})})],
        **options,
    )


def of_two(
    scene: TaggedMesh,
    law: vmdg.Law,
    materials: Sequence[vmdg.Material],
    interface: Mapping | None = None,
    **options,
) -> vmdg.Problem:
    """Problem of two bodies and their interface, whose frame is that of the default."""
    bond = vmdg.Interface(between=(1, 2), law=law, **(interface or {}))
    bodies = dict(enumerate(materials, start=1))
    return vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [bond], **options)


def couple(
    scene: TaggedMesh, law: vmdg.Law, materials: Sequence[vmdg.Material] = SAME, **options
) -> vmdg.Problem:
    """Problem of two blocks; ``options`` are those of their interface, turning by default."""
    return joined(scene, law, materials, {"frame": "corotating", **options})


def revolved(
    scene: TaggedMesh,
    law: vmdg.Law,
    materials: Sequence[vmdg.Material] = MATERIALS,
    interface: Mapping | None = None,
    **options,
) -> vmdg.Problem:
    """Axisymmetric problem of two bodies; ``interface`` are further options of what joins them."""
    turning = {"frame": "corotating", **(interface or {})}
    return joined(scene, law, materials, turning, symmetry="axisymmetric", **options)


def hold(problem: vmdg.Problem, scene: TaggedMesh, *tags: int, component: str) -> None:
    """Prescribe zero for a component on surfaces."""
    for tag in tags:
        problem.dirichlet(scene.facet_tags.find(tag), 0.0, component)


def driven(
    comm: MPI.Comm,
    cell: str,
    law: vmdg.Law,
    path: Callable[[float], tuple[Sequence[float], float]],
    n: int = 1,
    materials: Sequence[vmdg.Material] = SAME,
    **options,
) -> tuple[vmdg.Problem, TaggedMesh]:
    """Blocks with rigid ends: the left one turns, the right one moves and turns.

    ``path`` gives the displacement of the right end before it turns [mm] and the angle; ``options``
    are those of the interface.
    """
    d = DIMENSION[cell]
    scene = blocks(comm, cell, (n, n, n))
    problem = couple(scene, law, materials, **options)

    def left(X, t):
        return turned(X, np.zeros(d), path(t)[1])

    def right(X, t):
        move, angle = path(t)
        return turned(X, np.asarray(move, dtype=float), angle)

    problem.dirichlet(scene.facet_tags.find(LEFT), left)
    problem.dirichlet(scene.facet_tags.find(RIGHT), right)
    return problem, scene


def pressed(comm, cell: str, law: vmdg.Law, n: int = 3, opening: float = -0.01) -> vmdg.Problem:
    """Two blocks pressed together by .01 t, or opened, and sheared by .04 t mm."""
    scene = two_blocks(comm, cell, n)
    problem = couple(scene, law, MATERIALS)
    d = scene.mesh.geometry.dim
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    move = np.array([opening, 0.04, 0.0][:d])
    problem.dirichlet(scene.facet_tags.find(2), lambda t: t * move)
    return problem


def pulled(comm, law: vmdg.Law = WEAK, n: int = 2) -> vmdg.Problem:
    """Two squares of :data:`MATERIALS`, the left one held, the right one pulled by t [mm]."""
    scene = two_blocks(comm, "quadrilateral", n)
    problem = joined(scene, law)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: (t, 0.0))
    return problem


def set_displacement(u: fem.Function, tags: MeshTags, field: Callable[[NDArray, int], NDArray]):
    """Interpolate ``field(x, tag)`` (d, n) on the cells of every tag."""
    for tag in np.unique(tags.values):
        u.interpolate(lambda x, tag=tag: field(x, tag), tags.find(tag))
    u.x.scatter_forward()


def displace(problem, scene, factor: float) -> None:
    """A rough deformation of both blocks, and side 2 away from side 1, more so at the top."""
    d = problem.mesh.geometry.dim

    def field(x, tag):
        u = factor * STRETCH[:d, :d] @ x[:d] + 0.01 * np.sin(3 * x[:d][::-1] + tag)
        if tag == 2:
            u += factor * np.outer(PUSH[:d], x[:d].sum(axis=0))
        return u

    set_displacement(problem.u, scene.cell_tags, field)
    means = problem.discretization.means
    if means is not None:
        problem.u.x.array[means.dofs] = factor * means.length * MEANS[: len(means.dofs)]


def rotation(d: int, angle: float) -> NDArray:
    """Rotation by ``angle``, in the plane or about the axis (2, -1, 2)/3."""
    if d == 2:
        c, s = np.cos(angle), np.sin(angle)
        return np.array([[c, -s], [s, c]])
    axis = np.array([2.0, -1.0, 2.0]) / 3
    W = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return np.eye(3) + np.sin(angle) * W + (1 - np.cos(angle)) * W @ W


def turned(X: NDArray, move: NDArray, angle: float) -> NDArray:
    """Displacement (d, n) of points X (3, n) that move by ``move`` (d,) and then turn."""
    d = len(move)
    return rotation(d, angle) @ (X[:d] + move[:, None]) - X[:d]


def put(problem: vmdg.Problem, scene: TaggedMesh, move: Sequence[float], angle: float) -> None:
    """Set a displacement: bend both blocks a little, move block 2 by ``move``, turn everything."""
    d = scene.mesh.geometry.dim
    waves = np.array([[2.0, 1.0, 0.5], [-1.0, 2.0, 1.5], [0.7, -1.0, 2.0]])[:d, :d]

    def field(x, tag):
        bent = x.copy()
        bent[:d] += 0.004 * np.sin(waves @ x[:d] + np.arange(1, d + 1)[:, None])
        bent[:d] += (tag == 2) * np.asarray(move)[:d, None]
        return rotation(d, angle) @ bent[:d] - x[:d]

    set_displacement(problem.u, scene.cell_tags, field)


def user_energy(F, parameters):
    """Eq. (86) as a user would write it."""
    J = ufl.det(F)
    return (
        parameters["mu"] / 2 * (ufl.tr(F.T * F) - 3 - 2 * ufl.ln(J))
        + parameters["lmbda"] / 2 * (J - 1) ** 2
    )


def through(problem: vmdg.Problem, *motions: Callable[[], None]) -> vmdg.Problem:
    """Steps that end in these displacements, without equilibrium; the last is not committed."""
    for t, move in enumerate(motions, start=1):
        if t > 1:
            problem.step.commit()
        problem.step.begin(t, 1.0)
        move()
        problem.step.assemble_residual()
    return problem


def partly_damaged(comm, cell: str, degree: int, **options):
    """Second step of a state in which some points were damaged and go on, and others are whole.

    ``interface`` are options of the bond, ``loads`` is called with problem and scene.
    """
    options["degree"] = degree
    load = options.pop("loads", lambda problem, scene: None)
    # the probe must have the r of the problem, whose H is another
    fixed = {"safety": 4.0, "frame": options.pop("frame", "reference"), "name": "bond"}
    fixed |= options.pop("interface", {})
    if options.get("periodic"):
        mesh = unit_box(comm, cell, 2)
        scene = TaggedMesh(
            mesh, tag_cells(mesh, {1: lambda x: x[0] < 0.5, 2: lambda x: x[0] > 0.5}), None
        )
        # the bodies also meet on the boundary
        fixed |= {"between": None, "facets": lambda x: np.isclose(x[0], 0.5)}
    else:
        scene = two_blocks(comm, cell, n=2 if DIMENSION[cell] == 2 else 1, distortion=0.05)
    if options.get("symmetry"):
        scene.mesh.geometry.x[:, 0] += 0.5
    probe = joined(scene, STRONG, interface=fixed, **options)
    load(probe, scene)
    displace(probe, scene, 1.0)
    probe.step.assemble_residual(hold=True)
    sizes = np.sort(np.linalg.norm(gather(comm, probe.state[0].traction), axis=1))
    # Strength inside the widest gap between two points, near its upper end: no point is at a
    # switch, and the second step, a little further, turns no whole point into a damaged one.
    widest = np.argmax(np.diff(sizes))
    strength = sizes[widest] + 0.8 * (sizes[widest + 1] - sizes[widest])
    # H = 1000 MPa/mm, below every r here; no point is near separation at these openings.
    law = vmdg.Debonding(strength=strength, critical_gap=strength / 1000.0)
    problem = joined(scene, law, interface=fixed, **options)
    load(problem, scene)
    return through(problem, *(lambda s=s: displace(problem, scene, s) for s in (1.0, 1.02)))
