"""User's description of interfaces: where the displacement may jump, and by which law."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..domain.tags import Group
from ..domain.topology import LevelSet, Locator
from ..laws import Law

NORMS = ("frobenius", "spectral")
FRAMES = ("corotating", "reference")
ACTIVATIONS = ("all", "on-demand")
AUTO = "auto"
IGNORE, KEEP = "ignore", "keep"
ALL = "all"
_NAME = re.compile(r"\w[\w .+-]*")

T = TypeVar("T")

#: Predicate on pairs of tags a < b, (n,) and (n,): whether the interface lies between them (n,).
PairRule = Callable[[NDArray[np.int32], NDArray[np.int32]], NDArray[np.bool_]]

#: A user's replacement of (21)-(25).
StabilizationRule = Callable[[NDArray, NDArray, "StabilizationContext"], tuple[NDArray, NDArray]]


@dataclass(frozen=True)
class StabilizationContext:
    """Context of a user's ``stabilization(tau1, tau2, context)``; side 1 first."""

    u: Any
    cells: NDArray[np.int32]  # Local cells of the two sides, (nf, 2)
    local_facets: NDArray[np.int32]  # Number of the facet within these cells, (nf, 2)
    facets: NDArray[np.int32]  # Local facets of the mesh, (nf,)
    N: NDArray[np.float64]  # Mean reference normal, outward from side 1, (nf, d)
    # meas(gamma_s) [mm2; mm in plane strain], (nf,); of the full circle in axisymmetry
    area: NDArray[np.float64]


