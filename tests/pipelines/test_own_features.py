"""Features of the user's own: words of a new store are made with them, and the store keeps them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from kinedex.catalog.configs import config_path
from kinedex.pipelines.engine.runner import StageFailed, run_pipeline
from kinedex.storage.store.store import open_store
from tests.pipelines.archives import write_archive


@pytest.fixture(scope="module")
def own(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the shipped set with another threshold and one feature more."""
    text = config_path("features", "body40").read_text(encoding="utf-8")
    text = text.replace("name: body40", "name: mine").replace("mix: [27, 40]", "mix: [27, 41]")
    text = text.replace("weak: 120, strong: 110", "weak: 100, strong: 90", 1)
    text += (
        "  41: {name: hands_low, description: right wrist low, quantity: {height: [rwrist]}, length: humerus,"
        ' when: "<", weak: 3, strong: 2}\n'
    )
    path = tmp_path_factory.mktemp("features") / "mine.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_words_are_made_with_features_of_ones_own_and_stay_so(own: Path, tmp_path: Path) -> None:
    archive = write_archive(tmp_path / "archive", {"x_1.amc": 300, "x_2.amc": 200})
    source = {"source": str(archive)}
    run_pipeline("ingest", tmp_path / "plain", assignments=source)
    run_pipeline("ingest", tmp_path / "mine", assignments={**source, "ingest.features": str(own)})
    plain, mine = open_store(tmp_path / "plain"), open_store(tmp_path / "mine")
    assert [feature.name for feature in mine.feature_set.features][40:] == ["hands_low"]
    assert mine.sql("SELECT count(*) AS n FROM features").to_pylist() == [{"n": 41}]
    changed = np.uint64(1 << 6 | 1 << 40)  # the right elbow's threshold, and the new feature
    before, after = plain.words().words, mine.words().words
    assert np.array_equal(before & ~changed, after & ~changed)
    assert not np.array_equal(before & np.uint64(1 << 6), after & np.uint64(1 << 6))
    assert mine.sql("SELECT * FROM runs_where('hands_low')").num_columns

    # A run that does not name the file keeps to the store's features, the new take's too.
    write_archive(archive, {"x_3.amc": 100}, first_seed=7)
    run_pipeline("ingest", tmp_path / "mine", assignments=source)
    assert len(open_store(tmp_path / "mine").takes()) == 3
    assert open_store(tmp_path / "mine").feature_set.digest == mine.feature_set.digest


def test_a_store_has_one_feature_set_for_good(own: Path, tmp_path: Path) -> None:
    source = {"source": str(write_archive(tmp_path / "archive", {"x_1.amc": 60}))}
    run_pipeline("ingest", tmp_path / "store", assignments=source)
    with pytest.raises(StageFailed, match=r"body40 version 1 .* not with mine version 1 .* ingest into a new store"):
        run_pipeline("ingest", tmp_path / "store", assignments={**source, "ingest.features": str(own)})
    assert open_store(tmp_path / "store").feature_set.name == "body40"
