"""Write the record of a data set: `metadata.csv`, one row per clip, and `dataset.json`, which adds how it was made."""

from __future__ import annotations

import json
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import date, datetime
from pathlib import Path
from typing import Any

from kinedex.ops.intervals import in_seconds
from kinedex.pipelines.export.clip_batches import Done, frames_at, source_frames
from kinedex.pipelines.export.request import FILE_FORMATS, ClipOptions, IntervalSource
from kinedex.storage.formats.csv_tables import csv_line
from kinedex.storage.formats.data_set_folder import CLIPS, FORMAT
from kinedex.storage.snapshot.manifest import kinedex_version, running_command
from kinedex.storage.store.store import Store

_LICENCES = ("licence", "license")

_DESCRIBING = ("pattern", "metadata")
"""The origins of columns with metadata from users: named groups of paths, and tables of metadata."""

_MEASURED = ("height_m",)
"""The measured columns of takes that are useful metadata of a clip; the others rate whole takes (`suspect_takes`)."""

_DIGITS = 4
"""The number of decimals of numbers that kinedex has computed."""


@dataclass(frozen=True)
class Facts:
    """The facts about an export that the record of the data set contains besides the clips.

    Attributes
    ----------
    store : Store
        The store.
    what : IntervalSource
        The requested intervals.
    how : ClipOptions
        The format and processing of the clips.
    excluded : dict of str to str
        File of a clip that could not be written → the reason.
    remarks : tuple of str
        Remarks on excluded intervals and clips.
    """

    store: Store
    what: IntervalSource
    how: ClipOptions
    excluded: Mapping[str, str]
    remarks: tuple[str, ...]


def metadata_rows(facts: Facts, done: Sequence[Done]) -> list[dict[str, Any]]:
    """Return the rows of `metadata.csv`: one for each clip, with columns of the clip followed by those of its take.

    Columns of the take are those filled by named groups of paths and by tables of metadata, and the height. If a column
    of takes or of the SQL query has the name of another column, it gets the prefix `take_` or `sql_`.

    Parameters
    ----------
    facts : Facts
        The store and the request.
    done : sequence of Done
        The clips that were written.
    """
    return [_row(facts, one) for one in done]


def _row(facts: Facts, done: Done) -> dict[str, Any]:
    job, store, how = done.job, facts.store, facts.how
    clip, take, interval = job.clip, job.row, job.clip.interval
    first, last = source_frames(take, clip.first, clip.last)
    inner = source_frames(take, clip.start, clip.stop)
    own = float(take["source_rate_hz"]) if job.channels else store.rate_hz
    outer, meant = ((first, last), inner) if job.channels else ((clip.first, clip.last), (clip.start, clip.stop))
    rate = how.rate_hz or own
    count = frames_at(outer[1] - outer[0], own, rate)
    edges = [min(count, round((edge - outer[0]) * rate / own)) for edge in meant]
    record = store.manifest.stages.get(interval.stage or "")
    row: dict[str, Any] = {
        "file": done.files[0].file,
        "sha256": done.files[0].sha256,
        "split": None if clip.folder == CLIPS else clip.folder,
        "class": clip.label,
        "take": clip.take,
        "start": clip.start,
        "stop": clip.stop,
        "seconds": round(in_seconds(clip.stop - clip.start, store.rate_hz), 6),
        "mirrored": clip.mirrored,
        "rate_hz": rate,
        "frames": count,
        "inner_start": edges[0],
        "inner_stop": edges[1],
        "outer_start": clip.first,
        "outer_stop": clip.last,
        "confidence": _rounded(interval.confidence),
        "actor": take["actor"],
        "licence": next((take[name] for name in take if name.lower() in _LICENCES), None),
        "origin": interval.origin,
        "stage": interval.stage,
        "run": interval.run,
        "pipeline_run": getattr(record, "pipeline_run", None) or None,
        "from": "channels" if job.channels else "joints",
        "source": take["source"],
        "source_sha256": take["checksum"],
        "source_start": inner[0],
        "source_stop": inner[1],
    }
    declared = store.manifest.columns.items()
    more = {
        name: take[name]
        for name, column in declared
        if name.lower() not in _LICENCES and (column.origin in _DESCRIBING or name in _MEASURED)
    }
    for prefix, columns in (("take_", more), ("sql_", interval.more)):
        for name, value in columns.items():
            # JSON cannot represent NaN and infinity
            unknown = isinstance(value, float) and not math.isfinite(value)
            measured = prefix == "take_" and name in _MEASURED
            row[f"{prefix}{name}" if name in row else name] = (
                None if unknown else _rounded(value) if measured else value
            )
    return row


