"""Select ground truth by parameters: the label files of takes, or their own classes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import polars as pl
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.classes import Classes
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.digests import files_digest
from kinedex.pipelines.engine.file_parameters import NamesFile
from kinedex.pipelines.evaluation.ground_truth import (
    GroundTruth,
    UnknownLabels,
    ground_truth_of_classes,
    place_ground_truth,
)
from kinedex.pipelines.labels.label_takes import on_takes
from kinedex.storage.formats.labels.formats import any_ground_truth, ground_truth_files, read_labels
from kinedex.storage.store.store import Store

NONE, OWN_CLASS = "none", "class"


class GroundTruthParameters(BaseModel):
    """The parameters that select ground truth."""

    model_config = ConfigDict(extra="forbid")

    ground_truth: str = Field(
        "**/ground_truth.csv",
        description="label files, read by their ending: .csv (take, class, start, stop in source frames), .json, "
        ".eaf (ELAN), .vtt (WebVTT), .txt (Audacity); a glob below the takes' source folders, or an absolute path; "
        "'class': each take's own class for all of it; 'none': there is none. Where none is given and this one finds "
        "no file, takes that have a class, such as one that their paths name, are evaluated by it as with 'class'",
    )
    source: Annotated[str | None, NamesFile("data")] = Field(
        None, description="the folder that ground_truth is relative to; by default the takes' source folders"
    )
    unknown_labels: UnknownLabels = Field(
        "error",
        description="a label that is neither a class nor a subclass: 'error'; 'miss' counts it as not found; 'ignore' "
        "excludes it, and reports that",
    )


def ground_truth_digest(params: GroundTruthParameters, store: Store | None) -> str:
    """Return a hash of the label files.

    If they cannot be found, the hash is a constant, so that the stage runs and reports the error.
    """
    if params.ground_truth in (NONE, OWN_CLASS):
        return ""
    known: set[str] = set(store.takes()["source_root"]) if store else set()
    roots = sorted(root for root in known if Path(root).is_dir())
    try:
        if not_labelled(params, roots):
            return "nobody's labels"
        return files_digest(truth_files(params, roots))
    except KinedexError:
        return "none to be read"


def with_own_classes(params: GroundTruthParameters, takes: pl.DataFrame) -> GroundTruthParameters:
    """Return parameters that evaluate takes by their own classes if no other ground truth is given or found.

    Parameters
    ----------
    params : GroundTruthParameters
        The parameters; returned unchanged if they give a ground truth, a file matches the default, or no take
        has a class.
    takes : polars.DataFrame
        Rows of the annotated takes.
    """
    if "ground_truth" in params.model_fields_set or not takes["class"].is_not_null().any():
        return params
    if any_ground_truth(params.ground_truth, _roots(params, takes["source_root"].unique())):
        return params
    return params.model_copy(update={"ground_truth": OWN_CLASS})


def not_labelled(params: GroundTruthParameters, roots: Iterable[str]) -> bool:
    """Return whether takes have no ground truth: it is "none", or not given while no file matches the default.

    Parameters
    ----------
    params : GroundTruthParameters
        The parameters.
    roots : iterable of str
        The source folders of the takes.
    """
    if params.ground_truth == NONE:
        return True
    if "ground_truth" in params.model_fields_set or params.ground_truth == OWN_CLASS:
        return False
    return not any_ground_truth(params.ground_truth, _roots(params, roots))


def ground_truth(store: Store, params: GroundTruthParameters, takes: pl.DataFrame, classes: Classes) -> GroundTruth:
    """Read the ground truth of takes and assign it to them."""
    if params.ground_truth == OWN_CLASS:
        return ground_truth_of_classes(takes, classes)
    paths = truth_files(params, takes["source_root"].unique())
    files, remarks = on_takes(store, list(map(read_labels, paths)))
    truth = place_ground_truth(files, takes, store.takes()["name"], classes, params.unknown_labels)
    return replace(truth, remarks=(*remarks, *truth.remarks))


def truth_files(params: GroundTruthParameters, roots: Iterable[str]) -> list[Path]:
    """Return the label files below `source`, or by default below the source folders of takes."""
    return ground_truth_files(params.ground_truth, _roots(params, roots))


def _roots(params: GroundTruthParameters, roots: Iterable[str]) -> Sequence[str]:
    return [params.source] if params.source else sorted(roots)
