"""Load kernels, indexes and files in the background that the first requests of a page would otherwise wait for.

Kernels are compiled on the first call after an installation, and loaded from files later. To load them, small requests
of each kind are made here, in the order in which users usually make them. The checksums of frame files are verified
before the first of them is shown.
"""

from __future__ import annotations

import logging
import time
from typing import TYPE_CHECKING

from starlette.requests import Request

from kinedex.ops.errors import KinedexError

if TYPE_CHECKING:
    from kinedex.explorer.examples import ExamplesRequest
    from kinedex.explorer.open_archive import Archive
    from kinedex.storage.store.store import Store

_LOG = logging.getLogger("kinedex.explorer")

MAX_CHECKED = 8_000_000_000
"""Maximum number of bytes of frame files that are verified in advance; in a larger archive, each file is verified when
it is first read.
"""

EXAMPLE_FRAMES = 60

_REQUEST = Request({"type": "http"})


def prepare(archive: Archive) -> None:
    """Make a small request of each kind; one that fails is logged and skipped.

    Parameters
    ----------
    archive : Archive
        The open store.
    """
    for step in (_open_sql, _ask_by_example, _check_frames, _ask_for_more, _ask_by_keyframes, _ask_for_doubtful):
        begin = time.perf_counter()
        try:
            step(archive)
            _LOG.info("%s: %.1f s", step.__name__, time.perf_counter() - begin)
        except KinedexError as fault:  # for instance because the index has not been built yet
            _LOG.info("%s: %s", step.__name__, fault)


def _open_sql(archive: Archive) -> None:
    archive.store().sql("SELECT take_id FROM suspect_takes WHERE take_id = -1")


def _example(store: Store, number: int) -> tuple[int, ExamplesRequest]:
    """Return the id of a take, and a search by example for intervals similar to its beginning."""
    from kinedex.explorer.examples import ExamplesRequest

    longest = sorted(store.take_frames, key=lambda take_id: -store.take_frames[take_id])
    chosen = longest[number % len(longest)]
    interval = {"take_id": chosen, "start": 0, "stop": min(EXAMPLE_FRAMES, store.take_frames[chosen])}
    return chosen, ExamplesRequest.model_validate({"positives": (interval,)})


def _ask_by_example(archive: Archive) -> None:
    from kinedex.explorer.examples import HitRequest, describe_hit, find_similar, warm_up

    warm_up()  # in this thread, because the process cannot end before the threads of a search do
    if not archive.store().take_frames:
        return
    chosen, asked = _example(archive.store(), 0)
    find_similar(archive, asked, _REQUEST)
    find_similar(archive, asked.model_copy(update={"where": f"take_id = {chosen}"}), _REQUEST)
    describe_hit(archive, HitRequest(positives=asked.positives, hit=asked.positives[0]), _REQUEST)


def _check_frames(archive: Archive) -> None:
    store = archive.store()
    if sum(part.bytes for part in store.manifest.frames) <= MAX_CHECKED:
        for part in store.manifest.frames:
            store.checked.part(part)


def _ask_for_more(archive: Archive) -> None:
    from kinedex.explorer.examples import ExamplesRequest, find_similar

    store = archive.store()
    if not store.take_frames:
        return
    (one, other, unlike) = (_example(store, number)[1].positives for number in (0, 1, 2))
    find_similar(archive, ExamplesRequest(positives=one + other, negatives=unlike), _REQUEST)


def _ask_by_keyframes(archive: Archive) -> None:
    from kinedex.explorer.keyframes import KeyframesRequest, find_keyframes

    first, second = (feature.name for feature in archive.store().feature_set.features[:2])
    poses = ({"on": (first,)}, {"on": (second,)})
    asked = {"query": {"poses": poses, "gaps": ({"low": 0.0, "high": 1.0},)}, "limit": 1}
    find_keyframes(archive, KeyframesRequest.model_validate(asked), _REQUEST)


def _ask_for_doubtful(archive: Archive) -> None:
    from kinedex.explorer.review_queue import QueueRequest, review_queue

    review_queue(archive, QueueRequest(limit=1), _REQUEST)
