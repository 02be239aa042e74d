"""`python -m kinedex.explorer.warm_process_main` imports the modules for learning, and waits for a command to run.

Imports take longer than learning. This process imports the stages, loads their kernels, and reads one line from
standard input: {"words": [arguments of `kinedex`], "log": file}. It runs this command as `kinedex` would, with its
output in the file. It ends without a command if the server ends, or after `IDLE_SECONDS`.
"""

from __future__ import annotations

import json
import os
import sys
from contextlib import suppress
from pathlib import Path
from runpy import run_module
from threading import Timer

IDLE_SECONDS = 600.0
"""Seconds that the process waits for a command; it takes some 200 MB of memory."""

STAGES = ("learn_templates", "annotate")


def prepare() -> None:
    """Import the stages of learning, and load their kernels by learning and annotating a few words."""
    import numpy as np
    import typer  # noqa: F401

    from kinedex.catalog.classes import OWN, load_classes
    from kinedex.catalog.features import load_feature_set
    from kinedex.ops.words import TakeWords
    from kinedex.pipelines.annotation.annotators import make_annotator
    from kinedex.pipelines.annotation.batches import annotate_words
    from kinedex.pipelines.annotation.methods import LabelledMotion, Material, Motion, Motions
    from kinedex.pipelines.annotation.single_examples import SingleExamples
    from kinedex.pipelines.annotation.template_methods import BestMethod
    from kinedex.pipelines.engine.executors import make_executor
    from kinedex.pipelines.engine.runner import run_pipeline  # noqa: F401
    from kinedex.pipelines.engine.stage import load_stage
    from kinedex.pipelines.templates.template_learning import TrainingClips, learn_templates

    for stage in STAGES:
        load_stage(stage)
    features = load_feature_set()
    words = np.arange(40, dtype=np.uint64) // 3
    clips = [TrainingClips("any", ("one", "other"), (words[:20], words[20:]))]
    tasks = learn_templates(clips, ["soft"], len(features.features), make_executor("serial", None))
    soft = [one for task in tasks for one in task]
    known = load_classes(OWN, {"any"})
    annotator = make_annotator(features, soft, known, 0.05, 0.13, method=BestMethod, clips=lambda: [words])
    takes = TakeWords(np.zeros(1, np.int64), np.array([0, len(words)], np.int64), words)
    annotate_words(annotator, takes, store_curves=True)
    examples = Motions(lambda: [LabelledMotion(words=own, label="any") for own in clips[0].words])
    given = Material(examples, Motions(lambda: [Motion(words=words)]))
    annotate_words(make_annotator(features, soft, known, 0.05, 0.13, method=SingleExamples, clips=given), takes)


def main() -> None:
    """Prepare, wait for a command, and run it."""
    with suppress(Exception):  # the command will meet the same error, and reports it
        prepare()
    limit = Timer(IDLE_SECONDS, os._exit, [1])  # not 0, because a command may have been sent at the same moment
    limit.daemon = True
    limit.start()
    line = sys.stdin.readline()
    limit.cancel()
    if not line:
        return
    asked = json.loads(line)
    with Path(asked["log"]).open("ab") as log, open(os.devnull, "rb") as nothing:
        os.dup2(nothing.fileno(), 0)
        os.dup2(log.fileno(), 1)
        os.dup2(log.fileno(), 2)
    sys.argv = ["kinedex", *asked["words"]]
    run_module("kinedex", run_name="__main__", alter_sys=True)


if __name__ == "__main__":
    main()
