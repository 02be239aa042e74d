"""Read and write template files, which hold motion templates as YAML or CSV that people can edit by hand."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from kinedex.catalog.configs import Located, load_yaml, read_text, scalar
from kinedex.catalog.features import FeatureSet
from kinedex.ops.arrays import F64
from kinedex.ops.errors import ConfigError, KinedexError
from kinedex.ops.templates.templates import NamedTemplate, Template

WILDCARD = 0.5
_LETTERS = {"0": 0.0, "1": 1.0, "*": WILDCARD}
_WEIGHT = "weight"


def read_templates(path: str | Path, feature_set: FeatureSet) -> tuple[NamedTemplate, ...]:
    """Read a file of templates: YAML, or CSV by its extension.

    A YAML file maps the name of each template to a mapping with the key `rows`. `rows` maps a feature (by name or
    number) to its values in all columns, as a text of 0, 1 and * (a wildcard) or as a list of numbers from 0 to 1.
    Features without a row are wildcards throughout. The optional key `weights` maps a feature to its weight (1 by
    default, 0 to ignore it), `column_weights` lists the weight of each column, and `description` is a text. A CSV file
    holds one template, which is named after the file. Each of its rows has a feature, its weight (if there is a column
    headed `weight`), and its value in every column.

    Parameters
    ----------
    path : path
        A file ending in .yaml, .yml or .csv.
    feature_set : FeatureSet
        The features that the file refers to.

    Raises
    ------
    ConfigError
        If the file is invalid; the message has the line of the first fault, what was expected, and the nearest valid
        name.
    """
    path = Path(path).expanduser()
    if path.suffix.lower() in (".yaml", ".yml"):
        return _named_templates(load_yaml(path), feature_set)
    if path.suffix.lower() != ".csv":
        raise ConfigError(path, "a template file ends in .yaml or .csv")
    return (_from_csv(read_text(path, "utf-8-sig"), path, feature_set),)


def write_yaml(templates: Iterable[NamedTemplate], feature_set: FeatureSet) -> str:
    """Write templates as YAML that `read_templates` reads as the same templates, to the last digit."""
    return "\n".join(_yaml(one, feature_set) for one in templates) or "{}\n"


def write_csv(template: Template, feature_set: FeatureSet) -> str:
    """Write a template as CSV that `read_templates` reads as the same values; column weights are not kept."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    weights = template.feature_weights
    head = ["feature"] if weights is None else ["feature", _WEIGHT]
    writer.writerow([*head, *range(1, len(template) + 1)])
    for feature in feature_set.features:
        row = template.values[:, feature.number - 1]
        weight = [] if weights is None else [_number(weights[feature.number - 1])]
        writer.writerow([feature.name, *weight, *("*" if value == WILDCARD else _number(value) for value in row)])
    return out.getvalue()


# ---- YAML ------------------------------------------------------------------------------------------------


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid")
    description: str = ""
    rows: dict[str | int, Any] = Field(min_length=1)
    weights: dict[str | int, Annotated[float, Field(ge=0, allow_inf_nan=False)]] = {}
    column_weights: list[Annotated[float, Field(gt=0, allow_inf_nan=False)]] | None = None


def _named_templates(located: Located, feature_set: FeatureSet) -> tuple[NamedTemplate, ...]:
    found = []
    for name, body in located.mapping().items():
        if not isinstance(name, str):
            raise located.error("the name of a template must be a text; put it in quotes", name)
        if not isinstance(body, dict):
            raise located.error("a template is a mapping with `rows`", name)
        entry = located.model(_Entry, name, data=body)
        found.append(NamedTemplate(name, _template(located, name, entry, feature_set), entry.description))
    if not found:
        raise located.error("holds no template")
    return tuple(found)


def _template(located: Located, name: str, entry: _Entry, feature_set: FeatureSet) -> Template:
    rows: dict[int, list[float]] = {}
    columns, first = 0, ""
    for key, written in entry.rows.items():
        at = (name, "rows", key)
        number = _feature(located, feature_set, key, at)
        if number in rows:
            raise located.error(f"feature {number} has a row already", *at)
        rows[number] = _row(located, written, at)
        columns, first = columns or len(rows[number]), first or str(key)
        if len(rows[number]) != columns:
            raise located.error(f"has {len(rows[number])} columns, but {first} has {columns}", *at)
    values = np.full((columns, len(feature_set.features)), WILDCARD)
    for number, row in rows.items():
        values[:, number - 1] = row
    weights = entry.column_weights
    if weights is not None and len(weights) != columns:
        raise located.error(
            f"must be one for each of the {columns} columns, got {len(weights)}", name, "column_weights"
        )
    return Template(
        values,
        np.ones(columns) if weights is None else np.array(weights, np.float64),
        _feature_weights(located, name, entry, feature_set),
    )


