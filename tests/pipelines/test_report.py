"""A report shows what the store holds, needs nothing else, and says what is missing."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from catalog.features import load_feature_set
from ops.errors import KinedexError, ParameterError
from pipelines.context import StageContext
from pipelines.executors import make_executor
from pipelines.report.axes import time_axis
from pipelines.report.choice import choose_takes, median_take, worst_middle_best
from pipelines.report.curves import HEIGHT, POINTS, curve_figure, line, minima, thin
from pipelines.report.data import (
    Curve,
    Failure,
    FeatureNames,
    HitCount,
    ReportData,
    Score,
    Segment,
    StageRow,
    TakeRow,
    Template,
)
from pipelines.report.gather import gather
from pipelines.report.palette import CLASS_COLOURS
from pipelines.report.pixels import SCALE, quantised_image, soft_image, wildcard_share
from pipelines.report.render import render
from pipelines.report.timelines import timeline
from pipelines.report.write import write_page
from pipelines.stages import report as stage
from pipelines.terminal import Terminal
from storage.manifest import StageRecord
from storage.schemas import frames_schema, result_schema, takes_schema
from storage.store import open_store
from storage.writer import StoreWriter

MOMENT = datetime(2026, 11, 21, 4, 27, tzinfo=UTC)
FRAMES = 90


def study() -> ReportData:
    """Two takes of three seconds, two classes: squats are found, one kick is missed and one is wrong."""
    names = FeatureNames("body4", "1", "0123abcd", ("knee_bent", "foot_raised", "hand_fast", "root_fast"),
                         (("upper", 1, 2), ("lower", 3, 2)))  # fmt: skip
    values = np.array([[0.0, 1.0, 0.5, 0.0], [0.0, 1.0, 1.0, 0.25], [1.0, 0.97, 0.0, 0.0]])
    squat = np.full(FRAMES, 0.3)
    squat[:10] = np.inf
    squat[40] = 0.02
    kick = np.full(FRAMES, 0.25)
    kick[70:73] = 0.1
    return ReportData(
        title="Squats and kicks",
        pipeline="study",
        created=MOMENT,
        store_path="/data/store",
        source_roots=("/data/archive",),
        kinedex_version="0.1.0",
        feature_set=names,
        archive_takes=5,
        archive_seconds=30.0,
        takes=(TakeRow("one", FRAMES, 30.0, "ann"), TakeRow("two", FRAMES, 30.0, "bob", ("no header",))),
        automatic=(
            Segment("one", "squat", 20, 41, 0.02, "squat2Reps"),
            Segment("one", "kick", 60, 73, 0.1, "kick"),
            Segment("two", "squat", 0, 45, 0.04, "squat1Reps"),
        ),
        manual=(Segment("one", "squat", 18, 45), Segment("two", "squat", 5, 40), Segment("two", "kick", 50, 70)),
        delta=0.05,
        tau=0.13,
        method="thesis",
        searched_share=1.0,
        scores=(
            Score("annotate", "pooled", "all", 0.8, 0.6, 0.69, 0.67, 0.67, 0.67, 56, 79, 82, 2, 3, 2, 3),
            Score("annotate", "class", "kick", 0.0, 0.0, None, 0.0, 0.0, None, 0, 13, 20, 0, 1, 0, 1),
            Score("annotate", "class", "squat", 0.85, 0.9, 0.87, 1.0, 1.0, 1.0, 56, 66, 62, 2, 2, 2, 2),
            Score("annotate", "take", "one", 0.62, 0.78, 0.69, 0.5, 1.0, 0.67, 21, 34, 27, 1, 2, 1, 1),
            Score("annotate", "take", "two", 0.78, 0.64, 0.7, 1.0, 0.5, 0.67, 35, 45, 55, 1, 1, 1, 2),
            Score("held", "pooled", "all", 0.5, 0.51, 0.52, 0.53, 0.54, 0.55, 1, 2, 3, 4, 5, 6, 7),
            Score("held", "fold", "ann", 0.5, 0.51, 0.52, 0.53, 0.54, 0.55, 1, 2, 3, 4, 5, 6, 7),
        ),
        evaluation="annotate",
        held_out="held",
        subclasses={"kick": ("kick",), "squat": ("squat1Reps", "squat2Reps")},
        templates=(
            Template("squat2Reps", "squat", "soft", values, ("c1", "c2", "c3"), 3, (0.1, 0.004)),
            Template("kick", "kick", "soft", values, ("c4",), 1, ()),
        ),
        curves=(Curve("squat", "squat2Reps", squat), Curve("kick", "kick", kick)),
        curves_take="one",
        curves_choice="the one in the middle by F1",
        hits=(HitCount("kick", 2, 1, 1.5),),
        failures=(Failure("clips/bad.amc", "ingest", "SourceError", "frame 3 lacks rfemur", 17),),
        warnings=(("two", "no header"),),
        stages=(StageRow("ingest", "r-1", "2026-11-21T04:00:00Z", 3.0, "abc", {"source": "x"}, {"takes": 5}),),
        versions=(("Python", "3.11"),),
        commands=("kinedex run study --store /data/store",),
    )


class Reading(HTMLParser):
    """The text of a page, and every attribute that could make a browser fetch something."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.words: list[str] = []
        self.references: list[str] = []
        self.tags: list[str] = []
        self.open: list[str] = []
        self.feed(page)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        if tag not in {"meta", "img", "br", "hr", "rect", "path", "wbr"}:
            self.open.append(tag)
        self.references += [
            value or "" for name, value in attrs if name in {"src", "href", "xlink:href", "data", "srcset"}
        ]

    def handle_endtag(self, tag: str) -> None:
        if tag not in {"meta", "img", "br", "hr", "path", "wbr"} and self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in {"style", "script"}:
            self.words.append(data)


