"""The views of limbs and inertial sensors (thesis, Chapter 7)."""

from __future__ import annotations

from kinedex.catalog.sql.result_columns import TAKE, result_view

QUATERNION = "STRUCT(w DOUBLE, x DOUBLE, y DOUBLE, z DOUBLE)"
VECTOR = "STRUCT(x DOUBLE, y DOUBLE, z DOUBLE)"

INERTIAL_VIEWS = (
    result_view(
        "limb_orientations",
        "The limbs of takes at the rate of their sources: orientation, place, and how the orientation is known.",
        f"""{TAKE}
limb    VARCHAR    the limb, such as lshank
source_frame    INTEGER    frame of the source, from 0; of takes of recordings, frame of the take
t    DOUBLE    its time in seconds
orientation    {QUATERNION}    unit quaternion from the limb's own frame to the world; NULL where not known
position    {VECTOR}    the middle of the limb in metres, Y up; NULL where not known
direction    {VECTOR}    unit vector from the near to the far joint in the world; NULL where not known
basis    VARCHAR    full (a node's rotation, or markers), hinge (long axis and a joint's plane) or none (long axis)
valid    BOOLEAN    the orientation is known, or for basis none the direction
jump    BOOLEAN    the frame is at a turn faster than 2,500 degrees a second
fit_mm    DOUBLE    root mean square distance of the markers to their shape; NULL where there are none""",
        "SELECT take, limb, max(basis) AS basis, count(*) FILTER (valid) AS valid, count(*) FILTER (jump) AS jumps "
        "FROM limb_orientations GROUP BY take, limb ORDER BY take, limb",
        stages="limb_orientations break_track",
    ),
)
