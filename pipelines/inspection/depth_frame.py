"""Inspect one frame of a depth camera: its foreground points, their graph, and geodesic extrema."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinedex.catalog.depth_cameras import DepthCamera, Placement, placement_of
from kinedex.ops.arrays import F32
from kinedex.ops.depth.extrema import Extrema, extrema_buffers, find_source, geodesic_extrema, tips_first
from kinedex.ops.depth.graph import PointGraph, build_graph
from kinedex.ops.depth.points import FrameCloud, choose_stride
from kinedex.ops.depth.tracker import MIN_POINTS
from kinedex.ops.wording import counted
from kinedex.pipelines.inspection.motion_file import Inspection
from kinedex.pipelines.reconstruction.recording_tracks import make_scene
from kinedex.storage.formats.depth.camera_file import read_camera
from kinedex.storage.formats.depth.frames import read_frame


@dataclass(frozen=True, eq=False)
class InspectedFrame:
    """A depth frame with the results of its analysis.

    Attributes
    ----------
    camera : DepthCamera
        The camera.
    image : float32 array (H, W)
        Depths in metres.
    stride : int
        Step between the rows and columns whose pixels are used.
    placement : Placement
        The position and orientation of the camera.
    cloud : FrameCloud
        The points of the foreground.
    graph : PointGraph
        The graph of the points.
    source : int
        The index of the point from which extrema are computed; −1 without a body.
    extrema : Extrema or None
        The geodesic extrema, tips of limbs first; None without a body.
    """

    camera: DepthCamera
    image: F32
    stride: int
    placement: Placement
    cloud: FrameCloud
    graph: PointGraph
    source: int
    extrema: Extrema | None


def inspect_depth_frame(
    file: Path, camera_file: Path, background: Path | None = None, stride: int | None = None
) -> InspectedFrame:
    """Analyse a frame of a depth camera in the same way as the tracker.

    Parameters
    ----------
    file : Path
        A depth image or a point cloud.
    camera_file : Path
        The file that describes the camera.
    background : Path, optional
        A frame of the empty room; by default all measured pixels are foreground.
    stride : int, optional
        Step between the rows and columns whose pixels are used; by default the smallest with at most 6,000 points.

    Raises
    ------
    KinedexError
        A file cannot be read, or is of another camera.
    """
    camera = read_camera(camera_file)
    image = read_frame(file, camera)
    room = None if background is None else read_frame(background, camera)
    placement = placement_of(camera, room)
    stride = stride or choose_stride(
        [image], camera.matrix, camera.distortion, room, placement.turn, placement.floor_height
    )
    scene = make_scene(camera, room, placement, stride)
    cloud = scene.preparation.prepare(image)
    graph = build_graph(cloud)
    source = find_source(cloud, graph) if len(cloud.points) else -1
    extrema = None
    if source >= 0:
        space = extrema_buffers(len(cloud.points))
        extrema = tips_first(cloud, graph, geodesic_extrema(graph, source, buffers=space), space)
    return InspectedFrame(camera, image, stride, placement, cloud, graph, source, extrema)


def frame_facts(found: InspectedFrame) -> Inspection:
    """Return the facts about a frame."""
    facts, image, cloud = Inspection(), found.image, found.cloud
    seen = image[image > 0]
    width, height = found.camera.size
    facts.add("image", f"{width} × {height} pixels, {len(seen) / image.size:.0%} of them measured")
    if len(seen):
        facts.add("depths", f"{seen.min():.2f} to {seen.max():.2f} m, {np.median(seen):.2f} m in the median")
    facts.add_all("camera", found.placement.notes or ("its file states where it stands",))
    points = counted(len(cloud.points), "point")
    few = f"; fewer than {MIN_POINTS}: nobody" if len(cloud.points) < MIN_POINTS else ""
    facts.add("foreground", f"{points}, every {found.stride}. row and column{few}")
    links = counted(found.graph.links, "link")
    body = counted(int(found.graph.body.sum()), "point")
    facts.add("graph", f"{counted(found.graph.components, 'component')}, {links}; the body has {body}")
    if found.extrema is not None:
        texts = []
        for number, (node, away) in enumerate(zip(found.extrema.nodes, found.extrema.distances, strict=True), 1):
            u, v = (cloud.pixels[node] * found.stride).tolist()
            x, y, z = cloud.points[node].tolist()
            texts.append(f"{number}: pixel ({u}, {v}), at {x:.2f} {y:.2f} {z:.2f} m, {away:.2f} m along the body")
        facts.add_all("extrema", texts)
    return facts
