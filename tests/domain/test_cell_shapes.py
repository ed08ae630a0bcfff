"""Degenerate, inverted and folded cells are refused, and nothing else is."""

from __future__ import annotations

import re

import numpy as np
import pytest
from dolfinx.mesh import Mesh
from support.scenes import EVERY_CELL, deform, distort, everywhere, tag_cells, unit_box

import vmdg
from vmdg.domain.cells import check_cells


def middle_node(mesh: Mesh) -> np.ndarray:
    """Node in the middle of the unit box, on the ranks that have it."""
    d = mesh.geometry.dim
    return np.flatnonzero(np.abs(mesh.geometry.x[:, :d] - 0.5).max(axis=1) < 1e-9)


def move_middle(mesh: Mesh, to: float) -> None:
    """Move the middle node along the diagonal of the unit box of two cells a side."""
    mesh.geometry.x[middle_node(mesh), : mesh.geometry.dim] = to


@EVERY_CELL
@pytest.mark.parametrize("stretch", [1e-6, 1.0, 1e6])
def test_sound_cells(comm, cell, stretch):
    """Distorted, mirrored and very flat cells pass."""
    mesh = unit_box(comm, cell, 3)
    distort(mesh, 0.04)
    check_cells(mesh)
    deform(mesh, np.diag([-stretch, 1.0, 1.0]))
    check_cells(mesh)


@EVERY_CELL
@pytest.mark.parametrize("to", [1.01, 1.6])
def test_inverted(comm, cell, to):
    """A node pushed through the corner of the box turns cells over."""
    mesh = unit_box(comm, cell, 2)
    move_middle(mesh, to)
    with pytest.raises(ValueError, match=r"cell \d+ at \[.*\] is inverted.*remesh"):
        check_cells(mesh)


@EVERY_CELL
@pytest.mark.parametrize("far", [0.0, 1e3])
def test_edge_without_length(comm, cell, far):
    """Two nodes in one place, far from the origin too."""
    mesh = unit_box(comm, cell, 2)
    x = mesh.geometry.x
    x[middle_node(mesh), 0] = 1.0
    x += far
    with pytest.raises(ValueError, match=r"cell \d+ at \[.*\] is degenerate"):
        check_cells(mesh)


@EVERY_CELL
def test_coordinates_that_are_no_numbers(comm, cell):
    """NaN passes no comparison."""
    mesh = unit_box(comm, cell, 2)
    move_middle(mesh, np.nan)
    with pytest.raises(ValueError, match="is degenerate"):
        check_cells(mesh)


def test_collapsed_corner(comm):
    """Two sides of a quadrilateral in one line: the Jacobian vanishes at a corner only."""
    mesh = unit_box(comm, "quadrilateral", 2)
    move_middle(mesh, 0.75)
    check_cells(mesh)


@EVERY_CELL
def test_problem_refuses(comm, cell):
    """The door of the library, on every rank."""
    mesh = unit_box(comm, cell, 2)
    move_middle(mesh, 1.3)
    tags = tag_cells(mesh, {1: everywhere})
    with pytest.raises(ValueError, match=re.escape("is inverted")):
        vmdg.Problem(mesh, tags, {1: vmdg.NeoHookean(E=1.0, nu=0.3)}, [])
