"""The study of recognition: which takes teach and which are labelled, and how labels of methods are scored."""

from __future__ import annotations

import numpy as np
import pytest

from studies.recognition import Result, calibration_row, interval, measures, row_of, scored
from studies.recognition_methods import Found, mirrored, most_of
from studies.recognition_protocols import Motion, Trial, amid, bandai_protocols, draw, end_to_end, untaught


def clip(name: str, label: str | None, frames: int = 10, group: str = "") -> Motion:
    truth = ((0, frames, label),) if label is not None else ()
    positions = np.full((frames, 24, 3), float(len(name)))
    return Motion(name, positions, np.zeros(frames, np.uint64), truth, group)


BANDAI = [
    clip(f"dataset-{1 + k % 2}_{label}_{k}", label, 30 + k, f"style {k % 5}")
    for label in ("walk-left", "walk-right", "bow")
    for k in range(12)
] + [clip("dataset-1_kick_0", "kick")]


def test_no_take_both_teaches_and_is_labelled() -> None:
    examples, rest = draw(BANDAI, 5, 1)
    assert not {one.name for one in examples} & {one.name for one in rest}
    assert len(examples) == 15
    assert len(rest) == 21
    for protocol in bandai_protocols(BANDAI, [clip("fight", None, 200)], [1, 5], 2):
        for make in protocol.trials.values():
            trial = make()
            learned = {one.positions.tobytes() for one in trial.examples}
            assert learned.isdisjoint(one.positions.tobytes() for one in trial.takes)
            taught = {one.label for one in trial.examples}
            assert {label for one in trial.takes for _, _, label in one.truth} <= taught


def test_motions_lie_end_to_end_with_foreign_ones_between() -> None:
    motions = [clip("a", "bow", 10), clip("bb", "kick", 20), clip("c", "bow", 5)]
    first, second = end_to_end(motions, 2)
    assert first.truth == ((0, 10, "bow"), (10, 30, "kick"))
    assert second.truth == ((0, 5, "bow"),)
    assert first.positions[:, 0, 0].tolist() == [1.0] * 10 + [2.0] * 20
    mixed = amid(motions, [clip("fight", None, 200)], 0)
    assert [one.truth for one in mixed] == [one.truth for one in motions]
    assert all(60 <= len(two.words) - len(one.words) < 150 for one, two in zip(motions, mixed, strict=True))
    assert untaught([first], ["kick"])[0].truth == ((10, 30, "kick"),)


def test_labels_are_scored_by_frames_segments_and_takes() -> None:
    take = Motion("a", np.zeros((30, 24, 3)), np.zeros(30, np.uint64), ((0, 10, "bow"), (10, 30, "move")))
    found = [Found(0, 10, "bow", 0.9), Found(10, 20, "walk", 0.8), Found(20, 30, "bow", 0.3)]
    result = scored([found], Trial([], [take], classes={"walk": "move"}))
    assert result.right.tolist() == [True, True, False]
    assert result.sureness.tolist() == [0.9, 0.8, 0.3]
    frames, segments = measures(result.counts.sum(axis=0), whole=False)
    assert frames == pytest.approx(2 * 20 / 60)
    assert segments == pytest.approx(2 * (2 / 3) * 1 / (2 / 3 + 1))
    whole = [clip("a", "bow"), clip("b", "bow"), clip("c", "bow")]
    found = [Found(0, 3, "kick", 0.9), Found(3, 10, "bow", 0.1)]
    result = scored([found, found[:1], []], Trial([], whole, whole=True))
    assert measures(result.counts.sum(axis=0), whole=True) == pytest.approx([1 / 3])
    assert most_of([Found(0, 3, "kick", 0.9), Found(3, 6, "bow", 0.1)]) == "kick"
    assert mirrored("raise-left-hand") == "raise-right-hand"
    assert mirrored("walk") == "walk"


def test_a_method_that_is_better_in_all_takes_has_an_interval_above_none() -> None:
    def result(right: list[float]) -> Result:
        counts = np.zeros((len(right), 7))
        counts[:, 0], counts[:, 1] = right, 1
        return Result(counts, np.array([0.9] * 30), np.array([True] * 30))

    better, worse = [result([1, 1, 1, 1]), result([1, 1, 1, 0])], [result([0, 0, 0, 0]), result([0, 1, 0, 0])]
    ((low, high),) = interval(better, worse, whole=True).tolist()
    assert 0.2 < low < high <= 1
    ((low, high),) = interval(better, better, whole=True).tolist()
    assert low == high == 0
    row = row_of("few", {"best": worse, "numeric": better}, True)
    assert row.startswith("| few | 12.5 ± 17.7 | 87.5 ± 17.7 | +")
    assert "0.90 → 1.00 (60)" in calibration_row("few", better)
    assert calibration_row("few", better).endswith("0 of 1 |")
