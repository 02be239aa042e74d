"""Propose patterns for the paths of an archive: divide them into tokens that look like actor, class or number."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

from kinedex.storage.formats.motion.packed_files import split_ending

SEPARATORS = ("_", "-", " ", ".")

USUAL = 0.8
"""The smallest fraction of names that must contain a separator for it to divide them."""

_MAX_FIELDS = 12

_NUMBERED = re.compile(r"(.*?[^0-9])([0-9]+)")
_CAMEL = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])|[0-9]+")
_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])")

MAX_PATTERNS = 8
"""The largest number of patterns in a proposal; paths of further layouts count as unmatched."""

_MOTIONS = frozenset(
    """
    walk run jog jump hop skip leap kick punch box fight hit sit stand lie crouch squat kneel bend turn rotate spin
    throw catch grab pick put place deposit lift carry push pull wave clap point reach raise shake nod bow dance salsa
    climb crawl sneak march stroll strut limp step shuffle stop start idle rest sleep fall roll stretch swing swim cart
    cartwheel handstand somersault flip bounce dribble shoot pass serve golf tennis basketball guide call byebye hello
    respond greet talk phone eat drink wash sweep jacks jack lunge press gait balance motion action drive ride
    """.split()
)
_STYLES = frozenset(
    """
    angry happy sad proud tired active exhausted elderly old young youthful child childlike normal neutral masculine
    masculinity feminine femininity drunk depressed confident shy strong weak slow fast quick calm nervous sexy zombie
    robot heavy light relaxed excited afraid scared giant musical limping injured stiff soft sneaky lazy style
    """.split()
)
_PEOPLE = frozenset("s sub subj subject a actor p person participant performer perf vp proband player user id".split())
_TRIALS = frozenset("take trial t clip rep repetition no nr number recording rec c r".split())
_CODE_LETTERS = 3
_REPEATED = 2
_NEARLY = 0.8
_SHARE = 0.3
_RESERVED = frozenset(
    """take_id name source source_root checksum source_bytes source_mtime_ns format skeleton skeleton_source recipe unit
    source_rate_hz source_frames rate_hz frames seconds invalid_frames groups warnings known person persons""".split()
)


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
    return split_ending(os.path.basename(path))[0]


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
    """Return the separator that divides most names, and the function that divides a name into fields.

    Without a usual separator it is empty, and names are divided at capital letters, or before the number at their end.
    """
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

    The other fields, counted from both ends, must have common values in paths with different numbers of fields.
    """
    groups = [[stem_of(path).split(separator) for path in paths] for paths in by_count.values()]
    least = min(by_count)
    if least > _MAX_FIELDS:
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
    """Return whether all sets hold numbers only, or none does and at least half of each is also in the largest set."""
    numbers = {all(value.isdecimal() for value in values) for values in sets}
    if numbers == {True}:
        return True
    largest = max(sets, key=len)
    return numbers == {False} and all(2 * len(values & largest) >= len(values) for values in sets)


@dataclass(frozen=True)
class Token:
    """A column of a layout, with the role that it appears to have.

    Attributes
    ----------
    column : Column
        Its values.
    role : str
        The name of its group: "actor", "class", "clip", "style", "tag", …; empty if it has none.
    why : str
        The reason for the role, or for having none.
    """

    column: Column
    role: str
    why: str


@dataclass(frozen=True)
class Proposal:
    """A pattern for the paths of one layout.

    Attributes
    ----------
    layout : Layout
        The paths.
    tokens : tuple of Token
        A token for each column.
    """

    layout: Layout
    tokens: tuple[Token, ...]

    @cached_property
    def pattern(self) -> str:
        """The regular expression, with a named group for each token that has a role."""
        folders = [_expression(token, "") for token in self.tokens if token.column.folder]
        fields = [_expression(token, self.layout.separator) for token in self.tokens if not token.column.folder]
        first = next(iter(self.tokens)).column
        begin = "" if first.is_constant and first.values[0] else "(?:^|/)"
        return begin + "/".join([*folders, re.escape(self.layout.separator).join(fields)]) + r"\.[^./]+$"

    @cached_property
    def fits(self) -> bool:
        """True if the pattern extracts the values of all tokens from every path of the layout."""
        compiled = re.compile(self.pattern)
        for number, path in enumerate(self.layout.paths):
            found = compiled.search(path)
            if found is None or any(
                found[token.role] != token.column.values[number] for token in self.tokens if token.role
            ):
                return False
        return True


