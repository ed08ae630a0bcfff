"""The web site has every page and every demo, and docstrings come out as they were typed."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import textwrap
from functools import cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parent.parent
SITE = ROOT / ".ci" / "site"


def module(name: str) -> ModuleType:
    """A module of the builder, which is no package."""
    spec = spec_from_file_location(f"site_{name}", SITE / f"{name}.py")
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


PAGES, BUILD = module("pages"), module("build")
readable = module("docstrings").readable


@cache
def sources() -> dict[str, str]:
    """The pages of the site, as Sphinx gets them."""
    return PAGES.sources()


def listed() -> list[str]:
    blocks = [block for text in sources().values() for block in toctrees(text)]
    lines = [line for block in blocks for line in block.splitlines() if line and line[0] != ":"]
    return [re.sub(r".*<(.+)>", r"\1", line) for line in lines]


def toctrees(text: str) -> list[str]:
    return re.findall(r"^```\{toctree\}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def test_every_page_is_listed_once():
    """A page that no table of contents lists would not be found, and none is listed in vain."""
    pages = {name.removesuffix(".md") for name in sources()} - {"index"}
    entries = listed()
    assert pages == set(entries)
    assert len(entries) == len(set(entries))


def test_every_file_is_a_page():
    """All Markdown files and all demos of the checkout are in the site."""
    files = {*ROOT.glob("*.md"), *ROOT.glob("[!.]*/**/*.md"), *ROOT.glob(".github/*.md")}
    files = {str(file.relative_to(ROOT)) for file in files if "results" not in file.parts}
    files = {file for file in files if not file.endswith("_template.md")}  # forms to fill in
    tables = {file for file in files if file.startswith("demos/gallery/")}
    linked = {file for file in files if (ROOT / file).resolve() != (ROOT / file)}
    assert files - tables - linked == set(PAGES.PAGES.values())
    assert {f"tables/{Path(table).name}" for table in tables} <= set(sources())
    folder = ROOT / "demos"
    scripts = [*folder.glob("*.py"), *folder.glob("studies/*.py")]
    demos = {f"demos/{demo.stem}.md" for demo in scripts}
    assert demos <= set(sources())


def test_pages_are_taken_apart_without_loss():
    """Every line of a page that is split stands in one of its parts, headings raised."""
    for page in PAGES.SPLIT:
        parts = PAGES.parts(page)
        assert len(parts) > 5
        lines = [line.lstrip("#") for text in parts.values() for line in text.splitlines()]
        whole = (ROOT / PAGES.PAGES[page]).read_text().splitlines()
        assert lines == [line.lstrip("#") for line in whole]
        assert all(text.startswith("# ") for text in parts.values())


def test_no_line_of_a_paragraph_starts_a_list():
    """To Markdown a full line before one with a minus ends there, and a bare <name> is a tag."""
    for name, text in sources().items():
        text = re.sub(r"^(```|~~~).*?^\1", "", text, flags=re.MULTILINE | re.DOTALL)
        assert not re.search(r"^[^\s#|*-].{60,}\n[-+*] ", text, re.MULTILINE), name
        assert not re.search(r"<[a-z]+>", re.sub(r"`[^`]*`", "", text)), name


def test_links_lead_to_pages_of_the_site():
    """A section becomes a page, a heading below it an anchor, other files their names."""
    known = {"vmdg/GUIDE.md#loads": "/reference/loads.md", "README.md": "/index.md"}
    text = "[a](../vmdg/GUIDE.md#loads), [b](../README.md), ![c](gallery/d.png), [e](run)"
    expected = (
        "[a](/reference/loads.md), [b](/index.md), ![c](/demos/gallery/d.png), e (`demos/run`)\n"
    )
    assert PAGES.linked(text, "demos/README.md", known) == expected
    assert PAGES.linked("[demos/run](demos/run)", "README.md", known) == "`demos/run`\n"
    assert PAGES.linked("```\n[a](b)\n```", "README.md", known) == "```\n[a](b)\n```\n"
    for broken in ("[a](vmdg/GUIDE.md#load)", "[a](nowhere.md)"):
        with pytest.raises(ValueError, match="which is no page and no heading"):
            PAGES.linked(broken, "README.md", known)


def test_every_public_name_is_in_the_api():
    """Those of the stub and those of the modules for users."""
    names = set(re.findall(r"^   ([\w.]+)$", sources()["api.md"], re.MULTILINE))
    stub = {name for names in PAGES.stub().values() for name in names}
    assert {"Problem", "solve", "Debonding"} <= stub
    assert {f"vmdg.{name}" for name in stub} <= names
    for each in PAGES.MODULES[1:]:
        assert set(PAGES.public(each)) <= names | stub


def test_types_of_arguments_are_said():
    """Short names of types in the API have a row; those of the engine's inside have none."""
    rows = dict(re.findall(r"^\| (\w+) \| `(.+?)` \|", "\n".join(PAGES.types()), re.MULTILINE))
    assert rows["Where"] == r"ArrayLike \| Locator"
    assert {"Group", "Value", "Which", "Parameter"} <= set(rows)
    assert not {"Piece", "Weigh", "Points", "Array"} & set(rows)


