"""Compare the takes of a capture session, to warn of contradictions and to decide what a file leaves open.

One file alone cannot show that its scale or its rate is wrong where a person of that size could move so; the files
that were recorded with it can. Files of one folder, format, skeleton file and person are a session. It agrees on a
value if at least `FILES` takes, and a share of `SHARE` of the takes that have any, have this value.
"""

from __future__ import annotations

import json
import os
import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kinedex.ops.wording import counted

Row = Mapping[str, Any]

FILES, SHARE = 4, 0.75

MARKERS = ("c3d", "trc", "csv", "tsv")
"""The formats of markers, which have static trials in place of skeleton files."""

SESSION = "unlike the files beside it: "
"""The beginning of warnings on takes that contradict their session."""

OPEN_UP, OPEN_RATE = "no axis is clearly up", "its rate is wrong: it states "
"""The beginnings of warnings on takes whose vertical axis or rate does not follow from their file."""

OPEN_UNIT, OPEN_SCALE = "its unit of length is doubtful", "its unit or scale is doubtful"
WRONG_UNIT = "its unit of length is wrong"
"""The beginnings of warnings on takes whose unit of length does not follow from their file."""

NO_RATE = "it does not state its frames per second"
"""The beginning of a warning on a take, or the reason why a file is refused, whose rate only its session can decide."""

_OPEN_UNITS = (OPEN_UNIT, OPEN_SCALE, WRONG_UNIT)

BY_SESSION = "as in the other files of its folder"
"""The words by which such a warning says that the session has decided."""

_SAME_BODY, _OTHER_BODY = 1.05, 1.1
"""Ratios of heights within which a session has one body, and beyond which a take of it has another."""

_ANY_BODIES = 1.8
"""The largest ratio of a height to the median of a session of several persons, up to which it is not doubted."""

_SAME_RATE = 0.01
_SAME_LIMB, _OTHER_LIMB = 1.08, 1.25
_SAME_TEMPO, _OTHER_TEMPO, _OTHER_SPEED = 1.35, 1.8, 1.4
"""The ratio of tempo within which motions are of one kind, and the ratios of tempo and of speed that only a wrong rate
explains; no take of HDM05, CMU and Bandai is beyond both."""

_LIMBS = {"thigh": "thighs", "shank": "shanks", "upper_arm": "upper arms", "forearm": "forearms"}


def session_of(row: Row) -> tuple[object, ...]:
    """Return the session of a take: its source root, folder, format, skeleton file (unless static trial) and person."""
    folder = os.path.dirname(row["source"])
    skeleton = row.get("skeleton_source") if row["format"] not in MARKERS else None
    return row["source_root"], folder, row["format"], skeleton, row.get("person")


