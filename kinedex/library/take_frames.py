"""The frames of a take: positions, orientation and words, in memory or from a source that reads them."""

from __future__ import annotations

from typing import NamedTuple, Protocol

import numpy as np
import numpy.typing as npt

F32 = npt.NDArray[np.float32]
U64 = npt.NDArray[np.uint64]


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
        """Return the words alone, which can be quicker."""
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
        """Return the words alone."""
        return self._frames.words

    def part(self, start: int, stop: int) -> LoadedFrames:
        """Return the frames from start up to, but not including, stop, without a copy."""
        positions, orientation, words = self._frames
        return LoadedFrames(Frames(positions[start:stop], orientation[start:stop], words[start:stop]))
