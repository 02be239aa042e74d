"""The views of results: what stages have stored, as the current pipeline has it, or with the rows of all pipelines."""

from __future__ import annotations

from kinedex.catalog.sql.columns import View, columns

ALL = "all_"
"""Before the name of a view of results: the view with the same columns that shows the rows of every pipeline."""

SOURCE_KINDS = ("skeleton_files", "source_files", "ingest_log")
"""Results that belong to a source folder, whichever pipeline has ingested it."""

SAVED_KINDS = ("hits", "duplicates")
"""Results that a command stores, and no pipeline makes."""

_RUN = "run    VARCHAR    the run of a stage that wrote the row"
_ORIGIN = columns("""
pipeline    VARCHAR    the pipeline that wrote the row; NULL for what a command has stored
stage    VARCHAR    its stage
pipeline_run    VARCHAR    the run of the pipeline, as in `pipeline_runs`; NULL while the stage runs again
""")
ORIGIN = tuple(column.name for column in _ORIGIN)
"""The last columns of every view of results, which are not in the parts: the store knows them of a whole part."""

_TAKE = """take_id    BIGINT    id of the take
take    VARCHAR    name of the take"""
_RANGE = """start    INTEGER    first frame, from 0
stop    INTEGER    frame after the last"""
_SECONDS = f"""{_RANGE}
start_seconds    DOUBLE    start as time
stop_seconds    DOUBLE    stop as time"""
_QUERY = """masks    UBIGINT[]    for each keyframe, the features it asks for: bit i − 1 is feature i
values    UBIGINT[]    for each keyframe, those of its features that must be on
positions    INTEGER[]    the template column of each keyframe, from 0
lows    INTEGER[]    least gap to each next keyframe, in frames
highs    INTEGER[]    greatest gap to each next keyframe, in frames; −1: any"""
_METHOD = (
    "method    VARCHAR    'templates' or 'templates within keyframe hits' (method thesis), "
    "'templates in a row' or 'templates in a row within keyframe hits' (method best)"
)


def _view(name: str, summary: str, text: str, example: str, stages: str = "") -> View:
    """Return the view of a kind of results, with the columns of its parts and of their origin."""
    stored = columns(f"{_RUN}\n{text}")
    shown = (*(column for column in stored if column.name not in ORIGIN), *_ORIGIN)
    return View(name, "results", summary, shown, example, stored=stored, stages=tuple(stages.split()))


