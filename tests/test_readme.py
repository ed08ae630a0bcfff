"""What the pages tell a reader to type works: commands, options, examples, links."""

from __future__ import annotations

import argparse
import re
import runpy
import shlex
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGES = [
    ROOT / "README.md",
    *sorted(ROOT.glob("[!.]*/*.md")),
    *(ROOT / ".github" / name for name in ("CONTRIBUTING.md", "CHANGELOG.md", "DECISIONS.md")),
]

#: Commands of others, which are not ours to try.
OTHERS = ("git", "cd", "export", "conda", "docker", "source", "neper", "mypy", "pre-commit")

#: Modules of others, and a word that stands for one.
OTHER_MODULES = ("code", "pip", "jupyterlab", "MODULE")

FENCED = re.compile(r"^```(\w*)\n(.*?)^```", re.MULTILINE | re.DOTALL)
OURS = r"(?:demos/run|tests/run|.ci/site/build.py|python3? -m vmdg)\b"


class Parsed(Exception):
    """The options of a script have been understood; what it would do next is not asked here."""


def commands(page: Path) -> list[str]:
    """Lines of shell blocks, without comments, and commands of ours within the text."""
    text = page.read_text()
    found = []
    for language, block in FENCED.findall(text):
        if language in ("", "sh", "bash"):
            lines = block.replace("\\\n", " ").splitlines()
            found += [line for line in lines if line.strip() and not line.startswith("#")]
    prose = FENCED.sub("", text)
    return found + re.findall(rf"`([^`\n]*{OURS}[^`\n]*)`", prose)


def words(command: str) -> list[str]:
    """Words of a command without settings of variables, launchers and what follows a pipe."""
    parts = shlex.split(command, comments=True)
    for stop in ("|", ">", "&&", ";"):
        if stop in parts:
            parts = parts[: parts.index(stop)]
    while parts and re.match(r"[A-Z_]+=", parts[0]):
        parts.pop(0)
    if parts and parts[0] in ("srun", "mpirun"):
        parts = parts[next(i for i, part in enumerate(parts) if part.startswith("python")) :]
    return parts


