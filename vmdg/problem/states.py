"""States of a problem, and its energies and means."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import Discretization
from ..domain.point_bodies import PointState
from ..interface.history import InterfaceSnapshot
from .motion import MotionState
from .work import Increment


@dataclass(frozen=True)
class Energy:
    """Energies of the whole body [N mm], the same on every rank.

    Attributes:
        bulk: Strain energy of the bodies.
        interface: Stored by the interfaces: (30), and the recoverable energy of an elastic bond.
            (30) is {P.N}.s + s.tau.s/2 with s = g - zeta, the small discretization opening of an
            intact interface. It is not the energy of a spring and may be negative: it corrects an
            excess in the bodies. Only the sum with ``bulk`` is an energy.
        damage: Dissipated in bonds since the start.
        friction: Dissipated by friction since the start.
        viscosity: Dissipated by the overstress, or released in jumps, since the start [N mm].
        external: Work of prescribed displacements, loads and eigenstrains since the start; see
            :meth:`.Problem.energy` for its accuracy at finite strain.
        discretization: Added since the start by a tau_s that changes between steps, the change of
            (30) at fixed u and zeta, and by opening facets, minus the relaxation when they open.
        springs: Stored in springs.
        plastic: Dissipated in the bodies since the start.
        kinetic: Of bodies with a density; that at the start of a run in time is in ``external``.
    """

    bulk: float
    interface: float
    damage: float
    friction: float
    viscosity: float
    external: float
    discretization: float = 0.0
    springs: float = 0.0
    plastic: float = 0.0
    kinetic: float = 0.0

    @property
    def stored(self) -> float:
        """Bulk, interface and springs together."""
        return self.bulk + self.interface + self.springs

    @property
    def dissipated(self) -> float:
        """Damage, friction, viscosity and plastic work together."""
        return self.damage + self.friction + self.viscosity + self.plastic

    @property
    def imbalance(self) -> float:
        """external + discretization - stored - dissipated - kinetic."""
        spent = self.stored + self.dissipated + self.kinetic
        return self.external + self.discretization - spent


@dataclass(frozen=True)
class InterfaceMean:
    """Area averages over an interface."""

    opening: NDArray[np.float64]  # g (d,) [mm]
    gap: NDArray[np.float64]  # zeta (d,) [mm]
    traction: NDArray[np.float64]  # T (d,) [MPa]
    softening: NDArray[np.float64]  # Q [MPa]
    area: float  # Reference area [mm2; mm in plane strain]


@dataclass(frozen=True)
class Pending:
    """Curvature term of the work of a step, as estimated, and the data to compute it."""

    start: Snapshot
    # Change of the displacement, local dofs [mm], and of zeta, flat [mm]
    change: tuple[NDArray[np.float64], NDArray[np.float64]]
    # phi of :mod:`.work` at the start, before and with tau_s of the step, and at the end, this
    # rank's [N mm]
    slopes: tuple[float, float, float]
    entered: float  # Recorded estimate [N mm]
    at_rest: bool  # Whether loads were constant, so that it was dissipated by viscosity


@dataclass(frozen=True)
class Works:
    """Works of a run so far, this rank's.

    Attributes:
        dissipated: By damage, friction and viscosity (3,) [N mm].
        external: Work of loads, prescribed displacements and eigenstrains, and energy added by the
            discretization (2,) [N mm].
        within: Work of loads in the last step in excess of the mean of its ends, due to points that
            begin to yield, separate or close in it, less what their friction takes of it [N mm]. It
            assumes equilibria between both ends, which a snap does not pass.
        increment: The last step along the path; None if the next one does not continue it.
        pending: Work of the last step that requires residuals to compute; None for none.
        plastic: Dissipated in the bodies [N mm].
    """

    dissipated: NDArray[np.float64]
    external: NDArray[np.float64]
    within: float = 0.0
    increment: Increment | None = None
    pending: Pending | None = None
    plastic: float = 0.0


@dataclass(frozen=True)
class Rate:
    """Derivative of a state by the logarithm of a parameter."""

    u: NDArray[np.float64]  # Of the displacement, local dofs, ghosts included [mm]
    t: float
    forces: NDArray[np.float64]  # Of the nodal forces, local dofs [N]
    interfaces: list[InterfaceSnapshot]
    # Works of runs with a slightly larger and smaller value; None if they are not needed
    works: tuple[Works, Works] | None = None


@dataclass(frozen=True)
class Rates:
    """Derivatives of a state by all parameters.

    Attributes:
        jumps: Number of jumps so far, which have no derivative: in them history counts as fixed.
    """

    by_name: dict[str, Rate]
    jumps: int = 0
    known: bool = True


@dataclass(frozen=True)
class Snapshot:
    """A converged state, from which a run can continue.

    Attributes:
        t: Load factor.
        discretization: Discretization for the facets open at that time.
        u: Displacement [mm], ghosts included.
        forces: Nodal forces of bodies and interfaces [N].
        interfaces: State of every active interface.
        open: For every interface, a mask of its open facets.
        works: Works of the run up to there.
        bodies: State of the bodies at points; None for none.
        rates: Derivatives by parameters; None for none.
        motion: Velocity and acceleration; None in statics.
    """

    t: float
    discretization: Discretization
    u: NDArray[np.float64]
    forces: NDArray[np.float64]
    interfaces: list[InterfaceSnapshot]
    open: list[NDArray[np.bool_]]
    works: Works
    bodies: PointState | None = None
    rates: Rates | None = None
    motion: MotionState | None = None

    def __repr__(self) -> str:
        return f"<Snapshot: t = {self.t:.6g}>"

    def change_to(self, other: Snapshot) -> tuple[NDArray[np.float64], float] | None:
        """Change of the displacement of owned dofs [mm] and of the load factor to another state.

        Args:
            other: The other state.

        Returns:
            None if facets have opened in between.
        """
        if other.discretization is not self.discretization:
            return None
        return (other.u - self.u)[: self.discretization.owned], other.t - self.t


@dataclass(frozen=True)
class RunScales:
    """Characteristic sizes found during a run."""

    force: float = 0.0  # Largest reaction, load, or imbalance at the start of a step [N]
    reaction: float = 0.0  # Largest reaction or load, except in jumps [N]
    work: float = math.inf  # Limit of the damage work in the next step [N mm]
    breaking: bool = False  # Whether load control has failed while bonds were breaking
    # Sign of the change of the load factor in the last stage; 0 before the first one
    sense: float = 0.0
    held: bool = False  # Whether the tangent has an artificial stiffness, since a piece is detached

    def with_forces(self, imbalance: float = 0.0, reaction: float = 0.0) -> RunScales:
        """Update with an imbalance and reactions or loads of the run [N]."""
        reaction = max(self.reaction, reaction)
        return replace(self, force=max(self.force, imbalance, reaction), reaction=reaction)
