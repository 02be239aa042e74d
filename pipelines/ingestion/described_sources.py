"""Describe the takes of a source by the patterns and tables of its ingest, and report paths that match no pattern."""

from __future__ import annotations

import re
import shlex
from collections.abc import Sequence
from pathlib import Path

from kinedex.ops.errors import AcceptError
from kinedex.ops.wording import counted
from kinedex.pipelines.ingestion.described_takes import Descriptions, Loss, losses, rows_below
from kinedex.pipelines.ingestion.metadata import Joined, load_metadata, unused_lines
from kinedex.pipelines.ingestion.parameters import IngestParameters
from kinedex.pipelines.ingestion.pattern_proposal import matched, propose
from kinedex.storage.formats.motion.sources import Scan, path_groups
from kinedex.storage.store.store import Store

_EXAMPLES = 2


def descriptions(params: IngestParameters, joined: Joined) -> Descriptions:
    """Return the metadata that patterns and joined tables give to the takes of a source."""
    return Descriptions(tuple(map(re.compile, params.patterns)), joined.values)


def refuse_losses(params: IngestParameters, store: Store, found: Scan) -> None:
    """Raise an error if an ingest would remove values of columns from takes.

    Parameters
    ----------
    params : IngestParameters
        The parameters of the ingest.
    store : Store
        The store, which is read only.
    found : Scan
        The files of the source.

    Raises
    ------
    AcceptError
        Takes would lose their values in some columns; the message names columns and takes.
    """
    rows = rows_below(store.take_rows.to_pylist(), found, params.root)
    metadata = load_metadata(params.tables, found)
    columns = {**store.manifest.columns, **metadata.columns(store.manifest.columns)[0]}
    joined = metadata.join(rows, params.root, columns)
    lost = losses(rows, columns, descriptions(params, joined))
    if lost:
        takes = len({name for one in lost for name in one.takes})
        which = f"{takes:,} of {counted(len(rows), 'take')} below {params.source} would lose values"
        lines = "".join(f"\n    {line}" for line in [*map(_loss_line, lost), *unused_lines(metadata)])
        raise AcceptError(
            f"{which}:{lines}\nnothing was changed. The store remembers the settings of this source: an ingest without "
            "`patterns` and `metadata` of its own uses them"
        )


def _loss_line(loss: Loss) -> str:
    examples = [f"'{value}' of {name}" for name, value in list(loss.takes.items())[:_EXAMPLES]]
    return f"{loss.column}: {counted(len(loss.takes), 'take')}, such as {', '.join(examples)}"


def unmatched_paths(params: IngestParameters, found: Scan) -> list[str]:
    """Return the paths of motion files that match none of the patterns; an empty list if there are no patterns."""
    patterns = [re.compile(pattern) for pattern in params.patterns]
    return [motion.path for motion in found.motions if patterns and path_groups(motion.path, patterns) is None]


def unmatched_line(params: IngestParameters, unmatched: Sequence[str], found: Scan, store: Path) -> str:
    """Return a message about paths that match no pattern, with the remedy.

    The remedy is `kinedex init` if it can propose patterns for some of them; otherwise the user has to write one.
    """
    examples = " and ".join(f"'{path}'" for path in dict.fromkeys((unmatched[0], unmatched[-1])))
    verb, whose = ("match", "their takes have") if len(unmatched) > 1 else ("matches", "its take has")
    line = (
        f"{len(unmatched):,} of {counted(len(found.motions), 'path')} {verb} no pattern, such as {examples}: {whose} "
        "neither class nor actor. "
    )
    if matched(propose(motion.path for motion in found.motions), unmatched):
        root = shlex.quote(found.motions[0].root)
        return (
            f"{line}`kinedex init {root} -o my.yaml` proposes patterns, and `kinedex run my.yaml --store "
            f"{shlex.quote(str(store))}` uses them"
        )
    return (
        f"{line}`kinedex init` has no pattern for {'them' if len(unmatched) > 1 else 'it'}: add one to `patterns` of "
        "the stage ingest, such as '(?P<class>[^/_]+)_(?P<actor>[^/_]+)', and run again, which reads no file anew; or "
        "leave it so"
    )
