"""Bars between rigid grips, weak links that know nothing of each other; order statistics."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI

import numpy as np
from dolfinx.mesh import locate_entities_boundary

import vmdg
from vmdg.meshes import distribute, model


def bundle(
    comm: MPI.Comm,
    strengths: np.ndarray,
    critical_gap: float,
    way: Callable[[float], float] = lambda t: t,
) -> tuple[vmdg.Problem, Callable[[vmdg.Problem], dict[str, float]]]:
    """Bars between rigid grips, each of two halves that are bonded; the force on the grip.

    The grip moves as far as an unbroken bar bears 10 MPa times the way.
    """
    length, width, E = 1.0, 0.05, 1000.0
    with model("bundle") as g:
        halves = [[], []]
        for place in range(len(strengths)):
            boxes = [
                (2, g.occ.addRectangle(x, 2 * place * width, 0, length, width))
                for x in (0.0, length)
            ]
            parts, _ = g.occ.fragment(boxes[:1], boxes[1:])
            for half, part in zip(halves, parts, strict=True):
                half.append(part[1])
        g.occ.synchronize()
        for _, curve in g.getEntities(1):
            g.mesh.setTransfiniteCurve(curve, 2)
        for _, surface in g.getEntities(2):
            g.mesh.setTransfiniteSurface(surface)
            g.mesh.setRecombine(2, surface)
        for tag, half in enumerate(halves, 1):
            g.addPhysicalGroup(2, half, tag)
        g.mesh.generate(2)
        mesh, cells, _ = distribute(g, comm, 2)
    law = vmdg.Debonding(
        strength=lambda x: strengths[np.floor(x[1] / (2 * width)).astype(int)],
        critical_gap=critical_gap,
    )
    body = vmdg.NeoHookean(E=E, nu=0.0)
    bond = vmdg.Interface(between=(1, 2), law=law)
    problem = vmdg.Problem(mesh, cells, {1: body, 2: body}, [bond], kinematics="small")
    grips = [
        locate_entities_boundary(mesh, 1, lambda x, place=place: np.isclose(x[0], place))
        for place in (0.0, 2 * length)
    ]
    problem.dirichlet(grips[0], 0.0)
    problem.dirichlet(grips[1], lambda t: (20.0 * length / E * way(t), 0.0))
    return problem, lambda p: {"force": p.reaction(grips[1])[0] / width}


def order_statistics(strengths: np.ndarray, stress: float) -> float:
    """Force of brittle bars by their width: those that are strong enough bear the stress [MPa]."""
    return stress * (strengths > stress).sum()
