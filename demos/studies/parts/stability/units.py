"""Units drawn at random: powers of two of length, stress and load factor change no digit."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from inspect import signature

import numpy as np
from numpy.random import Generator

import vmdg
from parts.stability.cases import (
    axisymmetric,
    contrast,
    corner_cells,
    crack_tip,
    dead_loads,
    large_rotation,
    load_cycles,
    ogden,
    step_sizes,
    viscous,
)
from parts.stability.checks import Run
from parts.stability.execution import execute
from parts.stability.links import bundles
from parts.stability.programmes import programmes, rates
from parts.stability.scenes import Array, Case, Cells, Support

#: Families whose cases are run in other units.
BASES = (contrast, step_sizes, load_cycles, dead_loads, large_rotation, crack_tip, corner_cells)
BASES += (axisymmetric, ogden, viscous, bundles, programmes, rates)

#: Powers of (length, stress, load factor) of parameters of laws and materials; 0 of all others.
POWERS = {
    "strength": (0, 1, 0),
    "normal_strength": (0, 1, 0),
    "shear_strength": (0, 1, 0),
    "critical_gap": (1, 0, 0),
    "fracture_energy": (1, 1, 0),
    "normal_energy": (1, 1, 0),
    "shear_energy": (1, 1, 0),
    "viscosity": (-1, 1, 1),
}


def scaled_law(law: vmdg.Law, units: Array) -> vmdg.Law:
    """The law in other units; parameters that vary are functions of the place."""
    changes = {}
    for one in fields(law):
        value, factor = getattr(law, one.name), np.prod(units ** POWERS.get(one.name, (0, 0, 0)))
        if callable(value):
            changes[one.name] = lambda x, f=value, factor=factor: factor * f(x / units[0])
        elif factor != 1:
            changes[one.name] = factor * value
    return replace(law, **changes)


def scaled_material(material: vmdg.Material, stress: float) -> vmdg.Material:
    """NeoHookean or Ogden."""
    values = material.parameters
    if isinstance(material, vmdg.Ogden):
        c, m = ([values[f"{name}{i + 1}"] for i in range(material.terms)] for name in "cm")
        return vmdg.Ogden(c=np.array(c) * stress, m=m, kappa=values["kappa"] * stress)
    return vmdg.NeoHookean(**{name: value * stress for name, value in values.items()})


def in_units(case: Case, units: Array) -> Case:
    """The case with other numbers for the same lengths, stresses and load factors."""
    length, stress, factor = units

    def motion(value: object) -> object:
        if not callable(value):
            return np.multiply(value, length)
        if len(signature(value).parameters) == 2:
            return lambda x, t: length * value(x / length, t / factor)
        return lambda t: np.multiply(value(t / factor), length)

    def where(predicate: Callable) -> Callable:
        return lambda x, *rest: predicate(x / length, *rest)

    mesh = case.mesh
    nodes, lines = mesh.nodes * length, tuple(line * length for line in mesh.lines)
    bonds = [
        replace(
            bond,
            law=scaled_law(bond.law, units),
            facets=bond.facets and where(bond.facets),
        )
        for bond in case.bonds
    ]
    traction, free = case.traction, case.motion
    if free:
        mass, speed = stress * factor**2 / length**2, length / factor
        free = replace(
            free,
            density={tag: mass * rho for tag, rho in free.density.items()},
            velocity=lambda x, f=free.velocity: speed * f(x / length),
        )
    return replace(
        case,
        motion=free,
        mesh=Cells(mesh.kind, nodes, mesh.cells, lines),
        materials={tag: scaled_material(m, stress) for tag, m in case.materials.items()},
        bonds=tuple(bonds),
        supports=tuple(
            Support(where(s.where), motion(s.value), s.component) for s in case.supports
        ),
        loads=case.loads * factor,
        traction=traction and (lambda t: stress * traction(t / factor)),
        unchanged_from=case.unchanged_from and case.unchanged_from * factor,
        exact=None,
        judge=None,
    )


def units(rng: Generator) -> Case:
    """A case of another family in other units: rows, work and every digit are the same."""
    base = BASES[rng.integers(len(BASES))](rng)
    exponents = [rng.integers(-30, 21), rng.integers(-30, 31), rng.integers(-20, 21)]
    factors = 2.0 ** np.array(exponents)

    def judge(run: Run) -> list[str]:
        other = execute(base)
        found = [f"in units of 1: {fault}" for fault in other.faults()]
        work = [
            (len(one.records), one.residuals, len(one.failures), bool(one.stopped))
            for one in (run, other)
        ]
        if work[0] != work[1]:
            return [*found, f"rows, residuals, cuts, stop: {work[0]}, in units of 1 {work[1]}"]
        for mine, theirs in zip(run.records, other.records, strict=True):
            same = mine.t == theirs.t * factors[2] and np.array_equal(mine.u, theirs.u * factors[0])
            same &= all(
                np.array_equal(a, b * factors[1])
                for a, b in zip(mine.softening, theirs.softening, strict=True)
            )
            if not same:
                off = np.abs(mine.u / factors[0] - theirs.u).max() / np.abs(theirs.u).max()
                return [*found, f"the row at {theirs.t:.6g} differs by {off:.1e}"]
        return found

    what = f"2^{exponents[0]} of length, 2^{exponents[1]} of stress, 2^{exponents[2]} of t: "
    case = in_units(base, factors)
    return replace(case, family="units", what=what + base.family + ", " + base.what, judge=judge)
