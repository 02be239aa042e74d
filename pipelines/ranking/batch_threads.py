"""Threads that work on batches of takes, in order and with few batches in memory."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import TypeVar

from kinedex.ops.withdrawal import check_withdrawn

Asked = TypeVar("Asked")
Found = TypeVar("Found")


def in_threads(work: Callable[[Asked], Found], items: Iterable[Asked], workers: int) -> Iterator[Found]:
    """Apply the work to every item in threads, with two items a thread in flight; results come in order.

    The next item is drawn after the results before it were consumed, so that it knows their thresholds. The kernels
    release the interpreter's lock: threads use all cores, without a copy of the words. Work that is withdrawn ends with
    the items in flight.
    """
    source = iter(items)
    with ThreadPoolExecutor(max(1, workers)) as pool:
        waiting: deque[Future[Found]] = deque(pool.submit(work, item) for item in islice(source, 2 * workers))
        try:
            while waiting:
                check_withdrawn()
                yield waiting.popleft().result()
                waiting.extend(pool.submit(work, item) for item in islice(source, 1))
        finally:
            for future in waiting:
                future.cancel()
