"""Define the commands for maintenance: duplicates, inspect, verify, repair, upgrade, versions, gc, version."""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from kinedex.commands.app import FAILED, MAINTAIN, command
from kinedex.commands.options import (
    ExecutorOption,
    JsonOption,
    OlderOption,
    Output,
    RateOption,
    StorePath,
    WaitOption,
    WorkersOption,
    open_for_reading,
    wait_of,
)
from kinedex.commands.output import print_json, print_message, show_table
from kinedex.ops.errors import KinedexError, SourceError
from kinedex.ops.wording import counted, visible, visible_lines

if TYPE_CHECKING:
    import pyarrow as pa

    from kinedex.pipelines.inspection.motion_file import Inspection
    from kinedex.storage.store.verification import Finding


@command(MAINTAIN)
def duplicates(store: StorePath, *, output: Output, as_json: JsonOption = False) -> None:
    """List takes that come from the same file or show the same motion.

    Motion is found that was trimmed, moved, turned, mirrored, resampled, made noisy, or put on another body. `changes`
    says what was done, `distance_mm` how far the joints are apart, and `shift_ms` how much later the motion is in the
    other take. The rows are kept in the store as the view `duplicates`.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.engine.run_id import new_run_id
    from kinedex.pipelines.inspection.duplicates import find_duplicates, save_duplicates

    opened = open_for_reading(store, "newest")
    found = find_duplicates(opened, Terminal())
    takes = len(opened.take_ids)
    opened.close()
    save_duplicates(opened, found, new_run_id())
    if as_json:
        print_json({"store": store, "takes": takes, "duplicates": found})
        return
    output.show(_shown(found) if output.is_plain else found)
    if output.is_plain:
        print_message(_duplicates_line(found, takes))


def _shown(found: pa.Table) -> pa.Table:
    """Return the columns of duplicates that a person reads, with the shift in milliseconds."""
    import pyarrow.compute as pc

    shown = found.select(["take", "of_take", "changes", "start_seconds", "stop_seconds", "share", "distance_mm"])
    return shown.append_column("shift_ms", pc.multiply(found.column("shift_seconds"), 1000.0))


def _duplicates_line(found: pa.Table, takes: int) -> str:
    """Return the line below the table, with the number of takes of each kind of duplicate."""
    columns = (found.column(name).to_pylist() for name in ("take", "same", "share", "changes"))
    rows = list(zip(*columns, strict=True))
    files = {take for take, same, *_ in rows if same == "file"}
    whole = {take for take, same, share, _ in rows if same == "motion" and share > 0.9} - files
    parts = {take for take, *_ in rows} - files - whole
    changes = Counter(one for _, same, _, text in rows if same == "motion" for one in text.split(", "))
    pairs = ", ".join(f"{change} {count:,}" for change, count in changes.most_common())
    line = (
        f"of {counted(takes, 'take')}, {len(files):,} come from a copy of a file, {len(whole):,} hold the motion of "
        f"another take, {len(parts):,} have a part in common with one"
    )
    return f"{line}; pairs by change: {pairs}" if pairs else line


@command(MAINTAIN)
def inspect(
    file: Annotated[Path, typer.Argument(help="Motion file, or file of inertial sensors.")],
    skeleton: Annotated[
        str, typer.Option(help="Skeleton mapping: auto, the name of a shipped one, or a .yaml file.")
    ] = "auto",
    source: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Source root; the ASF of an AMC file is looked for up to it.")
    ] = None,
    person: Annotated[str, typer.Option(help="Person of a file of several; the first unless given.")] = "",
    rate: RateOption = None,
    fill_gap_frames: Annotated[
        int | None, typer.Option(min=0, help="Longest gap of a point that is filled; 0.1 s unless given.")
    ] = None,
    body_model: Annotated[
        str | None, typer.Option(help="Body model of an AMASS file: model.npz of SMPL-H, or its joints at rest.")
    ] = None,
    features: Annotated[
        bool, typer.Option("--features", help="Also list how often each feature holds, and which lack a joint.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Picture (PNG) of a few frames to write; none unless given.")
    ] = None,
    camera: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Camera of a depth image: show foreground, graph and extrema.")
    ] = None,
    background: Annotated[
        Path | None, typer.Option(metavar="FILE", help="With --camera: the depth image of the empty room.")
    ] = None,
    sensors: Annotated[
        str | None, typer.Option(metavar="FILE", help="File of sensors: limbs, units and columns of sensor files.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show what a motion file, sensor file or depth image holds.

    A depth image needs --camera; the picture then shows its foreground, graph and extrema. Files of inertial sensors
    are recognised, with their units compared with gravity and with their orientations; --sensors describes them.
    """
    if camera is not None:
        _inspect_depth(file, camera, background, picture, as_json)
        return
    if sensors is not None or _is_sensor_file(file):
        _inspect_sensors(file, sensors, rate, as_json)
        return
    if file.suffix.lower() in (".png", ".pcd", ".ply"):
        raise KinedexError(f"{file}: a depth image or cloud is shown with its camera: --camera FILE")
    from kinedex.pipelines.inspection.motion_file import inspect_file
    from kinedex.reports.stick_figures import write_picture
    from kinedex.storage.formats.motion.reader import ReadSettings

    found = inspect_file(file, skeleton, source, ReadSettings(None, rate, fill_gap_frames, body_model), person)
    drawn = picture if picture is not None and write_picture(found, picture) else None
    if picture is not None:
        found.add("picture", str(drawn or "none, because no places of joints are known"))
    if not as_json:
        _show_facts(found, features)
    elif found.fault is None:
        _print_facts(file, found, features=found.features, picture=drawn)
    if found.fault is not None and file.suffix.lower() in (".csv", ".tsv"):
        raise KinedexError(f"{found.fault}\n  if it holds readings of inertial sensors: {_NAME_COLUMNS}")
    if found.fault is not None:
        raise found.fault


