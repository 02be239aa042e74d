"""Create the identifiers of runs, as used in results and in the history of a store."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime


def new_run_id() -> str:
    """Return an identifier of a run: the time in UTC, to 15 microseconds, and two random hexadecimal digits.

    The identifiers of successive runs sort in the order of their start.
    """
    moment = datetime.now(UTC)
    return f"{moment:%Y%m%d-%H%M%S}-{moment.microsecond * 65536 // 1_000_000:04x}{secrets.token_hex(1)}"
