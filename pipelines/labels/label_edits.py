"""Edit labels as in a timeline editor: draw, change, split, join, withdraw, accept, reject, and undo.

Every edit adds rows of labels and changes no existing row, so that the history is complete.
"""

from __future__ import annotations

import uuid
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.compute as pc

from kinedex.ops.errors import ConflictError, KinedexError, ParameterError
from kinedex.pipelines.labels.decisions import RecordedDecisions, decision_row, labels_by_id, withdrawal
from kinedex.storage.snapshot.schemas import labels_schema
from kinedex.storage.store.result_changes import record_labels
from kinedex.storage.store.store import Store, all_labels

Row = dict[str, Any]

_CONTENT = ("take", "class", "start", "stop", "limb", "verdict", "origin", "annotator", "confidence", "note", "source")
"""The columns of a label that an undo restores."""


class LabelEdits:
    """Edits of the labels of a store, which become rows for `pipelines.labels.decisions.record_decisions`.

    The caller chooses the ids of new rows, so that a request that is sent twice is recorded once: an edit with ids that
    the store already has adds nothing.

    Parameters
    ----------
    history : iterable of dict
        All rows of labels, in the order in which they were made.
    frames : mapping of str to int
        Name of a take → its number of frames.
    annotator : str, optional
        The name of the person who edits.

    Attributes
    ----------
    rows : list of dict
        The new rows.
    restored : dict of str to str
        Id of a label that is valid again → its new id.
    known : dict of str to dict
        All rows by their ids, the new ones included.
    """

    def __init__(self, history: Iterable[Row], frames: Mapping[str, int], annotator: str | None = None) -> None:
        self._frames = frames
        self._annotator = annotator
        self.known: dict[str, Row] = {}
        self._replaced: dict[str, str] = {}
        self.rows: list[Row] = []
        self.restored: dict[str, str] = {}
        for row in history:
            self._enter(row)

    def draw(self, id: str, take: str, label: str, start: int, stop: int, **more: Any) -> None:
        """Add a label; `more` are other columns, such as `verdict` and `limb`."""
        if id not in self.known:
            self._add({"id": id, "take": take, "class": label, "start": start, "stop": stop, "origin": "drawn", **more})

    def change(self, id: str, label: str, **values: Any) -> None:
        """Change the class, the start or stop, or the verdict of a label, given by its id."""
        if id in self.known:
            return
        before = self._standing(label)
        given = {key: value for key, value in values.items() if value is not None}
        if all(before[key] == value for key, value in given.items()):
            raise ParameterError("change", "a class, edges or a verdict that the label does not have", given or None)
        self._add({**self._copy(before), **given, "id": id, "origin": "corrected", "replaces": label})

    def split(self, ids: Sequence[str], label: str, at: int) -> None:
        """Split a label at a frame; `ids` are the ids of the two parts."""
        first, second = ids
        if first in self.known:
            return
        before = self._standing(label)
        if not before["start"] < at < before["stop"]:
            raise ParameterError("at", f"a frame within the label, from {before['start'] + 1}", at)
        more = {"origin": "corrected", "replaces": label}
        self._add({**self._copy(before), **more, "id": first, "stop": at})
        self._add({**self._copy(before), **more, "id": second, "start": at})

    def join(self, ids: Sequence[str], labels: Sequence[str]) -> None:
        """Join several labels of one take and class into one, from the first start to the last stop.

        The first id is for the joined label, the other ids are for the rows that withdraw the other labels.
        """
        if ids[0] in self.known:
            return
        if len(labels) < 2 or len(ids) != len(labels):
            raise ParameterError("labels", "at least two, with an id for each", len(labels))
        parts = [self._standing(one) for one in labels]
        for key in ("take", "class", "limb", "verdict"):
            if len({part[key] for part in parts}) > 1:
                raise ParameterError("labels", f"labels of one {key}", ", ".join(str(part[key]) for part in parts))
        edges = {"start": min(part["start"] for part in parts), "stop": max(part["stop"] for part in parts)}
        for id, label in zip(ids[1:], labels[1:], strict=True):
            self._withdraw(id, label)
        self._add({**self._copy(parts[0]), **edges, "id": ids[0], "origin": "corrected", "replaces": labels[0]})

    def withdraw(self, id: str, label: str) -> None:
        """Withdraw a label."""
        if id not in self.known:
            self._standing(label)
            self._withdraw(id, label)

    def decide(self, id: str, annotation: Mapping[str, Any], source: str, seen: str | None, *, accept: bool) -> None:
        """Accept or reject an annotation.

        Parameters
        ----------
        id : str
            The id of the new row.
        annotation : mapping
            A row of annotations.
        source : str
            The stage of the annotation.
        seen : str or None
            The id of the label with the same class, start and stop that the person saw; None if there was none.
        accept : bool
            True to accept, False to reject.

        Raises
        ------
        ConflictError
            There is another label with the same class, start and stop.
        """
        if id in self.known:
            return
        row = decision_row(annotation, accept, source, {"annotator": self._annotator})
        names = row.pop("names")
        standing = self._at(row, names)
        if standing is not None and standing["id"] != seen:
            raise ConflictError(f"{_shown(standing)} was {_decision(standing)} meanwhile{_by(standing)}")
        if standing is None and seen is not None:
            self._standing(seen)
        if standing is None or standing["verdict"] != row["verdict"]:
            self._add({**row, "id": id, "replaces": standing and standing["id"]})

    def restore(self, ids: Sequence[str], made: Sequence[str], back: Sequence[str]) -> None:
        """Undo an edit: labels that it replaced become valid again, and the rows that it made become invalid.

        To redo the edit, call this again: `made` are then the rows of the undo, and `back` the labels of the edit.

        Parameters
        ----------
        ids : sequence of str
            Ids of new rows: one for each label that becomes valid again, then one for each that becomes invalid.
        made : sequence of str
            The ids of the valid rows of the edit, or their newer ids in `restored`.
        back : sequence of str
            The ids of the labels that become valid again, with their class, start and stop.

        Raises
        ------
        ConflictError
            One of the rows has been replaced since then.
        """
        if not ids or ids[0] in self.known:
            return
        undone = {id: self._last(id) for id in made}
        left = iter(ids)
        for earlier in back:
            if earlier not in self.known:
                raise ConflictError(f"no label has the id {earlier}")
            if self.known[earlier]["verdict"] == "withdrawn":
                continue
            place = next((id for id, row in undone.items() if row["replaces"] == earlier), next(iter(undone), None))
            if place is not None:
                del undone[place]
            content = {key: self.known[earlier][key] for key in _CONTENT}
            self.restored[earlier] = _next(left)
            self._add({**content, "id": self.restored[earlier], "replaces": place}, restored=True)
        for row in undone.values():
            if row["verdict"] != "withdrawn":
                self._withdraw(_next(left), row["id"])

    def _last(self, id: str) -> Row:
        if id not in self.known or id in self._replaced:
            row = self.known.get(id)
            shown = "a label" if row is None else _shown(row)
            raise ConflictError(f"{shown} was changed again meanwhile, so that this edit cannot be undone")
        return self.known[id]

    def _standing(self, id: str) -> Row:
        """Return a valid label by its id; raise a ConflictError if it was replaced or does not exist."""
        row = self.known.get(id)
        if row is None:
            raise ConflictError(f"no label has the id {id}")
        if id in self._replaced:
            after = self.known[self._replaced[id]]
            how = "withdrawn" if after["verdict"] == "withdrawn" else f"changed to {_shown(after)}"
            raise ConflictError(f"{_shown(row)} was {how} meanwhile{_by(after)}")
        if row["verdict"] == "withdrawn":
            raise ConflictError(f"{_shown(row)} was withdrawn{_by(row)}")
        return row

    def _at(self, row: Mapping[str, Any], names: Iterable[str]) -> Row | None:
        """Return the valid label with the start and stop of a row and one of the given classes, or None."""
        chosen = set(names)
        place = row["take"], row["start"], row["stop"], row.get("limb")
        for one in self.known.values():
            same = (one["take"], one["start"], one["stop"], one["limb"]) == place and one["class"] in chosen
            if same and one["verdict"] != "withdrawn" and one["id"] not in self._replaced:
                return one
        return None

    def _copy(self, row: Row) -> Row:
        """Return the columns that the successor of a label inherits; it does not inherit the checksum of the take."""
        kept = ("take", "class", "start", "stop", "limb", "verdict", "source", "note")
        return {key: row[key] for key in kept}

    def _withdraw(self, id: str, label: str) -> None:
        self._add({**withdrawal(self.known[label]), "id": id})

    def _add(self, row: Row, *, restored: bool = False) -> None:
        """Add a row after filling in its columns and checking it against its take."""
        empty = dict.fromkeys((*_CONTENT, "replaces"), None) | {"verdict": "positive"}
        full = empty | ({} if restored else {"annotator": self._annotator}) | row
        if full["verdict"] != "withdrawn":
            self._check(full)
        self.rows.append(full)
        self._enter(full)

    def _check(self, row: Row) -> None:
        frames = self._frames.get(row["take"])
        if frames is None:
            raise KinedexError(f"no take is named '{row['take']}'; it may have been removed from the store")
        if not str(row["class"]).strip():
            raise ParameterError("class", "a name", repr(row["class"]))
        if not 0 <= row["start"] < row["stop"] <= frames:
            expected = f"frames [start, stop) within the {frames} of {row['take']}"
            raise ParameterError("start and stop", expected, (row["start"], row["stop"]))
        other = self._at(row, [row["class"]])
        if other is not None and other["id"] != row["replaces"]:
            raise ConflictError(f"there is such a label already: {_shown(other)}{_by(other)}")

    def _enter(self, row: Row) -> None:
        self.known[row["id"]] = row
        if row["replaces"] is not None:
            self._replaced[row["replaces"]] = row["id"]


