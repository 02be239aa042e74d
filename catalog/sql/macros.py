"""Define the SQL macros of a store, for short queries about runs, poses, takes and hits."""

from __future__ import annotations

from dataclasses import dataclass

from kinedex.catalog.limbs import LIMB_NAMES


@dataclass(frozen=True)
class Macro:
    """A macro of SQL.

    Attributes
    ----------
    name : str
        The name of the macro.
    arguments : tuple of (str, str or None, str)
        The name, default and meaning of each argument; the default is None for a required argument.
    summary : str
        The purpose of the macro in one sentence.
    body : str
        The SQL of the macro.
    example : str
        A query that runs on any store.
    table : bool
        True for a table macro, which is used in FROM; False for a scalar macro, which is used in expressions.
    needs : str
        "index" for a macro that is stored in the index file; "frames" or "results" for a macro that is only available
        when kinedex opens the store.
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
        """The call of the macro with its arguments: name(argument, argument := default)."""
        arguments = (name if default is None else f"{name} := {default}" for name, default, _ in self.arguments)
        return f"{self.name}({', '.join(arguments)})"

    def sql(self, *, temporary: bool = False) -> str:
        """Return the SQL statement that creates the macro."""
        kind = "TEMP MACRO" if temporary else "MACRO"
        return f"CREATE {kind} {self.signature} AS {'TABLE ' if self.table else ''}{self.body}"


# These expressions are inserted into the macros that need them, so that no macro calls another.
# (An argument must not share its name with a column that the same expression uses without a table name.)
_REFUSE = """error('no {what} ' || coalesce({given}, 'NULL') || coalesce(' (did you mean ''' || (
        SELECT arg_max(near.{name}, jaro_winkler_similarity(near.{name}, {given})) FROM {view} AS near
        WHERE jaro_winkler_similarity(near.{name}, {given}) > 0.75) || '''?)', '') || '; the view {view} lists them')"""


def _refuse(what: str, given: str, view: str, name: str) -> str:
    """Return an SQL expression that raises an error for an unknown name, suggesting the nearest name and the view."""
    return _REFUSE.format(what=what, given=f"CAST({given} AS VARCHAR)", view=view, name=name)


def _number(feature: str) -> str:
    """Return the SQL expression for the number of a feature that is given as a name, as 7, or as F7."""
    return f"""coalesce(
    (SELECT wanted.number FROM features AS wanted
     WHERE CAST({feature} AS VARCHAR) IN (wanted.name, CAST(wanted.number AS VARCHAR), 'F' || wanted.number)),
    {_refuse("feature", feature, "features", "name")})"""


def _take(name: str) -> str:
    """Return the SQL expression for the id of a take that is given by name; the id of NULL is NULL."""
    return f"""CASE WHEN {name} IS NOT NULL THEN coalesce(
    (SELECT wanted.take_id FROM takes AS wanted WHERE wanted.name = {name}),
    {_refuse("take is named", name, "takes", "name")}) END"""


_SET = f"""coalesce(
    (SELECT min(wanted.feature_set) FROM features AS wanted WHERE wanted.feature_set = set_name),
    {_refuse("feature set", "set_name", "features", "feature_set")})"""

# The terms of each pose, and the ranges of frames in which the pose occurs. `poses` holds the poses as (k, pose); a
# pose lists the names of features that must be on and, after "not", of those that must be off. A sweep over the ends of
# runs finds its ranges: all features that must be on are on, and none that must be off. For a pose without features
# that must be on, the runs of words show which frames are valid.
_POSE_RUNS = f"""asked AS (
    SELECT p.k, trim(unnest(string_split(CAST(p.pose AS VARCHAR), ','))) AS part FROM poses AS p),
spelt AS (
    SELECT a.k, regexp_matches(a.part, '^not\\s') AS off, trim(regexp_replace(a.part, '^not\\s+', '')) AS feature
    FROM asked AS a),
parts AS MATERIALIZED (
    SELECT DISTINCT s.k, s.off, {_number("s.feature")} AS number FROM spelt AS s),
counts AS (SELECT q.k, count(*) FILTER (NOT q.off) AS want FROM parts AS q GROUP BY q.k),
blind AS (
    SELECT DISTINCT q.k, t.take_id FROM parts AS q
    JOIN takes AS t ON ((t.known >> CAST(q.number - 1 AS UBIGINT)) & 1) = 0),
found AS (
    SELECT q.k, q.off, r.take_id, r.start, r.stop FROM parts AS q JOIN feature_runs AS r ON r.feature = q.number
    UNION ALL
    SELECT c.k, false, v.take_id::BIGINT, v.start, v.start + v.frames FROM counts AS c
    JOIN stored_valid_runs AS v ON c.want = 0),
pieces AS (
    SELECT d.k, d.off, d.take_id, d.start, d.stop FROM found AS d
    WHERE NOT EXISTS (SELECT 1 FROM blind AS b WHERE b.k = d.k AND b.take_id = d.take_id)),
ends AS (
    SELECT e.k, e.take_id, e.frame, sum(e.ons) AS ons, sum(e.offs) AS offs
    FROM (SELECT i.k, i.take_id, i.start AS frame, (NOT i.off)::INTEGER AS ons, i.off::INTEGER AS offs FROM pieces AS i
          UNION ALL
          SELECT i.k, i.take_id, i.stop, -(NOT i.off)::INTEGER, -i.off::INTEGER FROM pieces AS i) AS e
    GROUP BY e.k, e.take_id, e.frame),
swept AS (
    SELECT e.k, e.take_id, e.frame,
        sum(e.ons) OVER onward = greatest(c.want, 1) AND sum(e.offs) OVER onward = 0 AS holds,
        lead(e.frame) OVER onward AS next
    FROM ends AS e JOIN counts AS c ON c.k = e.k WINDOW onward AS (PARTITION BY e.k, e.take_id ORDER BY e.frame)),
turns AS (
    SELECT s.k, s.take_id, s.frame, s.next, s.holds,
        coalesce(lag(s.holds) OVER (PARTITION BY s.k, s.take_id ORDER BY s.frame), false) AS held FROM swept AS s),
numbered AS (
    SELECT t.k, t.take_id, t.frame, t.next, t.holds,
        count(*) FILTER (t.holds AND NOT t.held) OVER (PARTITION BY t.k, t.take_id ORDER BY t.frame) AS run
    FROM turns AS t),
pose_runs AS MATERIALIZED (
    SELECT n.k, n.take_id, min(n.frame) AS start, max(n.next) AS stop FROM numbered AS n
    WHERE n.holds GROUP BY n.k, n.take_id, n.run)"""

# The same two passes as `kinedex search` (thesis, Section 3.5). The backward pass finds for each pose the frames from
# which the remaining poses can be reached. The forward pass starts at the last frame of each such range of the first
# pose and always continues to the farthest frame within the gap. Ranges that overlap or touch are merged.
_PATTERN = f"""WITH RECURSIVE
poses AS (SELECT unnest(range(1, len(poses_in_order) + 1)) AS k, unnest(poses_in_order) AS pose),
{_POSE_RUNS},
last_one AS (SELECT max(p.k) AS k FROM poses AS p),
back(k, take_id, start, stop, gap) AS (
    SELECT s.k, s.take_id, s.start, s.stop, floor(within_seconds * t.rate_hz + 1e-9)::BIGINT
    FROM pose_runs AS s JOIN last_one AS l ON s.k = l.k JOIN takes AS t ON t.take_id = s.take_id
    UNION
    SELECT s.k, s.take_id, greatest(s.start, b.start - b.gap), least(s.stop, b.stop), b.gap
    FROM back AS b JOIN pose_runs AS s ON s.k = b.k - 1 AND s.take_id = b.take_id
    WHERE greatest(s.start, b.start - b.gap) < least(s.stop, b.stop)),
reach(k, take_id, start, last) AS (
    SELECT b.k, b.take_id, b.start, b.stop - 1 FROM back AS b WHERE b.k = 1
    UNION ALL
    SELECT r.k + 1, r.take_id, r.start, max(least(r.last + b.gap, b.stop - 1))
    FROM reach AS r JOIN back AS b ON b.k = r.k + 1 AND b.take_id = r.take_id
        AND b.start <= r.last + b.gap AND b.stop > r.last
    GROUP BY r.k, r.take_id, r.start, r.last),
ranges AS (
    SELECT r.take_id, r.start, max(r.last) + 1 AS stop FROM reach AS r JOIN last_one AS l ON r.k = l.k
    GROUP BY r.take_id, r.start),
before AS (
    SELECT r.take_id, r.start, r.stop, max(r.stop) OVER (PARTITION BY r.take_id ORDER BY r.start
        ROWS BETWEEN UNBOUNDED PRECEDING AND 1 PRECEDING) AS so_far FROM ranges AS r),
joined AS (
    SELECT b.take_id, b.start, b.stop, count(*) FILTER (b.so_far IS NULL OR b.so_far < b.start)
        OVER (PARTITION BY b.take_id ORDER BY b.start) AS number FROM before AS b),
hits_found AS (
    SELECT j.take_id, min(j.start)::INTEGER AS start, max(j.stop)::INTEGER AS stop
    FROM joined AS j GROUP BY j.take_id, j.number)
SELECT t.name AS take, h.take_id, h.start, h.stop, (h.stop - h.start) / t.rate_hz AS seconds
FROM hits_found AS h JOIN takes AS t ON t.take_id = h.take_id
ORDER BY t.name, h.start"""

_FEATURE = ("feature", None, "name or number of a feature")
_A = ("a", None, "name or number of the first feature")
_B = ("b", None, "name or number of the second feature")
_NAME = ("take", None, "name of a take")
_SET_NAME = ("set_name", None, "upper, lower or mix")
_NAMES_OF = """(SELECT coalesce(list(f.name ORDER BY f.number), []) FROM features AS f
     WHERE f.feature_set = {feature_set} AND (({word} >> CAST(f.bit AS UBIGINT)) & 1) = 1)"""
_LIMB = f"""CASE WHEN limb_name IS NULL OR limb_name IN ({", ".join(f"'{name}'" for name in LIMB_NAMES)})
    THEN limb_name ELSE error('no limb is named ' || limb_name || '; the limbs are {", ".join(LIMB_NAMES)}') END"""

MACROS = (
    Macro(
        "has",
        (("word", None, "a whole word, as in frames"), _FEATURE),
        "True if a feature is on in a word; NULL for the word of an invalid frame.",
        f"((word >> CAST({_number('feature')} - 1 AS UBIGINT)) & 1) = 1",
        "SELECT take_id, count(*) AS frames FROM frames WHERE has(word, 'rhand_above_neck') "
        "GROUP BY take_id ORDER BY take_id",
        table=False,
    ),
    Macro(
        "knows",
        (("mask", None, "the column `known` of takes"), _FEATURE),
        "True if a take has the joints that a feature needs; a feature that it lacks is neither on nor off.",
        f"coalesce(((mask >> CAST({_number('feature')} - 1 AS UBIGINT)) & 1) = 1, true)",
        "SELECT name FROM takes WHERE knows(known, 'rhand_above_neck') ORDER BY name LIMIT 5",
        table=False,
    ),
    Macro(
        "known_features",
        (_NAME,),
        "The features of a take: known is false where its body lacks the joints.",
        f"""SELECT f.number, f.name, f.description,
    t.known IS NULL OR ((t.known >> CAST(f.number - 1 AS UBIGINT)) & 1) = 1 AS known
FROM features AS f JOIN takes AS t ON t.take_id = {_take("take")}
ORDER BY f.number""",
        "SELECT known, count(*) AS features FROM known_features((SELECT min(name) FROM takes)) GROUP BY known",
    ),
    Macro(
        "features_of",
        (_SET_NAME, ("word", None, "a word of that set, as in vocabulary")),
        "The names of the features that are on in a word of a set; NULL without a word.",
        f"CASE WHEN word IS NOT NULL THEN {_NAMES_OF.format(feature_set=_SET, word='word')} END",
        "SELECT word, features_of(feature_set, word) AS features, frames FROM vocabulary "
        "WHERE feature_set = 'upper' ORDER BY frames DESC, word LIMIT 5",
        table=False,
    ),
    Macro(
        "runs_where",
        (_FEATURE, ("min_seconds", "0", "shortest duration that counts")),
        "The runs of a feature of at least a given duration, with the names of their takes.",
        f"""SELECT t.name AS take, r.take_id, r.start, r.stop, r.seconds
FROM feature_runs AS r JOIN takes AS t ON t.take_id = r.take_id
WHERE r.feature = {_number("feature")} AND r.seconds >= min_seconds
ORDER BY t.name, r.start""",
        "SELECT * FROM runs_where('relbow_bent', min_seconds := 0.5)",
    ),
    Macro(
        "together",
        (_A, _B),
        "The ranges of frames in which two features are on at the same time.",
        f"""SELECT t.name AS take, p.take_id, greatest(p.start, q.start) AS start, least(p.stop, q.stop) AS stop,
    (least(p.stop, q.stop) - greatest(p.start, q.start)) / t.rate_hz AS seconds
FROM feature_runs AS p
JOIN feature_runs AS q ON q.take_id = p.take_id AND p.start < q.stop AND q.start < p.stop
JOIN takes AS t ON t.take_id = p.take_id
WHERE p.feature = {_number("a")} AND q.feature = {_number("b")}
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
WHERE p.feature = {_number("a")} AND q.feature = {_number("b")}
    AND (q.start - p.stop) / t.rate_hz <= gap_seconds
ORDER BY 1, 3, 5""",
        "SELECT * FROM followed_by('rknee_bent', 'rfoot_fast', 0.5)",
    ),
    Macro(
        "pose",
        (
            ("features_on_or_off", None, "names or numbers with commas between; those after `not` are off"),
            ("min_seconds", "0", "shortest duration that counts"),
        ),
        "The longest ranges of frames in which some features are on and others off; the rest may be either.",
        f"""WITH poses AS (SELECT 1 AS k, features_on_or_off AS pose),
{_POSE_RUNS}
SELECT t.name AS take, s.take_id, s.start, s.stop, (s.stop - s.start) / t.rate_hz AS seconds
FROM pose_runs AS s JOIN takes AS t ON t.take_id = s.take_id
WHERE (s.stop - s.start) / t.rate_hz >= min_seconds
ORDER BY t.name, s.start""",
        "SELECT * FROM pose('rhand_above_neck, not lhand_above_neck', min_seconds := 0.2)",
    ),
    Macro(
        "pattern",
        (
            ("poses_in_order", None, "a list of poses, each as in `pose`"),
            ("within_seconds", "1", "longest gap from a frame of one pose to a frame of the next; may be 0"),
        ),
        "The ranges in which poses follow each other: the hits of `kinedex search` for keyframes with `within` gaps.",
        _PATTERN,
        "SELECT * FROM pattern(['not rhand_above_neck', 'rhand_above_neck', 'not rhand_above_neck'], "
        "within_seconds := 0.5)",
    ),
    Macro(
        "timeline",
        (_NAME,),
        "The runs of all features of a take, by start.",
        f"""SELECT r.start, r.stop, r.start / t.rate_hz AS start_seconds, r.stop / t.rate_hz AS stop_seconds,
    f.number AS feature, f.name, f.description
FROM feature_runs AS r
JOIN takes AS t ON t.take_id = r.take_id
JOIN features AS f ON f.number = r.feature
WHERE r.take_id = {_take("take")}
ORDER BY r.start, f.number""",
        "SELECT * FROM timeline((SELECT min(name) FROM takes))",
    ),
    Macro(
        "rarest_words",
        (_SET_NAME, ("n", "10", "number of words")),
        "The words of a set that fill the fewest frames.",
        f"""SELECT v.word, v.runs, v.frames,
    {_NAMES_OF.format(feature_set="v.feature_set", word="v.word")} AS features
FROM vocabulary AS v
WHERE v.feature_set = {_SET}
ORDER BY v.frames, v.runs, v.word LIMIT n""",
        "SELECT * FROM rarest_words('lower', n := 5)",
    ),
    Macro(
        "cooccurrence",
        (_FEATURE,),
        "The time for which each other feature is on while this one is on, and its share of this one's time.",
        f"""WITH own AS (SELECT r.take_id, r.start, r.stop FROM feature_runs AS r
    WHERE r.feature = {_number("feature")}),
shared AS (SELECT r.feature AS number, least(r.stop, own.stop) - greatest(r.start, own.start) AS frames, t.rate_hz
    FROM own JOIN feature_runs AS r ON r.take_id = own.take_id AND r.start < own.stop AND own.start < r.stop
    JOIN takes AS t ON t.take_id = own.take_id)
SELECT f.number AS feature, f.name, coalesce(sum(s.frames), 0)::BIGINT AS frames,
    coalesce(sum(s.frames / s.rate_hz), 0) AS seconds,
    coalesce(sum(s.frames), 0) / (SELECT sum(own.stop - own.start) FROM own) AS share
FROM features AS f LEFT JOIN shared AS s ON s.number = f.number
WHERE f.number <> {_number("feature")}
GROUP BY f.number, f.name
ORDER BY 3 DESC, 1""",
        "SELECT * FROM cooccurrence('rhand_fast') LIMIT 5",
    ),
    Macro(
        "frames_between",
        (_NAME, ("start", "0", "first frame"), ("stop", "NULL", "frame after the last")),
        "The frames [start, stop) of a take with all columns; up to its end where no stop is given.",
        f"""SELECT f.* FROM frames AS f
WHERE f.take_id = {_take("take")} AND f.frame >= start AND (stop IS NULL OR f.frame < stop)
ORDER BY f.frame""",
        "SELECT frame, rwrist.y FROM frames_between((SELECT min(name) FROM takes), 0, 30)",
        needs="frames",
    ),
    Macro(
        "frames_around",
        (
            _NAME,
            ("start", None, "first frame of a hit, a run, an annotation"),
            ("stop", None, "frame after its last"),
            ("seconds", "0.5", "time before and after it"),
        ),
        "The frames of a hit and around it: seconds from its start, true if inside, and all columns of frames.",
        f"""SELECT (f.frame - start) / t.rate_hz AS since_start, f.frame >= start AND f.frame < stop AS inside, f.*
FROM frames AS f JOIN takes AS t ON t.take_id = f.take_id
WHERE f.take_id = {_take("take")}
    AND f.frame >= start - floor(seconds * t.rate_hz + 1e-9) AND f.frame < stop + floor(seconds * t.rate_hz + 1e-9)
ORDER BY f.frame""",
        "SELECT since_start, inside, rwrist.y FROM frames_around((SELECT min(name) FROM takes), 5, 9, seconds := 0.1)",
        needs="frames",
    ),
    Macro(
        "labels_of",
        (_NAME,),
        "The annotations and the manual labels of a take, in order of time.",
        f"""SELECT l.source, l.run, l.class, l.subclass, l.start, l.stop,
    l.start / t.rate_hz AS start_seconds, l.stop / t.rate_hz AS stop_seconds, l.cost
FROM takes AS t JOIN (
    SELECT 'annotation' AS source, a.run, a.take_id, a.class, a.subclass, a.start, a.stop, a.cost FROM annotations AS a
    UNION ALL
    SELECT 'ground truth', g.run, g.take_id, g.class, NULL, g.start, g.stop, NULL FROM ground_truth AS g) AS l
    ON l.take_id = t.take_id
WHERE t.take_id = {_take("take")}
ORDER BY l.start, l.stop, l.source, l.run, l.class""",
        "SELECT * FROM labels_of((SELECT min(take) FROM annotations))",
        needs="results",
    ),
    Macro(
        "template_columns",
        (
            ("labelled", None, "a subclass that has templates"),
            ("tolerance", "0.05", "largest distance from 1 of an entry that is on, and from 0 of one that is off"),
        ),
        "The columns of a subclass's templates, with the names of the features that are on and that are off in them.",
        f"""WITH cells AS (
    SELECT m.run, m.kind, (i.place - 1) // m.features AS "column", m.weights[(i.place - 1) // m.features + 1] AS weight,
        (i.place - 1) % m.features + 1 AS number, m.values[i.place] AS value
    FROM (SELECT * FROM templates AS one WHERE one.subclass = CASE WHEN labelled IS NOT NULL THEN coalesce(
        (SELECT min(two.subclass) FROM templates AS two WHERE two.subclass = labelled),
        {_refuse("template of", "labelled", "templates", "subclass")}) END) AS m,
        LATERAL (SELECT unnest(range(1, len(m.values) + 1)) AS place) AS i)
SELECT c.run, c.kind, c.column, any_value(c.weight) AS weight,
    coalesce(list(f.name ORDER BY f.number) FILTER (c.value >= 1 - tolerance - 1e-9), []) AS features_on,
    coalesce(list(f.name ORDER BY f.number) FILTER (c.value <= tolerance + 1e-9), []) AS features_off
FROM cells AS c JOIN features AS f ON f.number = c.number
GROUP BY c.run, c.kind, c.column
ORDER BY c.run, c.kind, c.column""",
        "SELECT * FROM template_columns((SELECT min(subclass) FROM templates))",
        needs="results",
    ),
    Macro(
        "limb_errors_above",
        (
            ("limb_name", None, "a limb, such as lshank; NULL for all"),
            ("degrees_above", "45", "the error that the frames exceed"),
            ("min_seconds", "0", "shortest duration that counts"),
        ),
        "The ranges of source frames in which the error of a limb, compared with its sensor, is above a threshold.",
        f"""WITH wrong AS (
    SELECT e.stage, e.take, e.take_id, e.limb, e.source_frame, e.t, coalesce(e.degrees, e.swing_deg) AS error,
        e.source_frame - row_number() OVER (PARTITION BY e.stage, e.take_id, e.limb ORDER BY e.source_frame) AS run
    FROM limb_errors AS e
    WHERE e.valid AND coalesce(e.degrees, e.swing_deg) > degrees_above AND ({_LIMB} IS NULL OR e.limb = limb_name)),
rates AS (
    SELECT r.stage, r.take_id, r.limb, (max(r.t) - min(r.t)) / greatest(count(*) - 1, 1) AS step
    FROM limb_errors AS r GROUP BY r.stage, r.take_id, r.limb)
SELECT w.take, w.take_id, w.limb, min(w.source_frame) AS start, max(w.source_frame) + 1 AS stop,
    min(w.t) AS start_seconds, count(*) * any_value(s.step) AS seconds, max(w.error) AS peak_deg,
    avg(w.error) AS mean_deg
FROM wrong AS w JOIN rates AS s ON s.stage = w.stage AND s.take_id = w.take_id AND s.limb = w.limb
GROUP BY w.stage, w.take, w.take_id, w.limb, w.run
HAVING count(*) * any_value(s.step) >= min_seconds - 1e-9
ORDER BY w.take, w.limb, start""",
        "SELECT * FROM limb_errors_above('lshank', 45, min_seconds := 0.2)",
        needs="results",
    ),
    Macro(
        "worst_limbs",
        (("n", "10", "number of limbs"),),
        "The limbs of takes that are wrong for the largest share of their frames, compared with their sensors.",
        """SELECT e.take, e.take_id, e.limb, coalesce(any_value(w.frames), 0) / count(*) AS wrong,
    coalesce(any_value(w.seconds), 0) AS wrong_seconds, median(coalesce(e.degrees, e.swing_deg)) AS median_deg,
    max(coalesce(e.degrees, e.swing_deg)) AS peak_deg
FROM limb_errors AS e LEFT JOIN (
    SELECT r.stage, r.take_id, r.limb, sum(r.stop - r.start) AS frames, sum(r.seconds) AS seconds
    FROM limb_error_runs AS r WHERE r.kind = 'distance' GROUP BY r.stage, r.take_id, r.limb) AS w
    ON w.stage = e.stage AND w.take_id = e.take_id AND w.limb = e.limb
WHERE e.valid
GROUP BY e.stage, e.take, e.take_id, e.limb
ORDER BY wrong DESC, median_deg DESC, e.take, e.limb LIMIT n""",
        "SELECT * FROM worst_limbs(n := 5)",
        needs="results",
    ),
)
