"""Parameters by which a run is differentiated: their names, values and neighbouring values.

A name is the name of an interface, a group of cells or a class of laws, a dot, and a parameter. All
changes are relative, p (1 + h); a parameter that varies in space, and an eigenstrain, changes by a
common factor, by which it is then differentiated, or by a value that is given for it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..base.parallel import global_max
from ..base.words import near
from ..laws import Law
from ..points.interface import interface_names
from ..problem.loading import groups_of
from ..problem.problem import Problem

Array = NDArray[np.float64]

#: Young's modulus and Poisson's ratio of Lame parameters.
_OF_LAME: dict[str, Callable[[Array, Array], Array]] = {
    "E": lambda mu, lmbda: mu * (3 * lmbda + 2 * mu) / (lmbda + mu),
    "nu": lambda mu, lmbda: lmbda / (2 * (lmbda + mu)),
}

#: Other words for the same moduli.
_OTHERWISE = dict.fromkeys(_OF_LAME, ("mu", "lmbda")) | dict.fromkeys(("mu", "lmbda"), ("E", "nu"))


class Parameter:
    """A parameter of a problem.

    Attributes:
        of_body: Whether it changes the forces of bodies at a given displacement.
    """

    of_body = False
    value: float

    def __init__(self, problem: Problem, name: str):
        self._problem, self.name = problem, name

    def laws(self, h: float) -> list[Law]:
        """Laws of all active interfaces at p (1 + h)."""
        return [active.law for active in self._problem.discretization.active.values()]

    @contextmanager
    def changed(self, h: float) -> Iterator[None]:
        """The problem at p (1 + h), at unchanged displacement and history."""
        raise NotImplementedError


class LawParameter(Parameter):
    """A parameter of the laws of some interfaces."""

    def __init__(self, problem: Problem, name: str, numbers: Sequence[int], field: str):
        super().__init__(problem, name)
        self._numbers, self._field = numbers, field
        given = getattr(problem.interfaces[numbers[0]].law, field)
        self.value = float(given) if isinstance(given, Real) else 1.0
        self._laws: dict[float, list[tuple[Law, Law]]] = {}

    def _at(self, h: float) -> list[tuple[Law, Law]]:
        if h not in self._laws:
            self._laws[h] = [
                (self._scaled(active.law, h), self._scaled(active.facets.law, h))
                if number in self._numbers
                else (active.law, active.facets.law)
                for number, active in self._problem.discretization.active.items()
            ]
        return self._laws[h]

    def _scaled(self, law: Law, h: float) -> Law:
        return law.with_values({self._field: getattr(law, self._field) * (1 + h)})

    def laws(self, h: float) -> list[Law]:
        return [law for law, _ in self._at(h)]

    @contextmanager
    def changed(self, h: float) -> Iterator[None]:
        actives = list(self._problem.discretization.active.values())
        before = [(active.law, active.stabilizer.facets) for active in actives]
        for active, (law, on_facets) in zip(actives, self._at(h), strict=True):
            active.law = law
            active.stabilizer.facets = replace(active.stabilizer.facets, law=on_facets)
        try:
            yield
        finally:
            for active, (law, facets) in zip(actives, before, strict=True):
                active.law, active.stabilizer.facets = law, facets


class BodyParameter(Parameter):
    """A parameter of the material of groups of cells.

    Args:
        field: Name of the parameter: one of the material, or E or nu of Lame parameters.
    """

    of_body = True

    def __init__(self, problem: Problem, name: str, tags: Sequence[int], field: str):
        super().__init__(problem, name)
        self._field = field
        bodies = problem.discretization.bodies
        self._cells = np.concatenate([bodies.cells_of[tag] for tag in tags])
        self._key = problem.materials[tags[0]].kernel_key
        # Values on this rank, possibly none; equal values are one number.
        values = self._value(*self._moduli)
        largest = global_max(problem.comm, float(np.max(values, initial=-np.inf)))
        least = -global_max(problem.comm, float(np.max(-values, initial=-np.inf)))
        uniform = largest - least <= 1e-12 * max(abs(largest), abs(least))
        self.value = largest if uniform else 1.0

    @cached_property
    def _functions(self) -> dict[str, fem.Function]:
        regions = self._problem.discretization.bodies.regions
        found = (one.body for one in regions if one.body.material.kernel_key == self._key)
        return dict(next(found).parameters)

    @property
    def _names(self) -> tuple[str, ...]:
        return ("mu", "lmbda") if self._field in _OF_LAME else (self._field,)

    @property
    def _moduli(self) -> list[Array]:
        return [self._functions[name].x.array[self._cells] for name in self._names]

    def _value(self, *moduli: Array) -> Array:
        return _OF_LAME[self._field](*moduli) if self._field in _OF_LAME else moduli[0]

    def _scaled(self, h: float, *moduli: Array) -> list[Array]:
        """The moduli at p (1 + h)."""
        if self._field != "nu":
            return [(1 + h) * values for values in moduli]
        E, nu = (of(*moduli) for of in _OF_LAME.values())
        nu = (1 + h) * nu
        return [E / (2 * (1 + nu)), nu * E / ((1 + nu) * (1 - 2 * nu))]

    @contextmanager
    def changed(self, h: float) -> Iterator[None]:
        before = self._moduli
        self._set(self._scaled(h, *before))
        try:
            yield
        finally:
            self._set(before)

    def _set(self, moduli: Sequence[Array]) -> None:
        for name, values in zip(self._names, moduli, strict=True):
            self._functions[name].x.array[self._cells] = values


class EigenstrainParameter(Parameter):
    """A factor on the eigenstrain of a group of cells."""

    of_body = True
    value = 1.0

    def __init__(self, problem: Problem, name: str, tag: int):
        super().__init__(problem, name)
        self._tag = tag

    @contextmanager
    def changed(self, h: float) -> Iterator[None]:
        loading = self._problem.loading
        with self._problem.discretization.bodies.swollen(self._tag, 1 + h):
            loading.strain(loading.t)
            yield
        loading.strain(loading.t)


@dataclass(frozen=True)
class _Place:
    """What a name before the dot stands for."""

    make: Callable[[str, str], Parameter]  # Makes a parameter from its full name and its field
    fields: dict[str, Any]
    things: tuple[int, ...]  # Numbers of interfaces, from -1 downwards, or tags of cells

    def contains(self, field: str) -> set[tuple[int, str]]:
        """Parameters of single things that change with a field, or cannot change with it."""
        return {(one, name) for one in self.things for name in (field, *_OTHERWISE.get(field, ()))}


def parameters_of(problem: Problem, names: Sequence[str] | Mapping[str, float]) -> list[Parameter]:
    texts = not isinstance(names, str) and all(isinstance(name, str) for name in names)
    if not texts or not len(names):
        raise TypeError(
            f"solve: derivatives = {names!r} must be a list of names, one or more, such as "
            '["bond.strength", "matrix.E"]'
        )
    places, known, found = _places(problem), parameter_names(problem), []
    for name in dict.fromkeys(names):
        place, _, field = name.rpartition(".")
        if place not in places or field not in places[place].fields:
            raise ValueError(
                f"solve: derivatives has no parameter {name!r}; the problem has "
                f"{', '.join(known)}{near(name, known)}"
            )
        if np.any(np.equal(places[place].fields[field], 0.0)):
            raise ValueError(
                f"solve: derivatives by {name}, which is 0: changes are relative to the value; "
                "give it a small one"
            )
        found.append(places[place].make(name, field))
        if isinstance(names, Mapping):
            found[-1].value = float(names[name])
    return found


def parameter_names(problem: Problem) -> list[str]:
    return [f"{place}.{field}" for place, one in _places(problem).items() for field in one.fields]


def other_parameters(problem: Problem, names: Sequence[str]) -> list[Parameter]:
    """Parameters that are numbers other than zero, without those of some names: those of a class
    together where none of its members has one of its own among the names."""
    places, found = _places(problem), []
    taken: set[tuple[int, str]] = set()
    for name in names:
        place, _, field = name.rpartition(".")
        taken |= {(one, field) for one in places[place].things}
    for place, one in sorted(places.items(), key=lambda item: -len(item[1].things)):
        for field, value in one.fields.items():
            if isinstance(value, Real) and value != 0 and not one.contains(field) & taken:
                found.append(one.make(f"{place}.{field}", field))
                taken |= {(thing, field) for thing in one.things}
    return found


def _places(problem: Problem) -> dict[str, _Place]:
    places: dict[str, _Place] = {}
    by_class: dict[str, list[int]] = {}
    for i, name in enumerate(interface_names(problem.interfaces)):
        law = problem.interfaces[i].law
        if i in problem.discretization.active and law.inelastic and is_dataclass(law):
            places[name] = _of_laws(problem, [i])
            by_class.setdefault(type(law).__name__, []).append(i)
    groups = {tag: str(tag) for tag in problem.materials}
    groups |= {tag: name for name, tag in groups_of(problem.loading).items() if tag in groups}
    alike: dict[str, list[int]] = {}
    for tag, group in groups.items():
        if place := _of_bodies(problem, [tag]):
            places.setdefault(group, place)
            places.setdefault(str(tag), place)
            alike.setdefault(type(problem.materials[tag]).__name__, []).append(tag)
    for name, tags in alike.items():
        if len({problem.materials[tag].kernel_key for tag in tags}) == 1:
            places.setdefault(name, _of_bodies(problem, tags))
    for name, numbers in by_class.items():
        places.setdefault(name, _of_laws(problem, numbers))
    return places


def _of_bodies(problem: Problem, tags: Sequence[int]) -> _Place | None:
    """Of groups whose materials share a kernel; None without parameters."""
    own = dict(problem.materials[tags[0]].parameters)
    lame = dict.fromkeys(_OF_LAME, 1.0) if set(own) == {"mu", "lmbda"} else {}
    known = {name: value for name, value in (lame | own).items() if _differs(value)}
    if len(tags) == 1 and tags[0] in problem.discretization.bodies.swelling:
        known["eigenstrain"] = 1.0

    def make(name: str, field: str) -> Parameter:
        if field == "eigenstrain":
            return EigenstrainParameter(problem, name, tags[0])
        return BodyParameter(problem, name, tags, field)

    return _Place(make, known, tuple(tags)) if known else None


def _of_laws(problem: Problem, numbers: Sequence[int]) -> _Place:
    law = problem.interfaces[numbers[0]].law
    given = {field.name: getattr(law, field.name) for field in fields(law) if field.init}
    known = {name: 1.0 if callable(v) else v for name, v in given.items() if _differs(v)}
    things = tuple(-1 - i for i in numbers)
    return _Place(lambda name, field: LawParameter(problem, name, numbers, field), known, things)


def _differs(value: Any) -> bool:
    return not (value is None or isinstance(value, bool | str))
