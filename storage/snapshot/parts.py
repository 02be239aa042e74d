"""Write Parquet parts: under a temporary name, flushed to disk, then named after their own content."""

from __future__ import annotations

import os
import uuid
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
import pyarrow as pa
import pyarrow.parquet as pq

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import ParameterError, StoreError
from kinedex.ops.words import NO_WORD
from kinedex.storage.durable_files import TEMPORARY, sync_file, sync_folder, write_errors
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.manifest import Part
from kinedex.storage.snapshot.schemas import frames_schema

ROW_GROUP = 16_384
"""The number of rows in a row group of frames, about 3.4 MB on disk: small, so that an interval is read quickly."""

FULL_BYTES = 32_000_000
"""The size in bytes of a full part of results; further rows are written to another part."""


@dataclass(frozen=True)
class _Packed:
    """T frames of one take to be written, from number `first` on: float32 (3 J + 4, T) by column, and words (T,)."""

    take_id: int
    first: int
    numbers: npt.NDArray[np.float32]
    words: npt.NDArray[np.uint64]


def _table(takes: Sequence[_Packed], schema: pa.Schema) -> pa.Table:
    """Convert takes to rows of a frames part with one chunk per column, which is faster than one chunk per take."""
    lengths = [len(take.words) for take in takes]
    numbers = np.concatenate([take.numbers for take in takes], axis=1)
    words = np.concatenate([take.words for take in takes])
    structs = [field.type for field in schema if pa.types.is_struct(field.type)]
    parts = iter(numbers)
    columns: list[pa.Array] = [
        pa.array(np.repeat(np.array([take.take_id for take in takes], np.int64), lengths)),
        pa.array(
            np.concatenate([np.arange(take.first, take.first + len(take.words), dtype=np.int32) for take in takes])
        ),
    ]
    for struct in structs:
        fields = [pa.array(next(parts)) for _ in struct]
        columns.append(pa.StructArray.from_arrays(fields, fields=list(struct)))
    columns.append(pa.array(words, mask=words == NO_WORD))
    return pa.Table.from_arrays(columns, schema=schema)


def joint_positions(frames: pa.Table, joints: Iterable[str]) -> npt.NDArray[np.float32]:
    """Return the joint positions in rows of a frames part.

    Parameters
    ----------
    frames : pyarrow.Table
        Rows of a frames part.
    joints : iterable of str
        Names of J joints.

    Returns
    -------
    float32 array (J, 3, T)
        Metres, Y up.
    """
    rows = [
        [field.to_numpy(zero_copy_only=False) for field in frames.column(joint).combine_chunks().flatten()]
        for joint in joints
    ]
    return np.array(rows, dtype=np.float32).reshape(len(rows), 3, frames.num_rows)


