"""Query files: the words that people may write, their meaning, and the errors."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.catalog.configs import config_names
from kinedex.catalog.features import FeatureSet, load_feature_set
from kinedex.catalog.queries.keyframe_query import (
    SAME_FRAME,
    Gap,
    Keyframe,
    KeyframeQuery,
    choose_queries,
    features_of,
    mirrored,
    pattern_of,
)
from kinedex.catalog.queries.query_reader import parse_queries, query_file_paths, read_queries
from kinedex.catalog.queries.query_writer import write_queries
from kinedex.ops.body.features import words as feature_words
from kinedex.ops.errors import ConfigError, KinedexError, ParameterError
from kinedex.ops.search.gaps import UNBOUNDED
from kinedex.ops.words import bits

BODY = load_feature_set("body40")


def parse(text: str, feature_set: FeatureSet = BODY) -> tuple[KeyframeQuery, ...]:
    return parse_queries(text, feature_set, "mine.yaml")


def test_a_pattern_starts_with_the_lowest_feature_of_its_set() -> None:
    (query,) = parse('q: {keyframes: [{set: lower, pattern: "10**********"}]}')
    assert query.keyframes == (Keyframe("lower", 0b11, 0b01),)
    assert features_of(query.keyframes[0], BODY) == (["rfoot_behind"], ["lfoot_behind"])
    assert pattern_of(query.keyframes[0], BODY) == "10**********"


def test_a_pattern_over_mix_may_leave_the_turning_root_out() -> None:
    short, long = parse(
        'a: {keyframes: [{set: mix, pattern: "1***********0"}]}\n'
        'b: {keyframes: [{set: mix, pattern: "1***********0*"}]}\n'
    )
    assert short.keyframes == long.keyframes == (Keyframe("mix", 1 | 1 << 12, 1),)


def test_features_are_named_or_numbered() -> None:
    query, same = parse(
        "a: {keyframes: [{on: [rknee_bent, lknee_bent], off: [feet_apart]}]}\n"
        "b: {keyframes: [{on: [20, F21], off: [19]}]}\n"
    )
    assert query.keyframes == same.keyframes == (Keyframe("lower", 0b1110000, 0b1100000),)


def test_a_keyframe_over_several_sets_becomes_one_in_each_on_the_same_frame() -> None:
    text = """
sit:
  class: sitDownChair
  keyframes:
    - {on: [relbow_bent]}
    - {on: [rknee_bent, spine_horizontal], off: [rhand_fast]}
  gaps: [{frames: 8, stiffness: 0.5}]
  positions: [3, 11]
