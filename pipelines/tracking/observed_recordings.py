"""Read camera recordings from their files into a store, and later from the store's results."""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc

from kinedex.catalog.camera_recordings import CameraRecording, RecordingsFile, load_recordings
from kinedex.catalog.cameras import Camera
from kinedex.catalog.configs import config_path
from kinedex.catalog.keypoint_sets import load_keypoint_set
from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.pipelines.tracking.recorded_takes import Provenance, stamp_of
from kinedex.storage.formats.cameras.recording import Recording, RecordingCounts, read_recording, recording_files
from kinedex.storage.formats.motion.sources import checksum
from kinedex.storage.snapshot.schemas import columns_table, result_schema, result_table
from kinedex.storage.store.store import Store


def named_files(file: RecordingsFile, name: str) -> list[tuple[str, Path]]:
    """Return the files of a recording with their kinds: recordings, cameras, keypoints, silhouettes.

    Raises
    ------
    ConfigError
        A key does not name a file.
    """
    given = file.entry(name)
    found = [("recordings", Path(file.located.path))]
    for kind in ("cameras", "keypoints", "silhouettes"):
        if getattr(given, kind) is not None:
            files = recording_files(file, name, kind).files
            found += [(kind, path) for paths in files.values() for path in paths]
    keypoint_set = file.keypoint_set(name)
    if isinstance(keypoint_set, Path):
        found.append(("keypoint set", config_path("keypoints", keypoint_set)))
    return found


def files_stamp(file: RecordingsFile, name: str) -> str:
    """Return a hash of the settings of a recording, and of its files by path, size and time."""
    return stamp_of((name, file.entry(name).model_dump(mode="json")), named_files(file, name)[1:])


