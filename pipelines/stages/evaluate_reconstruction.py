"""Stage evaluate_reconstruction: compare reconstructed takes with the truth, where it is known."""

from __future__ import annotations

from pathlib import Path
from typing import Any, ClassVar

from kinedex.catalog.depth_recordings import DepthRecordingsFile, load_depth_recordings
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest, hash_of
from kinedex.pipelines.engine.display import ResultTable
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.reconstruction.reconstruction_errors import (
    Comparison,
    compare_with_truth,
    error_rows,
    stored_reconstruction,
)
from kinedex.pipelines.tracking.recorded_takes import TruthParameters, every_take
from kinedex.pipelines.tracking.recording_runs import earlier_rows
from kinedex.storage.formats.depth.recording import recording_truth
from kinedex.storage.snapshot.schemas import result_table
from kinedex.storage.store.store import Store


class EvaluateReconstruction(Stage[TruthParameters]):
    """Compares reconstructed takes with the truth, where it is known (thesis, Eq. 8.10)."""

    name = "evaluate_reconstruction"
    parameters = TruthParameters
    inputs: ClassVar = {"reconstructions": Input("reconstruct")}

    def external_digest(self, params: TruthParameters, store: Store | None) -> str:
        """Return a hash of the files of truth, and of the settings of the recordings that name them."""
        parts = store.manifest.results.get("reconstructions", ()) if store is not None else ()
        stages = sorted({part.stage for part in parts})
        rows = [row for stage in stages for row in earlier_rows(store, "reconstructions", stage)] if store else []
        stated, files = [], {Path(params.truth).expanduser()} if params.truth else set()
        for path, name in sorted({(str(row["file"]), str(row["recording"])) for row in rows if row["file"]}):
            try:
                file = load_depth_recordings(path)
                entry, truth = file.entry(name), recording_truth(file, name)
            except KinedexError:
                continue  # the recording no longer exists, nor does its truth
            stated.append((path, name, entry.model_dump(include={"truth", "truth_pose", "markers"})))
            files |= {truth} if isinstance(truth, Path) else set()
        return hash_of(stated, files_digest(sorted(file for file in files if file.is_file())))

    def reading(self, params: TruthParameters, store: Store) -> Reading:
        """Return a digest of all takes, any of which can be the truth."""
        return every_take(store)

    def run(self, context: StageContext, params: TruthParameters) -> dict[str, object]:
        """Compare every take whose truth is known, and store the errors."""
        store = context.open()
        stage = context.key(context.inputs["reconstructions"])
        found: list[Comparison] = []
        without = []
        for row in earlier_rows(store, "reconstructions", stage):
            frames = store.rows_of("reconstruction_frames", stage, "take_id", [int(str(row["take_id"]))])
            file = _file_of(row)
            known = (
                None
                if file is None
                else compare_with_truth(store, stored_reconstruction(row, frames), file, params.truth)
            )
            if known is None:
                without.append(row["take"])
            else:
                found.append(known)
        rows = error_rows(found)
        context.put_results(reconstruction_errors=result_table("reconstruction_errors", rows, context.run))
        if found:
            context.terminal.show(_table(rows))
        else:
            context.message(
                "no truth is known: set `truth` of the recording, or of this stage, to a take or a motion file"
            )
        takes = {row["take"]: round(row["mean_m"], 5) for row in rows if row["scope"] == "take"}
        return {"takes": takes, "without_truth": without}


def _file_of(row: dict[str, Any]) -> DepthRecordingsFile | None:
    """Return the recordings file of a take; None if the recording no longer exists."""
    if row["file"] is None or not Path(row["file"]).is_file():
        return None
    file = load_depth_recordings(row["file"])
    return file if row["recording"] in file.recordings else None


def _table(rows: list[dict[str, Any]]) -> ResultTable:
    """Return a table of errors with a row for each take, and one for all takes together."""
    table = ResultTable(("take", "mean cm", "median", "90 %", "off by > 10 cm", "five ends", "frames", "unseen"))
    for row in rows:
        if row["scope"] in ("take", "all") and row["frames"]:
            rate = row["rate_five_ends"]
            table.add(
                row.get("take") or "all",
                *(f"{100 * row[name]:.1f}" for name in ("mean_m", "median_m", "p90_m")),
                f"{row['over_10cm']:.1%}",
                "–" if rate is None else f"{rate:.0%}",
                str(row["frames"]),
                str(row["unseen_frames"]),
            )
    return table
