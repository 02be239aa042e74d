"""Why an interval is of a class, by quantities: `GET /api/takes/ID/explain?start=S&stop=S&class=NAME`.

→ {take, label, other, probability, other_probability, evidence, reasons: [{speaks, text, quantity, unit, value, low,
   high, other_low, other_high, below, share}], command, python}; without `class`, it is the most probable one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from kinedex.explorer.answers import command_line, python_lines
from kinedex.explorer.endpoints import get, take_of
from kinedex.explorer.motion import check_interval, name_of, whole_number
from kinedex.ops.cache import Cache
from kinedex.ops.intervals import Interval
from kinedex.reports.class_explanations import DescribedLabels, described_labels, explain_interval, reasons_table

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.open_archive import Archive

Row = dict[str, Any]

_DESCRIBED: Cache[tuple[str, str], DescribedLabels] = Cache(2)
"""The described labels of a store in a state of its takes and labels."""


def explain_class(archive: Archive, request: Request) -> Row:
    """Return the quantities that speak for the class of an interval, or against it."""
    store, take_id = take_of(archive, request)
    take = name_of(store, take_id)
    interval = whole_number(request, "start"), whole_number(request, "stop")
    check_interval(store, Interval(take, *interval), "the interval")
    label = request.query_params.get("class") or None
    key = (str(archive.path), str(archive.state()["labels"]))
    taught = _DESCRIBED.get(key) or _DESCRIBED.put(key, described_labels(store))
    found = explain_interval(store, taught, take, interval, label)
    words = [take, *map(str, interval), *(["--class", label] if label else [])]
    python = f"store.explain({take!r}, {interval[0]}, {interval[1]}{f', label={label!r}' if label else ''})"
    return {
        "take": take,
        **{name: value for name, value in found._asdict().items() if name != "reasons"},
        "reasons": reasons_table(found).to_pylist(),
        "command": command_line("kinedex", "explain", archive.path, *words),
        "python": python_lines(archive.path, python),
    }


routes = [get("/api/takes/{take:int}/explain", explain_class)]
