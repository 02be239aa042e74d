"""Takes that were annotated before are kept, as long as nothing has changed that decides their annotations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import kinedex
from kinedex.catalog.classes import Classes, load_classes
from kinedex.ops.annotation import promising_ranges as grouping
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation import single_examples
from kinedex.pipelines.annotation.annotators import Annotator, make_annotator
from kinedex.pipelines.annotation.earlier_annotations import setting_digest
from kinedex.pipelines.annotation.parameters import AnnotationParameters
from kinedex.pipelines.annotation.template_methods import BestMethod
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.stages import annotate
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.store.compaction import FANOUT
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import verify
from tests.pipelines.annotation.test_batches import KICK, annotator, template
from tests.pipelines.labelled import BODY, Line, clip, long_take, motion, write_store

CLIPS = [clip(name, actor, number) for name in ("walk", "kick") for actor in ("ann", "bob") for number in (1, 2)]
OLD = [long_take("cat_1", "cat", "walk", "kick", "walk"), long_take("cat_3", "cat", "rest", "kick", "rest")]
NEW = [long_take("cat_0", "cat", "kick", "walk"), long_take("cat_2", "cat", "walk", "rest", "walk")]


class KnownLine(Line):
    """A pipeline whose sources are known, as they are to the runner."""

    code, anew, runs = "sources", False, 0

    def context(self, stage: str) -> StageContext:
        KnownLine.runs += 1
        return replace(super().context(stage), code=self.code, anew=self.anew, run=f"run-{KnownLine.runs}")


def annotated(folder: Path, *takes: dict[str, object], executor: str = "serial", **params: object) -> KnownLine:
    line = KnownLine(write_store(folder, [*CLIPS, *takes]), executor)
    line.run(LearnTemplates, methods=["soft"])
    line.run(Annotate, **params)
    return line


def results(store: Store, kind: str) -> pa.Table:
    rows = store.result(kind).drop_columns(["run", "take_id"])
    order = [(name, "ascending") for name in ("take", "subclass", "start") if name in rows.column_names]
    return rows.sort_by(order)


@pytest.mark.parametrize("method", ["thesis", "best"])
@pytest.mark.parametrize("executor", ["serial", "processes"])
def test_new_takes_alone_are_annotated_and_all_is_as_if_annotated_at_once(tmp_path: Path, method: str, executor: str):
    whole = open_store(annotated(tmp_path / "whole", *OLD, *NEW, method=method).store)
    line = annotated(tmp_path / "grown", *OLD, method=method, executor=executor)
    write_store(line.store, NEW)
    assert line.run(Annotate, method=method)["kept_takes"] == 2
    assert "; 2 takes kept as they were, 2 annotated" in line.printed.getvalue()
    grown = open_store(line.store)
    for kind in ("annotations", "distance_curves"):
        assert results(grown, kind).equals(results(whole, kind))
    assert len(set(grown.result("annotations").column("run").to_pylist())) == 1
    both = [store.result("annotated_takes").drop_columns(["run", "take_id"]) for store in (grown, whole)]
    assert both[0].equals(both[1])
    assert (
        grown.result("annotations").column("take").to_pylist() == whole.result("annotations").column("take").to_pylist()
    )
    assert line.run(Annotate, method=method)["kept_takes"] == 4
    assert results(open_store(line.store), "annotations").equals(results(whole, "annotations"))
    line.executor.close()


def curve_files(store: Store) -> dict[str, set[str]]:
    """The files of distance curves, and the takes in each."""
    parts = store.manifest.results.get("distance_curves", ())
    return {part.path: set(pq.read_table(store.path / part.path, columns=["take"])[0].to_pylist()) for part in parts}


def test_curves_of_takes_that_are_kept_stay_in_their_files(tmp_path: Path):
    line = annotated(tmp_path / "store", *OLD)
    (first,) = curve_files(open_store(line.store))
    times = (line.store / first).stat()
    write_store(line.store, NEW)
    line.run(Annotate)
    store = open_store(line.store)
    assert list(curve_files(store).values()) == [{"cat_1", "cat_3"}, {"cat_0", "cat_2"}]
    assert first in curve_files(store)
    assert (line.store / first).stat() == times
    assert {part.stage for part in store.manifest.results["distance_curves"]} == {"test/annotate"}
    collect_garbage(line.store, keep=1)
    assert verify(open_store(line.store, at="newest")) == []
    assert results(open_store(line.store), "distance_curves").num_rows == 2 * 4
    line.run(Annotate)
    assert curve_files(open_store(line.store)) == curve_files(store)


def test_of_takes_that_changed_or_are_not_asked_for_the_curves_go(tmp_path: Path):
    line = annotated(tmp_path / "store", *OLD)
    write_store(line.store, NEW)
    line.run(Annotate)
    write_store(line.store, [long_take("cat_1", "cat", "kick", "rest")])  # the same name, other words
    line.run(Annotate, where="class IS NULL AND name != 'cat_2'")
    store = open_store(line.store)
    assert list(curve_files(store).values()) == [{"cat_0", "cat_1", "cat_3"}]
    assert store.result("distance_curves").num_rows == 2 * 3
    lengths = {row["take"]: len(row["costs"]) for row in store.result("distance_curves").to_pylist()}
    assert lengths == dict(store.takes("class IS NULL AND name != 'cat_2'").select("name", "frames").iter_rows())
    collect_garbage(line.store, keep=1)
    assert verify(open_store(line.store, at="newest")) == []
    assert len(list((line.store / "results/distance_curves").iterdir())) == 1
    line.run(Annotate, tau=0.1)
    assert not set(curve_files(open_store(line.store))) & set(curve_files(store))


def test_small_files_of_curves_are_put_together_before_there_are_many(tmp_path: Path):
    names = [f"cat_{number:02d}" for number in range(20)]
    line = annotated(tmp_path / "store", long_take("cat_99", "cat", "walk"))
    written = 0
    for name in names:
        write_store(line.store, [long_take(name, "cat", "walk", "kick")])
        before = set(curve_files(open_store(line.store)))
        line.run(Annotate)
        after = curve_files(open_store(line.store))
        assert len(after) <= 2 * FANOUT
        written += sum(len(takes) for path, takes in after.items() if path not in before)
    takes = [take for found in after.values() for take in found]
    assert sorted(takes) == [*names, "cat_99"]
    assert written <= 2 * len(names) + FANOUT  # each take once, and once more where files are put together


def test_an_annotation_that_fails_leaves_the_old_curves_and_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    line = annotated(tmp_path / "store", *OLD)
    before = open_store(line.store)
    write_store(line.store, NEW)

    def failing(*given: object) -> object:
        raise KinedexError("out of power")

    monkeypatch.setattr(annotate, "annotate_stored", failing)
    with pytest.raises(KinedexError, match="out of power"):
        line.run(Annotate)
    after = open_store(line.store)
    assert after.manifest.results == before.manifest.results
    assert verify(after) == []


def test_what_has_changed_is_annotated_again(tmp_path: Path):
    line = annotated(tmp_path / "store", *OLD)
    write_store(line.store, [long_take("cat_1", "cat", "kick", "rest")])  # the same name, other words
    assert line.run(Annotate)["kept_takes"] == 1
    changes: list[dict[str, object]] = [
        {"tau": 0.1},
        {"tau": 0.1, "tau_by_class": {"walk": 0.05}},
        {"tau": 0.1, "min_seconds": 0.2},
        {"delta": 0.1},
        {"method": "best"},
        {"store_curves": False},
    ]
    for params in changes:
        assert line.run(Annotate, **params)["kept_takes"] == 0
    assert line.run(Annotate, store_curves=False)["kept_takes"] == 2
    assert open_store(line.store).result("distance_curves").num_rows == 0
    line.code = "other sources"
    assert line.run(Annotate, store_curves=False)["kept_takes"] == 0
    line.code = ""  # nobody knows
    assert line.run(Annotate, store_curves=False)["kept_takes"] == 0
    line.code = "sources"
    line.run(Annotate, store_curves=False)
    line.anew = True  # as with --force
    assert line.run(Annotate, store_curves=False)["kept_takes"] == 0
    line.anew = False
    assert line.run(Annotate, store_curves=False)["kept_takes"] == 2
    line.run(Annotate)
    line.run(LearnTemplates, methods=["soft"], where="class IS NOT NULL AND actor = 'ann'")
    # the clips of both are the same, and so are the templates; fewer examples make labels less certain
    before = results(open_store(line.store), "annotations")
    assert line.run(Annotate)["kept_takes"] == 2
    after = results(open_store(line.store), "annotations")
    assert after.drop_columns(["confidence"]).equals(before.drop_columns(["confidence"]))
    assert after.column("confidence") != before.column("confidence")
    line.anew = True
    line.run(Annotate)
    assert results(open_store(line.store), "annotations").equals(after)
    line.anew = False
    write_store(line.store, [clip("walk", "ann", 1, frames_a_pose=9)])
    line.run(LearnTemplates, methods=["soft"])
    assert line.run(Annotate)["kept_takes"] == 0


def test_thresholds_do_not_matter_to_rows_of_templates(tmp_path: Path):
    line = annotated(tmp_path / "store", *OLD, method="best")
    for params in ({"tau": 0.1}, {"tau_by_class": {"walk": 0.05}}, {"tau": "calibrated"}):
        assert line.run(Annotate, method="best", **params)["kept_takes"] == 2
    assert line.run(Annotate, method="best", min_seconds=0.2)["kept_takes"] == 0


def test_takes_that_are_asked_for_no_longer_go(tmp_path: Path):
    line = annotated(tmp_path / "store", *OLD, *NEW)
    assert line.run(Annotate, where="name < 'cat_2' AND class IS NULL")["kept_takes"] == 2
    store = open_store(line.store)
    for kind in ("annotations", "distance_curves", "annotated_takes"):
        assert set(store.result(kind).column("take").to_pylist()) == {"cat_0", "cat_1"}


def test_every_part_of_an_annotator_decides_its_hash():
    one, templates = annotator("kick", "walk"), [template("kick"), template("walk")]
    assert setting_digest(one, True, "a") == setting_digest(annotator("kick", "walk"), True, "a")
    others: list[Annotator] = [
        annotator("kick", "walk", tau=0.1),
        annotator("kick", "wave"),
        annotator("kick", "walk", queries=(KICK,)),
        make_annotator(BODY, templates, _classes(), 0.05, {"kick": 0.1, "walk": 0.2}),
        replace(one, min_frames=3),
        replace(one, class_index=one.class_index[::-1]),
        make_annotator(BODY, [template("kick"), template("walk", 6)], _classes(), 0.05, 0.13),
        *(
            make_annotator(BODY, templates, _classes(), 0.05, 0.13, method=BestMethod, clips=lambda clip=clip: [clip])
            for clip in (motion("kick"), motion("walk"))
        ),
    ]
    digests = {setting_digest(other, True, "a") for other in others}
    assert len(digests) == len(others)
    assert setting_digest(one, True, "a") not in digests
    assert setting_digest(one, False, "a") != setting_digest(one, True, "a") != setting_digest(one, True, "b")


CHANGES: dict[str, dict[str, object]] = {
    "method": {"method": "best"},
    "templates": {"templates": "hard", "delta": 0.3},
    "delta": {"delta": 0.3},
    "tau": {"tau": 0.1},
    "tau_by_class": {"tau_by_class": {"walk": 0.05}},
    "min_seconds": {"min_seconds": 0.2},
    "queries": {"queries": "QUERIES"},
    "classes": {"classes": "CLASSES"},
    "each_example": {"method": "best", "each_example": True},
    "store_curves": {"store_curves": False},
}
"""Every parameter with a value that changes what is stored of a take, beside others that make it matter."""

WITHOUT_EFFECT_ON_A_TAKE = {"where": "it selects takes, and the annotation of a take does not depend on the others"}
"""Parameters after whose change a take that was annotated before keeps its annotation, each with the reason."""


def test_every_parameter_of_an_annotation_decides_whether_takes_are_annotated_again() -> None:
    assert {*CHANGES} | {*WITHOUT_EFFECT_ON_A_TAKE} == {*AnnotationParameters.model_fields}


@pytest.mark.parametrize("name", CHANGES)
def test_a_changed_parameter_annotates_takes_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    files = {"QUERIES": tmp_path / "queries.yaml", "CLASSES": tmp_path / "classes.yaml"}
    files["QUERIES"].write_text("kick:\n  keyframes: [{set: upper, pattern: '****111*******'}]\n")
    files["CLASSES"].write_text("legs: [walk, kick]\n")
    changes = {
        key: str(files[value]) if value in ("QUERIES", "CLASSES") else value for key, value in CHANGES[name].items()
    }
    unlike = {**clip("walk", "eve", 1), "words": motion("walk") ^ np.uint64(1)}  # a soft value between 0 and 1
    line = KnownLine(write_store(tmp_path / "store", [*CLIPS, unlike, *OLD]), "serial")
    line.run(LearnTemplates, methods=["soft", "hard"])
    found = []

    def recorded(annotator: Annotator, store_curves: bool, code: str) -> str:
        found.append(setting_digest(annotator, store_curves, code))
        return found[-1]

    monkeypatch.setattr(annotate, "setting_digest", recorded)
    without = {key: value for key, value in changes.items() if key != name}
    for params in (without, without, changes):
        line.run(Annotate, **params)
    assert found[0] == found[1] != found[2]


def _classes() -> Classes:
    return load_classes("own", ["kick", "walk"])


def test_classes_have_thresholds_of_their_own_and_segments_a_least_length(tmp_path: Path):
    noisy = motion("walk") ^ np.uint64(0b11)  # two features of forty are wrong: a cost of 0.05
    take = {"name": "cat_1", "actor": "cat", "class": None, "words": np.concatenate([noisy, motion("kick")])}
    line = annotated(tmp_path / "store", take, tau=0.1)

    def found(**params: object) -> set[str]:
        line.run(Annotate, **params)
        return set(open_store(line.store).result("annotations").column("class").to_pylist())

    assert found(tau=0.1) == {"walk", "kick"}
    assert found(tau=0.1, tau_by_class={"walk": 0.04}) == {"kick"}
    assert found(tau=0.04, tau_by_class={"walk": 0.1}) == {"walk", "kick"}
    assert found(tau=0.1, min_seconds=len(motion("walk")) / 30 + 0.01) == {"kick"}
    assert found(method="best", min_seconds=len(motion("walk")) / 30 + 0.01) == {"kick"}
    with pytest.raises(KinedexError, match="tau_by_class: no class is named 'walks'; did you mean 'walk'"):
        line.run(Annotate, tau_by_class={"walks": 0.1})


def test_new_examples_alone_are_compared_with_takes_and_all_is_as_if_annotated_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    compared: list[int] = []

    def counted_groups(templates: list[object], *other: object) -> object:
        compared.append(len(templates))
        return grouping.template_groups(templates, *other)  # type: ignore[arg-type]

    monkeypatch.setattr(single_examples, "template_groups", counted_groups)
    learned = {"methods": ["soft"], "examples": ["labels"]}
    asked = {"method": "best", "where": "true", "each_example": True, "store_curves": False}
    first = [{"take": "cat_1", "class": "walk", "start": 0, "stop": 20}]
    first += [{"take": "cat_1", "class": "kick", "start": 20, "stop": 45}]
    more = [{"take": "cat_0", "class": "kick", "start": 0, "stop": 25}]
    more += [{"take": "cat_3", "class": "walk", "start": 0, "stop": 5, "verdict": "negative"}]

    def run(line: KnownLine) -> list[int]:
        line.run(LearnTemplates, **learned)
        compared.clear()
        line.run(Annotate, **asked)
        return compared[-1:]  # the last ones are those of the takes; before them, confidence was calibrated

    line = KnownLine(write_store(tmp_path / "grown", [*OLD, *NEW]))
    kinedex.open_store(line.store).labels.add(first)
    assert run(line) == [2]
    kinedex.open_store(line.store).labels.add(more)
    assert run(line) == [1]  # the rejected one: the other has the frames of an example that is known
    whole = KnownLine(write_store(tmp_path / "whole", [*OLD, *NEW]))
    kinedex.open_store(whole.store).labels.add([*first, *more])
    assert run(whole) == [4]
    stores = [open_store(one.store) for one in (line, whole)]
    for kind in ("annotations", "example_ranges"):
        grown, once = (results(store, kind) for store in stores)
        assert grown.num_rows
        assert grown.equals(once)
    ranges = results(stores[0], "example_ranges").to_pylist()
    assert [row["take"] for row in ranges] == ["cat_0", "cat_1", "cat_2", "cat_3"]
    assert all(len(row["examples"]) == len(row["counts"]) == 4 for row in ranges)
    # those of takes that are kept stay, and those of takes that are not asked for go
    assert line.run(Annotate, **asked | {"where": "name != 'cat_3'"})["kept_takes"] == 3
    assert [row["take"] for row in results(open_store(line.store), "example_ranges").to_pylist()] == [
        "cat_0", "cat_1", "cat_2",
    ]  # fmt: skip
    write_store(line.store, [long_take("cat_2", "cat", "kick", "rest")])  # with it the usual postures change
    assert run(line) == [4]
    assert verify(open_store(line.store, at="newest")) == []
    line.run(Annotate, method="best", where="true")
    assert open_store(line.store).result("example_ranges").num_rows == 0
