"""Count what the source asks a reader to learn, and how plain its names are.

    python tools/plain_names.py [CHECKOUT]

Counts the Python files of `src` and `tests` by their syntax trees, prints each figure beside the
most that the project allows itself, and ends with status 1 if one is above. With `--list` it prints
where each vague name, docstring, repeated class and constant is.

A vague name is a use of a local variable or argument of `VAGUE`. A docstring is vague if it begins
with a word of `VAGUE_FIRST`: its subject should be the thing itself. Levels of imports are those
among the modules of one folder. A constant is a name in
capitals that a module binds; two of one name with other values have several meanings.
"""

from __future__ import annotations

import argparse
import ast
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import NamedTuple

VAGUE = {
    *("found", "each", "given", "known", "one", "own", "there", "said", "what", "asked", "wanted"),
    *("told", "taken", "gone", "tried", "ones", "those", "others", "every", "everything"),
    *("something", "anything", "whole", "rest", "now", "then", "here", "same", "seen", "made"),
    *("again",),
}
VAGUE_FIRST = re.compile(
    r"(The same|Those|These|This|That|It|Its|They|What|How|Where|Which|Who|Whose|When|Such|Each|One"
    r"|Ones|All that|Same)\b"
)
# The most there should be of each; what is above its aim may only fall (aim in brackets)
LIMITS = {
    "lines of source": 48_120,  # 40,500
    "modules": 214,
    "most modules in a folder": 20,
    "most levels of imports in a folder": 8,
    "lines of tests": 37_475,  # 29,000
    "vague local names per 1000 lines": 8.0,
    "vague docstrings (%)": 1.0,
    "class names used twice": 0,
    "constant names with several meanings": 0,
    "function names per 1000 lines": 41.7,  # 36
    "module constants": 250,
}


class Place(NamedTuple):
    """A line of a file, and what is there."""

    file: Path
    line: int
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.text}"


def line_count(folder: Path) -> int:
    return sum(len(file.read_text("utf-8").splitlines()) for file in folder.rglob("*.py"))


def vague_names(file: Path, module: ast.Module) -> Iterator[Place]:
    for node in ast.walk(module):
        if isinstance(node, ast.Name) and node.id in VAGUE:
            yield Place(file, node.lineno, node.id)


def docstrings(file: Path, module: ast.Module) -> Iterator[Place]:
    for node in ast.walk(module):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            text = ast.get_docstring(node)
            if text is not None:
                line = 1 if isinstance(node, ast.Module) else node.lineno
                yield Place(file, line, text.partition("\n")[0])


def constants(file: Path, module: ast.Module) -> Iterator[tuple[str, Place]]:
    """Names in capitals that a module binds, with what they are bound to."""
    for statement in module.body:
        if isinstance(statement, ast.Assign):
            targets: list[ast.expr] = statement.targets
        elif isinstance(statement, ast.AnnAssign):
            targets = [statement.target]
        else:
            continue
        bound = "" if statement.value is None else ast.unparse(statement.value)
        for node in (node for target in targets for node in ast.walk(target)):
            if isinstance(node, ast.Name) and node.id.isupper():
                yield node.id, Place(file, statement.lineno, f"{node.id} = {bound}")


def levels(folder: list[Path], modules: dict[Path, ast.Module]) -> int:
    """Longest chain of imports among the modules of a folder."""
    inside = {file.stem: file for file in folder}
    package = folder[0].parent.name

    @cache
    def level(file: Path) -> int:
        imported: set[str] = set()
        for node in ast.walk(modules[file]):
            if isinstance(node, ast.ImportFrom) and node.module is not None:
                above, _, name = node.module.rpartition(".")
                if above.endswith(package):
                    imported.add(name)
                elif name == package:  # from fascicle.study import paper
                    imported |= {alias.name for alias in node.names}
        return 1 + max((level(inside[name]) for name in imported & {*inside}), default=0)

    return max(map(level, folder))


def counted(checkout: Path) -> tuple[dict[str, float], dict[str, list[Place]]]:
    """Figures of a checkout, and the places that count against it."""
    files = sorted((checkout / "src").rglob("*.py"))
    if not files:
        sys.exit(f"{checkout}: no Python file in src; give a checkout of fascicle")
    places: dict[str, list[Place]] = defaultdict(list)
    bound: dict[str, list[Place]] = defaultdict(list)
    classes: dict[str, list[Place]] = defaultdict(list)
    functions: Counter[str] = Counter()
    described = 0
    modules = {file: ast.parse(file.read_text("utf-8")) for file in files}
    folders: dict[Path, list[Path]] = defaultdict(list)
    for file, module in modules.items():
        if file.name != "__init__.py":
            folders[file.parent].append(file)
        places["vague local names per 1000 lines"] += vague_names(file, module)
        for place in docstrings(file, module):
            described += 1
            if VAGUE_FIRST.match(place.text):
                places["vague docstrings (%)"].append(place)
        for name, place in constants(file, module):
            bound[name].append(place)
        for node in ast.walk(module):
            if isinstance(node, ast.ClassDef):
                classes[node.name].append(Place(file, node.lineno, f"class {node.name}"))
            elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                functions[node.name] += 1
    for several in classes.values():
        places["class names used twice"] += several[1:]
    for several in bound.values():
        if len({place.text for place in several}) > 1:
            places["constant names with several meanings"] += several[1:]
    lines = line_count(checkout / "src")
    figures = {
        "lines of source": lines,
        "modules": len(files),
        "most modules in a folder": max(map(len, folders.values())),
        "most levels of imports in a folder": max(levels(f, modules) for f in folders.values()),
        "lines of tests": line_count(checkout / "tests"),
        "function names per 1000 lines": 1000 * len(functions) / lines,
        "module constants": sum(map(len, bound.values())),
    }
    for name in ("class names used twice", "constant names with several meanings"):
        figures[name] = len(places[name])
    name, docstring = "vague local names per 1000 lines", "vague docstrings (%)"
    figures[name] = 1000 * len(places[name]) / lines
    figures[docstring] = 100 * len(places[docstring]) / max(described, 1)
    return figures, places


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("checkout", nargs="?", type=Path, default=Path(__file__).parents[1])
    parser.add_argument("--list", action="store_true", help="print every place")
    arguments = parser.parse_args()
    figures, places = counted(arguments.checkout)
    if arguments.list:
        for name, several in places.items():
            print(name, *several, sep="\n  ")
    above = 0
    for name, limit in LIMITS.items():
        figure = figures[name]
        shown = f"{figure:,.1f}" if isinstance(figure, float) else f"{figure:,}"
        print(f"{name:38}{shown:>10}   at most {limit:,}{': NOT MET' if figure > limit else ''}")
        above += figure > limit
    sys.exit(1 if above else 0)


if __name__ == "__main__":
    main()
