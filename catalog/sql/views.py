"""Collect the views and macros of a store, as SQL text with their descriptions."""

from __future__ import annotations

from kinedex.catalog.doubts import doubts_select
from kinedex.catalog.quality_figures import suspect_select
from kinedex.catalog.sql.columns import Column, View, columns
from kinedex.catalog.sql.macros import MACROS, Macro
from kinedex.catalog.sql.result_views import RESULT_VIEWS

__all__ = ["MACROS", "VIEWS", "Column", "Macro", "View", "help_rows"]

_RANGE = """take_id    BIGINT    id of the take
start    INTEGER    first frame, counted from 0
stop    INTEGER    frame after the last"""
_WORD = """feature_set    VARCHAR    the feature set: upper, lower or mix
word    UBIGINT    the bits of the word that belong to the set; bit i is the feature with this `bit`"""

# Annotations define which subclasses are in a class; a subclass in no annotation forms its own class.
_CLASSES = """WITH members AS (
    SELECT c.class, c.subclass FROM distance_curves AS c
    UNION
    SELECT a.class, a.subclass FROM annotations AS a),
clips AS (SELECT t.class AS subclass, count(*) AS clips, sum(t.seconds) AS seconds FROM takes AS t
    WHERE t.class IS NOT NULL GROUP BY t.class),
known AS (
    SELECT coalesce(m.class, c.subclass) AS class, c.subclass, c.clips, c.seconds, 'clips' AS how, 0 AS found
    FROM clips AS c LEFT JOIN members AS m ON m.subclass = c.subclass
    UNION ALL
    SELECT coalesce(m.class, p.subclass), p.subclass, 0, 0, p.how, 0
    FROM (SELECT DISTINCT x.subclass, 'templates' AS how FROM templates AS x
          UNION ALL
          SELECT DISTINCT q.subclass, 'queries' FROM queries AS q) AS p
    LEFT JOIN members AS m ON m.subclass = p.subclass
    UNION ALL
    SELECT m.class, m.subclass, 0, 0, NULL, 0 FROM members AS m
    UNION ALL
    SELECT a.class, NULL, 0, 0, 'annotations', count(*) FROM annotations AS a GROUP BY a.class
    UNION ALL
    SELECT g.class, NULL, 0, 0, 'ground_truth', count(*) FROM ground_truth AS g GROUP BY g.class)
SELECT k.class,
    coalesce(list(DISTINCT k.subclass ORDER BY k.subclass) FILTER (k.subclass IS NOT NULL), []) AS subclasses,
    sum(k.clips)::BIGINT AS clips, sum(k.seconds)::DOUBLE AS clip_seconds,
    coalesce(sum(k.found) FILTER (k.how = 'annotations'), 0)::BIGINT AS annotations,
    coalesce(sum(k.found) FILTER (k.how = 'ground_truth'), 0)::BIGINT AS labels,
    coalesce(list(DISTINCT k.how ORDER BY k.how) FILTER (k.how IS NOT NULL), []) AS known_from
FROM known AS k GROUP BY k.class ORDER BY k.class"""

_LABEL = """take    VARCHAR    name of the take, which the store may lack at present
take_id    BIGINT    id of the take; NULL if the store has no such take
class    VARCHAR    the class (or subclass) that the statement is about
start    INTEGER    first frame, counted from 0
stop    INTEGER    frame after the last
start_seconds    DOUBLE    time of the start in seconds
stop_seconds    DOUBLE    time of the stop in seconds
limb    VARCHAR    the limb that the statement is about, if one is named
verdict    VARCHAR    the verdict: positive (the frames show the class), negative (they do not) or withdrawn (the row \
that is replaced no longer counts)
annotator    VARCHAR    the person who made the statement
origin    VARCHAR    origin of the label: imported, accepted (from an annotation, also if it was rejected), corrected \
or drawn
source    VARCHAR    the label file with its line, or the stage of the annotation
created    TIMESTAMP WITH TIME ZONE    time of the decision
confidence    DOUBLE    confidence of the annotation or of the person, from 0 to 1
note    VARCHAR    remark of the person
id    VARCHAR    id of the label
replaces    VARCHAR    id of the row that this row replaces
checksum    VARCHAR    SHA-256 of the take's source file when the statement was made
file_changed    BOOLEAN    true if the take's file has changed since; NULL if the store has no such take
"""

