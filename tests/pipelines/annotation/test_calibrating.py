"""Thresholds of classes come from training clips alone, each matched with templates of other actors' clips."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from catalog.classes import Classes, MotionClass, load_classes
from ops.errors import KinedexError
from ops.templates.templates import learn_soft
from pipelines.annotation.calibrating import Calibration, calibrate
from pipelines.executors import make_executor
from pipelines.stages import annotate, evaluate, learn_templates, leave_one_out
from pipelines.templates.learning import SubclassTemplate, TrainingClips
from storage.store import open_store
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


def test_subclasses_of_one_class_do_not_count_against_it():
    legs = Classes((MotionClass("legs", "", ("kick", "walk")), MotionClass("arms", "", ("wave",))))
    some = [clips(name, ann=motion(name), bob=worse(name, 2)) for name in ("kick", "walk", "wave")]
    found = calibrated(legs, *some)
    assert set(found.taus) == {"legs", "arms"}
    assert found.scores == {"legs": 1.0, "arms": 1.0}


def test_the_stage_calibrates_on_what_its_templates_were_learned_from(tmp_path: Path):
    some = [clip(name, actor, n) for name in ("walk", "kick") for actor in ("ann", "bob", "cat") for n in (1, 2)]
    take = long_take("cat_1", "cat", "walk", "kick", "rest")
    (tmp_path / "archive").mkdir()
    text = "take,class,start,stop\ncat_1,walk,0,80\ncat_1,kick,80,180\n"
    (tmp_path / "archive" / "ground_truth.csv").write_text(text)
    for executor in ("serial", "processes"):
        line = Line(write_store(tmp_path / executor, [*some, take], tmp_path / "archive"), executor)
        line.run(learn_templates, methods=["soft"], where="class IS NOT NULL AND actor <> 'cat'")
        summary = line.run(annotate, tau="calibrated")
        assert set(summary["tau_by_class"]) == {"kick", "walk"}  # type: ignore[call-overload]
        assert summary["calibration_f"] == {"kick": 1.0, "walk": 1.0}
        given = line.run(annotate, tau="calibrated", tau_by_class={"walk": 0.5})["tau_by_class"]
        assert given == {**summary["tau_by_class"], "walk": 0.5}  # type: ignore[dict-item]
        assert line.run(annotate, tau="calibrated", method="best")["tau_by_class"] == {}
        line.run(annotate, tau="calibrated")
        assert set(open_store(line.store).result("annotations").column("class").to_pylist()) == {"walk", "kick"}
        line.run(evaluate)
        assert line.run(leave_one_out)["folds"] == 1
        line.executor.close()
