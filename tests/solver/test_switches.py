"""What a run uses and spares: every switch in both positions, and why steps are not condensed."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import joined
from support.scenes import two_blocks

import vmdg
from vmdg.solver import features as switches
from vmdg.solver import linear as linear_solver
from vmdg.solver.condensed_newton import CondensedNewton
from vmdg.solver.features import condensation, gap_components
from vmdg.solver.newton import Newton
from vmdg.solver.stepping import Stepper

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05)
RUBBING = vmdg.Debonding(strength=20.0, critical_gap=0.05, friction=0.4)


def on(problem: vmdg.Problem, **options) -> dict[str, bool]:
    """Position of every switch."""
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
        "bodies assembled": True,
        "condensed to interface": False,
        "linear solver": True,
    }
    assert found == expected


def test_tied_at_small_strain(comm):
    """One tangent serves all steps."""
    found = on(joined(two_blocks(comm, "quadrilateral"), vmdg.Bonded(), kinematics="small"))
    for name in ("bodies assembled", "condensed to interface", "tau_s every step"):
        assert not found[name]


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
    assert found["condensed to interface"] == (comm.size == 1)
    assert found["bodies assembled"] == (comm.size > 1)
    assert on(problem, condensed=False)["bodies assembled"]


def derived(tau1, tau2, context):
    """tau_s and delta_1 of the report with a safety of 4, as a user's own stabilization."""
    bonded = np.linalg.inv(tau1 + tau2)
    return 4 * bonded, bonded @ tau1


def refusal(problem, **options) -> str:
    """Why the default does not condense; asking for it is an error with the same reason."""
    condensed, why = condensation(problem, vmdg.SolveOptions(**options))
    assert not condensed
    with pytest.raises(ValueError, match="condensed = True is not possible") as error:
        vmdg.solve(problem, [0.1], vmdg.SolveOptions(condensed=True, **options))
    assert why in str(error.value)
    return why


def test_steps_aside(comm):
    """Finite strain, ties, several ranks, and features that need the whole problem."""
    scene = two_blocks(comm, "quadrilateral", 2)
    small = {"kinematics": "small"}
    assert "finite strain" in refusal(joined(scene, LAW))
    assert "tied" in refusal(joined(scene, vmdg.Bonded(), **small))
    if comm.size > 1:
        assert "ranks" in refusal(joined(scene, LAW, **small))
        return
    assert "dilatation" in refusal(joined(scene, LAW, volumetric="mean", **small))
    own = {"stabilization": derived}
    assert "stabilization" in refusal(joined(scene, LAW, interface=own, **small))
    problem = joined(scene, LAW, interface={"activate": "on-demand"}, **small)
    why = condensation(problem)[1]
    assert "tied" in why or "demand" in why
    assert "petsc" in refusal(joined(scene, LAW, **small), petsc={"ksp_type": "preonly"})


ITERATIVE = {"ksp_type": "gmres", "pc_type": "jacobi"}


@pytest.mark.parametrize("petsc", [None, ITERATIVE, {"snes_linesearch_type": "basic"}])
@pytest.mark.parametrize("limit", [0, 10_000])
def test_summary_says_what_newton_does(comm, monkeypatch, petsc, limit):
    """Kept bodies and the linear solver, for every source of the options of PETSc."""
    monkeypatch.setattr(linear_solver, "MEDIUM", limit)
    problem = joined(two_blocks(comm, "quadrilateral", 4), LAW)
    board = vmdg.switchboard(problem, vmdg.SolveOptions(petsc=petsc))
    reasons = {switch.name: switch.reason for switch in board}
    newton = Newton(problem, 1e-9, 10, petsc)
    assert newton.keeps_bulk == (petsc is ITERATIVE or limit == 0)
    assert newton.keeps_bulk == ("stale" in reasons["bodies assembled"])
    newton.destroy()
    kept, direct = "FGMRES with LDL^T", "LDL^T"
    expected = "options.petsc" if petsc is ITERATIVE else kept if limit == 0 else direct
    assert reasons["linear solver"] == expected


def test_where_it_is_cheaper(comm, monkeypatch):
    """The default compares the gaps with the dofs; True and False do as they say."""
    if comm.size > 1:
        pytest.skip("condensed on one rank only")
    problem = joined(two_blocks(comm, "quadrilateral", 2), LAW, kinematics="small")
    assert gap_components(problem) == 2 * 2 * 2  # facets, points, components
    for limit, kind in ((switches.CHEAPER, CondensedNewton), (0, Newton)):
        monkeypatch.setattr(switches, "CHEAPER", limit)
        stepper = Stepper(problem, vmdg.SolveOptions())
        assert isinstance(stepper._newton, kind)
        stepper.close()
    assert condensation(problem, vmdg.SolveOptions(condensed=True))[0]
    assert not condensation(problem, vmdg.SolveOptions(condensed=False))[0]


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
