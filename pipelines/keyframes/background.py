"""Background as negatives: what queries find in takes that hold none of their motions."""

from __future__ import annotations

from dataclasses import replace

from kinedex.ops.words import TakeWords
from kinedex.pipelines.keyframes.learning import Lesson, Outcome
from kinedex.pipelines.keyframes.margins import hit_ranges


def mine(lesson: Lesson, outcome: Outcome, words: TakeWords, features: int, most: int) -> tuple[Lesson, int]:
    """Add the false hits of a lesson's queries to its negatives.

    Parameters
    ----------
    outcome: of the lesson without background. words: takes without the class. most: how many stretches at most, the
    longest first.

    Returns
    -------
    The lesson with the stretches from the first to the last keyframe of hits, extended by the queries' margins; and how
    many stretches there are, those beyond the most among them.
    """
    found = set()
    for chosen in outcome.chosen:
        takes, ranges = hit_ranges(words, chosen.query, features)
        for take, (start, stop) in zip(takes.tolist(), ranges.tolist(), strict=True):
            end = min(stop + chosen.right, int(words.frames[take]))
            found.add((take, max(0, start - chosen.left), end))
    longest = sorted(found, key=lambda span: (span[1] - span[2], span))[:most]
    return replace(lesson, background=tuple(words.take(take)[start:stop] for take, start, stop in longest)), len(found)
