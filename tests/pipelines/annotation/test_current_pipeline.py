"""Annotations, templates and queries are those of the current pipeline unless another one is named."""

from __future__ import annotations

from pathlib import Path

import pytest

from kinedex.ops.errors import KinedexError
from kinedex.pipelines.annotation.annotation_tables import annotation_stage
from kinedex.pipelines.keyframes.stored_queries import stored_queries
from kinedex.pipelines.templates.stored_templates import stored_templates
from kinedex.storage.store.store import Store, open_store
from kinedex.storage.store.writer import StoreWriter
from tests.storage.made_up import BODY, make_store
from tests.storage.snapshot.test_visible_results import put


@pytest.fixture
def store(tmp_path: Path) -> Store:
    with StoreWriter.open(make_store(tmp_path / "store", {"a": 9}), BODY) as writer:
        put(writer, "annotated_takes", "first/annotate", "annotate", 1, "2026-01-01")
        put(writer, "annotated_takes", "second/annotate", "annotate", 1, "2026-01-02")
        writer.record_run("second")
        writer.record_run("first")
        writer.commit()
    return open_store(tmp_path / "store")


def test_the_stage_is_that_of_the_current_pipeline(store: Store) -> None:
    assert annotation_stage(store) == "first/annotate"
    assert annotation_stage(store, "second") == "second/annotate"
    with StoreWriter.open(store.path, BODY) as writer:
        writer.choose_pipeline("second")
        put(writer, "annotated_takes", "second/again", "annotate", 1, "2026-01-03")
        writer.commit()
    chosen = open_store(store.path)
    with pytest.raises(KinedexError, match=r"several stages of 'second' .*: second/again, second/annotate; .*--stage"):
        annotation_stage(chosen)
    assert annotation_stage(chosen, "second/again") == "second/again"
    with pytest.raises(KinedexError, match="no stage 'thrid' has annotated"):
        annotation_stage(chosen, "thrid")


def test_a_store_without_templates_or_queries_says_so(store: Store) -> None:
    for ask in (stored_templates, stored_queries):
        with pytest.raises(KinedexError, match=r"has no (templates|learned queries)"):
            ask(store)
