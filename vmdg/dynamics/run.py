"""A run in time: steps to given times, their history and energies."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeAlias

import numpy as np
from dolfinx import fem
from numpy.typing import ArrayLike, NDArray

from ..base.agreement import together
from ..base.parallel import raise_together, warn_together
from ..base.texts import in_full
from ..base.words import as_numbers
from ..checks.model import check_duration
from ..domain.tags import Group, by_tag
from ..output.history import History
from ..points.interface import label_of
from ..problem.loading import groups_of, let_go
from ..problem.motion import moving
from ..problem.problem import Problem
from ..problem.step import enter_given_state
from ..solver.attempt import Attempt
from ..solver.monitors import Monitor, watched_row
from ..solver.options import SolveOptions
from ..solver.reasons import explained
from ..solver.result import Result, StepFailure
from ..solver.run import agreed, common_columns, run_of
from .balance import Losses
from .contact_nodes import massless
from .explicit import ExplicitSteps
from .implicit import ImplicitSteps
from .schemes import CentralDifferences, GeneralizedAlpha
from .supports import SupportMotion

Array = NDArray[np.float64]
Scheme: TypeAlias = GeneralizedAlpha | CentralDifferences
Velocity: TypeAlias = Callable[[Array], Array] | fem.Function | Mapping[Group, ArrayLike] | None


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
            :attr:`.Problem.space`, a function of positions x (3, n) with values (d, n), or
            velocities (d,) by group, such as ``{"bar": (0, -1e4)}``, others at rest; None for the
            current one, zero at first [mm/s].
        monitor: As for :func:`vmdg.solve`.
        options: As for :func:`vmdg.solve`; there is no path to follow.
        history: History of an earlier run to continue, from :func:`vmdg.read_checkpoint`: the
            motion continues as it was, ``velocity`` is ignored, and times up to ``problem.t`` are
            skipped.

    Returns:
        History with time, iterations, residual, number of steps, energies if requested, and values
        of the monitor. The imbalance of energies is what the scheme has damped or added; above 5 %
        of the largest kinetic and stored energy a warning says so, once.

    Raises:
        StepFailure: a step fails after ``max_cuts`` halvings.
        ValueError: the problem has no density, or something that has no motion here: a rigid face,
            facets that open on demand, or a fluid in a crack; with :class:`CentralDifferences` a
            mean strain that follows from a stress; times that do not increase; an initial velocity
            of the wrong size.
        TypeError: an argument of the wrong type.
    """
    scheme = GeneralizedAlpha() if scheme is None else scheme
    given = {"times": in_full(times), "scheme": scheme, "velocity": velocity}
    functions = {"monitor": monitor}
    options = agreed(problem, "solve_dynamics", options, history, functions, **given)
    times = _checked(problem, times, scheme, velocity, options, history)
    result = Result(history=History() if history is None else history)
    if not len(times):
        return result
    problem.loading.clear_ray()
    let_go(problem.loading)
    with run_of(problem, options, result, len(times), history is not None) as run:
        supports = SupportMotion(problem.comm, problem.loading, problem.t, float(times[-1]))
        steps = _steps(problem, scheme, options, supports, history is not None)
        run.krylov, losses = lambda: steps.krylov, Losses(problem, steps.cure)
        if history is None:
            _set_out(problem, velocity, supports, float(times[0]), steps)
        for number, t in enumerate(times):
            start, found, taken, reasons = problem.t, Attempt(), steps.taken, []
            problem.step.set_out()
            run.check()
            for found in steps.advance(float(t)):
                if not found.converged:
                    reasons.append(found.reason)
                    result.failures.append((problem.t, found.reason))
                    run.progress.say(f"step in time from {problem.t:.8g} s failed: {found.reason}")
                run.check()
            if problem.t < t:
                failed = problem.t
                run.back()
                raise StepFailure(_complaint(failed, float(t), problem.t, reasons), result)
            row, more = common_columns(
                problem, "time [s]", found, len(result.history) + 1, len(reasons), options.energy
            )
            row |= {"steps [-]": steps.taken - taken} | more
            run.add(row | watched_row(problem, monitor), found)
            losses.look(steps.balance)
            run.progress.advanced(number + 1, t - start, found, result.history)
            if run.save(at_end=number == len(times) - 1):
                # A run that is resumed from here has no factors or tangents of earlier steps.
                steps.free()
                steps = _steps(problem, scheme, options, supports, False)
        # Not after a failure, where a single rank must not wait for the others.
        steps.free()
    return result


