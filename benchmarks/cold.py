"""`python -m benchmarks.cold STORE QUERIES`: time the way from opening a store to the answer, in a new process."""

from __future__ import annotations

import sys
import time

from kinedex.catalog.queries.query_reader import read_queries
from kinedex.pipelines.keyframes.store_search import search_store
from kinedex.storage.store.store import open_store


def main(store: str, file: str) -> None:
    """Search the queries of a file, and print the seconds since the store was opened."""
    began = time.perf_counter()
    opened = open_store(store)
    search_store(opened, read_queries(file, opened.feature_set))
    print(time.perf_counter() - began)


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
