"""What speaks against the result of a fit, as text with the cure."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm, t

from .model import LEVEL, TOLERANCE, Fit, Measured, Model
from .result import Identified

Array = NDArray[np.float64]

#: Relative standard error above which a parameter counts as not determined.
VAGUE = 0.5

#: Probability with which independent noise stays below a limit on its shape.
LEVEL_OF_SHAPE = 0.99

#: Residuals beyond the parameters without which their scatter says too little to name an outlier.
FEW = 3

#: Ratio of the largest values of a run and of a measurement that points to different units.
UNLIKE = 100.0


def doubts(found: Identified, solution: Fit, model: Model) -> tuple[list[str], bool]:
    """Messages about a result: what the data do not determine, and what the model does not fit; and
    whether the fit is stuck where parameters change nothing."""
    said, still = _unlike(model), model.still(solution.values)
    misfit = (_misfit(found, model) if found.sigma_known else []) or _shape(found, model)
    stuck = bool(still.any() and (misfit or (still.all() and not found.sigma_known)))
    if stuck:
        values = {name: found.estimate[name] for name in np.array(model.names)[still]}
        said.append(
            f"the runs do not change with {_named(values)}, which the fit cannot leave. Either a "
            "bond is broken before the first measured point, or nothing fails in the runs, or all "
            "of it breaks between two points, or abscissae and model are in different units: begin "
            "where the curve of the run resembles the measured one, with a lower strength and a "
            "larger gap or energy"
        )
    else:
        said += misfit
        said += [
            f"the data do not determine {name}: its standard error is {100 * error:.3g} % of "
            "its value. Measure where it matters, add another experiment, or give a prior"
            for name, error in found.relative_errors.items()
            if error > VAGUE
        ]
    if solution.bounded.any():
        names = [name for name, hit in zip(model.names, solution.bounded, strict=True) if hit]
        said.append(f"{', '.join(names)} ended at a bound, where errors are not valid")
    if solution.status == 0:
        said.append(
            f"the fit was ended by max_runs = {len(model.runs)} before it converged: begin again "
            "at found.estimate, with more runs"
        )
    elif model.runs[-1].refused and not stuck:
        said.append(
            "the fit ended next to values of the parameters that have no run, and its minimum may "
            f"be among them: {model.runs[-1].refused:.200}"
        )
    return said, stuck


def _named(values: dict[str, float]) -> str:
    return ", ".join(f"{name} = {value:.6g}" for name, value in values.items())


def _items(found: Identified) -> list[tuple[str, Measured, Array]]:
    """Everything measured, with its residuals over sigma, and what to call it."""
    items = []
    for experiment, group in found.measured.items():
        for one, r in zip(group, found.residuals[experiment], strict=True):
            items.append((f" in {experiment}" if len(found.measured) > 1 else "", one, r))
    return items


def _misfit(found: Identified, model: Model) -> list[str]:
    """Where the sum of squares is beyond the limit of noise: of all, or of one measurement."""
    sizes = [(float(r @ r), max(len(r) - one.nuisances, 1)) for _, one, r in _items(found)]
    total = float(sum(size for size, _ in sizes)), max(found.freedom, 1)
    if all(size <= chi2.ppf(LEVEL, count) for size, count in (*sizes, total)):
        return []
    limit = float(np.sqrt(chi2.ppf(LEVEL, total[1]) / total[1]))
    name, one, r = max(_items(found), key=lambda item: np.abs(item[2]).max())
    worst = int(np.abs(r).argmax())
    return [
        f"the model misses the data by {found.noise:.3g} sigma, noise alone by no more than "
        f"{limit:.3g} in {100 * LEVEL:g} % of measurements; most, by {abs(r[worst]):.3g} sigma, "
        f"{one.at(worst)}{name}. The errors are not valid. Look at found.plot(): one point alone "
        "is an outlier; a shape means that law, bodies or supports of the model are not those of "
        "the test, or that a better minimum lies elsewhere (begin at another start); a larger "
        "scatter, that sigma is too small"
    ]


def _shape(found: Identified, model: Model) -> list[str]:
    """Where residuals are not independent noise of one size: they follow each other, by the ratio
    of von Neumann (1941), or one is an outlier, by its externally studentized residual."""
    said = []
    deleted = np.split(*_studentized(found, model))
    for (name, one, r), away in zip(_items(found), deleted, strict=False):
        n, size = len(r), np.linalg.norm(r)
        exact = size <= TOLERANCE * np.linalg.norm(one.data) / model.scale
        if n < 4 or exact:
            continue
        ratio = n / (n - 1) * float(np.sum(np.diff(r) ** 2)) / size**2
        mean = 2 * n / (n - 1)
        deviation = np.sqrt(4 * n**2 * (n - 2) / ((n + 1) * (n - 1) ** 3))
        if ratio < mean + norm.ppf(1 - LEVEL_OF_SHAPE) * deviation:
            said.append(
                f"the residuals of the {one.column}{name} follow each other (ratio of von Neumann "
                f"{ratio:.2g}, of noise {mean:.2g}), by {found.noise:.3g} in the mean: law, bodies "
                "or supports of the model are not those of the test, or a better minimum lies "
                "elsewhere (begin at another start). The errors are not valid; look at found.plot()"
            )
        worst, tail = int(np.abs(away).argmax()), (1 - LEVEL_OF_SHAPE) / (2 * len(found.jacobian))
        outside = abs(away[worst]) > t.ppf(1 - tail, max(found.freedom - 1, 1))
        # A known sigma allows for what is small next to it.
        beyond = not found.sigma_known or abs(r[worst]) > norm.ppf(1 - tail)
        if found.freedom > FEW and outside and beyond:
            said.append(
                f"{one.at(worst)}{name} is an outlier, {abs(away[worst]):.2g} times the scatter of "
                "the others from the model: leave it out, give it a larger sigma, or, if more "
                "follow, look at found.plot() for what the model lacks"
            )
    return said


def _studentized(found: Identified, model: Model) -> tuple[Array, Array]:
    """Residuals over their standard deviation with the scatter of all others, for a linear model
    (n,), priors last, and where those of a measurement end.

    At a kink of the model the fit ends with residuals that the derivatives of one side could still
    lessen; without that part no scatter is below zero. It is at least the error of a fit.
    """
    values = np.array([*found.estimate.values()])
    r = model.residuals(values)
    Q = np.linalg.qr(found.jacobian)[0]
    r = r - Q @ (Q.T @ r)
    rest = np.maximum(1 - np.sum(Q**2, axis=1), TOLERANCE)
    others = np.maximum(r @ r - r**2 / rest, 0.0) / max(found.freedom - 1, 1)
    data = np.concatenate([one.data for _, one, _ in _items(found)]) / model.scale
    error = TOLERANCE**2 * (data @ data) / max(len(data), 1)
    away = r / np.sqrt(np.maximum(others, error) * rest)
    return away, np.cumsum([len(r) for _, _, r in _items(found)])


def _unlike(model: Model) -> list[str]:
    """Measurements of another size or sign than the run of the start."""
    said = []
    for one, run in model.compared(np.array([*model.start.values()])):
        run, data = (one.without_nuisances(values) for values in (run, one.data))
        if not run.any() or not data.any():
            continue
        sizes = np.abs(run).max(), np.abs(data).max()
        if max(sizes) > UNLIKE * min(sizes):
            said.append(
                f"the {one.column} of the run at the start is up to {sizes[0]:.3g}, that measured "
                f"up to {sizes[1]:.3g}: are they in the same unit?"
            )
        elif run @ data < 0:
            said.append(
                f"the {one.column} of the run at the start has the opposite sign of that measured: "
                "change the sign of one of them"
            )
    return said
