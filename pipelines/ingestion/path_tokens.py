"""Divide file paths into tokens: the columns that the paths of an archive have in common, for proposing patterns.

Paths of one layout have the same number of folders, and the same number of fields in their names, between separators
that are found from all names. Nothing but the text of the paths is used.
"""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

SEPARATORS = ("_", "-", " ", ".")

USUAL = 0.8
"""The smallest fraction of names that must contain a separator for it to divide them."""

_MOST_FIELDS = 12

_NUMBERED = re.compile(r"(.*?[^0-9])([0-9]+)")
_CAMEL = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+")
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")


@dataclass(frozen=True)
class Column:
    """The values of one token in all paths of a layout.

    Attributes
    ----------
    values : tuple of str
        The value in each path.
    folder : bool
        True for a folder, False for a field of the file's name.
    free : bool
        True for a field that contains separators itself.
    """

    values: tuple[str, ...]
    folder: bool = False
    free: bool = False

    @cached_property
    def counts(self) -> Counter[str]:
        """The number of paths with each value."""
        return Counter(self.values)

    @property
    def is_constant(self) -> bool:
        """True if all paths have the same value."""
        return len(self.counts) == 1

    @cached_property
    def is_number(self) -> bool:
        """True if every value consists of digits."""
        return all(re.fullmatch(r"[0-9]+", value) for value in self.counts)

    @cached_property
    def prefix(self) -> str:
        """The letters before the number, if every value is a number after the same letters; empty otherwise."""
        found = [re.fullmatch(r"([^0-9]+)[0-9]+", value) for value in self.counts]
        prefixes = {match[1] for match in found if match is not None}
        return prefixes.pop() if len(prefixes) == 1 and all(found) else ""

    @cached_property
    def shapes(self) -> frozenset[str]:
        """The shapes of the values: letters become "a", digits become "9"."""
        return frozenset(re.sub(r"[^\W\d_]", "a", re.sub(r"[0-9]", "9", value)) for value in self.counts)

    @cached_property
    def words(self) -> list[list[str]]:
        """The words of each distinct value, in lower case."""
        return [[word.lower() for word in _WORDS.findall(value)] for value in self.counts]


@dataclass(frozen=True)
class Layout:
    """Paths that have the same columns.

    Attributes
    ----------
    paths : tuple of str
        The paths.
    columns : tuple of Column
        The columns: folders first, then the fields of the name.
    separator : str
        The text between two fields; empty if there is none.
    """

    paths: tuple[str, ...]
    columns: tuple[Column, ...]
    separator: str

    @property
    def folders(self) -> int:
        """The number of folders in each path."""
        return sum(column.folder for column in self.columns)


def layouts(paths: Iterable[str]) -> list[Layout]:
    """Divide paths into layouts, sorted by descending number of paths.

    Parameters
    ----------
    paths : iterable of str
        The paths below a source root, with / and endings.
    """
    found: list[Layout] = []
    by_depth: dict[int, list[str]] = {}
    for path in dict.fromkeys(paths):
        by_depth.setdefault(path.count("/"), []).append(path)
    for same in by_depth.values():
        found += _of_depth(same)
    return sorted(found, key=lambda layout: (-len(layout.paths), layout.paths[0]))


def stem_of(path: str) -> str:
    """Return the name of a file without its folder and extension."""
    return os.path.splitext(os.path.basename(path))[0]


def _of_depth(paths: list[str]) -> list[Layout]:
    """Return the layouts of paths of the same depth, whose names are divided by one separator."""
    separator, split = _splitter([stem_of(path) for path in paths])
    by_count: dict[int, list[str]] = {}
    for path in paths:
        by_count.setdefault(len(split(stem_of(path))), []).append(path)
    if len(by_count) > 1 and separator and (merged := _with_free_field(by_count, separator)) is not None:
        return [merged]
    return [_layout(those, [split(stem_of(path)) for path in those], separator) for those in by_count.values()]


def _layout(paths: Sequence[str], fields: Sequence[Sequence[str]], separator: str, free: int = -1) -> Layout:
    folders = zip(*(path.split("/")[:-1] for path in paths), strict=True)
    columns = [Column(values, folder=True) for values in folders]
    columns += [Column(values, free=number == free) for number, values in enumerate(zip(*fields, strict=True))]
    return Layout(tuple(paths), tuple(columns), separator)


def _splitter(stems: Sequence[str]) -> tuple[str, Callable[[str], list[str]]]:
    """Return the separator that divides most names, and the function that divides a name by it."""
    for separator in SEPARATORS:
        if sum(separator in stem.strip(separator) for stem in stems) >= USUAL * len(stems):
            return separator, lambda stem, by=separator: stem.split(by)
    camel = {tuple(map(bool, _CAMEL.findall(stem))) for stem in stems}
    whole = all("".join(_CAMEL.findall(stem)) == stem for stem in stems)
    if whole and len(camel) == 1 and len(next(iter(camel))) > 1 and len(stems) > 1:
        return "", _CAMEL.findall
    return "", _numbered


def _numbered(stem: str) -> list[str]:
    """Split a name before the number at its end; a name without such a number is the only part."""
    found = _NUMBERED.fullmatch(stem)
    return [found[1], found[2]] if found else [stem]


def _with_free_field(by_count: dict[int, list[str]], separator: str) -> Layout | None:
    """Return a layout in which one field contains separators itself; None if the names have no fields in common.

    The other fields, counted from both ends, have common values whatever the number of fields.
    """
    groups = [[stem_of(path).split(separator) for path in paths] for paths in by_count.values()]
    least = min(by_count)
    if least > _MOST_FIELDS:
        return None
    best: tuple[int, int] | None = None
    for before in range(least):
        after = least - 1 - before
        if least > 1 and all(
            _alike([{names[place] for names in group} for group in groups])
            for place in [*range(before), *range(-after, 0)]
        ):
            cost = sum(
                len({_joined(names, before, after, separator)[place] for group in groups for names in group})
                for place in range(least)
            )
            best = min(best or (cost, before), (cost, before))
    if best is None:
        return None
    before, after = best[1], least - 1 - best[1]
    paths = [path for those in by_count.values() for path in those]
    fields = [_joined(names, before, after, separator) for group in groups for names in group]
    return _layout(paths, fields, separator, free=before)


def _joined(names: list[str], before: int, after: int, separator: str) -> list[str]:
    middle = separator.join(names[before : len(names) - after])
    return [*names[:before], middle, *names[len(names) - after :]]


def _alike(sets: Sequence[set[str]]) -> bool:
    """Return whether sets of values are of one kind: all numbers, or each with half its values in the largest set."""
    numbers = {all(value.isdecimal() for value in values) for values in sets}
    if numbers == {True}:
        return True
    largest = max(sets, key=len)
    return numbers == {False} and all(2 * len(values & largest) >= len(values) for values in sets)
