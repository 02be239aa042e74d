"""Write a self-contained page of small moving figures in groups; a click on a figure opens it in the player."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from kinedex.ops.templates.nearest_clip import nearest_clips
from kinedex.ops.wording import counted
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.templates.stored_clips import NearestExample, words_of
from kinedex.reports.embedded_motions import EmbeddedMotions, motions_json
from kinedex.reports.page_environment import page_environment
from kinedex.reports.palette import colour_rules, colour_slot
from kinedex.storage.store.store import Store

NOTHING = Markup("")

MARGIN = 10
"""Frames before and after a clip that the player can show."""

Place = tuple[str, int, int]
"""A take and a range of its frames [start, stop)."""

Examples = Mapping[str, Sequence[Place]]
"""A mapping from names to intervals that serve as examples, for instance from templates to their clips."""


@dataclass(frozen=True)
class Clip:
    """An interval of a take as a figure of a page.

    Attributes
    ----------
    take : str
        Name of the take.
    start, stop : int
        The frames [start, stop).
    title : str
        The first line below the figure.
    facts : tuple of str
        Further lines.
    examples : str
        Name of the examples of which the player shows the nearest beside the clip; empty for none.
    """

    take: str
    start: int
    stop: int
    title: str
    facts: tuple[str, ...] = ()
    examples: str = ""


@dataclass(frozen=True)
class Group:
    """A heading, the clips that are shown below it, and the number of all clips of the group."""

    name: str
    clips: tuple[Clip, ...]
    total: int


@dataclass(frozen=True)
class MotionPage:
    """The content of a page of moving figures.

    Attributes
    ----------
    title : str
        Heading of the page.
    lead : str
        The sentence below it.
    noun : str
        The noun for a figure, such as "hit".
    groups : sequence of Group
        The figures.
    remarks : sequence of str
        Sentences at the end.
    head : Markup
        HTML above the figures, such as a matrix.
    """

    title: str
    lead: str
    noun: str
    groups: Sequence[Group]
    remarks: Sequence[str] = ()
    head: Markup = NOTHING

    @property
    def shown(self) -> int:
        """Number of figures."""
        return sum(len(group.clips) for group in self.groups)

    @property
    def total(self) -> int:
        """Number of clips of all groups, shown or not."""
        return sum(group.total for group in self.groups)

    @property
    def amount(self) -> str:
        """A sentence with the number of figures that are shown, the number of all, and the option that shows all."""
        if self.shown == self.total:
            return f"{counted(self.total, self.noun)}."
        return f"{self.shown:,} of {counted(self.total, self.noun)}; --figures {self.total} shows all."


def shares(counts: Sequence[int], most: int) -> list[int]:
    """Return the number of clips to show of each group, dividing at most `most` clips evenly."""
    given = [0] * len(counts)
    while sum(given) < min(most, sum(counts)):
        open_groups = [place for place, count in enumerate(counts) if given[place] < count]
        room = max(1, (most - sum(given)) // len(open_groups))
        for place in open_groups[: most - sum(given)]:
            given[place] += min(room, counts[place] - given[place])
    return given


def grouped(clips: Sequence[Clip], name_of: Callable[[Clip], str], most: int) -> list[Group]:
    """Return at most `most` clips in groups, which are in the order of their first clips."""
    found: dict[str, list[Clip]] = {}
    for clip in clips:
        found.setdefault(name_of(clip), []).append(clip)
    given = shares([len(own) for own in found.values()], most)
    return [
        Group(name, tuple(own[:count]), len(own))
        for (name, own), count in zip(found.items(), given, strict=True)
        if own
    ]


def write_motion_page(store: Store, page: MotionPage, path: Path, examples: Examples | None = None) -> str:
    """Write a page of moving figures, and return the sentence about how many it shows.

    Parameters
    ----------
    store : Store
        The store of the takes.
    page : MotionPage
        The content; equal content gives equal bytes.
    path : Path
        The file.
    examples : Examples, optional
        The examples to which clips refer by name.

    Raises
    ------
    KinedexError
        The folder of the file does not exist.
    """
    template = page_environment().get_template("figures.html.j2")
    write_page(template.render(title=page.title, page=page, **figures_of(store, page.groups, examples)), path)
    return page.amount


def figures_of(store: Store, groups: Sequence[Group], examples: Examples | None = None) -> dict[str, Any]:
    """Return the variables that a page template needs for moving figures of clips and their player.

    Parameters
    ----------
    store : Store
        The store of the takes.
    groups : sequence of Group
        The figures.
    examples : Examples, optional
        The examples to which clips refer by name.

    Returns
    -------
    dict
        The variables of the template: the motions, the nearest examples and the colours of the groups.
    """
    clips = [clip for group in groups for clip in group.clips]
    motions = EmbeddedMotions.none(store).with_pieces(
        store, [(clip.take, clip.start, clip.stop) for clip in clips], MARGIN
    )
    near: dict[Clip, tuple[int, str]] = {}
    if examples is not None:
        found = _nearest(store, clips, examples)
        motions = motions.with_near(store, [(one.take, one.start, one.stop, one.frames) for one in found.values()])
        near = {clip: (place, one.take) for place, (clip, one) in enumerate(found.items())}
    light, dark = colour_rules(len(groups))
    return {
        "scripts": True,
        "motions": motions,
        "motions_json": motions_json(motions),
        "near": near,
        "slot": colour_slot,
        "rate_hz": store.rate_hz,
        "light": light,
        "dark": dark,
    }


def _nearest(store: Store, clips: Iterable[Clip], examples: Examples) -> dict[Clip, NearestExample]:
    """Return the nearest example of each clip that has examples, in the order of the clips."""
    named: dict[str, list[Clip]] = {}
    for clip in dict.fromkeys(clips):
        if examples.get(clip.examples) and clip.start < clip.stop:
            named.setdefault(clip.examples, []).append(clip)
    takes = {clip.take for own in named.values() for clip in own}
    takes |= {take for name in named for take, _, _ in examples[name]}
    words = words_of(store, sorted(takes))
    found: dict[Clip, NearestExample] = {}
    for name, own in named.items():
        known = [words[take][start:stop] for take, start, stop in examples[name]]
        parts = [words[clip.take][clip.start : clip.stop] for clip in own]
        for clip, one in zip(own, nearest_clips(known, parts, len(store.feature_set.features)), strict=True):
            found[clip] = NearestExample(*examples[name][one.clip], one.cost, one.frames)
    return {clip: found[clip] for clip in clips if clip in found}
