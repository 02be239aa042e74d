"""Record a store's Parquet files in its manifest: parts of frames and takes, of results, and of labels."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from typing import Annotated, Any

MOST_TAKES = 100_000_000
"""The largest number of takes in a part, so that a wrong manifest cannot fill the memory."""


def ranges(take_ids: Iterable[int]) -> list[list[int]]:
    """Return ascending ids as half-open ranges, [[first, last + 1], …], the form of manifests."""
    found: list[list[int]] = []
    for take in take_ids:
        if found and found[-1][1] == take:
            found[-1][1] = take + 1
        else:
            found.append([take, take + 1])
    return found


def _from_ranges(value: object) -> tuple[int, ...]:
    if not isinstance(value, list) or not all(
        isinstance(pair, list) and len(pair) == 2 and all(type(end) is int for end in pair) for pair in value
    ):
        raise ValueError("must be a list of ranges [first, last + 1] of take ids")
    if sum(max(0, stop - start) for start, stop in value) > MOST_TAKES:
        raise ValueError(f"must be at most {MOST_TAKES} takes")
    return tuple(chain.from_iterable(range(start, stop) for start, stop in value))


class _Ranges:
    """The pydantic type of take ids that a manifest stores as ranges."""

    read = staticmethod(_from_ranges)

    @staticmethod
    def __get_pydantic_core_schema__(source: Any, handler: Any) -> Any:
        """Return the pydantic validator, which is only needed for a faulty manifest."""
        from pydantic_core import core_schema

        return core_schema.no_info_before_validator_function(_from_ranges, handler(source))


TakeIds = Annotated[tuple[int, ...], _Ranges()]


@dataclass(frozen=True)
class Part:
    """A Parquet file of frames or takes.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    rows : int
        Number of its rows.
    bytes : int
        Size of the file.
    sha256 : str
        Checksum of the file.
    take_ids : tuple of int
        Ids of the takes written into it, ascending.
    dropped : tuple of int
        Tombstones: ids of takes in it that were replaced or removed later.
    dropped_rows : int
        Number of rows of dropped takes, which stay until compaction.
    xxh3 : str
        XXH3 checksum of the file, 128 bits in hexadecimal digits; empty in a store of format 3.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    take_ids: TakeIds
    dropped: TakeIds = ()
    dropped_rows: int = 0
    xxh3: str = ""

    @cached_property
    def live(self) -> tuple[int, ...]:
        """The ids of the takes of this part that are not dropped, ascending."""
        if not self.dropped:
            return self.take_ids
        gone = set(self.dropped)
        return tuple(take for take in self.take_ids if take not in gone)

    @property
    def live_rows(self) -> int:
        """The number of rows of live takes."""
        return self.rows - self.dropped_rows

    @cached_property
    def encoded(self) -> dict[str, Any]:
        """The part as JSON values for a manifest; cached, since every later version writes them again."""
        values = {name: getattr(self, name) for name in ("path", "rows", "bytes", "sha256", "xxh3", "dropped_rows")}
        return values | {"take_ids": ranges(self.take_ids), "dropped": ranges(self.dropped)}


@dataclass(frozen=True)
class ResultPart:
    """A Parquet file of results of one kind, written by one run of one stage.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    rows : int
        Number of its rows.
    bytes : int
        Size of the file.
    sha256 : str
        Checksum of the file.
    stage : str
        The stage, "<pipeline>/<stage>".
    run : str
        Id of the run of the stage.
    xxh3 : str
        XXH3 checksum of the file, 128 bits in hexadecimal digits; empty in a store of format 3.
    columns : int
        Number of its columns, the first ones of the schema of its kind; 0 (unknown) in a store of format 3.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    stage: str
    run: str
    xxh3: str = ""
    columns: int = 0

    @property
    def live_rows(self) -> int:
        """The number of rows, all of which are live."""
        return self.rows

    @property
    def dropped_rows(self) -> int:
        """Always 0, since results have no tombstones."""
        return 0


@dataclass(frozen=True)
class LabelPart:
    """A Parquet file of labels: statements of people, which cannot be recomputed.

    Attributes
    ----------
    path : str
        Path relative to the store, with /.
    rows : int
        Number of its rows, all of which are kept forever.
    bytes : int
        Size of the file.
    sha256 : str
        Checksum of the file.
    xxh3 : str
        XXH3 checksum of the file, 128 bits in hexadecimal digits.
    """

    path: str
    rows: int
    bytes: int
    sha256: str
    xxh3: str


AnyPart = Part | ResultPart | LabelPart
"""A Parquet file that a version names."""
