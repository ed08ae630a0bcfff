"""Mixed-mode bending by linear fracture mechanics as published: the crack is closed virtually.

Two arms of rectangles with incompatible modes, in numpy and without vmdg: what the published
critical points owe to their mesh.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from parts.delamination.laminate import MMB, Laminate
from parts.delamination.mmb import A_0, CRITICAL, LEVERS, L
from parts.tables import markdown

Array = NDArray[np.float64]

#: Gauss point, and corners of a cell.
GAUSS = 1 / math.sqrt(3)
CORNERS = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])


class Flexibility(NamedTuple):
    """Of the specimen at one crack length, for a unit load of each mode.

    Attributes:
        opening, shear: Displacement of the loads [mm/N].
        G_I, G_II: Energy release rates [N/mm per N2].
    """

    opening: float
    shear: float
    G_I: float
    G_II: float

    def critical(self, c: float, m: Laminate) -> tuple[float, float, float]:
        """Load [N], deflection [mm] and G_II/G_T at which a lever lets the crack grow.

        The lever's load P opens the arms by P (3c - L)/(4 L) and bends them by P (c + L)/L.
        """
        opened, bent = (3 * c - L) / (4 * L), (c + L) / L
        G_I, G_II = self.G_I * opened**2, self.G_II * bent**2
        ratio = G_II / (G_I + G_II)
        P = math.sqrt(m.toughness(ratio) / (G_I + G_II))
        return P, P * (self.opening * opened**2 + self.shear * bent**2), ratio


def moduli(m: Laminate) -> Array:
    """Stress over (eps_xx, eps_yy, 2 eps_xy) in plane strain [MPa]."""
    a, b, c = 1 / m.E1, -m.nu12 / m.E1, 1 / m.E2
    d = -m.nu23 / m.E2
    normal = np.linalg.inv([[a, b, b], [b, c, d], [b, d, c]])
    D = np.zeros((3, 3))
    D[:2, :2], D[2, 2] = normal[:2, :2], m.G12
    return D


def stiffness(dx: float, dy: float, D: Array) -> Array:
    """A rectangle of four nodes, unit width, its incompatible modes 1 - r^2 and 1 - s^2 condensed
    (Wilson et al. 1973; C3D8I and CPE4I of Abaqus are of this kind)."""
    K = np.zeros((12, 12))
    for r, s in GAUSS * CORNERS:
        x = np.append(CORNERS[:, 0] * (1 + CORNERS[:, 1] * s) / 4, [-2 * r, 0]) * 2 / dx
        y = np.append(CORNERS[:, 1] * (1 + CORNERS[:, 0] * r) / 4, [0, -2 * s]) * 2 / dy
        B = np.zeros((3, 12))
        B[0, ::2], B[1, 1::2], B[2, ::2], B[2, 1::2] = x, y, y, x
        K += dx * dy / 4 * B.T @ D @ B
    return K[:8, :8] - K[:8, 8:] @ np.linalg.solve(K[8:, 8:], K[8:, :8])


def dofs_of(corners: Array) -> Array:
    """Dofs of cells (n, 8) by the nodes at their corners (..., 4)."""
    return (2 * corners[..., None] + [0, 1]).reshape(-1, 8)


def assembled(dofs: Array, cells: Array, n: int) -> csc_array:
    """Stiffness of a body of n dofs by those of its cells (..., 8, 8), in the order of `dofs`."""
    pairs = np.repeat(dofs, 8), np.tile(dofs, 8).ravel()
    return coo_array((np.ravel(cells), pairs), (n, n)).tocsc()


def planes(size: float, tip: float) -> Array:
    """x of the cells [mm], ``tip`` long within 5 mm of the tip and ``size`` elsewhere."""
    x = np.zeros(1)
    for end, length in ((A_0 - 5, size), (A_0 + 5, tip), (L, size), (2 * L, size)):
        x = np.append(x, np.linspace(x[-1], end, math.ceil((end - x[-1]) / length) + 1)[1:])
    return x


def flexibility(rows: int, size: float = 1.0, tip: float = 0.25, m: Laminate = MMB) -> Flexibility:
    """Solve for opening and shear, and close the crack virtually (Rybicki and Kanninen 1977).

    Loads that open are at the ends of both arms, loads that bend at midspan and as two halves at
    the end; supports are at the lower face.

    Args:
        rows: Cells over an arm.
        size, tip: Of the cells along x [mm].
        m: The laminate.
    """
    x = planes(size, tip)
    crack = int(np.argmin(abs(x - A_0)))
    nodes = np.arange(len(x) * (2 * rows + 1)).reshape(len(x), -1)
    upper = nodes[:, rows].copy()
    upper[:crack] = nodes.size + np.arange(crack)
    D, dx = moduli(m), np.diff(x)
    cells = [m.b * stiffness(length, m.h / rows, D) for length in dx]
    dofs, values = [], []
    for row in range(2 * rows):
        low = upper if row == rows else nodes[:, row]
        around = np.stack([low[:-1], low[1:], nodes[1:, row + 1], nodes[:-1, row + 1]], 1)
        dofs.append(dofs_of(around))
        values.append(cells)
    n = 2 * (nodes.size + crack)
    K = assembled(np.concatenate(dofs), values, n)

    middle = int(np.argmin(abs(x - L)))
    end, load, far = 2 * nodes[0, -1] + 1, 2 * nodes[middle, -1] + 1, 2 * nodes[-1, 0]
    free = np.setdiff1d(np.arange(n), [2 * nodes[0, 0] + 1, far, far + 1])
    forces = np.zeros((n, 2))
    forces[end] = 1.0, 0.25
    forces[load, 1] = -1.0
    u = np.zeros((n, 2))
    u[free] = splu(K[free][:, free]).solve(forces[free])

    # Force of the cells above the tip, and opening of the crack one cell behind it.
    behind, ahead = dofs[rows][crack - 1], dofs[rows][crack]
    force = (cells[crack - 1] @ u[behind])[2:4] + (cells[crack] @ u[ahead])[:2]
    jump = u[2 * upper[crack - 1] :][:2] - u[2 * nodes[crack - 1, rows] :][:2]
    shear, opening = np.abs(force * jump) / (2 * m.b * dx[crack])
    return Flexibility(u[end, 0], u[end, 1] / 4 - u[load, 1], opening[0], shear[1])


def study(m: Laminate = MMB) -> str:
    """Critical points of all levers over the mesh, against those published."""
    meshes = {
        "two, 0.25": (2, 1.0, 0.25),
        "three, 0.25": (3, 1.0, 0.25),
        "six, 0.25": (6, 1.0, 0.25),
        "twelve, 0.0625": (12, 0.5, 0.0625),
        "24, 0.03125": (24, 0.25, 0.03125),
    }
    rows = []
    for name, mesh in meshes.items():
        found = flexibility(*mesh, m)
        row: list[str] = [name]
        for ratio, (deflection, load) in CRITICAL.items():
            P, w, _ = found.critical(LEVERS[ratio], m)
            row += [f"{P:.1f} ({100 * (P / load - 1):+.1f} %)"]
            row += [f"{w:.3f} ({100 * (w / deflection - 1):+.1f} %)"]
        rows.append(row)
    heads = [f"{ratio:g}: {what}" for ratio in CRITICAL for what in ("P [N]", "w [mm]")]
    published = [f"{value:g}" for w, P in CRITICAL.values() for value in (P, w)]
    return markdown(["cells over an arm, at the tip", *heads], [["published", *published], *rows])
