"""Check that a SQL statement only reads: its parse tree may contain only known kinds of nodes and known functions.

DuckDB serialises the tree of a query as JSON. The whole tree is traversed: every node must be of a kind that reads, and
every function must be in `allowed_functions`. The text itself is not searched for keywords, because DuckDB's grammar
has more ways to write a statement than a list of keywords can cover. Statements without such a tree (EXPLAIN, PRAGMA,
and a PIVOT that first looks up its columns) are allowed in a restricted form, from whose parts the statement to run is
composed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import duckdb

from kinedex.ops.errors import KinedexError
from kinedex.storage.sql.allowed_functions import FILE_FUNCTIONS, FUNCTIONS, OPERATORS, TABLE_FUNCTIONS

_NODES = frozenset(
    (
        "SELECT_NODE SET_OPERATION_NODE RECURSIVE_CTE_NODE CTE_NODE "  # queries
        "BASE_TABLE SUBQUERY JOIN TABLE_FUNCTION EXPRESSION_LIST EMPTY PIVOT SHOW_REF "  # the sources of a query
        "ORDER_MODIFIER LIMIT_MODIFIER LIMIT_PERCENT_MODIFIER DISTINCT_MODIFIER "
        "ORDER_DEFAULT ASCENDING DESCENDING ORDER_ASCENDING ORDER_DESCENDING"
    ).split()
)
_EXPRESSIONS = frozenset(
    (
        "BETWEEN CASE CAST COLLATE COLUMN_REF COMPARISON CONJUNCTION CONSTANT FUNCTION LAMBDA LAMBDA_REF OPERATOR "
        "PARAMETER POSITIONAL_REFERENCE STAR SUBQUERY TYPE WINDOW"
    ).split()
)
_PRAGMAS = frozenset(
    "collations database_list database_size functions metadata_info platform show show_databases show_tables "
    "show_tables_expanded storage_info table_info user_agent version".split()
)

_COMMENT = r"(?:--[^\n]*(?:\n|$)|/\*(?:[^*]|\*(?!/))*\*/)"
_QUOTED = re.compile(
    rf"""'(?:[^']|'')*' | "(?:[^"]|"")*" | \$(?P<tag>\w*)\$.*?\$(?P=tag)\$ | {_COMMENT}""", re.VERBOSE | re.DOTALL
)
_GAP = rf"(?:[ \t\r\n\f\v]|{_COMMENT})"
_NAME = r'(?:[A-Za-z_]\w*|"(?:[^"]|"")+")'
_COLUMN = rf"{_NAME}(?:{_GAP}*\.{_GAP}*{_NAME})*"
_AGGREGATE = rf"(?P<{{group}}>\w+){_GAP}*\({_GAP}*(?:\*|{_COLUMN})?{_GAP}*\)(?:{_GAP}+AS{_GAP}+{_NAME})?"
_EXPLAIN = (
    rf"{_GAP}*EXPLAIN(?={_GAP}|\()"
    rf"(?P<analyze>{_GAP}+ANALYZE(?={_GAP}|\())?"
    rf"(?:{_GAP}*\({_GAP}*(?P<options>(?:ANALYZE|FORMAT)(?:[ \t\r\n]|\w|,)*)\))?"
    r"(?P<query>.*)"
)
_PRAGMA = (
    rf"{_GAP}*PRAGMA{_GAP}+(?P<name>\w+){_GAP}*(?:\({_GAP}*(?P<value>'(?:[^']|'')*'|\w+){_GAP}*\))?{_GAP}*;?{_GAP}*"
)
_PIVOT = (
    rf"{_GAP}*PIVOT{_GAP}+(?P<source>{_NAME}){_GAP}+ON{_GAP}+{_COLUMN}(?:{_GAP}*,{_GAP}*{_COLUMN})*"
    rf"(?:{_GAP}+USING{_GAP}+{_AGGREGATE.format(group='first')}(?:{_GAP}*,{_GAP}*{_AGGREGATE.format(group='second')})?)?"
    rf"(?:{_GAP}+GROUP{_GAP}+BY{_GAP}+{_COLUMN}(?:{_GAP}*,{_GAP}*{_COLUMN})*)?{_GAP}*;?{_GAP}*"
)


def _match(pattern: str, text: str) -> re.Match[str] | None:
    """Match a pattern with a whole statement; it is compiled on first use, since most statements need none."""
    return re.fullmatch(pattern, text, re.IGNORECASE | re.DOTALL | re.ASCII)


