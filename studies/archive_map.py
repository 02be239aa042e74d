"""`python -m studies.archive_map STORE [STORE ...]`: how well the map of an archive and its clusters show the classes.

Takes without a class are left out. Of each store the table has the share of the ten nearest other takes that have the
same class, by the 80 numbers of each take and on the map; how far neighbours on the map are neighbours by the numbers
(trustworthiness); and for ways of clustering the adjusted Rand index against the classes, the number of clusters, and
the share of takes in none. HDBSCAN finds the number of clusters itself. k-means and Ward are given it, or a rule
chooses the cut of Ward's tree: the greatest mean silhouette, or the greatest modularity of the graph of nearest
neighbours, where an edge weighs as much as the share of neighbours that its two ends have in common.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.sparse import coo_array, csr_array
from sklearn.cluster import HDBSCAN, AgglomerativeClustering, KMeans
from sklearn.manifold import trustworthiness
from sklearn.metrics import adjusted_rand_score, silhouette_score
from sklearn.neighbors import NearestNeighbors, kneighbors_graph
from threadpoolctl import threadpool_limits

from kinedex.ops.arrays import F64, I64
from kinedex.ops.maps.interval_numbers import interval_numbers, standardised
from kinedex.ops.maps.layout import MIN_POINTS, map_clusters, map_layout
from kinedex.pipelines.keyframes.slice_search import stored_words
from kinedex.reports.markdown import grid
from kinedex.storage.store.store import Store, open_store

NEIGHBOURS = 10
COUNTS = (10, 20, 30)
SIZES = (160, 80, 40)
MAX_CUT = 60
"""A rule chooses among at most so many clusters."""

GRAPHS = (10, 30)
"""Neighbours of a take in the graphs whose modularity is a rule."""


def labelled(store: Store) -> tuple[F64, list[str]]:
    """Return the standardised numbers of the takes that have a class, and their classes."""
    rows = store.take_rows.sort_by("take_id").select(["take_id", "class"]).to_pylist()
    chosen = [row for row in rows if row["class"] is not None]
    words = stored_words(store, [row["take_id"] for row in chosen])
    numbers = interval_numbers(words.words, words.offsets, len(store.feature_set.features), words.known)
    return standardised(numbers), [row["class"] for row in chosen]


def same_class(positions: F64, classes: Sequence[str]) -> float:
    """Return the fraction of the nearest other points that have the same class."""
    count = min(NEIGHBOURS, len(positions) - 1)
    near = NearestNeighbors(n_neighbors=count).fit(positions).kneighbors(return_distance=False)
    names = np.array(classes)
    return float((names[near] == names[:, None]).mean())


def clusterings(numbers: F64, positions: F64) -> Iterator[tuple[str, Sequence[int]]]:
    """Yield ways of clustering with the cluster of each take, −1 for none."""
    for share in SIZES:
        for method in ("eom", "leaf"):
            made = HDBSCAN(
                min_cluster_size=max(MIN_POINTS, len(positions) // share), cluster_selection_method=method, copy=True
            )
            yield f"HDBSCAN on the map, 1 in {share}, {method}", made.fit_predict(positions)
    made = HDBSCAN(min_cluster_size=max(MIN_POINTS, len(positions) // SIZES[0]), min_samples=1, copy=True)
    yield f"HDBSCAN on the map, 1 in {SIZES[0]}, one neighbour", made.fit_predict(positions)
    yield "HDBSCAN of the numbers", HDBSCAN(min_cluster_size=MIN_POINTS, copy=True).fit_predict(numbers)
    for count in COUNTS:
        yield f"k-means on the map, {count}", KMeans(count, n_init=4, random_state=0).fit_predict(positions)
        yield f"Ward on the map, {count}", AgglomerativeClustering(count).fit_predict(positions)
        yield f"Ward of the numbers, {count}", AgglomerativeClustering(count).fit_predict(numbers)
    for what, points in (("on the map", positions), ("of the numbers", numbers)):
        tree = linkage(points, "ward")
        cuts = [fcluster(tree, count, "maxclust") - 1 for count in range(2, min(MAX_CUT, len(points) // 4) + 1)]
        yield f"Ward {what}, silhouette", max(cuts, key=partial(silhouette_score, points))
        for count in GRAPHS:
            rule = partial(modularity, shared_neighbours(points, count))
            yield f"Ward {what}, modularity, {count} neighbours", max(cuts, key=rule)


def shared_neighbours(points: F64, count: int) -> coo_array:
    """Return the graph of nearest neighbours, each edge with the share of neighbours that its ends have in common."""
    near = csr_array(kneighbors_graph(points, min(count, len(points) - 1)))
    common = coo_array((near @ near.T) * near.maximum(near.T))
    sizes = near.sum(axis=1)
    union = sizes[common.coords[0]] + sizes[common.coords[1]] - common.data
    return coo_array((common.data / union, common.coords), shape=near.shape)


def modularity(graph: coo_array, clusters: I64) -> float:
    """Return how much more of the weight of a graph lies within clusters than if edges were drawn by degree alone.

    M. Newman, M. Girvan: Finding and evaluating community structure in networks (2004).
    """
    whole = graph.sum()
    inside = graph.data[clusters[graph.coords[0]] == clusters[graph.coords[1]]].sum()
    degrees = np.bincount(clusters, graph.sum(axis=1))
    return float(inside / whole - ((degrees / whole) ** 2).sum())


def tables(path: Path) -> str:
    """Return the tables of a store as Markdown."""
    numbers, classes = labelled(open_store(path))
    begun = time.process_time()
    layout = map_layout(numbers)
    positions, seconds = layout.positions.astype(np.float64), time.process_time() - begun
    facts = [
        f"{path.name}: {len(classes)} takes of {len(set(classes))} classes, laid out in {seconds:.0f} s of one core",
        f"same class among the ten nearest: {same_class(numbers, classes):.2f} by the numbers, "
        f"{same_class(positions, classes):.2f} on the map; trustworthiness {trustworthiness(numbers, positions):.3f}",
        "",
    ]
    found = [("as shown", map_clusters(layout)), *clusterings(numbers, positions)]
    rows = []
    for name, clusters in found:
        own = np.asarray(clusters)
        index = adjusted_rand_score(classes, own)
        rows.append([name, f"{index:.2f}", str(len(set(own[own >= 0].tolist()))), f"{(own < 0).mean():.2f}"])
    return "\n".join([*facts, *grid(["clusters", "adjusted Rand index", "clusters found", "in none"], rows), ""])


def main() -> None:
    """Print the tables of each store."""
    parser = argparse.ArgumentParser(prog="python -m studies.archive_map", description=__doc__)
    parser.add_argument("stores", type=Path, nargs="+")
    with threadpool_limits(1):
        for store in parser.parse_args().stores:
            print(tables(store), flush=True)


if __name__ == "__main__":
    main()