@dataclass(frozen=True, eq=False)
class ReadRecording:
    """A recording that was read, with its files.

    Attributes
    ----------
    given : CameraRecording
        Its entry of the recordings file.
    file : Path
        The recordings file.
    recording : Recording, optional
        The recording; None for a 3D track.
    files : tuple of (str, Path, int, str)
        Kind, path, size and SHA-256 of each file.
    name : str
        Its name.
    fingerprint : str
        A hash of everything that was read.
    """

    given: CameraRecording
    file: Path
    recording: Recording | None
    files: tuple[tuple[str, Path, int, str], ...]
    name: str
    fingerprint: str

    @property
    def checksum(self) -> str:
        """A hash of the settings, and of the contents of all files except the recordings file."""
        own = [(kind, sha) for kind, _, _, sha in self.files if kind != "recordings"]
        text = json.dumps([own, self.given.model_dump(mode="json")], sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def row(self) -> dict[str, Any]:
        """Return the row of the recording in the results `recordings`."""
        found, given = self.recording, self.given
        return {
            "recording": self.name,
            "rate_hz": given.rate_hz if found is None else found.rate_hz,
            "source_frames": None if found is None else found.frames,
            "first_frame": 0 if found is None else found.first_frame,
            "cameras": [] if found is None else [camera.name for camera in found.cameras],
            "keypoint_set": None if found is None or found.keypoint_set is None else self._set_name(found),
            "keypoints": [] if found is None else list(found.keypoints),
            "silhouettes": found is not None and found.masks is not None,
            "cuts": list(given.cuts) if found is None else list(found.cuts),
            "track": given.track,
            "body": given.body,
            "truth": given.truth,
            "file": str(self.file),
            "remarks": [] if found is None else remarks_of(found),
            "checksum": self.checksum,
            "fingerprint": self.fingerprint,
        }

    def _set_name(self, found: Recording) -> str:
        assert found.keypoint_set is not None
        path = next((str(path) for kind, path, _, _ in self.files if kind == "keypoint set"), None)
        return path or found.keypoint_set.name

    def table(self, kind: str, run: str) -> pa.Table:
        """Return the rows of one kind of results of the recording."""
        rows: list[dict[str, Any]]
        if kind == "recordings":
            rows = [self.row()]
        elif kind == "recording_files":
            rows = [
                {"recording": self.name, "kind": what, "path": str(path), "bytes": size, "checksum": sha}
                for what, path, size, sha in self.files
            ]
        elif kind == "cameras":
            rows = [] if self.recording is None else [
                {"recording": self.name, "camera": one.name, "number": number, "width": one.size[0],
                 "height": one.size[1], "matrix": one.matrix.ravel().tolist(), "distortion": one.distortion.tolist(),
                 "rotation": one.rotation.ravel().tolist(), "translation": one.translation.tolist(),
                 "centre": one.centre.tolist()}
                for number, one in enumerate(self.recording.cameras)
            ]  # fmt: skip
        else:
            return self._observations(run)
        return result_table(kind, rows, run)

    def _observations(self, run: str) -> pa.Table:
        found = self.recording
        if found is None or not found.keypoints:
            return result_schema("observations").empty_table()
        frames, cameras, points = np.nonzero((found.confidence > 0) & np.isfinite(found.pixels).all(axis=3))
        names = pa.array([camera.name for camera in found.cameras]), pa.array(found.keypoints)
        pixels = found.pixels[frames, cameras, points]
        columns = {
            "camera": names[0].take(pa.array(cameras)),
            "source_frame": pa.array(frames, pa.int32()),
            "keypoint": names[1].take(pa.array(points)),
            "x": pa.array(pixels[:, 0]),
            "y": pa.array(pixels[:, 1]),
            "confidence": pa.array(found.confidence[frames, cameras, points]),
        }
        return columns_table("observations", columns, run=run, recording=self.name)


RECORDING_KINDS = ("recordings", "recording_files", "cameras", "observations")
"""The kinds of results that a recording has."""


def read_named(file: RecordingsFile, name: str, code: str) -> ReadRecording:
    """Read a recording with all its files.

    Raises
    ------
    KinedexError
        A file or a setting is invalid.
    """
    stamp = recording_fingerprint(file, name, code)
    given = file.entry(name)
    files = tuple((kind, path, path.stat().st_size, checksum(path)) for kind, path in named_files(file, name))
    recording = None if given.track is not None else read_recording(file, name)
    return ReadRecording(given, Path(file.located.path).absolute(), recording, files, name, stamp)


def recording_fingerprint(file: RecordingsFile, name: str, code: str) -> str:
    """Return a hash of everything that a recording is read from."""
    return hashlib.sha256(f"{code} {file.located.path} {files_stamp(file, name)}".encode()).hexdigest()[:32]


def remarks_of(recording: Recording) -> list[str]:
    """Return the remarks on a recording: its notes, and irregularities that were counted."""
    counts: RecordingCounts = recording.counts
    phrases = {
        "images_without_person": "images without a person",
        "keypoints_without_confidence": "keypoints without a confidence, which count as 1",
        "confidences_above_one": "confidences above 1, which count as 1",
        "keypoints_outside_image": "keypoints outside their image",
    }
    odd = [f"{getattr(counts, key):,} {text}" for key, text in phrases.items() if getattr(counts, key)]
    return [*recording.notes, *odd]


@dataclass(frozen=True, eq=False)
class StoredRecording:
    """A recording that was read from a store.

    Attributes
    ----------
    row : dict
        Its row of the results `recordings`.
    recording : Recording, optional
        The recording; None for a 3D track.
    provenance : Provenance
        Its files, as the origin of a track.
    """

    row: dict[str, Any]
    recording: Recording | None
    provenance: Provenance

    @property
    def name(self) -> str:
        """The name of the recording."""
        return str(self.row["recording"])


def stored_rows(store: Store, stage: str | None = None) -> dict[str, dict[str, Any]]:
    """Return the rows of recordings by name: those of a stage, or the most recently read ones."""
    found: dict[str, tuple[str, dict[str, Any]]] = {}
    for part in store.manifest.results.get("recordings", ()):
        if stage is None or part.stage == stage:
            for rows in store.result_pieces("recordings", [part]):
                for row in rows.to_pylist():
                    if row["recording"] not in found or found[row["recording"]][0] <= part.run:
                        found[row["recording"]] = part.run, {**row, "stage": part.stage}
    return {name: row for name, (_, row) in sorted(found.items())}


def stored_recording(store: Store, name: str, stage: str | None = None) -> StoredRecording:
    """Return a recording of a store.

    Parameters
    ----------
    store : Store
        The store.
    name : str
        The name of the recording.
    stage : str, optional
        The stage that has observed it, "<pipeline>/<stage>"; by default the stage that did so last.

    Raises
    ------
    KinedexError
        The store has no such recording, or the file of its keypoint set or silhouettes no longer exists.
    """
    rows = stored_rows(store, stage)
    if name not in rows:
        raise KinedexError(
            f"{store.path}: no recording '{name}'{did_you_mean(name, rows)}; `kinedex track {store.path} FILE` reads "
            "those of a recordings file"
        )
    row = rows[name]
    provenance = _provenance(store, row)
    if row["track"] is not None:
        return StoredRecording(row, None, provenance)
    cameras = tuple(
        Camera(
            one["camera"], np.array(one["matrix"]).reshape(3, 3), np.array(one["distortion"], np.float64),
            np.array(one["rotation"]).reshape(3, 3), np.array(one["translation"]), (one["width"], one["height"]),
        )
        for one in sorted(_rows(store, "cameras", row).to_pylist(), key=lambda one: int(one["number"]))
    )  # fmt: skip
    shape = (row["source_frames"], len(cameras), len(row["keypoints"]))
    pixels, confidence = _observed(_rows(store, "observations", row), row, shape)
    recording = Recording(
        name, cameras, row["rate_hz"], row["first_frame"],
        None if row["keypoint_set"] is None else load_keypoint_set(row["keypoint_set"]),
        tuple(row["keypoints"]), pixels, confidence,
        read_recording(load_recordings(row["file"]), name).masks if row["silhouettes"] else None,
        tuple(row["cuts"]), RecordingCounts(), tuple(row["remarks"]),
    )  # fmt: skip
    return StoredRecording(row, recording, provenance)


def _rows(store: Store, kind: str, row: dict[str, Any]) -> pa.Table:
    return store.rows_of(kind, row["stage"], "recording", [row["recording"]])


def _observed(rows: pa.Table, row: dict[str, Any], shape: tuple[int, int, int]) -> tuple[F64, F64]:
    pixels, confidence = np.full((*shape, 2), np.nan), np.zeros(shape)
    if rows.num_rows:
        positions = (
            rows.column("source_frame").to_numpy(),
            pc.index_in(rows.column("camera"), pa.array(row["cameras"])).to_numpy(),
            pc.index_in(rows.column("keypoint"), pa.array(row["keypoints"])).to_numpy(),
        )
        pixels[positions] = np.stack([rows.column(axis).to_numpy() for axis in "xy"], axis=1)
        confidence[positions] = rows.column("confidence").to_numpy()
    return pixels, confidence


def _provenance(store: Store, row: dict[str, Any]) -> Provenance:
    files = _rows(store, "recording_files", row).to_pylist()
    path = Path(row["file"])
    return Provenance(
        str(path.parent), path.name, row["checksum"], sum(one["bytes"] for one in files), 0, row["recording"],
        tuple(row["cameras"]),
    )  # fmt: skip
