"""`python -m studies.recognition BANDAI HDM05 TRUTH CMU_TRUTH`: compare methods that recognise motions.

BANDAI is the store of `python -m studies.bandai`, HDM05 that of `kinedex run hdm05-cmu`, TRUTH the ground truth of
HDM05's takes, and CMU_TRUTH that of CMU's. All methods learn from the same examples and label the same takes, which are
also the archive's unlabelled takes. Protocols:

- of each content of Bandai that has eight takes at least, a number of examples is drawn, whatever their style; the
  other takes are labelled as they are (per cent with the right content), and laid end to end, twenty to a long take,
  without anything that says where one ends; with half of the contents taught; and with pieces of CMU's takes between;
- styles left out: a third of the styles of Bandai's dataset 1, and its dataset 2, learned from dataset 1;
- of HDM05, the clips of one actor at a time are laid end to end and labelled by what the others teach, with all classes
  or half of them; the takes of the actor mm, of whom there are no clips; and takes of CMU with labels.

A method that has labelled a trial is not run again while its code is the same. `--anew` runs all.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.evaluation.metrics import Counts, compare
from kinedex.ops.evaluation.reliability import EDGES, reliability
from kinedex.pipelines.engine.code_digest import code_digest
from kinedex.storage.store.store import Store, open_store
from studies import BUILD
from studies.recognition_methods import METHODS, Found, most_of
from studies.recognition_protocols import (
    FOREIGN,
    Label,
    Protocol,
    Trial,
    bandai_protocols,
    cmu_protocol,
    hdm05_protocols,
    motions_of,
)

BOOTSTRAPS = 1000
CLOSE, FEW = 0.05, 20
"""A bucket of confidences holds where the share of right labels is so near to their mean; one of few is not judged."""

PATHS = {
    "thesis": "kinedex.pipelines.annotation.template_methods:ThesisMethod",
    "best": "kinedex.pipelines.annotation.template_methods:BestMethod",
    "each_example": "kinedex.pipelines.annotation.single_examples:SingleExamples",
}
"""The code of methods by templates; what they labelled is kept while it is the same."""

RECOGNISER = "kinedex.ops.numeric.recogniser:Recogniser"
"""The code of methods by numbers."""


@dataclass(frozen=True)
class Result:
    """The labels of a trial's takes by one method, and how each take was scored.

    Attributes
    ----------
    counts : float64 array (T, 7)
        The counts of each take (`Counts`); of whole takes 1 if the class is right, and 1, in the first two columns.
    sureness : float64 array (S,)
        How sure the method is of each label of all takes.
    right : bool array (S,)
        True for labels most of whose frames show the class.
    """

    counts: F64
    sureness: F64
    right: np.ndarray


def labels_of(store: Store, protocol: str, name: str, trial: Trial, method: str, folder: Path) -> list[list[Found]]:
    """Return the labels of a trial's takes, from a file if a method of the same code has written them."""
    digest = hashlib.sha256(f"{code_digest(PATHS.get(method, RECOGNISER))} {protocol} {name}".encode())
    for one in (*trial.examples, *trial.takes):
        digest.update(one.positions.tobytes() + f"{one.truth}".encode())
    path = folder / f"{method}-{digest.hexdigest()[:20]}.json"
    if path.is_file():
        return [[Found(*one) for one in own] for own in json.loads(path.read_text(encoding="utf-8"))["labels"]]
    begin = time.perf_counter()
    found = METHODS[method](store, trial)
    text = json.dumps({"seconds": time.perf_counter() - begin, "protocol": protocol, "trial": name, "labels": found})
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(text, encoding="utf-8")
    part.replace(path)
    return found


def scored(found: Sequence[Sequence[Found]], trial: Trial) -> Result:
    """Return how the labels of a trial agree with its true ones."""
    renamed = [[one._replace(label=trial.classes.get(one.label, one.label)) for one in own] for own in found]
    rows, sureness, right = [], [], []
    for own, take in zip(renamed, trial.takes, strict=True):
        if trial.whole:
            rows.append((float(most_of(own) == take.label), 1.0, *[0.0] * 5))
        else:
            rows.append(astuple(_counts(own, take.truth)))
        sureness += [one.sureness for one in own]
        right += [_is_right(one, take.truth) for one in own]
    return Result(np.array(rows, np.float64).reshape(-1, 7), np.array(sureness), np.array(right, np.bool_))


def _counts(found: Sequence[Found], truth: Sequence[Label]) -> Counts:
    """Return the counts of one take, over all classes."""
    whole = Counts()
    for label in sorted({one.label for one in found} | {one[2] for one in truth}):
        automatic = [(one.start, one.stop) for one in found if one.label == label]
        whole += compare(automatic, [one[:2] for one in truth if one[2] == label])
    return whole


def _is_right(found: Found, truth: Sequence[Label]) -> bool:
    """Return whether most frames of a segment show its class."""
    within = sum(max(0, min(found.stop, b) - max(found.start, a)) for a, b, label in truth if label == found.label)
    return 2 * within > found.stop - found.start


def measures(counts: F64, *, whole: bool) -> F64:
    """Return the measures of summed counts (…, 7): the share of right takes, or F (frames) and F (segments)."""
    with np.errstate(invalid="ignore", divide="ignore"):
        if whole:
            return counts[..., :1] / counts[..., 1:2]
        both, automatic, manual, hit, segments, manual_hit, manual_segments = np.moveaxis(counts, -1, 0)
        frames = 2 * both / (automatic + manual)
        precision, recall = hit / segments, manual_hit / manual_segments
        f2 = 2 * precision * recall / (precision + recall)
    return np.nan_to_num(np.stack([frames, f2], axis=-1))


