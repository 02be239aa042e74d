"""Names of nodes and markers in one form: side, words and numbers, looked up in a vocabulary of synonyms."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Literal, TypeAlias

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, load_yaml, shipped_configs

Side: TypeAlias = Literal["l", "r", ""]

LONGEST_PREFIX = 100
"""Maximum number of characters of a shared prefix, which limits the number of prefixes that are tried for a very long
name.
"""

_WORD = re.compile(r"[^\W\d_]+|\d+")
_CAMEL = re.compile(r"[A-Z]+(?=[A-Z][a-z])|[A-Z]?[^A-Z]+|[A-Z]+")
_SECOND = re.compile(r"#\d+$")  # the suffix that readers add to repeated names
_LONGEST = 100  # only so many characters at the end of a name are parsed
_VERTEBRA = re.compile(r"(?:^|[^A-Za-z])([LTCltc]\d{1,2})$")


@dataclass(frozen=True)
class NodeName:
    """A name of a node or marker in normal form.

    Attributes
    ----------
    text : str
        The name as the file has it.
    side : str
        "l", "r", or empty if the name states no side.
    words : tuple of str
        Its words in lower case, without prefix, side, numbers and marks of an end.
    ordinals : tuple of int
        The numbers after the last word.
    end : bool
        True if the name marks the end of a bone, as `HeadTop_End`, `Bip01 HeadNub`, `LeftToe_end`.
    """

    text: str
    side: Side = ""
    words: tuple[str, ...] = ()
    ordinals: tuple[int, ...] = ()
    end: bool = False

    @property
    def key(self) -> str:
        """Return the words concatenated, the form in which a vocabulary lists them."""
        return "".join(self.words)


class _VocabularyFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = ""
    description: str = ""
    left: list[str] = Field(default_factory=list)
    right: list[str] = Field(default_factory=list)
    ends: list[str] = Field(default_factory=list)
    ignored: list[str] = Field(default_factory=list)
    terms: dict[str, list[str]]


@dataclass(frozen=True, eq=False)
class Vocabulary:
    """Synonyms by the part of the body that they name.

    Attributes
    ----------
    terms : Mapping[str, tuple of str]
        Part → its synonyms in normal form. One synonym may stand under several parts; geometry then decides.
    left, right : frozenset of str
        Words that state a side.
    ends : frozenset of str
        Words that mark the end of a bone.
    ignored : frozenset of str
        Words without meaning, which prefix or follow names.
    """

    terms: Mapping[str, tuple[str, ...]]
    left: frozenset[str] = frozenset()
    right: frozenset[str] = frozenset()
    ends: frozenset[str] = frozenset()
    ignored: frozenset[str] = frozenset()
    _splits: dict[str, NodeName] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def by_key(self) -> dict[str, tuple[str, ...]]:
        """Return a dict from synonym to the parts that it may name."""
        found: dict[str, tuple[str, ...]] = {}
        for part, synonyms in self.terms.items():
            for synonym in synonyms:
                found[synonym] = (*found.get(synonym, ()), part)
        return found

    def parts(self, name: NodeName) -> tuple[str, ...]:
        """Return the parts that a name may mean, by all its words or, failing that, by the last ones of them."""
        for start in range(len(name.words)):
            key = "".join(name.words[start:])
            if key in self.by_key:
                return self.by_key[key]
        return ()

    def merged(self, others: Iterable[Vocabulary]) -> Vocabulary:
        """Return this vocabulary with the terms of others, such as those of a user, added."""
        terms = {part: list(synonyms) for part, synonyms in self.terms.items()}
        left, right, ends, ignored = set(self.left), set(self.right), set(self.ends), set(self.ignored)
        for other in others:
            for part, synonyms in other.terms.items():
                terms.setdefault(part, []).extend(synonyms)
            left |= other.left
            right |= other.right
            ends |= other.ends
            ignored |= other.ignored
        unique = {part: tuple(dict.fromkeys(synonyms)) for part, synonyms in terms.items()}
        return Vocabulary(unique, frozenset(left), frozenset(right), frozenset(ends), frozenset(ignored))


def load_vocabulary(path: str | Path, parts: Iterable[str] = ()) -> Vocabulary:
    """Read a vocabulary of names.

    Parameters
    ----------
    path : path
        A YAML file, or the name of a shipped one in `configs/names/`.
    parts : iterable of str
        The parts that may be named; empty if the file defines its own.

    Raises
    ------
    ConfigError
        At the first fault, with its file, line and key.
    """
    file = Path(path)
    return _load(file if file.suffix else shipped_configs() / "names" / f"{path}.yaml", tuple(parts))


@lru_cache(maxsize=16)
def _load(path: Path, parts: tuple[str, ...]) -> Vocabulary:
    return parse_vocabulary(load_yaml(path), parts)


def parse_vocabulary(located: Located, parts: tuple[str, ...] = ()) -> Vocabulary:
    """Return the vocabulary of a parsed file; parameters and errors as for `load_vocabulary`."""
    located.mapping()
    parsed = located.model(_VocabularyFile)
    return Vocabulary(
        terms={part: _keys(located, parsed, part, parts) for part in parsed.terms},
        left=frozenset(word.lower() for word in parsed.left),
        right=frozenset(word.lower() for word in parsed.right),
        ends=frozenset(word.lower() for word in parsed.ends),
        ignored=frozenset(word.lower() for word in parsed.ignored),
    )


def _keys(located: Located, parsed: _VocabularyFile, part: str, parts: tuple[str, ...]) -> tuple[str, ...]:
    """Return the synonyms of a part without spaces and case; raise a ConfigError if there is no such part."""
    if parts and part not in parts:
        raise located.error(f"no such part; expected one of {', '.join(parts)}", "terms", part)
    keys = []
    for i, synonym in enumerate(parsed.terms[part]):
        key = "".join(re.findall(r"[^\W_]", synonym)).lower()
        if not key:
            raise located.error(f"a synonym needs letters, got {synonym!r}", "terms", part, i)
        keys.append(key)
    return tuple(dict.fromkeys(keys))


def normal_names(names: Sequence[str], vocabulary: Vocabulary) -> tuple[NodeName, ...]:
    """Return the names of one body in normal form, without the words that most of them begin with.

    Parameters
    ----------
    names : sequence of str
        The names in the file.
    vocabulary : Vocabulary
        Its terms are never taken for a prefix, and a side that is glued to one of them is found (`lcollar`).
    """
    found = [split_name(name, vocabulary) for name in names]
    while True:
        firsts = Counter(name.words[0] for name in found if len(name.words) > 1)
        word, count = max(firsts.items(), key=lambda item: item[1], default=("", 0))
        if 2 * count <= len(found) or word in vocabulary.by_key:
            return tuple(found)
        found = [
            replace(name, words=name.words[1:]) if len(name.words) > 1 and name.words[0] == word else name
            for name in found
        ]


def split_name(text: str, vocabulary: Vocabulary) -> NodeName:
    """Return one name in normal form, without the prefix that ends with a colon or bar."""
    known = vocabulary._splits.get(text)
    if known is None:
        if len(vocabulary._splits) > 20_000:
            vocabulary._splits.clear()
        known = vocabulary._splits[text] = _split(text, vocabulary)
    return known


def _split(text: str, vocabulary: Vocabulary) -> NodeName:
    short = re.split(r"[:|]", _SECOND.sub("", text[-_LONGEST:]).rstrip(":|"))[-1]
    tokens = [part for word in _WORD.findall(short) for part in ([word] if word.isdigit() else _CAMEL.findall(word))]
    vertebra = _VERTEBRA.search(short)
    if vertebra and vertebra[1].lower() in vocabulary.by_key:
        before = [token.lower() for token in tokens[:-2]]
        if not any(token in vocabulary.by_key and "spine" not in vocabulary.by_key[token] for token in before):
            return NodeName(text, "", (vertebra[1].lower(),))
    side: Side = ""
    words: list[str] = []
    whole: list[str] = []
    numbers: list[int] = []
    end = False
    for token in tokens:
        lower = token.lower()
        if token.isdigit():
            numbers.append(int(token[:9]))
        elif lower in vocabulary.ends:
            end = True
        elif not side and (lower in vocabulary.left or lower in vocabulary.right):
            side = "l" if lower in vocabulary.left else "r"
        else:
            if not side:
                side, lower = _unglued(lower, vocabulary)
            whole.append(lower)
            if lower not in vocabulary.ignored:
                words.append(lower)
                numbers.clear()
            elif not words:
                numbers.clear()
    if "".join(whole) in vocabulary.by_key:  # as `hipjoint`, though `joint` alone means nothing
        words = whole
    return NodeName(text, side, tuple(words), tuple(numbers), end)


def _unglued(word: str, vocabulary: Vocabulary) -> tuple[Side, str]:
    """Return the side that is glued to a known word, as in `lcollar` and `rightupleg`, and the word without it."""
    if word in vocabulary.by_key or word in vocabulary.ignored:
        return "", word
    sides: tuple[tuple[Side, frozenset[str]], ...] = (("l", vocabulary.left), ("r", vocabulary.right))
    for side, marks in sides:
        for mark in marks:
            if word.startswith(mark) and word[len(mark) :] in vocabulary.by_key:
                return side, word[len(mark) :]
            if word.endswith(mark) and word[: -len(mark)] in vocabulary.by_key:
                return side, word[: -len(mark)]
    return "", word
