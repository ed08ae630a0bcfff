"""Writes the sources of the site: pages next to the code, the demos, the names of the API.

Nothing is written twice. Pages stay where they are; here they are taken apart at their headings
and their links are turned to pages of the site. The contents, ``index.md`` and its neighbours, say
in what order they stand, and Sphinx refuses a page that none of them lists.
"""

from __future__ import annotations

import ast
import json
import posixpath
import re
import shutil
from collections.abc import Iterator
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
DEMOS = ROOT / "demos"

#: Pages, by where they are in the site. README.md is the front page.
PAGES = {
    "index": "README.md",
    "install": "vmdg/INSTALL.md",
    "howto": "vmdg/HOWTO.md",
    "reference": "vmdg/GUIDE.md",
    "explanation": "vmdg/THEORY.md",
    "microstructure": "vmdg/MICROSTRUCTURE.md",
    "cluster": "vmdg/CLUSTER.md",
    "security": "vmdg/SECURITY.md",
    "glossary": "vmdg/GLOSSARY.md",
    "layout": "vmdg/README.md",
    "path": "vmdg/solver/README.md",
    "equations": "forms/README.md",
    "verification": "demos/ACCURACY.md",
    "speed": "demos/SPEED.md",
    "gallery": "demos/README.md",
    "contributing": ".github/CONTRIBUTING.md",
    "decisions": ".github/DECISIONS.md",
    "changes": ".github/CHANGELOG.md",
}

#: Pages that become one page for each of their headings, down to this level.
SPLIT = {"howto": 2, "reference": 3, "explanation": 2}

#: Modules for users, in the order of the API; names by ``__all__``, or all that are defined there.
MODULES = (
    "vmdg",
    "vmdg.laws",
    "vmdg.meshes",
    "vmdg.plot",
    "vmdg.forms.materials",
)

#: What the rooms of the public names are called in the API.
ROOMS = {
    "problem": "Problem, loads and energies",
    "interface": "Interfaces",
    "laws": "Interface laws",
    "forms": "Materials",
    "materials": "Materials with a history",
    "domain": "Groups of cells, random properties, orientations",
    "solver": "Runs",
    "output": "Results",
    "checkpoint": "Checkpoints",
    "linear": "Linear systems and stiffness of cells",
    "base": "Warnings",
}

HEADING = re.compile(r"(#+) +(.+?) *$")
LINK = re.compile(r"(!?)\[((?:[^\[\]]|!\[[^\]]*\]\([^)]*\))*)\]\(([^)\s]+)\)")
FENCE = re.compile(r" *(```|~~~)")


