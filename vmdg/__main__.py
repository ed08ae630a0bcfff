"""``python -m vmdg``: what is installed, and whether it works."""

from __future__ import annotations

import argparse
import sys

from . import __version__, doctor


def main(arguments: list[str] | None = None) -> int:
    """Run a command; its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m vmdg",
        description="Interface failure at finite strain on DOLFINx; under mpirun on its ranks.",
    )
    parser.add_argument("--version", action="version", version=f"vmdg {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    commands.add_parser("info", help="versions, solvers found, cache of kernels, ranks, threads")
    commands.add_parser(
        "doctor", help="debond two blocks and write files: does the installation work?"
    )
    chosen = parser.parse_args(arguments)
    if chosen.command is None:
        parser.print_help()
        return 0
    return getattr(doctor, chosen.command)()


if __name__ == "__main__":
    sys.exit(main())
