"""The motion files that both commits read, made once by this checkout's commands in `build/against/inputs`."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

from benchmarks.against.commits import BUILD, ROOT
from kinedex.ops.errors import KinedexError

MINUTES = 12
"""Minutes of motion in the archive, which has some 200 files."""

FRAMES = 30_000
"""Source frames of the long files, at 120 Hz: some four minutes, and 25 MB as AMC."""

LARGE_FRAMES = 90_000
"""Frames of the file at which memory is measured: some 60 MB."""


def inputs() -> Path:
    """Return the folder of the files; make it if it is missing."""
    folder = BUILD / "inputs"
    if not (folder / "complete").is_file():
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
    store = folder / "short-store"
    _kinedex("ingest", store, archive)
    _kinedex("export", store, "--where", "class IS NOT NULL", "--format", "bvh", "-o", folder / "short")


def _kinedex(*words: object) -> None:
    """Run a command of this checkout; what it prints is shown if it fails."""
    command = [sys.executable, "-m", "kinedex", *map(str, words)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
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