def _rounded(value: Any) -> Any:
    return round(value, _DIGITS) if isinstance(value, float) else value


def metadata_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Return the content of `metadata.csv`, in which no cell can be taken for a formula by a spreadsheet."""
    names = list(dict.fromkeys(name for row in rows for name in row))
    return csv_line(names) + "".join(csv_line([_cell(row.get(name)) for name in names]) for row in rows)


def _cell(value: object) -> object:
    if isinstance(value, bool):
        return "true" if value else "false"
    return json.dumps(value, default=str) if isinstance(value, list | dict) else value


def data_set_text(facts: Facts, rows: Sequence[Mapping[str, Any]], done: Sequence[Done]) -> str:
    """Return the content of `dataset.json`: how the data set was made, its splits and classes, and all clips.

    Parameters
    ----------
    facts : Facts
        The store and the request.
    rows : sequence of dict
        The rows of `metadata.csv`.
    done : sequence of Done
        The clips, in the order of the rows.
    """
    store, how = facts.store, facts.how
    clips = [{**row, "files": [asdict(file) for file in one.files]} for row, one in zip(rows, done, strict=True)]
    classes = sorted(
        {(one.job.clip.interval.label, one.job.clip.label) for one in done if one.job.clip.mirrored}, key=str
    )
    content = {
        "format": FORMAT,
        "kinedex": kinedex_version(),
        "command": running_command(),
        "store": {
            "version": store.manifest.version,
            "rate_hz": store.rate_hz,
            "feature_set": store.feature_set.name,
            "feature_set_digest": store.feature_set.digest,
        },
        "form": {"name": how.form, "meaning": FILE_FORMATS[how.form].meaning, "unit": "m", "up": "y"},
        "joints": list(store.feature_set.joints),
        "what": _plain(asdict(facts.what)),
        "how": _plain(asdict(how)),
        "splits": _with_values(split_facts(rows, how), done, how),
        "mirrored_classes": {before: after for before, after in classes if before is not None},
        "remarks": list(facts.remarks),
        "excluded": [{"file": file, "reason": reason} for file, reason in facts.excluded.items()],
        "clips": clips,
    }
    return json.dumps(content, indent=1, ensure_ascii=False, default=_json) + "\n"


def split_facts(rows: Sequence[Mapping[str, Any]], how: ClipOptions) -> dict[str, dict[str, Any]]:
    """Return for each split its number of clips, seconds, share of all seconds, and classes.

    Parameters
    ----------
    rows : sequence of dict
        The rows of `metadata.csv`.
    how : ClipOptions
        The request, with the column.
    """
    whole = sum(row["seconds"] for row in rows)
    found = {}
    for folder in how.folders:
        inside = [row for row in rows if (row["split"] or CLIPS) == folder]
        seconds = sum(row["seconds"] for row in inside)
        found[folder] = {
            "clips": len(inside),
            "seconds": round(seconds, 3),
            "share": round(seconds / whole, 4) if whole else 0.0,
            "classes": dict(sorted(Counter(row["class"] or "" for row in inside).items())),
        }
    return found


def _with_values(
    splits: dict[str, dict[str, Any]], done: Sequence[Done], how: ClipOptions
) -> dict[str, dict[str, Any]]:
    """Return the facts of each split with `values` added: the sorted values of the column `how.split` in its clips.

    If no column is given, the facts are returned unchanged.
    """
    if how.split is None:
        return splits
    values = {name: {one.job.row[how.split] for one in done if one.job.clip.folder == name} for name in splits}
    return {name: {**facts, "values": sorted(values[name], key=str)} for name, facts in splits.items()}


def _plain(values: dict[str, Any]) -> dict[str, Any]:
    return {name: str(value) if isinstance(value, Path) else value for name, value in values.items()}


def _json(value: object) -> object:
    return value.isoformat() if isinstance(value, date | datetime) else str(value)