def propose_patterns(paths: Iterable[str]) -> list[Proposal]:
    """Propose patterns for paths, in the order in which to try them: first for deeper paths and more fields.

    Parameters
    ----------
    paths : iterable of str
        The paths of motion files below a source root, with / and endings.
    """
    found: list[Proposal] = []
    for layout in layouts(paths):
        if len(found) == MAX_PATTERNS:
            break
        proposal = Proposal(layout, tuple(_tokens(layout, found)))
        if any(token.role for token in proposal.tokens) and proposal.fits:
            found.append(proposal)
    free = [any(column.free for column in one.layout.columns) for one in found]
    order = sorted(
        range(len(found)), key=lambda n: (-found[n].layout.folders, free[n], -len(found[n].layout.columns), n)
    )
    return [found[number] for number in order]


def matched_count(proposals: Sequence[Proposal], paths: Iterable[str]) -> int:
    """Return the number of paths that at least one of the patterns matches."""
    compiled = [re.compile(proposal.pattern) for proposal in proposals]
    return sum(any(pattern.search(path) for pattern in compiled) for path in paths)


def _tokens(layout: Layout, known: Sequence[Proposal]) -> Iterator[Token]:
    """Yield each column of a layout with its role."""
    columns = layout.columns
    roles = _inherited(layout, known)
    plain = [n for n, column in enumerate(columns) if not column.is_constant and not _is_repeated(columns, n)]
    roles = {number: role for number, role in roles.items() if number in plain or columns[number].is_constant}
    for role, number in (
        ("actor", _actor(columns, plain)),
        ("clip", _clip(columns, plain)),
        ("class", _class(layout, plain)),
    ):
        if number is not None and role not in roles.values() and number not in roles:
            roles[number] = role
    taken = set(roles.values())
    for number in plain:
        if number not in roles and len(columns[number].counts) < _NEARLY * len(layout.paths):
            roles[number] = _free_name(columns[number], taken)
            taken.add(roles[number])
    for number, column in enumerate(columns):
        role = roles.get(number, "")
        yield Token(column, role, _why(layout, number, role))


def _inherited(layout: Layout, known: Sequence[Proposal]) -> dict[int, str]:
    """Return the roles of columns that look like those at the same position in a layout examined before."""
    roles: dict[int, str] = {}
    fields = [number for number, column in enumerate(layout.columns) if not column.folder]
    for proposal in known:
        others = [token for token in proposal.tokens if not token.column.folder]
        for number, token in zip(fields, others, strict=False):
            column = layout.columns[number]
            shared = set(column.counts) & set(token.column.counts)
            same = column.shapes <= token.column.shapes and token.role == "actor"
            if token.role and (shared or same) and token.role not in roles.values() and number not in roles:
                roles[number] = token.role
    return roles


def _is_repeated(columns: Sequence[Column], number: int) -> bool:
    """Return whether a column is a folder whose name another column repeats in nearly every path."""
    column = columns[number]
    others = [other for other in columns[number + 1 :] if not other.is_constant]
    return column.folder and any(
        sum(a == b for a, b in zip(column.values, other.values, strict=True)) >= _NEARLY * len(column.values)
        for other in others
    )


def _actor(columns: Sequence[Column], plain: Sequence[int]) -> int | None:
    """Return the index of the column of actors, None if there is none.

    Its values are numbers after a word for people, short codes, or the first of two or more numbers.
    """
    for number in plain:
        if columns[number].prefix.strip("-. ").lower() in _PEOPLE:
            return number
    for number in plain:
        column = columns[number]
        lengths = {len(value) for value in column.counts}
        letters = all(value.isalpha() and value.isascii() for value in column.counts)
        known = {word for words in column.words for word in words} & (_MOTIONS | _STYLES)
        if letters and lengths == {next(iter(lengths))} and max(lengths) <= _CODE_LETTERS and not known:
            return number
    numbers = [number for number in plain if columns[number].is_number]
    if len(numbers) >= _REPEATED and len(columns[numbers[0]].counts) < len(columns[numbers[0]].values):
        return numbers[0]
    return None