def label_edits(store: Store, take: str, annotator: str | None = None) -> LabelEdits:
    """Return an editor of the labels of one take, with the labels that are on disk now.

    Parameters
    ----------
    store : Store
        The store.
    take : str
        Name of the take.
    annotator : str, optional
        The name of the person who edits.
    """
    rows = all_labels(store.path, store.manifest, store.checked)
    history = rows.filter(pc.equal(rows.column("take"), take)).to_pylist()
    frames = {name: store.take_frames[take_id] for name, take_id in store.take_ids.items() if name == take}
    return LabelEdits(history, frames, annotator)


def record_edits(store: Store, edits: LabelEdits) -> RecordedDecisions:
    """Record edits of labels in a store, which then shows them, and return the recorded rows."""
    recorded = record_labels(store.path, pa.Table.from_pylist(edits.rows, schema=labels_schema()))
    store.forget_labels()
    return RecordedDecisions(recorded)


def change_label(store: Store, id: str, *, annotator: str | None = None, **values: Any) -> RecordedDecisions:
    """Change the class, start, stop or verdict of a label.

    Parameters
    ----------
    store : Store
        The store.
    id : str
        The id of the label, or its beginning.
    annotator : str, optional
        The person who corrects it.
    **values : str or int, optional
        `class`, `start`, `stop` (frames) and `verdict`; values that are not given are unchanged.

    Raises
    ------
    KinedexError
        No label or several labels have such an id, or an equal label exists already.
    ParameterError
        Nothing would change, or the interval is not within the take.
    """
    (before,) = labels_by_id(store, [id]).iter_rows(named=True)
    edits = label_edits(store, before["take"], annotator)
    edits.change(uuid.uuid4().hex, before["id"], **values)
    return record_edits(store, edits)


def _next(ids: Any) -> str:
    found = next(ids, None)
    if found is None:
        raise ParameterError("ids", "an id for each row that the undo makes", "too few")
    return str(found)


def _shown(row: Row) -> str:
    return f"{row['class']} in {row['take']}[{row['start']}:{row['stop']}]"


def _decision(row: Row) -> str:
    return "rejected" if row["verdict"] == "negative" else "labelled"


def _by(row: Row) -> str:
    return f" by {row['annotator']}" if row.get("annotator") else ""
