"""Cracks that grow along an interface: length, process zone, energy release rate and mode."""

from __future__ import annotations

from numbers import Real

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import trapezoid

from ..assembly.surface import BROKEN
from ..base.parallel import global_sum
from ..forms.geometry import Axisymmetric
from ..interface.values import InterfaceState
from ..points.interface import Which, label_of, number_of
from ..problem.problem import Problem
from ..problem.step import energy_of


class CrackGrowth:
    """Length, process zone, resistance and modes of a crack growing along an interface.

    Call it once per row: as the monitor, ``monitor=crack``, or within one, ``crack()``. With Q the
    softening of a point, Q_0 that of its ``initial_damage``, d = (Q - Q_0)/(P_c - Q_0) the fraction
    of its bond broken in the run, 1 where there was none, and D the damage work of the whole
    problem,

    * crack: a = a_0 + (integral of d dA)/b, the length at which all damage counts as crack; a
      pre-existing crack by ``initial_damage`` is included;
    * zone: area of 0 < d < 1 over b where Q < 0.99 P_c, the length of the process zone;
    * resistance: G_R = dD/(b da) between two rows, the R-curve over a;
    * mode_1, mode_2: J_I = |integral of T_N dg_N| and J_II = |integral of T_T dg_T| along a plane
      interface (Rice 1968, J on a path around the process zone), the energy release rates of
      opening and of shear; in 2D only.

    J_I and J_II are integrated by the trapezoidal rule between points, without variations within a
    facet: with ten facets in the zone they are accurate to about 1 %.

    Args:
        problem: The problem.
        interface: The interface along which the crack grows: its number, its name or itself.
        width: b, across the direction of growth; default the thickness in plane strain. In
            axisymmetry, the circumference of a crack along a cylinder [mm].
        start: a_0, length of a crack outside the facets of the interface [mm].

    Raises:
        ValueError: the interface is a tie or opens on demand, a width is missing in 3D or
            axisymmetry, or width or start is not a length.
    """

    def __init__(
        self, problem: Problem, interface: Which, width: float | None = None, start: float = 0.0
    ):
        self._number = number_of(problem.interfaces, interface)
        chosen, label = problem.interfaces[self._number], label_of(problem.interfaces, self._number)
        if not chosen.law.has_bond:
            raise ValueError(f"CrackGrowth: {label} has no bond that can fail")
        if chosen.activate == "on-demand":
            raise ValueError(
                f"CrackGrowth: {label} opens on demand, and closed facets have no points; "
                'give the interface activate="all"'
            )
        if width is not None and not (isinstance(width, float | Real) and 0 < width < np.inf):
            raise ValueError(f"CrackGrowth: width = {width!r} must be positive and finite [mm]")
        if not (isinstance(start, float | Real) and 0 <= start < np.inf):
            raise ValueError(f"CrackGrowth: start = {start!r} must be a length >= 0 [mm]")
        self._plane = problem.mesh.topology.dim == 2
        geometry = problem.discretization.geometry
        if width is None and (not self._plane or isinstance(geometry, Axisymmetric)):
            raise ValueError(
                "CrackGrowth: give the width across the direction of growth [mm], in axisymmetry "
                "the circumference of the crack"
            )
        self._problem = problem
        self._width = float(geometry.thickness if width is None else width)
        self._start = start
        # a and D of the rows, D ascending.
        self._rows = [(self._crack(self._state()), energy_of(problem.step).damage)]

    def _state(self) -> InterfaceState:
        return self._problem.state[self._number]

    def _initial(self, state: InterfaceState) -> NDArray[np.float64]:
        """Q_0/P_c (nq,); 1 where the bond is gone with the partner."""
        active, found = self._problem.discretization.active[self._number], np.ones(len(state.facet))
        own = active.facets.damage[active.quadrature.facet]
        found[: len(own)] = own
        return found

    def _over_width(self, area: float) -> float:
        """An area of this rank over the width; collective [mm]."""
        thickness = float(self._problem.discretization.geometry.thickness) if self._plane else 1.0
        return float(thickness * global_sum(self._problem.comm, area) / self._width)

    def _crack(self, state: InterfaceState) -> float:
        # Of a bond only what holds stays where it was: the rest of the area is the crack.
        before, intact = self._initial(state), np.zeros(len(state.damage))
        bonded = before < BROKEN
        intact[bonded] = (1 - state.damage[bonded]) / (1 - before[bonded])
        area = self._problem.discretization.active[self._number].bonded_area
        return self._start + self._over_width(area - state.weights @ intact)

    @property
    def length(self) -> float:
        """a of the last row [mm]."""
        return self._rows[-1][0]

    def __call__(self, problem: Problem | None = None) -> dict[str, float]:
        """The current row; collective.

        Args:
            problem: The problem of the crack, as passed to a monitor; the same on another mesh
                where meshes follow the crack, whose last rows may have been taken back.

        Returns:
            "crack [mm]", "zone [mm]", "resistance [N/mm]", NaN in a row without growth, and in 2D
            "mode_1 [N/mm]" and "mode_2 [N/mm]".
        """
        if problem is not None and problem is not self._problem:
            self._problem = problem
            spent = energy_of(problem.step).damage
            self._rows[1:] = [row for row in self._rows[1:] if row[1] < spent]
        state, spent = self._state(), energy_of(self._problem.step).damage
        crack = self._crack(state)
        breaking = (state.damage > self._initial(state)) & (state.damage < BROKEN)
        last, before = self._rows[-1]
        grown = crack - last
        if not self._problem.loading.nearby:
            self._rows.append((crack, spent))
        row = {
            "crack [mm]": crack,
            "zone [mm]": self._over_width(state.weights @ breaking),
            "resistance [N/mm]": (
                (spent - before) / (self._width * grown) if grown > 0 else float("nan")
            ),
        }
        if self._plane:
            opening, shear = self._release(state)
            row |= {"mode_1 [N/mm]": opening, "mode_2 [N/mm]": shear}
        return row

    def _release(self, state: InterfaceState) -> tuple[float, float]:
        """J_I and J_II, the same on every rank; collective [N/mm]."""
        turned = [
            np.einsum("pji,pj->pi", state.rotation, vector)
            for vector in (state.traction, state.opening)
        ]
        own = np.hstack([state.points[:, :2], state.normal, *turned])
        comm, result = self._problem.comm, None
        parts = comm.gather(own)
        if comm.rank == 0:
            points = np.concatenate(parts)
            X, N, T, g = np.split(points, 4, axis=1)
            tangent = np.stack([-N[:, 1], N[:, 0]], axis=1)
            along = np.lexsort(X.T if np.ptp(X[:, 1]) > np.ptp(X[:, 0]) else X.T[::-1])
            modes = []
            for axis in (N, tangent):
                force, gap = (np.einsum("pi,pi->p", v, axis)[along] for v in (T, g))
                modes.append(abs(float(trapezoid(force, gap))))
            result = tuple(modes)
        return comm.bcast(result)
