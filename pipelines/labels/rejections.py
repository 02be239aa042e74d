"""Look up annotations that people have rejected, to exclude them from exported labels and clips."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kinedex.storage.store.store import Store


class Rejections:
    """The intervals that people have rejected for a class.

    Parameters
    ----------
    store : Store
        The store that has the labels.
    """

    def __init__(self, store: Store) -> None:
        self._rejected = frozenset(
            (row["take"], row["class"], row["start"], row["stop"])
            for row in store.labels().to_pylist()
            if row["verdict"] == "negative"
        )

    def include(self, annotation: Mapping[str, Any]) -> bool:
        """Return whether an annotation, a row with class and subclass, was rejected with exactly its start and stop."""
        place = annotation["start"], annotation["stop"]
        names = annotation["class"], annotation["subclass"]
        return any((annotation["take"], name, *place) in self._rejected for name in names)