"""
    (query,) = parse(text)
    assert query.target == "sitDownChair"
    assert [keyframe.set for keyframe in query.keyframes] == ["upper", "upper", "lower", "mix"]
    assert query.gaps == (Gap(4, 16, 8, 0.5), SAME_FRAME, SAME_FRAME)
    assert SAME_FRAME.low == SAME_FRAME.high == 0
    assert query.positions == (3, 11, 11, 11)


@pytest.mark.parametrize(
    ("written", "gap"),
    [
        ("{frames: 25, stiffness: 0.28}", Gap(7, 89, 25, 0.28)),
        ("{seconds: 0.5, stiffness: 0.5}", Gap(8, 30, 15, 0.5)),
        ("{frames: 4, stiffness: 0}", Gap(0, UNBOUNDED, 4, 0.0)),
        ("{range: [3, 12]}", Gap(3, 12)),
        ("{range: [3, null]}", Gap(3, UNBOUNDED)),
        ("{seconds_range: [0.1, 0.7]}", Gap(3, 21)),
        ("{seconds_range: [0.11, 0.69]}", Gap(4, 20)),
        ("{seconds_range: [0, null]}", Gap(0, UNBOUNDED)),
        ("{seconds_range: [0, .inf]}", Gap(0, UNBOUNDED)),
    ],
)
def test_a_gap_is_written_in_frames_or_seconds_with_stiffness_or_as_a_range(written: str, gap: Gap) -> None:
    (query,) = parse(f"q: {{keyframes: [{{on: [1]}}, {{on: [2]}}], gaps: [{written}]}}")
    assert query.gaps == (gap,)


@pytest.mark.parametrize(
    ("written", "gap"),
    [
        ("within 2 s", Gap(0, 60)),
        ("within 12 frames", Gap(0, 12)),
        ("within 500 ms", Gap(0, 15)),
        ("0.5 to 2 s", Gap(15, 60)),
        ("0.5 s to 2 s", Gap(15, 60)),
        ("200 ms to 1 second", Gap(6, 30)),
        ("5 to 12 frames", Gap(5, 12)),
        ("0.11 to 0.69 s", Gap(4, 20)),
        ("At least  1 s", Gap(30, UNBOUNDED)),
        ("exactly 3 frames", Gap(3, 3, 3, 1.0)),
        ("0.5 s ± 0.2 s", Gap(9, 21)),
        ("0.5 +- 0.2 s", Gap(9, 21)),
        ("3 ± 5 frames", Gap(0, 8)),
        ("0.5 s, stiffness 0.5", Gap(8, 30, 15, 0.5)),
        ("25 frames stiffness 0.28", Gap(7, 89, 25, 0.28)),
        ("up to 0.5 seconds", Gap(0, 15)),
        ("within 2 sec", Gap(0, 60)),
        ("0.5 min to 1 minute", Gap(900, 1800)),
        ("within 1 hour", Gap(0, 108_000)),
        ("1 to 2 hours", Gap(108_000, 216_000)),
        ("at least 1 h", Gap(108_000, UNBOUNDED)),
        ("within 100 milliseconds", Gap(0, 3)),
        ("exactly 1 frame", Gap(1, 1, 1, 1.0)),
        ("any time", Gap(0, UNBOUNDED)),
        ("same frame", SAME_FRAME),
        ("{seconds: 0.5, tolerance: 0.2}", Gap(9, 21)),
        ("{frames: 8, tolerance: 3}", Gap(5, 11)),
    ],
)
def test_a_gap_may_be_written_as_one_says_it(written: str, gap: Gap) -> None:
    quoted = written if written.startswith("{") else f'"{written}"'
    (query,) = parse(f"q: {{keyframes: [{{on: [1]}}, {{on: [2]}}], gaps: [{quoted}]}}")
    (after,) = parse(f"q: {{keyframes: [{{on: [1]}}, {{after: {quoted}, on: [2]}}]}}")
    assert query.gaps == after.gaps == (gap,)


def test_a_part_of_a_query_has_a_name() -> None:
    (query,) = parse("q: {keyframes: [{name: down, on: [rknee_bent, body_low]}, {after: any time, off: [20]}]}")
    assert [keyframe.name for keyframe in query.keyframes] == ["down", "down", ""]
    assert parse(write_queries([query], BODY))[0].keyframes[0].name == "down"


# ---- queries built from queries --------------------------------------------------------------------------

PARTS = """
kick:
  part: true
  keyframes: [{on: [rfoot_raised]}, {after: within 1 s, on: [rfoot_fast]}]
down:
  part: true
  keyframes: [{on: [body_low]}]
