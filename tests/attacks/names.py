"""Names that no terminal may obey: every command over an archive whose files, classes and labels have hostile names."""

from __future__ import annotations

import csv
import errno
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq

from kinedex.storage.formats.labels.formats import FORMATS, read_labels
from kinedex.storage.store.store import open_store
from tests.attacks.outcome import Options, Outcome
from tests.storage.made_up import make_store

HOSTILE = (
    "esc\x1b[7;31H", "osc\x1b]2;title\x07", "csi\x9b5m", "line\nFAKE kinedex", "return\rFAKE", "tab\tx", "=1+1",
    "rtl\u202egnp.exe", "lri\u2066x\u2069", "zero\u200bwidth", "bom\ufeffx", "ls\u2028FAKE", "@SUM(A1)", "-x", "+x",
    "[red]markup", "a:b*?", "con", "del\x7fx", "tag\U000e0041x", "'=x", "dot.", 'q"uo,te', "<script>alert(1)",
    "b\x08\x08",
)  # fmt: skip
"""Names as files can have them; patterns of the pipelines divide names at underscores, and these have none."""

NOT_UTF8 = b"take\xff\xfe_al_take09.amc"

SAMPLED = ("takes", "takes as csv", "sql", "no such take", "filter", "verify")
"""The commands of a sample, which is asked about takes alone."""

_STYLES = re.compile(r"\x1b\[[0-9;]*m|\x1b\[\?25[lh]|\x1b\[[0-9]*[AK]")
_ODD = re.compile(
    "[\x00-\x08\x0b-\x0c\x0e-\x1f\x7f-\x9f\u00ad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff"
    "\ufff9-\ufffb\U000e0000-\U000e0fff\ud800-\udfff\ufffd]"
)
_LAST = 60
"""Seconds that a command may be silent on the terminal before it counts as hanging."""


def on_terminal(arguments: list[str | bytes], folder: Path) -> tuple[int, str]:
    """Run a command on a pseudo-terminal of 2,000 columns, and return its exit code and all that it wrote."""
    import pty
    import select

    terminal, end = pty.openpty()
    environment = {**os.environ, "COLUMNS": "2000", "LINES": "50", "TERM": "xterm-256color"}
    process = subprocess.Popen(
        [sys.executable, "-m", "kinedex", *arguments], stdin=end, stdout=end, stderr=end, cwd=folder, env=environment
    )
    os.close(end)
    written = b""
    try:
        while select.select([terminal], [], [], 10 * _LAST)[0]:
            try:
                some = os.read(terminal, 65536)
            except OSError as fault:
                if fault.errno == errno.EIO:  # the other end is closed
                    break
                raise
            if not some:
                break
            written += some
    finally:
        os.close(terminal)
        try:
            code = process.wait(_LAST)
        except subprocess.TimeoutExpired:
            process.kill()
            code = process.wait(timeout=240)
    return code, written.decode("utf-8", "surrogateescape")


def problems(code: int, shown: str, *, lines: bool = True) -> Iterator[str]:
    """Yield what is wrong with the output of a command; in CSV a text between quotes may have `lines` of its own."""
    if code not in (0, 1, 2, 3):
        yield f"exit code {code}"
    if "Traceback" in shown:
        yield f"a traceback: {shown[-300:]!r}"
    bare = _STYLES.sub("", shown.replace("\r\n", "\n"))
    odd = _ODD.search(bare) or re.search(r"\r(?!\x1b|$)FAKE", bare)
    if odd:
        yield f"writes {odd[0]!r} in {bare[max(0, odd.start() - 60) : odd.end() + 40]!r}"
    fake = re.search(r"^FAKE.*", bare, re.MULTILINE)
    if fake and lines:
        yield f"a name passes for a line: {fake[0]!r}"


