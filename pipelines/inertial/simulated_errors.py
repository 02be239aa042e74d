"""Put simulated errors into the limbs of takes; write label files of the errors and of simulated annotators."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from kinedex.catalog.limbs import LIMBS
from kinedex.ops.inertial.injected_errors import annotate, as_other_side, inject, labelled_runs, own_threshold
from kinedex.ops.inertial.limb_motion import LimbMotion
from kinedex.ops.inertial.limb_orientation import NONE, jumps, long_axis
from kinedex.ops.inertial.rotations import distance_deg, exp, multiply, rotate
from kinedex.ops.inertial.sensor_model import seeded_generator, smooth_noise
from kinedex.pipelines.engine.digests import hash_of
from kinedex.pipelines.inertial.limb_motion import StoredLimbs
from kinedex.storage.durable_files import whole_file
from kinedex.storage.formats.csv_tables import csv_line, unguarded

NOISE_HZ = 6.0
"""The frequency, in Hz, below which the simulated noise of trackers lies."""

ERROR = "error"
"""The class of labels that mark wrong limbs."""

_LABELS = ("take", "class", "start", "stop", "limb", "annotator")
_TRUTH = ("take", "class", "start", "stop", "limb", "annotator", "kind", "degrees")


@dataclass(frozen=True)
class LimbLabel:
    """A label that marks a wrong limb.

    Attributes
    ----------
    take, limb : str
        The take and the limb.
    start, stop : int
        The frames [start, stop) of the source.
    annotator : str
        The name of the person or of the simulated annotator.
    kind : str
        The kind of error; only in labels of the truth.
    degrees : float
        The largest error within the label, in degrees, rounded to two decimals; NaN except in labels of the truth.
    """

    take: str
    limb: str
    start: int
    stop: int
    annotator: str
    kind: str = ""
    degrees: float = float("nan")


@dataclass(frozen=True, eq=False)
class TakeWithErrors:
    """A take with simulated errors: its limbs, the true labels, and those of annotators."""

    limbs: dict[str, LimbMotion]
    truth: list[LimbLabel]
    labels: list[LimbLabel]


def inject_errors(
    take: StoredLimbs, limbs: Iterable[str], noise_deg: float, annotators: int, seed: int
) -> TakeWithErrors:
    """Put simulated errors into the limbs of a take.

    Parameters
    ----------
    take : StoredLimbs
        The limbs.
    limbs : iterable of str
        The limbs that get errors; limbs without an orientation are not changed.
    noise_deg : float
        Root mean square of the smooth noise of all limbs, in degrees.
    annotators : int
        The number of simulated annotators.
    seed : int
        Seed of all random numbers.
    """
    wanted, rate_hz = set(limbs), take.rate_hz
    axes = {name: long_axis(one.orientation, one.direction) for name, one in take.limbs.items()}
    broken: dict[str, LimbMotion] = {}
    truth: list[LimbLabel] = []
    labels: list[LimbLabel] = []
    for name, one in take.limbs.items():
        if one.basis == NONE or rate_hz <= 0:
            broken[name] = one
            continue
        turned = _noisy(one, rate_hz, noise_deg, seeded_generator(seed, "noise", take.take, name))
        if name in wanted and np.isfinite(axes[name]).all():
            other = take.limbs.get(LIMBS[name].opposite)
            swapped = None
            if other is not None and other.limb != name and other.basis != NONE and np.isfinite(axes[other.limb]).all():
                swapped = as_other_side(other.orientation, axes[other.limb], axes[name])
            random = seeded_generator(seed, "errors", take.take, name)
            turned, errors = inject(turned, rate_hz, axes[name], random, swapped)
            for start, stop in labelled_runs(one.orientation, turned):
                kinds = [error.kind for error in errors if error.start < stop and error.stop > start]
                peak = float(np.nanmax(distance_deg(one.orientation[start:stop], turned[start:stop])))
                truth.append(LimbLabel(take.take, name, start, stop, "truth", " ".join(kinds), round(peak, 2)))
            for number in range(annotators):
                threshold = own_threshold(seeded_generator(seed, "annotator", str(number)))
                random = seeded_generator(seed, "annotator", str(number), take.take, name)
                runs = annotate(one.orientation, turned, rate_hz, threshold, random)
                labels += [LimbLabel(take.take, name, *run, f"simulated A{number + 1}") for run in runs]
        direction = rotate(turned, axes[name]) if np.isfinite(axes[name]).all() else one.direction
        jump = one.jump | jumps(turned, rate_hz)
        broken[name] = replace(one, orientation=turned, direction=direction, jump=jump)
    return TakeWithErrors(broken, truth, labels)


def _noisy(one: LimbMotion, rate_hz: float, noise_deg: float, random: np.random.Generator) -> np.ndarray:
    if not noise_deg:
        return one.orientation
    rotations = np.radians(noise_deg) * smooth_noise(len(one.times), rate_hz, NOISE_HZ, random) / np.sqrt(3.0)
    return multiply(one.orientation, exp(rotations))


def label_text(takes: Sequence[str], labels: Sequence[LimbLabel], with_kinds: bool = False) -> str:
    """Return labels as CSV text; a take without labels has a row with only its name.

    Parameters
    ----------
    takes : sequence of str
        All takes that were examined.
    labels : sequence of LimbLabel
        The labels.
    with_kinds : bool, optional
        True to write the kinds of errors and their largest angles as well.
    """
    header = _TRUTH if with_kinds else _LABELS
    by_take: dict[str, list[LimbLabel]] = {take: [] for take in takes}
    for one in labels:
        by_take[one.take].append(one)
    lines = [csv_line(header)]
    for take, own in by_take.items():
        if not own:
            lines.append(csv_line([take, *[None] * (len(header) - 1)]))
        for one in own:
            cells: list[object] = [take, ERROR, one.start, one.stop, one.limb, one.annotator]
            lines.append(csv_line([*cells, one.kind, one.degrees] if with_kinds else cells))
    return "".join(lines)


class SimulatedLabels:
    """The labels of takes with simulated errors, in two files: those of simulated annotators, and the true errors.

    Parameters
    ----------
    labels, truth : Path
        The files, which may exist from an earlier run.
    """

    def __init__(self, labels: Path, truth: Path) -> None:
        self.files = (labels, truth)
        self._labels, self._truth = _read_labels(labels), _read_labels(truth)

    def put(self, take: str, labels: Sequence[LimbLabel], truth: Sequence[LimbLabel]) -> None:
        """Set the labels of a take: those of annotators, and those of the true errors."""
        self._labels[take], self._truth[take] = list(labels), list(truth)

    def digest(self, take: str) -> str:
        """Return a hash of the labels of a take; empty if the take is missing in one of the files."""
        if take not in self._labels or take not in self._truth:
            return ""
        return hash_of(label_text([take], self._labels[take]), label_text([take], self._truth[take], with_kinds=True))

    def of(self, takes: Iterable[str]) -> tuple[list[LimbLabel], list[LimbLabel]]:
        """Return the labels of annotators and the true errors of takes."""
        names = list(takes)
        labels, truth = ([one for take in names for one in found[take]] for found in (self._labels, self._truth))
        return labels, truth

    def write(self, takes: Sequence[str]) -> None:
        """Write the labels of takes, in their order, and replace both files."""
        labels, truth = self.of(takes)
        texts = (label_text(takes, labels), label_text(takes, truth, with_kinds=True))
        for path, text in zip(self.files, texts, strict=True):
            with whole_file(path) as temporary:
                temporary.write_bytes(text.encode())


def _read_labels(file: Path) -> dict[str, list[LimbLabel]]:
    """Return the labels by take in a file that `SimulatedLabels.write` has made; empty for any other file."""
    found: dict[str, list[LimbLabel]] = {}
    try:
        for row in csv.DictReader(io.StringIO(file.read_bytes().decode(), newline=""), strict=True):
            own = found.setdefault(unguarded(row["take"]), [])
            if row["class"]:
                limb, annotator, kind = (unguarded(row.get(name) or "") for name in ("limb", "annotator", "kind"))
                start, stop, degrees = int(row["start"]), int(row["stop"]), float(row.get("degrees") or "nan")
                own.append(LimbLabel(unguarded(row["take"]), limb, start, stop, annotator, kind, degrees))
    except (OSError, csv.Error, KeyError, TypeError, ValueError):
        return {}
    return found