"""
KICK = (Keyframe("lower", 4, 4), Keyframe("lower", 1 << 10, 1 << 10))
OTHER_KICK = (Keyframe("lower", 8, 8), Keyframe("lower", 1 << 11, 1 << 11))
DOWN = (Keyframe("mix", 1 << 10, 1 << 10),)


def test_a_sequence_joins_queries_with_the_gap_between_them() -> None:
    (query,) = parse(PARTS + "both:\n  sequence: [kick, {then: down, within: 2 s}, {then: kick, gap: 5 to 9 frames}]")
    assert query.name == query.target == "both"
    assert query.keyframes == KICK + DOWN + KICK
    assert query.gaps == (Gap(0, 30), Gap(0, 60), Gap(5, 9), Gap(0, 30))
    assert query.alternatives == ()


def test_alternatives_are_further_chains_of_one_query() -> None:
    (query,) = parse(PARTS + "either:\n  class: k\n  any_of: [kick, down, {keyframes: [{on: [feet_apart]}]}]")
    assert [chain.keyframes for chain in query.chains] == [KICK, DOWN, (Keyframe("lower", 16, 16),)]
    assert {chain.target for chain in query.chains} == {"k"}
    assert {chain.name for chain in query.chains} == {"either"}


def test_alternatives_within_a_sequence_are_tried_one_by_one() -> None:
    (query,) = parse(PARTS + "q: {sequence: [{any_of: [kick, down]}, {then: {any_of: [down, kick]}, within: 1 s}]}")
    assert [chain.keyframes for chain in query.chains] == [KICK + DOWN, KICK + KICK, DOWN + DOWN, DOWN + KICK]


def test_a_mirrored_query_is_the_same_motion_of_the_other_side() -> None:
    both, other = parse(PARTS + "both: {any_of: [kick], mirror: both}\nother: {any_of: [kick], mirror: other}")
    assert [chain.keyframes for chain in both.chains] == [KICK, OTHER_KICK]
    assert [chain.keyframes for chain in other.chains] == [OTHER_KICK]
    (same,) = parse(PARTS + "same: {any_of: [down], mirror: both}")
    assert len(same.chains) == 1


def test_a_sequence_may_keep_to_one_side_or_change_it() -> None:
    one, any_side = parse(
        PARTS
        + "one: {sequence: [kick, {then: kick, within: 1 s}], mirror: both}\n"
        + "any: {sequence: [{any_of: [kick], mirror: both}, {then: {any_of: [kick], mirror: both}, within: 1 s}]}"
    )
    assert [chain.keyframes for chain in one.chains] == [KICK + KICK, OTHER_KICK + OTHER_KICK]
    assert len(any_side.chains) == 4


def test_a_filter_over_takes_stays_with_the_query() -> None:
    (query,) = parse(PARTS + "q: {takes: \"actor = 'bk'\", any_of: [kick, down]}")
    assert {chain.takes for chain in query.chains} == {"actor = 'bk'"}


WRONG_COMBINATIONS = [
    ("q: {any_of: [kik]}", "no query is named 'kik'; did you mean 'kick'"),
    ("q: {any_of: [q]}", "'q' is made of itself: q → q"),
    ("a: {any_of: [b]}\nb: {sequence: [a]}", "made of itself: a → b → a"),
    ("q: {any_of: [3]}", "name of a query or a query, got 3"),
    ("q: {any_of: []}", "at least 1"),
    ("q: {any_of: [kick], keyframes: [{on: [1]}]}", "got keyframes and any_of"),
    ("q: {description: x}", "got none of them"),
    ("q: {any_of: [kick], gaps: []}", "`gaps` goes with `keyframes`"),
    ("q: {any_of: [{any_of: [kick], class: x}]}", "`class` belongs to a query of its own"),
    ("q: {any_of: [kick], mirror: left}", "'both' or 'other'"),
    ("q: {sequence: [kick, down]}", "a step gives the query that follows as `then`"),
    ("q: {sequence: [kick, {then: down}]}", "a step has either `within: 2 s` or `gap`"),
    ("q: {sequence: [kick, {then: down, within: 2}]}", "must be a valid string, got 2"),
    ("q: {sequence: [kick, {then: down, within: 2 m}]}", "'within 2 m' is no gap; written so: \"within 2 s\""),
    ("q: {sequence: [kick, {thn: down, within: 2 s}]}", "as `then`"),
    ("q: {sequence: [kick, {then: down, withn: 2 s}]}", "did you mean 'within'"),
    ("f: {takes: x, any_of: [kick]}\nq: {any_of: [f]}", "'f' has a filter `takes`"),
    ("q: {keyframes: [{after: any time, on: [1]}]}", "no keyframe comes before the first"),
    ("q: {keyframes: [{on: [1]}, {on: [2]}, {after: any time, on: [1]}]}", "needs a gap as `after`"),
    ("q: {keyframes: [{on: [1]}, {after: any time, on: [1]}], gaps: [any time]}", "have gaps of their own"),
    ("q: {keyframes: [{on: [1]}, {after: soon, on: [1]}]}", "'soon' is no gap"),
    ("q: {keyframes: [{on: [1]}, {after: within 1 day, on: [1]}]}", "; units are ms, s, min, h or frames"),
    (
        "q: {keyframes: [{on: [1]}, {after: 5 to 2 s, on: [1]}]}",
        "first time must not exceed the second, got '5 to 2 s'",
    ),
    ("q: {keyframes: [{on: [1]}, {on: [1]}], gaps: [{seconds_range: [5, 2]}]}", "first time must not exceed"),
    ("q: {keyframes: [{on: [1]}, {after: 0.01 to 0.02 s, on: [1]}]}", "whole number of frames"),
    ("q: {keyframes: [{on: [1]}, {after: {seconds: 1, stiffness: 1, tolerance: 1}, on: [1]}]}", "or else its"),
    (
        "q: {sequence: [{any_of: [kick, down]}" + ", {then: {any_of: [kick, down]}, within: 1 s}" * 6 + "]}",
        "chains of keyframes, as alternatives multiply",
    ),
]


@pytest.mark.parametrize(("text", "message"), WRONG_COMBINATIONS)
def test_a_fault_in_a_combined_query_is_reported_with_its_line(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as fault:
        parse(PARTS + text)
    assert message in str(fault.value)
    assert fault.value.line in (8, 9)


# ---- queries of other files ------------------------------------------------------------------------------


def write(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    return folder


def test_a_query_uses_queries_of_other_files(tmp_path: Path) -> None:
    write(tmp_path, parts=PARTS, mine="both: {sequence: [{file: parts.yaml, query: kick}, {then: down, within: 2 s}]}\n"
          "down: {any_of: [{file: parts.yaml, query: down}]}\n"
          "shipped: {any_of: [{file: example, query: turn}]}")  # fmt: skip
    both, down, shipped = read_queries(tmp_path / "mine.yaml", BODY)
    assert (both.keyframes, both.gaps) == (KICK + DOWN, (Gap(0, 30), Gap(0, 60)))
    assert down.keyframes == DOWN
    (turn,) = choose_queries(read_queries("example", BODY), ["turn"])
    assert shipped.keyframes == turn.keyframes
    found = [path.name for path in query_file_paths([tmp_path / "mine.yaml"])]
    assert found == ["mine.yaml", "parts.yaml", "example.yaml"]


def test_files_may_refer_to_one_another_but_no_query_to_itself(tmp_path: Path) -> None:
    one = "a: {any_of: [{file: two.yaml, query: b}]}\nc: {keyframes: [{on: [rfoot_raised]}]}"
    write(tmp_path, one=one, two="b: {any_of: [{file: one.yaml, query: c}]}\nd: {any_of: [b]}")
    assert [query.keyframes for query in read_queries(tmp_path / "one.yaml", BODY)] == [KICK[:1], KICK[:1]]
    write(tmp_path, two="x: {keyframes: [{on: [1]}]}\nb: {any_of: [{file: ./one.yaml, query: a}]}")
    with pytest.raises(ConfigError, match="'a' is made of itself: a → b → a") as fault:
        read_queries(tmp_path / "one.yaml", BODY)
    assert (Path(fault.value.path).name, fault.value.line) == ("two.yaml", 2)
    assert len(query_file_paths([tmp_path / "one.yaml"])) == 2


@pytest.mark.parametrize(
    ("reference", "message"),
    [
        ("{file: none.yaml, query: kick}", "none.yaml: no such file; expected a query file"),
        ("{file: exmple, query: kick}", "did you mean 'example'"),
        ("{file: parts.yaml, query: kik}", "parts.yaml; did you mean 'kick'"),
        ("{file: parts.yaml, query: filtered}", "'filtered' has a filter `takes`"),
        ("{file: parts.yaml}", "this key is missing"),
        ("{query: kick}", "this key is missing"),
        ("{file: parts.yaml, qery: kick}", "did you mean 'query'"),
        ("{file: 3, query: kick}", "must be a valid string, got 3"),
    ],
)
def test_a_wrong_reference_is_reported_with_its_line(tmp_path: Path, reference: str, message: str) -> None:
    text = f"a: {{keyframes: [{{on: [1]}}]}}\nq:\n  any_of:\n    - a\n    - {reference}"
    write(tmp_path, parts=PARTS + "filtered: {takes: x, any_of: [kick]}", mine=text)
    with pytest.raises(ConfigError) as fault:
        read_queries(tmp_path / "mine.yaml", BODY)
    assert message in str(fault.value)
    assert (Path(fault.value.path).name, fault.value.line) == ("mine.yaml", 5)


@pytest.mark.shared
def test_the_combined_queries_of_table_3_3_are_written_with_references(shared: Path, tmp_path: Path) -> None:
    file = shared / "reference" / "keyframe_queries.json"
    both = ("elbowToKnee1RepsLelbowStart", "squat1Reps")
    first, then = (f"{{file: {file.resolve()}, query: {name}}}" for name in both)
    write(tmp_path, combined=f"ID58: {{sequence: [{first}, {{then: {then}, within: 2 s}}]}}")
    (combined,) = read_queries(tmp_path / "combined.yaml", BODY)
    one, other = choose_queries(read_queries(file, BODY), both)
    assert combined.keyframes == one.keyframes + other.keyframes
    assert len(combined.keyframes) == 7


def test_every_feature_has_one_mirror_image() -> None:
    numbers = {number: BODY.mirrored_number(number) for number in range(1, 41)}
    assert all(numbers[numbers[number]] == number for number in numbers)
    pairs = {(number, other) for number, other in numbers.items() if number < other}
    assert {(1, 2), (15, 16), (20, 21), (25, 26), (29, 30), (33, 34), (35, 36)} <= pairs
    alone = {number for number, other in numbers.items() if number == other}
    assert alone == {9, 10, 19, 22, 23, 24, 31, 32, 37, 38, 39, 40}


def test_the_features_of_a_mirrored_body_whose_pelvis_stands_still_are_the_mirrored_features() -> None:
    joints = [(BODY.joints.index(name), BODY.joints.index(twin)) for name, twin in _twins(BODY.joints)]
    rng = np.random.default_rng(5)
    body = np.cumsum(rng.normal(0, 0.05, (len(BODY.joints), 3, 400)), axis=2) + rng.normal(0, 0.5, (24, 3, 1))
    # In frame 0, where the lengths are taken, the body is symmetric.
    middle = sorted(set(range(24)) - {joint for pair in joints for joint in pair})
    body[middle, 0, 0] = 0
    for one, other in joints:
        body[other, :, 0] = body[one, :, 0] * [-1, 1, 1]
    hips = [BODY.joints.index("lhip"), BODY.joints.index("rhip")]
    body[hips] = body[hips, :, :1]
    turning = np.zeros((4, 400))
    turning[0] = 1.0
    glass = body.copy()
    for one, other in joints:
        glass[one], glass[other] = body[other], body[one]
    glass[:, 0] *= -1
    words = {name: feature_words(seen, turning, 30.0, BODY.rules) for name, seen in (("body", body), ("glass", glass))}
    numbers = {number: BODY.mirrored_number(number) for number in range(1, 41)}
    matrix, mirror = bits(words["body"], 40), bits(words["glass"], 40)
    for number, other in numbers.items():
        assert matrix[:, number - 1].tolist() == mirror[:, other - 1].tolist(), BODY.feature(number).name
    assert (matrix.any(axis=0) & ~matrix.all(axis=0)).sum() > 25


def test_a_feature_set_without_pairs_of_left_and_right_cannot_mirror_a_query() -> None:
    query = KeyframeQuery("kick", "kick", (Keyframe("upper", 1, 1),), ())
    with pytest.raises(KinedexError, match="cannot be mirrored; add `mirror: "):
        mirrored(query, replace(BODY, mirror=()))


def _twins(joints: tuple[str, ...]) -> list[tuple[str, str]]:
    return [(name, "l" + name[1:]) for name in joints if name.startswith("r") and "l" + name[1:] in joints]


def test_the_least_stiffness_tells_how_much_slower_a_hit_may_be() -> None:
    frames = (Keyframe("upper", 1, 1),) * 4
    query = KeyframeQuery("q", "q", frames, (Gap.of_distance(5, 0.8), Gap(4, 16), SAME_FRAME))
    assert query.least_stiffness == 0.5
    assert query.bounds == [(4, 6), (4, 16), (0, 0)]
    assert KeyframeQuery("q", "q", frames[:2], (SAME_FRAME,)).least_stiffness == 0.0


def test_the_papers_notation_is_read_as_a_list_and_as_a_mapping() -> None:
    body = {
        "keyframes": [{"feature_set": "lower", "pattern": "1" * 12}, {"feature_set": "mix", "pattern": "0" * 13}],
        "distances": [7],
        "stiffness": [0.07],
    }
    (listed,) = parse(json.dumps([{"name": "kick", **body}]))
    (mapped,) = parse(json.dumps({"kick": body}))
    assert listed == mapped
    assert listed.name == listed.target == "kick"
    assert listed.gaps == (Gap(1, 100, 7, 0.07),)


WRONG = [
    ("a:\n  keyframes:\n    - {on: [rkne_bent]}", 3, "did you mean 'rknee_bent'"),
    ("a:\n  keyframes:\n    - {on: [41]}", 3, "F1 to F40"),
    ("a:\n  keyframes:\n    - {on: [rknee_bent], off: [F20]}", 3, "occurs twice"),
    ("a:\n  keyframes:\n    - {on: []}", 3, "needs a pattern, or features"),
    ("a:\n  keyframes:\n    - {set: lwer, pattern: '1'}", 3, "did you mean 'lower'"),
    ("a:\n  keyframes:\n    - {set: lower, pattern: '1*'}", 3, "12 characters, got 2"),
    ("a:\n  keyframes:\n    - {set: mix, pattern: '1*'}", 3, "13 or 14 characters"),
    ("a:\n  keyframes:\n    - {set: lower, pattern: '1*********2*'}", 3, "made of 0, 1 and"),
    ("a:\n  keyframes:\n    - {set: lower, pattern: 000000000000}", 3, "in quotes"),
    ("a:\n  keyframes:\n    - {pattern: '1'}", 3, "needs the `set`"),
    ("a:\n  keyframes:\n    - {set: lower, on: [20]}", 3, "goes with a pattern"),
    ("a:\n  keyframes:\n    - {set: lower, pattern: '************', on: [20]}", 3, "either a pattern"),
    ("a:\n  keyframes:\n    - {set: lower, feature_set: lower, pattern: '************'}", 3, "the same"),
    ("a:\n  keyframes:\n    - {onn: [20]}", 3, "did you mean 'on'"),
    ("a:\n  keyframes: []", 2, "at least 1"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]", 2, "2 keyframes need 1 gaps"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps: []", 3, "need 1 gaps between them, found 0"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {frames: 3}", 4, "needs its `stiffness`"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {frames: -3, stiffness: 1}", 4, "got -3"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {frames: 3, stiffness: 1.5}", 4, "got 1.5"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {frames: 3, range: [1, 2]}", 4, "frames and range"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {range: [3, 2]}", 4, "low <= high"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {seconds_range: [1.0e+308, null]}", 4, "from 0 up"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {range: [1, 2], stiffness: 1}", 4, "no stiffness"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {seconds_range: [0.01, 0.02]}", 4, "whole number"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps:\n    - {seconds_range: [-1, 2]}", 4, "from 0 up"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  distances: [3]\n  stiffness: []", 4, "as many as"),
    ("a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  distances: [3]\n  gaps: []\n", 4, "either `gaps`"),
    ("a:\n  keyframes: [{on: [1]}]\n  positions: [3, 4]", 3, "found 2"),
    (
        "a:\n  keyframes: [{on: [1]}, {on: [2]}]\n  gaps: [{frames: 1, stiffness: 1}]\n  positions: [3, 2]",
        4,
        "must not fall",
    ),
    ("a:\n  keyfames: [{on: [1]}]", 2, "did you mean 'keyframes'"),
    ("a: 3", 1, "a query is a mapping"),
    ("3: {keyframes: [{on: [1]}]}", 1, "put it in quotes"),
    ("- {keyframes: [{on: [1]}]}", 1, "missing"),
    ("- {name: a, keyframes: [{on: [1]}]}\n- {name: a, keyframes: [{on: [2]}]}", 2, "second query"),
    ("a: {name: b, keyframes: [{on: [1]}]}", 1, "already named 'a'"),
    ("just text", 1, "expected a mapping"),
]


@pytest.mark.parametrize(("text", "line", "message"), WRONG)
def test_a_wrong_query_is_reported_with_its_line_and_the_way_out(text: str, line: int, message: str) -> None:
    with pytest.raises(ConfigError) as fault:
        parse(text)
    assert message in str(fault.value)
    assert fault.value.line == line
    assert str(fault.value).startswith(f"mine.yaml:{line}: ")


def test_queries_are_chosen_by_name() -> None:
    queries = parse("a: {keyframes: [{on: [1]}]}\nb: {keyframes: [{on: [2]}]}")
    assert choose_queries(queries, ["b"]) == queries[1:]
    assert choose_queries(queries, []) == queries
    with pytest.raises(KinedexError, match="no query is named 'squats'"):
        choose_queries(queries, ["squats"])


def test_a_query_that_contradicts_itself_cannot_be_made() -> None:
    one = Keyframe("upper", 1, 1)
    for wrong in (
        lambda: KeyframeQuery("q", "q", (), ()),
        lambda: KeyframeQuery("q", "q", (one, one), ()),
        lambda: KeyframeQuery("q", "q", (one,), (), (1, 2)),
        lambda: Keyframe("upper", 1, 2),
        lambda: Gap(3, 2),
    ):
        with pytest.raises(ParameterError):
            wrong()


@st.composite
def any_query(draw: st.DrawFn) -> KeyframeQuery:
    keyframes = []
    for _ in range(draw(st.integers(1, 5))):
        name = draw(st.sampled_from(list(BODY.sets)))
        mask = draw(st.integers(0, 2 ** BODY.sets[name].count - 1))
        keyframes.append(Keyframe(name, mask, draw(st.integers(0, mask)) & mask))
    frames, low = st.integers(0, 99), draw(st.integers(0, 99))
    stiffness = st.one_of(st.sampled_from([0.0, 0.28, 1.0]), st.floats(0, 1))
    written = st.one_of(
        st.just(SAME_FRAME),
        st.builds(Gap.of_distance, frames, stiffness),
        st.one_of(st.just(UNBOUNDED), st.integers(99, 500)).map(lambda high: Gap(low, high)),
    )
    gaps = [draw(written) for _ in keyframes[1:]]
    positions = draw(st.none() | st.lists(frames, min_size=len(keyframes), max_size=len(keyframes)).map(sorted))
    text = st.text(st.characters(exclude_categories=["Cs", "Cc"]))
    name = draw(text.filter(bool) | st.sampled_from(["on", "yes", "12", "squat1Reps", "null", "a: b", "#", "é"]))
    return KeyframeQuery(
        name,
        draw(st.just(name) | text.filter(bool)),
        tuple(keyframes),
        tuple(gaps),
        None if positions is None else tuple(positions),
        draw(text),
    )


@settings(max_examples=150, deadline=None)
@given(st.lists(any_query(), max_size=3, unique_by=lambda query: query.name))
def test_what_is_written_reads_back_as_the_same_queries(queries: list[KeyframeQuery]) -> None:
    assert parse(write_queries(queries, BODY)) == tuple(queries)


def test_written_queries_read_like_a_sentence() -> None:
    (query,) = parse(
        "squat:\n  keyframes: [{off: [rknee_bent]}, {on: [rknee_bent, body_low]}]\n  gaps: [{range: [4, null]}]"
    )
    assert write_queries([query], BODY) == (
        "squat:\n"
        "  keyframes:\n"
        "    - {off: [rknee_bent]}\n"
        "    - {on: [rknee_bent, body_low]}\n"
        "  gaps:\n"
        "    - {range: [4, null]}\n"
    )


@pytest.mark.parametrize("name", config_names("queries"))
def test_the_shipped_queries_can_be_read_and_written(name: str) -> None:
    queries = read_queries(name, BODY)
    assert all(query.description for query in queries)
    assert parse(write_queries(queries, BODY)) == queries


@pytest.mark.shared
def test_the_authors_queries_can_be_read_and_written(shared: Path) -> None:
    path = shared / "reference" / "keyframe_queries.json"
    queries = read_queries(path, BODY)
    assert len(queries) == 62
    for query, raw in zip(queries, json.loads(path.read_text()), strict=True):
        assert query.name == query.target == raw["name"]
        patterns = [frame["pattern"].ljust(BODY.sets[frame["feature_set"]].count, "*") for frame in raw["keyframes"]]
        assert [pattern_of(keyframe, BODY) for keyframe in query.keyframes] == patterns
    assert parse(write_queries(queries, BODY)) == queries
