"""What vmdg costs in addition to the time of a run: compiled kernels, and memory.

Both are measured in processes of their own: kernels with an empty cache, memory by the peak of the
resident size.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

import vmdg
from parts.benchmark.common import layers
from parts.benchmark.continuous import Plain
from parts.scenes import pushout as push_out
from vmdg.base import kernels
from vmdg.linear.ksp import LU
from vmdg.meshes import pushout
from vmdg.meshes.pushout import FIBRE, FIBRE_TOP, MATRIX, SUPPORT, SYMMETRY_X, SYMMETRY_Y

#: Where the push-out is cut short, load factors (1 is the end of the cure, then the punch in mm).
LOADS = (0.5, 1.0, 1.01, 1.02)


def two_blocks(
    cell: str, laws: list[vmdg.Law], degree: int = 1, kinematics: str = "finite"
) -> None:
    """Pull two layers apart by one small step, as many times as there are laws."""
    divisions = (2,) * (1 + (cell in ("tetrahedron", "hexahedron"))) + (4,)
    tagged = layers(cell, divisions, (1.0,) * (len(divisions) - 1) + (2.0,), 2)
    body = vmdg.NeoHookean(E=1000.0, nu=0.3)
    for law in laws:
        interface = vmdg.Interface(between=(1, 2), law=law)
        problem = vmdg.Problem(
            tagged.mesh,
            tagged.cell_tags,
            {1: body, 2: body},
            [interface],
            degree,
            kinematics=kinematics,
        )
        problem.dirichlet(tagged.facet_tags.find(1), 0.0)
        problem.dirichlet(tagged.facet_tags.find(2), 1e-3)
        vmdg.solve(problem, [1.0])


BOND = vmdg.Debonding(strength=10.0, critical_gap=0.1, friction=0.3)
RADIAL = vmdg.ExponentialDebonding(strength=10.0, fracture_energy=1.0)

#: Scenes, each in the cache that the ones before have left.
SCENES: dict[str, Callable[[], None]] = {
    "2D, tied": lambda: two_blocks("quadrilateral", [vmdg.Bonded()]),
    "2D, debonding": lambda: two_blocks("quadrilateral", [BOND]),
    "2D, another law": lambda: two_blocks("quadrilateral", [RADIAL]),
    "3D, tied": lambda: two_blocks("hexahedron", [vmdg.Bonded()]),
    "3D, debonding": lambda: two_blocks("hexahedron", [BOND]),
    "3D, another law": lambda: two_blocks("hexahedron", [RADIAL]),
}


def compile_scenes(names: list[str]) -> list[dict]:
    """Kernels of these scenes, compiled in this process."""
    found = []
    for name in names:
        first = len(kernels.requested)
        SCENES[name]()
        for kernel in kernels.requested[first:]:
            found.append({"scene": name, **vars(kernel)})
    return found


def fresh(part: str, cache: str | None = None) -> list | dict:
    """What a call gives in a process of its own, if asked for with its own cache of kernels."""
    known = "compile_scenes, peak_plain, peak_vmdg"
    program = f"import json; from parts.benchmark.cost import {known}; print(json.dumps({part}))"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    if cache is not None:
        environment["XDG_CACHE_HOME"] = cache
    output = subprocess.run(
        [sys.executable, "-c", program],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    ).stdout
    return json.loads(output.splitlines()[-1])


def compiled(names: list[str]) -> list[dict]:
    """Kernels of these scenes from an empty cache; ``lines`` is 0 where one was there already."""
    with tempfile.TemporaryDirectory() as cache:
        return fresh(f"compile_scenes({names!r})", cache=cache)


HEAD_KERNELS = ("scene", "kernel", "asked for", "compiled", "s", "lines of C")


def kernel_rows(found: list[dict]) -> list[list]:
    """One row a scene and kind of kernel."""
    rows = []
    for scene, name in dict.fromkeys((k["scene"], k["name"]) for k in found):
        mine = [k for k in found if (k["scene"], k["name"]) == (scene, name)]
        new = [k for k in mine if k["lines"]]
        seconds, lines = sum(k["seconds"] for k in new), sum(k["lines"] for k in new)
        rows.append([scene, name, len(mine), len(new), seconds, lines])
    return rows


def peak_vmdg(layers: int = 25, refine: float = 1.0) -> dict:
    """Cure and first millimetres/100 of the push-out; MiB and unknowns."""
    model = push_out.build(True, layers, refine, push_out.LAW, push_out.FIBRE_MODULUS)
    problem = model.problem
    options = vmdg.SolveOptions(relative_tolerance=1e-7, petsc=LU)
    vmdg.solve(problem, LOADS[:2], options)
    problem.dirichlet(model.top, lambda t: 1 - t, model.axis, relative=True)
    vmdg.solve(problem, LOADS[2:], options)
    return _peak(problem.space.dofmap.index_map.size_global * 3)


def peak_plain(layers: int = 25, refine: float = 1.0) -> dict:
    """The same mesh, materials and solver without an interface, pushed by two steps."""

    def count(cells: int) -> int:
        return max(round(refine * cells), 1)

    tagged = pushout(
        layers=count(layers),
        around=2 * count(6),
        fibre_rings=count(4),
        hole_rings=count(2),
        matrix_rings=count(31),
    )
    materials = {
        FIBRE: vmdg.NeoHookean(E=push_out.FIBRE_MODULUS, nu=push_out.NU_FIBRE),
        MATRIX: vmdg.NeoHookean(E=push_out.E_MATRIX, nu=push_out.NU_MATRIX),
    }
    plain = Plain(tagged, materials)
    find = tagged.facet_tags.find
    held = [
        plain.component(find(t), i) for t, i in ((SUPPORT, 2), (SYMMETRY_X, 0), (SYMMETRY_Y, 1))
    ]
    top = plain.component(find(FIBRE_TOP), 2)
    plain.prescribed = np.unique(np.concatenate([*held, top]))
    for t in LOADS[2:]:
        plain.u.x.array[top] = 1 - t
        plain.solve(LU, 1e-7)
    return _peak(plain.size)


def _peak(unknowns: int) -> dict:
    """Largest resident size of this process so far; getrusage would know the parent's too."""
    status = Path("/proc/self/status").read_text().splitlines()
    (kibibytes,) = (line.split()[1] for line in status if line.startswith("VmHWM:"))
    return {"MiB": int(kibibytes) / 1024, "unknowns": unknowns}


def peaks(layers: int = 25, refine: float = 1.0) -> dict[str, dict]:
    """Of both, each in its own process; kernels are compiled in another one before."""
    fresh("(peak_plain(2, 0.2), peak_vmdg(2, 0.2))")
    return {name: fresh(f"peak_{name}({layers}, {refine})") for name in ("plain", "vmdg")}
