"""Write a template to a file that people can edit."""

from __future__ import annotations

from pathlib import Path

from kinedex.catalog.features import FeatureSet
from kinedex.catalog.template_files import NamedTemplate, write_csv, write_yaml
from kinedex.ops.errors import KinedexError
from kinedex.pipelines.engine.page_files import write_page
from kinedex.pipelines.templates.stored_templates import TEMPLATE_ENDINGS


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
        The extension is not one of these, a CSV file has another name than the template, or the folder is missing.
    """
    ending = path.suffix.lower()
    if ending not in TEMPLATE_ENDINGS:
        raise KinedexError(f"{path}: a template file ends in .yaml or .csv")
    if ending == ".csv" and path.stem != made.name:
        raise KinedexError(f"{path}: a CSV file holds the template that it is named after; call it {made.name}.csv")
    write_page(write_csv(made.template, features) if ending == ".csv" else write_yaml([made], features), path)
