"""The motion files that both commits read, made once by this checkout's commands in `build/against`."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import kinedex
from benchmarks.against.commits import BUILD, ROOT
from kinedex.ops.errors import KinedexError

MINUTES = 12
"""Minutes of motion in the archive, which has some 200 files."""

FRAMES = 30_000
"""Source frames of the long files, at 120 Hz: some four minutes, and 25 MB as AMC."""

COPIES = 8
"""Copies of the long file's frames at 30 Hz in the arrays, of which features are computed."""

HOURS, RATE_HZ = 4, 30.0
"""Hours of motion for searches, and their frames per second."""

LARGE_FRAMES = 90_000
"""Frames of the file at which memory is measured: some 60 MB."""


def inputs() -> Path:
    """Return the folder of the files; make it if it is missing.

    It is named after this module, so that other sizes have other files, and stores of them.
    """
    folder = BUILD / f"inputs-{hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:8]}"
    if not (folder / "complete").is_file():
        print(f"making the motion files that both commits read, in {folder}", flush=True)
        shutil.rmtree(folder, ignore_errors=True)
        _write(folder, folder / "long")
        (folder / "complete").touch()
    return folder


def _write(folder: Path, long: Path) -> None:
    """Write an archive, a long AMC file, the same motion in the other formats, and many short BVH files."""
    archive = folder / "archive"
    _kinedex("synth", archive, "--minutes", MINUTES)
    amc = max((archive / "takes").glob("*.amc"), key=lambda file: file.stat().st_size)
    long.mkdir()
    shutil.copy(amc.with_name(f"{amc.stem.rsplit('_', 1)[0]}.asf"), long / "long.asf")
    (long / "long.amc").write_bytes(lengthened_amc(amc.read_bytes(), FRAMES))
    store = folder / "long-store"
    _kinedex("ingest", store, long)
    for ending in ("bvh", "c3d", "trc"):
        _kinedex("export", store, "long", "-o", long / f"long.{ending}", "--resample", 120)
    (long / "large.bvh").write_bytes(lengthened_bvh((long / "long.bvh").read_bytes(), LARGE_FRAMES))
    _write_mappings(long)
    _write_positions(long)
    store = folder / "short-store"
    _kinedex("ingest", store, archive)
    for name, where in (("short", "class IS NOT NULL"), ("takes", "class IS NULL")):
        _kinedex("export", store, "--where", where, "--format", "bvh", "-o", folder / name)
    _write_hours(folder / "hours", sorted((folder / "takes").rglob("*.bvh")))


def _write_mappings(long: Path) -> None:
    """Write the mappings of exported markers, for commits that do not know their names or the key `only`."""
    for ending, name in (("c3d", "named-markers-c3d"), ("trc", "named-markers")):
        lines = (ROOT / "configs" / "skeletons" / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
        kept = [line for line in lines if not line.startswith("only:")]
        (long / f"markers-{ending}.yaml").write_text("\n".join(kept) + "\n", encoding="utf-8")


def _write_positions(long: Path) -> None:
    """Write positions (T, 24, 3) and orientations (T, 4) at 30 Hz as arrays."""
    take = kinedex.read(long / "long.bvh")
    for name in ("positions", "orientation"):
        np.save(long / f"{name}.npy", np.concatenate([getattr(take, name)] * COPIES))


def _write_hours(folder: Path, takes: Sequence[Path]) -> None:
    """Write the frames of some takes one after the other as files of an hour each, all of them the same file."""
    folder.mkdir()
    rows = b"".join(path.read_bytes().partition(b"Frame Time")[2].partition(b"\n")[2] for path in takes)
    header = takes[0].read_bytes().partition(b"Frame Time")
    joined = b"".join([header[0], header[1], header[2].partition(b"\n")[0], b"\n", rows])
    (folder / "hour_00.bvh").write_bytes(lengthened_bvh(joined, round(3600 * RATE_HZ)))
    for number in range(1, HOURS):
        os.link(folder / "hour_00.bvh", folder / f"hour_{number:02}.bvh")


def _kinedex(*words: object) -> None:
    """Run a command of this checkout; what it prints is shown if it fails."""
    command = [sys.executable, "-m", "kinedex", *map(str, words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=1800)
    if done.returncode:
        raise KinedexError(f"'kinedex {' '.join(command[3:])}' failed: {done.stdout}{done.stderr}")


def lengthened_amc(data: bytes, frames: int) -> bytes:
    """Return the bytes of an AMC file whose frames are repeated up to a number."""
    lines = data.splitlines()
    first = next(place for place, line in enumerate(lines) if line.strip().isdigit())
    starts = [place for place in range(first, len(lines)) if lines[place].strip().isdigit()]
    stops = [*starts[1:], len(lines)]
    poses = [lines[start + 1 : stop] for start, stop in zip(starts, stops, strict=True)]
    made = lines[:first]
    for number in range(frames):
        made += [b"%d" % (number + 1), *poses[number % len(poses)]]
    return b"\n".join(made) + b"\n"


def lengthened_bvh(data: bytes, frames: int) -> bytes:
    """Return the bytes of a BVH file whose frames are repeated up to a number."""
    hierarchy, _, motion = data.partition(b"MOTION")
    lines = [line for line in motion.splitlines() if line.strip()]
    rows = lines[2:]
    repeated = [rows[number % len(rows)] for number in range(frames)]
    return b"\n".join([hierarchy.rstrip(), b"MOTION", b"Frames: %d" % frames, lines[1], *repeated]) + b"\n"
