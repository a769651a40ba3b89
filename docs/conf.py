"""Sphinx: the documentation as a site that opens offline (`make docs`)."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import jupytext

import fascicle

REPOSITORY = Path(__file__).resolve().parents[1]
NOTEBOOKS = REPOSITORY / "build" / "notebooks"
EXAMPLES = ("simulate_and_pace.py", "learn_and_predict.py")

project = "fascicle"
author = "the authors of fascicle"
release = fascicle.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["figures"]
html_theme = "furo"
html_title = f"fascicle {release}"
html_extra_path = [str(NOTEBOOKS)]
html_show_copyright = False
smartquotes = False  # options keep their two dashes
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # pages begin with what a reader needs, whatever its level
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # types and units stand in the docstrings
napoleon_google_docstring = False
napoleon_use_rtype = False
# names that docstrings put into `single quotes` are code
default_role = "code"


def write_notebooks() -> None:
    """Make notebooks, without output, of the examples."""
    NOTEBOOKS.mkdir(parents=True, exist_ok=True)
    for name in EXAMPLES:
        notebook = jupytext.read(REPOSITORY / "examples" / name)
        jupytext.write(notebook, (NOTEBOOKS / name).with_suffix(".ipynb"))


def benchmark_list() -> str:
    """What each benchmark says of itself, as Markdown."""
    parts = []
    for path in sorted((REPOSITORY / "benchmarks").glob("*.py")):
        text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
        if "python -m" in text:
            title, _, rest = text.partition("\n\n")
            parts.append(f"## {path.stem}\n\n{title}\n\n{rest}\n")
    return "\n".join(parts)


def insert_benchmarks(app: Any, page: str, source: list[str]) -> None:
    """Fill the page of benchmarks."""
    if page == "benchmarks":
        source[0] += "\n" + benchmark_list()


def setup(app: Any) -> None:
    write_notebooks()
    app.connect("source-read", insert_benchmarks)
