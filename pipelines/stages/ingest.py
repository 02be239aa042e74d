"""Stage ingest: motion files become takes and frames with words; what cannot be read is logged."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from contextlib import closing
from typing import Any

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.plugins import Plugins
from kinedex.catalog.skeletons.mappings import Mappings, load_mappings
from kinedex.ops import textnumbers
from kinedex.ops.body import features, kinematics
from kinedex.ops.errors import KinedexError, NewStoreError
from kinedex.pipelines.console.wording import counted
from kinedex.pipelines.engine.context import StageContext, feature_set_for
from kinedex.pipelines.engine.executors import WorkerDied, batches_of
from kinedex.pipelines.engine.stage import Stage
from kinedex.pipelines.ingestion.changes import Changes, compare, digest, features_digest
from kinedex.pipelines.ingestion.failures import Failure, failure, failure_messages, killer, log_table
from kinedex.pipelines.ingestion.file_batches import Batch, Task, Written, read_batch
from kinedex.pipelines.ingestion.memory_limit import MemoryShare
from kinedex.pipelines.ingestion.parameters import IngestParameters
from kinedex.pipelines.ingestion.task_batches import run_batches
from kinedex.storage.formats.motion.body_models import model_digest
from kinedex.storage.formats.motion.reader_table import READERS, motion_endings
from kinedex.storage.formats.motion.sources import Scan, scan
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.schemas import TakeColumn, column_problem
from kinedex.storage.store.compaction import compact
from kinedex.storage.store.store import Store
from kinedex.storage.store.verification import damaged_frames
from kinedex.storage.store.writer import StoreWriter

MEGABYTE = 1 << 20


class Ingest(Stage[IngestParameters]):
    """Motion files become takes and frames with words; files that cannot be read are logged."""

    name = "ingest"
    parameters = IngestParameters

    def external_digest(self, params: IngestParameters, store: Store | None) -> str:
        """Return a hash of the source files by path, size and time, of the mappings, and of the features."""
        feature_set = feature_set_for(store, params.features)
        mappings = load_mappings(params.skeleton, feature_set.joints)
        forms = [mappings.digest(form) for form in sorted(mappings.of_format)]
        model = model_digest(params.given.body_model)
        return digest([scan(params.source).digest, features_digest(feature_set), *forms, model])

    def is_current(self, store: Store) -> bool:
        """Return whether no part of frames is damaged: takes of damaged ones are read again."""
        return not damaged_frames(store)

    def named_parts(self, params: IngestParameters) -> Sequence[tuple[Plugins[Any], str]]:
        """Return the readers, all of which may be asked for a file."""
        return [(READERS, name) for name in READERS]

    def run(self, context: StageContext, params: IngestParameters) -> dict[str, object]:
        """Read the new and changed files of a source, batch by batch, each committed whole."""
        found = scan(params.source)
        if not found.motions:
            raise _no_motion_files(found, params.source)
        mappings = load_mappings(params.skeleton, context.feature_set.joints)
        with context.writer() as writer:
            plan = compare(writer, context.feature_set, mappings, found, params.name, params.patterns, params.given)
            if plan.renamed and not params.prune:
                raise _named_otherwise(plan)
            _report_changes(context, params, found, plan)
            _declare_groups(context, writer, params)
            writer.record_source(found.motions[0].root, context.key(), params.remembered)
            failures = list(plan.failures)
            frames = 0
            if not (params.strict and failures):
                frames = _read_files(context, params, mappings, writer, plan.tasks, failures)
            writer.put_results("ingest_log", log_table(failures, context.run), stage=context.key(), run=context.run)
            writer.put_results("skeleton_files", plan.skeletons, stage=context.key(), run=context.run)
            if params.strict and failures:
                writer.commit()
                raise KinedexError(
                    f"{failures[0].message}\n(strict: stopped at this file; files before it stay in the store)"
                )
            read = len(plan.tasks) - (len(failures) - len(plan.failures))
            if not plan.unchanged + read:
                writer.commit()
                _report_failures(context, failures)
                count = len(found.motions)
                none = f"none of the {count} files could be read" if count > 1 else "the only file could not be read"
                raise KinedexError(f"{none}; the reasons are above (table ingest_log)")
            dropped = [*plan.gone, *(take for take, _, _ in plan.renamed)] if params.prune else []
            if dropped:
                writer.drop_takes(dropped)
            writer.restate_takes(pa.Table.from_pylist(plan.restated, schema=writer.takes_schema))
            writer.commit()
            _compact(context, writer)
            total = len(writer.manifest.live_takes)
        _report_failures(context, failures)
        return {
            "takes": total,
            "read": read,
            "unchanged": plan.unchanged,
            "frames_read": frames,
            "left_out": len(failures),
            "not_read": len(found.unread),
            "dropped": len(dropped),
        }


def _declare_groups(context: StageContext, writer: StoreWriter, params: IngestParameters) -> None:
    """Declare the columns of the named groups; report those that cannot be columns of takes."""
    columns: dict[str, TakeColumn] = {}
    for name, column in params.group_columns.items():
        if (problem := column_problem(name, column, writer.manifest.columns | columns)) is None:
            columns[name] = column
        else:
            context.say(
                f"the named group '{name}' is no column of takes: {problem}; its values are in the column `groups`; "
                "give it another name in `patterns`"
            )
    writer.declare_columns(columns)


def _no_motion_files(found: Scan, source: str) -> KinedexError:
    """Return the error of a source without motion files."""
    return KinedexError(
        f"no motion files ({', '.join(motion_endings())}) below {source}; is this the right folder?"
        + "".join(f" {line}." for line in found.unread_lines())
        + "".join(f" {refused.fault}." for refused in found.refused[:3])
    )


def _report_changes(context: StageContext, params: IngestParameters, found: Scan, plan: Changes) -> None:
    """Report the files to read, those that are not read, and takes whose file is gone or renamed."""
    context.say(
        f"{counted(len(found.motions), 'motion file')} below {params.source}: "
        f"{len(plan.tasks)} to read, {plan.unchanged} unchanged"
        + (f", {len(plan.failures)} excluded" if plan.failures else "")
    )
    for line in found.unread_lines():
        context.say(line)
    if plan.damaged:
        again = len({task.take_id for task in plan.tasks}.intersection(plan.damaged))
        others = len(plan.damaged) - again
        context.say(
            f"{counted(len(plan.damaged), 'take')} in damaged parts of the store: {again} to read again"
            + (f"; `{shlex.join(repair(context.store_path).command)}` for the other {others}" if others else "")
        )
    if plan.gone:
        what = "dropped" if params.prune else "kept; `prune: true` drops them"
        context.say(f"{counted(len(plan.gone), 'take')} whose file is gone: {what}")
    if plan.renamed:
        context.say(f"{len(plan.renamed)} takes whose file has another name now: read again, and dropped as they were")


def _named_otherwise(plan: Changes) -> NewStoreError:
    """Return the error of a source whose takes are in the store under other names, and would be there twice."""
    _, before, now = plan.renamed[0]
    return NewStoreError(
        f"{counted(len(plan.renamed), 'take')} of this source are in the store under other names, such as '{before}' "
        f"(here '{now}'): another pipeline named them, by the parameter `name` of its ingest. Go on with the pipeline "
        "that brought them in, or use a new store; `prune: true` reads their files again under the new names and drops "
        "the takes of the old ones"
    )


def _report_failures(context: StageContext, failures: Sequence[Failure]) -> None:
    for line in failure_messages(failures):
        context.say(line)


def _read_files(
    context: StageContext,
    params: IngestParameters,
    mappings: Mappings,
    writer: StoreWriter,
    tasks: Sequence[Task],
    failures: list[Failure],
) -> int:
    """Read all files, commit them batch by batch, and return the number of frames."""
    if not tasks:
        return 0
    if context.executor.workers > 1:
        _compile_kernels(context.feature_set)
    frames, workers = 0, context.executor.workers
    memory = MemoryShare.of(params.max_memory, workers) if params.max_memory is not None else None
    with context.progress("reading takes", len(tasks)) as progress:
        batches = [
            Batch(
                context.store_path, context.feature_set, writer.manifest.rate_hz, mappings, params.given,
                params.strict, part, memory,
            )
            for part in _batches(tasks, params.batch_mb * MEGABYTE, workers)
        ]  # fmt: skip
        with closing(run_batches(context.executor, read_batch, batches, _give_up)) as results:
            for batch, written in results:
                failures.extend(written.failures)
                if written.part is not None:
                    writer.add_takes(pa.Table.from_pylist(written.takes, schema=writer.takes_schema), written.part)
                    writer.commit()
                    frames += written.part.rows
                progress.advance(len(batch.tasks))
                if params.strict and failures:
                    break
    return frames


def _give_up(batch: Batch, fault: Exception) -> Written:
    return Written([], None, [(killer if isinstance(fault, WorkerDied) else failure)(batch.tasks[0].motion, fault)])


def _compact(context: StageContext, writer: StoreWriter) -> None:
    done = compact(writer, spread=context.executor.map, workers=context.executor.workers)
    for fault in done.damaged:
        context.say(f"not compacted: {fault}")
    if done.changed:
        context.say(
            f"compacted: {done.frames_before} frames parts to {done.frames_after}, {done.takes_before} takes parts to "
            f"{done.takes_after}; `kinedex gc {context.store_path}` removes the old files"
        )


def _batches(tasks: Sequence[Task], limit: int, workers: int) -> list[tuple[Task, ...]]:
    """Divide tasks by bytes: at most `limit` each, and two for every worker where there is enough work."""
    sizes = [task.motion.size for task in tasks]
    return batches_of(tasks, sizes, min(limit, max(4 * MEGABYTE, sum(sizes) // (2 * workers) + 1)))


def _compile_kernels(feature_set: FeatureSet) -> None:
    """Compile kernels into the cache, before several processes would each do so."""
    node = kinematics.Node("root", -1, np.eye(3), np.zeros(3), np.zeros(3), np.zeros(3), ())
    kinematics.forward((node,), np.zeros((2, 1)))
    textnumbers.parse_frames(b"1\nroot 0\n", 0, 1, ["root"], [1])
    textnumbers.parse_rows(b"0\n", 0, 1, 1)
    body, upright = np.zeros((len(feature_set.joints), 3, 2)), np.zeros((4, 2))
    features.words(body, upright, 30.0, feature_set.rules, None, feature_set.plugin_primitives)
