"""Define the views of limbs and inertial sensors (thesis, Chapter 7)."""

from __future__ import annotations

from kinedex.catalog.sql.columns import TAKE, result_view

QUATERNION = "STRUCT(w DOUBLE, x DOUBLE, y DOUBLE, z DOUBLE)"
VECTOR = "STRUCT(x DOUBLE, y DOUBLE, z DOUBLE)"
_RANGE = """start    INTEGER    first source frame, from 0
stop    INTEGER    source frame after the last
start_seconds    DOUBLE    start as time
stop_seconds    DOUBLE    stop as time"""

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
basis    VARCHAR    full (node, markers, or joints of the trunk), hinge (long axis, a joint's plane) or none (long axis)
valid    BOOLEAN    the orientation is known, or for basis none the direction
jump    BOOLEAN    the frame is at a turn faster than 2,500 degrees a second
fit_mm    DOUBLE    root mean square distance of the markers to their shape; NULL where there are none
fingerprint    VARCHAR    a hash of all that the limbs of the take follow from, for reuse""",
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
left_out    VARCHAR    the reason for which the take has no offset; NULL where it has one
fingerprint    VARCHAR    a hash of all that the rows of the take follow from, for reuse""",
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
left_out    VARCHAR    the reason for which the mount was not found; NULL where it was
fingerprint    VARCHAR    a hash of all that the rows of the take follow from, for reuse""",
        "SELECT take, limb, round(inliers, 2) AS inliers, median_deg, observability, left_out "
        "FROM sensor_calibration ORDER BY median_deg DESC",
        stages="calibrate_sensors",
    ),
    result_view(
        "limb_errors",
        "The angle between what a take and what a sensor report of a limb, frame by frame (thesis, Eq. 7.16).",
        f"""{TAKE}
recording    VARCHAR    the recording
sensor    VARCHAR    name of the sensor in its file
limb    VARCHAR    the limb that it is worn on
source_frame    INTEGER    frame of the source, from 0
t    DOUBLE    its time in seconds
degrees    DOUBLE    the whole angle, 0 to 180; NULL where it is not known, and for basis none
swing_deg    DOUBLE    turn of the limb's long axis; NULL where it is not known
twist_deg    DOUBLE    turn about the long axis; NULL where it is not known, and for basis none
valid    BOOLEAN    the frame counts: take and sensor are known, and the limb does not jump
tau_deg    DOUBLE    the error above which the take's frames are wrong, as in `limb_error_runs`
fingerprint    VARCHAR    a hash of all that the rows of the take follow from, for reuse""",
        "SELECT take, limb, median(coalesce(degrees, swing_deg)) AS median_deg, count(*) FILTER (valid) AS frames "
        "FROM limb_errors GROUP BY take, limb ORDER BY median_deg DESC",
        stages="limb_errors",
    ),
    result_view(
        "limb_error_runs",
        "The ranges of source frames in which a limb of a take is wrong, or jumps.",
        f"""{TAKE}
limb    VARCHAR    the limb
kind    VARCHAR    distance (the error is above tau_deg) or jump (the limb turns by more than 2,500 degrees a second)
{_RANGE}
seconds    DOUBLE    its duration
peak_deg    DOUBLE    largest error of the frames that count; NULL where none does
mean_deg    DOUBLE    their mean error
tau_deg    DOUBLE    the error above which frames are wrong; the swing where only that is known""",
        "SELECT take, limb, start_seconds, seconds, peak_deg FROM limb_error_runs WHERE kind = 'distance' "
        "ORDER BY seconds DESC LIMIT 10",
        stages="limb_errors",
    ),
    result_view(
        "limb_labels",
        "The ranges of source frames in which people have marked a limb as wrong.",
        f"""{TAKE}
limb    VARCHAR    the limb
annotator    VARCHAR    who marked it; unnamed where nobody is named
{_RANGE}
file    VARCHAR    the label file, or the label of the store""",
        "SELECT take, limb, annotator, start_seconds, stop_seconds FROM limb_labels ORDER BY take, limb, start",
        stages="evaluate_limb_errors",
    ),
    result_view(
        "limb_error_metrics",
        "Precision, recall and F of limb errors against manual labels, over frames (p1, r1, f1) and segments.",
        """scope    VARCHAR    all, group (such as legs) or limb
name    VARCHAR    of which group or limb; all for all
detector    VARCHAR    sensors, or the annotator that is compared with another one
annotator    VARCHAR    whose labels count as right; all: those of every annotator, one after the other
tau_deg    DOUBLE    the error above which frames are wrong; NULL where annotators are compared
p1    DOUBLE    precision by frames
r1    DOUBLE    recall by frames
f1    DOUBLE    F measure by frames
p2    DOUBLE    precision by segments
r2    DOUBLE    recall by segments
f2    DOUBLE    F measure by segments
frames_both    BIGINT    frames that both mark
frames_automatic    BIGINT    frames that the detector marks
frames_manual    BIGINT    frames that the annotator marks
segments_automatic_hit    BIGINT    segments of the detector that are right
segments_automatic    BIGINT    segments of the detector
segments_manual_hit    BIGINT    manual segments that were found
segments_manual    BIGINT    manual segments
frames    BIGINT    frames of limbs that count
takes    BIGINT    takes that were compared
printed_p1    DOUBLE    precision by frames as a publication prints it for other takes; NULL where it prints none
printed_r1    DOUBLE    recall by frames as printed
printed_source    VARCHAR    the publication and its table""",
        "SELECT name, annotator, tau_deg, p1, r1, f1, f2 FROM limb_error_metrics "
        "WHERE detector = 'sensors' AND tau_deg = 45 ORDER BY name, annotator",
        stages="evaluate_limb_errors",
    ),
)
