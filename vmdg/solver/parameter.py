"""The control parameter of a step, an unknown in addition to the displacement."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..linear.system import System
from ..problem.problem import Problem
from .limits import Limits

Array = NDArray[np.float64]


class Rate(NamedTuple):
    """Derivatives by the parameter."""

    forces: Array  # Derivative of minus the residual on owned dofs [N]
    supports: Array  # Prescribed displacements, owned dofs [mm]
    work: float = 0.0  # Damage work, without that of the displacement [N mm]


class Parameter:
    """A constant load factor; base class of variable parameters.

    Attributes:
        drag: Viscous resistance of bodies, relative to the norm of K.
    """

    moves, least, drag = False, -math.inf, 0.0

    def __init__(self, problem: Problem):
        self._step, self._loading = problem.step, problem.loading

    @property
    def value(self) -> float:
        return self._loading.t

    def move(self, value: float) -> None:
        """Change it."""

    def rate(self, moved: Array) -> Rate:
        """Derivatives by it, at a displacement in the step; collective."""
        raise NotImplementedError


class LoadFactor(Parameter):
    """The load factor along a ray."""

    moves = True

    def move(self, value: float) -> None:
        self._loading.move(value)

    def rate(self, moved: Array) -> Rate:
        return Rate(self._step.load_rate(), self._loading.rate())


class Overstress(Parameter):
    """The overstress s of a jump: bonds carry an additional s H per gap increment, nodes s c |K|
    per displacement."""

    moves, least = True, 0.0
    value = 0.0  # replaces the load factor

    def __init__(self, problem: Problem, system: System, limits: Limits):
        super().__init__(problem)
        self._system, self._share, self.value = system, limits.jump.drag, limits.start

    @property
    def drag(self) -> float:
        return self._share * self.value

    def move(self, value: float) -> None:
        self.value = value
        self._step.slow_down(value)

    def rate(self, moved: Array) -> Rate:
        forces, work = self._step.overstress_rate(self.value)
        bodies = self._loading.balance(-self._share * self._system.norm * moved)
        return Rate(forces + bodies, np.zeros_like(forces), work)


def parameter_of(problem: Problem, system: System, limits: Limits) -> Parameter:
    if limits.jump is not None:
        return Overstress(problem, system, limits)
    return Parameter(problem) if problem.loading.ray is None else LoadFactor(problem)
