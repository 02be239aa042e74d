"""Parse and check YAML files that define features."""

from __future__ import annotations

import hashlib
import json
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located
from kinedex.catalog.feature_definitions import PRIMITIVES, Feature, WordSet
from kinedex.ops.body.feature_rules import COMPARISONS, JOINTS_OF, Rule, Term
from kinedex.ops.errors import did_you_mean


class _StandIn(BaseModel):
    model_config = ConfigDict(extra="forbid")
    factor: float = Field(gt=0)
    length: list[tuple[str, str]]


class FeatureFile(BaseModel):
    """The keys of a YAML file that defines features."""

    model_config = ConfigDict(extra="forbid")
    name: str
    version: int = Field(ge=1)
    description: str = ""
    joints: list[str]
    lengths: dict[str, list[tuple[str, str]]]
    sets: dict[str, tuple[int, int]]
    mirror: list[tuple[int, int]] = []
    ground: list[list[str]] = []
    stand_ins: dict[str, list[_StandIn]] = {}
    features: dict[int, dict[str, Any]]


class _FeatureEntry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    name: str = Field(pattern=r"^[a-z][a-z0-9_]*$")
    description: str
    quantity: dict[str, Any]
    length: str | None = None
    when: str
    weak: float | tuple[float, float]
    strong: float | tuple[float, float]


def digest_of(parsed: FeatureFile) -> str:
    """Return a hash of the keys that determine the words of a whole body: all but mirror, ground and stand-ins."""
    text = json.dumps(
        parsed.model_dump(exclude={"mirror", "ground", "stand_ins"}), sort_keys=True, separators=(",", ":")
    )
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def sets_of(located: Located, parsed: FeatureFile, count: int) -> dict[str, WordSet]:
    """Return the ranges of features that words are split into, by name; together they must cover all features."""
    expected = 1
    result = {}
    for name, (first, last) in parsed.sets.items():
        if first != expected or last < first or last > count:
            raise located.error(
                f"the sets must split features 1 to {count} without gap or overlap, in order; got {first} to {last}",
                "sets",
                name,
            )
        result[name] = WordSet(name, first, last - first + 1)
        expected = last + 1
    if expected != count + 1:
        raise located.error(f"features {expected} to {count} are in no set", "sets")
    return result


def mirror_of(located: Located, parsed: FeatureFile, count: int) -> tuple[tuple[int, int], ...]:
    """Return the pairs of features that a mirror image exchanges, by number."""
    seen: set[int] = set()
    for place, pair in enumerate(parsed.mirror):
        for number in pair:
            if not 1 <= number <= count:
                raise located.error(f"no feature {number}: there are F1 to F{count}", "mirror", place)
            if number in seen:
                raise located.error(f"feature {number} stands twice; a feature has one twin at most", "mirror", place)
            seen.add(number)
    return tuple(parsed.mirror)


def ground_of(located: Located, parsed: FeatureFile) -> tuple[tuple[str, ...], ...]:
    """Return groups of joints; the lowest point of a body is known if at least one joint of each group is known."""
    for place, group in enumerate(parsed.ground):
        for joint in group:
            _joint(located, parsed, joint, "ground", place)
    return tuple(tuple(group) for group in parsed.ground)


def feature_of(located: Located, parsed: FeatureFile, number: int) -> Feature:
    """Parse a feature and its rule; raise a ConfigError that names the key of an invalid value."""
    key = ("features", number)
    entry = located.model(_FeatureEntry, *key)
    if entry.when not in COMPARISONS:
        raise located.error(f"must be one of {', '.join(COMPARISONS)}, got {entry.when!r}", *key, "when")
    length: tuple[tuple[int, int], ...] = ()
    if entry.length is not None:
        if entry.length not in parsed.lengths:
            raise located.error(
                f"no length '{entry.length}'{did_you_mean(entry.length, parsed.lengths)}", *key, "length"
            )
        length = _pairs(located, parsed, parsed.lengths[entry.length], "lengths", entry.length)
    others = parsed.stand_ins.get(entry.length or "", [])
    stand_ins = tuple(
        (one.factor, _pairs(located, parsed, one.length, "stand_ins", str(entry.length), place))
        for place, one in enumerate(others)
    )
    rule = Rule(
        terms=_terms(located, parsed, entry.quantity, (*key, "quantity")),
        comparison=COMPARISONS[entry.when],
        weak=_bounds(located, entry, entry.weak, (*key, "weak")),
        strong=_bounds(located, entry, entry.strong, (*key, "strong")),
        length=length,
        stand_ins=stand_ins,
    )
    return Feature(number, entry.name, entry.description, rule)


