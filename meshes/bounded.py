"""Files that are not trusted: readers get a copy in an empty folder, and memory by its size."""

from __future__ import annotations

import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

#: Memory that a reader may take: a constant part [bytes], and a part in proportion to the size of
#: the file. A reader of text takes some 20 times its size.
ROOM, PER_BYTE = 500 << 20, 64

_CONVERT = """
import sys, gmsh
gmsh.initialize(readConfigFiles=False)
for option in ("General.Terminal", "Mesh.SaveAll"):
    gmsh.option.setNumber(option, option == "Mesh.SaveAll")
gmsh.open(sys.argv[1])
gmsh.write(sys.argv[2])
"""


@contextmanager
def alone(path: Path) -> Iterator[Path]:
    """A copy of a file in an empty folder that only this user can write to.

    gmsh executes the files NAME.opt, NAME.pos, ... next to the one that it opens, which may contain
    commands. A copy does not change between the check of its first bytes and its reading.
    """
    with TemporaryDirectory(prefix="vmdg-") as folder:
        copy = Path(folder) / f"mesh{path.suffix.lower()}"
        shutil.copyfile(path, copy)
        yield copy


def converted(path: Path) -> Path:
    """A universal file as a .msh next to it.

    gmsh does it in a process of its own, which a damaged file of this format would kill.
    """
    with path.open("rb") as file:
        if file.read(4096).split()[:1] != [b"-1"]:
            raise ValueError("it is not a universal file: its first line is not -1")
    result = path.with_suffix(".msh")
    command = [sys.executable, "-c", _CONVERT, str(path), str(result)]
    if subprocess.run(command, capture_output=True, check=False).returncode:
        raise ValueError("gmsh cannot read it; is it complete?")
    return result


@contextmanager
def bounded(size: int) -> Iterator[None]:
    """Bound the memory that is allocated in the block, as far as the system can.

    A count in a file of 100 bytes may ask for any amount of memory.
    """
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = _address_space() + ROOM + PER_BYTE * size
    ends = [end for end in (limit, *before) if end != resource.RLIM_INFINITY]
    resource.setrlimit(resource.RLIMIT_AS, (min(ends), before[1]))
    try:
        yield
    except MemoryError:
        raise ValueError(
            f"its {size} bytes ask for more than {(limit - _address_space()) >> 20} MB of memory; "
            "are its counts and numbers right?"
        ) from None
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def _address_space() -> int:
    """Of this process [bytes]; a large bound where the system does not say."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError):
        return 1 << 46
    return pages * resource.getpagesize()
