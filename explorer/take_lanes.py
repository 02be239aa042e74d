"""The lanes of a take: words, labels, annotations, other results and faults of quality on one time axis.

`GET /api/takes/ID` and `GET /api/take?name=` answer with `take_document`, `GET /api/takes/ID/words` with one
little-endian uint64 per analysis frame (bit i − 1 is feature Fi; 2⁶⁴ − 1 in an invalid frame),
`GET /api/takes/ID/lanes` with `take_lanes`, `GET /api/takes/ID/limb-error` with `limb_error_curve`, and
`GET /api/takes/ID/pose` with `pose_reading`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt
import pyarrow.compute as pc
from starlette.requests import Request

from kinedex.explorer.answers import NotFoundError, command_line, python_lines
from kinedex.explorer.endpoints import get, get_of_take, take_of
from kinedex.explorer.motion import POSITIONS, PositionCache, check_frame, frames_of, whole_number
from kinedex.explorer.open_archive import Archive
from kinedex.ops.arrays import F64
from kinedex.ops.body.motion_faults import fault_marks
from kinedex.ops.errors import ParameterError, did_you_mean
from kinedex.ops.intervals import in_seconds, nearest_frame
from kinedex.ops.words import ALL_KNOWN, NO_WORD, U64
from kinedex.storage.store.store import Store

Row = dict[str, Any]

_PLAIN = """SELECT {columns} FROM {view} WHERE take_id = ? ORDER BY ALL"""


def words_of_take(store: Store, take_id: int) -> U64:
    """Return the words of a take, uint64 (T,); `NO_WORD` in invalid frames.

    Raises
    ------
    KinedexError
        No take has this id.
    """
    frames_of(store, take_id)
    return store.words([take_id]).take(0)


def take_document(store: Store, take_id: int) -> Row:
    """Return the facts about a take that its page needs first.

    Parameters
    ----------
    store : Store
        The store of the take.
    take_id : int
        The take.

    Returns
    -------
    dict
        `take_id`, `name`, `frames`, `rate_hz`, `seconds`, `version` of the store; `columns`, the row of the take;
        `unknown`, the bits of features that its body lacks joints for; `warnings`; and `persons`, the takes of the
        same source file (name and id), which are of other persons at the same time. `command` and `python` read the
        same from a terminal and in Python.

    Raises
    ------
    KinedexError
        No take has this id.
    """
    frames = frames_of(store, take_id)
    rows = store.take_rows
    row = rows.filter(pc.equal(rows.column("take_id"), take_id)).to_pylist()[0]
    known = int(ALL_KNOWN if row.get("known") is None else row["known"])
    features = len(store.feature_set.features)
    warnings = list(row.get("warnings") or ())
    hidden = {"known", "warnings"}
    return {
        "take_id": take_id,
        "name": row["name"],
        "frames": frames,
        "rate_hz": store.rate_hz,
        "seconds": in_seconds(frames, store.rate_hz),
        "version": store.manifest.version,
        "columns": {name: _plain(value) for name, value in row.items() if name not in hidden and value is not None},
        "unknown": [bit for bit in range(features) if not known >> bit & 1],
        "warnings": warnings,
        "persons": _persons(store, row),
        "command": command_line("kinedex", "sql", store.path, f"SELECT * FROM takes WHERE take_id = {take_id}"),
        "python": python_lines(store.path, f"take = store[{row['name']!r}]", "take.positions, take.features()"),
    }


def _persons(store: Store, row: Mapping[str, Any]) -> list[Row]:
    """Return the other takes of the same source file."""
    rows = store.take_rows
    same = pc.and_(
        pc.equal(rows.column("source"), row["source"]), pc.equal(rows.column("source_root"), row["source_root"])
    )
    found = rows.filter(pc.fill_null(same, False)).select(["take_id", "name", "frames"]).to_pylist()
    return [one for one in found if one["take_id"] != row["take_id"]]


def _plain(value: object) -> object:
    """Convert a value to a type that JSON can represent."""
    if isinstance(value, float):
        return value if np.isfinite(value) else None
    return value if isinstance(value, str | int | bool | list) else str(value)


def take_lanes(cache: PositionCache, store: Store, take_id: int) -> Row:
    """Return the segments of a take, lane by lane.

    Parameters
    ----------
    cache : PositionCache
        The cache of joint positions.
    store : Store
        The store of the take.
    take_id : int
        The take.

    Returns
    -------
    dict
        `lanes`, a list of lanes. A lane has `id`, `group` (labels, ground_truth, annotations, compared, hits, limbs,
        duplicates or quality), `name`, `detail`, and `segments`, each with `start` and `stop` in analysis frames,
        `class` (the text on it), and what its source states: `confidence`, `cost`, `subclass`, `verdict`, `note`, ….
        `suspect`, the figures of the take that lie beyond their limits; `limbs`, those that have an error curve, with
        `tau_deg`. `command` and `python` read the same from a terminal and in Python.

    Raises
    ------
    KinedexError
        No take has this id.
    """
    frames = frames_of(store, take_id)
    lanes = [*_label_lanes(store, take_id)]
    for kind, reader in _READERS.items():
        if store.manifest.results.get(kind):
            lanes += reader(store, take_id)
    lanes += _quality_lanes(cache, store, take_id)
    for lane in lanes:
        for one in lane["segments"]:
            one["start"], one["stop"] = max(0, int(one["start"])), min(frames, int(one["stop"]))
        lane["segments"] = [one for one in lane["segments"] if one["start"] < one["stop"]]
    limbs = []
    if store.manifest.results.get("limb_errors"):
        asked = "SELECT limb, max(tau_deg) AS tau_deg FROM limb_errors WHERE take_id = ? GROUP BY limb ORDER BY limb"
        limbs = store.sql(asked, [take_id]).to_pylist()
    suspect = store.sql(_PLAIN.format(columns="* EXCLUDE (take_id, take)", view="suspect_takes"), [take_id])
    query = f"FROM annotations WHERE take_id = {take_id} ORDER BY start"
    return {
        "lanes": lanes,
        "suspect": suspect.to_pylist(),
        "limbs": limbs,
        "command": command_line("kinedex", "sql", store.path, query),
        "python": python_lines(store.path, f"store.sql({query!r})"),
    }


def _lane(group: str, name: str, segments: Iterable[Row], detail: str = "", id: str = "") -> Row:
    kept = [{key: _plain(value) for key, value in one.items() if value is not None} for one in segments]
    return {"id": f"{group}/{id or name}", "group": group, "name": name, "detail": detail, "segments": kept}


def _grouped(rows: Iterable[Row], key: Callable[[Row], str]) -> dict[str, list[Row]]:
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(key(row), []).append(row)
    return found


def _label_lanes(store: Store, take_id: int) -> list[Row]:
    """Return the labels of people, a lane for each verdict."""
    rows = store.labels()
    rows = rows.filter(pc.equal(rows.column("take"), store.take_names[take_id])).to_pylist()
    shown = ("id", "class", "start", "stop", "limb", "verdict", "annotator", "origin", "confidence", "note")
    found = _grouped(({key: row[key] for key in shown} for row in rows), lambda row: row["verdict"])
    titles = {"positive": "Labels", "negative": "Rejected"}
    return [
        _lane("labels", titles.get(verdict, verdict), found[verdict], "statements of people", verdict)
        for verdict in sorted(found, reverse=True)
    ]


def _annotation_lanes(store: Store, take_id: int) -> list[Row]:
    """Return the annotations, a lane for each pipeline, stage and method."""
    columns = "class, subclass, start, stop, cost, confidence, margin, method, pipeline, stage"
    rows = store.sql(_PLAIN.format(columns=columns, view="all_annotations"), [take_id]).to_pylist()
    lanes = []
    for key, own in sorted(_grouped(rows, lambda row: f"{row['pipeline']}/{row['stage']}, {row['method']}").items()):
        first = own[0]
        segments = [{k: v for k, v in row.items() if k not in ("method", "pipeline", "stage")} for row in own]
        name = str(first["pipeline"] or "annotations")
        lanes.append(_lane("annotations", name, segments, f"stage {first['stage']}, {first['method']}", key))
    return lanes


def _truth_lanes(store: Store, take_id: int) -> list[Row]:
    """Return the ground truth, a lane for each pipeline that has stored it."""
    rows = store.sql(
        _PLAIN.format(columns="class, start, stop, origin, pipeline", view="all_ground_truth"), [take_id]
    ).to_pylist()
    found = _grouped(rows, lambda row: str(row.pop("pipeline")))
    several = len(found) > 1
    return [
        _lane("ground_truth", f"Ground truth of {name}" if several else "Ground truth", own, f"pipeline {name}", name)
        for name, own in sorted(found.items())
    ]


def _compared_lanes(store: Store, take_id: int) -> list[Row]:
    """Return the segments of compared methods, a lane for each split, fold and method."""
    rows = store.sql(
        "SELECT c.split, c.fold, c.method, c.classes, c.starts, c.stops, c.confidences FROM method_cells AS c "
        "JOIN takes AS t ON t.name = c.take WHERE t.take_id = ? ORDER BY ALL",
        [take_id],
    ).to_pylist()
    lanes = []
    for row in rows:
        count = len(row["classes"])
        confidences = row["confidences"] or [None] * count
        parts = zip(row["classes"], row["starts"], row["stops"], confidences, strict=True)
        segments = [{"class": a, "start": b, "stop": c, "confidence": d} for a, b, c, d in parts]
        detail = f"{row['split']}, {row['fold']}"
        lanes.append(_lane("compared", row["method"], segments, detail, f"{detail}, {row['method']}"))
    return lanes


def _hit_lanes(store: Store, take_id: int) -> list[Row]:
    """Return saved hits of keyframe queries, a lane for each name that they were saved under."""
    rows = store.sql(_PLAIN.format(columns="saved_as, query, start, stop", view="hits"), [take_id]).to_pylist()
    found = _grouped(rows, lambda row: str(row.pop("saved_as")))
    return [
        _lane("hits", f"Hits: {name}", ({**row, "class": row["query"]} for row in own), "saved hits of queries", name)
        for name, own in sorted(found.items())
    ]


def _ranked_lanes(store: Store, take_id: int) -> list[Row]:
    """Return ranked hits of templates."""
    columns = "template AS class, rank, start, stop, cost"
    rows = store.sql(_PLAIN.format(columns=columns, view="ranked_hits"), [take_id]).to_pylist()
    return [_lane("hits", "Ranked hits", rows, "the best hits of templates")] if rows else []


def _duplicate_lanes(store: Store, take_id: int) -> list[Row]:
    """Return the ranges that are also in another take."""
    columns = "of_take AS class, of_take_id, same, changes, start, stop, share, shift_seconds, mirrored"
    rows = store.sql(_PLAIN.format(columns=columns, view="duplicates"), [take_id]).to_pylist()
    return [_lane("duplicates", "Also in another take", rows, "duplicates")] if rows else []


def _limb_lanes(store: Store, take_id: int, view: str, text: str, name: str) -> list[Row]:
    """Return the segments of a view of limbs, with source frames converted to analysis frames by time."""
    columns = f"limb, start_seconds, stop_seconds, {text}"
    rows = store.sql(_PLAIN.format(columns=columns, view=view), [take_id]).to_pylist()
    for row in rows:
        row["start"] = nearest_frame(row.pop("start_seconds"), store.rate_hz)
        row["stop"] = max(row["start"] + 1, nearest_frame(row.pop("stop_seconds"), store.rate_hz))
    detail = "reported by sensors" if name == "errors" else "marked by people"
    return [
        _lane("limbs", f"{limb} {name}", own, f"limb {limb}, {detail}", f"{name}/{limb}")
        for limb, own in sorted(_grouped(rows, lambda row: row["limb"]).items())
    ]


def _quality_lanes(cache: PositionCache, store: Store, take_id: int) -> list[Row]:
    """Return invalid frames, and the frames that show the faults of a motion."""
    words = words_of_take(store, take_id)
    invalid = words == NO_WORD
    positions = cache.positions(store, take_id)
    marks = fault_marks(positions, store.feature_set.joints, store.rate_hz, ~invalid)
    named = [("invalid", "Invalid frames", "a joint that features need is not known", invalid)]
    named += [(one.figure, one.name, one.meaning, one.frames) for one in marks]
    return [
        _lane("quality", name, ({"start": a, "stop": b, "class": name} for a, b in _runs(frames)), meaning, figure)
        for figure, name, meaning, frames in named
        if frames.any()
    ]


def _runs(frames: npt.NDArray[np.bool_]) -> list[list[int]]:
    """Return the maximal intervals [start, stop) in which a Boolean array is true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], frames, [False])).astype(np.int8)))
    found: list[list[int]] = edges.reshape(-1, 2).tolist()
    return found


