"""Provide the frames of a take (positions, orientation and words) from memory, or from a store when they are needed."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np

from kinedex.ops.arrays import F32, U64
from kinedex.storage.store.store import Store as StoredTakes


class Frames(NamedTuple):
    """The frames of a take: positions (T, J, 3), orientation (T, 4) and words (T,)."""

    positions: F32
    orientation: F32
    words: U64


class FrameSource(Protocol):
    """The interface of sources that return the frames of a take."""

    def frames(self) -> Frames:
        """Return all frames."""
        ...

    def words(self) -> U64:
        """Return only the words, which can be faster."""
        ...

    def part(self, start: int, stop: int) -> FrameSource:
        """Return the source of the frames from start up to, but not including, stop."""
        ...


class LoadedFrames:
    """A source of frames that are already in memory."""

    def __init__(self, frames: Frames) -> None:
        self._frames = frames

    def frames(self) -> Frames:
        """Return all frames."""
        return self._frames

    def words(self) -> U64:
        """Return only the words."""
        return self._frames.words

    def part(self, start: int, stop: int) -> LoadedFrames:
        """Return the frames from start up to, but not including, stop, without a copy."""
        positions, orientation, words = self._frames
        return LoadedFrames(Frames(positions[start:stop], orientation[start:stop], words[start:stop]))


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
