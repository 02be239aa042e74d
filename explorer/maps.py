"""The map of the archive: takes or windows as points, with their clusters.

`GET /api/map?unit=takes` (or windows) → lines of JSON as the work goes on: {done, total} each, the last one {answer} or
{error, status} as other addresses have it. The answer is
{unit, version, takes: [take_id], names: [name], owner: [index of the take of each point], starts, stops: [frame],
 x, y: [−1 to 1], cluster: [number or −1], clusters: [{points, takes, hours, words, title,
 traits: [{feature, share, rest}], classes: [{value, takes}], typical: [point], outline: [[x, y]]}],
 window_seconds: number or null, remarks: [sentence], python}.

`POST /api/map/takes` {where?, filters?, column} → for each take of the map, in its order, the value of a column:
{column, values: [value], codes: [index of a value, −1 without one, −2 where the take does not fit], takes, command,
 python}; a column of numbers has {numbers: [number or null], fits: [0 or 1]} in place of values and codes.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import AsyncIterator
from typing import Any

import numpy as np
from anyio import to_thread
from starlette.requests import Request
from starlette.responses import Response, StreamingResponse
from starlette.routing import Route

from kinedex.explorer.answers import Json, equivalent_query, python_lines
from kinedex.explorer.endpoints import LINES, error_line, post
from kinedex.explorer.map_processes import maps_of, require_extra
from kinedex.explorer.open_archive import Archive
from kinedex.explorer.selections import (
    SQL_SECONDS,
    Selection,
    columns_with_nan,
    condition_of,
    expression,
    quoting_condition,
)
from kinedex.explorer.store import NUMERIC
from kinedex.ops.errors import ParameterError
from kinedex.pipelines.inspection.archive_map import ArchiveMap, Cluster, Unit, trait_words
from kinedex.storage.duckdb_sql import sql_type
from kinedex.storage.store.store import Store

NO_VALUE, NO_FIT = -1, -2
"""Codes of takes without a value, and of those that do not fit the filters."""


async def stream_map(request: Request) -> Response:
    """Answer with the progress of a map and then the map, for as long as the page listens."""
    archive: Archive = request.app.state.archive
    asked = request.query_params.get("unit", "takes")
    unit: Unit = "windows" if asked == "windows" else "takes"
    if asked != unit:
        raise ParameterError("unit", "takes or windows", asked)
    require_extra()
    store = await to_thread.run_sync(archive.store)
    return StreamingResponse(_lines(request, archive, store, unit), media_type=LINES)


async def _lines(request: Request, archive: Archive, store: Store, unit: Unit) -> AsyncIterator[bytes]:
    try:
        async for found in maps_of(archive).find(store, unit):
            if isinstance(found, ArchiveMap):
                whole = await to_thread.run_sync(_described, archive, store, unit, found)
                yield bytes(Json({"answer": whole}).body) + b"\n"
            else:
                yield json.dumps({"done": found[0], "total": found[1]}).encode() + b"\n"
    except Exception as fault:  # the status of the response is sent already
        yield await error_line(request, fault)


def _described(archive: Archive, store: Store, unit: Unit, found: ArchiveMap) -> dict[str, Any]:
    """Return a map as a JSON object for pages."""
    takes, owner = np.unique(found.take_ids, return_inverse=True)
    places = np.round(found.positions.astype(np.float64), 4)
    line = "store.map()" if unit == "takes" else 'store.map("windows")'
    return {
        "unit": unit,
        "version": store.manifest.version,
        "takes": takes.tolist(),
        "names": [store.take_names[take] for take in takes.tolist()],
        "owner": owner.tolist(),
        "starts": found.starts.tolist(),
        "stops": found.stops.tolist(),
        "x": places[:, 0].tolist(),
        "y": places[:, 1].tolist(),
        "cluster": found.numbers.tolist(),
        "clusters": [_cluster(store, one) for one in found.clusters],
        "window_seconds": found.window_seconds,
        "remarks": found.remarks,
        "python": python_lines(archive.path, line),
    }


def _cluster(store: Store, one: Cluster) -> dict[str, Any]:
    features = store.feature_set.features
    return {
        "points": one.points,
        "takes": one.takes,
        "hours": one.hours,
        "title": cluster_title(one),
        "words": trait_words(one.traits, [feature.description for feature in features]),
        "traits": [
            {"feature": features[trait.feature].description, "share": trait.share, "rest": trait.rest}
            for trait in one.traits
        ],
        "classes": [{"value": value, "takes": takes} for value, takes in one.classes],
        "typical": one.typical,
        "outline": np.round(one.outline.astype(np.float64), 4).tolist(),
    }


def cluster_title(one: Cluster) -> str:
    """Return a title of a cluster: one or two classes of at least half of its takes, else "mixed" or "no class"."""
    known = [(value, takes) for value, takes in one.classes if value is not None]
    if sum(takes for _, takes in known) * 2 < one.takes:
        return "no class"
    shown = known[:1] if known[0][1] * 2 >= one.takes else known[:2]
    if sum(takes for _, takes in shown) * 2 < one.takes:
        return f"mixed, {known[0][0]} first"
    return " and ".join(str(value) for value, _ in shown)


class MapTakesRequest(Selection):
    """A request for the values of a column of the takes that fit filters."""

    column: str


@quoting_condition
def map_takes(archive: Archive, asked: MapTakesRequest, _request: Request) -> dict[str, Any]:
    """Return the values of a column for all takes, in the order of their ids, and mark takes that fit the filters."""
    store = archive.store()
    known = store.take_rows.column_names
    nan = columns_with_nan(store)
    name, condition = expression(asked.column, known, nan=nan), condition_of(asked, known, nan)
    # values of all takes, so that a value keeps its mark on the map, whatever the filters exclude
    every = store.answer(f"SELECT {name} AS value FROM takes ORDER BY take_id", timeout=SQL_SECONDS).table
    text = f"SELECT take_id, {name} AS value FROM takes{condition}"
    fitting = store.answer(f"SELECT take_id FROM takes{condition}", timeout=SQL_SECONDS).table
    takes = np.sort(store.take_rows.column("take_id").to_numpy())
    fits = np.isin(takes, fitting.column("take_id").to_numpy())
    found = every.column("value").to_pylist()
    answer = {"column": asked.column, "takes": int(fits.sum()), **equivalent_query(archive, text)}
    field = store.take_rows.schema.field(asked.column) if asked.column in known else None
    if field is not None and sql_type(field.type) in NUMERIC:
        return answer | {"numbers": found, "fits": fits.astype(int).tolist()}
    texts = [None if value is None else str(value) for value in found]
    counts = Counter(value for value in texts if value is not None)
    values = sorted(counts, key=lambda value: (-counts[value], value))
    index = {value: number for number, value in enumerate(values)} | {None: NO_VALUE}
    codes = np.where(fits, [index[value] for value in texts], NO_FIT)
    return answer | {"values": values, "codes": codes.tolist()}


routes = [Route("/api/map", stream_map, methods=["GET"]), post("/api/map/takes", map_takes, MapTakesRequest)]