_READERS: dict[str, Callable[[Store, int], list[Row]]] = {
    "ground_truth": _truth_lanes,
    "annotations": _annotation_lanes,
    "method_cells": _compared_lanes,
    "hits": _hit_lanes,
    "ranked_hits": _ranked_lanes,
    "limb_error_runs": partial(
        _limb_lanes, view="limb_error_runs", text="kind AS class, peak_deg, mean_deg, tau_deg", name="errors"
    ),
    "limb_labels": partial(
        _limb_lanes, view="limb_labels", text="coalesce(annotator, 'wrong') AS class", name="marked"
    ),
    "duplicates": _duplicate_lanes,
}
"""The kinds of results that have lanes, in their order."""


def limb_error_curve(store: Store, take_id: int, limb: str) -> npt.NDArray[np.float32]:
    """Return the angle between the orientations of a limb in the take and by its sensor, in each analysis frame.

    Parameters
    ----------
    store : Store
        The store of the take.
    take_id : int
        The take.
    limb : str
        Name of the limb.

    Returns
    -------
    float32 array (T,)
        Degrees, of the source frame nearest in time; ∞ where it is not known.

    Raises
    ------
    KinedexError
        No take has this id.
    ParameterError
        The take has no errors of this limb.
    """
    frames = frames_of(store, take_id)
    rows = store.sql(
        "SELECT t, coalesce(degrees, swing_deg) AS degrees FROM limb_errors WHERE take_id = ? AND limb = ? AND valid "
        "ORDER BY t",
        [take_id, limb],
    )
    if not rows.num_rows:
        raise ParameterError("limb", "a limb with errors in this take (`FROM limb_errors`)", limb)
    times, degrees = (rows.column(name).to_numpy(zero_copy_only=False) for name in ("t", "degrees"))
    wanted = in_seconds(np.arange(frames), store.rate_hz)
    return nearest_in_time(times, degrees, wanted, 1 / store.rate_hz).astype("<f4")


