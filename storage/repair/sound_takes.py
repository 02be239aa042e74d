"""Find the takes of a damaged part of frames whose rows are provably undamaged.

A row group is undamaged if the checksums of its pages match, and if writing its rows again gives the same bytes: this
proves the page headers, which have no checksum. Parts from another version of the Parquet library do not pass, nor do
those without page checksums.
"""

from __future__ import annotations

import io
from collections.abc import Collection, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from kinedex.storage.snapshot.parts import frames_writer
from kinedex.storage.snapshot.schemas import schema_problem


def sound_takes(
    file: Path, schema: pa.Schema, take_ids: Collection[int], frames: Mapping[int, int]
) -> dict[int, pa.Table]:
    """Return the rows of takes of a damaged part of frames, as far as they are proven to be undamaged.

    Parameters
    ----------
    file : Path
        The part.
    schema : pyarrow.Schema
        The required schema.
    take_ids : collection of int
        The takes to look for.
    frames : mapping of int to int
        Id of a take → its number of frames.

    Returns
    -------
    dict of int to pyarrow.Table
        Id of a take → all of its rows, in order of take_id.
    """
    groups = []
    try:
        with pq.ParquetFile(file, page_checksum_verification=True) as part:
            if schema_problem(part.schema_arrow, schema) is not None:
                return {}
            for number in range(part.num_row_groups):
                group = _sound_group(file, part, number, schema)
                if group is not None:
                    groups.append(group)
    except (OSError, pa.ArrowException):
        return {}
    rows = pa.concat_tables([schema.empty_table(), *groups])
    found = {}
    for take in sorted(take_ids):
        own = rows.filter(pc.equal(rows.column("take_id"), take)).combine_chunks()
        if np.array_equal(own.column("frame").to_numpy(), np.arange(frames[take])):
            found[take] = own
    return found


def _sound_group(file: Path, part: pq.ParquetFile, number: int, schema: pa.Schema) -> pa.Table | None:
    """Return the rows of a row group; None unless they are undamaged."""
    try:
        rows = part.read_row_group(number).cast(schema)
    except (OSError, pa.ArrowException):
        return None
    sink = io.BytesIO()
    with frames_writer(sink, schema) as writer:
        writer.write_table(rows.combine_chunks(), row_group_size=max(1, rows.num_rows))
    again = sink.getvalue()
    start, stop = _extent(part.metadata, number)
    first, last = _extent(pq.read_metadata(io.BytesIO(again)), 0)
    with open(file, "rb") as content:
        content.seek(start)
        return rows if content.read(stop - start) == again[first:last] else None


def _extent(metadata: pq.FileMetaData, number: int) -> tuple[int, int]:
    """Return the bytes [start, stop) of a row group in its file."""
    group = metadata.row_group(number)
    columns = [group.column(column) for column in range(group.num_columns)]
    start = min(
        column.data_page_offset if column.dictionary_page_offset is None else column.dictionary_page_offset
        for column in columns
    )
    return start, start + sum(column.total_compressed_size for column in columns)
