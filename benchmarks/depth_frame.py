"""Time depth frames: parts of a frame, and the whole, beside one plain pass of Dijkstra's algorithm on the same graphs.

The frames are those of a simulated time-of-flight camera, one after the other: kernels that see the same frame again
and again are faster than they ever are in use, because the processor learns their branches.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import njit

from benchmarks.harness import Figure, sized
from kinedex.catalog.bodies import load_body
from kinedex.catalog.filmed_bodies import load_filmed_body
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.depth.extrema import (
    COUNT,
    Extrema,
    ExtremaBuffers,
    extrema_buffers,
    find_source,
    geodesic_extrema,
    tips_first,
)
from kinedex.ops.depth.facing_direction import point_centre
from kinedex.ops.depth.graph import PointGraph, build_graph, graph_buffers
from kinedex.ops.depth.image_search import depth_view
from kinedex.ops.depth.nearest_pixels import nearest_pixels
from kinedex.ops.depth.points import FrameCloud, Preparation, ray_table
from kinedex.ops.depth.thinned_poses import bone_directions, bone_lengths_of, thin_poses
from kinedex.ops.depth.tracker import Reconstructor
from kinedex.ops.simulation.depth_sensors import SENSORS, UNIT_M
from kinedex.pipelines.simulation.simulated_depth import film_take
from kinedex.storage.snapshot.parts import joint_positions
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]
F32 = npt.NDArray[np.float32]
I32 = npt.NDArray[np.int32]

FRAMES, RUNS = sized((40, 15), (4, 1))
FRAME_PASSES, RESTARTED_SHARE = 10, 8
"""A whole frame is to take as many plain passes at most, and all extrema a part of searches that start anew."""


class Recording(NamedTuple):
    """Frames of a simulated camera, and what is made of them once."""

    preparation: Preparation
    tracker: Reconstructor
    images: list[F32]
    clouds: list[FrameCloud]
    graphs: list[PointGraph]
    extrema: list[Extrema]
    sources: list[int]


def figures(store: Store) -> list[Figure]:
    """Time the plain pass, the extrema, the parts of the preparation, and the whole frame."""
    made = recording(store)
    points = round(np.mean([len(cloud.points) for cloud in made.clouds]))
    plain = mean_of_best(made, lambda k: plain_pass(made, k, 1))
    library, reason = _scipy(made)
    anew = mean_of_best(made, lambda k: [plain_pass(made, k, count) for count in range(1, COUNT + 1)], 3)
    buffers = extrema_buffers(max(len(cloud.points) for cloud in made.clouds))
    twenty = mean_of_best(made, lambda k: _ordered_extrema(made, k, buffers))
    first = mean_of_best(made, lambda k: geodesic_extrema(made.graphs[k], made.sources[k], 1, buffers))
    one = f"a plain pass over {points:,} points"
    return [
        _figure("plain pass of Dijkstra's algorithm", plain, reason or "scipy's", library),
        _figure("first geodesic extremum", first, one, plain),
        _figure(f"{COUNT} extrema", twenty, f"1/{RESTARTED_SHARE} of searches that start anew", anew / RESTARTED_SHARE),
        *(_figure(name, mean_of_best(made, work), one, plain) for name, work in _parts(made).items()),
        _figure("whole frame, forward", _whole(made), f"{FRAME_PASSES} plain passes", FRAME_PASSES * plain),
    ]


def _figure(name: str, spent: float, other: str, other_spent: float | None) -> Figure:
    return Figure(f"depth: {name}", 1, "frames", spent, other, other_spent)


def mean_of_best(made: Recording, work: Callable[[int], object], runs: int = RUNS) -> float:
    """Return the mean over the frames of the best time that work takes for each; the runs go through all frames."""
    times = np.full((runs + 1, len(made.images)), np.inf)
    for run in range(runs + 1):
        for k in range(len(made.images)):
            begin = time.perf_counter()
            work(k)
            times[run, k] = time.perf_counter() - begin
    return float(times[1:].min(axis=0).mean())  # the first run compiles


def recording(store: Store) -> Recording:
    """Film the first frames of the longest take, with a pose database of the others."""
    takes = store.takes().sort("frames", "name", descending=[True, False])["name"].to_list()
    poses = {take: _poses(store, take) for take in takes[:20]}
    bones, sensor = bone_lengths_of(poses[takes[0]]), SENSORS["tof"]
    filmed = film_take(sensor, load_filmed_body("first"), poses[takes[0]][:FRAMES], bones, 0.0, [1])
    background = filmed.scene.background() * np.float32(UNIT_M)
    images = [filmed.scene.frame(k) * np.float32(UNIT_M) for k in range(FRAMES)]
    preparation = Preparation(ray_table(sensor.matrix, (), sensor.size), background)
    directions = np.concatenate([bone_directions(poses[take]) for take in takes[1:20]])
    kept = np.ascontiguousarray(directions[thin_poses(directions, bones).rows])
    tracker = Reconstructor(load_body(), bones, kept, preparation, depth_view(sensor.matrix))
    clouds = [_copied(preparation.prepare(image)) for image in images]
    graphs = [build_graph(cloud) for cloud in clouds]
    sources = [find_source(cloud, graph) for cloud, graph in zip(clouds, graphs, strict=True)]
    extrema = [geodesic_extrema(graph, source) for graph, source in zip(graphs, sources, strict=True)]
    return Recording(preparation, tracker, images, clouds, graphs, extrema, sources)


def _poses(store: Store, take: str) -> F64:
    table = store.frames(take).combine_chunks()
    return np.ascontiguousarray(joint_positions(table, JOINTS).transpose(2, 0, 1), np.float64)


def _copied(cloud: FrameCloud) -> FrameCloud:
    arrays = {name: getattr(cloud, name).copy() for name in ("points", "pixels", "numbers", "depth")}
    return cloud._replace(**arrays)


def _parts(made: Recording) -> dict[str, Callable[[int], object]]:
    """Return the parts of a frame before its poses, by name."""
    buffers = graph_buffers(max(len(cloud.points) for cloud in made.clouds))
    return {
        "foreground and cleaning": lambda k: made.preparation.prepare(made.images[k]),
        "edges, components and links": lambda k: build_graph(made.clouds[k], buffers=buffers),
        "source": lambda k: find_source(made.clouds[k], made.graphs[k]),
        "centre of the points": lambda k: point_centre(made.clouds[k].points),
        "nearest pixels": lambda k: nearest_pixels(made.clouds[k].numbers, made.clouds[k].box, made.clouds[k].buffers),
    }


def _ordered_extrema(made: Recording, k: int, buffers: ExtremaBuffers) -> Extrema:
    found = geodesic_extrema(made.graphs[k], made.sources[k], COUNT, buffers)
    return tips_first(made.clouds[k], made.graphs[k], found, buffers)


def _whole(made: Recording) -> float:
    """Return the seconds of a frame when the recording is tracked from its start."""

    def work(k: int) -> None:
        if k == 0:
            made.tracker.restart()
        made.tracker.step(made.images[k])

    return mean_of_best(made, work)


def plain_pass(made: Recording, k: int, count: int) -> int:
    """Run Dijkstra's algorithm on the graph of a frame, from its source and the first extrema; return visited nodes."""
    graph = made.graphs[k]
    sources = np.concatenate([[made.sources[k]], made.extrema[k].nodes[: count - 1]])
    buffers = np.empty(len(graph.lengths) + count)
    nodes = np.empty(len(buffers), np.int32)
    return int(
        dijkstra(graph.starts, graph.neighbours, graph.lengths, sources, np.empty(len(graph.body)), buffers, nodes)
    )


