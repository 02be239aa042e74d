"""Process batches of takes in threads, in order and with few batches in memory."""

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
    """Apply a function to every item in threads, with two items per thread in flight; yield the results in order.

    The next item is drawn only after earlier results were consumed, so that it can use thresholds from them. The
    kernels release the interpreter's lock: threads use all cores without copying words. After cancellation, only the
    items in flight are completed.
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
