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
kind    VARCHAR    kind of the template: soft or hard
features    INTEGER    number of values in a column of the template
columns    INTEGER    number of columns of the template
values    DOUBLE[]    value of each feature from 0 (off) to 1 (on), column after column
weights    DOUBLE[]    mean number of frames of the clips that each column stands for
clips    VARCHAR[]    the takes that the template was learned from
rounds    INTEGER    number of times that the clips were averaged
costs    DOUBLE[]    largest distance between two clips before each round
take_filter    VARCHAR    the SQL filter that chose the training takes
origin    VARCHAR    the way in which the template was made: learned from clips of its class, or made of other templates
clip_costs    DOUBLE[]    median DTW cost between each clip and the other clips
feature_weights    DOUBLE[]    weight of each feature; NULL if all weights are equal
remarks    VARCHAR[]    remarks about unusual clips""",
        "SELECT subclass, kind, columns, len(clips) AS clips FROM templates ORDER BY subclass, kind",
        stages="learn_templates",
    ),
    result_view(
        "annotated_takes",
        "The takes that were annotated, including those in which nothing was found.",
        f"""{TAKE}
frames         BIGINT     length of the take in frames
searched       DOUBLE     share of the frames in which templates were matched, averaged over the templates
fingerprint    VARCHAR    hash of the words of the take and of everything that the annotation depends on; NULL if \
unknown""",
        "SELECT take FROM annotated_takes WHERE take_id NOT IN (SELECT take_id FROM annotations) ORDER BY take",
        stages="annotate",
    ),
    result_view(
        "not_applied",
        "Templates and queries that were not applied to a take, because its body lacks too many of the joints "
        "they need.",
        f"""{TAKE}
kind    VARCHAR    kind of what was not applied: template or query
name    VARCHAR    the subclass of the template, or the name of the query
known    DOUBLE    share of the fixed entries whose features the take has, which is less than 0.6""",
        "SELECT take, kind, count(*) AS refused FROM not_applied GROUP BY take, kind ORDER BY take, kind",
        stages="annotate rank",
    ),
    result_view(
        "distance_curves",
        "The distance curve of each subclass over a take, with one cost per frame.",
        f"""{TAKE}
class    VARCHAR    the class that the subclass belongs to
subclass    VARCHAR    the subclass whose template was compared
costs    FLOAT[]    cost of the best match that ends in each frame; infinity if no match ends there
preselected    DOUBLE    share of the frames that remain after the preselection by keyframe queries""",
        "SELECT take, subclass, list_min(costs) AS least FROM distance_curves ORDER BY least LIMIT 10",
        stages="annotate",
    ),
    result_view(
        "example_ranges",
        "Frames that each example could label (`each_example`), so that a later run compares only new examples.",
        f"""{TAKE}
fingerprint    VARCHAR    hash of the words of the take and of the code of kinedex
examples    UBIGINT[]    a hash of each example
counts    INTEGER[]    number of ranges of each example
starts    INTEGER[]    first frames of the ranges, example after example
stops    INTEGER[]    frames after the last frames of the ranges""",
        "SELECT take, len(examples) AS examples, len(starts) AS ranges FROM example_ranges ORDER BY ranges DESC, take",
        stages="annotate",
    ),
    result_view(
        "annotations",
        "The segments that the annotation found: class, range, cost.",
        f"""{TAKE}
class    VARCHAR    the class of the segment
subclass    VARCHAR    the subclass whose template is nearest
{SECONDS}
cost    DOUBLE    smallest distance within the segment, at least 0
confidence    DOUBLE    probability that the class is right, calibrated on examples; NULL if it is unknown
{_METHOD}
margin    DOUBLE    lead over other classes and the background, from 0 (none) to 1
value    DOUBLE    contribution of the segment to the explanation of the take (method best); NULL for other methods""",
        "SELECT class, count(*) AS segments, sum(stop_seconds - start_seconds) AS seconds FROM annotations "
        "WHERE method IN ('templates', 'templates within keyframe hits') GROUP BY class ORDER BY class",
        stages="annotate",
    ),
    result_view(
        "ranked_hits",
        "The best hits of each template, by rank: take, range, cost.",
        f"""template    VARCHAR    the template that was looked for
