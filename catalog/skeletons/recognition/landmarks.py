"""Define the vocabulary of points: landmarks, joint centres, keypoints, and the joints computed from them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, load_yaml, shipped_configs
from kinedex.catalog.skeletons.recognition.names import LONGEST_PREFIX
from kinedex.catalog.skeletons.skeleton_fit import KINDS, Chord, Mix
from kinedex.ops.errors import did_you_mean

_WORD = re.compile(r"[^\W_]+")
_EXPLICIT = ("joint", "center", "centre", "jc")  # words that mark a label of a marker set as a joint
_MAX_CHOICES = 16  # alternatives of a joint; more never help
_LOOKED_AT = 60  # most labels in which a prefix without a separator is searched
_ARM = 4  # least labels of a set for one arm, which do not say of which
_UNUSED = "unused"  # such labels that are of no use
_SKIN = 3  # least labels of skin landmarks in a file of markers
_TRUNK = ("lasis", "rasis", "lpsis", "rpsis", "sacrum", "c7", "clav", "t10", "strn")
"""Landmarks of the trunk, some of which every set of skin markers has."""

_MODEL = "OALP"  # last letters in Vicon's names of segment origins and axes, which are no markers
_FEW_OF_MODEL = 3  # of these four, which make a segment although one of them is missing

_MODEL_JOINTS = {"FEP": "hjc", "FEO": "kjc", "TIO": "ajc", "CLO": "sjc", "HUO": "ejc", "RAO": "wjc"}
"""Vicon's names of those that are joint centres: origins of segments, and the upper end of the thigh."""


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid")
    sided: dict[str, list[str]] = Field(default_factory=dict)
    middle: dict[str, list[str]] = Field(default_factory=dict)
    clusters: dict[str, list[str]] = Field(default_factory=dict)
    arm: dict[str, list[str]] = Field(default_factory=dict)
    spine: list[str] = Field(default_factory=list)


class _Set(BaseModel):
    model_config = ConfigDict(extra="forbid")
    labels: list[str]
    least: int
    joints: dict[str, list[dict[str, Any]]]


class _LandmarkFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str
    description: str = ""
    left: list[str]
    right: list[str]
    suffixes: list[str] = Field(default_factory=list)
    skin: _Part
    centres: _Part
    orders: dict[str, list[str]] = Field(default_factory=dict)
    points: dict[str, list[dict[str, Any]]]
    joints: dict[str, list[dict[str, Any]]]
    sets: dict[str, _Set] = Field(default_factory=dict)


