"""A page shows what was found, needs nothing but itself, and reports what is missing."""

from __future__ import annotations

import re
from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import TakeSegment
from kinedex.reports.annotation_page import annotation_page
from kinedex.reports.report_data import Curve, Failure, HitCount, Score, StageRow, TakeRow, Template
from kinedex.reports.report_overview import SEGMENTS
from tests.pipelines.study import FRAMES, Reading, study

UNJUDGED: dict[str, object] = {"scores": (), "evaluation": None, "held_out": None}


def test_a_page_shows_measures_takes_templates_curves_and_exclusions() -> None:
    text = Reading(annotation_page(study())).text
    for expected in (
        "Squats and kicks", "0.69 F (frames)", "0.67 F (segments)", "0.52 F (frames)", "56 have the class",
        "2 of 3 automatic segments",
        "τ = 0.13", "δ = 0.05", "the lowest F (frames) first", "squat2Reps in class squat", "3 frames = 0.10 s",
        "3 clips",
        "3 rounds", "knee bent", "lowest 0.020", "frame 3 lacks rfemur", "two : no header", "kinedex run study",
        "digest 0123abcd",
    ):  # fmt: skip
        assert expected in text, expected


def test_the_convergence_of_learning_and_remarks_on_clips_are_shown() -> None:
    data = study()
    squat, kick = data.templates
    odd = replace(squat, remarks=("clips far from all others: c2 (cost 0.3)",))
    page = annotation_page(replace(data, templates=(odd, replace(kick, clips=(), origin="from kick.yaml"))))
    text = Reading(page).text
    assert text.count("clips far from all others: c2 (cost 0.3)") == 2  # beside the template, and among the remarks
    assert "from kick.yaml" in text
    assert page.count('class="soft trace"') == 1
    assert "Largest cost between two clips from 0.100 to 0.0040 in 1 rounds: converged" in page


def test_a_page_needs_nothing_but_itself() -> None:
    page = annotation_page(study())
    reading = Reading(page)
    assert "http:" not in page
    assert "https:" not in page
    assert "url(" not in page
    assert "@import" not in page
    outside = {reference.split(":")[0] for reference in reading.references if not reference.startswith("#")}
    assert outside == {"data", SEGMENTS}  # the list beside the page is a link, and nothing that a browser fetches
    assert not {"link", "iframe", "object", "embed"} & set(reading.tags)
    assert "default-src 'none'" in page


def test_every_tag_that_opens_closes() -> None:
    assert Reading(annotation_page(study())).open == []


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
        automatic=(TakeSegment(evil, evil, 0, 9, 0.1, evil + "2"),),
        manual=(TakeSegment(evil, evil + "3", 0, 9),),
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
    page = annotation_page(data)
    assert Reading(page).tags.count("script") == Reading(annotation_page(study())).tags.count("script")
    assert "<script>alert" not in page


def test_the_same_data_give_the_same_page_and_the_moment_is_given() -> None:
    assert annotation_page(study()) == annotation_page(study())
    later = annotation_page(replace(study(), created=datetime(2027, 1, 2, tzinfo=UTC)))
    assert later.replace("2027-01-02 00:00", "2026-11-21 04:27") == annotation_page(study())


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (UNJUDGED, "No evaluation is stored for this run"),
        (UNJUDGED, "No evaluation is stored, so there are no tables of agreement"),
        ({"held_out": None}, "Leave one actor out was not run."),
        ({"manual": ()}, "There is no ground truth for these takes"),
        ({"templates": ()}, "No templates are stored for this run"),
        ({"curves": ()}, "No distance curves are stored for the take “one”"),
        ({"curves": (), "curves_take": None}, "No distance curves are stored for any take"),
        ({"failures": ()}, "Every source file was read"),
        ({"warnings": ()}, "No take has a warning"),
        ({"takes": (), "automatic": (), "manual": (), "curves": ()}, "No take was annotated"),
        ({"automatic": (), "manual": ()}, "This take has neither automatic nor manual segments"),
        ({"tau": None}, "The threshold τ is not stored, so minima are not marked"),
        ({"delta": None}, "The δ of the annotation is not stored"),
        ({"stages": ()}, "manifest of the store records no stage of this pipeline"),
        ({"learned_from": ("bob",)}, "No example clip is of ann, so this result equals the plain one"),
        ({"searched_share": 0.15}, "restricted the search to 15% of the frames"),
        ({"other_templates": 3}, "3 templates of another kind"),
    ],
)  # fmt: skip
def test_missing_data_is_reported(change: dict[str, object], sentence: str) -> None:
    assert sentence in Reading(annotation_page(replace(study(), **change))).text  # type: ignore[arg-type]


def test_classes_that_only_one_side_knows_are_named() -> None:
    data = study()
    jump = replace(data, manual=(*data.manual, TakeSegment("two", "jump", 80, 90)))
    assert "without a template, which cannot be found: jump" in Reading(annotation_page(jump)).text
    no_kick = replace(data, manual=data.manual[:2])
    assert "all their segments count as false: kick" in Reading(annotation_page(no_kick)).text


def test_takes_not_shown_are_counted_and_named() -> None:
    text = Reading(annotation_page(study(), max_takes=1)).text
    assert "1 take not shown" in text
    assert re.search(r"1 take without a timeline here two", text)


def test_a_take_that_was_not_annotated_cannot_be_asked_for() -> None:
    with pytest.raises(KinedexError, match="no annotated take is named 'tow'; did you mean 'two'"):
        annotation_page(study(), takes=["tow"])


def test_long_lists_end_with_the_number_of_further_rows() -> None:
    data = study()
    many = replace(
        data,
        failures=tuple(Failure(f"bad{i:04d}.amc", "ingest", "SourceError", "cut", 1) for i in range(520)),
        warnings=tuple((f"take{i}", "odd") for i in range(510)),
        scores=(data.scores[0], *(Score("annotate", "take", f"t{i:04d}", f1=i / 600) for i in range(600))),
        templates=tuple(replace(data.templates[0], subclass=f"s{i:02d}") for i in range(20)),
    )
    page = annotation_page(many)
    text = Reading(page).text
    for expected in ("20 more: SELECT * FROM ingest_log", "10 more: SELECT name, warnings",
                     "of 600 takes with the lowest F (frames); all of them",
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
        TakeSegment(take.name, labels[int(generator.integers(15))], start, start + 40, 0.1, "sub")
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
    assert len(annotation_page(data).encode()) < 5_000_000
