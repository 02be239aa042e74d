"""The command line: output, exit codes, messages of errors, JSON, logs."""

from __future__ import annotations

import ast
import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import duckdb
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from docs.generators.json_documents import DOCUMENTS
from kinedex.catalog.features import load_feature_set
from kinedex.commands.cli import app
from kinedex.storage.lock import Lock
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.pipelines.archives import write_archive

OF_OTHER_TESTS = (
    "init", "synth", "sql", "report compare", "template ", "query ", "keyframes ", "mapping new", "mapping nodes",
    "mapping add", "mapping remove", "explain",
)  # fmt: skip
COMMANDS = ["demo", "run", "plan", "ingest", "inspect", "search", "sql", "takes", "verify", "synth", "version"]


@dataclass(frozen=True)
class Ended:
    """The exit status and the output of a command."""

    returncode: int
    stdout: str
    stderr: str


def kinedex(*words: str | Path, stdin: str | None = None) -> Ended:
    """Run a command in this process; anything but an exit or a message of its own is raised."""
    done = CliRunner().invoke(app, [*map(str, words)], input=stdin, prog_name="kinedex", catch_exceptions=False)
    return Ended(done.exit_code, done.stdout, done.stderr)


def process(*words: str | Path) -> Ended:
    """Run a command as people do, in a process of its own."""
    command = [sys.executable, "-m", "kinedex", *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=240)
    return Ended(done.returncode, done.stdout, done.stderr)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    takes = {"clips/wave/x_aa_wave_001_120.amc": 60, "clips/bow/x_bb_bow_001_120.amc": 80, "takes/x_aa_take01.amc": 200}
    return write_archive(tmp_path_factory.mktemp("archive") / "it's here", takes)