# ---- the page -----------------------------------------------------------------------------------------------


def test_a_page_shows_numbers_takes_templates_curves_and_what_is_missing() -> None:
    text = Reading(render(study())).text
    for expected in (
        "Squats and kicks", "0.69 F1", "0.67 F2", "0.52 F1", "56 carry the class", "2 of 3 automatic segments",
        "τ = 0.13", "δ = 0.05", "the lowest F1 first", "squat2Reps in class squat", "3 frames = 0.10 s", "3 clips",
        "3 rounds", "knee bent", "lowest 0.020", "frame 3 lacks rfemur", "two : no header", "kinedex run study",
        "digest 0123abcd",
    ):  # fmt: skip
        assert expected in text, expected


def test_a_page_needs_nothing_but_itself() -> None:
    page = render(study())
    reading = Reading(page)
    assert "http:" not in page
    assert "https:" not in page
    assert "url(" not in page
    assert "@import" not in page
    assert {reference.split(":")[0] for reference in reading.references if not reference.startswith("#")} == {"data"}
    assert not {"link", "iframe", "object", "embed"} & set(reading.tags)
    assert "default-src 'none'" in page


def test_every_tag_that_opens_closes() -> None:
    assert Reading(render(study())).open == []


def test_names_from_data_never_become_markup() -> None:
    evil = '<script>alert("x")</script>&\'"'
    data = study()
    data = replace(
        data,
        title=evil,
        pipeline=evil,
        store_path=evil,
        source_roots=(evil,),
        takes=(TakeRow(evil, FRAMES, 30.0, evil, (evil,)),),
        automatic=(Segment(evil, evil, 0, 9, 0.1, evil + "2"),),
        manual=(Segment(evil, evil + "3", 0, 9),),
        scores=tuple(replace(s, name=evil) for s in data.scores),
        templates=(replace(data.templates[0], subclass=evil, label=evil, clips=(evil,)),),
        curves=(Curve(evil, evil, np.full(FRAMES, 0.1)),),
        curves_take=evil,
        curves_choice=evil,
        hits=(HitCount(evil, 1, 1, 1.0),),
        failures=(Failure(evil, evil, evil, evil, 1),),
        warnings=((evil, evil),),
        stages=(StageRow(evil, evil, evil, 1.0, evil, {evil: evil}, {evil: evil}),),
        feature_set=replace(data.feature_set, name=evil, names=(evil, evil, "c", "d"), sets=((evil, 1, 4),)),
        subclasses={},
        commands=(evil,),
        method=evil,
    )
    page = render(data)
    assert Reading(page).tags.count("script") == 1
    assert "<script>alert" not in page


