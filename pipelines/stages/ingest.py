"""Stage ingest: read motion files as takes, compute the words of their frames, and log files that cannot be read."""

from __future__ import annotations

import shlex
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa

from kinedex.catalog.capture_sessions import same_decisions, session_lines, with_session_warnings
from kinedex.catalog.plugins import Plugins
from kinedex.catalog.skeletons.mappings import Mappings
from kinedex.ops.errors import KinedexError, NewStoreError
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.context import StageContext, feature_set_for
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.stage import Stage
from kinedex.pipelines.ingestion.file_failures import Failure, failure_messages, log_table
from kinedex.pipelines.ingestion.metadata import (
    NO_PATTERN,
    Metadata,
    descriptions,
    join_lines,
    load_metadata,
    metadata_in_source,
    refuse_losses,
    unmatched_line,
    unmatched_paths,
)
from kinedex.pipelines.ingestion.parameters import IngestParameters, chosen_mappings, remembered_line, with_remembered
from kinedex.pipelines.ingestion.read_passes import FilesRead, ReadPasses, motion_outcomes
from kinedex.pipelines.ingestion.source_changes import (
    SourceChanges,
    compare_source,
    digest,
    features_digest,
    removed_below,
    without_removed,
)
from kinedex.pipelines.inspection.duplicates import copies_line
from kinedex.storage.formats.motion.body_models import model_digest
from kinedex.storage.formats.motion.reader_table import READERS, motion_endings
from kinedex.storage.formats.motion.sources import Scan, scan
from kinedex.storage.remedies import repair
from kinedex.storage.snapshot.file_outcomes import file_table
from kinedex.storage.snapshot.manifest_files import read_newest, versions
from kinedex.storage.snapshot.measured_columns import declarable_figures
from kinedex.storage.snapshot.schemas import RECORDED_FORMATS, TakeColumn, column_problem
from kinedex.storage.store.compaction import compact
from kinedex.storage.store.store import Store
from kinedex.storage.store.verification import damaged_frames
from kinedex.storage.store.writer import StoreWriter