def _pairs(
    located: Located, parsed: FeatureFile, pairs: list[tuple[str, str]], *key: str | int
) -> tuple[tuple[int, int], ...]:
    return tuple((_joint(located, parsed, a, *key), _joint(located, parsed, b, *key)) for a, b in pairs)


def _bounds(
    located: Located, entry: _FeatureEntry, value: float | tuple[float, float], key: tuple[str | int, ...]
) -> tuple[float, float]:
    if isinstance(value, tuple) != (entry.when == "within"):
        expected = "a pair of bounds" if entry.when == "within" else "one number"
        raise located.error(f"'{entry.when}' takes {expected}, got {value!r}", *key)
    return value if isinstance(value, tuple) else (value, value)


def _terms(
    located: Located, parsed: FeatureFile, quantity: dict[str, Any], key: tuple[str | int, ...]
) -> tuple[Term, ...]:
    if "sum" in quantity:
        parts = quantity["sum"]
        if len(quantity) > 1 or not isinstance(parts, list) or not parts:
            raise located.error("sum must be a list of [factor, primitive] and stand alone", *key)
        for part in parts:
            if not (isinstance(part, list) and len(part) == 2 and _is_number(part[0]) and isinstance(part[1], dict)):
                raise located.error(f"sum must be a list of [factor, primitive], got {part!r}", *key)
        return tuple(_term(located, parsed, part, float(factor), key) for factor, part in parts)
    return (_term(located, parsed, quantity, 1.0, key),)


def _term(
    located: Located, parsed: FeatureFile, part: dict[str, Any], factor: float, key: tuple[str | int, ...]
) -> Term:
    options = {"window_ms", "without", "abs"}
    names = [name for name in part if name not in options]
    if len(names) != 1 or (names[0] not in JOINTS_OF and names[0] not in PRIMITIVES):
        wrong = next((name for name in names if name not in PRIMITIVES), "nothing")
        raise located.error(f"expected one primitive, got '{wrong}'{did_you_mean(wrong, PRIMITIVES)}", *key)
    primitive = names[0]
    plugin = None if primitive in JOINTS_OF else PRIMITIVES.load(primitive)
    for name in (primitive, "without"):
        if not isinstance(part.get(name, []), list):
            raise located.error(f"{name} must be a list of joints, got {part[name]!r}", *key)
    window_ms = part.get("window_ms", 0.0)
    if not _is_number(window_ms) or window_ms < 0:
        raise located.error(f"window_ms must be a number of milliseconds, got {window_ms!r}", *key)
    joints = tuple(_joint(located, parsed, name, *key) for name in part[primitive])
    wanted = plugin.joints if plugin is not None else JOINTS_OF[primitive]
    if wanted is None and not joints:
        raise located.error(f"{primitive} takes at least one joint", *key)
    if wanted is not None and len(joints) != wanted:
        raise located.error(f"{primitive} takes {wanted} joints, got {len(joints)}", *key)
    return Term(
        primitive=primitive,
        joints=joints,
        factor=factor,
        window_ms=float(window_ms),
        without=tuple(_joint(located, parsed, name, *key) for name in part.get("without", ())),
        absolute=bool(part.get("abs", False)),
    )


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1e9


def _joint(located: Located, parsed: FeatureFile, name: object, *key: str | int) -> int:
    if not isinstance(name, str) or name not in parsed.joints:
        raise located.error(f"no joint '{name}'{did_you_mean(str(name), parsed.joints)}", *key)
    return parsed.joints.index(name)
