"""Find the node of the other side for each left and right node of a skeleton."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from kinedex.catalog.skeletons.recognition.names import NodeName, load_vocabulary, normal_names
from kinedex.catalog.skeletons.skeleton_fit import Fit
from kinedex.ops.errors import SourceError


def mirrored_nodes(source: str | Path, names: Sequence[str], parents: Sequence[int], fit: Fit) -> tuple[int, ...]:
    """Return for each node the index of its counterpart on the other side; its own index for a node in the middle.

    The skeleton mapping decides which nodes are on the left and on the right, and names decide it for the others, such
    as fingers. Both sides must have nodes of the same tree.

    Parameters
    ----------
    source : str or Path
        The file that errors name.
    names : sequence of str
        The nodes, parents first.
    parents : sequence of int
        The parent of each node, −1 for a root.
    fit : Fit
        The skeleton mapping that fits the nodes.

    Raises
    ------
    SourceError
        A node has no partner on the other side; the message names it, and the form that needs none.
    """
    sides = _sides(names, parents, fit)
    words = normal_names(names, load_vocabulary("joints"))
    children: list[list[int]] = [[] for _ in names]
    for i, parent in enumerate(parents):
        if parent >= 0:
            children[parent].append(i)
    image = [-1] * len(names)
    waiting = [(i, i) for i, parent in enumerate(parents) if parent < 0]
    while waiting:
        one, other = waiting.pop()
        image[one], image[other] = other, one
        if one != other:
            waiting += _partners(source, children[one], children[other], names, words)
            continue
        left, right, middle = ([i for i in children[one] if sides[i] == side] for side in ("l", "r", ""))
        waiting += [(i, i) for i in middle]
        waiting += _partners(source, left, right, names, words)
    return tuple(image)


def _sides(names: Sequence[str], parents: Sequence[int], fit: Fit) -> list[str]:
    """Return the side of each node, which is empty for a node in the middle.

    A node has the side of the mapped nodes at or below it; if there are none, its name decides.
    """
    below: list[set[str]] = [set() for _ in names]
    for joint, mix in fit.joints.items():
        if mix is not None and mix.node is not None and (i := fit.indices[mix.node]) < len(names):
            below[i].add(
                joint[0] if joint[0] in "lr" and f"{'r' if joint[0] == 'l' else 'l'}{joint[1:]}" in fit.joints else ""
            )
    for i in range(len(names) - 1, -1, -1):
        if parents[i] >= 0:
            below[parents[i]] |= below[i]
    named = normal_names(names, load_vocabulary("joints"))
    return [
        next(iter(found)) if len(found) == 1 else "" if found else name.side
        for found, name in zip(below, named, strict=True)
    ]


def _partners(
    source: str | Path, left: list[int], right: list[int], names: Sequence[str], words: Sequence[NodeName]
) -> list[tuple[int, int]]:
    """Return the pairs of corresponding left and right nodes.

    Nodes are paired by their names without the side; if these do not match, in the order of the file.
    """
    keys = [{(words[i].key, words[i].ordinals, words[i].end): i for i in side} for side in (left, right)]
    if keys[0].keys() == keys[1].keys() and len(keys[0]) == len(left) == len(right):
        return [(i, keys[1][key]) for key, i in keys[0].items()]
    if len(left) == len(right):
        return list(zip(left, right, strict=True))
    few, many = sorted((left, right), key=len)
    odd = [i for i in many if not any(words[i].key == words[j].key for j in few)] or many
    shown = ", ".join(f"'{names[i]}'" for i in odd[:5]) + (" …" if len(odd) > 5 else "")
    raise SourceError(
        source,
        f"cannot be mirrored: {shown} of one side {'has' if len(odd) == 1 else 'have'} no partner on the other; mirror "
        "the 24 joints instead (kinedex export --joints)",
    )
