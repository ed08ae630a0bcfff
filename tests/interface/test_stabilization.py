"""tau_s and delta against an integration of (21)-(23) that shares no code with the engine."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from dolfinx.mesh import entities_to_geometry
from support.checks import gather
from support.problems import MATERIALS, joined
from support.scenes import (
    DIMENSION,
    EVERY_CELL,
    deform,
    distort,
    two_blocks,
)

import vmdg
from vmdg import compat
from vmdg.meshes import blocks

SHEAR = np.array([[1.2, 0.3, 0.1], [-0.2, 0.9, 0.25], [0.15, -0.1, 1.1]])
HOMOGENEOUS = np.array([[1.15, 0.2, -0.1], [0.05, 0.9, 0.15], [0.1, -0.05, 1.1]])
FINITE_F = {"F = I": np.eye(3), "general F": HOMOGENEOUS}

# Rounding of a few hundred products and of the inverses of well-conditioned 3 x 3 matrices.
ROUNDING = 1e-12


# The oracle: numpy only, from the corners of a cell and the parameters of (86)


def acoustic_tensor(F, mu, lmbda):
    """A of (86) by hand: P = mu (F - F^-T) + lambda (J - 1) J F^-T."""
    d = len(F)
    full = np.eye(3)
    full[:d, :d] = F
    J, inverse, one = np.linalg.det(full), np.linalg.inv(full), np.eye(3)
    swapped = np.einsum("jk,li->ijkl", inverse, inverse)
    A = mu * np.einsum("ik,jl->ijkl", one, one)
    A += (mu - lmbda * (J - 1) * J) * swapped
    A += lmbda * (2 * J - 1) * J * np.einsum("ji,lk->ijkl", inverse, inverse)
    return A[:d, :d, :d, :d]


def gauss(n=6):
    """Gauss points on (0, 1)."""
    x, w = np.polynomial.legendre.leggauss(n)
    return (x + 1) / 2, w / 2


def box_points(d):
    x, w = gauss()
    points = np.stack(np.meshgrid(*[x] * d, indexing="ij"), axis=-1).reshape(-1, d)
    weights = np.prod(np.stack(np.meshgrid(*[w] * d, indexing="ij"), axis=-1), axis=-1).ravel()
    return points, weights


def simplex_points(d):
    """Gauss points of the unit simplex: the unit box collapsed (Duffy)."""
    box, weights = box_points(d)
    points, left = box.copy(), np.ones(len(box))
    for i in range(d):
        points[:, i] *= left
        weights = weights * left
        left = left * (1 - box[:, i])
    return points, weights


def simplex_bubble(corners, on_facet):
    """Gradients of d^d prod l_i over the corners of the facet, and the weights dV."""
    d = corners.shape[1]
    edges = (corners[1:] - corners[0]).T
    points, weights = simplex_points(d)
    gradients = np.linalg.inv(edges)
    gradients = np.vstack([-gradients.sum(axis=0), gradients])
    barycentric = np.column_stack([1 - points.sum(axis=1), points])
    total = np.zeros((len(points), d))
    for i in on_facet:
        others = [j for j in on_facet if j != i]
        total += np.prod(barycentric[:, others], axis=1)[:, None] * gradients[i]
    return d**d * total, weights * abs(np.linalg.det(edges))


def box_bubble(corners, on_facet):
    """Gradients of (distance from the far side) prod 4 x (1 - x), and the weights dV."""
    d = corners.shape[1]
    edges = np.column_stack([corners[2**i] - corners[0] for i in range(d)])
    reference = np.linalg.solve(edges, (corners - corners[0]).T).T
    assert np.allclose(reference, np.round(reference), atol=1e-12)  # a parallelepiped
    points, weights = box_points(d)
    facet = np.round(reference[on_facet])
    (normal,) = np.flatnonzero(np.ptp(facet, axis=0) == 0)
    at_one = facet[0, normal] == 1
    values = 4 * points * (1 - points)
    slopes = 4 - 8 * points
    values[:, normal] = points[:, normal] if at_one else 1 - points[:, normal]
    slopes[:, normal] = 1 if at_one else -1
    gradient = np.empty_like(points)
    for i in range(d):
        gradient[:, i] = slopes[:, i] * np.prod(np.delete(values, i, axis=1), axis=1)
    return gradient @ np.linalg.inv(edges), weights * abs(np.linalg.det(edges))


def facet_measure(corners):
    edges = corners[1:3] - corners[0]
    if corners.shape[1] == 2:
        return np.linalg.norm(edges)
    area = np.linalg.norm(np.cross(*edges))
    return area / 2 if len(corners) == 3 else area


# int_gamma b dA / meas(gamma): of 4 x (1 - x), of 27 l1 l2 l3, of a product of two of the first.
MEAN_BUBBLE = {"triangle": 2 / 3, "quadrilateral": 2 / 3, "tetrahedron": 0.45, "hexahedron": 4 / 9}


def oracle_tau(cell, corners, on_facet, A):
    """tau_a of (21)-(22) of one cell."""
    bubble = simplex_bubble if cell in ("triangle", "tetrahedron") else box_bubble
    gradient, dV = bubble(corners, on_facet)
    B = np.einsum("q,qj,ijkl,ql->ik", dV, gradient, A, gradient)
    area = facet_measure(corners[on_facet])
    return (MEAN_BUBBLE[cell] * area) ** 2 / area * np.linalg.inv(B)


def oracle_sides(problem, cell, F):
    """tau_1 and tau_2 of every facet of this rank, (2, nf, d, d)."""
    mesh, d = problem.mesh, DIMENSION[cell]
    facets = problem.discretization.active[0].facets
    result = np.empty((2, len(facets.facets), d, d))
    x, dofmap = mesh.geometry.x[:, :d], compat.geometry_dofmap(mesh)
    for f, cells in enumerate(facets.cells):
        shared = np.intersect1d(*dofmap[cells])
        for a, number in enumerate(cells):
            parameters = MATERIALS[facets.tags[f, a] - 1].parameters
            on_facet = np.flatnonzero(np.isin(dofmap[number], shared))
            A = acoustic_tensor(F[:d, :d], **parameters)
            result[a, f] = oracle_tau(cell, x[dofmap[number]], on_facet, A)
    return result


def deviation(comm, value, expected):
    """Largest difference relative to the largest entry, over all ranks."""
    value, expected = gather(comm, value), gather(comm, expected)
    assert value.shape == expected.shape
    assert len(value) > 0
    return np.abs(value - expected).max() / np.abs(expected).max()


# The engine


@EVERY_CELL
@pytest.mark.parametrize("F", FINITE_F.values(), ids=FINITE_F.keys())
def test_against_independent_integration(comm, cell, F):
    """(21)-(23) on sheared cells with different materials, tau_a, tau_s, delta and norm."""
    scene = two_blocks(comm, cell)
    deform(scene.mesh, SHEAR)
    d, safety, seen = DIMENSION[cell], 3.0, []

    def watch(tau1, tau2, context):
        seen.append((tau1, tau2, context))
        return tau1, tau2

    problem = joined(scene, vmdg.Bonded(), interface={"safety": safety})
    watched = joined(scene, vmdg.Bonded(), interface={"stabilization": watch})
    for each in (problem, watched):
        each.u.interpolate(lambda x: (F - np.eye(3))[:d, :d] @ x[:d])
        each.u.x.scatter_forward()
        each.discretization.update_stabilization()

    tau1, tau2 = oracle_sides(problem, cell, F)
    tau_s = np.linalg.inv(tau1 + tau2)
    got = problem.stabilization[0]
    assert deviation(comm, got.tau, safety * tau_s) < ROUNDING
    assert deviation(comm, got.delta[:, 0], tau_s @ tau1) < ROUNDING
    assert deviation(comm, got.delta[:, 1], tau_s @ tau2) < ROUNDING
    assert deviation(comm, got.delta.sum(axis=1), np.tile(np.eye(d), (len(got.tau), 1, 1))) < (
        ROUNDING
    )
    assert deviation(comm, got.norm, safety * np.sqrt((tau_s**2).sum(axis=(1, 2)))) < ROUNDING
    assert deviation(comm, seen[-1][0], tau1) < ROUNDING
    assert deviation(comm, seen[-1][1], tau2) < ROUNDING


@EVERY_CELL
def test_safety_and_norm(comm, cell):
    """safety multiplies tau_s, not delta; the spectral norm is the largest singular value."""
    scene = two_blocks(comm, cell, distortion=0.05)

    def of(**options):
        return joined(scene, vmdg.Bonded(), interface=options).stabilization[0]

    one, four, spectral = of(safety=1.0), of(safety=4.0), of(safety=1.0, norm="spectral")
    assert deviation(comm, four.tau, 4 * one.tau) < ROUNDING
    assert deviation(comm, four.norm, 4 * one.norm) < ROUNDING
    assert deviation(comm, four.delta, one.delta) < ROUNDING
    assert (four.safety == 4).all()
    largest = np.linalg.svd(one.tau, compute_uv=False).max(axis=1, initial=0.0)
    assert deviation(comm, spectral.norm, largest) < ROUNDING
    assert (gather(comm, one.norm - spectral.norm) > 0).all()


def test_user_stabilization_is_used_as_is(comm):
    """What the user's callable returns is tau_s and delta_1; safety does not touch it."""
    scene = two_blocks(comm, "triangle", n=2, distortion=0.03)
    rng = np.random.default_rng(comm.rank)
    given = {}

    def stabilization(tau1, tau2, context):
        nf = len(context.facets)
        assert tau1.shape == tau2.shape == (nf, 2, 2)
        given["tau"], given["delta1"] = 1e3 * rng.random((nf, 2, 2)), rng.random((nf, 2, 2))
        given["context"] = context
        return given["tau"], given["delta1"]

    options = {"safety": 7.0, "stabilization": stabilization}
    problem = joined(scene, vmdg.Bonded(), interface=options)
    got, context = problem.stabilization[0], given["context"]
    length = gather(comm, context.area)
    N = gather(comm, context.N)
    assert np.array_equal(got.tau, given["tau"])
    assert np.array_equal(got.delta[:, 0], given["delta1"])
    assert np.array_equal(got.delta[:, 1], np.eye(2) - given["delta1"])
    assert context.u is problem.u
    assert context.cells.shape == context.local_facets.shape == (len(context.facets), 2)
    assert len(length) == 2
    assert np.linalg.norm(N, axis=1) == pytest.approx(np.ones(2), rel=1e-14)
    assert (N[:, 0] > 0.9).all()  # from block 1 to block 2


