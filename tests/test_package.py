"""The package as a user meets it: its names and what it imports."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import vmdg

ROOT = Path(__file__).resolve().parent.parent


def test_public_names():
    """Every public name can be loaded, and an unknown one is an AttributeError."""
    assert all(getattr(vmdg, name) is not None for name in vmdg.__all__)
    assert set(vmdg.__all__) <= set(dir(vmdg))
    with pytest.raises(AttributeError, match="no attribute 'Cohesive'"):
        vmdg.Cohesive  # noqa: B018


def test_laws_need_numpy_only():
    """``vmdg.laws`` is imported where DOLFINx, PETSc and MPI are missing."""
    code = (
        "import sys\n"
        "for name in ('dolfinx', 'petsc4py', 'mpi4py', 'ufl', 'basix', 'scipy'):\n"
        "    sys.modules[name] = None\n"
        "from vmdg.laws import Debonding\n"
        "print(Debonding(strength=1.0, critical_gap=0.5).softening_modulus)\n"
    )
    environment = {"PYTHONPATH": str(ROOT), "PATH": os.environ["PATH"]}
    done = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "2.0"
