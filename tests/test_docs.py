"""The documentation keeps up with the code: equations, docstrings, the API reference."""

from __future__ import annotations

import ast
import inspect
import re
import runpy
import textwrap
from collections.abc import Iterator
from dataclasses import is_dataclass
from importlib import import_module
from pathlib import Path

import pytest

import vmdg

ROOT = Path(__file__).resolve().parent.parent

#: Numbered equations and Boxes of the report.
EQUATIONS = [f"({n})" for n in range(1, 92)] + [f"Box {n}" for n in (1, 2, 3)]


# From equation to code


def numbers(text: str) -> list[str]:
    """Equations and Boxes named in a text, ranges like (66)-(71) taken apart."""
    found = []
    for first, last in re.findall(r"\((\d+)\)(?:-\((\d+)\))?", text):
        found += [f"({n})" for n in range(int(first), int(last or first) + 1)]
    for boxes in re.findall(r"Box(?:es)? (\d(?:(?:, | and )\d)*)", text):
        found += [f"Box {n}" for n in re.findall(r"\d", boxes)]
    return found


def rows() -> list[list[str]]:
    """Rows of the table: equations, file, function, remark."""
    lines = (ROOT / "forms" / "README.md").read_text().splitlines()
    table = [line.strip("|").split("|") for line in lines if line.startswith("| (")]
    table += [line.strip("|").split("|") for line in lines if line.startswith("| Box")]
    return [[cell.strip().strip("`") for cell in row] for row in table]


def definition(path: str, name: str) -> ast.AST | None:
    """The function or class of a file, ``Class.method`` too."""
    node: ast.AST | None = ast.parse((ROOT / path).read_text())
    for part in name.split("."):
        kinds = (ast.FunctionDef, ast.ClassDef)
        inside = [n for n in node.body if isinstance(n, kinds) and n.name == part]
        if not inside:
            return None
        node = inside[0]
    return node


def test_every_equation_has_one_row():
    """No number of the report is forgotten, none is said twice."""
    named = [number for row in rows() for number in numbers(row[0])]
    assert sorted(named) == sorted(EQUATIONS)


@pytest.mark.parametrize("row", rows(), ids=lambda row: row[0])
def test_equation_is_where_the_table_says(row):
    """The file has the function, whose docstring (or the file's) names it; or a reason is given."""
    equations, path, name, remark = row
    if not path:
        assert not name
        assert len(remark) > 5
        return
    found = definition(path, name)
    assert found is not None, f"{path} has no {name}"
    texts = [ast.get_docstring(found), ast.get_docstring(ast.parse((ROOT / path).read_text()))]
    cited = numbers(" ".join(text or "" for text in texts))
    missing = [number for number in numbers(equations) if number not in cited]
    assert not missing, f"the docstring of {name} in {path} does not name {missing}"


# Docstrings of public names

#: Modules of the reference: names by ``__all__``, or all that are defined there.
MODULES = runpy.run_path(str(ROOT / ".ci" / "site" / "pages.py"))["MODULES"]


def public() -> Iterator[tuple[str, object]]:
    """Every public function, class, method and property, once."""
    seen = set()
    for module in map(import_module, MODULES):
        names = getattr(module, "__all__", None)
        if names is None:
            names = [n for n, o in vars(module).items() if _defined_in(o, module) and n[0] != "_"]
        for name in names:
            item = getattr(module, name)
            if id(item) in seen:
                continue
            seen.add(id(item))
            where = f"{module.__name__}.{name}"
            yield where, item
            if inspect.isclass(item):
                yield from _members(where, item)


def _defined_in(item: object, module: object) -> bool:
    return getattr(item, "__module__", None) == module.__name__ and callable(item)


def _members(where: str, item: type) -> Iterator[tuple[str, object]]:
    for name, member in vars(item).items():
        known = isinstance(member, (property, classmethod, staticmethod)) or inspect.isfunction(
            member
        )
        if known and not name.startswith("_"):
            yield f"{where}.{name}", member


