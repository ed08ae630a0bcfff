"""Users' descriptions of a periodic cell and of generalized plane strain, and their means."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import product

from mpi4py import MPI

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..assembly.dirichlet import AXES
from ..assembly.values import Value, check_resultant, value_at
from .arguments import GENERALIZED
from .calls import Drive

Array = NDArray[np.float64]

#: Components of a mean by name, "xx" or "xy", or all of them: an array or f(t).
Components = Mapping[str, Value] | ArrayLike | Callable[[float], ArrayLike]

#: Asymmetry of a strain, relative to its size, that counts as rounding.
ASYMMETRY = 1e-12


@dataclass(frozen=True)
class Periodic:
    """A mesh as a periodic cell, for ``Problem(..., periodic=)``: a representative volume.

    The displacement is u = (F_bar - I).X + w with a fluctuation w that is the same on opposite
    faces. F_bar, at small strain E_bar with u = E_bar.X + w, is prescribed, or follows from a given
    mean stress, or some components of each are given. Components given in neither are stress free:
    ``strain={"xx": lambda t: 0.01 * t}`` alone is uniaxial stress along x. A rotation of the cell
    does no work: at finite strain, if neither F_xy nor F_yx is given, one of them is set to zero,
    F_yx unless its stress is given.

    For the motion of a cell see :func:`vmdg.solve_dynamics`.

    Opposite faces must have the same mesh. Interfaces may cross them. The boundary itself is not an
    interface: bodies that meet across it are tied, and an interface there raises an error.

    Args:
        strain: Mean strain E_bar at small strain, components by name ("xy" is the component of the
            tensor, half the angle), an array (d, d), or f(t) of the load factor that returns one; a
            component is a number or f(t).
        gradient: Mean deformation gradient F_bar at finite strain, in the same way.
        stress: Mean stress, at finite strain the first Piola-Kirchhoff stress P_bar, in the same
            way [MPa].
        vectors: Sides of the cell, one per row (d, d); None for those of the bounding box of the
            mesh [mm].
    """

    strain: Components | None = None
    gradient: Components | None = None
    stress: Components | None = None
    vectors: ArrayLike | None = None

    def drives(self, comm: MPI.Comm, d: int, small: bool) -> list[Drive]:
        """The load on every component; collective.

        Args:
            comm: Communicator of the mesh.
            d: Its dimension.
            small: Whether strains are small.

        Raises:
            ValueError: the kinematics require the other measure, a component is unknown or given
                twice, a value has the wrong shape, or nothing is given.
        """
        measure, other = ("strain", "gradient") if small else ("gradient", "strain")
        if getattr(self, other) is not None:
            kinematics = "small" if small else "finite"
            raise ValueError(
                f"Periodic: {other} cannot be combined with kinematics={kinematics!r}; give "
                f"{measure}="
            )
        given = _components(comm, getattr(self, measure), d, measure)
        stress = _components(comm, self.stress, d, "stress")
        if not given and not stress:
            raise ValueError(f"Periodic: give {measure}=, stress= or both")
        if small:
            given, stress = (_upper(c, w) for c, w in ((given, measure), (stress, "stress")))
        if both := sorted(set(given) & set(stress)):
            raise ValueError(
                f"Periodic: component {_name(*both[0])} is given in {measure} and in stress; "
                "remove it from one of them"
            )
        drives = _of_strain if small else _of_gradient
        return drives(given, stress, d)


def checked_periodic(periodic: Periodic | None) -> Periodic | None:
    if periodic is None or isinstance(periodic, Periodic):
        return periodic
    raise TypeError(
        f"Problem: periodic = {periodic!r} must be vmdg.Periodic(...), for example "
        'vmdg.Periodic(strain={"xx": lambda t: 0.01 * t})'
    )


_Given = dict[tuple[int, int], Value]


def _name(i: int, j: int) -> str:
    return AXES[i] + AXES[j]


def _components(comm: MPI.Comm, given: Components | None, d: int, what: str) -> _Given:
    """Components by row and column; collective."""
    if given is None:
        return {}
    entries = list(product(range(d), repeat=2))
    if not isinstance(given, Mapping):
        check_resultant(comm, given, [(d, d)], f"Periodic: {what}")
        return {entry: lambda t, entry=entry: value_at(given, t)[entry] for entry in entries}
    names, result = {_name(*entry): entry for entry in entries}, {}
    for name, value in given.items():
        if name not in names:
            raise ValueError(
                f"Periodic: {what} has no component {name!r}; in {d}D they are {', '.join(names)}"
            )
        check_resultant(comm, value, [()], f"Periodic: {what} {name}")
        result[names[name]] = lambda t, value=value: value_at(value, t)
    return result


def _upper(given: _Given, what: str) -> _Given:
    """Components i <= j of a symmetric tensor."""
    result = {}
    for (i, j), value in given.items():
        twin = given.get((j, i), value)
        for t in (0.0, 1.0):
            one, two = float(value(t)), float(twin(t))
            if abs(one - two) > ASYMMETRY * max(abs(one), abs(two)):
                raise ValueError(
                    f"Periodic: {what} is not symmetric, {_name(i, j)} = {one:g} and "
                    f"{_name(j, i)} = {two:g} at load factor {t:g}; give one of them"
                )
        result[min(i, j), max(i, j)] = value
    return result


def _of_strain(given: _Given, stress: _Given, d: int) -> list[Drive]:
    """H_ij = 2 E_ij above the diagonal and 0 below: its symmetric part is E."""
    drives = []
    for i, j in product(range(d), repeat=2):
        if i > j:
            drives.append(Drive(i, j, True, 0.0))
        elif (i, j) in given:
            factor, value = 1 if i == j else 2, given[i, j]
            drives.append(Drive(i, j, True, lambda t, v=value, f=factor: f * v(t)))
        else:
            drives.append(Drive(i, j, False, stress.get((i, j), 0.0)))
    return drives


def _of_gradient(given: _Given, stress: _Given, d: int) -> list[Drive]:
    """H = F - I, with one of F_ij and F_ji zero where neither is given."""
    drives = []
    for i, j in product(range(d), repeat=2):
        twin, low = (j, i), i > j
        if (i, j) in given:
            drives.append(Drive(i, j, True, lambda t, v=given[i, j], one=i == j: v(t) - one))
            continue
        if low and (i, j) in stress and twin in stress:
            raise ValueError(
                f"Periodic: stress has {_name(*twin)} and {_name(i, j)}, which leave the rotation "
                "of the cell undetermined; give one of them, the other follows from the balance of "
                "moments"
            )
        if i != j and twin not in given:
            held = (i, j) not in stress if low else twin in stress
            if held:
                drives.append(Drive(i, j, True, 0.0))
                continue
        drives.append(Drive(i, j, False, stress.get((i, j), 0.0)))
    return drives


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
