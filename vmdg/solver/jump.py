"""Carries a problem over a real snap: from a limit point to the next equilibrium at its load."""

from __future__ import annotations

from .control import Control
from .report import StepReport
from .stepper import Stepper

#: The overstress at the start of a jump and its largest one, in multiples of H; below the inverse
#: of that there is none to speak of.
FIRST_OVERSTRESS, MAX_OVERSTRESS = 4.0, 1e8

#: The overstress is halved after a step with so few corrections, and grows by this factor after one
#: that fails.
FEW_CORRECTIONS, GROWTH = 5, 4.0

#: Overstress relative to the strength below which a jump that slows down is tried to end without
#: it, and steps before a jump is given up.
REST, MAX_STEPS = 0.1, 200


def jump(
    stepper: Stepper, t: float, span: float, max_steps: int = MAX_STEPS
) -> tuple[StepReport, int]:
    """Carry the problem to the next equilibrium at a load factor.

    Steps at this load with an overstress eta = factor H per gap increment follow the bond as it
    breaks; the factor shrinks as they converge, until a step without it does: the end is an
    equilibrium of the law as it is. What bonds and friction do not take of the energy on the way is
    released, and counted with the viscous work.

    Args:
        stepper: Takes the steps; the problem is in a state from which it runs away at this load.
        t: Load factor.
        span: Of the stage.
        max_steps: Steps with overstress before it is given up.

    Returns:
        Report of the last step and the number of steps with overstress. If it fails the problem is
        back where it was.
    """
    problem, step = stepper.problem, stepper.problem.step
    before, imbalance = step.snapshot(), problem.energy().imbalance
    overstress, steps, work = FIRST_OVERSTRESS, 0, 0.0
    report = StepReport(False, [], "")
    while steps < max_steps and 1 / MAX_OVERSTRESS < overstress < MAX_OVERSTRESS:
        report = stepper.step(Control(t, span), overstress=overstress)
        steps += 1
        if not report.converged:
            overstress, work = GROWTH * overstress, 0.0
            continue
        slows, work = report.work <= work, report.work
        if slows and step.overstress() < REST:
            report = stepper.step(Control(t, span))
            if report.converged:
                step.release(problem.energy().imbalance - imbalance)
                return report, steps
        if report.iterations <= FEW_CORRECTIONS:
            overstress /= 2
    step.return_to(before)
    return report.failed(f"JUMP_FAILED after {steps} steps"), steps