def interval(first: Sequence[Result], second: Sequence[Result], *, whole: bool) -> F64:
    """Return the 95 % intervals of the mean differences of two methods, float64 (measures, 2).

    Trials are drawn with replacement, and of each the takes, the same for both methods (bootstrap).
    """
    generator = np.random.default_rng(0)
    found = []
    for _ in range(BOOTSTRAPS):
        differences = []
        for trial in generator.integers(len(first), size=len(first)).tolist():
            takes = generator.integers(len(first[trial].counts), size=len(first[trial].counts))
            own, other = (measures(one[trial].counts[takes].sum(axis=0), whole=whole) for one in (first, second))
            differences.append(own - other)
        found.append(np.mean(differences, axis=0))
    return np.percentile(found, [2.5, 97.5], axis=0).T


def row_of(protocol: str, results: Mapping[str, Sequence[Result]], whole: bool) -> str:
    """Return the row of a protocol: mean and deviation over trials of each method, and the interval of a difference."""
    cells = []
    scale, digits = (100, 1) if whole else (1, 2)
    for own in results.values():
        values = scale * np.array([measures(one.counts.sum(axis=0), whole=whole) for one in own])
        spread = values.std(axis=0, ddof=1) if len(values) > 1 else None
        parts = [
            f"{mean:.{digits}f}" + (f" ± {spread[k]:.{digits}f}" if spread is not None else "")
            for k, mean in enumerate(values.mean(axis=0))
        ]
        cells.append(" / ".join(parts))
    if {"numeric", "best"} <= set(results):
        edges = scale * interval(results["numeric"], results["best"], whole=whole)
        cells.append(" / ".join(f"{low:+.{digits}f} to {high:+.{digits}f}".replace("-", "−") for low, high in edges))
    return f"| {protocol} | {' | '.join(cells)} |"


def calibration_row(protocol: str, results: Sequence[Result]) -> str:
    """Return the row of a protocol in the table of calibration."""
    sureness, right = (np.concatenate([getattr(one, name) for one in results]) for name in ("sureness", "right"))
    cells, close, judged = [], 0, 0
    for bucket in reliability(np.clip(sureness, 0, 1), right, EDGES):
        if bucket.count >= FEW:
            judged += 1
            close += abs(bucket.share - bucket.confidence) <= CLOSE
        cells.append(f"{bucket.confidence:.2f} → {bucket.share:.2f} ({bucket.count})" if bucket.count else "–")
    return f"| {protocol} | {' | '.join(cells)} | {close} of {judged} |"


def rows(
    store: Store, protocols: Sequence[Protocol], methods: Sequence[str], folder: Path
) -> Iterator[tuple[str, str]]:
    """Yield of each protocol the row of the table, and that of the calibration of the recogniser."""
    for protocol in protocols:
        results: dict[str, list[Result]] = {method: [] for method in methods}
        whole = False
        for name, make in protocol.trials.items():
            trial = make()
            whole = trial.whole
            for method in methods:
                results[method].append(scored(labels_of(store, protocol.name, name, trial, method, folder), trial))
        sure = calibration_row(protocol.name, results["numeric"]) if "numeric" in methods else ""
        yield row_of(protocol.name, results, whole), sure


def main() -> None:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(
        prog="python -m studies.recognition", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("bandai", type=Path, help="store of `python -m studies.bandai`")
    parser.add_argument("hdm05", type=Path, help="store of `kinedex run hdm05-cmu`")
    parser.add_argument("truth", type=Path, help="ground truth of the takes of mm")
    parser.add_argument("cmu_truth", type=Path, help="ground truth of CMU's takes")
    parser.add_argument("--examples", type=int, nargs="+", default=[1, 3, 5, 10], help="of each content of Bandai")
    parser.add_argument("--draws", type=int, default=6, help="number of draws of Bandai's takes")
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=list(METHODS))
    parser.add_argument("--only", default="", help="a part of the names of protocols")
    parser.add_argument("--results", type=Path, default=BUILD / "recognition", help="folder of what was labelled")
    given = parser.parse_args()
    stores = {path: open_store(path) for path in (given.bandai, given.hdm05)}
    bandai, hdm05 = (motions_of(store) for store in stores.values())
    foreign = [hdm05[name] for name in FOREIGN if name in hdm05]
    one = stores[given.hdm05]
    protocols = [
        *bandai_protocols(list(bandai.values()), foreign, given.examples, given.draws),
        *hdm05_protocols(one, hdm05, given.truth, foreign),
        cmu_protocol(one, hdm05, given.cmu_truth),
    ]
    chosen = [protocol for protocol in protocols if given.only in protocol.name]
    both = {"numeric", "best"} <= set(given.methods)
    print("| per cent, or F (frames) / F (segments) | " + " | ".join(given.methods) + " | numeric − best |" * both)
    print("|---" * (1 + len(given.methods) + both) + "|")
    sure = []
    for row, calibration in rows(one, chosen, given.methods, given.results):
        print(row, flush=True)
        sure.append(calibration)
    if "numeric" in given.methods:
        edges = " | ".join(f"to {edge:g}" for edge in EDGES[1:])
        print(f"\n| probability → share of right labels (labels) | {edges} | within 5 points |\n|---{'|---' * 6}|")
        print("\n".join(sure))


if __name__ == "__main__":
    main()
