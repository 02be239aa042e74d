"""Commands that look after files and stores: inspect, verify, gc, version."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.commands.shell import RateOption, StorePath, command
from kinedex.pipelines.console.terminal import make_console


@command
def inspect(
    file: Annotated[Path, typer.Argument(help="a motion file")],
    skeleton: Annotated[str, typer.Option(help="skeleton mapping: auto, a shipped name, or a .yaml file")] = "auto",
    source: Annotated[
        Path | None, typer.Option(metavar="DIR", help="source root: the ASF of an AMC file is looked for up to there")
    ] = None,
    rate: RateOption = None,
    fill_gap_frames: Annotated[
        int | None, typer.Option(min=0, help="longest gap of a point that is closed; a tenth of a second unless given")
    ] = None,
    body_model: Annotated[
        str | None, typer.Option(help="body model of an AMASS file: model.npz of SMPL-H, or its joints at rest")
    ] = None,
    features: Annotated[
        bool,
        typer.Option("--features", help="also how often each feature holds, and which are off for want of a joint"),
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(metavar="PNG", help="picture to write; STEM.png in this folder unless given")
    ] = None,
) -> None:
    """Show what a motion file is and what becomes of it, and draw a few of its frames."""
    from kinedex.pipelines.inspection.inspection import inspect_file, show, write_picture
    from kinedex.storage.formats.motion.bodies import Given

    found = inspect_file(file, skeleton, source, Given(None, rate, fill_gap_frames, body_model))
    path = picture or Path(f"{file.stem}.png")
    if write_picture(found, path):
        found.say("picture", str(path))
    show(found, make_console(), features)
    if found.fault is not None:
        raise found.fault


@command
def verify(store: StorePath) -> None:
    """Check every file of a store against its manifest: sums, sizes, counts, order, and the index."""
    from kinedex.storage.store.store import open_store
    from kinedex.storage.store.verification import verify as check

    opened = open_store(store)
    findings = check(opened)
    for finding in findings:
        print(f"{'✗' if finding.fault else '·'} {finding}")
    parts = len(opened.manifest.parts)
    faults = sum(finding.fault for finding in findings)
    if faults:
        raise KinedexError(f"{store}: {faults} of {parts} parts or files are damaged")
    print(
        f"{store}: version {opened.manifest.version}, {len(opened.manifest.live_takes)} takes, {parts} parts: all sound"
    )


@command
def gc(
    store: StorePath,
    keep: Annotated[int, typer.Option(min=1, help="how many of the newest versions stay readable")] = 2,
    dry_run: Annotated[bool, typer.Option(help="only say what would go")] = False,
) -> None:
    """Remove old versions of a store, and the files that only they need."""
    from kinedex.storage.store.garbage_collection import collect, summary

    for line in summary(collect(store, keep=keep, dry_run=dry_run)):
        print(f"would remove {line}" if dry_run else f"removed {line}")


@command
def version() -> None:
    """Print the versions of kinedex and of what it computes with."""
    from importlib.metadata import version as installed

    for package in ("kinedex", "numpy", "numba", "pyarrow", "duckdb", "polars"):
        print(f"{package:10} {installed(package)}")