class Interface:
    """A set of interior facets across which the displacement may jump, with its law.

    Give exactly one of ``facets``, ``surfaces``, ``between``, ``within`` and ``level_set``. A group
    of cells is given by its tag, or by its name where the problem has :class:`vmdg.NamedTags`. An
    interface is immutable.

    Args:
        facets: Local facet indices, for example ``facet_tags.find("crack")``, where each of several
            ranks gives those it knows; or a predicate on coordinates (3, n), true at all vertices
            of an interior facet.
        surfaces: Facets of the surfaces of two bodies that share no nodes and whose meshes need not
            match, side 1 first, as ``facet_tags.find`` gives them. Parts of them that lie opposite
            each other are paired, once in the reference configuration or, with ``sliding``, in
            every state.
        between: The facets that separate cells of these two groups, or, where the groups share no
            nodes, the parts of their surfaces that lie opposite each other; with "all" those
            between any two groups, such as all grain boundaries; or those for which a function of
            the tags a < b, (n,) and (n,), is true, such as classes of grain boundaries, see
            :func:`vmdg.misorientation`.
        within: All interior facets of this group (cracks through a region).
        level_set: The facets between cells where phi(x), x (3, n) [mm], is negative at the midpoint
            and all others. Of two cells with equal tags the negative one is side 1.
        law: ``vmdg.Bonded()`` (tie), ``vmdg.Debonding(...)`` or another :class:`vmdg.laws.Law`.
        safety: Factor on tau_s. "auto" determines it on every facet, below or above 1, such that
            the bonded form is coercive (:mod:`vmdg.interface.coercivity`) and r well above H; r
            never decreases within a run, but that of surfaces that slide without a bond. 1 is the
            report's tau_s, 4 that of its Tables 1 and 2.
        norm: |tau_s| of (57): "frobenius" or "spectral".
        frame: "corotating" keeps zeta and N in a frame that rotates with the interface; "reference"
            is exactly as in the report's boxes, for small rotations, and is cheaper. At small
            strain rotations are small by assumption and the frame is fixed.
        traction_jump: Add the term -[[(GRAD eta : A).N]].delta_s.[[P.N]] of (26); (27) drops it.
        activate: "all" opens every facet from the start; "on-demand" keeps a facet continuous, at
            no cost, until its traction approaches the strength (cracks through a region).
        activate_at: Traction relative to the strength at which a facet opens on demand. Averaged
            over continuous cells, the traction near a crack tip or a corner is about half of that
            on an open facet, hence the default.
        stabilization: ``f(tau1, tau2, context) -> (tau_s (nf, d, d), delta1 (nf, d, d))``
            replaces (21)-(25), for research and tests; ``safety`` does not apply to its result.
        initial_damage: Initial Q/strength, from 0 to 1; 1 is a pre-existing crack with contact and
            friction. A number, one for every facet of ``facets``, f(x) of the midpoints x (3, n) of
            the facets [mm], or a Function, averaged over both sides at the midpoint. Parameters of
            the law that vary are given in the same way. It does not count as work. Damaged facets
            that open on demand are open from the start. None for an intact bond.
        largest_strength: Strength of the law in opening [MPa] above which it is lowered to this, in
            shear by the same factor, and gaps are raised by it, so that the fracture energy is the
            same: for facets longer than the process zone of the given strength, whose warning says
            which strength they can carry. None leaves the law as it is.
        sliding: Let two bodies that share no nodes slide along each other by any distance where
            there is no bond or it is broken: points meet other facets, leave the other body, and
            come back. With ``between`` side 1 is then the stiffer body, else the one whose surface
            is flatter, else the one with the longer facets; ``surfaces`` gives it. At small strain,
            where displacements are small by assumption, bodies slide on the partners of the
            reference configuration, along its surface.
        gap: What the distance of surfaces that share no nodes [mm] means, in the reference
            configuration: with "ignore" the bodies touch, as two polygons along one curve do, up to
            the mean thickness 2 V/A of the thicker one; with "keep" it is a gap of any width, or
            where they overlap an interference that the first step relaxes. None for "keep" if they
            slide, else "ignore".
        name: Name of the interface in messages, files and pictures; None for its number in the
            problem, "interface_0".

    Raises:
        ValueError: the description is incomplete or contradictory.
        TypeError: ``law`` is not an interface law, or facets are not an array of integers.
    """

    def __init__(
        self,
        facets: ArrayLike | Locator | None = None,
        *,
        between: tuple[Group, Group] | str | PairRule | None = None,
        surfaces: tuple[ArrayLike, ArrayLike] | None = None,
        within: Group | None = None,
        level_set: LevelSet | None = None,
        law: Law,
        safety: float | str = AUTO,
        norm: str = "frobenius",
        frame: str = "corotating",
        traction_jump: bool = False,
        activate: str = "all",
        activate_at: float = 0.4,
        stabilization: StabilizationRule | None = None,
        initial_damage: float | ArrayLike | LevelSet | None = None,
        largest_strength: float | None = None,
        sliding: bool = False,
        gap: str | None = None,
        name: str | None = None,
    ):
        places = {
            "facets": facets,
            "surfaces": surfaces,
            "between": between,
            "within": within,
            "level_set": level_set,
        }
        given = [name for name, value in places.items() if value is not None]
        if len(given) != 1:
            raise ValueError(
                "Interface needs exactly one of facets=, surfaces=(facets, facets), "
                "between=(tag, tag), within=tag, level_set=phi; given: "
                f"{', '.join(given) or 'none'}"
            )
        if isinstance(law, type) and issubclass(law, Law):
            raise TypeError(
                f"Interface: law = {law.__name__} is a class; give an instance with its "
                f"parameters, {law.__name__}(...)"
            )
        if not isinstance(law, Law):
            raise TypeError(f"Interface: law = {law!r} is not an interface law; try vmdg.Bonded()")
        if level_set is not None and not callable(level_set):
            raise TypeError(
                f"Interface: level_set = {level_set!r} must be a function of points x (3, n), for "
                "example lambda x: np.hypot(x[0], x[1]) - 0.25"
            )
        if safety != AUTO and not (isinstance(safety, Real) and 0 < safety < np.inf):
            raise ValueError(f'Interface: safety = {safety!r} must be positive, or "{AUTO}"')
        words = ("norm", norm, NORMS), ("frame", frame, FRAMES), ("activate", activate, ACTIVATIONS)
        for what, word, known in words:
            if word not in known:
                raise ValueError(f"Interface: {what} = {word!r} must be one of {known}")
        if isinstance(activate_at, str) or not 0 < activate_at <= 1:
            raise ValueError(f"Interface: activate_at = {activate_at!r} must lie in (0, 1]")
        if activate == "on-demand" and not law.inelastic:
            raise ValueError("Interface: a tie never fails, so it cannot open on demand")
        several = between is None or callable(between) or between == ALL
        if not several and (
            not isinstance(between, Sequence | np.ndarray)
            or isinstance(between, str)
            or len(between) != 2
            or between[0] == between[1]
        ):
            raise ValueError(
                f"Interface: between = {between!r} must be two different tags, {ALL!r}, or a "
                "function of two tags; for the facets inside one tag use within=tag"
            )
        if np.ndim(within) != 0:
            raise ValueError(
                f"Interface: within = {within!r} must be one tag; create an interface for each, "
                "with the same law"
            )
        if stabilization is not None and not callable(stabilization):
            raise TypeError(
                f"Interface: stabilization = {stabilization!r} must be a function of tau1, tau2 "
                "and the context; a number that multiplies tau_s is safety="
            )
        if largest_strength is not None and not (
            isinstance(largest_strength, Real) and 0 < largest_strength < np.inf and law.has_bond
        ):
            raise ValueError(
                f"Interface: largest_strength = {largest_strength!r} must be positive [MPa], for a "
                f"law with a bond, and the law is {law}"
            )
        _check_sliding(sliding, gap, between, surfaces, law, frame, safety)
        usable = name is None or (isinstance(name, str) and _NAME.fullmatch(name))
        if not usable or name == "bodies":
            raise ValueError(
                f"Interface: name = {name!r} must be usable as a file name, and not 'bodies', "
                "which names the file of the bodies"
            )
        damage = _checked_damage(initial_damage, facets, law)
        for parameter, value in law.varying.items():
            if not callable(value):
                _check_one_a_facet(value, facets, f"{parameter} of the law")
        indices = facets is not None and not callable(facets)
        self.facets = _local_indices(facets) if indices else facets
        self.surfaces = None if surfaces is None else _two_surfaces(surfaces)
        self.between = between
        self.within = within
        self.level_set = level_set
        self.law = law
        self.safety = safety if safety == AUTO else float(safety)
        self.norm = norm
        self.frame = frame
        self.traction_jump = bool(traction_jump)
        self.activate = activate
        self.activate_at = float(activate_at)
        self.stabilization = stabilization
        self.initial_damage = damage
        self.largest_strength = largest_strength
        self.sliding = bool(sliding)
        self.gap = gap or (KEEP if sliding else IGNORE)
        self.name = name
        self._complete = True

    def __setattr__(self, name: str, value: Any) -> None:
        if hasattr(self, "_complete"):
            raise AttributeError(
                f"Interface: {name} cannot be changed, an existing problem would not notice; "
                "create a new Interface and a new Problem"
            )
        super().__setattr__(name, value)

    @property
    def place(self) -> str:
        """Description of its location."""
        if callable(self.between):
            return "between=<function>"
        if self.surfaces is not None:
            one, two = map(len, self.surfaces)
            return f"surfaces=(<{one}>, <{two}>)"
        if self.between is not None:
            return f"between={self.between!r}"
        if self.within is not None:
            return f"within={self.within!r}"
        if self.level_set is not None:
            return "level_set=<function>"
        return "facets=<function>" if callable(self.facets) else f"facets=<{len(self.facets)}>"

    @property
    def _first_side(self) -> str:
        """Which of two groups is side 1, as text; empty where it depends on the facet."""
        if self.surfaces is not None:
            return " <sliding, side 1: the first>" if self.sliding else " <side 1: the first>"
        if not isinstance(self.between, Sequence) or self.between == ALL:
            return ""
        if self.sliding:
            return " <sliding, side 1: the stiffer, flatter or coarser>"
        if all(isinstance(group, int | np.integer) for group in self.between):
            return f" <side 1: {min(self.between)}>"
        return " <side 1: the lower tag>"

    def __str__(self) -> str:
        return f"Interface({self.place})" if self.name is None else f"interface {self.name!r}"

    def __repr__(self) -> str:
        name = "" if self.name is None else f", name={self.name!r}"
        return f"Interface({self.place}{self._first_side}, law={self.law}{name})"


