"""Write values of Arrow, DuckDB and Python as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from decimal import Decimal
from typing import Any

from kinedex.ops.wording import json_escaped


def json_text(document: object) -> str:
    """Return a value as indented JSON text that ends with a line break."""
    return json_escaped(json.dumps(json_value(document), indent=1, ensure_ascii=False, allow_nan=False)) + "\n"


def setting_text(value: object) -> str:
    """Return a value in the form that `--set` reads: a text unchanged, and any other value as JSON, which is YAML."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def json_value(value: Any) -> Any:
    """Convert a value to one that JSON can represent.

    ∞ and NaN become null. Decimals, such as SQL's sums of integers, become numbers. Arrow tables become lists of rows.
    Paths, dates, times and other values for which JSON has no type become text.
    """
    match value:
        case None | bool() | int() | str():
            return value
        case float():
            return value if math.isfinite(value) else None
        case Decimal():
            return int(value) if value == value.to_integral_value() else float(value)
        case Mapping():
            return {str(name): json_value(part) for name, part in value.items()}
        case list() | tuple():
            return [json_value(part) for part in value]
        case bytes():
            return value.hex()
    if hasattr(value, "to_pylist"):
        return json_value(value.to_pylist())
    return str(value)
