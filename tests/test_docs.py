"""Pages of docs/: links lead somewhere, commands and parameters are real, YAML is valid, SQL runs."""

from __future__ import annotations

import re
import shlex
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer

from kinedex.catalog.classes import load_classes
from kinedex.catalog.configs import config_path
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.query_reader import parse_queries
from kinedex.catalog.skeletons.mappings import load_skeleton
from kinedex.commands.cli import app
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.stages.annotate import Annotate
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.pipelines.stages.learn_templates import LearnTemplates
from kinedex.storage.snapshot.schemas import RESULT_KINDS
from kinedex.storage.store.store import Store, open_store
from tests.pipelines.archives import context, write_archive
from tests.pipelines.labelled import Line

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGES = sorted(DOCS.rglob("*.md"))
TEXTS = {str(page.relative_to(DOCS)): page.read_text(encoding="utf-8") for page in PAGES}
GUIDES = (
    "tutorial.md",
    "tracking.md",
    "depth.md",
    "accuracy.md",
    "keyframe-learning.md",
    "thesis.md",
    "labels.md",
    "formats.md",
    *(name for name in TEXTS if name.startswith("howto/")),
)
LINES = [
    (name, line.strip()) for name in GUIDES for line in re.findall(r"^ {4}(kinedex .*)$", TEXTS[name], re.MULTILINE)
]


