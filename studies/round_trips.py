"""`python -m studies.round_trips [FILE …]`: write takes in every form of `kinedex export`, and read them again.

Without files, three synthetic motions of one actor are written as AMC at 120 Hz. Libraries of others read the files
where they are installed: ezc3d, py-c3d and pygltflib with `make setup`, polars and NumPy always.
"""

from __future__ import annotations

import argparse
import importlib.util
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
import polars as pl

import kinedex
from kinedex.library.take import Take
from kinedex.ops.errors import KinedexError
from kinedex.ops.synth.body import draw_actor
from kinedex.ops.synth.performance import perform_clip
from kinedex.ops.synth.solve import columns
from kinedex.pipelines.export.request import FILE_FORMATS
from kinedex.reports.markdown import grid
from kinedex.storage.formats.motion.acclaim_writer import Dialect, write_amc, write_asf
from kinedex.storage.formats.motion.channel_cuts import SourceCut
from kinedex.storage.formats.motion.joint_motion import JointMotion

F32 = npt.NDArray[np.float32]

SYNTHETIC = ("walk4StepsLstart", "cartwheelLeft", "kickRight1Reps")
"""The motions that are performed where no files are given."""

FILMS = ("gif", "mp4")
"""The forms that hold pictures."""


@dataclass(frozen=True)
class RoundTrip:
    """The result of one take in one form.

    Attributes
    ----------
    form : str
        The form, and what was written: joints or channels.
    frames : int
        Frames at the analysis rate.
    error_mm : float
        The largest distance of a joint; NaN where kinedex does not read the form.
    differ : int
        Frames whose words differ from those of the take.
    differ_at_rate : int
        Frames whose words differ from those of the same joints at the rate of the file.
    bytes : int
        The size of the files.
    others : dict of str to bool
        Library → whether it reads the numbers that were written.
    """

    form: str
    frames: int
    error_mm: float
    differ: int
    differ_at_rate: int
    bytes: int
    others: dict[str, bool]


def round_trips(source: Path, folder: Path) -> Iterator[RoundTrip]:
    """Write a take in every form that can express it, read the files, and compare them with it.

    Parameters
    ----------
    source : Path
        A motion file.
    folder : Path
        A folder to write to.
    """
    take = kinedex.read(source)
    motion = JointMotion(take.name, take.joints, take.positions, take.rate_hz, take.words(), take.orientation)
    joints = Take.from_positions(take.positions, take.rate_hz, orientation=take.orientation)
    for name, form in FILE_FORMATS.items():
        if name in FILMS:
            continue
        paths = [folder / f"{name}.{ending}" for ending in form.endings]
        if form.joints is not None:
            try:
                form.write_joints(paths[0], motion)
            except KinedexError as fault:
                print(f"{name}: {fault}")
            else:
                yield _compared(f"{name}, joints", take, joints, paths[:1])
        if form.channels is not None and take.info["format"] in form.sources:
            skeleton = take.info["skeleton_source"]
            frames, rate_hz = take.info["source_frames"], take.info["source_rate_hz"]
            form.cut_channels(paths, SourceCut(source, skeleton and Path(skeleton), None, 0, frames, rate_hz))
            yield _compared(f"{name}, channels", take, take, paths)


def _compared(called: str, take: Take, at_rate: Take, paths: Sequence[Path]) -> RoundTrip:
    size = sum(path.stat().st_size for path in paths)
    others = dict(_others(paths[0], take.positions))
    if paths[0].suffix == ".parquet":  # the form of the store itself: its numbers are compared by polars
        return RoundTrip(called, len(take), np.nan, 0, 0, size, others)
    again = kinedex.read(paths[0])
    apart = np.linalg.norm(again.positions - take.positions, axis=2)
    differ, differ_at_rate = (int(np.count_nonzero(again.words() != one.words())) for one in (take, at_rate))
    return RoundTrip(called, len(take), float(np.nanmax(apart)) * 1000, differ, differ_at_rate, size, others)


