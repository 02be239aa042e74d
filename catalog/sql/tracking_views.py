"""Define the views of camera recordings, tracks, priors, and their evaluation."""

from __future__ import annotations

from kinedex.catalog.sql.columns import TAKE, result_view

TRACKING_VIEWS = (
    result_view(
        "recordings",
        "Recordings of cameras that were read, and 3D tracks that stand for one.",
        """recording    VARCHAR    name of the recording
rate_hz    DOUBLE    frames per second
source_frames    BIGINT    its number of frames
first_frame    BIGINT    the number that its files give the first frame
cameras    VARCHAR[]    names of its cameras; empty for a 3D track
keypoint_set    VARCHAR    the set of its keypoints; NULL without keypoints
keypoints    VARCHAR[]    names of its keypoints that have a place on the body
silhouettes    BOOLEAN    true where it has silhouettes, which stay in their files
cuts    INTEGER[]    frames that do not follow from the frame before
track    VARCHAR    the take that stands for it; NULL for cameras
body    VARCHAR    the take whose bone lengths are used, or estimate
truth    VARCHAR    the take or file that it is compared with
file    VARCHAR    the recordings file
remarks    VARCHAR[]    remarks of its reader
checksum    VARCHAR    hash of all its files
fingerprint    VARCHAR    hash of all that was read, for reuse""",
        "SELECT recording, len(cameras) AS cameras, source_frames / rate_hz AS seconds FROM recordings ORDER BY ALL",
        stages="observe",
    ),
    result_view(
        "recording_files",
        "The files of recordings.",
        """recording    VARCHAR    name of the recording
kind    VARCHAR    recordings, calibration, keypoints, silhouettes or track
path    VARCHAR    the file
bytes    BIGINT    its size
checksum    VARCHAR    its SHA-256""",
        "SELECT recording, kind, count(*) AS files, sum(bytes) AS bytes FROM recording_files GROUP BY ALL ORDER BY ALL",
        stages="observe",
    ),
    result_view(
        "cameras",
        "The calibrated cameras of recordings: x_camera = R x_world + t, in metres, Y up.",
        """recording    VARCHAR    name of the recording
camera    VARCHAR    name of the camera
number    INTEGER    its place among the cameras, from 0
width    INTEGER    of its image in pixels
height    INTEGER    of its image in pixels
matrix    DOUBLE[]    camera matrix (3 × 3), row by row, in pixels
distortion    DOUBLE[]    distortion numbers in OpenCV's order; empty for none
rotation    DOUBLE[]    R (3 × 3), row by row
translation    DOUBLE[]    t in metres
centre    DOUBLE[]    its place in the world in metres""",
        "SELECT recording, camera, centre[1] AS x, centre[2] AS y, centre[3] AS z FROM cameras ORDER BY ALL",
        stages="observe",
    ),
    result_view(
        "observations",
        "What the cameras saw: keypoints in pixels, without those that were not seen.",
        """recording    VARCHAR    name of the recording
camera    VARCHAR    name of the camera
source_frame    INTEGER    frame of the recording, from 0
keypoint    VARCHAR    name of the keypoint
x    DOUBLE    to the right, in pixels
y    DOUBLE    downwards, in pixels
confidence    DOUBLE    of the detector, above 0 to 1""",
        "SELECT camera, keypoint, avg(confidence) AS confidence FROM observations GROUP BY ALL ORDER BY ALL LIMIT 10",
        stages="observe",
    ),
    result_view(
        "tracks",
        "Takes that were tracked or stabilised, one row each.",
        f"""{TAKE}
recording    VARCHAR    the recording that it comes from; NULL for a take that was stabilised without one
track_of    VARCHAR    the take that was stabilised; NULL for one that was tracked
tracker    VARCHAR    take or frames
chain    VARCHAR    the kinematic chain
nodes    VARCHAR[]    nodes of the chain, in the order of `chain_poses`
joints    VARCHAR[]    joints of the chain, in the order of `body` and `moved_mm`
body    DOUBLE[]    place of each joint in the frame of its node in metres, three numbers a joint
body_from    VARCHAR    origin of the lengths: a take, estimate, or the track itself
sigma_px    DOUBLE    standard deviation of a keypoint that it was tracked with, in pixels
rate_hz    DOUBLE    frames per second of its poses
source_frames    BIGINT    its number of poses
rounds    INTEGER    rounds with priors; 0 for a take that was tracked
hits    INTEGER    hits that lent priors in the last round
withdrawn    INTEGER    hits whose priors were withdrawn, wholly or in part, in all rounds
remarks    VARCHAR[]    remarks about it
fingerprint    VARCHAR    hash of all that it follows from""",
        "SELECT take, tracker, source_frames / rate_hz AS seconds, hits, withdrawn FROM tracks ORDER BY take",
        stages="track stabilise",
    ),
    result_view(
        "chain_poses",
        "Poses of the kinematic chain of tracked and stabilised takes, at the rate of their recording.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, from 0
place    DOUBLE[]    place of the root in metres
turns    DOUBLE[]    rotation vector of each node from its parent in radians, three numbers a node""",
        "SELECT take, source_frame, place FROM chain_poses ORDER BY take, source_frame LIMIT 5",
        stages="track stabilise",
    ),
    result_view(
        "track_frames",
        "Frames of tracked and stabilised takes: cost, cameras, and what has moved.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, from 0
cost    DOUBLE    robust cost of the observations in this frame
cameras    INTEGER    cameras that saw the body; NULL without cameras
agreeing    DOUBLE    cameras that agree with the track, on average over the keypoints
trusted    DOUBLE    share of the keypoints that are trusted
contested    INTEGER    keypoints in which the cameras disagree
lost    BOOLEAN    true where the tracker had lost the body
moved_mm    DOUBLE[]    distance that each joint was moved by priors; NULL for a take that was tracked""",
        "SELECT take, avg(trusted) AS trusted, avg(cost) AS cost FROM track_frames GROUP BY take ORDER BY take",
        stages="track stabilise",
    ),
    result_view(
        "track_cameras",
        "Residuals of the rays of each camera: a bad calibration shows as one camera that differs.",
        f"""{TAKE}
camera    VARCHAR    name of the camera
keypoints    BIGINT    observations that were used
median_px    DOUBLE    median distance of a keypoint from the track in the image, in pixels
p90_px    DOUBLE    its 90th percentile
weight    DOUBLE    mean robust weight, from 0 (excluded) to 1""",
        "SELECT take, camera, median_px, weight FROM track_cameras ORDER BY take, camera",
        stages="track stabilise",
    ),
    result_view(
        "archive_poses",
        "The poses of classes, for each column of their templates, as the example clips have them.",
        """class    VARCHAR    the class of the template
clips    VARCHAR[]    the example clips
columns    INTEGER    columns of the template
nodes    VARCHAR[]    nodes of the kinematic chain
means    DOUBLE[]    mean rotation of each node, columns × nodes × 3 × 3
spreads    DOUBLE[]    spread about the axes of each node in radians, columns × nodes × 3
tilts    DOUBLE[]    mean direction of the up axis seen from the first node, columns × 3
fingerprint    VARCHAR    hash of all that the poses follow from""",
        "SELECT class, len(clips) AS clips, columns FROM archive_poses ORDER BY class",
        stages="stabilise",
    ),
    result_view(
        "priors",
        "The priors that hits in the archive have lent to takes, and those that were withdrawn.",
        f"""{TAKE}
round    INTEGER    from 1
kind    VARCHAR    archive, pose, or the constraint: foot_on_ground, elbow_bent, hand_to_front or foot_to_front
side    VARCHAR    left or right of a constraint; NULL for other kinds
class    VARCHAR    class of the hit
hit    INTEGER    number of the hit within its round
source_start    INTEGER    first frame of the recording, from 0
source_stop    INTEGER    frame of the recording after the last
start_seconds    DOUBLE    start as time
stop_seconds    DOUBLE    stop as time
first_column    INTEGER    column of the template in the first frame, from 0
last_column    INTEGER    column of the template in the last frame
cost    DOUBLE    cost of the hit, from 0
weight    DOUBLE    factor of the weights of its priors
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
reference    VARCHAR    the truth, a take or a file of positions; or sensors
scope    VARCHAR    take, joint, or part: frames with and without trouble; sensors, or limb: angles against sensors
name    VARCHAR    which joint, part or limb; all for a take
frames    BIGINT    frames that were compared
mean_mm    DOUBLE    mean distance
sd_mm    DOUBLE    standard deviation over the frames' means
median_mm    DOUBLE    median distance
max_mm    DOUBLE    greatest mean of a frame
mean_deg    DOUBLE    mean angle between limb and sensor; NULL for distances
sd_deg    DOUBLE    standard deviation of the angles
median_deg    DOUBLE    median angle
max_deg    DOUBLE    greatest angle""",
        "SELECT take, mean_mm, max_mm FROM track_metrics WHERE scope = 'take' ORDER BY take",
        stages="evaluate_track",
    ),
)
