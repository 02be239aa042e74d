"""Read the file that lists depth recordings: the name of each recording, its files, its camera and its units."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.camera_recordings import EntriesFile, parse_entries
from kinedex.catalog.configs import LocalPath, Located, load_yaml
from kinedex.catalog.depth_cameras import FASTEST_HZ

AUTO, NONE = "auto", "none"
"""The values of `background` that are not files: measure it in the recording, and use no background."""

_Number = Annotated[float, Field(allow_inf_nan=False, ge=-1e9, le=1e9)]
_Vector = Annotated[list[_Number], Field(min_length=3, max_length=3)]


class WorldPose(BaseModel):
    """A rigid transformation to the world: x_world = rotation · x + place.

    Attributes
    ----------
    rotation : list of 3 lists of 3 floats
        The rotation matrix.
    place : list of 3 floats
        The translation in metres.
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
        The file of its camera; not needed for organised point clouds and NPZ files with intrinsics.
    background : str, optional
        A depth image of the empty room, `auto` to measure it in the recording, or `none` if the frames show no room.
    rate_hz : float, optional
        Frames per second; required if neither camera nor frames state them.
    depth_unit_m : float, optional
        The number of metres of one unit of depth, which overrides the unit of the camera.
    body : str, optional
        A take of the store with the bone lengths of the person, or `estimate`; it overrides the stage's `body`.
    truth : str, optional
        A take of the store, or a file of positions, that the reconstruction is compared with.
    truth_pose : WorldPose, optional
        The transformation from the axes of the truth to the world.
    markers : mapping of str to str
        The joint that each marker of the truth is fixed to, by the marker's name.
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


DepthRecordingsFile = EntriesFile[DepthEntry]
"""A file of recordings by depth cameras."""


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
    return EntriesFile(located, dict(parse_entries(located, DepthEntry, "kick: {depth: …}")))