@njit(nogil=True)
def dijkstra(
    starts: I32, neighbours: I32, lengths: F64, sources: npt.NDArray[np.int64], reached: F64, keys: F64, heap: I32
) -> int:
    """Fill the distance of each node, with a binary heap and lazy deletion, and return the number of visited nodes."""
    reached[:] = np.inf
    size, visited = 0, 0
    for source in sources:
        reached[source] = 0.0
        keys[size], heap[size] = 0.0, source
        size += 1
    while size > 0:
        key, node = keys[0], heap[0]
        size -= 1
        last, moved, place = keys[size], heap[size], 0
        while 2 * place + 1 < size:
            below = 2 * place + 1
            if below + 1 < size and keys[below + 1] < keys[below]:
                below += 1
            if keys[below] >= last:
                break
            keys[place], heap[place] = keys[below], heap[below]
            place = below
        keys[place], heap[place] = last, moved
        if key > reached[node]:
            continue
        visited += 1
        for k in range(starts[node], starts[node + 1]):
            other, length = neighbours[k], key + lengths[k]
            if length < reached[other]:
                reached[other], place = length, size
                size += 1
                while place > 0 and keys[(place - 1) >> 1] > length:
                    keys[place], heap[place] = keys[(place - 1) >> 1], heap[(place - 1) >> 1]
                    place = (place - 1) >> 1
                keys[place], heap[place] = length, other
    return visited


def _scipy(made: Recording) -> tuple[float | None, str]:
    """Time scipy's pass, or return the reason why nothing was timed."""
    try:
        from scipy.sparse import csr_matrix
        from scipy.sparse.csgraph import dijkstra as shortest
    except ModuleNotFoundError:
        return None, "scipy's was not timed: it is not installed (make bench installs it)"
    matrices = [
        csr_matrix((graph.lengths, graph.neighbours, graph.starts), (len(graph.body), len(graph.body)))
        for graph in made.graphs
    ]
    return mean_of_best(made, lambda k: shortest(matrices[k], indices=made.sources[k])), ""
