"""Least squares of measured curves, with derivatives along the path."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import OptimizeResult, least_squares

from ..base.agreement import same_arguments, together
from ..base.parallel import raise_together, warn_together
from ..base.texts import in_full
from ..problem.problem import Problem
from ..solver.monitors import Monitor, Until
from ..solver.options import SolveOptions, silent
from ..solver.result import StepFailure
from ..solver.stepping import solve
from .curves import Curve
from .result import Identified, Run

Array = NDArray[np.float64]

#: A problem for values of the parameters, the monitor that returns what was measured, and where the
#: run ends.
Make = Callable[[dict[str, float]], tuple[Problem, Monitor] | tuple[Problem, Monitor, Until]]

#: Relative standard error above which a parameter counts as not determined.
VAGUE = 0.5

#: Standard error of a logarithm of which the data say nothing.
UNKNOWN = 1e3

#: Relative tolerance of the cost, and of the logarithms of the parameters.
TOLERANCE = 1e-4

#: Largest number of evaluations of a fit of all parameters but one.
MOST_REFITTED = 10


def identify(
    make_problem: Make | Mapping[str, Make],
    measured: Curve | Sequence[Curve] | Mapping[str, Curve | Sequence[Curve]],
    start: Mapping[str, float],
    bounds: Mapping[str, tuple[float, float]] | None = None,
    sigma: float | None = None,
    *,
    loads: ArrayLike | Mapping[str, ArrayLike] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    options: SolveOptions | None = None,
    file: str | Path | None = None,
    comm: MPI.Comm | None = None,
    spread: bool = False,
    max_runs: int = 50,
) -> Identified:
    """Find parameters with which runs fit measured curves; collective.

    Least squares in the logarithms of the parameters, by the trust-region method of
    ``scipy.optimize.least_squares``, with the derivatives that are carried along the runs.

    Args:
        make_problem: ``f(values)`` returns a problem and its monitor for parameters by name, and
            ``until`` of :func:`vmdg.solve` for a run that ends before its last load factor; for
            several experiments such functions by name.
        measured: Curves of the experiment; by name for several.
        start: First values by the names of ``vmdg.solve(derivatives=)``, all positive.
        bounds: Smallest and largest value by name; none for others.
        sigma: Standard deviation of the noise of all curves without one of their own, in their
            unit; None to estimate it from the residuals.
        loads: Load factors of the run, by name for several; None for the abscissae of curves along
            "load".
        priors: What is known beforehand by name: value and relative standard deviation.
        options: Options of the runs.
        file: JSON file of all runs. If it exists, its runs are not repeated, so that a stopped
            identification continues.
        comm: All ranks that call this; None for ``MPI.COMM_WORLD``. With ``MPI.COMM_SELF``, for
            problems made on it, every rank identifies by itself, for example other seeds.
        spread: Whether the experiments are distributed over these ranks; ``make_problem`` then
            makes its problems on ``MPI.COMM_SELF``. Otherwise all take part in every run.
        max_runs: Largest number of evaluations of all experiments.

    Returns:
        The estimate with its covariance; it warns of parameters that the data do not determine.

    Raises:
        ValueError: a start value is not positive or outside of its bounds, names of bounds, priors
            or experiments do not match, or there are fewer points than parameters.
    """
    comm = MPI.COMM_WORLD if comm is None else comm
    same_arguments(
        comm,
        "identify",
        measured=_numbers(measured),
        start=start,
        bounds=bounds,
        sigma=sigma,
        loads=in_full(loads),
        priors=priors,
        options=silent(options),
        file=file,
        spread=spread,
        max_runs=max_runs,
    )
    if not isinstance(start, Mapping) or not start:
        raise ValueError(f"identify: start = {start!r} must be values by name, one or more")
    if not (isinstance(max_runs, int) and max_runs >= 1):
        raise ValueError(f"identify: max_runs = {max_runs!r} must be a whole number >= 1")
    several = isinstance(make_problem, Mapping)
    makes: dict[str, Make] = {}
    makes |= make_problem if isinstance(make_problem, Mapping) else {"measured": make_problem}
    curves = _by_experiment(makes, measured, several)
    programmes = _loads_of(curves, loads, several)
    names, (low, high) = list(start), _checked_bounds(start, bounds or {})
    known = _checked_priors(start, priors or {})
    _check_sigma(curves, sigma)
    count = sum(len(curve.x) for group in curves.values() for curve in group) + len(known)
    own = all(curve.sigma is not None for group in curves.values() for curve in group)
    if count < len(names) + (sigma is None and not own):
        raise ValueError(f"identify: {count} points do not determine {len(names)} parameters")
    given = makes, curves, programmes, options or SolveOptions(), sigma or 1.0, known
    model = _Model(*given, names, (low, high), comm, file, spread)
    solution = model.fit(np.log([start[name] for name in names]), max_runs)
    return _result(solution, model, sigma)


def _numbers(measured: Any) -> Any:
    """All numbers of curves, of one, of a list or by name."""
    if isinstance(measured, Mapping):
        return {name: _numbers(curve) for name, curve in measured.items()}
    if isinstance(measured, list | tuple):
        return [_numbers(curve) for curve in measured]
    return {k: in_full(v) for k, v in getattr(measured, "__dict__", {}).items()}


class _Model:
    """Weighted residuals and their derivatives for logarithms of the parameters."""

    def __init__(
        self,
        makes: Mapping[str, Make],
        curves: Mapping[str, Sequence[Curve]],
        loads: Mapping[str, Array],
        options: SolveOptions,
        sigma: float,
        priors: Mapping[str, tuple[float, float]],
        names: Sequence[str],
        bounds: tuple[Array, Array],
        comm: MPI.Comm,
        file: str | Path | None,
        spread: bool,
    ):
        self._makes, self.curves, self._loads = makes, curves, loads
        self._options, self._sigma, self._priors = options, sigma, priors
        self.names, self.bounds, self.comm = list(names), bounds, comm
        self._spread = spread and comm.size > 1
        self._file = None if file is None else Path(file)
        self.runs: list[Run] = []
        self._found: dict[str, tuple[Array, Array]] = {}
        points = {name: [one.x.tolist() for one in group] for name, group in curves.items()}
        self._head = {"parameters": self.names, "points": points}
        self._stored = self._read()

    def residuals(self, logs: Array) -> Array:
        """Weighted residuals of all curves, priors last (n,)."""
        return self._at(logs)[0]

    def jacobian(self, logs: Array) -> Array:
        """Their derivatives (n, k)."""
        return self._at(logs)[1]

    def fit(self, start: Array, max_runs: int, fixed: Sequence[int] = ()) -> OptimizeResult:
        """Least squares from these logarithms; those of some numbers stay as they are."""
        free = np.setdiff1d(np.arange(len(start)), fixed)

        def whole(some: Array) -> Array:
            logs = start.copy()
            logs[free] = some
            return logs

        low, high = self.bounds
        return least_squares(
            lambda some: self.residuals(whole(some)),
            start[free],
            lambda some: self.jacobian(whole(some))[:, free],
            bounds=(low[free], high[free]),
            xtol=TOLERANCE,
            ftol=TOLERANCE,
            max_nfev=max_runs,
        )

    def least_cost(self, place: int, logs: Array) -> float:
        """Least cost with the parameter of this number as in these logarithms, from which those of
        the others start."""
        if len(logs) > 1:
            return float(self.fit(np.clip(logs, *self.bounds), MOST_REFITTED, [place]).cost)
        return self.cost(dict(zip(self.names, np.exp(logs), strict=True)))

    def cost(self, values: Mapping[str, float]) -> float:
        """Half of the sum of squares for parameters by name."""
        r = self.residuals(np.log([values[name] for name in self.names]))
        return float(r @ r / 2)

    def _at(self, logs: Array) -> tuple[Array, Array]:
        """Weighted residuals and their derivatives."""
        key = json.dumps(logs.tolist())
        if key not in self._found:
            values = dict(zip(self.names, np.exp(logs).tolist(), strict=True))
            parts = self._curves_of(values, key)
            weighted = [self._weighted(name, *parts[name]) for name in self._makes]
            rows, slopes = zip(*weighted, *self._of_priors(logs), strict=True)
            self._found[key] = r, _ = np.concatenate(rows), np.vstack(slopes)
            self.runs.append(Run(values, float(r @ r / 2)))
        return self._found[key]

    def _curves_of(self, values: dict[str, float], key: str) -> dict[str, tuple[Array, Array]]:
        """Values of all curves by experiment (n,), and p d/dp (n, k); from the file if it has
        them."""
        if key not in self._stored:
            if self._spread:
                parts = self._spread_out(values)
            else:
                parts = {name: self._experiment(name, values) for name in self._makes}
            # To the last digit the same on all ranks, which would otherwise part company.
            parts = self.comm.bcast(parts)
            self._stored[key] = {n: [y.tolist(), rates.tolist()] for n, (y, rates) in parts.items()}
            together(self.comm, self._write)
        shape = -1, len(self.names)
        return {
            name: (np.array(y), np.array(rates).reshape(shape))
            for name, (y, rates) in self._stored[key].items()
        }

    def _spread_out(self, values: dict[str, float]) -> dict[str, tuple[Array, Array]]:
        """All experiments, each by one rank; an error of one is raised on all."""
        comm, parts, failed = self.comm, {}, None
        try:
            for name in list(self._makes)[comm.rank :: comm.size]:
                parts[name] = self._experiment(name, values)
        except Exception as error:  # of a user's function too
            failed = f"identify: on rank {comm.rank}: {type(error).__name__}: {error}"
        raise_together(comm, failed, RuntimeError)
        return {name: part for one in comm.allgather(parts) for name, part in one.items()}

    def _experiment(self, name: str, values: dict[str, float]) -> tuple[Array, Array]:
        """Values of the curves of an experiment, and p d/dp."""
        made = self._makes[name](dict(values))
        if not isinstance(made, tuple | list) or len(made) not in (2, 3):
            raise TypeError(
                f"identify: make_problem returned {made!r:.80}; it must return a problem and its "
                "monitor, and until= of solve if needed"
            )
        problem, monitor, *rest = made
        until: Until | None = rest[0] if rest else None
        arguments = problem, self._loads[name], self._options, monitor
        try:
            history = solve(*arguments, until=until, derivatives=values).history
        except StepFailure as failure:
            # What the run has not reached counts as where it ended.
            history = failure.result.history
            if not len(history):
                raise
        found = [curve.of_run(history, self.names) for curve in self.curves[name]]
        y, rates = (np.concatenate(part) for part in zip(*found, strict=True))
        return y, rates * np.array([values[one] for one in self.names])

    def _weighted(self, name: str, y: Array, rates: Array) -> tuple[Array, Array]:
        """Residuals of an experiment over sigma, and their derivatives."""
        group = self.curves[name]
        weights = [
            np.broadcast_to(self._sigma if one.sigma is None else one.sigma, one.y.shape)
            for one in group
        ]
        sigma = np.concatenate(weights)
        measured = np.concatenate([one.y for one in group])
        return (y - measured) / sigma, rates / sigma[:, None]

    def _of_priors(self, logs: Array) -> list[tuple[Array, Array]]:
        parts = []
        for name, (value, error) in self._priors.items():
            place = self.names.index(name)
            slope = np.zeros((1, len(self.names)))
            slope[0, place] = 1 / error
            parts.append((np.array([(logs[place] - np.log(value)) / error]), slope))
        return parts

    def by_experiment(self, residuals: Array) -> dict[str, list[Array]]:
        """Weighted residuals by experiment and curve."""
        found: dict[str, list[Array]] = {}
        first = 0
        for name, group in self.curves.items():
            found[name] = []
            for curve in group:
                found[name].append(residuals[first : first + len(curve.x)])
                first += len(curve.x)
        return found

    # The file of runs

    def _read(self) -> dict[str, Any]:
        """Stored runs by the logarithms of their parameters."""
        stored = self.comm.bcast(together(self.comm, self._of_file))
        if stored is None:
            return {}
        if any(stored.get(name) != value for name, value in self._head.items()):
            raise ValueError(
                f"identify: {self._file} has runs for other parameters or abscissae than "
                f"{self.names}; give another file, or delete it"
            )
        return stored["runs"]

    def _of_file(self) -> dict[str, Any] | None:
        """What the file says, on rank 0; None if there is none."""
        if self._file is None or self.comm.rank > 0 or not self._file.is_file():
            return None
        return json.loads(self._file.read_text())

    def _write(self) -> None:
        """Write all runs, on rank 0."""
        if self._file is None or self.comm.rank > 0:
            return
        self._file.parent.mkdir(parents=True, exist_ok=True)
        near = self._file.with_suffix(".part")
        near.write_text(json.dumps(self._head | {"runs": self._stored}))
        near.replace(self._file)


def _result(solution: Any, model: _Model, sigma: float | None) -> Identified:
    """Statistics of a solution of least squares."""
    J, r = model.jacobian(solution.x), model.residuals(solution.x)
    n, k = J.shape
    noise = float(np.sqrt(r @ r / max(n - k, 1)))
    known = sigma is not None or all(
        curve.sigma is not None for group in model.curves.values() for curve in group
    )
    scale = 1.0 if known else noise
    _, sizes, directions = np.linalg.svd(J, full_matrices=False)
    errors = scale / np.maximum(sizes, scale / UNKNOWN)
    covariance = directions.T @ (errors[:, None] ** 2 * directions)
    deviations = np.sqrt(np.diag(covariance))
    estimate = dict(zip(model.names, np.exp(solution.x).tolist(), strict=True))

    def least_cost(name: str, value: float) -> float:
        place = model.names.index(name)
        way = covariance[place] / covariance[place, place]
        return model.least_cost(place, solution.x + (np.log(value) - solution.x[place]) * way)

    found = Identified(
        estimate=estimate,
        covariance=covariance,
        correlation=covariance / np.outer(deviations, deviations),
        residuals=model.by_experiment(r),
        jacobian=J,
        sigma_known=known,
        noise=noise,
        iterations=solution.njev - 1,
        runs=model.runs,
        converged=solution.status > 0,
        bounds=dict(zip(model.names, np.exp(np.transpose(model.bounds)).tolist(), strict=True)),
        cost=model.cost,
        least_cost=least_cost,
    )
    for name, error in found.relative_errors.items():
        if error > VAGUE:
            found.warnings.append(
                f"the data do not determine {name}: its standard error is {100 * error:.3g} % of "
                f"its value. Measure where it matters, add another experiment, or give a prior"
            )
    bounded = [name for name, mask in zip(model.names, solution.active_mask, strict=True) if mask]
    if bounded:
        found.warnings.append(f"{', '.join(bounded)} ended at a bound, where errors are not valid")
    for message in found.warnings:
        warn_together(model.comm, f"identify: {message}")
    return found


# The user's input


def _by_experiment(makes: Mapping[str, Make], measured: Any, several: bool) -> dict[str, list]:
    """Curves by experiment."""
    if several != isinstance(measured, Mapping):
        raise ValueError(
            "identify: for several experiments give both make_problem and measured by name, "
            '{"DCB": ..., "ENF": ...}'
        )
    given = dict(measured) if several else {"measured": measured}
    if set(given) != set(makes):
        raise ValueError(f"identify: experiments {sorted(makes)}, but curves of {sorted(given)}")
    curves = {
        name: [given[name]] if isinstance(given[name], Curve) else list(given[name])
        for name in makes
    }
    for name, group in curves.items():
        if not group or not all(isinstance(curve, Curve) for curve in group):
            raise TypeError(
                f"identify: measured of {name!r} must be a vmdg.Curve or a list of them"
            )
    return curves


def _loads_of(curves: Mapping[str, Sequence[Curve]], loads: Any, several: bool) -> dict[str, Array]:
    """Load factors by experiment."""
    if loads is not None:
        if several and (not isinstance(loads, Mapping) or set(loads) != set(curves)):
            raise ValueError(f"identify: give loads= by name of the experiments {sorted(curves)}")
        given = loads if several else {"measured": loads}
        return {name: np.asarray(given[name], dtype=float) for name in curves}
    found = {}
    for name, group in curves.items():
        along = [curve.x for curve in group if curve.along == "load"]
        if not along or any((np.diff(x) <= 0).any() or x[0] <= 0 for x in along):
            raise ValueError(
                f"identify: give loads=, the load factors of the runs of {name!r}: only where a "
                'curve along "load" rises from above 0 they are its abscissae'
            )
        found[name] = np.unique(np.concatenate(along))
    return found


def _checked_bounds(
    start: Mapping[str, float], bounds: Mapping[str, tuple[float, float]]
) -> tuple[Array, Array]:
    """Logarithms of the bounds."""
    if unknown := sorted(set(bounds) - set(start)):
        raise ValueError(f"identify: bounds of {unknown[0]!r}, which is not in start {list(start)}")
    ends = []
    for name, value in start.items():
        low, high = bounds.get(name, (0.0, np.inf))
        if not (value > 0 and np.isfinite(value)):
            raise ValueError(f"identify: start[{name!r}] = {value!r} must be positive and finite")
        if not 0 <= low < value < high:
            raise ValueError(
                f"identify: start[{name!r}] = {value!r} must lie inside of its bounds {low}, {high}"
            )
        ends.append((np.log(low) if low > 0 else -np.inf, np.log(high)))
    low, high = np.array(ends).T
    return low, high


def _checked_priors(
    start: Mapping[str, float], priors: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    for name, (value, error) in priors.items():
        if name not in start:
            raise ValueError(f"identify: a prior of {name!r}, which is not in start {list(start)}")
        if not (value > 0 and error > 0):
            raise ValueError(
                f"identify: the prior of {name} must be a positive value and its relative standard "
                f"deviation, not {value!r}, {error!r}"
            )
    return dict(priors)


def _check_sigma(curves: Mapping[str, Sequence[Curve]], sigma: float | None) -> None:
    if sigma is not None and not sigma > 0:
        raise ValueError(f"identify: sigma = {sigma!r} must be positive")
    own = [curve.sigma is not None for group in curves.values() for curve in group]
    if sigma is None and any(own) and not all(own):
        raise ValueError("identify: give sigma= for the curves that have none")