def _others(path: Path, positions: F32) -> Iterator[tuple[str, bool]]:
    """Yield the libraries that read a file, and whether they find the places."""
    ending = path.suffix
    if ending == ".csv":
        table = pl.read_csv(path).select(pl.exclude("frame", "time")).to_numpy()
        yield "polars", np.array_equal(table.astype(np.float32).reshape(positions.shape), positions, equal_nan=True)
    if ending == ".parquet":
        structs = pl.read_parquet(path).select(pl.selectors.struct()).drop("root_orientation")
        found = np.stack([structs[name].struct.unnest().to_numpy() for name in structs.columns], axis=1)
        yield "polars", np.array_equal(found, positions, equal_nan=True)
    if ending == ".npz":
        yield "NumPy", np.array_equal(np.load(path)["positions"], positions, equal_nan=True)
    if ending == ".c3d":
        yield from _c3d_libraries(path, positions)
    if ending == ".glb" and importlib.util.find_spec("pygltflib"):
        yield "pygltflib", _gltf_root(path, positions[:, 0])


def _c3d_libraries(path: Path, positions: F32) -> Iterator[tuple[str, bool]]:
    seen = np.isfinite(positions).all(axis=2)
    if importlib.util.find_spec("ezc3d"):
        import ezc3d

        points = ezc3d.c3d(str(path))["data"]["points"][:3].transpose(2, 1, 0) / 1000
        yield "ezc3d", np.allclose(points[seen], positions[seen], rtol=0, atol=1e-6)
    if importlib.util.find_spec("c3d"):
        import warnings

        import c3d

        with path.open("rb") as file, warnings.catch_warnings():
            warnings.simplefilter("ignore")  # there are no analog samples
            points = np.array([row[:, :3] for _, row, _ in c3d.Reader(file).read_frames()]) / 1000
        yield "py-c3d", np.allclose(points[seen], positions[seen], rtol=0, atol=1e-6)


def _gltf_root(path: Path, positions: F32) -> bool:
    """Return whether the library finds the places of the root."""
    import pygltflib

    document = pygltflib.GLTF2().load(str(path))
    clip = document.animations[0]
    channel = next(one for one in clip.channels if one.target.path == "translation" and one.target.node == 0)
    view = document.bufferViews[document.accessors[clip.samplers[channel.sampler].output].bufferView]
    data = document.binary_blob()[view.byteOffset : view.byteOffset + view.byteLength]
    return np.array_equal(np.frombuffer(data, "<f4").reshape(-1, 3), positions)


def synthetic(folder: Path) -> list[Path]:
    """Write the synthetic takes as AMC files with their skeleton."""
    actor = draw_actor(4, 9)
    write_asf(folder / "synthetic.asf", actor.body, "synthetic", Dialect())
    paths = []
    for name in SYNTHETIC:
        paths.append(folder / f"synthetic_{name}.amc")
        write_amc(paths[-1], columns(actor.body), perform_clip(actor, name, 0, 9).angles, Dialect())
    return paths


def table(found: Sequence[RoundTrip]) -> str:
    """Return the round trips of all takes as a Markdown table, a row for each form."""
    rows = []
    for form in dict.fromkeys(one.form for one in found):
        of = [one for one in found if one.form == form]
        frames = sum(one.frames for one in of)
        libraries = dict.fromkeys(name for one in of for name in one.others)
        wrong = [name for name in libraries if not all(one.others.get(name, True) for one in of)]
        reread = not np.isnan(of[0].error_mm)
        rows.append([
            form,
            f"{max(one.error_mm for one in of):.4f}" if reread else "–",
            f"{sum(one.differ for one in of)} of {frames}" if reread else "–",
            f"{sum(one.differ_at_rate for one in of)} of {frames}" if reread else "–",
            f"{sum(one.bytes for one in of) / frames:.0f}",
            ", ".join(f"{name} (other numbers)" if name in wrong else name for name in libraries) or "–",
        ])  # fmt: skip
    head = ["form", "largest error (mm)", "words that differ", "at the rate of the file", "bytes a frame", "read by"]
    return "\n".join(grid(head, rows))


def main() -> None:
    """Print the table of round trips."""
    parser = argparse.ArgumentParser(prog="python -m studies.round_trips", description=__doc__)
    parser.add_argument("files", type=Path, nargs="*", help="motion files; synthetic ones by default")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        sources = given.files or synthetic(folder)
        print(table([one for source in sources for one in round_trips(source, folder)]))


if __name__ == "__main__":
    main()
