"""Repair a store: find damage, and make everything again that can be made again.

The steps are ordered such that the store can be opened at any moment, and that a repair that was killed continues when
it is run again: each step begins with the damage that remains. Manifests come first, then rows of takes, frames,
results, the index, and the pipelines whose results were removed. Whatever cannot be made again is put into a quarantine
before the version without it is published.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import pyarrow as pa

from kinedex.ops.errors import KinedexError
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.engine.display import Display
from kinedex.pipelines.engine.executors import make_executor
from kinedex.pipelines.engine.runner import run_pipeline
from kinedex.pipelines.ingestion.file_batches import read_batch
from kinedex.pipelines.ingestion.take_sources import Sources, ingest_settings, known_stages, pipeline_text
from kinedex.pipelines.tracking.recording_runs import stages_of_takes
from kinedex.storage.durable_files import TEMPORARY, sync_file, whole_file, write_errors
from kinedex.storage.index.builder import build_index
from kinedex.storage.lock import NO_WAIT, Lock, Wait
from kinedex.storage.remedies import repair
from kinedex.storage.repair.manifests import BadManifest, bad_manifests, newest_sound, set_aside
from kinedex.storage.repair.quarantine import KeptFile, LostTake, PendingRun, Quarantine, quarantines
from kinedex.storage.repair.restored_rows import restored_labels, restored_rows, sound_takes, with_rows, without_flip
from kinedex.storage.snapshot.label_journal import empty, read_journals
from kinedex.storage.snapshot.manifest import Manifest, Part, kinedex_version, now, running_command
from kinedex.storage.snapshot.manifest_files import publish, require_current_format
from kinedex.storage.snapshot.parts import FramesWriter
from kinedex.storage.snapshot.schemas import frames_schema
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.verification import Finding, verify
from kinedex.storage.store.writer import StoreWriter


@dataclass
class RepairResult:
    """The result of a repair or, in a dry run, its plan.

    Attributes
    ----------
    store : Path
        The store's directory.
    found : list of Finding
        The damage.
    lines : list of str
        Descriptions of what was done, or would be done.
    lost : list of LostTake
        The takes that could not be made again.
    kept : list of KeptFile
        The damaged files that were put into the quarantine.
    failed_runs : list of PendingRun
        The pipelines that could not be run again.
    remaining : list of Finding
        The damage that remains; empty in a dry run.
    """

    store: Path
    found: list[Finding] = field(default_factory=list)
    lines: list[str] = field(default_factory=list)
    lost: list[LostTake] = field(default_factory=list)
    kept: list[KeptFile] = field(default_factory=list)
    failed_runs: list[PendingRun] = field(default_factory=list)
    remaining: list[Finding] = field(default_factory=list)


def repair_store(
    path: str | Path,
    terminal: Display,
    *,
    dry_run: bool = False,
    executor: str = "serial",
    workers: int | None = None,
    wait: Wait = NO_WAIT,
) -> RepairResult:
    """Repair a store; an undamaged store is not changed.

    Parameters
    ----------
    path : str or Path
        The directory of the store.
    terminal : Display
        Shows messages and progress.
    dry_run : bool, optional
        Change nothing; only report what is damaged and what would be done.
    executor : {"serial", "processes", "dask"}, optional
        The executor of reading and of stages.
    workers : int, optional
        The number of workers.
    wait : Wait, optional
        The time to wait for another writer.

    Raises
    ------
    KinedexError
        There is no store, all of its versions are damaged, another writer is active, or it has an older format.
    """
    root = Path(path)
    bad = bad_manifests(root)
    work = _Work(root, terminal, executor, workers, wait)
    problems = ((one.file, f"the manifest is damaged: {one.problem}") for one in bad)
    work.outcome.found = [Finding(file, problem, repair(root), "manifest") for file, problem in problems]
    work.outcome.found += [one for one in verify(Store(root, newest_sound(root, bad))) if one.kind != "manifest"]
    if dry_run:
        work.report_plan(bad)
    else:
        work.repair(bad)
    return work.outcome


class _Work:
    """One repair in progress."""

    def __init__(self, root: Path, terminal: Display, executor: str, workers: int | None, wait: Wait) -> None:
        self.root = root
        self.terminal = terminal
        self.executor = executor
        self.workers = workers
        self.wait = wait
        self.quarantine = Quarantine.new(root)
        self.outcome = RepairResult(root)
        self.mended: set[str] = set()
        self.tracking: set[str] = set()

    def message(self, line: str) -> None:
        self.outcome.lines.append(line)
        self.terminal.message(line)

    def repair(self, bad: list[BadManifest]) -> None:
        """Run all steps of the repair."""
        require_current_format(self.root, newest_sound(self.root, bad))
        with Lock(self.root / "lock", "this repair", self.wait):
            self._manifests(bad)
            self._flipped_bits()
            self._labels()
            self._take_rows()
            self._leftovers()
        self._frames()
        self._results()
        self._index()
        self._runs()
        self.outcome.lost = self.quarantine.takes
        self.outcome.kept = [
            file for one in quarantines(self.root) if one.name == self.quarantine.name for file in one.files
        ]
        self.outcome.remaining = [one for one in verify(open_store(self.root, at="newest")) if one.fault]

    def report_plan(self, bad: list[BadManifest]) -> None:
        """Report what a repair would do."""
        store = Store(self.root, newest_sound(self.root, bad))
        for one in bad:
            self.message(f"{one.file} would go into the quarantine" + _lost_parts(one))
        wrong = [part for part in store.manifest.takes if part.path in self._damaged("takes")]
        if wrong:
            rows = restored_rows(store, wrong)
            self.message(
                f"the rows of {counted(rows.rows.num_rows, 'take')} would be restored, {len(rows.lost)} would be lost"
            )
        take_ids = {take for one in self.outcome.found if one.kind in ("frames", "content") for take in one.takes}
        if take_ids and not wrong:
            found = self._sources(store).find(take_ids)
            count = sum(len(batch.tasks) for batch in found.batches)
            self.message(f"{counted(count, 'take')} would be read again from their sources")
            for take in found.lost:
                self.message(f"take {take.name} could not be read again: {take.why}")
            self.outcome.lost = found.lost
        for stage in sorted({*self._hit_stages(store)}):
            self.message(f"the stage {stage} would run again")
        if any(one.kind == "index" for one in self.outcome.found) or take_ids:
            self.message("the index would be built again")

    def _manifests(self, bad: list[BadManifest]) -> None:
        if not bad:
            return
        newest = newest_sound(self.root, bad)
        set_aside(self.quarantine, bad)
        for one in bad:
            if one.version > newest.version:
                changes = f": {one.changes}" if one.changes else ""
                self.message(
                    f"version {one.version} is lost, whose manifest is damaged{changes}; the store is at version "
                    f"{newest.version} of {newest.created}{_lost_parts(one)}"
                )
            else:
                self.message(f"{one.file} is damaged and lies in the quarantine; no newer version needs it")

    def _flipped_bits(self) -> None:
        """Restore small files in which a single bit was flipped, as verified by their checksums."""
        parts = {part.path: part for part in open_store(self.root, at="newest").manifest.parts}
        for one in list(self.outcome.found):
            path = self.root / one.file
            if one.file not in parts or not path.is_file() or path.stat().st_size != parts[one.file].bytes:
                continue
            content = without_flip(path.read_bytes(), parts[one.file].sha256)
            if content is not None:
                with write_errors(path), whole_file(path) as temporary:
                    temporary.write_bytes(content)
                    sync_file(temporary)
                self.mended.add(one.file)
                self.message(f"{one.file}: one bit was flipped, and is as it was")

    def _labels(self) -> None:
        """Restore labels from damaged parts; as labels are primary data, the damaged parts are kept in any case."""
        store = open_store(self.root, at="newest")
        wrong = [part for part in store.manifest.labels if part.path in self._damaged("labels")]
        lines = [one for one in read_journals(self.root) if one.damaged]
        if not wrong and not lines:
            return
        for part in wrong:
            self._keep(part.path, "the part of labels is damaged", counted(part.rows, "label"), part.sha256)
        for one in lines:
            file = one.path.relative_to(self.root).as_posix()
            self._keep(
                file,
                "a line of the journal of labels is damaged",
                f"{counted(len(one.rows), 'label')} and damaged lines",
            )
        restored = restored_labels(store, wrong)
        self._publish(restored.manifest, {})
        for one in restored.journals:
            empty(one)
        if wrong:
            self.message(
                f"restored {counted(restored.restored, 'label')} from older versions; {restored.lost} are lost"
            )
        for one in lines:
            lost = counted(len(one.damaged), "line")
            self.message(f"{lost} of the journal of labels cannot be read; they are kept in {self.quarantine.folder}")

    def _damaged(self, kind: str) -> set[str]:
        """Return the files with findings of a kind that are still damaged."""
        return {one.file for one in self.outcome.found if one.kind == kind} - self.mended

    def _take_rows(self) -> None:
        """Restore the rows of takes whose parts are damaged; writing to the store requires these rows."""
        store = open_store(self.root, at="newest")
        wrong = [part for part in store.manifest.takes if part.path in self._damaged("takes")]
        if not wrong:
            return
        restored = restored_rows(store, wrong)
        if restored.lost:
            for part in wrong:
                self._keep(
                    part.path,
                    "the part of takes is damaged",
                    f"the rows of {counted(len(part.live), 'take')}",
                    part.sha256,
                )
            for part in store.manifest.frames:
                if not set(restored.lost).isdisjoint(part.live):
                    self._keep(part.path, "the rows of its takes are lost", "the frames of these takes", part.sha256)
            self.quarantine.takes += [LostTake("", take, "", "its row is lost") for take in restored.lost]
            self.quarantine.write()
            self.message(
                f"{counted(len(restored.lost), 'take')} lost their rows; an ingest reads their files as new takes"
            )
        manifest = with_rows(store, wrong, restored)
        if manifest != store.manifest:
            self._publish(manifest, {"takes_dropped": len(restored.lost)} if restored.lost else {})
        if restored.rows.num_rows:
            self.message(f"restored the rows of {counted(restored.rows.num_rows, 'take')}")

    def _publish(self, manifest: Manifest, changes: dict[str, object]) -> None:
        """Publish a version that a regular writer could not make, because the store cannot be read completely."""
        publish(
            self.root,
            replace(
                manifest, version=manifest.version + 1, created=now(), changes=changes, kinedex=kinedex_version(),
                command=running_command(),
            ),
        )  # fmt: skip

    def _leftovers(self) -> None:
        """Put files that no version names into the quarantine, and remove temporary files of killed runs."""
        for one in self.outcome.found:
            if one.kind == "leftover" and (self.root / one.file).is_file():
                if Path(one.file).name.startswith(TEMPORARY):
                    (self.root / one.file).unlink()
                    continue
                self._keep(one.file, one.problem, "unknown")
                (self.root / one.file).unlink(missing_ok=True)
                self.message(f"{one.file} lies in the quarantine: {one.problem}")

    def _frames(self) -> None:
        """Read takes in damaged parts of frames again."""
        store = open_store(self.root, at="newest")
        wrong = [part for part in store.manifest.frames if part.path in self._damaged("frames")]
        single = {take for one in self.outcome.found if one.kind == "content" for take in one.takes}
        if not wrong and not single:
            return
        # if takes have other lengths than their rows state, the number of rows to drop from the part is unknown
        wrong += [part for part in store.manifest.frames if part not in wrong and not single.isdisjoint(part.live)]
        with StoreWriter.open(self.root, store.feature_set, store.rate_hz, self.wait) as writer:
            sources = self._sources(writer.store)
            rows = set(writer.store.take_frames)
            for part in wrong:
                self._read_again(writer, sources, rows.intersection(part.live), part)
            single -= {take for part in wrong for take in part.live if take in rows}
            if single & rows:
                self._read_again(writer, sources, single & rows, None)
            nameless = (single - rows) & set(writer.manifest.live_takes)
            if nameless:
                writer.drop_takes(nameless)
            writer.commit()

    def _read_again(self, writer: StoreWriter, sources: Sources, takes: Iterable[int], part: Part | None) -> None:
        """Read takes again, replace their rows in a part, and commit."""
        found = sources.find(takes)
        lost = list(found.lost)
        pool = make_executor(self.executor, self.workers)
        names: list[str] = []
        for batch, written in zip(found.batches, pool.map(read_batch, found.batches), strict=True):
            rows = {row["take_id"]: row for row in written.takes}
            for task in batch.tasks:
                if task.take_id in rows:
                    names.append(task.name)
                else:
                    whys = [one.message for one in written.failures if one.subject == (task.motion.path, task.person)]
                    lost.append(LostTake(task.name, task.take_id, str(task.motion.absolute), "".join(whys[:1])))
            if written.part is None or (part is not None and written.part.sha256 == part.sha256):
                continue  # the part has its content again, under the same name
            table = pa.Table.from_pylist([_same_row(sources, row) for row in written.takes], schema=writer.takes_schema)
            writer.add_takes(table, written.part)
        pool.close()
        if lost and part is not None:
            lost = self._salvaged(writer, sources, lost, part)
        if lost:
            self._give_up(writer, lost, part)
        writer.commit()
        if names:
            self.message(f"read {counted(len(names), 'take')} again from their sources: {name_list(names)}")
        if found.otherwise:
            self.message(
                f"read otherwise than before, since kinedex or a mapping has changed: {name_list(found.otherwise)}"
            )

    def _salvaged(self, writer: StoreWriter, sources: Sources, lost: list[LostTake], part: Part) -> list[LostTake]:
        """Put rows of lost takes that are verifiably right into a new part, and return the remaining lost takes."""
        manifest = writer.manifest
        schema = frames_schema(manifest.feature_set, manifest.rate_hz)
        frames = writer.store.take_frames
        found = sound_takes(self.root / part.path, schema, [take.take_id for take in lost], frames)
        if found:
            with FramesWriter(self.root, manifest.feature_set, manifest.rate_hz) as file:
                for take, rows in found.items():
                    file.add_table(take, rows)
                made = file.close()
            table = pa.Table.from_pylist([sources.row(take) for take in found], schema=writer.takes_schema)
            writer.add_takes(table, made)
            names = [take.name for take in lost if take.take_id in found]
            self.message(
                f"kept {counted(len(names), 'take')} of the damaged part whose rows are right: {name_list(names)}"
            )
        return [take for take in lost if take.take_id not in found]

    def _give_up(self, writer: StoreWriter, lost: list[LostTake], part: Part | None) -> None:
        """Drop takes that cannot be read again, after the damaged part and their names were put into the quarantine."""
        if part is not None:
            held = f"the frames of {name_list([take.name for take in lost])}"
            self._keep(part.path, "the part of frames is damaged", held, part.sha256)
        self.quarantine.takes += lost
        self.quarantine.write()
        self.tracking |= stages_of_takes(writer.store, {take.take_id for take in lost})
        writer.drop_takes([take.take_id for take in lost])
        for take in lost:
            self.message(f"take {take.name} is lost: {take.why}")

    def _results(self) -> None:
        """Remove the results of stages with damaged parts, and record the pipelines that must run again."""
        store = open_store(self.root, at="newest")
        stages = self._hit_stages(store)
        if not stages:
            return
        records = known_stages(self.root)
        for stage in sorted(stages):
            parts = [part for parts in store.manifest.results.values() for part in parts if part.stage == stage]
            bad = [part for part in parts if part.path in stages[stage]]
            for part in parts if stage in records else bad:
                why = "is damaged" if part in bad else "belongs to the same results as a damaged one"
                self._keep(part.path, f"the part of results {why}", f"results of {stage}", part.sha256, stage)
        pipelines: dict[str, list[str]] = {}
        for stage in sorted(set(stages) & set(records)):
            pipelines.setdefault(stage.partition("/")[0], []).append(stage)
        for name, those in pipelines.items():
            file = self.quarantine.write_file(f"{name}.yaml", pipeline_text(records, name))
            self.quarantine.runs.append(PendingRun(those, file))
            self.quarantine.write()
        with StoreWriter.open(self.root, store.feature_set, store.rate_hz, self.wait) as writer:
            for stage, bad_paths in stages.items():
                for kind, parts_of_kind in store.manifest.results.items():
                    own = [part for part in parts_of_kind if part.stage == stage]
                    stay = [] if stage in records else [part for part in own if part.path not in bad_paths]
                    if own:
                        writer.put_results(kind, stay, stage=stage, run="")
                if stage in records:
                    writer.forget_stage(stage)
                else:
                    self.message(f"the results of {stage} are lost: no pipeline made them; make them again by hand")
            writer.commit()

    def _index(self) -> None:
        """Build the index if it is missing, stale or damaged."""
        store = open_store(self.root, at="newest")
        wrong = {one.file.split("/")[1] for one in self.outcome.found if one.kind == "index" and one.fault}
        for name in wrong:
            shutil.rmtree(self.root / "index" / name, ignore_errors=True)
        if not store.manifest.live_takes:
            return
        before = _generations(self.root)
        build_index(store)
        if before != _generations(self.root):
            self.message("built the index again")

    def _runs(self) -> None:
        """Run the pipelines whose results were removed by this repair or by an interrupted one."""
        for quarantine in quarantines(self.root):
            for run in quarantine.runs:
                if not run.done and self._has_run(run):
                    quarantine.finish(run)

    def _has_run(self, run: PendingRun) -> bool:
        """Run a pipeline, and return whether it succeeded."""
        try:
            run_pipeline(
                self.root / run.file, self.root, assignments={}, executor=self.executor, workers=self.workers,
                terminal=self.terminal, wait_seconds=self.wait.seconds,
            )  # fmt: skip
        except KinedexError as fault:
            self.outcome.failed_runs.append(run)
            self.message(f"the results of {name_list(run.stages)} could not be made again: {fault}")
            return False
        self.message(f"made the results of {name_list(run.stages)} again")
        return True

    def _hit_stages(self, store: Store) -> dict[str, set[str]]:
        """Return the stages with damaged results or reports, each with the paths of its damaged parts."""
        wrong = self._damaged("results") | self._damaged("report")
        found: dict[str, set[str]] = {}
        for parts in store.manifest.results.values():
            for part in parts:
                if part.path in wrong:
                    found.setdefault(part.stage, set()).add(part.path)
        for name in self.tracking:
            found.setdefault(name, set())
        for name, record in store.manifest.stages.items():
            if not wrong.isdisjoint(record.summary.get("files", ())):
                found.setdefault(name, set())
        return found

    def _sources(self, store: Store) -> Sources:
        return Sources(store, ingest_settings(store.manifest, known_stages(self.root)))

    def _keep(self, file: str, why: str, held: str, sha256: str = "", stage: str = "") -> None:
        self.quarantine.keep(KeptFile(file, why, held, sha256, stage))


def _lost_parts(bad: BadManifest) -> str:
    return f"; {counted(len(bad.lost), 'part')} that only it names go into the quarantine" if bad.lost else ""


def _same_row(sources: Sources, row: dict[str, object]) -> dict[str, object]:
    """Return the former row of a take; if its frames differ now, return the new row with the former metadata."""
    before = sources.row(int(str(row["take_id"])))
    same = all(row[name] == before[name] for name in ("frames", "invalid_frames", "recipe"))
    return before if same else row | {name: before[name] for name in sources.describing if name in before}


def _generations(root: Path) -> list[str]:
    with suppress(FileNotFoundError):
        return sorted(path.name for path in (root / "index").iterdir() if path.is_dir())
    return []
