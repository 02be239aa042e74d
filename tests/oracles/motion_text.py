"""Naive twins of the parsers of AMC and BVH: the whole text at once, line by line and word by word."""

from __future__ import annotations

import re
from collections.abc import Sequence


def lines_of(text: str) -> list[list[str]]:
    """Return the words of every line that is neither blank nor a comment; every known end of a line ends one."""
    lines = [re.findall(r"[^ \t]+", line) for line in re.split(r"\r\n|\r|\n", text)]
    return [words for words in lines if words and not words[0].startswith("#")]


def rows(text: str) -> list[list[float]]:
    """Return the numbers of a BVH file behind its frame time."""
    found = re.search(r"Frame Time:[^\r\n]*", text)
    assert found is not None
    return [[float(word) for word in words] for words in lines_of(text[found.end() :])]


def frames(text: str, bones: Sequence[str]) -> list[list[float]]:
    """Return the numbers of an AMC file, those of the bones of a frame one after the other in a given order."""
    found: list[dict[str, list[float]]] = []
    for words in lines_of(text):
        if words[0].isdigit():
            found.append({})
        elif found:
            found[-1][words[0]] = [float(word) for word in words[1:]]
    return [[number for bone in bones for number in frame[bone]] for frame in found]
