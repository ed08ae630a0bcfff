"""Errors of an intact interface relative to those of continuous elements on the same mesh.

Small strain, two bodies and exact solutions:

* "ring", a quarter of two rings, or "shell", a sixth of two spherical shells, under internal
  pressure (Lame), u_r = A r + B / r^(d - 1) in each body;
* "Goodier", a ring of a round core and the matrix around it under remote shear;
* "straight", an upright interface, stresses that change across it alone, s_xx = cos 2x and
  s_xy = sin 2x / 2.

The cells are curved where the interface is, of order k. The curve is not what makes errors differ,
but how much of the error is in normal derivatives, see :mod:`vmdg.interface.coercivity`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from numpy.typing import NDArray
from parts.benchmark.common import DIMENSION
from parts.convergence.manufactured import Exact
from parts.convergence.rates import field_errors, interpolate
from ufl.core.expr import Expr

import vmdg
from vmdg.meshes import TaggedMesh, blocks

TIE = vmdg.Bonded()
BOND = vmdg.Debonding(strength=1e9, critical_gap=1e9)

#: E of body 1 relative to body 2, E = 1000 MPa; nu = 0.3.
CONTRASTS = (0.1, 1.0, 10.0)

#: Inner, interface and outer radius [mm].
RADII = {"ring": (1.0, 2.0, 3.0), "shell": (1.0, 2.0, 3.0), "Goodier": (0.5, 1.0, 2.0)}

#: Cells across each body, by dimension and degree.
LEVELS = {(2, 1): (2, 4), (2, 2): (2, 4), (2, 3): (2, 4), (3, 1): (2, 3), (3, 2): (2,)}

Materials = tuple[vmdg.NeoHookean, vmdg.NeoHookean]
Fields = tuple[Expr, Expr]


@dataclass(frozen=True)
class Excess:
    """Errors relative to those of continuous elements, minus 1."""

    shape: str  # Of the bodies
    cell: str  # Of the mesh
    degree: int  # k
    n: int  # Cells across each body
    contrast: float  # E_1 / E_2
    law: str  # Name of the law
    l2: float  # Of u in L2
    h1: float  # Of GRAD u


def _lame(materials: Materials, d: int) -> NDArray[np.float64]:
    """A and B of both bodies: pressure 1 within, none outside, u_r and s_rr continuous."""
    inner, middle, outer = RADII["ring"]

    def stress(material: vmdg.NeoHookean, r: float) -> list[float]:
        mu, lmbda = material.parameters["mu"], material.parameters["lmbda"]
        return [d * lmbda + 2 * mu, -2 * mu * (d - 1) / r**d]

    one, two = materials
    u = [middle, middle ** (1 - d)]
    rows = [
        stress(one, inner) + [0, 0],
        [0, 0, *stress(two, outer)],
        [*stress(one, middle), *(-s for s in stress(two, middle))],
        [*u, *(-v for v in u)],
    ]
    return np.linalg.solve(rows, [-1.0, 0, 0, 0]).reshape(2, 2)


def _radial(mesh: Mesh, materials: Materials) -> Fields:
    X, d = ufl.SpatialCoordinate(mesh), mesh.geometry.dim
    square = ufl.dot(X, X)
    return tuple((float(A) + float(B) / square ** (d / 2)) * X for A, B in _lame(materials, d))


def _goodier(mesh: Mesh, materials: Materials) -> Fields:
    """u_r = f(r) cos 2t, u_t = g(r) sin 2t: f = -g = a r in the core (a = 1 far away), and with
    k = 3 - 4 nu of the matrix f = r + c (1 + k)/r - d/r3, g = -r + c (1 - k)/r - d/r3 around it."""
    (mu_1, _), (mu_2, l_2) = (tuple(m.parameters.values()) for m in materials)
    r = RADII["Goodier"][1]
    k = 3 - 2 * l_2 / (l_2 + mu_2)

    def column(mu: float, lmbda: float, f: float, g: float, df: float, dg: float) -> list[float]:
        """f, g, s_rr and s_rt at the interface."""
        rr = (lmbda + 2 * mu) * df + lmbda * (f + 2 * g) / r
        return [f, g, rr, mu * (dg - (2 * f + g) / r)]

    l_1 = materials[0].parameters["lmbda"]
    core = column(mu_1, l_1, r, -r, 1, -1)
    far = column(mu_2, l_2, r, -r, 1, -1)
    c = column(mu_2, l_2, (1 + k) / r, (1 - k) / r, -(1 + k) / r**2, -(1 - k) / r**2)
    d = column(mu_2, l_2, -1 / r**3, -1 / r**3, 3 / r**4, 3 / r**4)
    matrix = np.array([core, [-v for v in c], [-v for v in d]]).T
    (a, c, d), *_ = np.linalg.lstsq(matrix, far, rcond=None)
    X = ufl.SpatialCoordinate(mesh)
    R = ufl.sqrt(ufl.dot(X, X))
    n = X / R
    t = ufl.as_vector([-n[1], n[0]])
    cos, sin = n[0] ** 2 - n[1] ** 2, 2 * n[0] * n[1]

    def field(f: Expr, g: Expr) -> Expr:
        return f * cos * n + g * sin * t

    return (
        field(float(a) * R, -float(a) * R),
        field(R + c * (1 + k) / R - d / R**3, -R + c * (1 - k) / R - d / R**3),
    )


def _straight(mesh: Mesh, materials: Materials) -> Fields:
    x = ufl.SpatialCoordinate(mesh)[0]
    fields = []
    for material in materials:
        mu, lmbda = material.parameters["mu"], material.parameters["lmbda"]
        along = (ufl.sin(2 * x) - np.sin(2)) / (2 * (lmbda + 2 * mu))
        fields.append(ufl.as_vector([along, (np.cos(2) - ufl.cos(2 * x)) / (4 * mu)]))
    return tuple(fields)


_FIELDS: dict[str, Callable[[Mesh, Materials], Fields]] = {
    "ring": _radial,
    "shell": _radial,
    "Goodier": _goodier,
    "straight": _straight,
}


def _mesh(shape: str, cell: str, degree: int, n: int) -> TaggedMesh:
    """Body 1 within, with n cells across each body."""
    d = DIMENSION[cell]
    around = n if d == 3 else 2 * n
    curved = shape in RADII
    tagged = blocks(MPI.COMM_WORLD, cell, (n, around, around), order=degree if curved else 1)
    if not curved:
        return tagged
    x, (inner, middle, outer) = tagged.mesh.geometry.x, RADII[shape]
    s = x[:, 0]
    r = np.where(s < 1, inner + (middle - inner) * s, middle + (outer - middle) * (s - 1))
    if d == 2:
        angle = np.pi / 2 * x[:, 1]
        x[:, 0], x[:, 1] = r * np.cos(angle), r * np.sin(angle)
    else:
        way = np.column_stack([np.ones(len(s)), np.tan(np.pi / 4 * (2 * x[:, 1:] - 1))])
        x[:] = r[:, None] * way / np.linalg.norm(way, axis=1)[:, None]
    return tagged


def _errors(
    shape: str,
    tagged: TaggedMesh,
    exact: Exact,
    materials: Materials,
    degree: int,
    law: vmdg.Law | None,
) -> NDArray[np.float64]:
    """Relative errors of u and GRAD u; a ring is loaded, others have all sides prescribed."""
    mesh, d = tagged.mesh, tagged.mesh.geometry.dim
    interfaces = [] if law is None else [vmdg.Interface(between=(1, 2), law=law)]
    bodies = dict(enumerate(materials, start=1))
    problem = vmdg.Problem(mesh, tagged.cell_tags, bodies, interfaces, degree, kinematics="small")
    for tag, (material, u) in enumerate(zip(materials, exact.u, strict=True), start=1):
        mu, lmbda = material.parameters["mu"], material.parameters["lmbda"]
        strain = ufl.sym(ufl.grad(u))
        stress = 2 * mu * strain + lmbda * ufl.tr(strain) * ufl.Identity(d)
        problem.body_force(-ufl.div(stress), tag)
    find = tagged.facet_tags.find
    if shape == "ring":
        problem.traction(find(1), -ufl.FacetNormal(mesh))
        problem.dirichlet(find(4), 0.0, "y")
        problem.dirichlet(find(5), 0.0, "x")
    else:
        interpolate(problem.u, tagged, exact)
        sides = np.concatenate([find(i) for i in (1, 2, 4, 5, 6, 7)])
        dofs = fem.locate_dofs_topological(problem.space, d - 1, sides)
        given = problem.u.x.array.reshape(-1, d)[dofs].T.copy()
        problem.u.x.array[:] = 0
        problem.dirichlet(sides, lambda x, t: given)
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(relative_tolerance=1e-11))
    return np.array(field_errors(problem.u, tagged, exact))


def measure(
    shape: str, cell: str, degree: int, n: int, contrast: float, laws: Sequence[vmdg.Law]
) -> list[Excess]:
    materials = (vmdg.NeoHookean(E=1e3 * contrast, nu=0.3), vmdg.NeoHookean(E=1e3, nu=0.3))
    tagged = _mesh(shape, cell, degree, n)
    exact = Exact(_FIELDS[shape](tagged.mesh, materials), ufl.zero())
    plain = _errors(shape, tagged, exact, materials, degree, None)
    found = []
    for law in laws:
        l2, h1 = _errors(shape, tagged, exact, materials, degree, law) / plain - 1
        name = type(law).__name__
        found.append(Excess(shape, cell, degree, n, contrast, name, float(l2), float(h1)))
    return found


def cases(cell: str, degree: int) -> list[tuple[str, str, int, int, float]]:
    """Shapes, cells across and contrasts; a core like its matrix has a linear solution."""
    d = DIMENSION[cell]
    return [
        (shape, cell, degree, n, contrast)
        for shape in (("ring", "Goodier", "straight") if d == 2 else ("shell",))
        for n in LEVELS[d, degree]
        for contrast in CONTRASTS
        if (shape, contrast) != ("Goodier", 1.0)
    ]


HEAD = ("cell", "k", "law", "u", "in", "GRAD u", "in")


def rows(found: Sequence[Excess]) -> list[list]:
    """The largest excess [%] by cell, degree and law, and where it is."""
    result = []
    for kind in dict.fromkeys((one.cell, one.degree, one.law) for one in found):
        mine = [one for one in found if (one.cell, one.degree, one.law) == kind]
        row: list = [*kind]
        for name in ("l2", "h1"):
            worst = max(mine, key=lambda one, name=name: getattr(one, name))
            row += [
                f"{100 * getattr(worst, name):.1f}",
                f"{worst.shape}, n = {worst.n}, E1/E2 = {worst.contrast:g}",
            ]
        result.append(row)
    return result
