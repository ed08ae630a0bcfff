"""Carries a problem over a real snap: from a limit point to the next equilibrium at its load."""

from __future__ import annotations

from .control import ROUGH, Brake, Control
from .report import StepReport
from .stepper import Stepper

#: The overstress at the start of a jump, and at which it is given up, in multiples of H.
FIRST_OVERSTRESS, MAX_OVERSTRESS = 4.0, 1e8

#: The overstress that as good as holds bonds, the one at which bodies that moved are at rest, and
#: the share of the work on bonds in a jump that is little for a step.
HELD, REST, SPENT = 1e3, 1e-4, 1e-2

#: Corrections that a step should take, the largest growth of one, and what one that fails is cut
#: by.
AIM, GROWTH, CUT = 4, 2.0, 0.25

#: Steps before a jump, or a given load factor, is given up.
MAX_STEPS = 200


def growth_after(report: StepReport) -> float:
    """How much longer than a step the next one may be, by the corrections it took."""
    return min(AIM / max(report.iterations, 1), GROWTH)


def jump(stepper: Stepper, t: float, span: float, work: float) -> tuple[StepReport, int]:
    """Carry the problem to the next equilibrium at a load factor.

    Steps at this load follow the bonds as they break, slowed down by an overstress eta = factor H
    per gap increment: as much of it as makes the work on bonds what it is to be, see
    :class:`vmdg.solver.control.Brake`, or a given one at the start, after a step that has failed,
    and where so little is left to break that it would take more. Where it takes none, or nothing
    breaks any more, a step without it ends at an equilibrium of the law as it is.

    Where steps fail although bonds are as good as held it is bodies that move, as in buckling. A
    drag slows them down in proportion to the overstress,

        R(u) + c (u - u_n) = 0,

    the steepest descent of the energy in time by backward Euler: K + c I is positive definite for a
    c that is large enough. It falls until they rest (Kelley and Keyes 1998).

    Args:
        stepper: Takes the steps; the problem is in a state from which it runs away at this load.
        t: Load factor.
        span: Of the stage.
        work: Work on bonds in the first step at this load [N mm].

    Returns:
        Report of the last step and the number of steps with overstress. If it fails the problem is
        back where it was.
    """
    step = stepper.problem.step
    before, scales = step.snapshot(), step.scales
    report, ahead = StepReport(False, [], ""), None
    drag, steps, done, moves = FIRST_OVERSTRESS, 0, 0.0, False
    while steps < MAX_STEPS and drag < MAX_OVERSTRESS:
        start, brakes = step.snapshot(), drag < FIRST_OVERSTRESS and not moves
        control = Brake(0.0, drag, work) if brakes else Control(t, span, moves=moves)
        report = stepper.step(control, ahead, overstress=drag)
        steps += 1
        strays = report.work > (1 + ROUGH) * work if brakes else moves and report.unstable
        if not report.converged or strays:
            step.return_to(start)
            if not moves and drag > HELD and not stepper.problem.discretization.bodies.small:
                moves, drag = True, CUT * FIRST_OVERSTRESS
            work, drag, ahead = CUT * work, drag / CUT, None
            continue
        slowed = step.drag
        done += report.work
        little = (1 - ROUGH) * work if brakes else SPENT * done
        rests = drag < REST if moves else report.work <= little
        if slowed <= 0 or rests:
            if slowed <= 0:
                step.return_to(start)
            end = stepper.step(Control(t, span))
            if end.converged:
                return end, steps
            if brakes or moves:
                work, drag, ahead = CUT * work, FIRST_OVERSTRESS, None
                continue
        growth = growth_after(report)
        work, ahead = growth * max(work, report.work), report.change if brakes else None
        slowed = drag if moves else min(slowed, FIRST_OVERSTRESS)
        drag = slowed / (max(growth, 1.0) if brakes else GROWTH)
    step.return_to(before)
    step.scales = scales
    return report.failed(f"JUMP_FAILED after {steps} steps"), steps