class Ingest(Stage[IngestParameters]):
    """Reads motion files as takes, computes the words of their frames, and logs files that cannot be read."""

    name = "ingest"
    parameters = IngestParameters

    def external_digest(self, params: IngestParameters, store: Store | None) -> str:
        """Return a hash of everything outside the store that decides what is read.

        This covers the source files by path, size and time, the skeleton mappings, the features, the body model, the
        tables of metadata, and the paths of files whose takes were removed.
        """
        feature_set = feature_set_for(store, params.features)
        path, manifest = (store.path, store.manifest) if store is not None else (Path(), None)
        mappings = chosen_mappings(params, feature_set.joints, path, manifest)
        forms = [mappings.digest(form) for form in sorted(mappings.of_format)]
        model = model_digest(params.given.body_model)
        tables = [files_digest(map(Path, params.tables))] if params.metadata else []
        removed = removed_below(params.source, manifest)
        return digest([scan(params.source).digest, features_digest(feature_set), *forms, model, *tables, *removed])

    def with_remembered(self, params: IngestParameters, unset: frozenset[str], store: Store) -> IngestParameters:
        """Return the parameters, with those of the source's last ingest in place of those that the user left unset."""
        return with_remembered(params, unset, store)

    def examine(self, params: IngestParameters, store: Store) -> None:
        """Raise an error if the ingest would remove values of columns from takes of the source."""
        refuse_losses(params, store, scan(params.source))

    def is_current(self, store: Store) -> bool:
        """Return whether no part of the stored frames is damaged; takes in damaged parts are read again."""
        return not damaged_frames(store)

    def named_parts(self, params: IngestParameters) -> Sequence[tuple[Plugins[Any], str]]:
        """Return the names of all file readers, any of which may read a file."""
        return [(READERS, name) for name in READERS]

    def run(self, context: StageContext, params: IngestParameters) -> dict[str, object]:
        """Read the new and changed files of a source in batches, each committed whole."""
        found = scan(params.source)
        if not found.motions:
            raise _no_motion_files(found, params.source)
        metadata = load_metadata(params.tables, found)
        standing = read_newest(context.store_path) if versions(context.store_path) else None
        found = without_removed(found, standing)
        mappings = chosen_mappings(params, context.feature_set.joints, context.store_path, standing)
        with context.writer() as writer:
            plan = compare_source(
                writer, context.feature_set, mappings, found, params.name, params.patterns, params.given,
                params.skeleton_files,
            )  # fmt: skip
            if plan.renamed and not params.prune:
                raise _other_names_error(plan)
            unmatched = _report_changes(context, params, found, plan)
            _declare_columns(context, writer, params, metadata)
            # report errors of a table before files are read
            metadata.join([task.described for task in plan.tasks], params.root, writer.columns)
            root = found.motions[0].root
            if not plan.renamed:
                writer.record_source(root, context.key(), params.remembered)
            done = FilesRead()
            if not (params.strict and plan.failures):
                done = ReadPasses(context, params, mappings, writer, plan).run()
            failures = [*plan.failures, *done.failures]
            files = file_table(found, motion_outcomes(found, plan, done, failures), root)
            log = log_table(failures, context.run)
            for kind, table in {"ingest_log": log, "source_files": files, "skeleton_files": plan.skeletons}.items():
                writer.put_results(kind, table, stage=context.key(), run=context.run)
            if (params.strict and failures) or not (plan.unchanged or done.takes):
                writer.commit()
                raise _ingest_error(context, params, found, failures)
            surplus = [*plan.surplus, *done.surplus]
            _report_persons(context, params, done, surplus)
            _report_unused(context, mappings, done)
            dropped = [*plan.gone, *surplus, *(take for take, _, _ in plan.renamed)] if params.prune else []
            if dropped:
                writer.drop_takes(dropped)
            # only after all takes have their new names: until then, the next run needs the former naming rule
            writer.record_source(root, context.key(), params.remembered)
            _describe(context, params, writer, plan, metadata, dropped)
            writer.commit()
            _compact(context, writer)
            total = len(writer.manifest.live_takes)
        context.message(*failure_messages(failures))
        _report_read(context, {name for names in done.takes.values() for name in names})
        return {
            "takes": total,
            "read": len(done.takes),
            "unchanged": len(plan.unchanged),
            "frames_read": done.frames,
            "left_out": len(failures),
            "not_read": len(found.unread),
            "passed_over": len(found.passed_over),
            "dropped": len(dropped),
            "unmatched": unmatched,
        }


def _ingest_error(
    context: StageContext, params: IngestParameters, found: Scan, failures: Sequence[Failure]
) -> KinedexError:
    """Return the error of an ingest that stopped at a file, or that could read no file."""
    if params.strict and failures:
        return KinedexError(f"{failures[0].message}\n(strict: stopped at this file; files before it stay in the store)")
    context.message(*failure_messages(failures))
    count = len(found.motions)
    none = f"none of the {count} files could be read" if count > 1 else "the only file could not be read"
    return KinedexError(f"{none}; the reasons are above (table ingest_log)")


