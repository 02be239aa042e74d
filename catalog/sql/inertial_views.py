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
    result_view(
        "imu_recordings",
        "The sensors of recordings: the limb that each is worn on, its take, rate and channels, and what is odd.",
        f"""{TAKE}
recording    VARCHAR    the recording: sensors that share a clock, of one file or of several files
sensor    VARCHAR    name of the sensor in its file
limb    VARCHAR    the limb that it is worn on, such as lshank; NULL where no limb claims it
file    VARCHAR    its file
format    VARCHAR    format of the file
rate_hz    DOUBLE    samples per second
samples    BIGINT    number of samples
frame    VARCHAR    the world of the file's own orientations; NULL where they are estimated
channels    VARCHAR[]    acc, gyr, mag, orientation: those that the file has
gaps    STRUCT(last_s DOUBLE, next_s DOUBLE)[]    last and next sample of holes above 50 ms, seconds of its clock
warnings    VARCHAR[]    what is odd
orientation    VARCHAR    file (the file's own), 9D or 6D (estimated with or without magnetic field); NULL for neither
fingerprint    VARCHAR    a hash of all that the rows follow from, for reuse""",
        "SELECT recording, take, sensor, limb, rate_hz, warnings FROM imu_recordings ORDER BY recording, sensor",
        stages="read_imu",
    ),
    result_view(
        "imu_samples",
        "The samples of sensors in SI units, with their orientations, from files or estimated.",
        f"""recording    VARCHAR    the recording
sensor    VARCHAR    name of the sensor in its file
sample    BIGINT    number of the sample, from 0
t    DOUBLE    seconds on the recording's clock
acc    {VECTOR}    specific force in m/s², in the sensor's axes; NULL where not measured
gyr    {VECTOR}    angular velocity in rad/s; NULL where not measured
mag    {VECTOR}    magnetic field, in µT where the file states its unit; NULL where not measured
orientation    {QUATERNION}    unit quaternion, sensor to X magnetic north, Y west, Z up; NULL where not known""",
        "SELECT recording, sensor, count(*) AS samples, max(t) - min(t) AS seconds "
        "FROM imu_samples GROUP BY recording, sensor ORDER BY recording, sensor",
        stages="read_imu",
    ),
    result_view(
        "sensor_sync",
        "The clocks of recordings against those of takes: what is added to a take's time to get the sensor's.",
        f"""{TAKE}
recording    VARCHAR    the recording
offset_s    DOUBLE    sensor time = take time + offset_s + ppm / 1e6 * take time; NULL where it was not found
ppm    DOUBLE    drift of the clock in parts per million
correlation    DOUBLE    correlation of angular speeds at the best offset, -1 to 1; NULL for a given offset
next_best    DOUBLE    the largest correlation 0.25 s or farther from it; NULL where there is none
limbs    INTEGER    number of limbs that were correlated
refined    BOOLEAN    the offset is that of the least orientation errors; false: of the correlation, or given
left_out    VARCHAR    the reason for which the take has no offset; NULL where it has one""",
        "SELECT take, recording, offset_s, correlation, next_best, left_out FROM sensor_sync ORDER BY correlation",
        stages="synchronise",
    ),
    result_view(
        "sensor_calibration",
        "The mounts of sensors on limbs and the rotation between the worlds of sensor and take.",
        f"""{TAKE}
recording    VARCHAR    the recording
sensor    VARCHAR    name of the sensor in its file
limb    VARCHAR    the limb that it is worn on
basis    VARCHAR    how the limb's orientation is known: full, hinge or none
q_global    {QUATERNION}    X magnetic north, Y west, Z up to the take's world; NULL where it was not found
q_mount    {QUATERNION}    sensor to limb; NULL where it was not found, and for basis none
direction    {VECTOR}    the limb's long axis in the sensor's axes, for basis none
frames    INTEGER    frames that were fitted
inliers    DOUBLE    share of them with an error below 15 degrees
median_deg    DOUBLE    median error of those
observability    DOUBLE    least eigenvalue of the normal equations; 0 where a direction is free
tilt_deg    DOUBLE    angle between the verticals of take and sensors, where it was fitted; else 0
drift    STRUCT(t DOUBLE, degrees DOUBLE)[]    correction of the sensor's heading at knots, seconds of the take
warning    VARCHAR    what makes the result doubtful; NULL where nothing does
left_out    VARCHAR    the reason for which the mount was not found; NULL where it was""",
        "SELECT take, limb, round(inliers, 2) AS inliers, median_deg, observability, left_out "
        "FROM sensor_calibration ORDER BY median_deg DESC",
        stages="calibrate_sensors",
    ),
)
