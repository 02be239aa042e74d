"""The commands and Python lines that make the same decisions about labels as a person made on the page."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from kinedex.explorer.same import command_line, python_lines

if TYPE_CHECKING:
    from kinedex.explorer.archive import Archive

Row = Mapping[str, Any]

_ID = 12
"""Number of digits of a label's id in a command."""


def same_decisions(archive: Archive, rows: Iterable[Row], known: Mapping[str, Row]) -> dict[str, str]:
    """Return the commands and the Python lines that make decisions, one line for each.

    Parameters
    ----------
    archive : Archive
        The open store.
    rows : iterable of mapping
        Rows of labels, as they were recorded.
    known : mapping of str to mapping
        Rows by their ids: those that `rows` replace.
    """
    lines = []
    gone: set[str] = set()  # when a label is split, the first part replaces it, and the second is a new label
    for row in rows:
        before = row.get("replaces") or ""
        lines.append(_line(archive, row, None if before in gone else known.get(before)))
        gone.add(before)
    if not lines:
        return {}
    return {
        "command": "\n".join(command for command, _ in lines),
        "python": python_lines(archive.path, *(python for _, python in lines)),
    }


def _line(archive: Archive, row: Row, before: Row | None) -> tuple[str, str]:
    """Return the command and the Python line that record the same decision about a label."""
    person = row.get("annotator")
    by, by_person = (["--annotator", person], f", annotator={person!r}") if person else ([], "")

    def command(name: str, *words: str) -> str:
        return command_line("kinedex", "labels", name, archive.path, *words, *by)

    if row["verdict"] == "withdrawn":
        id = str(row["replaces"])[:_ID]
        return command("remove", id), f"store.labels.remove([{id!r}]{by_person})"
    is_moved = before is not None and any(row[key] != before[key] for key in ("class", "start", "stop"))
    if before is not None and before["verdict"] != "withdrawn" and (is_moved or row["origin"] == "corrected"):
        return _change(command, row, before, by_person)
    if row["origin"] == "accepted" and row.get("source"):
        return _decide(command, row, by_person)
    keys = ("verdict", "limb", "note", "confidence")
    content = {key: row[key] for key in ("take", "class", "start", "stop")}
    content |= {key: row[key] for key in keys if row.get(key) not in (None, "positive")}
    options = ["--not"] if row["verdict"] == "negative" else []
    options += [word for key in keys[1:] if row.get(key) is not None for word in (f"--{key}", str(row[key]))]
    words = (row["take"], row["class"], str(row["start"]), str(row["stop"]), *options)
    return command("add", *words), f"store.labels.add([{content!r}]{by_person})"


def _change(command: Any, row: Row, before: Row, by_person: str) -> tuple[str, str]:
    """Return the command and the Python line that correct a label as the page did."""
    id = str(before["id"])[:_ID]
    given = {key: row[key] for key in ("class", "start", "stop", "verdict") if row[key] != before[key]}
    options = [word for key, value in given.items() for word in (f"--{key}", str(value))]
    names = {"class": "label"}
    arguments = "".join(f", {names.get(key, key)}={value!r}" for key, value in given.items())
    return command("change", id, *options), f"store.labels.change({id!r}{arguments}{by_person})"


def _decide(command: Any, row: Row, by_person: str) -> tuple[str, str]:
    """Return the command and the Python line that accept or reject an annotation."""
    name = "accept" if row["verdict"] == "positive" else "reject"
    edges = f"start = {row['start']} AND stop = {row['stop']}"
    take = row["take"].replace("'", "''")
    label = row["class"].replace("'", "''")
    where = f"SELECT * FROM annotations WHERE take = '{take}' AND {edges} AND '{label}' IN (class, subclass)"
    words = ("--take", row["take"], "--class", row["class"], "--where", edges, "--stage", row["source"])
    return command(name, *words), f"store.labels.{name}(store.sql({where!r}, polars=True){by_person})"
