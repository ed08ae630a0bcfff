"""What an identification finds: parameters with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import norm, t

from ..base.tables import html_table

Array = NDArray[np.float64]

#: Factor on an estimate at which the search for the end of an interval is given up, and largest one
#: in its first step.
UNLIMITED, FIRST = 1e3, 2.0

#: Distance from the estimate of values without a run, in standard errors.
REFUSED = 1e3

#: Per cent of an estimate for one of a given parameter that is not worth a word.
SMALL = 0.01

#: Error of the end of an interval, relative to its distance.
OF_END = 0.02


@dataclass(frozen=True)
class Run:
    """One evaluation of the model."""

    values: dict[str, float]
    # Half of the sum of the squares of the weighted residuals, priors included; inf without a run
    cost: float
    refused: str = ""  # Why there is no run; empty where there is one


class Given(NamedTuple):
    """What a parameter of the model that is given, and not fitted, does to a result.

    Attributes:
        effects: By how many per cent each estimate changes if it is larger by one, by name.
        error: Standard error of its logarithm if it were fitted too: what the data say about it.
    """

    effects: dict[str, float]
    error: float


@dataclass(frozen=True)
class Identified:
    """Parameters that fit measured curves, with their uncertainty.

    The statistics are those of least squares in the logarithms of the parameters, linearised at
    the estimate.

    Attributes:
        estimate: Parameters by name.
        covariance: Of the logarithms (k, k): its diagonal has the squares of relative errors.
        correlation: Of the logarithms (k, k).
        measured: What was measured, by experiment.
        fitted: What the run of the estimate has in its place, by experiment.
        residuals: Model minus measurement over sigma, by experiment; where sigma is not known in
            units of a common number of the size of the measured values.
        jacobian: Derivatives of all weighted residuals by the logarithms, priors last (n, k).
        freedom: Number of data, priors included, minus those of all that is fitted.
        sigma_known: Whether the noise was given; otherwise it is estimated from the residuals.
        noise: Factor on the given sigma that the residuals show, or the estimated sigma.
        iterations: Number of iterations of least squares.
        runs: All evaluations, in order, later ones included.
        converged: Whether least squares converged, and not where nothing changes with any
            parameter.
        bounds: Smallest and largest value by name, 0 and inf without one.
        differenced: Parameters whose derivatives are differences of whole runs; those of others
            are carried along the runs.
        energies: G_c and its relative standard error, by name of interfaces whose strength and
            critical gap are parameters.
        given: Parameters of the problems that are not fitted, with what they do to the estimates,
            by name; without those that have no derivatives along a run.
        cost: The cost for any parameters by name, by a run.
        least_cost: The least cost with a parameter, by name, at a value, by several runs.
        warnings: Messages about parameters that the data do not determine.
    """

    estimate: dict[str, float]
    covariance: Array
    correlation: Array
    measured: dict[str, list[Any]]
    fitted: dict[str, list[Array]]
    residuals: dict[str, list[Array]]
    jacobian: Array
    freedom: int
    sigma_known: bool
    noise: float
    iterations: int
    runs: list[Run]
    converged: bool
    bounds: dict[str, list[float]]
    differenced: list[str]
    energies: dict[str, tuple[float, float]]
    given: dict[str, Given]
    cost: Callable[[Mapping[str, float]], float] = field(repr=False)
    least_cost: Callable[[str, float], float] = field(repr=False)
    warnings: list[str] = field(default_factory=list)

    @property
    def names(self) -> list[str]:
        """Names of the parameters."""
        return list(self.estimate)

    @property
    def relative_errors(self) -> dict[str, float]:
        """Standard errors of the logarithms, which are relative errors of the parameters."""
        return dict(zip(self.names, np.sqrt(np.diag(self.covariance)).tolist(), strict=True))

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter, linearised.

        Args:
            name: Its name.
            level: Probability with which such intervals contain the true value.
        """
        return self._around(self.estimate[name], self.relative_errors[name], level)

    def _around(self, value: float, error: float, level: float) -> tuple[float, float]:
        with np.errstate(over="ignore"):
            factor = float(np.exp(self._width(level) * error))
        return value / factor, value * factor

    def profile_interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of a parameter from the cost itself, by further runs; collective.

        All values with which the others can be chosen such that the cost rises no more than in
        such an interval of a linear model: where derivatives at the estimate do not tell how the
        cost rises, as with teeth on the curve or far from the estimate, this is the one to trust.
        Values of all runs that fit as well are inside; if one fits better than the estimate, begin
        again from it. It takes some 20 runs; those of a ``file`` are not repeated.

        Args:
            name: Its name.
            level: Probability with which such intervals contain the true value.

        Returns:
            Its ends; 0 or inf for one that the data do not limit.
        """
        wide = self._width(level)
        ends = [self._end(name, side, wide) for side in (-1, 1)]
        # Other runs may have found other minima, even lower ones.
        ends += [run.values[name] for run in self.runs if self._distance(run.cost) <= wide]
        return min(ends), max(ends)

    def _end(self, name: str, side: int, wide: float) -> float:
        """Where the least cost with a parameter fixed has risen to this number of standard errors,
        below or above the estimate."""
        value, bound = self.estimate[name], self.bounds[name][side > 0]
        most = min(np.log(UNLIMITED), abs(np.log(bound / value)) if bound > 0 else np.inf)

        def excess(way: float) -> float:
            if way == 0:
                return -wide
            return self._distance(self.least_cost(name, value * np.exp(side * way))) - wide

        inner, outer = 0.0, min(wide * self.relative_errors[name], np.log(FIRST), most)
        while excess(outer) < 0:
            if outer == most:
                limited = most < np.log(UNLIMITED)
                return bound if limited else (np.inf if side > 0 else 0.0)
            inner, outer = outer, min(2 * outer, most)
        return value * np.exp(side * brentq(excess, inner, outer, xtol=OF_END * outer))

    def _width(self, level: float) -> float:
        """Half of a confidence interval in standard errors."""
        share = (1 + level) / 2
        return float(norm.ppf(share) if self.sigma_known else t.ppf(share, self.freedom))

    def _distance(self, cost: float) -> float:
        """Distance from the estimate, in standard errors of a linear model."""
        least = next(run.cost for run in self.runs if run.values == self.estimate)
        if not np.isfinite(cost):
            return REFUSED
        return float(np.sqrt(2 * max(cost - least, 0.0))) / self._scale

    @property
    def least_certain(self) -> tuple[dict[str, float], float]:
        """The direction of the logarithms, of length 1, about which the data say least, and its
        standard error."""
        variances, directions = np.linalg.eigh(self.covariance)
        way = directions[:, -1] * np.sign(directions[np.abs(directions[:, -1]).argmax(), -1])
        return dict(zip(self.names, way.tolist(), strict=True)), float(np.sqrt(variances[-1]))

    def profile(self, steps: Sequence[float] = (-2, -1, 0, 1, 2)) -> tuple[Array, Array, Array]:
        """The cost along the least certain direction, by further runs.

        Where it differs much from the parabola the linearised intervals cannot be trusted.

        Args:
            steps: Distances from the estimate, in standard errors.

        Returns:
            The steps, the increase of the cost, and steps^2/2, that of the parabola (n,).
        """
        direction, error = self.least_certain
        places, costs = np.array(steps, dtype=float), []
        for place in places:
            factors = {name: np.exp(place * error * way) for name, way in direction.items()}
            values = {name: self.estimate[name] * factor for name, factor in factors.items()}
            costs.append(self.cost(values))
        least = self.cost(self.estimate)
        return places, (np.array(costs) - least) / self._scale**2, places**2 / 2

    @property
    def _scale(self) -> float:
        r = np.concatenate([one for group in self.residuals.values() for one in group])
        return 1.0 if self.sigma_known else float(np.sqrt(r @ r / self.freedom))

    def plot(self, figure: Any = None) -> Any:
        """Draw what was measured with its noise and the run of the estimate, and below the
        residuals over sigma, with the band that holds 95 % of them.

        Args:
            figure: A figure of matplotlib, or None for a new one.

        Returns:
            The figure.
        """
        if figure is None:
            import matplotlib.pyplot as plt

            figure = plt.figure(layout="constrained")
        items = [
            (experiment, *parts)
            for experiment in self.measured
            for parts in zip(
                *(one[experiment] for one in (self.measured, self.fitted, self.residuals)),
                strict=True,
            )
        ]
        axes = figure.subplots(2, len(items), squeeze=False, height_ratios=(3, 1), sharex="col")
        for (experiment, one, fitted, residuals), (top, bottom) in zip(items, axes.T, strict=True):
            sigma = self.noise if one.sigma is None and not self.sigma_known else one.sigma
            one.draw(top, fitted, sigma)
            x = one.abscissae
            bottom.axhspan(-1.96, 1.96, color="0.9")
            bottom.axhline(0.0, color="k", lw=0.8)
            bottom.plot(x, residuals / self._scale, "ko", ms=3)
            bottom.set(xlabel=one.along, ylabel="residual / sigma")
            if len(self.measured) > 1:
                top.set_title(experiment)
        return figure

    def _rows(self) -> list[tuple[str, float, float, float, float]]:
        values = [
            (name, value, self.relative_errors[name]) for name, value in self.estimate.items()
        ]
        values += [(f"G_c of {name}", *one) for name, one in self.energies.items()]
        return [(*one, *self._around(*one[1:], 0.95)) for one in values]

    def __str__(self) -> str:
        """A line for every parameter, the noise, correlations, what was done, and the warnings."""
        rows = self._rows()
        width = max(len(name) for name, *_ in rows)
        lines = [
            f"{name:{width}}  {value:.6g}  +- {100 * error:.2g} %  95 % in {low:.4g} .. {high:.4g}"
            for name, value, error, low, high in rows
        ]
        lines.append(f"noise {self.noise:.3g}{' sigma' if self.sigma_known else ', estimated'}")
        if len(self.names) > 1:
            lines.append("correlation")
            for i, name in enumerate(self.names):
                numbers = "".join(f"  {value:6.3f}" for value in self.correlation[i, : i + 1])
                lines.append(f"  {name:{width}}{numbers}")
        if self.given:
            lines.append("these errors are of noise; of what is given, 1 % more changes")
        for name, one in self.given.items():
            changes = [f"{k} by {v:+.2g} %" for k, v in one.effects.items() if abs(v) > SMALL]
            told = f"tell it within {100 * one.error:.2g} %" if one.error < 1 else "do not tell it"
            lines.append(f"  {name:{width}}  {', '.join(changes) or 'nothing'}; the data {told}")
        refused = sum(bool(run.refused) for run in self.runs)
        head = f"{self.iterations} iterations, {len(self.runs)} runs"
        head += f", {refused} of them refused" if refused else ""
        head += "" if self.converged else ", not converged"
        lines.append(head)
        if self.differenced:
            lines.append(f"by differences of whole runs: {', '.join(self.differenced)}")
        return "\n".join([*lines, *(f"warning: {message}" for message in self.warnings)])

    def _repr_html_(self) -> str:
        columns = ("parameter", "estimate", "relative error", "95 % from", "to")
        return html_table(columns, self._rows())
