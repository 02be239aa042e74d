"""Define the views of camera recordings, tracks, priors, and their evaluation."""

from __future__ import annotations

from kinedex.catalog.sql.columns import TAKE, result_view

TRACKING_VIEWS = (
    result_view(
        "recordings",
        "Recordings of cameras that were read, and 3D tracks that are used like recordings.",
        """recording    VARCHAR    name of the recording
rate_hz    DOUBLE    frames per second
source_frames    BIGINT    number of frames
first_frame    BIGINT    number of the first frame in the files
cameras    VARCHAR[]    names of the cameras; empty for a 3D track
keypoint_set    VARCHAR    name of the keypoint set; NULL without keypoints
keypoints    VARCHAR[]    names of the keypoints that have a place on the body
silhouettes    BOOLEAN    true if there are silhouettes, which stay in their files
cuts    INTEGER[]    frames that do not continue the previous frame
track    VARCHAR    the take that is used as a 3D track; NULL for recordings of cameras
body    VARCHAR    the take whose bone lengths are used, or "estimate"
truth    VARCHAR    the take or file with the truth
file    VARCHAR    the recordings file
remarks    VARCHAR[]    remarks made when the recording was read
checksum    VARCHAR    hash of all files of the recording
fingerprint    VARCHAR    hash of everything that was read, for reuse""",
        "SELECT recording, len(cameras) AS cameras, source_frames / rate_hz AS seconds FROM recordings ORDER BY ALL",
        stages="observe",
    ),
    result_view(
        "recording_files",
        "The files of recordings.",
        """recording    VARCHAR    name of the recording
kind    VARCHAR    kind of the file: recordings, calibration, keypoints, silhouettes or track
path    VARCHAR    path of the file
bytes    BIGINT    size of the file in bytes
checksum    VARCHAR    SHA-256 of the file""",
        "SELECT recording, kind, count(*) AS files, sum(bytes) AS bytes FROM recording_files GROUP BY ALL ORDER BY ALL",
        stages="observe",
    ),
    result_view(
        "cameras",
        "The calibrated cameras of recordings: x_camera = R x_world + t, in metres, Y up.",
        """recording    VARCHAR    name of the recording
camera    VARCHAR    name of the camera
number    INTEGER    index of the camera, from 0
width    INTEGER    width of the image in pixels
height    INTEGER    height of the image in pixels
matrix    DOUBLE[]    camera matrix (3 × 3), row by row, in pixels
distortion    DOUBLE[]    distortion coefficients in OpenCV's order; empty if there are none
rotation    DOUBLE[]    rotation R (3 × 3), row by row
translation    DOUBLE[]    translation t in metres
centre    DOUBLE[]    position of the camera in the world in metres""",
        "SELECT recording, camera, centre[1] AS x, centre[2] AS y, centre[3] AS z FROM cameras ORDER BY ALL",
        stages="observe",
    ),
    result_view(
        "observations",
        "The keypoints that the cameras saw, in pixels.",
        """recording    VARCHAR    name of the recording
camera    VARCHAR    name of the camera
source_frame    INTEGER    frame of the recording, counted from 0
keypoint    VARCHAR    name of the keypoint
x    DOUBLE    coordinate to the right, in pixels
y    DOUBLE    downward coordinate, in pixels
confidence    DOUBLE    confidence of the detector, above 0 and at most 1""",
        "SELECT camera, keypoint, avg(confidence) AS confidence FROM observations GROUP BY ALL ORDER BY ALL LIMIT 10",
        stages="observe",
    ),
    result_view(
        "tracks",
        "Takes that were tracked or stabilised, with one row for each take.",
        f"""{TAKE}
recording    VARCHAR    the recording of the take; NULL for a take that was stabilised without a recording
track_of    VARCHAR    the take that was stabilised; NULL for a tracked take
tracker    VARCHAR    the tracker: take or frames
chain    VARCHAR    the kinematic chain
nodes    VARCHAR[]    names of the nodes, in the order of `chain_poses`
joints    VARCHAR[]    names of the joints, in the order of `body` and `moved_mm`
body    DOUBLE[]    position of each joint in the frame of its node in metres, three numbers a joint
body_from    VARCHAR    origin of the bone lengths: a take, "estimate", or the track itself
sigma_px    DOUBLE    standard deviation of a keypoint in pixels, with which the take was tracked
rate_hz    DOUBLE    frames per second of the poses
source_frames    BIGINT    number of poses
rounds    INTEGER    number of rounds with priors; 0 for a tracked take
hits    INTEGER    number of hits that provided priors in the last round
withdrawn    INTEGER    number of hits whose priors were withdrawn, wholly or in part, in all rounds
remarks    VARCHAR[]    remarks about the take
fingerprint    VARCHAR    hash of everything that the take depends on""",
        "SELECT take, tracker, source_frames / rate_hz AS seconds, hits, withdrawn FROM tracks ORDER BY take",
        stages="track stabilise",
    ),
    result_view(
        "chain_poses",
        "Poses of the kinematic chain of tracked and stabilised takes, at the rate of their recording.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, counted from 0
place    DOUBLE[]    position of the root in metres
turns    DOUBLE[]    rotation vector of each node relative to its parent in radians, three numbers a node""",
        "SELECT take, source_frame, place FROM chain_poses ORDER BY take, source_frame LIMIT 5",
        stages="track stabilise",
    ),
    result_view(
        "track_frames",
        "Frames of tracked and stabilised takes: cost, cameras, and what has moved.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, counted from 0
cost    DOUBLE    robust cost of the observations in this frame
cameras    INTEGER    number of cameras that saw the body; NULL without cameras
agreeing    DOUBLE    number of cameras that agree with the track, averaged over the keypoints
trusted    DOUBLE    share of the keypoints that are reliable
contested    INTEGER    number of keypoints in which the cameras disagree
lost    BOOLEAN    true if the tracker had lost the body
moved_mm    DOUBLE[]    distance by which priors moved each joint, in mm; NULL for a tracked take""",
        "SELECT take, avg(trusted) AS trusted, avg(cost) AS cost FROM track_frames GROUP BY take ORDER BY take",
        stages="track stabilise",
    ),
    result_view(
        "track_cameras",
        "Residuals of the rays of each camera: a bad calibration shows as one camera that differs.",
        f"""{TAKE}
camera    VARCHAR    name of the camera
keypoints    BIGINT    number of observations that were used
median_px    DOUBLE    median distance of a keypoint from the track in the image, in pixels
p90_px    DOUBLE    90th percentile of this distance, in pixels
weight    DOUBLE    mean robust weight, from 0 (excluded) to 1""",
        "SELECT take, camera, median_px, weight FROM track_cameras ORDER BY take, camera",
        stages="track stabilise",
    ),
    result_view(
        "archive_poses",
        "The mean poses of the example clips of each class, for each column of its template.",
        """class    VARCHAR    the class of the template
clips    VARCHAR[]    the example clips
columns    INTEGER    number of columns of the template
nodes    VARCHAR[]    names of the nodes of the kinematic chain
means    DOUBLE[]    mean rotation of each node, columns × nodes × 3 × 3
spreads    DOUBLE[]    spread about the axes of each node in radians, columns × nodes × 3
tilts    DOUBLE[]    mean direction of the up axis seen from the first node, columns × 3
fingerprint    VARCHAR    hash of everything that the poses depend on""",
        "SELECT class, len(clips) AS clips, columns FROM archive_poses ORDER BY class",
        stages="stabilise",
    ),
    result_view(
        "priors",
        "The priors of takes, which come from hits in the archive, and the priors that were withdrawn.",
        f"""{TAKE}
round    INTEGER    number of the round, from 1
kind    VARCHAR    kind of the prior: archive, pose, or a constraint (foot_on_ground, elbow_bent, hand_to_front, \
foot_to_front)
side    VARCHAR    side of a constraint, left or right; NULL for other kinds
class    VARCHAR    class of the hit
hit    INTEGER    number of the hit within its round
source_start    INTEGER    first frame of the recording, from 0
source_stop    INTEGER    frame of the recording after the last
start_seconds    DOUBLE    time of the start in seconds
stop_seconds    DOUBLE    time of the stop in seconds
first_column    INTEGER    column of the template in the first frame, from 0
last_column    INTEGER    column of the template in the last frame
cost    DOUBLE    cost of the hit, at least 0
weight    DOUBLE    factor by which the weights of the priors were multiplied
kept    BOOLEAN    false for priors that were withdrawn
reason    VARCHAR    the reason for which they were withdrawn""",
        "SELECT take, class, count(*) FILTER (NOT kept) AS withdrawn, count(*) AS hits FROM priors GROUP BY ALL "
        "ORDER BY ALL",
        stages="stabilise",
    ),
    result_view(
        "track_metrics",
        "The distances of tracked and stabilised takes from the truth, and the angles between their limbs and sensors.",
        f"""{TAKE}
reference    VARCHAR    object of the comparison: the truth, which is a take or a file of positions, or sensors
scope    VARCHAR    scope of the row: take, joint, part (frames with or without failures), or, for angles against \
sensors, sensors or limb
name    VARCHAR    name of the joint, part or limb; "all" for a take
frames    BIGINT    number of frames that were compared
mean_mm    DOUBLE    mean distance
sd_mm    DOUBLE    standard deviation over the frames' means
median_mm    DOUBLE    median distance
max_mm    DOUBLE    largest mean distance of a frame
mean_deg    DOUBLE    mean angle between limb and sensor; NULL for distances
sd_deg    DOUBLE    standard deviation of the angles
median_deg    DOUBLE    median angle
max_deg    DOUBLE    largest angle""",
        "SELECT take, mean_mm, max_mm FROM track_metrics WHERE scope = 'take' ORDER BY take",
        stages="evaluate_track",
    ),
)