def with_session_warnings(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Return the rows of takes whose warnings on contradictions within their session change, with the new warnings.

    Parameters
    ----------
    rows : sequence of mapping
        The rows of all takes of a source.
    """
    found = session_warnings(rows)
    changed = []
    for row in rows:
        others = [warning for warning in row["warnings"] if not warning.startswith(SESSION)]
        warnings = [*others, *found.get(row["take_id"], ())]
        if warnings != row["warnings"]:
            changed.append({**row, "warnings": warnings})
    return changed


def session_warnings(rows: Iterable[Row]) -> dict[int, list[str]]:
    """Return take id → sentences on what contradicts the take's session, with the values of both.

    Parameters
    ----------
    rows : iterable of mapping
        Rows of takes, with their quality figures; unknown figures are None or missing.
    """
    found: dict[int, list[str]] = {}
    for takes in sessions(rows):
        for take_id, sentence in _contradictions(takes):
            found.setdefault(take_id, []).append(SESSION + sentence)
    return found


def is_undecided(row: Row) -> bool:
    """Return whether the vertical axis, the rate or the unit of a take does not follow from its own file."""
    return _has(row, OPEN_UP, OPEN_RATE, NO_RATE, *_OPEN_UNITS)


def refused_row(take_id: int, place: tuple[str, str, str], recipe: str) -> Row:
    """Return a row for a file that was refused because it states no rate, for `decided_recipes`.

    Parameters
    ----------
    take_id : int
        The id that its take would have.
    place : (str, str, str)
        The source root, the path below it, and the format.
    recipe : str
        The recipe that its take would have.
    """
    root, path, form = place
    row = {"take_id": take_id, "source_root": root, "source": path, "format": form}
    return row | {"recipe": recipe, "warnings": [NO_RATE]}


def decided_recipes(rows: Iterable[Row]) -> dict[int, str]:
    """Return take id → new recipe of the undecided takes for which the session's other takes now imply other settings.

    Only takes that are sure of a setting decide on it, and all or nearly all of them must agree. A single one suffices,
    such as a static trial in the folder of a motion.

    Parameters
    ----------
    rows : iterable of mapping
        The rows of all takes of a source.
    """
    takes: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        takes.setdefault(session_of(row), []).append(row)
    found = {}
    for those in takes.values():
        undecided = [row for row in those if is_undecided(row)]
        if undecided:
            up = _decided(row["file_up"] for row in those if row.get("file_up") and not _has(row, OPEN_UP))
            rate_hz = _decided(row["source_rate_hz"] for row in those if not _has(row, OPEN_RATE, NO_RATE))
            unit_m = _decided(_metres(row) for row in those if row.get("unit") and not _has(row, *_OPEN_UNITS))
        for row in undecided:
            now: dict[str, Any] = {"session_up": up} if up is not None and _has(row, OPEN_UP) else {}
            now |= {"session_hz": rate_hz} if rate_hz is not None and _has(row, OPEN_RATE, NO_RATE) else {}
            now |= {"session_unit_m": unit_m} if unit_m is not None and _has(row, *_OPEN_UNITS) else {}
            if now != decisions_in(row["recipe"]):
                found[row["take_id"]] = _with_decisions(row["recipe"].partition(" ")[0], now)
    return found


def decisions_in(recipe: str) -> dict[str, Any]:
    """Return the settings of `ReadSettings` that the session of a take has decided, from the JSON in its recipe."""
    text = recipe.partition(" ")[2]
    return dict(json.loads(text)) if text else {}


def same_decisions(recipe: str, row: Row) -> str:
    """Return a new recipe with the decisions of the session that the recipe in a take's row holds."""
    return _with_decisions(recipe, decisions_in(row["recipe"]))


def _with_decisions(recipe: str, decisions: Mapping[str, Any]) -> str:
    return f"{recipe} {json.dumps(decisions)}" if decisions else recipe


def _metres(row: Row) -> float:
    """Return the metres of a take's unit, which is a text such as "0.01 m (guessed)"."""
    return float(row["unit"].split()[0])


def _has(row: Row, *beginnings: str) -> bool:
    return any(warning.startswith(beginnings) for warning in row["warnings"])


def _decided(values: Iterable[Any]) -> Any | None:
    """Return the value that all share, or on which most agree as in `agreed`; None if there is none."""
    counts = Counter(values)
    if not counts:
        return None
    value, count = counts.most_common(1)[0]
    return value if len(counts) == 1 or _is_agreed(count, counts.total()) else None


def session_lines(warnings: Mapping[str, Sequence[str]]) -> list[str]:
    """Return a list of one message on the takes that contradict their sessions; empty if none does.

    Parameters
    ----------
    warnings : mapping of str to sequence of str
        Take name → its warnings.
    """
    alone = [(name, one) for name, those in warnings.items() for one in those if one.startswith(SESSION)]
    if not alone:
        return []
    name, warning = alone[0]
    return [f"{counted(len(dict(alone)), 'take')} {SESSION}such as '{name}': {warning.removeprefix(SESSION)}"]


def sessions(rows: Iterable[Row]) -> Iterator[list[Row]]:
    """Yield the takes of each session that has enough files to decide anything."""
    takes: dict[tuple[object, ...], list[Row]] = {}
    for row in rows:
        takes.setdefault(session_of(row), []).append(row)
    return (those for those in takes.values() if len(those) > FILES)


def agreed(takes: Sequence[Row], name: str) -> Any | None:
    """Return the value of a column on which a session agrees; None if it does not."""
    counts = Counter(row[name] for row in takes if row.get(name) is not None)
    if not counts:
        return None
    value, count = counts.most_common(1)[0]
    return value if _is_agreed(count, counts.total()) else None


def _is_agreed(count: int, total: int) -> bool:
    return count >= FILES and count >= SHARE * total


def _contradictions(takes: Sequence[Row]) -> Iterator[tuple[int, str]]:
    for compare in (_rates, _axes, _estimates, _bodies, _tempos):
        yield from compare(takes)


def _rates(takes: Sequence[Row]) -> Iterator[tuple[int, str]]:
    usual = agreed([{"rate": f"{row['source_rate_hz']:.4g}"} for row in takes], "rate")
    if usual is None:
        return
    for row in takes:
        rate_hz = row["source_rate_hz"]
        if abs(rate_hz / float(usual) - 1) > _SAME_RATE:
            values = f"it is read at {rate_hz:.6g} Hz, they at {usual} Hz"
            yield row["take_id"], f"{values}; if its rate is wrong, give it by --rate to an ingest of this file alone"


def _axes(takes: Sequence[Row]) -> Iterator[tuple[int, str]]:
    usual = agreed(takes, "file_up")
    for row in takes:
        up = row.get("file_up") or usual
        if up != usual and usual is not None:
            values = f"{up} is taken as its vertical axis, {usual} as theirs"
            yield row["take_id"], f"{values}; if it stands along {usual}, state `up: {usual}` in a skeleton mapping"


def _estimates(takes: Sequence[Row]) -> Iterator[tuple[int, str]]:
    """Yield the takes in which joints are estimated, although the other files of the session have them."""
    known = [row for row in takes if row.get("estimated_joints") is not None]
    counts = Counter(joint for row in known for joint in row["estimated_joints"].split())
    held = {joint for joint, count in counts.items() if _is_agreed(len(known) - count, len(known))}
    for row in known:
        if lacks := [joint for joint in row["estimated_joints"].split() if joint in held]:
            yield row["take_id"], f"{', '.join(lacks)} estimated, held by them; it lacks labels or bones"


@dataclass(frozen=True)
class _Typical:
    """The median of a figure in a session, the number of takes near it, and that of the takes with this figure."""

    median: float
    near: int
    total: int

    @property
    def is_clear(self) -> bool:
        return _is_agreed(self.near, self.total)


def _typical(values: Iterable[float], ratio: float) -> _Typical:
    known = list(values)
    median = statistics.median(known) if known else 0.0
    near = sum(median / ratio <= value <= median * ratio for value in known)
    return _Typical(median, near if median > 0 else 0, len(known))


def _values(takes: Sequence[Row], name: str) -> dict[int, float]:
    return {row["take_id"]: row[name] for row in takes if row.get(name) is not None}


def _beyond(value: float, median: float, ratio: float) -> bool:
    return not median / ratio <= value <= median * ratio


def _bodies(takes: Sequence[Row]) -> Iterator[tuple[int, str]]:
    """Yield the takes whose bodies have another height, or limbs of another length, than those of the session."""
    heights = _values(takes, "height_m")
    one, several = _typical(heights.values(), _SAME_BODY), _typical(heights.values(), _ANY_BODIES)
    usual, limit = (one, _OTHER_BODY) if one.is_clear else (several, _ANY_BODIES)
    others = {take for take, height in heights.items() if usual.is_clear and _beyond(height, usual.median, limit)}
    for take in sorted(others):
        values = f"its body is {heights[take]:.2f} m high, theirs {usual.median:.2f} m"
        yield take, f"{values}; it is another person, or unit or scale is wrong: state `unit_m` in a skeleton mapping"
    for column, limb in _LIMBS.items() if one.is_clear else ():
        shares = _values(takes, f"{column}_share")
        lengths = {take: share * heights[take] for take, share in shares.items() if take in heights}
        length = _typical(lengths.values(), _SAME_LIMB)
        for take, value in lengths.items():
            if length.is_clear and take not in others and _beyond(value, length.median, _OTHER_LIMB):
                values = f"its {limb} are {value:.2f} m long, theirs {length.median:.2f} m"
                yield take, f"{values}; labels or bones may be exchanged"


def _tempos(takes: Sequence[Row]) -> Iterator[tuple[int, str]]:
    """Yield takes whose tempo and speed both differ more from the medians than those of repetitions, with a warning."""
    tempos, speeds = _values(takes, "tempo_hz"), _values(takes, "speed_m_s")
    tempo, speed = _typical(tempos.values(), _SAME_TEMPO), _typical(speeds.values(), _OTHER_SPEED)
    for take, value in tempos.items() if tempo.is_clear and speed.is_clear else ():
        fast = value > tempo.median * _OTHER_TEMPO and speeds[take] > speed.median * _OTHER_SPEED
        slow = value < tempo.median / _OTHER_TEMPO and speeds[take] < speed.median / _OTHER_SPEED
        if fast or slow:
            values = f"its hands and feet turn {value:.2g} times a second, theirs {tempo.median:.2g} times"
            yield take, f"{values}; if its rate is wrong, give it by --rate to an ingest of this file alone"
