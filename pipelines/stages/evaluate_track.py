"""Stage evaluate_track: compare tracked and stabilised takes with the truth and with worn sensors, where known."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.tracking.observed_recordings import stored_rows
from kinedex.pipelines.tracking.recorded_takes import TruthParameters, every_take
from kinedex.pipelines.tracking.recording_runs import earlier_rows
from kinedex.pipelines.tracking.tracked_takes import (
    SENSORS,
    STABILISED,
    TRACKED,
    poses_of,
    sensor_error_statistics,
    track_errors,
    truth_reference,
)
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.store.store import Store


class EvaluateTrack(Stage[TruthParameters]):
    """Compares tracked and stabilised takes with the truth and with worn sensors, where known."""

    name = "evaluate_track"
    parameters = TruthParameters
    inputs: ClassVar = {
        "tracks": Input("track"),
        "stabilised": Input("stabilise", optional=True),
        "errors": Input("limb_errors", optional=True),
    }

    def external_digest(self, params: TruthParameters, store: Store | None) -> str:
        """Return a hash of the files of truth."""
        rows = stored_rows(store).values() if store is not None else ()
        names = [(params.truth or row["truth"], Path(row["file"]).parent) for row in rows]
        files = sorted({folder / Path(name).expanduser() for name, folder in names if name})
        return files_digest(file for file in files if file.is_file())

    def reading(self, params: TruthParameters, store: Store) -> Reading:
        """Return a digest of all takes, any of which can be the truth."""
        return every_take(store)

    def run(self, context: StageContext, params: TruthParameters) -> dict[str, object]:
        """Compare every take with known truth or worn sensors, and store the errors."""
        store = context.open()
        recordings = stored_rows(store)
        rows: list[dict[str, Any]] = []
        without = []
        tracked: set[int] = set()
        for role in ("tracks", "stabilised"):
            if role not in context.inputs:
                continue
            stage = context.key(context.inputs[role])
            for row in earlier_rows(store, "tracks", stage):
                tracked.add(int(str(row["take_id"])))
                known = recordings.get(str(row["recording"]), {})
                truth = params.truth or known.get("truth")
                if truth is None:
                    without.append(row["take"])
                    continue
                folder = Path(known["file"]).parent if known and params.truth is None else Path()
                reference = truth_reference(store, truth, folder, known.get("recording"))
                rows += track_errors(row, poses_of(store, stage, int(str(row["take_id"]))), reference)
        judged: list[dict[str, Any]] = []
        if "errors" in context.inputs:
            judged = sensor_error_statistics(store, context.key(context.inputs["errors"]), tracked)
        context.put_results(track_metrics=result_table("track_metrics", [*rows, *judged], context.run))
        takes = [row for row in rows if row["scope"] == "take"]
        if takes:
            context.terminal.show(_table(rows))
        if judged:
            context.terminal.show(_sensor_table(judged))
        if not takes and not judged:
            context.message(
                "no truth is known: set `truth` of the recording, or of this stage, to a take or a motion file"
            )
        wholes = [row for row in judged if row["scope"] == SENSORS]
        return {
            "takes": {row["take"]: round(row["mean_mm"], 3) for row in takes},
            "without_truth": without,
            **({"degrees": {row["take"]: round(row["mean_deg"], 3) for row in wholes}} if wholes else {}),
        }


def _sensor_table(rows: list[dict[str, Any]]) -> ResultTable:
    """Return a table with a row for each take and each limb: the angles between take and sensors, in degrees."""
    table = ResultTable(("take", "limb", "mean °", "sd", "median", "max"), texts=frozenset({0, 1}))
    for row in sorted(rows, key=lambda row: (_subject(row["take"]), -row["take"].endswith(TRACKED))):
        texts = (f"{row[name]:.1f}" for name in ("mean_deg", "sd_deg", "median_deg", "max_deg"))
        table.add(row["take"], row["name"], *texts)
    return table


def _table(rows: list[dict[str, Any]]) -> ResultTable:
    """Return a table with a row for each take: the distances of its limbs from the truth, in millimetres."""
    table = ResultTable(("take", "mean mm", "sd", "max", "in failures", "elsewhere"))
    parts = {(row["take"], row["name"]): row["mean_mm"] for row in rows if row["scope"] == "part"}
    for row in sorted(rows, key=lambda row: (_subject(row["take"]), -row["take"].endswith(TRACKED))):
        if row["scope"] == "take":
            numbers = [row["mean_mm"], row["sd_mm"], row["max_mm"]]
            numbers += [parts.get((row["take"], name)) for name in ("in failures", "elsewhere")]
            texts = ["–" if one is None else f"{one:.1f}" for one in numbers]
            table.add(row["take"], *texts)
    return table


def _subject(take: str) -> str:
    """Return a take's name without the suffix that marks tracked or stabilised takes."""
    return take.removesuffix(TRACKED).removesuffix(STABILISED)
