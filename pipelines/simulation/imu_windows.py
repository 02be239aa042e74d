"""Label samples of simulated sensors: annotated segments in samples, and windows of equal length with a class."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from kinedex.ops.errors import ParameterError
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]

LEAST_SHARE = 0.5
"""The fraction of a window above which the class that covers most of it becomes its class."""


@dataclass(frozen=True)
class Segment:
    """An interval of a take with a class.

    Attributes
    ----------
    origin : str
        label (of a person), annotation (of a method) or take (the class of a take that is one clip).
    name : str
        The class.
    start_s, stop_s : float
        Times in the take, in seconds.
    """

    origin: str
    name: str
    start_s: float
    stop_s: float


@dataclass(frozen=True)
class Windowing:
    """Length and step of windows in seconds."""

    seconds: float = 2.0
    step_s: float = 1.0

    def __post_init__(self) -> None:
        if not 0.0 < self.seconds <= 3600.0:
            raise ParameterError("window", "a positive number of seconds", self.seconds)
        if not 0.0 < self.step_s <= 3600.0:
            raise ParameterError("step", "a positive number of seconds", self.step_s)


def take_segments(store: Store) -> dict[str, list[Segment]]:
    """Return the segments of all takes, by the take's name.

    Labels of people take precedence over annotations if a take has both; a take with neither has the class of its file,
    if there is one.
    """
    found: dict[str, list[Segment]] = {}
    rows = store.sql(
        'SELECT take, "class", start_seconds AS a, stop_seconds AS b FROM labels '
        "WHERE verdict = 'positive' AND limb IS NULL ORDER BY take, start, stop, \"class\""
    ).to_pylist()
    for row in rows:
        found.setdefault(row["take"], []).append(Segment("label", row["class"], row["a"], row["b"]))
    labelled = set(found)
    for row in store.sql(
        'SELECT take, "class", start_seconds AS a, stop_seconds AS b FROM annotations '
        'ORDER BY take, start, stop, "class", subclass'
    ).to_pylist():
        if row["take"] not in labelled:
            found.setdefault(row["take"], []).append(Segment("annotation", row["class"], row["a"], row["b"]))
    for row in store.take_rows.select(["name", "class", "seconds"]).to_pylist():
        if row["name"] not in found and row["class"] is not None:
            found[row["name"]] = [Segment("take", row["class"], 0.0, row["seconds"])]
    return found


def segment_rows(segments: Sequence[Segment], take_times: F64) -> list[tuple[str, str, int, int]]:
    """Return origin, class and samples [start, stop) of the segments that contain samples."""
    rows = []
    for one in segments:
        start, stop = np.searchsorted(take_times, [one.start_s - 1e-9, one.stop_s - 1e-9]).tolist()
        if stop > start:
            rows.append((one.origin, one.name, start, stop))
    return rows


def window_rows(
    rows: Sequence[tuple[str, str, int, int]], samples: int, rate_hz: float, windowing: Windowing
) -> list[tuple[int, int, str, float]]:
    """Return windows [start, stop) in samples, with the class that covers most of each window, and its share.

    The class is empty if none covers more than half of a window.
    """
    width, step = max(1, round(windowing.seconds * rate_hz)), max(1, round(windowing.step_s * rate_hz))
    classes = sorted({name for _, name, _, _ in rows})
    covered = np.zeros((len(classes), samples + 1), np.int64)
    for _, name, start, stop in rows:
        covered[classes.index(name), start:stop] = 1
    sums = np.concatenate([np.zeros((len(classes), 1), np.int64), np.cumsum(covered[:, :samples], axis=1)], axis=1)
    found = []
    for start in range(0, samples - width + 1, step):
        shares = (sums[:, start + width] - sums[:, start]) / width
        best = int(np.argmax(shares)) if len(classes) else -1
        clear = best >= 0 and shares[best] > LEAST_SHARE
        found.append((start, start + width, classes[best] if clear else "", float(shares[best]) if best >= 0 else 0.0))
    return found