def test_the_same_data_give_the_same_page_and_the_moment_is_given() -> None:
    assert render(study()) == render(study())
    later = render(replace(study(), created=datetime(2027, 1, 2, tzinfo=UTC)))
    assert later.replace("2027-01-02 00:00", "2026-11-21 04:27") == render(study())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"scores": (), "evaluation": None, "held_out": None}, "No evaluation is stored for this run"),
        ({"scores": (), "evaluation": None, "held_out": None}, "Without an evaluation there are no tables"),
        ({"held_out": None}, "Leave one actor out was not run."),
        ({"manual": ()}, "There is no ground truth for these takes"),
        ({"templates": ()}, "No templates are stored for this run"),
        ({"curves": ()}, "No distance curves are stored for the take “one”"),
        ({"curves": (), "curves_take": None}, "No distance curves are stored for any take"),
        ({"failures": ()}, "Every source file came in"),
        ({"warnings": ()}, "No take carries a warning"),
        ({"takes": (), "automatic": (), "manual": (), "curves": ()}, "No take was annotated"),
        ({"automatic": (), "manual": ()}, "Nothing was labelled in this take"),
        ({"tau": None}, "The threshold τ is not stored, so minima are not marked"),
        ({"delta": None}, "The store does not say which δ annotation used"),
        ({"stages": ()}, "manifest records no stage of this pipeline"),
        ({"learned_from": ("bob",)}, "No example clip is of ann, so this result equals the plain one"),
        ({"searched_share": 0.15}, "narrowed the search to 15% of the frames"),
        ({"other_templates": 3}, "3 templates of another kind"),
    ],
)  # fmt: skip
def test_what_is_missing_is_said(change: dict[str, object], sentence: str) -> None:
    assert sentence in Reading(render(replace(study(), **change))).text  # type: ignore[arg-type]


def test_classes_that_only_one_side_knows_are_named() -> None:
    data = study()
    jump = replace(data, manual=(*data.manual, Segment("two", "jump", 80, 90)))
    assert "without a template, so never found: jump" in Reading(render(jump)).text
    no_kick = replace(data, manual=data.manual[:2])
    assert "every label of theirs counts as wrong: kick" in Reading(render(no_kick)).text


def test_takes_left_out_are_counted_and_named() -> None:
    text = Reading(render(study(), max_takes=1)).text
    assert "1 take left out" in text
    assert re.search(r"1 take without a timeline here two", text)


def test_a_take_that_was_not_annotated_cannot_be_asked_for() -> None:
    with pytest.raises(KinedexError, match="no annotated take is named 'tow'; did you mean 'two'"):
        render(study(), takes=["tow"])


def test_long_lists_say_how_many_more_there_are() -> None:
    data = study()
    many = replace(
        data,
        failures=tuple(Failure(f"bad{i:04d}.amc", "ingest", "SourceError", "cut", 1) for i in range(520)),
        warnings=tuple((f"take{i}", "odd") for i in range(510)),
        scores=(data.scores[0], *(Score("annotate", "take", f"t{i:04d}", f1=i / 600) for i in range(600))),
        templates=tuple(replace(data.templates[0], subclass=f"s{i:02d}") for i in range(20)),
    )
    page = render(many)
    text = Reading(page).text
    for expected in ("20 more: SELECT * FROM ingest_log", "10 more: SELECT name, warnings", "of 600; all of them",
                     "4 further templates"):  # fmt: skip
        assert expected in text
    assert "t0499" in text
    assert "t0500" not in text
    assert Reading(page).open == []


def test_forty_takes_of_fifteen_classes_stay_below_five_megabytes() -> None:
    generator = np.random.default_rng(5)
    labels = [f"class{i:02d}" for i in range(15)]
    takes = tuple(TakeRow(f"take{i:03d}", 3600, 30.0) for i in range(40))
    segments = tuple(
        Segment(take.name, labels[int(generator.integers(15))], start, start + 40, 0.1, "sub")
        for take in takes
        for start in range(0, 3500, 45)
    )
    curves = tuple(Curve(label, label, generator.random(3600)) for label in labels)
    values = generator.random((60, 4))
    data = replace(
        study(),
        takes=takes,
        automatic=segments,
        manual=segments,
        scores=(),
        evaluation=None,
        templates=tuple(Template(label, label, "soft", values, ("c",), 3) for label in labels),
        curves=curves,
        curves_take="take000",
    )
    assert len(render(data).encode()) < 5_000_000


# ---- its parts ----------------------------------------------------------------------------------------------


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
    drawn = timeline(take, [Segment("t", "a", 0, 10)], [Segment("t", "a", 10, 20)], {"a": 0})
    assert drawn.lanes[0].automatic[0].agrees is False
    assert drawn.lanes[0].manual[0].agrees is False


