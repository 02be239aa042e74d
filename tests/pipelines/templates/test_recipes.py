"""Templates in the mirror, combined, of files and with weights; large classes; and training clips with faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.template_files import write_yaml
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import Kind, LearnedTemplate, NamedTemplate, Template, quantise
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.stages import learn_templates
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.evaluate import Evaluate
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.template_learning import SubclassTemplate, read_templates
from kinedex.storage.store.store import open_store
from tests.pipelines.labelled import BODY, Line, clip, labelled_line, write_store


@pytest.fixture
def line(tmp_path: Path) -> Line:
    return labelled_line(tmp_path)


def test_a_large_subclass_is_divided_among_the_workers_without_a_difference(
    line: Line, monkeypatch: pytest.MonkeyPatch
):
    line.run(LearnTemplates)
    alone = open_store(line.store).result("templates").drop_columns(["run"])
    monkeypatch.setattr("kinedex.pipelines.templates.template_learning._SPLIT_CELLS", 1)
    spread = Line(line.store, "processes")
    spread.run(LearnTemplates)
    spread.executor.close()
    assert open_store(line.store).result("templates").drop_columns(["run"]).equals(alone)


def templates_by_name(line: Line, kind: str = "soft") -> dict[str, dict[str, object]]:
    rows = open_store(line.store).result("templates").to_pylist()
    return {row["subclass"]: row for row in rows if row["kind"] == kind}


def test_clips_in_the_mirror_teach_another_class_or_the_same(line: Line):
    line.run(LearnTemplates, mirror={"kick": "kick_other", "wave": "wave"})
    rows = templates_by_name(line)
    assert set(rows) == {"kick", "kick_other", "walk", "wave"}
    values = {name: np.array(row["values"]).reshape(-1, 40) for name, row in rows.items()}
    np.testing.assert_allclose(values["kick_other"], values["kick"][:, BODY.mirror_order], atol=1e-12)
    assert rows["kick_other"]["clips"] == rows["kick"]["clips"]
    assert rows["kick_other"]["origin"] == "learned, 3 of 3 clips are those of kick in the mirror"
    assert rows["wave"]["origin"] == "learned, 3 of 6 clips are those of wave in the mirror"
    assert rows["walk"]["origin"] == "learned"
    with pytest.raises(KinedexError, match="mirror: there are no clips of 'kik'; did you mean 'kick'"):
        line.run(LearnTemplates, mirror={"kik": "x"})
    with pytest.raises(KinedexError, match="'x' is the mirror image of both 'kick' and 'wave'"):
        line.run(LearnTemplates, mirror={"kick": "x", "wave": "x"})


def test_motions_that_follow_each_other_are_one_template(line: Line):
    line.run(LearnTemplates, combine={"walk_then_kick": {"parts": ["walk", "kick"], "gap": 5}})
    rows = templates_by_name(line)
    row = rows["walk_then_kick"]
    assert row["columns"] == rows["walk"]["columns"] + 5 + rows["kick"]["columns"]
    assert row["origin"] == "walk, then kick with 5 columns of anything between"
    assert row["clips"] == rows["walk"]["clips"] + rows["kick"]["clips"]
    line.run(Annotate, where="name = 'cat_take01'")
    found = open_store(line.store).result("annotations").to_pylist()
    assert ("walk_then_kick", 20 // 4) in {(row["class"], row["start"]) for row in found}
    line.run(Evaluate, unknown_labels="ignore")
    line.leave_out()
    with pytest.raises(KinedexError, match="'x' needs a template of 'wolk'; did you mean 'walk'"):
        line.run(LearnTemplates, combine={"x": {"parts": ["wolk", "kick"]}})
    with pytest.raises(KinedexError, match="'kick' has a template already"):
        line.run(LearnTemplates, combine={"kick": {"parts": ["walk", "kick"]}})


def test_a_template_of_a_file_takes_the_place_of_a_learned_one(line: Line, tmp_path: Path):
    line.run(LearnTemplates)
    by_hand = {one.subclass: one for one in read_templates(open_store(line.store), "test/learn_templates", "soft")}
    file = tmp_path / "mine.yaml"
    file.write_text(write_yaml([NamedTemplate("kick", by_hand["kick"].learned.template)], BODY))
    params = LearnTemplates.parameters(template_files=[str(file)])
    before = LearnTemplates().external_digest(params, open_store(line.store))
    line.run(LearnTemplates, template_files=[str(file)])
    rows = templates_by_name(line)
    assert rows["kick"]["values"] == by_hand["kick"].learned.template.values.ravel().tolist()
    assert (rows["kick"]["origin"], rows["kick"]["clips"], rows["kick"]["costs"]) == ("from mine.yaml", [], [])
    assert set(templates_by_name(line, "hard")) == {"kick", "walk", "wave"}
    assert "templates from files, so their clips are not learned from: kick" in line.printed.getvalue()
    line.run(Annotate)
    assert line.run(Evaluate)["f2"] == 1
    assert line.leave_out()["folds"] == 2
    summary = line.run(LearnTemplates, where="false", template_files=[str(file)], methods=["soft"])
    assert (summary["templates"], summary["clips"]) == (1, 0)
    file.write_text(file.read_text() + "walk:\n  rows: {F1: '01'}\n")
    assert LearnTemplates().external_digest(params, None) != before
    with pytest.raises(KinedexError, match=r"'kick' stands in .* and in"):
        line.run(LearnTemplates, template_files=[str(file), str(file)])


def test_features_can_be_weighted_by_name(line: Line):
    line.run(LearnTemplates, weights={"F1": 0, "rhand_fast": 3}, methods=["soft"])
    counts = templates_by_name(line)["kick"]["feature_weights"]
    assert isinstance(counts, list)
    assert (counts[0], counts[12], counts[1]) == (0, 3, 1)
    (one, *_) = read_templates(open_store(line.store), "test/learn_templates", "soft")
    assert not np.any(quantise(one.learned.template, 0.05).mask & np.uint64(1))
    line.run(Annotate)
    line.run(Evaluate)
    line.leave_out()
    for weights, message in [({"F41": 1}, "no feature F41"), ({"F1": 1, "rhand_forwards": 2}, "are the same feature"),
                          ({name.name: 0 for name in BODY.features}, "at least one feature must count")]:  # fmt: skip
        with pytest.raises(KinedexError, match=message):
            line.run(LearnTemplates, weights=weights)


def test_invalid_frames_are_cut_off_or_the_clip_is_left_out_and_both_are_said(line: Line):
    hole = np.array([NO_WORD], np.uint64)
    good = clip("kick", "dan", 4)
    words = np.asarray(good["words"])
    clips = [
        good | {"name": "dan_kick_ends", "words": np.concatenate([hole, words, hole, hole])},
        good | {"name": "dan_kick_hole", "words": np.concatenate([words[:9], hole, words[9:]])},
    ]
    write_store(line.store, clips)
    line.run(LearnTemplates, methods=["soft"])
    row = templates_by_name(line)["kick"]
    assert row["clips"] == ["ann_kick_001", "ann_kick_002", "bob_kick_003", "dan_kick_ends"]
    assert row["remarks"] == [
        "clips with invalid frames in the middle, excluded: dan_kick_hole",
        "clips with invalid frames at an end, which are cut off: dan_kick_ends",
    ]
    assert "warning: kick: clips with invalid frames in the middle, excluded: dan_kick_hole" in line.printed.getvalue()
    with pytest.raises(KinedexError, match=r"subclass kick is left without a clip .*\(dan_kick_hole\)"):
        line.run(LearnTemplates, where="name = 'dan_kick_hole'")


def test_a_clip_of_another_motion_is_told_from_the_others(line: Line):
    odd = [clip("kick", "dan", number, number) | {"name": f"dan_kick_{number}"} for number in (4, 5, 6)]
    odd.append(clip("wave", "dan", 9) | {"name": "dan_kick_wrong", "class": "kick"})
    odd.append(clip("kick", "dan", 8, 30) | {"name": "dan_kick_slow"})
    write_store(line.store, odd)
    summary = line.run(LearnTemplates, methods=["soft"])
    remarks = " | ".join(templates_by_name(line)["kick"]["remarks"])  # type: ignore[arg-type]
    assert "far from all others" in remarks
    assert "dan_kick_wrong (cost" in remarks
    assert "dan_kick_slow (150 frames)" in remarks
    assert len(summary["warnings"]) == 2  # type: ignore[arg-type]


def test_a_warning_of_one_kind_says_which_and_the_class_comes_first():
    def made(subclass: str, kind: Kind, *remarks: str) -> SubclassTemplate:
        learned = LearnedTemplate(Template(np.zeros((2, 40)), np.ones(2)), 1, ())
        return SubclassTemplate(subclass, kind, learned, ("a",), remarks=remarks)

    templates = [made("kick", "soft", "both", "one"), made("kick", "hard", "both"), made("walk", "soft", "both")]
    assert learn_templates._warnings(templates) == {"both": ["kick", "walk"], "one": ["kick (soft)"]}