def _checked(
    problem: Problem,
    times: ArrayLike,
    scheme: Scheme,
    velocity: Velocity,
    options: SolveOptions,
    history: History | None,
) -> Array:
    """The times, after checks of the arguments; collective."""
    if not isinstance(scheme, Scheme):
        raise TypeError(
            f"solve_dynamics: scheme = {scheme!r} must be vmdg.GeneralizedAlpha() or "
            "vmdg.CentralDifferences()"
        )
    given = np.asarray(times)
    start, kinds = problem.t, "iuf"
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
    if isinstance(scheme, CentralDifferences) and history is None:
        _warn_of_masses(problem)
    if history is None and len(given):
        check_duration(problem, float(given[-1]) - start)
    return given.astype(float)


def _warn_of_masses(problem: Problem) -> None:
    """Say that explicit steps leave contact nodes of surfaces that slide their mass; collective."""
    active = problem.discretization.active.items()
    keeps = [i for i, one in active if one.facets.slides and massless(one.law)]
    message = (
        f"solve_dynamics: surfaces that slide, those of {label_of(problem.interfaces, keeps[0])}, "
        "keep the mass of their contact nodes in explicit steps, so that the force of an impact "
        "oscillates by a third on any mesh; impulses, energies and momenta do not. Use means of "
        "the force over some steps, GeneralizedAlpha, with half of that, or sliding=False where "
        "they slide by less than a facet"
        if keeps
        else None
    )
    warn_together(problem.comm, message)


def _set_out(
    problem: Problem,
    velocity: Velocity,
    supports: SupportMotion,
    first: float,
    steps: ImplicitSteps | ExplicitSteps,
) -> None:
    """Take an initial velocity, of supports as they move up to the first time, and the acceleration
    that belongs to it; collective."""
    motion, d = moving(problem.step.motion), problem.mesh.geometry.dim
    kinetic = motion.kinetic_energy()
    v = motion.velocity.x.array
    if isinstance(velocity, fem.Function):
        if velocity.function_space != problem.space:
            raise ValueError(
                "solve_dynamics: velocity must be a Function of problem.space, or a function of x"
            )
        v = velocity.x.array
    elif isinstance(velocity, Mapping):
        v = _by_group(problem, velocity)
    elif callable(velocity):
        x = problem.space.tabulate_dof_coordinates().T
        values = together(problem.comm, lambda: as_numbers(velocity(x)))
        shape = d, x.shape[1]
        right = values.shape == shape and bool(np.isfinite(values).all())
        message = f"solve_dynamics: velocity returned {values.shape}, expected {shape}, finite"
        raise_together(problem.comm, None if right else message)
        v = values.T.ravel()
        if (means := problem.discretization.means) is not None:
            v[means.rows] = 0.0
    elif velocity is not None:
        raise TypeError(
            f"solve_dynamics: velocity = {velocity!r} must be a Function of problem.space, a "
            'function of positions x (3, n) with values (d, n), or velocities by group, {"bar": '
            "(0, -1e4)}"
        )
    start = v[: problem.discretization.owned].copy()
    start[problem.loading.owned_prescribed] = supports.at(problem.t, problem.t, first)[0]
    motion.move(start, motion.acceleration)
    problem.step.ledger.enter_start(motion.kinetic_energy() - kinetic)
    steps.accelerate()
    enter_given_state(problem.step)


def _by_group(problem: Problem, velocity: Mapping[Group, ArrayLike]) -> Array:
    """Velocity of local dofs from those of groups; where bodies share nodes, of the last group."""
    d, cells_of = problem.mesh.geometry.dim, problem.discretization.bodies.cells_of
    given = by_tag(velocity, groups_of(problem.loading), "solve_dynamics: velocity")
    v = np.zeros_like(problem.u.x.array)
    for tag, value in given.items():
        values = as_numbers(value)
        if tag not in cells_of:
            raise ValueError(
                f"solve_dynamics: velocity: no cell has tag {tag}; tags are {sorted(cells_of)}"
            )
        if values.shape != (d,) or not np.isfinite(values).all():
            raise ValueError(
                f"solve_dynamics: velocity of {tag} = {value!r} must be {d} finite numbers"
            )
        v.reshape(-1, d)[problem.space.dofmap.list[cells_of[tag]]] = values
    return v


def _steps(
    problem: Problem,
    scheme: Scheme,
    options: SolveOptions,
    supports: SupportMotion,
    continues: bool,
) -> ImplicitSteps | ExplicitSteps:
    if isinstance(scheme, CentralDifferences):
        return ExplicitSteps(problem, scheme, options, supports, continues)
    return ImplicitSteps(problem, scheme, options, supports)


def _complaint(failed: float, t: float, row: float, reasons: list[str]) -> str:
    why = explained(reasons, in_time=True)
    return (
        f"the step in time from {failed:.8g} to {t:.8g} s failed; the problem is in the state of "
        f"its last row, at {row:.8g} s. In the last attempt {why}."
    )
