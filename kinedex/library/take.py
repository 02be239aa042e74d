"""Define takes as Python objects, which are read from a motion file or a store, or made from an array."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.library.arguments import checked_methods
from kinedex.library.take_frames import Frames, FrameSource, LoadedFrames
from kinedex.ops.arrays import F32, U64, Bool
from kinedex.ops.errors import ParameterError
from kinedex.ops.intervals import in_seconds
from kinedex.ops.words import ALL_KNOWN, NO_WORD

if TYPE_CHECKING:
    import polars as pl

    from kinedex.storage.formats.motion.reader import Body


ANALYSIS_RATE_HZ = 30.0
"""The rate at which takes are analysed, in frames per second."""

PLAYED_SECONDS = 120.0
"""The longest part of a take, in seconds, that is embedded in a notebook for its player, with some 200 kB."""

FEATURES = "body40"
"""The feature set that is used by default."""


@checked_methods
class Take:
    """One recorded motion, at the analysis rate of 30 frames per second.

    Takes are returned by `kinedex.read`, by `Take.from_positions`, and by a store (``store["name"]``). The frames of a
    take of a store are read when they are first needed. ``take[30:90]`` is a take with the frames 30 to 89.

    Attributes
    ----------
    name : str
        The name of the take.
    take_id : int or None
        The id in its store; None for a take that is not in a store.
    interval : tuple of int or None
        The frames [start, stop) of the whole take, if this take is an interval of it; None for a whole take.
    rate_hz : float
        Frames per second of all arrays of the take.
    feature_set : FeatureSet
        The feature set, which defines the bits of the words.
    info : dict
        The known columns of the take in the SQL view `takes`: source, format, skeleton, unit, source_rate_hz,
        source_frames, seconds, actor, class and others. Later versions may add entries.

    Examples
    --------
    >>> take = kinedex.read(motion_file)
    >>> take.positions.shape == (len(take), 24, 3)
    True
    >>> take.features()["rknee_bent"].sum() <= len(take)
    True
    """

    def __init__(
        self,
        name: str,
        source: FrameSource,
        length: int,
        feature_set: FeatureSet,
        rate_hz: float,
        info: Mapping[str, Any],
        take_id: int | None = None,
        interval: tuple[int, int] | None = None,
    ) -> None:
        self.name = name
        self.interval = interval
        self.take_id = take_id
        self.rate_hz = rate_hz
        self.feature_set = feature_set
        self.info = dict(info)
        self._source = source
        self._length = length

    @classmethod
    def from_positions(
        cls,
        positions: npt.ArrayLike,
        rate: float,
        *,
        name: str = "array",
        joints: Sequence[str] | None = None,
        orientation: npt.ArrayLike | None = None,
        feature_set: str | Path = FEATURES,
    ) -> Take:
        """Make a take from an array of joint positions.

        Parameters
        ----------
        positions : array_like of float, shape (T, J, 3)
            Joint positions in metres, Y up. A joint that is NaN in all frames is unknown, and so are the features that
            need it. A frame in which another joint is NaN is invalid.
        rate : float
            Frames per second of the array.
        name : str, optional
            The name of the take.
        joints : sequence of str, optional
            The names of the J joints, in any order; by default the 24 joints of the feature set, in its order. Other
            joints of the feature set are unknown.
        orientation : array_like of float, shape (T, 4), optional
            The root's orientation as unit quaternions w, x, y, z. By default it is estimated from hips and spine.
        feature_set : str or Path, optional
            A shipped feature set, or the path of a YAML file.

        Returns
        -------
        Take
            The motion at the analysis rate; positions between two frames of the array are interpolated linearly.

        Raises
        ------
        ParameterError
            An array has another shape, the rate is out of range, or a joint has no known name.

        Examples
        --------
        >>> standing = np.repeat(take.positions[:1], 120, axis=0)
        >>> len(Take.from_positions(standing, rate=60))
        60
        """
        features = load_feature_set(feature_set)
        body = body_of_array(positions, rate, features, joints, orientation)
        return take_of_body(name, body, features)

    def __len__(self) -> int:
        """Return the number of frames."""
        return self._length

    def __getitem__(self, frames: slice) -> Take:
        """Return an interval of the take, as a take.

        Parameters
        ----------
        frames : slice
            Start and stop, counted as in a list; the step must be 1.

        Returns
        -------
        Take
            A take of the same name whose frame 0 is the first frame of the interval.

        Raises
        ------
        ParameterError
            The index is not a slice, or its step is not 1.

        Examples
        --------
        >>> len(take[10:40])
        30
        """
        if not isinstance(frames, slice) or frames.step not in (None, 1):
            raise ParameterError("frames", "a slice with step 1, such as take[30:90]", frames)
        start, stop, _ = frames.indices(self._length)
        stop = max(start, stop)
        info = {**self.info, "frames": stop - start, "seconds": in_seconds(stop - start, self.rate_hz)}
        source = self._source.part(start, stop)
        first = self.interval[0] if self.interval else 0
        of_whole = (first + start, first + stop)
        return Take(self.name, source, stop - start, self.feature_set, self.rate_hz, info, self.take_id, of_whole)

    def __repr__(self) -> str:
        return f"Take({self.label!r}, {self._length} frames, {self.seconds:.2f} s)"

    def _repr_html_(self) -> str:
        from kinedex.reports.notebook_html import ShownTake, take_html

        facts = [
            ("frames", f"{len(self):,} at {self.rate_hz:g} Hz, {self.seconds:.2f} s"),
            ("invalid frames", f"{int((~self.valid).sum()):,}"),
            *((name, str(self.info[name])) for name in ("class", "actor", "source", "skeleton") if self.info.get(name)),
            *(("warning", warning) for warning in self.warnings),
        ]
        played = self[: round(PLAYED_SECONDS * self.rate_hz)].positions
        return take_html(ShownTake(self.label, facts, self.joints, played, len(self), self.rate_hz))

    @property
    def label(self) -> str:
        """Return the name of the take, with its interval if it is not a whole take.

        Returns
        -------
        str
            For example ``"walk_01"``, or ``"walk_01[30:90]"``.
        """
        return self.name if self.interval is None else f"{self.name}[{self.interval[0]}:{self.interval[1]}]"

    @property
    def seconds(self) -> float:
        """Return the duration in seconds.

        Returns
        -------
        float
            The number of frames divided by the rate.
        """
        return in_seconds(self._length, self.rate_hz)

    @property
    def joints(self) -> tuple[str, ...]:
        """Return the names of the joints, in the order of `positions`.

        Returns
        -------
        tuple of str
            24 names for the shipped feature set.
        """
        return self.feature_set.joints

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return the warnings from reading the file.

        Returns
        -------
        tuple of str
            One sentence each; empty if there are none.
        """
        return tuple(self.info.get("warnings") or ())

    @property
    def known(self) -> int:
        """Return the mask of the features that can be computed from the joints of the body.

        Returns
        -------
        int
            A mask with the bits of a word; all 64 bits are set if every feature is known.
        """
        mask = self.info.get("known")
        return int(ALL_KNOWN) if mask is None else int(mask)

    @property
    def unknown_features(self) -> tuple[str, ...]:
        """Return the features that are unknown because the body lacks joints.

        Returns
        -------
        tuple of str
            Names of features, in the order of their numbers; empty if the body has all joints.
        """
        return tuple(self.feature_set.named(~self.known & self.feature_set.every_bit))

    @cached_property
    def _frames(self) -> Frames:
        return self._source.frames()

    @property
    def positions(self) -> F32:
        """Return the positions of the joints.

        Returns
        -------
        float32 array (T, J, 3)
            Positions in metres, Y up; NaN where a joint is not known.
        """
        return self._frames.positions

    @property
    def orientation(self) -> F32:
        """Return the orientation of the root.

        Returns
        -------
        float32 array (T, 4)
            Unit quaternions w, x, y, z; NaN where the orientation is not known.
        """
        return self._frames.orientation

    @property
    def valid(self) -> Bool:
        """Return a mask of the valid frames; invalid frames have no word, and are ignored in searches and annotations.

        Returns
        -------
        bool array (T,)
            False for frames in which a joint of the body is not known.
        """
        valid: Bool = self.words() != NO_WORD
        return valid

    def words(self) -> U64:
        """Return the word of every frame, which has the features of the frame as bits.

        Returns
        -------
        uint64 array (T,)
            Bit i − 1 is feature Fi; ``0xFFFFFFFFFFFFFFFF`` stands for an invalid frame.

        Examples
        --------
        >>> words = take.words()
        >>> words.dtype, len(words) == len(take)
        (dtype('uint64'), True)
        """
        return self._words

    @cached_property
    def _words(self) -> U64:
        return self._source.words()

    def features(self) -> pl.DataFrame:
        """Return the features of every frame.

        Returns
        -------
        polars.DataFrame
            T rows and one Boolean column per feature (40 for the shipped feature set), named after the feature; null in
            invalid frames and for unknown features. ``.to_numpy()`` returns an array (T, 40).

        Examples
        --------
        >>> take.features().shape == (len(take), 40)
        True
        """
        return feature_table(self.words(), self.feature_set, self.known)


