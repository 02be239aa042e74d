"""What analysts query: the views and table macros of a store, as SQL text with the words that explain them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Column:
    """A column of an index table: its DuckDB type and what it holds."""

    name: str
    type: str
    meaning: str


@dataclass(frozen=True)
class View:
    """A relation that analysts query by name.

    origin: "index" (a table of the published index), "parts" (read from the store's Parquet files) or "results"
    (likewise, the rows of all live runs). columns: of tables that only the index has; the others follow their Arrow
    schema.
    """

    name: str
    origin: str
    summary: str
    columns: tuple[Column, ...] = ()


@dataclass(frozen=True)
class Macro:
    """A macro: arguments as (name, default or None, meaning), its SQL, and an example that runs on any store.

    table: whether it stands in FROM; otherwise it is an expression. needs: "index" macros are stored in the index file,
    "frames" macros exist where a store is opened with kinedex.
    """

    name: str
    arguments: tuple[tuple[str, str | None, str], ...]
    summary: str
    body: str
    example: str
    table: bool = True
    needs: str = "index"

    @property
    def signature(self) -> str:
        """The macro as it is called: name(argument, argument := default)."""
        arguments = (name if default is None else f"{name} := {default}" for name, default, _ in self.arguments)
        return f"{self.name}({', '.join(arguments)})"

    def sql(self, *, temporary: bool = False) -> str:
        """The statement that makes the macro."""
        kind = "TEMP MACRO" if temporary else "MACRO"
        return f"CREATE {kind} {self.signature} AS {'TABLE ' if self.table else ''}{self.body}"


_TAKE_ID = Column("take_id", "BIGINT", "id of the take")
_START = Column("start", "INTEGER", "first frame, from 0")
_STOP = Column("stop", "INTEGER", "frame after the last")

VIEWS = (
    View("takes", "index", "One row per take: name, source file, rate, length, actor, class, warnings."),
    View(
        "features",
        "index",
        "The features of the store's feature set.",
        (
            Column("number", "UTINYINT", "F1 is 1; bit number − 1 of a whole word"),
            Column("name", "VARCHAR", "short name, such as rhand_forwards"),
            Column("description", "VARCHAR", "what it says about the body"),
            Column("feature_set", "VARCHAR", "the set it belongs to: upper, lower or mix"),
            Column("bit", "UTINYINT", "its bit in the words of that set"),
        ),
    ),
    View(
        "word_runs",
        "index",
        "The inverted lists: stretches of frames with the same word of a set, sorted by set, word, take, start.",
        (
            Column("feature_set", "VARCHAR", "upper, lower or mix"),
            Column("word", "UBIGINT", "the word, cut down to the set"),
            _TAKE_ID,
            _START,
            _STOP,
        ),
    ),
    View(
        "feature_runs",
        "index",
        "Stretches of frames where a feature is on, sorted by feature, take, start.",
        (
            Column("feature", "UTINYINT", "the feature's number"),
            _TAKE_ID,
            _START,
            _STOP,
            Column("seconds", "DOUBLE", "duration of the run"),
        ),
    ),
    View(
        "vocabulary",
        "index",
        "The distinct words of each feature set and how often they occur.",
        (
            Column("feature_set", "VARCHAR", "upper, lower or mix"),
            Column("word", "UBIGINT", "the word, cut down to the set"),
            Column("runs", "BIGINT", "its runs in all takes"),
            Column("frames", "BIGINT", "its frames in all takes"),
        ),
    ),
    View(
        "help",
        "index",
        "This list: every view and macro with what it is for.",
        (
            Column("name", "VARCHAR", "name of the view or macro"),
            Column("call", "VARCHAR", "how it stands in a query"),
            Column("summary", "VARCHAR", "what it is for"),
            Column("example", "VARCHAR", "a query that runs"),
        ),
    ),
    View(
        "frames",
        "parts",
        "One row per analysis frame: 24 joints (rwrist.y), root_orientation, the whole word (null if invalid).",
    ),
    View("templates", "results", "Motion templates, soft and hard, per subclass."),
    View("annotated_takes", "results", "The takes that were annotated, also those in which nothing was found."),
    View("distance_curves", "results", "The distance curve of a subclass over a take, one cost per frame."),
    View("annotations", "results", "What the annotation found: class, range, cost."),
    View("ranked_hits", "results", "The best places for each template, by rank: take, range, cost."),
    View("retrieval", "results", "How good rankings are: average precision and recall of each class, and confusions."),
    View("ground_truth", "results", "The manual labels that annotations are compared with."),
    View("metrics", "results", "Precision, recall and F1 by frames (1) and by segments (2)."),
    View("queries", "results", "Learned keyframe queries, in bits of whole words, with their margins."),
    View("keyframe_runs", "results", "The runs that keyframe queries were learned in, one row each."),
    View("hits", "results", "What keyframe queries found."),
    View("ingest_log", "results", "Source files, or places in them, that could not be read."),
)

# Written into the macros that need them, so that each stands alone and none calls another.
# (An argument must not have the name of a column that stands beside it without a table's name.)
_NUMBER = """coalesce(
    (SELECT wanted.number FROM features AS wanted
     WHERE wanted.name = CAST({0} AS VARCHAR) OR CAST(wanted.number AS VARCHAR) = ltrim(CAST({0} AS VARCHAR), 'F')),
    error('no feature ' || CAST({0} AS VARCHAR) || '; the view features lists them'))"""
_TAKE = """coalesce(
    (SELECT wanted.take_id FROM takes AS wanted WHERE wanted.name = {0}),
    error('no take is named ' || {0} || '; the view takes lists them'))"""
_SET = """coalesce(
    (SELECT min(wanted.feature_set) FROM features AS wanted WHERE wanted.feature_set = {0}),
    error('no feature set ' || {0} || '; the view features lists them'))"""

_FEATURE = ("feature", None, "name or number of a feature")
_A = ("a", None, "name or number of the first feature")
_B = ("b", None, "name or number of the second feature")

MACROS = (
    Macro(
        "has",
        (("word", None, "a whole word, as in frames"), _FEATURE),
        "Whether a feature is on in a word.",
        f"((word >> CAST({_NUMBER.format('feature')} - 1 AS UBIGINT)) & 1) = 1",
        "SELECT take_id, count(*) AS frames FROM frames WHERE has(word, 'rhand_above_neck') GROUP BY take_id",
        table=False,
    ),
    Macro(
        "features_of",
        (("set_name", None, "upper, lower or mix"), ("word", None, "a word of that set, as in vocabulary")),
        "The names of the features that are on in a word of a set.",
        """(SELECT coalesce(list(f.name ORDER BY f.number), []) FROM features AS f
 WHERE f.feature_set = set_name AND ((word >> CAST(f.bit AS UBIGINT)) & 1) = 1)""",
        "SELECT word, features_of(feature_set, word) AS features, frames FROM vocabulary "
        "WHERE feature_set = 'upper' ORDER BY frames DESC, word LIMIT 5",
        table=False,
    ),
    Macro(
        "runs_where",
        (_FEATURE, ("min_seconds", "0", "shortest duration that counts")),
        "The runs of a feature that last long enough, with the names of their takes.",
        f"""SELECT t.name AS take, r.take_id, r.start, r.stop, r.seconds
FROM feature_runs AS r JOIN takes AS t ON t.take_id = r.take_id
WHERE r.feature = {_NUMBER.format("feature")} AND r.seconds >= min_seconds
ORDER BY t.name, r.start""",
        "SELECT * FROM runs_where('relbow_bent', min_seconds := 0.5)",
    ),
    Macro(
        "together",
        (_A, _B),
        "The stretches where two features are on at the same time.",
        f"""SELECT t.name AS take, p.take_id, greatest(p.start, q.start) AS start, least(p.stop, q.stop) AS stop,
    (least(p.stop, q.stop) - greatest(p.start, q.start)) / t.rate_hz AS seconds
FROM feature_runs AS p
JOIN feature_runs AS q ON q.take_id = p.take_id AND p.start < q.stop AND q.start < p.stop
JOIN takes AS t ON t.take_id = p.take_id
WHERE p.feature = {_NUMBER.format("a")} AND q.feature = {_NUMBER.format("b")}
ORDER BY 1, 3""",
        "SELECT * FROM together('rhand_above_neck', 'lhand_above_neck')",
    ),
    Macro(
        "followed_by",
        (_A, _B, ("gap_seconds", None, "longest time from the end of one run to the start of the other")),
        "Runs of a feature after which, within a time, a run of another feature starts.",
        f"""SELECT t.name AS take, p.take_id, p.start, p.stop AS a_stop, q.start AS b_start, q.stop,
    (q.start - p.stop) / t.rate_hz AS gap
FROM feature_runs AS p
JOIN feature_runs AS q ON q.take_id = p.take_id AND q.start >= p.stop
JOIN takes AS t ON t.take_id = p.take_id
WHERE p.feature = {_NUMBER.format("a")} AND q.feature = {_NUMBER.format("b")}
    AND (q.start - p.stop) / t.rate_hz <= gap_seconds
ORDER BY 1, 3, 5""",
        "SELECT * FROM followed_by('rknee_bent', 'rfoot_fast', 0.5)",
    ),
    Macro(
        "timeline",
        (("take", None, "name of a take"),),
        "What a take's features do, run by run.",
        f"""SELECT r.start, r.stop, r.start / t.rate_hz AS start_seconds, r.stop / t.rate_hz AS stop_seconds,
    f.number AS feature, f.name, f.description
FROM feature_runs AS r
JOIN takes AS t ON t.take_id = r.take_id
JOIN features AS f ON f.number = r.feature
WHERE r.take_id = {_TAKE.format("take")}
ORDER BY r.start, f.number""",
        "SELECT * FROM timeline((SELECT min(name) FROM takes))",
    ),
    Macro(
        "rarest_words",
        (("set_name", None, "upper, lower or mix"), ("n", "10", "how many")),
        "The words of a set that fill the fewest frames.",
        f"""SELECT v.word, v.runs, v.frames,
    (SELECT coalesce(list(f.name ORDER BY f.number), []) FROM features AS f
     WHERE f.feature_set = v.feature_set AND ((v.word >> CAST(f.bit AS UBIGINT)) & 1) = 1) AS features
FROM vocabulary AS v
WHERE v.feature_set = {_SET.format("set_name")}
ORDER BY v.frames, v.runs, v.word LIMIT n""",
        "SELECT * FROM rarest_words('lower', n := 5)",
    ),
    Macro(
        "cooccurrence",
        (_FEATURE,),
        "How long every other feature is on while this one is, and which share of its time that is.",
        f"""WITH own AS (SELECT r.take_id, r.start, r.stop FROM feature_runs AS r
    WHERE r.feature = {_NUMBER.format("feature")}),
shared AS (SELECT r.feature AS number, least(r.stop, own.stop) - greatest(r.start, own.start) AS frames, t.rate_hz
    FROM own JOIN feature_runs AS r ON r.take_id = own.take_id AND r.start < own.stop AND own.start < r.stop
    JOIN takes AS t ON t.take_id = own.take_id)
SELECT f.number AS feature, f.name, coalesce(sum(s.frames), 0)::BIGINT AS frames,
    coalesce(sum(s.frames / s.rate_hz), 0) AS seconds,
    coalesce(sum(s.frames), 0) / (SELECT sum(own.stop - own.start) FROM own) AS share
FROM features AS f LEFT JOIN shared AS s ON s.number = f.number
WHERE f.number <> {_NUMBER.format("feature")}
GROUP BY f.number, f.name
ORDER BY 3 DESC, 1""",
        "SELECT * FROM cooccurrence('rhand_fast') LIMIT 5",
    ),
    Macro(
        "frames_between",
        (("take", None, "name of a take"), ("start", "0", "first frame"), ("stop", "NULL", "frame after the last")),
        "The frames [start, stop) of a take, joints and all; to its end where no stop is given.",
        f"""SELECT f.* FROM frames AS f
WHERE f.take_id = {_TAKE.format("take")} AND f.frame >= start AND (stop IS NULL OR f.frame < stop)
ORDER BY f.frame""",
        "SELECT frame, rwrist.y FROM frames_between((SELECT min(name) FROM takes), 0, 30)",
        needs="frames",
    ),
)


def help_rows(*, index_only: bool = False) -> list[tuple[str, str, str, str]]:
    """The rows of the view `help`: (name, call, summary, example); `index_only`: of what the index itself holds."""
    rows = [
        (view.name, f"FROM {view.name}", view.summary, f"SELECT * FROM {view.name} LIMIT 10")
        for view in VIEWS
        if view.origin == "index" or not index_only
    ]
    for macro in MACROS:
        if macro.needs == "index" or not index_only:
            call = f"FROM {macro.signature}" if macro.table else macro.signature
            rows.append((macro.name, call, macro.summary, macro.example))
    return rows
