"""Runs of all experiments for parameters, as weighted residuals with their derivatives."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from itertools import product
from numbers import Real
from pathlib import Path
from reprlib import repr as short
from typing import Any, NamedTuple, TypeVar

from mpi4py import MPI

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2

from ..base.agreement import together
from ..base.arrays import power_of_two
from ..base.words import near
from ..laws import Debonding, TrapezoidalDebonding
from ..points.interface import interface_names
from ..problem.problem import Problem
from ..sensitivity.checks import check_differentiable
from ..sensitivity.parameters import other_parameters, parameter_names
from ..solver.monitors import Monitor, Until
from ..solver.options import SolveOptions
from ..solver.result import StepFailure
from ..solver.stepping import solve
from .curves import Compared, Curve
from .fields import Field
from .result import Run
from .runs import RunFile, of_model, of_options

Array = NDArray[np.float64]

T = TypeVar("T")

#: What was measured.
Measured = Curve | Field

#: A problem for values of the parameters, the monitor that returns what was measured, and where the
#: run ends.
Make = Callable[[dict[str, float]], tuple[Problem, Monitor] | tuple[Problem, Monitor, Until]]

#: Tolerance of the logarithms of the parameters; that of the cost, quadratic at a minimum, is its
#: square.
TOLERANCE = 1e-4

#: Largest change of a logarithm in the first step: longer ones lead from a bad start to values with
#: which nothing fails, or all, from where no step leads back.
FIRST = 0.3

#: Factors on a parameter that changes nothing; the second ones where none of the first helps.
LEAPS = (0.1, 0.3, 3.0, 10.0), (0.7, 1.5)

#: Probability with which noise alone stays below a limit.
LEVEL = 0.999

#: Relative change of a parameter for differences of whole runs.
DIFFERENCE = 1e-3

#: Largest number of evaluations of a fit of all parameters but one.
MOST_REFITTED = 10

#: Errors with which a law, a model or a run refuses values of the parameters.
REFUSALS = (ValueError, ArithmeticError, StepFailure)


class Refused(RuntimeError):
    """Values of the parameters for which there is no run; the message says why."""


class Fit(NamedTuple):
    """How least squares ended."""

    values: Array  # Parameters (k,)
    cost: float
    status: int  # 0 at the largest number of evaluations, -1 where there is no run at the start
    bounded: NDArray[np.bool_]  # Whether a parameter is at its bound (k,)
    iterations: int


class Model:
    """Weighted residuals and their derivatives by the logarithms of the parameters.

    Args:
        sigma: Deviation of measurements without one of their own; None if it is not known.
        bounds: Smallest and largest values (k,).

    Attributes:
        scale: Deviation used as weight: sigma, or a number of the size of the measured values.
        known: Whether all noise is given.
        differenced: Parameters that are differentiated by differences of whole runs.
        plateaus: Gap up to which the resistance is constant, of laws of a strength and a critical
            gap, by name and class of their interfaces.
        suspects: What may be meant by names that no problem has.
    """

    def __init__(
        self,
        makes: Mapping[str, Make],
        measured: Mapping[str, Sequence[Measured]],
        loads: Mapping[str, Array],
        options: SolveOptions,
        sigma: float | None,
        priors: Mapping[str, tuple[float, float]],
        start: Mapping[str, float],
        bounds: tuple[Array, Array],
        comm: MPI.Comm,
        file: str | Path | None,
        spread: bool,
    ):
        self._makes, self.measured, self._loads = makes, measured, loads
        self._options, self._priors, self.start = options, priors, dict(start)
        self.names, self.bounds, self.comm = list(start), bounds, comm
        self._spread = spread and comm.size > 1
        self.file = RunFile(comm, file)
        self.runs: list[Run] = []
        self.differenced: set[str] = set()
        self.plateaus: dict[str, float] = {}
        self.suspects: dict[str, str] = {}
        self._direct: dict[str, list[str]] = {}
        self._others: dict[str, dict[str, float]] = {}
        self._residuals: dict[str, Array] = {}
        largest = [np.abs(one.data).max() for one in self._all if one.sigma is None]
        size = float(power_of_two(max(largest, default=0.0) or 1.0))
        self.scale = size if sigma is None else sigma
        self.known = not largest or sigma is not None
        self.count = sum(len(one.data) for one in self._all) + len(priors)
        self.freedom = self.count - sum(one.nuisances for one in self._all) - len(self.names)

    @property
    def _all(self) -> list[Measured]:
        return [one for group in self.measured.values() for one in group]

    def claimed(self) -> AbstractContextManager:
        """With the exclusive right to write the file of runs."""
        return self.file.claimed()

    def open(self) -> None:
        """Read the file of runs, and refuse it if its model is another one.

        Raises:
            ValueError: it is another one.
        """
        first = self.file.first()
        at = self.start if first is None else first
        if list(at) != self.names:
            raise ValueError(
                f"identify: the file has runs for other parameters, {list(at)}, than "
                f"{self.names}; give another file, or delete it"
            )
        models = {}
        for name, seen in self._each(lambda n: self._seen(n, at)).items():
            models[name], self._direct[name], self._others[name], plateaus, suspects = seen
            self.plateaus |= plateaus
            self.suspects |= suspects
            self.differenced |= set(self.names) - set(self._direct[name])
        self.file.accept(
            {
                "at": at,
                "options": of_options(self._options),
                "load factors": {name: t.tolist() for name, t in self._loads.items()},
                "measured": {
                    name: {str(i + 1): one.places for i, one in enumerate(group)}
                    for name, group in self.measured.items()
                },
                "of": models,
            }
        )

    def _seen(
        self, name: str, values: Mapping[str, float]
    ) -> tuple[Any, list[str], dict, dict, dict]:
        """An experiment: its model, the parameters with derivatives along its runs, others that it
        has with their values, :attr:`plateaus` and :attr:`suspects`."""
        problem, *_ = self._made(name, values)
        known = parameter_names(problem)
        try:
            check_differentiable(problem, self._options, False)
            direct = [one for one in self.names if one in known]
            others = {one.name: one.value for one in other_parameters(problem, direct)}
        except ValueError:
            direct, others = [], {}
        plateaus, suspects = {}, {}
        for one in self.names:
            if one not in known and near(one, known):
                suspects[one] = near(one, known)
        for i, key in enumerate(interface_names(problem.interfaces)):
            law = problem.interfaces[i].law
            if type(law) in (Debonding, TrapezoidalDebonding):
                plateau = getattr(law, "plateau_gap", 0.0)
                if all(isinstance(v, Real) for v in (law.strength, law.critical_gap, plateau)):
                    plateaus |= {key: float(plateau), type(law).__name__: float(plateau)}
        model = of_model(problem, self._loads[name]) if self.file.kept else {}
        return model, direct, others, plateaus, suspects

    # Least squares

    def fit(self, start: Array, max_runs: int, fixed: Sequence[int] = ()) -> Fit:
        """Least squares from these parameters; those of some numbers stay as they are.

        The unknowns are FIRST + log(p / p_start): they have no unit, and their tolerances are
        relative to a factor of e. Values without a run are trials that are rejected.
        """
        free = np.setdiff1d(np.arange(len(start)), fixed)

        def whole(some: Array) -> Array:
            values = start.copy()
            values[free] = start[free] * np.exp(some - FIRST)
            return values

        if not np.isfinite(self.residuals(start)).all():
            return Fit(start, np.inf, -1, np.zeros(len(start), dtype=bool), 0)
        with np.errstate(divide="ignore"):
            low, high = (FIRST + np.log(ends[free] / start[free]) for ends in self.bounds)
        found = least_squares(
            lambda some: self.residuals(whole(some)),
            np.full(len(free), FIRST),
            lambda some: self._moving(whole(some))[:, free],
            bounds=(low, high),
            xtol=TOLERANCE / FIRST,
            ftol=TOLERANCE**2,
            gtol=float(np.finfo(float).eps),
            max_nfev=max_runs,
        )
        bounded = np.zeros(len(start), dtype=bool)
        bounded[free] = found.active_mask != 0
        return Fit(whole(found.x), float(found.cost), found.status, bounded, found.njev - 1)

    def solve(self, start: Array, max_runs: int) -> Fit:
        """Least squares of all parameters, off plateaus: where some change nothing, at the start or
        at the end, and the misfit is not noise, others are tried, and the best is the next start.
        """
        values, iterations = start, 0
        while True:
            values = self._off_plateau(values, max_runs)
            found = self.fit(values, max_runs - len(self.runs) + 1)
            iterations += found.iterations
            values = self._off_plateau(found.values, max_runs)
            if values is found.values:
                return found._replace(iterations=iterations)

    def _off_plateau(self, values: Array, max_runs: int) -> Array:
        """Values with the least cost among those with one parameter that changes nothing by some
        factors; the values themselves where there is none."""
        r = self.residuals(values)
        if self.known and r @ r <= chi2.ppf(LEVEL, max(self.freedom, 1)):
            return values
        best, least, still = values, (1 - TOLERANCE) * r @ r, np.flatnonzero(self.still(values))
        for factors in LEAPS:
            for place, factor in product(still, factors):
                other = values.copy()
                other[place] = np.clip(factor * other[place], *(one[place] for one in self.bounds))
                if len(self.runs) < max_runs and (r := self.residuals(other)) @ r < least:
                    best, least = other, r @ r
            if best is not values:
                break
        return best

    def still(self, values: Array) -> NDArray[np.bool_]:
        """Parameters of which a factor of e leaves the residuals as they are (k,)."""
        sizes = np.linalg.norm(self.jacobian(values), axis=0)
        return sizes < TOLERANCE * np.linalg.norm(self.residuals(values))

    def _moving(self, values: Array) -> Array:
        """The derivatives, without the rounding of parameters that change nothing."""
        return np.where(self.still(values), 0.0, self.jacobian(values))

    def least_cost(self, place: int, values: Array) -> float:
        """Least cost with the parameter of this number as in these values, from which those of the
        others start; inf where there is no run."""
        inside = np.clip(values, *self.bounds)
        inside[place] = values[place]
        if len(values) > 1:
            return self.fit(inside, MOST_REFITTED, [place]).cost
        return self.cost(dict(zip(self.names, inside.tolist(), strict=True)))

    def cost(self, values: Mapping[str, float]) -> float:
        """Half of the sum of squares for parameters by name; inf where there is no run."""
        r = self.residuals(np.array([values[name] for name in self.names]))
        return float(r @ r / 2)

    def residuals(self, values: Array) -> Array:
        """Residuals over sigma, priors last (n,); inf where there is no run."""
        key, by_name = self._named(values)
        if key not in self._residuals:
            stored = self._stored(key, by_name)
            refused = stored.get("refused", "")
            if refused and not self.runs:
                raise ValueError(f"identify: there is no run at the start: {refused}")
            r = np.full(self.count, np.inf)
            if not refused:
                parts = [self._weighted(one, y - one.data) for one, y in self.compared(values)]
                r = np.concatenate([*parts, self._of_priors(values)])
            self._residuals[key] = r
            self.runs.append(Run(by_name, float(r @ r / 2), refused))
        return self._residuals[key]

    def jacobian(self, values: Array) -> Array:
        """Derivatives of the residuals by the logarithms of the parameters (n, k)."""
        key, by_name = self._named(values)
        stored, found = self._stored(key, by_name), {}
        others = self._stored(f"differences {key}", by_name, self._differences)
        for name in self.measured:
            found[name] = rates = np.empty((len(stored[name][0]), len(self.names)))
            direct = [one in self._direct[name] for one in self.names]
            rates[:, direct] = np.reshape(stored[name][1], (len(rates), -1))
            rates[:, np.logical_not(direct)] = np.reshape(others[name], (len(rates), -1))
        of_priors = np.zeros((len(self._priors), len(self.names)))
        for row, (name, (_, error)) in zip(of_priors, self._priors.items(), strict=True):
            row[self.names.index(name)] = 1 / error
        return np.vstack([self._all_weighted(found), of_priors])

    def by_given(self, values: Array) -> dict[str, Array]:
        """Derivatives of the residuals by the logarithms of the parameters of the problems that are
        given and not fitted, by name (n,)."""
        key, by_name = self._named(values)
        stored = self._stored(f"given {key}", by_name, self._of_given)
        if "refused" in stored:
            return {}
        sizes = {name: len(one[0]) for name, one in self._stored(key, by_name).items()}
        found, of_priors = {}, np.zeros(len(self._priors))
        for one in dict.fromkeys(one for rates in stored.values() for one in rates):
            rates = {n: np.array(stored[n].get(one, np.zeros(size))) for n, size in sizes.items()}
            found[one] = np.append(self._all_weighted(rates), of_priors)
        return found

    def _all_weighted(self, rates: Mapping[str, Array]) -> Array:
        """Derivatives over sigma of all measurements, from those by experiment."""
        found = []
        for name, group in self.measured.items():
            ends = np.cumsum([len(one.data) for one in group])[:-1]
            parts = zip(group, np.split(rates[name], ends), strict=True)
            found += [self._weighted(one, part) for one, part in parts]
        return np.concatenate(found)

    def compared(self, values: Array) -> list[tuple[Measured, Array]]:
        """What was measured, with what the runs have in its place (n,)."""
        stored, pairs = self._stored(*self._named(values)), []
        for name, group in self.measured.items():
            ends = np.cumsum([len(one.data) for one in group])[:-1]
            pairs += zip(group, np.split(np.array(stored[name][0]), ends), strict=True)
        return pairs

    def by_experiment(self, parts: Sequence[T]) -> dict[str, list[T]]:
        """One item for everything measured, by experiment."""
        rest = iter(parts)
        return {name: [next(rest) for _ in group] for name, group in self.measured.items()}

    def split(self, residuals: Array) -> list[Array]:
        """Residuals of everything measured."""
        ends = np.cumsum([len(one.data) for one in self._all])
        return np.split(residuals, ends)[:-1]

    def _named(self, values: Array) -> tuple[str, dict[str, float]]:
        numbers = values.tolist()
        return json.dumps(numbers), dict(zip(self.names, numbers, strict=True))

    def _weighted(self, one: Measured, part: Array) -> Array:
        sigma = np.broadcast_to(self.scale if one.sigma is None else one.sigma, one.data.shape)
        return one.without_nuisances((part.T / sigma).T)

    def _of_priors(self, values: Array) -> Array:
        logs = dict(zip(self.names, np.log(values), strict=True))
        known = self._priors.items()
        return np.array([(logs[name] - np.log(value)) / error for name, (value, error) in known])

    # Runs

    def _stored(
        self, key: str, values: dict[str, float], run: Callable | None = None
    ) -> dict[str, Any]:
        """What all experiments have, by name; from the file if it has it."""
        if key not in self.file.runs:
            try:
                found = self._each(lambda name: (run or self._experiment)(name, values))
            except (*REFUSALS, Refused) as error:
                if not self.runs:
                    raise
                found = {"refused": str(error)}
            # To the last digit the same on all ranks, which would otherwise part company.
            self.file.add(key, self.comm.bcast(found))
        return self.file.runs[key]

    def _each(self, call: Callable[[str], T]) -> dict[str, T]:
        """A call for every experiment, by one rank each if they are distributed; an error of one
        is raised on all."""
        comm = self.comm
        if not self._spread:
            return {name: call(name) for name in self._makes}
        parts, failed = {}, None
        try:
            for name in list(self._makes)[comm.rank :: comm.size]:
                parts[name] = call(name)
        except Exception as error:  # of a user's function too
            kind = Refused if isinstance(error, (*REFUSALS, Refused)) else RuntimeError
            failed = kind, f"identify: on rank {comm.rank}: {type(error).__name__}: {error}"
        for one in comm.allgather(failed):
            if one is not None:
                raise one[0](one[1])
        return {name: part for one in comm.allgather(parts) for name, part in one.items()}

    def _made(self, name: str, values: Mapping[str, float]) -> tuple[Problem, Monitor, Any]:
        comm = MPI.COMM_SELF if self._spread else self.comm
        made = together(comm, lambda: self._makes[name](dict(values)))
        if not (
            isinstance(made, tuple | list)
            and len(made) in (2, 3)
            and isinstance(made[0], Problem)
            and all(one is None or callable(one) for one in made[1:])
        ):
            raise TypeError(
                f"identify: make_problem of {name!r} returned {short(made)}; it must return a "
                "problem, its monitor or None and, if runs may end earlier, until"
            )
        problem, monitor, *rest = made
        fields = [one for one in self.measured[name] if isinstance(one, Field)]
        samples = {one.column: one.watch(problem) for one in fields}

        def watched(problem: Problem) -> dict[str, Any]:
            return {**(monitor(problem) or {}), **{key: take() for key, take in samples.items()}}

        return problem, watched if fields else monitor, rest[0] if rest else None

    def _run(self, name: str, values: Mapping[str, float], by: Mapping[str, float]) -> Compared:
        """What a run has in the place of all that was measured in an experiment, with derivatives
        by parameters of these values.

        Raises:
            StepFailure: it ends before it has reached everything.
        """
        problem, monitor, until = self._made(name, values)
        arguments = problem, self._loads[name], self._options, monitor
        failed = None
        try:
            history = solve(*arguments, until=until, derivatives=by or None).history
        except StepFailure as failure:
            failed, history = failure, failure.result.history
            if not len(history):
                raise
        found = [one.of_run(history, list(by)) for one in self.measured[name]]
        if failed is not None and not all(one.reached for one in found):
            raise failed
        values_of, slopes, _ = zip(*found, strict=True)
        return Compared(np.concatenate(values_of), np.concatenate(slopes), True)

    def _experiment(self, name: str, values: dict[str, float]) -> list[list]:
        """Values of an experiment (n,), and p d/dp of them by the parameters with derivatives along
        the run (n, k)."""
        by = {one: values[one] for one in self._direct[name]}
        found = self._run(name, values, by)
        return [found.values.tolist(), (found.slopes * [*by.values()]).tolist()]

    def _of_given(self, name: str, values: dict[str, float]) -> dict[str, list[float]]:
        """q d/dq of an experiment by parameters q that are not fitted, by name (n,), without those
        that follow the values."""
        problem, *_ = self._made(name, values)
        direct, first = self._direct[name], self._others[name]
        by = {one.name: one.value for one in other_parameters(problem, direct)} if first else {}
        by = {one: value for one, value in by.items() if np.isclose(value, first.get(one, np.nan))}
        if not by:
            return {}
        rates = self._run(name, values, by).slopes * [*by.values()]
        return dict(zip(by, rates.T.tolist(), strict=True))

    def _differences(self, name: str, values: dict[str, float]) -> list:
        """p d/dp of an experiment by the other parameters (n, k), by differences of whole runs;
        one-sided next to values without a run."""
        here = np.array(self.file.runs[self._named(np.array([*values.values()]))[0]][name][0])
        found = []
        for one in self.names:
            if one in self._direct[name]:
                continue
            ends, width = [], 0.0
            for h in (DIFFERENCE, -DIFFERENCE):
                try:
                    ends.append(self._run(name, values | {one: values[one] * (1 + h)}, {}).values)
                    width += DIFFERENCE
                except REFUSALS:
                    ends.append(here)
            found.append((ends[0] - ends[1]) / (width or 1.0))
        return np.reshape(found, (len(found), len(here))).T.tolist()
