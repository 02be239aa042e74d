"""Find the files of a source whose takes a person has removed from the store, which an ingest skips."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.motion.sources import PassedOver, Scan
from kinedex.storage.snapshot.manifest import Manifest

KIND = "files whose takes were removed (`kinedex takes readmit` reads them again)"
"""The description of these files among those that an ingest skips."""


def removed_below(source: str | Path, manifest: Manifest | None) -> tuple[str, ...]:
    """Return the paths of the removed files of a source folder, sorted."""
    root = os.path.realpath(Path(source).expanduser())
    return () if manifest is None else manifest.removed_files.get(root, ())


def without_removed(found: Scan, manifest: Manifest | None) -> Scan:
    """Return a scan without the motion files whose takes were removed; they are listed as skipped.

    Raises
    ------
    KinedexError
        No other motion file remains.
    """
    root = found.motions[0].root
    removed = frozenset(removed_below(root, manifest))
    if not removed:
        return found
    motions = tuple(motion for motion in found.motions if motion.path not in removed)
    if not motions:
        raise KinedexError(
            f"{root}: the takes of all its motion files were removed from the store; `kinedex takes readmit` lists them"
        )
    passed = [PassedOver(motion.path, KIND) for motion in found.motions if motion.path in removed]
    others = tuple(sorted((*found.passed_over, *passed), key=lambda one: one.path))
    return replace(found, motions=motions, passed_over=others)
