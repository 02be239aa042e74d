"""Figures of a template with its quantised form, and of two templates side by side."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from kinedex.catalog.features import FeatureSet
from kinedex.ops.templates.derived_templates import Contrast, consistency
from kinedex.ops.templates.templates import QuantisedTemplate, Template, quantise
from kinedex.reports.matrix_figures import MatrixFigure, Panel
from kinedex.reports.pixels import BLACK, TOLERANCE, VARYING, WHITE, WILDCARD, Colour, ramp

F64 = npt.NDArray[np.float64]
U8 = npt.NDArray[np.uint8]

FIRST_ON: Colour = (200, 80, 10)
SECOND_ON: Colour = (0, 114, 178)
NOT_COMPARED: Colour = (235, 235, 235)
AGREED: Colour = (205, 205, 205)


def template_figure(
    template: Template, title: str, note: str, delta: float, features: FeatureSet, rate_hz: float
) -> MatrixFigure:
    """Lay out a template, its quantised form at δ, and the consistency of each feature."""
    quantised = quantise(template, delta)
    agreement = consistency(template)
    return MatrixFigure(
        title=title,
        note=note,
        rows=row_names(features),
        panels=(
            Panel("average of the aligned clips", soft_colours(template.values)),
            Panel(f"quantised: within {delta:g} of off or on", quantised_colours(quantised, len(features.features))),
        ),
        notes_head="consistency",
        notes=[
            f"{share:.0%}" + ("  (no weight)" if silent else "")
            for share, silent in zip(agreement, _silent(template), strict=True)
        ],
        rules=set_rules(features),
        legend=(
            (BLACK, "off in every clip"),
            (WHITE, "on in every clip"),
            (VARYING[0], "mostly off"),
            (VARYING[2], "half and half"),
            (VARYING[-1], "mostly on"),
            (WILDCARD, "wildcard: anything fits"),
        ),
        rate_hz=rate_hz,
    )


def contrast_figure(
    first: Template,
    second: Template,
    names: tuple[str, str],
    found: Contrast,
    delta: float,
    note: str,
    features: FeatureSet,
    rate_hz: float,
) -> MatrixFigure:
    """Lay out two aligned templates, and the entries that contradict each other at δ."""
    count = len(features.features)
    one, other = (quantised_colours(quantise(template, delta), count) for template in (first, second))
    against = np.full((count, len(found.path), 3), AGREED, np.uint8)
    against[~found.compared.T] = NOT_COMPARED
    against[found.against.T > 0] = FIRST_ON
    against[found.against.T < 0] = SECOND_ON
    many = np.abs(found.against).sum(axis=0)
    return MatrixFigure(
        title=f"{names[0]} and {names[1]}",
        note=note,
        rows=row_names(features),
        panels=(
            Panel(names[0], one[:, found.path[:, 0]]),
            Panel(names[1], other[:, found.path[:, 1]]),
            Panel("contradictions", against),
        ),
        notes_head="columns against",
        notes=[str(columns) if columns else "" for columns in many.tolist()],
        rules=set_rules(features),
        legend=(
            (BLACK, "off"),
            (WHITE, "on"),
            (WILDCARD, "wildcard"),
            (FIRST_ON, f"on in {names[0]} only"),
            (SECOND_ON, f"on in {names[1]} only"),
            (AGREED, "alike"),
            (NOT_COMPARED, "a wildcard in one of them"),
        ),
        rate_hz=rate_hz,
    )


def row_names(features: FeatureSet) -> list[str]:
    """Return a name for the row of each feature: the feature's name and number."""
    return [f"{feature.name} {feature.number}" for feature in features.features]


def set_rules(features: FeatureSet) -> list[int]:
    """Return the first row of each set of features but the first."""
    return [word_set.first - 1 for word_set in features.sets.values() if word_set.first > 1]


def soft_colours(values: F64) -> U8:
    """Return the colours of a template, uint8 (features, columns, 3): 0 is black, 1 is white, a ramp between."""
    palette = np.array([ramp(i / 255) for i in range(256)], np.uint8)
    colours = palette[np.clip(np.round(values * 255), 0, 255).astype(np.int64)]
    colours[values <= TOLERANCE] = BLACK
    colours[values >= 1 - TOLERANCE] = WHITE
    turned: U8 = np.ascontiguousarray(colours.transpose(1, 0, 2))
    return turned


def quantised_colours(template: QuantisedTemplate, features: int) -> U8:
    """Return the colours of a quantised template, uint8 (features, columns, 3): off is black, on white, * grey blue."""
    palette = np.array([BLACK, WILDCARD, WHITE], np.uint8)
    turned: U8 = np.ascontiguousarray(palette[(2 * template.values(features)).astype(np.int64)].transpose(1, 0, 2))
    return turned


def _silent(template: Template) -> list[bool]:
    weights = template.feature_weights
    return [False] * template.values.shape[1] if weights is None else (weights == 0).tolist()