def test_mean_normal_of_curved_facets():
    """int N dA of a facet is its chord, turned by a right angle, whatever the curve between."""
    scene, given = blocks(MPI.COMM_SELF, "triangle", (2, 2, 2), order=2), []
    distort(scene.mesh, 0.03)

    def stabilization(tau1, tau2, context):
        given.append(context)
        return 1e4 * np.eye(2) + 0 * tau1, 0.5 * np.eye(2) + 0 * tau1

    joined(scene, vmdg.Bonded(), interface={"stabilization": stabilization}, degree=2)
    x = scene.mesh.geometry.x[entities_to_geometry(scene.mesh, 1, given[0].facets), :2]
    chord = x[:, 1] - x[:, 0]
    assert np.abs(np.linalg.det(np.stack([chord, x[:, 2] - x[:, 0]], axis=1))).min() > 1e-3
    assert np.abs(np.einsum("fi,fi->f", given[0].N, chord)).max() < 1e-12


WRONG_SHAPES = {
    "tau_s": (lambda tau: (tau[:, 0], tau), r"returned tau_s of shape \(\d+, 2\), expected"),
    "delta1": (lambda tau: (tau, tau[:, :1]), r"returned delta1 of shape \(\d+, 1, 2\), expected"),
}


@pytest.mark.parametrize("name", WRONG_SHAPES)
def test_user_stabilization_of_wrong_shape(name):
    """A callable that returns another shape is refused by the name of what it got wrong."""
    build, message = WRONG_SHAPES[name]
    scene = two_blocks(MPI.COMM_SELF, "triangle", n=2)
    with pytest.raises(ValueError, match=message):
        joined(scene, vmdg.Bonded(), interface={"stabilization": lambda tau1, tau2, _: build(tau1)})


