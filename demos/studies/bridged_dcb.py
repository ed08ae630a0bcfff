"""A published curve of a double cantilever beam, fitted by laws with and without fibre bridges.

Load over opening of carbon and epoxy, from de Gracia, Boyano, Arrese and Mujika, A new approach for
determining the R-curve in DCB tests without optical measurements, Engineering Fracture Mechanics
135 (2015), 274-285. With one energy the load would fall as the crack runs; here it stays, as fibres
bridge the crack. The bridged law is that of ``demos/tutorial_law.py``. The strength is given: a
curve of a long crack does not tell it. E along the fibres is found too, since it decides with the
length of the crack about the stiffness.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import matplotlib.pyplot as plt
import numpy as np
from parts.options import run
from parts.scenes import tutorial_law
from parts.tables import markdown, report

import vmdg
from vmdg.meshes import beams

#: Opening [mm] and load [N], every second point as read from the figure by D. Hartlen,
#: github.com/DCHartlen/CompliantCrackEquivalenceMethods (MIT).
MEASURED = (
    *((0.63, 4.03), (0.83, 5.31), (1.03, 6.58), (1.21, 7.72), (1.40, 8.89), (1.58, 10.04)),
    *((1.77, 11.15), (1.96, 12.29), (2.14, 13.42), (2.33, 14.53), (2.55, 15.82), (2.75, 17.06)),
    *((2.92, 18.20), (3.12, 19.29), (3.30, 20.43), (3.54, 21.78), (3.75, 22.95), (3.96, 24.11)),
    *((4.14, 25.33), (4.39, 26.62), (4.77, 27.86), (5.29, 28.17), (5.79, 28.03), (6.19, 27.80)),
    *((6.57, 27.45), (7.18, 27.18), (7.71, 27.03), (8.19, 26.69), (8.49, 26.69), (8.92, 27.20)),
    *((9.40, 27.64), (9.94, 27.88)),
)
CRACK, HEIGHT, WIDTH = 46.0, 1.5, 15.0  # mm
ACROSS, SHEAR, STRENGTH = 7e3, 4e3, 20.0  # MPa
#: First values; C00 is E along the fibres of both arms.
STARTS = {
    "linear": {"bond.critical_gap": 0.03, "Orthotropic.C00": 110e3},
    "bridged": {
        "bond.bridging": 1.0,
        "bond.knee": 0.025,
        "bond.critical_gap": 0.5,
        "Orthotropic.C00": 110e3,
    },
}
LABELS = {"linear": "linear softening", "bridged": "with bridges of fibres"}
#: Where the bridged law is one, and bridges are no longer than the beam.
BOUNDS = {"bond.bridging": (0.05, 10.0), "bond.knee": (0.01, 0.1), "bond.critical_gap": (0.11, 3.0)}


def law(values: dict[str, float]) -> vmdg.Law:
    """With these values; linear without bridges."""
    given = {k.removeprefix("bond."): v for k, v in values.items() if k.startswith("bond.")}
    kind = tutorial_law.BridgedDebonding if "bridging" in given else vmdg.Debonding
    return kind(strength=STRENGTH, **given)


def beam(values: dict[str, float], facet: float = 2.0) -> tuple[vmdg.Problem, Callable]:
    """The beam and its load."""
    stations = (0.0, CRACK - 4, CRACK, CRACK + 50)
    divisions = np.ceil(np.diff(stations) / (facet * np.array([4, 1, 1]))).astype(int)
    mesh, cells, sides = beams(
        stations=stations, divisions=divisions.tolist(), height=HEIGHT, rows=2, precrack=CRACK
    )
    bond = vmdg.Interface(facets=sides.find("interface"), law=law(values), name="bond")
    # Without nu_12 and nu_13 the stiffness along the fibres is E_1.
    moduli = (values["Orthotropic.C00"], ACROSS, ACROSS)
    arm = vmdg.Orthotropic(E=moduli, nu=(0.0, 0.0, 0.4), G=(SHEAR, SHEAR, ACROSS / 2.8))
    arms = {"lower arm": arm, "upper arm": arm}
    problem = vmdg.Problem(mesh, cells, arms, [bond], degree=2, kinematics="small", thickness=WIDTH)
    for y in (HEIGHT, -HEIGHT):
        problem.dirichlet_points(
            lambda x, y=y: np.isclose(x[0], 0.0) & np.isclose(x[1], y),
            lambda t, y=y: t * y / (2 * HEIGHT),
            "y",
        )
    problem.dirichlet(sides.find("right"), 0.0)
    top = sides.find("upper left")
    return problem, lambda problem: {"force [N]": problem.reaction(top)[1]}


def main(
    facet: float = 2.0, every: int = 1, out: str = "results/bridged_dcb"
) -> dict[str, vmdg.Identified]:
    """Fit both laws; what was identified.

    Args:
        facet: Size of the facets [mm].
        every: Use every such point.
        out: Folder for table and picture.
    """
    opening, load = np.array(MEASURED[::every]).T
    curve, found = vmdg.Curve(opening, load), {}
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.5, 3.8), layout="constrained")
    left.plot(opening, load, "ko", ms=4, mfc="none", label="measured (de Gracia et al. 2015)")
    lines = []
    for i, (name, start) in enumerate(STARTS.items()):
        bounds = BOUNDS if name == "bridged" else None
        fit = vmdg.identify(partial(beam, facet=facet), curve, start, bounds)
        found[name] = fit
        left.plot(opening, *fit.fitted["measured"], f"C{i}", label=LABELS[name])
        bond = law(fit.estimate)
        gap = np.linspace(0, bond.critical_gap, 400)
        right.semilogy(
            gap, bond.soften(np.full(400, STRENGTH), gap)[0], f"C{i}", label=LABELS[name]
        )
        energy = bond.bond_energy(np.array([STRENGTH]))[0]
        lines.append((name, "energy [N/mm]", f"{energy:.4g}", "", f"{fit.noise:.2g}"))
        lines += [
            (name, parameter, f"{value:.4g}", f"{100 * fit.relative_errors[parameter]:.2g}", "")
            for parameter, value in fit.estimate.items()
        ]
    left.set(xlabel="opening [mm]", ylabel="load [N]", xlim=(0, None), ylim=(0, None))
    right.set(xlabel="gap [mm]", ylabel="traction [MPa]", xlim=(0, None), ylim=(0.05, None))
    for ax in (left, right):
        ax.legend()
    text = markdown(("law", "quantity", "value", "standard error [%]", "residual [N]"), lines)
    report(out, "bridged_dcb", text, figure)
    return found


if __name__ == "__main__":
    run(main)
