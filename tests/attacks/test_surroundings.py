"""A store in odd surroundings: strange paths, links to places outside, a clock that went back, a full disk, pickles."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from kinedex.ops.errors import KinedexError, StoreError
from kinedex.storage.formats.motion.body_models import load_body_model
from kinedex.storage.formats.motion.reader import ReadSettings
from kinedex.storage.formats.motion.reader_table import read_body
from kinedex.storage.index.builder import build_index
from kinedex.storage.store.garbage_collection import collect_garbage
from kinedex.storage.store.store import open_store
from kinedex.storage.store.verification import verify
from kinedex.storage.store.writer import StoreWriter
from tests.fuzz.seeds import known
from tests.storage.made_up import BODY, add, make_store


@pytest.mark.parametrize(
    "name", ["it's", "a b", "ü日", "a*b", "a[b]", "a;b--", "%s", 'a"b', "a\nb", "-x", "~", "\x1b[2J"]
)
def test_a_store_of_any_name_is_written_indexed_and_read(tmp_path: Path, name: str) -> None:
    path = make_store(tmp_path / name / "store", {"a": 30})
    build_index(open_store(path))
    with open_store(path) as store:
        assert store.sql("SELECT name FROM takes").to_pylist() == [{"name": "a"}]
        assert verify(store) == []


@pytest.mark.skipif(os.name == "nt", reason="a backslash separates folders there")
@pytest.mark.parametrize("name", ["a?b", "a\\b"])
def test_a_path_that_duckdb_cannot_open_is_refused_before_anything_is_written(tmp_path: Path, name: str) -> None:
    with pytest.raises(StoreError, match="name another directory"):
        make_store(tmp_path / name, {"a": 30})
    assert list(tmp_path.iterdir()) == []


def test_links_in_the_index_folder_lead_neither_gc_nor_a_build_outside(tmp_path: Path) -> None:
    path = make_store(tmp_path / "store", {"a": 30})
    build_index(open_store(path))
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "file").write_text("precious")
    for name in ("gen-000001-9", ".building-x"):
        (path / "index" / name).symlink_to(outside)
    collect_garbage(path, keep=1)
    assert not (path / "index" / "gen-000001-9").is_symlink()
    assert (outside / "file").read_text() == "precious"
    assert verify(open_store(path)) == []


def test_after_the_clock_went_back_leftovers_go_and_takes_stay(tmp_path: Path) -> None:
    path = make_store(tmp_path / "store", {"a": 30})
    later = time.time() + 400 * 86_400
    for file in path.rglob("*"):
        os.utime(file, (later, later))
    (path / "frames" / ".tmp-1.parquet").write_bytes(b"unfinished")
    (path / "frames" / f"part-{'0' * 24}.parquet").write_bytes(b"of a killed run")
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"b": 20})
        writer.commit()
    collect_garbage(path, keep=1)
    with open_store(path) as store:
        assert sorted(store.take_ids) == ["a", "b"]
        assert verify(store) == []
        assert len(list((path / "frames").iterdir())) == len(store.manifest.frames)


FULL = """
import resource, signal, sys
from pathlib import Path
from kinedex.ops.errors import KinedexError
from tests.storage.made_up import make_store
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
try:
    make_store(Path(sys.argv[1]), {"a": 3000})
except KinedexError as fault:
    sys.exit(str(fault))
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no limit on the size of files there")
@pytest.mark.parametrize("limit", [100, 3_000, 20_000])
def test_where_files_cannot_grow_nothing_is_committed_and_the_next_run_completes(tmp_path: Path, limit: int) -> None:
    path = tmp_path / "store"
    full = subprocess.run(
        [sys.executable, "-c", FULL, str(path), str(limit)], capture_output=True, text=True, timeout=120
    )
    assert "nothing was committed" in full.stderr
    assert "Traceback" not in full.stderr
    make_store(path, {"a": 3000})
    assert verify(open_store(path)) == []


class Payload:
    """An object whose pickle makes a folder when it is read."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[object, tuple[str]]:
        return os.mkdir, (str(self.path),)


def test_pickles_in_arrays_are_never_read(tmp_path: Path) -> None:
    made = tmp_path / "made"
    array = np.array([Payload(made)], dtype=object)
    np.savez(tmp_path / "a.npz", positions=array, names=array, fps=array)
    np.save(tmp_path / "b.npy", array, allow_pickle=True)
    (tmp_path / "c.npy").write_bytes(pickle.dumps(Payload(made)))
    (tmp_path / "d.npz").write_bytes(pickle.dumps(Payload(made)))
    np.savez(tmp_path / "model.npz", joints=array, v_template=array, J_regressor=array)
    feature_set, mappings = known()
    for name in ("a.npz", "b.npy", "c.npy", "d.npz"):
        with pytest.raises(KinedexError):
            read_body(tmp_path / name, None, mappings, feature_set.joints, ReadSettings(30.0, None, 5))
    with pytest.raises(KinedexError):
        load_body_model(str(tmp_path / "model.npz"), "neutral")
    assert not made.exists()
