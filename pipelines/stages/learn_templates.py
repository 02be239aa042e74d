"""Stage learn_templates: a soft and a hard motion template for every subclass of the training takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import polars as pl
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.features import FeatureSet
from kinedex.ops.errors import KinedexError
from kinedex.ops.templates.templates import MOST_ROUNDS, Kind
from kinedex.pipelines.console.wording import few
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest, takes_read
from kinedex.pipelines.templates.learning import (
    SubclassTemplate,
    TrainingClips,
    learn_templates,
    templates_table,
    training_clips,
    training_takes,
)
from kinedex.pipelines.templates.recipes import (
    Combination,
    combined,
    feature_weights,
    given_templates,
    templates_of_files,
    with_mirrored,
)
from kinedex.storage.store.store import Store


class Params(BaseModel):
    """What the stage `learn_templates` takes."""

    model_config = ConfigDict(extra="forbid")

    where: str = Field(
        "class IS NOT NULL",
        description="takes to learn from: a SQL filter over the columns of takes; they are grouped by `class`",
    )
    methods: list[Kind] = Field(
        ["soft", "hard"], min_length=1, description="soft: shares of the clips; hard: what all clips have in common"
    )
    weights: dict[str, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = Field(
        {},
        description="feature → how much it counts where clips are aligned and in distance curves, 1 unless given; one "
        "of weight 0 counts nowhere",
    )
    mirror: dict[str, str] = Field(
        {}, description="class → the class that its clips are examples of with left and right exchanged"
    )
    combine: dict[str, Combination] = Field(
        {}, description="new class → {parts: [class, …], gap: columns of anything between them}"
    )
    template_files: list[str] = Field(
        [], description="template files (.yaml, .csv): their templates are taken in the place of learned ones"
    )

    @property
    def kinds(self) -> list[Kind]:
        """The methods, each once."""
        return list(dict.fromkeys(self.methods))


def external_digest(params: Params, store: Store | None) -> str:
    """What the stage depends on outside the store: template files, and which features are each other's mirror image."""
    pairs = str(store.feature_set.mirror) if store is not None and params.mirror else ""
    return files_digest([Path(file).expanduser() for file in params.template_files]) + pairs


def reads(params: Params, store: Store) -> Reading:
    """The takes that the stage depends on: the clips that it learns from, and no others."""
    return takes_read(store, {"clip": params.where})


def run(context: StageContext, params: Params) -> dict[str, object]:
    """Learn and store the templates."""
    store = context.open()
    takes = takes_to_learn_from(store, params)
    clips = clips_to_learn_from(store, params, takes)
    given = {one.name for _, one in templates_of_files(params.template_files, store.feature_set)}
    unused = sorted(given & set(takes["class"]))
    if unused:
        context.say(f"templates from files, so their clips are not learned from: {few(unused)}")
    features = len(store.feature_set.features)
    counts = feature_weights(params.weights, store.feature_set)
    learned: list[SubclassTemplate] = []
    with context.progress("templates", len(clips) * len(params.kinds)) as progress:
        for templates in learn_templates(clips, params.kinds, features, context.executor, counts):
            learned += templates
            progress.advance(len(templates))
    learned = completed(learned, params, store.feature_set)
    warnings = _warnings(learned)
    for text, classes in warnings.items():
        context.say(f"warning: {few(classes)}: {text}")
    with context.writer() as writer:
        table = templates_table(learned, context.run, params.where)
        writer.put_results("templates", table, stage=context.key(), run=context.run)
        writer.commit()
    used = len({name for one in learned for name in one.clips})
    subclasses = len({one.subclass for one in learned})
    context.say(f"{len(learned)} templates of {subclasses} subclasses from {used} clips")
    return {
        "templates": len(learned),
        "subclasses": subclasses,
        "clips": used,
        "single_clip_subclasses": [one.subclass for one in clips if len(one.names) == 1],
        "most_rounds": max(one.learned.rounds for one in learned),
        "warnings": [f"{', '.join(classes)}: {text}" for text, classes in warnings.items()],
    }


def takes_to_learn_from(store: Store, params: Params) -> pl.DataFrame:
    """The training takes; there may be none where all templates come from files."""
    takes = store.takes(params.where)
    return takes if params.template_files and not takes.height else training_takes(store, params.where)


def clips_to_learn_from(store: Store, params: Params, takes: pl.DataFrame) -> list[TrainingClips]:
    """The clips of every subclass that is learned: mirrored ones included, those with a template of a file left out."""
    given = {one.name for _, one in templates_of_files(params.template_files, store.feature_set)}
    clips = with_mirrored(training_clips(store, takes), params.mirror, store.feature_set)
    return [one for one in clips if one.subclass not in given]


def completed(
    learned: Sequence[SubclassTemplate],
    params: Params,
    feature_set: FeatureSet,
    kinds: Sequence[Kind] | None = None,
    *,
    where_possible: bool = False,
) -> list[SubclassTemplate]:
    """Learned templates with those of files and those made of others, by subclass and kind.

    Parameters
    ----------
    kinds: None takes all methods. where_possible: leave out what is made of templates that are not there.

    Raises
    ------
    KinedexError: there is none at all, or one that is needed for another is missing.
    """
    kinds = params.kinds if kinds is None else list(kinds)
    counts = feature_weights(params.weights, feature_set)
    files = templates_of_files(params.template_files, feature_set)
    every = [*learned, *given_templates(files, kinds, counts)]
    names = {one.subclass for one in every}
    wanted = {name: one for name, one in params.combine.items() if not where_possible or names.issuperset(one.parts)}
    every += combined(every, wanted, kinds)
    if not every:
        raise KinedexError("there is no template: no clip to learn from, and none in `template_files`")
    return sorted(every, key=lambda one: (one.subclass, kinds.index(one.kind)))


def _warnings(templates: Sequence[SubclassTemplate]) -> dict[str, list[str]]:
    """What is to be said of templates → of which subclasses, with the kind where it is not true of all kinds."""
    kinds: dict[str, set[str]] = {}
    found: dict[str, dict[str, list[str]]] = {}
    for one in templates:
        kinds.setdefault(one.subclass, set()).add(one.kind)
        said = list(one.remarks)
        if one.learned.rounds == MOST_ROUNDS:
            said.append(f"not settled after {MOST_ROUNDS} rounds")
        for text in said:
            found.setdefault(text, {}).setdefault(one.subclass, []).append(one.kind)
    return {
        text: [
            subclass if set(own) == kinds[subclass] else f"{subclass} ({', '.join(own)})"
            for subclass, own in classes.items()
        ]
        for text, classes in found.items()
    }
