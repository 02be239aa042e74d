"""The memory of a file is known before it is read, and a file beyond `--max-memory` is refused with the number."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.features import load_feature_set
from kinedex.ops.errors import ParameterError, SourceError
from kinedex.pipelines.ingestion.memory_limit import PROCESS_BYTES, MemoryShare, needed_bytes, parse_size
from kinedex.storage.formats.motion.reader import MotionFile, ReadSettings
from kinedex.storage.store.store import open_store
from tests.commands.test_cli import kinedex
from tests.large_files import estimate_mb, measure
from tests.pipelines.archives import write_archive

FEATURES = load_feature_set()


@pytest.mark.parametrize(
    ("text", "size"),
    [("1.5GB", 1_500_000_000), ("2GiB", 2 << 30), ("800 mb", 800_000_000), ("64K", 64_000), ("1000", 1000)],
)
def test_sizes(text: str, size: int) -> None:
    assert parse_size(text) == size


@pytest.mark.parametrize("text", ["", "GB", "-1GB", "1.5TB", "1e9", "1,5GB", "١GB"])
def test_other_texts_are_no_sizes(text: str) -> None:
    with pytest.raises(ParameterError, match=r"max_memory must be a size such as 1\.5GB or 800MB"):
        parse_size(text)


def test_workers_share_the_limit_with_the_process_that_waits_for_them() -> None:
    assert MemoryShare.of("1.5GB", 1).bytes == 1_500_000_000
    assert MemoryShare.of("1.5GB", 4).bytes == (1_500_000_000 - PROCESS_BYTES) // 4
    assert MemoryShare.of("1MB", 4).bytes == 0


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="peaks are looked up in /proc, which is not here")
@pytest.mark.parametrize("form", ["amc", "csv", "npz, packed"])
def test_no_file_takes_more_than_was_estimated(tmp_path: Path, form: str) -> None:
    file, found = measure(tmp_path / "made", form, 16_000_000)
    assert not found["failure"]
    assert found["peak"] - found["before"] < estimate_mb(file) - PROCESS_BYTES / 1e6


def test_a_packed_file_counts_as_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    np.savez_compressed(path, positions=np.zeros((200_000, 24, 3)), fps=30.0)
    assert path.stat().st_size < 1_000_000
    assert needed_bytes(MotionFile(path), FEATURES, 30.0, ReadSettings()) > PROCESS_BYTES + 200_000 * 24 * 3 * 8 * 2
    with pytest.raises(
        SourceError, match=r"a\.npz: takes [\d,]+ MB of memory, more than --max-memory allows \(500 MB\)"
    ):
        MemoryShare.of("500MB", 1).refuse_large(MotionFile(path), FEATURES, 30.0, ReadSettings())


def test_frames_of_a_slow_source_count_as_they_are_sampled(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros((50_000, 24, 3), np.float32))
    slow, fast = (needed_bytes(MotionFile(path), FEATURES, 30.0, ReadSettings(rate_hz=rate)) for rate in (2.0, 120.0))
    assert slow - fast > 14 * 50_000 * 24 * 3 * 8


def test_a_damaged_file_is_left_to_its_reader(tmp_path: Path) -> None:
    for name in ("a.npz", "a.npy", "a.bvh", "a.c3d"):
        (tmp_path / name).write_bytes(b"nothing")
        MemoryShare.of("1MB", 1).refuse_large(MotionFile(tmp_path / name), FEATURES, 30.0, ReadSettings())


def test_ingest_refuses_what_needs_more_and_reads_it_once_there_is_more(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_bd_1.amc": 40, "x_bd_2.amc": 1200})
    store = tmp_path / "store"
    files = [MotionFile(source / name, source / "x.asf") for name in ("x_bd_1.amc", "x_bd_2.amc")]
    needs = [needed_bytes(file, FEATURES, 30.0, ReadSettings()) for file in files]
    one = ("--executor", "serial", "--max-memory")
    assert kinedex("ingest", store, source, *one, f"{sum(needs) // 2}B").returncode == 3  # files were excluded
    with open_store(store) as opened:
        assert opened.takes()["name"].to_list() == ["x_bd_1"]
        (row,) = opened.result("ingest_log").to_pylist()
    assert re.search(r"x_bd_2\.amc: takes \d+ MB of memory, more than --max-memory allows \(\d+ MB\)", row["message"])
    assert kinedex("ingest", store, source, *one, "1.5GB").returncode == 0
    with open_store(store) as opened:
        assert opened.takes()["name"].sort().to_list() == ["x_bd_1", "x_bd_2"]


def test_a_limit_that_is_no_size_is_refused(tmp_path: Path) -> None:
    source = write_archive(tmp_path / "source", {"x_bd_1.amc": 40})
    given = ("--set", f"source={source}", "--max-memory", "much")
    ended = kinedex("run", "ingest", "--store", tmp_path / "store", *given)
    assert ended.returncode != 0
    assert "max_memory must be a size such as 1.5GB or 800MB, got 'much'" in ended.stderr.replace("\n", " ")