def _show_facts(found: Inspection, features: bool = False) -> None:
    """Print the facts about a file, and on request the table of features."""
    from kinedex.console.tables import PrintedTable, pairs
    from kinedex.console.terminal import make_console

    console = make_console()
    console.print(pairs(found.lines))
    if features and found.features is not None:
        console.print(PrintedTable(found.features))


def _print_facts(file: Path, found: Inspection, **more: object) -> None:
    """Print the facts about a file as a JSON object."""
    facts = [{"name": name, "value": text} for name, text in found.lines]
    print_json({"file": file, "facts": facts, "features": None, "picture": None, "sensors": None, **more})


_SENSOR_ENDINGS = (".txt", ".parquet", ".h5", ".hdf5")
"""File endings of sensor files that motion files do not have."""

_NAME_COLUMNS = (
    "columns such as time_s, acc_x, gyr_x and q_w are recognised, and `columns:` of a file of sensors names any "
    "others: --sensors FILE"
)


def _is_sensor_file(file: Path) -> bool:
    """Return whether a file holds sensor readings; raise an error if it holds neither readings nor motion."""
    ending = file.suffix.lower()
    if not file.is_file() or ending not in (*_SENSOR_ENDINGS, ".csv", ".tsv"):
        return False
    from kinedex.storage.formats.imu.recording import FORMATS, beginning, is_sensor_file

    known = is_sensor_file(file)
    if not known and ending in _SENSOR_ENDINGS:
        beginning(file)
        forms = ", ".join(form.title for form in FORMATS.values())
        raise SourceError(
            file, f"holds no readings of inertial sensors in a form that is known ({forms}); {_NAME_COLUMNS}"
        )
    return known


def _inspect_sensors(file: Path, sensors: str | None, rate_hz: float | None, as_json: bool) -> None:
    """Show the content of a file of inertial sensors."""
    from kinedex.catalog.sensorsets import SensorSet, load_sensor_set
    from kinedex.pipelines.inspection.sensor_file import inspect_sensor_file

    chosen = SensorSet() if sensors is None else load_sensor_set(sensors)
    found, inspected = inspect_sensor_file(file, chosen, rate_hz)
    if as_json:
        _print_facts(file, found, sensors=[one.document() for one in inspected])
    else:
        _show_facts(found)


