"""Learn a template from intervals that a person has accepted, in contrast to intervals that were rejected."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from kinedex.ops.arrays import F64
from kinedex.ops.errors import KinedexError
from kinedex.ops.intervals import Hit, Interval
from kinedex.ops.templates.derived_templates import contrast_weights
from kinedex.ops.templates.templates import NamedTemplate
from kinedex.ops.words import ALL_KNOWN, U64
from kinedex.pipelines.keyframes.slice_search import stored_words
from kinedex.pipelines.templates.examples import interval_of
from kinedex.pipelines.templates.store_ranking import DELTA
from kinedex.pipelines.templates.stored_templates import clip_range, frame_range, template_of_frames
from kinedex.pipelines.templates.template_learning import learn_template, usable_clips
from kinedex.storage.store.store import Store

MIRROR_OF = "mirror of "
"""The words before the name of an interval that is mirrored."""


@dataclass(frozen=True)
class ChosenTemplate:
    """A template learned from chosen intervals.

    Attributes
    ----------
    named : NamedTemplate
        The template, with the weights of features.
    clips : tuple of str
        The intervals that were learned from, as "name[start:stop]"; mirrored ones have the prefix "mirror of ".
    remarks : tuple of str
        Remarks on intervals that were excluded.
    """

    named: NamedTemplate
    clips: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def weights(self) -> F64 | None:
        """The weights of features, float64 (f,); None if all have the same weight."""
        return self.named.template.feature_weights


def template_of_chosen(
    store: Store,
    name: str,
    accepted: Sequence[Hit],
    rejected: Sequence[Hit] = (),
    delta: float = DELTA,
) -> ChosenTemplate:
    """Learn a template from accepted intervals, in contrast to rejected ones.

    A single interval becomes the template unchanged; several are averaged as in `Template.learn`. Rejected intervals
    change the weights of features (`contrast_weights`), so that the template can be used in any ranking
    of the archive. A rejected interval that overlaps an accepted one is ignored: it still shows the motion, and made
    results worse in the study of corrections (docs/studies.md).

    Parameters
    ----------
    store : Store
        The store of the takes.
    name : str
        The name of the template.
    accepted : sequence of Hit
        Intervals that show the motion; at least one.
    rejected : sequence of Hit, optional
        Intervals that do not show the motion.
    delta : float, optional
        Values within delta of 0 or 1 count as fixed.

    Raises
    ------
    KinedexError
        Nothing was accepted, an interval is not within its take, or all have invalid frames in the middle.
    """
    if not accepted:
        raise KinedexError("no example to search by: choose at least one interval")
    held = _Words(store, [*accepted, *rejected])
    features = len(store.feature_set.features)
    remarks: tuple[str, ...] = ()
    if len(accepted) == 1 and not accepted[0].mirrored:
        (one,) = accepted
        take, start, stop = one.interval
        named = template_of_frames(held.takes[take], take, start, stop, features, name, held.known(one))
        learned_words = [held.words(one)]
    else:
        clips = {label_of(one): one for one in accepted}
        masks = {label: held.known(one) for label, one in clips.items()}
        known_masks = {label: mask for label, mask in masks.items() if mask != ALL_KNOWN}
        actors = {label: held.actors[one.interval.take] for label, one in clips.items()}
        words_of = {label: held.words(clips[label]) for label in sorted(clips)}
        training = usable_clips(name, words_of, known_masks, actors)
        learned = learn_template(training, "soft", features)
        named = NamedTemplate(name, learned.template, f"learned of {len(training.names)} intervals")
        learned_words, remarks = list(training.words), training.remarks
    apart = [one for one in rejected if not any(one.interval.overlaps(other.interval) for other in accepted)]
    if len(apart) < len(rejected):
        remarks = (*remarks, f"rejected intervals that overlap an accepted one, ignored: {len(rejected) - len(apart)}")
    if apart:
        weights = contrast_weights(named.template, learned_words, [held.words(one) for one in apart], delta)
        standing = named.template.feature_weights
        weights = weights if standing is None else weights * standing
        named = replace(
            named,
            template=replace(named.template, feature_weights=weights),
            description=f"{named.description}, in contrast to {len(apart)} rejected",
        )
    return ChosenTemplate(named, tuple(label_of(one) for one in accepted), remarks)


def label_of(one: Hit) -> str:
    """Return the name of a chosen interval, "take[start:stop]", with the prefix "mirror of " if it is mirrored."""
    take, start, stop = one.interval
    return f"{MIRROR_OF if one.mirrored else ''}{take}[{start}:{stop}]"


def hit_of(text: str, store: Store) -> Hit:
    """Return the interval that a name denotes, as `label_of` makes it; a name of a take denotes the whole take.

    Raises
    ------
    KinedexError
        There is no such take, or the frames are not within it.
    """
    mirrored = text.startswith(MIRROR_OF) and text not in store.take_ids
    take, frames = interval_of(text.removeprefix(MIRROR_OF) if mirrored else text, store.take_ids)
    start, stop = clip_range(store, take, frames.start, frames.stop)
    return Hit(Interval(take, start, stop), mirrored=mirrored)


class _Words:
    """The words of the takes from which intervals were chosen."""

    def __init__(self, store: Store, chosen: Sequence[Hit]) -> None:
        self.store = store
        wanted = {store.take_id(one.interval.take) for one in chosen}
        rows = store.takes().select("take_id", "name", "actor").iter_rows()
        self.actors = {name: actor or "" for take_id, name, actor in rows if take_id in wanted}
        found = stored_words(store, sorted(wanted))
        self.takes = {store.take_names[take_id]: found.take(i) for i, take_id in enumerate(found.take_ids.tolist())}
        for take, start, stop in (one.interval for one in chosen):
            frame_range(take, len(self.takes[take]), store.rate_hz, start, stop)

    def words(self, one: Hit) -> U64:
        """Return the words of an interval; for a mirrored one, with left and right exchanged."""
        take, start, stop = one.interval
        words = self.takes[take][start:stop]
        return self.store.feature_set.mirrored(words) if one.mirrored else words

    def known(self, one: Hit) -> int:
        """Return the mask of the features that are known in the take of an interval."""
        mask = self.store.known.get(self.store.take_ids[one.interval.take], int(ALL_KNOWN))
        if not one.mirrored or mask == ALL_KNOWN:
            return mask
        features = self.store.feature_set
        return int(features.mirrored(np.array([mask & features.every_bit], np.uint64))[0])
