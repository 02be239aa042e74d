"""Geodesic extrema: the worked example, the search that starts anew, and frames of the given recordings."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.depth.extrema import TIP_M, extrema_buffers, find_source, geodesic_extrema, tips_first
from kinedex.ops.depth.graph import build_graph
from kinedex.ops.depth.points import FrameCloud
from kinedex.ops.errors import ParameterError
from tests.ops.depth.depth_images import filmed, kinect_frames, lattice_cloud, plus_cloud, random_cloud
from tests.ops.depth.test_graph import neighbours
from tests.oracles import depth_points as oracle


def test_the_worked_example() -> None:
    cloud = plus_cloud()
    graph = build_graph(cloud)
    assert len(cloud.points) == graph.body.sum() == 86
    found = geodesic_extrema(graph, int(cloud.numbers[40, 40]), 7)
    assert cloud.pixels[found.nodes[:5]].tolist() == [[70, 40], [40, 65], [20, 40], [55, 40], [40, 52]]
    np.testing.assert_allclose(found.distances, [0.30, 0.25, 0.20, 0.15, 0.12, 0.10, 0.10], atol=1e-12)
    assert found.visited[:5].tolist() == [86, 15, 13, 10, 15]


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32 - 1), on_lattice=st.booleans())
def test_extrema_are_those_of_searches_that_start_anew(seed: int, on_lattice: bool) -> None:
    cloud = lattice_cloud(seed) if on_lattice else random_cloud(seed)
    graph = build_graph(cloud, 0.012 if on_lattice else 0.06)
    source = find_source(cloud, graph)
    if not graph.body.any():
        assert source == -1
        return
    found = geodesic_extrema(graph, source)
    nodes, distances, nearer = oracle.restarted_extrema(neighbours(graph), source, 20)
    assert found.nodes.tolist() == nodes
    assert found.distances.tolist() == distances
    assert found.visited.tolist() == nearer
    assert graph.body[found.nodes].all()


def test_the_source_is_the_lowest_node_of_those_nearest_to_the_lowered_mean() -> None:
    for seed in range(30):
        cloud = lattice_cloud(seed)
        graph = build_graph(cloud, 0.012)
        for drop in (0.0, 0.05):
            if graph.body.any():
                mean = cloud.points.mean(axis=0) - (0, drop, 0)
                apart = np.linalg.norm(cloud.points - mean, axis=1)[graph.body]
                assert np.isclose(apart.min(), np.linalg.norm(cloud.points[find_source(cloud, graph, drop)] - mean))


def test_a_small_body_has_fewer_extrema() -> None:
    cloud = plus_cloud()
    graph = build_graph(cloud)
    found = geodesic_extrema(graph, find_source(cloud, graph), 10_000)
    assert len(found.nodes) == len(set(found.nodes.tolist())) == graph.body.sum() - 1


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), on_lattice=st.booleans())
def test_tips_come_first(seed: int, on_lattice: bool) -> None:
    cloud = lattice_cloud(seed) if on_lattice else random_cloud(seed)
    graph = build_graph(cloud, 0.012 if on_lattice else 0.06)
    source = find_source(cloud, graph)
    if source < 0:
        return
    buffers, around = extrema_buffers(2000), neighbours(graph)
    found = geodesic_extrema(graph, source, buffers=buffers)
    from_source = oracle.shortest(around, [source])
    tips = [oracle.is_tip(cloud.points, around, node, from_source, TIP_M) for node in found.nodes.tolist()]
    order = sorted(range(len(tips)), key=lambda k: not tips[k])
    ordered = tips_first(cloud, graph, found, buffers)
    for before, after in zip(found, ordered, strict=True):
        assert after.tolist() == before[order].tolist()


def test_a_source_that_is_no_node_is_refused() -> None:
    with pytest.raises(ParameterError, match=r"source must be a node from 0 to 85, got -1"):
        geodesic_extrema(build_graph(plus_cloud()), -1)


FIGURES = {
    "kick": (
        (4525, 3935, 1, 0, 3879, (160, 169)),
        (3879, 289, 265, 1076, 248),
        {(197, 168): 1.035, (169, 224): 1.022, (159, 92): 0.991, (146, 238): 0.989, (132, 157): 0.911},
    ),
    "squat": (
        (3913, 3433, 3, 2, 3359, (162, 215)),
        (3359, 215, 276, 278, 788),
        {(135, 211): 1.120, (187, 224): 1.093, (200, 243): 0.880, (166, 156): 0.864, (118, 243): 0.816},
    ),
    "throw": (
        (10145, 3384, 2, 1, 3375, (155, 149)),
        (3375, 233, 348, 429, 245),
        {(146, 78): 1.326, (159, 81): 1.238, (155, 73): 1.144, (171, 220): 1.116, (147, 212): 1.057},
    ),
}


@pytest.mark.shared
@pytest.mark.parametrize("name", FIGURES)
def test_the_figures_of_a_given_frame(shared: Path, name: str) -> None:
    (foreground, points, components, links, body, source), visited, extrema = FIGURES[name]
    recording = filmed(shared, name, [20])
    cloud = recording.preparation.prepare(recording.images[0])
    graph = build_graph(cloud)
    node = find_source(cloud, graph)
    found = geodesic_extrema(graph, node, 5)
    assert (cloud.foreground, len(cloud.points), graph.components, graph.links) == (
        foreground,
        points,
        components,
        links,
    )
    assert (graph.body.sum(), tuple(cloud.pixels[node])) == (body, source)
    assert tuple(found.visited) == visited
    pixels = [tuple(pixel) for pixel in cloud.pixels[found.nodes].tolist()]
    assert dict(zip(pixels, found.distances.round(3).tolist(), strict=True)) == extrema
    assert geodesic_extrema(graph, node).nodes.tolist() == oracle.restarted_extrema(neighbours(graph), node, 20)[0]


def finds_all_ends(cloud: FrameCloud, ends: np.ndarray, drop: float, tips: bool = False) -> bool:
    """Return True where each of the five ends has one of the first five extrema within 0.2 m, one to one."""
    graph, buffers = build_graph(cloud), extrema_buffers(len(cloud.points))
    found = geodesic_extrema(graph, find_source(cloud, graph, drop), 20, buffers)
    nodes = (tips_first(cloud, graph, found, buffers) if tips else found).nodes[:5]
    close = np.linalg.norm(cloud.points[nodes][:, None] - ends, axis=2) <= 0.2
    return any(close[list(order), range(5)].all() for order in permutations(range(len(close)), 5))


@pytest.mark.shared
@pytest.mark.parametrize(("name", "shares"), [("kick", [84, 81, 84]), ("squat", [83, 64, 85]), ("throw", [90, 87, 88])])
def test_the_share_of_frames_in_which_all_ends_are_found(shared: Path, name: str, shares: list[int]) -> None:
    """From 0.2 m below the mean, from the mean as printed, and with tips first."""
    recording = filmed(shared, name)
    found = [
        [finds_all_ends(recording.preparation.prepare(image), ends, *way) for way in ((0.2,), (0.0,), (0.2, True))]
        for image, ends in zip(recording.images, recording.ends, strict=True)
    ]
    assert (100 * np.mean(found, axis=0)).round().tolist() == shares


@pytest.mark.shared
def test_hands_and_heads_of_a_real_camera_are_found(shared: Path) -> None:
    heads = []
    for cloud, hands, head in kinect_frames(shared, 2):
        graph = build_graph(cloud, 0.04)
        found = cloud.points[geodesic_extrema(graph, find_source(cloud, graph, 0.0), 7).nodes]
        to_hands, to_head = (np.linalg.norm(found[:, None] - positions, axis=2) for positions in (hands, head))
        assert (to_hands[:3].min(axis=0) < 0.10).all()
        heads.append(int(np.flatnonzero(to_head[:, 0] < 0.10)[0]) + 1)
    assert len(heads) == 9
    assert sum(rank <= 5 for rank in heads) == 7
    assert max(heads) <= 7
