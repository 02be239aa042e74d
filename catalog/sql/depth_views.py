"""Define the views of the pose database, of takes reconstructed from depth, and of their evaluation."""

from __future__ import annotations

from kinedex.catalog.sql.columns import TAKE, result_view

DEPTH_VIEWS = (
    result_view(
        "poses",
        "The pose database: poses of the archive that differ, as unit directions of bones.",
        f"""pose    INTEGER    its number, from 0, in order of take name and frame
{TAKE}
frame    INTEGER    frame of the take, from 0
directions    FLOAT[]    unit vector along the bone to each joint, three numbers a joint; 0 for bones without length""",
        "SELECT take, count(*) AS poses FROM poses GROUP BY take ORDER BY poses DESC, take LIMIT 10",
        stages="pose_database",
    ),
    result_view(
        "pose_takes",
        "The takes that the pose database was made of, also those that lend no pose.",
        f"""{TAKE}
actor    VARCHAR    their actor, whose bones count once in the mean of the archive; NULL counts as one actor
frames    BIGINT    its length in frames
poses    INTEGER    number of its poses in the database
distance_m    DOUBLE    a frame is no pose of the database where it is so near to another one, in metres
bone_lengths    DOUBLE[]    median length in metres of the bone that ends at each joint; NULL where joints are missing
stands_for    INTEGER[]    for each frame the number of a pose within distance_m; NULL without a word
fingerprint    VARCHAR    hash of all that its directions follow from""",
        "SELECT take, frames, poses FROM pose_takes WHERE poses = 0 ORDER BY take",
        stages="pose_database",
    ),
    result_view(
        "reconstructions",
        "Takes that were reconstructed from depth recordings, one row each.",
        f"""{TAKE}
recording    VARCHAR    the recording that it comes from
file    VARCHAR    the recordings file; NULL for a live camera
form    VARCHAR    best, or printed: the thesis's
direction    VARCHAR    both or forward in time
hypotheses    VARCHAR[]    those that took part: local, database
candidates    INTEGER    poses of the database that were tried in a frame
stride    INTEGER    every how many rows and columns of the images a pixel was used
smooth_hz    DOUBLE    frequency above which motion was damped; NULL where it was not
body_from    VARCHAR    origin of the bones: a take, or estimate
height_m    DOUBLE    standing height in metres
joints    VARCHAR[]    the joints, in the order of `bone_lengths` and of `joints` in `reconstruction_frames`
bone_lengths    DOUBLE[]    length in metres of the bone that ends at each joint
floor_m    DOUBLE    height of the camera above the floor in metres; NULL where no floor is known
turn    DOUBLE[]    rotation, row by row, from the camera's axes (x right, y down, z forward) to the world
place    DOUBLE[]    the camera in the world in metres
rate_hz    DOUBLE    frames per second of the recording
source_frames    BIGINT    its number of frames
unseen_frames    BIGINT    frames without a pose
first_frame    INTEGER    number of its first frame in the names of the files
remarks    VARCHAR[]    remarks about it
fingerprint    VARCHAR    hash of all that it follows from""",
        "SELECT take, source_frames / rate_hz AS seconds, height_m, unseen_frames FROM reconstructions ORDER BY take",
        stages="reconstruct",
    ),
    result_view(
        "reconstruction_frames",
        "Frames of depth recordings: the hypothesis that was taken, its costs, and what it rests on.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, from 0
hypothesis    VARCHAR    local or database; NULL without a person
direction    VARCHAR    forward or backward: the track that the frame is taken from
cost_local    DOUBLE    cost of the local hypothesis in the vote, in metres; NULL without one
cost_database    DOUBLE    cost of the database's
archive_take    VARCHAR    the take that lent the database's pose
archive_frame    INTEGER    its frame
points    INTEGER    points of the person
components    INTEGER    components of their graph
links    INTEGER    edges that were added between components
maps    INTEGER    assignments of ends to extrema that were tried
facing    DOUBLE[]    horizontal direction that extrema were turned by, in the world
centre    DOUBLE[]    centre of the points in the world in metres
extrema    DOUBLE[]    geodesic extrema in the world, three numbers each, NaN where there are fewer
unseen    VARCHAR[]    joints whose surface is nearest to no point
joints    DOUBLE[]    the joints in the world in metres, three numbers a joint; NULL without a person
remarks    VARCHAR[]    what makes the frame doubtful""",
        "SELECT archive_take, count(*) AS frames FROM reconstruction_frames WHERE hypothesis = 'database' GROUP BY ALL "
        "ORDER BY ALL",
        stages="reconstruct",
    ),
    result_view(
        "depth_votes",
        "The hypotheses of each frame of depth recordings: what was tried, what it costs, and what was taken.",
        f"""{TAKE}
source_frame    INTEGER    frame of the recording, from 0
direction    VARCHAR    forward or backward in time
hypothesis    VARCHAR    local or database
candidate    INTEGER    number of the candidate, from 1, cheapest first, one facing elsewhere last; NULL: local
archive_take    VARCHAR    the take that it comes from; NULL for local
archive_frame    INTEGER    its frame
ends    INTEGER[]    the extremum, from 1, that counts as left and right fingers, left and right toes, top of the head
ends_m    DOUBLE    sum of their distances from the ends of the pose before; NULL where the lowest two count as feet
distance_m    DOUBLE    distance of its ends from the extrema (root mean square)
lookup_cost    DOUBLE    cost by which it was looked up (thesis, Eq. 8.6)
trial_cost    DOUBLE    cost after a short fit; NULL where there was one candidate
cost    DOUBLE    cost in the vote after the whole fit; NULL for candidates that were not fitted
surface    DOUBLE    its part of the surface (thesis, Eq. 8.7)
extrema    DOUBLE    its part of the extrema (thesis, Eq. 8.8)
points    DOUBLE    its part of all points
winner    BOOLEAN    true for the pose that the take has""",
        "SELECT take, source_frame, archive_take, archive_frame, cost FROM depth_votes WHERE winner AND candidate > 0 "
        "ORDER BY ALL LIMIT 10",
        stages="reconstruct",
    ),
    result_view(
        "reconstruction_errors",
        "The distances of reconstructed takes from the truth.",
        f"""{TAKE}
reference    VARCHAR    the truth: a take, or a file
scope    VARCHAR    all, take or joint (or marker)
name    VARCHAR    which joint or marker; all for the others
offset_m    DOUBLE[]    place of a marker in the axes of the body part of its joint; NULL for joints
mean_m    DOUBLE    mean distance in metres
std_m    DOUBLE    standard deviation over the frames
median_m    DOUBLE    median over the frames
p90_m    DOUBLE    90th percentile over the frames
frames    BIGINT    frames that were compared
unseen_frames    BIGINT    frames whose truth is known, and which have no pose
over_10cm    DOUBLE    share of the frames that are off by more than 10 cm
rate_five_ends    DOUBLE    share of the frames in which all five ends are found; NULL for joints and markers""",
        "SELECT take, mean_m, median_m, over_10cm FROM reconstruction_errors WHERE scope = 'take' ORDER BY take",
        stages="evaluate_reconstruction",
    ),
)
