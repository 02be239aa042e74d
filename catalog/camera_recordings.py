"""Read the file that lists recordings by cameras: their names, their data files, and how to interpret these files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Generic, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

from kinedex.catalog.configs import LocalPath, Located, load_yaml
from kinedex.ops.errors import ConfigError, did_you_mean

ESTIMATE = "estimate"
"""The value of `body` which says that bone lengths are estimated from the recording itself."""

_NAME = re.compile(r"\w[\w .+-]{0,99}")
_KEY = "recordings"


class CameraRecording(BaseModel):
    """A recording of one person by several calibrated cameras, or a 3D track.

    Attributes
    ----------
    cameras : str, optional
        The calibration: one file, or a file for each camera with `{camera}` in its path.
    keypoints : str, optional
        Files of 2D keypoints; `{camera}` stands for the camera, `*` for any letters.
    silhouettes : str, optional
        Files of masks, written like `keypoints`.
    track : str, optional
        A take of the store that is used instead of cameras, keypoints and silhouettes.
    rate_hz : float, optional
        Frames per second of the cameras; a track has the rate of its take.
    up : str, optional
        The axis of the calibration that points up. It is required if the file format does not determine it.
    unit : str, optional
        The unit of length of the calibration. It is required if the file format does not determine it.
    size : tuple of (int, int), optional
        Width and height of the images in pixels, for calibrations that do not state the image size.
    keypoint_set : str, optional
        A shipped file of `configs/keypoints`, or the path of another. By default the set is recognised by the names or
        the number of keypoints.
    person : str
        The person who is tracked if a frame shows several: "largest", "most_confident", or the id of a person.
    body : str
        A take of the store with the bone lengths of the person, or "estimate" to estimate them from the recording.
    offsets : mapping of str to int
        Offset in frames by camera name: frame k of the recording is frame k + offset of this camera's files.
    cuts : list of int
        The first frame after each cut, numbered as in the files.
    truth : str, optional
        A take of the store, or a file of positions, that the track is compared with.
    """

    model_config = ConfigDict(extra="forbid")
    cameras: LocalPath | None = None
    keypoints: LocalPath | None = None
    silhouettes: LocalPath | None = None
    track: str | None = Field(None, min_length=1)
    rate_hz: float | None = Field(None, gt=0, le=10_000, allow_inf_nan=False)
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None
    unit: Literal["m", "cm", "mm", "in"] | None = None
    size: tuple[Annotated[int, Field(gt=0, le=100_000)], Annotated[int, Field(gt=0, le=100_000)]] | None = None
    keypoint_set: LocalPath | None = None
    person: Annotated[str, BeforeValidator(lambda value: str(value) if type(value) is int else value)] = "largest"
    body: str = Field(ESTIMATE, min_length=1)
    offsets: dict[str, Annotated[int, Field(ge=-1_000_000, le=1_000_000)]] = {}
    cuts: list[Annotated[int, Field(ge=0)]] = []
    truth: LocalPath | None = None


Entry = TypeVar("Entry", bound=BaseModel)


@dataclass(frozen=True, eq=False)
class EntriesFile(Generic[Entry]):
    """A file of recordings by cameras of one kind.

    Attributes
    ----------
    located : Located
        The file, with the lines of its keys.
    recordings : mapping of str to Entry
        The recordings by name, in the order of the file.
    """

    located: Located
    recordings: Mapping[str, Entry]

    @property
    def folder(self) -> Path:
        """The folder that relative paths start from."""
        return self.located.path.parent

    def entry(self, name: str) -> Entry:
        """Return the recording with a name; raise a ConfigError that suggests the nearest name if there is none."""
        if name not in self.recordings:
            raise self.located.error(f"no recording is called '{name}'{did_you_mean(name, self.recordings)}", _KEY)
        return self.recordings[name]

    def error(self, name: str, key: str, message: str) -> ConfigError:
        """Return an error that names a recording's key and its line."""
        return self.located.error(message, _KEY, name, key)


def parse_entries(located: Located, model: type[Entry], example: str) -> Iterator[tuple[str, Entry]]:
    """Yield the names and recordings of a parsed file.

    Parameters
    ----------
    located : Located
        The parsed file.
    model : type
        The model of a recording.
    example : str
        An example of a recording for error messages, such as "walk: {cameras: …}".

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    content = located.mapping()
    other = next((key for key in content if key != _KEY), None)
    if other is not None:
        raise located.error(f"no such key; recordings stand under `{_KEY}`", str(other))
    entries = content.get(_KEY)
    if not isinstance(entries, dict) or not entries:
        raise located.error(f"expected a mapping of names to recordings, as `recordings: {{{example}}}`", _KEY)
    for name, entry in entries.items():
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise located.error(
                "a recording's name must be 1 to 100 letters, digits or ' _.+-', and begin with a letter or digit, got "
                f"{str(name)[:50]!r}; put numbers in quotes", _KEY, name,
            )  # fmt: skip
        yield name, located.model(model, _KEY, name, data=entry)


class RecordingsFile(EntriesFile[CameraRecording]):
    """A file of recordings by calibrated cameras."""

    def keypoint_set(self, name: str) -> str | Path | None:
        """Return the keypoint set of a recording, a shipped name or a path; None if the recording names no set."""
        given = self.entry(name).keypoint_set
        if given is None or not ("/" in given or given.endswith((".yaml", ".yml", ".json"))):
            return given
        return self.folder / Path(given).expanduser()


def load_recordings(path: str | Path) -> RecordingsFile:
    """Read a file of recordings by cameras.

    Raises
    ------
    ConfigError
        There is no such file, or it is invalid; the message names the line, the key and what was expected.
    """
    path = Path(path)
    if not path.is_file() or path.suffix.lower() == ".toml":
        found = "is a folder" if path.is_dir() else "is no YAML" if path.exists() else "no such file"
        raise ConfigError(
            path, f"{found}; expected the file of recordings, a YAML file that names calibration, keypoints and rate "
            "of each: `recordings: {walk: {cameras: calib.toml, keypoints: pose/{camera}/*.json, rate_hz: 60}}`",
        )  # fmt: skip
    return parse_recordings(load_yaml(path))


def parse_recordings(located: Located) -> RecordingsFile:
    """Return the recordings of a parsed file.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    found = {}
    for name, recording in parse_entries(located, CameraRecording, "walk: {cameras: …}"):
        _check(located, name, recording)
        found[name] = recording
    return RecordingsFile(located, found)


def _check(located: Located, name: str, recording: CameraRecording) -> None:
    """Raise an error unless a recording has either cameras with observations or a track, but not both."""
    at = (_KEY, name)
    observed = recording.keypoints or recording.silhouettes
    if recording.track is not None:
        for key in ("cameras", "keypoints", "silhouettes", "size", "keypoint_set", "offsets"):
            if getattr(recording, key):
                raise located.error("must not stand beside `track`, which is in their place", *at, key)
        return
    if not observed:
        raise located.error("must have `keypoints` or `silhouettes`, with `cameras`; or `track`", *at)
    if recording.cameras is None:
        raise located.error("must have `cameras`, the file of their calibration", *at)
    if recording.rate_hz is None:
        raise located.error("must have `rate_hz`, the frames per second of the cameras", *at)