def _check_sliding(
    sliding: bool,
    gap: str | None,
    between: Any,
    surfaces: Any,
    law: Law,
    frame: str,
    safety: float | str,
) -> None:
    """Refuse an interface that slides, or has gaps, and is not between two bodies, or has a law, a
    frame or gaps of another kind."""
    if gap not in (None, IGNORE, KEEP):
        raise ValueError(
            f'Interface: gap = {gap!r} must be "{IGNORE}" or "{KEEP}": whether the distance of '
            "surfaces that share no nodes counts"
        )
    several = callable(between) or between == ALL
    if (sliding or gap == KEEP) and (several or (between is None and surfaces is None)):
        what = "sliding = True" if sliding else f'gap = "{KEEP}"'
        raise ValueError(
            f"Interface: {what} is for two bodies that share no nodes: between=(tag, tag) or "
            "surfaces=(facets, facets)"
        )
    if gap == KEEP and not sliding and (law.has_bond or not law.inelastic):
        raise ValueError(
            f'Interface: {law} holds the bodies together, across any gap: gap = "{KEEP}" is for '
            "contact, vmdg.Contact(friction=...)"
        )
    if not sliding:
        return
    if not law.inelastic:
        raise ValueError(
            f"Interface: {law} holds the bodies together, so that they cannot slide: "
            "sliding = True is for contact and for bonds that may break"
        )
    if law.has_bond and safety != AUTO:
        raise ValueError(
            f'Interface: safety = {safety!r} is not for a bond of bodies that slide; use "{AUTO}"'
        )
    if frame != FRAMES[0]:
        raise ValueError(
            f'Interface: frame = {frame!r} does not follow bodies that slide; use "{FRAMES[0]}"'
        )
    if gap == IGNORE:
        raise ValueError(
            f'Interface: gap = "{IGNORE}" has no meaning for bodies that slide, whose points meet '
            f'others; omit it or give "{KEEP}"'
        )


