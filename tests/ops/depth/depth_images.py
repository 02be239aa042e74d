"""Depth images for tests: random ones with holes, steps and ties, a plus of lines, and the given recordings."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml
from PIL import Image

from kinedex.ops.depth.points import FrameCloud, Preparation, ray_table

RECORDINGS = {"kick": "kickLFront1Reps_tof", "squat": "squat1Reps_tof", "throw": "throwBasketball_structured"}
ENDS = ("lfingers", "rfingers", "ltoes", "rtoes", "headtop")


class Filmed(NamedTuple):
    """A given recording: the way from its images to points, the images, and the five ends in each of them."""

    preparation: Preparation
    images: list[np.ndarray]
    ends: np.ndarray


def random_image(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Draw a depth image of a few patches, in steps that make ties likely, and the rays of its pixels."""
    random = np.random.default_rng(seed)
    height, width = random.integers(4, 34, 2)
    image = np.zeros((height, width))
    for _ in range(random.integers(1, 7)):
        (top, bottom), (left, right) = (
            np.sort(random.integers(0, height + 1, 2)),
            np.sort(random.integers(0, width + 1, 2)),
        )
        rows, columns = np.mgrid[top:bottom, left:right]
        slopes = random.integers(-2, 3, 2) * 10
        image[top:bottom, left:right] = random.integers(10, 19) * 100 + slopes[0] * rows + slopes[1] * columns
    image += (image > 0) * random.integers(-1, 2, image.shape) * random.choice([0, 1, 20, 50])
    image[random.random(image.shape) < random.choice([0.0, 0.02, 0.2])] = 0
    matrix = [[40.0, 0, (width - 1) / 2], [0, 40.0, (height - 1) / 2], [0, 0, 1]]
    return (image * 0.001).astype(np.float32), ray_table(matrix, (), (int(width), int(height)))


def random_cloud(seed: int) -> FrameCloud:
    """Return the points of a random image without background."""
    image, rays = random_image(seed)
    return Preparation(rays).prepare(image)


def lattice_cloud(seed: int) -> FrameCloud:
    """Draw pixels at one depth, many missing and not cleaned: thin lines, rings, and components at equal gaps."""
    random = np.random.default_rng(seed)
    height, width = random.integers(3, 40, 2)
    return flat_cloud(random.random((height, width)) < random.choice([0.3, 0.45, 0.7]))


def plus_cloud() -> FrameCloud:
    """Return the points of a plus of one-pixel lines, 2 m away."""
    mask = np.zeros((70, 75), bool)
    mask[40, 20:71] = mask[30:66, 40] = True
    return flat_cloud(mask)


def flat_cloud(mask: np.ndarray) -> FrameCloud:
    """Return the points of pixels at a depth of 2 m; the focal length is 200 pixels, the centre is (40, 40)."""
    rows, columns = np.nonzero(mask)
    numbers = np.full(mask.shape, -1, np.int32)
    numbers[rows, columns] = np.arange(len(rows))
    points = np.stack([(columns - 40) / 100, (40 - rows) / 100, np.full(len(rows), -2.0)], axis=1)
    box = (int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1) if len(rows) else (0,) * 4
    pixels = np.stack([columns, rows], axis=1).astype(np.int32)
    return FrameCloud(points, pixels, numbers, np.where(mask, 2.0, 0.0).astype(np.float32), box, len(rows))


def read_image(path: Path, unit: float) -> np.ndarray:
    """Read a PNG of depths."""
    return (np.asarray(Image.open(path)) * unit).astype(np.float32)


def filmed(shared: Path, name: str, frames: list[int] | None = None) -> Filmed:
    """Read a given recording, or some of its frames."""
    folder = shared / "data" / "depth" / "simulated" / RECORDINGS[name]
    camera = yaml.safe_load((folder / "camera.yaml").read_text())
    unit, rotation = camera["depth_unit_m"], np.array(camera["pose"]["rotation"])
    truth = np.genfromtxt(folder / "ground_truth.csv", delimiter=",", names=True)
    world = np.stack([np.stack([truth[f"{end}_{axis}"] for axis in "xyz"], axis=1) for end in ENDS], axis=1)
    ends = (world - camera["pose"]["place"]) @ rotation.T * (1, -1, -1)
    paths = sorted((folder / "depth").glob("*.png"))
    images = [read_image(paths[k], unit) for k in (range(len(paths)) if frames is None else frames)]
    return Filmed(Preparation(camera_rays(camera), read_image(folder / "background.png", unit)), images, ends)


def camera_rays(camera: dict[str, float], stride: int = 1) -> np.ndarray:
    """Return the rays of a camera without distortion."""
    matrix = [[camera["fx"], 0, camera["cx"]], [0, camera["fy"], camera["cy"]], [0, 0, 1]]
    return ray_table(matrix, (), (int(camera["width"]), int(camera["height"])), stride)


def kinect_frames(shared: Path, stride: int) -> Iterator[tuple[FrameCloud, np.ndarray, np.ndarray]]:
    """Yield the points of each labelled frame of a real Kinect, and the labelled places of both hands and the head."""
    folder = shared / "data" / "depth" / "kinect_upper"
    camera = yaml.safe_load((folder / "camera.yaml").read_text())
    rays, preparation = camera_rays(camera), Preparation(camera_rays(camera, stride), stride=stride)
    with (folder / "labels.csv").open(newline="") as file:
        labels = list(csv.DictReader(file))
    for name in dict.fromkeys(row["file"] for row in labels):
        image, parts = read_image(folder / name, camera["depth_unit_m"]), {"hand": [], "head": []}
        for row in (row for row in labels if row["file"] == name):
            u, v = int(row["u"]), int(row["v"])
            parts[row["part"]].append(float(image[v, u]) * np.array([rays[v, u, 0], -rays[v, u, 1], -1]))
        yield preparation.prepare(image), np.array(parts["hand"]), np.array(parts["head"])
