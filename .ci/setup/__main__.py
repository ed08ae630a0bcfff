"""The commands ``tests/run`` and ``demos/run``, for Python 3.9 without other packages."""

from __future__ import annotations

import os
import re
import signal
import sys

import environment
from common import MODULES, ROOT, TEST_MODULES, default, die, say

TESTS_USAGE = """\
usage: tests/run [--yes] [-n RANKS | -j WORKERS] [--dolfinx latest] [pytest arguments...]

--yes              as root, install Debian packages without asking
-n RANKS           run the suite on several MPI ranks
-j WORKERS         share the serial suite between processes, default: one a core, at most 8; 1 for a debugger
--dolfinx latest   use the newest DOLFINx (a second environment, Debian unstable)

Of pytest's arguments, --all adds the tests with the mark "long", which run every night.
"""  # noqa: E501

DEMOS_USAGE = """\
usage: demos/run [--yes] [-n RANKS] [--dolfinx latest] NAME|FILE.py|-m MODULE [arguments...]

NAME is an example or a study of the list below, FILE.py any script, MODULE an installed one; without any, the list is
all that is printed. "-m vmdg info" lists what is installed, "-m vmdg doctor" checks that it works.
--yes              as root, install Debian packages without asking
-n RANKS           run on several MPI ranks
--dolfinx latest   use the newest DOLFINx (a second environment, Debian unstable)
"""  # noqa: E501


def leading_options(names: str, arguments: list[str], usage: str) -> tuple[dict, list[str]]:
    """Values of the leading options; what follows is for the script or for pytest."""
    values, rest = {"-n": "1", "--dolfinx": ""}, list(arguments)
    if rest[:1] == ["--yes"]:
        os.environ["VMDG_YES"], rest = "1", rest[1:]
    while rest and (option := re.fullmatch(rf"({names})(?:=|(?=\d)|$)(.*)", rest[0])):
        name, value = option.groups()
        if not value and len(rest) == 1:
            die(f"{name} needs a value")
        values[name] = value or rest[1]
        rest = rest[1 if value else 2 :]
    if rest and rest[0] in ("-h", "--help"):
        print(usage, end="")
        sys.exit()
    for name, what in (("-n", "ranks"), ("-j", "processes")):
        if not re.fullmatch("[1-9][0-9]*", values.get(name, "1")):
            die(f"{name} takes a number of {what}, not '{values[name]}'")
    if values["--dolfinx"] not in ("", "latest"):
        die("--dolfinx takes only the word 'latest'")
    return values, rest[1:] if rest[:1] == ["--"] else rest


def tests(arguments: list[str]) -> None:
    """Run the test suite."""
    values, rest = leading_options("-n|-j|--dolfinx", arguments, TESTS_USAGE)
    ranks, workers = int(values["-n"]), int(values.get("-j", 0))
    if ranks > 1 and workers > 1:
        die(f"-n {ranks} runs every test on all ranks: -j {workers} is for the serial suite")
    workers = workers or min(8, len(os.sched_getaffinity(0)))
    command = ["-m", "pytest"]
    if ranks == 1 and workers > 1:
        # Whole files, because tests of a file share what is costly to make. A process that dies
        # ends the run and names its test; another one in its place would meet the same test.
        command += ["-n", str(workers), "--dist", "loadfile", "--max-worker-restart=0"]
    for argument in rest:
        if re.match("-n|-j|--dolfinx", argument):
            place = f"tests/run {argument} ... -q PATH"
            die(f"{argument} comes before the arguments of pytest: {place}")
        # A test named from the caller's folder keeps its meaning when pytest starts elsewhere.
        is_path = re.match("[^-]", argument) and os.path.exists(argument.partition("::")[0])
        command.append(os.path.abspath(argument) if is_path else argument)
    if not sys.stdout.isatty():  # mpirun gives every rank a terminal, even into a pipe
        default("NO_COLOR", "1")
    os.chdir(ROOT)
    found = environment.prepare(values["--dolfinx"] == "latest", *MODULES, *TEST_MODULES)
    environment.execute(found, ranks, command)


def demos(arguments: list[str]) -> None:
    """Run a demo, a script or a module, or list the demos."""
    values, rest = leading_options("-n|--dolfinx", arguments, DEMOS_USAGE)
    if not rest:
        print(DEMOS_USAGE, list_of_demos(), sep="\n")
        return
    folders = []
    if rest[0] != "-m":
        script = find_script(rest[0])
        if script is None:
            say(f"no demo and no script is called '{rest[0]}'; the demos are")
            print(list_of_demos(), file=sys.stderr)
            sys.exit(2)
        folders, rest = [os.path.dirname(script)], [script, *rest[1:]]
    found = environment.prepare(values["--dolfinx"] == "latest", *MODULES)
    environment.execute(found, int(values["-n"]), rest, *folders)


def find_script(name: str) -> str | None:
    """Path of a file that is there, of an example or of a study."""
    paths = [os.path.abspath(name)] if name.endswith(".py") else []
    stem = name.removesuffix(".py")
    paths += [f"{ROOT}/demos/{folder}{stem}.py" for folder in ("", "studies/")]
    return next(filter(os.path.isfile, paths), None)


def list_of_demos() -> str:
    """Names with the first lines of their docstrings."""
    titles = {
        "": "examples, each a file of its own to copy and change:",
        "studies": "studies, which measure the method:",
    }
    lines = []
    for folder, title in titles.items():
        lines.append(title)
        for path in sorted((ROOT / "demos" / folder).glob("*.py")):
            first = re.search(r'^[rR]?"""\s*(.*?)("""|$)', path.read_text("utf-8"), re.MULTILINE)
            lines.append(f"  {path.stem:24} {first[1] if first else ''}")
    return "\n".join(lines)


if __name__ == "__main__":
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # Python ignores it, and what it starts would
    if signal.getsignal(signal.SIGINT) is not signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.SIG_DFL)  # no traceback
    {"tests": tests, "demos": demos}[sys.argv[1]](sys.argv[2:])
