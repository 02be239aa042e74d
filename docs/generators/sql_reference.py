"""The reference part of docs/sql.md, made from the views and macros (`python -m docs.generators.sql_reference`)."""

from __future__ import annotations

from pathlib import Path

from docs.generators.markdown_tables import table
from kinedex.catalog.sql.macros import Macro
from kinedex.catalog.sql.views import MACROS, VIEWS, View

BEGIN, END = "<!-- the reference begins: python -m docs.generators.sql_reference -->", "<!-- the reference ends -->"
ORIGINS = {
    "index": "Views of the index",
    "parts": "Frames",
    "derived": "Classes",
    "labels": "Labels",
    "pipelines": "Runs of pipelines",
    "results": "Results of stages",
}


def reference() -> str:
    """Return the reference as Markdown: every macro and view, with arguments or columns and an example."""
    parts = ["## Macros\n"]
    parts += [_macro(macro) for macro in MACROS]
    for origin, title in ORIGINS.items():
        parts.append(f"## {title}\n")
        parts += [_view(view) for view in VIEWS if view.origin == origin]
    return "\n".join(parts)


def renewed(page: str) -> str:
    """Return a page with a new reference between its two marks."""
    before, rest = page.split(BEGIN)
    after = rest.split(END)[1]
    return f"{before}{BEGIN}\n\n{reference()}\n{END}{after}"


def _macro(macro: Macro) -> str:
    rows = [
        (f"`{name}`", meaning if default is None else f"{meaning} (default {default})")
        for name, default, meaning in macro.arguments
    ]
    kind = "Stands in FROM." if macro.table else "An expression."
    return f"### {macro.signature}\n\n{macro.summary} {kind}\n\n{table(('argument', 'meaning'), rows)}\n{_sql(macro)}"


def _view(view: View) -> str:
    rows = [(f"`{column.name}`", column.type, column.meaning) for column in view.columns]
    return f"### {view.name}\n\n{view.summary}\n\n{table(('column', 'type', 'meaning'), rows)}\n{_sql(view)}"


def _sql(entry: View | Macro) -> str:
    return f"```sql\n{entry.example};\n```\n"


if __name__ == "__main__":
    file = Path(__file__).resolve().parents[2] / "docs" / "sql.md"
    file.write_text(renewed(file.read_text(encoding="utf-8")), encoding="utf-8")
