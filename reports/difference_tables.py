"""Format the comparison of two evaluations as tables for the terminal and as Markdown."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence

from kinedex.ops.wording import name_list, two_digits
from kinedex.pipelines.engine.display import Line, ResultTable, Tone
from kinedex.pipelines.evaluation.annotation_scores import F_FRAMES, F_SEGMENTS, THESIS_NAMES
from kinedex.pipelines.evaluation.differences import Change, Comparison
from kinedex.reports.markdown import grid, plain

VERDICTS = ("worse", "mixed", "better", "incomparable")
HEADER = (f"{F_FRAMES} A", "B", "B − A", f"{F_SEGMENTS} A", "B", "B − A")
MAX_SHOWN = 20
"""The largest number of changes of a kind that the terminal shows; a file lists all."""

_TONES: dict[str, Tone] = {
    "better": "better", "worse": "worse", "mixed": "doubtful", "incomparable": "doubtful", "same": "plain",
}  # fmt: skip


def change_cells(change: Change) -> list[str]:
    """Return a change as cells of the columns in `HEADER`."""
    cells = []
    for pair, by in zip((change.f1, change.f2), change.by, strict=True):
        cells += [two_digits(pair[0]), two_digits(pair[1]), signed_difference(by)]
    return cells


def signed_difference(value: float | None) -> str:
    """Format a difference with its sign; "·" if it rounds to 0, "–" for None, where an evaluation has no value."""
    return "–" if value is None else "·" if abs(value) < 0.0005 else f"{value:+.3f}"


def comparison_tables(one: Comparison) -> list[ResultTable | Line]:
    """Return a comparison as tables: the verdict, then the changes, the largest first."""
    parts: list[ResultTable | Line] = [
        *map(Line, (f"A  {one.a}", f"B  {one.b}", *settings(one))),
        Line(f"{one.verdict}.", "main"),
        _table(one.scope, [one.overall], plain=not one.common),
    ]
    for title, changed in _by_verdict(one):
        more = f", the first {MAX_SHOWN}" if len(changed) > MAX_SHOWN else ""
        parts.append(_table(f"{title}{more}", changed[:MAX_SHOWN]))
    return parts + [Line(text) for text in (*remarks(one), THESIS_NAMES)]


def _by_verdict(one: Comparison) -> Iterator[tuple[str, list[Change]]]:
    """Yield the changes of classes and takes of each verdict with a title, the largest first."""
    for what, changes in (("classes", one.classes), ("takes", one.takes)):
        for verdict in VERDICTS:
            if changed := one.changed(changes, verdict):
                yield f"{verdict}: {len(changed)} of {len(changes)} {what}", changed


def settings(one: Comparison) -> list[str]:
    """Return the parameters that differ, one per line."""
    return [f"{name}: {_setting(ours)} in A, {_setting(theirs)} in B" for name, ours, theirs in one.settings]


def _setting(value: object) -> str:
    return "not set" if value is None else value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def remarks(one: Comparison) -> list[str]:
    """Return remarks on classes and takes that did not change, and on those that could not be compared."""
    texts = []
    for what, other in (("takes", one.other_truth.takes), ("classes", one.other_truth.classes)):
        if other:
            texts.append(f"{what} whose manual labels are not the same in A and B: {name_list(other)}")
    for what, changes in (("classes", one.classes), ("takes", one.takes)):
        same = len(one.changed(changes, "same"))
        if same:
            texts.append(f"{same} of {len(changes)} {what} are the same")
    for name, alone in (("A", one.only_a), ("B", one.only_b)):
        if alone.takes:
            texts.append(f"takes of {name} alone, excluded: {name_list(alone.takes)}")
        if alone.classes:
            texts.append(f"classes of {name} alone, not compared: {name_list(alone.classes)}")
    if (one.only_a.takes or one.only_b.takes) and one.classes:
        texts.append("classes are over all takes of each")
    return texts


def _table(title: str, changes: Sequence[Change], *, plain: bool = False) -> ResultTable:
    table = ResultTable(("", *HEADER), title=title or None, layout="close")
    for change in changes:
        table.add(change.name, *change_cells(change), tone="plain" if plain else _TONES[change.verdict])
    return table


def markdown(comparisons: Sequence[Comparison]) -> str:
    """Return comparisons as Markdown."""
    lines = ["# Two evaluations compared", "", f"{THESIS_NAMES}.", ""]
    for one in comparisons:
        lines += [f"## {plain(f'{one.b} against {one.a}')}", "", f"{one.verdict}.", ""]
        lines += [*(f"- {plain(text)}" for text in settings(one)), ""] if one.settings else []
        lines += [
            f"{one.scope.capitalize()}",
            "",
            *grid(["", *HEADER], [[one.overall.name, *change_cells(one.overall)]]),
        ]
        for title, changed in _by_verdict(one):
            lines += [f"### {title[:1].upper()}{title[1:]}", ""]
            lines += grid(["", *HEADER], [[change.name, *change_cells(change)] for change in changed])
        lines += [f"- {plain(text)}" for text in remarks(one)] + [""]
    return "\n".join(lines).rstrip("\n") + "\n"