def write_archive(folder: Path) -> Path:
    """Make a synthetic archive, give its classes, takes and actors hostile names, and add a name that is not UTF-8."""
    plain, hostile = folder / "plain", folder / "archive"
    subprocess.run(
        [sys.executable, "-m", "kinedex", "synth", str(plain), "--minutes", "1", "--actors", "2"], check=True,
        capture_output=True, timeout=240,
    )  # fmt: skip
    folders = sorted((plain / "clips").iterdir())
    classes = {path.name: HOSTILE[number % len(HOSTILE)] for number, path in enumerate(folders)}
    takes: dict[str, str] = {}
    for number, path in enumerate(sorted(plain.rglob("*.amc"))):
        odd, place, name = HOSTILE[number % len(HOSTILE)], path.parent.relative_to(plain), path.stem
        if place.parts[0] == "clips":
            place, name = Path("clips", classes[place.name]), name.replace(path.parent.name, odd)
        else:
            name = name.replace("SYN", odd)
        takes[path.stem] = name
        (hostile / place).mkdir(parents=True, exist_ok=True)
        shutil.copy(path, hostile / place / f"{name}.amc")
        # a skeleton file is found by the beginning of its name
        skeleton = next(plain.rglob(f"{'_'.join(path.stem.split('_')[:2])}.asf"))
        shutil.copy(skeleton, hostile / place / f"{'_'.join(name.split('_')[:2])}.asf")
        if place.name == "takes":
            beside = os.fsencode(hostile / place)
            shutil.copy(path, os.path.join(beside, NOT_UTF8))
            shutil.copy(skeleton, os.path.join(beside, NOT_UTF8.replace(b"_take09.amc", b".asf")))
    with (plain / "takes" / "ground_truth.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    with (hostile / "takes" / "ground_truth.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, ["take", "class", "start", "stop"], lineterminator="\r\n")
        writer.writeheader()
        for row in rows:
            known = next((name for name in classes if name.startswith(row["class"])), row["class"])
            writer.writerow({**row, "take": takes[row["take"]], "class": classes.get(known, row["class"])})
    return hostile


