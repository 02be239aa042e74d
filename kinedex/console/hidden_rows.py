"""Hints about rows of other pipelines, which the plain views of results do not show."""

from __future__ import annotations

import re
import shlex
from collections import Counter

from kinedex.ops.wording import counted, few
from kinedex.storage.snapshot.manifest import Manifest
from kinedex.storage.snapshot.shown_results import (
    PIPELINE_KINDS,
    all_parts,
    pipeline_of,
    shown_parts,
    shown_pipeline,
)
from kinedex.storage.store.store import Store

_QUOTED = re.compile(r"'(?:[^']|'')*'|--[^\n]*|/\*.*?\*/", re.DOTALL)


def hidden_rows_hints(store: Store, statement: str, rows: int) -> list[str]:
    """Return a hint for each view in a statement that is empty only because the rows are of another pipeline.

    Parameters
    ----------
    store : Store
        The store that was asked.
    statement : str
        The SQL.
    rows : int
        Number of rows of the answer. If it is 0, hints are also given for views that do show some rows.
    """
    words = set(re.findall(r"\w+", _QUOTED.sub(" ", statement).lower()))
    hints = []
    for kind in (kind for kind in PIPELINE_KINDS if kind in words):
        shown = sum(part.rows for part in shown_parts(store.manifest, kind))
        others = _hidden(store.manifest, kind)
        if others and (not shown or not rows):
            names = few([f"{name} ({counted(count, 'row')})" for name, count in others.items()])
            current = shown_pipeline(store.manifest, kind)
            hints.append(
                f"{kind} shows {counted(shown, 'row')} of pipeline {current}; all_{kind} has those of {names}, too, "
                f"and `kinedex use {shlex.quote(str(store.path))} NAME` shows another pipeline"
            )
    return hints


def _hidden(manifest: Manifest, kind: str) -> dict[str, int]:
    """Return the pipelines whose rows of a kind are not shown, with the number of their rows."""
    shown = {part.path for part in shown_parts(manifest, kind)}
    counts: Counter[str] = Counter()
    for part in all_parts(manifest, kind):
        if part.path not in shown and part.rows:
            counts[pipeline_of(part.stage)] += part.rows
    return dict(sorted(counts.items()))
