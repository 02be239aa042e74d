"""Define the views of limbs and inertial sensors (thesis, Chapter 7)."""

from __future__ import annotations

from kinedex.catalog.sql.columns import TAKE, result_view

QUATERNION = "STRUCT(w DOUBLE, x DOUBLE, y DOUBLE, z DOUBLE)"
VECTOR = "STRUCT(x DOUBLE, y DOUBLE, z DOUBLE)"
_RANGE = """start    INTEGER    first source frame, counted from 0
stop    INTEGER    source frame after the last
start_seconds    DOUBLE    time of the start in seconds
stop_seconds    DOUBLE    time of the stop in seconds"""

INERTIAL_VIEWS = (
    result_view(
        "limb_orientations",
        "The limbs of takes at the rate of their sources, with orientation, position, and the basis of the "
        "orientation.",
        f"""{TAKE}
limb    VARCHAR    name of the limb, such as lshank
source_frame    INTEGER    frame of the source, counted from 0; for takes made from recordings, frame of the take
t    DOUBLE    time of the frame in seconds
orientation    {QUATERNION}    unit quaternion from the limb's own axes to the world; NULL if unknown
position    {VECTOR}    position of the middle of the limb in metres, Y up; NULL if unknown
direction    {VECTOR}    unit vector from the near to the far joint in the world; NULL if unknown
basis    VARCHAR    basis of the orientation: full (node, markers, or joints of the trunk), hinge (long axis and \
plane of a joint) or none (long axis alone)
valid    BOOLEAN    true if the orientation is known, or for basis none the direction
jump    BOOLEAN    true if the frame is at a turn faster than 2,500 degrees per second
fit_mm    DOUBLE    root mean square distance of the markers from their rigid shape; NULL if there are no markers
fingerprint    VARCHAR    hash of everything that the limbs of the take depend on, for reuse""",
        "SELECT take, limb, max(basis) AS basis, count(*) FILTER (valid) AS valid, count(*) FILTER (jump) AS jumps "
        "FROM limb_orientations GROUP BY take, limb ORDER BY take, limb",
        stages="limb_orientations break_track",
    ),
    result_view(
        "imu_recordings",
        "The sensors of recordings, each with its limb, take, rate, channels and warnings.",
        f"""{TAKE}
recording    VARCHAR    name of the recording, whose sensors share a clock and are in one file or several files
sensor    VARCHAR    name of the sensor in its file
limb    VARCHAR    the limb on which the sensor is worn, such as lshank; NULL if it is assigned to no limb
file    VARCHAR    the file of the sensor
format    VARCHAR    format of the file
rate_hz    DOUBLE    samples per second
samples    BIGINT    number of samples
frame    VARCHAR    world axes of the orientations in the file; NULL if orientations are estimated
channels    VARCHAR[]    channels that the file has, of acc, gyr, mag and orientation
gaps    STRUCT(last_s DOUBLE, next_s DOUBLE)[]    times of the samples before and after each gap of more than 50 ms, \
in seconds of the sensor's clock
warnings    VARCHAR[]    warnings about contradictions in the file
orientation    VARCHAR    origin of the orientations: file, or estimated with (9D) or without (6D) the magnetic \
field; NULL if there are none
fingerprint    VARCHAR    hash of everything that the rows depend on, for reuse""",
        "SELECT recording, take, sensor, limb, rate_hz, warnings FROM imu_recordings ORDER BY recording, sensor",
        stages="read_imu",
    ),
    result_view(
        "imu_samples",
        "The samples of sensors in SI units, with their orientations, from files or estimated.",
        f"""recording    VARCHAR    the recording
sensor    VARCHAR    name of the sensor in its file
sample    BIGINT    number of the sample, from 0
t    DOUBLE    time in seconds on the recording's clock
acc    {VECTOR}    specific force in m/s², in the sensor's axes; NULL if it was not measured
gyr    {VECTOR}    angular velocity in rad/s; NULL if it was not measured
mag    {VECTOR}    magnetic field, in µT if the file states the unit; NULL if it was not measured
orientation    {QUATERNION}    unit quaternion from the sensor to X magnetic north, Y west, Z up; NULL if unknown""",
        "SELECT recording, sensor, count(*) AS samples, max(t) - min(t) AS seconds "
        "FROM imu_samples GROUP BY recording, sensor ORDER BY recording, sensor",
        stages="read_imu",
    ),
    result_view(
        "sensor_sync",
        "The clocks of recordings relative to takes: the offset and drift that convert a take's time to the "
        "sensor's time.",
        f"""{TAKE}
recording    VARCHAR    the recording
offset_s    DOUBLE    offset of the clock in seconds: sensor time = take time + offset_s + ppm / 1e6 * take time; \
NULL if it was not found
ppm    DOUBLE    drift of the clock in parts per million
correlation    DOUBLE    correlation of angular speeds at the best offset, -1 to 1; NULL for a given offset
next_best    DOUBLE    largest correlation at an offset that differs by 0.25 s or more; NULL if there is none
limbs    INTEGER    number of limbs that were correlated
refined    BOOLEAN    true if the offset was refined by the orientation errors; false if it comes from the \
correlation or was given
left_out    VARCHAR    reason why the take has no offset; NULL if it has one
fingerprint    VARCHAR    hash of everything that the rows of the take depend on, for reuse""",
        "SELECT take, recording, offset_s, correlation, next_best, left_out FROM sensor_sync ORDER BY correlation",
        stages="synchronise",
    ),
    result_view(
        "sensor_calibration",
        "The mounts of sensors on limbs and the rotation between the worlds of sensor and take.",
        f"""{TAKE}
recording    VARCHAR    the recording
sensor    VARCHAR    name of the sensor in its file
limb    VARCHAR    the limb on which the sensor is worn
basis    VARCHAR    basis of the limb's orientation: full, hinge or none
q_global    {QUATERNION}    unit quaternion from X magnetic north, Y west, Z up to the take's world; NULL if it was \
not found
q_mount    {QUATERNION}    unit quaternion from sensor to limb; NULL if it was not found, and for basis none
direction    {VECTOR}    long axis of the limb in the sensor's axes, for basis none
frames    INTEGER    number of frames that were fitted
inliers    DOUBLE    share of these frames with an error below 15 degrees
median_deg    DOUBLE    median error of these inliers in degrees
observability    DOUBLE    smallest eigenvalue of the normal equations; 0 if a direction is undetermined
tilt_deg    DOUBLE    angle between the verticals of take and sensors if it was fitted; otherwise 0
drift    STRUCT(t DOUBLE, degrees DOUBLE)[]    correction of the sensor's heading at knots, whose times are seconds \
of the take
warning    VARCHAR    reason why the result is doubtful; NULL if it is not
left_out    VARCHAR    reason why the mount was not found; NULL if it was found
fingerprint    VARCHAR    hash of everything that the rows of the take depend on, for reuse""",
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
limb    VARCHAR    the limb on which the sensor is worn
source_frame    INTEGER    frame of the source, counted from 0
t    DOUBLE    time of the frame in seconds
degrees    DOUBLE    the whole angle, from 0 to 180 degrees; NULL if unknown, and for basis none
swing_deg    DOUBLE    angle between the long axes of the limb; NULL if unknown
twist_deg    DOUBLE    angle of rotation about the long axis; NULL if unknown, and for basis none
valid    BOOLEAN    true if the frame counts: take and sensor are known, and the limb does not jump
tau_deg    DOUBLE    the error above which the take's frames are wrong, as in `limb_error_runs`
fingerprint    VARCHAR    hash of everything that the rows of the take depend on, for reuse""",
        "SELECT take, limb, median(coalesce(degrees, swing_deg)) AS median_deg, count(*) FILTER (valid) AS frames "
        "FROM limb_errors GROUP BY take, limb ORDER BY median_deg DESC",
        stages="limb_errors",
    ),
    result_view(
        "limb_error_runs",
        "The ranges of source frames in which a limb of a take is wrong, or jumps.",
        f"""{TAKE}
limb    VARCHAR    the limb
kind    VARCHAR    kind of the range: distance (the error is above tau_deg) or jump (the limb turns by more than \
2,500 degrees per second)
{_RANGE}
seconds    DOUBLE    duration in seconds
peak_deg    DOUBLE    largest error of the frames that count, in degrees; NULL if no frame counts
mean_deg    DOUBLE    mean error of the frames that count, in degrees
tau_deg    DOUBLE    error above which frames are wrong, in degrees; it applies to the swing if only that is known""",
        "SELECT take, limb, start_seconds, seconds, peak_deg FROM limb_error_runs WHERE kind = 'distance' "
        "ORDER BY seconds DESC LIMIT 10",
        stages="limb_errors",
    ),
    result_view(
        "limb_labels",
        "The ranges of source frames in which people have marked a limb as wrong.",
        f"""{TAKE}
limb    VARCHAR    the limb
annotator    VARCHAR    person who marked the limb; "unnamed" if no name is given
{_RANGE}
file    VARCHAR    the label file, or the id of the label in the store""",
        "SELECT take, limb, annotator, start_seconds, stop_seconds FROM limb_labels ORDER BY take, limb, start",
        stages="evaluate_limb_errors",
    ),
    result_view(
        "limb_error_metrics",
        "Precision, recall and F of limb errors against manual labels, over frames (p1, r1, f1) and segments.",
        """scope    VARCHAR    scope of the row: all, group (such as legs) or limb
name    VARCHAR    name of the group or limb; "all" for all limbs
detector    VARCHAR    sensors, or the annotator that is compared with another one
annotator    VARCHAR    annotator whose labels count as right; "all" for the labels of every annotator, one after the \
other
tau_deg    DOUBLE    error above which frames are wrong, in degrees; NULL if annotators are compared
p1    DOUBLE    precision by frames
r1    DOUBLE    recall by frames
f1    DOUBLE    F measure by frames
p2    DOUBLE    precision by segments
r2    DOUBLE    recall by segments
f2    DOUBLE    F measure by segments
frames_both    BIGINT    number of frames that both mark
frames_automatic    BIGINT    number of frames that the detector marks
frames_manual    BIGINT    number of frames that the annotator marks
segments_automatic_hit    BIGINT    number of segments of the detector that are right
segments_automatic    BIGINT    number of segments of the detector
segments_manual_hit    BIGINT    number of manual segments that were found
segments_manual    BIGINT    number of manual segments
frames    BIGINT    number of frames of limbs that count
takes    BIGINT    number of takes that were compared
printed_p1    DOUBLE    precision by frames as a publication prints it for other takes; NULL if it prints none
printed_r1    DOUBLE    recall by frames as printed
printed_source    VARCHAR    the publication and its table""",
        "SELECT name, annotator, tau_deg, p1, r1, f1, f2 FROM limb_error_metrics "
        "WHERE detector = 'sensors' AND tau_deg = 45 ORDER BY name, annotator",
        stages="evaluate_limb_errors",
    ),
)
