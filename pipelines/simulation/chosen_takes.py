"""Select the takes of a store that are simulated, and name their recordings."""

from __future__ import annotations

import re
from collections.abc import Sequence

from kinedex.ops.errors import KinedexError
from kinedex.storage.formats.labels.file_names import file_names
from kinedex.storage.store.store import Store

_FORBIDDEN = re.compile(r"[^\w.+-]")
_MOST_LETTERS = 90


def chosen_takes(store: Store, takes: Sequence[str], where: str | None) -> list[str]:
    """Return the names of the takes that are named or selected, in the store's order.

    Parameters
    ----------
    store : Store
        The store.
    takes : sequence of str
        Names of takes.
    where : str or None
        SQL filter over the columns of takes, which selects further ones.

    Raises
    ------
    KinedexError
        There is no such take, or nothing is selected.
    """
    for name in takes:
        store.take_id(name)
    selected = set(store.takes_table(where)["name"].to_pylist()) if where is not None else set()
    if where is not None and not selected:
        raise KinedexError(f"the filter `{where}` selects no take of {store.path}")
    if not takes and where is None:
        raise KinedexError("no take is named; name takes, or select them with --where \"class = 'walk'\"")
    wanted = selected | set(takes)
    return [name for name in store.takes_table(None)["name"].to_pylist() if name in wanted]


def recording_names(takes: Sequence[str]) -> list[str]:
    """Return a name for the recording of each take, which is also the name of its folder.

    Letters, digits and . + - are kept, other characters become underscores.
    """
    plain = [(_FORBIDDEN.sub("_", take)[:_MOST_LETTERS]).lstrip(".+-") or "take" for take in takes]
    twice = {name.casefold() for name in plain if sum(one.casefold() == name.casefold() for one in plain) > 1}
    numbered = [f"{name}-{i + 1}" if name.casefold() in twice else name for i, name in enumerate(plain)]
    return [name.replace("~", "-") for name in file_names(numbered)]
