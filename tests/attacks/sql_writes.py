"""SQL that must not write: every kind of statement, nested in every place for a query, with every kind of blank."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from pathlib import Path

from kinedex.ops.errors import KinedexError
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.store import open_store
from tests.attacks.outcome import Options, Outcome
from tests.storage.made_up import make_store

SECRET = "a secret that no query may show"

SAMPLED = 61
"""A sample has each statement whose number is a multiple of this."""

BLANKS = (
    " ", "\t", "\n", "\r\n", "\f", "\v", "/**/", "/* x */", "--\n",
    "\u00a0", "\u1680", "\u2000", "\u2003", "\u2009", "\u200a", "\u200b", "\u2028", "\u2029", "\u202f", "\u205f",
    "\u3000", "\ufeff", "\u180e", "\u2060",
)  # fmt: skip

STATEMENTS = (
    "COPY takes TO '{file}'",
    "COPY (SELECT 1 AS x) TO '{file}' (FORMAT csv)",
    "COPY (FROM takes) TO '{manifest}'",
    "COPY takes FROM '{other}'",
    "INSERT INTO takes SELECT * FROM takes",
    "INSERT INTO takes VALUES (1) RETURNING *",
    "UPDATE takes SET name = ''",
    "DELETE FROM takes RETURNING name",
    "MERGE INTO takes USING takes AS t USING (take_id) WHEN MATCHED THEN DELETE",
    "TRUNCATE takes",
    "CREATE TABLE memory.t AS SELECT 1",
    "CREATE OR REPLACE VIEW takes AS SELECT 1",
    "CREATE TEMP MACRO f(x) AS x",
    "CREATE SECRET s (TYPE http)",
    "CREATE TYPE mood AS ENUM ('a')",
    "DROP VIEW takes",
    "ALTER TABLE takes RENAME TO other",
    "ATTACH '{file}' AS other",
    "DETACH idx",
    "USE memory",
    "SET threads = 1",
    "RESET threads",
    "SET VARIABLE x = 1",
    "EXPORT DATABASE '{file}'",
    "IMPORT DATABASE '{file}'",
    "INSTALL httpfs",
    "LOAD '{file}'",
    "UPDATE EXTENSIONS",
    "VACUUM",
    "CHECKPOINT",
    "FORCE CHECKPOINT",
    "BEGIN TRANSACTION",
    "PREPARE p AS SELECT 1",
    "EXECUTE p",
    "COMMENT ON VIEW takes IS 'x'",
    "CALL enable_logging(storage = 'file', storage_path = '{file}')",
    "CALL checkpoint()",
    "PRAGMA import_database('{file}')",
    "PRAGMA enable_profiling",
    "FROM query('COPY takes TO ''{file}''')",
    "FROM query_table('takes')",
    "FROM json_execute_serialized_sql(json_serialize_sql('SELECT 1'))",
    "FROM enable_logging(storage = 'file', storage_path = '{file}')",
    "FROM enable_profiling(save_location = '{file}')",
    "FROM checkpoint()",
    "FROM truncate_duckdb_logs()",
    "SELECT write_log('x')",
    "SELECT nextval('s')",
    "SELECT getenv('HOME')",
    "SELECT sleep_ms(1)",
    "FROM read_text('{secret}')",
    "FROM read_blob('{secret}')",
    "FROM read_csv('{secret}')",
    "FROM read_parquet('{part}')",
    "FROM glob('{folder}/*')",
    "FROM '{secret}'",
    "FROM \"{part}\"",
    "FROM sniff_csv('{secret}')",
    "FROM parquet_metadata('{part}')",
    "FROM duckdb_secrets()",
)  # fmt: skip

NESTINGS = (
    "{statement}",
    "{statement};",
    "({statement})",
    "SELECT 1; {statement}",
    "WITH a AS ({statement}) SELECT * FROM a",
    "WITH a AS MATERIALIZED ({statement}) SELECT * FROM a",
    "WITH a AS NOT MATERIALIZED ({statement}) FROM a",
    "WITH b AS (SELECT 1), a AS ({statement}) FROM a, b",
    "WITH a AS (WITH b AS ({statement}) FROM b) FROM a",
    "WITH RECURSIVE a AS ({statement}) FROM a",
    "FROM ({statement})",
    "FROM (WITH a AS ({statement}) FROM a)",
    "SELECT (WITH a AS ({statement}) SELECT count(*) FROM a)",
    "SELECT 1 WHERE EXISTS (WITH a AS ({statement}) FROM a)",
    "SELECT 1 WHERE 1 IN (WITH a AS ({statement}) SELECT 1 FROM a)",
    "SELECT 1 UNION ALL (WITH a AS ({statement}) SELECT 1 FROM a)",
    "SELECT 1 ORDER BY (WITH a AS ({statement}) SELECT 1 FROM a)",
    "SELECT 1 LIMIT (WITH a AS ({statement}) SELECT 1 FROM a)",
    "VALUES ((WITH a AS ({statement}) SELECT 1 FROM a))",
    "SELECT [x FOR x IN [1] IF (WITH a AS ({statement}) SELECT true FROM a)]",
    "SELECT list_transform([1], lambda x: (WITH a AS ({statement}) SELECT 1 FROM a))",
    "SELECT CASE WHEN (WITH a AS ({statement}) SELECT true FROM a) THEN 1 END",
    "SELECT 1 FROM takes t, LATERAL (WITH a AS ({statement}) FROM a) l",
    "FROM takes JOIN (WITH a AS ({statement}) SELECT 1 AS y FROM a) q ON true",
    "SELECT sum(1) OVER (ORDER BY (WITH a AS ({statement}) SELECT 1 FROM a))",
    "PIVOT (WITH a AS ({statement}) FROM a) ON name IN ('a') USING count(*)",
    "PIVOT (WITH a AS ({statement}) FROM a) ON name USING count(*)",
    "UNPIVOT (WITH a AS ({statement}) FROM a) ON name INTO NAME n VALUE v",
    "DESCRIBE {statement}",
    "DESCRIBE (WITH a AS ({statement}) FROM a)",
    "SUMMARIZE (WITH a AS ({statement}) FROM a)",
    "SUMMARIZE {statement}",
    "SHOW {statement}",
    "EXPLAIN {statement}",
    "EXPLAIN ANALYZE {statement}",
    "EXPLAIN ANALYZE WITH a AS ({statement}) FROM a",
    "EXPLAIN (ANALYZE, FORMAT json) {statement}",
    "EXPLAIN (ANALYZE) WITH a AS ({statement}) FROM a",
    "-- comment\n{statement}",
    "/* comment */ WITH a AS ({statement}) FROM a",
)


def attacks(names: dict[str, Path]) -> Iterator[str]:
    """Yield every statement in every nesting, with plain blanks, and with every other blank in each of the two.

    Parameters
    ----------
    names : dict of str to Path
        The files that stand in the statements: file, manifest, other, folder, part and secret.
    """
    for place, nesting in enumerate(NESTINGS):
        for number, statement in enumerate(STATEMENTS):
            filled = statement.format(**names)
            yield nesting.replace("{statement}", filled)
            # every pair of a statement and a nesting meets some of the blanks, and every blank meets every statement
            for turn in range(3):
                blank = BLANKS[(place + 7 * number + 5 * turn) % len(BLANKS)]
                yield nesting.replace("{statement}", filled.replace(" ", blank))
                if turn < 2:
                    yield nesting.replace(" ", blank).replace("{statement}", filled.replace(" ", blank))


def checksums(folder: Path) -> dict[str, str]:
    """Return the checksum of every file of a folder."""
    files = (path for path in sorted(folder.rglob("*")) if path.is_file())
    return {str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def run(folder: Path, options: Options) -> Outcome:
    """Run every statement, or the one of the case's number, against a store in a new folder."""
    only = int(options.case) if (options.case or "").isdigit() else None
    tried, refused, broken = attack(folder, only, every=SAMPLED if options.size == "sample" else 1)
    outcome = Outcome({"statements": tried, "refused": refused}, cases=tried)
    for line in broken:
        outcome.fail(line.split(":")[0], line)
    return outcome


