"""Mass and motion of the bodies: velocity, acceleration, kinetic energy."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from numbers import Real
from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc
from numpy.typing import NDArray

from ..assembly.discretization import Discretization
from ..base.parallel import global_sum, warn_together
from ..forms.geometry import Axisymmetric
from .damping import Damping, Rayleigh

Array = NDArray[np.float64]

#: Ratio of densities that points to different units: of solids it is below 1e4.
UNLIKE = 1e6


def checked_density(
    comm: MPI.Comm, density: Mapping[int, float], deformable: set[int]
) -> dict[int, float]:
    """Density by tag; warns of values that are probably in different units; collective."""
    for tag, rho in density.items():
        if isinstance(rho, bool) or not isinstance(rho, Real):
            raise TypeError(f"Problem: density of tag {tag} = {rho!r} must be a number")
        if not 0 < rho < np.inf:
            raise ValueError(f"Problem: density of tag {tag} = {rho!r} must be positive and finite")
    if missing := sorted(deformable - set(density)):
        raise ValueError(
            f"Problem: density has no value for tag {missing[0]}: give one for every body"
        )
    if others := sorted(set(density) - deformable):
        raise ValueError(
            f"Problem: density has a value for tag {others[0]}, which is no deformable body"
        )
    least, most = (pick(density, key=lambda tag: density[tag]) for pick in (min, max))
    if density[most] > UNLIKE * density[least]:
        warn_together(
            comm,
            f"Problem: the densities {density[least]:g} of tag {least} and {density[most]:g} of "
            f"tag {most} are probably in different units (t/mm3 with N, mm and s)",
        )
    return {tag: float(rho) for tag, rho in density.items()}


class Plan(NamedTuple):
    """Where an explicit run is between two renewals, for one that continues it."""

    count: int
    critical: float  # The critical step found there [s]
    longest: float  # The longest one so far [s]
    cuts: int


class MotionState(NamedTuple):
    """Motion at the end of a step, see :class:`Motion`; its arrays are never modified."""

    velocity: Array  # Local dofs [mm/s]
    acceleration: Array  # Owned dofs [mm/s2]
    carried: Array  # Inertial and viscous forces of owned dofs [N]
    lumped: Array | None
    plan: Plan | None


class Motion:
    """Mass and motion of the bodies.

    In a periodic cell u = H.X + w has mass where it is w: with that of H(t).X, which belongs to the
    large scale, what happens would depend on where the cell is cut unless H grows uniformly, when
    both are the same.

    Args:
        density: Mass per reference volume by tag, in units such that 1 is force times time squared
            per length to the fourth: t/mm3 with N, mm and s.

    Attributes:
        velocity: Of the displacement, in a periodic cell of w [mm/s].
        acceleration: Owned dofs [mm/s2].
        carried: Inertial and viscous forces of owned dofs at the end of the last step, which
            supports carry in addition to the internal ones [N].
        lumped: Lumped masses of owned dofs, from which the kinetic energy follows [N s2/mm]; None
            for the consistent mass matrix.
        plan: Of the last explicit step; None for none.
    """

    def __init__(
        self, discretization: Discretization, density: Mapping[int, float], rayleigh: Rayleigh
    ):
        self.density = dict(density)
        self._discretization = discretization
        self._rho = fem.Function(fem.functionspace(discretization.mesh, ("DG", 0)))
        for tag, value in self.density.items():
            self._rho.x.array[discretization.bodies.cells_of[tag]] = value
        self.damping = Damping(discretization, self._rho, rayleigh)
        self.damping.refuse()
        self.velocity = fem.Function(discretization.space, name="velocity")
        self.acceleration = np.zeros(discretization.owned)
        self.carried = np.zeros(discretization.owned)
        self.lumped: Array | None = None
        self.plan: Plan | None = None

    @cached_property
    def _form(self) -> fem.Form:
        """int rho v.w dV, with a rule that is exact on affine cells."""
        discretization = self._discretization
        mesh, geometry = discretization.mesh, discretization.geometry
        v, w = ufl.TrialFunction(discretization.space), ufl.TestFunction(discretization.space)
        order = 2 * discretization.degree + isinstance(geometry, Axisymmetric)
        dx = ufl.dx(domain=mesh, metadata={"quadrature_degree": order})
        return discretization.weak_form.compile(
            geometry.weight * self._rho * ufl.inner(v, w) * dx, "mass"
        )

    def matrix(self, kind: PETSc.Mat.Type = PETSc.Mat.Type.AIJ) -> PETSc.Mat:
        """A new consistent mass matrix, with the pattern of the tangent; collective."""
        matrix, means = self._discretization.create_matrix(kind), self._discretization.means
        fem_petsc.assemble_matrix(matrix, self._form)
        # Means have no mass, but entries for the identity of prescribed dofs.
        for dof in () if means is None else means.owned_rows:
            matrix.setValueLocal(dof, dof, 0.0, PETSc.InsertMode.ADD_VALUES)
        matrix.assemble()
        return matrix

    @cached_property
    def mass(self) -> PETSc.Mat:
        """The consistent mass matrix [N s2/mm]."""
        return self.matrix()

    @cached_property
    def row_sums(self) -> Array:
        """Row sums of the mass matrix, of owned dofs [N s2/mm]; collective."""
        ones, sums = self.mass.createVecs()
        ones.set(1.0)
        self.mass.mult(ones, sums)
        return sums.array.copy()

    def of(self, values: Array) -> Array:
        """Consistent mass matrix times values of owned dofs; collective."""
        x, y = self.mass.createVecs()
        x.array[:] = values
        self.mass.mult(x, y)
        return y.array.copy()

    def kinetic_energy(self) -> float:
        """Kinetic energy at the current velocity; collective [N mm]."""
        v = self.velocity.x.array[: self._discretization.owned]
        momentum = self.of(v) if self.lumped is None else self.lumped * v
        return float(global_sum(self._discretization.mesh.comm, v @ momentum / 2))

    @property
    def moves(self) -> bool:
        return bool(self.velocity.x.array.any() or self.acceleration.any() or self.carried.any())

    @property
    def state(self) -> MotionState:
        velocity = self.velocity.x.array.copy()
        return MotionState(velocity, self.acceleration, self.carried, self.lumped, self.plan)

    def return_to(self, state: MotionState) -> None:
        self.velocity.x.array[:], *others = state
        self.acceleration, self.carried, self.lumped, self.plan = others

    def fields(self) -> dict[str, Array]:
        """Velocity, acceleration and carried forces over local dofs, by name; collective."""
        found = {"velocity": self.velocity.x.array}
        for name, values in (("acceleration", self.acceleration), ("carried", self.carried)):
            field = fem.Function(self._discretization.space).x
            field.array[: self._discretization.owned] = values
            field.scatter_forward()
            found[name] = field.array
        return found

    def take(self, fields: Mapping[str, Array]) -> None:
        at_rest = np.zeros_like(self.velocity.x.array)
        self.velocity.x.array[:] = fields.get("velocity", at_rest)
        owned = slice(self._discretization.owned)
        self.acceleration = fields.get("acceleration", at_rest)[owned].copy()
        self.carried, self.plan = fields.get("carried", at_rest)[owned].copy(), None

    def move(
        self,
        velocity: Array,
        acceleration: Array,
        carried: Array | None = None,
        plan: Plan | None = None,
    ) -> None:
        """Take velocity, acceleration and carried forces of owned dofs, none at rest; collective.

        The arrays must not be modified later.
        """
        self.plan = plan
        self.carried = np.zeros_like(acceleration) if carried is None else carried
        self.velocity.x.array[: self._discretization.owned] = velocity
        self.velocity.x.scatter_forward()
        self.acceleration = acceleration


def moving(motion: Motion | None) -> Motion:
    if motion is None:
        raise ValueError(
            "the problem has no mass: give density={tag: mass per volume}, in t/mm3 with N, mm "
            "and s"
        )
    return motion
