"""Stage learn_keyframes: learn keyframe queries for every subclass from its examples and those of other classes."""

from __future__ import annotations

from kinedex.catalog.classes import class_files, load_classes
from kinedex.ops.errors import KinedexError
from kinedex.ops.keyframes.consensus import AtLeast
from kinedex.ops.wording import counted, name_list
from kinedex.pipelines.engine.context import StageContext
from kinedex.pipelines.engine.digests import Reading, files_digest
from kinedex.pipelines.engine.page_files import drawn_by, write_page
from kinedex.pipelines.engine.stage import Stage
from kinedex.pipelines.keyframes.learning_runs import ClassRuns, StoredRuns, learn_queries, queries_table
from kinedex.pipelines.keyframes.parameters import KeyframeParameters, setting_of
from kinedex.pipelines.keyframes.query_learning import training_sets
from kinedex.pipelines.templates.examples import examples_of, examples_read, rejected_examples
from kinedex.pipelines.templates.template_learning import example_clips
from kinedex.storage.store.store import Store

PAGE = "kinedex.reports.keyframes_page:keyframes_page"
"""The function that draws the page of the stage."""


class LearnKeyframes(Stage[KeyframeParameters]):
    """Learns keyframe queries for every subclass from its examples and those of other classes."""

    name = "learn_keyframes"
    parameters = KeyframeParameters

    def reading(self, params: KeyframeParameters, store: Store) -> Reading:
        """Return a digest of the training examples."""
        return examples_read(store, params)

    def external_digest(self, params: KeyframeParameters, store: Store | None) -> str:
        """Return a hash of the class file."""
        return files_digest(class_files(params.classes))

    def run(self, context: StageContext, params: KeyframeParameters) -> dict[str, object]:
        """Learn and store the queries and all learning runs; learning runs that were finished earlier are reused."""
        store = context.open()
        found = examples_of(store, params)
        context.report_unmatched(found.unmatched)
        clips, rejected = example_clips(store, found.examples), rejected_examples(store, params)
        if len(clips) < 2 and not rejected:
            raise KinedexError(
                f"keyframe queries tell classes apart, so clips of at least two are needed; the filter "
                f"`{params.where}` selects those of {clips[0].subclass} only"
            )
        context.message(*found.remarks, *(f"{one.subclass}: {remark}" for one in clips for remark in one.remarks))
        wanted = training_sets(clips, load_classes(params.classes, [one.subclass for one in clips]), rejected)
        bare = [one.subclass for one in wanted if not one.negatives]
        if bare:
            raise KinedexError(
                f"no clip is of another class than {name_list(bare)}, so there is nothing to tell it from"
            )
        setting, rounds = setting_of(params, store), params.rounds()
        kept = StoredRuns(context, wanted)
        before = {(one.key, one.number) for one in kept.known()}
        subclasses = counted(len(wanted), "subclass", "subclasses")
        examples = counted(sum(len(one.names) for one in clips), "clip")
        if rejected:
            examples += f" and {counted(len(rejected), 'rejected interval')}"
        context.message(f"{subclasses} with {examples}, in rounds of {rounds.group} runs each")
        with context.progress("runs", rounds.runs * len(wanted)) as progress:
            classes = learn_queries(
                wanted, setting, rounds, context.executor, kept.known(), kept.save, progress.advance, context.message
            )
        known = sum((one.key, number) in before for one in classes for number in one.used)
        context.put_results(keyframe_runs=kept.table(classes), queries=queries_table(classes, context.run))
        path = context.report_file("keyframes.html")
        outcomes = [one.outcome for one in classes]
        finished = {one.training.subclass: list(one.used.values()) for one in classes}
        title = "Keyframe queries learned from clips"
        remarks = [f"{one.subclass}: {remark}" for one in clips for remark in one.remarks]
        page = drawn_by(PAGE)(title, outcomes, finished, store.feature_set, store.rate_hz, params.learner, remarks)
        write_page(page, path)
        context.message(f"report: {path.resolve()}")
        file = path.relative_to(context.store_path).as_posix()
        return {**_summary(context, classes, params.at_least, known), "files": [file]}


def _summary(context: StageContext, classes: list[ClassRuns], at_least: AtLeast, known: int) -> dict[str, object]:
    outcomes = [one.outcome for one in classes]
    best: list[str] = [one.subclass for one in outcomes if one.consensus.origin == "best run"]
    if best:
        context.message(
            f"less fit than the {at_least} run, so the best run instead of the consensus: {name_list(best)}"
        )
    lost = [one.subclass for one in outcomes if one.recall < 1.0]
    if lost:
        context.message(f"not every training clip is found: {name_list(lost)}")
    done = sum(len(one.used) for one in classes)
    settled = sum(one.settled for one in classes)
    queries = sum(len(one.chosen) for one in outcomes)
    clips = sum(len(one.clips) for one in outcomes)
    context.message(
        f"{queries} queries of {len(classes)} subclasses from {clips} clips; {done} runs"
        + (f", {known} of them known from before" if known else "")
        + (f"; {settled} subclasses settled early" if settled else "")
    )
    return {
        "queries": queries,
        "subclasses": len(classes),
        "clips": clips,
        "runs": done,
        "settled": settled,
        "best_runs": best,
        "incomplete": lost,
        "precision": round(sum(one.precision for one in outcomes) / len(outcomes), 6),
        "recall": round(sum(one.recall for one in outcomes) / len(outcomes), 6),
    }
