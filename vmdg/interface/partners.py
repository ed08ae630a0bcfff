"""What the motion of the pairs of surfaces that slide adds to the tangent.

Where side 2 moves by g relative to side 1, segments change, and their points of side 1 move by y,
of :class:`.Shifts`, linear in the jet. With the current normals n of side 1 and m of side 2, a
partner stays on the normal of its point where it moves by -Pi.h relative to its body, with
h = g - y and Pi = I - n (x) m / (m.n). Then

* the distance changes by n m.h/(m.n) instead of g, but not what slides, which is counted by pairs:
  n (m / (m.n) - n).h is added to the opening,
* the fluxes are those of other points: with dX_1 = F_1^-1.y and dX_2 = -F_2^-1.Pi.h the mean flux
  changes by +-delta_a.(A : dF_a/dX.dX_a).N_a, of bodies at points with their stress as it is
  extrapolated in the place of A : dF_a,
* M_2 changes with dS_2/dS_1, by tr L_1 - n.L_1.(2 n - m) - tr L_2 + m.L_2.n relative to it,
  L_a = GRAD w_a.F_a^-1 and m.n = 1, and with it the flux and the adjoint term of side 2,
* forces act at other points: T.(GRAD eta_2.dX_2 - GRAD eta_1.dX_1),
* dA changes, and with it the terms q of (27),
* zeta of the couple does not grow by the slip.

Points of a bond keep their partners.
"""

from __future__ import annotations

from pathlib import Path

import basix
import numpy as np
from dolfinx import fem
from numpy.typing import NDArray

from ..base.kernels import call, compile_source
from ..domain.materials import Bodies
from ..domain.shapes import derivatives_in_cells, reference_facets
from ..forms.geometry import Axisymmetric
from ..points.pair_points import PairPoints
from .stabilization import Stabilization
from .tangent import PointTangent

Array = NDArray[np.float64]

#: Number of points, and the arrays of partners.c.
_DECLARATIONS = f"""
void add_partners(long{", void *" * 24});
void traction_slopes(long{", void *" * 8});
"""


class PartnerTangent:
    """The part of D of one interface that comes from the motion of its pairs."""

    def __init__(
        self, quadrature: PairPoints, u: fem.Function, bodies: Bodies, tangent: PointTangent
    ):
        self._quadrature, self._u, self._bodies = quadrature, u, bodies
        self._tangent = tangent
        self._hoop = isinstance(quadrature.geometry, Axisymmetric)
        d, entries = quadrature.d, len(tangent.jets.entries)
        sizes = {"DIM": d, "ENTRIES": entries, "KNOWN": d * d + self._hoop}
        source, comm = Path(__file__).with_suffix(".c"), quadrature.mesh.comm
        self._module = compile_source(source, _DECLARATIONS, sizes, comm, "partners' tangent")

    def add_to(
        self,
        D: Array,
        traction: Array,
        compliance: Array | None,
        stabilization: Stabilization,
        frame: tuple[Array, Array],
        T: Array,
        terms: Array,
        flux: Array,
    ) -> None:
        """Add to D dA.

        Args:
            traction: Tt dA from there (nq, d, jet).
            compliance: C = d zeta/dT (nq, d, d) [mm3/N]; None fixes zeta.
            terms: q of (27) (nq, jet).
            flux: P_2.N_2 dS_2/dS_1 (nq, d) [MPa].
        """
        q, d, facet = self._quadrature, self._quadrature.d, self._quadrature.facet
        gradients = np.ascontiguousarray(q.field(self._u)[1][..., : d * d])
        call(
            self._module,
            "add_partners",
            *(self._tangent.areas, gradients, q.normal, *q.outward, q.leads, *frame),
            *(q.facets.segments.axes[facet], *q.shifts()),
            *(1.0 * (facet >= q.facets.bonded), stabilization.norm[facet], compliance),
            *(stabilization.weights[facet], *(self._traction_slopes(a) for a in range(2))),
            *(T, terms, flux, traction, D),
        )

    def _traction_slopes(self, a: int) -> Array | None:
        """How P.N of side ``a`` changes with X along its facet (nq, d, d) [MPa/mm]; None where it
        is constant."""
        q, u, points = self._quadrature, self._u, self._bodies.points
        degree, d = u.function_space.ufl_element().degree, q.d
        flat = q.mesh.topology.cell_name() in ("triangle", "tetrahedron")
        if degree == 1 and flat and not self._hoop:
            return None
        cells, places = q.facets.cells[:, a], q.places()[a]
        edges = reference_facets(q.mesh)[1][q.facets.local[:, a]]
        unit = np.eye(d, dtype=int)
        first = np.array([basix.index(*one) for one in unit])
        second = np.array([[basix.index(*(one + other)) for other in unit] for one in unit])
        found = np.empty((len(q.facet), d, d))
        call(
            self._module,
            "traction_slopes",
            *(self._tangent.moduli[a], *derivatives_in_cells(u, cells, places), first, second),
            *(q.field(u)[1][:, :, a], edges[q.facet], found),
        )
        cells = cells[q.facet]
        if points is not None and (rows := np.flatnonzero(points.has(cells))).size:
            there = places.reshape(-1, d)[rows]
            stress = points.stress_slopes(cells[rows], there)[:, :d, :d]
            found[rows] = np.einsum("pijk,pj->pik", stress, q.outward[a][rows])
        return found
