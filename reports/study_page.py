"""Make the page that compares methods, with the motions that it plays."""

from __future__ import annotations

from kinedex.pipelines.engine.display import Progress
from kinedex.pipelines.evaluation.study import Study, shown_parts
from kinedex.reports.methods_page import methods_page
from kinedex.reports.motions import Embed, embed
from kinedex.reports.study_examples import with_study
from kinedex.storage.store.store import Store


def study_page(store: Store, study: Study, embedded: Embed, stage: str, progress: Progress) -> str:
    """Return the page of a comparison, with the motions of the takes on it and their nearest examples.

    Parameters
    ----------
    store : Store
        The store of the takes and the clips.
    study : Study
        The comparison.
    embedded : str or sequence of str
        The takes whose motion the page carries: "auto", "all", "none", or names.
    stage : str
        The name of the stage, for remarks.
    progress : callable
        Makes a progress bar of a description and a number of steps.
    """
    named = dict(store.takes().select("take_id", "name").iter_rows())
    shown = {title: [named[part] for part in parts] for title, parts in shown_parts(study).items()}
    motions = embed(store, shown, embedded, stage, progress)
    motions, near = with_study(store, study, motions, progress)
    return methods_page(study, motions, near)
