"""Annotating in batches: takes do not influence each other, and keyframes narrow the search."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.catalog.classes import Classes, MotionClass, load_classes
from kinedex.catalog.queries.keyframe_query import Gap, Keyframe, KeyframeQuery
from kinedex.ops.annotation.segments import local_minima
from kinedex.ops.distances.dtw import distance_curves
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import LearnedTemplate, Template, learn_soft
from kinedex.ops.words import TakeWords
from kinedex.pipelines.annotation import batches as annotating
from kinedex.pipelines.annotation import template_methods
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator, unknown_targets
from kinedex.pipelines.annotation.batches import annotate_words, split_takes
from kinedex.pipelines.annotation.template_methods import BestMethod
from kinedex.pipelines.keyframes.preselected_frames import preselect, template_ranges
from kinedex.pipelines.templates.template_learning import SubclassTemplate
from tests.oracles import annotation as naive
from tests.oracles.paths import start_frames
from tests.pipelines.labelled import BODY, POSES, motion


def template(subclass: str, frames_a_pose: int = 5) -> SubclassTemplate:
    return SubclassTemplate(subclass, "soft", learn_soft([motion(subclass, frames_a_pose)], 40), ("clip",))


def annotator(*subclasses: str, queries: tuple[KeyframeQuery, ...] = (), tau: float = 0.13) -> Annotator:
    templates = [template(subclass) for subclass in subclasses]
    return make_annotator(BODY, templates, load_classes("own", subclasses), 0.05, tau, queries)


def laid_out(takes: list[np.ndarray]) -> TakeWords:
    offsets = np.concatenate([[0], np.cumsum([len(take) for take in takes])]).astype(np.int64)
    return TakeWords(np.arange(len(takes)), offsets, np.concatenate([*takes, np.empty(0, np.uint64)]))


KICK = KeyframeQuery(
    "my kick",
    "kick",
    tuple(Keyframe("upper", 0x3FFF, int(word) & 0x3FFF) for word in POSES["kick"][[0, 2, 4]]),
    (Gap(1, 20), Gap(1, 20)),
)


def test_motions_are_found_where_they_are():
    take = np.concatenate([motion(name) for name in ("rest", "walk", "rest", "kick", "kick", "rest")])
    (found,) = annotate_words(annotator("kick", "walk", "rest"), laid_out([take]), store_curves=True)
    labels = [("kick", "rest", "walk")[s.class_index] for s in found.segments if s.cost == 0]
    assert labels == ["rest", "walk", "rest", "kick", "rest"]  # two kicks in a row are one stretch of kicking
    kick = next(s for s in found.segments if s.class_index == 0)
    assert (kick.start, kick.stop) == (30, 80)
    assert found.curves is not None
    assert found.curves.shape == (3, len(take))
    assert found.preselected.tolist() == [1, 1, 1]


def test_labelled_together_motions_in_a_row_are_told_apart():
    names = ("rest", "walk", "rest", "kick", "kick", "rest")
    take = np.concatenate([motion(name) for name in names])
    templates = [template(subclass) for subclass in ("kick", "walk")]
    classes = load_classes("own", ["kick", "walk"])
    made = make_annotator(BODY, templates, classes, 0.05, 0.13, method=BestMethod, clips=lambda: [take])
    (found,) = annotate_words(made, laid_out([take]))
    lengths = np.cumsum([0, *(len(motion(name)) for name in names)]).tolist()
    expected = [(lengths[i], lengths[i + 1], name) for i, name in enumerate(names) if name != "rest"]
    assert [(s.start, s.stop, ("kick", "walk")[s.class_index]) for s in found.segments] == expected
    assert all(segment.cost == 0 and segment.margin > 0.5 for segment in found.segments)
    assert made.label == "templates in a row"


def test_labelled_together_features_of_weight_0_are_no_evidence():
    names = ("rest", "walk", "rest", "kick", "kick", "rest")
    take = np.concatenate([motion(name) for name in names])
    classes = load_classes("own", ["kick", "walk"])
    wrong = np.uint64(0xFFFF)  # the template of kicks has these features the other way round
    learned = [learn_soft([words], 40) for words in (motion("kick") ^ wrong, motion("walk"))]
    found = {}
    for weight in (0.0, 1.0):
        weights = np.repeat([weight, 1.0], [16, 24])
        templates = [
            SubclassTemplate(
                name, "soft", replace(one, template=replace(one.template, feature_weights=weights)), ("c",)
            )
            for name, one in zip(("kick", "walk"), learned, strict=True)
        ]
        made = make_annotator(BODY, templates, classes, 0.05, 0.13, method=BestMethod, clips=lambda: [take])
        (annotated,) = annotate_words(made, laid_out([take]))
        found[weight] = [(s.start, s.stop, s.class_index) for s in annotated.segments]
    lengths = np.cumsum([0, *(len(motion(name)) for name in names)]).tolist()
    expected = [(lengths[i], lengths[i + 1], index) for i, index in ((1, 1), (3, 0), (4, 0))]
    assert found[0.0] == expected
    assert found[1.0] == expected[:1]


def test_labelled_together_a_motion_is_found_in_the_hits_of_its_keyframes_only():
    take = np.concatenate([motion(name) for name in ("walk", "rest", "kick", "rest")])
    templates = [template(subclass) for subclass in ("kick", "walk")]
    classes = load_classes("own", ["kick", "walk"])
    nowhere = replace(KICK, keyframes=tuple(replace(one, mask=0x3FFF, value=0x3FFF) for one in KICK.keyframes))
    for query, expected in ((KICK, [1, 0]), (nowhere, [1])):
        made = make_annotator(BODY, templates, classes, 0.05, 0.13, (query,), method=BestMethod, clips=lambda: [take])
        (found,) = annotate_words(made, laid_out([take]))
        assert [one.class_index for one in found.segments] == expected


words_of_takes = st.lists(
    st.lists(st.sampled_from(sorted(POSES)), max_size=5).map(
        lambda names: np.concatenate([np.empty(0, np.uint64), *(motion(name, 3) for name in names)])
    ),
    min_size=1,
    max_size=4,
)


@settings(max_examples=40)
@given(words_of_takes, st.booleans())
def test_takes_do_not_influence_each_other(takes: list[np.ndarray], with_keyframes: bool):
    queries = (KICK,) if with_keyframes else ()
    templates = [template("kick", 3), template("walk", 3), template("rest", 1)]  # the last has a single column
    classes = load_classes("own", [one.subclass for one in templates])
    one = make_annotator(BODY, templates, classes, 0.05, 0.13, queries)
    together = annotate_words(one, laid_out(takes), store_curves=True)
    for found, take in zip(together, takes, strict=True):
        (alone,) = annotate_words(one, laid_out([take]), store_curves=True)
        assert found.segments == alone.segments
        np.testing.assert_array_equal(found.curves, alone.curves)
        np.testing.assert_array_equal(found.preselected, alone.preselected)


def test_keyframes_narrow_the_search_but_not_the_result():
    take = np.concatenate([motion(name) for name in ("walk", "rest", "walk", "kick", "walk", "rest", "walk")])
    words = laid_out([take])
    (everywhere,) = annotate_words(annotator("kick", "walk"), words)
    (narrowed,) = annotate_words(annotator("kick", "walk", queries=(KICK,)), words, store_curves=True)
    assert narrowed.preselected[0] < 0.6
    assert narrowed.preselected[1] == 1
    assert narrowed.curves is not None
    assert np.isinf(narrowed.curves[0, :20]).all()
    best = [
        min((s for s in found.segments if s.class_index == 0), key=lambda s: s.cost) for found in (everywhere, narrowed)
    ]
    assert best[0] == best[1]


def test_a_query_for_a_class_serves_the_subclasses_that_have_none_of_their_own():
    classes = Classes((MotionClass("legs", "", ("kick", "walk")), MotionClass("arms", "", ("wave",))))
    for_legs = KeyframeQuery("legs", "legs", (Keyframe("upper", 1, 1),), ())
    made = make_annotator(
        BODY, [template("kick"), template("walk"), template("wave")], classes, 0.05, 0.13, (for_legs, KICK)
    )
    assert made.queries == ((KICK,), (for_legs,), ())
    assert made.label == "templates within keyframe hits"
    assert made.class_index.tolist() == [0, 0, 1]


def test_learned_queries_preselect_besides_those_of_files_for_a_subclass_or_its_class():
    classes = Classes((MotionClass("legs", "", ("kick", "walk")), MotionClass("arms", "", ("wave",))))
    for_legs = KeyframeQuery("legs", "legs", (Keyframe("upper", 1, 1),), ())
    written, for_wave = replace(KICK, name="kick"), KeyframeQuery("wave", "wave", for_legs.keyframes, ())
    learned = replace(KICK, name="kick", margins=(3, 3))
    templates = [template("kick"), template("walk"), template("wave")]
    made = make_annotator(BODY, templates, classes, 0.05, 0.13, (for_legs,)).with_learned((learned, for_wave), classes)
    assert made.queries == ((for_legs, learned), (for_legs,), (for_wave,))
    made = make_annotator(BODY, templates, classes, 0.05, 0.13, (written, for_legs)).with_learned((learned,), classes)
    assert made.queries == ((written, learned), (for_legs,), ())


def test_two_queries_of_one_name_both_preselect():
    nowhere = replace(KICK, keyframes=tuple(replace(one, mask=0x3FFF, value=0x3FFF) for one in KICK.keyframes))
    words = laid_out([np.concatenate([motion(name) for name in ("walk", "rest", "kick", "walk")])])
    (expected,) = annotate_words(annotator("kick", "walk", queries=(KICK,)), words, store_curves=True)
    assert 0 < expected.preselected[0] < 1
    for queries in ((KICK, nowhere), (nowhere, KICK)):
        (found,) = annotate_words(annotator("kick", "walk", queries=queries), words, store_curves=True)
        assert found.segments == expected.segments
        assert found.preselected.tolist() == expected.preselected.tolist()


def test_queries_that_fit_no_class_are_named_and_all_of_them_an_error():
    classes = load_classes("own", ["kick", "walk"])
    other = KeyframeQuery("x", "kik", KICK.keyframes, KICK.gaps)
    assert unknown_targets([KICK, other], classes) == ["kik"]
    with pytest.raises(KinedexError, match="the first is for 'kik'; did you mean 'kick'"):
        unknown_targets([other], classes)


def test_classes_without_any_template_are_an_error():
    with pytest.raises(KinedexError, match="none of the classes dance has a template; there are: kick"):
        make_annotator(BODY, [template("kick")], Classes((MotionClass("dance", "", ()),)), 0.05, 0.13)


def faint(subclass: str, fixed: int) -> SubclassTemplate:
    """A template of four columns of which so many entries are no wildcards."""
    values = np.full((4, 40), 0.5)
    values.ravel()[:fixed] = 0
    return SubclassTemplate(subclass, "soft", LearnedTemplate(Template(values, np.ones(4)), 1, (0.0, 0.0)), ("clip",))


def test_templates_that_fit_anything_are_left_out_and_those_that_nearly_do_are_named():
    classes = load_classes("own", ["faint", "kick", "nothing", "walk"])
    templates = [faint("nothing", 0), template("kick"), faint("faint", 3), faint("walk", 4)]
    made = make_annotator(BODY, templates, classes, 0.05, 0.13)
    assert made.subclasses == ("kick", "faint", "walk")
    assert made.classes == ("faint", "kick", "nothing", "walk")
    assert made.remarks == (
        "templates of wildcards alone, which would fit anything, excluded: nothing",
        "templates with less than 1 fixed entry a column on average, which fit almost anything: faint (0.75)",
    )
    assert not make_annotator(BODY, [template("kick")], classes, 0.05, 0.13).remarks
    with pytest.raises(KinedexError, match=r"every template is wildcards alone .* raise `delta`"):
        make_annotator(BODY, templates[:1], classes, 0.05, 0.13)


def test_takes_are_divided_into_batches_and_none_is_lost(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(annotating, "BATCH_FRAMES", 100)
    assert split_takes([3, 1, 2, 4, 5], [10, 60, 50, 300, 1]) == [(1,), (2, 3), (4,), (5,)]
    assert split_takes([], []) == []


@given(
    st.lists(st.integers(0, 12), min_size=1, max_size=5),
    st.lists(st.tuples(st.integers(0, 6), st.integers(1, 6)), max_size=6),
)
def test_frames_within_ranges_are_counted_take_by_take(lengths: list[int], steps: list[tuple[int, int]]):
    offsets = np.cumsum([0, *lengths])
    edges = np.minimum(np.cumsum([0, *(step for pair in steps for step in pair)])[1:], offsets[-1]).reshape(-1, 2)
    inside = [sum(start <= frame < stop for start, stop in edges) for frame in range(offsets[-1])]
    expected = [sum(inside[start:stop]) for start, stop in pairwise(offsets)]
    assert annotating._frames_within(edges, offsets).tolist() == expected


@settings(max_examples=30)
@given(words_of_takes, st.sampled_from(["nowhere", "somewhere", "two"]))
def test_takes_do_not_influence_each_other_where_they_are_explained_within_keyframe_hits(
    takes: list[np.ndarray], where: str
):
    start = replace(KICK, name="its start", keyframes=KICK.keyframes[:1], gaps=())
    nowhere = replace(KICK, keyframes=tuple(replace(one, mask=0x3FFF, value=0x3FFF) for one in KICK.keyframes))
    queries = {"nowhere": (nowhere,), "somewhere": (KICK,), "two": (start, replace(start, target="walk"))}[where]
    templates = [template("kick", 3), template("walk", 3)]
    classes, clips = load_classes("own", ["kick", "walk"]), [motion("walk"), motion("rest")]
    one = make_annotator(BODY, templates, classes, 0.05, 0.13, queries, method=BestMethod, clips=lambda: clips)
    for found, take in zip(annotate_words(one, laid_out(takes)), takes, strict=True):
        (alone,) = annotate_words(one, laid_out([take]))
        assert found.segments == alone.segments


@settings(max_examples=40)
@given(words_of_takes, st.sampled_from([0, 1, 2]), st.sampled_from([0.02, 0.13, 0.5]), st.sampled_from([0, 1, 10**9]))
def test_segments_are_those_of_whole_curves_labelled_frame_by_frame(
    takes: list[np.ndarray], with_keyframes: int, tau: float, narrow: int
):
    queries = (KICK, replace(KICK, name="its start", keyframes=KICK.keyframes[:1], gaps=()))[:with_keyframes]
    templates = [template("kick", 3), template("walk", 3), template("rest", 1)]  # the last has a single column
    classes = Classes((MotionClass("legs", "", ("rest", "kick")), MotionClass("walk", "", ("walk",))))
    one = make_annotator(BODY, templates, classes, 0.05, tau, queries)
    words = laid_out(takes)
    ranges = template_ranges_of(one, words)
    pieces = list(pairwise(words.offsets.tolist()))
    modified: list[list[list[float]]] = [[] for _ in pieces]
    for quantised, stretches in zip(one.templates, ranges, strict=True):
        (curve,) = distance_curves([quantised], words.words, stretches)
        for own, (start, stop) in zip(modified, pieces, strict=True):
            ends = local_minima(curve[start:stop], tau)
            begins = start_frames(quantised, words.words, ends + start, stretches) - start
            starts = dict(zip(ends.tolist(), begins.tolist(), strict=True))
            own.append(naive.modified(curve[start:stop].tolist(), starts, tau))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(template_methods, "NARROW", narrow)
        found = annotate_words(one, words)
    for take, own in zip(found, modified, strict=True):
        expected = naive.annotate(own, one.class_index.tolist(), tau)
        labels = [(s.start, s.stop, s.class_index, s.subclass) for s in take.segments]
        assert labels == [(*s[:3], s[4]) for s in expected]
        assert [s.cost for s in take.segments] == pytest.approx([s[3] for s in expected], abs=1e-9)
        assert [s.margin for s in take.segments] == pytest.approx([s[5] for s in expected], abs=1e-9)


def template_ranges_of(one: Annotator, words: TakeWords) -> list[np.ndarray]:
    """Return the ranges of each template by `template_ranges`, from hits that are found in memory."""
    hits = preselect(words, BODY, [query for queries in one.queries for query in queries])
    found = []
    for quantised, queries in zip(one.templates, one.queries, strict=True):
        if not queries:
            found.append(np.stack([words.offsets[:-1], words.offsets[1:]], axis=1))
            continue
        found.append(template_ranges(hits, queries, quantised.values(40), BODY, words.offsets))
    return found
