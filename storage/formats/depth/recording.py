"""Read a recording by a depth camera: check its files against each other, and open its images for reading."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from kinedex.catalog.configs import load_yaml
from kinedex.catalog.depth_cameras import DepthCamera
from kinedex.catalog.depth_recordings import (
    AUTO,
    NONE,
    DepthEntry,
    DepthRecordingsFile,
    WorldPose,
)
from kinedex.ops.depth.background import percentile_depths
from kinedex.ops.errors import ConfigError, KinedexError, SourceError
from kinedex.storage.formats.cameras.file_patterns import find_files
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.clouds import Cloud, check_camera, fitted_matrix
from kinedex.storage.formats.depth.frame_files import FrameFiles, find_frames
from kinedex.storage.formats.depth.frames import DepthFrames, DepthSource, ImageFiles, open_raw, read_cloud, read_frame
from kinedex.storage.formats.depth.npz import NpzValues, camera_of_npz, npz_values, open_npz
from kinedex.storage.formats.depth.png import image_size
from kinedex.storage.formats.depth.recording_checks import (
    intrinsics_note,
    likely_unit,
    measured_extents,
    moved_frames,
    other_unit,
    shows_room,
    unit_fault,
)

F32 = npt.NDArray[np.float32]
F64 = npt.NDArray[np.float64]
Read = TypeVar("Read")

SAMPLE = 10
"""The number of frames, spread over a recording, on which the recording is checked."""

MAX_BACKGROUND_BYTES = 1 << 28
"""The largest memory, in bytes, for the frames from which a background is measured; more frames are subsampled."""

CAMERA_MOVED = "much lies behind the background; did the camera move?"
"""The end of the note on frames that contradict the background."""

_MAX_TRIES = 50
_YAML = (".yaml", ".yml")
_MAX_OFF_PX = 1.0


@dataclass(frozen=True, eq=False)
class DepthRecording:
    """A recording of one person by a depth camera.

    Attributes
    ----------
    name : str
        Its name.
    camera : DepthCamera
        The camera.
    background : float32 array (H, W) or None
        Depths z of the empty room in metres, 0 where unknown; None if the recording has no background.
    frames : DepthFrames
        The images, read one at a time: depths z in metres.
    rate_hz : float
        Frames per second.
    body : str or None
        A take of the store that has the bone lengths of the person, or `estimate`; None if neither is stated.
    truth : str or Path or None
        The ground truth: a take of the store, or a file of positions.
    truth_pose : WorldPose or None
        The pose of the ground truth's axes in the world.
    markers : mapping of str to str
        Marker of the ground truth → the joint that it is fixed to.
    notes : tuple of str
        Sentences for the user about choices and about values that look wrong; `frames.notes()` has those about frames.
    """

    name: str
    camera: DepthCamera
    background: F32 | None
    frames: DepthFrames
    rate_hz: float
    body: str | None = None
    truth: str | Path | None = None
    truth_pose: WorldPose | None = None
    markers: Mapping[str, str] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def read_recording(file: DepthRecordingsFile, name: str) -> DepthRecording:
    """Read one depth recording.

    Parameters
    ----------
    file : DepthRecordingsFile
        The file of recordings, see `kinedex.catalog.depth_recordings.load_depth_recordings`.
    name : str
        The name of a recording in the file.

    Raises
    ------
    ConfigError
        The file, or a key of the recording or its camera, is invalid; the message names file, line and key.
    SourceError
        A file of frames is invalid.
    """
    entry = _Entry(file, name, file.entry(name))
    files = entry.frame_files()
    values = npz_values(files.files[0]) if files.kind == "npz" else None
    camera = entry.camera(files, values)
    rate_hz = entry.rate_hz(camera, files, values)
    camera = replace(camera, rate_hz=rate_hz)
    frames = DepthFrames(entry.source(files, camera))
    images = entry.sample(frames)
    background, notes = entry.background(camera, frames, images)
    notes += entry.checks(camera, files, images, background)
    notes += frames.notes()
    return DepthRecording(
        name, camera, background, frames, rate_hz, entry.given.body, entry.truth(), entry.given.truth_pose,
        entry.given.markers, tuple(note for note in notes if note),
    )  # fmt: skip


def recording_files(file: DepthRecordingsFile, name: str) -> list[tuple[str, Path]]:
    """Return the files of a recording except its ground truth, each with the key that names the file.

    Raises
    ------
    ConfigError
        A key names no file; the message names file, line and key.
    """
    entry = _Entry(file, name, file.entry(name))
    listed = file.folder / entry.given.depth
    found = [("depth", path) for path in entry.frame_files().files]
    if listed.suffix.lower() == ".txt":
        found.append(("depth", listed))
    for key, value in (("camera", entry.given.camera), ("background", entry.given.background)):
        if value is not None and (key, value) not in (("background", AUTO), ("background", NONE)):
            found.append((key, entry.path(key, value)))
    return found


def recording_truth(file: DepthRecordingsFile, name: str) -> str | Path | None:
    """Return the ground truth of a recording: a take of the store, a file, or None.

    Raises
    ------
    ConfigError
        The file does not exist; the message names file, line and key.
    """
    return _Entry(file, name, file.entry(name)).truth()


@dataclass(frozen=True)
class _Entry:
    """The entry of a recording in the file of recordings."""

    file: DepthRecordingsFile
    name: str
    given: DepthEntry

    def error(self, key: str, message: str) -> ConfigError:
        return self.file.error(self.name, key, message)

    def path(self, key: str, pattern: str) -> Path:
        """Return the single file that a key names; errors name the key."""
        try:
            found = find_files(self.file.folder, pattern, excluded=self.file.located.path).files
        except SourceError as fault:
            raise self.error(key, fault.reason) from None
        files = [path for paths in found.values() for path in paths]
        if len(files) != 1:
            raise self.error(key, f"'{pattern}' matches {len(files)} files; name one")
        return files[0]

    def frame_files(self) -> FrameFiles:
        """Return the files of the frames; errors name the key."""
        try:
            return find_frames(self.file.folder, self.given.depth, self.file.located.path)
        except SourceError as fault:
            raise self.error("depth", str(fault)) from None

    def camera(self, files: FrameFiles, values: NpzValues | None) -> DepthCamera:
        """Return the camera, from its file, an NPZ file or an organised cloud."""
        camera: DepthCamera | None = None
        if self.given.camera is not None:
            path = self.path("camera", self.given.camera)
            stated = path.suffix.lower() in _YAML
            camera = read_camera(path, None if stated else values.size if values is not None else _first_size(files))
            if values is not None and values.matrix is not None:
                self.compare_matrices(camera, files, values.matrix)
        elif values is not None:
            camera = camera_of_npz(files.files[0], values)
        elif files.kind == "images" and (cloud := _first_cloud(files)) is not None and cloud.size is not None:
            camera = DepthCamera(fitted_matrix(cloud), np.zeros(0), cloud.size)
        if camera is None:
            raise self.error(
                "camera",
                "this key is missing: only NPZ files with `intrinsics` and organised clouds state their camera",
            )
        if self.given.depth_unit_m is not None:
            camera = replace(camera, depth_unit_m=self.given.depth_unit_m)
        elif values is not None and values.depth_unit_m is not None and not 0 < values.depth_unit_m <= 1:
            raise SourceError(files.files[0], f"'depth_unit_m' must be above 0, at most 1, got {values.depth_unit_m:g}")
        return camera

    def compare_matrices(self, camera: DepthCamera, files: FrameFiles, matrix: F64) -> None:
        """Raise an error if the camera contradicts the intrinsics in an NPZ file."""
        if np.abs(camera.matrix - matrix).max() > _MAX_OFF_PX:
            fx, cx, fy, cy = matrix[0, 0], matrix[0, 2], matrix[1, 1], matrix[1, 2]
            raise self.error(
                "camera", f"contradicts the intrinsics in {files.files[0].name}, fx {fx:g}, fy {fy:g}, cx {cx:g}, cy "
                f"{cy:g}, by more than {_MAX_OFF_PX:g} pixel; remove this key to use them",
            )  # fmt: skip

    def rate_hz(self, camera: DepthCamera, files: FrameFiles, values: NpzValues | None) -> float:
        """Return the frames per second, from the recording, the camera, the NPZ file or the times of the files."""
        stated = None if values is None else values.rate_hz
        found = self.given.rate_hz or camera.rate_hz or stated or files.rate_hz()
        if found is None:
            raise self.error("rate_hz", "this key is missing: neither camera nor frames state the frames per second")
        return float(found)

    def source(self, files: FrameFiles, camera: DepthCamera) -> DepthSource:
        """Return the source of the images for files of their kind."""
        unit_m = self.given.depth_unit_m or 1.0
        if files.kind == "npz":
            return open_npz(files.files[0], camera, unit_m)
        if files.kind == "raw":
            return open_raw(files.files[0], camera)
        return ImageFiles(files.numbers(camera.rate_hz), camera, unit_m)

    def sample(self, frames: DepthFrames) -> dict[int, F32]:
        """Return a few images, spread over the recording; raise an error with the reason if none can be read."""
        present = [number - frames.first for number in frames.source.numbers]
        chosen = {present[i] for i in np.linspace(0, len(present) - 1, min(SAMPLE, len(present))).astype(int)}
        images = {t: image for t in sorted(chosen) if (image := frames[t]) is not None}
        if not images:  # all images of the sample are damaged: try the first frames
            for t in present[:_MAX_TRIES]:
                if (image := frames[t]) is not None:
                    return {t: image}
            raise self.error("depth", f"no frame can be read; the first: {next(iter(frames.damaged.values()))}")
        return images

    def background(
        self, camera: DepthCamera, frames: DepthFrames, images: Mapping[int, F32]
    ) -> tuple[F32 | None, list[str]]:
        """Return the background image, or None if there is none, and notes on it."""
        given = self.given.background
        if given is None:
            given = AUTO if shows_room(images) else NONE
            reason = "the images show the room" if given == AUTO else "most pixels of the images are empty"
            notes = [f"background: {given}, for {reason}; write `background:` to choose"]
        else:
            notes = []
        if given == NONE and self.given.background == NONE and shows_room(images):
            notes.append(
                "background: none, but the images show the room, all of which counts as the person; write `auto`"
            )
        if given == NONE:
            return None, notes
        if given == AUTO:
            return self._measured_background(camera, frames, notes), notes
        path = self.path("background", given)
        try:
            return read_frame(path, camera, self.given.depth_unit_m or 1.0), notes
        except SourceError as fault:
            raise self.error("background", str(fault)) from None

    def _measured_background(self, camera: DepthCamera, frames: DepthFrames, notes: list[str]) -> F32:
        """Return the 90th percentile of each pixel's depths over all frames, or over evenly spaced ones of many."""
        most = max(SAMPLE, MAX_BACKGROUND_BYTES // (4 * camera.size[0] * camera.size[1]))
        present = [number - frames.first for number in frames.source.numbers]
        if len(present) > most:
            present = [present[i] for i in np.linspace(0, len(present) - 1, most).astype(int)]
            notes.append(f"background: measured in {most} frames, evenly spaced over the recording")
        stack = np.zeros((len(present), camera.size[1], camera.size[0]), np.float32)
        for i, t in enumerate(present):
            image = frames[t]
            if image is not None:
                stack[i] = image
        return percentile_depths(stack)

    def checks(
        self, camera: DepthCamera, files: FrameFiles, images: Mapping[int, F32], background: F32 | None
    ) -> list[str]:
        """Check the recording's values against a few frames, and return notes on what looks wrong."""
        extents = measured_extents(camera, images, background)
        unit_m = camera.depth_unit_m
        if files.kind == "images" and files.files[0].suffix.lower() not in (".png", ".raw", ".bin"):
            unit_m = self.given.depth_unit_m or 1.0
            if self.given.camera is not None and (cloud := _first_cloud(files)) is not None and cloud.size is not None:
                check_camera(cloud, camera)
        notes = [self.moved_note(images, background), intrinsics_note(camera)]
        if extents is None:
            return [f"nobody is seen in {len(images)} frames, spread over the recording", *notes]
        if fault := unit_fault(extents, unit_m):
            raise self.unit_error(fault)
        return notes

    def moved_note(self, images: Mapping[int, F32], background: F32 | None) -> str:
        """Return a note on frames that are behind the background; raise an error if no frame fits the background."""
        moved = {}
        if background is not None and self.given.background not in (None, AUTO):
            moved = moved_frames(images, background)
        listed = ", ".join(map(str, moved))
        if moved and len(moved) == len(images):
            if background is not None and (factor := other_unit(images, background)):
                raise self.error(
                    "depth_unit_m", f"the images lie {factor:.3g} times as far away as the background: is one of "
                    "them in another unit? `depth_unit_m` of a recording holds for its images; "
                    f"{likely_unit(1 / factor):g} would fit if they are clouds",
                )  # fmt: skip
            raise self.error(
                "background", f"lies before {min(moved.values()):.0%} or more of the pixels in all {len(moved)} frames "
                "that were compared: the camera moved, or it is of another room; write `background: auto`",
            )  # fmt: skip
        return f"frames {listed}: {CAMERA_MOVED}" if moved else ""

    def unit_error(self, fault: str) -> ConfigError:
        """Return an error about the unit that names the key, in the camera's file or the recording, that states it."""
        if self.given.depth_unit_m is None and self.given.camera is not None:
            path = self.path("camera", self.given.camera)
            if path.suffix.lower() in _YAML:
                return load_yaml(path).error(fault, "depth_unit_m")
        return self.error("depth_unit_m", fault)

    def truth(self) -> str | Path | None:
        """Return the ground truth: a file if the entry names one or has a slash, else a take's name; None for none."""
        given = self.given.truth
        if given is None:
            return None
        if "/" in given or os.path.isfile(self.file.folder / given):
            return self.path("truth", given)
        return given


def _first_size(files: FrameFiles) -> tuple[int, int] | None:
    """Return the size of the first image that can be read, for cameras without a stated size."""
    is_image = files.kind == "images" and files.files[0].suffix.lower() == ".png"
    return _first_read(files, image_size) if is_image else None


def _first_read(files: FrameFiles, read: Callable[[Path], Read]) -> Read:
    """Return the result of the first file that can be read; raise the error of the first file after 50 failures."""
    fault: KinedexError | None = None
    for path in files.files[:_MAX_TRIES]:
        try:
            return read(path)
        except SourceError as found:
            fault = fault or found
    raise fault or SourceError(files.files[0], "cannot be read")


def _first_cloud(files: FrameFiles) -> Cloud | None:
    """Return the first cloud that can be read; None if the frames are not clouds."""
    return _first_read(files, read_cloud)
