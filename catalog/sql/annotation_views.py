"""Define the views of templates, annotations, rankings, and their evaluation."""

from __future__ import annotations

from kinedex.catalog.sql.columns import RANGE, SECONDS, TAKE, result_view

_METHOD = (
    "method    VARCHAR    'templates' or 'templates within keyframe hits' (method thesis), "
    "'templates in a row' or 'templates in a row within keyframe hits' (method best)"
)

ANNOTATION_VIEWS = (
    result_view(
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
    result_view(
        "annotated_takes",
        "The takes that were annotated, also those in which nothing was found.",
        f"""{TAKE}
frames         BIGINT     its length in frames
searched       DOUBLE     share of its frames that templates were matched in, on average over the templates
fingerprint    VARCHAR    a hash of its words and of all that they were annotated with; null where not known""",
        "SELECT take FROM annotated_takes WHERE take_id NOT IN (SELECT take_id FROM annotations) ORDER BY take",
        stages="annotate",
    ),
    result_view(
        "not_applied",
        "Templates and queries that were not applied to a take, whose body lacks too many of the joints they ask for.",
        f"""{TAKE}
kind    VARCHAR    template or query
name    VARCHAR    the subclass of the template, or the name of the query
known    DOUBLE    share of its fixed entries that the take knows: less than 0.6""",
        "SELECT take, kind, count(*) AS refused FROM not_applied GROUP BY take, kind ORDER BY take, kind",
        stages="annotate rank",
    ),
    result_view(
        "distance_curves",
        "The distance curve of a subclass over a take, one cost per frame; of a take that was kept, by an earlier run.",
        f"""{TAKE}
class    VARCHAR    the class that the subclass belongs to
subclass    VARCHAR    whose template was compared
costs    FLOAT[]    for each frame, the cost of the best match that ends there; infinity where there is none
preselected    DOUBLE    share of the frames that keyframe queries left to be searched""",
        "SELECT take, subclass, list_min(costs) AS least FROM distance_curves ORDER BY least LIMIT 10",
        stages="annotate",
    ),
    result_view(
        "example_ranges",
        "Frames in which each example could label anything, with `each_example`; a later run compares new ones only.",
        f"""{TAKE}
fingerprint    VARCHAR    a hash of the take's words and of the program
examples    UBIGINT[]    a hash of each example
counts    INTEGER[]    the number of ranges of each
starts    INTEGER[]    their first frames, example after example
stops    INTEGER[]    the frames after their last""",
        "SELECT take, len(examples) AS examples, len(starts) AS ranges FROM example_ranges ORDER BY ranges DESC, take",
        stages="annotate",
    ),
    result_view(
        "annotations",
        "The segments that the annotation found: class, range, cost.",
        f"""{TAKE}
class    VARCHAR    the label
subclass    VARCHAR    whose template came nearest
{SECONDS}
cost    DOUBLE    least distance within the range, from 0
confidence    DOUBLE    probability that the label is right, calibrated on examples; null where it cannot be known
{_METHOD}
margin    DOUBLE    from 0 (something else would do as well) to 1
value    DOUBLE    what the frames add to the explanation of the take (method best); null for methods without one""",
        "SELECT class, count(*) AS segments, sum(stop_seconds - start_seconds) AS seconds FROM annotations "
        "WHERE method IN ('templates', 'templates within keyframe hits') GROUP BY class ORDER BY class",
        stages="annotate",
    ),
    result_view(
        "ranked_hits",
        "The best hits of each template, by rank: take, range, cost.",
        f"""template    VARCHAR    the template that was looked for
rank    INTEGER    1 is the best
{TAKE}
{SECONDS}
cost    DOUBLE    distance from the template, from 0""",
        "SELECT template, rank, take, start, stop, cost FROM ranked_hits WHERE rank <= 3 ORDER BY template, rank",
        stages="rank",
    ),
    result_view(
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
    result_view(
        "ground_truth",
        "The manual labels that annotations are compared with.",
        f"""{TAKE}
class    VARCHAR    the label
{RANGE}
source_start    BIGINT    start in frames of the source file
source_stop    BIGINT    stop in frames of the source file
origin    VARCHAR    the file that holds the label""",
        "SELECT class, count(*) AS segments FROM ground_truth GROUP BY class ORDER BY class",
        stages="evaluate",
    ),
    result_view(
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
    result_view(
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
    result_view(
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
)