def slug(heading: str) -> str:
    """The anchor of a heading, as GitHub makes it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-")


def headings(text: str) -> Iterator[tuple[int, int, str]]:
    """Line, level and words of the headings of a page, those of code blocks apart."""
    fenced = False
    for i, line in enumerate(text.splitlines()):
        fenced ^= bool(FENCE.match(line))
        found = HEADING.match(line)
        if found and not fenced:
            yield i, len(found[1]), found[2]


def parts(page: str) -> dict[str, str]:
    """Text of every page that a page of ``PAGES`` becomes, by its place in the site.

    Args:
        page: Key of ``PAGES``.
    """
    lines = (ROOT / PAGES[page]).read_text().splitlines()
    if page not in SPLIT:
        return {page: "\n".join(lines) + "\n"}
    found = list(headings("\n".join(lines)))
    cuts = [(i, level, words) for i, level, words in found if 1 < level <= SPLIT[page]]
    made = {page: "\n".join(lines[: cuts[0][0]]) + "\n"}
    ends = [*(start for start, _, _ in cuts[1:]), len(lines)]
    for (start, level, title), end in zip(cuts, ends, strict=True):
        raised = lines[start:end]
        for i, below, words in headings("\n".join(raised)):
            raised[i] = "#" * (below - level + 1) + " " + words
        made[f"{page}/{slug(title)}"] = "\n".join(raised) + "\n"
    return made


def anchors() -> dict[str, str]:
    """Page and anchor of the site for every page and heading, by file and anchor."""
    known = {}
    for page, file in PAGES.items():
        for place, text in parts(page).items():
            for i, _, words in headings(text):
                below = f"#{slug(words)}" if i > 0 else ""
                known[f"{file}#{slug(words)}"] = f"/{place}.md{below}"
        known[file] = f"/{page}.md"
    for table in sorted((ROOT / "demos" / "gallery").glob("*.md")):
        known[f"demos/gallery/{table.name}"] = f"/tables/{table.name}"
    for demo in demos():
        known[str(demo.relative_to(ROOT))] = f"/demos/{demo.stem}.md"
    return known


def linked(text: str, file: str, known: dict[str, str]) -> str:
    """A page with links to pages of the site; those to other files become their names.

    Args:
        text: Of the page, or of a part.
        file: The page, relative to the checkout.
        known: What ``anchors`` gives.

    Raises:
        ValueError: a link leads to no file, or to no heading.
    """

    def turned(found: re.Match[str]) -> str:
        picture, words, target = found.groups()
        words = LINK.sub(turned, words)
        if re.match(r"[a-z]+:", target):
            return f"{picture}[{words}]({target})"
        path, _, anchor = target.partition("#")
        path = posixpath.normpath(posixpath.join(posixpath.dirname(file), path)) if path else file
        whole = f"{path}#{anchor}" if anchor else path
        if picture:
            return f"![{words}](/{path})"
        if whole in known:
            return f"[{words}]({known[whole]})"
        if anchor or not (ROOT / path).exists():
            raise ValueError(f"{file} links to {target}, which is no page and no heading of one")
        if words == path:
            return f"`{path}`"
        return words if "`" in words or "!" in words else f"{words} (`{path}`)"

    made, fenced = [], False
    block: list[str] = []
    for line in [*text.splitlines(), "```"]:
        if FENCE.match(line):
            if not fenced:
                made.append(LINK.sub(turned, "\n".join(block)) if block else None)
                block = []
            fenced = not fenced
            made.append(line)
        elif fenced:
            made.append(line)
        else:
            block.append(line)
    return "\n".join(part for part in made[:-1] if part is not None) + "\n"


def synonyms() -> dict[str, list[str]]:
    """Words of the glossary under which a reader may look for a page, by page of the site."""
    known = anchors()
    text = (ROOT / PAGES["glossary"]).read_text().split("\n## Other words\n")[1]
    found: dict[str, list[str]] = {}
    for line in text.splitlines():
        if line.startswith("* "):
            words, _, links = line[2:].rpartition(": ")
            for _, _, target in LINK.findall(links):
                path, _, anchor = target.partition("#")
                place = known[f"vmdg/{path}#{anchor}" if anchor else f"vmdg/{path}"]
                found.setdefault(place.partition("#")[0].lstrip("/"), []).extend(words.split(", "))
    return found


def demos() -> list[Path]:
    """Scripts that ``demos/run`` lists: examples and studies."""
    return sorted([*DEMOS.glob("*.py"), *DEMOS.glob("studies/*.py")])


def tutorial(demo: Path) -> bool:
    """Whether a demo is one that is read from top to bottom, which is a notebook too."""
    return demo.stem.startswith("tutorial")


def scenes() -> dict[str, list[tuple[str, str]]]:
    """Pictures and words of the gallery, by name of the demo that makes them."""
    rows: dict[str, list[tuple[str, str]]] = {}
    for line in (ROOT / PAGES["gallery"]).read_text().splitlines():
        found = re.match(r"\| !\[\]\((.+?)\) \| (`demos/run (?:-n \d+ )?(\w+)[^|]*) \|", line)
        if found:
            rows.setdefault(found[3], []).append((f"/demos/{found[1]}", found[2]))
    return rows


def docstring(script: Path) -> tuple[list[str], int]:
    """Lines of a script's docstring, and the line of the script behind it."""
    tree = ast.parse(script.read_text())
    return (ast.get_docstring(tree) or "").splitlines(), tree.body[0].end_lineno or 0


def title(first: str) -> str:
    """What a demo is called: the first words of its docstring.

    Args:
        first: Line of the docstring.
    """
    words = first.removeprefix("Tutorial: ")
    words = re.split(r"[:;.](?= |$)", words)[0]
    return words[0].upper() + words[1:]


