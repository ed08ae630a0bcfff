"""Files that are not what they seem: no command is run, memory is bounded, words are said."""

from __future__ import annotations

import random
import re
import resource
import warnings
from pathlib import Path

from mpi4py import MPI

import gmsh
import pytest
from support import foreign

from vmdg.meshes import read_mesh

#: Numbers that may stand in the place of others.
NUMBERS = (b"99999999999", b"-1", b"2147483647", b"1e400", b"nan", b"", b"18446744073709551615")

#: What a script of gmsh begins with.
COMMAND = 'SystemCall "touch owned";\n'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("name", ["good.msh.opt", "mesh.msh.opt", "good.opt", ".gmshrc"])
def test_commands_beside_a_mesh(folder, name):
    """gmsh reads options beside a file, of which this user need not know."""
    foreign.of_gmsh(folder / "good.msh")
    Path(name).write_text(COMMAND)
    assert read_mesh("good.msh", MPI.COMM_SELF).cell_tags.names == {"left": 1, "right": 2}
    assert not Path("owned").exists()


@pytest.mark.parametrize(
    "words",
    [
        COMMAND + "// $MeshFormat\n",
        "\n$MeshFormat\n" + COMMAND,
        " $NOD\n",
        "$Comments\n",
        "$Mesh\n",
    ],
)
def test_commands_in_a_mesh(folder, words):
    """A script whose comments look like a mesh."""
    for ending in ("msh", "unv", "inp", "vtu"):
        check_commands(words, ending)


def check_commands(words, ending):
    path = Path(f"a.{ending}")
    path.write_text(words + COMMAND + "// $EndElements\n$EndElements\n")
    with pytest.raises(ValueError, match=rf"^read_mesh: a\.{ending}: "):
        read_mesh(path, MPI.COMM_SELF)
    assert not Path("owned").exists()


def mutations(content: bytes, count: int) -> list[bytes]:
    """The same with numbers replaced, bytes turned, lines lost, or cut."""
    draw = random.Random(len(content))
    made = []
    for n in range(count):
        new = bytearray(content)
        if n % 2:
            spot = draw.choice(list(re.finditer(rb"[-+.\deE]+", content)))
            new[spot.start() : spot.end()] = draw.choice(NUMBERS)
        elif n % 4:
            new[draw.randrange(len(new))] = draw.randrange(256)
        else:
            lines = content.split(b"\n")
            del lines[draw.randrange(len(lines)) :][: draw.choice([1, 1, len(lines)])]
            new = bytearray(b"\n".join(lines))
        made.append(bytes(new))
    return made


@pytest.mark.parametrize("kind", ["4.1", "4.1 binary", "2.2", "2.2 binary", "inp", "med", "vtu"])
def test_damaged_files(folder, kind):
    """Each is read or refused in words, without asking for memory that it cannot need."""
    seed = Path(f"seed.{kind if kind.isalpha() else 'msh'}")
    if kind[0].isdigit():
        binary = float("binary" in kind)
        foreign.of_gmsh(
            seed, lambda: gmsh.option.setNumber("Mesh.Binary", binary), float(kind.split()[0])
        )
    elif kind == "inp":
        seed.write_text(foreign.abaqus("CPE3", foreign.POINTS, foreign.CELLS))
    else:
        foreign.of_gmsh(Path("seed.msh"), version=2.2)
        meshio = pytest.importorskip("meshio")
        meshio.write(seed, meshio.read("seed.msh"))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for number, content in enumerate(mutations(seed.read_bytes(), 6)):
        path = seed.with_stem(f"{kind.split()[-1]}{number}")
        path.write_bytes(content)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            try:
                read_mesh(path, MPI.COMM_SELF)
            except ValueError as error:
                assert str(error).startswith(f"read_mesh: {path}: ")
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 1 << 20  # [kB]


def test_counts_beyond_the_file(folder):
    """Labels by range, and a section of gmsh, that would not fit into any memory."""
    deck = foreign.abaqus("CPE3", foreign.POINTS, foreign.CELLS)
    Path("a.inp").write_text(deck + "*Elset, elset=all, generate\n1, 99999999999999, 1\n")
    tagged = read_mesh("a.inp", MPI.COMM_SELF, groups=["all"])
    assert tagged.cell_tags.find("all").size == 4
    Path("a.vtk").write_text(
        "# vtk DataFile Version 2.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\n"
        "POINTS 99999999999 double\n0 0 0\n"
    )
    pytest.importorskip("meshio")
    with pytest.raises(ValueError, match=r"^read_mesh: a\.vtk: "):
        read_mesh("a.vtk", MPI.COMM_SELF)
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY
