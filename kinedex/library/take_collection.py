"""The methods of `Store` as a collection of takes: their table, their positions and their words."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from kinedex.catalog.features import FeatureSet
from kinedex.library.stored_frames import StoredFrames
from kinedex.library.take import Take
from kinedex.library.take_frames import F32, U64
from kinedex.ops.errors import StoreError, did_you_mean
from kinedex.storage.store.store import Store as StoredTakes

if TYPE_CHECKING:
    import polars as pl


class TakeCollection:
    """The takes of a store, by name and id."""

    def __init__(self, stored: StoredTakes) -> None:
        self.stored = stored
        self.path = stored.path
        self.version = stored.manifest.version
        self.newest_version = stored.newest_version
        self.rate_hz = stored.rate_hz
        self.feature_set: FeatureSet = stored.feature_set

    @cached_property
    def _rows(self) -> dict[str, dict[str, Any]]:
        return {row["name"]: row for row in self.stored.takes_table().to_pylist()}

    @cached_property
    def _names(self) -> dict[int, str]:
        return {row["take_id"]: name for name, row in self._rows.items()}

    def _row(self, take: str | int | Take) -> dict[str, Any]:
        """Return the row of a take that is given by name, by id, or as a take."""
        name = take.name if isinstance(take, Take) else take
        if isinstance(name, int | np.integer) and not isinstance(name, bool):
            if int(name) not in self._names:
                raise StoreError(f"{self.path}: no take has the id {name}; `store.takes()` lists those that there are")
            return self._rows[self._names[int(name)]]
        if name not in self._rows:
            raise StoreError(f"{self.path}: no take is named '{name}'{did_you_mean(str(name), self._rows)}")
        return self._rows[name]

    def __len__(self) -> int:
        return len(self.stored.manifest.live_takes)

    def __iter__(self) -> Iterator[Take]:
        return (self[name] for name in self._rows)

    def __contains__(self, take: object) -> bool:
        return take in self._rows or take in self._names

    def __getitem__(self, take: str | int) -> Take:
        """Return a take by its name or its id.

        Parameters
        ----------
        take : str or int
            The name or the id.

        Returns
        -------
        Take
            The take, whose frames are read when they are first needed.

        Raises
        ------
        StoreError
            There is no such take; the message names the nearest.

        Examples
        --------
        >>> store[take.name].take_id == take.take_id
        True
        """
        row = self._row(take)
        source = StoredFrames(self.stored, row["name"], row["take_id"], 0, row["frames"])
        return Take(row["name"], source, row["frames"], self.feature_set, self.rate_hz, row, row["take_id"])

    def takes(self, where: str | None = None) -> pl.DataFrame:
        """Return the table of takes.

        Parameters
        ----------
        where : str, optional
            A SQL filter over the columns of takes, such as ``"actor IN ('al', 'bo') AND class IS NOT NULL"``.

        Returns
        -------
        polars.DataFrame
            One row per take, sorted by name: take_id, name, source, format, skeleton, source_rate_hz, frames, seconds,
            actor, class, clip, warnings and others.

        Raises
        ------
        KinedexError
            The filter is not valid; the message names the columns.

        Examples
        --------
        >>> store.takes("class IS NOT NULL").select("name", "class").columns
        ['name', 'class']
        """
        return self.stored.takes(where)

    def positions(self, take: str | int | Take) -> F32:
        """Return the joint positions of a take.

        Parameters
        ----------
        take : str, int or Take
            The take, by name or id.

        Returns
        -------
        float32 array (T, J, 3)
            Metres, Y up; NaN where a joint is not known.

        Raises
        ------
        StoreError
            There is no such take.

        Examples
        --------
        >>> store.positions(take.name).shape == (len(take), 24, 3)
        True
        """
        return self[self._row(take)["name"]].positions

    def words(self, take: str | int | Take) -> U64:
        """Return the words of a take: of every frame its features as bits.

        Parameters
        ----------
        take : str, int or Take
            The take, by name or id.

        Returns
        -------
        uint64 array (T,)
            Bit i − 1 is feature Fi; ``0xFFFFFFFFFFFFFFFF`` in invalid frames.

        Raises
        ------
        StoreError
            There is no such take.

        Examples
        --------
        >>> len(store.words(take)) == len(take)
        True
        """
        return self[self._row(take)["name"]].words()
