"""The graph of a frame's points: edges, components and links as searches over all pairs find them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinedex.ops.depth.graph import PointGraph, build_graph, edge_threshold, graph_buffers
from kinedex.ops.depth.points import FrameCloud
from tests.ops.depth.depth_images import flat_cloud, lattice_cloud, random_cloud
from tests.oracles import depth_points as oracle


def neighbours(graph: PointGraph) -> list[dict[int, float]]:
    return [
        dict(zip(graph.neighbours[a:b].tolist(), graph.lengths[a:b].tolist(), strict=True))
        for a, b in zip(graph.starts[:-1], graph.starts[1:], strict=True)
    ]


def assert_graph(cloud: FrameCloud, graph: PointGraph, threshold: float) -> None:
    expected = oracle.edges(cloud.points, cloud.numbers, threshold)
    parts = oracle.components(expected)
    body, links = oracle.links(cloud.points, parts)
    for i, j in links:
        expected[i][j] = expected[j][i] = oracle.distance(cloud.points[i], cloud.points[j])
    assert neighbours(graph) == expected
    assert graph.components == len(parts)
    assert graph.links == len(links)
    assert set(np.flatnonzero(graph.body).tolist()) == body
    for number, part in enumerate(parts):
        assert np.flatnonzero(graph.labels == number).tolist() == part


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1), threshold=st.sampled_from([0.03, 0.06]))
def test_the_graph_of_a_random_image_is_that_of_all_pairs(seed: int, threshold: float) -> None:
    cloud = random_cloud(seed)
    assert_graph(cloud, build_graph(cloud, threshold), threshold)


@settings(max_examples=30)
@given(seed=st.integers(0, 2**32 - 1))
def test_equally_close_pairs_and_components_go_to_the_lowest_nodes(seed: int) -> None:
    """Points on a lattice: gaps between components are equal in many places."""
    cloud = lattice_cloud(seed)
    assert_graph(cloud, build_graph(cloud, 0.012), 0.012)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**32 - 1))
def test_room_of_other_frames_leaves_nothing_behind(seed: int) -> None:
    buffers, last = graph_buffers(2000), random_cloud(seed)
    build_graph(random_cloud(seed + 1), 0.06, buffers)
    build_graph(lattice_cloud(seed), 0.012, buffers)
    assert_graph(last, build_graph(last, 0.06, buffers), 0.06)


def test_the_largest_component_is_the_body_and_far_ones_are_not() -> None:
    mask = np.zeros((20, 200), bool)
    mask[2:8, 2:8] = mask[2:8, 20:28] = mask[2:8, 110:117] = mask[15, 0:11] = True
    graph = build_graph(flat_cloud(mask), 0.06)
    assert (graph.components, graph.links) == (3, 1)  # the line of 11 pixels is too small, the last patch too far
    assert graph.body.sum() == 36 + 48


def test_few_points_far_apart_in_a_wide_image_are_sorted() -> None:
    """There are more columns of tiles than points."""
    mask = np.zeros((4, 1200), bool)
    mask[:, 2:6] = mask[:, 40:44] = mask[:, 1190:1194] = True
    cloud = flat_cloud(mask)
    assert_graph(cloud, build_graph(cloud), 0.06)


def stepped_cloud(step_mm: int, seed: int) -> FrameCloud:
    """Points whose depths are whole steps of a sensor."""
    cloud = flat_cloud(np.ones((30, 40), bool))
    steps = np.random.default_rng(seed).integers(0, 4, cloud.depth.shape)
    return cloud._replace(depth=(2.0 + 0.001 * step_mm * steps).astype(np.float32))


@pytest.mark.parametrize(("step_mm", "expected"), [(0, 0.043), (3, 0.0451), (10, 0.05), (26, 0.06), (90, 0.06)])
def test_the_threshold_grows_with_the_step_of_the_sensor(step_mm: int, expected: float) -> None:
    assert np.isclose(edge_threshold(stepped_cloud(step_mm, 1)), expected)


@pytest.mark.parametrize("size", [0, 1])
def test_no_points_have_no_body(size: int) -> None:
    graph = build_graph(flat_cloud(np.ones((size, size), bool)))
    assert (len(graph.starts), graph.components, graph.links, graph.body.sum()) == (size + 1, 0, 0, 0)
