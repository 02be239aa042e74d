"""Small cuts of the real data, with its layout, on which every study runs in seconds: for tries, not for figures.

Of HDM05 two clips of each class and actor, and the beginnings of two takes; of CMU and of filmed takes the first
frames; of other archives a few files. Files that are missing in the source are missing in the cut.
"""

from __future__ import annotations

import csv
import json
import re
import shutil
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

CLIPS = 2
"""Clips of each class and actor of HDM05."""

HDM05_FRAMES = {"HDM_mm_take04": 1261, "HDM_mm_take05": 425}
"""Takes of HDM05, cut where a label ends."""

FEW = ("hopBothLegs1hops", "kickLFront1Reps", "squat1Reps")
"""Classes that have all clips in the cut `few`; the others have one."""

SHORTEST = ("HDM_mm_take04", "hopBothLegs1hops")
"""Take and class of its one label."""

CMU_FRAMES = 600
CMU_WHOLE = "01_01"
"""A take of CMU that is kept whole, as what follows its first jumps is judged."""

MAX_FRAMES = 1_000_000
CONTENT_FILES = 12
"""Files of each content of each data set of Bandai; contents with fewer are left out."""

FILMED = ("squat1Reps", "kickLFront1Reps", "sneak2StepsLStart", "jogLeftCircle4StepsRstart", "medley", "02_05", "03_04")
FILMED_FRAMES, DEPTH_FRAMES = 60, 12
TRIALS = ("07_undisturbed_fast_rotation_B.hdf5", "24_disturbed_tapping_A.hdf5")
SKELETONS = 6


def cut(data: Path, folder: Path) -> None:
    """Write a small cut of a folder of real data.

    Parameters
    ----------
    data : Path
        Folder with hdm05, cmu, bandai, cameras, depth, imu, c3d and wild.
    folder : Path
        Folder to write; it is new.
    """
    for part in (_hdm05, _cmu, _bandai, _cameras, _depth, _others):
        part(data, folder)
    _few(folder)


def _copy(data: Path, folder: Path, files: Sequence[Path]) -> None:
    for file in files:
        to = folder / file.relative_to(data)
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, to)


def _hdm05(data: Path, folder: Path) -> None:
    seen: Counter[tuple[str, str]] = Counter()
    for file in sorted((data / "hdm05" / "clips").glob("*/*.amc")):
        key = (file.parent.name, file.name.split("_")[1])
        seen[key] += 1
        if seen[key] <= CLIPS:
            _copy(data, folder, [file])
    _copy(data, folder, sorted((data / "hdm05").glob("*/*.asf")))
    for name, frames in HDM05_FRAMES.items():
        _copy_frames(data, folder, Path("hdm05", "takes", f"{name}.amc"), frames)
    _copy_labels(data, folder, Path("hdm05", "takes", "ground_truth.csv"), HDM05_FRAMES)


def _cmu(data: Path, folder: Path) -> None:
    frames = {
        file: MAX_FRAMES if file.stem == CMU_WHOLE else CMU_FRAMES
        for file in sorted((data / "cmu").glob("[0-9]*/*.amc"))
    }
    for file, most in frames.items():
        _copy_frames(data, folder, file.relative_to(data), most)
    _copy(data, folder, sorted((data / "cmu").glob("[0-9]*/*.asf")))
    _copy_labels(data, folder, Path("cmu", "ground_truth.csv"), {file.stem: most for file, most in frames.items()})
    # apart from the archive, in which each take is once
    _copy(data / "cmu", folder, sorted((data / "cmu" / "same_take_amc_and_bvh").glob("*")))


