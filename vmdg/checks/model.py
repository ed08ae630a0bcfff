"""Checks of a problem before it is solved, for mistakes whose effects would be hard to
interpret."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..assembly.means import lattice_of
from ..base.parallel import global_any, global_max, raise_together, warn_together
from ..domain.topology import box_sides
from ..interface.active import ActiveInterface
from ..interface.stabilization import SAME_UNITS, SUSPICIOUS_RATIO
from ..problem.motion import moving
from ..problem.problem import Problem
from .standing import falling
from .supports import LoosePart, in_words, loose_among, loose_parts, parts_of

#: Strength relative to r h, the stiffness of the cells at an interface: smallest plausible value (a
#: modulus in Pa with a strength in MPa is below), and largest usual value.
WEAKEST, USUAL = 1e-8, 0.1

#: Largest plausible critical gap relative to the size of the mesh.
WIDEST = 1.0

#: Smallest plausible duration of a motion, relative to the time of a wave through a cell. A density
#: in kg/m3 with N, mm and s makes waves 1e6 times slower.
BRIEFEST = 1e-3

#: |tau_s| relative to H below which the loss of digits is reported.
LOSSY = 1e-3

#: Number of load factors at which loads are compared, and relative position of an intermediate one.
MOST_SAMPLES, BETWEEN = 5, 0.382

#: Smallest plausible length of a periodic cell in the first loaded state, relative to the initial
#: one.
SHORTEST = 0.5

#: Largest plausible coefficient of friction, below values in degrees or percent.
ROUGHEST = 5.0


def check_model(problem: Problem, loads: NDArray[np.float64], traced: bool = False) -> bool:
    """Look for missing or conflicting supports and implausible numbers; whether a body is
    constrained by contact alone.

    ``traced`` if load factors may decrease along the path where bonds break.
    """
    message = (
        "the nodes of the mesh were moved after the problem was created, which does not notice it: "
        "move or scale the mesh first"
    )
    raise_together(problem.comm, message if problem.discretization.bodies.moved else None)
    rests_on_contact = _check_supports(problem)
    _check_programme(problem, loads)
    if not traced:
        _check_bonds(problem, loads)
    _check_gradient(problem, float(loads[0]))
    first, last = (problem.loading.dirichlet.conflict(float(t)) for t in (loads[0], loads[-1]))
    warn_together(problem.comm, first or last)
    for active in problem.discretization.active.values():
        if active.law.inelastic:
            _check_proportions(problem, active)
    return rests_on_contact


def checked_loads(
    loads: ArrayLike, problem: Problem, rows: Sequence[Mapping[str, Any]] | None = None
) -> NDArray[np.float64]:
    """Load factors as an array (n,); warns about those that a continued run has passed; collective.

    Args:
        loads: The user's loads; an int is a number of equal steps to 1.
        rows: Rows of an earlier run to continue, in which case there may be no loads.
    """
    if not isinstance(problem, Problem):
        raise TypeError(
            f"solve: problem = {problem!r} must be a vmdg.Problem: solve(problem, loads)"
        )
    if isinstance(loads, int | np.integer) and not isinstance(loads, bool):
        return _equal_steps(int(loads), problem.t)
    if np.ndim(loads) == 0:
        raise TypeError(
            f"solve: loads = {loads!r} must be a list of load factors, [1.0] for one step to 1, or "
            "an int, 10 for ten equal steps to 1"
        )
    given = np.asarray(loads)
    empty = not given.size and rows is None
    if given.ndim != 1 or given.dtype.kind not in "iuf" or empty or not np.isfinite(given).all():
        raise ValueError(
            f"solve: loads = {loads!r} must be one or more finite load factors, for example "
            "numpy.linspace(0.1, 1.0, 10)"
        )
    result, message = given.astype(float), None
    if rows and result.size and rows[0]["load"] == result[0] != problem.t in result:
        message = (
            f"solve: the continued run is at load factor {problem.t:.8g}, but loads start again at "
            f"{result[0]:.8g}: the run returns there. To continue give the remaining ones, "
            "loads[loads > problem.t]"
        )
    warn_together(problem.comm, message)
    return result


def _equal_steps(number: int, start: float) -> NDArray[np.float64]:
    if number < 1:
        raise ValueError(f"solve: loads = {number} is a number of steps and must be at least 1")
    if start >= 1:
        raise ValueError(
            f"solve: loads = {number} is a number of equal steps to load factor 1, and the problem "
            f"is at {start:.8g}: give the load factors themselves, for example "
            f"[{start:.8g}, {start + 0.1:.8g}]"
        )
    return np.linspace(start, 1.0, number + 1)[1:]


# Supports


def _check_supports(problem: Problem) -> bool:
    """Whether a body is constrained by contact alone; raises for an unconstrained body."""
    interfaces, message = problem.discretization.active.values(), None
    for words, motions in _alike(loose_parts(problem, interfaces)):
        message = (
            f"there is no constraint on {words} against {motions}: the solution is not unique. "
            "Prescribe displacements by problem.dirichlet(facets, 0.0), or for a symmetric body "
            "those of its planes of symmetry, dirichlet(facets, 0.0, 'x')"
        )
    raise_together(problem.comm, message)
    bonded = _bonded(problem)
    broken = any(bool((one.facets.damage >= 1).any()) for one in interfaces)
    cut = len(bonded) < len(interfaces) or global_any(problem.comm, broken)
    resting = loose_parts(problem, bonded, worst=1.0) if cut else []
    for words, motions in _alike(resting):
        warn_together(
            problem.comm,
            f"only contact constrains {words} against {motions}, and contact without pressure "
            "constrains nothing: prescribe displacements, or press the body by them; if the mesh "
            "does not follow a precrack, cells between its facets are such bodies",
        )
    return bool(resting)


def _alike(parts: Sequence[LoosePart]) -> list[tuple[str, str]]:
    """Description of bodies and motions, one for all parts with equal motions."""
    motions = dict.fromkeys(part.motions for part in parts)
    return [(in_words([p for p in parts if p.motions == one]), one) for one in motions]


def _bonded(problem: Problem) -> list[ActiveInterface]:
    """Interfaces that are not completely broken; collective."""
    interfaces = problem.discretization.active.values()
    holds = [global_any(problem.comm, bool((c.facets.damage < 1).any())) for c in interfaces]
    return [
        c
        for c, some in zip(interfaces, holds, strict=True)
        if some and (c.law.has_bond or not c.law.inelastic)
    ]


def _check_bonds(problem: Problem, loads: NDArray[np.float64]) -> None:
    """Warn about loads carried by bonds alone; contact is checked by limit analysis."""
    interfaces = problem.discretization.active.values()
    # Cracks within a body are assumed to leave it in one piece.
    lasting = [c for c in interfaces if not c.law.inelastic or c.interface.within is not None]
    loaded = problem.loading.given.loaded
    breakable = [c for c in _bonded(problem) if c not in lasting]
    if not breakable or not global_any(problem.comm, bool(loaded.any())):
        return
    held, comm = parts_of(problem, lasting), problem.comm
    loose = [
        part
        for part in loose_among(problem, held)
        if global_any(comm, bool(loaded[part.cells].any()))
    ]
    # The extent and forces of a fluid are not known in advance.
    if loose and not problem.loading.given.filled:
        between = [one for one in interfaces if one not in lasting]
        falls = set().union(*(falling(problem, held, between, t) for t in (loads[0], loads[-1])))
        loose = [part for part in loose if part.name in falls]
    for words, motions in _alike(loose):
        several = words[0].isdigit()
        warn_together(
            comm,
            f"{words} {'carry loads' if several else 'carries a load'}, and against {motions} only "
            f"bonds constrain {'them' if several else 'it'}: once they break there is no "
            "equilibrium, and no step will converge. Prescribe a displacement instead of the load, "
            "or follow the decreasing load by SolveOptions(unstable='trace') until= the crack is "
            "long enough",
        )


def _check_programme(problem: Problem, loads: NDArray[np.float64]) -> None:
    """Warn about a run without loads, or without changes from row to row."""
    check, ends = problem.loading.check_finite, dict.fromkeys((float(loads[0]), float(loads[-1])))
    rows = [check(t) for t in ends]
    try:
        rows += [check(t) for t in _samples(problem.t, loads) if t not in ends]
    except Exception:
        # A user's function failed on all ranks at a load factor that the run may not reach; if it
        # does, it ends there with this error and the rows until then.
        return
    pairs = [(part, first) for row in rows for part, first in zip(row, rows[0], strict=True)]
    loaded = global_any(problem.comm, any(part.any() for part, _ in pairs))
    changes = global_any(problem.comm, any((part != first).any() for part, first in pairs))
    message = None
    # Bodies that overlap push each other apart.
    moved = problem.u.x.array.any() or any(
        one.history.traction.any() for one in problem.discretization.active.values()
    )
    if not loaded and not global_any(problem.comm, bool(moved)):
        message = (
            "there is no load: all prescribed displacements, loads and eigenstrains are zero at "
            f"load factors {loads[0]:.6g} to {loads[-1]:.6g}. Give a load that depends on the load "
            "factor, problem.dirichlet(facets, lambda t: 0.1 * t, 'x') for example"
        )
    elif not changes and len(set(loads)) > 1 and not _moves_by_itself(problem):
        message = (
            f"no load depends on the load factor: all {len(loads)} steps end in the same state. "
            "Give the increasing load as a function, lambda t: 0.1 * t instead of 0.1, or a single "
            "load factor, [1.0]"
        )
    warn_together(problem.comm, message)


def _samples(start: float, loads: NDArray[np.float64]) -> NDArray[np.float64]:
    """The current load factor, some of those to reach, and one between the first two."""
    some = loads[np.unique(np.linspace(0, len(loads) - 1, MOST_SAMPLES).astype(int))]
    between = loads[0] + BETWEEN * np.diff(loads[:2])
    return np.concatenate([[start], some, between])


def _check_gradient(problem: Problem, t: float) -> None:
    """Warn about a mean gradient that was probably meant as a strain."""
    means, u = problem.discretization.means, problem.u.x.array
    if lattice_of(means) is None or problem.discretization.bodies.small:
        return
    given = np.zeros_like(u)
    given[problem.loading.prescribed] = problem.loading.dirichlet.values(t)
    H = means.gradient(given)
    least, message = np.linalg.svd(np.eye(len(H)) + H, compute_uv=False)[-1], None
    if least < SHORTEST:
        message = (
            f"Periodic: gradient compresses the cell to {least:.3g} of its length at the first "
            f"load factor, {t:.6g}. It is F_bar, 1 without strain: use 1 + 0.01 * t instead of "
            "0.01 * t"
        )
    warn_together(problem.comm, message)


def _moves_by_itself(problem: Problem) -> bool:
    """Whether a state may change under constant loads: by viscosity, cycles, or spreading
    fluids."""
    worn = any(interface.law.fatigues for interface in problem.interfaces)
    return bool(problem.loading.given.filled) or worn or rated(problem)


def rated(problem: Problem) -> bool:
    """Whether laws or bodies of a problem depend on the time step."""
    bodies = problem.discretization.bodies.points
    laws = any(interface.law.viscosity > 0 for interface in problem.interfaces)
    return laws or (bodies is not None and bool(bodies.viscous))


# Proportions


def _check_proportions(problem: Problem, active: ActiveInterface) -> None:
    law, comm, message = active.facets.law, problem.comm, None
    if (roughest := np.max(law.friction, initial=0.0)) > ROUGHEST:
        message = (
            f"{active.facets.label}: friction = {roughest:g} is Coulomb's coefficient mu, the "
            "tangent of the friction angle, usually below 1; it is neither in degrees nor in "
            "percent"
        )
    warn_together(comm, message)
    if not law.has_bond:
        return
    _check_softening(comm, active)
    stiffness = _moduli(active)
    softest = -global_max(comm, float(-stiffness.min(initial=np.inf)))
    size = box_sides(problem.mesh).max()
    strength = np.min(law.strength, initial=np.inf)
    gap = np.max(law.strength / law.softening_modulus, initial=0.0)
    message = None
    if strength < WEAKEST * softest:
        message = (
            f"{active.facets.label}: the strength {strength:.3g} is less than {WEAKEST:g} of the "
            f"adjacent elastic moduli, of the order of {softest:.3g}: the bond breaks at once. "
            "Give both in the same unit (MPa with mm and N)"
        )
    # With a strength near the moduli the bond is intended not to break.
    elif gap > WIDEST * size and strength < USUAL * softest:
        message = (
            f"{active.facets.label}: the critical gap is about {gap:.3g}, the mesh {size:.3g} "
            "wide: the bond will hardly soften. Give both in the same unit (mm with N and MPa), "
            "and the strength before the critical gap"
        )
    warn_together(comm, message)


def _moduli(active: ActiveInterface) -> NDArray[np.float64]:
    """r h of facets (nf,), of the order of the moduli of their cells [MPa]."""
    r = active.stabilization.norm / active.stabilization.safety
    return r * active.quadrature.extent


def check_duration(problem: Problem, duration: float) -> None:
    """Warn about a motion that is over long before a wave has crossed a cell; collective.

    A wave at c = sqrt(E/rho) takes h/c through a cell of the size h, here those at interfaces.
    """
    rho, message = max(moving(problem.step.motion).density.values()), None
    times = [
        float((active.quadrature.extent * np.sqrt(rho / _moduli(active))).min(initial=np.inf))
        for active in problem.discretization.active.values()
    ]
    crossing = -global_max(problem.comm, -min(times, default=np.inf))
    if duration < BRIEFEST * crossing < np.inf:
        message = (
            f"solve_dynamics: in {duration:.3g} s no wave crosses a cell, which takes "
            f"{crossing:.3g} s with the density {rho:.3g}. With N, mm and s densities are in t/mm3 "
            "(steel 7.85e-9), with N, m and s in kg/m3"
        )
    warn_together(problem.comm, message)


def _check_softening(comm: MPI.Comm, active: ActiveInterface) -> None:
    """Warn about facets far too coarse for H, which the r of ``safety="auto"`` exceeds on any
    mesh."""
    if not active.stabilizer.automatic:
        return
    extent = active.quadrature.extent
    H = np.broadcast_to(active.facets.law.softening_modulus, extent.shape)
    share = active.stabilization.norm / active.stabilization.safety / H
    worst, message = -global_max(comm, float(-share.min(initial=np.inf))), None
    if worst < 1 / SUSPICIOUS_RATIO and worst == share.min(initial=np.inf):
        f = np.argmin(share)
        message = (
            f"{active.facets.label}: at facet {active.facets.facets[f]} the softening modulus H = "
            f"{H[f]:.6g} MPa/mm is far above the derived |tau_s| = {share[f] * H[f]:.6g}: the bond "
            "would soften faster than the element can unload. Refine the facet from "
            f"{extent[f]:.3g} to below {extent[f] * share[f]:.3g} mm, or raise the critical "
            f"gap{SAME_UNITS}"
        )
        if share[f] < LOSSY:
            # T = {P.N} + r (g - zeta), r = 2 H: openings have the rounding error of displacements.
            message += (
                f" Tractions lose {-np.log10(share[f]):.0f} of their 16 digits, so residuals "
                "cannot be as small as usual"
            )
    warn_together(comm, message)
