"""The figures of a scene with their clips: the nodes of each, their names, and the one that is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from kinedex.ops.errors import SourceError


@dataclass(frozen=True)
class Group:
    """The nodes of one figure in a scene.

    Attributes
    ----------
    nodes : tuple of int
        Indices in the scene, parents first; the first is the top of the figure.
    parents : tuple of int
        Index in `nodes` of the nearest node above each; −1 for the first.
    """

    nodes: tuple[int, ...]
    parents: tuple[int, ...]

    def chain(self, above: Sequence[int]) -> tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]:
        """Return the nodes with all that they hang from, their parents, and the places of the figure's own in them.

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
    """Return the nodes of a scene, every node after the one that it hangs from; nodes in circles are left out."""
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
    """Return the figures of a scene: every bone that hangs from no other, with the nodes below it.

    Parameters
    ----------
    above : sequence of int
        The parent of every node of the scene; −1 for roots.
    bones : set of int
        The nodes that are surely bones.
    shown : set of int
        The nodes that a figure may have: bones, and ends of bones, but no meshes or cameras.
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


class NamedClip(Protocol):
    """A clip of a figure, with the names of both."""

    @property
    def figure(self) -> str:
        """The name of the figure."""

    @property
    def clip(self) -> str:
        """The name of the clip."""


def clip_names(clips: Sequence[NamedClip]) -> tuple[str, ...]:
    """Return a name for each clip of each figure: of the figure, of the clip, or of both, as far as they differ."""
    figures = len({clip.figure for clip in clips}) > 1
    several = len({clip.clip for clip in clips}) > 1
    found = []
    for clip in clips:
        parts = [clip.figure] if figures else []
        found.append(" ".join([*parts, clip.clip] if several or not figures else parts))
    return unique_names(found)


def unique_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return the names, later ones of equal names with a number: `Hips`, `Hips (2)`."""
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
    """Return the index of the person to read; a SourceError lists those of the file where it is not clear which."""
    if not persons or (len(persons) == 1 and not person):
        return 0
    if person in persons:
        return list(persons).index(person)
    listed = ", ".join(f"'{name}'" for name in persons[:20])
    if person:
        raise SourceError(path, f"has no person '{person}'; it has {listed}")
    raise SourceError(path, f"holds {len(persons)} figures or clips: {listed}; give one of them as `person`")
