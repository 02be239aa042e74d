"""The colours of classes, distinguishable with any colour vision, on light and on dark backgrounds."""

from __future__ import annotations

# Each pair is (on white, on near black), with a contrast of at least 3:1. More classes than pairs repeat colours:
# rows have names, so that a colour is never the only sign.
CLASS_COLOURS: tuple[tuple[str, str], ...] = (
    ("#0072b2", "#4fb0ea"),
    ("#c8500a", "#f28a43"),
    ("#00875f", "#35c797"),
    ("#a03a93", "#dc84d0"),
    ("#857400", "#d3c24a"),
    ("#332288", "#a297f5"),
    ("#c2495d", "#ee93a0"),
    ("#2a8a9d", "#66cbdc"),
    ("#7d4a12", "#cf9b60"),
    ("#882255", "#d9689c"),
    ("#4f7d1b", "#9cc95c"),
    ("#5f6b78", "#aab4bf"),
)


def colour_slot(index: int) -> int:
    """Return the number of the pair of colours of the class at `index`."""
    return index % len(CLASS_COLOURS)


def colour_rules(slots: int) -> tuple[str, str]:
    """Return the CSS rules of the variable --k in the classes k0, k1, …, for light and for dark pages."""
    used = CLASS_COLOURS[: min(slots, len(CLASS_COLOURS))]
    light = "".join(f".k{i}{{--k:{pair[0]}}}" for i, pair in enumerate(used))
    dark = "".join(f".k{i}{{--k:{pair[1]}}}" for i, pair in enumerate(used))
    return light, dark
