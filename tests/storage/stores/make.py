"""`python -m tests.storage.stores.make CHECKOUT FILE`: a small store, made by the kinedex of a checkout of any age.

The kinedex of the checkout makes the synthetic archive, ingests three of its clips with named groups, indexes them,
learns templates and annotates; then one clip changes, and the pipeline runs again. The label comes last.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

CLIPS = {
    "jumpingJack1Reps": "SYN_al_jumpingJack1Reps_001_120", "punchLeft1Reps": "SYN_al_punchLeft1Reps_001_120",
    "punchRight1Reps": "SYN_bo_punchRight1Reps_001_120",
}  # fmt: skip
"""Class → clip of the synthetic archive."""

LABEL = ("labels", "add", "store", CLIPS["jumpingJack1Reps"], "jumpingJack1Reps", "2", "30")

PIPELINE = r"""
name: old
stages:
  ingest:
    params:
      source: SOURCE
      patterns:
        - 'clips/(?P<class>punch[^/]+)/[^/_]+_(?P<actor>[^/_]+)_.*_(?P<clip>\d+)_(?P<rate>\d+)\.'
        - 'clips/(?P<style>[^/]+)/[^/_]+_(?P<actor>[^/_]+)_.*_(?P<clip>\d+)_'
  index:
  learn_templates: {params: {where: class IS NOT NULL}}
  annotate: {params: {where: class IS NULL, tau: 0.3}}
"""


def make(checkout: Path, file: Path, *, label: bool) -> None:
    """Make the store with a checkout's kinedex, and pack it.

    Parameters
    ----------
    checkout : Path
        The root of the checkout.
    file : Path
        The archive to write, a .tar.xz that holds the folder `store`.
    label : bool
        Add a label, which kinedex could not in format 3.
    """
    with tempfile.TemporaryDirectory(prefix="kinedex-store-") as name:
        folder = Path(name)
        kinedex(checkout, folder, "synth", "synthetic", "--minutes", "1", "--actors", "2")
        for label, clip in CLIPS.items():
            place = folder / "archive" / "clips" / label
            place.mkdir(parents=True)
            shutil.copy(folder / "synthetic" / "clips" / label / f"{clip}.amc", place)
        for skeleton in (folder / "synthetic" / "clips").glob("*.asf"):
            shutil.copy(skeleton, folder / "archive" / "clips")
        (folder / "old.yaml").write_text(PIPELINE.replace("SOURCE", str(folder / "archive")))
        kinedex(checkout, folder, "run", "old.yaml", "--store", "store")
        changed = folder / "archive" / "clips" / "punchLeft1Reps" / f"{CLIPS['punchLeft1Reps']}.amc"
        lines = changed.read_text().splitlines(keepends=True)
        changed.write_text("".join(lines[: lines.index("65\n")]))
        kinedex(checkout, folder, "run", "old.yaml", "--store", "store")
        if label:
            kinedex(checkout, folder, *LABEL)
        with tarfile.open(file, "w:xz") as packed:
            packed.add(folder / "store", "store", filter=_anonymous)


def kinedex(checkout: Path, folder: Path, *arguments: str) -> None:
    """Run a command of the checkout's kinedex in a folder."""
    environment = os.environ | {"PYTHONPATH": str(checkout.resolve()), "NUMBA_CACHE_DIR": str(folder / "compiled")}
    subprocess.run([sys.executable, "-m", "kinedex", *arguments], cwd=folder, env=environment, check=True, timeout=600)


def _anonymous(entry: tarfile.TarInfo) -> tarfile.TarInfo:
    entry.uid = entry.gid = 0
    entry.uname = entry.gname = ""
    return entry


def main() -> None:
    """Make a store by what the command line names."""
    parser = argparse.ArgumentParser(prog="python -m tests.storage.stores.make", description=__doc__)
    parser.add_argument("checkout", type=Path, help="root of a checkout whose kinedex makes the store")
    parser.add_argument("file", type=Path, help="the .tar.xz to write")
    parser.add_argument("--label", action="store_true", help="add a label")
    given = parser.parse_args()
    make(given.checkout, given.file, label=given.label)


if __name__ == "__main__":
    main()
