"""Names of interfaces: everything that takes a number takes the name or the interface too."""

from __future__ import annotations

import numpy as np
import pytest
from support.problems import MATERIALS
from support.scenes import two_blocks

import vmdg
from vmdg import plot
from vmdg.output.values import facet_scalar, scalar
from vmdg.points.interface import interface_names, number_of

LAW = vmdg.Debonding(strength=20.0, critical_gap=0.05)


def named(name: str | None = None) -> vmdg.Interface:
    return vmdg.Interface(between=(1, 2), law=LAW, name=name)


def test_number():
    """By number, name or identity; the message lists the names."""
    bond, other, alone = named("bond"), named(), named("bond")
    both = [other, bond]
    assert interface_names(both) == ["interface_0", "bond"]
    assert [number_of(both, which) for which in (1, np.int64(1), -1, "bond", bond)] == [1] * 5
    assert number_of(both, "interface_0") == number_of(both, other) == 0
    for which, error in (("bnd", ValueError), (2, IndexError), (alone, ValueError)):
        with pytest.raises(error, match=r"no interface .*; the problem has 'interface_0', 'bond'"):
            number_of(both, which)
    with pytest.raises(TypeError):
        number_of(both, 0.5)


@pytest.mark.parametrize("name", ["", "a/b", "bodies", ".bond", 3])
def test_names_that_cannot_be(name):
    """A name is that of a file beside bodies.bp."""
    with pytest.raises(ValueError, match=r"Interface: name = .* must be usable as a file name"):
        named(name)


def test_problem_and_pictures(comm):
    """Of an interface with a name, all results are found by it."""
    scene, bond = two_blocks(comm, "quadrilateral", 2), named("bond")
    bodies = dict(enumerate(MATERIALS, start=1))
    cracks = vmdg.Interface(within=2, law=LAW, activate="on-demand")
    problem = vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [cracks, bond])
    problem.u.interpolate(lambda x: 0.01 * x[:2] ** 2)
    problem.step.assemble_residual()
    for which in (1, "bond", bond):
        assert problem.mean(which).area == pytest.approx(1.0)
        assert problem.state[which].gap.shape == problem.state[1].gap.shape
        assert (problem.stabilization[which].norm == problem.stabilization[1].norm).all()
        assert (
            problem.step.activation.facets[which].facets == problem.step.activation.facets[1].facets
        ).all()
        assert (problem.fine_scale(which) == problem.fine_scale(1)).all()
        assert (
            facet_scalar(problem, which, "fine_scale") == facet_scalar(problem, 1, "fine_scale")
        ).all()
        assert (problem.indicator(which) == problem.indicator(1)).all()
        assert (scalar(problem, which, "damage") == scalar(problem, 1, "damage")).all()
        assert (facet_scalar(problem, which, "slip") == facet_scalar(problem, 1, "slip")).all()
        line = plot.interface_profile(problem, which, "traction").lines[0]
        assert len(line.get_xdata()) == comm.allreduce(len(problem.state[1].weights))
        assert plot.mode_map(problem, which, axis="y").collections
    assert len(problem.state["interface_0"].weights) == 0
    with pytest.raises(ValueError, match="no interface 'fibre'"):
        problem.mean("fibre")
    with pytest.raises(ValueError, match=r"interface 0 \(between=.*are both called 'interface_1'"):
        vmdg.Problem(scene.mesh, scene.cell_tags, bodies, [named("interface_1"), cracks])
