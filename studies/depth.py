"""`python -m studies.depth DATA`: print the errors of poses from a depth camera by each method, on set D of the design.

DATA is a folder with hdm05/clips, hdm05/takes and depth/simulated. Recordings are filmed at the first call, and kept in
build/studies/depth; --make-sets films them and ends. Actors dg and bk are for the choice of parameters, mm is the test.
One core takes half an hour; --workers spreads recordings over several.
"""

from __future__ import annotations

import argparse
import csv
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from kinedex.ops.body.joint_tree import JOINTS
from kinedex.reports.markdown import grid
from kinedex.storage.formats.depth.camera_file import read_camera
from studies.depth_rows import (
    BODY,
    DATABASE,
    DEFAULT,
    LOCAL,
    ONE,
    PRINTED,
    PRINTED_LOCAL,
    Tracked,
    both_ways,
    estimated_bones,
    tracked,
)
from studies.depth_set import (
    TEST_ACTOR,
    Archive,
    Film,
    Filmed,
    archive_of,
    choice_clips,
    film_set,
    held_out_clips,
    inside,
    own_bones,
    read_motions,
)

F64 = npt.NDArray[np.float64]
Tracks = dict[str, dict[str, Tracked]]
"""Method → recording → its track."""

FORWARD, BOTH = "combined, forward", "both ways"
METHODS = {"local only": LOCAL, "database only": DATABASE, "combined, one candidate": ONE, FORWARD: DEFAULT}
PRINTED_METHODS = {"local only": PRINTED_LOCAL, "combined, one candidate": PRINTED}
OFF_CM = 10.0
OWN, ESTIMATED, MEAN = "own bones", "estimated body", "mean bones at his height"
CAMERAS, AZIMUTHS = ("tof", "structured"), (45.0, -45.0, 60.0, -60.0, 90.0)
PROTOTYPE = {
    ("tof", OWN): ("10.1 / 7.3, 36 %", "15.4 / 6.8, 42 %", "4.1 / 2.4, 6 %", "3.5 / 2.4, 3 %", "2.8 / 1.9, 3 %"),
    ("tof", MEAN): ("10.8 / 7.6, 37 %", "16.4 / 7.0, 43 %", "4.7 / 3.3, 7 %", "3.8 / 2.9, 3 %", "3.3 / 2.6, 2 %"),
    ("structured", OWN): ("7.9 / 8.2, 29 %", "16.2 / 7.8, 45 %", "4.7 / 2.9, 9 %", "3.9 / 2.7, 6 %", "3.4 / 2.4, 3 %"),
    ("structured", MEAN): ("", "", "5.9 / 3.6, 15 %", "4.1 / 3.1, 5 %", "3.7 / 2.9, 2 %"),
}  # fmt: skip
"""The figures of the design's prototype on set D, in the order of `METHODS` and both ways."""
PROTOTYPE_PRINTED = ("19.0 / 16.1, 76 %", "", "9.4 / 6.8, 32 %", "", "")
AIMS = {("tof", OWN): 2.5, ("structured", OWN): 3.0, ("tof", ESTIMATED): 3.0, ("structured", ESTIMATED): 3.5}


@dataclass(frozen=True)
class Study:
    """A study holds what each of its tables needs.

    Attributes
    ----------
    film : callable
        Returns the recordings of the actor that are filmed in a way.
    archive : Archive
        The pose database.
    bones : float64 array (24,)
        The actor's own bones in metres.
    run : callable
        Like `map`, over one process or several.
    """

    film: Callable[[Film], list[Filmed]]
    archive: Archive
    bones: F64
    run: Callable[..., list[object]]


def bones_of(study: Study, recordings: Sequence[Filmed], kind: str) -> list[F64]:
    """Return the bone lengths that each recording is tracked with."""
    if kind == ESTIMATED:
        found = study.run(partial(estimated_bones, archive=study.archive), recordings)
        return [np.asarray(one) for one in found]
    lengths = study.bones
    if kind == MEAN:
        mean = study.archive.mean_bones
        lengths = mean * (BODY.standing_height(lengths) / BODY.standing_height(mean))
    return [lengths] * len(recordings)


def tracks_of(study: Study, recordings: Sequence[Filmed], bones: Sequence[F64], methods: Sequence[str]) -> Tracks:
    """Return the tracks of all recordings by some of `METHODS`, and both ways where asked."""
    jobs = [(one, study.archive, lengths, tuple(methods)) for one, lengths in zip(recordings, bones, strict=True)]
    found: Tracks = {name: {} for name in methods}
    for one, tracks in zip(recordings, study.run(_all_methods, jobs), strict=True):
        assert isinstance(tracks, dict)
        for name in methods:
            found[name][one.name] = tracks[name]
    return found