def _describe(
    context: StageContext,
    params: IngestParameters,
    writer: StoreWriter,
    plan: SourceChanges,
    metadata: Metadata,
    dropped: Collection[int],
) -> None:
    """Store the metadata from patterns and tables in the rows of the source's takes; no motion file is read."""
    schema = writer.takes_schema
    writer.restate_takes(pa.Table.from_pylist(plan.restated, schema=schema))
    moved = {row["take_id"]: row for row in plan.restated}
    rows = [moved.get(row["take_id"], row) for row in writer.store.take_rows.to_pylist()]
    read = [row for row in rows if row["format"] not in RECORDED_FORMATS and row["take_id"] not in dropped]
    root = params.root
    here = [row for row in read if row["source_root"] == root]
    joined = metadata.join(here, root, writer.columns)
    changed = [
        row | ({"recipe": same_decisions(plan.recipes[row["source"]], row)} if row["source"] in plan.unchanged else {})
        for row in descriptions(params, joined).changed(here, writer.columns)
    ]
    writer.restate_takes(pa.Table.from_pylist(changed, schema=schema), described=True)
    described = {row["take_id"]: row for row in changed}
    compared = with_session_warnings([described.get(row["take_id"], row) for row in here])
    writer.restate_takes(pa.Table.from_pylist(compared, schema=schema))
    context.message(*join_lines(metadata, joined))
    if changed:
        context.message(
            f"{counted(len(changed), 'take')} described anew by patterns or metadata; no file was read for it"
        )
    if (beside := metadata_in_source(root, params.tables)) is not None:
        context.message(
            f"{beside} is not used: `--set ingest.metadata={shlex.quote(beside)}` joins its columns to takes"
        )


def _declare_columns(context: StageContext, writer: StoreWriter, params: IngestParameters, metadata: Metadata) -> None:
    """Declare the columns from named groups, tables and figures; report those that cannot be columns of takes."""
    columns: dict[str, TakeColumn] = {}
    for name, column in params.group_columns.items():
        standing = writer.manifest.columns.get(name)
        if standing is not None and standing.origin == "file":
            raise KinedexError(
                f"the named group '{name}' of `patterns` has the name of a column that this store fills from files "
                f"({standing.meaning}); give the group another name, such as 'actor'"
            )
        if (problem := column_problem(name, column, writer.manifest.columns | columns)) is None:
            columns[name] = column
        else:
            context.message(
                f"the named group '{name}' is no column of takes: {problem}; its values are in the column `groups`; "
                "give it another name in `patterns`"
            )
    writer.declare_columns(columns)
    of_tables, problems = metadata.columns(writer.columns)
    context.message(*problems)
    writer.declare_columns({name: column for name, column in of_tables.items() if name not in writer.columns})
    writer.widen_columns({name: column.type for name, column in of_tables.items()})
    figures, problems = declarable_figures(writer.columns)
    context.message(*problems)
    writer.declare_columns(figures)


def _no_motion_files(found: Scan, source: str) -> KinedexError:
    """Return the error of a source without motion files."""
    return KinedexError(
        f"no motion files ({', '.join(motion_endings())}) below {source}; is this the right folder?"
        + (f" Of {counted(found.count, 'file')}:" if found.count else " It holds no file.")
        + (f" {counted(len(found.skeletons), 'skeleton file')} (.asf) without motion." if found.skeletons else "")
        + "".join(f" {line}." for line in [*found.unread_lines(), *found.passed_over_lines()])
        + "".join(f" {refused.fault}." for refused in found.refused[:3])
    )


def _report_changes(context: StageContext, params: IngestParameters, found: Scan, plan: SourceChanges) -> int:
    """Report files to read and files that are not read, removed or renamed takes, and remembered settings.

    Returns
    -------
    int
        The number of files whose path matches no pattern.
    """
    if params.from_store:
        context.message(remembered_line(params))
    context.message(
        f"{counted(len(found.motions), 'motion file')} below {params.source}: "
        f"{len(plan.tasks)} to read, {len(plan.unchanged)} unchanged"
        + (f", {len(plan.failures)} excluded" if plan.failures else "")
    )
    if found.skeletons:
        context.message(counted(len(found.skeletons), "skeleton file"))
    context.message(*found.unread_lines(), *found.passed_over_lines())
    if plan.by_path:
        path, name = next(iter(plan.by_path.items()))
        context.message(
            f"{counted(len(plan.by_path), 'new take')} named by the path of the file, since others have its stem: "
            f"'{name}' for {path}" + (", …" if len(plan.by_path) > 1 else "")
        )
    if plan.damaged:
        again = len({task.take_id for task in plan.tasks}.intersection(plan.damaged))
        others = len(plan.damaged) - again
        context.message(
            f"{counted(len(plan.damaged), 'take')} in damaged parts of the store: {again} to read again"
            + (f"; `{shlex.join(repair(context.store_path).command)}` for the other {others}" if others else "")
        )
    if plan.gone:
        what = "dropped" if params.prune else "kept; `prune: true` drops them"
        context.message(f"{counted(len(plan.gone), 'take')} whose file is gone: {what}")
    if plan.renamed:
        takes = counted(len(plan.renamed), "take")
        context.message(f"{takes} whose file has another name now: read again, and dropped as they were")
    unmatched = unmatched_paths(params, found)
    if unmatched:
        context.message(unmatched_line(params, unmatched, found, context.store_path))
    return len(unmatched)


