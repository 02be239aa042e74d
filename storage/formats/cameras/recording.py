"""Read a recording by calibrated cameras: check its files against each other, and convert them to arrays."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.catalog.camera_recordings import CameraRecording, RecordingsFile
from kinedex.catalog.cameras import Camera, observed_rays
from kinedex.catalog.keypoint_sets import KeypointSet, load_keypoint_set
from kinedex.ops.body.kinematic_chain import ChainBody
from kinedex.ops.errors import ConfigError, SourceError, did_you_mean
from kinedex.ops.tracking.observations import BodyPoints, Rays
from kinedex.storage.formats.cameras.calibrations import ENDINGS, calibration_files, in_metres, read_calibration
from kinedex.storage.formats.cameras.camera_values import Calibration
from kinedex.storage.formats.cameras.file_patterns import CAMERA, CameraFiles, find_files, match_cameras
from kinedex.storage.formats.cameras.keypoint_files import KeypointArrays, keypoint_arrays, read_keypoint_files
from kinedex.storage.formats.cameras.masks import CameraMasks, MaskFrames, mask_arrays, open_bits, open_images
from kinedex.storage.formats.cameras.persons import LARGEST, MOST_CONFIDENT, SeenPersons
from kinedex.storage.formats.cameras.recording_checks import check_cameras, check_keypoints

F64 = npt.NDArray[np.float64]

_ENDINGS = {"cameras": ENDINGS, "keypoints": (".json",), "silhouettes": (".png",)}
"""A dict from each key of a recording to the extensions of the files that are read if the key names a folder."""

_MAX_LISTED, _MAX_IDS = 26, 8  # most keypoints, and ids of persons, listed in a note


@dataclass(frozen=True)
class RecordingCounts:
    """Counts of irregularities in a recording, some of which are normal.

    Attributes
    ----------
    images_with_several_persons : int
        Images, one for each frame and camera, with several persons.
    images_without_person : int
        Images in which the person is not seen.
    keypoints_without_confidence : int
        Keypoints whose confidence is missing and counts as 1.
    confidences_above_one : int
        Confidences above 1, which count as 1.
    keypoints_outside_image : int
        Keypoints with a confidence of 0.1 or more outside the image of their camera.
    """

    images_with_several_persons: int = 0
    images_without_person: int = 0
    keypoints_without_confidence: int = 0
    confidences_above_one: int = 0
    keypoints_outside_image: int = 0


@dataclass(frozen=True, eq=False)
class Recording:
    """A recording of one person by V calibrated cameras.

    Attributes
    ----------
    name : str
        Its name.
    cameras : tuple of Camera
        The cameras, in metres with Y up.
    rate_hz : float
        Frames per second.
    first_frame : int
        The number of the first frame in the files.
    keypoint_set : KeypointSet or None
        The set of the keypoints; None without keypoints.
    keypoints : tuple of str
        Names of the P keypoints that have a position on the body.
    pixels : float64 array (T, V, P, 2)
        Keypoints in the images; NaN where one is missing.
    confidence : float64 array (T, V, P)
        Confidence in [0, 1]; 0 where a keypoint is missing.
    masks : MaskFrames or None
        Silhouettes, read frame by frame.
    cuts : tuple of int
        Frames, counted from 0, at which a new shot begins, so that they do not continue the previous frame.
    counts : RecordingCounts
        Counts of irregularities.
    notes : tuple of str
        Sentences for the user about the matching of names, unused keypoints and values that look wrong.
    """

    name: str
    cameras: tuple[Camera, ...]
    rate_hz: float
    first_frame: int
    keypoint_set: KeypointSet | None
    keypoints: tuple[str, ...]
    pixels: F64
    confidence: F64
    masks: MaskFrames | None
    cuts: tuple[int, ...]
    counts: RecordingCounts
    notes: tuple[str, ...]

    @property
    def frames(self) -> int:
        """The number of frames."""
        return len(self.pixels)

    def rays(self) -> Rays:
        """Return the rays from the cameras through the keypoints."""
        return observed_rays(self.cameras, self.pixels, self.confidence)

    def body_points(self, body: ChainBody) -> BodyPoints:
        """Return the positions of the keypoints on a body."""
        if self.keypoint_set is None:
            return BodyPoints(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64))
        return self.keypoint_set.body_points(self.keypoints, body)


def read_recording(file: RecordingsFile, name: str) -> Recording:
    """Read a recording by cameras.

    Parameters
    ----------
    file : RecordingsFile
        The file of recordings, see `kinedex.catalog.camera_recordings.load_recordings`.
    name : str
        The name of a recording in the file; it must have cameras.

    Raises
    ------
    ConfigError
        A key of the recording, or a calibration, is invalid; the message names line and key.
    SourceError
        A file of keypoints or masks is invalid.
    """
    entry = _Entry.of(file, name)
    notes: list[str] = []
    seen = entry.keypoints(notes)
    masks = entry.masks(notes)
    used = [camera for camera in entry.cameras if camera.name in seen or camera.name in masks]
    check_cameras(file, name, used, notes)
    shift = entry.offsets([camera.name for camera in used])
    keypoints, counts = None, RecordingCounts()
    if seen:
        chosen = _keypoint_set(file, name)
        keypoints = keypoint_arrays([seen.get(camera.name) for camera in used], chosen, entry.given.person, shift)
        outside, more = check_keypoints(file, name, used, keypoints, entry.unit)
        counts = RecordingCounts(
            keypoints.several, keypoints.empty, keypoints.without_confidence, keypoints.above_one, outside
        )
        notes += [*_set_notes(keypoints), *more, *_person_notes(seen.values(), entry.given.person, counts)]
    own = tuple(masks.get(camera.name) for camera in used)
    first, frames = _extent(file, name, keypoints, own, shift)
    pixels, confidence = _over(keypoints, len(used), first, frames)
    return Recording(
        name=name,
        cameras=tuple(used),
        rate_hz=entry.rate_hz,
        first_frame=first,
        keypoint_set=None if keypoints is None else keypoints.keypoint_set,
        keypoints=() if keypoints is None else keypoints.names,
        pixels=pixels,
        confidence=confidence,
        masks=MaskFrames(own, tuple(first + offset for offset in shift), frames) if masks else None,
        cuts=_cuts(file, name, entry.given, first, frames),
        counts=counts,
        notes=tuple(notes),
    )


@dataclass(frozen=True, eq=False)
class _Entry:
    """The entry of a recording in its file, and its cameras; matching files to cameras adds names to `labels`."""

    file: RecordingsFile
    name: str
    given: CameraRecording
    cameras: tuple[Camera, ...]
    rate_hz: float
    unit: str
    labels: dict[str, str]

    @classmethod
    def of(cls, file: RecordingsFile, name: str) -> _Entry:
        """Return the entry of a recording after reading its calibration."""
        given = file.entry(name)
        if given.cameras is None or given.rate_hz is None:
            raise file.error(name, "track", "is a 3D track of the store, which has no cameras to be read")
        calibration = _calibration(file, name, given)
        try:
            cameras = in_metres(calibration, given.unit, given.up)
        except ConfigError as fault:
            raise file.error(name, "cameras", fault.reason) from None
        unit = given.unit or calibration.unit
        return cls(file, name, given, cameras, given.rate_hz, unit, dict(calibration.labels or {}))

    def keypoints(self, notes: list[str]) -> dict[str, SeenPersons]:
        """Return the persons of each camera by its name; empty if the entry has no keypoints."""
        if self.given.keypoints is None:
            return {}
        files = recording_files(self.file, self.name, "keypoints")
        found = read_keypoint_files(files, self.name)
        if list(found) == [""]:
            raise self._error("keypoints", f"the table has no column `camera`, and the path no {CAMERA}")
        return {camera: found[value] for camera, value in self._matched("keypoints", found, notes).items()}

    def masks(self, notes: list[str]) -> dict[str, CameraMasks]:
        """Return the masks of each camera by its name; empty if the entry has no silhouettes."""
        if self.given.silhouettes is None:
            return {}
        files = recording_files(self.file, self.name, "silhouettes")
        by_name = {camera.name: camera for camera in self.cameras}
        if next(iter(files.files.values()))[0].suffix.lower() == ".npz":
            arrays = _mask_arrays(files)
            pairs = self._matched("silhouettes", arrays, notes)
            return {camera: open_bits(*arrays[value], by_name[camera]) for camera, value in pairs.items()}
        if not files.each_camera:
            raise self._error("silhouettes", f"masks in PNG need {CAMERA} in their path, as masks/{CAMERA}/*.png")
        pairs = self._matched("silhouettes", files.files, notes)
        return {camera: open_images(files.files[value], by_name[camera]) for camera, value in pairs.items()}

    def offsets(self, cameras: Sequence[str]) -> list[int]:
        """Return the frame offsets of cameras; `offsets` may name a camera, its label or its files."""
        known = self.labels | {camera.name: camera.name for camera in self.cameras}
        for key in self.given.offsets:
            if key not in known:
                raise self._error("offsets", f"no camera is called '{key}'{did_you_mean(key, known)}")
        found = {known[key]: offset for key, offset in self.given.offsets.items()}
        return [found.get(camera, 0) for camera in cameras]

    def _matched(self, key: str, values: Mapping[str, object], notes: list[str]) -> dict[str, str]:
        """Return for each camera the name by which its files call it; append a note on the matching, if there is one.

        The name is the text in the place of `{camera}` in a path, or a name inside a file of several cameras.
        """
        names = [camera.name for camera in self.cameras]
        try:
            pairs, note = match_cameras(self.file.folder, key, names, self.labels, values)
        except SourceError as fault:
            raise self._error(key, fault.reason) from None
        notes += [note] if note else []
        self.labels.update({value: camera for camera, value in pairs.items() if value not in names})
        return pairs

    def _error(self, key: str, message: str) -> ConfigError:
        return self.file.error(self.name, key, message)


def recording_files(file: RecordingsFile, name: str, key: str) -> CameraFiles:
    """Return the files that a key of a recording names, without the file of recordings itself.

    Parameters
    ----------
    file : RecordingsFile
        The file of recordings.
    name : str
        The recording.
    key : str
        A key that the recording has: "cameras", "keypoints" or "silhouettes".

    Raises
    ------
    ConfigError
        The key names no file, or several files for one calibration; the message names the key and its line.
    """
    pattern = str(getattr(file.entry(name), key))
    try:
        found = find_files(file.folder, pattern, _ENDINGS[key], Path(file.located.path))
    except SourceError as fault:
        raise file.error(name, key, fault.reason) from None
    if key != "cameras":
        return found
    files = {camera: calibration_files(paths[0]) for camera, paths in found.files.items()}
    several = next((paths for camera, paths in found.files.items() if not {*paths} <= {*files[camera]}), None)
    if several is not None:
        listed = ", ".join(path.name for path in several[:4]) + (", …" if len(several) > 4 else "")
        raise file.error(name, key, f"'{pattern}' matches several files ({listed}); name one, or use {CAMERA}")
    return CameraFiles(pattern, files)


def _calibration(file: RecordingsFile, name: str, given: CameraRecording) -> Calibration:
    """Return the calibration, from one file for all cameras or from one file for each camera.

    In the second case, the name of a camera is the text in the place of `{camera}` in the path of its file.
    """
    files = recording_files(file, name, "cameras")
    if not files.each_camera:
        return read_calibration(files.files[""][0], given.size)
    read = {camera: read_calibration(paths[0], given.size) for camera, paths in files.files.items()}
    several = next((one for one in read.values() if len(one.cameras) != 1), None)
    if several is not None:
        raise file.error(name, "cameras", f"{several.path} has {len(several.cameras)} cameras, but must have one")
    first = next(iter(read.values()))
    cameras = tuple(replace(found.cameras[0], name=camera) for camera, found in read.items())
    return Calibration(first.path, first.kind, cameras, first.unit, first.up)


def _keypoint_set(file: RecordingsFile, name: str) -> KeypointSet | None:
    """Return the keypoint set of the recording, if it names one."""
    chosen = file.keypoint_set(name)
    try:
        return None if chosen is None else load_keypoint_set(chosen)
    except ConfigError as fault:
        if fault.line is not None:
            raise
        reason = f"{fault.path}: {fault.reason}" if isinstance(chosen, Path) else fault.reason
        raise file.error(name, "keypoint_set", reason) from None


def _mask_arrays(files: CameraFiles) -> dict[str, tuple[Path, str]]:
    """Return a dict from the name of a camera's masks to NPZ file and array; a file holds one camera or all cameras."""
    arrays: dict[str, tuple[Path, str]] = {}
    for value, paths in files.files.items():
        names = mask_arrays(paths[0])
        if files.each_camera and len(names) != 1:
            raise SourceError(paths[0], f"expected one array, the masks of one camera, got {len(names)}")
        arrays |= {value: (paths[0], names[0])} if files.each_camera else {one: (paths[0], one) for one in names}
    return arrays