def _inspect_depth(file: Path, camera: Path, background: Path | None, picture: Path | None, as_json: bool) -> None:
    """Show what was found in a depth image."""
    from kinedex.pipelines.inspection.depth_frame import frame_facts, inspect_depth_frame
    from kinedex.reports.depth_picture import write_frame_picture

    found = inspect_depth_frame(file, camera, background)
    facts = frame_facts(found)
    if picture is not None:
        write_frame_picture(found, picture)
        facts.add("picture", str(picture))
    if as_json:
        _print_facts(file, facts, picture=picture)
    else:
        _show_facts(facts)


def finding_document(one: Finding) -> dict[str, object]:
    """Return a finding of the command `verify` as a JSON object."""
    return {"file": one.file, "problem": one.problem, "remedy": asdict(one.remedy), "fault": one.fault}


@command(MAINTAIN)
def verify(store: StorePath, as_json: JsonOption = False) -> None:
    """Check the files of a store against its manifest, and the index."""
    from kinedex.console.terminal import Terminal
    from kinedex.storage.remedies import repair
    from kinedex.storage.store.store import open_store
    from kinedex.storage.store.verification import verify as check

    opened = open_store(store, at="newest")
    with Terminal().progress("checking parts", len(opened.manifest.parts)) as bar:
        findings = check(opened, bar.advance)
    parts, takes = len(opened.manifest.parts), len(opened.manifest.live_takes)
    faults = sum(finding.fault for finding in findings)
    if as_json:
        rows = [finding_document(one) for one in findings]
        document = {"store": store, "version": opened.manifest.version, "takes": takes, "parts": parts}
        print_json({**document, "faults": faults, "findings": rows})
        if faults:
            raise typer.Exit(FAILED)
        return
    for finding in findings:
        print(visible_lines(f"{'✗' if finding.fault else '·'} {finding}"))
    if faults:
        raise KinedexError(f"{store}: {faults} of {parts} parts or files are damaged", remedy=repair(store))
    print(f"{store}: version {opened.manifest.version}, {counted(takes, 'take')}, {counted(parts, 'part')}: all sound")


@command(MAINTAIN)
def repair(
    store: StorePath,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Report the damage and what would be done, and change nothing.")
    ] = False,
    executor: ExecutorOption = "processes",
    workers: WorkersOption = None,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Repair the damaged files of a store.

    Takes are read again from their sources, the index is rebuilt, and stages run again for missing results. Damaged
    files that cannot be restored are kept in quarantine/ in the store, with a list.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.ingestion.store_repair import repair_store

    done = repair_store(store, Terminal(), dry_run=dry_run, executor=executor, workers=workers, wait=wait_of(wait))
    if as_json:
        print_json(
            {
                "store": store,
                "dry_run": dry_run,
                "found": [finding_document(one) for one in done.found],
                "done": done.lines,
                "lost_takes": [asdict(one) for one in done.lost],
                "quarantine": [asdict(one) for one in done.kept],
                "to_run": [run.command(store) for run in done.failed_runs],
                "faults": len(done.remaining),
            }
        )
        if done.remaining or done.failed_runs:
            raise typer.Exit(FAILED)
        return
    for finding in done.found if dry_run else done.remaining:
        print(visible_lines(f"{'✗' if finding.fault else '·'} {finding.file}: {finding.problem}"))
    for run in done.failed_runs:
        print(visible_lines(f"to make the results of {', '.join(run.stages)} again: {shlex.join(run.command(store))}"))
    if done.remaining:
        raise KinedexError(f"{store}: {counted(len(done.remaining), 'file')} could not be repaired")
    if done.failed_runs:
        count = sum(len(run.stages) for run in done.failed_runs)
        raise KinedexError(f"{store}: repaired, but the results of {counted(count, 'stage')} are missing")
    if not dry_run:
        lost = f", but {counted(len(done.lost), 'take')} could not be read again" if done.lost else ""
        print(f"{store}: {f'repaired{lost}' if done.found else 'nothing is damaged'}")


