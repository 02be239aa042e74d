"""The guarded figures, as `benchmarks/guarded.yaml` lists them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from kinedex.ops.errors import KinedexError, did_you_mean

FILE = Path(__file__).resolve().parents[1] / "guarded.yaml"

ROUNDS = 5


@dataclass(frozen=True)
class Guarded:
    """A figure that may not fall.

    Attributes
    ----------
    key : str
        Its function in `benchmarks/drivers/work.py`.
    part : str
        The part of the list that it belongs to.
    figure, unit, means : str
        Its name, its unit, and what it means to a user.
    rounds : int
        How often it is measured at each commit.
    """

    key: str
    part: str
    figure: str
    unit: str
    means: str
    rounds: int = ROUNDS


def guarded_figures(parts: Sequence[str] = ()) -> list[Guarded]:
    """Return the guarded figures of some parts, or of all if none are named.

    Raises
    ------
    KinedexError
        There is no such part.
    """
    listed = yaml.safe_load(FILE.read_text(encoding="utf-8"))
    for part in parts:
        if part not in listed:
            raise KinedexError(
                f"'{part}' is no part of {FILE.name}, which has {', '.join(listed)}{did_you_mean(part, listed)}"
            )
    return [Guarded(key, part, **entry) for part in parts or listed for key, entry in listed[part].items()]