def demo_page(demo: Path, known: dict[str, str]) -> str:
    """Page of a demo: its docstring, its pictures, the script, of a study its parts.

    Args:
        known: What ``anchors`` gives.
    """
    lines, behind = docstring(demo)
    text = "\n".join(lines).replace("``", "`")
    made = [f"# {title(lines[0])}", "", text, ""]
    shown = scenes().get(demo.stem, [])
    named = [path for path, _ in shown]
    taken = [path for rows in scenes().values() for path, _ in rows]
    own = sorted((ROOT / "demos" / "gallery").glob(f"{demo.stem}*.png"))
    others = [f"/{path.relative_to(ROOT)}" for path in own]
    rest = [(path, "") for path in others if path not in named and path not in taken]
    for path, words in [*shown, *rest]:
        alternative = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", words).replace("`", "")
        made += [f"![{alternative}]({path})", "", linked(words, PAGES["gallery"], known), ""]
    options = f"`demos/run {demo.stem} --help` lists its options."
    made += [
        "## The script",
        "",
        f"`{demo.relative_to(ROOT)}`; {options}",
        *[f"{{download}}`As a notebook </code/{demo.stem}.ipynb>`."] * tutorial(demo),
        "",
        *chapters(demo, behind),
        "",
    ]
    imports = re.findall(r"^from parts\.([\w.]+) import", demo.read_text(), re.MULTILINE)
    named = {f"studies/parts/{name.replace('.', '/')}.py" for name in imports}
    files = sorted(file for file in named if (DEMOS / file).is_file())  # packages have no text
    if files:
        made += ["## Parts", "", "What the script imports from its own folder.", ""]
    for file in files:
        made += [f":::{{dropdown}} demos/{file}", *code(file), ":::", ""]
    return "\n".join(made)


def code(file: str, first: int = 1, last: int | str = "", dedent: int = 0) -> list[str]:
    """A literal include of lines of a file.

    Args:
        file: Relative to the folder of demos.
        first: Line, from 1.
        last: Line, that one included; empty for the end.
        dedent: Columns.
    """
    options = [f":lines: {first}-{last}", ":language: python"]
    options += [f":dedent: {dedent}"] * bool(dedent)
    return [f"```{{literalinclude}} /code/{file}", *options, "```"]


def notebook(demo: Path) -> str:
    """A script as a Jupyter notebook: its docstring, its chapters, and a call of main at the end.

    Numbered comments within functions stay there.
    """
    said, behind = docstring(demo)
    lines = demo.read_text().splitlines()
    end = next(i for i, line in enumerate(lines) if line.startswith("if __name__"))
    cells = [("markdown", [f"# {title(said[0])}", "", *said])]
    piece: list[str] = []
    i = behind
    while i < end:
        found = re.match(r"# \d+\. (\w.*)", lines[i])
        if not found:
            piece.append(lines[i])
            i += 1
            continue
        cells.append(("code", piece))
        words, piece = [found[1]], []
        while lines[i := i + 1].startswith("# "):
            words.append(lines[i][2:])
        cells.append(("markdown", words))
    cells += [("code", piece), ("code", ["main()"])]
    made = []
    for kind, text in cells:
        source = "\n".join(text).strip("\n")
        if source:
            cell = {"cell_type": kind, "id": f"cell-{len(made)}", "metadata": {}, "source": source}
            made.append(cell | ({"execution_count": None, "outputs": []} if kind == "code" else {}))
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    whole = {"cells": made, "metadata": {"kernelspec": kernel}, "nbformat": 4, "nbformat_minor": 5}
    return json.dumps(whole, indent=1, ensure_ascii=False)


def chapters(demo: Path, behind: int) -> list[str]:
    """A script in the chapters that its comments number, "# 1. Geometry. ...", or in one piece.

    Args:
        demo: Script.
        behind: Its last line of the docstring.
    """
    lines = demo.read_text().splitlines()
    made: list[str] = []
    start = i = behind
    while i < len(lines):
        found = re.match(r" *# \d+\. (\w[^.:]*)([.:]) ?(.*)", lines[i])
        if not found:
            i += 1
            continue
        made += _piece(demo, lines, start, i)
        said = [found[3][:1].upper() + found[3][1:]]
        i += 1
        while i < len(lines) and lines[i].lstrip().startswith("# "):
            said.append(lines[i].lstrip()[2:])
            i += 1
        made += [f"### {found[1]}", "", *said, ""]
        start = i
    return made + _piece(demo, lines, start, len(lines))


def _piece(demo: Path, lines: list[str], start: int, end: int) -> list[str]:
    """Literal include of lines[start:end], without blank ones around."""
    filled = [i for i in range(start, end) if lines[i].strip()]
    if not filled:
        return []
    return [*code(str(demo.relative_to(DEMOS)), filled[0] + 1, filled[-1] + 1), ""]


def stub() -> dict[str, list[str]]:
    """Public names of ``vmdg/__init__.pyi``, by room."""
    names: dict[str, list[str]] = {}
    for line in ast.parse((ROOT / "vmdg" / "__init__.pyi").read_text()).body:
        if isinstance(line, ast.ImportFrom) and line.module:
            room = line.module.partition(".")[0]
            names.setdefault(room, []).extend(item.name for item in line.names)
    return names


def public(module: str) -> list[str]:
    """Names of a module below ``vmdg``: ``__all__``, or classes and functions defined there."""
    path = ROOT.joinpath(*module.split("."))
    file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
    tree = ast.parse(file.read_text())
    defined = []
    for node in tree.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return ast.literal_eval(node.value)
        if isinstance(node, ast.ClassDef | ast.FunctionDef) and node.name[0] != "_":
            defined.append(node.name)
    return defined


def aliases() -> dict[str, tuple[str, str]]:
    """Names of types that the engine gives itself: what each stands for, and its comment."""
    found: dict[str, tuple[str, str]] = {}
    for path in sorted((ROOT / "vmdg").glob("*/*.py")):
        lines = path.read_text().splitlines()
        for node in ast.parse("\n".join(lines)).body:
            if isinstance(node, ast.AnnAssign) and node.value:  # Value: TypeAlias = ...
                target = node.target
            elif isinstance(node, ast.Assign):
                target = node.targets[0]
            else:
                continue
            name, first = ast.unparse(target), node.lineno - 1
            if re.fullmatch("[A-Z][a-z]+[A-Za-z]*", name) and isinstance(
                node.value, ast.BinOp | ast.Subscript
            ):
                start = first
                while lines[start - 1].startswith("#:"):
                    start -= 1
                comment = " ".join(line[2:].strip() for line in lines[start:first])
                found.setdefault(name, (ast.unparse(node.value), comment))
    return found


def annotations() -> set[str]:
    """Words in the types of arguments and attributes of public names."""
    names = {name for names in stub().values() for name in names}
    names |= {name for module in MODULES[1:] for name in public(module)}
    words: set[str] = set()
    for path in (ROOT / "vmdg").glob("*/*.py"):
        for item in ast.parse(path.read_text()).body:
            if getattr(item, "name", None) not in names:
                continue
            members = item.body if isinstance(item, ast.ClassDef) else [item]
            for member in members:
                name = getattr(member, "name", "")
                if name.startswith("_") and name != "__init__":
                    continue
                for node in ast.walk(member):
                    if isinstance(node, ast.arg | ast.AnnAssign) and node.annotation:
                        words |= set(re.findall(r"\w+", ast.unparse(node.annotation)))
    return words


def types() -> list[str]:
    """Table of the types that arguments of public names have."""
    used = annotations()
    rows = []
    for name, (value, comment) in sorted(aliases().items()):
        if name in used and name != "Array":
            value, comment = value.replace("|", "\\|"), re.sub(r":\w+:", "", comment)
            rows.append(f"| {name} | `{value}` | {comment} |")
    return ["## Types of arguments", "", "| name | is one of | |", "|---|---|---|", *rows, ""]


def api() -> str:
    """Page of all public names, by room and by module."""
    made = ["# All public names", "", "Names of `vmdg` itself, then those of its modules.", ""]
    rooms = stub()
    order = [room for room in [*ROOMS, *sorted(rooms.keys() - ROOMS.keys())] if room in rooms]
    known = [name for names in rooms.values() for name in names]
    groups = [(ROOMS.get(room, room), "vmdg", rooms[room]) for room in order]
    for module in MODULES[1:]:
        names = [name for name in public(module) if name not in known]
        groups.append((f"`{module}`", module, names))
    for words, module, names in groups:
        made += [f"## {words}", "", "```{eval-rst}"]
        if module != "vmdg":
            made += [f".. automodule:: {module}", "   :no-members:", ""]
        made += [".. autosummary::", "   :toctree: names", "   :nosignatures:", ""]
        made += [f"   {module}.{name}" if module == "vmdg" else f"   {name}" for name in names]
        made += ["```", ""]
    return "\n".join([*made, *types()])


