"""How large the source is: lines, modules, constants, raised errors and public names.

    python tools/source_size.py [CHECKOUT]

Counts the Python files of `src` and `tests` and prints each figure beside the most that the
project allows itself. A constant is a name in capitals that a module binds; a public function or
class stands in a module and has no leading underscore.
"""

from __future__ import annotations

import ast
import sys
from collections import Counter
from pathlib import Path

# What is counted: the most there should be
AIMS = {
    "lines of source": 33_000,
    "modules": 240,
    "module constants": 500,
    "raised errors": None,
    "public functions and classes": None,
    "lines of tests": 26_000,
}


def lines_of(folder: Path) -> int:
    return sum(len(file.read_text("utf-8").splitlines()) for file in folder.rglob("*.py"))


def constants(module: ast.Module) -> int:
    """Names in capitals that a module binds, one each where a tuple binds several."""
    targets: list[ast.expr] = []
    for statement in module.body:
        if isinstance(statement, ast.Assign):
            targets += statement.targets
        elif isinstance(statement, ast.AnnAssign):
            targets.append(statement.target)
    names = (n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name))
    return sum(name.isupper() for name in names)


def sizes(checkout: Path) -> Counter[str]:
    files = [*(checkout / "src").rglob("*.py")]
    found = Counter(
        {
            "lines of source": lines_of(checkout / "src"),
            "modules": len(files),
            "lines of tests": lines_of(checkout / "tests"),
        }
    )
    for file in files:
        module = ast.parse(file.read_text("utf-8"))
        found["module constants"] += constants(module)
        found["raised errors"] += sum(isinstance(node, ast.Raise) for node in ast.walk(module))
        for node in module.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                found["public functions and classes"] += not node.name.startswith("_")
    return found


def main() -> None:
    checkout = Path(sys.argv[1] if len(sys.argv) > 1 else Path(__file__).parents[1])
    found = sizes(checkout)
    if not found["modules"]:
        sys.exit(f"{checkout}: no Python file in src; give a checkout of fascicle")
    for what, aim in AIMS.items():
        line = f"{what:30}{found[what]:8,}"
        if aim is not None:
            line += f"   at most {aim:,}{'' if found[what] <= aim else ': NOT MET'}"
        print(line)


if __name__ == "__main__":
    main()
