"""A problem at states near its current one, and rates between them at fixed history."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from dolfinx import fem
from dolfinx.la import InsertMode
from numpy.typing import NDArray
from scipy.sparse import csr_array

from ..assembly.discretization import interface_forces
from ..assembly.point_matrices import local_tractions
from ..assembly.space import at_owners
from ..base.arrays import power_of_two
from ..base.parallel import global_max
from ..domain.topology import box_sides
from ..interface.active import trial_of
from ..interface.history import InterfaceSnapshot, PointHistory
from ..interface.return_map import Trial
from ..interface.stabilization import Stabilization
from ..interface.values import PointValues
from ..problem.problem import Problem
from ..problem.states import Rate
from .parameters import Parameter
from .records import CHANGE, NEAR, difference, shifted, zeros

Array = NDArray[np.float64]

#: Displacement for differences, relative to the size of the body; at small strain they are exact.
MOVE = 1e-6


class Neighbours:
    """States near the current one of a problem, to which it returns; all methods are collective."""

    def __init__(self, problem: Problem):
        self.problem, self.discretization = problem, problem.discretization
        self.actives = list(self.discretization.active.values())
        self._field = fem.Function(problem.space)
        self._size = float(np.linalg.norm(box_sides(problem.mesh)))
        self._known: tuple[list[Array], list[csr_array]] | None = None

    @contextmanager
    def interfaces(
        self,
        h: float,
        histories: Sequence[PointHistory] | None,
        values: Sequence[PointValues] | None,
        stabilizations: Sequence[Stabilization],
    ) -> Iterator[None]:
        """All interfaces moved by h times these rates; None for no change."""
        before = [
            InterfaceSnapshot(active.history, active.values, active.stabilization)
            for active in self.actives
        ]
        for i, (active, state) in enumerate(zip(self.actives, before, strict=True)):
            state = replace(state, stabilization=shifted(state.stabilization, stabilizations[i], h))
            if histories is not None:
                state = replace(state, history=shifted(state.history, histories[i], h))
            if values is not None:
                state = replace(state, values=shifted(state.values, values[i], h))
            active.return_to(state)
        try:
            yield
        finally:
            for active, state in zip(self.actives, before, strict=True):
                active.return_to(state)

    @contextmanager
    def at(self, parameter: Parameter, rate: Rate, h: float) -> Iterator[None]:
        """The problem in the state at p (1 + h)."""
        problem, discretization = self.problem, self.discretization
        u, forces = problem.u.x.array, discretization.forces.x.array
        before, t = (u.copy(), forces.copy()), problem.t
        u += h * rate.u
        forces += h * rate.forces
        if rate.t:
            problem.loading.move(t + h * rate.t)
        discretization.update_means(pressure=True)
        problem.loading.nearby, of = True, rate.interfaces
        records = (
            [one.history for one in of],
            [one.values for one in of],
            [one.stabilization for one in of],
        )
        try:
            with self.interfaces(h, *records), parameter.changed(h):
                yield
        finally:
            self.problem.loading.nearby = False
            u[:], forces[:] = before
            if rate.t:
                problem.loading.move(t)
            discretization.update_means(pressure=True)

    def everywhere(self, values: Array) -> Array:
        """Values of owned dofs on local dofs, ghosts included."""
        self._field.x.array[: self.discretization.owned] = values
        self._field.x.scatter_forward()
        return self._field.x.array.copy()

    def held(self, rate: Rate) -> Array:
        """Rate of prescribed dofs, on owned dofs: supports that are relative to an earlier
        displacement move with that one."""
        dofs = self.problem.loading.dirichlet.relative
        dofs, found = dofs[dofs < self.discretization.owned], np.zeros(self.discretization.owned)
        found[dofs] = rate.u[dofs]
        return found

    # Rates at fixed displacement, and along one

    def trials(
        self,
        parameter: Parameter,
        histories: Sequence[PointHistory],
        stabilizations: Sequence[Stabilization],
        given: Sequence[Trial],
    ) -> list[Trial]:
        """Rates of the input of return maps at fixed displacement."""
        if parameter.of_body:
            ends = []
            for h in (CHANGE, -CHANGE):
                with self.interfaces(h, histories, None, stabilizations), parameter.changed(h):
                    ends.append([active.trial() for active in self.actives])
            return [difference(a, b, 2 * CHANGE) for a, b in zip(*ends, strict=True)]
        rates = []
        for active, trial, *known in zip(
            self.actives, given, stabilizations, histories, strict=True
        ):
            rate = trial_of(active, *known)
            changes = {name: getattr(rate, name) for name in ("total", "r", "gap", "softening")}
            rates.append(replace(zeros(trial), **changes))
        return rates

    def trials_along(self, u: Array, t: float, given: Sequence[Trial]) -> list[Trial]:
        """Rates of the input of return maps along a displacement, and a load factor."""
        problem, here = self.problem, self.problem.u.x
        size = global_max(problem.comm, float(np.abs(u).max(initial=0.0)))
        if size == 0:
            return [zeros(trial) for trial in given]
        straight = self.discretization.bodies.linear and not problem.loading.pressurised
        h = float(power_of_two(self._size / size)) if straight else MOVE * self._size / size
        before, factor, ends = here.array.copy(), problem.t, []
        for end in (h,) if straight else (h, -h):
            here.array[:] = before + end * u
            if t:
                problem.loading.move(factor + end * t)
            self.discretization.update_means()
            ends.append([active.trial() for active in self.actives])
        here.array[:] = before
        if t:
            problem.loading.move(factor)
        self.discretization.update_means()
        lower, width = (given, h) if straight else (ends[1], 2 * h)
        return [difference(a, b, width) for a, b in zip(ends[0], lower, strict=True)]

    def forces_of_gaps(self, values: Sequence[PointValues]) -> Array:
        """dR/dp where only gaps change, at small strain, owned dofs [N]: -Tt(eta).dzeta dA."""
        forces = fem.Function(self.problem.space)
        for active, rate, matrix in zip(self.actives, values, self._tractions, strict=True):
            if active.law.inelastic:
                forces.x.array[:] -= matrix @ rate.gap.ravel()
        forces.x.scatter_reverse(InsertMode.add)
        return forces.x.array[: self.discretization.owned].copy()

    @property
    def _tractions(self) -> list[csr_array]:
        """Transposes of int q.Tt(du) dA at small strain, over local dofs and gap components; made
        again where facets have been left out or taken in."""
        weights = [active.stabilization.weights for active in self.actives]
        if self._known is None or not all(map(np.array_equal, weights, self._known[0])):
            self._known = weights, [local_tractions(active) for active in self.actives]
        return self._known[1]

    def forces(
        self,
        parameter: Parameter,
        stabilizations: Sequence[Stabilization],
        values: Sequence[PointValues],
        here: Array,
    ) -> Array:
        """dR/dp where tau_s or moduli change, owned dofs [N]."""
        values = [replace(one, update=None) for one in values]
        if not (parameter.of_body or self.discretization.bodies.mean_dilatation):
            with self.interfaces(NEAR, None, values, stabilizations), parameter.changed(NEAR):
                return (interface_forces(self.discretization) - here) / NEAR
        # Stresses are small differences of moduli: two neighbours, further away.
        before, ends = self.discretization.forces.x.array.copy(), []
        for h in (CHANGE, -CHANGE):
            with self.interfaces(h, None, values, stabilizations), parameter.changed(h):
                ends.append(self.discretization.assemble_residual(None).copy())
        self.discretization.forces.x.array[:] = before
        self.discretization.update_means(pressure=True)
        return (ends[0] - ends[1]) / (2 * CHANGE)

    def load_rate(self, dt: float) -> Array:
        """-dR/dlambda at fixed displacement along the ray, owned dofs [N]."""
        problem, loading = self.problem, self.problem.loading
        ray = loading.ray
        if not (loading.pressurised or loading.strained(ray.start, ray.end)):
            return at_owners(problem.space, ray.rate(loading.dead))
        t, change = loading.t, MOVE * (ray.end - ray.start)
        before, ends = self.discretization.forces.x.array.copy(), []
        points = [active.snapshot() for active in self.actives]
        for end in (t + change, t - change):
            loading.move(end)
            ends.append(self.discretization.assemble_residual(dt, False, loading.vector).copy())
        loading.move(t)
        for active, state in zip(self.actives, points, strict=True):
            active.return_to(state)
        self.discretization.forces.x.array[:] = before
        self.discretization.update_means(pressure=True)
        return -(ends[0] - ends[1]) / (2 * change)
