"""The page that compares two evaluations."""

from __future__ import annotations

from collections.abc import Sequence

from kinedex.ops.wording import digits
from kinedex.pipelines.evaluation.differences import HEADER, VERDICTS, Comparison, remarks, settings, signed
from kinedex.reports.page_environment import page_environment


def comparison_page(comparisons: Sequence[Comparison]) -> str:
    """Return comparisons as one self-contained HTML page."""
    environment = page_environment({"digits": digits, "signed": signed, "remarks": remarks, "settings": settings})
    return environment.get_template("compared.html.j2").render(
        comparisons=comparisons, verdicts=VERDICTS, header=HEADER
    )