def test_tutorials_are_chapters():
    """Numbered comments of a script become headings and text, all other lines are shown."""
    page = sources()["demos/tutorial.md"]
    assert "### Geometry\n\nBodies and sides get physical groups" in page
    assert "# 1. Geometry" not in page
    lines = (ROOT / "demos" / "tutorial.py").read_text().splitlines()
    shown: set[int] = set()
    for first, last in re.findall(r"/code/tutorial\.py\n:lines: (\d+)-(\d+)", page):
        shown |= set(range(int(first), int(last) + 1))
    _, behind = PAGES.docstring(ROOT / "demos" / "tutorial.py")
    hidden = [line for i, line in enumerate(lines, 1) if i > behind and i not in shown]
    assert all(not line or line.lstrip().startswith("# ") for line in hidden)


def test_docstrings_keep_their_formulas():
    """Blocks that are set in are literal, characters of formulas are no markup."""
    typed = """\
        Size |T*_N| of q_, as ``a * b|c`` and `x_`:

            psi = K |zeta|^2/2,
            T = K zeta,

        * a point, |T| <= R,
          that goes on

        Args:
            a: Of the bodies, |a|.

                not a formula of a paragraph
        """
    made = readable(textwrap.dedent(typed).splitlines())
    assert made[0] == r"Size \|T\*_N\| of q\_, as ``a * b|c`` and `x_`:"
    assert made[1:6] == ["", "::", "", "    psi = K |zeta|^2/2,", "    T = K zeta,"]
    assert made[7] == r"* a point, \|T\| <= R,"
    assert made[8] == "  that goes on"
    assert made[11] == r"    a: Of the bodies, \|a\|."


def test_requirements_are_those_of_the_package():
    """The command reads dependencies and the extra without a parser of TOML."""
    found = BUILD.requirements()
    assert {"numpy", "scipy", "sphinx", "myst-parser"} <= set(found)
    tomllib = pytest.importorskip("tomllib")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert found == project["dependencies"] + project["optional-dependencies"]["docs"]


@pytest.mark.skipif(
    not all(map(find_spec, BUILD.NEEDED)), reason="Sphinx and its extensions are not installed"
)
def test_site_is_built_without_warnings(tmp_path):
    """The command ends well, and a page of the API has its words."""
    if {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"} & os.environ.keys():
        pytest.skip("the site is built without mpirun")
    subprocess.run([sys.executable, str(SITE / "build.py"), str(tmp_path)], check=True, timeout=500)
    page = (tmp_path / "html" / "names" / "vmdg.Problem.html").read_text()
    assert "Bodies connected by interfaces that may fail." in page
