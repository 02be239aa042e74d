"""`python -m studies.formats AMC ASF BVH`: compare a take between formats, and after an export as CSV."""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.harness import silent
from kinedex.catalog.features import load_feature_set
from kinedex.catalog.skeletons.mappings import load_mappings
from kinedex.ops.body import features
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.export.data_set import export_take
from kinedex.pipelines.export.request import ClipOptions
from kinedex.storage.formats.motion.reader import Body
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.store.store import open_store

FEATURES = load_feature_set()
LOWER = ("root", "lhip", "lknee", "lankle", "ltoes", "rhip", "rknee", "rankle", "rtoes", "belly", "chest")


def main() -> None:
    """Print the differences of joints and words between the files, and of words after an export."""
    parser = argparse.ArgumentParser(prog="python -m studies.formats", description=__doc__)
    for name in ("amc", "asf", "bvh"):
        parser.add_argument(name, type=Path)
    given = parser.parse_args()
    mappings = load_mappings("auto", FEATURES.joints)
    amc = read_body(given.amc, given.asf, mappings, FEATURES.joints)
    bvh = read_body(given.bvh, None, mappings, FEATURES.joints)
    rest = bvh.frames - amc.frames
    print(f"{amc.frames} frames; the BVH has {rest} more in front")
    apart = np.linalg.norm(bvh.positions[:, :, rest:] - amc.positions, axis=1) * 1000
    below = [FEATURES.joints.index(joint) for joint in LOWER]
    print(f"joints, largest distance: {apart.max():.3f} mm; legs, pelvis and lower spine {apart[below].max():.3f} mm")
    _compare("words at the source's rate", _words(amc), _words(bvh)[rest:])
    _compare("every fourth frame of them", _words(amc)[::4], _words(bvh)[rest:][::4])
    _exported(given.amc, given.asf)


def _words(body: Body) -> np.ndarray:
    return features.words(body.positions, body.orientation, body.rate_hz, FEATURES.rules)


def _compare(what: str, one: np.ndarray, other: np.ndarray) -> None:
    different = one ^ other
    frames = np.flatnonzero(different)
    bits = 1 - np.bitwise_count(different).sum() / (len(FEATURES.features) * len(one))
    first = ", ".join(map(str, frames[:20])) + (" …" if len(frames) > 20 else "")
    print(f"{what}: equal in {(different == 0).mean():.2%} of the frames, {bits:.2%} of all bits")
    print(f"    {len(frames)} of {len(one)} differ: {first}")


def _exported(amc: Path, asf: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file in (amc, asf):
            (folder / "one").mkdir(exist_ok=True)
            (folder / "one" / file.name).write_bytes(file.read_bytes())
        run_pipeline("ingest", folder / "a", assignments={"source": str(folder / "one")}, terminal=silent())
        (folder / "two").mkdir()
        export_take(open_store(folder / "a"), amc.stem, ClipOptions("csv"), folder / "two" / f"{amc.stem}.csv")
        settings = {"source": str(folder / "two"), "ingest.rate_hz": "30"}
        run_pipeline("ingest", folder / "b", assignments=settings, terminal=silent())
        _compare(
            "exported as CSV and back", open_store(folder / "a").words().words, open_store(folder / "b").words().words
        )


if __name__ == "__main__":
    main()
