"""The synthetic archive is the same for the same seed, reads like a real one, and is as hard as life."""

from __future__ import annotations

import csv
import hashlib
from collections import Counter
from functools import partial
from pathlib import Path

import pytest
from rich.console import Console

from kinedex.catalog.classes import load_classes
from kinedex.console.terminal import Progress, ProgressLines
from kinedex.ops.errors import KinedexError, ParameterError
from kinedex.ops.synth.performance import MOTIONS
from kinedex.pipelines.simulation.synthetic_archive import ArchiveSummary, write_archive
from kinedex.storage.formats.motion.acclaim import AmcFile
from kinedex.storage.formats.motion.asf import read_asf
from kinedex.storage.formats.motion.skeleton_files import skeleton_of
from kinedex.storage.formats.motion.sources import scan
from studies.synthetic_motion import HDM05, HDM05_FRAMES, SETS, figures, within, words_of


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, ArchiveSummary]:
    folder = tmp_path_factory.mktemp("synth") / "archive"
    return folder, write_archive(folder, minutes=1.0, seed=4, jobs=1)


def digests(folder: Path) -> dict[str, str]:
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.suffix in (".amc", ".asf", ".csv")
    }


def test_the_bytes_do_not_depend_on_the_number_of_jobs(archive: tuple[Path, ArchiveSummary], tmp_path: Path) -> None:
    folder, _ = archive
    write_archive(tmp_path / "again", minutes=1.0, seed=4, jobs=2)
    assert digests(folder) == digests(tmp_path / "again")


def test_every_file_is_read_with_the_skeleton_of_its_actor(archive: tuple[Path, ArchiveSummary]) -> None:
    folder, summary = archive
    sources = scan(folder)
    frames = 0
    for motion in sources.motions:
        skeleton = skeleton_of(motion, sources.skeletons)
        assert motion.stem.startswith(skeleton.stem + "_")
        assert Path(skeleton.path).parts[0] == Path(motion.path).parts[0]
        frames += AmcFile(motion.absolute, read_asf(skeleton.absolute)).frames
    assert len(sources.motions) == summary.clips + summary.takes
    assert frames == summary.frames
    assert abs(summary.clip_minutes + summary.take_minutes - 1.0) < 0.4


def test_every_actor_is_in_clips_and_takes(archive: tuple[Path, ArchiveSummary]) -> None:
    folder, summary = archive
    assert len(summary.actors) == 5
    assert len(summary.classes) >= 10
    for part in ("clips", "takes"):
        seen = {path.name.split("_")[1] for path in (folder / part).rglob("*.amc")}
        assert seen == set(summary.actors)


def test_ground_truth_lies_within_the_takes_in_order_and_names_classes(archive: tuple[Path, ArchiveSummary]) -> None:
    folder, summary = archive
    with (folder / "takes" / "ground_truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == summary.labels
    classes = load_classes("synthetic", [motion.name for motion in MOTIONS])
    last: Counter[str] = Counter()
    for row in rows:
        assert classes.class_of(row["class"]) == row["class"]
        assert (folder / "takes" / f"{row['take']}.amc").is_file()
        assert last[row["take"]] <= int(row["start"]) < int(row["stop"])
        last[row["take"]] = int(row["stop"])


def test_the_shipped_classes_take_every_subclass() -> None:
    classes = load_classes("synthetic", [motion.name for motion in MOTIONS])
    assert classes.without_class == ()
    assert {motion.name: motion.label for motion in MOTIONS} == classes.of_subclass()


def test_a_complete_archive_is_left_as_it_is_and_a_begun_one_is_finished(
    archive: tuple[Path, ArchiveSummary], tmp_path: Path
) -> None:
    folder, summary = archive
    before = digests(folder)
    again = write_archive(folder, minutes=1.0, seed=4, jobs=1)
    assert not again.made
    assert (again.frames, again.labels) == (summary.frames, summary.labels)
    assert digests(folder) == before

    class Killed(Exception):
        pass

    class Bar(Progress):
        def advance(self, n: int = 1) -> None:
            raise Killed

    console = Console(quiet=True)
    bars = partial(Bar, console, ProgressLines(console.print))
    with pytest.raises(Killed):
        write_archive(tmp_path / "begun", minutes=1.0, seed=4, jobs=1, progress=bars)
    assert write_archive(tmp_path / "begun", minutes=1.0, seed=4, jobs=1).made
    assert digests(tmp_path / "begun") == before


def test_a_folder_that_holds_something_else_is_not_touched(
    archive: tuple[Path, ArchiveSummary], tmp_path: Path
) -> None:
    folder, _ = archive
    with pytest.raises(KinedexError, match="other settings"):
        write_archive(folder, minutes=2.0, seed=4)
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(KinedexError, match="is neither empty nor a synthetic archive"):
        write_archive(tmp_path)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"minutes": 0.0}, "minutes must be"), ({"actors": 0}, "actors must be"), ({"seed": -1}, "seed must be")],
)
def test_impossible_sizes_are_refused(wrong: dict[str, float], message: str, tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match=message):
        write_archive(tmp_path / "archive", **wrong)  # type: ignore[arg-type]


@pytest.mark.slow
def test_words_and_runs_are_within_a_factor_of_two_of_hdm05(tmp_path: Path) -> None:
    write_archive(tmp_path / "archive", minutes=8.5)
    mine = figures(words_of(tmp_path / "archive"))
    for name in SETS:
        assert mine[name].frames == HDM05_FRAMES
        assert within(mine[name], HDM05[name]), (name, mine[name], HDM05[name])


def test_the_time_of_the_clips_can_be_given(archive: tuple[Path, ArchiveSummary], tmp_path: Path) -> None:
    folder, summary = archive
    more = write_archive(tmp_path / "more", minutes=1.5, seed=4, jobs=1, clip_minutes=0.5)
    assert more.clips == summary.clips
    assert more.take_minutes > 1.5 * summary.take_minutes
    assert {name: one for name, one in digests(tmp_path / "more").items() if name.startswith("clips")} == {
        name: one for name, one in digests(folder).items() if name.startswith("clips")
    }
    with pytest.raises(KinedexError, match="settings"):
        write_archive(tmp_path / "more", minutes=1.5, seed=4, jobs=1)
    with pytest.raises(ParameterError, match="clip_minutes"):
        write_archive(tmp_path / "none", minutes=1.0, clip_minutes=1.0)
