"""Thresholds of classes come from training clips alone, each matched with templates of other actors' clips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.classes import Classes, MotionClass, load_classes
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import learn_soft
from kinedex.pipelines.annotation import batches as annotating
from kinedex.pipelines.annotation import threshold_calibration as calibrating
from kinedex.pipelines.annotation.threshold_calibration import Calibration, calibrate
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.evaluate import Evaluate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.template_learning import SubclassTemplate, TrainingClips
from kinedex.storage.store.store import open_store
from tests.oracles.dtw import accumulated
from tests.pipelines.labelled import Line, clip, long_take, motion, write_store


def clips(subclass: str, **words: np.ndarray) -> TrainingClips:
    return TrainingClips(subclass, tuple(f"{subclass}_{actor}" for actor in words), tuple(words.values()))


ACTORS: dict[str, str | None] = {
    f"{label}_{actor}": actor for label in ("walk", "kick", "wave") for actor in ("ann", "bob")
}


def worse(subclass: str, features: int) -> np.ndarray:
    """A motion with so many features of forty wrong in every frame."""
    return motion(subclass) ^ np.uint64((1 << features) - 1)


def learned_from(seen: list[set[str]]):
    def learn(some):
        seen.append({name for one in some for name in one.names})
        return [SubclassTemplate(one.subclass, "soft", learn_soft(list(one.words), 40), one.names) for one in some]

    return learn


def calibrated(classes: Classes, *some: TrainingClips, seen: list[set[str]] | None = None) -> Calibration:
    learn = learned_from([] if seen is None else seen)
    return calibrate(some, ACTORS, classes, 0.05, learn, make_executor("serial", 1))


def test_an_actors_clips_meet_templates_of_the_others_and_the_middle_divides_them():
    walk = clips("walk", ann=motion("walk"), bob=worse("walk", 4))
    kick = clips("kick", ann=motion("kick"), bob=motion("kick"))
    seen: list[set[str]] = []
    found = calibrated(load_classes("own", ["kick", "walk"]), walk, kick, seen=seen)
    assert seen == [{"walk_bob", "kick_bob"}, {"walk_ann", "kick_ann"}]
    assert found.scores == {"kick": 1.0, "walk": 1.0}
    assert not found.remarks

    def least(template: np.ndarray, take: np.ndarray) -> float:
        columns = [[int(word) >> bit & 1 for bit in range(40)] for word in template.tolist()]
        return min(accumulated(columns, columns_of(take))[1][-1]) / len(columns)

    def columns_of(take: np.ndarray) -> list[list[int]]:
        return [[int(word) >> bit & 1 for bit in range(40)] for word in take.tolist()]

    own = [least(worse("walk", 4), motion("walk")), least(motion("walk"), worse("walk", 4))]
    others = [least(worse("walk", 4), motion("kick")), least(motion("walk"), motion("kick"))]
    assert own == pytest.approx([0.1, 0.1])
    assert found.taus["walk"] == pytest.approx((max(own) + min(others)) / 2)


def test_a_class_of_one_actors_clips_has_the_threshold_of_all_and_that_is_said():
    walk = clips("walk", ann=motion("walk"), bob=worse("walk", 4))
    kick = clips("kick", ann=motion("kick"), bob=motion("kick"))
    wave = clips("wave", ann=motion("wave"))
    found = calibrated(load_classes("own", ["kick", "walk", "wave"]), walk, kick, wave)
    assert 0.1 < found.taus["wave"] < 0.5
    assert list(found.scores) == ["kick", "walk"]
    assert found.remarks[0].startswith("τ of all classes together")
    assert found.remarks[0].endswith("one actor: wave")
    with pytest.raises(KinedexError, match="leaves one actor out at a time, but all training clips are of ann"):
        calibrated(load_classes("own", ["wave"]), wave)
    with pytest.raises(KinedexError, match="needs training clips"):
        calibrated(load_classes("own", ["wave"]))


def test_classes_without_a_template_have_no_threshold_and_each_without_its_own_is_said_why():
    walk = clips("walk", ann=motion("walk"), bob=worse("walk", 4))
    kick = clips("kick", ann=motion("kick"), bob=motion("kick"))
    wave = clips("wave", ann=motion("wave"))
    classes = load_classes("own", ["dance", "kick", "rest", "walk", "wave"])
    made = SubclassTemplate("rest", "soft", learn_soft([motion("rest")], 40), ())

    def learn(some):  # a template of a file besides, of a class that has no clip
        return [*learned_from([])(some), made]

    found = calibrate((walk, kick, wave), ACTORS, classes, 0.05, learn, make_executor("serial", 1))
    assert set(found.taus) == {"kick", "rest", "walk", "wave"}
    assert found.taus["rest"] == found.taus["wave"]
    together = f"τ of all classes together ({found.taus['rest']:.3g}), as"
    assert found.remarks == (f"{together} they have no clips: rest", f"{together} their clips are of one actor: wave")
    both = clips("wave", ann=motion("wave"), bob=motion("wave"))
    known = load_classes("own", ["kick", "walk", "wave"])
    fits_nothing = calibrate((walk, kick, both), ACTORS, known, 0.05, too_long, make_executor("serial", 1))
    assert fits_nothing.remarks[0].endswith("as no clip of theirs fits a template of other actors' clips: wave")


def too_long(some):
    """Templates as they are learned, but those of wave are longer than a clip of it can be stretched to."""

    def tiled(one: TrainingClips) -> TrainingClips:
        return TrainingClips(one.subclass, one.names, tuple(np.tile(words, 9) for words in one.words))

    return learned_from([])([tiled(one) if one.subclass == "wave" else one for one in some])


def test_the_curves_of_a_fold_are_made_batch_by_batch(monkeypatch: pytest.MonkeyPatch):
    some = (clips("walk", ann=motion("walk"), bob=worse("walk", 4)), clips("kick", ann=motion("kick")[:7]))
    fold = calibrating.Fold(tuple(learned_from([])(some)), some, 0.05)
    whole = calibrating.fold_costs(fold)
    assert whole.shape == (2, 3)
    monkeypatch.setattr(annotating, "BATCH_FRAMES", 30)
    longest = []
    curves_of = calibrating.distance_curves

    def seen(templates, words, ranges):
        longest.append(len(words))
        return curves_of(templates, words, ranges)

    monkeypatch.setattr(calibrating, "distance_curves", seen)
    assert np.array_equal(calibrating.fold_costs(fold), whole)
    assert longest == [20, 27]
    nothing = calibrating.Fold((), some, 0.05)
    assert calibrating.fold_costs(nothing).shape == (0, 3)


def test_subclasses_of_one_class_do_not_count_against_it():
    legs = Classes((MotionClass("legs", "", ("kick", "walk")), MotionClass("arms", "", ("wave",))))
    some = [clips(name, ann=motion(name), bob=worse(name, 2)) for name in ("kick", "walk", "wave")]
    found = calibrated(legs, *some)
    assert set(found.taus) == {"legs", "arms"}
    assert found.scores == {"legs": 1.0, "arms": 1.0}


def test_the_stage_calibrates_on_what_its_templates_were_learned_from(tmp_path: Path):
    some = [clip(name, actor, n) for name in ("walk", "kick") for actor in ("ann", "bob", "cat") for n in (1, 2)]
    some.append(clip("wave", "cat", 1))  # in the archive, and not learned from
    take = long_take("cat_1", "cat", "walk", "kick", "rest")
    (tmp_path / "archive").mkdir()
    text = "take,class,start,stop\ncat_1,walk,0,80\ncat_1,kick,80,180\n"
    (tmp_path / "archive" / "ground_truth.csv").write_text(text)
    (tmp_path / "classes.yaml").write_text("kick: [kick]\nwalk: [walk]\nwave: [wave]\n")
    for executor in ("serial", "processes"):
        line = Line(write_store(tmp_path / executor, [*some, take], tmp_path / "archive"), executor)
        line.run(LearnTemplates, methods=["soft"], where="class IS NOT NULL AND actor <> 'cat'")
        summary = line.run(Annotate, tau="calibrated")
        assert set(summary["tau_by_class"]) == {"kick", "walk"}  # type: ignore[call-overload]
        assert summary["calibration_f"] == {"kick": 1.0, "walk": 1.0}
        given = line.run(Annotate, tau="calibrated", tau_by_class={"walk": 0.5})["tau_by_class"]
        assert given == {**summary["tau_by_class"], "walk": 0.5}  # type: ignore[dict-item]
        best = line.run(Annotate, tau="calibrated", method="best", tau_by_class={"walk": 0.5})
        assert best["tau_by_class"] == {}
        remark = "`tau: calibrated` and `tau_by_class` have no effect with `method: best`, which uses no thresholds"
        assert best["remarks"] == [remark]
        assert remark in line.printed.getvalue()
        with_classes = line.run(Annotate, tau="calibrated", classes=str(tmp_path / "classes.yaml"))
        assert set(with_classes["tau_by_class"]) == {"kick", "walk"}  # type: ignore[call-overload]
        assert with_classes["remarks"] == []
        line.run(Annotate, tau="calibrated")
        assert set(open_store(line.store).result("annotations").column("class").to_pylist()) == {"walk", "kick"}
        line.run(Evaluate)
        assert line.leave_out()["folds"] == 1
        line.executor.close()
