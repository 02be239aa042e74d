"""Define the quality figures of takes, which reveal wrong units, wrong axes and faulty motion, and their limits.

The limits are wider than the range of values in HDM05, CMU and Bandai (`python -m studies.plausibility` prints both),
and wider than the range of proportions of adults and children.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

TRAINING = "HDM05, CMU and Bandai"
BODIES = "Drillis and Contini (1966), adults, widened to children"


@dataclass(frozen=True)
class Figure:
    """A figure of a take: a column of `takes`, with its limits.

    Attributes
    ----------
    name : str
        The column, and the attribute of `Plausibility`.
    type : str
        The type of the column.
    unit : str
        The unit of the figure; empty for shares and texts.
    meaning : str
        The description of the figure.
    low, high : float or None
        The limits; None if there is no limit on that side.
    source : str
        The source of the limits.
    advice : str
        Advice for a figure outside the limits.
    """

    name: str
    type: Literal["DOUBLE", "VARCHAR"]
    unit: str
    meaning: str
    low: float | None = None
    high: float | None = None
    source: str = ""
    advice: str = ""

    def limits(self) -> str:
        """Return the limits in words; empty where there are none."""
        unit = f" {self.unit}" if self.unit else ""
        if self.low is not None:
            return f"{self.low:g} to {self.high:g}{unit}" if self.high is not None else f"at least {self.low:g}{unit}"
        return f"at most {self.high:g}{unit}" if self.high is not None else ""

    def off(self, value: object) -> bool:
        """Return whether a value lies outside the limits; False for an unknown value."""
        if not isinstance(value, float):
            return False
        return (self.low is not None and value < self.low) or (self.high is not None and value > self.high)


_LOOK = "compare the picture of `kinedex inspect --picture FILE` with the joints of the skeleton mapping"
_PROPORTIONS = f"a joint may be mapped wrongly, or the figure is stylised: {_LOOK}"
RATE_ADVICE = "if the rate is wrong, give it by --rate"

FIGURES = (
    Figure(
        "height_m", "DOUBLE", "m", "height of the body along its legs and trunk",
        0.8, 2.3, "children of two years, and the tallest adults",
        "the unit of length may be wrong: state `unit_m` in a skeleton mapping",
    ),
    Figure("thigh_share", "DOUBLE", "", "length of the thighs / height", 0.17, 0.34, BODIES, _PROPORTIONS),
    Figure("shank_share", "DOUBLE", "", "length of the shanks / height", 0.17, 0.34, BODIES, _PROPORTIONS),
    Figure("upper_arm_share", "DOUBLE", "", "length of the upper arms / height", 0.11, 0.25, BODIES, _PROPORTIONS),
    Figure("forearm_share", "DOUBLE", "", "length of the forearms / height", 0.1, 0.23, BODIES, _PROPORTIONS),
    Figure(
        "neck_share", "DOUBLE", "", "height of the neck above the middle of the shoulders / height",
        -0.072, 0.1, TRAINING, f"the neck or the shoulders are not where they belong: {_LOOK}",
    ),
    Figure(
        "asymmetry", "DOUBLE", "", "largest difference of a left and a right limb / their mean",
        None, 0.25, TRAINING, _PROPORTIONS,
    ),
    Figure(
        "bone_variation", "DOUBLE", "", "largest standard deviation of the length of a limb / its length",
        None, 0.15, TRAINING, f"joints or markers jump or are exchanged: {_LOOK}",
    ),
    Figure("up_axis", "VARCHAR", "", "axis along which the body stands: y if it is read rightly; empty if undecided"),
    Figure("up_confidence", "DOUBLE", "", "confidence of `up_axis`, 0 to 1"),
    Figure(
        "left_right", "DOUBLE", "", "1 if toes and knees show left on the left, -1 if they show it on the right",
        -0.15, None, TRAINING,
        "left and right are exchanged or an axis is mirrored: correct `joints` or `handedness` in a skeleton mapping",
    ),
    Figure(
        "floor_m", "DOUBLE", "m", "median height of the lowest foot; null for a body whose root is fixed",
        -1.3, 2.0, TRAINING, "the floor is not at y = 0: the unit of the root may be wrong",
    ),
    Figure("speed_m_s", "DOUBLE", "m/s", "mean speed of all joints", 0.0005, 9.0, TRAINING),
    Figure(
        "fast_m_s", "DOUBLE", "m/s", "99th percentile of the speeds of joints",
        None, 25.0, TRAINING, f"unit or rate may be wrong, or joints jump; {RATE_ADVICE}",
    ),
    Figure("fastest_m_s", "DOUBLE", "m/s", "largest speed of a joint between two source frames"),
    Figure("tempo_hz", "DOUBLE", "Hz", "frequency with which hands and feet turn round", 0.4, 7.0, TRAINING),
    Figure(
        "acceleration_m_s2", "DOUBLE", "m/s²", "90th percentile of the acceleration of hands and feet",
        None, 200.0, TRAINING,
    ),
    Figure(
        "repeated_share", "DOUBLE", "", "share of source frames that are equal to the one before",
        None, 0.1, TRAINING,
    ),
    Figure(
        "foot_skate_m_s", "DOUBLE", "m/s", "metres that feet slide over the ground per second of contact",
        None, 1.2, TRAINING,
    ),
    Figure(
        "penetration_m", "DOUBLE", "m", "how far feet go below the usual height of the lowest joint",
        None, 0.3, TRAINING, f"feet sink into the ground: {_LOOK}",
    ),
    Figure("flight_s", "DOUBLE", "s", "longest time in which no joint is within 0.1 m of the ground"),
    Figure(
        "knee_forwards_share", "DOUBLE", "", "share of frames in which a knee bends forwards by more than 12°",
        None, 0.3, TRAINING, f"knees bend the wrong way: {_LOOK}",
    ),
    Figure(
        "spike_deg", "DOUBLE", "degrees", "largest turn of a limb away in one frame and back in the next",
        None, 40.0, TRAINING, "a limb jumps for one frame: a gap was filled badly, or markers were exchanged",
    ),
    Figure(
        "jitter_m_s3", "DOUBLE", "m/s³", "median third derivative of the places of joints, over steps of 1/30 s",
        None, 2500.0, f"{TRAINING}; widened after other takes",
        "the motion trembles: tracking may be noisy, or the rate wrong",
    ),
    Figure(
        "stuck_share", "DOUBLE", "", "largest share of steps in which an end of a limb stays while the limb moves",
        None, 0.1, TRAINING, "a knee, an elbow or a wrist stands still: its marker or its channel was lost",
    ),
    Figure("invalid_share", "DOUBLE", "", "share of invalid frames", None, 0.1, TRAINING),
)  # fmt: skip
"""The figures, in the order of their columns."""

FLOOR_M, JITTERS = 0.3, 40.0
"""Limits relative to the other takes with the same skeleton mapping: the distance in metres of a take's floor from the
median floor, and the ratio of a take's jitter to the median jitter."""