def _all_methods(job: tuple[Filmed, Archive, F64, tuple[str, ...]]) -> dict[str, Tracked]:
    one, archive, bones, methods = job
    wanted = [name for name in METHODS if name in methods or (name == FORWARD and BOTH in methods)]
    tracks = {name: tracked(one, archive, bones, METHODS[name]) for name in wanted}
    if BOTH in methods:
        backward = tracked(one, archive, bones, DEFAULT, backward=True)
        tracks[BOTH] = both_ways(tracks[FORWARD], backward, one.truth)
    return tracks


def pooled(tracks: Mapping[str, Tracked]) -> F64:
    """Return the errors of all frames."""
    return np.concatenate([track.errors_cm for track in tracks.values()])


def cell(tracks: Mapping[str, Tracked]) -> str:
    """Return mean and median error in cm, and the fraction of frames that are off by more than 10 cm."""
    errors = pooled(tracks)
    return f"{errors.mean():.1f} / {np.median(errors):.1f}, {100 * (errors > OFF_CM).mean():.1f} %"


def rows(
    study: Study, films: Sequence[Film], kinds: Sequence[str], methods: Sequence[str]
) -> dict[tuple[str, str], Tracks]:
    """Return the tracks of every way to film, with every kind of bone lengths."""
    found = {}
    for film in films:
        recordings = study.film(film)
        for kind in kinds:
            tracks = tracks_of(study, recordings, bones_of(study, recordings, kind), methods)
            print(f"{film.name}, {kind}: {cell(tracks[methods[-1]])} {methods[-1]}", file=sys.stderr, flush=True)
            found[film.name, kind] = tracks
    return found


def table(found: Mapping[tuple[str, str], Tracks], prototype: Mapping[tuple[str, str], Sequence[str]]) -> list[str]:
    """Return a table of rows, with those of the prototype below."""
    methods = list(next(iter(found.values())))
    positions = [[*METHODS, BOTH].index(name) for name in methods]
    lines = []
    for (film, kind), tracks in found.items():
        lines.append([f"{film}, {kind}", *(cell(tracks[name]) for name in methods)])
        if (film, kind) in prototype:
            lines.append(["prototype", *(prototype[film, kind][place] for place in positions)])
    return grid(["", *methods], lines)


def printed_table(study: Study) -> list[str]:
    """Return the table of the printed form of the thesis, filmed by time of flight, with own bones."""
    recordings = study.film(Film())
    lines = [["printed, tof, own bones"], ["prototype"]]
    for name, settings in PRINTED_METHODS.items():
        job = partial(tracked, archive=study.archive, bones=study.bones, settings=settings)
        tracks = dict(zip((one.name for one in recordings), study.run(job, recordings), strict=True))
        lines[0].append(cell({name: track for name, track in tracks.items() if isinstance(track, Tracked)}))
        lines[1].append(PROTOTYPE_PRINTED[[*METHODS].index(name)])
    return grid(["", *PRINTED_METHODS], lines)


def class_table(found: Mapping[tuple[str, str], Tracks]) -> list[str]:
    """Return the errors of each class both ways, with the fraction of frames whose five ends are all found."""
    first = next(iter(found.values()))[BOTH]
    lines = []
    for name in [*first, ""]:
        picked = [{key: track for key, track in tracks[BOTH].items() if name in ("", key)} for tracks in found.values()]
        frames = sum(len(track.errors_cm) for track in picked[0].values())
        ends = np.concatenate([track.found for track in picked[0].values()])
        votes = np.concatenate([track.database for track in picked[0].values()])
        shares = [f"{100 * share:.0f} %" for share in (votes.mean(), ends.mean())]
        lines.append([name or "all", str(frames), *map(cell, picked), *shares])
    return grid(["", "frames", *(", ".join(key) for key in found), "database taken", "all five ends"], lines)


def aims(found: Mapping[tuple[str, str], Tracks]) -> list[str]:
    """Return how the tracks both ways stand against the aims."""
    lines = []
    for key, tracks in found.items():
        errors, name = pooled(tracks[BOTH]), ", ".join(key)
        parts = [pooled(tracks[part]).mean() for part in ("local only", "database only")]
        combined = pooled(tracks[FORWARD]).mean()
        if key in AIMS:
            lines.append([f"{name}: mean", f"{errors.mean():.2f} cm", f"≤ {AIMS[key]:.1f} cm"])
        lines.append([f"{name}: off by more than 10 cm", f"{100 * (errors > OFF_CM).mean():.1f} %", "≤ 1.5 %"])
        lines.append([f"{name}: combined by the better part", f"{combined / min(parts):.2f}", "< 1"])
    ends = np.concatenate([track.found for track in next(iter(found.values()))[FORWARD].values()])
    lines.append(["all five ends found", f"{100 * ends.mean():.1f} %", "≥ 60 %"])
    return grid(["", "reached", "aim"], lines)


