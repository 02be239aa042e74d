"""List the templates of a store, look them up by name, read and write template files, and make them from clips."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.intervals import in_seconds, nearest_frame
from kinedex.ops.templates.derived_templates import without_unknown
from kinedex.ops.templates.templates import Kind, LearnedTemplate, NamedTemplate, Template, learn, quantise
from kinedex.ops.words import ALL_KNOWN, NO_WORD, U64
from kinedex.storage.snapshot.visible_results import pipeline_of
from kinedex.storage.store.store import Store

TEMPLATE_ENDINGS = (".yaml", ".yml", ".csv")


LEARNED_ORIGIN = "learned"
"""The origin of a template that was learned from clips of its own class."""


@dataclass(frozen=True)
class StoredTemplate:
    """A template and the stage that stored it, "<pipeline>/<stage>"."""

    stage: str
    one: SubclassTemplate


def stored_templates(store: Store, stage: str | None = None) -> list[StoredTemplate]:
    """Read all templates of a store, sorted by stage, subclass and kind.

    Parameters
    ----------
    store : Store
        The store to read.
    stage : str, optional
        The stage: "<pipeline>/<stage>", or only the name of the pipeline; by default the
        pipeline that the view `templates` shows.

    Returns
    -------
    list of StoredTemplate
        The templates; at least one.

    Raises
    ------
    KinedexError
        The store has no templates, or none of this stage.
    """
    stages = {part.run: part.stage for part in store.manifest.results.get("templates", ())}
    if not stages:
        raise KinedexError(f"{store.path} has no templates yet; a pipeline with a stage learn_templates makes them")
    known = sorted(set(stages.values()))
    if stage is not None and not any(name == stage or name.startswith(f"{stage}/") for name in known):
        raise KinedexError(f"no templates of a stage '{stage}'{did_you_mean(stage, known)}")
    found = [
        StoredTemplate(stages[row["run"]], template_of(row))
        for row in store.result("templates", pipeline=pipeline_of(stage) if stage else None).to_pylist()
        if stage is None or stage in (stages[row["run"]], pipeline_of(stages[row["run"]]))
    ]
    return sorted(found, key=lambda each: (each.stage, each.one.subclass, each.one.kind != "soft"))


def choose_template(store: Store, name: str, kind: Kind = "soft", stage: str | None = None) -> SubclassTemplate:
    """Return the learned template of a subclass.

    Parameters
    ----------
    store : Store
        The store to read.
    name : str
        The subclass.
    kind : {"soft", "hard"}
        The kind of template.
    stage : str, optional
        The stage that learned it, as for `stored_templates`; required if several stages of the pipeline have one.

    Returns
    -------
    SubclassTemplate
        The template with its provenance.

    Raises
    ------
    KinedexError
        There is no such template, or several stages have one; the message lists the existing templates.
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
            f"several stages have a template of '{name}': choose one with --stage "
            f"({', '.join(each.stage for each in found)})"
        )
    return found[0].one


def choose_templates(
    store: Store, names: Sequence[str] | None = None, kind: Kind = "soft", stage: str | None = None
) -> list[NamedTemplate]:
    """Return learned templates by the names of their subclasses, and templates from files by their paths.

    Parameters
    ----------
    store : Store
        The store to read.
    names : sequence of str, optional
        Subclasses with a learned template, or paths of template files; by default all learned templates.
    kind : {"soft", "hard"}
        The kind of the learned templates.
    stage : str, optional
        The stage that learned them, as for `stored_templates`.

    Returns
    -------
    list of NamedTemplate
        The templates, in the order of `names`, each name once.

    Raises
    ------
    KinedexError
        A name has no template, a file is invalid or has several, or two templates have the same name.
    """
    if names is None:
        names = [each.one.subclass for each in stored_templates(store, stage) if each.one.kind == kind]
        if not names:
            raise KinedexError(f"{store.path} has no {kind} templates" + (f" of stage {stage}" if stage else ""))
    found: dict[str, NamedTemplate] = {}
    for name in dict.fromkeys(names):
        if not name.endswith(TEMPLATE_ENDINGS):
            found[name] = NamedTemplate(name, choose_template(store, name, kind, stage).learned.template)
            continue
        made = template_of_file(Path(name), store.feature_set)
        if made.name in found:
            raise KinedexError(f"{name}: there is a template '{made.name}' already; give it another name")
        found[made.name] = made
    return list(found.values())


