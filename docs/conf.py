"""Sphinx: pages in MyST, API by autodoc, which imports (static readers cannot follow the one import name)."""

import re
from importlib import metadata
from typing import Any

project = "optolever"
author = "the optolever maintainers"
release = metadata.version("optolever")

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath"]
root_doc = "index"

html_theme = "furo"
html_title = "optolever"
autodoc_member_order = "bysource"


def paragraph(lines: list[str]) -> list[str]:
    """A paragraph of a docstring as reStructuredText: tables and columns stay as they are typed."""
    if lines[0].startswith(">>>"):
        return [*lines, ""]
    columns = any(line.startswith(("|", " ")) or re.search(r"\S {2,}\S", line) for line in lines)
    if columns:
        return ["::", "", *(f"    {line}" for line in lines), ""]
    return [*(re.sub(r"([|*\\])", r"\\\1", line) for line in lines), ""]


def plain_text(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are plain text with tables, no reStructuredText."""
    text = "\n".join(lines).strip("\n")
    parts = [part.split("\n") for part in re.split(r"\n\s*\n", text) if part]
    if what == "module":  # a face's table of files is for those who work on it
        parts = [part for part in parts if not part[0].startswith("|")]
    lines[:] = [line for part in parts for line in paragraph(part)]


def setup(app: Any) -> None:
    """Sphinx's hook."""
    app.connect("autodoc-process-docstring", plain_text)