def _feature_weights(located: Located, name: str, entry: _Entry, feature_set: FeatureSet) -> F64 | None:
    if not entry.weights:
        return None
    result = np.ones(len(feature_set.features))
    for key, weight in entry.weights.items():
        result[_feature(located, feature_set, key, (name, "weights", key)) - 1] = weight
    if not result.any():
        raise located.error("at least one feature must count", name, "weights")
    return result


def _feature(located: Located, feature_set: FeatureSet, key: str | int, at: tuple[str | int, ...]) -> int:
    try:
        return feature_set.feature(key).number
    except KinedexError as fault:
        raise located.error(str(fault), *at) from None


def _row(located: Located, written: object, at: tuple[str | int, ...]) -> list[float]:
    if isinstance(written, int | float):
        raise located.error("put the row in quotes; without them YAML reads a number", *at)
    if not isinstance(written, str | list) or not written:
        raise located.error(f"a row is a text of 0, 1 and *, or a list of numbers, got {written!r}", *at)
    row = []
    for place, entry in enumerate(written):
        value = _value(entry)
        if value is None:
            expected = "0, 1 or *" if isinstance(written, str) else "a number from 0 to 1, or *"
            raise located.error(f"column {place + 1} must be {expected}, got {entry!r}", *at)
        row.append(value)
    return row


def _value(entry: object) -> float | None:
    """Return the value of an entry, or None if it is invalid."""
    if isinstance(entry, str):
        if entry in _LETTERS:
            return _LETTERS[entry]
        try:
            entry = float(entry)
        except ValueError:
            return None
    if isinstance(entry, bool) or not isinstance(entry, int | float) or not 0 <= entry <= 1:
        return None
    return float(entry)


def _yaml(one: NamedTemplate, feature_set: FeatureSet) -> str:
    template = one.template
    lines = [f"{scalar(one.name)}:"]
    if one.description:
        lines.append(f"  description: {scalar(one.description)}")
    if template.feature_weights is not None:
        pairs = zip(feature_set.features, template.feature_weights.tolist(), strict=True)
        unlike = [f"{feature.name}: {_number(weight)}" for feature, weight in pairs if weight != 1]
        # Weights that are all 1 are written too, because the store distinguishes them from no weights.
        lines.append(f"  weights: {{{', '.join(unlike or [f'{feature_set.features[0].name}: 1'])}}}")
    if np.any(template.weights != 1):
        lines.append(f"  column_weights: [{', '.join(map(_number, template.weights))}]")
    lines.append("  rows:")
    width = max(len(feature.name) for feature in feature_set.features) + 1
    for feature in feature_set.features:
        label = f"{feature.name}:".ljust(width)
        lines.append(f"    {label} {_row_text(template.values[:, feature.number - 1])}")
    return "\n".join(lines) + "\n"


def _row_text(row: F64) -> str:
    letters = {value: letter for letter, value in _LETTERS.items()}
    if all(value in letters for value in row.tolist()):
        return f'"{"".join(letters[value] for value in row.tolist())}"'
    return f"[{', '.join(map(_number, row))}]"


def _number(value: float) -> str:
    """Return the shortest text that is read as the same number."""
    whole = float(value)
    return str(int(whole)) if whole.is_integer() else repr(whole)


# ---- CSV -------------------------------------------------------------------------------------------------


def _from_csv(text: str, path: Path, feature_set: FeatureSet) -> NamedTemplate:
    """Convert a CSV table to the mapping that an equivalent YAML file would hold, and read that mapping."""
    reader = csv.reader(io.StringIO(text))
    try:
        table = [(reader.line_num, [cell.strip() for cell in row]) for row in reader if any(map(str.strip, row))]
    except csv.Error as fault:
        raise ConfigError(path, f"is not CSV: {fault}", line=reader.line_num) from None
    if not table or table[0][1][0].lower() != "feature":
        raise ConfigError(path, "must begin with a line `feature,1,2,3,…`, a number for each column", line=1)
    (first, head), *rows = table
    start = 2 if len(head) > 1 and head[1].lower() == _WEIGHT else 1
    if len(head) == start:
        raise ConfigError(path, "has no columns", line=first)
    if not rows:
        raise ConfigError(path, "has no feature in it", line=first)
    name = path.stem
    parts: dict[str, dict[str, Any]] = {"rows": {}, "weights": {}}
    lines: dict[tuple[str | int, ...], int] = {(name,): first}
    for line, (feature, *cells) in rows:
        if len(cells) != len(head) - 1:
            reason = f"has {len(cells) + 1} cells, but the first line has {len(head)}"
            raise ConfigError(path, reason, line=line, key=feature)
        if feature in parts["rows"]:
            raise ConfigError(path, "has a row already", line=line, key=feature)
        parts["rows"][feature] = cells[start - 1 :]
        if start == 2:
            parts["weights"][feature] = cells[0]
        lines |= {(name, part, feature): line for part in parts}
    return _named_templates(Located(path, {name: parts}, lines), feature_set)[0]