def parse(script: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a script or a module (-m) understand its options, and stop it there."""
    understand = argparse.ArgumentParser.parse_args

    def parse_args(self, args=None, namespace=None):
        understand(self, args, namespace)
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_args)
    by_name = script[0] == "-m"
    arguments = script[2:] if by_name else script[1:]
    monkeypatch.setattr(sys, "argv", [script[by_name], *arguments])
    try:
        if by_name:
            monkeypatch.delitem(sys.modules, f"{script[1]}.__main__", raising=False)
            runpy.run_module(script[1], run_name="__main__")
        else:
            monkeypatch.syspath_prepend(str(Path(script[0]).resolve().parent))
            runpy.run_path(script[0], run_name="__main__")
    except Parsed:
        pass
    except SystemExit as stop:
        assert stop.code in (0, None), f"{' '.join(script)} does not understand its options"


def options_of_run(parts: list[str], known: tuple[str, ...]) -> list[str]:
    """What follows the options of demos/run or tests/run itself."""
    while parts and parts[0] in known:
        value = parts[1]
        assert value == "latest" if parts[0] == "--dolfinx" else re.fullmatch(r"\d+|[A-Z]+", value)
        parts = parts[2:]
    return parts


def run_demo(parts: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """``demos/run [-n RANKS] [--dolfinx latest] NAME|FILE.py [arguments...]``."""
    parts = options_of_run(parts, ("-n", "--dolfinx"))
    if not parts or parts[0] in ("NAME", "my.py", "--help"):
        return
    if parts[0] == "-m" and parts[1] in OTHER_MODULES:
        return
    if parts[0] == "-m":
        parse(parts, monkeypatch)
        return
    name = parts[0].removesuffix(".py")
    folders = (ROOT / "demos", ROOT / "demos" / "studies", ROOT)
    places = [folder / f"{name}.py" for folder in folders]
    there = [path for path in places if path.is_file()]
    assert there, f"there is no demo and no script {parts[0]}"
    takes_options = re.search(r"argparse|parts.options", there[0].read_text())
    if takes_options:
        parse([str(there[0]), *parts[1:]], monkeypatch)
    else:
        assert not any(part.startswith("-") for part in parts[1:]), f"{name} takes no options"


def run_tests(parts: list[str]) -> None:
    """``tests/run [-n RANKS | -j WORKERS] [--dolfinx latest] [pytest arguments...]``."""
    parts = options_of_run(parts, ("-n", "-j", "--dolfinx"))
    files = [part.partition("::")[0] for part in parts if part.startswith("tests/")]
    assert all((ROOT / file).exists() for file in files), f"no such test: {files}"
    if "-k" in parts:
        word = parts[parts.index("-k") + 1]
        assert any(word in (ROOT / file).read_text() for file in files), f"no test has {word}"


def install(parts: list[str]) -> None:
    """``pip install [-e] .[extra]`` of this repository."""
    if parts[-1] in OTHERS:
        return
    (what,) = (part for part in parts[1:] if not part.startswith("-"))
    extras = re.fullmatch(r"\.(?:\[(.*)\])?", what)
    assert extras, f"pip install {what} is not of this repository"
    known = (ROOT / "pyproject.toml").read_text().partition("optional-dependencies]")[2]
    for extra in filter(None, (extras[1] or "").split(",")):
        assert re.search(rf"^{extra} = ", known, re.MULTILINE), f"no extra {extra}"


def attempt(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Understand a command as the shell and the scripts would, without the hours it may take."""
    parts = words(command)
    if parts[0] == "demos/run":
        run_demo(parts[1:], monkeypatch)
    elif parts[0] == "tests/run":
        run_tests(parts[1:])
    elif parts[0] in ("pip", "pip3"):
        install(parts[1:])
    elif re.fullmatch(r"python3?", parts[0]):
        run_demo(parts[1:], monkeypatch)
    elif "/" in parts[0]:
        assert (ROOT / parts[0]).is_file(), f"there is no {parts[0]}"
    else:
        assert parts[0] in OTHERS, f"what is {parts[0]}?"


ALL = [(page, command) for page in PAGES for command in dict.fromkeys(commands(page))]


@pytest.mark.parametrize(("page", "command"), ALL, ids=[command for _, command in ALL])
def test_command(page, command, monkeypatch):
    """Every command names a script that is there and options that it has."""
    attempt(command, monkeypatch)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_options_in_the_text(page):
    """Options named by themselves belong to a script."""
    sources = [*(ROOT / "demos").glob("**/*.py"), ROOT / "demos" / "run", ROOT / "tests" / "run"]
    known = "\n".join(path.read_text() for path in sources)
    for option in re.findall(r"`(--[\w-]+)[^`]*`", FENCED.sub("", page.read_text())):
        name = option[2:].removeprefix("no-").replace("-", "_")
        assert option in known or re.search(rf"\b{name}\b", known), f"no script has {option}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_demos_of_tables(page):
    """Tables of demos name demos that are there."""
    for table in re.findall(r"^\| demo .*\n(?:\|.*\n)+", page.read_text(), re.MULTILINE):
        names = re.findall(r"^\| `(\w+)`", table, re.MULTILINE)
        assert names
        folders = (ROOT / "demos", ROOT / "demos" / "studies")
        assert all(any((folder / f"{n}.py").is_file() for folder in folders) for n in names)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links(page):
    """Pictures and files that are linked are there."""
    for target in re.findall(r"\]\(([^)#:\s]+)\)", page.read_text()):
        assert (page.parent / target).exists(), f"{page.name} links {target}"


#: Pages whose blocks of Python take more than some seconds.
LONG = "HOWTO.md", "MICROSTRUCTURE.md"


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=[pytest.mark.long] * (page.name in LONG)) for page in PAGES],
    ids=lambda page: page.name,
)
def test_python_blocks(page, out, monkeypatch):
    """Blocks of Python run as printed, one after the other in a page."""
    monkeypatch.chdir(out)
    scope: dict = {}
    for language, block in FENCED.findall(page.read_text()):
        if language == "python":
            exec(block, scope)


def test_first_example(out, monkeypatch):
    """The first problem of the README: the force rises, the bond breaks, nothing is left."""
    monkeypatch.chdir(out)
    blocks = [block for language, block in FENCED.findall(PAGES[0].read_text()) if language]
    (code,) = (block for block in blocks if "monitor=force" in block)
    scope: dict = {}
    exec(code, scope)
    history = scope["result"].history
    load, force = history["load"], history["force"]
    assert len(force) == 20
    assert "rises to 90 N at 0.1 mm" in PAGES[0].read_text()
    assert round(force.max()) == 90
    assert load[force.argmax()] == pytest.approx(0.1)
    assert np.abs(force[load > 0.19]).max() < 1e-5
