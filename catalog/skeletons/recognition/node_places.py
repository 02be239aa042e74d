"""Read the names of nodes together with their places in the tree, which correct names that are wrong or say nothing.

The tree shows more than the names: a node between two nodes of the left side is on the left, a twist joint before a
joint of the same name is no joint of its own, and a node with an unknown name is the same part as its partner on the
other side.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

from kinedex.catalog.skeletons.recognition.names import NodeName, Side, Vocabulary, load_vocabulary, normal_names

_PLAIN = re.compile(r"[\W_]+")
_TWIST = re.compile("twist|roll")
_SIDES: tuple[Side, Side] = ("l", "r")
_ARMS = frozenset({"clavicle", "upperarm"})


def other_side(side: Side) -> Side:
    """Return the opposite of a side; empty for none."""
    return "r" if side == "l" else "l" if side == "r" else ""


def exchanged_names(names: Sequence[str], parents: Sequence[int]) -> tuple[tuple[int, int], ...]:
    """Return the pairs of nodes with exchanged names, because each lies in a branch of the other side.

    At least two nodes above and below each must be named for the other side, and more than twice as many as for its
    own. If left and right of a whole branch are exchanged, no names contradict each other, and none are returned.

    Parameters
    ----------
    names : sequence of str
        The nodes, parents first.
    parents : sequence of int
        The parent of each node, −1 for a root.
    """
    return _exchanged(tuple(names), tuple(parents))


@lru_cache(maxsize=256)  # The takes of an archive share a few skeletons.
def _exchanged(names: tuple[str, ...], parents: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    words = normal_names(names, load_vocabulary("joints"))
    sites = [parent >= 0 and name == f"{names[parent]}_end" for name, parent in zip(names, parents, strict=True)]
    left, right = (_beside(words, parents, sites, side) for side in _SIDES)
    wrong: dict[tuple[Side, str, tuple[int, ...]], int] = {}
    found = []
    for i, name in enumerate(words):
        own, other = (left[i], right[i]) if name.side == "l" else (right[i], left[i])
        if not name.side or sites[i] or other < 2 or other <= 2 * own:
            continue
        twin = wrong.pop((other_side(name.side), name.key, name.ordinals), None)
        if twin is not None:
            found.append((twin, i))
        else:
            wrong[name.side, name.key, name.ordinals] = i
    return tuple(found)


def _beside(words: Sequence[NodeName], parents: Sequence[int], sites: Sequence[bool], side: Side) -> list[int]:
    """Return for each node the number of nodes above and below it that are named for a side, without End Sites."""
    own = [name.side == side and not site for name, site in zip(words, sites, strict=True)]
    above, below = [0] * len(words), [0] * len(words)
    for i, parent in enumerate(parents):
        if parent >= 0:
            above[i] = above[parent] + own[parent]
    for i in range(len(words) - 1, -1, -1):
        if parents[i] >= 0:
            below[parents[i]] += below[i] + own[i]
    return [a + b for a, b in zip(above, below, strict=True)]


def with_exchanged(names: Sequence[str], pairs: Sequence[tuple[int, int]]) -> tuple[str, ...]:
    """Return names with those of each pair exchanged, and those of End Sites, which contain the name of their node."""
    found = list(names)
    for a, b in pairs:
        one, other = names[a], names[b]
        for i, name in enumerate(names):
            if name in (one, f"{one}_end"):
                found[i] = other + name[len(one) :]
            elif name in (other, f"{other}_end"):
                found[i] = one + name[len(other) :]
    return tuple(found)


def exchange_warning(names: Sequence[str], pairs: Sequence[tuple[int, int]]) -> list[str]:
    """Return a warning on pairs of nodes that are read with each other's name; empty if there are none."""
    if not pairs:
        return []
    shown = ", ".join(f"'{names[a]}' and '{names[b]}'" for a, b in pairs)
    return [f"the names {shown} are exchanged: each lies in a branch of the other side, and is read as the other"]


