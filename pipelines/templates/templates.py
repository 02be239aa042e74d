"""Templates of a store by name: the list of them, one of them, and one made from a stretch of a take."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow as pa

from kinedex.catalog.template_files import NamedTemplate
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.templates.templates import Kind, learn, quantise
from kinedex.ops.words import NO_WORD
from kinedex.pipelines.templates.learning import SubclassTemplate, template_of
from kinedex.storage.store.store import Store


@dataclass(frozen=True)
class StoredTemplate:
    """A template and the stage that stored it: "<pipeline>/<stage>"."""

    stage: str
    one: SubclassTemplate


def stored_templates(store: Store, stage: str | None = None) -> list[StoredTemplate]:
    """All templates of a store, by stage, subclass and kind.

    Parameters
    ----------
    stage: only those of this stage: "<pipeline>/<stage>", or the pipeline's name alone.

    Raises
    ------
    KinedexError: there are none.
    """
    stages = {part.run: part.stage for part in store.manifest.results.get("templates", ())}
    if not stages:
        raise KinedexError(f"{store.path} has no templates yet; a pipeline with a stage learn_templates makes them")
    known = sorted(set(stages.values()))
    if stage is not None and not any(name == stage or name.startswith(f"{stage}/") for name in known):
        raise KinedexError(f"no templates of a stage '{stage}'{did_you_mean(stage, known)}")
    found = [
        StoredTemplate(stages[row["run"]], template_of(row))
        for row in store.result("templates").to_pylist()
        if stage is None or stages[row["run"]] == stage or stages[row["run"]].startswith(f"{stage}/")
    ]
    return sorted(found, key=lambda each: (each.stage, each.one.subclass, each.one.kind != "soft"))


def choose_template(store: Store, name: str, kind: Kind, stage: str | None = None) -> SubclassTemplate:
    """The template of a subclass.

    Raises
    ------
    KinedexError: there is none of that name or kind, or several stages have one; the message says what there is.
    """
    every = stored_templates(store, stage)
    of_name = [each for each in every if each.one.subclass == name]
    if not of_name:
        raise KinedexError(f"no template of '{name}'{did_you_mean(name, [each.one.subclass for each in every])}")
    found = [each for each in of_name if each.one.kind == kind]
    if not found:
        raise KinedexError(f"'{name}' has no {kind} template (it has: {', '.join(each.one.kind for each in of_name)})")
    if len(found) > 1:
        raise KinedexError(
            f"several stages have a template of '{name}': say which with --stage "
            f"({', '.join(each.stage for each in found)})"
        )
    return found[0].one


def templates_overview(store: Store, delta: float, stage: str | None = None) -> pa.Table:
    """The templates of a store as a table, one row each; wildcards are counted at this δ."""
    rows = []
    for each in stored_templates(store, stage):
        one, template = each.one, each.one.learned.template
        features = template.values.shape[1]
        rows.append(
            {
                "stage": each.stage,
                "subclass": one.subclass,
                "kind": one.kind,
                "columns": len(template),
                "seconds": round(len(template) / store.rate_hz, 2),
                "clips": len(one.clips),
                "rounds": one.learned.rounds,
                "last_cost": round(one.learned.costs[-1], 4) if one.learned.costs else None,
                "wildcards": round(1 - quantise(template, delta).fixed / features, 3),
                "origin": one.origin,
                "remarks": "; ".join(one.remarks),
            }
        )
    return pa.Table.from_pylist(rows)


def parse_place(text: str, rate_hz: float, what: str) -> int:
    """A place in a take: a frame, or seconds where an s follows ("1.5s").

    Raises
    ------
    KinedexError: it is neither.
    """
    number = text.strip()
    try:
        return round(float(number[:-1]) * rate_hz) if number.endswith("s") else int(number)
    except (ValueError, OverflowError):
        raise KinedexError(f"{what} must be a frame (45) or seconds (1.5s), got '{text}'") from None


def stretch(store: Store, take: str, start: str | None, stop: str | None) -> tuple[int, int]:
    """The frames [start, stop) of a take, said as frames (45) or seconds (1.5s); where one is missing, the take's end.

    Raises
    ------
    KinedexError: no such take, no such place, or a stretch outside the take.
    """
    frames = len(store.words([store.take_id(take)]).words)
    first = parse_place(start, store.rate_hz, "START") if start is not None else 0
    last = parse_place(stop, store.rate_hz, "STOP") if stop is not None else frames
    if not 0 <= first < last <= frames:
        raise KinedexError(
            f"{take} has {frames} frames ({frames / store.rate_hz:g} s): expected 0 <= START < STOP <= "
            f"{frames}, got {first} and {last}"
        )
    return first, last


def template_from_clip(store: Store, take: str, start: str | None, stop: str | None, name: str) -> NamedTemplate:
    """The template of one example: the frames [start, stop) of a take, invalid ones at its ends cut off.

    Raises
    ------
    KinedexError: no such take, a stretch outside it, or invalid frames within.
    """
    first, last = stretch(store, take, start, stop)
    words = store.words([store.take_id(take)]).take(0)
    valid = np.flatnonzero(words[first:last] != NO_WORD)
    if not len(valid):
        raise KinedexError(f"{take}: all frames from {first} to {last} are invalid")
    clip = words[first + valid[0] : first + valid[-1] + 1]
    if len(clip) > len(valid):
        hole = first + int(np.flatnonzero(words[first + valid[0] : last] == NO_WORD)[0] + valid[0])
        raise KinedexError(
            f"{take}: frame {hole} is invalid, in the middle of {first} to {last}; choose a stretch beside it"
        )
    template = learn("soft", [clip], len(store.feature_set.features)).template
    begin = first + int(valid[0])
    return NamedTemplate(name, template, f"frames {begin} to {begin + len(clip)} of {take}")
