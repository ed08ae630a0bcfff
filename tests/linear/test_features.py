"""What a run uses and spares: every switch in both positions."""

from __future__ import annotations

import pytest
from support.problems import joined
from support.scenes import two_blocks

import vmdg

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05)
RUBBING = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.4)


def on(problem: vmdg.Problem, **options) -> dict[str, bool]:
    board = vmdg.switchboard(problem, vmdg.SolveOptions(**options))
    assert len({switch.name for switch in board}) == len(board)
    return {switch.name: switch.on for switch in board}


def test_tied_at_finite_strain(comm):
    """A tie has no history, the tensor tau_s and a symmetric tangent that moves with the bodies."""
    found = on(joined(two_blocks(comm, "quadrilateral"), vmdg.Bonded()))
    expected = {
        "history and return map": False,
        "damage tangent": False,
        "tensor tau_s": True,
        "friction": False,
        "unsymmetric tangent": False,
        "turning frame": False,
        "terms K of (85)": True,
        "tau_s every step": True,
        "linear solver": True,
    }
    assert found == expected


def test_friction_at_finite_strain(comm):
    """Friction asks for history and an unsymmetric solver, the default frame turns."""
    scene = two_blocks(comm, "quadrilateral")
    interface = vmdg.Interface(between=(1, 2), law=RUBBING)
    materials = {1: vmdg.NeoHookean(E=5000.0, nu=0.25), 2: vmdg.NeoHookean(E=2000.0, nu=0.35)}
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, materials, [interface])
    found = on(problem)
    for name in ("history and return map", "friction", "unsymmetric tangent", "turning frame"):
        assert found[name]
    assert not found["tensor tau_s"]
    # The same at small strain: no frame turns, nothing of the bodies changes.
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, materials, [interface], kinematics="small")
    found = on(problem)
    for name in ("turning frame", "terms K of (85)", "tau_s every step"):
        assert not found[name]


ITERATIVE = {"ksp_type": "gmres", "pc_type": "jacobi"}


@pytest.mark.parametrize("petsc", [None, ITERATIVE, {"snes_linesearch_type": "basic"}])
@pytest.mark.parametrize(("cell", "n"), [("quadrilateral", 4), ("hexahedron", 8)])
def test_summary_says_what_newton_does(comm, petsc, cell, n):
    """The linear solver, for every source of the options of PETSc."""
    scene = two_blocks(comm, cell, n)
    problem = joined(scene, LAW)
    problem.dirichlet(scene.facet_tags.find(1), 0.0)
    problem.dirichlet(scene.facet_tags.find(2), lambda t: t, "x")
    result = vmdg.solve(problem, [0.001], vmdg.SolveOptions(petsc=petsc))
    reasons = {switch.name: switch.reason for switch in result.switches}
    lagged = cell == "hexahedron"  # more than 3,000 unknowns
    assert (result.counts.krylov > 0) == (petsc is ITERATIVE or lagged)
    expected = "FGMRES with LDL^T" if lagged else "LDL^T"
    assert reasons["linear solver"] == ("options.petsc" if petsc is ITERATIVE else expected)


@pytest.mark.filterwarnings("ignore:there is no load")
def test_summary(comm, capsys):
    """Quiet by default; with a progress bar rank 0 prints a line for every switch."""
    scene = two_blocks(comm, "quadrilateral")
    for progress in (False, True):
        problem = joined(scene, LAW, kinematics="small")
        problem.dirichlet(scene.facet_tags.find(1), 0.0)
        result = vmdg.solve(problem, [0.1, 0.2], vmdg.SolveOptions(progress=progress))
        printed = capsys.readouterr().out
        assert (printed != "") == (progress and comm.rank == 0)
    if comm.rank == 0:
        assert printed.startswith("2 steps, 0 corrections, 0 attempts failed")
        for switch in result.switches:
            assert f"  {switch.name}" in printed
            assert switch.reason in printed
