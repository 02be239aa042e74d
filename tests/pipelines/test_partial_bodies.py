"""Bodies that lack joints: searched, annotated and ranked by what they know, beside whole bodies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kinedex.catalog.classes import load_classes
from kinedex.catalog.queries.keyframe_query import (
    Gap,
    Keyframe,
    KeyframeQuery,
    query_share,
    restricted_query,
    word_pattern,
)
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.ops.annotation.segments import Segment
from kinedex.ops.ranking.best_hits import rank
from kinedex.ops.templates.derived_templates import restricted_template
from kinedex.ops.templates.templates import LearnedTemplate, learn_soft, quantise
from kinedex.ops.words import ALL_KNOWN, U64, TakeWords
from kinedex.pipelines.annotation import threshold_calibration as calibration
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.batches import annotate_words
from kinedex.pipelines.annotation.methods import AnnotationMethod, Needs, Setting, Takes
from kinedex.pipelines.annotation.template_methods import BestMethod, ThesisMethod
from kinedex.pipelines.keyframes.applicability import applicability, not_applied_table
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.proposed_query import propose_query
from kinedex.pipelines.keyframes.query_learning import training_sets, training_task
from kinedex.pipelines.keyframes.search_explanation import explain_store
from kinedex.pipelines.keyframes.slice_search import sliced_words
from kinedex.pipelines.keyframes.store_search import search_remarks, search_store
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.ranked_hits import RankedTemplate
from kinedex.pipelines.templates.ranking import rank_takes
from kinedex.pipelines.templates.ranking_evaluation import clip_costs
from kinedex.pipelines.templates.store_ranking import rank_store
from kinedex.pipelines.templates.stored_templates import template_from_clip
from kinedex.pipelines.templates.template_learning import SubclassTemplate, learn_template, usable_clips
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import hits_of
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.oracles import known as naive
from tests.oracles import runs as naive_runs
from tests.pipelines.labelled import BODY, POSES, Line, clip, long_take, motion, write_store

EVERY = BODY.every_bit
ARMS = BODY.known(["lknee", "lankle", "ltoes", "rknee", "rankle", "rtoes"])
MOST = EVERY & ~0b1111_1111  # without F1 to F8
MASKS = (int(ALL_KNOWN), MOST, ARMS, 0b1111)

QUERIES: tuple[KeyframeQuery, ...] = parse_queries(
    """
