"""What an identification finds: parameters with their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq
from scipy.stats import norm, t

from ..base.tables import html_table

Array = NDArray[np.float64]

#: Factor on an estimate at which the search for the end of an interval is given up, and largest one
#: in its first step.
UNLIMITED, FIRST = 1e3, 2.0

#: Error of the end of an interval, relative to its distance.
OF_END = 0.02


@dataclass(frozen=True)
class Run:
    """One evaluation of the model.

    Attributes:
        values: Parameters by name.
        cost: Half of the sum of the squares of the weighted residuals, priors included.
    """

    values: dict[str, float]
    cost: float


@dataclass(frozen=True)
class Identified:
    """Parameters that fit measured curves, with their uncertainty.

    The statistics are those of least squares in the logarithms of the parameters, linearised at
    the estimate.

    Attributes:
        estimate: Parameters by name.
        covariance: Of the logarithms (k, k): its diagonal has the squares of relative errors.
        correlation: Of the logarithms (k, k).
        residuals: Model minus measurement over sigma, by experiment and curve.
        jacobian: Derivatives of all weighted residuals by the logarithms, priors last (n, k).
        sigma_known: Whether the noise was given; otherwise it is estimated from the residuals.
        noise: Factor on the given sigma that the residuals show, or the estimated sigma.
        iterations: Number of iterations of least squares.
        runs: All evaluations, in order, later ones included.
        converged: Whether least squares converged.
        bounds: Smallest and largest value by name, 0 and inf without one.
        cost: The cost for any parameters by name, by a run.
        least_cost: The least cost with a parameter, by name, at a value, by several runs.
        warnings: Messages about parameters that the data do not determine.
    """

    estimate: dict[str, float]
    covariance: Array
    correlation: Array
    residuals: dict[str, list[Array]]
    jacobian: Array
    sigma_known: bool
    noise: float
    iterations: int
    runs: list[Run]
    converged: bool
    bounds: dict[str, list[float]]
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
        factor = np.exp(self._width(level) * self.relative_errors[name])
        return self.estimate[name] / factor, self.estimate[name] * factor

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
        freedom = self.jacobian.shape[0] - self.jacobian.shape[1]
        return float(norm.ppf(share) if self.sigma_known else t.ppf(share, freedom))

    def _distance(self, cost: float) -> float:
        """Distance from the estimate, in standard errors of a linear model."""
        least = next(run.cost for run in self.runs if run.values == self.estimate)
        scale = 1.0 if self.sigma_known else self.noise
        return float(np.sqrt(2 * max(cost - least, 0.0))) / scale

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
        scale = 1.0 if self.sigma_known else self.noise**2
        least = self.cost(self.estimate)
        return places, (np.array(costs) - least) / scale, places**2 / 2

    def plot(self, axes: Any) -> None:
        """Draw the weighted residuals over the number of the point.

        Args:
            axes: Axes of matplotlib.
        """
        for experiment, curves in self.residuals.items():
            for number, values in enumerate(curves):
                label = experiment if len(curves) == 1 else f"{experiment} {number + 1}"
                axes.plot(np.arange(1, len(values) + 1), values, "o-", lw=0.5, ms=3, label=label)
        axes.axhline(0.0, color="k", lw=0.8)
        axes.set(xlabel="number of the point", ylabel="residual over sigma")
        axes.legend()

    def _rows(self) -> list[tuple[str, float, float, float, float]]:
        rows = []
        for name, value in self.estimate.items():
            rows.append((name, value, self.relative_errors[name], *self.interval(name)))
        return rows

    def __str__(self) -> str:
        """A line for every parameter, and the warnings."""
        width = max(map(len, self.names))
        lines = [
            f"{name:{width}}  {value:.6g}  +- {100 * error:.2g} %  95 % in {low:.4g} .. {high:.4g}"
            for name, value, error, low, high in self._rows()
        ]
        head = f"{self.iterations} iterations, {len(self.runs)} runs" + (
            "" if self.converged else ", not converged"
        )
        return "\n".join([*lines, head, *self.warnings])

    def _repr_html_(self) -> str:
        """For notebooks: a table of the parameters."""
        columns = ("parameter", "estimate", "relative error", "95 % from", "to")
        return html_table(columns, self._rows())