def _two_surfaces(given: Any) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    if not isinstance(given, Sequence) or isinstance(given, str) or len(given) != 2:
        raise TypeError(
            f"Interface: surfaces = {given!r} must be two arrays of local facets, for example "
            "(facet_tags.find(3), facet_tags.find(4))"
        )
    one, two = (_local_indices(facets, "surfaces") for facets in given)
    return one, two


def _local_indices(given: ArrayLike, what: str = "facets") -> NDArray[np.int32]:
    facets = np.asarray(given)
    if facets.ndim != 1 or (facets.size and facets.dtype.kind not in "iu"):
        raise TypeError(
            f"Interface: {what} = {given!r} must be an array of local facets, as "
            "facet_tags.find(group) gives them (np.flatnonzero(mask) of a mask), or a predicate "
            "on coordinates"
        )
    return facets.astype(np.int32)


def _checked_damage(given: Any, facets: Any, law: Law) -> float | NDArray | LevelSet | None:
    """Initial damage as a number, an array like the facets, or a function; None for none."""
    if given is None:
        return None
    if not law.has_bond:
        raise ValueError(
            f"Interface: initial_damage has no meaning for {law}, which has no bond to damage; "
            "omit it, or give a law with a strength"
        )
    if callable(given):
        return given
    values = np.asarray(given)
    if values.dtype.kind not in "biuf" or not ((values >= 0) & (values <= 1)).all():
        raise ValueError(
            f"Interface: initial_damage = {given!r} must lie in [0, 1]: the lost fraction of the "
            "strength, a number, f(x) of midpoints x (3, n), or one number per facet"
        )
    values = values.astype(float)
    if values.ndim == 0:
        return float(values)
    _check_one_a_facet(values, facets, "initial_damage")
    return values


def _check_one_a_facet(values: NDArray, facets: Any, what: str) -> None:
    if facets is None or callable(facets) or values.shape != np.shape(facets):
        raise ValueError(
            f"Interface: {what} has shape {values.shape}; an array must have one value for every "
            "facet of facets=; without facets= give a number or a function of points x (3, n)"
        )


#: One of a problem's interfaces: its number, its name, or the interface itself.
Which = int | str | Interface


def interface_names(interfaces: Iterable[Interface]) -> list[str]:
    """Names of a problem's interfaces, "interface_<number>" where the user gave none."""
    return [interface.name or f"interface_{i}" for i, interface in enumerate(interfaces)]


def label_of(interfaces: Sequence[Interface], number: int) -> str:
    one = interfaces[number]
    return f"interface {number} ({one.place})" if one.name is None else str(one)


def number_of(interfaces: Sequence[Interface], which: Which) -> int:
    names = interface_names(interfaces)
    asked = which if isinstance(which, Interface) else repr(which)
    missing = f"there is no interface {asked}; the problem has {', '.join(map(repr, names))}"
    if isinstance(which, str | Interface):
        places: list[Any] = names if isinstance(which, str) else list(interfaces)
        if which not in places:
            raise ValueError(missing)
        return places.index(which)
    if not isinstance(which, int | np.integer) or isinstance(which, bool):
        raise TypeError(missing)
    number = int(which)
    if not -len(names) <= number < len(names):
        raise IndexError(missing)
    return number % len(names)


class InterfaceList(list[T]):
    """One value per interface, indexed by number, name or the interface itself."""

    def __init__(self, interfaces: Sequence[Interface], values: Iterable[T]):
        super().__init__(values)
        self._interfaces = interfaces

    def __getitem__(self, which: Any) -> Any:
        if not isinstance(which, slice):
            which = number_of(self._interfaces, which)
        return super().__getitem__(which)
