"""Collect the views of stored results, with the rows of the current pipeline or of all pipelines.

A kind of results is defined by its view alone: the view's name is the kind, and its columns are the schema of the
kind's Parquet parts. To add a kind, add a `result_view` to the module of its topic. Add the views of a new module to
`RESULT_VIEWS`. docs/sql.md is generated from the views, and docs/formats.md lists the kinds.
"""

from __future__ import annotations

from kinedex.catalog.sql.annotation_views import ANNOTATION_VIEWS
from kinedex.catalog.sql.archive_views import ARCHIVE_VIEWS
from kinedex.catalog.sql.columns import SECONDS, TAKE, result_view
from kinedex.catalog.sql.depth_views import DEPTH_VIEWS
from kinedex.catalog.sql.inertial_views import INERTIAL_VIEWS
from kinedex.catalog.sql.tracking_views import TRACKING_VIEWS

_QUERY = """masks    UBIGINT[]    features that each keyframe asks for; bit i − 1 is feature i
values    UBIGINT[]    features of each keyframe that must be on
positions    INTEGER[]    the template column of each keyframe, from 0
lows    INTEGER[]    smallest gap to each next keyframe, in frames
highs    INTEGER[]    largest gap to each next keyframe, in frames; −1 for any gap"""

KEYFRAME_VIEWS = (
    result_view(
        "queries",
        "Learned keyframe queries, in bits of whole words, with their margins.",
        f"""subclass    VARCHAR    the subclass whose motions the query preselects
number    INTEGER    number of the query, 0 for the first of a subclass; further queries find what the first one misses
origin    VARCHAR    origin of the query: consensus of the runs, best run, or run
{_QUERY}
left    INTEGER    number of frames before a hit into which the motion may extend
right    INTEGER    number of frames after a hit into which the motion may extend
columns    INTEGER    number of columns of the template
fitness    DOUBLE    fitness of the consensus (thesis, Eq. 4.11)
rank    DOUBLE    value by which queries are compared, computed from the fitness
median    DOUBLE    rank of the median run
best    DOUBLE    rank of the best run
agreement    DOUBLE    share of keyframes that had to agree on a feature; 0 if the query is that of a run
precision    DOUBLE    precision of all queries of the subclass together, on the training clips
recall    DOUBLE    recall of all queries of the subclass together, on the training clips
runs    INTEGER    number of runs
settled    BOOLEAN    true if further runs no longer changed the outcome
matrix    DOUBLE[]    entries fixed by the runs, columns × features, from 0 (off) to 1 (on); NULL for further queries
clips    VARCHAR[]    the training clips of the subclass""",
        "SELECT subclass, len(masks) AS keyframes, recall, precision FROM queries ORDER BY subclass, number",
        stages="learn_keyframes",
    ),
    result_view(
        "keyframe_runs",
        "The runs in which keyframe queries were learned, with one row for each run.",
        f"""key    VARCHAR    hash of everything that a run depends on, except its number
subclass    VARCHAR    the subclass that the run learns to find
number    INTEGER    number of the run
fitness    DOUBLE    fitness of the best query of the run (thesis, Eq. 4.11)
rank    DOUBLE    value by which queries are compared
evaluated    BIGINT    number of queries that were tried
{_QUERY}
history    DOUBLE[]    mean precision and recall, and mean and best fitness, of each generation""",
        "SELECT subclass, count(*) AS runs, max(fitness) AS best FROM keyframe_runs GROUP BY subclass ORDER BY ALL",
        stages="learn_keyframes",
    ),
    result_view(
        "hits",
        "The saved hits of keyframe queries.",
        f"""saved_as    VARCHAR    the name under which `kinedex search --save` saved the hits
query    VARCHAR    name of the query
{TAKE}
{SECONDS}""",
        "SELECT query, count(*) AS hits, sum(stop_seconds - start_seconds) AS seconds FROM hits "
        "WHERE saved_as = 'mine' GROUP BY query ORDER BY query",
    ),
)


ALL = "all_"
"""Prefix of the name of a view of results, for the view with the same columns and the rows of all pipelines."""

SOURCE_KINDS = ("skeleton_files", "source_files", "ingest_log")
"""Kinds of results that belong to a source folder, whichever pipeline has ingested it."""

SAVED_KINDS = ("hits", "duplicates", "known_failures", "accepted_doubts")
"""Kinds of results that belong to no pipeline; their views show all rows."""

RESULT_VIEWS = (*ANNOTATION_VIEWS, *TRACKING_VIEWS, *DEPTH_VIEWS, *INERTIAL_VIEWS, *KEYFRAME_VIEWS, *ARCHIVE_VIEWS)
