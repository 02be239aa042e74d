"""Answers about the quality of an archive: suspect takes, warnings, duplicates, and files that ingest excluded.

GET /api/quality → {figures: [{figure, meaning, unit, low, high, advice, takes}], warnings: [{warning, takes}],
                    invalid: {takes, frames}, command, python}
GET /api/flags → {flags: {take_id: [text]}, total}: figures beyond their limits, take by take
GET /api/duplicates → {searched, rows: [{take, of_take, same, start, stop, share, mirrored, …}], total, …}
GET /api/excluded → {rows: [{source, file, line, error, message}], total, …}
"""

from __future__ import annotations

from typing import Any

from starlette.requests import Request

from kinedex.catalog.quality_figures import FIGURES
from kinedex.explorer.answers import command_line, equivalent_query
from kinedex.explorer.endpoints import get
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import SQL_SECONDS

ROWS = 2000
"""Maximum number of rows of one answer; `total` counts all."""

FLAGS = 50_000
"""Maximum number of figures beyond their limits, of all takes together, in one answer."""

_SUSPECT = (
    "SELECT figure, any_value(meaning) AS meaning, any_value(unit) AS unit, any_value(low) AS low, "
    "any_value(high) AS high, count(*) AS takes FROM suspect_takes GROUP BY figure ORDER BY takes DESC, figure"
)
_FLAGS = "SELECT take_id, meaning, value, unit, low, high FROM suspect_takes ORDER BY take_id, figure"
_WARNINGS = (
    "SELECT warning, count(*) AS takes FROM (SELECT unnest(warnings) AS warning FROM takes) "
    "GROUP BY warning ORDER BY takes DESC, warning"
)
_INVALID = "SELECT count(*) AS takes, coalesce(sum(invalid_frames), 0) AS frames FROM takes WHERE invalid_frames > 0"
_DUPLICATES = "SELECT * FROM duplicates ORDER BY take, of_take, start"
_EXCLUDED = "SELECT source, file, line, error, message, logged_at FROM ingest_log ORDER BY source"


def quality(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return how many takes exceed each limit of quality, have each warning, and have invalid frames."""
    store = archive.store()
    advice = {figure.name: figure.advice for figure in FIGURES}
    figures = store.answer(_SUSPECT, timeout=SQL_SECONDS).table.to_pylist()
    warnings = store.answer(_WARNINGS, timeout=SQL_SECONDS, max_rows=ROWS)
    return {
        "figures": [{**row, "advice": advice.get(row["figure"], "")} for row in figures],
        "warnings": warnings.table.to_pylist(),
        "invalid": store.answer(_INVALID, timeout=SQL_SECONDS).table.to_pylist()[0],
        **equivalent_query(archive, "SELECT * FROM suspect_takes"),
    }


def flags(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return, for each take, the figures that are beyond their limits."""
    found = archive.store().answer(_FLAGS, timeout=SQL_SECONDS, max_rows=FLAGS)
    texts: dict[str, list[str]] = {}
    for row in found.table.to_pylist():
        ends = [f"{row[key]:g}" if row[key] is not None else "" for key in ("low", "high")]
        limits = f"{ends[0]} to {ends[1]}" if all(ends) else f"at least {ends[0]}" if ends[0] else f"at most {ends[1]}"
        unit = f" {row['unit']}" if row["unit"] else ""
        texts.setdefault(str(row["take_id"]), []).append(
            f"{row['meaning']}: {row['value']:.3g}{unit}, expected {limits}{unit}"
        )
    return {"flags": texts, "total": found.rows}


def duplicates(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return the takes that contain the motion of other takes, as found by `kinedex duplicates`."""
    store = archive.store()
    found = store.answer(_DUPLICATES, timeout=SQL_SECONDS, max_rows=ROWS)
    return {
        "searched": any(part for part in store.manifest.results.get("duplicates", ())),
        "rows": found.table.to_pylist(),
        "total": found.rows,
        "command": command_line("kinedex", "duplicates", archive.path),
        "python": equivalent_query(archive, _DUPLICATES)["python"],
    }


def excluded(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return the source files that the last ingest excluded, with the reasons."""
    found = archive.store().answer(_EXCLUDED, timeout=SQL_SECONDS, max_rows=ROWS)
    return {"rows": found.table.to_pylist(), "total": found.rows, **equivalent_query(archive, _EXCLUDED)}


routes = [
    get("/api/quality", quality),
    get("/api/flags", flags),
    get("/api/duplicates", duplicates),
    get("/api/excluded", excluded),
]
