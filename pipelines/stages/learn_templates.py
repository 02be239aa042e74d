"""Stage learn_templates: a soft and a hard motion template for every subclass of the training takes."""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, Field

from pipelines.context import StageContext
from pipelines.learning import Kind, learn_templates, templates_table, training_clips, training_takes


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


def run(context: StageContext, params: Params) -> dict[str, object]:
    """Learn and store the templates."""
    store = context.open()
    takes = training_takes(store, params.where)
    clips = training_clips(store, takes)
    single = [one.subclass for one in clips if len(one.names) == 1]
    if single:
        context.say(f"warning: one clip only, which then is the template: {', '.join(single)}")
    kinds = list(dict.fromkeys(params.methods))
    features = len(store.feature_set.features)
    learned = []
    with context.progress("templates", len(clips) * len(kinds)) as progress:
        for templates in learn_templates(clips, kinds, features, context.executor):
            learned += templates
            progress.advance(len(templates))
    unsettled = sorted({one.subclass for one in learned if one.learned.rounds == 10})
    if unsettled:
        context.say(f"not settled after 10 rounds: {', '.join(unsettled)}")
    with context.writer() as writer:
        table = templates_table(learned, context.run, params.where)
        writer.put_results("templates", table, stage=context.key(), run=context.run)
        writer.commit()
    context.say(f"{len(learned)} templates of {len(clips)} subclasses from {takes.height} clips")
    return {
        "templates": len(learned),
        "subclasses": len(clips),
        "clips": takes.height,
        "single_clip_subclasses": single,
        "most_rounds": max(one.learned.rounds for one in learned),
    }