def _clip(columns: Sequence[Column], plain: Sequence[int]) -> int | None:
    """Return the index of the column that numbers takes, None if there is none.

    It is the last one with numbers, or with numbers after a word for takes.
    """
    for number in reversed(plain):
        if columns[number].is_number or columns[number].prefix.strip("-. ").lower() in _TRIALS:
            return number
    return None


def _share(column: Column, known: frozenset[str]) -> float:
    """Return the share of the values that contain one of the words in any form, such as walking and walks for walk."""
    hits = sum(any(_has(word, known) for word in words) for words in column.words)
    return hits / len(column.counts)


def _has(word: str, known: frozenset[str]) -> bool:
    stems = (word, *(word.removesuffix(ending) for ending in ("s", "es", "ing", "ed", "ning", "ping")))
    return any(stem in known or f"{stem}e" in known for stem in stems)


def _class(layout: Layout, plain: Sequence[int]) -> int | None:
    """Return the index of the column of classes; None if there is none.

    It is the column with the largest share of words for motions. If no column has such words, it is the one with most
    distinct values among the fields of names whose values recur.
    """
    texts = [number for number in plain if not layout.columns[number].is_number]
    texts = [number for number in texts if not layout.columns[number].prefix or layout.columns[number].free]
    columns = layout.columns
    texts = [number for number in texts if len(columns[number].counts) < _NEARLY * len(layout.paths)]
    moving = [number for number in texts if _share(columns[number], _MOTIONS) >= _SHARE]
    if moving:
        return max(moving, key=lambda n: (_share(columns[n], _MOTIONS), len(columns[n].counts)))
    repeated = [
        number
        for number in texts
        if not columns[number].folder
        and len(columns[number].counts) * _REPEATED <= len(layout.paths)
        and not _share(columns[number], _STYLES)
    ]
    return max(repeated, key=lambda n: len(columns[n].counts), default=None)


def _free_name(column: Column, taken: set[str]) -> str:
    """Return a name for a column that is neither actor, class nor clip.

    It is "style", the word before a number, "number", "folder" or "tag", with a number after it if it is in use.
    """
    word = re.sub(r"[^a-z]", "", column.prefix.lower())
    if not column.is_number and not column.prefix and _share(column, _STYLES) > 0:
        name = "style"
    elif len(word) > 1 and column.prefix.isascii():
        name = word
    else:
        name = "number" if column.is_number else "folder" if column.folder else "tag"
    if name in _RESERVED:
        name = f"{name}_of_path"
    return next(one for one in (name, *(f"{name}{n}" for n in range(2, len(taken) + 3))) if one not in taken)


def _why(layout: Layout, number: int, role: str) -> str:
    """Return a description of a column, or the reason why it has no role."""
    column = layout.columns[number]
    if not role:
        if _is_repeated(layout.columns, number):
            return "repeats the name"
        return "always the same" if column.is_constant else "differs in every file"
    looks = {"actor": "looks like people", "class": "looks like motions", "clip": "counts"}
    return looks.get(role) or ("looks like styles" if role.startswith("style") else "rename it, or leave it out")


def _expression(token: Token, separator: str) -> str:
    """Return the part of a pattern for one token."""
    column = token.column
    if column.is_constant and not token.role and not column.is_number:
        return re.escape(column.values[0]).replace(r"\-", "-").replace(r"\ ", " ")
    inner = _values_of(column, separator)
    return f"(?P<{token.role}>{inner})" if token.role else inner


def _values_of(column: Column, separator: str) -> str:
    """Return a regular expression for the values of a column."""
    if column.is_number:
        return r"\d+"
    if column.folder:
        return "[^/]+"
    if column.free:
        return "[^/]+?"
    if column.prefix:
        return re.escape(column.prefix).replace(r"\-", "-").replace(r"\ ", " ") + r"\d+"
    if not separator:
        for expression in ("[A-Z][a-z]+", "[a-z]+", "[A-Z]+"):
            if all(re.fullmatch(expression, value) for value in column.counts):
                return expression
        return "[^/]*?[^/0-9]"
    many = "*" if "" in column.counts else "+"
    return f"[^{re.escape(separator)}/]{many}".replace(r"\ ", " ")
