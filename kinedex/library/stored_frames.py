"""Frames of takes in a store, which are read from its Parquet parts when they are needed."""

from __future__ import annotations

import numpy as np

from kinedex.library.take_frames import U64, Frames
from kinedex.storage.store.store import Store as StoredTakes


class StoredFrames:
    """Frames that are read from the parts of a store when they are needed."""

    def __init__(self, stored: StoredTakes, name: str, take_id: int, start: int, stop: int) -> None:
        self._stored, self._name, self._take_id = stored, name, take_id
        self._start, self._stop = start, stop

    def frames(self) -> Frames:
        """Read positions, orientation and words."""
        return stored_frames(self._stored, self._name, self._start, self._stop)

    def words(self) -> U64:
        """Read only the words, not the positions."""
        return self._stored.words([self._take_id]).take(0)[self._start : self._stop]

    def part(self, start: int, stop: int) -> StoredFrames:
        """Return the source of an interval of these frames."""
        return StoredFrames(self._stored, self._name, self._take_id, self._start + start, self._start + stop)


def stored_frames(stored: StoredTakes, name: str, start: int, stop: int) -> Frames:
    """Read the frames of a take from the parts of its store."""
    from kinedex.storage.snapshot.frames import words_of
    from kinedex.storage.snapshot.parts import joint_positions

    table = stored.frames(name, start, stop)
    positions = joint_positions(table, stored.feature_set.joints)
    turned = table.column("root_orientation").combine_chunks().flatten()
    return Frames(
        np.ascontiguousarray(positions.transpose(2, 0, 1)),
        np.stack([part.to_numpy(zero_copy_only=False) for part in turned], axis=1).astype(np.float32),
        words_of(table),
    )
