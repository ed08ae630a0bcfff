"""Push-out, section 7.4: mesh, cure, the way over the peak, resumed runs, 3D and section."""

from __future__ import annotations

import numpy as np
import pushout as demo
import pytest
import ufl
from dolfinx import fem
from support.checks import integral

import vmdg
from vmdg.meshes import pushout

R_F, R_S, R_M, H = 0.95, 1.025, 4.3, 5.36


@pytest.mark.long
def test_section_to_the_end(comm, out):
    """The whole curve on a coarse section: slope, peak, the jump, friction, modes at the top.

    On 12 layers peak and end lie within 3% of those on 100 layers (408.5 N and 104.3 N), the slope
    within 9% (7890 N/mm, punch on a coarse corner); damage never heals.
    """
    history = demo.main(refine=0.5, steps=40, out=str(out))
    comm.barrier()
    punch, force = history["punch"], history["force"]
    assert force[0] / punch[0] == pytest.approx(7890, rel=0.09)
    assert force.max() == pytest.approx(408.5, rel=0.03)
    assert force[-1] == pytest.approx(104.3, rel=0.03)
    assert (np.diff(history["debonded"]) > -1e-12).all()
    assert history["debonded"][-1] == pytest.approx(H, rel=1e-9)
    assert history["jump_steps"].sum() > 0
    assert (out / "pushout.png").stat().st_size > 10_000


@pytest.mark.long
def test_solid_against_section(comm):
    """3D and section on the same layers, half way to the peak: force within 2%.

    The quarter has 12 flat facets around it: its area is 1.1% smaller.
    """
    forces = []
    for solid in (True, False):
        model = demo.build(solid, 12, 0.5, demo.LAW, demo.FIBRE_MODULUS)
        vmdg.solve(model.problem, [1.0])
        model.problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
        history = vmdg.solve(model.problem, [1.01, 1.02, 1.03], monitor=model.measures).history
        forces.append(history["force"])
    assert forces[0] == pytest.approx(forces[1], rel=0.02)


def test_relative_displacement(comm):
    """The nodes keep the form they have when they are gripped."""
    model = demo.build(False, 6, 0.5, demo.LAW, demo.FIBRE_MODULUS)
    problem = model.problem
    vmdg.solve(problem, [1.0])
    dofs = fem.locate_dofs_topological(problem.space, 1, model.top)
    before = problem.u.x.array.reshape(-1, 2)[dofs, 1].copy()
    problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    vmdg.solve(problem, [1.001])
    moved = problem.u.x.array.reshape(-1, 2)[dofs, 1] - before
    assert moved == pytest.approx(np.full(len(dofs), -0.001), abs=1e-12)


def test_quarter(comm):
    """Areas of a polygon with 24 corners, in 3D, on any number of ranks."""
    mesh, _, facets = pushout(comm, 6, 6, 2, 1, 5)
    polygon = 6 * np.sin(np.pi / 12) / 2  # quarter of a polygon of 24 corners, radius 1
    side = 12 * np.sin(np.pi / 24) * H  # quarter of its prism
    exact = {
        "fibre top": polygon * R_F**2,
        "fibre bottom": polygon * R_F**2,
        "matrix top": polygon * (R_M**2 - R_F**2),
        "hole": polygon * (R_S**2 - R_F**2),
        "support": polygon * (R_M**2 - R_S**2),
        "outer": side * R_M,
        "symmetry x": R_M * H,
        "symmetry y": R_M * H,
    }
    ds = ufl.Measure("ds", mesh, subdomain_data=facets)
    for name, area in exact.items():
        form = fem.Constant(mesh, 1.0) * ds(facets.names[name])
        assert integral(comm, form) == pytest.approx(area, rel=1e-9), name
