"""Convert runs of wrong limbs to labels, for files that a person corrects."""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Sequence

from kinedex.ops.errors import KinedexError, did_you_mean
from kinedex.ops.wording import few
from kinedex.pipelines.inertial.limb_error_tables import ERRORS, RUNS, judged_limbs
from kinedex.storage.formats.labels.segments import ERROR, Label, TakeLabels
from kinedex.storage.snapshot.shown_results import pipeline_of, pipelines_by_use
from kinedex.storage.store.store import Store


def limb_error_stage(store: Store, wanted: str | None = None) -> str:
    """Return the stage whose intervals of wrong limbs the user has requested.

    Parameters
    ----------
    store : Store
        The store to read.
    wanted : str, optional
        "<pipeline>/<stage>", the name of the pipeline, or the id of the run; the stage of the pipeline whose runs the
        view `limb_error_runs` shows by default.

    Raises
    ------
    KinedexError
        No limb was compared with a sensor, none by this stage, or several stages match.
    """
    stages = sorted({part.stage for part in store.manifest.results.get(ERRORS, ())})
    if not stages:
        command = f"kinedex run limb-errors --store {shlex.quote(str(store.path))} --set source=… --set recordings=…"
        raise KinedexError(f"{store.path}: no limb was compared with a sensor; `{command}` does it")
    asked = wanted or next(name for name in pipelines_by_use(store.manifest) if name in map(pipeline_of, stages))
    records = store.manifest.stages
    fitting = [
        name
        for name in stages
        if asked in (name, pipeline_of(name)) or (name in records and asked == records[name].run)
    ]
    if not fitting:
        raise KinedexError(f"no stage '{asked}' has compared limbs with sensors{did_you_mean(asked, stages)}")
    if len(fitting) > 1:
        raise KinedexError(
            f"several stages of '{asked}' have compared limbs with sensors: {few(fitting)}; choose one with --stage"
        )
    return fitting[0]


def limb_error_labels(
    store: Store, stage: str, takes: Sequence[str] = (), where: str | None = None
) -> list[TakeLabels]:
    """Return the runs in which limbs are wrong as labels of the class `error`, for each take; jumps are excluded.

    Limbs without such a run are listed as covered, so that label files show that they were compared.

    Parameters
    ----------
    store : Store
        The store to read.
    stage : str
        "<pipeline>/<stage>".
    takes : sequence of str
        The names of the takes to return; by default all that have sensors.
    where : str, optional
        A SQL filter over the columns of takes.

    Raises
    ------
    KinedexError
        A take was not compared with sensors, or the filter selects none that was.
    """
    record = store.manifest.stages.get(stage)
    runs: dict[str, list[Label]] = defaultdict(list)
    for row in store.result(RUNS, stage=stage).to_pylist():
        if row["kind"] == "distance":
            runs[row["take"]].append(Label(ERROR, row["start"], row["stop"], limb=row["limb"]))
    live = {str(row["name"]) for row in store.takes(where).iter_rows(named=True)}
    found: dict[str, TakeLabels] = {}
    for limbs in judged_limbs(store, stage):
        one = limbs[0]
        own = tuple(sorted(runs[one.take], key=lambda label: (label.start, label.stop, label.limb)))
        made = TakeLabels.made if record is None else record.finished
        covered = tuple((judged.limb, "") for judged in limbs)
        found[one.take] = TakeLabels(one.take, one.rate_hz, len(one.error), own, made, covered)
    unknown = sorted(set(takes) - set(found))
    if unknown:
        raise KinedexError(
            f"stage {stage} did not compare '{unknown[0]}' with sensors{did_you_mean(unknown[0], found)}"
        )
    chosen = [found[name] for name in sorted(found) if name in live and (not takes or name in takes)]
    if not chosen:
        raise KinedexError(f"{store.path}: no take that stage {stage} has compared with sensors is selected")
    return chosen