def template_of_file(path: Path, features: FeatureSet) -> NamedTemplate:
    """Return the only template in a template file; raise a KinedexError if it has several."""
    from kinedex.catalog.template_files import read_templates  # imported here, as most templates come from the store

    found = read_templates(path, features)
    if len(found) > 1:
        raise KinedexError(f"{path} holds {len(found)} templates; leave one in it: {', '.join(t.name for t in found)}")
    return found[0]


def templates_overview(store: Store, delta: float, stage: str | None = None) -> pa.Table:
    """Return a table of the templates of a store, one row for each.

    Parameters
    ----------
    store : Store
        The store to read.
    delta : float
        Entries within delta of 0 or 1 are fixed; the fraction of the others is the column `wildcards`.
    stage : str, optional
        The stage, as for `stored_templates`.

    Returns
    -------
    pyarrow.Table
        Columns stage, subclass, kind, columns, seconds, clips, rounds, last_cost, wildcards, origin, remarks.
    """
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
                "seconds": round(in_seconds(len(template), store.rate_hz), 2),
                "clips": len(one.clips),
                "rounds": one.learned.rounds,
                "last_cost": round(one.learned.costs[-1], 4) if one.learned.costs else None,
                "wildcards": round(1 - quantise(template, delta).fixed / features, 3),
                "origin": one.origin,
                "remarks": "; ".join(one.remarks),
            }
        )
    return pa.Table.from_pylist(rows)


def parse_frame(text: str, rate_hz: float, what: str) -> int:
    """Parse a frame, given as a number (45) or in seconds (1.5s).

    Parameters
    ----------
    text : str
        The text that the user wrote.
    rate_hz : float
        The analysis rate, in frames per second.
    what : str
        The name of the argument, for the message.

    Returns
    -------
    int
        The nearest frame.

    Raises
    ------
    KinedexError
        The text is neither a number nor seconds.
    """
    number = text.strip()
    try:
        return nearest_frame(float(number[:-1]), rate_hz) if number.endswith("s") else int(number)
    except (ValueError, OverflowError):
        raise KinedexError(f"{what} must be a frame (45) or seconds (1.5s), got '{text}'") from None


def clip_range(store: Store, take: str, start: str | int | None, stop: str | int | None) -> tuple[int, int]:
    """Return the frames [start, stop) of a clip within a take.

    Parameters
    ----------
    store : Store
        The store that holds the take.
    take : str
        The name of the take.
    start, stop : int or str, optional
        Frames, or texts as for `parse_frame`; by default the take's first frame, and the one after its last.

    Returns
    -------
    tuple of int
        The first frame and the one after the last.

    Raises
    ------
    KinedexError
        There is no such take, a value cannot be parsed, or the range is empty or not within the take.
    """
    return frame_range(take, len(store.words([store.take_id(take)]).words), store.rate_hz, start, stop)


def frame_range(
    take: str, frames: int, rate_hz: float, start: str | int | None, stop: str | int | None
) -> tuple[int, int]:
    """Return the frames [start, stop) of a clip within a take of a given length.

    Parameters
    ----------
    take : str
        The name of the take, for the message.
    frames : int
        The number of its frames.
    rate_hz : float
        Frames per second.
    start, stop : int or str, optional
        Frames, or texts as for `parse_frame`; by default the take's first frame, and the one after its last.

    Returns
    -------
    tuple of int
        The first frame and the one after the last.

    Raises
    ------
    KinedexError
        A value cannot be parsed, or the range is empty or not within the take.
    """
    first = parse_frame(str(start), rate_hz, "START") if start is not None else 0
    last = parse_frame(str(stop), rate_hz, "STOP") if stop is not None else frames
    if not 0 <= first < last <= frames:
        raise KinedexError(
            f"{take} has {frames} frames ({in_seconds(frames, rate_hz):g} s): expected 0 <= START < STOP <= "
            f"{frames}, got {first} and {last}"
        )
    return first, last


