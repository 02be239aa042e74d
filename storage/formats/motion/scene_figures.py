"""Choose a figure and clip of a scene: the nodes of each figure, their names, and the one to read."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Generic, TypeVar

from kinedex.ops.errors import SourceError

Content = TypeVar("Content")


@dataclass(frozen=True)
class Group:
    """The nodes of one figure in a scene.

    Attributes
    ----------
    nodes : tuple of int
        Indices in the scene, parents first; the first is the top of the figure.
    parents : tuple of int
        Index in `nodes` of the nearest ancestor of each; −1 for the first.
    """

    nodes: tuple[int, ...]
    parents: tuple[int, ...]

    def chain(self, above: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
        """Return the nodes with all their ancestors, and the parents and the figure's nodes as indices into these.

        Parameters
        ----------
        above : sequence of int
            The parent of every node of the scene; −1 for roots.
        """
        needed: set[int] = set()
        for node in self.nodes:
            while node >= 0 and node not in needed:
                needed.add(node)
                node = above[node]
        chain = [node for node in parents_first(above) if node in needed]
        place = {node: i for i, node in enumerate(chain)}
        parents = tuple(place[above[node]] if above[node] >= 0 else -1 for node in chain)
        return tuple(chain), parents, tuple(place[node] for node in self.nodes)


def parents_first(above: Sequence[int]) -> list[int]:
    """Return the nodes of a scene, each after its parent; nodes in cycles are left out."""
    below: list[list[int]] = [[] for _ in above]
    for node, parent in enumerate(above):
        if parent >= 0:
            below[parent].append(node)
    order: list[int] = []
    waiting = [node for node, parent in enumerate(above) if parent < 0][::-1]
    while waiting:
        node = waiting.pop()
        order.append(node)
        waiting += reversed(below[node])
    return order


def groups_of(above: Sequence[int], bones: set[int], shown: set[int]) -> list[Group]:
    """Return the figures of a scene: every bone without a bone above it, with its descendants.

    Parameters
    ----------
    above : sequence of int
        The parent of every node of the scene; −1 for roots.
    bones : set of int
        The nodes that are certainly bones.
    shown : set of int
        The nodes that may belong to a figure: bones, and ends of bones, but no meshes or cameras.
    """
    nearest: dict[int, int] = {}  # the nearest node of a figure at or above each node
    top: dict[int, int] = {}
    members: dict[int, list[int]] = {}
    for node in parents_first(above):
        parent = above[node]
        inside = parent in top
        if inside:
            top[node], nearest[node] = top[parent], nearest[parent]
        elif node in bones:
            top[node] = node
            members[node] = []
        if node in top and (node in shown or node in bones):
            members[top[node]].append(node)
            nearest[node] = node
    groups = []
    for nodes in members.values():
        place = {node: i for i, node in enumerate(nodes)}
        groups.append(Group(tuple(nodes), (-1, *(place[nearest[above[node]]] for node in nodes[1:]))))
    return groups


@dataclass(frozen=True)
class FigureClip(Generic[Content]):
    """A clip of a figure: the figure's nodes, the clip's content in the file, and the names of figure and clip."""

    group: Group
    content: Content
    figure: str
    clip: str


def figure_clips(
    figures: Sequence[tuple[Group, str]], clips: Sequence[tuple[Content, str, Collection[int | None]]]
) -> list[FigureClip[Content]]:
    """Return the clips that move each figure, from figures with their names, and clips with names and moved nodes."""
    called = unique_names([name for _, name in figures])
    names = unique_names([name for _, name, _ in clips])
    return [
        FigureClip(group, content, figure, name)
        for (group, _), figure in zip(figures, called, strict=True)
        for (content, _, moved), name in zip(clips, names, strict=True)
        if not set(group.nodes).isdisjoint(moved)
    ]


def chosen_clip(path: Path, person: str, clips: Sequence[FigureClip[Content]]) -> FigureClip[Content]:
    """Return the clip that is read as a person; raise a SourceError that lists them if the choice is not clear."""
    return clips[chosen_person(path, person, clip_names(clips))]


def clip_names(clips: Sequence[FigureClip[Content]]) -> tuple[str, ...]:
    """Return a name for each clip of each figure: the figure's, the clip's, or both, as needed to tell them apart."""
    figures = len({clip.figure for clip in clips}) > 1
    several = len({clip.clip for clip in clips}) > 1
    found = []
    for clip in clips:
        parts = [clip.figure] if figures else []
        found.append(" ".join([*parts, clip.clip] if several or not figures else parts))
    return unique_names(found)


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, with numbers added to repeated ones: `Hips`, `Hips (2)`."""
    taken: set[str] = set()
    found = []
    count: dict[str, int] = {}
    for name in names:
        own = name
        while own in taken:
            count[name] = count.get(name, 1) + 1
            own = f"{name} ({count[name]})"
        taken.add(own)
        found.append(own)
    return tuple(found)


def chosen_person(path: Path, person: str, persons: Sequence[str]) -> int:
    """Return the index of the person to read; raise a SourceError that lists the persons if the choice is not clear."""
    if not persons or (len(persons) == 1 and not person):
        return 0
    if person in persons:
        return list(persons).index(person)
    listed = ", ".join(f"'{name}'" for name in persons[:20])
    if person:
        raise SourceError(path, f"has no person '{person}'; it has {listed}")
    raise SourceError(path, f"holds {len(persons)} figures or clips: {listed}; give one of them as `person`")
