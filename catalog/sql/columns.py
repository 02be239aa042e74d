"""Descriptions of views: columns with types and meanings, and a query that runs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal


@dataclass(frozen=True)
class Column:
    """A column of a view: its name, DuckDB type and meaning."""

    name: str
    type: str
    meaning: str


@dataclass(frozen=True)
class View:
    """A relation that analysts query by name.

    Attributes
    ----------
    name : str
        Its name.
    origin : str
        "index" (a table of the published index), "parts" (read from the store's Parquet files), "results" (likewise,
        those of the current pipeline), "pipelines" (read from the manifest), "labels" (statements of people) or
        "derived" (made of other views by `body`).
    summary : str
        Its purpose in one sentence.
    columns : tuple of Column
        Its columns.
    example : str
        A query that runs on any store.
    body : str
        The SELECT of a view that is made of others.
    stored : tuple of Column
        The columns of the Parquet files of a view of results.
    stages : tuple of str
        The kinds of stages that make the rows of a view of results.
    """

    name: str
    origin: Literal["index", "parts", "labels", "results", "pipelines", "derived"]
    summary: str
    columns: tuple[Column, ...]
    example: str
    body: str = ""
    stored: tuple[Column, ...] = ()
    stages: tuple[str, ...] = ()


def columns(text: str) -> tuple[Column, ...]:
    """Parse columns from lines of name, type and meaning, separated by two spaces or more."""
    rows = (re.split(r"\s{2,}", line.strip(), maxsplit=2) for line in text.strip().splitlines())
    return tuple(Column(name, kind, meaning) for name, kind, meaning in rows)