VIEWS = (
    View(
        "takes",
        "index",
        "One row per take: name, source file, rate, length, actor, class, warnings.",
        columns("""
take_id    BIGINT    id of the take, which stays the same if the file is read again
name    VARCHAR    name of the take: the stem or the path of the source file, as the parameter `name` of ingest \
determines
source    VARCHAR    path of the source file, relative to source_root
source_root    VARCHAR    the folder of the archive
checksum    VARCHAR    SHA-256 of the source file
source_bytes    BIGINT    size of the source file
source_mtime_ns    BIGINT    time of the last change of the source file, in nanoseconds since 1970
format    VARCHAR    format of the source file: amc, bvh, c3d, …
skeleton    VARCHAR    name of the mapping from the nodes of the file to the 24 joints
skeleton_source    VARCHAR    the skeleton file of the source file, or its static trial, if it has one
recipe    VARCHAR    hash of everything, except the file, that the frames of the take depend on
unit    VARCHAR    unit of length in the file
source_rate_hz    DOUBLE    frames per second in the file
source_frames    BIGINT    number of frames in the file
rate_hz    DOUBLE    frames per second in the store
frames    BIGINT    number of frames in the store
seconds    DOUBLE    duration in seconds
invalid_frames    BIGINT    number of frames without a word, because joints were not seen
actor    VARCHAR    name of the actor, as the `patterns` of ingest state
class    VARCHAR    the class that a clip shows (its subclass); NULL for other takes
clip    VARCHAR    number of the clip, as the patterns state
groups    VARCHAR    all further named groups of the patterns as JSON; they are also separate columns
warnings    VARCHAR[]    warnings about the file
known    UBIGINT    mask of the features that the body has joints for, with the bits of a word; NULL for all features
"""),
        "SELECT name, actor, seconds, warnings FROM takes WHERE class IS NULL ORDER BY seconds DESC LIMIT 10",
    ),
    View(
        "features",
        "index",
        "The features of the store's feature set.",
        columns("""
number    UTINYINT    number of the feature, 1 for F1, which is bit number − 1 of a whole word
name    VARCHAR    short name, such as rhand_forwards
description    VARCHAR    the property of the body that it states
feature_set    VARCHAR    the set that the feature belongs to: upper, lower or mix
bit    UTINYINT    bit of the feature in the words of that set
"""),
        "SELECT number, name, description FROM features WHERE name LIKE '%knee%'",
    ),
    View(
        "word_runs",
        "index",
        "The inverted lists: runs of frames with the same word of a set, in takes that know all of it; in no order.",
        columns(f"{_WORD}\n{_RANGE}"),
        "SELECT take_id, start, stop FROM word_runs WHERE feature_set = 'lower' AND word = 5 ORDER BY take_id, start",
    ),
    View(
        "feature_runs",
        "index",
        "The runs of frames in which a feature is on, in no particular order.",
        columns(f"""feature    UTINYINT    the feature's number
{_RANGE}
seconds    DOUBLE    duration of the run"""),
        "SELECT f.name, count(*) AS runs, sum(r.seconds) AS seconds FROM feature_runs AS r "
        "JOIN features AS f ON f.number = r.feature GROUP BY f.name ORDER BY seconds DESC LIMIT 5",
    ),
    View(
        "vocabulary",
        "index",
        "The distinct words of each feature set, with their runs and frames in the takes that know the whole set.",
        columns(f"""{_WORD}
runs    BIGINT    number of runs of the word in all takes
frames    BIGINT    number of frames of the word in all takes"""),
        "SELECT feature_set, count(*) AS words FROM vocabulary GROUP BY feature_set ORDER BY feature_set",
    ),
    View(
        "help",
        "index",
        "This list: every view and macro with its purpose.",
        columns("""
name    VARCHAR    name of the view or macro
call    VARCHAR    the way in which a query uses the view or macro
summary    VARCHAR    purpose of the view or macro
example    VARCHAR    a query that runs
"""),
        "SELECT name, summary FROM help WHERE call LIKE '%feature%'",
    ),
    View(
        "frames",
        "parts",
        "One row per analysis frame: 24 joints (rwrist.y), root_orientation, the whole word (NULL if invalid).",
        columns("""
take_id    BIGINT    id of the take
frame    INTEGER    number of the frame, from 0
JOINT    STRUCT(x FLOAT, y FLOAT, z FLOAT)    position of the joint in metres, Y up, in one column for each of the 24 \
joints
root_orientation    STRUCT(w FLOAT, x FLOAT, y FLOAT, z FLOAT)    orientation of the root as a quaternion
word    UBIGINT    the features of the frame as bits; bit i − 1 is feature i; NULL if a joint that a feature needs \
was not seen
"""),
        "SELECT take_id, max(rwrist.y) AS highest FROM frames GROUP BY take_id ORDER BY highest DESC, take_id LIMIT 5",
    ),
    View(
        "classes",
        "derived",
        "The classes of the archive: subclasses, clips, annotations, labels, and the sources that name each class.",
        columns("""
class    VARCHAR    the class; for a subclass that no annotation assigns to a class, the subclass
subclasses    VARCHAR[]    the labels of clips, templates and queries in it
clips    BIGINT    number of clips of the class
clip_seconds    DOUBLE    total duration of these clips in seconds
annotations    BIGINT    number of its segments in the view `annotations`
labels    BIGINT    number of its manual segments in the view `ground_truth`
known_from    VARCHAR[]    the sources in which the class occurs: clips, templates, queries, annotations, ground_truth
"""),
        "SELECT class, clips, annotations FROM classes WHERE list_contains(known_from, 'clips') ORDER BY class",
        _CLASSES,
    ),
    View(
        "suspect_takes",
        "derived",
        "The figures of takes that lie beyond their limits, one row each (docs/quality.md).",
        columns("""
take_id    BIGINT    id of the take
take    VARCHAR    name of the take
figure    VARCHAR    the column of `takes`
value    DOUBLE    value of the figure
low    DOUBLE    smallest value that is expected; NULL if there is no limit
high    DOUBLE    largest value that is expected; NULL if there is no limit
unit    VARCHAR    unit of value, low and high
meaning    VARCHAR    property that the figure measures
"""),
        "SELECT figure, count(*) AS takes FROM suspect_takes GROUP BY figure ORDER BY takes DESC, figure",
        suspect_select(),
    ),
    View(
        "doubts",
        "derived",
        "Source files that were refused, warned of, or read by a guess, one row for each doubt.",
        columns("""
kind    VARCHAR    refused (the file is no take), warned, or guessed (the body was recognised with a low confidence)
cause    VARCHAR    the message without details, which is the same for many files
source_root    VARCHAR    the folder that was ingested
source    VARCHAR    the file, relative to it
take    VARCHAR    name of the take; NULL for a file that was refused
message    VARCHAR    the refusal or the warning, without the path of the file
accepted    BOOLEAN    true if a person has accepted this message about this take: `kinedex takes accept`
"""),
        "SELECT kind, cause, count(*) AS files FROM doubts WHERE NOT accepted GROUP BY ALL ORDER BY files DESC, cause",
        doubts_select(),
    ),
    View(
        "label_history",
        "labels",
        "All rows of labels, including replaced ones, in the order in which they were made.",
        columns(f"{_LABEL}current    BOOLEAN    true if no other row replaces this row and it withdraws no row"),
        "SELECT take, class, start, stop, verdict, created FROM label_history WHERE NOT current ORDER BY created",
    ),
    View(
        "labels",
        "labels",
        "The labels of people that currently count.",
        columns(_LABEL),
        "SELECT class, verdict, count(*) AS labels FROM labels GROUP BY class, verdict ORDER BY class, verdict",
        "SELECT * EXCLUDE (current) FROM label_history WHERE current",
    ),
    View(
        "pipeline_runs",
        "pipelines",
        "The runs of pipelines that results stand of, and which of them is current: whose rows the views of results "
        "show. `all_annotations`, and `all_` before any other view of results, has the rows of all pipelines.",
        columns("""
pipeline    VARCHAR    name of the pipeline
pipeline_run    VARCHAR    id of the run
finished    TIMESTAMP WITH TIME ZONE    time at which the last stage of the run was done
seconds    DOUBLE    total duration of the stages in seconds
stages    VARCHAR[]    the stages that ran last in this run; other stages had nothing to do, or have run again since
views    VARCHAR[]    the views of results that show the rows of the run
command    VARCHAR    the command that ran the pipeline
kinedex    VARCHAR    version of kinedex
current    BOOLEAN    true for the current pipeline, which is the one that ran last or that `kinedex use` has chosen
"""),
        "SELECT pipeline, finished, stages, views, current FROM pipeline_runs ORDER BY finished",
    ),
    *RESULT_VIEWS,
)


def help_rows(*, index_only: bool = False) -> list[tuple[str, str, str, str]]:
    """Return the rows (name, call, summary, example) of the view `help`; with `index_only` those of the index file."""
    rows = [
        (view.name, f"FROM {view.name}", view.summary, view.example)
        for view in VIEWS
        if view.origin == "index" or not index_only
    ]
    for macro in MACROS:
        if macro.needs == "index" or not index_only:
            call = f"FROM {macro.signature}" if macro.table else macro.signature
            rows.append((macro.name, call, macro.summary, macro.example))
    return rows
