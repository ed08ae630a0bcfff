"""States of a problem, and its energies and means."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..assembly.discretization import Discretization
from ..interface.history import InterfaceSnapshot
from .work import Arc


@dataclass(frozen=True)
class Energy:
    """Energies of the whole body [N mm], the same on every rank.

    Attributes:
        bulk: Strain energy of the bodies.
        interface: Stored by the interfaces: (30), and what an elastic bond can return. (30) is
            {P.N}.s + s.tau.s/2 with s = g - zeta, the small opening that the mesh leaves where the
            interface holds. It is no energy of a spring and may be negative: it takes back what
            the bodies store too much. Only the sum with ``bulk`` is an energy.
        damage: Spent on bonds since the start.
        friction: Spent on sliding since the start.
        viscosity: Spent on the overstress since the start, or released in jumps [N mm].
        external: Work of prescribed displacements, loads and eigenstrains since the start; see
            :meth:`.Problem.energy` for its accuracy at finite strain.
        discretization: Added since the start by a tau_s that changes between steps, the change of
            (30) at fixed u and zeta, and by facets that open, less what relaxes as they do.
        springs: Stored by springs.
    """

    bulk: float
    interface: float
    damage: float
    friction: float
    viscosity: float
    external: float
    discretization: float = 0.0
    springs: float = 0.0

    @property
    def stored(self) -> float:
        """Bulk, interface and springs together."""
        return self.bulk + self.interface + self.springs

    @property
    def dissipated(self) -> float:
        """Damage, friction and viscosity together."""
        return self.damage + self.friction + self.viscosity

    @property
    def imbalance(self) -> float:
        """external + discretization - stored - dissipated."""
        return self.external + self.discretization - self.stored - self.dissipated


@dataclass(frozen=True)
class InterfaceMean:
    """Area averages over an interface.

    Attributes:
        opening: g (d,) [mm].
        gap: zeta (d,) [mm].
        traction: T (d,) [MPa].
        softening: Q [MPa].
        area: Reference area [mm2; mm in plane strain].
    """

    opening: NDArray[np.float64]
    gap: NDArray[np.float64]
    traction: NDArray[np.float64]
    softening: NDArray[np.float64]
    area: float


@dataclass(frozen=True)
class Pending:
    """What the curvature of a step adds to its work, as it is entered and as it may be found.

    Attributes:
        start: The state in which the step has begun.
        change: Of the displacement, local dofs [mm], and of zeta, flat [mm].
        slopes: phi of :mod:`.work` at the start, before and with its tau_s, and at the end, this
            rank's [N mm].
        entered: What it was taken for [N mm].
        at_rest: Whether loads were at rest, so that a rate has let it go.
    """

    start: Snapshot
    change: tuple[NDArray[np.float64], NDArray[np.float64]]
    slopes: tuple[float, float, float]
    entered: float
    at_rest: bool


@dataclass(frozen=True)
class Works:
    """Of a run so far, this rank's.

    Attributes:
        dissipated: By damage, friction and viscosity (3,) [N mm].
        external: Of loads, prescribed displacements and eigenstrains, and what the discretization
            has added (2,) [N mm].
        within: Of loads in the last step, beyond that of the mean of its ends by points that begin
            to yield, part or close in it [N mm]. It is that of equilibria between both ends, which
            a snap does not go through.
        arc: The last step along the path; None where the next one does not go on from there.
        pending: Of the last step what costs residuals to enter; None where there is nothing.
    """

    dissipated: NDArray[np.float64]
    external: NDArray[np.float64]
    within: float = 0.0
    arc: Arc | None = None
    pending: Pending | None = None


@dataclass(frozen=True)
class Snapshot:
    """A converged state: everything a run continues from.

    Attributes:
        t: Load factor.
        discretization: Forms of the facets that were open then.
        u: Displacement [mm], ghosts included.
        forces: Nodal forces of bodies and interfaces [N].
        interfaces: State of every active interface.
        open: By interface, which of its facets were open.
        works: Of the run up to there.
    """

    t: float
    discretization: Discretization
    u: NDArray[np.float64]
    forces: NDArray[np.float64]
    interfaces: list[InterfaceSnapshot]
    open: list[NDArray[np.bool_]]
    works: Works

    def way_to(self, other: Snapshot) -> tuple[NDArray[np.float64], float] | None:
        """Change of the displacement of owned dofs [mm] and of the load factor to another state.

        Args:
            other: The other state.

        Returns:
            None where facets have opened in between.
        """
        if other.discretization is not self.discretization:
            return None
        return (other.u - self.u)[: self.discretization.owned], other.t - self.t


@dataclass(frozen=True)
class RunScales:
    """What a run has found out about the sizes of its problem.

    Attributes:
        force: Reaction, load, or imbalance at the start of a step [N].
        reaction: Reaction or load, without those of jumps [N].
        work: Work on bonds that the next step may do [N mm].
        breaking: Whether load control has failed while bonds were breaking.
        sense: Sign of the change of the load factor in the last stage; 0 before the first one.
        held: Whether the tangent holds what nothing else does, since a piece has come free.
    """

    force: float = 0.0
    reaction: float = 0.0
    work: float = math.inf
    breaking: bool = False
    sense: float = 0.0
    held: bool = False

    def with_forces(self, imbalance: float = 0.0, reaction: float = 0.0) -> RunScales:
        """With an imbalance, and reactions or loads, that the run has seen [N]."""
        reaction = max(self.reaction, reaction)
        return replace(self, force=max(self.force, imbalance, reaction), reaction=reaction)
