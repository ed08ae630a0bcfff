"""Identity of the problem of a checkpoint, which must agree before a run continues from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from dolfinx.mesh import compute_midpoints

from ..assembly.means import lattice_of
from ..base.parallel import global_sum
from ..materials.point import PointMaterial
from ..points.interface import Interface
from ..problem.problem import Problem

#: Relative tolerance for sums over the mesh between partitions.
PARTITION_ROUNDING = 1e-9


def identity(problem: Problem) -> dict[str, Any]:
    """Mesh, bodies, interfaces and their parameters, in JSON types; collective.

    It is the same on every number of ranks and in every state of the problem. Loads, supports and
    energies given as functions cannot be compared and are omitted, except for their part of a
    state: start values of supports with ``relative=True``, and the extent of fluids.
    """
    mesh = problem.mesh
    nodes = mesh.geometry.index_map().size_local
    x = mesh.geometry.x[:nodes]
    result: dict[str, Any] = {
        "cell type": mesh.topology.cell_name(),
        "number of cells": mesh.topology.index_map(mesh.topology.dim).size_global,
        "number of mesh nodes": mesh.geometry.index_map().size_global,
        "sum of node coordinates": global_sum(mesh.comm, x.sum(axis=0)).tolist(),
        "sum of squared node coordinates": global_sum(mesh.comm, (x**2).sum(axis=0)).tolist(),
        "degree": problem.discretization.degree,
        "kinematics": "small" if problem.discretization.bodies.small else "finite",
        "geometry": type(problem.discretization.geometry).__name__,
        "thickness": float(problem.discretization.geometry.thickness),
        "number of interfaces": len(problem.interfaces),
    }
    if lattice := lattice_of(problem.discretization.means):
        result["sides of the cell"] = lattice.vectors.ravel().tolist()
    if problem.discretization.bodies.plane_stress:
        result["plane"] = "stress"
    if problem.loading.given.starts:
        result["supports with relative=True"] = len(problem.loading.given.starts)
    for tag, material in sorted(problem.materials.items()):
        at_points = isinstance(material, PointMaterial)
        known = material.numbers if at_points else material.parameters
        result[f"material {tag}"] = _described(material, known)
        if at_points:  # tables
            lists = {name: value for name, value in known.items() if isinstance(value, list)}
            result[f"material {tag}"] |= lists
    for i, interface in enumerate(problem.interfaces):
        count = int(global_sum(mesh.comm, len(problem.step.activation.facets[i].facets)))
        result[f"facets of interface {i}"] = count
        result |= {f"interface {i}: {name}": v for name, v in _options(interface).items()}
        if i in problem.loading.given.filled:
            result[f"interface {i}: pressure"] = "of a fluid"
        facets = problem.step.activation.facets[i]
        x = compute_midpoints(mesh, mesh.topology.dim - 1, facets.facets)
        for name, values in facets.law.varying.items():
            moments = np.concatenate([[values.sum(), values @ values], values @ x])
            result[f"interface {i}: {name} by facet"] = global_sum(mesh.comm, moments).tolist()
    return result


def _options(interface: Interface) -> dict[str, Any]:
    names = ("safety", "norm", "frame", "traction_jump", "activate", "activate_at")
    options = {name: getattr(interface, name) for name in names}
    options["law"] = _described(interface.law, _parameters(interface.law))
    damage = interface.initial_damage
    if damage is not None:
        options["initial damage"] = damage if isinstance(damage, float) else "varies"
    options["own stabilization"] = interface.stabilization is not None
    return options


def _parameters(law: Any) -> dict[str, Any]:
    if is_dataclass(law):
        return {field.name: getattr(law, field.name) for field in fields(law)}
    return vars(law)


def _described(item: object, parameters: Mapping[str, Any]) -> dict[str, Any]:
    known = {k: v for k, v in parameters.items() if isinstance(v, (bool, int, float, str))}
    return {"class": type(item).__name__} | known


def differences(stored: Mapping[str, Any], present: Mapping[str, Any]) -> list[str]:
    names = dict.fromkeys([*stored, *present])
    return [
        f"{name}: {stored.get(name, 'nothing')} there, {present.get(name, 'nothing')} here"
        for name in names
        if not _same(stored.get(name), present.get(name))
    ]


def _same(a: Any, b: Any) -> bool:
    if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
        size = max(map(abs, [*a, *b]), default=0.0)
        return bool(np.allclose(a, b, rtol=0, atol=PARTITION_ROUNDING * size))
    return a == b
