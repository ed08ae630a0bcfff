"""tau_s and delta, eqs. (21)-(23), per facet from bubble integrals of the current moduli."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem
from numpy.typing import NDArray

from ..base.kernels import compile_form
from ..base.quadrature import bubble_degree
from ..domain.materials import Bodies
from ..forms import bubbles
from ..forms.geometry import Geometry
from ..forms.stabilization import bubble_stiffness
from .facets import InterfaceFacets
from .interface import AUTO, Interface, StabilizationContext
from .quadrature import FacetQuadrature, bubble_integrals


@dataclass(frozen=True)
class Stabilization:
    """Stabilization of an interface on the facets this rank owns.

    Attributes:
        tau: tau_s, safety included (nf, d, d) [MPa/mm].
        delta: Flux weights delta_1, delta_2 of (23) (nf, 2, d, d).
        delta_s: (tau_1^-1 + tau_2^-1)^-1 of (25)-(26), without safety (nf, d, d) [mm3/N].
        norm: |tau_s|, the scalar r of (57) (nf,) [MPa/mm].
        safety: Factor in ``tau`` and ``norm`` on the derived tau_s (nf,).
    """

    tau: NDArray[np.float64]
    delta: NDArray[np.float64]
    delta_s: NDArray[np.float64]
    norm: NDArray[np.float64]
    safety: NDArray[np.float64]

    @classmethod
    def empty(cls, d: int) -> Stabilization:
        """Of an interface with no open facet."""
        tensors, numbers = np.zeros((0, d, d)), np.zeros(0)
        return cls(tensors, np.zeros((0, 2, d, d)), tensors, numbers, numbers)

    def raised(self, factor: NDArray[np.float64]) -> Stabilization:
        """The same with tau_s multiplied by ``factor`` (nf,)."""
        return replace(
            self,
            tau=factor[:, None, None] * self.tau,
            norm=factor * self.norm,
            safety=factor * self.safety,
        )


class BubbleIntegrals:
    """Assembles int_K GRAD b : A : GRAD b dV of (22) for chosen (cell, facet in it) pairs.

    A bubble Function selects one facet per cell and pass; a cell with several interface facets
    takes part in several passes, so their number is the largest count of interface facets a cell
    has.
    """

    def __init__(
        self,
        u: fem.Function,
        bodies: Bodies,
        geometry: Geometry,
        cells: NDArray[np.int32],
        local_facets: NDArray[np.int32],
    ):
        mesh = u.function_space.mesh
        cell_name = mesh.topology.cell_name()
        self._d = mesh.geometry.dim
        self._cells = cells
        self._bubble = fem.Function(fem.functionspace(mesh, bubbles.element(cell_name)))
        self._selected = self._bubble.function_space.dofmap.list[cells, local_facets]
        self._pass_of = _occurrence(cells)
        space = fem.functionspace(mesh, ("DG", 0, (self._d, self._d)))
        self._dofs = space.dofmap.list[cells, 0]
        index_map = space.dofmap.index_map
        self._size = (index_map.size_local + index_map.num_ghosts) * self._d**2
        test = ufl.TestFunction(space)
        present = np.unique(cells)
        self._forms = []
        for number, region in enumerate(bodies.regions):
            of_region = present[bodies.region[present] == number]
            dx = ufl.Measure(
                "dx",
                domain=mesh,
                subdomain_data=[(0, of_region)],
                subdomain_id=0,
                metadata={"quadrature_degree": bubble_degree(cell_name, geometry)},
            )
            integrand = bubble_stiffness(region.body, geometry, u, self._bubble)
            weight = geometry.circumference(ufl.SpatialCoordinate(mesh))
            form = weight * ufl.inner(test, integrand) * dx
            self._forms.append(compile_form(form, [], mesh.comm, name="bubble stiffness"))

    def __call__(self) -> NDArray[np.float64]:
        """The integrals (number of pairs, d, d) [MPa mm; MPa in plane strain]."""
        result = np.empty((len(self._cells), self._d, self._d))
        for number in range(int(self._pass_of.max(initial=-1)) + 1):
            chosen = self._pass_of == number
            self._bubble.x.array[:] = 0
            self._bubble.x.array[self._selected[chosen]] = 1
            assembled = np.zeros(self._size)
            for form in self._forms:
                fem.assemble_vector(assembled, form)
            values = assembled.reshape(-1, self._d, self._d)
            result[chosen] = values[self._dofs[chosen]]
        return result


def _occurrence(values: NDArray[np.int32]) -> NDArray[np.int64]:
    """How many times each entry occurs before itself."""
    order = np.argsort(values, kind="stable")
    starts = np.flatnonzero(np.diff(values[order], prepend=-1))
    count = np.diff(np.append(starts, len(values)))
    result = np.empty(len(values), dtype=np.int64)
    result[order] = np.arange(len(values)) - np.repeat(starts, count)
    return result


class Stabilizer:
    """Evaluates the stabilization of one interface at the current displacement.

    tau_a = (int_gamma b)^2 / meas(gamma) inv(int_K GRAD b : A : GRAD b dV)   (21)-(22)
    tau_s = safety inv(tau_1 + tau_2),  delta_a = inv(tau_1 + tau_2).tau_a    (23)
    delta_s = tau_1.inv(tau_1 + tau_2).tau_2                                  (25)

    With ``safety="auto"`` tau_s is the derived one: :mod:`vmdg.interface.coercivity` raises it.

    In axisymmetry the fine scale is a ring, u' = b_s (beta_r e_r + beta_z e_z), and (21)-(22)
    follow in the same way from the weak form on its cell, all integrals with dA = 2 pi r ds and
    dV = 2 pi r dr dz and GRAD(b e_r) with its hoop part b/r:
    tau_a = (int b 2 pi r ds)^2 / (int 2 pi r ds) inv(int GRAD b : A : GRAD b 2 pi r dr dz).
    Both sides of every fraction carry one length more, so tau is per reference area as before, and
    tends to that of plane strain where r is large against the cell.
    """

    def __init__(
        self,
        interface: Interface,
        facets: InterfaceFacets,
        quadrature: FacetQuadrature,
        u: fem.Function,
        bodies: Bodies,
    ):
        self._interface = interface
        self._stiffness = BubbleIntegrals(
            u, bodies, quadrature.geometry, facets.cells.T.ravel(), facets.local.T.ravel()
        )
        area = quadrature.area
        self._factor = bubble_integrals(quadrature) ** 2 / area
        N = np.zeros((len(area), quadrature.d))
        np.add.at(N, quadrature.facet, quadrature.normal * quadrature.weights[:, None])
        N /= np.linalg.norm(N, axis=1, keepdims=True)
        self._context = StabilizationContext(u, facets.cells, facets.local, facets.facets, N, area)

    def __call__(self) -> Stabilization:
        """tau_s and delta at the current displacement.

        Raises:
            ValueError: the user's callable returns arrays of wrong shape.
        """
        number = len(self._factor)
        stiffness = self._stiffness()
        d = stiffness.shape[-1]
        tau1, tau2 = self._factor[:, None, None] * np.linalg.inv(stiffness).reshape(2, number, d, d)
        bonded = np.linalg.inv(tau1 + tau2)
        safety = 1.0
        if self._interface.stabilization is not None:
            tau, delta1 = self._interface.stabilization(tau1, tau2, self._context)
            for name, value in (("tau_s", tau), ("delta1", delta1)):
                if np.shape(value) != (number, d, d):
                    raise ValueError(
                        f"{self._interface}: stabilization returned {name} of shape "
                        f"{np.shape(value)}, expected {(number, d, d)}"
                    )
        else:
            if self._interface.safety != AUTO:
                safety = self._interface.safety
            tau, delta1 = safety * bonded, bonded @ tau1
        delta = np.stack([delta1, np.eye(d) - delta1], axis=1)
        order = "fro" if self._interface.norm == "frobenius" else 2
        norm = np.linalg.norm(tau, ord=order, axis=(1, 2))
        return Stabilization(tau, delta, tau1 @ bonded @ tau2, norm, np.full(number, float(safety)))