@pytest.fixture(scope="module")
def store(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("cli") / "store"
    done = kinedex("ingest", path, source, "--executor", "serial")
    assert done.returncode == 0, done.stderr
    assert "3 to read, 0 unchanged" in done.stdout
    return path


def test_a_process_exits_with_the_code_and_prints_errors_to_standard_error(store: Path) -> None:
    done = process("takes", store, "--columns", "name", "--format", "csv")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == kinedex("takes", store, "--columns", "name", "--format", "csv").stdout
    done = process("takes", store, "--columns", "nam")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == "kinedex: --columns: takes have no column 'nam'; did you mean 'name'?\n"
    assert process("takes", store, "--colums", "name").returncode == 2


@pytest.mark.parametrize("command", COMMANDS)
def test_help_shows_usage_and_options(command: str) -> None:
    done = kinedex(command, "--help")
    assert done.returncode == 0
    assert "Usage:" in done.stdout
    assert "--help" in done.stdout


def test_a_second_ingest_does_nothing(store: Path, source: Path) -> None:
    done = kinedex("ingest", store, source, "--executor", "serial")
    assert done.returncode == 0
    assert "everything was done already" in done.stdout


def test_takes_are_listed_filtered_and_written(store: Path, tmp_path: Path) -> None:
    done = kinedex("takes", store, "--where", "actor = 'aa'", "--format", "json", "--columns", "name,class,frames")
    assert json.loads(done.stdout) == [
        {"name": "x_aa_take01", "class": None, "frames": 50},
        {"name": "x_aa_wave_001_120", "class": "wave", "frames": 15},
    ]
    assert kinedex("takes", store, "-o", tmp_path / "takes.parquet").returncode == 0
    assert pq.read_table(tmp_path / "takes.parquet").num_rows == 3
    assert "3 takes" in kinedex("takes", store).stdout


def test_a_filter_that_fits_no_take_shows_the_values_of_its_columns(store: Path) -> None:
    shown = kinedex("takes", store, "--where", "class = 'wvae' AND actor IS NOT NULL AND frames > 1").stdout
    assert "0 takes" in shown
    assert re.search(r"no take of 3 takes fits; class has 'bow', 'wave'; actor has 'aa', 'bb'", shown), shown


def test_sql_prints_the_file_for_other_clients(store: Path) -> None:
    done = kinedex("sql", store, "--path")
    assert Path(done.stdout.strip()).is_absolute()
    with duckdb.connect(done.stdout.strip(), read_only=True) as client:
        assert client.execute("SELECT count(*) FROM takes").fetchall() == [(3,)]
    done = kinedex("sql", store, "SELECT 1", "--path")
    assert done.returncode == 1
    assert "runs no SQL" in done.stderr


def test_sql_answers_from_an_argument_a_file_and_standard_input(store: Path, tmp_path: Path) -> None:
    query = "SELECT count(*) AS takes FROM takes"
    (tmp_path / "q.sql").write_text(query)
    expected = "takes\n3\n"
    assert kinedex("sql", store, query, "--format", "csv").stdout == expected
    assert kinedex("sql", store, "-f", tmp_path / "q.sql", "--format", "csv").stdout == expected
    assert kinedex("sql", store, "--format", "csv", stdin=query).stdout == expected


def test_a_statement_may_begin_with_a_comment(store: Path) -> None:
    for comment in ("-- why", "--why", "--", "-- a = b"):
        for words in (["--format", "csv"], []):
            done = kinedex("sql", store, f"{comment}\nSELECT 2 AS two", *words)
            assert done.returncode == 0, done.stderr
            assert "two" in done.stdout
    assert kinedex("sql", store, "SELECT 1", "--formt", "csv").returncode == 2


def test_output_is_written_by_its_ending_and_refused_by_an_unknown_one(store: Path, tmp_path: Path) -> None:
    for name, begins in (("x.csv", b"a\n"), ("x.JSON", b"["), ("x.parquet", b"PAR1"), ("x", b"a\n")):
        assert kinedex("sql", store, "SELECT 1 AS a", "-o", tmp_path / name).returncode == 0
        assert (tmp_path / name).read_bytes().startswith(begins)
    refused = kinedex("sql", store, "SELECT 1 AS a", "-o", tmp_path / "x.xlsx")
    assert refused.returncode == 1
    assert "no format has the ending '.xlsx'; expected .csv, .json or .parquet" in refused.stderr
    assert not (tmp_path / "x.xlsx").exists()
    assert kinedex("sql", store, "SELECT 1 AS a", "-o", tmp_path / "x.txt", "--format", "csv").returncode == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["takes", "STORE", "--columns", "nam"], "did you mean 'name'?"),
        (["takes", "STORE", "--where", "acter = 'aa'"], "actor"),
        (["takes", "/no/such/store"], "does not exist"),
        (["sql", "STORE", "DROP TABLE takes"], "only"),
        (["sql", "STORE", "SELECT * FROM taks"], "takes"),
        (["sql", "STORE", "SELECT 1", "--format", "tsv"], "no output format 'tsv'"),
        (["sql", "STORE", "SELECT 1", "-f", "x.sql"], "not both"),
        (["run", "anotate", "--store", "STORE"], "did you mean 'annotate'?"),
        (["run", "annotate", "--store", "STORE"], "--set source="),
        (["run", "annotate", "--store", "STORE", "--set", "tau"], "expected NAME=VALUE"),
        (["run", "annotate", "--store", "STORE", "--set", "annotate.taw=1"], "did you mean 'tau'?"),
        (["search", "STORE", "exampel"], "did you mean 'example'?"),
        (["search", "STORE", "example", "-q", "sqat"], "did you mean 'squat'?"),
        (["ingest", "STORE", "/no/such/folder"], "is not a folder"),
    ],
)
def test_an_error_is_one_message_with_a_way_out(store: Path, words: list[str], message: str) -> None:
    done = kinedex(*(str(store) if word == "STORE" else word for word in words))
    assert done.returncode == 1
    assert done.stderr.startswith("kinedex: ")
    assert message in done.stderr
    assert "Traceback" not in done.stderr


