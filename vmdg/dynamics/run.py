"""A run in time: steps to given times, their history and energies."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike, NDArray

from ..base.agreement import Interrupt, same_arguments, together
from ..base.parallel import raise_together
from ..base.texts import in_full
from ..base.timers import timer, timings, timings_since
from ..checkpoint.checkpoint import warn_of_replacement, write_checkpoint
from ..output.history import History, HistoryFile
from ..problem.loading import let_go
from ..problem.motion import moving
from ..problem.problem import Problem
from ..problem.step import enter_given_state
from ..solver.attempt import Attempt
from ..solver.monitors import Monitor, check_functions, energy_columns, sliding_column, watched_row
from ..solver.options import SolveOptions, silent
from ..solver.progress import Progress
from ..solver.reasons import explained
from ..solver.result import Counts, Result, StepFailure
from ..solver.stepping import claimed
from .explicit import ExplicitSteps
from .implicit import ImplicitSteps
from .schemes import CentralDifferences, GeneralizedAlpha
from .supports import SupportMotion

Array = NDArray[np.float64]
Scheme: TypeAlias = GeneralizedAlpha | CentralDifferences
Velocity: TypeAlias = Callable[[Array], Array] | fem.Function | None


def solve_dynamics(
    problem: Problem,
    times: ArrayLike,
    scheme: Scheme | None = None,
    velocity: Velocity = None,
    monitor: Monitor | None = None,
    options: SolveOptions | None = None,
    history: History | None = None,
) -> Result:
    """Solve for the motion at a sequence of times.

    The load factor is the time: loads and supports are functions of it, and viscous laws take its
    steps. A run starts in the current state of the problem, at its time ``problem.t``: at rest,
    after :func:`vmdg.solve` or after another run in time.

    A periodic cell, u = (F_bar - I).X + w, has the motion of an infinite body whose mean
    deformation is F_bar(t): for every periodic eta

        int rho w_tt.eta + int P(F_bar + GRAD w):GRAD eta + (terms of interfaces) = 0.

    The inertia of F_bar_tt.X is left to the large scale: it is zero at a constant rate of F_bar,
    and at another the body of one material has the strain F_bar - I everywhere, and what happens is
    the same wherever the cell is cut. At rest means that w is. Energies balance with the work
    V P_bar:dF_bar of the mean stress, which is that of ``Periodic(stress=...)`` at every time, and
    with the kinetic energy of w, whose momentum is kept. Nor has F_33 of generalized plane strain
    any inertia.

    Args:
        problem: A problem with a ``density``, changed in place.
        times: Increasing times, each a row of the history [s]. With :class:`GeneralizedAlpha` they
            are the steps, which are halved where one fails; with :class:`CentralDifferences` steps
            in between are stable.
        scheme: The scheme; None for ``GeneralizedAlpha()``.
        velocity: Velocity at the start, in a periodic cell of w: a Function of
            :attr:`.Problem.space`, or a function of positions x (3, n) with values (d, n); None for
            the current one, zero at first [mm/s].
        monitor: As for :func:`vmdg.solve`.
        options: As for :func:`vmdg.solve`; there is no path to follow.
        history: History of an earlier run to continue, from :func:`vmdg.read_checkpoint`: the
            motion continues as it was, ``velocity`` is ignored, and times up to ``problem.t`` are
            skipped.

    Returns:
        History with time, iterations, residual, number of steps, energies if requested, and values
        of the monitor. The imbalance of energies is what the scheme has damped or added.

    Raises:
        StepFailure: a step fails after ``max_cuts`` halvings.
        ValueError: the problem has no density, or something that has no motion here: a rigid face,
            facets that open on demand, or a fluid in a crack; with :class:`CentralDifferences` a
            mean strain that follows from a stress; times that do not increase; an initial velocity
            of the wrong size.
        TypeError: an argument of the wrong type.
    """
    options = SolveOptions() if options is None else options
    scheme = GeneralizedAlpha() if scheme is None else scheme
    if not isinstance(problem, Problem):
        raise TypeError(f"solve_dynamics: problem = {problem!r} must be a vmdg.Problem")
    same_arguments(
        problem.comm,
        "solve_dynamics",
        times=in_full(times),
        scheme=scheme,
        velocity=velocity,
        monitor=monitor and "given",
        options=silent(options),
        history=len(history) if isinstance(history, History) else history,
    )
    times = _checked(problem, times, scheme, options, history)
    check_functions(monitor=monitor)
    result = Result(history=History() if history is None else history)
    if not len(times):
        return result
    if options.checkpoint is not None and history is None:
        warn_of_replacement(problem.comm, options.checkpoint)
    before, motion = timings(), moving(problem.step.motion)
    problem.loading.clear_ray()
    let_go(problem.loading)
    with (
        timer("solve"),
        Interrupt(problem.comm) as interrupt,
        claimed(problem, options),
        HistoryFile(problem.comm, options.csv, result.history) as file,
        Progress(problem, len(times), options) as progress,
    ):
        supports = SupportMotion(problem.comm, problem.loading, problem.t, float(times[-1]))
        steps = _steps(problem, scheme, options, supports)
        if history is None:
            kinetic = motion.kinetic_energy()
            _set_out(problem, velocity, supports.at(problem.t, problem.t, float(times[0]))[0])
            problem.step.ledger.enter_start(motion.kinetic_energy() - kinetic)
            steps.accelerate()
            enter_given_state(problem.step)
        written = len(result.history)
        for number, t in enumerate(times):
            start, found, cuts, count = problem.t, Attempt(), 0, 0
            problem.step.set_out()
            for found in steps.advance(float(t)):
                interrupt.check()
                if not found.converged:
                    result.failures.append((problem.t, found.reason))
                cuts, count = cuts + (not found.converged), count + found.converged
            if problem.t < t:
                raise StepFailure(_complaint(problem, float(t), found), result)
            _add_row(problem, found, cuts, count, options, monitor, result)
            file.update()
            progress.advanced(number + 1, t - start, found, result.history)
            unsaved, last = len(result.history) - written, number == len(times) - 1
            if options.checkpoint and (unsaved >= options.checkpoint_every or last):
                write_checkpoint(problem, options.checkpoint, result.history)
                written = len(result.history)
                # A run that is resumed from here has no factors or tangents of earlier steps.
                steps.free()
                steps = _steps(problem, scheme, options, supports)
        steps.free()
    result.timings = timings_since(before)
    result.counts = Counts.from_timings(result.timings, steps.krylov)
    if (options.progress or options.verbose) and problem.comm.rank == 0:
        print(result.summary())
    return result


def _checked(
    problem: Problem,
    times: ArrayLike,
    scheme: Scheme,
    options: SolveOptions,
    history: History | None,
) -> Array:
    """The times, after checks of all arguments; collective."""
    if not isinstance(scheme, Scheme):
        raise TypeError(
            f"solve_dynamics: scheme = {scheme!r} must be vmdg.GeneralizedAlpha() or "
            "vmdg.CentralDifferences()"
        )
    if not isinstance(options, SolveOptions):
        raise TypeError(f"solve_dynamics: options = {options!r} must be SolveOptions(...)")
    given = np.asarray(times)
    start, kinds = problem.t, "iuf"
    if history is not None and not isinstance(history, History):
        raise TypeError(f"solve_dynamics: history = {history!r} must be a History")
    if given.ndim != 1 or not given.size or given.dtype.kind not in kinds:
        raise ValueError(
            f"solve_dynamics: times = {times!r} must be a list of times, for example "
            "numpy.linspace(0, 1e-3, 101)[1:]"
        )
    if history is not None:
        given = given[~(given <= start)]
    if not np.isfinite(given).all() or (np.diff(given, prepend=start) <= 0).any():
        raise ValueError(
            f"solve_dynamics: times must be finite and increase from problem.t = {start:.8g} on"
        )
    loading = problem.loading
    refused = {
        "a rigid face; use a wall, vmdg.Rigid, or a stiff body": bool(loading.rigid),
        "facets that open on demand; use activate='all'": bool(problem.step.activation),
        "a fluid in a crack": bool(loading.given.filled),
        "cycles": options.cycles > 0,
    }
    for what, present in refused.items():
        if present:
            raise ValueError(f"solve_dynamics has no motion for {what}")
    moving(problem.step.motion)
    return given.astype(float)


def _set_out(problem: Problem, velocity: Velocity, of_supports: Array) -> None:
    """Take an initial velocity, of supports as they move; collective."""
    motion, d = moving(problem.step.motion), problem.mesh.geometry.dim
    v = motion.velocity.x.array
    if isinstance(velocity, fem.Function):
        if velocity.function_space != problem.space:
            raise ValueError(
                "solve_dynamics: velocity must be a Function of problem.space, or a function of x"
            )
        v = velocity.x.array
    elif callable(velocity):
        x = problem.space.tabulate_dof_coordinates().T
        values = together(problem.comm, lambda: np.asarray(velocity(x), dtype=float))
        shape = d, x.shape[1]
        right = values.shape == shape and bool(np.isfinite(values).all())
        message = f"solve_dynamics: velocity returned {values.shape}, expected {shape}, finite"
        raise_together(problem.comm, None if right else message)
        v = values.T.ravel()
        if (means := problem.discretization.means) is not None:
            v[means.rows] = 0.0
    elif velocity is not None:
        raise TypeError(
            f"solve_dynamics: velocity = {velocity!r} must be a Function of problem.space or a "
            "function of positions x (3, n) with values (d, n)"
        )
    start = v[: problem.discretization.owned].copy()
    start[problem.loading.owned_prescribed] = of_supports
    motion.move(start, motion.acceleration)


def _steps(
    problem: Problem, scheme: Scheme, options: SolveOptions, supports: SupportMotion
) -> ImplicitSteps | ExplicitSteps:
    if isinstance(scheme, CentralDifferences):
        return ExplicitSteps(problem, scheme, supports)
    return ImplicitSteps(problem, scheme, options, supports)


def _add_row(
    problem: Problem,
    found: Attempt,
    cuts: int,
    count: int,
    options: SolveOptions,
    monitor: Monitor | None,
    result: Result,
) -> None:
    """Add the row of a time."""
    row = {
        "time [s]": problem.t,
        "iterations [-]": found.iterations,
        "residual [N]": found.norms[-1],
        "cuts [-]": cuts,
        "steps [-]": count,
    }
    row |= sliding_column(problem)
    if options.energy:
        row |= energy_columns(problem)
    result.history.append(row | watched_row(problem, monitor))
    result.residuals.append(found.norms)


def _complaint(problem: Problem, t: float, found: Attempt) -> str:
    return (
        f"the step in time from {problem.t:.8g} to {t:.8g} s failed; the problem is in its state "
        f"at {problem.t:.8g} s. In the last attempt {explained([found.reason])}."
    )