def _set_notes(keypoints: KeypointArrays) -> list[str]:
    """Return notes on the keypoint set, and on the keypoints that are not used."""
    some, more = keypoints.unused[:_MAX_LISTED], len(keypoints.unused) - _MAX_LISTED
    listed = ", ".join(some) + (f" and {more} more" if more > 0 else "")
    unused = [f"not used, for want of a place on the body or of any image: {listed}"]
    return [f"keypoints are those of {keypoints.keypoint_set.name}", *(unused if keypoints.unused else [])]


def _person_notes(seen: Iterable[SeenPersons], choice: str, counts: RecordingCounts) -> list[str]:
    """Return notes on how the person is chosen in images with several persons, and on other possible choices."""
    images = counts.images_with_several_persons
    if not images:
        return []
    ids = sorted({one.called for camera in seen for those in camera.frames.values() for one in those if one.called})
    more = f" and {len(ids) - _MAX_IDS} more" if len(ids) > _MAX_IDS else ""
    listed = f"an id ({', '.join(ids[:_MAX_IDS])}{more})" if ids else "an id, of which the files have none"
    rules = {
        LARGEST: "the one whose box of keypoints is largest in the image",
        MOST_CONFIDENT: "the one whose confidences have the greatest sum",
    }
    taken = rules.get(choice, f"the one with the id '{choice}'")
    others = [f"`{name}`" for name in rules if name != choice]
    return [
        f"{images:,} image{'s' * (images > 1)} with several persons: {taken} is tracked (`person: {choice}`); other "
        f"choices are {', '.join(others)}, and {listed}"
    ]


