"""Doubts about source files: refusals, warnings and guesses, and those of them that a person has accepted."""

from __future__ import annotations

KIND, STAGE = "accepted_doubts", "doubts/accept"
"""The kind of results in which a store keeps accepted doubts, and the stage that they are stored under."""

SURE = 0.8
"""The confidence of recognition below which a body counts as guessed."""

# Details differ from file to file: what stands in brackets or quotes, numbers, and what follows a colon or semicolon.
_DETAILS = (
    (r" *\([^()]*\)", ""),
    (r"'[^']*'", "…"),
    (r"(^|[\s≤<>])-?\d[\d.,]*", r"\1…"),
    (r"[:;](\s.*)?$", ""),
)


def doubts_select() -> str:
    """Return the SELECT statement of the view `doubts`, which lists what is doubtful about source files and takes.

    The cause of a doubt is its message without details, by which doubts of many files are grouped. If a store lacks the
    column of the confidence, the view has no guesses.
    """
    return f"""WITH refused AS (
    SELECT 'refused' AS kind, s.source_root, l.source, NULL::VARCHAR AS take,
        regexp_replace(CASE WHEN starts_with(l.message, l.file) THEN substr(l.message, length(l.file) + 1)
            ELSE l.message END, '^(:[0-9]+)?: ', '') AS message
    FROM ingest_log AS l LEFT JOIN source_files AS s
        ON (s.source, s.pipeline, s.stage) = (l.source, l.pipeline, l.stage)),
warned AS (
    SELECT 'warned' AS kind, t.source_root, t.source, t.name AS take, unnest(t.warnings) AS message FROM takes AS t),
figures AS (
    UNPIVOT (SELECT t.source_root, t.source, t.name AS take,
        COLUMNS(lambda c: c IN ('seconds', 'recognition_confidence')) FROM takes AS t)
    ON COLUMNS(* EXCLUDE (source_root, source, take)) INTO NAME figure VALUE value),
guessed AS (
    SELECT 'guessed' AS kind, g.source_root, g.source, g.take,
        printf('its body is recognised with a low confidence: %.2f', g.value) AS message
    FROM figures AS g WHERE g.figure = 'recognition_confidence' AND g.value < {SURE}),
found AS (FROM refused UNION ALL FROM warned UNION ALL FROM guessed)
SELECT f.kind, {cause_sql("f.message")} AS cause, f.source_root, f.source, f.take, f.message,
    EXISTS (SELECT 1 FROM accepted_doubts AS a WHERE (a.take, a.message) = (f.take, f.message)) AS accepted
FROM found AS f ORDER BY f.kind, cause, f.source, f.take, f.message"""


def cause_sql(message: str) -> str:
    """Return a SQL expression for the cause of a doubt, which is its message without details.

    Parameters
    ----------
    message : str
        A SQL expression for the message.
    """
    cause = f"split_part({message}, chr(10), 1)"
    for pattern, text in _DETAILS:
        cause = f"regexp_replace({cause}, {_quoted(pattern)}, {_quoted(text)}, 'g')"
    return cause


def _quoted(text: str) -> str:
    """Return a text as a SQL string."""
    return "'" + text.replace("'", "''") + "'"
