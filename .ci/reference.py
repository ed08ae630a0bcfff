"""Writes the API reference of all modules for users; called by .ci/reference."""

from __future__ import annotations

import sys
from pathlib import Path

import vmdg

#: Modules for users, in the order of the reference.
MODULES = (
    "vmdg",
    "vmdg.laws",
    "vmdg.meshes",
    "vmdg.plot",
    "vmdg.plot.solids",
    "vmdg.forms.materials",
)


def main(tools: str, out: str) -> None:
    """Build the pages.

    Args:
        tools: Folder in which pdoc is installed.
        out: Folder for the pages.
    """
    sys.path.append(tools)
    import pdoc

    # Names that vmdg loads on first use; pdoc looks for those that are there.
    vars(vmdg).update({name: getattr(vmdg, name) for name in vmdg.__all__})
    pdoc.render.configure(docformat="google", show_source=False, math=False)
    pdoc.pdoc(*MODULES, output_directory=Path(out))


if __name__ == "__main__":
    main(*sys.argv[1:])