def yaml_of(name: str, nth: int = 0) -> str:
    """The n-th whole YAML file that a page shows."""
    return re.findall(r"^```yaml\n(.*?)^```", TEXTS[name], re.DOTALL | re.MULTILINE)[nth]


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Takes, an index, templates and annotations; the feature `rhand_low` of the pages is there too."""
    folder = tmp_path_factory.mktemp("docs")
    takes = {"x_bo_long_1.amc": 500, "x_al_hop_1.amc": 90, "x_al_hop_2.amc": 99, "x_bo_sway_1.amc": 88}
    source = write_archive(folder / "source", takes)
    patterns = [r"x_(?P<actor>[a-z]+)_(?P<class>hop|sway)_(?P<clip>\d)", r"x_(?P<actor>[a-z]+)_long_\d"]
    Ingest().run(context(folder / "store"), Ingest.parameters(source=str(source), patterns=patterns))
    Index().run(context(folder / "store", "index"), Index.parameters())
    line = Line(folder / "store")
    line.run(LearnTemplates)
    line.run(Annotate, tau=0.5)
    return open_store(folder / "store")


def _anchors(text: str) -> set[str]:
    """Return the anchors of the headings of a page; repeated headings are numbered."""
    names = [
        re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
        for title in re.findall(r"^#+ (.*)$", text, re.MULTILINE)
    ]
    return {f"{name}-{names[:i].count(name)}" if name in names[:i] else name for i, name in enumerate(names)}


@pytest.mark.parametrize("name", TEXTS)
def test_links_lead_somewhere(name: str) -> None:
    for target, _, anchor in re.findall(r"\]\(([^)#\s]*)(#([^)]*))?\)", TEXTS[name]):
        if target.startswith("http"):
            continue
        path = (DOCS / name).parent / target if target else DOCS / name
        assert path.is_file(), f"{name}: {target}"
        if anchor:
            assert anchor in _anchors(path.read_text("utf-8")), f"{name}: {target}#{anchor}"


def test_the_page_of_formats_names_every_kind_of_result() -> None:
    named = set(re.findall(r"`results/(\w+)/`", TEXTS["formats.md"]))
    assert named == {*RESULT_KINDS}


def test_the_index_names_every_page() -> None:
    linked = set(re.findall(r"\]\(([a-z0-9/-]+\.md)\)", TEXTS["README.md"]))
    assert linked == set(TEXTS) - {"README.md"}


@pytest.mark.parametrize(("name", "line"), LINES, ids=lambda text: text[:60])
def test_commands_and_their_options_exist(name: str, line: str) -> None:
    words = shlex.split(line, comments=True)[1:]
    command: Any = typer.main.get_command(app)
    while hasattr(command, "commands"):
        words = command.completed(words) if hasattr(command, "completed") else words
        assert words[0] in command.commands, f"{name}: {line}"
        command = command.commands[words.pop(0)]
    known = {option for parameter in command.params for option in parameter.opts} | {"--help"}
    assert {word for word in words if re.match(r"--?[a-z]", word)} <= known, f"{name}: {line}"


RUNS = [one for one in LINES if one[1].startswith("kinedex run ") and "again.yaml" not in one[1]]


@pytest.mark.parametrize(("name", "line"), RUNS, ids=lambda text: text[:60])
def test_settings_and_parameters_exist(name: str, line: str, tmp_path: Path) -> None:
    words = shlex.split(line, comments=True)[2:]
    pipeline = words[0]
    if pipeline == "own.yaml":
        (tmp_path / pipeline).write_text(yaml_of("howto/own-classes.md"), encoding="utf-8")
        pipeline = str(tmp_path / pipeline)
    given = [value for option, value in pairwise(words) if option == "--set"]
    load_pipeline(pipeline, dict(pair.split("=", 1) for pair in given))


STATEMENTS = [
    (name, shlex.split(line)[3]) for name, line in LINES if line.startswith("kinedex sql ") and "rhand_low" not in line
]


@pytest.mark.parametrize(("name", "statement"), STATEMENTS, ids=lambda text: text[:50])
def test_statements_run(store: Store, name: str, statement: str) -> None:
    statement = statement.replace("anna_01", "x_bo_long_1")
    assert store.sql(statement).num_columns > 0, name


def test_the_query_of_the_tutorial_is_one(store: Store) -> None:
    (query,) = parse_queries(yaml_of("tutorial.md"), store.feature_set)
    assert query.name == "kick"


def test_the_mapping_of_the_page_is_one(tmp_path: Path) -> None:
    path = tmp_path / "studio.yaml"
    path.write_text(yaml_of("howto/own-skeleton.md"), encoding="utf-8")
    assert load_skeleton(path, load_feature_set().joints).name == "studio"


def test_the_class_file_of_the_page_is_one(tmp_path: Path) -> None:
    path = tmp_path / "my-classes.yaml"
    path.write_text(yaml_of("howto/own-classes.md", 1), encoding="utf-8")
    found = load_classes(path, ["kickLeft", "kickRight", "squat", "jumpingJack"])
    assert found.names == ("kick", "squat", "jump")
    assert not found.without_class


def test_the_features_of_the_page_can_be_added(tmp_path: Path) -> None:
    lines = re.findall(r"^ {3}(4\d: \{name.*)$", TEXTS["howto/own-features.md"], re.MULTILINE)
    text = config_path("features", "body40").read_text(encoding="utf-8")
    text = text.replace("mix: [27, 40]", "mix: [27, 42]").replace("[35, 36]]", "[35, 36], [41, 42]]")
    path = tmp_path / "my-features.yaml"
    path.write_text(text.replace("name: body40", "name: my-features") + "".join(f"  {line}\n" for line in lines))
    added = load_feature_set(path)
    assert [feature.name for feature in added.features[40:]] == ["rhand_low", "lhand_low"]


@pytest.mark.parametrize(("file", "word"), re.findall(r"`pytest (\S+) -k (\w+)`", "".join(TEXTS.values())))
def test_tests_that_pages_name_exist(file: str, word: str) -> None:
    assert re.search(rf"^def test_\w*{word}", (DOCS.parent / file).read_text(encoding="utf-8"), re.MULTILINE)


def test_programs_that_pages_name_exist() -> None:
    for package, name in re.findall(r"python -m (studies|benchmarks)\.(\w+)", "".join(TEXTS.values())):
        program = DOCS.parent / package / name
        assert program.with_suffix(".py").is_file() or (program / "__main__.py").is_file(), f"{package}.{name}"
