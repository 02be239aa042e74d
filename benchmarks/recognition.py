"""Time the recogniser of motions on one core: positions of takes of Bandai become labels, step by step.

Five examples of each content that has eight takes are learned; the other takes are laid end to end, twenty to a take.
Beside it stands the evidence of the states alone, in numpy with 64 bits.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks.harness import BUILD, LEFT_OUT, Figure, seconds, sized
from kinedex.ops.body.joint_tree import JOINTS
from kinedex.ops.numeric.candidate_cuts import candidate_cuts
from kinedex.ops.numeric.channels import channels
from kinedex.ops.numeric.recogniser import Recogniser, TaughtMotion
from kinedex.ops.numeric.span_chain import spans_between
from kinedex.ops.numeric.span_descriptors import SpanSums
from kinedex.storage.store.store import Store
from studies.bandai import ingest
from studies.recognition_protocols import draw, end_to_end, motions_of
from tests.real_data import SHARED

FILES = SHARED / "data" / "bandai" / sized("", "dataset-1")
EXAMPLES, TOGETHER = 5, 20


def figures(_: Store) -> Iterator[Figure]:
    """Time learning, labelling, and the steps of labelling."""
    if not FILES.is_dir():
        yield Figure("labels by numbers", 0.0, "", None, f"{LEFT_OUT}{FILES} is missing")
        return
    store = ingest(FILES, BUILD / "recognition-store")
    examples, rest = draw(list(motions_of(store).values()), EXAMPLES, 0)
    takes = [one.positions for one in end_to_end(rest, TOGETHER)]
    taught = [TaughtMotion(one.positions, one.label) for one in examples]

    def learn() -> Recogniser:
        return Recogniser.fit(taught, takes, JOINTS, store.rate_hz)

    learned = learn()
    frames = sum(len(take) for take in takes)
    found = [channels(take, JOINTS, store.rate_hz) for take in takes]
    rows = learned.model.rows
    projected = [rows.project(one.frames) for one in found]
    spans = [
        spans_between(candidate_cuts(one, rows.columns).cuts, np.exp(learned.model.log_frames)) for one in projected
    ]
    naive = seconds(lambda: [rows.evidence(one.frames) for one in found])
    beside = ("evidence alone, in numpy with 64 bits", naive)
    name = f"labels by numbers, {len(learned.classes)} classes, {len(rows.states)} states"
    yield Figure(name, frames, "frames", seconds(lambda: [learned.label(take) for take in takes]), *beside)
    steps = {
        "channels": lambda: [channels(take, JOINTS, store.rate_hz) for take in takes],
        "projection": lambda: [rows.project(one.frames) for one in found],
        "candidate cuts": lambda: [candidate_cuts(one, rows.columns) for one in projected],
        "descriptors": lambda: [
            SpanSums(one, store.rate_hz).describe(own.starts, own.stops) for one, own in zip(found, spans, strict=True)
        ],
    }
    for step, work in steps.items():
        yield Figure(f"the same: {step}", frames, "frames", seconds(work), *beside)
    yield Figure(f"learning {len(taught)} examples", len(taught), "examples", seconds(learn, 3))
