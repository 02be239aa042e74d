"""Check that a SQL statement only reads: its parse tree may contain only known kinds of nodes and known functions.

Only listed functions are allowed, so that a function that a later DuckDB adds is refused until it has been reviewed. No
listed function reads or writes a file, reads the environment, changes the connection, or runs SQL from a text, except
those in `FILE_FUNCTIONS`, which read files.

DuckDB serialises the tree of a query as JSON. The whole tree is traversed: every node must be of a kind that reads, and
every function must be in the lists below. The text itself is not searched for keywords, because DuckDB's grammar
has more ways to write a statement than a list of keywords can cover. Statements without such a tree (EXPLAIN, PRAGMA,
and a PIVOT that first looks up its columns) are allowed in a restricted form: they are parsed here, and the statement
to run is composed again from the parts.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator
from typing import Any, NamedTuple

import duckdb

from kinedex.ops.errors import KinedexError

OPERATORS = frozenset(
    (
        "! != !__postfix !~~ !~~* % & && * ** + - -> ->> / // < <-> << <= <=> <@ = > >= >> @ @> ^ ^@ | || ~ ~~ ~~* ~~~"
    ).split()
) | {"IS DISTINCT FROM", "IS NOT DISTINCT FROM"}
"""Operators, which the parser converts to functions of these names."""

FUNCTIONS = frozenset(
    """
    abs acos acosh add age aggregate ago alias any_value apply approx_count_distinct approx_quantile
    approx_top_k arbitrary arg_max arg_max_null arg_max_nulls_last arg_min arg_min_null arg_min_nulls_last
    argmax argmin array_agg array_aggr array_aggregate array_append array_apply array_cat array_concat
    array_contains array_cosine_distance array_cosine_similarity array_cross_product array_distance
    array_distinct array_dot_product array_extract array_filter array_grade_up array_has array_has_all
    array_has_any array_indexof array_inner_product array_intersect array_length array_negative_dot_product
    array_negative_inner_product array_pop_back array_pop_front array_position array_prepend array_push_back
    array_push_front array_reduce array_resize array_reverse array_reverse_sort array_select array_slice
    array_sort array_to_json array_to_string array_to_string_comma_default array_transform array_unique
    array_value array_where array_zip ascii asin asinh atan atan2 atanh avg bar base64 bin binom bit_and
    bit_count bit_length bit_or bit_position bit_xor bitstring bitstring_agg bool_and bool_or cardinality cbrt
    ceil ceiling century char_length character_length chr coalesce concat concat_ws contains corr cos cosh cot
    count count_if count_star countif covar_pop covar_samp cume_dist current_catalog current_database
    current_date current_localtime current_localtimestamp current_schema damerau_levenshtein date_add date_diff
    date_part date_sub date_trunc datediff datepart datesub datetrunc day dayname dayofmonth dayofweek dayofyear
    days_in_month decade decimal_average decimal_division decode degrees dense_rank divide editdist3 element_at
    encode ends_with entropy enum_code enum_first enum_last enum_range enum_range_boundary epoch epoch_ms
    epoch_ns epoch_us equi_width_bins era error even exists exp factorial favg fdiv fill filter first
    first_value flatten floor fmod format formatReadableDecimalSize formatReadableSize format_bytes
    format_pg_type format_type from_base64 from_binary from_hex from_json from_json_strict fsum gamma gcd
    gen_random_uuid generate_series generate_subscripts geomean geometric_mean get_bit get_current_time
    get_current_timestamp grade_up greatest greatest_common_divisor group_concat grouping grouping_id hamming
    hash hex histogram histogram_exact hour if ifnull in_search_path instr isfinite isinf isnan isodow isoyear
    jaccard jaro_similarity jaro_winkler_similarity json json_array json_array_length json_contains
    json_deep_merge json_exists json_extract json_extract_path json_extract_path_text json_extract_string
    json_group_array json_group_object json_group_structure json_insert json_keys json_merge_patch
    json_merge_patch_diff json_normalize json_object json_pretty json_quote json_remove json_replace json_set
    json_strip_nulls json_structure json_transform json_transform_strict json_type json_valid json_value julian
    kahan_sum kurtosis kurtosis_pop lag last last_day last_value lcase lcm lead least least_common_multiple left
    left_grapheme len length length_grapheme levenshtein lgamma list list_aggr list_aggregate list_any_value
    list_append list_apply list_approx_count_distinct list_avg list_bit_and list_bit_or list_bit_xor
    list_bool_and list_bool_or list_cat list_comprehension list_concat list_contains list_cosine_distance
    list_cosine_similarity list_count list_distance list_distinct list_dot_product list_element list_entropy
    list_extract list_filter list_first list_grade_up list_has list_has_all list_has_any list_histogram
    list_indexof list_inner_product list_intersect list_kurtosis list_kurtosis_pop list_last list_mad list_max
    list_median list_min list_mode list_negative_dot_product list_negative_inner_product list_pack list_position
    list_prepend list_product list_reduce list_resize list_reverse list_reverse_sort list_select list_sem
    list_skewness list_slice list_sort list_stddev_pop list_stddev_samp list_string_agg list_sum list_transform
    list_unique list_value list_var_pop list_var_samp list_where list_zip listagg ln log log10 log2 lower lpad
    ltrim lttb mad make_date make_time make_timestamp make_timestamp_ms make_timestamp_ns make_timestamptz
    make_type map map_concat map_contains map_contains_entry map_contains_value map_entries map_extract
    map_extract_value map_from_entries map_keys map_values max max_by md5 md5_number md5_number_lower
    md5_number_upper mean median microsecond millennium millisecond min min_by minute mismatches mod mode month
    monthname multiply nanosecond nextafter nfc_normalize normalized_interval not_ilike_escape not_like_escape
    now nth_value ntile nullif octet_length ord overlay parse_dirname parse_dirpath parse_filename
    parse_formatted_bytes parse_path path_join percent_rank pg_typeof pi position pow power prefix printf
    product quantile quantile_cont quantile_disc quarter radians random range rank rank_dense reduce
    regexp_escape regexp_extract regexp_extract_all regexp_full_match regexp_matches regexp_replace
    regexp_split_to_array regexp_split_to_table regr_avgx regr_avgy regr_count regr_intercept regr_r2 regr_slope
    regr_sxx regr_sxy regr_syy repeat replace reservoir_quantile reverse right right_grapheme round round_even
    roundbankers row row_number row_to_json rpad rtrim second sem set_bit sha1 sha256 sign signbit sin sinh
    skewness split split_part sqrt st_asbinary st_asgeojson st_astext st_aswkb st_aswkt st_crs
    st_geomfromgeojson st_geomfromwkb st_intersects_extent starts_with stddev stddev_pop stddev_samp str_split
    str_split_regex strftime string_agg string_split string_split_regex string_to_array strip_accents strlen
    strpos strptime struct_concat struct_contains struct_extract struct_extract_at struct_has struct_indexof
    struct_insert struct_keys struct_pack struct_position struct_update struct_values substr substring
    substring_grapheme subtract suffix sum sum_no_overflow sumkahan tan tanh time_bucket timezone timezone_hour
    timezone_minute to_base to_base64 to_binary to_centuries to_days to_decades to_hex to_hours to_json
    to_microseconds to_millennia to_milliseconds to_minutes to_months to_quarters to_seconds to_timestamp
    to_weeks to_years today transaction_timestamp translate trim trunc try try_strptime typeof ucase unbin unhex
    unicode union_extract union_tag union_value unnest unpivot_list upper url_decode url_encode uuid
    uuid_extract_timestamp uuid_extract_version uuidv4 uuidv7 var_pop var_samp variance variant_array_length
    variant_contains variant_exists variant_extract variant_extract_string variant_keys variant_normalize
    variant_type variant_typeof version wavg week weekday weekofyear weighted_avg xor year yearweek
    """.split()
)
"""Scalar functions, aggregates and window functions."""

TABLE_FUNCTIONS = frozenset(
    """
    duckdb_columns duckdb_constraints duckdb_databases duckdb_functions duckdb_indexes duckdb_keywords duckdb_schemas
    duckdb_tables duckdb_types duckdb_views generate_series histogram histogram_values icu_calendar_names json_each
    json_tree pg_timezone_names pragma_collations pragma_database_size pragma_metadata_info pragma_platform
    pragma_show pragma_storage_info pragma_table_info pragma_user_agent pragma_version range repeat repeat_row summary
    unnest
    """.split()
)
"""Functions that return tables without reading any file."""

FILE_FUNCTIONS = frozenset(
    """
    glob parquet_file_metadata parquet_kv_metadata parquet_metadata parquet_scan parquet_schema read_blob read_csv
    read_csv_auto read_json read_json_auto read_json_objects read_json_objects_auto read_ndjson read_ndjson_auto
    read_ndjson_objects read_parquet read_text sniff_csv
    """.split()
)
"""Functions that read files, which are allowed if the user has opened folders."""


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
    """Match a whole statement with a pattern, which is compiled on first use, since most statements need no pattern."""
    return re.fullmatch(pattern, text, re.IGNORECASE | re.DOTALL | re.ASCII)


class UnknownName(KinedexError):
    """A query uses a table or a function that does not exist."""

    def __init__(self, name: str, text: str) -> None:
        super().__init__(text)
        self.name = name


def checked_statement(
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
    """Return the names in a statement that `checked_statement` allows.

    Raises
    ------
    KinedexError
        The statement has no tree, so that `checked_statement` refuses it as well.
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
    query = checked_statement(connection, parts["query"], macros, files=files)
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
