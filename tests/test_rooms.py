"""Who may know whom, and how much a class shows, read from the source.

Tests and demos use the public names of the package, and leave its modules as they are.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent

#: From the ground up; a room knows rooms below it only.
FLOORS = (
    ("laws", "forms", "compat"),
    ("base", "materials"),
    ("domain",),
    ("points", "meshes"),
    ("interface",),
    ("assembly",),
    ("problem",),
    ("checks",),
    ("output",),
    ("plot", "checkpoint", "linear"),
    ("sensitivity",),
    ("solver",),
    ("dynamics", "identification", "remeshing"),
    ("vmdg",),
    ("doctor",),
    ("__main__",),
)
FLOOR = {room: floor for floor, rooms in enumerate(FLOORS) for room in rooms}

#: What the rooms on the ground may import besides the standard library.
GROUND = {"laws": {"numpy"}, "forms": {"ufl", "basix", "numpy"}}

MOST_NAMES = 32


def folders() -> Iterator[Path]:
    """The package and its rooms, the links to forms and meshes among them."""
    package = ROOT / "vmdg"
    yield package
    yield from (path for path in package.iterdir() if (path / "__init__.py").is_file())


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_name(path): path for folder in folders() for path in sorted(folder.glob("*.py"))}


@cache
def tree(module: str) -> ast.Module:
    return ast.parse(FILES[module].read_text())


def room(module: str) -> str:
    return module.split(".")[1] if "." in module else module


def imports(module: str) -> Iterator[str]:
    """All that a file imports, in functions and for type checkers too, save the version."""
    is_package = FILES[module].name == "__init__.py"
    for node in ast.walk(tree(module)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = module.split(".")[: len(module.split(".")) + is_package - node.level]
            base = ".".join([*(above if node.level else []), *([node.module] * bool(node.module))])
            for name in {alias.name for alias in node.names} - {"__version__"}:
                full = f"{base}.{name}"
                yield full if full in FILES else base


@cache
def graph() -> dict[str, set[str]]:
    """What every file imports of others."""
    return {module: {name for name in imports(module) if name in FILES} for module in FILES}


def test_imports_run_down():
    """A file imports from its own room and from floors below."""
    pairs = [(m, n) for m, needs in graph().items() for n in needs if room(m) != room(n)]
    assert not [pair for pair in pairs if FLOOR[room(pair[0])] <= FLOOR[room(pair[1])]]


def test_no_circle():
    """No file needs itself, however long the way round."""
    TopologicalSorter(graph()).prepare()


@pytest.mark.parametrize("ground", GROUND)
def test_ground(ground):
    """Laws are numpy, forms are UFL."""
    modules = [module for module in FILES if room(module) == ground]
    found = {name.partition(".")[0] for module in modules for name in imports(module)}
    assert found <= GROUND[ground] | {"vmdg"} | sys.stdlib_module_names


def public_names(node: ast.ClassDef) -> set[str]:
    """Methods, properties, fields, and what ``__init__`` assigns to self, without underscore."""
    names = set()
    for item in node.body:
        if isinstance(item, ast.FunctionDef):
            names.add(item.name)
        elif isinstance(item, ast.AnnAssign | ast.Assign):
            targets = item.targets if isinstance(item, ast.Assign) else [item.target]
            names |= {target.id for target in targets if isinstance(target, ast.Name)}
        if isinstance(item, ast.FunctionDef) and item.name == "__init__":
            stores = (n for n in ast.walk(item) if isinstance(n, ast.Attribute))
            names |= {n.attr for n in stores if isinstance(n.ctx, ast.Store)}
    return {name for name in names if not name.startswith("_")}


def test_classes_are_small():
    """No class shows more than a reader can hold in the head."""
    shown = {
        f"{module}.{node.name}": len(public_names(node))
        for module in FILES
        for node in ast.walk(tree(module))
        if isinstance(node, ast.ClassDef)
    }
    assert not {name: count for name, count in shown.items() if count > MOST_NAMES}


# Users of the package

OURS = {"vmdg", "parts", "support"}
OURS |= {path.stem for place in ("demos", "demos/studies") for path in (ROOT / place).glob("*.py")}
USERS = sorted(
    path.relative_to(ROOT).as_posix()
    for folder in ("tests", "demos")
    for path in (ROOT / folder).rglob("*.py")
)
#: Methods of monkeypatch and of unittest.mock.patch.
PATCHES = {"setattr", "setitem", "object", "dict"}
#: Of named tuples, and what notebooks call: names that begin with an underscore and are public.
PUBLIC = {"_replace", "_asdict", "_fields", "_make", "_repr_html_"}


def is_private(name: str) -> bool:
    return name.startswith("_") and not name.endswith("__") and name not in PUBLIC


def root_name(node: ast.expr) -> str:
    """First name of ``a.b[c].d``."""
    while isinstance(node, ast.Attribute | ast.Subscript):
        node = node.value
    return node.id if isinstance(node, ast.Name) else ""


def imported(tree: ast.AST) -> Iterator[tuple[str, str, str]]:
    """Module, name and local name of every import."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((a.name, "", a.asname or a.name.partition(".")[0]) for a in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from ((node.module or "", a.name, a.asname or a.name) for a in node.names)


def liberties(tree: ast.AST) -> Iterator[str]:
    """Uses of private names of others, and changes of what a module of ours holds."""
    names = {local: module for module, _, local in imported(tree)}
    foreign = {local for local, module in names.items() if module.partition(".")[0] not in OURS}
    yield from (f"import {name}" for _, name, _ in imported(tree) if is_private(name))
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            if is_private(node.attr) and root_name(node.value) != "self":
                yield f"line {node.lineno}: {node.attr}"
            if isinstance(node.ctx, ast.Store) and root_name(node) in names.keys() - foreign:
                yield f"line {node.lineno}: sets {ast.unparse(node)}"
        if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in PATCHES:
            target, root = ast.unparse(node.args[0]), root_name(node.args[0])
            if "vmdg" in target or (root.islower() and root not in foreign):
                yield f"line {node.lineno}: patches {target}"


def test_public_use():
    """Neither a private name nor a patched module of ours."""
    found = {path: list(liberties(ast.parse((ROOT / path).read_text()))) for path in USERS}
    assert not {path: texts for path, texts in found.items() if texts}