def unwrapped(item: object) -> object:
    """The function behind a property or a class method."""
    if isinstance(item, property):
        return item.fget
    return getattr(item, "__func__", item)


def documentation(item: object) -> str:
    """Own docstring, or the one of the base class for a method that has none."""
    return inspect.getdoc(item) or ""


PUBLIC = dict(public())


def test_everything_public_has_a_docstring():
    """Functions, classes, methods and properties."""
    bare = [where for where, item in PUBLIC.items() if not documentation(item)]
    assert not bare


def overridden(where: str) -> bool:
    """Whether a method overrides one of a base class, which documents the arguments."""
    owner = PUBLIC.get(where.rpartition(".")[0])
    if not inspect.isclass(owner):
        return False
    return any(where.rpartition(".")[2] in vars(base) for base in owner.__mro__[1:])


def parameters(item: object) -> list[str]:
    function = unwrapped(item)
    if inspect.isclass(function):
        if "__init__" not in vars(function):
            return []
        function = function.__init__
    names = inspect.signature(function).parameters
    return [name for name in names if name not in ("self", "cls")]


def test_arguments_are_documented():
    """Every argument of a public function has an entry in its docstring.

    Values of a data class are its attributes; what a property, an override and a method of one
    obvious argument take, their first line may say.
    """
    undocumented = []
    for where, item in PUBLIC.items():
        if isinstance(item, property) or overridden(where):
            continue
        names, text = parameters(item), documentation(item)
        alone = len(names) == 1 and not inspect.isclass(item)
        entry = r"\b{}\b" if alone else r"^ *(?:\w+, )*\*{{0,2}}{}(?:, \w+)*: "
        for name in names:
            if not re.search(entry.format(re.escape(name)), text, re.MULTILINE):
                undocumented.append(f"{where}: {name}")
    assert not undocumented


#: Arguments that are quantities, and what their documentation names.
UNIT = re.compile(r"\[[^\]]*(mm|MPa|N|s|-)[^\]]*\]|\b(MPa|mm)\b")
QUANTITIES = (
    "E mu kappa lmbda strength critical_gap viscosity thickness length height depth width radius "
    "element_size size fibre_radius hole_radius matrix_radius precrack outer trial "
    "penalty gap softening tensile_strength shear_strength level_set"
).split()


def test_quantities_have_units():
    """Arguments and attributes that are lengths, stresses or the like name their unit."""
    bare, counted = [], 0
    for where, item in PUBLIC.items():
        for name in QUANTITIES:
            entry = re.search(
                rf"^ *{name}: (.*(?:\n {{6,}}.*)*)", documentation(item), re.MULTILINE
            )
            counted += entry is not None
            if entry and not UNIT.search(entry[1]):
                bare.append(f"{where}: {name}")
    assert counted > 40
    assert not bare


def raised(item: object) -> set[str]:
    """Exceptions that the body of a public function raises itself."""
    functions = [unwrapped(item)]
    if inspect.isclass(functions[0]):
        own = vars(functions[0])
        # The __init__ of a data class has no source.
        names = ("__post_init__",) if is_dataclass(functions[0]) else ("__init__",)
        functions = [own[name] for name in names if name in own]
    names = set()
    for function in functions:
        tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
        for node in ast.walk(tree):
            if isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
                names.add(ast.unparse(node.exc.func))
    return names - {"NotImplementedError"}


def test_errors_are_documented():
    """What a public function raises itself is in its Raises section."""
    silent, counted = [], 0
    for where, item in PUBLIC.items():
        text = documentation(item).partition("Raises:")[2]
        for name in raised(item):
            counted += 1
            if not re.search(rf"^ *{name}:", text, re.MULTILINE):
                silent.append(f"{where}: {name}")
    assert counted > 20
    assert not silent


def test_public_names_are_few_and_known():
    """The walk over the modules finds what users are told of."""
    for name in ("vmdg.Problem.dirichlet", "vmdg.solve", "vmdg.meshes.blocks", "vmdg.NamedTags"):
        assert name in PUBLIC
    assert {where.split(".")[1] for where in PUBLIC} >= set(vmdg.__all__)
