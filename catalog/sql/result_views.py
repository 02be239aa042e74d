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
margin    DOUBLE    from 0 (something else would do as well) to 1""",
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
outcome    VARCHAR    in (the store has its takes), refused, skeleton, not read, passed over (no motion)
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
