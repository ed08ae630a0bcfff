"""Carries a problem over a real snap: from a limit point to the next equilibrium at its load."""

from __future__ import annotations

from .control import ROUGH, Brake, Control
from .report import StepReport
from .stepper import Stepper

#: The overstress at the start of a jump and its largest one, in multiples of H.
FIRST_OVERSTRESS, MAX_OVERSTRESS = 4.0, 1e8

#: Corrections that a step should take, its largest growth, and what one that fails is cut by.
AIM, GROWTH, CUT = 5, 2.0, 0.25

#: Steps before a jump is given up.
MAX_STEPS = 200


def jump(
    stepper: Stepper, t: float, span: float, work: float, max_steps: int = MAX_STEPS
) -> tuple[StepReport, int]:
    """Carry the problem to the next equilibrium at a load factor.

    Steps at this load follow the bonds as they break. An overstress eta = factor H per gap
    increment slows them down, in each step so much that the work on bonds is what it is to be, see
    :class:`vmdg.solver.control.Brake`. Where that takes no overstress, or no bond is left, a step
    without it ends at an equilibrium of the law as it is. What bonds and friction do not take of
    the energy on the way is released, and counted with the viscous work.

    Args:
        stepper: Takes the steps; the problem is in a state from which it runs away at this load.
        t: Load factor.
        span: Of the stage.
        work: Work on bonds in the first step at this load [N mm].
        max_steps: Steps with overstress before it is given up.

    Returns:
        Report of the last step and the number of steps with overstress. If it fails the problem is
        back where it was.
    """
    problem, step = stepper.problem, stepper.problem.step
    before, imbalance = step.snapshot(), problem.energy().imbalance
    report, ahead = StepReport(False, [], ""), None
    drag, steps, there = FIRST_OVERSTRESS, 0, False
    while steps < max_steps and drag < MAX_OVERSTRESS:
        start = step.snapshot()
        control = Brake(0.0, drag, work) if there else Control(t, span)
        report = stepper.step(control, ahead, overstress=drag)
        steps += 1
        if not there:
            there = report.converged
            drag = drag if there else drag / CUT
            continue
        slowed, ended = step.drag, report.work < (1 - ROUGH) * work
        if report.converged and (slowed <= 0 or ended):
            if slowed <= 0:
                step.return_to(start)
            report = stepper.step(Control(t, span))
            if report.converged:
                step.release(problem.energy().imbalance - imbalance)
                return report, steps
        if not report.converged or report.work > (1 + ROUGH) * work:
            step.return_to(start)
            work, drag, ahead = CUT * work, drag / CUT, None
            continue
        growth = min(AIM / max(report.iterations, 1), GROWTH)
        work, drag, ahead = growth * work, slowed / max(growth, 1.0), report.change
    step.return_to(before)
    return report.failed(f"JUMP_FAILED after {steps} steps"), steps