class FramesWriter:
    """A writer of one frames part, to which takes are added one by one.

    Any process may write a part; readers see it after `StoreWriter.add_takes`, with the record that `close` returns,
    and a commit. Takes must be added in ascending order of take_id. An exception in the `with` block removes the
    unfinished file.

    Parameters
    ----------
    store : str or Path
        The store's directory.
    feature_set : FeatureSet
        The feature set of the words.
    rate_hz : float, optional
        Analysis frames per second.
    """

    def __init__(self, store: str | Path, feature_set: FeatureSet, rate_hz: float = 30.0) -> None:
        self.store = Path(store)
        self.schema = frames_schema(feature_set, rate_hz)
        self._folder = self.store / "frames"
        self._temporary = self._folder / f"{TEMPORARY}{uuid.uuid4().hex}.parquet"
        self._writer: pq.ParquetWriter | None = None
        self._packed: list[_Packed] = []
        self._packed_rows = 0
        self._waiting: list[pa.Table] = []
        self._waiting_rows = 0
        self._take_ids: list[int] = []
        self._rows = 0

    def add(
        self,
        take_id: int,
        positions: npt.NDArray[np.floating],
        orientation: npt.NDArray[np.floating],
        words: npt.NDArray[np.uint64],
    ) -> None:
        """Add a whole take.

        Parameters
        ----------
        take_id : int
            The take's id in the store.
        positions : float array (J, 3, T)
            Metres, joints in the order of the feature set; NaN where unknown. Stored as float32.
        orientation : float array (4, T)
            The root's unit quaternion w, x, y, z.
        words : uint64 array (T,)
            One word per frame; `NO_WORD` for an invalid frame, which is stored as null.
        """
        joints = len(self.schema) - 4
        if positions.shape != (joints, 3, len(words)):
            raise ParameterError("positions", f"of shape ({joints}, 3, {len(words)})", positions.shape)
        if orientation.shape != (4, len(words)):
            raise ParameterError("orientation", f"of shape (4, {len(words)})", orientation.shape)
        self._append_id(take_id)
        for first in range(0, max(len(words), 1), ROW_GROUP):  # for a long take a second copy would be too large
            part = slice(first, first + ROW_GROUP)
            own = np.array(words[part], np.uint64)
            numbers = np.empty((3 * joints + 4, len(own)), np.float32)
            numbers[:-4].reshape(joints, 3, len(own))[:] = positions[:, :, part]
            numbers[-4:] = orientation[:, part]
            self._packed.append(_Packed(take_id, first, numbers, own))
            self._packed_rows += len(own)
            if self._packed_rows >= ROW_GROUP:
                self._lay_out()

    def add_table(self, take_id: int, table: pa.Table) -> None:
        """Add a whole take, given as a table with one row per frame, in order."""
        self.add_pieces([take_id], [table])

    def add_pieces(self, take_ids: Sequence[int], pieces: Iterable[pa.Table]) -> None:
        """Add whole takes, given as tables that together have all of their rows, in order, in pieces of any length."""
        self._lay_out()
        for take_id in take_ids:
            self._append_id(take_id)
        for piece in pieces:
            self._add_piece(piece)

    def _append_id(self, take_id: int) -> None:
        if self._take_ids and take_id <= self._take_ids[-1]:
            raise ParameterError("take_id", f"above {self._take_ids[-1]}, the take before", take_id)
        self._take_ids.append(take_id)

    def _lay_out(self) -> None:
        """Convert the takes added as arrays to a table."""
        if self._packed:
            packed, self._packed, self._packed_rows = self._packed, [], 0
            self._add_piece(_table(packed, self.schema))

    def _add_piece(self, piece: pa.Table) -> None:
        self._waiting.append(piece)
        self._waiting_rows += piece.num_rows
        self._rows += piece.num_rows
        if self._waiting_rows >= 2 * ROW_GROUP:
            self._write(last=False)

    def close(self) -> Part:
        """Finish the part, give it its name, and return its record."""
        self._lay_out()
        self._write(last=True)
        assert self._writer is not None
        with write_errors(self._folder):
            self._writer.close()
        return publish_part(self.store, self._temporary, "frames", self._rows, self._take_ids)

    def _write(self, *, last: bool) -> None:
        table = pa.concat_tables(self._waiting) if self._waiting else self.schema.empty_table()
        with write_errors(self._folder):
            if self._writer is None:
                self._writer = frames_writer(self._temporary, self.schema)
            # keep at least one whole row group for later, so that the last row group of a part is not small
            while table.num_rows >= 2 * ROW_GROUP:
                self._write_group(table.slice(0, ROW_GROUP))
                table = table.slice(ROW_GROUP)
            if last:
                self._write_group(table)
        self._waiting = [] if last else [table]
        self._waiting_rows = 0 if last else table.num_rows

    def _write_group(self, rows: pa.Table) -> None:
        assert self._writer is not None
        # columns of one chunk are written in half the time of one chunk per take, including the copy
        self._writer.write_table(rows.combine_chunks(), row_group_size=max(1, rows.num_rows))

    def __enter__(self) -> FramesWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        _discard(self._writer, self._temporary)


def frames_writer(sink: Path | BinaryIO, schema: pa.Schema) -> pq.ParquetWriter:
    """Return the Parquet writer of a frames part, to a file or to memory."""
    floats = [
        f"{field.name}.{child.name}" for field in schema if pa.types.is_struct(field.type) for child in field.type
    ]
    return pq.ParquetWriter(
        # a relative path that begins with ~ would be taken for the home folder
        sink.absolute() if isinstance(sink, Path) else sink,
        schema,
        compression="zstd",
        compression_level=3,
        # measured on 200,000 frames: half the size of dictionary encoding, nine times as fast to write
        use_dictionary=["take_id", "word"],
        use_byte_stream_split=floats,
        write_statistics=["take_id", "frame", "word"],
        write_page_checksum=True,
    )


