"""The names of runs, in results and in the history of a store."""

from __future__ import annotations

import secrets
from datetime import UTC, datetime


def new_run_id() -> str:
    """Return a short name for one run: the moment in UTC, to 15 microseconds, and two random digits.

    Names of runs that began one after the other are in order.
    """
    moment = datetime.now(UTC)
    return f"{moment:%Y%m%d-%H%M%S}-{moment.microsecond * 65536 // 1_000_000:04x}{secrets.token_hex(1)}"
