"""Plans: what runs again after what changed, and what a stopped run leaves."""

from __future__ import annotations

import io
import logging
import pickle
from pathlib import Path

import pytest
from rich.console import Console

from kinedex.catalog.configs import shipped_configs
from kinedex.console.terminal import Terminal
from kinedex.ops.errors import ConfigError, KinedexError, NewStoreError, ParameterError, SourceError
from kinedex.pipelines.engine.config import load_pipeline
from kinedex.pipelines.engine.executors import SerialExecutor
from kinedex.pipelines.engine.plan import make_plan
from kinedex.pipelines.engine.runner import StageFailed, run_pipeline
from kinedex.pipelines.stages import ingest
from kinedex.pipelines.stages.index import Index
from kinedex.pipelines.stages.ingest import Ingest
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.archives import human_amc, write_archive


def run(store: Path, source: Path, **options: object) -> tuple[str, ...]:
    silent = Terminal(Console(file=io.StringIO()))
    return run_pipeline("ingest", store, assignments={"source": str(source)}, terminal=silent, **options).ran  # type: ignore[arg-type]


@pytest.fixture
def archive(tmp_path: Path) -> tuple[Path, Path]:
    source, store = write_archive(tmp_path / "source", {"x_1.amc": 30, "x_2.amc": 40}), tmp_path / "store"
    assert run(store, source) == ("ingest", "index")
    return store, source


def reasons(store: Path, source: Path, force: frozenset[str] = frozenset(), **settings: str) -> list[str | None]:
    pipeline = load_pipeline("ingest", {"source": str(source), **settings})
    return [step.reason for step in make_plan(pipeline, store, force)]


def test_nothing_runs_twice(archive: tuple[Path, Path]) -> None:
    assert run(*archive) == ()
    assert reasons(*archive) == [None, None]


def test_what_changed_is_said_and_what_depends_on_it_runs_too(archive: tuple[Path, Path]) -> None:
    store, source = archive
    (source / "x_2.amc").write_text(human_amc(44, seed=9))
    assert reasons(store, source) == ["its files changed", "ingest changed"]
    assert reasons(store, source, **{"ingest.rate_hz": "60"})[0] == "its parameters changed; its files changed"


def test_force_carries_through_to_the_end(archive: tuple[Path, Path]) -> None:
    assert reasons(*archive, frozenset({"ingest"})) == ["--force", "ingest runs"]
    assert reasons(*archive, frozenset({"index"})) == [None, "--force"]
    with pytest.raises(KinedexError, match="did you mean 'index'"):
        reasons(*archive, frozenset({"indx"}))


def test_takes_that_somebody_else_changed_are_noticed(archive: tuple[Path, Path]) -> None:
    store, source = archive
    opened = open_store(store)
    with StoreWriter.open(store, opened.feature_set) as writer:
        writer.drop_takes([opened.take_id("x_1")])
        writer.commit()
    assert reasons(store, source)[0] == "the store's takes changed"
    run(store, source)
    assert open_store(store).takes()["name"].to_list() == ["x_1", "x_2"]


def test_an_index_that_is_gone_is_built_again(archive: tuple[Path, Path]) -> None:
    store, source = archive
    for file in (store / "index").rglob("*.duckdb"):
        file.unlink()
    assert reasons(store, source) == [None, "what it made is gone or stale"]


def test_a_mapping_that_changed_reads_the_takes_again(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"x_1.amc": 30}), tmp_path / "store"
    shipped = Path(ingest.__file__).parents[2] / "configs" / "skeletons" / "acclaim.yaml"
    mapping = tmp_path / "mine.yaml"
    mapping.write_text(shipped.read_text())
    assert reasons(store, source, skeleton=str(mapping)) == ["has not run yet", "has not run yet"]
    silent = Terminal(Console(file=io.StringIO()))
    settings = {"source": str(source), "skeleton": str(mapping)}
    run_pipeline("ingest", store, assignments=settings, terminal=silent)
    assert reasons(store, source, skeleton=str(mapping)) == [None, None]
    mapping.write_text(shipped.read_text().replace("0.0254", "0.05"))
    assert reasons(store, source, skeleton=str(mapping))[0] == "its files changed"


@pytest.mark.parametrize(
    "fault", [KinedexError("no luck"), OSError(28, "No space left on device", "part"), MemoryError()]
)
def test_a_stage_that_fails_does_not_count_as_done_and_says_how_to_go_on(
    archive: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, fault: Exception
) -> None:
    store, source = archive

    def fail(*_: object) -> dict[str, object]:
        raise fault

    monkeypatch.setattr(Index, "run", fail)
    with pytest.raises(StageFailed) as caught:
        run(store, source, force=frozenset({"index"}))
    assert "stage index" in str(caught.value)
    assert f"kinedex run ingest --store {store} --set source={source} --executor serial --force index" in str(
        caught.value
    )
    monkeypatch.undo()
    assert reasons(store, source) == [None, "has not run yet"]


