"""The file of depth recordings: the name of each recording, its files, and their camera and units."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import LocalPath, Located, load_yaml
from kinedex.catalog.depth_cameras import FASTEST_HZ
from kinedex.ops.errors import ConfigError, did_you_mean

AUTO, NONE = "auto", "none"
"""Values of `background` that are no file: measured in the recording itself, and absent."""

_NAME = re.compile(r"\w[\w .+-]{0,99}")
_KEY = "recordings"
_Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
_Vector = Annotated[list[_Number], Field(min_length=3, max_length=3)]


class WorldPose(BaseModel):
    """A turn and a place: x_world = rotation · x + place.

    Attributes
    ----------
    rotation : list of 3 lists of 3 floats
        The turn.
    place : list of 3 floats
        The shift in metres.
    """

    model_config = ConfigDict(extra="forbid")
    rotation: Annotated[list[_Vector], Field(min_length=3, max_length=3)]
    place: _Vector


class DepthEntry(BaseModel):
    """A recording of one person by one depth camera.

    Attributes
    ----------
    depth : str
        Its frames: a pattern of files (`*` stands for any letters), an NPZ or raw file, or `depth.txt` of TUM RGB-D.
    camera : str, optional
        The file of its camera; organised clouds and NPZ files with intrinsics need none.
    background : str, optional
        A depth image of the empty room, `auto` (measured in the recording) or `none` (removed before).
    rate_hz : float, optional
        Frames per second, where camera and frames do not state them.
    depth_unit_m : float, optional
        Metres of one unit, in the place of the camera's.
    body : str, optional
        A take of the store whose bone lengths are those of the person, or `estimate`; it overrides the stage's `body`.
    truth : str, optional
        A take of the store, or a file of positions, that the reconstruction is compared with.
    truth_pose : WorldPose, optional
        Where the axes of the truth lie in the world.
    markers : mapping of str to str
        Marker of the truth → the joint that it is fixed to.
    """

    model_config = ConfigDict(extra="forbid")
    depth: LocalPath
    camera: LocalPath | None = None
    background: LocalPath | None = None
    rate_hz: float | None = Field(None, gt=0, le=FASTEST_HZ, allow_inf_nan=False)
    depth_unit_m: float | None = Field(None, gt=0, le=1, allow_inf_nan=False)
    body: str | None = Field(None, min_length=1)
    truth: LocalPath | None = None
    truth_pose: WorldPose | None = None
    markers: dict[str, str] = {}


@dataclass(frozen=True, eq=False)
class DepthRecordingsFile:
    """A file of depth recordings.

    Attributes
    ----------
    located : Located
        The file, with the lines of its keys.
    recordings : mapping of str to DepthEntry
        The recordings by name, in the order of the file.
    """

    located: Located
    recordings: Mapping[str, DepthEntry]

    @property
    def folder(self) -> Path:
        """The folder that relative paths start from."""
        return self.located.path.parent

    def entry(self, name: str) -> DepthEntry:
        """Return a recording; a ConfigError names the nearest one where there is none of this name."""
        if name not in self.recordings:
            raise self.located.error(f"no recording is called '{name}'{did_you_mean(name, self.recordings)}", _KEY)
        return self.recordings[name]

    def error(self, name: str, key: str, message: str) -> ConfigError:
        """Return an error that names a recording's key and its line."""
        return self.located.error(message, _KEY, name, key)


def load_depth_recordings(path: str | Path) -> DepthRecordingsFile:
    """Read a file of depth recordings.

    Raises
    ------
    ConfigError
        The file is invalid; the message names the line, the key and what was expected.
    """
    return parse_depth_recordings(load_yaml(path))


def parse_depth_recordings(located: Located) -> DepthRecordingsFile:
    """Return the depth recordings of a parsed file.

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
        raise located.error("expected a mapping of names to recordings, as `recordings: {kick: {depth: …}}`", _KEY)
    found = {}
    for name, entry in entries.items():
        if not isinstance(name, str) or not _NAME.fullmatch(name):
            raise located.error(
                "a recording's name must be 1 to 100 letters, digits or ' _.+-', and begin with a letter or digit, got "
                f"{str(name)[:50]!r}; put numbers in quotes", _KEY, name,
            )  # fmt: skip
        found[name] = located.model(DepthEntry, _KEY, name, data=entry)
    return DepthRecordingsFile(located, found)
