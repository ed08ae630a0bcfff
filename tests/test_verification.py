"""Closed forms at a coarse size, and what the delamination scene is made of."""

from __future__ import annotations

import _beams
import _verification
import numpy as np
import pytest
import verification

from vmdg.meshes import beams, core_and_ring


def test_closed_forms(comm, out):
    """Bar to round-off (a patch test); fields to the h2 of the traction of degree 2.

    At h = a/10 the measured errors are 1.0e-5 (mean pressure), 6.6e-3 (pressure, pointwise at the
    quadrature points), 5.3e-3 and 5.8e-3 (Goodier).
    """
    checks = {(c.case, c.quantity): c for c in verification.main(coarse=True, out=str(out))}
    bounds = {"bimaterial bar": 1e-10, "Lame shrink fit": 1e-2, "Goodier inclusion": 1e-2}
    assert {case for case, _ in checks} == set(bounds)
    for (case, _), check in checks.items():
        assert check.error < bounds[case], check
    assert checks["Lame shrink fit", "mean pressure [MPa]"].error < 5e-5
    comm.barrier()
    assert (out / "verification.md").read_text().count("\n") == len(checks) + 2


def test_pointwise_tractions_converge():
    """Goodier's tractions in the maximum norm: halving h divides the error by three or more."""
    coarse, fine = (_verification.goodier(h) for h in (0.1, 0.05))
    for before, after in zip(coarse, fine, strict=True):
        assert after.error < before.error / 3


def test_theory_of_the_cantilever():
    """Numbers of the literature: 68.9 N by beam theory, 63.2 N at 1.94 mm corrected (1% here for
    the plane strain modulus)."""
    m = _beams.Laminate()
    K = np.sqrt(m.b * m.G_c * m.rigidity / 12)
    assert pytest.approx(68.9, rel=0.01) == K / 30
    assert pytest.approx(63.2, rel=0.01) == K / (30 + m.chi * m.h)
    assert pytest.approx(1.94, rel=0.01) == 8 * K * (30 + m.chi * m.h) ** 2 / m.rigidity


def test_cantilever_before_and_at_the_start_of_growth():
    """Stiffness within 1% of corrected beam theory; the load lags it where the bond softens."""
    run = _beams.dcb(element_size=0.25, steps=9, end=1.8, rows=2, degree=2)
    assert run.checks[0].error < 0.01
    force, exact = run.history["force"], run.history["force_exact"]
    assert np.abs(force / exact - 1).max() < 0.03
    assert (np.diff(run.history["crack"]) >= 0).all()


def test_end_notched_flexure():
    """Stiffness and the load that drives the crack within 1% of corrected beam theory."""
    run = _beams.enf()
    assert all(check.error < 0.01 for check in run.checks)
    assert run.history["crack"][-1] > 41


@pytest.mark.parametrize("slit", [True, False])
@pytest.mark.parametrize("cell", ["triangle", "quadrilateral"])
def test_mesh_of_beams(comm, cell, slit):
    """The cracked part has its tag; a slit has twice the facets there, one for each lip."""
    tagged = beams(comm, cell, (0.0, 2.0, 5.0), (4, 6), 1.0, 2, 2.0, slit)
    tags = tagged.facet_tags
    own = tagged.mesh.topology.index_map(1).size_local

    def count(tag):
        return comm.allreduce(int((tags.find(tag) < own).sum()))

    assert [count(tag) for tag in range(1, 8)] == [2, 2, 4, 10, 10, 6, 8 if slit else 4]


def test_errors_of_the_meshes(comm):
    """Refused with the name of what is wrong."""
    with pytest.raises(ValueError, match="cell = 'hexahedron'"):
        beams(comm, "hexahedron")
    with pytest.raises(ValueError, match="stations must ascend"):
        beams(comm, stations=(0.0, 30.0, 20.0))
    with pytest.raises(ValueError, match="precrack = 31"):
        beams(comm, precrack=31.0)
    with pytest.raises(ValueError, match="radius = 3"):
        core_and_ring(comm, radius=3.0)
