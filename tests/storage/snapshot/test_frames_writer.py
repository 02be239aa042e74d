"""A part of frames is the same however its takes are cut on their way into row groups."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kinedex.ops.words import NO_WORD
from kinedex.storage.snapshot import parts
from kinedex.storage.snapshot.parts import FramesWriter, joint_positions
from tests.storage.made_up import BODY


@given(st.lists(st.integers(1, 70), min_size=1, max_size=6), st.integers(1, 20))
def test_rows_are_those_of_the_takes_in_groups_of_one_size(
    tmp_path_factory: pytest.TempPathFactory, lengths: list[int], group: int
) -> None:
    store, joints = tmp_path_factory.mktemp("store"), len(BODY.joints)
    (store / "frames").mkdir()
    random = np.random.default_rng(sum(lengths))
    takes = [
        (random.normal(size=(joints, 3, n)), random.normal(size=(4, n)), random.integers(0, 99, n).astype(np.uint64))
        for n in lengths
    ]
    for _, _, words in takes:
        words[::7] = NO_WORD
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(parts, "ROW_GROUP", group)
        with FramesWriter(store, BODY) as writer:
            for take_id, take in enumerate(takes, 5):
                writer.add(take_id, *take)
            part = writer.close()
    file = pq.ParquetFile(Path(store) / part.path)
    rows = file.read()
    assert rows["take_id"].to_pylist() == np.repeat(np.arange(5, 5 + len(takes)), lengths).tolist()
    assert rows["frame"].to_pylist() == [t for n in lengths for t in range(n)]
    positions = np.concatenate([take[0] for take in takes], axis=2).astype(np.float32)
    np.testing.assert_array_equal(joint_positions(rows, BODY.joints), positions)
    words = np.concatenate([take[2] for take in takes])
    assert rows["word"].to_pylist() == [None if word == NO_WORD else int(word) for word in words]
    sizes = [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)]
    assert sizes[:-1] == [group] * (len(sizes) - 1)
    assert sizes[-1] < 2 * group
