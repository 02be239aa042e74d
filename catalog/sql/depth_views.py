"""Define the views of the pose database, of takes reconstructed from depth, and of their evaluation."""

from __future__ import annotations

from kinedex.catalog.sql.columns import TAKE, result_view

DEPTH_VIEWS = (
    result_view(
        "poses",
        "The pose database: poses of the archive that differ, as unit directions of bones.",
        f"""pose    INTEGER    number of the pose, from 0, in the order of take name and frame
{TAKE}
frame    INTEGER    frame of the take, counted from 0
directions    FLOAT[]    unit vector along the bone to each joint, three numbers a joint; 0 for bones without length""",
        "SELECT take, count(*) AS poses FROM poses GROUP BY take ORDER BY poses DESC, take LIMIT 10",
        stages="pose_database",
    ),
    result_view(
        "pose_takes",
        "The takes from which the pose database was made, including those without a pose in it.",
        f"""{TAKE}
actor    VARCHAR    actor of the take; each actor counts once in the mean of the archive, and NULL counts as one actor
frames    BIGINT    length of the take in frames
poses    INTEGER    number of poses of the take in the database
distance_m    DOUBLE    distance in metres below which a frame is represented by another pose of the database
bone_lengths    DOUBLE[]    median length in metres of the bone that ends at each joint; NULL where joints are missing
stands_for    INTEGER[]    number of a pose within distance_m for each frame; NULL for a frame without a word
fingerprint    VARCHAR    hash of everything that the directions depend on""",
        "SELECT take, frames, poses FROM pose_takes WHERE poses = 0 ORDER BY take",
        stages="pose_database",
    ),
    result_view(
        "reconstructions",
        "Takes that were reconstructed from depth recordings, with one row for each take.",
        f"""{TAKE}
recording    VARCHAR    the recording of the take
file    VARCHAR    the recordings file; NULL for a live camera
form    VARCHAR    form of the method: best, or printed (as in the thesis)
direction    VARCHAR    direction of time in which the take was tracked: forward or both
hypotheses    VARCHAR[]    hypotheses that took part: local, database
candidates    INTEGER    number of poses of the database that were tried in a frame
stride    INTEGER    step between the rows and columns of an image whose pixels were used
smooth_hz    DOUBLE    frequency above which motion was damped; NULL if it was not
body_from    VARCHAR    origin of the bones: a take, or "estimate"
height_m    DOUBLE    standing height in metres
joints    VARCHAR[]    names of the joints, in the order of `bone_lengths` and of `joints` in `reconstruction_frames`
bone_lengths    DOUBLE[]    length in metres of the bone that ends at each joint
floor_m    DOUBLE    height of the camera above the floor in metres; NULL where no floor is known
turn    DOUBLE[]    rotation, row by row, from the camera's axes (x right, y down, z forward) to the world
place    DOUBLE[]    position of the camera in the world in metres
rate_hz    DOUBLE    frames per second of the recording
source_frames    BIGINT    number of frames
unseen_frames    BIGINT    number of frames without a pose
first_frame    INTEGER    number of the first frame in the names of the files
remarks    VARCHAR[]    remarks about the take
fingerprint    VARCHAR    hash of everything that the take depends on""",
        "SELECT take, source_frames / rate_hz AS seconds, height_m, unseen_frames FROM reconstructions ORDER BY take",
        stages="reconstruct",
    ),
    result_view(
        "reconstruction_frames",
        "Frames of depth recordings, with the hypothesis that was chosen, its costs, and the data it is based on.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, counted from 0
hypothesis    VARCHAR    the hypothesis that was chosen: local or database; NULL without a person
direction    VARCHAR    direction of time of the track that the frame is taken from: forward or backward
cost_local    DOUBLE    cost of the local hypothesis in the vote, in metres; NULL if there is none
cost_database    DOUBLE    cost of the hypothesis from the database, in metres; NULL if there is none
archive_take    VARCHAR    the take of the pose from the database
archive_frame    INTEGER    the frame of this take
points    INTEGER    number of points of the person
components    INTEGER    number of components of the graph of the points
links    INTEGER    number of edges that were added between components
maps    INTEGER    number of assignments of end effectors to extrema that were tried
facing    DOUBLE[]    horizontal facing direction in the world, by which the extrema were rotated
centre    DOUBLE[]    centre of the points in the world in metres
extrema    DOUBLE[]    geodesic extrema in the world, three numbers each; NaN if there are fewer
unseen    VARCHAR[]    names of the joints whose surface is nearest to no point
joints    DOUBLE[]    positions of the joints in the world in metres, three numbers a joint; NULL without a person
remarks    VARCHAR[]    reasons why the frame is doubtful""",
        "SELECT archive_take, count(*) AS frames FROM reconstruction_frames WHERE hypothesis = 'database' GROUP BY ALL "
        "ORDER BY ALL",
        stages="reconstruct",
    ),
    result_view(
        "depth_votes",
        "The hypotheses and candidates that were tried for each frame of depth recordings, with their costs.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, counted from 0
direction    VARCHAR    direction of time: forward or backward
hypothesis    VARCHAR    the hypothesis: local or database
candidate    INTEGER    number of the candidate, from 1, the cheapest first and one that faces another direction \
last; NULL for local
archive_take    VARCHAR    the take of the candidate; NULL for local
archive_frame    INTEGER    the frame of this take
ends    INTEGER[]    number of the extremum, from 1, that is assigned to left and right fingers, left and right toes, \
and top of the head
ends_m    DOUBLE    sum of the distances of these extrema from the end effectors of the previous pose; NULL if the \
lowest two are the feet
distance_m    DOUBLE    root mean square distance of the end effectors from the extrema
lookup_cost    DOUBLE    cost by which the candidate was looked up (thesis, Eq. 8.6)
trial_cost    DOUBLE    cost after a short fit; NULL if there was only one candidate
cost    DOUBLE    cost in the vote after the whole fit; NULL for candidates that were not fitted
surface    DOUBLE    part of the cost for the surface (thesis, Eq. 8.7)
extrema    DOUBLE    part of the cost for the extrema (thesis, Eq. 8.8)
points    DOUBLE    part of the cost for all points
winner    BOOLEAN    true for the pose that the take has""",
        "SELECT take, source_frame, archive_take, archive_frame, cost FROM depth_votes WHERE winner AND candidate > 0 "
        "ORDER BY ALL LIMIT 10",
        stages="reconstruct",
    ),
    result_view(
        "reconstruction_errors",
        "The distances of reconstructed takes from the truth.",
        f"""{TAKE}
reference    VARCHAR    the truth, which is a take or a file
scope    VARCHAR    scope of the row: all, take or joint (or marker)
name    VARCHAR    name of the joint or marker; "all" for the other scopes
offset_m    DOUBLE[]    position of a marker in the axes of the body part that it is fixed to, in metres; NULL for \
joints
mean_m    DOUBLE    mean distance in metres
std_m    DOUBLE    standard deviation over the frames in metres
median_m    DOUBLE    median over the frames in metres
p90_m    DOUBLE    90th percentile over the frames in metres
frames    BIGINT    number of frames that were compared
unseen_frames    BIGINT    number of frames with known truth and without a pose
over_10cm    DOUBLE    share of the frames with a mean distance above 10 cm
rate_five_ends    DOUBLE    share of the frames in which all five end effectors are found; NULL for joints and \
markers""",
        "SELECT take, mean_m, median_m, over_10cm FROM reconstruction_errors WHERE scope = 'take' ORDER BY take",
        stages="evaluate_reconstruction",
    ),
)
