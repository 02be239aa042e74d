"""Configuration of the site (`make docs`): these pages and the API reference; nothing is fetched when it is read."""

from __future__ import annotations

import inspect
import re
import tomllib
from pathlib import Path
from typing import Any

from sphinx.application import Sphinx

import kinedex

ROOT = Path(__file__).resolve().parents[1]

project = "kinedex"
author = "the kinedex authors"
project_copyright = "the kinedex authors, Apache-2.0"
release = version = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["version"]
root_doc = "README"
exclude_patterns = ["conf.py", "generators"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc"]
myst_heading_anchors = 4
myst_links_external_new_tab = False
suppress_warnings = ["myst.header"]
default_role = "code"  # docstrings write names in single backticks
autosummary_generate = True
autodoc_typehints = "none"  # numpydoc's sections state the types
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_title = f"kinedex {release}"
html_show_sourcelink = False
html_copy_source = False
pygments_style = "friendly"

CONTENTS = re.compile(r"^\*\*([\w ]+)\*\*.*\n((?:- .*\n(?:  .*\n)*)+)", re.MULTILINE)
OUTSIDE = re.compile(r"\[([^\]]*)\]\((?:\.\./)+([^)]*)\)")


def with_contents(app: Sphinx, name: str, source: list[str]) -> None:
    """Add the navigation to the index: what its lists link to, in their order, and the API reference."""
    if name != root_doc:
        return
    trees = []
    for caption, entries in CONTENTS.findall(source[0]):
        pages = re.findall(r"\]\(([\w/-]+)\.md\)", entries)
        trees.append(f"```{{toctree}}\n:hidden:\n:caption: {caption}\n\n" + "\n".join(pages) + "\n```\n")
    source[0] += "\n" + "\n".join(trees)


def with_names(app: Sphinx, name: str, source: list[str]) -> None:
    """Fill the page of the API with the public names: functions first, then classes, then errors."""
    if name != "api":
        return
    public = {name: getattr(kinedex, name) for name in sorted(kinedex.__all__)}
    classes = {name for name, one in public.items() if isinstance(one, type)}
    errors = {name for name in classes if issubclass(public[name], Exception)}
    parts = []
    for title, names in (("Functions", set(public) - classes), ("Classes", classes - errors), ("Errors", errors)):
        lines = [f"## {title}\n\n```{{eval-rst}}"]
        for name in sorted(names):
            if inspect.isclass(public[name]):
                lines.append(f".. autoclass:: kinedex.{name}\n   :members:\n")
            elif callable(public[name]):
                lines.append(f".. autofunction:: kinedex.{name}\n")
        parts.append("\n".join([*lines, "```\n"]))
    source[0] = source[0].replace("<!-- names -->", "\n".join(parts))


def outside_links(app: Sphinx, name: str, source: list[str]) -> None:
    """Leave of links to files of the repository that are no pages their text: the site does not have these files."""
    depth = name.count("/") + 1

    def unlinked(found: re.Match[str]) -> str:
        return found[1] if found[0].count("../") >= depth else found[0]

    source[0] = OUTSIDE.sub(unlinked, source[0])


def with_index(app: Sphinx, fault: Exception | None) -> None:
    """Copy the first page to the name that web servers ask for."""
    if fault is None and app.builder.name == "html":
        first = Path(app.outdir) / f"{root_doc}.html"
        (Path(app.outdir) / "index.html").write_text(first.read_text(encoding="utf-8"), encoding="utf-8")


def setup(app: Sphinx) -> dict[str, Any]:
    """Register the changes of the sources."""
    app.connect("source-read", with_contents)
    app.connect("source-read", with_names)
    app.connect("source-read", outside_links)
    app.connect("build-finished", with_index)
    return {"parallel_read_safe": True}