hands: {keyframes: [{on: [9]}, {off: [10], on: [1]}], gaps: [{range: [1, 9]}]}
foot: {keyframes: [{off: [26]}, {on: [26, 27, 28]}], gaps: [{range: [1, 20]}]}
either: {any_of: [{keyframes: [{on: [17]}]}, {keyframes: [{on: [12]}, {off: [5]}], gaps: [{range: [0, 30]}]}]}
""",
    BODY,
)


def partial(words: U64, known: int) -> U64:
    return words & np.uint64(known)


def laid_out(takes: list[tuple[U64, int]]) -> TakeWords:
    offsets = np.cumsum([0, *(len(words) for words, _ in takes)]).astype(np.int64)
    laid = np.concatenate([np.empty(0, np.uint64), *(partial(words, known) for words, known in takes)])
    return TakeWords(np.arange(len(takes)), offsets, laid, np.array([known for _, known in takes], np.uint64))


def seen(word: int, known: int) -> naive.Seen:
    return [word >> i & 1 if known >> i & 1 else None for i in range(40)]


def entries(mask: int, value: int) -> list[int | None]:
    return [value >> i & 1 if mask >> i & 1 else None for i in range(40)]


@given(takes=st.lists(st.tuples(st.integers(0, 80), st.sampled_from(MASKS)), max_size=6), seed=st.integers(0, 2**32))
@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_query_asks_of_each_take_what_it_knows(takes: list[tuple[int, int]], seed: int) -> None:
    random = np.random.default_rng(seed)
    few = random.integers(0, 2**40, 4, dtype=np.uint64)
    given_takes = [(random.choice(few, length), known) for length, known in takes]
    words = laid_out(given_takes)
    found = sliced_words(words, BODY).search(QUERIES)
    for query, ranges in zip(QUERIES, found, strict=True):
        chains = []
        for chain in query.chains:
            pattern = word_pattern(chain, BODY)
            poses = [entries(*pair) for pair in zip(pattern.masks, pattern.values, strict=True)]
            chains.append((poses, pattern.gaps))
        for index, (own, known) in enumerate(given_takes):
            take = [seen(word, known) for word in own.tolist()]
            expected = naive.hits(chains, take)
            assert [tuple(one) for one in ranges.take(index).tolist()] == expected


def test_alternatives_of_which_too_little_is_known_are_excluded() -> None:
    either = QUERIES[2]
    assert restricted_query(either, BODY, EVERY) is either
    found = restricted_query(either, BODY, EVERY & ~(1 << 16))
    assert found is not None
    assert [chain.keyframes for chain in found.chains] == [either.alternatives[0].keyframes]
    assert query_share(either, BODY, EVERY & ~(1 << 16)) == 1
    assert restricted_query(either, BODY, 0b1_0000) is None
    assert query_share(either, BODY, 0b1_0000) == 1 / 2


def template(subclass: str) -> SubclassTemplate:
    return SubclassTemplate(subclass, "soft", learn_soft([motion(subclass)], 40), ("clip",))


def annotator(method: type = ThesisMethod, queries: tuple[KeyframeQuery, ...] = ()) -> Annotator:
    names = ("kick", "rest", "walk")
    clips = [motion(name) for name in names]
    made = [template(name) for name in names]
    return make_annotator(
        BODY, made, load_classes("own", names), 0.05, 0.13, queries, method=method, clips=lambda: clips
    )


TAKE = np.concatenate([motion(name) for name in ("rest", "walk", "rest", "kick", "kick", "rest")])


@pytest.mark.parametrize("method", [ThesisMethod, BestMethod])
def test_whole_bodies_are_annotated_as_without_partial_ones_beside_them(method: type) -> None:
    chosen = annotator(method)
    alone = TakeWords(np.arange(1), np.array([0, len(TAKE)]), TAKE)
    (expected,) = annotate_words(chosen, alone, store_curves=True)
    mixed = laid_out([(TAKE, MOST), (TAKE, int(ALL_KNOWN)), (TAKE, 0b1111)])
    found = annotate_words(chosen, mixed, store_curves=True)
    assert found[1].segments == expected.segments
    np.testing.assert_array_equal(found[1].curves, expected.curves)
    assert found[1].applied is None
    # with 32 of 40 features the motions are found where they are, and with 4 nothing is tried
    assert [(one.class_index, one.start, one.stop) for one in found[0].segments] == [
        (one.class_index, one.start, one.stop) for one in expected.segments
    ]
    assert found[0].applied is not None
    assert found[0].applied.all()
    assert found[2].applied is not None
    assert not found[2].applied.any()
    assert found[2].segments == ()
    assert np.isinf(found[2].curves).all()
    assert not found[2].preselected.any()


def test_curves_of_a_partial_body_cost_what_is_known() -> None:
    chosen = annotator()
    (found,) = annotate_words(chosen, laid_out([(TAKE, MOST)]), store_curves=True)
    for s, one in enumerate(chosen.templates):
        columns = [entries(*pair) for pair in zip(one.mask.tolist(), one.value.tolist(), strict=True)]
        expected = naive.curve(columns, [seen(word, MOST) for word in partial(TAKE, MOST).tolist()])
        np.testing.assert_allclose(found.curves[s], expected, atol=1e-6)


def test_the_order_of_segments_names_the_right_subclass_where_some_are_not_applied() -> None:
    chosen = annotator()
    words = POSES["kick"]
    fixed = np.bitwise_or.reduce(words ^ words[0])
    known = EVERY & ~int(fixed)  # of a kick only what never changes
    few = [s for s, one in enumerate(chosen.templates) if restricted_template(one, known) is not None]
    (found,) = annotate_words(chosen, laid_out([(TAKE, known)]))
    assert {one.subclass for one in found.segments} <= set(few)
    for one in found.segments:
        assert chosen.class_index[one.subclass] == one.class_index


def test_a_template_is_matched_in_all_frames_where_its_query_is_not_applied() -> None:
    legs = KeyframeQuery(
        "legs", "kick", (Keyframe("lower", 0xFFF, int(POSES["kick"][0] >> np.uint64(14)) & 0xFFF),), ()
    )
    known = EVERY & ~(0x3F << 14)  # half of the query's entries
    chosen = annotator(queries=(legs,))
    places = [chosen.subclasses.index("kick"), chosen.subclasses.index("walk")]
    whole, some = annotate_words(chosen, laid_out([(TAKE, int(ALL_KNOWN)), (TAKE, known)]))
    assert whole.preselected[places[0]] < 1
    assert some.preselected[places].tolist() == [1, 1]


def test_margins_of_a_restricted_query_are_those_of_the_whole_one() -> None:
    kick = KeyframeQuery(
        "kick",
        "kick",
        tuple(Keyframe("upper", 0x3FFF, int(word) & 0x3FFF) for word in POSES["kick"][[0, 4]]),
        (Gap(1, 40),),
    )
    chosen = annotator(queries=(kick,))
    restricted, places = chosen.restricted(EVERY & ~0b111)
    assert restricted is not None
    assert places.tolist() == [0, 1, 2]
    assert restricted.margins == chosen.margins
    (query,) = restricted.queries[chosen.subclasses.index("kick")]
    assert [one.mask for one in query.keyframes] == [0x3FF8, 0x3FF8]


@pytest.fixture
def store(tmp_path: Path) -> Store:
    rows = [
        {"name": f"take_{number}", "actor": "a", "words": partial(TAKE, known), "known": None if number == 1 else known}
        for number, known in enumerate((MOST, EVERY, 0b1111))
    ]
    return open_store(write_store(tmp_path / "store", rows))


def test_partial_bodies_are_ranked_by_what_they_know(store: Store) -> None:
    kick = quantise(template("kick").learned.template, 0.05)
    found, again = rank_takes(store, [RankedTemplate("kick", kick), RankedTemplate("again", kick)], 0.2)
    words = store.words()
    assert words.known is not None
    assert words.known.tolist() == [MOST, int(ALL_KNOWN), 0b1111]
    expected = []
    for take, known in (("take_0", MOST), ("take_1", EVERY)):
        own = store.words([store.take_id(take)]).words
        restricted = restricted_template(kick, known)
        assert restricted is not None
        hits = rank(restricted, TakeWords(np.arange(1), np.array([0, len(own)]), own), 0.2)
        expected += list(zip([take] * len(hits), hits.starts.tolist(), hits.stops.tolist(), strict=True))
    assert sorted(one.interval for one in hits_of(found.hits)) == sorted(expected)
    assert (found.frames, found.searched) == (3 * len(TAKE), 2 * len(TAKE))
    assert found.hits.drop_columns(["template"]) == again.hits.drop_columns(["template"])


def test_only_takes_that_lack_features_have_a_mask(store: Store) -> None:
    ids = [store.take_id(f"take_{number}") for number in range(3)]
    assert store.known == {ids[0]: MOST, ids[2]: 0b1111}
    assert store.words([ids[1]]).known is None
    assert store.words([ids[2]]).masks == [0b1111]


@pytest.fixture
def indexed(store: Store) -> Store:
    build_index(store)
    return open_store(store.path)


def test_the_index_has_the_words_of_a_set_only_where_the_whole_set_is_known(indexed: Store) -> None:
    words = indexed.words()
    assert words.known is not None
    for name, word_set in BODY.sets.items():
        whole = [place for place, known in enumerate(words.known.tolist()) if known & word_set.mask == word_set.mask]
        cut = [
            [word >> (word_set.first - 1) & (1 << word_set.count) - 1 for word in words.take(i).tolist()] for i in whole
        ]
        expected = [
            (word, int(words.take_ids[whole[take]]), start, stop)
            for take, start, stop, word in naive_runs.word_runs(cut)
        ]
        found = indexed.sql(
            "SELECT word, take_id, start, stop FROM word_runs WHERE feature_set = ? ORDER BY take_id, start", [name]
        )
        assert list(zip(*found.to_pydict().values(), strict=True)) == expected
        counted = indexed.sql("SELECT sum(frames)::BIGINT AS frames FROM vocabulary WHERE feature_set = ?", [name])
        assert counted.column("frames")[0].as_py() == sum(map(len, cut))
    for number in (1, 9, 30):
        runs = indexed.sql("SELECT take_id, start, stop FROM feature_runs WHERE feature = ? ORDER BY ALL", [number])
        expected_runs = [
            (int(take_id), *one)
            for take_id, own, known in zip(words.take_ids, map(words.take, range(3)), words.known.tolist(), strict=True)
            for one in naive.feature_runs([seen(word, known) for word in own.tolist()], number - 1)
        ]
        assert list(zip(*runs.to_pydict().values(), strict=True)) == expected_runs
    assert verify(indexed) == []


def test_sql_takes_what_is_unknown_for_neither_on_nor_off(indexed: Store) -> None:
    on_in_kick = BODY.features[int(POSES["kick"][0]).bit_length() - 1].name

    def takes(query: str) -> set[str]:
        return set(indexed.sql(query).column(0).to_pylist())

    assert takes("SELECT take FROM pose('not rhand_forwards')") == {"take_1", "take_2"}
    assert takes("SELECT take FROM pose('not rhand_forwards, not root_fast')") <= {"take_1"}
    assert takes(f"SELECT take FROM pose('{on_in_kick}')") == {"take_0", "take_1"}
    assert takes("SELECT take FROM pattern(['not rhand_forwards', 'rhand_forwards'], within_seconds := 9)") <= {
        "take_1",
        "take_2",
    }
    assert takes("SELECT name FROM takes WHERE knows(known, 'rhand_forwards')") == {"take_1", "take_2"}
    assert takes("SELECT name FROM known_features('take_2') WHERE known") == {one.name for one in BODY.features[:4]}
    assert takes("SELECT name FROM known_features('take_1') WHERE NOT known") == set()


def test_a_search_of_the_store_asks_of_each_take_what_it_knows(indexed: Store) -> None:
    hits = search_store(indexed, QUERIES)
    words = indexed.words()
    found = sliced_words(words, BODY).search(QUERIES)
    names = [indexed.takes(f"take_id = {take_id}")["name"][0] for take_id in words.take_ids.tolist()]
    expected = [
        (query.name, names[take], start, stop)
        for query, ranges in zip(QUERIES, found, strict=True)
        for take in range(3)
        for start, stop in ranges.take(take).tolist()
    ]
    columns = (hits.column(name).to_pylist() for name in ("query", "take", "start", "stop"))
    assert list(zip(*columns, strict=True)) == expected


def test_what_is_not_applied_is_reported(indexed: Store) -> None:
    kick = KeyframeQuery("my kick", "kick", (Keyframe("upper", 0xFF, int(POSES["kick"][0]) & 0xFF),), ())
    assert search_remarks(indexed, [kick]) == [
        "queries not applied in 2 takes, where less than 60% of their entries are known: my kick"
    ]
    wide = KeyframeQuery("wide", "kick", (Keyframe("upper", 0x3FF0, int(POSES["kick"][0]) & 0x3FF0),), ())
    assert search_remarks(indexed, [wide], "name = 'take_0'") == [
        "queries applied by their known entries in 1 take whose bodies lack joints, 60% of them or more: wide"
    ]
    assert search_remarks(indexed, [wide], "name = 'take_1'") == []
    known = indexed.known
    found = annotator(queries=(kick,)).partly_known(known)
    table = not_applied_table(found, known, {take: name for name, take in indexed.take_ids.items()}, "run")
    rows = [(row["take"], row["kind"], row["name"], round(row["known"], 2)) for row in table.to_pylist()]
    assert rows == [
        ("take_0", "query", "my kick", 0.0),
        *(("take_2", "template", name, 0.1) for name in ("kick", "rest", "walk")),
        ("take_2", "query", "my kick", 0.5),
    ]
    assert applicability(BODY, [int(ALL_KNOWN), EVERY], {}, [kick]) == []


class Blunt(AnnotationMethod):
    """A method of a plugin that knows nothing of masks."""

    name, label, needs = "blunt", "blunt", Needs(words=True, templates="learned")

    @classmethod
    def fit(cls, examples: object, unlabelled: object, setting: Setting) -> Blunt:
        return cls()

    def annotate(self, takes: Takes) -> list[list[Segment]]:
        return [[Segment(0, 5, 0, 0.1, 0)] for _ in takes]


def test_a_method_that_needs_all_features_leaves_partial_bodies_alone_and_that_is_reported() -> None:
    chosen = annotator(Blunt)
    found = annotate_words(chosen, laid_out([(TAKE, MOST), (TAKE, int(ALL_KNOWN))]))
    assert [len(one.segments) for one in found] == [0, 1]
    assert chosen.remarks_on({7: MOST}) == [
        "the method 'blunt' needs all features: 1 take whose bodies lack joints have no annotation"
    ]


def test_stages_store_what_is_not_applied(tmp_path: Path) -> None:
    clips = [clip(name, actor, 1, pace) for name in ("kick", "walk") for actor, pace in (("a", 5), ("b", 6))]
    takes = [
        long_take("whole", "c", "rest", "kick", "walk"),
        long_take("most", "c", "rest", "kick", "walk") | {"known": MOST},
        long_take("few", "c", "rest", "kick", "walk") | {"known": 0b1111},
    ]
    for take in takes[1:]:
        take["words"] = partial(take["words"], int(take["known"]))  # type: ignore[call-overload]
    line = Line(write_store(tmp_path / "store", [*clips, *takes]))
    line.run(LearnTemplates, where="class IS NOT NULL")
    summary = line.run(Annotate, where="class IS NULL", method="thesis", store_curves=True)
    remark = "templates not applied in 1 take, where less than 60% of their entries are known: kick, walk"
    assert remark in summary["remarks"]
    store = open_store(line.store)
    rows = store.result("not_applied").to_pylist()
    assert [(row["take"], row["kind"], row["name"]) for row in rows] == [
        ("few", "template", "kick"),
        ("few", "template", "walk"),
    ]
    found = {(row["take"], row["class"]) for row in store.result("annotations").to_pylist()}
    assert found == {(take, name) for take in ("whole", "most") for name in ("kick", "walk")}
    curves = {row["take"]: row["costs"] for row in store.result("distance_curves").to_pylist()}
    assert np.isinf(curves["few"]).all()
    assert verify(store) == []


def test_a_template_learns_nothing_of_features_that_its_clips_lack() -> None:
    every = {f"clip_{pace}": partial(motion("kick", pace), MOST) for pace in (4, 5, 6)}
    clips = usable_clips("kick", every, dict.fromkeys(every, MOST))
    assert (clips.known, clips.remarks) == (MOST, ("the bodies of all clips lack joints: 32 features are learned",))
    learned = learn_template(clips, "soft", 40).template
    assert np.flatnonzero(learned.unknown).tolist() == list(range(8))
    quantised = quantise(learned, 0.05)
    assert not int(np.bitwise_or.reduce(quantised.mask)) & ~MOST
    assert quantised.feature_weights is None
    whole = learn_template(usable_clips("kick", {name: motion("kick") for name in every}), "soft", 40).template
    np.testing.assert_array_equal(learned.values[:, 8:] > 0.5, whole.values[:, 8:] > 0.5)


def test_clips_that_lack_what_others_have_are_excluded() -> None:
    every = {"whole_1": motion("kick"), "part": partial(motion("kick"), MOST), "whole_2": motion("kick", 4)}
    clips = usable_clips("kick", every, {"part": MOST})
    assert (clips.names, clips.known) == (("whole_1", "whole_2"), int(ALL_KNOWN))
    assert clips.remarks == ("clips whose bodies lack joints that others have, excluded: part",)
    some = usable_clips("kick", every, {"part": MOST, "whole_1": ARMS & MOST, "whole_2": ARMS & MOST})
    assert (some.names, some.known) == (("part",), MOST)


def test_the_usual_postures_stand_for_what_a_template_does_not_know() -> None:
    """A template of partial clips labels whole bodies by what it knows, with method best as well."""
    every = {f"{name}_{pace}": motion(name, pace) for name in ("kick", "walk") for pace in (4, 5)}
    made = []
    for name in ("kick", "walk"):
        own = {key: partial(words, MOST) for key, words in every.items() if key.startswith(name)}
        clips = usable_clips(name, own, dict.fromkeys(own, MOST))
        made.append(
            SubclassTemplate(
                name, "soft", LearnedTemplate(learn_template(clips, "soft", 40).template, 1, (0.0,)), clips.names
            )
        )
    chosen = make_annotator(
        BODY, made, load_classes("own", ("kick", "walk")), 0.05, 0.13, method=BestMethod, clips=lambda: [TAKE]
    )
    (found,) = annotate_words(chosen, TakeWords(np.arange(1), np.array([0, len(TAKE)]), TAKE))
    labels = [chosen.classes[one.class_index] for one in found.segments]
    assert labels == ["walk", "kick", "kick"]


def test_keyframes_are_learned_of_known_features_alone(indexed: Store) -> None:
    clips = [
        usable_clips(name, {f"{name}_{pace}": partial(motion(name, pace), known) for pace in (4, 5, 6)}, masks)
        for name, known, masks in (
            ("kick", MOST, {f"kick_{pace}": MOST for pace in (4, 5, 6)}),
            ("walk", EVERY, {}),
            ("wave", 0b1111, {f"wave_{pace}": 0b1111 for pace in (4, 5, 6)}),
        )
    ]
    kick, walk, _ = training_sets(clips, load_classes("own", ("kick", "walk", "wave")))
    assert len(kick.negatives) == 3  # a wave of which four features are known is no evidence
    assert walk.negatives == ()
    task = training_task(kick, setting_of(KeyframeParameters(where="", sets=[]), indexed))
    assert task.masks.any()
    assert not int(np.bitwise_or.reduce(task.masks)) & ~MOST


def test_a_query_proposed_from_a_partial_example_fixes_what_it_knows(indexed: Store) -> None:
    text = propose_query(indexed, "take_0", 25, 55)
    (query,) = parse_queries(text, BODY)
    assert all(query_share(chain, BODY, MOST) == 1 for chain in query.chains)
    assert {"take_0", "take_1"} <= set(search_store(indexed, [query]).column("take").to_pylist())


def test_an_example_of_a_partial_body_finds_itself(indexed: Store) -> None:
    example = template_from_clip(indexed, "take_0", "30", "55")
    ranking = rank_store(indexed, [example]).rankings[0]
    assert {hit.interval[:2] for hit in hits_of(ranking.hits) if hit.cost == 0} >= {("take_0", 30), ("take_1", 30)}


def test_clips_are_judged_by_what_they_know() -> None:
    templates = {name: quantise(template(name).learned.template, 0.05) for name in ("kick", "walk")}
    clips = laid_out([(motion("kick"), int(ALL_KNOWN)), (motion("kick"), MOST), (motion("walk"), 0b1111)])
    costs = clip_costs(templates, clips)
    assert costs["kick"].tolist() == [0, 0, np.inf]
    assert costs["walk"][:2].min() > 0
    whole = clip_costs(templates, laid_out([(motion("kick"), int(ALL_KNOWN))]))
    assert costs["walk"][0] == whole["walk"][0]


def test_thresholds_are_calibrated_by_what_clips_know() -> None:
    part = usable_clips("kick", {"part": partial(motion("kick"), MOST)}, {"part": MOST})
    whole = usable_clips("kick", {"whole": motion("kick")})
    few = usable_clips("walk", {"few": partial(motion("walk"), 0b1111)}, {"few": 0b1111})
    fold = calibration.Fold((template("kick"), template("walk")), (part, whole, few), 0.05)
    costs = calibration.fold_costs(fold)
    assert costs[0].tolist() == [0, 0, np.inf]
    assert np.isinf(costs[1, 2])


def test_an_explanation_finds_what_the_search_finds(indexed: Store) -> None:
    reports = explain_store(indexed, QUERIES)
    hits = search_store(indexed, QUERIES).column("query").to_pylist()
    assert [report.ranges for report in reports] == [hits.count(query.name) for query in QUERIES]