def suspect_select() -> str:
    """Return the SELECT statement of the view `suspect_takes`, which lists the figures outside their limits.

    If a store lacks the column of a figure, the view has no rows for this figure.
    """
    limited = [figure for figure in FIGURES if figure.type == "DOUBLE" and figure.limits()]
    names = ", ".join(f"'{figure.name}'" for figure in limited)
    rows = ", ".join(
        f"('{figure.name}', {_sql(figure.low)}, {_sql(figure.high)}, '{figure.unit}', '{figure.meaning}')"
        for figure in limited
    )
    return f"""WITH figures AS (
    UNPIVOT (SELECT t.take_id, t.name AS take, t.skeleton,
        COLUMNS(lambda c: c IN ('source_rate_hz', {names})) FROM takes AS t)
    ON COLUMNS(* EXCLUDE (take_id, take, skeleton)) INTO NAME figure VALUE value),
limits AS (SELECT * FROM (VALUES {rows}) AS l(figure, low, high, unit, meaning)),
typical AS (SELECT f.skeleton, f.figure, median(f.value) AS median FROM figures AS f
    WHERE f.figure IN ('floor_m', 'jitter_m_s3') GROUP BY f.skeleton, f.figure),
bounds AS (
    SELECT f.take_id, f.take, f.figure, f.value, l.unit, l.meaning,
        CASE f.figure WHEN 'floor_m' THEN greatest(l.low, t.median - {FLOOR_M}) ELSE l.low END AS low,
        CASE f.figure WHEN 'floor_m' THEN least(l.high, t.median + {FLOOR_M})
            WHEN 'jitter_m_s3' THEN least(l.high, t.median * {JITTERS}) ELSE l.high END AS high
    FROM figures AS f JOIN limits AS l ON l.figure = f.figure
    LEFT JOIN typical AS t ON (t.skeleton, t.figure) = (f.skeleton, f.figure))
SELECT b.take_id, b.take, b.figure, b.value, b.low, b.high, b.unit, b.meaning FROM bounds AS b
WHERE b.value < b.low OR b.value > b.high ORDER BY b.take, b.figure"""


def _sql(limit: float | None) -> str:
    return "NULL::DOUBLE" if limit is None else f"{limit}::DOUBLE"
