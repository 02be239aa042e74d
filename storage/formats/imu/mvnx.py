"""Read the sensors in an MVNX file of Xsens MVN: orientations and magnetic fields, at the rate of the motion.

The format is taken from the manual, without a sample file. Orientations are quaternions w x y z from the sensor to F_GI
(X magnetic north, Y west, Z up). The accelerations in such files have no gravity, and are not read.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kinedex.ops.errors import SourceError
from kinedex.storage.formats.imu.signals import NWU, RawSensor, UserStatements
from kinedex.storage.formats.mvnx import read_mvnx, subject_names

_ORIENTATION, _FIELD = "sensorOrientation", "sensorMagneticField"


def recognises(path: Path, head: bytes) -> bool:
    """Return True for a file with the element `mvnx`."""
    return b"<mvnx" in head


def read(path: Path, given: UserStatements) -> list[RawSensor]:
    """Read the sensors of all subjects; if there are several subjects, a sensor is named `subject/sensor`.

    Raises
    ------
    SourceError
        The file is damaged, or has no orientations of sensors; the message names the line.
    """
    subjects = read_mvnx(path, (_ORIENTATION, _FIELD))
    found = []
    for name, subject in zip(subject_names(subjects), subjects, strict=True):
        orientations, fields = subject.numbers(_ORIENTATION), subject.numbers(_FIELD)
        steps = np.array(subject.indices, np.int64)
        back = np.flatnonzero(np.diff(steps) <= 0)
        if len(back):
            raise SourceError(
                path, f"the index of a frame must ascend, got {steps[back[0] + 1]} after {steps[back[0]]}"
            )
        for i, label in enumerate(subject.sensors):
            if not len(orientations):
                continue
            sensor = RawSensor(label if len(subjects) == 1 else f"{name}/{label}", rate_hz=subject.rate_hz, frame=NWU)
            sensor.frame_assumed = True
            sensor.orientation = orientations[:, i]
            sensor.mag = fields[:, i] if len(fields) else None
            sensor.steps, sensor.units = steps, {"mag": "1"}
            found.append(sensor)
    if not found:
        raise SourceError(
            path, f"has no <{_ORIENTATION}>, the orientations of sensors; export them from MVN, or ingest the file as "
            "motion",
        )  # fmt: skip
    return found
