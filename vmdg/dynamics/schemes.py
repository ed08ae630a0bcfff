"""Time integration schemes and their parameters."""

from __future__ import annotations

from dataclasses import dataclass
from numbers import Real
from typing import Protocol


def _check(scheme: object, name: str, least: float, most: float) -> None:
    value = getattr(scheme, name)
    if isinstance(value, bool) or not isinstance(value, Real) or not least < float(value) <= most:
        raise ValueError(
            f"{type(scheme).__name__}: {name} = {value!r} must be a number in ({least:g}, {most:g}]"
        )


class Newmark(Protocol):
    """Newmark's relations with mean forces, see :class:`GeneralizedAlpha`.

    Attributes:
        alpha_m: Weight of the inertia at the start of a step.
        alpha_f: Weight of the forces at the start of a step.
        work_at_end: Weight of the end of a step in the work of loads and supports.
    """

    @property
    def alpha_m(self) -> float: ...
    @property
    def alpha_f(self) -> float: ...
    @property
    def gamma(self) -> float: ...
    @property
    def beta(self) -> float: ...
    @property
    def work_at_end(self) -> float: ...


@dataclass(frozen=True)
class AtEnd:
    """Newmark's relations with all forces of the end of a step, beta = 1/2 and gamma = 1, for steps
    in which bodies meet, separate, stick or slip (Kane et al. 1999, Comput. Methods Appl. Mech.
    Eng. 180, for the forces of contact).

    With M.a_1 = -R_1, v_1 = v_0 + h a_1 and u_1 - u_0 = h (v_0 + v_1)/2 the kinetic energy changes
    by

        v_1.M.v_1/2 - v_0.M.v_0/2 = -R_1.(u_1 - u_0),

    the work of the forces of the end, which for a convex energy U is at most U_0 - U_1: whatever
    the step, an impact makes no energy. Of first order.
    """

    alpha_m: float = 0.0
    alpha_f: float = 0.0
    gamma: float = 1.0
    beta: float = 0.5
    work_at_end: float = 1.0


@dataclass(frozen=True)
class GeneralizedAlpha:
    """Implicit integration of second order, with damping of high frequencies.

    Chung and Hulbert (1993): with the spectral radius rho at infinite frequency,

        alpha_m = (2 rho - 1)/(rho + 1),   alpha_f = rho/(rho + 1),
        gamma = 1/2 - alpha_m + alpha_f,   beta = (1 - alpha_m + alpha_f)^2/4,

    equilibrium is that of mean forces,

        M.((1 - alpha_m) a_1 + alpha_m a_0) + (1 - alpha_f) R_1 + alpha_f R_0 = 0,

    with the residuals R of (46) at the ends of the step, so that return maps are evaluated at its
    end only, and Newmark's relations (1959) give displacement and velocity. A step that would make
    more than 1 % of the largest kinetic and stored energy, as where bodies meet in long steps, is
    repeated with all forces of its end, which makes none; if that does, as a bond that would have
    taken more than there was, it is halved. So is a step that would lose as much in which surfaces
    meet or part, see :class:`.Balance`.

    Momentum is kept, as are its moment at small strain, and at finite strain up to second order: it
    is no scheme that keeps energy and momenta, whose forces would be those of the mean deformation
    of a step (Simo and Tarnow 1992, J. Appl. Math. Phys. 43). With rho_inf = 1 forces R_0 and R_1
    have no moment about their own positions x_0 and x_1, but do about the means of a step,

        sum(x_1 x M.v_1) - sum(x_0 x M.v_0) = h/4 sum((x_1 - x_0) x (R_1 - R_0)),

    and with the forces of the end of a step alone h/2 sum((x_1 - x_0) x R_1).

    Args:
        rho_inf: Spectral radius at infinite frequency: 1 keeps the energy of linear bodies, with
            0.8 the highest frequencies lose a fifth of their amplitude in a step. Friction that
            sticks chatters with 1.
        tolerance: Error of a step relative to the largest change of the displacement so far, root
            mean squares over the mass, to which steps between the given times adapt; None for the
            given times as steps. The error is (beta - 1/6) h^2 (a_1 - a_0) (Zienkiewicz and Xie
            1991, Earthq. Eng. Struct. Dyn. 20).

    Raises:
        ValueError: one is not in (0, 1].
    """

    rho_inf: float = 0.8
    tolerance: float | None = None

    def __post_init__(self) -> None:
        _check(self, "rho_inf", 0.0, 1.0)
        if self.tolerance is not None:
            _check(self, "tolerance", 0.0, 1.0)

    @property
    def alpha_m(self) -> float:
        """Weight of the inertia at the start of a step."""
        return (2 * self.rho_inf - 1) / (self.rho_inf + 1)

    @property
    def alpha_f(self) -> float:
        """Weight of the forces at the start of a step."""
        return self.rho_inf / (self.rho_inf + 1)

    @property
    def gamma(self) -> float:
        """Newmark's parameter of the velocity."""
        return 0.5 - self.alpha_m + self.alpha_f

    @property
    def beta(self) -> float:
        """Newmark's parameter of the displacement."""
        return (1 - self.alpha_m + self.alpha_f) ** 2 / 4

    @property
    def work_at_end(self) -> float:
        """Weight of the end of a step in the work of loads and supports."""
        return 0.5


@dataclass(frozen=True)
class CentralDifferences:
    """Explicit integration of second order with lumped masses.

        u_1 = u_0 + h v_0 + h^2 a_0/2,   M.a_1 = -R_1,   v_1 = v_0 + h (a_0 + a_1)/2.

    It is stable up to the critical step 2/omega, omega^2 the largest eigenvalue of M^-1.K with the
    tangent of the whole problem, interfaces included.

    Nodes of contact have no mass, so that the force of an impact does not oscillate. They keep it
    where surfaces slide, as a warning says: all of the boundary may meet the other body, and bodies
    are not to lose the mass of all of it. The force then oscillates by a third however fine the
    mesh, with :class:`GeneralizedAlpha` by a sixth; energies and momenta are as good.

    Args:
        safety: Step relative to the critical one.
        renewal: Number of steps after which tau_s and the critical step are computed again.

    Raises:
        ValueError: ``safety`` is not in (0, 1], or ``renewal`` is no positive integer.
    """

    safety: float = 0.9
    renewal: int = 100

    def __post_init__(self) -> None:
        _check(self, "safety", 0.0, 1.0)
        if isinstance(self.renewal, bool) or self.renewal != int(self.renewal) or self.renewal < 1:
            raise ValueError(
                f"CentralDifferences: renewal = {self.renewal!r} must be an integer >= 1"
            )