rank    INTEGER    rank of the hit, 1 for the best
{TAKE}
{SECONDS}
cost    DOUBLE    distance from the template, at least 0""",
        "SELECT template, rank, take, start, stop, cost FROM ranked_hits WHERE rank <= 3 ORDER BY template, rank",
        stages="rank",
    ),
    result_view(
        "retrieval",
        "The quality of rankings: average precision and recall of each class, and confusions.",
        """evaluation    VARCHAR    the kind of items that were ranked: clips or takes
fold    VARCHAR    the part of the archive that was excluded from learning; empty if there is none
class    VARCHAR    the class that was looked for
relevant    INTEGER    number of items to find
found    INTEGER    number of these below the threshold
average_precision    DOUBLE    average precision of the ranking; 1 if all relevant items come first
recall_at_tau    DOUBLE    share of the relevant items below the threshold
confused_with    VARCHAR[]    classes of the wrong items above the last right item, most frequent first""",
        "SELECT class, avg(average_precision) AS average_precision FROM retrieval GROUP BY class ORDER BY class",
        stages="evaluate_ranking",
    ),
    result_view(
        "ground_truth",
        "The manual labels that annotations are compared with.",
        f"""{TAKE}
class    VARCHAR    the class of the segment
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
        """evaluation    VARCHAR    the stage that made the evaluation
scope    VARCHAR    scope of the row: pooled, class, take, fold, or group (takes with the same value of divide_by)
name    VARCHAR    name of the class, take, fold or group
p1    DOUBLE    precision by frames
r1    DOUBLE    recall by frames
f1    DOUBLE    F measure by frames
p2    DOUBLE    precision by segments
r2    DOUBLE    recall by segments
f2    DOUBLE    F measure by segments
frames_both    BIGINT    number of frames with the same label in both
frames_automatic    BIGINT    number of frames that the annotation labels
frames_manual    BIGINT    number of frames that people have labelled
segments_automatic_hit    BIGINT    number of segments of the annotation that are right
segments_automatic    BIGINT    number of segments of the annotation
segments_manual_hit    BIGINT    number of manual segments that were found
segments_manual    BIGINT    number of manual segments""",
        "SELECT stage, name, f1, f2 FROM metrics WHERE scope = 'class' ORDER BY stage, f1",
        stages="evaluate compare_methods",
    ),
    result_view(
        "method_cells",
        "The segments that the compared methods of annotation found, one row per cell and take.",
        """cell    VARCHAR    hash of everything that the row depends on
split    VARCHAR    the division of the archive into training and test
fold    VARCHAR    name of the fold of the split
method    VARCHAR    the method of annotation
take    VARCHAR    name of the take
frames    INTEGER    length of the take in frames
classes    VARCHAR[]    classes of the segments found
starts    INTEGER[]    first frame of each segment
stops    INTEGER[]    frame after the last of each segment
confidences    DOUBLE[]    margin of each segment, from 0 to 1""",
        "SELECT split, method, count(DISTINCT take) AS takes FROM method_cells GROUP BY ALL ORDER BY ALL",
        stages="compare_methods",
    ),
    result_view(
        "precision_recall",
        "Precision and recall of rankings for each stiffness of keyframe queries.",
        """variant    VARCHAR    the frames that were ranked: the hits of the queries, or all frames
stiffness    DOUBLE    stiffness of all gaps of the queries, if it was changed
class    VARCHAR    the class that was looked for
relevant    INTEGER    number of items to find
ranked    INTEGER    number of items within the frames that were ranked
found    INTEGER    number of relevant items among the ranked items
kept    DOUBLE    share of the frames that were ranked
average_precision    DOUBLE    average precision of the ranking; 1 if all relevant items come first
precision    DOUBLE[]    precision after each rank
recall    DOUBLE[]    recall after each rank""",
        "SELECT stiffness, avg(average_precision) AS average_precision FROM precision_recall GROUP BY ALL ORDER BY ALL",
        stages="vary_stiffness",
    ),
)
