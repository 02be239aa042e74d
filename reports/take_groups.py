"""Group the takes of a page by a column that divides them into a few groups, such as the actor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import PurePosixPath

import polars as pl

FEWEST, MOST = 2, 40
"""Minimum and maximum number of groups for which takes are grouped."""

NONE = "other"
"""The group of takes without a value."""

_SHARE = 0.5  # least share of takes that have a value
_OWN = ("class", "clip")  # columns that name the content or count takes
_EMPTY = (None, "")


def take_groups(takes: pl.DataFrame, columns: Sequence[str]) -> tuple[str, dict[str, str]]:
    """Group takes by the actor, or else by the one of `columns` with the most values, or by the folder.

    Parameters
    ----------
    takes : polars.DataFrame
        Rows of `takes` with name, source, actor and the columns.
    columns : sequence of str
        Columns of named groups of patterns, and of metadata.

    Returns
    -------
    name : str
        Name of the column, "folder", or empty if nothing divides the takes into `FEWEST` to `MOST` groups.
    groups : dict of str to str
        Name of a take → its group.
    """
    names = takes["name"].to_list()
    others = {name: takes[name].to_list() for name in columns if name not in (*_OWN, "actor") and name in takes.columns}
    folders = [PurePosixPath(source.replace("\\", "/")).parent.as_posix() for source in takes["source"].to_list()]
    candidates: dict[str, Sequence[object]] = {"actor": takes["actor"].to_list()}
    candidates |= {key: others[key] for key in sorted(others, key=lambda key: (-len(_values(others[key])), key))}
    candidates |= {"folder": ["" if one == "." else one for one in folders]}
    for name, values in candidates.items():
        if _divides(values):
            return name, {
                take: NONE if value in _EMPTY else str(value) for take, value in zip(names, values, strict=True)
            }
    return "", {}


def by_group(groups: Mapping[str, str], names: Sequence[str]) -> dict[str, list[str]]:
    """Return the takes of each group, both in the order of their names, takes without a value last."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(groups.get(name, ""), []).append(name)
    return {group: found[group] for group in sorted(found, key=lambda one: (one == NONE, one))}


def _values(values: Sequence[object]) -> set[object]:
    return {value for value in values if value not in _EMPTY}


def _divides(values: Sequence[object]) -> bool:
    known = sum(value not in _EMPTY for value in values)
    return FEWEST <= len(_values(values)) <= MOST and known >= _SHARE * len(values) and len(_values(values)) < known
