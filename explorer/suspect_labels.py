"""The labels that are probably wrong: `POST /api/labels/suspects`, the most suspect first, with what fits better.

{classes?: [name], takes?: [name], where?: SQL over suspects, offset, limit ≤ 100}
→ {judged, total, remarks: [text], offset, command, python, rows: [{take_id, take, class, start, stop, suspicion,
   probability, kind, proposal, new_class, new_start, new_stop, rate_factor, source, id}]}
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

from pydantic import Field

from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import RequestBody, post
from kinedex.library.label_suspects import Suspects, label_suspects
from kinedex.ops.cache import Cache
from kinedex.pipelines.labels.row_selection import RowSelection, selected_rows

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.open_archive import Archive

Row = dict[str, Any]

BLOCK = 100
"""Maximum number of labels of one answer."""

_FOUND: Cache[tuple[str, str], Suspects] = Cache(2)
"""The suspects of a store in a state of its takes and labels."""


class SuspectsRequest(RequestBody):
    """A request for a block of the suspects."""

    classes: tuple[str, ...] = ()
    takes: tuple[str, ...] = ()
    where: str | None = None
    offset: Annotated[int, Field(ge=0)] = 0
    limit: Annotated[int, Field(ge=0, le=BLOCK)] = 20


def suspect_labels(archive: Archive, asked: SuspectsRequest, _request: Request) -> Row:
    """Return a block of the labels that are probably wrong."""
    key = (str(archive.path), str(archive.state()["labels"]))
    found = _FOUND.get(key) or _FOUND.put(key, label_suspects(archive.store()))
    where = (asked.where or "").strip() or None
    chosen = RowSelection(asked.takes, asked.classes, where=where, every=True)
    rows = selected_rows(found.rows, chosen, "suspect", keep_order=True)
    given = [word for take in asked.takes for word in ("--take", take)]
    given += [word for name in asked.classes for word in ("--class", name)]
    given += ["--where", where] if where else []
    python = f"store.labels.suspects({where!r})" if where else "store.labels.suspects()"
    return {
        "judged": found.judged,
        "total": rows.height,
        "remarks": list(found.remarks),
        "offset": asked.offset,
        "rows": rows.slice(asked.offset, asked.limit).to_dicts(),
        "command": command_line("kinedex", "labels", "suspects", archive.path, *given),
        "python": python_lines(archive.path, python),
    }


routes = [post("/api/labels/suspects", suspect_labels, SuspectsRequest)]
