"""Cook's membrane of steel, with an interface across its middle."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
from dolfinx import fem

import vmdg
from parts.plasticity.rows import STEEL, Row
from parts.verification.checks import describe
from vmdg.base.parallel import global_sum
from vmdg.meshes import blocks
from vmdg.meshes.two_blocks import LEFT, RIGHT

#: Width, height at the clamped side, height at the loaded side [mm], shear on the latter [MPa].
WIDTH, CLAMPED, LOADED, SHEAR = 48.0, 44.0, 16.0, 312.5
#: Displacement of the upper right corner along x and y [mm]: test ssnp179a of code_aster, mixed
#: elements with Hencky strains (its document V6.03.179), and the values that it is to meet within
#: 2 %. By finite volumes the rise is 7.4 mm (solids4foam, tutorial cooksMembrane).
CODE_ASTER, ITS_REFERENCE, SOLIDS4FOAM = (-6.1790, 6.9302), (-6.2391, 7.0003), 7.4


def membrane(cells: int, tied: bool, steps: int = 10) -> tuple[np.ndarray, str]:
    """Displacement of the upper right corner [mm], and the mesh, under a dead load.

    Args:
        cells: Along both directions.
        tied: Whether the membrane is two bodies tied half way, else one.
        steps: Equal steps of the load.
    """
    middle = WIDTH / 2
    mesh, tags, facets = blocks(
        MPI.COMM_WORLD, "quadrilateral", (cells // 2, cells), WIDTH, 1.0, interface=(middle,) * 2
    )
    x = mesh.geometry.x
    share = x[:, 0] / WIDTH
    x[:, 1] = CLAMPED * share + x[:, 1] * (CLAMPED + (LOADED - CLAMPED) * share)
    interfaces = [vmdg.Interface(between=(1, 2), law=vmdg.Bonded())] if tied else []
    problem = vmdg.Problem(mesh, tags, {1: STEEL, 2: STEEL}, interfaces, degree=2)
    problem.dirichlet(facets.find(LEFT), 0.0)
    problem.traction(facets.find(RIGHT), lambda t: (0.0, SHEAR * t))
    vmdg.solve(problem, steps)

    def corner(x: np.ndarray) -> np.ndarray:
        return np.isclose(x[0], WIDTH) & np.isclose(x[1], CLAMPED + LOADED)

    nodes = fem.locate_dofs_geometrical(problem.space, corner)
    own = nodes[nodes < problem.space.dofmap.index_map.size_local]
    found = problem.u.x.array.reshape(-1, 2)[own].sum(axis=0)
    return global_sum(problem.comm, found), describe(problem, 2)


def cook(coarse: bool = False) -> list[Row]:
    """The corner against code_aster, and against one body on the same mesh."""
    cells = 8 if coarse else 32
    found, mesh = membrane(cells, True)
    plain, _ = membrane(cells, False)
    references = {
        "one body, same mesh": plain,
        "code_aster ssnp179a": CODE_ASTER,
        "its reference": ITS_REFERENCE,
    }
    rows = [
        Row("Cook's membrane", f"displacement {axis} [mm]", ours, theirs[i], source, mesh)
        for source, theirs in references.items()
        for i, (axis, ours) in enumerate(zip("xy", found, strict=True))
    ]
    rise = "displacement y [mm]"
    return [*rows, Row("Cook's membrane", rise, found[1], SOLIDS4FOAM, "solids4foam", mesh)]
