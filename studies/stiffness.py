"""`python -m studies.stiffness QUERIES …`: print the histogram of stiffness in query files (Figures 3.9 and 4.4).

Figure 3.9 of the thesis shows queries that its authors wrote by hand, Figure 4.4 learned queries
(`kinedex keyframes export STORE -o learned.yaml`). A gap that is written as a range has the stiffness of Eq. 4.7.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Sequence

import numpy as np

from kinedex.catalog.features import load_feature_set
from kinedex.catalog.queries.keyframe_query import SAME_FRAME, KeyframeQuery
from kinedex.catalog.queries.query_reader import read_queries

BINS = 10


def stiffness_values(queries: Iterable[KeyframeQuery], *, same_frame: bool = True) -> list[float]:
    """Return the stiffness of every gap of every query, alternatives included.

    Parameters
    ----------
    queries : iterable of KeyframeQuery
        The queries.
    same_frame : bool
        Count gaps between the parts of one keyframe, whose stiffness is always 1, too.
    """
    gaps = [gap for query in queries for chain in query.chains for gap in chain.gaps]
    return [gap.nominal_stiffness for gap in gaps if same_frame or gap != SAME_FRAME]


def histogram(values: Sequence[float]) -> list[str]:
    """Return a Markdown table: so many values around 0, 0.1, …, 1, and their share."""
    counts = np.bincount(np.rint(np.array(values) * BINS).astype(int), minlength=BINS + 1)
    lines = ["| stiffness | gaps | share |", "|--:|--:|--:|"]
    return lines + [f"| {i / BINS:.1f} | {n} | {n / len(values):.1%} |" for i, n in enumerate(counts.tolist())]


def main() -> None:
    """Print the histogram, and the two shares that the thesis prints."""
    parser = argparse.ArgumentParser(prog="python -m studies.stiffness", description=__doc__)
    parser.add_argument("queries", nargs="+", help="query files, YAML or JSON")
    given = parser.parse_args()
    features = load_feature_set()
    queries = [query for file in given.queries for query in read_queries(file, features)]
    values = np.array(stiffness_values(queries))
    apart = np.array(stiffness_values(queries, same_frame=False))
    print(f"{len(queries)} queries, {len(values)} gaps\n")
    print("\n".join(histogram(values.tolist())))
    for name, chosen in (("all gaps", values), ("without parts of one keyframe", apart)):
        stiff = np.mean(chosen >= 0.85)
        print(f"\n{name}: {1 - stiff:.1%} are 0.8 or less, {stiff:.1%} are 0.9 or more")


if __name__ == "__main__":
    main()
