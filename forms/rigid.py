"""A rigid wall: cells with a prescribed motion, on which an interface is one-sided.

Derivation, for a wall in place of body 2. As the moduli A_2 of (22) tend to infinity, the fine
scale of body 2 vanishes, tau_2 -> 0 in (21). Then (23) and (25) become

    tau_s = tau_1^-1,   delta_1 = I,   delta_2 = 0,   delta_s = 0,
    lambda = P_1.N_1 - tau_1^-1.(phi_1 - phi_w - zeta),

with the prescribed position phi_w(t) of the wall. Since phi_2 = phi_w is prescribed, (2), eta_2 = 0
by (9), and (27) contains the terms of body 1 alone: its traction, its bubble and the coercivity of
its cells. The terms with eta_2, which enter no equation, are the force on the wall. The return maps
of section 5 do not change. The frame of the law does not rotate because the wall does not.
"""

from __future__ import annotations

from collections.abc import Hashable
from typing import Any, cast

from .materials import NeoHookean


class Rigid(NeoHookean):
    """A rigid, possibly moving wall, given for a cell tag in place of a material.

    All nodes of these cells are prescribed, so that a wall adds no unknowns; one layer of cells is
    enough, see :func:`vmdg.meshes.with_wall`. An interface to a wall takes tractions and tau_s from
    the deformable side, the limit of a body of infinite modulus. Without an interface the wall and
    its neighbours share nodes. ``problem.reaction`` of boundary facets of a wall is the force on
    the whole wall.

    Args:
        displacement: Of the wall: a number, an array (d,), a Constant or f(t) of the load factor
            [mm]; at small strain also f(x, t) at points x (3, n), which must be a rigid motion.
    """

    def __init__(self, displacement: Any = 0.0):
        # The moduli have no effect: all nodes are prescribed, and tau of this side is zero.
        super().__init__(E=1.0, nu=0.0)
        self.displacement = displacement

    @property
    def kernel_key(self) -> Hashable:
        """The key of bodies with the same energy."""
        return cast(Hashable, NeoHookean)
