"""The web site has every page and every demo, and docstrings come out as they were typed."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import textwrap
from functools import cache
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest

ROOT = Path(__file__).resolve().parent.parent
SITE = ROOT / ".ci" / "site"


def module(name: str) -> ModuleType:
    """A module of the builder, which is no package."""
    spec = spec_from_file_location(f"site_{name}", SITE / f"{name}.py")
    made = module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


PAGES, BUILD, FORMULAS = module("pages"), module("build"), module("formulas")
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


def shown(text: str, display: bool = True) -> str:
    """The signs of a formula in their order, fractions as (a)/(b)."""
    tree = ElementTree.fromstring(FORMULAS.mathml(text, display))
    tree[0].remove(tree[0][1])  # the text as it was typed

    def signs(part: ElementTree.Element) -> str:
        inside = [signs(child) for child in part]
        if part.tag == "mfrac":
            return "({})/({})".format(*inside)
        return (part.text or " " * (part.tag == "mspace")) + "".join(inside)

    return signs(tree)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("K.du_0 = -R", "K⋅du0 = −R"),
        ("T = {P.N} + tau_s.s,", "T = {P⋅N} + τs⋅s,"),
        ("int_K GRAD b : A : GRAD b dV", "∫K GRAD b : A : GRAD b dV"),
        ("zeta_T,n = [R^T.(x_2 - x_1)]_T(u_n) - s_n", "ζT,n = [RT⋅(x2 − x1)]T(un) − sn"),
        ("Pi = I - n (x) m/(m.n)", "Π = I − n ⊗ (m)/(m⋅n)"),
        ("|T*_N - d mu |T_N| n| <= F_s^-1_JK", "|TN∗ − d μ |TN| n| ≤ Fs−1JK"),
        ("F_bar = (theta / J)^(1/n) F", "F¯ = (θ / J)1/n F"),
        ("K = d2Pi/du2 where lambda >= E, otherwise 0", "K = (d2Π)/(du2) where λ ≥ E, otherwise 0"),
        ("sigma_y = yield_stress + hardening alpha", "σy = yield_stress + hardening α"),
        ("sum(x_1 x M.v_1)", "∑(x1 × M⋅v1)"),
        ("a c/n M + 2/3 c", "a c/n M + (2)/(3) c"),  # (a c)/n M, or a (c/n) M: as it was typed
        ("d psi/d zeta = T.s/2", "d ψ/d ζ = T⋅s/2"),
    ],
)
def test_formulas_keep_their_signs(text, expected):
    """Every sign in its place; a fraction is stacked where it can be read in one way."""
    assert shown(text) == expected


@pytest.mark.parametrize(
    "text",
    [
        "solve(problem, loads)",
        "law = vmdg.Bonded()",
        "demos/run tutorial",
        "Interface(between=lambda a, b: angle(R[a], R[b]) < 15, law=...)",
        "x = y^1/2",  # the root, or half of y
        "u = c x t",  # a product, or a vector product
        "T = (P.N + s",
        "n = |T",
        "a == b",
        "mesh size = 3",
        "step  load  gap",
        "$ pip install .",
        "T = K_",
    ],
)
def test_what_is_no_formula_stays(text):
    """Programs, tables, sentences, and what could be read in two ways are not typeset."""
    with pytest.raises(FORMULAS.Unclear):
        FORMULAS.block(text)


def test_formulas_in_sentences():
    """Letters that are words, units, initials and counts are left to the sentence."""
    text = (
        "A law, e.g. of a bond, has T = {P.N} + r s at side 1, where |T| <= max(R, mu |T_N|), in "
        "MPa or N/m; 2 H is 5 N by M. Ortiz. At (57) tau_s (57) and zeta_n, n [N] need a < 1/2 and "
        "DG of degree 2 - I/O does not. Units are N, mm and s (20 s)."
    )
    found = [text[start:end] for start, end in FORMULAS.spans(text)]
    assert found == [
        "T = {P.N} + r s", "|T| <= max(R, mu |T_N|)", "tau_s", "zeta_n", "n", "a < 1/2",
    ]  # fmt: skip


def test_all_formulas_of_the_theory_are_typeset():
    """Every block of THEORY.md."""
    text = (ROOT / "vmdg" / "THEORY.md").read_text()
    blocks = re.findall(r"(?:^    .+\n)+", text, re.MULTILINE)
    assert len(blocks) >= 5
    assert all("<math" in FORMULAS.block(block) for block in blocks)


def test_tutorials_are_notebooks():
    """All of a script but its command line, in cells that a notebook can run one after another."""
    scripts = [demo for demo in PAGES.demos() if PAGES.tutorial(demo)]
    assert len(scripts) > 5
    for script in scripts:
        cells = json.loads(PAGES.notebook(script))["cells"]
        assert len({cell["id"] for cell in cells}) == len(cells) > 3
        assert cells[-1]["source"] == "main()"
        code = [cell["source"] for cell in cells if cell["cell_type"] == "code"]
        for piece in code:
            ast.parse(piece)
        words = "\n".join(cell["source"] for cell in cells).replace("#", "").split()
        whole = script.read_text().partition("if __name__")[0]
        whole = re.sub(r"^# \d+\. ", "", whole, flags=re.MULTILINE).replace('"""', " ")
        kept = " ".join(words).replace('"""', " ").split()
        assert set(whole.replace("#", "").split()) <= set(kept)


def test_other_words_lead_to_pages():
    """What a reader may call a thing is in the index of the page that says it."""
    pages = sources()
    index = {name: re.findall(r"^```{index} (.*)$", text, re.M) for name, text in pages.items()}
    for words, page in (("CZM", "laws"), ("press fit", "materials"), ("mode mixity", "laws")):
        assert f"! {words}" in index[f"reference/{page}.md"][0].split(", ")
    assert "mesh size" in index["howto/choose-the-mesh-at-a-process-zone.md"][0]


def test_site_is_built_without_warnings(tmp_path):
    """The command ends well, a page of the API has its words, formulas are typeset."""
    if {"OMPI_COMM_WORLD_SIZE", "PMI_SIZE"} & os.environ.keys():
        pytest.skip("the site is built without mpirun")
    command = [sys.executable, str(SITE / "build.py"), str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=500)
    if "Sphinx could not be installed" in ended.stderr:
        pytest.skip("pip cannot install Sphinx here, no network")
    assert ended.returncode == 0, ended.stdout + ended.stderr
    html = tmp_path / "html"
    page = (html / "names" / "vmdg.Problem.html").read_text()
    assert "Bodies connected by interfaces that may fail." in page
    texts = {file: file.read_text() for file in html.rglob("*.html")}
    assert sum('<div class="formula">' in text for text in texts.values()) > 15
    assert sum("<math" in text for text in texts.values()) > 80
    for text in texts.values():
        for formula in re.findall(r"<math.*?</math>", text):
            ElementTree.fromstring(formula)
        assert not re.search(r'<(script|link)[^>]+(src|href)="(https?:)?//', text)
    assert len(list(html.glob("_downloads/*/tutorial*.ipynb"))) > 5
