"""Define the commands `simulate …`, which make recordings of takes with known ground truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated

import typer

from kinedex.commands.app import TRACK, command, group
from kinedex.commands.options import AtOption, JsonOption, StorePath, WhereOption, interval_of, open_for_reading
from kinedex.commands.output import print_json, print_message, print_path
from kinedex.ops.wording import counted

simulate = group("simulate", "Make recordings of takes, with their truth apart.", TRACK)


@command(of=simulate)
def cameras(
    store: StorePath,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="New folder of the recordings.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of cameras, errors and failures.")],
    takes: Annotated[list[str] | None, typer.Argument(metavar="[TAKE...]", help="Takes to film.")] = None,
    where: WhereOption = None,
    count: Annotated[int, typer.Option("--cameras", max=100, metavar="N", help="Number of cameras, 2 at least.")] = 4,
    keypoints: Annotated[
        str, typer.Option(metavar="SET", help="Keypoint set, as coco-17, body-25 or halpe-26; or a file.")
    ] = "coco-17-toes",
    form: Annotated[str, typer.Option("--format", help="Keypoints as parquet or openpose.")] = "parquet",
    silhouettes: Annotated[bool, typer.Option("--silhouettes", help="Write masks of the body, too.")] = False,
    noise: Annotated[float, typer.Option(min=0, metavar="PX", help="Noise of keypoints in pixels.")] = 4.0,
    failures: Annotated[float, typer.Option(min=0, max=100, metavar="RATE", help="Failures per second.")] = 0.67,
    long: Annotated[
        bool, typer.Option("--long", help="Let failures last 1.2 to 2.2 s instead of 0.4 to 1.2 s.")
    ] = False,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Film takes by simulated cameras.

    DIR/recordings.yaml names the recordings, as `kinedex track` reads them. DIR/truth has the true joints, and the
    failures of the detector. The same command makes the same bytes.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.ops.simulation.recording import LONG, CameraRing, Detector, FailureRate, Setup
    from kinedex.pipelines.simulation.simulated_cameras import RECORDINGS, CameraRequest, simulate_cameras

    rate = replace(LONG if long else FailureRate(), per_second=failures)
    setup = Setup(CameraRing(count), Detector(noise_px=noise), rate)
    request = CameraRequest(tuple(takes or ()), where, seed, setup, keypoints, form, silhouettes)
    made = simulate_cameras(open_for_reading(store, at), request, output, Terminal().progress)
    number = counted(len(made.recordings), "recording")
    line = f"{number} of {made.frames:,} frames with {counted(made.failures, 'failure')}, in {made.folder}"
    file = made.folder / RECORDINGS
    _report(asdict(made) | {"recordings_file": file}, [line], file, as_json)


@command(of=simulate)
def depth(
    store: StorePath,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="New folder of the recordings.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of the body's sizes and of all errors.")],
    takes: Annotated[list[str] | None, typer.Argument(metavar="[TAKE...]", help="Takes to film.")] = None,
    where: WhereOption = None,
    camera: Annotated[str, typer.Option(metavar="NAME", help="tof, tof_small or structured.")] = "tof",
    body: Annotated[str, typer.Option(metavar="NAME", help="first or second; or a file.")] = "first",
    azimuth: Annotated[
        float, typer.Option(min=-360, max=360, metavar="DEGREES", help="Film from the person's left by this angle.")
    ] = 0.0,
    frames: Annotated[
        str | None, typer.Option(metavar="A:B", help="Film frames A to B of each take, without B.")
    ] = None,
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Film takes by a simulated depth camera.

    DIR/recordings.yaml names the recordings, as `kinedex reconstruct` reads them: depth images, the background and
    the camera. DIR/truth has the true joints. The same command makes the same bytes.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.pipelines.simulation.simulated_depth import RECORDINGS, DepthRequest, simulate_depth

    interval = None if frames is None else interval_of(frames)
    request = DepthRequest(tuple(takes or ()), where, seed, camera, body, azimuth, interval)
    made = simulate_depth(open_for_reading(store, at), request, output, Terminal().progress)
    lines = [
        f"{name}: {counted(number, 'frame')} with a joint near the camera, or outside the image"
        for name, number in made.outside.items()
    ]
    lines.append(f"{counted(len(made.recordings), 'recording')} of {made.frames:,} frames, in {made.folder}")
    file = made.folder / RECORDINGS
    _report(asdict(made) | {"recordings_file": file}, lines, file, as_json)


@command(of=simulate)
def imu(
    store: StorePath,
    output: Annotated[Path, typer.Option("--output", "-o", metavar="DIR", help="New folder of the data set.")],
    seed: Annotated[int, typer.Option(min=0, help="Seed of mounts, headings, clocks and all errors.")],
    takes: Annotated[
        list[str] | None, typer.Argument(metavar="[TAKE...]", help="Takes whose actors wear them.")
    ] = None,
    where: WhereOption = None,
    limbs: Annotated[
        list[str] | None,
        typer.Option("--limb", metavar="LIMB", help="Limb or group with sensors, as lshank or hands; repeatable."),
    ] = None,
    grade: Annotated[
        str, typer.Option(metavar="NAME", help="perfect, good, cheap or a device, as mpu-9250; or a file.")
    ] = "good",
    rate: Annotated[float, typer.Option(min=1, max=10_000, metavar="HZ", help="Samples per second.")] = 100.0,
    form: Annotated[str, typer.Option("--format", help="parquet, npz or xsens-txt.")] = "parquet",
    window: Annotated[float, typer.Option(metavar="SECONDS", help="Length of the windows with labels.")] = 2.0,
    step: Annotated[float, typer.Option(metavar="SECONDS", help="Time from one window to the next.")] = 1.0,
    stand: Annotated[
        float,
        typer.Option(min=0, max=60, metavar="SECONDS", help="Rest in the first pose before, and in the last after."),
    ] = 0.0,
    mount: Annotated[
        str, typer.Option(help="random: another rotation for each actor and limb; limb: the axes of the limb.")
    ] = "random",
    at: AtOption = None,
    as_json: JsonOption = False,
) -> None:
    """Put simulated inertial sensors on the limbs of takes.

    The takes' sources are read again at their own rate. DIR/README.md describes all files, and has code that loads the
    windows: DIR/recordings has a folder for each take, DIR/windows.csv the class of each window, and DIR/truth mounts
    and clocks. Pieces of takes shorter than a window are excluded. The same command makes the same bytes.
    """
    from kinedex.console.terminal import Terminal
    from kinedex.ops.simulation.imu_sensors import WearOptions
    from kinedex.pipelines.simulation.imu_recordings import README, ImuRequest, Windowing, simulate_imu

    wearing = WearOptions(seed, rate, stand_s=stand, mount=mount)
    request = ImuRequest(tuple(limbs or ()), grade, wearing, form, Windowing(window, step))
    made = simulate_imu(open_for_reading(store, at), takes or (), where, request, output, Terminal().progress)
    line = f"{counted(len(made.recordings), 'take')}, {made.seconds:,.1f} s, {made.samples:,} samples, in {output}"
    _report(asdict(made) | {"folder": output}, [*made.remarks(), line], output / README, as_json)


def _report(document: Mapping[str, object], lines: Iterable[str], file: Path, as_json: bool) -> None:
    """Print a summary of the recordings as a JSON object, or as lines with the file to read first."""
    if as_json:
        print_json(document)
        return
    for line in lines:
        print_message(line)
    print_path(file)