def _report_persons(context: StageContext, params: IngestParameters, done: FilesRead, surplus: Sequence[int]) -> None:
    """Report files with several persons, and takes of persons that their files no longer contain."""
    if done.persons:
        path, takes = next(((path, takes) for path, takes in done.takes.items() if path in done.persons), ("", []))
        context.message(
            f"{counted(len(done.persons), 'file')} of several persons, {sum(done.persons.values())} in all: a take each"
            + (f", such as '{takes[0]}' of {path}" if takes else "")
        )
    if surplus:
        what = "dropped" if params.prune else "kept; `prune: true` drops them"
        context.message(f"{counted(len(surplus), 'take')} of persons whom their files do not hold any more: {what}")


def _report_unused(context: StageContext, mappings: Mappings, done: FilesRead) -> None:
    """Report the user's own mappings that fit none of the files that were read."""
    for own in (own for several in mappings.own.values() for own in several):
        if done.takes and own.name not in done.skeletons:
            context.message(
                f"the mapping '{own.name}' ({own.path}) fits none of the files that were read; "
                "`kinedex inspect FILE --skeleton YAML` names the node that a file lacks"
            )


def _other_names_error(plan: SourceChanges) -> NewStoreError:
    """Return the error of a source whose takes the store has under other names, and would otherwise have twice."""
    _, before, now = plan.renamed[0]
    return NewStoreError(
        f"{counted(len(plan.renamed), 'take')} of this source are in the store under other names, such as '{before}' "
        f"(here '{now}'): another pipeline named them, by the parameter `name` of its ingest. Go on with the pipeline "
        "that brought them in, or use a new store; `prune: true` reads their files again under the new names and drops "
        "the takes of the old ones"
    )


def _report_read(context: StageContext, names: Collection[str]) -> None:
    """Report warnings about the takes that were read, and duplicate files among all takes."""
    if not names:
        return
    store = context.open()
    columns = store.take_columns("name", "warnings").columns
    rows = zip(*(column.to_pylist() for column in columns), strict=True)
    # paths that match no pattern were reported before files were read
    found = {name: [one for one in warnings if one != NO_PATTERN] for name, warnings in rows if name in names}
    warned = {name: warnings for name, warnings in found.items() if warnings}
    if warned:
        first, warnings = next(iter(warned.items()))
        where = shlex.quote(str(context.store_path))
        context.message(
            f"{counted(len(warned), 'take')} with warnings, such as '{first}': {warnings[0]}; "
            f"`kinedex takes {where} --columns name,warnings --where 'len(warnings) > 0'` lists them"
        )
    context.message(*session_lines(found))
    if (line := copies_line(store)) is not None:
        context.message(line)


def _compact(context: StageContext, writer: StoreWriter) -> None:
    done = compact(writer, spread=context.executor.map, workers=context.executor.workers)
    for fault in done.damaged:
        context.message(f"not compacted: {fault}")
    if done.changed:
        context.message(
            f"compacted: {done.frames_before} frames parts to {done.frames_after}, {done.takes_before} takes parts to "
            f"{done.takes_after}; `kinedex gc {context.store_path}` removes the old files"
        )
