"""Loads on a problem at its load factor: prescribed displacements, dead loads, eigenstrains."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..assembly.dirichlet import AXES, DirichletConditions
from ..assembly.discretization import Discretization
from ..assembly.loads import DeadLoads
from ..assembly.means import lattice_of
from ..assembly.rigid import RigidFaces
from ..assembly.values import Load, not_finite
from ..base.agreement import together
from ..base.parallel import global_any, global_sum, raise_together
from ..base.tables import rounded
from ..domain.geometry import axis_dofs
from .eigenstrain import Eigenstrains, refusal

Array = NDArray[np.float64]

#: Positions between two load factors at which loads are checked for linearity, and its tolerance
#: relative to the largest value at an end.
PROBES, STRAIGHT = (0.382, 0.5), 1e-9


class Ray:
    """A list of loads, each linear between its given values at two load factors, and beyond."""

    def __init__(self, loads: Iterable[Load], start: float, end: float):
        self.start, self.end = start, end
        self.ends = {load: (load.values(start), load.values(end)) for load in loads}

    def at(self, load: Load, t: float) -> Array:
        """Values of a load at load factor ``t``, also beyond the ends."""
        share = (t - self.start) / (self.end - self.start)
        first, last = self.ends[load]
        return (1 - share) * first + share * last

    def rate(self, load: Load) -> Array:
        first, last = self.ends[load]
        return (last - first) / (self.end - self.start)

    def changes(self, load: Load) -> bool:
        first, last = self.ends[load]
        return bool((first != last).any())

    def reproduces(self, t: float) -> bool:
        """Whether the ray reproduces all given loads at load factor ``t``, on this rank."""
        off = [np.abs(load.values(t) - self.at(load, t)).max(initial=0.0) for load in self.ends]
        sizes = [np.abs(pair).max(initial=0.0) for pair in self.ends.values()]
        return bool((np.array(off) <= STRAIGHT * np.array(sizes)).all())

    def turns(self, t: float) -> Array:
        """Of every load the changes a from ``t`` to the start and b from there to the end: a.b, a.a
        and b.b on this rank (n, 3)."""
        found = []
        for load, (first, last) in self.ends.items():
            a, b = (first - load.values(t)).ravel(), (last - first).ravel()
            found.append((a @ b, a @ a, b @ b))
        return np.array(found)

    def is_straight(self) -> bool:
        length = self.end - self.start
        # All of them: ranks that stopped at the first one would call users' functions less often.
        return all([self.reproduces(self.start + share * length) for share in PROBES])


class Given(NamedTuple):
    """Information on the loads and supports given so far."""

    loaded: NDArray[np.bool_]  # Whether dead loads act on a cell, for every local cell
    # Initial displacement of all local dofs for every support with ``relative=True``, in the order
    # given [mm]
    starts: list[Array]
    filled: set[int]  # Numbers of the interfaces with a fluid between their faces
    # Every support and load as a function that imposes it in a new space
    calls: list[Callable[[Loading], None]]


class Loading:
    """Prescribed displacements, dead loads and eigenstrains, as functions of the load factor.

    What imposes them is kept, since facets that open on demand change the space.

    Attributes:
        nearby: Whether the state is for the moment one of a neighbouring value of a parameter, at
            which a monitor is differentiated.
        ray: The ray along which the load factor moves; None if loads are used as given.
        rigid_parts: Those of the problem by the interfaces that are intact, see
            :func:`.supports.parts_of`; forgotten when a load or support is added.
    """

    def __init__(self, discretization: Discretization, names: dict[str, int]):
        self._mesh, self._bodies = discretization.mesh, discretization.bodies
        self._names = names
        self.ray: Ray | None = None
        self._vector: Array | None = None
        self.nearby, self._anchored = False, True
        self.load_factor, self.t = fem.Constant(self._mesh, 0.0), 0.0
        self.given = Given(np.zeros(len(self._bodies.tags), dtype=bool), [], set(), [])
        self.rebuild(discretization)

    def rebuild(self, discretization: Discretization) -> None:
        self.discretization, u = discretization, discretization.u
        self.rigid_parts: dict[tuple[float, ...], Any] = {}
        self.dirichlet = DirichletConditions(discretization.space, self._zeros())
        self.dead = DeadLoads(u, discretization.geometry, self.load_factor)
        self.surface = discretization.new_surface()
        self.rigid = RigidFaces(u, discretization.geometry)
        self._strains = Eigenstrains(self._bodies)
        self.loads = self.dirichlet, self.dead, self.surface, self.rigid, self._strains
        for impose in self.given.calls:
            impose(self)
        if self.ray is not None:
            self.ray = Ray(self.loads, self.ray.start, self.ray.end)
        self.move(self.t)

    def _zeros(self) -> NDArray[np.int32]:
        discretization = self.discretization
        if discretization.means is None:
            return axis_dofs(discretization.space, discretization.geometry)
        return discretization.means.fixed if self._anchored else discretization.means.spare

    def add(
        self,
        impose: Callable[[Loading], None],
        cells: Sequence[int] | NDArray[np.integer] = (),
        of_means: bool = False,
    ) -> None:
        """Apply a load or prescribed displacement now, and in all later spaces.

        Args:
            impose: Applies it in the current space. A function that refers to this object would
                close a reference cycle, which keeps meshes alive after a problem is deleted, and
                their communicators, of which MPICH has 2048.
            of_means: Whether it acts on a mean, as allowed in a periodic cell.
        """
        if lattice_of(self.discretization.means) is not None and not of_means:
            raise ValueError(
                "a periodic cell has no supports and loads: its load is the mean strain or stress "
                "of Periodic(...), and its boundary lies inside the material"
            )
        impose(self)
        try:
            self._refuse_held_faces()
        except ValueError:
            self.rebuild(self.discretization)
            raise
        self.given.calls.append(impose)
        self.given.loaded[np.asarray(cells, dtype=np.intp)] = True
        self.rigid_parts.clear()
        self.move(self.t)

    # Values

    def at(self, load: Load, t: float) -> Array:
        """Values of one of :attr:`loads` at load factor ``t`` of the current ray."""
        return load.values(t) if self.ray is None else self.ray.at(load, t)

    @property
    def prescribed(self) -> NDArray[np.int32]:
        """Prescribed local dofs (component-wise numbers), ghosts included."""
        return self.dirichlet.dofs

    @property
    def owned_prescribed(self) -> NDArray[np.int32]:
        """Those of :attr:`prescribed` that this rank owns."""
        return self.prescribed[self.prescribed < self.discretization.owned]

    def prescribed_values(self, t: float) -> NDArray[np.float64]:
        """Prescribed displacement of :attr:`prescribed` at load factor ``t`` [mm]."""
        return self.at(self.dirichlet, t)

    def _refuse_held_faces(self) -> None:
        """Check that nodes of rigid faces have no other constraint."""
        if not self.rigid:
            return
        dofs, d = self.rigid.dofs, self.discretization.space.dofmap.index_map_bs
        chosen, counts = np.unique(dofs, return_counts=True)
        held, message = np.isin(chosen, self.prescribed), None
        wrong = chosen[held | (counts > 1)]
        if len(wrong):
            node, axis = divmod(int(wrong[0]), d)
            x = self.discretization.space.tabulate_dof_coordinates()[node, :d]
            other = "is prescribed too" if held.any() else "belongs to two rigid faces"
            message = (
                f"rigid_face: the displacement along {AXES[axis]} of the node at "
                f"{rounded(x)} {other}; give the rigid face another component, or exclude the "
                "facets at this node from one of them"
            )
        raise_together(self._mesh.comm, message)

    def away(self, t: float) -> Array:
        """Difference between prescribed displacements at load factor ``t`` and current ones, on
        owned dofs, zero at free dofs; collective [mm]."""
        u, result = self.discretization.u.x.array, np.zeros(self.discretization.owned)
        owned = self.owned_prescribed
        result[owned] = self.prescribed_values(t)[: len(owned)] - u[owned]
        missing = self.at(self.rigid, t) - self.rigid.displacements()
        return result + self.rigid.lifted(missing)

    def rate(self) -> Array:
        """Derivative of prescribed displacements by the load factor along the ray, as
        :meth:`away`."""
        owned, result = self.owned_prescribed, np.zeros(self.discretization.owned)
        result[owned] = self.ray.rate(self.dirichlet)[: len(owned)]
        return result + self.rigid.lifted(self.ray.rate(self.rigid))

    def balance(self, forces: Array) -> Array:
        """Remove the reactions of supports and rigid faces from forces on owned dofs, in place;
        collective [N]."""
        forces[self.owned_prescribed] = 0
        self.rigid.balance(forces)
        return forces

    @property
    def vector(self) -> Array:
        """Loads at the current load factor, and pressures at the current displacement, over local
        dofs, before ghosts are added to owners [N]; collective."""
        if self._vector is None:
            self._vector = self.at(self.dead, self.t)
        return self._vector + self.surface.load_vector() if self.pressurised else self._vector

    @property
    def pressurised(self) -> bool:
        return self.surface.pressurised

    def spread(self) -> None:
        self.surface.spread()
        self.move(self.t)

    # Load factor

    def set_ray(self, start: float, end: float) -> bool:
        """Treat loads as linear between two load factors from now on; False, with loads used as
        given, if they are not linear or do not change; collective."""
        self.clear_ray()
        if start == end:
            return False
        comm = self._mesh.comm
        ray = together(comm, lambda: Ray(self.loads, start, end))
        for t, values in zip((start, end), zip(*ray.ends.values(), strict=True), strict=True):
            self._refuse_infinite(t, values)
        if not global_any(comm, any(map(ray.changes, self.loads))):
            return False
        if global_any(comm, not together(comm, ray.is_straight)):
            return False
        self.ray, self._vector = ray, None
        return True

    def check_finite(self, t: float) -> list[Array]:
        """The given values of :attr:`loads` at load factor ``t``; collective."""
        values = together(self._mesh.comm, lambda: [load.values(t) for load in self.loads])
        self._refuse_infinite(t, values)
        return values

    def _refuse_infinite(self, t: float, values: Sequence[Array]) -> None:
        message = None
        for load, value in zip(self.loads, values, strict=True):
            message = not_finite(load, value, t) or message
        raise_together(self._mesh.comm, message or refusal(self._bodies, values[-1], t))

    def as_given(self, t: float) -> bool:
        """Whether the current ray reproduces the given loads at ``t``; collective."""
        comm = self._mesh.comm
        return not global_any(comm, not together(comm, lambda: self.ray.reproduces(t)))

    def comes_back(self, t: float) -> bool:
        """Whether a load that changed from ``t`` to the start of the ray goes back along it;
        collective."""
        comm = self._mesh.comm
        ab, aa, bb = global_sum(comm, together(comm, lambda: self.ray.turns(t))).T
        return bool((ab < -STRAIGHT * np.sqrt(aa * bb)).any())

    def clear_ray(self) -> None:
        self.ray, self._vector = None, None

    def strained(self, t: float, other: float) -> bool:
        """Whether eigenstrains differ between two load factors; collective."""
        if t == other or not self._bodies.grow:
            return False
        ray = self.ray or Ray([self._strains], t, other)
        return global_any(self._mesh.comm, ray.changes(self._strains))

    def strain(self, t: float) -> None:
        """Set eigenstrains to load factor ``t`` of the current ray."""
        self._strains.apply(self.at(self._strains, t))

    def move(self, t: float) -> None:
        """Move to load factor ``t`` of the current ray, without imposing prescribed
        displacements."""
        self.load_factor.value = self.t = float(t)
        self._vector = None
        self.strain(t)
        self.surface.apply(self.at(self.surface, t))


def groups_of(loading: Loading) -> dict[str, int]:
    """Tag by name of the groups of cells; empty where they have no names."""
    return loading._names


def let_go(loading: Loading) -> None:
    """Let a periodic cell translate in time, where its momentum is kept."""
    if loading._anchored and lattice_of(loading.discretization.means) is not None:
        loading._anchored = False
        loading.dirichlet.fix(loading._zeros())


def anchor(loading: Loading) -> None:
    """Translate a periodic cell such that its anchor is where statics fixes it; collective."""
    if loading._anchored:
        return
    discretization, d = loading.discretization, loading._mesh.geometry.dim
    owned, here = (
        discretization.means.anchor[discretization.means.anchor < discretization.owned],
        np.zeros(d),
    )
    here[owned % d] = discretization.u.x.array[owned]
    nodes = np.unique(discretization.means.nodes)
    discretization.u.x.array.reshape(-1, d)[nodes] -= global_sum(loading._mesh.comm, here)
    loading._anchored = True
    loading.dirichlet.fix(loading._zeros())