def nearest_in_time(times: F64, values: F64, wanted: F64, within: float) -> F64:
    """Return the values at the times nearest to wanted times; ∞ where no value is known close enough.

    Parameters
    ----------
    times : float64 array (N,)
        Ascending, at least one.
    values : float64 array (N,)
        NaN where not known.
    wanted : float64 array (T,)
        Times.
    within : float
        The largest accepted difference of the times.
    """
    after = np.searchsorted(times, wanted).clip(max=len(times) - 1)
    before = (after - 1).clip(min=0)
    nearest = np.where(wanted - times[before] <= np.abs(times[after] - wanted), before, after)
    found = values[nearest]
    return np.where((np.abs(times[nearest] - wanted) <= within) & np.isfinite(found), found, np.inf)


def pose_reading(store: Store, take_id: int, frame: int) -> Row:
    """Return the features that hold in a frame of a take.

    Parameters
    ----------
    store : Store
        The store of the take.
    take_id : int
        The take.
    frame : int
        The analysis frame.

    Returns
    -------
    dict
        `frame`, `valid`, and the names of the features that are `on`, `off` and `unknown`; in an invalid frame all are
        unknown. `command` and `python` read the same from a terminal and in Python.

    Raises
    ------
    KinedexError
        No take has this id.
    ParameterError
        The take has no such frame.
    """
    check_frame(store, take_id, frame)
    word = words_of_take(store, take_id)[frame]
    features, every = store.feature_set, store.feature_set.every_bit
    known = store.known.get(take_id, int(ALL_KNOWN)) & every if word != NO_WORD else 0
    value = int(word) & known
    return {
        "frame": frame,
        "valid": bool(word != NO_WORD),
        "on": features.named(value),
        "off": features.named(known & ~value),
        "unknown": features.named(every & ~known),
        "command": command_line(
            "kinedex", "sql", store.path, f"SELECT word FROM frames WHERE take_id = {take_id} AND frame = {frame}"
        ),
        "python": python_lines(store.path, f"store[{take_id}].features()[{frame}]"),
    }


def _named(archive: Archive, request: Request) -> Row:
    store, name = archive.store(), request.query_params.get("name", "")
    if name not in store.take_ids:
        raise NotFoundError(f"{store.path}: no take is named '{name}'{did_you_mean(name, store.take_ids)}")
    return take_document(store, store.take_ids[name])


def _limb_error(archive: Archive, request: Request) -> bytes:
    return limb_error_curve(*take_of(archive, request), request.query_params.get("limb", "")).tobytes()


def _pose(archive: Archive, request: Request) -> Row:
    return pose_reading(*take_of(archive, request), whole_number(request, "frame"))


routes = [
    get("/api/take", _named),
    get_of_take("", take_document),
    get_of_take("/words", lambda store, take: words_of_take(store, take).astype("<u8").tobytes()),
    get_of_take("/lanes", partial(take_lanes, POSITIONS)),
    get("/api/takes/{take:int}/limb-error", _limb_error),
    get("/api/takes/{take:int}/pose", _pose),
]
