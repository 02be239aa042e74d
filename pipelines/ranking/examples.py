"""Learn templates from chosen intervals: similar to accepted ones, and dissimilar to rejected ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from kinedex.catalog.template_files import NamedTemplate
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.contrast_weights import contrast_weights
from kinedex.ops.words import ALL_KNOWN, U64
from kinedex.pipelines.ranking.store_ranking import DELTA
from kinedex.pipelines.search.bit_slices import stored_words
from kinedex.pipelines.templates.learning import learned_of, usable_clips
from kinedex.pipelines.templates.stored_templates import frame_range, template_of_frames
from kinedex.storage.store.store import Store

F64 = npt.NDArray[np.float64]


@dataclass(frozen=True)
class ChosenInterval:
    """The frames [start, stop) of a take, or their mirror image."""

    take_id: int
    start: int
    stop: int
    mirrored: bool = False


@dataclass(frozen=True)
class ChosenTemplate:
    """A template learned from chosen intervals.

    Attributes
    ----------
    named : NamedTemplate
        The template, with the weights of features.
    clips : tuple of str
        The intervals that it was learned from, as "name[start:stop]", mirrored ones with the prefix "mirror of ".
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
    accepted: Sequence[ChosenInterval],
    rejected: Sequence[ChosenInterval] = (),
    delta: float = DELTA,
) -> ChosenTemplate:
    """Learn a template from accepted intervals, in contrast to rejected ones.

    A single interval becomes the template unchanged; several are averaged as in `Template.learn`. Rejected intervals
    change the weights of features (`ops.templates.contrast_weights`), so that the template can be used in any ranking
    of the archive. A rejected interval that overlaps an accepted one is ignored: it still shows the motion, and made
    results worse in the study of corrections (docs/studies.md).

    Parameters
    ----------
    store : Store
        The store of the takes.
    name : str
        The name of the template.
    accepted : sequence of ChosenInterval
        Intervals that show the motion; at least one.
    rejected : sequence of ChosenInterval, optional
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
        words, known = held.take(one.take_id), store.known.get(one.take_id, int(ALL_KNOWN))
        named = template_of_frames(words, held.names[one.take_id], one.start, one.stop, features, name, known)
        learned_words = [held.words(one)]
    else:
        clips = {held.label(one): one for one in accepted}
        masks = {label: held.known(one) for label, one in clips.items()}
        known_masks = {label: mask for label, mask in masks.items() if mask != ALL_KNOWN}
        actors = {label: held.actors[one.take_id] for label, one in clips.items()}
        words_of = {label: held.words(clips[label]) for label in sorted(clips)}
        training = usable_clips(name, words_of, known_masks, actors)
        learned = learned_of(training, "soft", features)
        named = NamedTemplate(name, learned.template, f"learned of {len(training.names)} intervals")
        learned_words, remarks = list(training.words), training.remarks
    apart = [one for one in rejected if not any(_overlap(one, other) for other in accepted)]
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
    return ChosenTemplate(named, tuple(held.label(one) for one in accepted), remarks)


def _overlap(one: ChosenInterval, other: ChosenInterval) -> bool:
    return one.take_id == other.take_id and one.start < other.stop and other.start < one.stop


class _Words:
    """The words of the takes from which intervals were chosen."""

    def __init__(self, store: Store, chosen: Sequence[ChosenInterval]) -> None:
        self.store = store
        wanted = {one.take_id for one in chosen}
        self.names = {take_id: name for name, take_id in store.take_ids.items() if take_id in wanted}
        if missing := wanted - set(self.names):
            raise KinedexError(f"no take has the id {min(missing)}; it may have been removed from the store")
        rows = store.takes().select("take_id", "actor").iter_rows()
        self.actors = {take_id: actor or "" for take_id, actor in rows if take_id in wanted}
        found = stored_words(store, sorted(wanted))
        self._takes = {take_id: found.take(place) for place, take_id in enumerate(found.take_ids.tolist())}
        for one in chosen:
            frame_range(self.names[one.take_id], len(self.take(one.take_id)), store.rate_hz, one.start, one.stop)

    def take(self, take_id: int) -> U64:
        return self._takes[take_id]

    def words(self, one: ChosenInterval) -> U64:
        """Return the words of an interval; for a mirrored one, with left and right exchanged."""
        words = self._takes[one.take_id][one.start : one.stop]
        return self.store.feature_set.mirrored(words) if one.mirrored else words

    def known(self, one: ChosenInterval) -> int:
        """Return the mask of the features that are known in the take of an interval."""
        mask = self.store.known.get(one.take_id, int(ALL_KNOWN))
        if not one.mirrored or mask == ALL_KNOWN:
            return mask
        features = self.store.feature_set
        return int(features.mirrored(np.array([mask & features.every_bit], np.uint64))[0])

    def label(self, one: ChosenInterval) -> str:
        return f"{'mirror of ' if one.mirrored else ''}{self.names[one.take_id]}[{one.start}:{one.stop}]"
