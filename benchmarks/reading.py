"""Time motion files to words: parsing, kinematics and features, and the ingest into a store, on one core."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from benchmarks import packages
from benchmarks.archive import BUILD, archive
from benchmarks.harness import Figure, seconds, silent, sized
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_skeleton
from kinedex.ops.body import features, kinematics
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.asf import Skeleton, read_asf
from kinedex.storage.formats.motion.bvh_parser import parse_bvh
from kinedex.storage.formats.motion.c3d import parse_c3d
from kinedex.storage.store.store import Store
from tests import real_data
from tests.oracles import features as naive

SHARED = real_data.SHARED / "data"
JOINED_MB = sized(5.0, 0.3)


def figures(_: Store) -> list[Figure]:
    """Time the reading of the longest take, and the ingest of the whole archive."""
    root = archive()
    amc = max((root / "takes").glob("*.amc"), key=lambda file: file.stat().st_size)
    asf = root / "takes" / f"{amc.stem.rsplit('_', 1)[0]}.asf"
    skeleton = read_asf(asf)
    return [
        *packages.beside(
            "AMC file to numbers", amc, lambda: AmcFile(amc, read_asf(asf)).channels(), packages.of_acclaim(asf, amc)
        ),
        *_joined_bvh(),
        *_c3d(),
        _posing(skeleton, AmcFile(amc, skeleton).channels()),
        *_ingesting(root),
    ]


def _joined_bvh() -> Iterable[Figure]:
    """Time a file of many takes of one skeleton: header, names and all frames are read from its bytes."""
    name = "BVH file to numbers"
    files = sorted((SHARED / "bandai").rglob("*.bvh"))
    if not files:
        yield Figure(name, 0.0, "MB", None, "left out: no BVH files in ../shared/data/bandai")
        return
    header = files[0].read_bytes().partition(b"MOTION")[0]
    rows: list[bytes] = []
    size = 0
    for file in files:
        hierarchy, _, motion = file.read_bytes().partition(b"MOTION")
        if hierarchy.split() == header.split() and size < JOINED_MB * 1e6:
            rows += [line for line in motion.splitlines()[1:] if line[:1] not in (b"", b"F")]
            size = sum(map(len, rows))
    path = BUILD / "joined.bvh"
    path.parent.mkdir(parents=True, exist_ok=True)
    lines = [header.strip(), b"MOTION", b"Frames: %d" % len(rows), b"Frame Time: 0.0333333", *rows]
    path.write_bytes(b"\n".join(lines) + b"\n")
    yield from packages.beside(name, path, lambda: parse_bvh(path), packages.of_bvh(path))


def _c3d() -> Iterable[Figure]:
    name = "C3D file to markers"
    files = sorted((SHARED / "c3d").glob("*.c3d"), key=lambda file: file.stat().st_size)
    if not files:
        yield Figure(name, 0.0, "MB", None, "left out: no C3D files in ../shared/data/c3d")
        return
    yield from packages.beside(name, files[-1], lambda: parse_c3d(files[-1]), packages.of_c3d(files[-1]))


def _posing(skeleton: Skeleton, channels: np.ndarray) -> Figure:
    """Time channels to words: joints, the root's rotation and all features, in every source frame."""
    feature_set = load_feature_set()
    fit = load_skeleton("acclaim", feature_set.joints).fit(skeleton.bones)

    def pose(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nodes, matrices = kinematics.forward(skeleton.nodes, part, wanted=fit.nodes)
        return fit.apply(nodes, feature_set.joints), kinematics.quaternions(matrices, after=skeleton.root_frame)

    def ours() -> object:
        return features.words(*pose(channels), 120.0, feature_set.rules)

    few = channels[:400]
    positions, orientation = pose(few)
    w, x, y, z = orientation
    axes = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], axis=1)
    slow = seconds(lambda: naive.words(naive.Body(positions, axes, 120.0)), 1) * len(channels) / len(few)
    return Figure(
        "kinematics and 40 features", len(channels) / 1e3, "k source frames", seconds(ours),
        "the tests' naive features alone", slow,
    )  # fmt: skip


def _ingesting(root: Path) -> Iterable[Figure]:
    """Time AMC files to a store, from the scan of the folder to the manifest on disk, in a warm process.

    Checksums, skeletons, parsing, features, Parquet and the commit are included; the start of a process is not.
    """
    size = sum(file.stat().st_size for file in root.rglob("*.amc")) / 1e6
    alone = BUILD / "ingest-alone.yaml"
    alone.parent.mkdir(parents=True, exist_ok=True)
    alone.write_text("name: ingest-alone\nsettings: {source: }\nstages: {ingest: {params: {source: '${source}'}}}\n")

    def into_store(pipeline: str | Path) -> Callable[[], object]:
        store = BUILD / "ingest-store"

        def work() -> None:
            shutil.rmtree(store, ignore_errors=True)
            run_pipeline(pipeline, store, assignments={"source": str(root)}, executor="serial", terminal=silent())

        return work

    def bytes_alone() -> int:
        return sum(len(file.read_bytes()) for file in root.rglob("*.amc"))

    other = "reading the bytes alone", seconds(bytes_alone, 3)
    yield Figure("AMC files to a committed store", size, "MB", seconds(into_store(alone), 3), *other)
    yield Figure("the same, and its index", size, "MB", seconds(into_store("ingest"), 3), *other)