class UnknownName(KinedexError):
    """A query uses a table or a function that does not exist."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(text)
        self.name = name


def checked(
    connection: duckdb.DuckDBPyConnection, text: str, macros: Iterable[str] = (), *, files: bool = False
) -> str:
    """Return the statement to run, or raise an error unless the text only reads.

    Parameters
    ----------
    connection : duckdb.DuckDBPyConnection
        The connection whose parser is used; the text is not executed.
    text : str
        One statement.
    macros : iterable of str
        Names of macros that may be called besides DuckDB's functions.
    files : bool
        If True, functions that read files may be called; the connection's settings limit which files.

    Returns
    -------
    str
        The text itself, or for EXPLAIN and PRAGMA the same statement composed from its parts.

    Raises
    ------
    KinedexError
        If the text is not one statement, does more than read, or calls a function that is not allowed; the message
        names what is refused and what to do instead.
    """
    _refuse_blanks(text)
    try:
        found = connection.extract_statements(text)
        kinds = [statement.type.name for statement in found]
    except duckdb.Error as fault:
        raise KinedexError(re.sub(r"^\w+ Error: ", "", str(fault).strip())) from None
    except ValueError:  # a kind of statement without a name in the Python client
        raise _refused("a statement of another kind") from None
    if len(kinds) != 1:
        raise KinedexError(f"expected one SQL statement, got {len(kinds)}")
    if kinds[0] == "EXPLAIN":
        return _explained(connection, text, macros, files)
    if kinds[0] == "PRAGMA":
        return _pragma(text)
    if kinds[0] == "MULTI":
        return _pivot(connection, text, frozenset(macros))
    if kinds[0] != "SELECT":
        raise _refused(kinds[0])
    allowed = FUNCTIONS | OPERATORS | TABLE_FUNCTIONS | frozenset(macros) | (FILE_FUNCTIONS if files else frozenset())
    for node in _nodes(_tree(connection, text)):
        _check_node(node, files)
        if "function_name" in node:
            _check_function(connection, str(node["function_name"]), allowed)
    return text


class Names(NamedTuple):
    """The names in a statement, in lower case.

    Attributes
    ----------
    tables : frozenset of str
        The tables and views that it reads; `"pragma"` for a PRAGMA.
    functions : frozenset of str
        The functions and macros that it calls.
    own : frozenset of str
        The names that it defines itself with WITH.
    """

    tables: frozenset[str]
    functions: frozenset[str]
    own: frozenset[str]


def names_in(connection: duckdb.DuckDBPyConnection, text: str) -> Names:
    """Return the names in a statement that `checked` allows.

    Raises
    ------
    KinedexError
        The statement has no tree, so that `checked` refuses it as well.
    """
    if explained := _match(_EXPLAIN, text):
        return names_in(connection, explained["query"])
    if _match(_PRAGMA, text):
        return Names(frozenset(("pragma",)), frozenset(), frozenset())
    if pivot := _match(_PIVOT, text):
        return Names(frozenset((pivot["source"].strip('"').lower(),)), frozenset(), frozenset())
    nodes = list(_nodes(_tree(connection, text)))
    tables, functions = (
        frozenset(str(node[key]).lower() for node in nodes if key in node) for key in ("table_name", "function_name")
    )
    return Names(tables, functions, frozenset(str(node["key"]).lower() for node in nodes if "key" in node))


_last_tree: tuple[str, Any] = ("", None)
"""The last parsed text and its tree, since the check and the search for names need the same tree."""


def _tree(connection: duckdb.DuckDBPyConnection, text: str) -> Any:
    """Return the parse tree of a text, which must not be modified."""
    global _last_tree
    last_text, tree = _last_tree
    if tree is None or last_text != text:
        tree = _parsed(connection, text)
        _last_tree = text, tree
    return tree


def _parsed(connection: duckdb.DuckDBPyConnection, text: str) -> Any:
    try:
        serialised = "SELECT json_serialize_sql(?, skip_null := true, skip_empty := true)"
        rows = connection.execute(serialised, [text]).fetchall()
    except duckdb.Error as fault:
        raise KinedexError(f"this statement cannot be checked: {str(fault).splitlines()[0]}") from None
    try:
        tree = json.loads(rows[0][0])
    except (ValueError, RecursionError):
        raise KinedexError("this statement is nested too deeply to be checked; divide it with WITH") from None
    if not isinstance(tree, dict) or tree.get("error", True):
        reason = tree.get("error_message", "no tree") if isinstance(tree, dict) else "no tree"
        raise _refused(f"a statement that cannot be checked ({reason})")
    return tree["statements"]


def _nodes(tree: Any) -> Iterator[dict[str, Any]]:
    """Yield every mapping of the tree, at any depth."""
    waiting = [tree]
    while waiting:
        part = waiting.pop()
        if isinstance(part, dict):
            yield part
            waiting.extend(part.values())
        elif isinstance(part, list):
            waiting.extend(part)


def _check_node(node: dict[str, Any], files: bool) -> None:
    kind, group = node.get("type"), node.get("class")
    if group is not None:
        if group not in _EXPRESSIONS:
            raise _refused(f"an expression of the kind {group}")
    elif isinstance(kind, str) and kind not in _NODES:
        raise _refused(kind.removesuffix("_QUERY_NODE").removesuffix("_NODE"))
    if "info_type" in node:
        raise _refused(str(node["info_type"]).removesuffix("_INFO"))
    if kind == "BASE_TABLE" and not files and not re.fullmatch(r"\w+", str(node.get("table_name", ""))):
        raise KinedexError(
            f"'{node.get('table_name')}' is no view or table; files are read only from folders that were opened "
            "with `--allow-files DIR`, or `files=[…]` of `open_store`"
        )


def _check_function(connection: duckdb.DuckDBPyConnection, name: str, allowed: frozenset[str]) -> None:
    if name in allowed or name.lower() in allowed:
        return
    if name.lower() in FILE_FUNCTIONS:
        raise KinedexError(
            f"{name}(…) reads files, and SQL reads the store alone; open a folder for it with `--allow-files DIR`, "
            "or `files=[…]` of `open_store`"
        )
    found = connection.execute("FROM duckdb_functions() WHERE lower(function_name) = ? LIMIT 1", [name.lower()])
    if not found.fetchall():
        raise UnknownName(name, f'Function with name "{name}" does not exist')
    raise _refused(f"{name}(…), which is not among the functions that are known to read only")


def _refuse_blanks(text: str) -> None:
    """Raise an error for non-ASCII whitespace and invisible characters outside literals, quoted names and comments."""
    bare = _QUOTED.sub(lambda quoted: " " * len(quoted[0]), text)
    for place, character in enumerate(bare):
        if not character.isascii() and (not character.isprintable() or character.isspace()):
            raise KinedexError(
                f"character {place + 1} is U+{ord(character):04X}, a blank or invisible character; "
                "write a plain space in its place (between quotes any character may stand)"
            )


def _explained(connection: duckdb.DuckDBPyConnection, text: str, macros: Iterable[str], files: bool) -> str:
    parts = _match(_EXPLAIN, text)
    if parts is None:
        raise _refused("an EXPLAIN of another form")
    query = checked(connection, parts["query"], macros, files=files)
    if re.match(rf"{_GAP}*(EXPLAIN|PRAGMA)\b", query, re.IGNORECASE):
        raise _refused("an EXPLAIN of something that is no query")
    options = (parts["options"] or "").lower()
    if re.sub(r"\b(analyze|true|false|format|json|text|html|graphviz|yaml|mermaid)\b|[\s,]", "", options):
        raise _refused(f"EXPLAIN ({parts['options']})")
    analyze = "ANALYZE " if parts["analyze"] else ""
    return f"EXPLAIN {analyze}{f'({options}) ' if options else ''}{query}"


def _pragma(text: str) -> str:
    parts = _match(_PRAGMA, text)
    if parts is None or parts["name"].lower() not in _PRAGMAS:
        raise KinedexError(f"only these PRAGMAs are allowed: {', '.join(sorted(_PRAGMAS))}")
    value = f"({parts['value']})" if parts["value"] else ""
    return f"PRAGMA {parts['name']}{value}"


def _pivot(connection: duckdb.DuckDBPyConnection, text: str, macros: frozenset[str]) -> str:
    parts = _match(_PIVOT, text)
    if parts is None:
        raise KinedexError(
            "only queries that read are allowed, and a PIVOT inside a query, or over one, is checked only with its "
            "values: PIVOT … ON column IN ('a', 'b') USING …; without them write PIVOT view ON column USING sum(column)"
        )
    for name in filter(None, (parts["first"], parts["second"])):
        _check_function(connection, name, FUNCTIONS | macros)
    return text


def _refused(what: str) -> KinedexError:
    return KinedexError(
        f"only queries that read are allowed, got {what}; "
        "to work with copies, write the result to a file or open the store with `Store.connect()`"
    )
