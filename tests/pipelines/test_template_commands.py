"""`kinedex template`: what a stranger sees of templates, figures of them, and templates from examples."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from typer.testing import CliRunner

from kinedex.catalog.configs import parse_yaml
from kinedex.catalog.template_files import read_templates
from kinedex.commands.cli import app
from kinedex.ops.errors import ConfigError
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.pipelines.templates.training import Combination
from tests.pipelines.labelled import BODY, POSES, Line, clip, motion, write_store

CLIPS = [
    clip(subclass, actor, number, pace)
    for subclass in ("walk", "kick")
    for actor, number, pace in (("ann", 1, 4), ("ann", 2, 5), ("bob", 3, 6))
]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    holes = motion("kick", 4)
    holes[[0, 1, 12]] = NO_WORD
    broken = {"name": "dan_take", "actor": "dan", "class": None, "words": holes}
    line = Line(write_store(tmp_path_factory.mktemp("templates") / "store", [*CLIPS, broken]))
    line.run(LearnTemplates, combine={"both": {"parts": ["walk", "kick"], "gap": 3}})
    return line.store


def run(*words: object, code: int = 0) -> str:
    result = CliRunner().invoke(app, ["template", *map(str, words)])
    assert result.exit_code == code, result.output
    return result.output


def test_all_templates_are_listed(store: Path):
    message = run("list", store)
    assert message.count("kick") >= 2
    assert "walk, then kick with 3 columns of anything" in " ".join(message.split())
    rows = run("list", store, "--format", "csv").splitlines()
    assert rows[0] == "stage,subclass,kind,columns,seconds,clips,rounds,last_cost,wildcards,origin,remarks"
    assert len(rows) == 1 + 2 * 3
    assert "did you mean 'test/learn_templates'" in run("list", store, "--stage", "test/learn_template", code=1)


def test_a_template_is_shown_with_its_features_by_name(store: Path):
    message = run("show", store, "kick").splitlines()
    assert message[0].startswith("kick, soft: 25 columns (0.83 s); 3 clips, ")
    assert "largest cost between two clips, round by round: 0.000 → 0.000 (settled)" in message
    first = next(line for line in message if "rhand_forwards  1" in line)
    signs = "".join("█" if word & 1 else "·" for word in POSES["kick"].tolist() for _ in range(5))
    assert first.split()[-2:] == [signs, "100%"]
    assert sum("%" in line for line in message) == 40
    assert "did you mean 'kick'" in run("show", store, "kik", code=1)
    assert "expected soft or hard" in run("show", store, "kick", "--kind", "firm", code=1)


def test_what_distinguishes_two_classes_is_said_in_words(store: Path):
    message = run("diff", store, "kick", "walk")
    assert "kick and walk contradict each other in" in message
    assert "on in kick, off in walk" in message
    assert "contradict each other in 0.0%" in run("diff", store, "kick", "kick")


@pytest.mark.parametrize("what", [("show", "kick"), ("diff", "kick", "walk")])
def test_figures_are_svg_or_png(store: Path, tmp_path: Path, what: tuple[str, ...]):
    svg, png = tmp_path / "figure.svg", tmp_path / "figure.png"
    for path in (svg, png):
        assert str(path) in run(what[0], store, *what[1:], "--output", path).replace("\n", "")
    texts = [
        "".join(each.itertext()) for each in ET.fromstring(svg.read_text()).iter("{http://www.w3.org/2000/svg}text")
    ]
    assert set(texts) >= {f"{feature.name} {feature.number}" for feature in BODY.features}
    with Image.open(io.BytesIO(png.read_bytes())) as image:
        colours = {colour for _, colour in image.convert("RGB").getcolors(1 << 20)}
    assert colours >= {(0, 0, 0), (255, 255, 255)}
    assert "expected an ending of .svg or .png" in run(what[0], store, *what[1:], "-o", tmp_path / "x.gif", code=1)


def test_a_template_goes_to_a_file_and_one_example_makes_one(store: Path, tmp_path: Path):
    run("show", store, "kick", "-o", tmp_path / "mine.yaml")
    (kick,) = read_templates(tmp_path / "mine.yaml", BODY)
    assert kick.name == "kick"
    assert "call it kick.csv" in run("show", store, "kick", "-o", tmp_path / "other.csv", code=1)
    run("from-clip", store, "ann_kick_002", 5, 20, "--name", "middle", "-o", tmp_path / "middle.csv")
    (middle,) = read_templates(tmp_path / "middle.csv", BODY)
    assert np.array_equal(middle.template.values, kick.template.values[5:20])
    text = run("from-clip", store, "ann_kick_002", "0.5s", "--name", "rest")
    (tmp_path / "rest.yaml").write_text(text)
    (rest,) = read_templates(tmp_path / "rest.yaml", BODY)
    assert len(rest.template) == 10
    assert rest.description == "frames 15 to 25 of ann_kick_002"


def test_an_example_that_cannot_be_one_is_explained(store: Path):
    for words, message in [
        (("ann_kick_002", 5, 99), "has 25 frames"),
        (("ann_kick_002", "x"), "START must be a frame"),
        (("ann_kick_oo2",), "did you mean"),
        (("dan_take",), "frame 12 is invalid, in the middle"),
        (("dan_take", 0, 2), "are invalid"),
    ]:
        assert message in run("from-clip", store, *words, code=1)
    assert "frames 2 to 12 of dan_take" in run("from-clip", store, "dan_take", 0, 12)


def test_a_store_without_templates_says_so(tmp_path: Path):
    assert "has no templates yet" in run("list", write_store(tmp_path / "store", CLIPS[:1]), code=1)


def test_a_folder_that_is_not_there_is_named_and_no_other_file(store: Path, tmp_path: Path):
    message = run("from-clip", store, "ann_kick_002", "-o", tmp_path / "nodir" / "ann_kick_002.csv", code=1)
    assert "does not exist; create it" in message
    assert "mkdir -p" in message
    assert ".ann_kick_002" not in message


def test_feature_weights_are_shown(tmp_path: Path):
    line = Line(write_store(tmp_path / "store", CLIPS))
    line.run(LearnTemplates, weights={"rhand_forwards": 0, "lhand_forwards": 2.5})
    assert "feature weights: rhand_forwards 0, lhand_forwards 2.5; all others 1" in run("show", line.store, "kick")


def test_a_combination_of_one_part_is_refused_in_plain_words():
    with pytest.raises(ConfigError, match="must have at least 2 entries, got"):
        parse_yaml("both: {parts: [walk]}", "x.yaml").model(Combination, "both")
