"""Configuration of Sphinx; ``build.py`` calls it with the sources that ``pages.py`` writes."""

from __future__ import annotations

import sys
from importlib.util import find_spec
from pathlib import Path

from sphinx.ext import autosummary
from sphinx.ext.autodoc.mock import MockFinder, _MockObject
from sphinx.util.inspect import TypeAliasForwardRef

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT)]

from docstrings import readable  # noqa: E402
from pages import aliases  # noqa: E402

# What vmdg imports and this machine has not is replaced, so that docstrings can be read without
# FEniCSx. Some modules of vmdg look into it when they are imported: they compare versions and the
# size of a communicator, search a docstring of DOLFINx, and make unions of its types.
FENICSX = "dolfinx petsc4py mpi4py ufl basix ffcx gmsh meshio h5py cffi adios2 pyvista vtk".split()
autodoc_mock_imports = [name for name in FENICSX if find_spec(name) is None]
sys.meta_path.insert(0, MockFinder(autodoc_mock_imports))
_MockObject.__gt__ = _MockObject.__lt__ = lambda *_: False
_MockObject.__or__ = _MockObject.__ror__ = lambda self, _: self
_MockObject.__init__.__doc__ = ""

import vmdg  # noqa: E402

project = "vmdg"
author = "The vmdg developers"
version = release = vmdg.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.mathjax",
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

myst_enable_extensions = ["amsmath", "colon_fence", "dollarmath"]
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
html_static_path = [str(HERE / "style.css")]
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
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
}
html_sidebars = {"index": []}
project_copyright = author


def setup(app) -> None:
    """Docstrings are made ready before napoleon (priority 500) takes their sections apart."""
    app.connect("autodoc-process-docstring", _readable, priority=400)
    app.connect("autodoc-skip-member", _said_before)


def _readable(app, what, name, item, options, lines: list[str]) -> None:
    lines[:] = readable(lines)
    if what in ("property", "attribute"):
        lines.insert(0, "\\ ")  # or napoleon takes what stands before a colon for the type


def _said_before(app, what, name, item, skip, options) -> bool | None:
    """Fields of named tuples, which the class describes."""
    return True if (getattr(item, "__doc__", "") or "").startswith("Alias for field") else None
