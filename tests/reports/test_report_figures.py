"""The parts of a report: timelines, curves, template images, the choice of takes, colours."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.ops.errors import ParameterError
from kinedex.ops.intervals import TakeSegment
from kinedex.pipelines.engine.page_files import write_page
from kinedex.reports.palette import CLASS_COLOURS
from kinedex.reports.pixels import SCALE, quantised_image, soft_image, wildcard_share
from kinedex.reports.plots import time_axis
from kinedex.reports.report_data import Curve, Score, TakeRow
from kinedex.reports.take_selection import choose_takes, median_take, worst_middle_best
from kinedex.reports.timelines import HEIGHT, POINTS, curve_diagram, line, minima, thinned_frames, timeline
from tests.pipelines.study import FRAMES, study


def test_a_segment_that_the_other_side_does_not_confirm_is_marked() -> None:
    data = study()
    one = timeline(data.takes[0], data.automatic[:2], data.manual[:1], {"kick": 0, "squat": 1})
    assert [lane.label for lane in one.lanes] == ["kick", "squat"]
    kick, squat = one.lanes
    assert kick.automatic[0].agrees is False
    assert kick.automatic[0].tip == (
        "kick, automatic: 2.00–2.43 s, frames [60, 73), cost 0.100; no manual segment here"
    )
    assert squat.automatic[0].agrees is True
    assert squat.automatic[0].tip.endswith("cost 0.020, as squat2Reps")
    assert (squat.manual[0].left, squat.manual[0].width) == (20.0, 30.0)


def test_segments_that_only_touch_do_not_confirm_each_other() -> None:
    take = TakeRow("t", 30, 30.0)
    drawn = timeline(take, [TakeSegment("t", "a", 0, 10)], [TakeSegment("t", "a", 10, 20)], {"a": 0})
    assert drawn.lanes[0].automatic[0].agrees is False
    assert drawn.lanes[0].manual[0].agrees is False


def test_without_ground_truth_no_segment_is_wrong() -> None:
    drawn = timeline(TakeRow("t", 30, 30.0), [TakeSegment("t", "a", 0, 10)], [], {"a": 0})
    assert drawn.lanes[0].automatic[0].agrees is None
    empty = Score("annotate", "take", "t", f1=0.0)  # somebody found nothing in it, so all that is found is wrong
    drawn = timeline(TakeRow("t", 30, 30.0), [TakeSegment("t", "a", 0, 10)], [], {"a": 0}, empty)
    assert drawn.lanes[0].automatic[0].agrees is False


def test_few_takes_are_all_shown_the_worst_first() -> None:
    choice = choose_takes(["a", "b", "c"], {"a": 0.9, "b": 0.2})
    assert choice.shown == ("b", "a", "c")
    assert choice.left_out == ()


def test_of_many_takes_the_worst_the_middle_and_the_best_are_shown() -> None:
    ranked = [f"t{i}" for i in range(11)]
    assert worst_middle_best(ranked, 3) == ["t0", "t5", "t10"]
    assert worst_middle_best(ranked, 5) == ["t0", "t1", "t5", "t9", "t10"]
    assert worst_middle_best(ranked, 1) == ["t0"]
    for count in range(1, 14):
        chosen = worst_middle_best(ranked, count)
        assert len(chosen) == min(count, 11)
        assert chosen == sorted(set(chosen), key=ranked.index)


def test_a_few_of_many_timelines_lead_and_the_others_are_folded() -> None:
    names = [f"t{i:02d}" for i in range(12)]
    choice = choose_takes(names, {name: i / 12 for i, name in enumerate(names)})
    assert choice.shown[:6] == ("t00", "t01", "t05", "t06", "t10", "t11")
    assert sorted(choice.shown) == names
    assert choice.folded == 6
    assert choose_takes(names, {}, wanted=names).folded == 0


def test_takes_with_a_score_go_before_those_without() -> None:
    choice = choose_takes(["a", "b", "c", "d"], {"d": 0.5}, max_takes=2)
    assert choice.shown == ("d", "a")
    assert choice.left_out == ("b", "c")


def test_at_least_one_take_must_be_allowed() -> None:
    with pytest.raises(ParameterError, match="max_takes must be at least 1"):
        choose_takes(["a"], {}, max_takes=0)


def test_the_median_take_is_the_lower_one_of_two() -> None:
    assert median_take({"a": 0.9, "b": 0.1, "c": 0.5, "d": 0.6}) == "c"
    assert median_take({}) is None


def test_time_axes_have_round_steps_and_few_texts() -> None:
    assert time_axis(20.0).ticks == ((0.0, "0"), (25.0, "5"), (50.0, "10"), (75.0, "15 s"))
    assert time_axis(0.5).ticks[1] == (20.0, "0.1")
    for seconds in (0.03, 1.0, 7.7, 61.0, 3599.0, 90000.0):
        assert 1 <= len(time_axis(seconds).ticks) <= 9


def test_an_infinite_cost_is_a_gap_in_the_curve() -> None:
    costs = np.array([np.inf, 0.5, 0.25, 0.25, 0.25, np.inf, 0.0])
    assert line(costs, 0.5) == "M1 0l1 100h2M6 200"


def test_a_long_curve_keeps_every_lowest_point() -> None:
    generator = np.random.default_rng(1)
    costs = generator.random(10 * POINTS)
    costs[12345] = -1.0
    frames, kept = thinned_frames(costs)
    assert len(frames) <= POINTS + 2
    assert 12345 in frames
    assert np.array_equal(costs[frames], kept)
    assert np.all(np.diff(frames) > 0)


def test_a_plateau_below_the_threshold_is_one_mark() -> None:
    costs = np.array([0.3, 0.1, 0.1, 0.1, 0.3, 0.05, 0.2, 0.2, np.inf])
    marks = minima(Curve("a", "a1", costs), 0.5, 30.0, 0.13)
    assert [mark.path for mark in marks] == ["M1 160h2", "M5 180h0"]
    assert marks[1].tip == "a1 ends at frame 5, 0.17 s: cost 0.050"


def test_classes_without_segments_and_minima_are_put_aside() -> None:
    data = study()
    curves = [*data.curves, Curve("jump", "jump", np.full(FRAMES, 0.4)), Curve("rest", "rest", np.full(FRAMES, np.inf))]
    slots = {"jump": 0, "kick": 1, "rest": 2, "squat": 3}
    figure = curve_diagram(data.takes[0], curves, data.automatic[:2], data.manual[:1], slots, 0.13)
    assert [panel.label for panel in figure.panels] == ["kick", "squat"]
    assert [panel.label for panel in figure.quiet] == ["jump", "rest"]
    assert figure.quiet[1].lowest is None
    assert figure.tau_y == pytest.approx(HEIGHT * (1 - 0.13 / figure.top))


def test_a_template_is_black_where_off_white_where_on_and_coloured_between() -> None:
    from PIL import Image

    values = np.array([[0.0, 1.0, 0.5], [0.04, 0.96, 1.0 - 1e-12]])
    soft = decoded(Image, soft_image(values))
    assert soft.shape == (3, 2, 3)
    assert soft[0, 0].tolist() == [0, 0, 0]
    assert soft[1, 0].tolist() == soft[2, 1].tolist() == [255, 255, 255]
    for entry in (soft[2, 0], soft[0, 1], soft[1, 1]):
        assert int(entry.max()) - int(entry.min()) > 50
    quantised = decoded(Image, quantised_image(values, 0.05))
    assert quantised[:, 1].tolist() == [[0, 0, 0], [255, 255, 255], [255, 255, 255]]
    assert quantised[2, 0].tolist() not in ([0, 0, 0], [255, 255, 255])
    assert wildcard_share(values, 0.05) == pytest.approx(1 / 6)
    assert wildcard_share(values, 0.0) == pytest.approx(3 / 6)


def decoded(image: object, uri: str) -> np.ndarray:
    import base64
    import io

    data = base64.b64decode(uri.removeprefix("data:image/png;base64,"))
    pixels = np.asarray(image.open(io.BytesIO(data)).convert("RGB"))  # type: ignore[attr-defined]
    return pixels[::SCALE, ::SCALE]


def test_class_colours_stand_out_from_their_backgrounds() -> None:
    for light, dark in CLASS_COLOURS:
        assert contrast(light, "#ffffff") >= 3
        assert contrast(dark, "#14171b") >= 3


def contrast(one: str, other: str) -> float:
    """The WCAG contrast ratio of two colours."""

    def luminance(colour: str) -> float:
        parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
        linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
        return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_a_page_is_written_whole(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old")
    assert write_page("é", path) == 2
    assert path.read_text(encoding="utf-8") == "é"
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]
