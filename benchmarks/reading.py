"""Motion files to words: parsing, kinematics with features, and the whole way into a committed store, on one core."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from benchmarks.archive import BUILD, archive
from benchmarks.harness import Figure, seconds, silent
from catalog.features import load_feature_set
from catalog.skeletons import load_skeleton
from ops import features, kinematics
from pipelines.runner import run_pipeline
from storage.acclaim import read_amc, read_asf
from tests.oracles import features as naive


def figures() -> list[Figure]:
    """Time reading on the longest take, and the ingest of the whole archive."""
    root = archive()
    path = max((root / "takes").glob("*.amc"), key=lambda file: file.stat().st_size)
    skeleton = read_asf(root / "takes" / f"{path.stem.rsplit('_', 1)[0]}.asf")
    motion = read_amc(path, skeleton)
    return [_parsing(path, skeleton), _posing(skeleton, motion.channels), _ingesting(root)]


def _parsing(path: Path, skeleton: object) -> Figure:
    def in_python() -> int:
        with path.open(encoding="latin-1") as file:
            return sum(len([float(word) for word in line.split()[1:]]) for line in file if line[:1].isalpha())

    megabytes = path.stat().st_size / 1e6
    ours = seconds(lambda: read_amc(path, skeleton))  # type: ignore[arg-type]
    return Figure("AMC text to numbers", megabytes, "MB", ours, "split and float in Python", seconds(in_python, 1))


def _posing(skeleton: object, channels: np.ndarray) -> Figure:
    feature_set = load_feature_set()
    mapping = load_skeleton("acclaim", feature_set.joints)

    def pose(part: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        nodes, matrices = kinematics.forward(skeleton.nodes, part)  # type: ignore[attr-defined]
        positions = mapping.apply("", skeleton.bones, nodes, feature_set.joints)  # type: ignore[attr-defined]
        return positions, kinematics.quaternions(matrices)

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


def _ingesting(root: Path) -> Figure:
    store = BUILD / "ingest-store"
    size = sum(file.stat().st_size for file in root.rglob("*.amc")) / 1e6

    def ingest() -> None:
        shutil.rmtree(store, ignore_errors=True)
        run_pipeline("ingest", store, assignments={"source": str(root)}, executor="serial", terminal=silent())

    def read_only() -> int:
        return sum(len(file.read_bytes()) for file in root.rglob("*.amc"))

    ours = seconds(ingest, 3)
    return Figure("AMC files to an indexed store", size, "MB", ours, "reading the bytes alone", seconds(read_only, 3))