def feature_table(words: U64, feature_set: FeatureSet, known: int) -> pl.DataFrame:
    """Return one row per word and one Boolean column per feature, null in invalid frames and for unknown features."""
    import polars as pl

    columns = {one.name: words & np.uint64(1 << (one.number - 1)) != 0 for one in feature_set.features}
    frame, valid = pl.DataFrame(columns), words != NO_WORD
    shown = frame if valid.all() else frame.select(pl.when(pl.Series(valid)).then(pl.all()))
    unknown = feature_set.named(~known & feature_set.every_bit)
    return shown.with_columns(pl.lit(None, pl.Boolean).alias(name) for name in unknown)


def take_of_body(name: str, body: Body, feature_set: FeatureSet, about: Mapping[str, Any] | None = None) -> Take:
    """Compute the words of a body in the same way as an ingest, and return the body as a take."""
    from kinedex.pipelines.ingestion.analysis import (
        analyse,
        known_features,
        measured_quality,
        unknown_feature_warnings,
    )
    from kinedex.storage.snapshot.measured_columns import QUALITY_COLUMNS

    positions, orientation, words = analyse(body, feature_set, ANALYSIS_RATE_HZ)
    known = known_features(feature_set, body)
    figures, doubts = measured_quality(body, feature_set.joints, QUALITY_COLUMNS)
    frames = Frames(
        np.ascontiguousarray(positions.transpose(2, 0, 1), np.float32),
        np.ascontiguousarray(orientation.T, np.float32),
        words,
    )
    info = {
        "name": name,
        **(about or {}),
        "skeleton": body.skeleton,
        "unit": body.unit,
        "source_rate_hz": body.rate_hz,
        "source_frames": body.frames,
        "rate_hz": ANALYSIS_RATE_HZ,
        "frames": len(words),
        "seconds": in_seconds(body.frames, body.rate_hz),
        "invalid_frames": int(np.count_nonzero(words == NO_WORD)),
        "warnings": [*body.warnings, *unknown_feature_warnings(feature_set, body), *doubts],
        "known": None if known == feature_set.every_bit else known,
        **figures,
    }
    return Take(name, LoadedFrames(frames), len(words), feature_set, ANALYSIS_RATE_HZ, info)


