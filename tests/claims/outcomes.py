"""The outcome of each claim, and the table of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from kinedex.reports.markdown import grid

LONGEST = 100
"""Characters of a claim in the table."""


@dataclass(frozen=True)
class Outcome:
    """The outcome of a claim.

    Attributes
    ----------
    claim : str
        The command, or what else is claimed.
    way : str
        How it was run, or why not.
    seconds : float
        How long it took.
    result : str
        "ok", "not run", or what is wrong: its first line, then the end of the output.
    """

    claim: str
    way: str
    seconds: float
    result: str

    @property
    def failed(self) -> bool:
        """True where something is wrong."""
        return self.result not in ("ok", "not run")


def table(outcomes: Sequence[Outcome]) -> str:
    """Return the table of all outcomes as Markdown, and the outputs of those that failed below it."""
    rows = [
        [_short(one.claim), _short(one.way), f"{one.seconds:.1f}", one.result.partition("\n")[0]] for one in outcomes
    ]
    text = "\n".join(grid(["claim", "how it is run", "seconds", "result"], rows))
    for one in outcomes:
        if one.failed:
            text += f"\n\n{one.claim}\n{one.result}"
    counts = [sum(one.result == kind for one in outcomes) for kind in ("ok", "not run")]
    failed = sum(one.failed for one in outcomes)
    return f"{text}\n\n{len(outcomes)} claims: {counts[0]} ok, {counts[1]} not run here, {failed} failed"


def _short(text: str) -> str:
    text = " ".join(text.split()).replace("|", "\\|")
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 1]}…"
