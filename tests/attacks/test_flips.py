"""No flipped bit in a file of a store changes an answer without an error that names the file."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa

from kinedex.storage.index.builder import build_index
from kinedex.storage.snapshot.schemas import result_schema
from kinedex.storage.store.store import open_store
from kinedex.storage.store.writer import StoreWriter
from tests.attacks.flips import attack
from tests.attacks.outcome import Options
from tests.storage.made_up import BODY, add, make_store

EACH = 1


def test_a_flipped_bit_is_the_same_answer_or_an_error_that_names_the_file(tmp_path: Path) -> None:
    path = make_store(tmp_path / "store", {"a": 130, "b": 70})
    row = {"take_id": 1, "take": "a", "class": "walk", "subclass": "walk", "start": 3, "stop": 40, "confidence": 0.5}
    with StoreWriter.open(path, BODY) as writer:
        table = pa.Table.from_pylist([row | {"run": "r"}], schema=result_schema("annotations"))
        writer.put_results("annotations", table, stage="study/annotate", run="r")
        writer.commit()
    build_index(open_store(path, at="newest"), threads=1)
    with StoreWriter.open(path, BODY) as writer:
        add(writer, {"c": 40})
        writer.commit()
        build_index(writer.store, threads=1)
    outcome = attack(path, EACH, Options(seed=1))
    assert outcome.failures == []
    kinds = ["frames", "generation.json", "index.duckdb", "manifest, newest", "manifest, older"]
    kinds += ["results/annotations", "slices", "takes"]
    for kind in kinds:
        assert sum(count for name, count in outcome.counts.items() if name.startswith(f"{kind},")) == EACH
    assert outcome.counts["frames, found"] == EACH
    assert outcome.counts["flips"] == EACH * len(kinds)
