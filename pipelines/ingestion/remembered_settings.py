"""Look up settings of a source that a store remembers, for parameters left unset at the next ingest."""

from __future__ import annotations

import os
from typing import Any

from kinedex.pipelines.ingestion.parameters import IngestParameters
from kinedex.storage.store.store import Store


def with_remembered(params: IngestParameters, unset: frozenset[str], store: Store) -> IngestParameters:
    """Return the parameters of an ingest, with unset parameters taken from the source's last ingest.

    Parameters
    ----------
    params : IngestParameters
        The parameters.
    unset : frozenset of str
        The names of the parameters that the user has not set.
    store : Store
        The store.
    """
    settings = _settings_of(params.root, store)
    # a store never changes its feature set
    return params.with_remembered({name: settings[name] for name in settings if name in unset - {"features"}})


def _settings_of(root: str, store: Store) -> dict[str, Any]:
    """Return the settings of a source, or of the source that was moved to its path; empty for a new one."""
    sources = store.manifest.sources
    if root in sources:
        return sources[root].settings
    gone = [former for former in sources if not os.path.isdir(former)]
    if not gone:
        return {}
    rows = store.take_columns("source_root", "source").to_pylist()
    for former in sorted(gone, key=lambda former: sources[former].recorded, reverse=True):
        if any(os.path.isfile(os.path.join(root, row["source"])) for row in rows if row["source_root"] == former):
            return sources[former].settings
    return {}


def remembered_line(params: IngestParameters) -> str:
    """Return a message that lists the parameters which the store remembers."""
    shown = ", ".join(f"{name} {_short(getattr(params, name))}" for name in params.from_store)
    return f"as at the last ingest of this source: {shown}; `--set ingest.{params.from_store[0]}=…` sets another"


def _short(value: object) -> str:
    if isinstance(value, list) and value:
        return f"'{value[0]}'" + (f" and {len(value) - 1} more" if len(value) > 1 else "")
    return f"'{value}'" if isinstance(value, str) else "none" if value in (None, []) else str(value)
