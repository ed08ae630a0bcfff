"""User's description of the load on F_33 in generalized plane strain."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

from ..assembly.values import Value, check_resultant
from .arguments import GENERALIZED
from .calls import Drive


@dataclass(frozen=True)
class GeneralizedStrain:
    """Generalized plane strain, for ``Problem(..., plane=)``: a section of a long body.

    The ends of the body stay plane and parallel, so F_33 is one number for all bodies and
    interfaces, without bending about x and y. It is prescribed, or follows from the force along z.
    The option "generalized strain" means zero force.

    Args:
        strain: F_33 - 1, a number or f(t) of the load factor; None if it is free.
        force: Dead force on the section, int P_33 dA, in the same way [N]; None for none.
    """

    strain: Value | None = None
    force: Value | None = None

    def drives(self, comm: MPI.Comm) -> list[Drive]:
        """The load on F_33 - 1; collective.

        Args:
            comm: Communicator of the mesh.

        Raises:
            ValueError: both are given, or one is not a number.
        """
        if self.strain is not None and self.force is not None:
            raise ValueError(
                "GeneralizedStrain: give strain= or force=, not both; the other one follows"
            )
        given = {"strain": self.strain, "force": self.force}
        given = {name: value for name, value in given.items() if value is not None}
        for name, value in given.items():
            check_resultant(comm, value, [()], f"GeneralizedStrain: {name}")
        return [Drive(2, 2, name == "strain", value) for name, value in given.items()]


def generalized(plane: str | GeneralizedStrain) -> GeneralizedStrain | None:
    """The user's ``plane``, the option converted to its class; None for other options."""
    if isinstance(plane, GeneralizedStrain):
        return plane
    return GeneralizedStrain() if plane == GENERALIZED else None