_BLOCK = 256  # frames that are transposed at a time, so that they stay in the cache


def body_of_array(
    positions: npt.ArrayLike,
    rate: float,
    feature_set: FeatureSet,
    joints: Sequence[str] | None,
    orientation: npt.ArrayLike | None,
) -> Body:
    """Return a body from positions (T, J, 3) in metres of the given joints; all other joints are NaN."""
    from kinedex.storage.formats.motion.points import root_orientation
    from kinedex.storage.formats.motion.reader import Body

    check_rate(rate)
    names = feature_set.joints if joints is None else tuple(joints)
    given = np.asarray(positions, np.float64)
    if given.ndim != 3 or given.shape[1:] != (len(names), 3) or not len(given):
        raise ParameterError("positions", f"of shape (frames, {len(names)}, 3) with at least 1 frame", given.shape)
    odd = sorted(set(names) - set(feature_set.joints))
    if odd or len(set(names)) < len(names):
        raise ParameterError("joints", f"different names among {', '.join(feature_set.joints)}", odd or list(names))
    placed = np.empty((len(feature_set.joints), 3, len(given)))
    placed[[name not in names for name in feature_set.joints]] = np.nan
    places = [feature_set.joints.index(name) for name in names]
    for start in range(0, len(given), _BLOCK):
        placed[places, :, start : start + _BLOCK] = given[start : start + _BLOCK].transpose(1, 2, 0)
    lost: Bool = np.any(np.isnan(placed), axis=1)
    unknown: Bool = np.all(lost, axis=1)
    valid: Bool = ~np.any(lost[~unknown], axis=0)
    if unknown.all() or not valid.any():
        raise ParameterError("positions", "finite for every joint in at least one frame", "NaN in every frame")
    warnings: list[str] = []
    if orientation is None:
        turned = root_orientation(placed, feature_set.joints, valid, warnings)
    else:
        turned = np.asarray(orientation, np.float64).T
        if turned.shape != (4, len(given)):
            raise ParameterError("orientation", f"of shape ({len(given)}, 4)", turned.T.shape)
    return Body(
        positions=placed,
        orientation=np.ascontiguousarray(turned),
        rate_hz=float(rate),
        unit="1 m",
        skeleton="array",
        unknown=tuple(name for name, gone in zip(feature_set.joints, unknown, strict=True) if gone),
        warnings=tuple(warnings),
        valid=None if valid.all() else valid,
    )


def check_rate(rate: float) -> None:
    """Raise a ParameterError if a rate is outside of the range that is allowed for motion files."""
    from kinedex.storage.formats.motion.reader import FASTEST_HZ, SLOWEST_HZ

    if not (math.isfinite(rate) and SLOWEST_HZ <= rate <= FASTEST_HZ):
        raise ParameterError("rate", f"from {SLOWEST_HZ:g} to {FASTEST_HZ:g} frames per second", rate)