def _extent(
    file: RecordingsFile,
    name: str,
    keypoints: KeypointArrays | None,
    masks: Sequence[CameraMasks | None],
    offsets: Sequence[int],
) -> tuple[int, int]:
    """Return the number of the first frame that has keypoints or masks, and the number of frames."""
    ends = [] if keypoints is None else [keypoints.first_frame, keypoints.first_frame + len(keypoints.pixels) - 1]
    present = 0
    for one, offset in zip(masks, offsets, strict=True):
        if one is not None:
            numbers = one.frames
            present = max(present, len(numbers))
            ends += [numbers[0] - offset, numbers[-1] - offset]
    first, frames = min(ends), max(ends) - min(ends) + 1
    if frames > 10 * max(present, 0 if keypoints is None else len(keypoints.pixels)) + 1000:
        raise file.error(name, "silhouettes", f"most of the frames {first} to {first + frames - 1} are missing")
    return first, frames


def _over(keypoints: KeypointArrays | None, cameras: int, first: int, frames: int) -> tuple[F64, F64]:
    """Return pixels and confidences for all frames of the recording; for 0 keypoints if it has only masks."""
    count = 0 if keypoints is None else len(keypoints.names)
    pixels = np.full((frames, cameras, count, 2), np.nan)
    confidence = np.zeros((frames, cameras, count))
    if keypoints is not None:
        part = slice(keypoints.first_frame - first, keypoints.first_frame - first + len(keypoints.pixels))
        pixels[part], confidence[part] = keypoints.pixels, keypoints.confidence
    return pixels, confidence


def _cuts(file: RecordingsFile, name: str, given: CameraRecording, first: int, frames: int) -> tuple[int, ...]:
    """Return the cuts as frames counted from 0."""
    for cut in given.cuts:
        if not first < cut < first + frames:
            raise file.error(name, "cuts", f"must lie between the frames {first} and {first + frames - 1}, got {cut}")
    return tuple(sorted({cut - first for cut in given.cuts}))
