"""What :class:`vmdg.FieldWriter` has written, read by ADIOS2."""

from __future__ import annotations

import io
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

# ADIOS2's own package and the ADIOS2 within DOLFINx are builds of their own that need not fit into
# one process; nor does a reader need the MPI of the process that asks.
_READER = """
import io, sys
import adios2, numpy
with adios2.FileReader(sys.argv[1]) as reader:
    types = {name: about["Type"] for name, about in reader.available_variables().items()}
    arrays = {name: reader.read(name) for name in types if types[name] in ("double", "float")}
memory = io.BytesIO()
numpy.savez(memory, **arrays)
sys.stdout.buffer.write(memory.getvalue())
"""

#: What would make a child of an MPI process believe to be one of its ranks.
_OF_RANKS = ("OMPI_", "PMIX_", "PMI_", "PRTE_", "HYDRA_", "MPI_LOCAL")


def read_vtx(path: str | Path) -> dict[str, NDArray[np.floating]]:
    """The floating-point arrays of a VTX file, by name; of the last step, not collective.

    Raises:
        subprocess.CalledProcessError: the file cannot be read, or there is no module adios2.
    """
    environment = {k: v for k, v in os.environ.items() if not k.startswith(_OF_RANKS)}
    command = [sys.executable, "-c", _READER, str(path)]
    done = subprocess.run(command, env=environment, stdout=subprocess.PIPE, check=True)
    with np.load(io.BytesIO(done.stdout)) as arrays:
        return dict(arrays)
