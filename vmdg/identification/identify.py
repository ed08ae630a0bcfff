"""Parameters from measured curves, by least squares with derivatives along the path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.agreement import same_arguments
from ..base.parallel import warn_together
from ..base.texts import in_full
from ..output.history import split_unit
from ..solver.options import SolveOptions, silent
from .doubts import doubts
from .fields import Field
from .model import Fit, Make, Measured, Model
from .result import Given, Identified

Array = NDArray[np.float64]

#: Standard error of a logarithm of which the data say nothing.
UNKNOWN = 1e3

#: Smallest singular value of the derivatives, relative to the largest, where there is no noise.
EXACT = 1e-12


def identify(
    make_problem: Make | Mapping[str, Make],
    measured: Measured | Sequence[Measured] | Mapping[str, Measured | Sequence[Measured]],
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
        raise ValueError(f"identify: max_runs = {max_runs!r} must be an integer >= 1")
    several = isinstance(make_problem, Mapping)
    makes: dict[str, Make] = {}
    makes |= make_problem if isinstance(make_problem, Mapping) else {"measured": make_problem}
    curves = _by_experiment(makes, measured, several)
    programmes = _loads_of(curves, loads, several)
    bounded = _checked_bounds(start, bounds or {})
    beforehand = _checked_priors(start, priors or {})
    _check_sigma(curves, sigma)
    given = makes, curves, programmes, options or SolveOptions(), sigma, beforehand
    model = Model(*given, start, bounded, comm, file, spread)
    if model.freedom < (0 if model.known else 1):
        raise ValueError(f"identify: {model.count} points do not determine {len(start)} parameters")
    first = np.array([float(value) for value in start.values()])
    with model.claimed():
        model.open()
        model.residuals(first)
        for name, hint in model.suspects.items():
            if not model.jacobian(first)[:, list(start).index(name)].any():
                raise ValueError(f"identify: no run changes with {name}{hint}")
        solution = model.solve(first, max_runs)
        return _result(solution, model)


def _numbers(measured: Any) -> Any:
    """All numbers of curves, of one, of a list or by name."""
    if isinstance(measured, Mapping):
        return {name: _numbers(curve) for name, curve in measured.items()}
    if isinstance(measured, list | tuple):
        return [_numbers(curve) for curve in measured]
    return {k: in_full(v) for k, v in getattr(measured, "__dict__", {}).items()}


def _result(solution: Fit, model: Model) -> Identified:
    """Statistics of a solution of least squares."""
    J, r = model.jacobian(solution.values), model.residuals(solution.values)
    noise = float(np.sqrt(r @ r / max(model.freedom, 1)))
    scale = 1.0 if model.known else noise
    _, sizes, directions = np.linalg.svd(J, full_matrices=False)
    errors = scale / np.maximum(sizes, scale / UNKNOWN if scale else EXACT * sizes.max(initial=1.0))
    covariance = directions.T @ (errors[:, None] ** 2 * directions)
    deviations = np.sqrt(np.diag(covariance))
    estimate = dict(zip(model.names, solution.values.tolist(), strict=True))

    def least_cost(name: str, value: float) -> float:
        place = model.names.index(name)
        way = covariance[place] / covariance[place, place]
        values = solution.values * np.exp(np.log(value / estimate[name]) * way)
        values[place] = value
        with model.claimed():
            return model.least_cost(place, values)

    def cost(values: Mapping[str, float]) -> float:
        with model.claimed():
            return model.cost(values)

    compared = model.compared(solution.values)
    found = Identified(
        estimate=estimate,
        covariance=covariance,
        correlation=covariance / np.outer(deviations, deviations),
        measured=model.by_experiment([one for one, _ in compared]),
        fitted=model.by_experiment([values for _, values in compared]),
        residuals=model.by_experiment(model.split(r)),
        jacobian=J,
        freedom=model.freedom,
        sigma_known=model.known,
        noise=noise if model.known else noise * model.scale,
        iterations=solution.iterations,
        runs=model.runs,
        converged=solution.status > 0,
        bounds=dict(zip(model.names, np.transpose(model.bounds).tolist(), strict=True)),
        differenced=[name for name in model.names if name in model.differenced],
        energies=_energies(estimate, covariance, model.plateaus),
        given=_given(solution, model, scale),
        cost=cost,
        least_cost=least_cost,
    )
    said, stuck = doubts(found, solution, model)
    found = replace(found, converged=found.converged and not stuck, warnings=said)
    for message in found.warnings:
        warn_together(model.comm, f"identify: {message}")
    return found


def _given(solution: Fit, model: Model, scale: float) -> dict[str, Given]:
    """What parameters q that are given do to the estimates p: at a minimum of r^T.r

        d log p/d log q = -J^+.g,   g = dr/d log q,

    without second derivatives; what is left of g is what the data show of q."""
    free = ~(model.still(solution.values) | solution.bounded)
    J, found = np.where(free, model.jacobian(solution.values), 0.0), {}
    for name, g in model.by_given(solution.values).items():
        effects = -np.linalg.lstsq(J, g, rcond=None)[0]
        with np.errstate(divide="ignore", invalid="ignore"):
            error = float(np.float64(scale) / np.linalg.norm(g + J @ effects))
        found[name] = Given(dict(zip(model.names, effects.tolist(), strict=True)), error)
    return found


def _energies(
    estimate: dict[str, float], covariance: Array, plateaus: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Fracture energies G_c = P_c (zeta_c + zeta_p)/2 of laws whose strength and critical gap were
    found, with their relative standard errors."""
    names, found = list(estimate), {}
    for key, plateau in plateaus.items():
        strength, gap, flat = (f"{key}.{of}" for of in ("strength", "critical_gap", "plateau_gap"))
        if strength in estimate and gap in estimate:
            gaps = {gap: estimate[gap], flat: estimate.get(flat, plateau)}
            total = sum(gaps.values())
            # d log G_c / d log p
            slopes = {strength: 1.0} | {name: value / total for name, value in gaps.items()}
            way = np.array([slopes.get(name, 0.0) for name in names])
            found[key] = estimate[strength] * total / 2, float(np.sqrt(way @ covariance @ way))
    return found


