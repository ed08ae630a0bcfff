"""The fibre push-out over a parameter: Figures 30 and 31 of the report, and meshes and steps.

Runs the example ``pushout`` with several moduli or coefficients of friction, with several meshes or
numbers of steps, or once with the values of the report, and makes a table and a picture of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from mpi4py import MPI

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from parts.options import run
from parts.scenes import pushout
from parts.tables import markdown
from parts.verification.checks import Check, compare, describe

import vmdg
from vmdg.meshes import pushout_section

E_FIBRE = 2500.0  # MPa


def _slide(
    height: float, layers: int, friction: float, punch: float, verbose: bool
) -> tuple[vmdg.Problem, float]:
    """Shrink the matrix of section 7.4 onto a fibre, then push: the end and its force [N]."""
    mesh, cells, facets = pushout_section(MPI.COMM_WORLD, layers, 6, 1, 10, height)
    materials = {
        "fibre": vmdg.NeoHookean(E=E_FIBRE, nu=NU_FIBRE),
        "matrix": vmdg.NeoHookean(E=E_MATRIX, nu=NU_MATRIX),
    }
    problem = vmdg.Problem(
        mesh,
        cells,
        materials,
        [vmdg.Interface(between=("fibre", "matrix"), law=vmdg.Contact(friction))],
        eigenstrain={"matrix": lambda t: -SHRINKAGE * min(t, 1.0)},
        symmetry="axisymmetric",
    )
    top = facets.find("fibre top")
    problem.dirichlet(facets.find("support"), 0.0, "y")
    problem.dirichlet(top, lambda t: min(1 - t, 0.0), "y")
    loads = np.r_[np.linspace(0.25, 1, 4), 1 + np.linspace(0, punch, 11)[1:]]
    vmdg.solve(problem, loads, vmdg.SolveOptions(relative_tolerance=1e-8, verbose=verbose))
    return problem, -problem.reaction(top)[1]


def _growth(problem: vmdg.Problem, state: vmdg.InterfaceState, height: float) -> float:
    """lambda [1/mm] of shear tractions e^(lambda z) in the middle half of the fibre."""
    inside = np.abs(state.points[:, 1] / height - 0.5) < 0.25
    rows = np.column_stack([state.points[inside, 1], np.abs(state.traction[inside, 1])])
    z, shear = np.concatenate(problem.comm.allgather(rows)).T
    return float(np.polyfit(z, np.log(shear), 1)[0])


def push_out(
    layers: int = 80, height: float = 20.0, friction: float = 0.1, verbose: bool = False
) -> list[Check]:
    """A fibre of 21 radii, and that of section 7.4 with 5.6, once they slide.

    The estimate takes the fibre for a bar in plane rings: the pressure p = p0 + k sigma grows with
    the stress sigma in the fibre, a sigma' = 2 mu p, so that both grow as e^(lambda z) with lambda
    = 2 mu k/a, and the force is :func:`shear_lag` without a bond. It holds where z
    is farther than a radius or two from both ends; there the rings are not plane, the pressure
    differs and a share of the order of a/H of the force is in doubt. It also neglects that the
    matrix carries the force back: its stress is that of the fibre times a^2/(b^2 - a^2) = 0.05.
    """
    slender, force = _slide(height, layers, friction, 0.15, verbose)
    mesh = describe(slender, 1)
    case = f"push-out, H = {height / RADIUS:.1f} a"
    _, k = ring_pressure(E_FIBRE)
    growth = _growth(slender, slender.state[0], height)
    checks = [
        compare(case, "friction force [N]", force, shear_lag(height, friction, E_FIBRE, 0.0), mesh),
        compare(case, "lambda, middle half [1/mm]", growth, 2 * friction * k / RADIUS, mesh),
    ]
    short, force = _slide(HEIGHT, round(layers * 0.4), pushout.FRICTION, 0.1, verbose)
    estimate = shear_lag(HEIGHT, pushout.FRICTION, E_FIBRE, 0.0)
    case, mesh = f"push-out, H = {HEIGHT / RADIUS:.1f} a", describe(short, 1)
    return [*checks, compare(case, "friction force [N]", force, estimate, mesh)]


RADIUS, HEIGHT, SHRINKAGE = pushout.RADIUS, pushout.HEIGHT, pushout.SHRINKAGE
E_MATRIX, NU_MATRIX, NU_FIBRE = pushout.E_MATRIX, pushout.NU_MATRIX, pushout.NU_FIBRE
OUTER_RADIUS = 4.3  # of the matrix, mm
# Figures 30 and 31, and the influence of mesh and steps: argument, label, values.
STUDIES = {
    "modulus": ("fibre_modulus", "E_f / E_m = {:g}", (0.625, 2.5, 6.0)),
    "friction": ("friction", "mu = {:g}", (0.3, 0.525, 0.6)),
    "mesh": ("refine", "cells x {:g}", (0.5, 1.0, 2.0, 4.0)),
    "steps": ("steps", "{:d} steps", (50, 100, 200, 400)),
    "report": ("friction", "mu = {:g}", (0.525,)),
}


def ring_pressure(fibre_modulus: float) -> tuple[float, float]:
    """p0 [MPa] and k [-]: p = p0 + k sigma on a fibre with stress sigma (Lame, plane stress)."""
    a2, b2 = RADIUS**2, OUTER_RADIUS**2
    compliance = ((b2 + a2) / (b2 - a2) + NU_MATRIX) / E_MATRIX + (1 - NU_FIBRE) / fibre_modulus
    return SHRINKAGE / compliance, NU_FIBRE / fibre_modulus / compliance


def shear_lag(
    length: NDArray | float,
    friction: float,
    fibre_modulus: float,
    energy: float = pushout.STRENGTH * pushout.CRITICAL_GAP / 2,
) -> NDArray | float:
    """Force [N] at which the bond is gone over ``length`` [mm] from the loaded end.

    F = pi a^2 [sigma_d e^(lambda l) + p0/k (e^(lambda l) - 1)], the one-dimensional estimate of
    Alfano and Sacco and of Lin, Geubelle and Sottos: p0 the pressure after the cure, k the rise of
    the pressure with the stress in the fibre, sigma_d = 2 sqrt(E_f G / a) with G the work of the
    bond [N/mm], 0 for friction alone. Near its ends the fibre is no bar: lengths differ by up to
    1.5 a.
    """
    p0, k = ring_pressure(fibre_modulus)
    sigma = 2 * np.sqrt(fibre_modulus * energy / RADIUS)
    grown = np.exp(2 * friction * k / RADIUS * length)
    return np.pi * RADIUS**2 * (sigma * grown + p0 / k * (grown - 1))


def curves(runs: dict[str, vmdg.History], friction: float, fibre_modulus: float) -> Figure:
    """Force and debonded length over the punch, and the force over the debonded length."""
    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout="constrained")
    for label, history in runs.items():
        punch, force, length = (history[name] for name in ("punch", "force", "debonded"))
        label = label.replace("mu", "μ").replace(" x ", " × ")
        axes[0].plot(np.r_[0, punch], np.r_[0, force], label=label)
        axes[1].plot(np.r_[0, punch], np.r_[0, length], label=label)
        axes[2].plot(length, force, label="bond gone" if len(runs) == 1 else label)
    axes[0].set(xlabel="punch [mm]", ylabel="force [N]", xlim=0, ylim=0)
    axes[1].set(xlabel="punch [mm]", ylabel="debonded length [mm]", xlim=0)
    axes[1].set_ylim(0, 1.05 * HEIGHT)
    axes[2].set(xlabel="debonded length [mm]", ylabel="force [N]", xlim=(0, HEIGHT), ylim=0)
    if len(runs) == 1:
        history = next(iter(runs.values()))
        axes[2].plot(history["damaged"], history["force"], "--", label="bond damaged")
        length = np.linspace(0, HEIGHT, 100)
        force = shear_lag(length, friction, fibre_modulus)
        shift = 1.5 * RADIUS
        band = {"color": "black", "alpha": 0.15, "label": r"shear lag $\pm$ 1.5 a"}
        axes[2].fill_betweenx(force, length - shift, length + shift, **band)
        axes[2].legend()
    else:
        axes[0].legend()
    return figure


def _force_at_first(history: vmdg.History, name: str) -> float:
    """Force [N] in the first step at which a column is above zero, NaN if in none."""
    reached = history[name] > 0
    return history["force"][np.argmax(reached)] if reached.any() else np.nan


def section_7_4(runs: dict[str, vmdg.History], name: str = "run") -> str:
    """Table of the numbers of section 7.4, one row per run.

    Args:
        name: Name of what differs between runs.
    """
    head = [
        *(name, "slope [N/mm]", "first damage [N]", "bond first gone [N]", "largest [N]"),
        *("debonded at the largest [mm]", "end [N]"),
    ]
    rows = []
    for label, history in runs.items():
        punch, force, gone = (history[name] for name in ("punch", "force", "debonded"))
        starts = [_force_at_first(history, name) for name in ("damaged", "debonded")]
        peak = np.argmax(force)
        numbers = [force[0] / punch[0], *starts, force[peak], gone[peak], force[-1]]
        rows.append([label, *(f"{number:.5g}" for number in numbers)])
    return markdown(head, rows)


def studied(
    study: str,
    values: Sequence[float],
    out: Path,
    refine: float = 1.0,
    steps: int = 100,
    end: float = 0.174,
    resume: bool = False,
) -> dict[str, vmdg.History]:
    """One run of the example per value, a table and a picture of all; the histories by label.

    Args:
        out: Folder for table and picture; every run has a folder in it.
        refine: Factor on all counts of cells [-].
        end: Travel of the punch [mm].
        resume: Continue from the last checkpoint of every run.
    """
    argument, label, _ = STUDIES[study]
    first, runs = MPI.COMM_WORLD.rank == 0, {}
    for value in values:
        if first:
            print(label.format(value))
        given = {"refine": refine, "steps": steps, "friction": pushout.FRICTION}
        given["fibre_modulus"] = pushout.FIBRE_MODULUS
        given[argument] = value * E_MATRIX if study == "modulus" else value
        law = replace(pushout.LAW, friction=given["friction"])
        model = pushout.build(False, 25, given["refine"], law, given["fibre_modulus"])
        folder = out / f"{study}_{value}"
        runs[label.format(value)] = pushout.push(
            model, folder, given["steps"], end, resume, model.measures
        )
    if first:
        (out / f"pushout_{study}.md").write_text(section_7_4(runs, study) + "\n")
        print(section_7_4(runs, study))
        figure = curves(runs, pushout.FRICTION, pushout.FIBRE_MODULUS)
        figure.savefig(out / f"pushout_{study}.png")
    return runs


def main(
    study: Annotated[str, STUDIES] = "report",
    refine: float = 1,
    steps: int = 100,
    end: float = 0.174,
    resume: bool = False,
    out: str = "results/pushout_parameters",
) -> dict[str, vmdg.History]:
    """Run all values of a study; the histories by label.

    Args:
        study: What is changed.
        refine: Factor on all numbers of cells [-].
        steps: Load steps of the punch.
        end: Travel of the punch [mm].
        resume: Continue from the last checkpoint of every run.
        out: Folder for table, picture and the runs.
    """
    given = {"refine": refine, "steps": steps, "end": end, "resume": resume}
    return studied(study, STUDIES[study][2], Path(out), **given)


if __name__ == "__main__":
    run(main)