def read_given(folder: Path) -> list[Filmed]:
    """Return the recordings of the design, made by its prototype's simulator."""
    found = []
    for home in sorted(path for path in folder.iterdir() if path.is_dir()):
        with (home / "ground_truth.csv").open(encoding="utf-8", newline="") as file:
            lines = list(csv.reader(file))
        joints = np.array(lines[1:], np.float64)[:, 1:].reshape(len(lines) - 1, len(JOINTS), 3)
        camera = read_camera(home / "camera.yaml")
        found.append(Filmed(home.name, TEST_ACTOR, home, camera, inside(camera, joints)))
    return found


def given_table(study: Study, folder: Path) -> list[str]:
    """Return the errors on the recordings of the design."""
    recordings = read_given(folder)
    own, guessed = (
        tracks_of(study, recordings, bones_of(study, recordings, kind), (FORWARD, BOTH)) for kind in (OWN, ESTIMATED)
    )
    lines = [
        [one.name, *(cell({one.name: tracks[name][one.name]}) for tracks in (own, guessed) for name in (FORWARD, BOTH))]
        for one in recordings
    ]
    return grid(["", *(f"{kind}, {name}" for kind in (OWN, ESTIMATED) for name in ("forward", BOTH))], lines)


def section(title: str, lines: Sequence[str]) -> None:
    """Print a part of the study."""
    print(f"{title}\n\n" + "\n".join(lines), flush=True)


def tables(study: Study, actor: str, data: Path) -> None:
    """Print all tables of an actor's recordings."""
    every = [*METHODS, BOTH]
    films = [Film(camera) for camera in CAMERAS]
    found = rows(study, films, (OWN, ESTIMATED), every)
    known = PROTOTYPE if actor == TEST_ACTOR else {}
    section(f"Set of {actor}", table(found, known))
    section("Aims", aims(found))
    section("Classes, both ways", class_table({key: tracks for key, tracks in found.items() if key[1] == OWN}))
    section("Printed form", printed_table(study))
    if actor != TEST_ACTOR:
        return
    section("Recordings of the design", given_table(study, data / "depth" / "simulated"))
    section("Mean bones at his height", table(rows(study, films, (MEAN,), (FORWARD, BOTH)), known))
    second = [replace(film, body="second") for film in films]
    section("Second body", table(rows(study, second, (OWN, ESTIMATED), (FORWARD, BOTH)), {}))
    aside = [Film(azimuth_deg=azimuth) for azimuth in AZIMUTHS]
    section("Filmed from aside", table(rows(study, aside, (OWN,), (FORWARD, BOTH)), {}))


def main() -> None:
    """Print all tables."""
    parser = argparse.ArgumentParser(prog="python -m studies.depth", description=__doc__)
    parser.add_argument("data", type=Path, help="folder with hdm05 and depth/simulated")
    parser.add_argument("--actor", choices=(TEST_ACTOR, "dg", "bk"), default=TEST_ACTOR, help="whose recordings")
    parser.add_argument("--make-sets", action="store_true", help="film the recordings of all three actors, and end")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    options = parser.parse_args()
    begin = time.perf_counter()
    motions = read_motions(options.data / "hdm05")
    bones = own_bones(motions)
    sets = {actor: choice_clips(motions, actor) for actor in ("dg", "bk")}
    sets[TEST_ACTOR] = held_out_clips(motions, options.data / "hdm05")
    if options.make_sets:
        for clips in sets.values():
            for camera in CAMERAS:
                recordings = film_set(clips, bones, Film(camera))
                print(f"{recordings[0].folder.parent}: {len(recordings)} recordings", flush=True)
        return
    actor: str = options.actor
    with ProcessPoolExecutor(max(1, options.workers)) as pool:
        study = Study(
            lambda film: film_set(sets[actor], bones, film),
            archive_of(motions, bones, actor),
            bones[actor],
            lambda work, jobs: list(pool.map(work, jobs)),
        )
        tables(study, actor, options.data)
    print(f"{(time.perf_counter() - begin) / 60:.1f} minutes")


if __name__ == "__main__":
    main()
