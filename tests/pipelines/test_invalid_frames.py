"""Invalid frames from the marker file to the report: no word, no run, no hit, no annotation; exports mark them."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from kinedex.console.terminal import Terminal
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.runner import Outcome, run_pipeline
from kinedex.pipelines.export.data_set import export_take
from kinedex.pipelines.export.request import ClipOptions
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from tests.c3d_files import LABELS, standing_markers, write_c3d, z_up

TAKE = "HDM_ann_take1"
ARMS = [LABELS.index(side + name) for side in "LR" for name in ("ELB", "WRA", "WRB", "FIN")]
LEG = [LABELS.index(name) for name in ("LTOE", "LHEE", "LANK", "LKNE")]
INVALID = range(128, 143)  # of 30 a second: source frames 510 to 569 of 120


def still(frames: int) -> np.ndarray:
    return np.repeat(standing_markers(1), frames, axis=2)


def arms_up(height: float = 1.0) -> np.ndarray:
    points = still(120)
    points[ARMS, 1] += height * np.sin(np.linspace(0, np.pi, 120))
    return points


def leg_up(height: float = 0.5) -> np.ndarray:
    points = still(120)
    swing = np.array([1, 1, 0.9, 0.5])[:, None] * height * np.sin(np.linspace(0, np.pi, 120))
    points[LEG, 1] += swing
    points[LEG, 2] += swing
    return points


def write(path: Path, *parts: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    write_c3d(path, 1000 * z_up(np.concatenate(parts, axis=2)))


@pytest.fixture(scope="module")
def archive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Clips of two classes, and a take with one of each and one whose elbow is hidden for half a second."""
    root = tmp_path_factory.mktemp("markers")
    for actor in ("ann", "bob"):
        for number, height in enumerate((0.9, 1.1)):
            write(root / f"clips/raise/HDM_{actor}_raise_{number:03}_120.c3d", arms_up(height))
            write(root / f"clips/kick/HDM_{actor}_kick_{number:03}_120.c3d", leg_up(height / 2))
    hidden = arms_up()
    hidden[LABELS.index("LELB"), :, 30:90] = np.nan
    parts = still(120), arms_up(), still(60), leg_up(), still(60), hidden, still(120)
    write(root / f"takes/{TAKE}.c3d", *parts)
    truth = "".join(f"{TAKE},{name},{start},{start + 120}\n" for name, start in (("raise", 120), ("kick", 300)))
    (root / "takes" / "ground_truth.csv").write_text(f"take,class,start,stop\n{truth}")
    return root


def run(pipeline: str, store: Path, **settings: str) -> Outcome:
    settings = {name.replace("__", "."): value for name, value in settings.items()}
    return run_pipeline(pipeline, store, assignments=settings, terminal=Terminal(Console(file=io.StringIO())))


@pytest.mark.parametrize("method", ["thesis", "best"])
def test_invalid_frames_have_no_word_no_run_and_no_annotation(tmp_path: Path, archive: Path, method: str) -> None:
    path = tmp_path / "store"
    outcome = run("annotate", path, source=str(archive), method=method)
    assert outcome.left_out == 0
    assert outcome.report is not None
    store = open_store(path)
    assert verify(store) == []
    frames = store.frames(TAKE)
    lost = [frame for frame, word in enumerate(frames.column("word").to_pylist()) if word is None]
    assert lost == list(INVALID)
    inside = f"start < {INVALID.stop} AND stop > {INVALID.start}"
    of_take = f"JOIN takes USING (take_id) WHERE name = '{TAKE}'"
    for view in ("word_runs", "feature_runs"):
        (row,) = store.sql(f"SELECT count(*) AS whole, count_if({inside}) AS bad FROM {view} {of_take}").to_pylist()
        assert row["whole"] > 0
        assert row["bad"] == 0
    found = store.sql("SELECT class, start, stop FROM annotations").to_pylist()
    assert {row["class"] for row in found} == {"raise", "kick"}
    assert not [row for row in found if row["start"] < INVALID.stop and row["stop"] > INVALID.start]


def test_a_take_with_invalid_frames_is_exported_as_tables_and_as_bvh_with_its_gaps_closed(
    tmp_path: Path, archive: Path
) -> None:
    open_gaps, closed = tmp_path / "open", tmp_path / "closed"
    run("ingest", open_gaps, source=str(archive))
    run("ingest", closed, source=str(archive), ingest__fill_gap_frames="60")
    with pytest.raises(KinedexError, match=r"is invalid in 15 of its 180 frames, where lelbow"):
        export_take(open_store(open_gaps), TAKE, ClipOptions("bvh"), tmp_path / "a.bvh")
    assert not (tmp_path / "a.bvh").exists()
    export_take(open_store(closed), TAKE, ClipOptions("bvh"), tmp_path / "a.bvh")
    assert "Frames: 180" in (tmp_path / "a.bvh").read_text()
    export_take(open_store(open_gaps), TAKE, ClipOptions("csv"), tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    assert [number - 1 for number, line in enumerate(lines) if "nan" in line] == list(INVALID)
    export_take(open_store(open_gaps), TAKE, ClipOptions("parquet"), tmp_path / "a.parquet")
    assert pq.read_table(tmp_path / "a.parquet").column("word").null_count == len(INVALID)
