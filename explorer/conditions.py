"""SQL conditions that users type: errors that quote them, and conditions over other views than `takes`."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import wraps
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import numpy.typing as npt

from kinedex.explorer.selections import SQL_SECONDS, Filter, Selection, packed_ids
from kinedex.ops.errors import KinedexError
from kinedex.storage import duck

if TYPE_CHECKING:
    from starlette.requests import Request

    from kinedex.explorer.archive import Archive
    from kinedex.storage.store.store import Store

_QUOTE = re.compile(r"(.*?)\n\nLINE (\d+): (.*)\n( *)\^+\s*", re.DOTALL)
"""A message of DuckDB: the error, and the line of the statement, cut to the part around the position that ^ marks."""

_SHOWN = 60
"""Maximum number of characters of a condition that a message quotes."""


Asked = TypeVar("Asked", bound=Selection)
Answer = Callable[["Archive", Asked, "Request"], dict[str, Any]]


def own_words(function: Answer[Asked]) -> Answer[Asked]:
    """Wrap the handler of an address, so that SQL errors quote the user's condition, not the statement around it.

    Parameters
    ----------
    function : callable
        Returns the answer to the archive, a selection and the request.
    """

    @wraps(function)
    def answer(archive: Archive, asked: Asked, request: Request) -> dict[str, Any]:
        try:
            return function(archive, asked, request)
        except KinedexError as fault:
            if type(fault) is KinedexError and (asked.where or "").strip():
                matching_takes(archive.store(), asked.where or "")
            raise

    return answer


def matching_takes(store: Store, where: str) -> npt.NDArray[np.int64]:
    """Return the ids of the takes for which a condition holds; it may read every view.

    Parameters
    ----------
    store : Store
        The store that is asked.
    where : str
        The condition.

    Raises
    ------
    KinedexError
        The condition is at fault; the message has the place in it.
    """
    text = where.strip()
    try:
        found = store.answer(f"SELECT take_id FROM takes WHERE (\n{text}\n)", timeout=SQL_SECONDS).table
    except KinedexError as fault:
        if type(fault) is not KinedexError:  # it took too long, or the client has disconnected
            raise
        raise KinedexError(in_own_words(str(fault), text)) from None
    ids: npt.NDArray[np.int64] = found.column("take_id").to_numpy()
    return ids


def in_own_words(message: str, text: str) -> str:
    """Return DuckDB's error message with the position relative to the user's condition, not the statement.

    Parameters
    ----------
    message : str
        The message of DuckDB about a statement in which the condition begins on line 2.
    text : str
        The condition.

    Examples
    --------
    >>> fault = 'syntax error at or near "ORDER"' + chr(10) * 2 + "LINE 2: class ORDER" + chr(10) + " " * 14 + "^"
    >>> in_own_words(fault, "class ORDER")
    'syntax error at or near "ORDER": character 7, “ORDER”'
    """
    lines = text.split("\n")
    found = _QUOTE.fullmatch(message)
    if found is None:
        short = message.partition("\n  the views and macros of a store")[0]
        return short.replace(" in FROM clause!\nCandidate bindings:", "; the nearest are").replace(
            " in FROM clause!", ""
        )
    what, number, shown, before = found[1], int(found[2]) - 2, found[3], found[4]
    if number >= len(lines):
        return "syntax error at the end: something is missing there, or a bracket is closed that was not opened"
    # a long line is cut at both ends
    part = shown.removeprefix("...").removesuffix("...")
    begin = max(0, lines[number].find(part))
    column = begin + max(0, len(before) - len(f"LINE {found[2]}: ") - (3 if shown.startswith("...") else 0))
    rest = lines[number][column:]
    place = f"character {column + 1}" if len(lines) == 1 else f"line {number + 1}, character {column + 1}"
    return f"{what}: {place}, “{rest if len(rest) <= _SHOWN else rest[:_SHOWN] + '…'}”"


def over_takes_alone(store: Store, asked: Selection) -> Selection:
    """Return a selection whose condition, if it has one, names columns of takes alone.

    Searches and exports filter the rows of takes. A condition over other views (`suspect_takes`) becomes the choice of
    the takes for which it holds now.

    Parameters
    ----------
    store : Store
        The store that is asked.
    asked : Selection
        The selection as the user made it.

    Raises
    ------
    KinedexError
        The condition is at fault; the message has the place in it.
    """
    where = (asked.where or "").strip()
    if not where:
        return asked
    try:
        duck.rows_where(store.take_rows.slice(0, 0), "takes", where)
    except duck.Error:
        found = matching_takes(store, where)
        if len(found) == 0:
            raise KinedexError(f"no take fits the condition {where}") from None
        chosen = Filter(column="take_id", chosen=packed_ids(found))
        return asked.model_copy(update={"where": None, "filters": (*asked.filters, chosen)})
    return asked