RESULT_VIEWS = (
    _view(
        "templates",
        "Motion templates, soft and hard, per subclass.",
        """subclass    VARCHAR    the subclass of the template
kind    VARCHAR    soft or hard
features    INTEGER    values in a column of the template
columns    INTEGER    number of its columns
values    DOUBLE[]    column after column, a value from 0 (off) to 1 (on) for each feature
weights    DOUBLE[]    number of frames of the clips that each column stands for
clips    VARCHAR[]    the takes that it was learned from
rounds    INTEGER    number of times that the clips were averaged
costs    DOUBLE[]    before each round, the largest distance between two clips
take_filter    VARCHAR    the SQL filter that chose the training takes
origin    VARCHAR    learned from clips of its own class, or made of other templates, and how
clip_costs    DOUBLE[]    median DTW cost of each clip to the others
feature_weights    DOUBLE[]    weight of each feature; NULL: all alike
remarks    VARCHAR[]    remarks about unusual clips""",
        "SELECT subclass, kind, columns, len(clips) AS clips FROM templates ORDER BY subclass, kind",
        stages="learn_templates",
    ),
    _view(
        "annotated_takes",
        "The takes that were annotated, also those in which nothing was found.",
        f"""{_TAKE}
frames         BIGINT     its length in frames
searched       DOUBLE     share of its frames that templates were matched in, on average over the templates
fingerprint    VARCHAR    a hash of its words and of all that they were annotated with; null where not known""",
        "SELECT take FROM annotated_takes WHERE take_id NOT IN (SELECT take_id FROM annotations) ORDER BY take",
        stages="annotate",
    ),
    _view(
        "not_applied",
        "Templates and queries that were not applied to a take, whose body lacks too many of the joints they ask for.",
        f"""{_TAKE}
kind    VARCHAR    template or query
name    VARCHAR    the subclass of the template, or the name of the query
known    DOUBLE    share of its fixed entries that the take knows: less than 0.6""",
        "SELECT take, kind, count(*) AS refused FROM not_applied GROUP BY take, kind ORDER BY take, kind",
        stages="annotate rank",
    ),
    _view(
        "distance_curves",
        "The distance curve of a subclass over a take, one cost per frame; of a take that was kept, by an earlier run.",
        f"""{_TAKE}
class    VARCHAR    the class that the subclass belongs to
subclass    VARCHAR    whose template was compared
costs    FLOAT[]    for each frame, the cost of the best match that ends there; infinity where there is none
preselected    DOUBLE    share of the frames that keyframe queries left to be searched""",
        "SELECT take, subclass, list_min(costs) AS least FROM distance_curves ORDER BY least LIMIT 10",
        stages="annotate",
    ),
    _view(
        "annotations",
        "The segments that the annotation found: class, range, cost.",
        f"""{_TAKE}
class    VARCHAR    the label
subclass    VARCHAR    whose template came nearest
{_SECONDS}
cost    DOUBLE    least distance within the range, from 0
confidence    DOUBLE    probability that the label is right, calibrated on examples; null where it cannot be known
{_METHOD}
margin    DOUBLE    from 0 (something else would do as well) to 1
value    DOUBLE    what the frames add to the explanation of the take (method best); null for methods without one""",
        "SELECT class, count(*) AS segments, sum(stop_seconds - start_seconds) AS seconds FROM annotations "
        "WHERE method IN ('templates', 'templates within keyframe hits') GROUP BY class ORDER BY class",
        stages="annotate",
    ),
    _view(
        "ranked_hits",
        "The best hits of each template, by rank: take, range, cost.",
        f"""template    VARCHAR    the template that was looked for
rank    INTEGER    1 is the best
{_TAKE}
{_SECONDS}
cost    DOUBLE    distance from the template, from 0""",
        "SELECT template, rank, take, start, stop, cost FROM ranked_hits WHERE rank <= 3 ORDER BY template, rank",
        stages="rank",
    ),
    _view(
        "retrieval",
        "The quality of rankings: average precision and recall of each class, and confusions.",
        """evaluation    VARCHAR    the kind of items that were ranked: clips or takes
fold    VARCHAR    the part of the archive that was excluded from learning; empty for none
class    VARCHAR    the class that was looked for
relevant    INTEGER    number of items to find
found    INTEGER    number of these below the threshold
average_precision    DOUBLE    1 where all that should be found comes first
recall_at_tau    DOUBLE    share of them below the threshold
confused_with    VARCHAR[]    classes that stand above the last right one, most frequent first""",
        "SELECT class, avg(average_precision) AS average_precision FROM retrieval GROUP BY class ORDER BY class",
        stages="evaluate_ranking",
    ),
    _view(
        "ground_truth",
        "The manual labels that annotations are compared with.",
        f"""{_TAKE}
class    VARCHAR    the label
{_RANGE}
source_start    BIGINT    start in frames of the source file
source_stop    BIGINT    stop in frames of the source file
origin    VARCHAR    the file that holds the label""",
        "SELECT class, count(*) AS segments FROM ground_truth GROUP BY class ORDER BY class",
        stages="evaluate",
    ),
    _view(
        "metrics",
        "Precision, recall and F over frames (p1, r1, f1) and over segments (p2, r2, f2).",
        """evaluation    VARCHAR    the stage that evaluated
scope    VARCHAR    pooled, class, take, fold, or group: takes with the same value of divide_by
name    VARCHAR    of which class, take, fold or group
p1    DOUBLE    precision by frames
r1    DOUBLE    recall by frames
f1    DOUBLE    F measure by frames
p2    DOUBLE    precision by segments
r2    DOUBLE    recall by segments
f2    DOUBLE    F measure by segments
frames_both    BIGINT    frames that both label alike
frames_automatic    BIGINT    frames that the annotation labels
frames_manual    BIGINT    frames that people have labelled
segments_automatic_hit    BIGINT    segments of the annotation that are right
segments_automatic    BIGINT    segments of the annotation
segments_manual_hit    BIGINT    manual segments that were found
segments_manual    BIGINT    manual segments""",
        "SELECT stage, name, f1, f2 FROM metrics WHERE scope = 'class' ORDER BY stage, f1",
        stages="evaluate compare_methods",
    ),
    _view(
        "method_cells",
        "The segments that the compared methods of annotation found, one row per cell and take.",
        """cell    VARCHAR    hash of all that the row follows from
split    VARCHAR    the division of the archive into training and test
fold    VARCHAR    which division
method    VARCHAR    the method of annotation
take    VARCHAR    name of the take
frames    INTEGER    its length in frames
classes    VARCHAR[]    the labels found
starts    INTEGER[]    first frame of each
stops    INTEGER[]    frame after the last of each
confidences    DOUBLE[]    margin of each, from 0 to 1""",
        "SELECT split, method, count(DISTINCT take) AS takes FROM method_cells GROUP BY ALL ORDER BY ALL",
        stages="compare_methods",
    ),
    _view(
        "precision_recall",
        "Precision and recall of rankings for each stiffness of keyframe queries.",
        """variant    VARCHAR    which frames were ranked: those that the queries left, or all
stiffness    DOUBLE    of all gaps of the queries, where it was changed
class    VARCHAR    the class that was looked for
relevant    INTEGER    number of items to find
ranked    INTEGER    number of items that the queries left to be ranked
found    INTEGER    number of relevant items among these
kept    DOUBLE    share of the frames that the queries left
average_precision    DOUBLE    1 where all that should be found comes first
precision    DOUBLE[]    after each rank
recall    DOUBLE[]    after each rank""",
        "SELECT stiffness, avg(average_precision) AS average_precision FROM precision_recall GROUP BY ALL ORDER BY ALL",
        stages="vary_stiffness",
    ),
    _view(
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
    _view(
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
    _view(
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
    _view(
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
    _view(
        "tracks",
        "Takes that were tracked or stabilised, one row each.",
        f"""{_TAKE}
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
    _view(
        "chain_poses",
        "Poses of the kinematic chain of tracked and stabilised takes, at the rate of their recording.",
        f"""{_TAKE}
source_frame    INTEGER    frame of the recording, from 0
place    DOUBLE[]    place of the root in metres
turns    DOUBLE[]    rotation vector of each node from its parent in radians, three numbers a node""",
        "SELECT take, source_frame, place FROM chain_poses ORDER BY take, source_frame LIMIT 5",
        stages="track stabilise",
    ),
    _view(
        "track_frames",
        "Frames of tracked and stabilised takes: cost, cameras, and what has moved.",
        f"""{_TAKE}
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
    _view(
        "track_cameras",
        "Residuals of the rays of each camera: a bad calibration shows as one camera that differs.",
        f"""{_TAKE}
camera    VARCHAR    name of the camera
keypoints    BIGINT    observations that were used
median_px    DOUBLE    median distance of a keypoint from the track in the image, in pixels
p90_px    DOUBLE    its 90th percentile
weight    DOUBLE    mean robust weight, from 0 (excluded) to 1""",
        "SELECT take, camera, median_px, weight FROM track_cameras ORDER BY take, camera",
        stages="track stabilise",
    ),
    _view(
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
    _view(
        "priors",
        "The priors that hits in the archive have lent to takes, and those that were withdrawn.",
        f"""{_TAKE}
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
    _view(
        "track_metrics",
        "The distances of tracked and stabilised takes from the truth.",
        f"""{_TAKE}
reference    VARCHAR    the truth: a take, or a file of positions
scope    VARCHAR    take, joint, or part: frames with and without trouble
name    VARCHAR    which joint or part; all joints for a take
frames    BIGINT    frames that were compared
mean_mm    DOUBLE    mean distance
sd_mm    DOUBLE    standard deviation over the frames' means
median_mm    DOUBLE    median distance
max_mm    DOUBLE    greatest mean of a frame""",
        "SELECT take, mean_mm, max_mm FROM track_metrics WHERE scope = 'take' ORDER BY take",
        stages="evaluate_track",
    ),
    _view(
        "poses",
        "The pose database: poses of the archive that differ, as unit directions of bones.",
        f"""pose    INTEGER    its number, from 0, in order of take name and frame
{_TAKE}
frame    INTEGER    frame of the take, from 0
directions    FLOAT[]    unit vector along the bone to each joint, three numbers a joint; 0 for bones without length""",
        "SELECT take, count(*) AS poses FROM poses GROUP BY take ORDER BY poses DESC, take LIMIT 10",
        stages="pose_database",
    ),
    _view(
        "pose_takes",
        "The takes that the pose database was made of, also those that lend no pose.",
        f"""{_TAKE}
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
    _view(
        "reconstructions",
        "Takes that were reconstructed from depth recordings, one row each.",
        f"""{_TAKE}
recording    VARCHAR    the recording that it comes from
file    VARCHAR    the recordings file
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
    _view(
        "reconstruction_frames",
        "Frames of depth recordings: the hypothesis that was taken, its costs, and what it rests on.",
        f"""{_TAKE}
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
    _view(
        "depth_votes",
        "The hypotheses of each frame of depth recordings: what was tried, what it costs, and what was taken.",
        f"""{_TAKE}
source_frame    INTEGER    frame of the recording, from 0
direction    VARCHAR    forward or backward in time
hypothesis    VARCHAR    local or database
candidate    INTEGER    number of the database's candidate, from 1, cheapest first; NULL for local
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
    _view(
        "reconstruction_errors",
        "The distances of reconstructed takes from the truth.",
        f"""{_TAKE}
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
    _view(
        "queries",
        "Learned keyframe queries, in bits of whole words, with their margins.",
        f"""subclass    VARCHAR    whose motions it preselects
number    INTEGER    0 for the first query of a subclass; further ones find what it misses
origin    VARCHAR    consensus of the runs, best run, or run
{_QUERY}
left    INTEGER    frames before a hit that the motion may reach
right    INTEGER    frames after a hit that the motion may reach
columns    INTEGER    columns of the template
fitness    DOUBLE    of the consensus (thesis, Eq. 4.11)
rank    DOUBLE    the value that queries are compared by, from the fitness
median    DOUBLE    rank of the median run
best    DOUBLE    rank of the best run
agreement    DOUBLE    share of keyframes that had to agree on a feature; 0 where it is a run
precision    DOUBLE    of all queries of the subclass together, on the training clips
recall    DOUBLE    likewise
runs    INTEGER    number of runs
settled    BOOLEAN    true if more runs had ceased to change the outcome
matrix    DOUBLE[]    entries fixed by the runs, columns × features, from 0 (off) to 1 (on); NULL for further queries
clips    VARCHAR[]    the training clips of the subclass""",
        "SELECT subclass, len(masks) AS keyframes, recall, precision FROM queries ORDER BY subclass, number",
        stages="learn_keyframes",
    ),
    _view(
        "keyframe_runs",
        "The runs that keyframe queries were learned in, one row each.",
        f"""key    VARCHAR    hash of all that a run follows from but its number
subclass    VARCHAR    the subclass that it learns to find
number    INTEGER    number of the run
fitness    DOUBLE    of its best query (thesis, Eq. 4.11)
rank    DOUBLE    the value that queries are compared by
evaluated    BIGINT    number of queries that were tried
{_QUERY}
history    DOUBLE[]    four numbers for each generation""",
        "SELECT subclass, count(*) AS runs, max(fitness) AS best FROM keyframe_runs GROUP BY subclass ORDER BY ALL",
        stages="learn_keyframes",
    ),
    _view(
        "hits",
        "The saved hits of keyframe queries.",
        f"""saved_as    VARCHAR    the name that they were kept under: `kinedex search --save`
query    VARCHAR    name of the query
{_TAKE}
{_SECONDS}""",
        "SELECT query, count(*) AS hits, sum(stop_seconds - start_seconds) AS seconds FROM hits "
        "WHERE saved_as = 'mine' GROUP BY query ORDER BY query",
    ),
    _view(
        "duplicates",
        "Takes that hold the same file or motion as a longer take, as `kinedex duplicates` found them last.",
        f"""{_TAKE}
of_take_id    BIGINT    id of the other take, which is longer, or as long with an earlier name
of_take    VARCHAR    its name
same    VARCHAR    file: a copy of the same file; motion: the joints move alike
{_SECONDS}
share    DOUBLE    share of the take that this range is
shift_seconds    DOUBLE    time t of the take is t + shift_seconds of the other one
mirrored    BOOLEAN    true if left and right are exchanged
distance_mm    DOUBLE    mean distance of the joints around the root""",
        "SELECT take, of_take, share, mirrored FROM duplicates WHERE share > 0.9 ORDER BY take, of_take LIMIT 10",
    ),
    _view(
        "skeleton_files",
        "The skeleton files that takes were read with, as they were when they were last checked.",
        """source_root    VARCHAR    the folder that was ingested
source    VARCHAR    the skeleton file, relative to it
source_bytes    BIGINT    its size
source_mtime_ns    BIGINT    its time of change, in nanoseconds since 1970
checksum    VARCHAR    its SHA-256""",
        "SELECT t.name, t.skeleton_source, s.checksum FROM takes AS t JOIN skeleton_files AS s "
        "ON (s.source_root, s.source) = (t.source_root, t.skeleton_source) ORDER BY t.name LIMIT 10",
        stages="ingest",
    ),
    _view(
        "source_files",
        "All files below the folder that a stage ingested last, and what became of each.",
        """source_root    VARCHAR    the folder that was ingested
source    VARCHAR    the file, relative to it; also a folder that cannot be read
ending    VARCHAR    its ending in small letters, with the dot
outcome    VARCHAR    in (the store has its takes), refused, skeleton, metadata, not read, passed over (no motion)
takes    INTEGER    number of its takes in the store
reason    VARCHAR    the fault, the way out, or the kind of a file that was passed over""",
        "SELECT outcome, ending, count(*) AS files FROM source_files GROUP BY ALL ORDER BY files DESC, ending",
        stages="ingest",
    ),
    _view(
        "ingest_log",
        "Source files, or places in them, that could not be read.",
        """source    VARCHAR    the source file, relative to its root
stage    VARCHAR    the stage that met it
error    VARCHAR    kind of error
message    VARCHAR    the fault, and the way out
file    VARCHAR    the file that is at fault, where it is another one
line    INTEGER    its line, where there is one
logged_at    TIMESTAMP WITH TIME ZONE    when""",
        "SELECT source, line, message FROM ingest_log ORDER BY source, line",
        stages="ingest",
    ),
)