def commands(archive: Path, store: Path, take: str, label: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the commands with their names, in an order in which each finds what it needs."""
    where, log = str(store), str(store.parent / "log.jsonl")
    yield "run", ["run", "annotate", "--store", where, "--set", f"source={archive}", "-v", "--log-file", log]
    yield "run again", ["run", "annotate", "--store", where, "--set", f"source={archive}", "--log-file", log]
    yield "plan", ["plan", "annotate", "--store", where, "--set", f"source={archive}"]
    yield "ingest", ["ingest", where, str(archive), "-v"]
    yield "takes", ["takes", where, "--columns", "*"]
    for form in ("csv", "json"):
        yield f"takes as {form}", ["takes", where, "--format", form]
        yield f"sql as {form}", ["sql", where, "FROM takes", "--format", form]
    yield "sql", ["sql", where, "SELECT name, class, [name] AS l, {'a': name} AS s, name AS \"x\x1b[2Jy\" FROM takes"]
    yield "annotations", ["sql", where, "SELECT take, class FROM annotations"]
    yield "log of the ingest", ["sql", where, "FROM ingest_log"]
    yield "sql with an error", ["sql", where, f"SELECT nothing, '{take.replace(chr(39), '')}' FROM takes"]
    yield "no such take", ["export", where, f"{take}x"]
    yield "filter", ["takes", where, "--where", f"name = \x1b[2J'{take}"]
    yield "no such option", ["takes", where, "--no\x1b[2Jsuch"]
    yield "search", ["search", where, "example"]
    yield "explain", ["search", where, "example", "--explain"]
    yield "templates", ["template", "list", where]
    yield "template", ["template", "show", where, label]
    yield "rank", ["rank", where, label, "--top", "3"]
    yield "rank everything", ["rank", where, "--top", "2"]
    yield "export", ["export", where, take, "-o", str(store.parent / f"{label}.csv".replace("/", "_"))]
    yield "query from clip", ["query", "from-clip", where, take]
    for form in FORMATS:
        export = ["labels", "export", where, "--format", form, "-o", str(store.parent / f"labels-{form}")]
        yield from ((f"labels as {form}", export), (f"labels again as {form}", export))
    yield "labels in one file", ["labels", "export", where, "-o", str(store.parent / "all.csv")]
    yield "labels read", ["labels", "read", str(store.parent / "all.csv")]
    yield "ground truth", ["labels", "read", str(archive / "takes" / "ground_truth.csv")]
    yield "inspect", ["inspect", str(next(archive.glob("takes/*.amc"), archive))]
    yield "verify", ["verify", where]
    yield "gc", ["gc", where]


def run(folder: Path, options: Options) -> Outcome:
    """Run every command, or the one that the case names, on a terminal."""
    outcome, sample = Outcome(), options.size == "sample"
    archive, store = folder, folder / "store"
    if sample:
        make_store(store, dict.fromkeys(HOSTILE, 9))
        take = label = HOSTILE[0]
    else:
        archive = write_archive(folder)
        take = next(path.stem for path in sorted(archive.glob("takes/*.amc")))
        label = sorted(path.name for path in (archive / "clips").iterdir())[0]
    for name, arguments in commands(archive, store, take, label):
        if (sample and name not in SAMPLED) or (options.case not in (None, name, "files") and name != "run"):
            continue
        code, shown = on_terminal(list(arguments), folder)
        outcome.count("commands")
        outcome.count("characters on the terminal", len(shown))
        for problem in problems(code, shown, lines=not name.endswith("csv")):
            outcome.fail(name, problem)
    outcome.cases = outcome.counts["commands"]
    if options.case in (None, "files") and not sample:
        for problem in files(folder, store, archive):
            outcome.fail("files", problem)
    outcome.counts["hostile names"] = len(HOSTILE) + 1
    return outcome


def files(folder: Path, store: Path, archive: Path) -> Iterator[str]:
    """Yield what is wrong with what was written: files hold true values, in the form of their formats."""
    names = {take["name"] for take in open_store(store).takes_table().to_pylist()}
    expected = {os.fsdecode(path.relative_to(archive).with_suffix("").name) for path in archive.rglob("*.amc")}
    missing = {name for name in expected if name.isprintable() and not any(one.endswith(name) for one in names)}
    if missing:
        yield f"takes are missing: {sorted(missing)[:3]}"
    annotated = set(open_store(store).sql("SELECT DISTINCT take FROM annotated_takes").column(0).to_pylist())
    for form in FORMATS:
        paths = list(folder.glob(f"labels-{form}/*"))
        for path in paths:
            if not path.name.isprintable() or re.search(r'[\\:*?"<>|]', path.name):
                yield f"a file's name: {path.name!r}"
        read = {take for path in paths for take in read_labels(path).takes}
        if form in ("csv", "json") and read != annotated:
            yield f"{form} gives back other takes: {sorted(read ^ annotated)[:4]}"
        if form in ("eaf", "vtt") and not read <= annotated:
            yield f"{form} gives back other takes: {sorted(read - annotated)[:4]}"
    with (folder / "all.csv").open(newline="", encoding="utf-8") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    formulas = [cell for cell in cells if re.match(r"[=+\-@\t\r]", cell) and not re.fullmatch(r"-?[0-9.e-]+", cell)]
    yield from (f"a formula: {cell!r}" for cell in formulas)
    for line in (folder / "log.jsonl").read_text(encoding="utf-8").splitlines():
        json.loads(line)
        yield from (f"the log holds {odd!r}" for odd in _ODD.findall(line))
    for path in (store / "results" / "reports").rglob("*.html"):
        if "<script>alert(1)" in path.read_text(encoding="utf-8"):
            yield f"{path.name} holds a name as markup"
    for path in store.rglob("*.parquet"):
        pq.read_schema(path)
