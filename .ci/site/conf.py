"""Configuration of Sphinx; ``build.py`` calls it with the sources that ``pages.py`` writes."""

from __future__ import annotations

import re
import sys
from contextlib import suppress
from importlib.util import find_spec
from pathlib import Path

from docutils import nodes
from sphinx.ext import autosummary
from sphinx.ext.autodoc.mock import MockFinder, _MockObject
from sphinx.util.inspect import TypeAliasForwardRef

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT)]

from docstrings import readable  # noqa: E402
from formulas import Unclear, block, mathml, spans  # noqa: E402
from pages import aliases  # noqa: E402

# FEniCSx is replaced, so that docstrings can be read without it, and the site is the same where it
# is. Some modules of vmdg look into it when they are imported: they compare versions and the size
# of a communicator, search a docstring of DOLFINx, and make unions of its types.
FENICSX = "dolfinx petsc4py mpi4py ufl basix ffcx gmsh meshio h5py cffi adios2 pyvista vtk".split()
autodoc_mock_imports = FENICSX
sys.meta_path.insert(0, MockFinder(autodoc_mock_imports))
_MockObject.__gt__ = _MockObject.__lt__ = lambda *_: False
_MockObject.__or__ = _MockObject.__ror__ = lambda self, _: self
_MockObject.__init__.__doc__ = ""

import vmdg  # noqa: E402

#: Pages whose formulas are typeset: explanations, how-to, reference, names of the API, tutorials;
#: not that of units, whose letters are no symbols.
FORMULAS = (
    "explanation|howto(?!/choose-units)|reference|names/|derivations|equations|microstructure|glossary|path"
    "|demos/tutorial"
)

WORD_JOINER = "\u2060"

project = "vmdg"
author = "The vmdg developers"
version = release = vmdg.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_copybutton",
    "sphinx_design",
]
nitpicky = False  # types of packages that are not linked have no targets
# A name such as Parameter is shorter than what it stands for; what it may be is in the words.
autodoc_type_aliases = {name: name for name in aliases()} | {
    "Array": "NDArray",
    "ArrayLike": "ArrayLike",
}
TypeAliasForwardRef.__repr__ = lambda self: self.name
autosummary.WELL_KNOWN_ABBREVIATIONS += ("eq.", "eqs.", "St.")

myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4

autosummary_generate = True
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
napoleon_numpy_docstring = False
napoleon_custom_sections = [("Attributes", "params_style")]
napoleon_use_rtype = False
default_role = "code"
highlight_language = "none"  # blocks of formulas
templates_path = [str(HERE / "templates")]
python_use_unqualified_type_names = True
toc_object_entries_show_parents = "hide"
add_module_names = False

copybutton_exclude = ".linenos, .gp, .go"

html_theme = "pydata_sphinx_theme"
html_title = f"vmdg {version}"
FONTS = Path(find_spec("ziamath").origin).parent / "fonts"
html_static_path = [str(HERE / "style.css"), str(FONTS / "STIXTwoMath-Regular.ttf")]
html_css_files = ["style.css"]
html_copy_source = False
html_show_sourcelink = False
html_theme_options = {
    "header_links_before_dropdown": 7,
    "navbar_align": "left",
    "navbar_persistent": [],
    "navbar_end": ["search-button", "theme-switcher"],
    "navigation_depth": 2,
    "show_toc_level": 2,
    "secondary_sidebar_items": {"**": ["page-toc"], "equations": []},
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {"index": []}
project_copyright = author


def setup(app) -> None:
    """Docstrings are made ready before napoleon (priority 500) takes their sections apart."""
    app.connect("autodoc-process-docstring", _readable, priority=400)
    app.connect("autodoc-skip-member", _said_before)
    app.connect("doctree-read", _typeset)
    app.connect("doctree-resolved", _fitted)


def _readable(app, what, name, item, options, lines: list[str]) -> None:
    lines[:] = readable(lines)
    if what in ("property", "attribute"):
        lines.insert(0, "\\ ")  # or napoleon takes what stands before a colon for the type


def _said_before(app, what, name, item, skip, options) -> bool | None:
    """Fields of named tuples, which the class describes."""
    return True if (getattr(item, "__doc__", "") or "").startswith("Alias for field") else None


def _typeset(app, tree) -> None:
    """Blocks without a language that are formulas, and formulas in sentences, become MathML."""
    if re.match(FORMULAS, app.env.docname) is None:
        return
    for literal in list(tree.findall(nodes.literal_block)):
        if literal.get("language", "none") in ("none", "default"):
            with suppress(Unclear):
                literal.replace_self(nodes.raw("", block(literal.astext()), format="html"))
    for node in [t for p in tree.findall(nodes.paragraph) for t in p if isinstance(t, nodes.Text)]:
        text = node.astext()
        pieces: list[nodes.Node] = []
        last = 0
        for start, end in spans(text):
            # No line ends between a formula and a bracket or comma.
            around = (f" {text}"[start], f"{text} "[end])
            tied = ["" if sign.isspace() else WORD_JOINER for sign in around]
            made = mathml(text[start:end], display=False)
            if end - start > 30:
                made = f'<span class="formula-long">{made}</span>'
            made = nodes.raw("", tied[0] + made + tied[1], format="html")
            pieces += [nodes.Text(text[last:start]), made]
            last = end
        node.parent.replace(node, [*pieces, nodes.Text(text[last:])])


#: Characters of the longest cell from which a table has sentences, and the most columns of one.
SENTENCE, COLUMNS = 30, 6


def _fitted(app, tree, docname: str) -> None:
    """Tables that fit on narrow screens: those of sentences have the heads in their cells, too,
    to be shown as a list of rows; those of numbers are set closely."""
    for table in tree.findall(nodes.table):
        rows = [list(row) for row in table.findall(nodes.row)]
        if len(rows) < 2 or not table.next_node(nodes.thead):
            continue
        head, *body = rows
        pictures = table.next_node(nodes.image) is not None
        if not any(title.astext() for title in head):
            continue
        longest = max((len(entry.astext()) for row in body for entry in row), default=0)
        if len(head) <= COLUMNS and longest >= SENTENCE:
            table["classes"].append("entries" if pictures and len(head) > 4 else "sentences")
            for row in body:
                for title, entry in zip(head[1:], row[1:], strict=False):
                    said = nodes.inline(classes=["cell-head"])
                    said += [child.deepcopy() for part in title for child in part]
                    if said.astext() and entry.astext() and not entry.next_node(nodes.image):
                        entry[0].insert(0, said)
        elif len(head) > 4:
            table["classes"].append("numbers")
