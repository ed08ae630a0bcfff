#!/usr/bin/env python3
"""Builds the web site of the pages, the demos and the API.

Sphinx and its extensions come from the extra ``docs`` of pyproject.toml. Where they cannot be
imported they are installed with pip into a virtual environment in the user's cache folder, once.
FEniCSx need not be installed.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import shutil
import subprocess
import sys
import venv
from importlib.util import find_spec
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]

#: Modules of the extra ``docs`` and of vmdg's own dependencies, without which the API has no pages.
NEEDED = (
    "sphinx",
    "myst_parser",
    "pydata_sphinx_theme",
    "sphinx_copybutton",
    "sphinx_design",
    "ziamath",
    "numpy",
    "scipy",
    "matplotlib",
    "tqdm",
    "PIL",
)


def requirements() -> list[str]:
    """What pip installs: dependencies and the extra ``docs``, as pyproject.toml lists them.

    Python 3.10 has no parser of TOML, and the lists are literals of Python, too.
    """
    text = (ROOT / "pyproject.toml").read_text()
    found = []
    for name in ("dependencies", "docs"):
        start = text.index(f"\n{name} = [") + len(name) + 4
        found += text[start : text.index("]", start)].split('"')[1::2]
    return found


def own() -> dict[str, str]:
    """The environment without what would lead pip and Python to other folders."""
    dropped = ("PYTHONPATH", "PYTHONHOME", "PYTHONUSERBASE", "PIP_TARGET", "PIP_PREFIX")
    return {**{k: v for k, v in os.environ.items() if k not in dropped}, "PIP_USER": "0"}


def environment() -> Path:
    """Interpreter of a virtual environment with these packages, which is made where it lacks."""
    wanted = requirements()
    key = hashlib.sha256(repr([sys.version, *wanted]).encode()).hexdigest()[:8]
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folder = cache / "vmdg" / f"site-{key}"
    python = folder / "bin" / "python3"
    if not (folder / "complete").exists():
        print(f"installing Sphinx in {folder}", flush=True)
        shutil.rmtree(folder, ignore_errors=True)
        try:
            venv.create(folder, with_pip=True)
            install = [python, "-m", "pip", "install", "--quiet", *wanted]
            subprocess.run(install, check=True, env=own())
        except subprocess.CalledProcessError as error:
            sys.exit(
                f"Sphinx could not be installed (exit code {error.returncode}): without a network "
                'or python3-venv, "pip install .[docs]" in an environment of your own, build there'
            )
        (folder / "complete").touch()
    return python


def main() -> int:
    """Build the site; the exit code of Sphinx."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    default = ROOT / "results" / "site"
    parser.add_argument(
        "folder",
        nargs="?",
        type=Path,
        default=default,
        help="its subfolders html (the site), sources and doctrees are rebuilt; results/site",
    )
    parser.add_argument(
        "--links", action="store_true", help="try the links to other sites instead, a minute"
    )
    arguments = parser.parse_args()
    if not all(map(find_spec, NEEDED)):
        python = environment()
        os.execve(python, [str(python), __file__, *sys.argv[1:]], own())

    from pages import write
    from sphinx.cmd.build import build_main

    out = arguments.folder.resolve()
    sources = out / "sources"
    # Rebuilt each time: unchanged pages would not warn again, and deleted ones would remain.
    for name in ("sources", "doctrees", "html", "linkcheck"):
        shutil.rmtree(out / name, ignore_errors=True)
    write(sources)
    builder = "linkcheck" if arguments.links else "html"
    options = ["-b", builder, "-W", "--keep-going", "-q", "-d", str(out / "doctrees")]
    failed = build_main([*options, "-c", str(HERE), str(sources), str(out / builder)])
    if not failed and builder == "html":
        print(f"the site is in {out / builder / 'index.html'}")
    return failed


if __name__ == "__main__":
    sys.exit(main())
