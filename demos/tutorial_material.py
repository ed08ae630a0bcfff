"""Tutorial: your own material. Two layers of an artery, with collagen fibres, are peeled apart.

An energy W(F) in UFL is all a material needs: stress and moduli are derived from it. The energy is
checked by hand for a homogeneous deformation. Then two layers of this material, bonded to each
other, are peeled apart at very large strains and rotations, as in a dissection of the wall.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
import ufl
from ufl.core.expr import Expr

import vmdg
from vmdg.meshes import beams, blocks
from vmdg.meshes.beams import INTERFACE, LOWER_LEFT, RIGHT, UPPER_LEFT
from vmdg.plot import curve, stress

# 1. The energy, after Holzapfel, Gasser and Ogden (2000): a soft matrix, and two families of fibres
# in the plane of the layers, at angles +theta and -theta to x, which stiffen exponentially. F is
# always 3 x 3, also in plane strain. Parameters are passed as a dictionary: materials that differ
# only in their values share one compiled kernel. Energies must be smooth (three times
# differentiable): here fibres carry compression as well as tension.

PARAMETERS = {"c": 0.05, "lmbda": 0.5, "k1": 0.1, "k2": 3.0}  # MPa, MPa, MPa, -


def artery(F: Expr, p: Mapping[str, Expr]) -> Expr:
    """W [MPa] = c/2 (tr C - 3) - c ln J + lmbda/2 (J - 1)^2 + k1/k2 (exp(k2 E^2) - 1).

    E = a.C.a - 1 is the strain of the fibres, a = (cos theta, 0, sin theta); C_xz = 0 here.
    """
    C, J = F.T * F, ufl.det(F)
    E = p["cos"] ** 2 * C[0, 0] + p["sin"] ** 2 * C[2, 2] - 1
    matrix = p["c"] / 2 * (ufl.tr(C) - 3) - p["c"] * ufl.ln(J) + p["lmbda"] / 2 * (J - 1) ** 2
    return matrix + p["k1"] / p["k2"] * (ufl.exp(p["k2"] * E**2) - 1)


def layer(theta: float) -> vmdg.Material:
    """The material with its fibres at +-``theta`` [degrees]."""
    direction = {"cos": np.cos(np.radians(theta)), "sin": np.sin(np.radians(theta))}
    return vmdg.Hyperelastic(artery, PARAMETERS | direction)


# 2. The check. A block of two halves, tied by an interface, is stretched and sheared from all
# sides, so that F is the same everywhere. By hand, with F^-T the transposed inverse,
#
#     P = c (F - F^-T) + lmbda (J - 1) J F^-T
#         + 4 k1 E exp(k2 E^2) (cos^2 theta F.e_x e_x + sin^2 theta F.e_z e_z),
#
# and the traction of the interface, whose normal is e_x, must be P.e_x; the energy must be W.


def check(theta: float = 30.0) -> tuple[float, float]:
    """Relative errors of traction and energy."""
    mesh, cells, _ = blocks(MPI.COMM_WORLD, "quadrilateral", (2, 2))
    tie = vmdg.Interface(between=(1, 2), law=vmdg.Bonded())
    problem = vmdg.Problem(mesh, cells, {1: layer(theta), 2: layer(theta)}, [tie])
    H = np.array([[0.3, 0.2], [0.1, -0.1]])
    problem.dirichlet(lambda x: np.full(x.shape[1], True), lambda x, t: t * H @ x[:2])
    vmdg.solve(problem, [0.5, 1.0], vmdg.SolveOptions(relative_tolerance=1e-12))

    c, lmbda, k1, k2 = PARAMETERS.values()
    F = np.eye(3)
    F[:2, :2] += H
    C, J, inverse = F.T @ F, np.linalg.det(F), np.linalg.inv(F).T
    cos2, sin2 = np.cos(np.radians(theta)) ** 2, np.sin(np.radians(theta)) ** 2
    E = cos2 * C[0, 0] + sin2 - 1
    P = c * (F - inverse) + lmbda * (J - 1) * J * inverse
    P[:, 0] += 4 * k1 * E * np.exp(k2 * E**2) * cos2 * F[:, 0]
    W = c / 2 * (np.trace(C) - 3) - c * np.log(J) + lmbda / 2 * (J - 1) ** 2
    W += k1 / k2 * (np.exp(k2 * E**2) - 1)
    volume = 2.0  # two squares of 1 mm
    traction = np.abs(problem.mean(0).traction - P[:2, 0]).max() / np.abs(P[:2, 0]).max()
    return float(traction), abs(problem.energy().bulk / (volume * W) - 1)


# 3. Use it. The same energy describes strips cut along the vessel's circumference, whose fibres are
# closer to the direction of the strip, and along its axis. The toughness is 0.06 N/mm.


def peel(theta: float, steps: int, opening: float) -> tuple[vmdg.Problem, vmdg.History]:
    """Grip the ends of two layers of 0.5 mm and pull them ``opening`` [mm] apart."""
    mesh, cells, facets = beams(
        stations=(0, 3, 10), divisions=(15, 50), height=0.5, rows=3, precrack=3
    )
    bond = vmdg.Debonding(strength=0.1, critical_gap=1.2)
    interface = vmdg.Interface(facets.find(INTERFACE), law=bond)
    problem = vmdg.Problem(mesh, cells, {1: layer(theta), 2: layer(theta)}, [interface])
    upper = facets.find(UPPER_LEFT)
    problem.dirichlet(facets.find(RIGHT), 0.0)
    problem.dirichlet(upper, lambda t: t / 2, "y")
    problem.dirichlet(facets.find(LOWER_LEFT), lambda t: -t / 2, "y")

    def monitor(problem: vmdg.Problem) -> dict[str, float]:
        return {"opening [mm]": problem.t, "force [N]": problem.reaction(upper)[1]}

    loads = np.linspace(0, opening, steps + 1)[1:]
    options = vmdg.SolveOptions(progress=True)
    return problem, vmdg.solve(problem, loads, options, monitor).history


def main(steps: int = 60, out: str = "results/tutorial_material") -> dict[str, vmdg.History]:
    """Check the material, then peel strips of two directions; the history of both."""
    print("relative errors of traction and energy: {:.1e}, {:.1e}".format(*check()))
    shape = {"figsize": (9.5, 4.2), "width_ratios": (2, 2.4, 4), "layout": "constrained"}
    figure, axes = plt.subplots(1, 3, **shape)
    histories = {}
    for ax, (name, theta) in zip(axes, {"circumferential": 30, "axial": 60}.items(), strict=False):
        problem, histories[name] = peel(theta, steps, 12.0)
        stress(problem, "principal", ax=ax, limits=(0, 0.2), colorbar=ax is axes[1])
        ax.set(title=f"{name}\nfibres at {theta}°", xlim=(3.5, 10.2))
        curve(histories[name], "opening", "force", axes[2], origin=True, label=name)
    axes[2].legend()
    if MPI.COMM_WORLD.rank == 0:
        Path(out).mkdir(parents=True, exist_ok=True)
        figure.savefig(Path(out) / "tutorial_material.png")
        print(f"results are in {out}")
    return histories


if __name__ == "__main__":
    command = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.ArgumentDefaultsHelpFormatter
    )
    command.add_argument("--steps", type=int, default=60, help="load steps")
    command.add_argument("--out", default="results/tutorial_material", help="results folder")
    main(**vars(command.parse_args()))
