"""Stage learn_templates: learn a soft and a hard motion template for every subclass of the training takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import ClassVar

from kinedex.ops.templates.templates import MAX_ROUNDS
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest
from kinedex.pipelines.engine.stage import Input, Stage
from kinedex.pipelines.templates.examples import examples_read
from kinedex.pipelines.templates.template_learning import SubclassTemplate, learn_templates, templates_table
from kinedex.pipelines.templates.training import (
    TemplateParameters,
    feature_weights,
    training_material,
    with_given_templates,
)
from kinedex.storage.store.store import Store


class LearnTemplates(Stage[TemplateParameters]):
    """Learns a soft and a hard motion template for every subclass of the training takes."""

    name = "learn_templates"
    parameters = TemplateParameters
    inputs: ClassVar = {"takes": Input("ingest", optional=True)}

    def reading(self, params: TemplateParameters, store: Store) -> Reading:
        """Return a digest of the training examples, including rejected ones, on which thresholds depend."""
        return examples_read(store, params)

    def external_digest(self, params: TemplateParameters, store: Store | None) -> str:
        """Return a hash of the template files and, where clips are mirrored, of the pairs of mirrored features."""
        pairs = str(store.feature_set.mirror) if store is not None and params.mirror else ""
        return files_digest([Path(file).expanduser() for file in params.template_files]) + pairs

    def run(self, context: StageContext, params: TemplateParameters) -> dict[str, object]:
        """Learn and store the templates."""
        store = context.open()
        material = training_material(store, params)
        clips = material.clips
        context.report_unmatched(material.unmatched)
        context.message(*material.remarks)
        if material.unused:
            context.message(f"templates from files, so their clips are not learned from: {name_list(material.unused)}")
        features = len(store.feature_set.features)
        counts = feature_weights(params.weights, store.feature_set)
        learned: list[SubclassTemplate] = []
        with context.progress("templates", len(clips) * len(params.kinds)) as progress:
            for templates in learn_templates(clips, params.kinds, features, context.executor, counts):
                learned += templates
                progress.advance(len(templates))
        learned = with_given_templates(learned, params, store.feature_set)
        warnings = _warnings(learned)
        for text, classes in warnings.items():
            context.message(f"warning: {name_list(classes)}: {text}")
        context.put_results(templates=templates_table(learned, context.run, params.where))
        used = len({name for one in learned for name in one.clips})
        subclasses = len({one.subclass for one in learned})
        made = f"{counted(len(learned), 'template')} of {counted(subclasses, 'subclass', 'subclasses')}"
        context.message(f"{made} from {counted(used, 'clip')}")
        return {
            "templates": len(learned),
            "subclasses": subclasses,
            "clips": used,
            "single_clip_subclasses": [one.subclass for one in clips if len(one.names) == 1],
            "most_rounds": max(one.learned.rounds for one in learned),
            "warnings": [f"{', '.join(classes)}: {text}" for text, classes in warnings.items()],
        }


def _warnings(templates: Sequence[SubclassTemplate]) -> dict[str, list[str]]:
    """Return a dict from warning to subclasses, with the kind of template if it concerns only some kinds."""
    kinds: dict[str, set[str]] = {}
    found: dict[str, dict[str, list[str]]] = {}
    for one in templates:
        kinds.setdefault(one.subclass, set()).add(one.kind)
        remarks = list(one.remarks)
        if one.learned.rounds == MAX_ROUNDS:
            remarks.append(f"not settled after {MAX_ROUNDS} rounds")
        for text in remarks:
            found.setdefault(text, {}).setdefault(one.subclass, []).append(one.kind)
    return {
        text: [
            subclass if set(own) == kinds[subclass] else f"{subclass} ({', '.join(own)})"
            for subclass, own in classes.items()
        ]
        for text, classes in found.items()
    }