def attack(folder: Path, only: int | None = None, every: int = 1) -> tuple[int, int, list[str]]:
    """Run every statement, or the one of this number, against a store in a new folder.

    Parameters
    ----------
    folder : Path
        The folder, which is not empty afterwards.
    only : int, optional
        The number of the one statement to run.
    every : int, optional
        Run each n-th statement; up to 5, every statement stands in every nesting at least once.

    Returns
    -------
    tuple of int, int and list of str
        How many statements were tried, how many of them were refused, and what got through: statements that showed a
        file from outside the store, and files that were not what they had been.
    """
    path = make_store(folder / "store", {"a": 30, "b": 40})
    build_index(open_store(path, at="newest"))
    (folder / "secret.csv").write_text(SECRET)
    broken, refused = [], 0
    with open_store(path, at="newest") as store:
        places = {
            "file": folder / "written",
            "manifest": sorted(path.glob("manifest/*.json"))[-1],
            "other": folder / "other.csv",
            "folder": folder,
            "part": path / store.manifest.frames[0].path,
            "secret": folder / "secret.csv",
        }
        tried = list(dict.fromkeys(attacks(places)))
        chosen = [number for number in range(len(tried)) if number % every == 0] if only is None else [only]
        before = checksums(folder)
        for number in chosen:
            statement = tried[number]
            try:
                if SECRET in str(store.sql(statement).to_pylist()):
                    broken.append(f"{number}: shows a file: {statement!r}")
            except KinedexError:
                refused += 1
        after = checksums(folder)
    broken += [
        f"all: changed, made or removed: {name}"
        for name in before.keys() | after.keys()
        if before.get(name) != after.get(name)
    ]
    return len(chosen), refused, broken