def test_compliance_follows_the_penalty(comm):
    """C = d zeta/dT_tr of the last return map with another r is that of a return map with this r.

    The first tangent of a step has it: with C of a smaller r the bond would soften far too fast.
    """
    scene = two_blocks(comm, "quadrilateral")
    law = vmdg.Debonding(strength=5.0, critical_gap=0.1, friction=0.4)
    problem = joined(scene, law, interface={"frame": "reference"})
    # Points at the lower end open, those at the upper end are pressed and slide.
    problem.u.interpolate(
        lambda x: np.where(x[0] > 0.5, [0.01 - 0.02 * x[1], 0.02 + 0 * x[1]], 0.0)
    )
    problem.step.assemble_residual()
    active = problem.discretization.active[0]
    start, end, r = active.history, active.values.update, active.stabilization.norm
    assert gather(comm, active.values.compliance).any()
    active.apply(active.stabilization.with_norm(3 * r))
    more = 3 * r[active.quadrature.facet]
    trial = end.traction + more[:, None] * (end.gap - start.gap)
    again = law.return_map(trial, active.quadrature.normal, start.gap, start.softening, more)
    assert again.gap == pytest.approx(end.gap, abs=1e-14)
    assert active.values.compliance == pytest.approx(again.tangent, rel=1e-9, abs=1e-15)