def _bandai(data: Path, folder: Path) -> None:
    by_content: dict[str, list[Path]] = {}
    for file in sorted((data / "bandai").glob("*/*.bvh")):
        by_content.setdefault("_".join(file.name.split("_")[:2]), []).append(file)
    for files in by_content.values():
        if len(files) >= CONTENT_FILES:
            # evenly, so that all styles are among them
            _copy(data, folder, [files[place * len(files) // CONTENT_FILES] for place in range(CONTENT_FILES)])


def _cameras(data: Path, folder: Path) -> None:
    source, to = data / "cameras" / "simulated", folder / "cameras" / "simulated"
    if not source.is_dir():
        return
    to.mkdir(parents=True)
    document = json.loads((source / "cameras.json").read_text(encoding="utf-8"))
    kept = {f"{name}_seed{seed}" for name in FILMED for seed in (1, 2)}
    document["recordings"] = {name: one for name, one in document["recordings"].items() if name in kept}
    (to / "cameras.json").write_text(json.dumps(document), encoding="utf-8")
    for name, column, values in (("truth", "take", FILMED), ("keypoints", "recording", sorted(kept))):
        table = pq.read_table(source / f"{name}.parquet")
        begins = pc.less(table["frame"], FILMED_FRAMES)
        pq.write_table(table.filter(pc.and_(begins, pc.is_in(table[column], pa.array(values)))), to / f"{name}.parquet")
    with (source / "failures.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.reader(file))
    # every recording has one, so that there are frames within failures and others
    rows = [rows[0], *([name, "20", "35", "views", "rleg"] for name in document["recordings"])]
    with (to / "failures.csv").open("w", encoding="utf-8", newline="") as file:
        csv.writer(file).writerows(rows)


def _depth(data: Path, folder: Path) -> None:
    for home in sorted((data / "depth" / "simulated").glob("squat1Reps*")):
        _copy(data, folder, [home / "background.png", home / "camera.yaml"])
        _copy(data, folder, sorted((home / "depth").glob("*.png"))[:DEPTH_FRAMES])
        lines = (home / "ground_truth.csv").read_text(encoding="utf-8").splitlines(keepends=True)
        (folder / home.relative_to(data) / "ground_truth.csv").write_text("".join(lines[: 1 + DEPTH_FRAMES]))


def _few(folder: Path) -> None:
    """Write the cut `few` for studies that do much with each motion: clips of few classes, and one labelled motion."""
    takes, labels = folder / "hdm05" / "takes", folder / "few" / "hdm05" / "takes"
    if not takes.is_dir():
        return
    labels.mkdir(parents=True)
    (folder / "few" / "depth").symlink_to(folder.resolve() / "depth")
    _copy(folder, folder / "few", [takes / "HDM_mm.asf", takes / f"{SHORTEST[0]}.amc"])
    clips = folder / "hdm05" / "clips"
    _copy(folder, folder / "few", sorted(clips.glob("*.asf")))
    for home in sorted(path for path in clips.iterdir() if path.is_dir()):
        _copy(folder, folder / "few", sorted(home.glob("*.amc"))[: None if home.name in FEW else 1])
    rows = (takes / "ground_truth.csv").read_text(encoding="utf-8").splitlines()
    text = "\n".join([rows[0], *(row for row in rows if row.startswith(",".join(SHORTEST)))])
    (labels / "ground_truth.csv").write_text(f"{text}\n", encoding="utf-8")


def _others(data: Path, folder: Path) -> None:
    _copy(data, folder, [file for name in TRIALS if (file := data / "imu" / "broad" / name).is_file()])
    _copy(
        data, folder, [one for part in ("apdm", "feet", "xio", "xsens") for one in sorted(data.glob(f"imu/{part}/*.*"))]
    )
    _copy(
        data, folder, [one for one in sorted(data.glob("c3d/*.c3d")) if one.stem in ("Optotrak", "Qualisys", "Vicon")]
    )
    _copy(data, folder, sorted(data.glob("wild/pyCGM/Sample_Static.c3d")))
    _copy(data, folder, [one for one in sorted(data.glob("wild/*/*.bvh")) if one.stat().st_size < 300_000][:SKELETONS])
    skeletons = data.parent / "reference" / "wild_skeletons.json"
    if skeletons.is_file():
        document = json.loads(skeletons.read_text(encoding="utf-8"))
        few = {key: value[:SKELETONS] if isinstance(value, list) else value for key, value in document.items()}
        (folder / "skeletons.json").write_text(json.dumps(few), encoding="utf-8")
    queries = data.parent / "reference" / "keyframe_queries.json"
    if queries.is_file():
        shutil.copyfile(queries, folder / "queries.json")


def _copy_frames(data: Path, folder: Path, file: Path, frames: int) -> None:
    """Copy the first frames of an AMC file, if it is there."""
    if not (data / file).is_file():
        return
    text = (data / file).read_text(encoding="utf-8")
    end = re.search(rf"^{frames + 1}\s*$", text, re.MULTILINE)
    to = folder / file
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_text(text if end is None else text[: end.start()], encoding="utf-8")


def _copy_labels(data: Path, folder: Path, file: Path, frames: dict[str, int]) -> None:
    """Copy labels of takes that begin within the frames that are kept."""
    if not (data / file).is_file():
        return
    with (data / file).open(encoding="utf-8", newline="") as source:
        head, *rows = csv.reader(source)
    kept = [
        [take, label, start, str(min(int(stop), frames[take]))]
        for take, label, start, stop in rows
        if take in frames and int(start) < frames[take]
    ]
    (folder / file).parent.mkdir(parents=True, exist_ok=True)
    with (folder / file).open("w", encoding="utf-8", newline="") as to:
        csv.writer(to).writerows([head, *kept])