def test_without_ground_truth_no_segment_is_wrong() -> None:
    drawn = timeline(TakeRow("t", 30, 30.0), [Segment("t", "a", 0, 10)], [], {"a": 0})
    assert drawn.lanes[0].automatic[0].agrees is None


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
    frames, kept = thin(costs)
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
    figure = curve_figure(data.takes[0], curves, data.automatic[:2], data.manual[:1], slots, 0.13)
    assert [panel.label for panel in figure.panels] == ["kick", "squat"]
    assert [panel.label for panel in figure.quiet] == ["jump", "rest"]
    assert figure.quiet[1].lowest is None
    assert figure.tau_y == pytest.approx(HEIGHT * (1 - 0.13 / figure.top))


def test_a_template_is_black_where_off_white_where_on_and_coloured_between() -> None:
    from PIL import Image  # comes with matplotlib

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


# ---- from a store -------------------------------------------------------------------------------------------


def table(schema: pa.Schema, rows: list[dict[str, object]]) -> pa.Table:
    """Rows of a schema; what they do not say is null."""
    return pa.Table.from_pylist([{name: row.get(name) for name in schema.names} for row in rows], schema=schema)


@pytest.fixture
def store(tmp_path: Path) -> Path:
    """A store with two annotated takes and one clip, as the pipeline `study` would leave it."""
    features = load_feature_set()
    path = tmp_path / "store"
    names = {"clip_a": "squat1Reps", "long_1": None, "long_2": None}
    with StoreWriter.open(path, features) as writer:
        ids = writer.assign_take_ids(names)
        takes = [
            {"take_id": ids[name], "name": name, "source": f"{name}.amc", "source_root": "/archive", "rate_hz": 30.0,
             "frames": FRAMES, "seconds": 3.0, "actor": "ann", "class": label, "groups": "{}",
             "warnings": ["odd header"] if name == "long_1" else []}
            for name, label in names.items()
        ]  # fmt: skip
        point, turn = dict.fromkeys("xyz", 0.0), dict(zip("wxyz", (1.0, 0.0, 0.0, 0.0), strict=True))
        joints = dict.fromkeys(features.joints, point)
        frames = [
            {"take_id": i, "frame": f, **joints, "root_orientation": turn, "word": 0}
            for i in sorted(ids.values())
            for f in range(FRAMES)
        ]
        writer.add_takes(table(takes_schema(), takes), table(frames_schema(features, 30.0), frames))

        def put(kind: str, stage: str, rows: list[dict[str, object]]) -> None:
            schema = result_schema(kind)
            rows = [{**row, "run": f"run-{stage}"} for row in rows]
            writer.put_results(kind, table(schema, rows), stage=f"study/{stage}", run=f"run-{stage}")

        put("templates", "learn_templates", [
            {"subclass": "squat1Reps", "kind": kind, "features": 40, "columns": 2, "values": [0.0, 1.0] * 40,
             "weights": [1.0, 1.0], "clips": ["clip_a"], "rounds": 1, "costs": [0.0]} for kind in ("soft", "hard")
        ])  # fmt: skip
        put("distance_curves", "annotate", [
            {"take_id": ids[name], "take": name, "class": "squat", "subclass": "squat1Reps",
             "costs": [0.5] * 40 + [low] + [0.5] * 49, "preselected": 0.5}
            for name, low in (("long_1", 0.01), ("long_2", 0.02))
        ])  # fmt: skip
        put("annotations", "annotate", [
            {"take_id": ids["long_1"], "take": "long_1", "class": "squat", "subclass": "squat1Reps", "start": 20,
             "stop": 41, "start_seconds": 0.67, "stop_seconds": 1.37, "cost": 0.01, "method": "thesis"}
        ])  # fmt: skip
        put("ground_truth", "evaluate", [
            {"take_id": ids["long_1"], "take": "long_1", "class": "squat", "start": 21, "stop": 44, "origin": "x.csv"}
        ])  # fmt: skip
        for name, measure in (("evaluate", 0.91), ("leave_one_out", 0.61)):
            put("metrics", name, [
                {"evaluation": name, "scope": scope, "name": of, "f1": measure, "f2": measure,
                 **dict.fromkeys(result_schema("metrics").names[10:], 7)}
                for scope, of in (("pooled", "all"), ("take", "long_1"), ("fold", "ann"))
            ])  # fmt: skip
        put("ingest_log", "ingest", [
            {"source": "bad.amc", "stage": "ingest", "error": "SourceError", "message": "frame 9 is cut", "line": 99,
             "logged_at": MOMENT}
        ])  # fmt: skip
        for name in ("ingest", "learn_templates", "annotate", "evaluate", "report"):
            summary = {
                "uses": name,
                "params": {"delta": 0.04, "tau": 0.11, "templates": "soft"},
                "searched": 0.5,
                "inputs": {"takes": "ingest"} if name == "annotate" else {},
            }
            writer.record_stage(StageRecord(f"study/{name}", f"print-{name}", f"run-{name}", "2026", 1.0, summary))
        writer.commit()
    return path