def fails_with(archive: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch, fault: KinedexError) -> str:
    def fail(*_: object) -> dict[str, object]:
        raise fault

    monkeypatch.setattr(Index, "run", fail)
    with pytest.raises(StageFailed) as caught:
        run(*archive, force=frozenset({"index"}))
    return str(caught.value)


def test_a_command_that_cannot_succeed_is_not_advised(
    archive: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert fails_with(archive, monkeypatch, NewStoreError("use another")) == "stage index: use another"
    fault = KinedexError("no luck")
    fault.way_out = ("luck", "good")
    message = fails_with(archive, monkeypatch, fault)
    assert "continue with:\n    kinedex run ingest" in message
    assert message.endswith("--force index --set index.luck=good")


def test_a_store_is_not_made_before_something_goes_in(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(StageFailed, match="no motion files"):
        run(tmp_path / "store", tmp_path / "empty")
    assert not (tmp_path / "store").exists()


def test_a_stop_after_everything_is_recorded_is_none(
    archive: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(_: SerialExecutor) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(SerialExecutor, "close", stop)
    assert run(*archive, force=frozenset({"index"})) == ("index",)


def test_figures_stay_when_another_run_begins_the_stage_right_away(tmp_path: Path) -> None:
    source, store = write_archive(tmp_path / "source", {"x_1.amc": 30, "x_2.amc": 40}), tmp_path / "store"

    class AnotherRun(Terminal):
        def message(self, text: str) -> None:
            if text.startswith("done in"):
                with StoreWriter.open(store, open_store(store).feature_set) as writer:
                    writer.forget_stage("ingest/index")
                    writer.commit()

    terminal = AnotherRun(Console(file=io.StringIO()))
    outcome = run_pipeline("ingest", store, settings={"source": source}, terminal=terminal)
    assert outcome.ran == ("ingest", "index")
    assert list(outcome.summaries) == ["ingest", "index"]
    assert "ingest/index" not in open_store(store).manifest.stages


def test_what_another_pipeline_has_done_is_not_called_undone(archive: tuple[Path, Path]) -> None:
    store, source = archive
    message = io.StringIO()
    pipeline = store.parent / "other.yaml"
    pipeline.write_text(
        (shipped_configs() / "pipelines" / "ingest.yaml").read_text().replace("name: ingest", "name: x")
    )
    run_pipeline(
        pipeline, store, assignments={"source": str(source)}, terminal=Terminal(Console(file=message, soft_wrap=True))
    )
    lines = message.getvalue().splitlines()
    assert lines[0].endswith("ingest: not run yet by the pipeline 'x' (but by another)")
    assert "0 to read, 2 unchanged" in lines[1]
    assert "for which 0 of 18 frames were indexed anew" in message.getvalue()
    other = load_pipeline("annotate", {"source": str(source)})
    assert make_plan(other, store)[2].reason == "has not run yet"


def test_a_run_that_is_killed_in_a_stage_leaves_no_record_of_it(
    archive: tuple[Path, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    store, source = archive

    def kill(*_: object) -> dict[str, object]:
        raise KeyboardInterrupt

    monkeypatch.setattr(Ingest, "run", kill)
    with pytest.raises(KeyboardInterrupt):
        run(store, source, force=frozenset({"ingest"}))
    monkeypatch.undo()
    assert reasons(store, source)[0] == "has not run yet"


@pytest.mark.parametrize(
    "error",
    [
        ParameterError("rate_hz", "positive", -1),
        SourceError("a.amc", "is empty", line=3),
        ConfigError("a.yaml", "no such key", line=2, key="x"),
    ],
)
def test_errors_cross_from_a_worker_process_whole(error: KinedexError) -> None:
    copy = pickle.loads(pickle.dumps(error))
    assert (type(copy), str(copy)) == (type(error), str(error))


def test_a_run_from_python_takes_values_and_gives_figures(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    source = write_archive(tmp_path / "source", {"x_1.amc": 30})
    silent = Terminal(Console(file=io.StringIO()))
    with caplog.at_level(logging.INFO, logger="kinedex"):
        outcome = run_pipeline("ingest", tmp_path / "store", settings={"source": source}, terminal=silent)
    assert outcome.summaries["ingest"]["takes"] == 1
    assert (outcome.report, outcome.metrics.height) == (None, 0)
    events = [(one.event, one.stage) for one in caplog.records if one.name == "kinedex.engine"]  # type: ignore[attr-defined]
    assert any(one.name == "kinedex.stages" and "1 to read" in one.getMessage() for one in caplog.records)
    assert events == [("start", "ingest"), ("finish", "ingest"), ("start", "index"), ("finish", "index")]
    with pytest.raises(KinedexError) as caught:
        run_pipeline("ingest", tmp_path / "new", settings={"source": tmp_path}, terminal=silent, force={"indx"})
    assert "--" not in str(caught.value)
    (tmp_path / "empty").mkdir()
    with pytest.raises(StageFailed) as failed:
        run_pipeline("ingest", tmp_path / "new", settings={"source": tmp_path / "empty"}, terminal=silent)
    assert "call again" in str(failed.value)
    assert "--set" not in str(failed.value)
