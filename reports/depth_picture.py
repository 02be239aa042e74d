"""Draw one frame of a depth camera, with its foreground, its graph and its geodesic extrema."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from kinedex.ops.arrays import U8
from kinedex.pipelines.inspection.depth_frame import InspectedFrame
from kinedex.reports.palette import CLASS_COLOURS
from kinedex.storage.durable_files import whole_file

MIN_WIDTH = 640
"""Minimum width of a picture in pixels; smaller images are enlarged by a whole factor."""

_TINT, _FAR_GREY = 0.65, 215


def frame_picture(found: InspectedFrame) -> U8:
    """Return an RGB image (H, W, 3) of a frame: depth in grey, tinted by component."""
    image = found.image
    grey = np.zeros(image.shape)
    seen = image > 0
    if seen.any():
        low, high = np.percentile(image[seen], [1, 99])
        share = np.clip((image - low) / max(float(high - low), 1e-6), 0.0, 1.0)
        grey[seen] = 255 - (255 - 40) * share[seen]
    picture = np.repeat(np.minimum(grey, _FAR_GREY)[..., None], 3, axis=2)
    labels = np.full(image.shape, -2)
    u, v = found.cloud.pixels.T * found.stride
    for down in range(found.stride):
        for across in range(found.stride):
            labels[np.minimum(v + down, image.shape[0] - 1), np.minimum(u + across, image.shape[1] - 1)] = (
                found.graph.labels
            )
    for label in np.unique(labels[labels >= -1]).tolist():
        colour = "#808080" if label < 0 else CLASS_COLOURS[label % len(CLASS_COLOURS)][1]
        tint = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)])
        own = labels == label
        picture[own] = (1 - _TINT) * picture[own] + _TINT * tint
    return picture.round().astype(np.uint8)


def write_frame_picture(found: InspectedFrame, path: Path) -> None:
    """Write the picture of a frame as PNG."""
    times = max(1, -(-MIN_WIDTH // found.camera.size[0]))
    picture = Image.fromarray(np.repeat(np.repeat(frame_picture(found), times, axis=0), times, axis=1))
    draw = ImageDraw.Draw(picture)

    def place(node: int) -> tuple[float, float]:
        u, v = found.cloud.pixels[node] * found.stride * times + times / 2
        return float(u), float(v)

    if found.extrema is not None:
        x, y = place(found.source)
        draw.line([(x - 6, y), (x + 6, y)], "white", 2)
        draw.line([(x, y - 6), (x, y + 6)], "white", 2)
        for number, node in enumerate(found.extrema.nodes.tolist(), 1):
            x, y = place(node)
            draw.ellipse([x - 4, y - 4, x + 4, y + 4], "#ffffff" if number <= 5 else None, "#000000", 1)
            draw.text((x + 6, y - 6), str(number), "#ffffff", stroke_width=1, stroke_fill="#000000")
    with whole_file(path) as unfinished:
        picture.save(unfinished, "PNG")