def context(path: Path, inputs: dict[str, str]) -> StageContext:
    return StageContext(
        store_path=path,
        feature_set=load_feature_set(),
        pipeline="study",
        stage="report",
        run="run-report",
        executor=make_executor("serial", None),
        terminal=Terminal(),
        inputs=inputs,
    )


INPUTS = {
    "templates": "learn_templates",
    "annotations": "annotate",
    "evaluation": "evaluate",
    "leave_one_out": "leave_one_out",
}


def test_a_store_gives_everything_that_a_report_shows(store: Path) -> None:
    data = gather(open_store(store), "study", created=MOMENT, inputs=INPUTS, own_stage="report")
    assert [take.name for take in data.takes] == ["long_1", "long_2"]
    assert data.archive_takes == 3
    assert data.title == "Annotation of archive"
    assert (data.delta, data.tau, data.searched_share) == (0.04, 0.11, 0.5)
    assert data.automatic == (Segment("long_1", "squat", 20, 41, 0.01, "squat1Reps"),)
    assert data.manual == (Segment("long_1", "squat", 21, 44),)
    main, held = data.pooled(data.evaluation), data.pooled(data.held_out)
    assert main is not None
    assert held is not None
    assert (main.f1, held.f1) == (0.91, 0.61)
    assert [(t.subclass, t.label, t.values.shape) for t in data.templates] == [("squat1Reps", "squat", (2, 40))]
    assert data.other_templates == 1
    assert data.learned_from == ("ann",)
    assert data.curves_take == "long_1"
    assert data.curves[0].costs[40] == pytest.approx(0.01)
    assert data.warnings == (("long_1", "odd header"),)
    assert data.failures == (Failure("bad.amc", "ingest", "SourceError", "frame 9 is cut", 99),)
    assert [row.stage for row in data.stages] == ["evaluate", "ingest", "annotate", "learn_templates"]
    assert data.stages[2].summary == {"searched": 0.5}


def test_only_stages_that_play_a_role_are_reported(store: Path) -> None:
    inputs = {"templates": "learn_templates", "annotations": "annotate"}
    data = gather(open_store(store), "study", created=MOMENT, inputs=inputs)
    assert data.scores == ()
    assert data.manual == ()
    assert data.curves_take == "long_1"


def test_another_takes_curves_can_be_asked_for(store: Path) -> None:
    data = gather(open_store(store), "study", created=MOMENT, curves_take="long_2")
    assert data.curves[0].costs[40] == pytest.approx(0.02)
    with pytest.raises(KinedexError, match="no annotated take is named 'long_3'; did you mean"):
        gather(open_store(store), "study", created=MOMENT, curves_take="long_3")


def test_an_empty_store_has_a_report_too(tmp_path: Path) -> None:
    with StoreWriter.open(tmp_path / "store", load_feature_set()) as writer:
        writer.commit()
    page = render(gather(open_store(tmp_path / "store"), "study", created=MOMENT))
    assert "No take was annotated" in page


def test_the_stage_writes_the_page_beside_the_results(store: Path) -> None:
    summary = stage.run(context(store, INPUTS), stage.Params(title="A study"))
    path = store / "results" / "reports" / "study" / "report.html"
    assert summary["report"] == "results/reports/study/report.html"
    assert summary["bytes"] == path.stat().st_size
    text = Reading(path.read_text(encoding="utf-8")).text
    assert "A study" in text
    assert "0.91 F1" in text
    assert "0.61 F1" in text


def test_a_changed_page_template_changes_what_the_stage_depends_on() -> None:
    digest = stage.external_digest(stage.Params())
    assert digest == stage.external_digest(stage.Params(title="other"))
    assert re.fullmatch(r"[0-9a-f]{16}", digest)
