"""Errors and rates of the tied interface against the exact solutions of ``manufactured``."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import astuple, dataclass, fields
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

from mpi4py import MPI

import basix
import matplotlib.pyplot as plt
import numpy as np
import scipy.spatial
import ufl
from dolfinx import fem
from dolfinx.mesh import Mesh
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from parts.benchmark.common import DIMENSION
from parts.convergence.manufactured import Exact, bent, body_force, kinked, sheared, stress
from parts.tables import markdown
from parts.topology import facet_cells, global_sum, tags_of_cells
from ufl.core.expr import Expr

import vmdg
from vmdg import compat
from vmdg.base.kernels import compile_expression, compile_form
from vmdg.meshes import TaggedMesh, blocks

SOLUTIONS: dict[str, Callable[..., Exact]] = {"sheared": sheared, "bent": bent, "kinked": kinked}
SHAPES = ("straight", "inclined", "curved")
NORMS = ("l2", "h1", "traction")
TOP = 5

#: Errors below are rounding.
ROUND_OFF = 1e-11

#: Of the cells' size: how far distortion moves a node at most.
DISTORTION = {"triangle": 0.15, "quadrilateral": 0.2, "tetrahedron": 0.1, "hexahedron": 0.15}


@dataclass(frozen=True)
class Study:
    """One row of the table: a family of meshes, an exact solution and two materials."""

    cell: str  # "triangle", "quadrilateral", "tetrahedron" or "hexahedron"
    degree: int  # k of the displacement
    shape: str = "straight"  # Of the interface: "straight", "inclined" or "curved"
    solution: str = "kinked"  # "sheared", "bent" or "kinked"
    contrast: float = 1.0  # E_1/E_2
    distorted: bool = False  # Nodes moved at random, along the interface too
    levels: tuple[int, ...] = (4, 8)  # Cells along each mm, refined from one to the next
    straight_cells: bool = False  # Leave the cells' sides straight along a curved interface

    @property
    def loaded(self) -> bool:
        """Whether the top carries the exact tractions; all other sides are prescribed.

        Only for (ii). Where a loaded side meets a prescribed one, solutions of the dual problem are
        singular and the rate in L2 falls to about k + 0.7 on fine meshes, whatever the interface
        does; and (i) is unstable under dead tractions there (its tangent is indefinite).
        """
        return self.solution == "bent"

    @property
    def materials(self) -> tuple[vmdg.NeoHookean, vmdg.NeoHookean]:
        """Body 1 is the stiff one."""
        return tuple(vmdg.NeoHookean(E=E, nu=0.3) for E in (1e3 * self.contrast, 1e3))

    def position(self, y: Expr | NDArray, z: Expr | NDArray | None = None, m=np):
        """x - 1 of the interface at height y and depth z [mm]; ``m`` is numpy or ufl."""
        if self.shape == "straight":
            return 0 * y
        if self.shape == "inclined":
            return 0.4 * (y - 0.5)
        return 0.15 * m.sin(2 * y if z is None else 2 * y + z)

    def level(self, mesh: Mesh) -> Expr:
        """Zero on the interface, positive in body 2."""
        x, *rest = ufl.SpatialCoordinate(mesh)
        return x - 1 - self.position(*rest, m=ufl)

    def mesh(self, n: int, comm: MPI.Comm = MPI.COMM_WORLD) -> TaggedMesh:
        """Two blocks of 1 mm with n cells along each; curved cells have order k."""
        curved = self.shape == "curved" and not self.straight_cells
        tagged = blocks(comm, self.cell, (n, n, n), order=self.degree if curved else 1)
        if self.distorted:
            _distort(tagged.mesh, n, DISTORTION[self.cell])
        x = tagged.mesh.geometry.x
        z = x[:, 2] if DIMENSION[self.cell] == 3 else None
        x[:, 0] += (1 - abs(x[:, 0] - 1)) * self.position(x[:, 1], z)
        return tagged


def _distort(mesh: Mesh, n: int, amplitude: float) -> None:
    """Move the vertices of a grid of size 1/n at random, within the planes that bound the blocks.

    The same vertex moves the same way in every partition; other nodes stay affine.
    """
    d, x = mesh.geometry.dim, mesh.geometry.x
    grid = n * x[:, :d]
    scatter = np.sin(np.round(grid) @ np.array([12.9898, 78.233, 37.719])[:d]) * 43758.5453
    inside = ~np.isclose(x[:, :d], np.round(x[:, :d]))
    # Digits of one random number serve for the directions.
    move = np.column_stack([scatter * 100.0**i for i in range(d)]) % 1
    moved = x[:, :d] + amplitude / n * (2 * move - 1) * inside
    element = compat.coordinate_element(mesh)
    cell = mesh.basix_cell()
    lagrange = (basix.ElementFamily.P, cell)
    variant = basix.LagrangeVariant(element.variant)
    nodes = basix.create_element(*lagrange, element.degree, variant).points
    affine = basix.create_element(*lagrange, 1).tabulate(0, nodes)[0, :, :, 0]
    cells = compat.geometry_dofmap(mesh)
    x[cells, :d] = np.einsum("nv,cvd->cnd", affine, moved[cells[:, : affine.shape[1]]])


@dataclass(frozen=True)
class Errors:
    """Relative errors on one mesh."""

    h: float  # 1/n [mm]
    l2: float  # Of u in L2
    h1: float  # Of GRAD u in L2
    traction: float  # Of T in L2 of the interface
    dofs: int  # Of the displacement
    seconds: float  # For mesh, kernels and solution


@dataclass(frozen=True)
class Tied:
    """A study on one mesh, at the interpolated exact solution."""

    problem: vmdg.Problem  # The problem
    tagged: TaggedMesh  # Its mesh
    exact: Exact  # The solution
    forces: dict[int, Expr]  # Body force of every tag (d,) [N/mm3]
    sides: NDArray[np.int32]  # Facets where the displacement is prescribed


def tied(study: Study, n: int, comm: MPI.Comm = MPI.COMM_WORLD) -> Tied:
    """The problem with n cells along each mm.

    Newton is to start from the interpolated exact solution, so that it finds this one of the
    solutions of the nonlinear problem and tau_s belongs to its state.
    """
    tagged = study.mesh(n, comm)
    mesh, materials = tagged.mesh, study.materials
    exact = SOLUTIONS[study.solution](mesh, materials, study.level(mesh))
    interface = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(
        mesh, tagged.cell_tags, {1: materials[0], 2: materials[1]}, [interface], study.degree
    )
    tags = tags_of_cells(mesh, tagged.cell_tags)
    top = tagged.facet_tags.find(TOP)
    top_tags = tags[facet_cells(mesh)[top, 0]]
    forces = {}
    for tag, (material, u) in enumerate(zip(materials, exact.u, strict=True), start=1):
        forces[tag] = body_force(material, u)
        problem.body_force(forces[tag], tag)
        if study.loaded:
            traction = ufl.dot(stress(material, u), ufl.FacetNormal(mesh))
            problem.traction(top[top_tags == tag], traction)
    interpolate(problem.u, tagged, exact)
    prescribed_sides = (1, 2, 4, 6, 7) if study.loaded else (1, 2, 4, TOP, 6, 7)
    sides = np.concatenate([tagged.facet_tags.find(i) for i in prescribed_sides])
    dofs = fem.locate_dofs_topological(problem.space, mesh.topology.dim - 1, sides)
    prescribed = problem.u.x.array.reshape(-1, mesh.geometry.dim)[dofs].T.copy()
    problem.dirichlet(sides, lambda x, t: prescribed)
    return Tied(problem, tagged, exact, forces, sides)


def interpolate(u: fem.Function, tagged: TaggedMesh, exact: Exact) -> None:
    """Give ``u`` the exact displacement at its nodes."""
    points = compat.interpolation_points(u.function_space)
    tags = tags_of_cells(tagged.mesh, tagged.cell_tags)
    for tag, part in enumerate(exact.u, start=1):
        cells = np.flatnonzero(tags == tag).astype(np.int32)
        u.interpolate(compile_expression(part, points, tagged.mesh.comm), cells)
    u.x.scatter_forward()


def errors(study: Study, n: int, comm: MPI.Comm = MPI.COMM_WORLD) -> Errors:
    """Solve with n cells along each mm and compare."""
    start = perf_counter()
    model = tied(study, n, comm)
    problem = model.problem
    vmdg.solve(problem, [1.0], vmdg.SolveOptions(relative_tolerance=1e-11))
    size = problem.space.dofmap.index_map.size_global * problem.mesh.geometry.dim
    elapsed = perf_counter() - start
    return Errors(
        1 / n,
        *field_errors(problem.u, model.tagged, model.exact),
        _traction_error(problem, model.exact),
        size,
        elapsed,
    )


def field_errors(u_h: fem.Function, tagged: TaggedMesh, exact: Exact) -> tuple[float, float]:
    """Relative errors of u and GRAD u in L2 of the bodies."""
    mesh = tagged.mesh
    degree = 2 * u_h.function_space.ufl_element().degree + 3
    dx = ufl.dx(
        domain=mesh, subdomain_data=tagged.cell_tags, metadata={"quadrature_degree": degree}
    )

    def norm(part: Callable[[Expr], Expr]) -> float:
        form = sum(ufl.inner(part(u), part(u)) * dx(tag) for tag, u in enumerate(exact.u, start=1))
        gap = sum(
            ufl.inner(part(u) - part(u_h), part(u) - part(u_h)) * dx(tag)
            for tag, u in enumerate(exact.u, start=1)
        )
        squares = [fem.assemble_scalar(compile_form(f, mesh.comm)) for f in (gap, form)]
        error, size = global_sum(mesh.comm, squares)
        return float(np.sqrt(error / size))

    return norm(lambda v: v), norm(ufl.grad)


def _at_points(quadrature: Any, expression: Expr) -> NDArray[np.float64]:
    """A vector of side 1, of x and N, at the points of an interface (nq, d)."""
    mesh, facets = quadrature.mesh, quadrature.facets
    d, points = mesh.geometry.dim, quadrature.points
    kind = basix.cell.subentity_types(mesh.basix_cell())[d - 1][0]
    rule = basix.make_quadrature(kind, quadrature.degree)[0]
    rows = np.column_stack([facets.cells[:, 0], facets.local[:, 0]])
    position, value = (
        compat.evaluate(compile_expression(e, rule, mesh.comm), mesh, rows).reshape(-1, d)
        for e in (ufl.SpatialCoordinate(mesh), expression)
    )
    nearest = scipy.spatial.cKDTree(position).query(points[:, :d])[1]
    return value[nearest]


def _traction_error(problem: vmdg.Problem, exact: Exact) -> float:
    """Relative error of T in L2 of the interface."""
    mesh, state = problem.mesh, problem.state[0]
    quadrature = problem.discretization.active[0].quadrature
    traction = _at_points(quadrature, exact.traction)
    gaps = ((state.traction - traction) ** 2).sum(axis=1)
    squares = [state.weights @ gaps, state.weights @ (traction**2).sum(axis=1)]
    error, size = global_sum(mesh.comm, squares)
    return float(np.sqrt(error / size))


@dataclass(frozen=True)
class Row:
    """Errors of one study on its meshes."""

    study: Study
    levels: list[Errors]

    @property
    def rates(self) -> dict[str, float]:
        """Least-squares slope of log(error) against log(h), by norm.

        Without the coarsest of three or more meshes; infinite where the finest mesh is exact to
        round-off (quadrilaterals hold (i)).
        """
        used = self.levels[len(self.levels) > 2 :]
        h = np.log([level.h for level in used])
        values = {m: [getattr(level, m) for level in used] for m in NORMS}
        return {
            m: float(np.polyfit(h, np.log(v), 1)[0]) if v[-1] > ROUND_OFF else np.inf
            for m, v in values.items()
        }


def targets(degree: int) -> dict[str, float]:
    """Least rates: k + 0.9 of u in L2, k - 0.1 of its gradient and of the interface traction."""
    return {"l2": degree + 0.9, "h1": degree - 0.1, "traction": degree - 0.1}


#: Meshes of the full table, by dimension and degree.
LEVELS = {
    (2, 1): (8, 16, 32, 64),
    (2, 2): (4, 8, 16, 32),
    (2, 3): (4, 8, 16, 32, 64),
    (3, 1): (5, 10, 20),
    (3, 2): (3, 6, 10),
}

#: Tetrahedra of degree 2 along a curve: between 6 and 10 cells a mm their tractions converge with
#: 1.82 to 1.87, from there on with 1.93 and more.
CURVED_TETRAHEDRA = (6, 10, 14)


def full_studies() -> list[Study]:
    """All combinations: cells, degrees, interfaces, solutions, contrasts, distortion."""
    result = []
    for (d, k), levels in LEVELS.items():
        smooth = [("sheared", 1.0), ("bent", 1.0)] if d == 2 else []
        solutions = [*smooth, *(("kinked", contrast) for contrast in (1.0, 10.0, 1e4))]
        cells = [cell for cell, dimension in DIMENSION.items() if dimension == d]
        for c, s, (f, e), x in product(cells, SHAPES, solutions, (False, True)):
            late = (c, k, s) == ("tetrahedron", 2, "curved")
            result.append(Study(c, k, s, f, e, x, CURVED_TETRAHEDRA if late else levels))
    return result


def coarse_studies() -> list[Study]:
    """A few hard ones: every cell, mostly curved, distorted and of high contrast."""
    hard = ("kinked", 1e4, True)
    return [
        Study("triangle", 1, "inclined", "sheared", 1.0, False, (16, 32)),
        Study("triangle", 2, "curved", *hard, (12, 24)),
        Study("triangle", 3, "inclined", *hard, (8, 16)),
        Study("quadrilateral", 2, "straight", "bent", 1.0, True, (8, 16)),
        Study("quadrilateral", 2, "curved", *hard, (8, 16, 32)),
        Study("tetrahedron", 1, "inclined", *hard, (4, 8)),
        Study("hexahedron", 2, "curved", *hard, (3, 5)),
    ]


def table(rows: Sequence[Row]) -> str:
    """All rows as a Markdown table: errors on the finest mesh, and rates."""
    head = ["cell", "k", "interface", "solution", "E1/E2", "mesh", "cells/mm", "dofs"]
    head += ["u error", "rate", "GRAD u error", "rate", "T error", "rate", "s"]
    lines = []
    for row in rows:
        s, fine, rates = row.study, row.levels[-1], row.rates
        mesh = "distorted" if s.distorted else "regular"
        names = [s.cell, s.degree, s.shape, s.solution, f"{s.contrast:g}", mesh]
        sizes = [f"{s.levels[0]}-{s.levels[-1]}", fine.dofs]
        values = [v for m in NORMS for v in (f"{getattr(fine, m):.2e}", f"{rates[m]:.2f}")]
        lines.append([*names, *sizes, *values, f"{sum(e.seconds for e in row.levels):.1f}"])
    return markdown(head, lines)


def summary(rows: Sequence[Row]) -> str:
    """Least rates by cell and degree as a Markdown table."""
    head = ["cell", "k", "studies", "u in L2", "GRAD u", "traction", "targets", "below target"]
    lines = []
    for cell, degree in dict.fromkeys((row.study.cell, row.study.degree) for row in rows):
        mine = [r for r in rows if (r.study.cell, r.study.degree) == (cell, degree)]
        least = [f"{min(row.rates[m] for row in mine):.2f}" for m in NORMS]
        goal = targets(degree)
        missed = sum(any(row.rates[m] < goal[m] for m in NORMS) for row in mine)
        aims = " / ".join(f"{goal[m]:.1f}" for m in NORMS)
        lines.append([cell, degree, len(mine), *least, aims, missed])
    return markdown(head, lines)


def write_csv(rows: Sequence[Row], path: Path) -> None:
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        names = [field.name for field in fields(Study) if field.name != "levels"]
        writer.writerow([*names, *(field.name for field in fields(Errors))])
        for row in rows:
            for level in row.levels:
                writer.writerow([*(getattr(row.study, n) for n in names), *astuple(level)])


def draw(rows: Sequence[Row]) -> Figure:
    """Errors against h for the hardest studies: curved, distorted, largest contrast."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 4.2), layout="constrained", sharex=True)
    titles = ("u, L2", "GRAD u, L2", "interface traction, L2")
    hardest = [r for r in rows if r.study.shape == "curved" and r.study.distorted]
    top = max(row.study.contrast for row in hardest)
    hardest = [row for row in hardest if row.study.contrast == top]
    markers = dict(zip(DIMENSION, "^so*", strict=True))
    colours = {1: "C0", 2: "C1", 3: "C2"}
    for ax, norm, title in zip(axes, NORMS, titles, strict=True):
        for row in hardest:
            s = row.study
            h, values = ([getattr(e, name) for e in row.levels] for name in ("h", norm))
            style = {"marker": markers[s.cell], "color": colours[s.degree], "mfc": "none"}
            ax.loglog(h, values, lw=1, **style)
        for degree in sorted({row.study.degree for row in hardest}):
            _slope(ax, [r for r in hardest if r.study.degree == degree], norm, colours[degree])
        ax.margins(x=0.12)
        ax.set(title=title, xlabel="h [mm]")
        ax.grid(which="both", lw=0.3)
    axes[0].set_ylabel("relative error")
    kinds = [
        Line2D([], [], color="gray", mfc="none", marker=m, label=c) for c, m in markers.items()
    ]
    kinds += [Line2D([], [], color=c, label=f"degree {k}") for k, c in colours.items()]
    axes[-1].legend(handles=kinds, loc="lower right")
    figure.suptitle(f"Curved interface, distorted cells, moduli 1 : {top:g}")
    return figure


def _slope(ax: Axes, rows: Sequence[Row], norm: str, colour: str) -> None:
    """A dashed line of the slope that theory promises, below the errors of one degree."""
    degree = rows[0].study.degree
    slope = degree + 1 if norm == "l2" else degree
    ends = np.array([max(r.levels[0].h for r in rows), min(r.levels[-1].h for r in rows)])
    lowest = min(getattr(e, norm) / e.h**slope for row in rows for e in row.levels)
    line = 0.6 * lowest * ends**slope
    ax.loglog(ends, line, "--", color=colour, lw=1)
    ax.annotate(f"$h^{slope}$", (ends[1], line[1]), color=colour, ha="right", va="top")