@command(MAINTAIN)
def upgrade(
    store: StorePath,
    keep_damaged: Annotated[
        bool, typer.Option("--keep-damaged", help="Convert it with its damaged parts, for `kinedex repair` to repair.")
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Report what would be done; check no checksum, and change nothing.")
    ] = False,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Convert a store of an older format.

    Takes and results are unchanged, and the old version is kept until `kinedex gc` removes it. An interrupted upgrade
    continues where it stopped when it is run again.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.storage.snapshot.manifest_files import read_newest
    from kinedex.storage.store import upgrade as upgrading

    parts = len(read_newest(store).parts)
    with Terminal().progress("checking parts", parts) as bar:
        done = upgrading.upgrade(
            store, keep_damaged=keep_damaged, dry_run=dry_run, wait=wait_of(wait), progress=lambda _: bar.advance()
        )
    if as_json:
        print_json({"store": store, "dry_run": dry_run, **asdict(done)})
        return
    for line in upgrading.summary(store, done, dry_run=dry_run):
        print(line)


@command(MAINTAIN)
def versions(store: StorePath, as_json: JsonOption = False) -> None:
    """List the versions of a store and what each changed."""
    from kinedex.storage.store.version_changes import list_versions, versions_table

    found = list_versions(store)
    if as_json:
        print_json({"store": store, "versions": [asdict(version) for version in found]})
        return
    show_table(versions_table(found))


@command(MAINTAIN)
def gc(
    store: StorePath,
    keep: Annotated[int, typer.Option(min=1, help="Number of the newest versions that stay.")] = 2,
    older_than: OlderOption = None,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="List what would be removed, and remove nothing.")] = False,
    wait: WaitOption = None,
    as_json: JsonOption = False,
) -> None:
    """Remove old versions of a store.

    A version is removed if it is not among the newest, is older than --older-than, and no process has it open.
    """
    from kinedex.storage.store.garbage_collection import collect_garbage, summary

    found = collect_garbage(store, keep=keep, older_than_seconds=older_than or 0.0, dry_run=dry_run, wait=wait_of(wait))
    if as_json:
        rows = [{"path": one.path, "bytes": one.bytes, "kind": one.kind} for one in found.removed]
        opened = [{"version": one.version, "processes": one.processes} for one in found.open_versions]
        print_json({"store": store, "dry_run": dry_run, "removed": rows, "open_versions": opened})
        return
    for line in summary(found.removed):
        print(visible(f"would remove {line}" if dry_run else f"removed {line}"))
    for one in found.open_versions:
        print(visible(f"kept: {one}"))


@command(MAINTAIN)
def version(as_json: JsonOption = False) -> None:
    """Print the versions of kinedex and its libraries, and its path."""
    from importlib.metadata import version as version_of

    versions = {name: version_of(name) for name in ("kinedex", "numpy", "numba", "pyarrow", "duckdb", "polars")}
    path, installed = Path(__file__).parents[1].resolve(), _installed_package()
    if as_json:
        print_json({"versions": versions, "path": path, "installed_path": installed})
        return
    for name, number in versions.items():
        print(f"{name:10} {number}")
    print(f"{'path':10} {path}")
    if path != installed:
        place = f"the installed one is {installed}" if installed else "none is installed"
        print(
            f"kinedex: this is the package of a checkout; {place}. The command `kinedex` takes the installed one, "
            "`python -m kinedex` that of the folder it starts in.",
            file=sys.stderr,
        )


def _installed_package() -> Path | None:
    """Return the folder of the installed package, or of its checkout for an editable install; None if not installed."""
    import json
    from importlib.metadata import PackageNotFoundError, distribution
    from urllib.parse import urlparse
    from urllib.request import url2pathname

    try:
        found = distribution("kinedex")
    except PackageNotFoundError:
        return None
    try:
        source = json.loads(found.read_text("direct_url.json") or "{}")
    except json.JSONDecodeError:
        source = {}
    if source.get("dir_info", {}).get("editable"):
        return Path(url2pathname(urlparse(source["url"]).path)).resolve() / "kinedex"
    return Path(str(found.locate_file("kinedex"))).resolve()