def twist_nodes(names: Sequence[str], parents: Sequence[int]) -> frozenset[int]:
    """Return the nodes that only divide a bone: each is named as the twist of its only child, as `NeckTwist` of `Neck`.

    Parameters
    ----------
    names, parents
        As for `exchanged_names`.
    """
    short = [_PLAIN.sub("", name.lower()) for name in names]
    children: list[list[int]] = [[] for _ in names]
    for i, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(i)
    plain = [_TWIST.sub("", name) for name in short]
    return frozenset(
        i
        for i, below in enumerate(children)
        if parents[i] >= 0 and len(below) == 1 and plain[i] != short[i] and plain[i] == short[below[0]]
    )


def placed_names(
    names: tuple[NodeName, ...], parents: Sequence[int], children: Sequence[Sequence[int]], vocabulary: Vocabulary
) -> tuple[NodeName, ...]:
    """Return names in which unknown ones are replaced: by that of the partner on the other side, or by neck.

    The partner of a node with an unknown name is the only named node, below the same parent or the parent's partner,
    that has no partner yet. A node between the place where the arms begin and the head is a neck.

    Parameters
    ----------
    names : tuple of NodeName
        The N nodes, parents first.
    parents : sequence of int
        The parent of each node, −1 for a root.
    children : sequence of sequence of int
        The children of each node.
    vocabulary : Vocabulary
        The names of parts.
    """
    known = [bool(vocabulary.parts(name)) or name.end for name in names]
    if all(known):
        return names
    found = list(names)
    _name_partners(found, known, children, parents)
    for i in range(len(found)):
        if not known[i] and parents[i] >= 0 and _is_neck(found, i, parents, children, vocabulary):
            found[i] = replace(found[i], side="", words=("neck",), ordinals=(), end=False)
    return tuple(found)


def _name_partners(
    found: list[NodeName], known: list[bool], children: Sequence[Sequence[int]], parents: Sequence[int]
) -> None:
    """Give nodes with unknown names the names of their partners, from the roots down, in place."""
    waiting = [(i, i) for i, parent in enumerate(parents) if parent < 0]
    while waiting:
        one, other = waiting.pop()
        mine = {(found[i].side, found[i].key, found[i].ordinals): i for i in children[one] if known[i]}
        theirs = {(found[i].side, found[i].key, found[i].ordinals): i for i in children[other] if known[i]}
        lone = {i for i in children[one] if not known[i] and children[i]}
        if one != other:
            lone |= {i for i in children[other] if not known[i] and children[i]}
        pairs, alone = [], []
        for (side, key, ordinals), i in mine.items() | (theirs.items() if one != other else set()):
            if not side:
                waiting.append((i, i))
                continue
            where = mine if one == other or i in children[other] else theirs
            partner = where.get((other_side(side), key, ordinals))
            if partner is None and children[i]:
                alone.append(i)
            elif partner is not None and side == "l":
                pairs.append((i, partner))
        if len(lone) == 1 and len(alone) == 1 and (one == other or _apart(alone[0], min(lone), children[one])):
            node, twin = min(lone), alone[0]
            found[node] = replace(
                found[node], side=other_side(found[twin].side), words=found[twin].words, ordinals=found[twin].ordinals
            )
            known[node] = True
            pairs.append((twin, node))
        waiting += pairs


def _apart(a: int, b: int, siblings: Sequence[int]) -> bool:
    return (a in siblings) != (b in siblings)


def _is_neck(
    names: Sequence[NodeName], at: int, parents: Sequence[int], children: Sequence[Sequence[int]], known: Vocabulary
) -> bool:
    """Return whether a node begins beside the arms and leads to the head or to another neck."""
    up = [{*known.parts(names[child])} for child in children[at]]
    beside = {names[i].side for i in children[parents[at]] if {*known.parts(names[i])} & _ARMS}
    return len(up) == 1 and bool(up[0] & {"head", "neck"}) and "helper" not in up[0] and beside >= {"l", "r"}
