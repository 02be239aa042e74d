"""Macros over takes with invalid frames, hits and results: their answers are those of plain loops over frames."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from kinedex.ops.errors import KinedexError
from kinedex.ops.words import NO_WORD
from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.oracles.keyframes import ranges_by_sets
from tests.pipelines.labelled import write_store
from tests.storage.made_up import BODY

NAMES = [feature.name for feature in BODY.features[:4]]
INVALID = int(NO_WORD)


def made_up() -> dict[str, list[int]]:
    """Words with the first four features only, so that they come together often, and with invalid stretches."""
    random = np.random.default_rng(7)
    takes = {}
    for name, stretches in (("a", 60), ("b", 25), ("c", 0), ("d", 1)):
        words = random.integers(0, 16, stretches)
        words = np.where(random.random(stretches) < 0.12, INVALID, words.astype(np.uint64))
        takes[name] = np.repeat(words, random.integers(1, 5, stretches)).tolist()
    return {**takes, "e": [INVALID] * 6}


TAKES = made_up()
CLASSES = {"a": None, "b": "walk", "c": "hop", "d": "hop", "e": None}


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    takes: list[dict[str, object]] = [
        {"name": name, "words": words, "class": CLASSES[name], "actor": "x"} for name, words in TAKES.items()
    ]
    path = write_store(tmp_path_factory.mktemp("macros") / "store", takes)
    build_index(open_store(path, at="newest"), shard_frames=40)
    return open_store(path)


def rows(store: Store, query: str, params: object = None) -> list[tuple[object, ...]]:
    found = store.sql(query, params)
    return list(zip(*(column.to_pylist() for column in found.columns), strict=True))


def holds(word: int, pose: str) -> bool:
    """Return true where a frame meets a pose, which is read term by term."""
    if word == INVALID:
        return False
    wanted = []
    for part in pose.split(","):
        *negation, name = part.split()
        on = word >> NAMES.index(name) & 1
        wanted.append(not on if negation else on)
    return all(wanted)


def stretches(met: list[bool]) -> list[tuple[int, int]]:
    edges = [i for i, (one, two) in enumerate(pairwise([False, *met, False])) if one != two]
    return list(zip(edges[::2], edges[1::2], strict=True))


def some_poses(seed: int, count: int) -> list[str]:
    random = np.random.default_rng(seed)
    poses = []
    for _ in range(count):
        chosen = random.choice(NAMES, random.integers(1, 4), replace=False)
        poses.append(", ".join(("not " if random.random() < 0.5 else "") + name for name in chosen))
    return poses


@pytest.mark.parametrize("seed", range(6))
def test_a_pose_is_where_all_of_it_holds(store: Store, seed: int) -> None:
    for pose in some_poses(seed, 4):
        expected = [
            (take, start, stop)
            for take, words in TAKES.items()
            for start, stop in stretches([holds(w, pose) for w in words])
        ]
        assert expected
        assert rows(store, "SELECT take, start, stop FROM pose(?)", [pose]) == expected, pose
        long = [row for row in expected if (row[2] - row[1]) / 30 >= 0.1]
        assert rows(store, "SELECT take, start, stop FROM pose(?, min_seconds := 0.1)", [pose]) == long, pose


@pytest.mark.parametrize("seed", range(12))
def test_a_pattern_finds_what_keyframe_search_finds(store: Store, seed: int) -> None:
    random = np.random.default_rng(seed)
    poses = some_poses(100 + seed, int(random.integers(1, 5)))
    seconds = float(random.choice([0, 0.1, 0.2, 0.7, 3]))
    gaps = [(0, int(np.floor(seconds * 30 + 1e-9)))] * (len(poses) - 1)
    expected = [
        (take, start, stop)
        for take, words in TAKES.items()
        if words
        for start, stop in ranges_by_sets([[holds(w, pose) for w in words] for pose in poses], gaps)
    ]
    query = f"SELECT take, start, stop FROM pattern({poses!r}, within_seconds := {seconds})"
    assert rows(store, query) == expected, query


def test_a_pose_takes_numbers_and_any_spacing_and_what_contradicts_itself_never_holds(store: Store) -> None:
    plain = rows(store, "FROM pose('rhand_above_neck, not lhand_above_neck')")
    assert plain
    for same in ("3,not 4", "  F3 ,  not   F4 ", "3, 3, not 4, not lhand_above_neck"):
        assert rows(store, f"FROM pose('{same}')") == plain, same
    assert rows(store, "FROM pose('3, not 3')") == []
    assert rows(store, "FROM pattern(['3, not 3', '3'])") == []


def test_runs_stop_at_invalid_frames_and_their_words_have_no_features(store: Store) -> None:
    expected = [
        (take, start, stop)
        for take, words in TAKES.items()
        for start, stop in stretches([holds(word, NAMES[0]) for word in words])
    ]
    assert rows(store, "SELECT take, start, stop FROM runs_where(1)") == expected
    invalid = sum(words.count(INVALID) for words in TAKES.values())
    assert rows(store, "SELECT count(*) FROM frames WHERE has(word, 1) IS NULL") == [(invalid,)]
    assert rows(store, "SELECT features_of('upper', NULL)") == [(None,)]
    for macro in ("timeline('e')", "pose('not 1') WHERE take = 'e'", "timeline('c')"):
        assert rows(store, f"FROM {macro}") == []


def test_together_followed_by_and_cooccurrence_leave_invalid_frames_out(store: Store) -> None:
    both = [
        (take, start, stop)
        for take, words in TAKES.items()
        for start, stop in stretches([holds(word, f"{NAMES[0]}, {NAMES[2]}") for word in words])
    ]
    assert rows(store, "SELECT take, start, stop FROM together(1, 3)") == both
    after = [
        (take, a, b, c, d)
        for take, words in TAKES.items()
        for a, b in stretches([holds(word, NAMES[0]) for word in words])
        for c, d in stretches([holds(word, NAMES[1]) for word in words])
        if 0 <= c - b <= 6
    ]
    assert rows(store, "SELECT take, start, a_stop, b_start, stop FROM followed_by(1, 2, 0.2)") == after
    frames = sum(stop - start for _, start, stop in both)
    assert rows(store, "SELECT frames FROM cooccurrence(1) WHERE feature = 3") == [(frames,)]
    assert rows(store, "SELECT share FROM cooccurrence(40) WHERE feature = 3") == [(None,)]


def test_rare_words_are_counted_in_valid_frames(store: Store) -> None:
    counts: dict[int, int] = {}
    for word in (word for words in TAKES.values() for word in words if word != INVALID):
        counts[word] = counts.get(word, 0) + 1
    found = rows(store, "SELECT word, frames, features FROM rarest_words('upper', n := 100)")
    assert {word: frames for word, frames, _ in found} == counts
    assert [frames for _, frames, _ in found] == sorted(counts.values())
    for word, _, features in found:
        assert features == [name for bit, name in enumerate(NAMES) if int(str(word)) >> bit & 1]


def test_frames_around_a_hit_reach_to_the_ends_of_the_take(store: Store) -> None:
    found = rows(store, "SELECT since_start, inside, frame, word FROM frames_around('a', 10, 14, seconds := 0.1)")
    assert [row[2] for row in found] == list(range(7, 17))
    assert [row[1] for row in found] == [10 <= frame < 14 for frame in range(7, 17)]
    assert [row[0] for row in found] == pytest.approx([(frame - 10) / 30 for frame in range(7, 17)])
    assert [row[3] for row in found] == [word if word != INVALID else None for word in TAKES["a"][7:17]]
    last = len(TAKES["b"])
    near = rows(store, f"SELECT frame FROM frames_around('b', {last - 1}, {last}, seconds := 100)")
    assert near == [(frame,) for frame in range(last)]


def results(path: Path) -> Store:
    """A store of the takes above with templates, annotations and labels."""
    takes: list[dict[str, object]] = [
        {"name": name, "words": words, "class": CLASSES[name]} for name, words in TAKES.items()
    ]
    write_store(path, takes)
    put = {
        "templates": [
            {"subclass": "hop", "kind": "soft", "features": 40, "columns": 2, "weights": [1.0, 2.5],
             "values": [1.0, 0.5, 0.03, *[0.5] * 37, 0.96, 0.0, *[0.5] * 38]}
        ],
        "annotations": [
            {"take_id": 1, "take": "a", "class": "jump", "subclass": "hop", "start": 5, "stop": 9, "cost": 0.25}
        ],
        "ground_truth": [
            {"take_id": 1, "take": "a", "class": "jump", "start": 3, "stop": 8},
            {"take_id": 1, "take": "a", "class": "sit", "start": 20, "stop": 30},
        ],
    }  # fmt: skip
    with StoreWriter.open(path, BODY) as writer:
        for kind, lines in put.items():
            schema = result_schema(kind)
            whole = [{name: {"run": kind, **line}.get(name) for name in schema.names} for line in lines]
            table = pa.Table.from_pylist(whole, schema=schema)
            writer.put_results(kind, table, stage=f"test/{kind}", run=kind)
        writer.commit()
    return open_store(path)


def test_results_have_macros_and_need_no_index(tmp_path: Path) -> None:
    store = results(tmp_path)
    with pytest.raises(KinedexError, match="index"):
        store.sql("FROM pose('1')")
    assert rows(store, "SELECT source, class, subclass, start, stop, cost FROM labels_of('a')") == [
        ("ground truth", "jump", None, 3, 8, None),
        ("annotation", "jump", "hop", 5, 9, 0.25),
        ("ground truth", "sit", None, 20, 30, None),
    ]
    assert rows(store, "FROM labels_of('b')") == []
    with pytest.raises(KinedexError, match="no take is named nobody; the view takes lists them"):
        store.sql("FROM labels_of('nobody')")
    on, off = [[NAMES[0]], [NAMES[0]]], [[NAMES[2]], [NAMES[1]]]
    assert rows(store, "SELECT * FROM template_columns('hop')") == [
        ("templates", "soft", number, (1.0, 2.5)[number], on[number], off[number]) for number in range(2)
    ]
    assert rows(store, "SELECT features_on FROM template_columns('hop', tolerance := 0)") == [([NAMES[0]],), ([],)]
    with pytest.raises(
        KinedexError, match=r"no template of hip \(did you mean 'hop'\?\); the view templates lists them"
    ):
        store.sql("FROM template_columns('hip')")


def test_classes_say_how_they_are_known(tmp_path: Path) -> None:
    everywhere = ["annotations", "clips", "ground_truth", "templates"]
    assert rows(results(tmp_path), "FROM classes") == [
        ("jump", ["hop"], 2, pytest.approx(len(TAKES["d"]) / 30), 1, 1, everywhere),
        ("sit", [], 0, 0.0, 0, 1, ["ground_truth"]),
        ("walk", ["walk"], 1, pytest.approx(len(TAKES["b"]) / 30), 0, 0, ["clips"]),
    ]  # fmt: skip


def test_nothing_is_known_of_an_empty_archive(tmp_path: Path) -> None:
    write_store(tmp_path, [])
    store = open_store(tmp_path)
    assert rows(store, "FROM classes") == []
    build_index(store)
    with open_store(tmp_path) as opened:
        for name, example in rows(opened, "SELECT name, example FROM help"):
            assert opened.sql(str(example)).num_columns, name
