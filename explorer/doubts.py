"""Doubts about files, grouped by cause: refusals, warnings and guesses, and the acceptance of those about takes.

GET /api/doubts → {causes: [{kind, cause, files, accepted}], total, command, python}
POST /api/doubts/files {kind, cause} → {rows: [{source_root, source, take, message, accepted}], total, command, python}
POST /api/doubts/accept {kind, cause, takes?: [name], revoke?} → {changed, command}: of all takes unless some are given
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field
from starlette.requests import Request

from kinedex.explorer.answers import command_line, equivalent_query
from kinedex.explorer.endpoints import RequestBody, get, post
from kinedex.explorer.named_files import PATIENCE
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import SQL_SECONDS
from kinedex.storage.duckdb_sql import quote
from kinedex.storage.store.accepted_doubts import accept_doubts, chosen_doubts
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter

ROWS = 2000
"""Maximum number of rows of one answer; `total` counts all."""

_CAUSES = (
    "SELECT kind, cause, count(*) AS files, count(*) FILTER (accepted) AS accepted FROM doubts GROUP BY kind, cause "
    "ORDER BY list_position(['refused', 'guessed', 'warned'], kind), files DESC, cause"
)


class CauseRequest(RequestBody):
    """The doubts of one cause."""

    kind: Literal["refused", "warned", "guessed"]
    cause: Annotated[str, Field(max_length=10_000)]

    @property
    def condition(self) -> str:
        """The SQL condition that selects these doubts in the view `doubts`."""
        return f"kind = {quote(self.kind)} AND cause = {quote(self.cause)}"


class AcceptRequest(CauseRequest):
    """Doubts about takes to accept, those of all takes unless some are named."""

    takes: Annotated[tuple[str, ...], Field(max_length=ROWS)] = ()
    revoke: bool = False


def list_causes(archive: Archive, _request: Request) -> dict[str, Any]:
    """Return the causes of doubts, refusals first, with the numbers of doubts in all and of accepted ones."""
    found = archive.store().answer(_CAUSES, timeout=SQL_SECONDS, max_rows=ROWS)
    return {"causes": found.table.to_pylist(), "total": found.rows, **equivalent_query(archive, _CAUSES)}


def list_files(archive: Archive, asked: CauseRequest, _request: Request) -> dict[str, Any]:
    """Return the files and takes with a doubt of one cause, those that are not accepted first."""
    text = (
        f"SELECT source_root, source, take, message, accepted FROM doubts WHERE {asked.condition} "
        "ORDER BY accepted, source, take"
    )
    found = archive.store().answer(text, timeout=SQL_SECONDS, max_rows=ROWS)
    return {"rows": found.table.to_pylist(), "total": found.rows, **equivalent_query(archive, text)}


def accept(archive: Archive, asked: AcceptRequest, _request: Request) -> dict[str, Any]:
    """Accept the doubts of one cause, or take their acceptance back."""
    store = open_store(archive.path)
    doubts = chosen_doubts(store, asked.takes, asked.condition)
    with StoreWriter.open(store.path, store.feature_set, store.rate_hz, PATIENCE) as writer:
        changed = accept_doubts(writer, doubts, revoke=asked.revoke)
        writer.commit()
    archive.state(look=True)
    revoke = ["--revoke"] if asked.revoke else []
    words: list[str | Path] = [
        "kinedex",
        "takes",
        "accept",
        archive.path,
        *asked.takes,
        "--where",
        asked.condition,
        *revoke,
    ]
    return {"changed": changed, "command": command_line(*words)}


routes = [
    get("/api/doubts", list_causes),
    post("/api/doubts/files", list_files, CauseRequest),
    post("/api/doubts/accept", accept, AcceptRequest, writes=True),
]