def template_from_clip(
    store: Store, take: str, start: str | int | None = None, stop: str | int | None = None, name: str | None = None
) -> NamedTemplate:
    """Make a template from one example; invalid frames at its ends are removed.

    Parameters
    ----------
    store : Store
        The store that holds the take.
    take : str
        The name of the take.
    start, stop : int or str, optional
        The clip within the take, as for `clip_range`; by default the whole take.
    name : str, optional
        The name of the template; by default that of the take.

    Returns
    -------
    NamedTemplate
        The template, with one column for each frame of the clip.

    Raises
    ------
    KinedexError
        There is no such take, the range is not within it, or it has invalid frames in the middle.
    """
    first, last = clip_range(store, take, start, stop)
    words = store.words([store.take_id(take)])
    features = len(store.feature_set.features)
    return template_of_frames(words.take(0), take, first, last, features, name or take, words.masks[0])


def template_of_frames(
    words: U64, take: str, first: int, last: int, features: int, name: str, known: int = int(ALL_KNOWN)
) -> NamedTemplate:
    """Make a template from the frames [first, last) of a take; invalid frames at the ends are removed.

    Parameters
    ----------
    words : uint64 array (T,)
        The words of the take.
    take : str
        The name of the take, for the description and for messages.
    first, last : int
        The first frame of the example, and the one after its last.
    features : int
        The number of features.
    name : str
        The name of the template.
    known : int
        The mask of the features known in the take; the others become wildcards.

    Returns
    -------
    NamedTemplate
        The template, with one column for each frame of the example.

    Raises
    ------
    KinedexError
        All frames are invalid, or some in the middle are.
    """
    valid = np.flatnonzero(words[first:last] != NO_WORD)
    if not len(valid):
        raise KinedexError(f"{take}: all frames from {first} to {last} are invalid")
    clip = words[first + valid[0] : first + valid[-1] + 1]
    if len(clip) > len(valid):
        hole = first + int(np.flatnonzero(words[first + valid[0] : last] == NO_WORD)[0] + valid[0])
        raise KinedexError(
            f"{take}: frame {hole} is invalid, in the middle of {first} to {last}; choose an interval beside it"
        )
    template = learn("soft", [clip], features).template
    if known != ALL_KNOWN:
        template = without_unknown(template, known)
    begin = first + int(valid[0])
    return NamedTemplate(name, template, f"frames {begin} to {begin + len(clip)} of {take}")


@dataclass(frozen=True)
class SubclassTemplate:
    """A template with its provenance: the names of its clips, its origin, and remarks on the clips."""

    subclass: str
    kind: Kind
    learned: LearnedTemplate
    clips: tuple[str, ...]
    origin: str = LEARNED_ORIGIN
    remarks: tuple[str, ...] = ()


def template_of(row: dict[str, Any]) -> SubclassTemplate:
    """Return the template in a row of the results `templates`."""
    counts = row["feature_weights"]
    template = Template(
        np.array(row["values"]).reshape(row["columns"], row["features"]),
        np.array(row["weights"]),
        None if counts is None else np.array(counts),
    )
    learned = LearnedTemplate(template, row["rounds"], tuple(row["costs"]), tuple(row["clip_costs"]))
    return SubclassTemplate(
        row["subclass"], row["kind"], learned, tuple(row["clips"]), row["origin"], tuple(row["remarks"])
    )


def write_template(made: NamedTemplate, features: FeatureSet, path: Path) -> None:
    """Write a template file in the format of the path's extension.

    Parameters
    ----------
    made : NamedTemplate
        The template.
    features : FeatureSet
        The features of its rows.
    path : Path
        A file ending in .yaml, .yml or .csv; a CSV file must be named after the template.

    Raises
    ------
    KinedexError
        The extension is another one, a CSV file has another name than the template, or the folder is missing.
    """
    from kinedex.catalog.template_files import write_csv, write_yaml  # imported here, as few templates are written
    from kinedex.pipelines.engine.page_files import write_page

    ending = path.suffix.lower()
    if ending not in TEMPLATE_ENDINGS:
        raise KinedexError(f"{path}: a template file ends in .yaml or .csv")
    if ending == ".csv" and path.stem != made.name:
        raise KinedexError(f"{path}: a CSV file holds the template that it is named after; call it {made.name}.csv")
    write_page(write_csv(made.template, features) if ending == ".csv" else write_yaml([made], features), path)
