"""What leads F_33 in generalized plane strain, as a user describes it."""

from __future__ import annotations

from dataclasses import dataclass

from mpi4py import MPI

from ..assembly.values import Value, check_resultant
from .arguments import GENERALIZED
from .loading import Drive


@dataclass(frozen=True)
class GeneralizedStrain:
    """Generalized plane strain, for ``Problem(..., plane=)``: a section of a long body.

    The ends of the body stay plane and parallel, so that F_33 is one number for all bodies and
    interfaces: there is no bending about x and y. It is given, or follows from the force along z.
    The word "generalized strain" is one without force.

    Args:
        strain: F_33 - 1, a number or f(t) of the load factor; None leaves it free.
        force: Dead force on the section, int P_33 dA, in the same way [N]; None for none.
    """

    strain: Value | None = None
    force: Value | None = None

    def drives(self, comm: MPI.Comm) -> list[Drive]:
        """What leads F_33 - 1; collective.

        Args:
            comm: Communicator of the mesh.

        Raises:
            ValueError: both are given, or one that is no number.
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
    """What a user gave for ``plane``, the word as its class; None where it is another one."""
    if isinstance(plane, GeneralizedStrain):
        return plane
    return GeneralizedStrain() if plane == GENERALIZED else None