def test_takes_without_ground_truth_are_annotated_and_reported(source: Path, tmp_path: Path) -> None:
    words = ("run", "annotate", "--store", tmp_path / "store", "--set", f"source={source}", "--executor", "serial")
    done = kinedex(*words)
    assert done.returncode == 0, done.stderr
    assert "no ground truth, nothing to evaluate" in done.stdout
    assert (tmp_path / "store/results/reports/annotate/report.html").is_file()
    given = kinedex(*words, "--set", "evaluate.ground_truth=**/ground_truth.csv")
    assert given.returncode == 1
    assert "no file '**/ground_truth.csv' below" in given.stderr


def test_a_failed_stage_prints_the_command_that_continues(store: Path, source: Path) -> None:
    settings = [f"source={source}", "train=actor = 'nobody'", "evaluate.ground_truth=none"]
    words = [word for setting in settings for word in ("--set", setting)]
    done = kinedex("run", "annotate", "--store", store, *words, "--executor", "serial")
    assert done.returncode == 1
    assert "stage learn_templates:" in done.stderr
    assert "continue with:\n    kinedex run annotate --store" in done.stderr


def test_excluded_files_show_in_the_exit_code_every_time(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_1.amc": 20})
    (source / "x_2.amc").write_text("1\nroot 0 0 zero 0 0 0\n")
    for _ in range(2):
        done = kinedex("ingest", tmp_path / "store", source, "--executor", "serial")
        assert done.returncode == 3
        assert "1 source file excluded" in done.stdout
    log = kinedex("sql", tmp_path / "store", "SELECT source, line FROM ingest_log", "--format", "csv")
    assert log.stdout == "source,line\nx_2.amc,2\n"


def test_an_ingest_can_be_strict_and_drop_missing_files(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_1.amc": 9, "x_2.amc": 9, "x_3.amc": 9})
    whole = (source / "x_2.amc").read_text()
    (source / "x_2.amc").write_text(whole[:-40])
    words = ("ingest", tmp_path / "store", source, "--executor", "serial")
    failed = kinedex(*words, "--strict", "--prune")
    assert failed.returncode == 1
    assert "x_2.amc:" in failed.stderr
    assert "strict: stopped at this file" in failed.stderr
    assert "--set ingest.prune=true --set ingest.strict=true" in failed.stderr
    logged = kinedex("sql", tmp_path / "store", "SELECT source, line FROM ingest_log", "--format", "csv")
    assert re.fullmatch(r"source,line\nx_2\.amc,27\d\n", logged.stdout)
    (source / "x_2.amc").write_text(whole)
    (source / "x_1.amc").unlink()
    assert kinedex(*words, "--strict").returncode == 0
    assert "1 take whose file is gone: dropped" in kinedex(*words, "--prune").stdout
    assert kinedex("takes", tmp_path / "store", "--columns", "name", "--format", "csv").stdout == "name\nx_2\nx_3\n"


def test_search_prints_hits_and_explains(store: Path) -> None:
    hits = kinedex("search", store, "example", "--format", "csv")
    assert hits.returncode == 0, hits.stderr
    assert hits.stdout.startswith("query,take,") or "query" in hits.stdout.splitlines()[0]
    explained = kinedex("search", store, "example", "--explain").stdout
    assert "surviving" in explained
    assert "lknee_bent" in explained
    assert "*****" not in explained
    assert ",pattern," in kinedex("search", store, "example", "--explain", "--format", "csv").stdout


def test_a_search_shows_as_many_intervals_as_asked_for_and_counts_all(store: Path, tmp_path: Path) -> None:
    (tmp_path / "upright.yaml").write_text("upright:\n  keyframes:\n    - {off: [spine_horizontal]}\n")
    every, first = (kinedex("search", store, tmp_path / "upright.yaml", *more) for more in ((), ("--top", "1")))
    count = len(every.stdout.splitlines())
    assert "3 intervals in 3 takes\n" in every.stdout
    assert "3 intervals in 3 takes; the first 1 are shown, --limit 0 shows all" in first.stdout
    assert len(first.stdout.splitlines()) == count - 2
    table = kinedex("search", store, tmp_path / "upright.yaml", "--top", "2", "--format", "csv")
    assert (len(table.stdout.splitlines()), "3 intervals; the first 2 are shown" in table.stderr) == (3, True)


def test_verify_finds_a_damaged_part(store: Path, tmp_path: Path) -> None:
    assert kinedex("verify", store).returncode == 0
    copy = Path(shutil.copytree(store, tmp_path / "copy"))
    part = next((copy / "frames").glob("part-*.parquet"))
    data = bytearray(part.read_bytes())
    data[len(data) // 2] ^= 1
    part.write_bytes(data)
    done = kinedex("verify", copy)
    assert done.returncode == 1
    assert part.name in done.stdout


def document(*words: str | Path, code: int = 0) -> dict[str, Any]:
    """Run a command with --json and return the object on standard output, which holds nothing else."""
    done = kinedex(*words, "--json")
    assert done.returncode == code, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def test_json_documents_have_the_keys_of_the_reference(store: Path, source: Path, tmp_path: Path) -> None:
    settings = ["--set", f"source={source}", "--set", "evaluate.ground_truth=none"]
    copy = Path(shutil.copytree(store, tmp_path / "copy"))
    run = document("history", "list", store)["runs"][-1]["run"]
    found = {
        "run": document("run", "ingest", "--store", store, *settings[:2], "--executor", "serial"),
        "ingest": document("ingest", store, source, "--executor", "serial"),
        "plan": document("plan", "annotate", "--store", store, *settings),
        "takes list": document("takes", store),
        "export": document("export", store, "-o", tmp_path / "clips"),
        "simulate cameras": document("simulate", "cameras", store, "x_aa_take01", "-o", tmp_path / "film", "--seed=1"),
        "simulate depth": document("simulate", "depth", store, "x_aa_take01", "-o", tmp_path / "deep", "--seed=1"),
        "search": document("search", store, "example"),
        "search --explain": document("search", store, "example", "--explain"),
        "rank": document("rank", store, "--take", "x_aa_wave_001_120", "--tau", "1"),
        "inspect": document("inspect", source / "takes/x_aa_take01.amc", "--picture", tmp_path / "x.png"),
        "mapping list": document("mapping", "list", store),
        "verify": document("verify", store),
        "repair": document("repair", store, "--dry-run"),
        "upgrade": document("upgrade", store),
        "versions": document("versions", store),
        "history list": document("history", "list", store),
        "history show": document("history", "show", store, run),
        "history export": document("history", "export", store, run, "-o", tmp_path / "again.yaml"),
        "duplicates": document("duplicates", copy),
        "takes remove": document("takes", "remove", copy, "x_aa_take01"),
        "takes readmit": document("takes", "readmit", copy),
        "takes accept": document("takes", "accept", copy, "--where", "true"),
        "merge": document("merge", copy, store, "--prefix", "b_"),
        "use": document("use", store),
        "gc": document("gc", store, "--dry-run"),
        "version": document("version"),
    }
    # tests/pipelines/labels/test_decisions.py has annotations to decide on, tests/library/test_explanations.py labels
    # to explain, and the demo prints what a run does; the others are in test_json_everywhere.py
    elsewhere = ("labels ", "demo", *OF_OTHER_TESTS)
    assert {command: list(keys) for command, keys in DOCUMENTS.items() if not command.startswith(elsewhere)} == {
        command: list(keys) for command, keys in found.items()
    }
    assert found["ingest"]["ran"] == []
    assert len(found["takes list"]["takes"]) == 3
    assert found["plan"]["stages"][0]["stage"] == "ingest"
    assert found["rank"]["hits"][0]["take"] == "x_aa_wave_001_120"
    assert (found["verify"]["faults"], found["verify"]["findings"]) == (0, [])
    assert found["inspect"]["facts"][0]["name"] == "file"
    assert Path(found["version"]["path"]).is_dir()


def test_errors_are_json_objects_with_the_exit_code(store: Path, tmp_path: Path) -> None:
    for words, code, kind in (
        (("takes", tmp_path), 1, "StoreError"),
        (("takes", store, "--columns", "nam"), 1, "KinedexError"),
        (("takes",), 2, "UsageError"),
        (("taks", store), 2, "UsageError"),
        (("takes", store, "--colums", "name"), 2, "UsageError"),
        (("inspect", tmp_path / "none.amc"), 1, "KinedexError"),
    ):
        error = document(*words, code=code)["error"]
        assert (error["type"], error["exit_code"], error["remedy"]) == (kind, code, None)
    assert "did you mean" in error["message"] or "no such file" in error["message"]


def test_a_run_with_json_exits_with_the_code_of_excluded_files(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_1.amc": 20})
    (source / "x_2.amc").write_text("1\nroot 0 0 zero 0 0 0\n")
    found = document("ingest", tmp_path / "store", source, "--executor", "serial", code=3)
    assert (found["excluded_files"], found["ran"]) == (1, ["ingest", "index"])


def test_quiet_prints_results_alone_and_a_log_file_holds_json_lines(store: Path, source: Path, tmp_path: Path) -> None:
    log = tmp_path / "log.jsonl"
    words = ("run", "ingest", "--store", store, "--set", f"source={source}", "--executor", "serial", "--log-file", log)
    assert "[1/2] ingest" in kinedex(*words).stdout
    assert kinedex(*words, "--quiet").stdout == "everything was done already: 2 stages, nothing to do\n"
    lines = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert {"time", "level", "logger", "message"} <= set(lines[0])
    assert any("ingest" in line["message"] for line in lines)
    assert all(line["logger"].startswith("kinedex") for line in lines)
    shown = kinedex("takes", store, "--quiet").stdout
    assert "x_aa_take01" in shown
    assert "3 takes" not in shown
    assert "ingest" in kinedex(*words, "--verbose").stderr
    refused = kinedex("takes", store, "--log-file", tmp_path)
    assert refused.returncode == 1
    assert "--log-file" in refused.stderr


def test_the_help_is_short_and_begins_with_what_most_people_need(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    lines = kinedex("--help").stdout.splitlines()
    assert len(lines) <= 50, "a tall terminal"
    assert max(map(len, lines)) <= 80
    assert not [line for line in lines[3:] if line.endswith("...")], "a summary is cut"
    first = {line.split()[0] for line in lines[:24] if line.startswith("  ")}  # a small terminal
    assert first >= {"init", "demo", "run", "ingest", "sql", "export", "takes", "search", "rank"}
    headings = [at for at, line in enumerate(lines) if line.endswith(":") and not line.startswith(" ")]
    sizes = [end - start - 1 for start, end in pairwise(headings)]
    assert max(sizes) <= 12, "a section is too long to be read"


def test_the_program_prints_its_version_and_the_path_of_its_package() -> None:
    assert re.fullmatch(r"kinedex \d+\.\d+\.\d+\S*\n", kinedex("--version").stdout)
    assert re.search(r"^path +/.*kinedex$", kinedex("version").stdout, re.MULTILINE)


def test_a_checkout_beside_the_installed_package_is_reported(tmp_path: Path) -> None:
    root = Path(__file__).resolve().parents[2]
    rooms = shutil.ignore_patterns("__pycache__")
    shutil.copytree(root / "kinedex", tmp_path / "kinedex", ignore=rooms)
    done = subprocess.run(
        [sys.executable, "-m", "kinedex", "version"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        timeout=240,
    )
    assert f"path       {tmp_path.resolve() / 'kinedex'}" in done.stdout
    assert "this is the package of a checkout; the installed one is" in done.stderr


def test_shells_get_a_completion_script_and_names_of_commands() -> None:
    shells = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1", "_KINEDEX_COMPLETE": ""}
    script = subprocess.run(
        [sys.executable, "-m", "kinedex", "--show-completion", "bash"],
        env=os.environ | shells, capture_output=True, text=True, check=False, timeout=240,
    )  # fmt: skip
    assert "complete -o default -F _kinedex_completion kinedex" in script.stdout
    asked = {"_KINEDEX_COMPLETE": "complete_bash", "COMP_WORDS": "kinedex ver", "COMP_CWORD": "1"}
    done = subprocess.run(
        [sys.executable, "-m", "kinedex"],
        env=os.environ | asked,
        capture_output=True,
        text=True,
        check=False,
        timeout=240,
    )
    assert done.stdout.split() == ["verify", "versions", "version"]


@pytest.mark.parametrize("words", [["--help"], ["takes", "--help"], ["--version"]])
def test_help_imports_no_library_that_computes(words: list[str]) -> None:
    code = (
        "import sys\nfrom kinedex.commands.cli import app\n"
        f"try:\n    app({words!r}, prog_name='kinedex')\nexcept SystemExit:\n    pass\n"
        "heavy = {'numba', 'numpy', 'dask', 'polars', 'pyarrow', 'duckdb', 'rich', 'yaml', 'jinja2'}\n"
        "print(sorted(heavy & set(sys.modules)), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=240)
    assert done.stderr.strip() == "[]"


def test_commands_import_nothing_that_only_posix_has() -> None:
    posix = {"readline", "termios", "fcntl", "resource", "pwd", "grp", "tty", "pty"}
    root = Path(__file__).resolve().parents[2] / "kinedex"
    for path in [*root.glob("commands/*.py"), *root.glob("console/*.py")]:
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not posix & {*names, getattr(node, "module", None)}, path


def test_commands_show_the_newest_version_with_its_index_and_report_a_newer_one(store: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(store, tmp_path / "store")
    indexed = document("versions", copy)["versions"][-1]["version"]
    with StoreWriter.open(copy, load_feature_set()) as writer:
        writer.drop_takes([writer.manifest.live_takes[0]])
        newest = writer.commit().version
    before = document("takes", copy)["takes"]
    done = kinedex("takes", copy, "--format", "csv")
    assert (
        f"version {indexed} of {copy} is shown, the newest with its index; version {newest} is the newest"
        in done.stderr
    )
    assert kinedex("takes", copy, "--format", "csv", "--quiet").stderr == ""
    after = document("takes", copy, "--at", "newest")["takes"]
    assert len(after) == len(before) - 1
    assert document("takes", copy, "--at", str(indexed))["takes"] == before
    assert kinedex("sql", copy, "SELECT count(*) AS n FROM takes", "--format", "csv").stdout.split() == [
        "n", str(len(before))
    ]  # fmt: skip
    for words in (["--at", "first"], ["--at", "99999"]):
        wrong = kinedex("takes", copy, *words)
        assert wrong.returncode == 1
        assert "newest" in wrong.stderr or "it has no version 99999" in wrong.stderr
    refused = kinedex("search", copy, "example", "--save", "x", "--at", str(indexed))
    assert "give no --at" in refused.stderr


def test_gc_keeps_young_versions_and_waits_no_longer_than_it_is_asked_to(store: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(store, tmp_path / "store")
    assert document("gc", copy, "--keep", "1", "--older-than", "1d", "--dry-run")["removed"] == []
    assert kinedex("gc", copy, "--older-than", "a day").returncode == 2
    with Lock(copy / "lock", "this"):
        late = kinedex("gc", copy, "--wait", "1s")
    assert late.returncode == 1
    assert "`--wait 10m` waits for it" in late.stderr
    with open_store(copy) as opened:
        version = opened.manifest.version
        with StoreWriter.open(copy, load_feature_set()) as writer:
            for run in ("one", "two", "three"):
                writer.put_results("hits", result_schema("hits").empty_table(), stage="p/search", run=run)
                writer.forget_stage(next(iter(writer.manifest.stages), ""))
                writer.commit()
        assert f"kept: version {version} is open in " in kinedex("gc", copy, "--keep", "1").stdout