# The user's input


def _by_experiment(makes: Mapping[str, Make], measured: Any, several: bool) -> dict[str, list]:
    if several != isinstance(measured, Mapping):
        raise ValueError(
            "identify: for several experiments give both make_problem and measured by name, "
            '{"DCB": ..., "ENF": ...}'
        )
    given = dict(measured) if several else {"measured": measured}
    if set(given) != set(makes):
        raise ValueError(f"identify: experiments {sorted(makes)}, but curves of {sorted(given)}")
    groups = {
        name: [given[name]] if isinstance(given[name], Measured) else list(given[name])
        for name in makes
    }
    for name, group in groups.items():
        if not group or not all(isinstance(one, Measured) for one in group):
            raise TypeError(
                f"identify: measured of {name!r} must be a vmdg.Curve, a vmdg.Field or a list of "
                "them"
            )
        fields = [one.column for one in group if isinstance(one, Field)]
        if len(fields) == len(group):
            raise ValueError(
                f"identify: a field of displacements says nothing about the size of forces: give a "
                f"vmdg.Curve of the force of {name!r} too, [vmdg.Curve(...), vmdg.Field(...)]"
            )
        if len(set(fields)) < len(fields):
            raise ValueError(f"identify: give the fields of {name!r} different names, column=")
    return groups


def _loads_of(
    curves: Mapping[str, Sequence[Measured]], loads: Any, several: bool
) -> dict[str, Array]:
    if loads is not None:
        if several and (not isinstance(loads, Mapping) or set(loads) != set(curves)):
            raise ValueError(f"identify: give loads= by name of the experiments {sorted(curves)}")
        given = loads if several else {"measured": loads}
        return {name: np.asarray(given[name], dtype=float) for name in curves}
    found = {}
    for name, group in curves.items():
        along = [
            one.loads if isinstance(one, Field) else one.x
            for one in group
            if split_unit(one.along)[0] == "load"
        ]
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
    """Smallest and largest values (k,)."""
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
        ends.append((low, high))
    low, high = np.array(ends, dtype=float).T
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


def _check_sigma(curves: Mapping[str, Sequence[Measured]], sigma: float | None) -> None:
    if sigma is not None and not sigma > 0:
        raise ValueError(f"identify: sigma = {sigma!r} must be positive")
    own = {curve.sigma is not None for group in curves.values() for curve in group}
    if sigma is None and len(own) > 1:
        raise ValueError("identify: give sigma= for the curves that have none")
