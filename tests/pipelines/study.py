"""A small study for the tests of reports, and how a page is read."""

from __future__ import annotations

from datetime import UTC, datetime
from html.parser import HTMLParser

import numpy as np

from kinedex.ops.intervals import TakeSegment
from kinedex.reports.report_data import (
    Curve,
    Failure,
    FeatureNames,
    HitCount,
    ReportData,
    Score,
    StageRow,
    TakeRow,
    Template,
)

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
            TakeSegment("one", "squat", 20, 41, 0.02, "squat2Reps"),
            TakeSegment("one", "kick", 60, 73, 0.1, "kick"),
            TakeSegment("two", "squat", 0, 45, 0.04, "squat1Reps"),
        ),
        manual=(
            TakeSegment("one", "squat", 18, 45),
            TakeSegment("two", "squat", 5, 40),
            TakeSegment("two", "kick", 50, 70),
        ),
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
        if tag not in {"meta", "img", "br", "hr", "input", "rect", "path", "wbr"}:
            self.open.append(tag)
        self.references += [
            value or "" for name, value in attrs if name in {"src", "href", "xlink:href", "data", "srcset"}
        ]

    def handle_endtag(self, tag: str) -> None:
        if tag not in {"meta", "img", "br", "hr", "input", "path", "wbr"} and self.open and self.open[-1] == tag:
            self.open.pop()

    def handle_data(self, data: str) -> None:
        if not self.open or self.open[-1] not in {"style", "script"}:
            self.words.append(data)