def write_part(store: Path, folder: str, table: pa.Table, take_ids: Iterable[int] = ()) -> Part:
    """Write a small table, such as takes or labels, as one part in `folder`, a path relative to the store."""
    temporary = store / folder / f"{TEMPORARY}{uuid.uuid4().hex}.parquet"
    try:
        with write_errors(store / folder):
            (store / folder).mkdir(parents=True, exist_ok=True)
            pq.write_table(table, temporary, compression="zstd", write_page_checksum=True)
        return publish_part(store, temporary, folder, table.num_rows, take_ids)
    finally:
        temporary.unlink(missing_ok=True)


def write_pieces(store: Path, folder: str, pieces: Iterable[pa.Table]) -> list[Part]:
    """Write tables of one schema as parts in `folder`, in order; without rows, no part is written.

    A part is closed when it reaches `FULL_BYTES`. Only one piece is in memory at a time; each becomes a separate row
    group (or several, if it is very long).
    """
    parts = []
    growing: _Growing | None = None
    try:
        for piece in pieces:
            if not piece.num_rows:
                continue
            if growing is None:
                growing = _Growing(store, folder)
            if growing.add(piece) >= FULL_BYTES:
                parts.append(growing.close())
                growing = None
        if growing is not None:
            parts.append(growing.close())
            growing = None
        return parts
    finally:
        if growing is not None:
            growing.discard()


class _Growing:
    """A part that is written piece by piece under a temporary name."""

    def __init__(self, store: Path, folder: str) -> None:
        self._store, self._folder = store, folder
        self._temporary = store / folder / f"{TEMPORARY}{uuid.uuid4().hex}.parquet"
        self._writer: pq.ParquetWriter | None = None
        self._rows = 0

    def add(self, piece: pa.Table) -> int:
        """Write another piece, and return the size of the file in bytes."""
        with write_errors(self._store / self._folder):
            if self._writer is None:
                self._temporary.parent.mkdir(parents=True, exist_ok=True)
                self._writer = pq.ParquetWriter(
                    self._temporary.absolute(), piece.schema, compression="zstd", write_page_checksum=True
                )
            self._writer.write_table(piece)
            self._rows += piece.num_rows
            return self._temporary.stat().st_size

    def close(self) -> Part:
        """Finish the part and give it its name."""
        assert self._writer is not None
        try:
            with write_errors(self._store / self._folder):
                self._writer.close()
            return publish_part(self._store, self._temporary, self._folder, self._rows, ())
        finally:
            self._temporary.unlink(missing_ok=True)

    def discard(self) -> None:
        """Remove the unfinished file."""
        _discard(self._writer, self._temporary)


def _discard(writer: pq.ParquetWriter | None, temporary: Path) -> None:
    """Remove the unfinished file of a writer."""
    if writer is not None and writer.is_open:
        # on a full disk, even closing a file to be discarded fails
        with suppress(OSError):
            writer.close()
    temporary.unlink(missing_ok=True)


def publish_part(store: Path, temporary: Path, folder: str, rows: int, take_ids: Iterable[int]) -> Part:
    """Flush a finished file to disk and name it after its content, so that equal content has equal names."""
    with write_errors(store / folder):
        sums = sync_file(temporary)
        path = temporary.with_name(f"part-{sums.sha256[:24]}.parquet")
        _rename(temporary, path)
        sync_folder(path.parent)
    return Part(f"{folder}/{path.name}", rows, sums.bytes, sums.sha256, tuple(take_ids), xxh3=sums.xxh3)


@contextmanager
def read_errors(file: Path) -> Iterator[None]:
    """Turn errors on reading a part into a StoreError that names it."""
    try:
        yield
    except (OSError, pa.ArrowException) as fault:
        reason = str(fault).splitlines()[0]
        # a part's folder lies two levels deep for results, else one
        store = file.parents[1] if file.parent.name in ("frames", "takes", "labels") else file.parents[2]
        raise StoreError(f"{file}: the part cannot be read: {reason}", remedy=repair(store)) from None


def _rename(temporary: Path, path: Path) -> None:
    """Rename a part; if Windows refuses to replace an open file, keep the open one, which has the same content."""
    try:
        os.replace(temporary, path)
    except PermissionError:
        if os.name != "nt" or not path.is_file():
            raise
        temporary.unlink()


def column_count(file: Path) -> int:
    """Return the number of columns of a part, which manifests of format 3 do not record."""
    with read_errors(file):
        return len(pq.read_schema(file).names)


def part_file(store: Path, path: str) -> Path:
    """Return the file of a part; raise StoreError if it is missing."""
    file = store / path
    if not file.is_file():
        raise StoreError(f"{file}: the manifest names this part, but the file is missing", remedy=repair(store))
    return file