def sources() -> dict[str, str]:
    """Text of all pages of the site, by path below the folder of sources."""
    known = anchors()
    made = {}
    for page, file in PAGES.items():
        for place, text in parts(page).items():
            made[f"{place}.md"] = linked(text, file, known)
    for table in sorted((ROOT / "demos" / "gallery").glob("*.md")):
        text = linked(table.read_text(), f"demos/gallery/{table.name}", known)
        made[f"tables/{table.name}"] = text
    for demo in demos():
        made[f"demos/{demo.stem}.md"] = demo_page(demo, known)
    made["api.md"] = api()
    for contents in sorted(HERE.glob("*.md")):
        before = made.get(contents.name, "")
        made[contents.name] = before + "\n" * bool(before) + contents.read_text()
    for name, words in synonyms().items():  # main entries of the index come first in a search
        entries = ", ".join(f"! {word}" for word in words)
        made[name] = made[name].rstrip("\n") + f"\n\n```{{index}} {entries}\n```\n"
    return made


def write(folder: Path) -> None:
    """Write all sources.

    Args:
        folder: For the sources; new.
    """
    for name, text in sources().items():
        file = folder / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    shutil.copytree(
        DEMOS / "gallery",
        folder / "demos" / "gallery",
        ignore=shutil.ignore_patterns("*.md", "*.csv"),
    )
    shutil.copytree(DEMOS / "studies", folder / "code" / "studies")
    for demo in DEMOS.glob("*.py"):
        shutil.copy(demo, folder / "code")
        if tutorial(demo):
            (folder / "code" / f"{demo.stem}.ipynb").write_text(notebook(demo))