class _OwnFile(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = ""
    description: str = ""
    left: list[str] = Field(default_factory=list)
    right: list[str] = Field(default_factory=list)
    suffixes: list[str] = Field(default_factory=list)
    skin: _Part = Field(default_factory=_Part)
    centres: _Part = Field(default_factory=_Part)


@dataclass(frozen=True)
class Choice:
    """One way to compute a joint: weights over landmarks and points, and an offset along the normal of their plane.

    Attributes
    ----------
    weights : tuple of (str, float)
        Landmark or point → weight; the weights add up to 1.
    plane, out : tuple of str, float
        As in `Mix`, over landmarks; `joint lhip` stands for a joint, `point lgrip` for a point of several landmarks.
    kind : type of Mix
        The kind of the offset.
    estimated : str
        A phrase if this is an estimate; empty for a regression.
    rough : bool
        True for an estimate that may be more than 5 cm off.
    last : bool
        True for an estimate that serves only where there is no other choice, not in frames where another is hidden.
    """

    weights: tuple[tuple[str, float], ...]
    plane: tuple[str, ...] = ()
    out: float = 0.0
    kind: type[Mix] = Mix
    estimated: str = ""
    rough: bool = False
    last: bool = False


@dataclass(frozen=True)
class MarkerSet:
    """A marker set with a convention of its own.

    Attributes
    ----------
    labels : tuple of str
        Its labels of both sides in lower case.
    least : int
        The smallest number of them by which the set is recognised.
    joints : dict of str to tuple of Choice
        The alternatives of joints in this set, which are tried before those of `Landmarks.joints`.
    """

    labels: frozenset[str]
    least: int
    joints: Mapping[str, tuple[Choice, ...]]


@dataclass(frozen=True)
class Reading:
    """The landmarks that the labels of a file name.

    Attributes
    ----------
    labels : dict of str to tuple of str
        Landmark → its labels in the file; several only for clusters and the spine.
    skin : bool
        True for a set of markers on the skin, False for one of joint centres.
    unread : tuple of str
        The labels that name nothing.
    sets : tuple of str
        The marker sets with a convention of their own that the labels belong to.
    arm : dict of str to str
        Landmark of an arm of unknown side → its label, in a set for one arm.
    made : dict
        Joint → its mixes of these labels, as far as `Landmarks.all_mixes` has computed them.
    """

    labels: dict[str, tuple[str, ...]]
    skin: bool
    unread: tuple[str, ...]
    sets: tuple[str, ...] = ()
    arm: dict[str, str] = field(default_factory=dict)
    made: dict[str, dict[Mix, Choice]] = field(default_factory=dict, compare=False, repr=False)

    @property
    def known(self) -> int:
        """The number of labels that name a landmark."""
        return sum(map(len, self.labels.values())) + len(self.arm)

    def with_arm(self, side: str) -> Reading:
        """Return the landmarks, with those of an arm of unknown side assigned to a side, "l" or "r"."""
        sided = {f"{side}{landmark}": (label,) for landmark, label in self.arm.items()}
        return Reading(self.labels | sided, self.skin, self.unread, self.sets)


Table = dict[str, list[tuple[str, int]]]


@dataclass(frozen=True, eq=False)
class Landmarks:
    """Labels and regressions of `configs/names/landmarks.yaml`.

    Attributes
    ----------
    skin, centres : Table
        Label without case and marks → the landmarks that it may name, each with its place in the list of labels.
    arm : dict of str to str
        Label of a set for one arm → landmark without its side.
    order : tuple of str
        All landmarks in the order in which labels are assigned to them.
    many : frozenset of str
        Landmarks that may use all of their labels that a file has, instead of the first: clusters and the spine.
    sides : dict of str to str
        A word that states a side → "l" or "r".
    joints : dict of str to tuple of Choice
        The alternatives of each named joint that has a regression.
    points : dict of str to tuple of Choice
        The alternatives of each point that regressions use.
    orders : dict of str to tuple of str
        The labels of points that files without names hold, by the program that writes them so.
    sets : dict of str to MarkerSet
        The marker sets whose convention differs from that of the others.
    """

    skin: Table
    centres: Table
    arm: Mapping[str, str]
    order: tuple[str, ...]
    many: frozenset[str]
    sides: Mapping[str, str]
    suffixes: tuple[str, ...]
    joints: Mapping[str, tuple[Choice, ...]]
    points: Mapping[str, tuple[Choice, ...]]
    orders: Mapping[str, tuple[str, ...]]
    sets: Mapping[str, MarkerSet]
    _keys: dict[str, tuple[str, ...]] = field(default_factory=dict, init=False, repr=False)
    _readings: dict[tuple[str, ...], Reading] = field(default_factory=dict, init=False, repr=False)

    def read(self, labels: Sequence[str]) -> Reading:
        """Return the landmarks of labels, from which a common prefix and ending are removed if more are then known."""
        known = self._readings.get(tuple(labels))
        if known is not None:
            return known
        prefixes = sorted({"", *_prefixes(labels)}, key=len)
        around = product(prefixes, ("", *_endings(labels)))
        found = max((self._read(labels, *one) for one in around), key=lambda found: found.known)
        if len(self._readings) > 256:
            self._readings.clear()
        self._readings[tuple(labels)] = found
        return found

    def all_mixes(self, reading: Reading, joints: Sequence[str]) -> dict[str, dict[Mix, Choice]]:
        """Return the mixes of every joint, as `mixes` does, and cache them, since files of an archive share labels."""
        for joint in joints:
            if joint not in reading.made:
                reading.made[joint] = self.mixes(joint, reading.labels, reading.sets)
        return {joint: reading.made[joint] for joint in joints}

    def _read(self, labels: Sequence[str], prefix: str, ending: str) -> Reading:
        short = {label: label.removeprefix(prefix).removesuffix(ending).rpartition(":")[2] for label in labels}
        of_model = model_labels(list(short.values()))
        keys = {}
        for label, name in short.items():
            if name not in of_model:
                keys[label] = self._key_of(name)
            elif name[1:] in _MODEL_JOINTS:
                keys[label] = (name[0].lower() + _MODEL_JOINTS[name[1:]],)
        arm, of_arm = self._arm(keys)
        keys = {label: forms for label, forms in keys.items() if label not in of_arm}
        skin = self._found(keys, self.skin)
        centres = self._found(keys, self.centres)
        own = len({label for label, _, _ in skin} - {label for label, _, _ in centres})
        of_joints = len({label for label, _, _ in centres} - {label for label, _, _ in skin})
        is_skin = own >= _SKIN and own >= of_joints // 2 and any(landmark in _TRUNK for _, landmark, _ in skin)
        if is_skin:
            explicit = {label for label in keys if any(word in keys[label][0] for word in _EXPLICIT)}
            centres = [hit for hit in centres if hit[0] in explicit or hit[1][0] not in "lr"]
        named = _assigned([*(skin if is_skin else ()), *centres], self.order, self.many)
        used = {label for found in named.values() for label in found} | {*arm.values()}
        forms = {form for known in keys.values() for form in known}
        sets = tuple(name for name, one in self.sets.items() if len(forms & one.labels) >= one.least)
        return Reading(named, is_skin, tuple(label for label in labels if label not in used), sets, arm)

    def _arm(self, keys: Mapping[str, tuple[str, ...]]) -> tuple[dict[str, str], set[str]]:
        """Return landmark → label of a set for one arm, and all labels of it; both empty if there is no such set."""
        found = {label: self.arm[forms[-1]] for label, forms in keys.items() if forms[-1] in self.arm}
        named = {landmark: label for label, landmark in reversed(found.items()) if landmark != _UNUSED}
        return (named, set(found)) if len(named) >= _ARM else ({}, set())

    def _key_of(self, label: str) -> tuple[str, ...]:
        """Return the forms by which a label is looked up: with its side, if any, as l or r in front, and as a word."""
        known = self._keys.get(label)
        if known is not None:
            return known
        words = [word.lower() for word in _WORD.findall(label.rpartition(":")[2])]
        forms = ["".join(words)]
        at = next((i for i, word in enumerate(words) if word in self.sides), None)
        if at is not None and len(words) > 1:
            forms.insert(0, self.sides[words[at]] + " " + "".join(words[:at] + words[at + 1 :]))
        if len(self._keys) > 20_000:
            self._keys.clear()
        self._keys[label] = tuple(forms)
        return self._keys[label]

    def _found(self, keys: Mapping[str, tuple[str, ...]], table: Table) -> list[tuple[str, str, int]]:
        """Return the labels that a table knows, each with a landmark and its rank there."""
        hits = []
        for label, forms in keys.items():
            known = next((table[form] for form in forms if form in table), ())
            hits += [(label, landmark, rank) for landmark, rank in known]
        return hits

    def mixes(self, joint: str, labels: Mapping[str, tuple[str, ...]], sets: Sequence[str] = ()) -> dict[Mix, Choice]:
        """Return the mixes of labels from which a joint can be computed, best first, each with its choice.

        Parameters
        ----------
        joint : str
            A named joint.
        labels : Mapping of str to tuple of str
            Landmark → its labels in the file.
        sets : sequence of str
            The marker sets that they belong to, whose choices come first.
        """
        mixes: dict[Mix, Choice] = {}
        own = [choice for name in sets for choice in self.sets[name].joints.get(joint, ())]
        for choice in (*own, *self.joints.get(joint, ())):
            found = () if choice.last and mixes else self._expanded(choice, labels, sets)
            marked = self._marked(choice, labels) if found else choice
            for mix in found:
                mixes.setdefault(mix, marked)
        return dict(list(mixes.items())[:_MAX_CHOICES])

    def _marked(self, choice: Choice, labels: Mapping[str, tuple[str, ...]]) -> Choice:
        """Return a choice, marked as estimated with the phrase of the first estimated point that it uses, if any."""
        for name in [name for name, _ in choice.weights if name not in labels]:
            way = next(way for way in self.points[name] if all(self._ways(part, labels) for part, _ in way.weights))
            marked = self._marked(way, labels)
            if marked.estimated and not choice.estimated:
                choice = replace(choice, estimated=marked.estimated, rough=marked.rough)
        return choice

    def _expanded(self, choice: Choice, labels: Mapping[str, tuple[str, ...]], sets: Sequence[str] = ()) -> list[Mix]:
        corners = {name: corner for name in choice.plane if " " in name for corner in self._corner(name, labels, sets)}
        if any(" " in name and name not in corners for name in choice.plane):
            return []
        used = list(dict.fromkeys([*(name for name, _ in choice.weights), *choice.plane]))
        used = [name for name in used if name not in corners]
        ways = [self._ways(name, labels) for name in used]
        mixes = []
        for combination in product(*ways):
            way = dict(zip(used, combination, strict=True))
            weights: dict[str, float] = {}
            for name, weight in choice.weights:
                for label, share in way[name]:
                    weights[label] = weights.get(label, 0.0) + weight * share
            plane = tuple(corners[name] if name in corners else way[name][0][0] for name in choice.plane)
            if len(set(plane)) == len(plane):
                rounded = tuple((label, round(weight, 6)) for label, weight in weights.items() if abs(weight) > 1e-9)
                mixes.append(choice.kind(rounded, plane=plane, out=choice.out if plane else 0.0))
        return mixes

    def _corner(self, name: str, labels: Mapping[str, tuple[str, ...]], sets: Sequence[str]) -> list[Mix]:
        """Return the mix for a corner of a plane, such as `joint lhip` or `point lgrip`; empty if there is none."""
        kind, _, part = name.partition(" ")
        if kind == "joint":
            return list(self.mixes(part, labels, sets))[:1]
        return [Mix(way) for way in self._ways(part, labels)[:1]]

    def _ways(self, name: str, labels: Mapping[str, tuple[str, ...]]) -> list[tuple[tuple[str, float], ...]]:
        """Return the weights over labels with which a landmark or a point can be computed, the best first."""
        if name in labels:
            there = labels[name]
            return [tuple((label, 1.0 / len(there)) for label in there)]
        ways = []
        for choice in self.points.get(name, ()):
            parts = [self._ways(part, labels) for part, _ in choice.weights]
            if all(parts):
                ways.append(
                    tuple(
                        (label, weight * share)
                        for (_, weight), part in zip(choice.weights, parts, strict=True)
                        for label, share in part[0]
                    )
                )
        return ways


def model_labels(labels: Sequence[str]) -> frozenset[str]:
    """Return the labels that Vicon's models give to origins and axes of segments, which are no markers."""
    stems = Counter(label[:-1] for label in labels if label[-1:] in _MODEL)
    models = {stem for stem, count in stems.items() if count >= _FEW_OF_MODEL}
    return frozenset(label for label in labels if label[-1:] in _MODEL and label[:-1] in models)


def _prefixes(labels: Sequence[str]) -> list[str]:
    """Return beginnings of labels that may be prefixes, such as `subject:`.

    These are at most eight that end with a separator and that more than a third of the labels have, and those of up to
    12 characters that more than two thirds of the first `_LOOKED_AT` labels have.
    """
    marks = Counter(
        label[: mark.end()] for label in labels for mark in re.finditer(r"[^A-Za-z0-9]", label[:LONGEST_PREFIX])
    )
    usual = [prefix for prefix, count in marks.most_common(8) if 3 * count > len(labels)]
    some = labels[:_LOOKED_AT]
    starts = Counter(label[:size] for label in some for size in (*range(1, 11), 12) if len(label) > size + 1)
    glued = [start for start, count in starts.items() if 3 * count > 2 * len(some) > 6]
    return [*usual, *glued]


def _endings(labels: Sequence[str]) -> list[str]:
    """Return at most four endings that begin with a separator (`_m`) and that more than two thirds of labels have."""
    marks = Counter(
        label[mark.start() :]
        for label in labels
        for mark in re.finditer(r"[^A-Za-z0-9]", label)
        if 0 < mark.start() < len(label) - 1 and len(label) - mark.start() <= LONGEST_PREFIX
    )
    return [ending for ending, count in marks.most_common(4) if 3 * count > 2 * len(labels)]


def _assigned(
    hits: Iterable[tuple[str, str, int]], order: Sequence[str], many: frozenset[str]
) -> dict[str, tuple[str, ...]]:
    """Assign to each landmark, in order, its best label that no earlier landmark has."""
    wanted: dict[str, list[tuple[int, str]]] = {}
    for label, landmark, rank in hits:
        wanted.setdefault(landmark, []).append((rank, label))
    used: set[str] = set()
    named: dict[str, tuple[str, ...]] = {}
    for landmark in order:
        free = [label for _, label in sorted(wanted.get(landmark, ()), key=lambda hit: hit[0]) if label not in used]
        chosen = tuple(free if landmark in many else free[:1])
        if chosen:
            named[landmark] = chosen
            used.update(chosen)
    return named


def load_landmarks() -> Landmarks:
    """Read `configs/names/landmarks.yaml`.

    Raises
    ------
    ConfigError
        At the first fault, with its file, line and key.
    """
    return _load(shipped_configs() / "names" / "landmarks.yaml")


@lru_cache(maxsize=4)
def _load(path: Path) -> Landmarks:
    located = load_yaml(path)
    located.mapping()
    return _landmarks(located, located.model(_LandmarkFile))


def landmarks_with(others: Iterable[Located]) -> Landmarks:
    """Return the shipped landmarks with the labels of other files added, such as those of a user.

    Parameters
    ----------
    others : iterable of Located
        Parsed files with `skin` and `centres` as in `configs/names/landmarks.yaml`; their labels count after the
        shipped ones.

    Raises
    ------
    ConfigError
        A file names a landmark that does not exist, or is invalid; the error names its line.
    """
    located = load_yaml(shipped_configs() / "names" / "landmarks.yaml")
    located.mapping()
    parsed = located.model(_LandmarkFile)
    for other in others:
        added = other.model(_OwnFile)
        parsed.left += added.left
        parsed.right += added.right
        parsed.suffixes += added.suffixes
        for section in ("skin", "centres"):
            part, more = getattr(parsed, section), getattr(added, section)
            part.spine += more.spine
            for group in ("sided", "middle", "clusters"):
                known = getattr(part, group)
                for name, labels in getattr(more, group).items():
                    if name not in known:
                        raise other.error(f"no such landmark{did_you_mean(name, known)}", section, group, name)
                    known[name] += labels
    return _landmarks(located, parsed)


def _landmarks(located: Located, parsed: _LandmarkFile) -> Landmarks:
    sides = {word.lower(): side for side, words in (("l", parsed.left), ("r", parsed.right)) for word in words}
    skin, centres = _table(parsed.skin, parsed.suffixes), _table(parsed.centres, parsed.suffixes)
    both = (parsed.skin, parsed.centres)
    many = {f"{side}{name}" for part in both for name in part.clusters for side in "lr"} | {"spine"}
    order = [name for part in both for name in _names(part)]
    points = _mirrored({name: _choices(located, "points", name, ways) for name, ways in parsed.points.items()}, order)
    known = {*order, *points}
    orders = {name: tuple(labels) for name, labels in parsed.orders.items()}
    left = {name: _choices(located, "joints", name, ways) for name, ways in parsed.joints.items()}
    names = [*order, *points]
    joints = _mirrored(left, names)
    sets = {}
    for name, one in parsed.sets.items():
        labels = frozenset(side + label for label in one.labels for side in "lr")
        own = {joint: _choices(located, "sets", joint, ways) for joint, ways in one.joints.items()}
        sets[name] = MarkerSet(labels, one.least, _mirrored(own, [*names, *joints]))
    for joint, choices in [pair for made in (joints, *(one.joints for one in sets.values())) for pair in made.items()]:
        for choice in choices:
            for name in (*(name for name, _ in choice.weights), *choice.plane):
                if name.rpartition(" ")[2] not in (joints if name.startswith("joint ") else known):
                    raise located.error(f"no landmark is called '{name}'", "joints", joint)
    arm = {label.replace(" ", ""): name for name, labels in parsed.skin.arm.items() for label in labels}
    return Landmarks(
        skin, centres, arm, tuple(order), frozenset(many), sides, tuple(parsed.suffixes), joints, points, orders, sets
    )


def _names(part: _Part) -> list[str]:
    names = [f"{side}{name}" for name in part.sided for side in "lr"]
    names += list(part.middle)
    names += [f"{side}{name}" for name in part.clusters for side in "lr"]
    return [*names, *(["spine"] if part.spine else [])]


def _table(part: _Part, suffixes: Sequence[str]) -> Table:
    table: Table = {}

    def add(key: str, landmark: str, rank: int) -> None:
        if all(known != landmark for known, _ in table.setdefault(key, [])):
            table[key].append((landmark, rank))

    for group in (part.sided, part.clusters):
        for name, labels in group.items():
            for rank, label in enumerate(labels):
                words = label.split()
                for ending in ("", *suffixes):
                    for side in "lr":
                        for key in _glued([*words, *([ending] if ending else [])], side):
                            add(key, f"{side}{name}", 2 * rank + (not ending))
    for name, labels in (*part.middle.items(), *((("spine", part.spine),) if part.spine else ())):
        for rank, label in enumerate(labels):
            for ending in ("", *suffixes):
                add(label.replace(" ", "") + ending, name, 2 * rank + (not ending))
    return table


def _glued(words: Sequence[str], side: str) -> list[str]:
    """Return the forms of a label with its side in front, at the end and between its words."""
    whole = "".join(words)
    long = {"l": "left", "r": "right"}[side]
    forms = [f"{side} {whole}", side + whole, long + whole, whole + long]
    if len(whole) > 2:
        forms.append(whole + side)
    for at in range(1, len(words)):
        before, after = "".join(words[:at]), "".join(words[at:])
        forms += [before + side + after, before + long + after]
    return forms


def _choices(located: Located, section: str, name: str, ways: Sequence[Mapping[str, Any]]) -> tuple[Choice, ...]:
    choices = []
    for i, way in enumerate(ways):
        aside, estimated = way.get("aside"), str(way.get("estimated", ""))
        rough, last = bool(way.get("rough")), bool(way.get("last"))
        weights = {key: value for key, value in way.items() if key not in ("aside", "estimated", "rough", "last")}
        if any(not isinstance(value, (int, float)) for value in weights.values()):
            raise located.error("expected weights over landmarks", section, name, i)
        if abs(sum(weights.values()) - 1.0) > 1e-9:
            raise located.error(f"the weights must add up to 1, got {sum(weights.values()):g}", section, name, i)
        plane, out = (tuple(aside["plane"]), float(aside["times"])) if aside else ((), 0.0)
        kind = KINDS[aside.get("kind", "normal")] if aside else Mix
        choices.append(Choice(tuple(weights.items()), plane, out, kind, estimated, rough, last))
    return tuple(choices)


def _mirrored(found: Mapping[str, tuple[Choice, ...]], names: Iterable[str]) -> dict[str, tuple[Choice, ...]]:
    """Return choices, with each choice of the left side repeated for the right side."""
    sided = {name[1:] for name in names if name[0] == "l" and "r" + name[1:] in set(names)}
    sided |= {name[1:] for name in found if name[0] == "l"}

    def other(name: str) -> str:
        if " " in name:
            kind, _, part = name.partition(" ")
            return f"{kind} {other(part)}"
        return {"l": "r", "r": "l"}[name[0]] + name[1:] if name[0] in "lr" and name[1:] in sided else name

    mirrored = dict(found)
    for name, choices in found.items():
        if name[0] == "l" and name[1:] in sided:
            mirrored["r" + name[1:]] = tuple(
                replace(
                    choice,
                    weights=tuple((other(part), weight) for part, weight in choice.weights),
                    plane=tuple(other(part) for part in choice.plane),
                    out=choice.out if choice.kind is Chord else -choice.out,
                )
                for choice in choices
            )
    return mirrored
