"""Carries a problem over an unstable stage at constant load."""

from __future__ import annotations

from .iteration import LoadStep, StepReport
from .stepper import Stepper

#: The overstress at the start of a jump and its largest one, in multiples of H; below the inverse
#: of that there is none to speak of.
FIRST_OVERSTRESS, MAX_OVERSTRESS = 4.0, 1e8

#: The overstress is halved after a step with so few corrections, and grows by this factor after one
#: that fails.
FEW_CORRECTIONS, GROWTH = 5, 4.0


def jump(stepper: Stepper, t: float) -> tuple[StepReport, int]:
    """Carry the problem over an unstable stage at load factor ``t``.

    Displacement control has no equilibrium nearby. Steps at this load with an overstress
    eta = factor H per gap increment follow the bond as it breaks; the factor shrinks as they
    converge, until a step without it does: the end is an equilibrium of the law as it is.

    Args:
        stepper: Takes the steps.
        t: Load factor.

    Returns:
        Report of the last step and the number of steps with overstress. If it fails the problem is
        back where it was.
    """
    step, options = stepper.problem.step, stepper.options
    before = step.snapshot()
    # The time that passes, relative to the viscosity: the path goes on in it.
    overstress, time, steps, least_steps = FIRST_OVERSTRESS, 0.0, 0, 1
    report, leaving, failed = StepReport(False, [], ""), True, False
    stepper.forget_path()
    while steps < options.max_jump_steps and 1 / MAX_OVERSTRESS < overstress < MAX_OVERSTRESS:
        # More overstress is the cheaper second attempt, as long as it helps. What is still leaving
        # the equilibrium need not be exact.
        path = (time, time + 1 / overstress)
        report = stepper.step(LoadStep(t, overstress, path, second=failed, exact=not leaving))
        steps += 1
        failed = not report.converged
        if failed:
            overstress *= GROWTH
            continue
        time += 1 / overstress
        # A state that has hardly left the equilibrium would be taken for the next one.
        at_rest = report.iterations == 0 and not leaving
        leaving = leaving and report.iterations > 0
        if (at_rest or steps >= least_steps) and step.overstress() < options.jump_rest:
            # While the state moves, more steps are the cheaper second attempt here too.
            report = stepper.step(LoadStep(t, path=(time, time), second=at_rest))
            if report.converged:
                stepper.forget_path()
                return report, steps
            # It grows from small values while the state leaves the equilibrium: be patient.
            least_steps = 2 * steps
        if report.iterations <= FEW_CORRECTIONS:
            overstress /= 2
    step.return_to(before)
    stepper.forget_path()
    return report.failed(f"JUMP_FAILED after {steps} steps"), steps
