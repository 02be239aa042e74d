"""`python -m studies.retrieval STORE …`: judge searches by example, with every clip that has a class as an example.

The stores are those of `kinedex run hdm05-cmu` and of `python -m studies.bandai`. Each take of a class with eight takes
or more is an example for a search in the other takes: by `rank`, with its default threshold and with that of `similar`,
and by `similar`. A hit is right if its take has the class of the example; of the hits of a take the best counts. Takes
without a class are searched, but their hits are not judged. Printed are the mean, over examples, of the precision among
the ten best hits (or as many as there are other takes of the class), the least such mean of a class, the mean average
precision, and what the line of `similar` divides: the share of right hits above it, and the share of all takes of the
class that lie above it.

With `--where`, only the takes that it selects are examples, such as `"starts_with(name, 'dataset-1')"`.
"""

from __future__ import annotations

import argparse
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars as pl

import kinedex

LEAST = 8
"""Classes with fewer takes are not asked for."""

BEST = 10
"""The number of best hits that are judged."""

Search = Callable[[kinedex.Store, str], pl.DataFrame]


def by_words(tau: float | None) -> Search:
    """Return the search by the distance of words below a threshold, that of `rank` by default."""

    def search(store: kinedex.Store, take: str) -> pl.DataFrame:
        example = kinedex.Template.from_clip(store[take])
        return store.rank(example, None) if tau is None else store.rank(example, None, tau=tau)

    return search


def by_numbers(store: kinedex.Store, take: str) -> pl.DataFrame:
    """Return the hits of the search by words and numbers."""
    return store.similar(take, top=None)


SEARCHES: dict[str, Search] = {"words, τ 0.1": by_words(None), "words, τ 0.5": by_words(0.5), "numbers": by_numbers}


class Judged(NamedTuple):
    """The judgement of one search.

    Attributes
    ----------
    label : str
        The class of the example.
    precision : float
        The share of right hits among the best.
    average_precision : float
        The average precision.
    above, right_above, relevant : int
        The takes whose best hit is probable, those of them that are right, and the other takes of the class.
    """

    label: str
    precision: float
    average_precision: float
    above: int
    right_above: int
    relevant: int


def judged(found: pl.DataFrame, example: str, classes: dict[str, str], relevant: int) -> Judged:
    """Return the judgement of the hits of an example."""
    probable = found["probable"].to_list() if "probable" in found.columns else [False] * found.height
    seen: dict[str, bool] = {}
    for take, above in zip(found["take"].to_list(), probable, strict=True):
        if take != example and take in classes:
            seen.setdefault(take, above is True)
    right = np.array([classes[take] == classes[example] for take in seen], np.bool_)
    above = np.array(list(seen.values()), np.bool_)
    count = min(BEST, relevant)
    precisions = np.cumsum(right) / np.arange(1, len(right) + 1)
    return Judged(
        classes[example],
        float(right[:count].sum()) / count,
        float(precisions[right].sum()) / relevant,
        int(above.sum()),
        int((right & above).sum()),
        relevant,
    )


def judge(store: kinedex.Store, search: Search, where: str, every: int) -> Iterator[Judged]:
    """Yield the judgement of every search."""
    clips = store.takes("class IS NOT NULL")
    classes = dict(zip(clips["name"].to_list(), clips["class"].to_list(), strict=True))
    counts = Counter(classes.values())
    asked = store.takes(f"class IS NOT NULL AND ({where})")["name"].to_list()
    for example in [one for one in asked if counts[classes[one]] >= LEAST][::every]:
        yield judged(search(store, example), example, classes, counts[classes[example]] - 1)


def line(name: str, found: Sequence[Judged]) -> str:
    """Return the row of a table for the judgements of one kind of search."""
    of = defaultdict(list)
    for one in found:
        of[one.label].append(one.precision)
    least = min(of, key=lambda label: float(np.mean(of[label])))
    above, right, relevant = (sum(column) for column in zip(*(one[3:] for one in found), strict=True))
    divided = f"{right / above:.2f} | {right / relevant:.2f}" if above else "| "
    mean = np.mean([one.precision for one in found])
    average = np.mean([one.average_precision for one in found])
    return f"| {name} | {mean:.3f} | {np.mean(of[least]):.2f} ({least}) | {average:.3f} | {divided} |"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the study; see the module docstring."""
    parser = argparse.ArgumentParser(prog="python -m studies.retrieval", description=__doc__.partition("\n")[0])
    parser.add_argument("stores", type=Path, nargs="+")
    parser.add_argument("--where", default="true", help="a SQL filter over takes: those that are examples")
    parser.add_argument("--every", type=int, default=1, help="of these takes, every how manyth is an example")
    asked = parser.parse_args(arguments)
    for path in asked.stores:
        with kinedex.open_store(path) as store:
            print(f"{path.name}")
            print("| search | P@10 | least of a class | mAP | right above the line | of all right |")
            print("|---|--:|--:|--:|--:|--:|")
            for name, search in SEARCHES.items():
                found = list(judge(store, search, asked.where, asked.every))
                if not found:
                    parser.error(f"{path}: no class with {LEAST} takes or more has an example among the chosen takes")
                print(line(name, found), flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
